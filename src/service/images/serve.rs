//! Answers the requests for images of one connection.
//!
//! A request has one answer, so that no more than one chunk is on its way, whatever the link and however slowly the other end reads. An answer
//! is handed to whoever writes to the connection, and waits there until no update is due.

use super::super::session::Shared;
use super::super::state::State;
use super::super::supervisor::panic_message;
use super::gallery::{Key, Opened, Refused};
use crate::image::ImageCounter;
use crate::wire::{CHUNK_BYTES, ImageChunk, ImageForm, ImageRefusal, ImageRequest, List, Message, NoImage, Text, Wanted};
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinError;
use tokio::time::{Instant, sleep_until};

/// What a connection asks for: the newest request alone.
#[derive(Debug, Default)]
pub struct Requests {
    newest: watch::Sender<Option<ImageRequest>>,
    waits: AtomicBool,
}

impl Requests {
    /// Takes a request; whether one before it still waited for its answer, which it will not have.
    pub fn take(&self, request: ImageRequest) -> bool {
        self.newest.send_replace(Some(request));
        self.waits.swap(true, Ordering::Relaxed)
    }
}

/// What is being sent on a connection, and how fast.
struct Server<'a> {
    shared: &'a Shared,
    state: watch::Receiver<Arc<State>>,
    opened: Option<Opened>,
    /// The next answer goes then at the earliest.
    not_before: Instant,
}

/// Answers the requests of a connection, each in its time, until nobody takes the answers any more.
pub async fn serve(shared: &Shared, requests: &Requests, answers: mpsc::Sender<Message>) {
    let mut newest = requests.newest.subscribe();
    // One may have come before this began.
    newest.mark_changed();
    let mut server = Server { shared, state: shared.state.clone(), opened: None, not_before: Instant::now() };
    while newest.changed().await.is_ok() {
        loop {
            let Some(request) = *newest.borrow_and_update() else { break };
            let since = Instant::now();
            let answer = tokio::select! {
                biased;
                _ = newest.changed() => continue,
                image = server.wait_for(&request) => match image {
                    Ok(key) => server.chunk(&request, key).await,
                    Err(refused) => Err(refused),
                },
            };
            let answer = answer.unwrap_or_else(|refused| refusal(&request, refused));
            server.pace(&request, since);
            requests.waits.store(false, Ordering::Relaxed);
            if answers.send(answer).await.is_err() {
                return;
            }
            break;
        }
    }
}

impl Server<'_> {
    /// Waits until an answer may go and there is what is asked for. It may be given up at any time.
    async fn wait_for(&mut self, request: &ImageRequest) -> Result<Key, Refused> {
        // Of the moment of the request: what is kept from then on is new.
        let kept = self.state.borrow().newest_kept;
        sleep_until(self.not_before.min(Instant::now() + self.cost(request))).await;
        let _ = self.state.wait_for(|state| state.may_send_images()).await;
        let key = self.judge(request)?;
        match request.wanted.get() {
            Some(Wanted::Next) => {
                let ours = self.shared.clock.boot_id();
                let foreign = request.camera_boot_id.get().is_some_and(|boot| boot.get() != ours);
                let named = request.image_counter.get().map(|image| (ImageCounter(image.get()), request.exposure));
                let after = if foreign { None } else { named.or(kept) };
                let next = |state: &State| {
                    state
                        .newest_kept
                        .filter(|newest| Some(*newest) > after && state.settings.images.send && state.may_send_images())
                };
                let newest = match self.state.wait_for(|state| next(state).is_some()).await {
                    Ok(state) => next(&state),
                    Err(_) => None,
                };
                let (image, _) = newest.ok_or((NoImage::NeverWas, "the service ends".to_owned()))?;
                let exposure = after.filter(|(last, _)| *last == image).map_or(0, |(_, exposure)| exposure.saturating_add(1));
                Ok(self.key(request, ours, image, exposure))
            }
            _ => Ok(key),
        }
    }

    /// Which exposure a request means, as far as that is known at once.
    fn judge(&self, request: &ImageRequest) -> Result<Key, Refused> {
        if request.rate_bytes_s.get() == 0 {
            return Err((NoImage::Rate, "a rate of 0 bytes/s would never end".to_owned()));
        }
        let ours = self.shared.clock.boot_id();
        let state = self.state.borrow();
        let nothing = || (NoImage::NeverWas, "no image has been kept yet".to_owned());
        match request.wanted.get() {
            Some(Wanted::Image) => {
                let image = request.image_counter.get().map(|image| ImageCounter(image.get()));
                let image = image.ok_or((NoImage::NoNumber, "the number of the image is missing".to_owned()))?;
                let boot = request.camera_boot_id.get().map_or(ours, |boot| boot.get());
                let next = state.counters.next_image;
                if boot == ours && image >= next {
                    return Err((NoImage::NeverWas, format!("there is no image {} yet, the next is {}", image.0, next.0)));
                }
                Ok(self.key(request, boot, image, request.exposure))
            }
            // The next one is known once it is kept.
            Some(Wanted::Next) => Ok(self.key(request, ours, ImageCounter::default(), 0)),
            Some(Wanted::Newest) => {
                let (image, _) = state.newest_kept.ok_or_else(nothing)?;
                Ok(self.key(request, ours, image, request.exposure))
            }
            None => Err(nothing()),
        }
    }

    fn key(&self, request: &ImageRequest, boot_id: u32, image: ImageCounter, exposure: u8) -> Key {
        Key { boot_id, image, exposure, form: request.form.get().unwrap_or(ImageForm::Raw) }
    }

    /// The chunk that is asked for.
    async fn chunk(&mut self, request: &ImageRequest, key: Key) -> Result<Message, Refused> {
        let mut opened = match self.opened.take().filter(|opened| opened.key == key) {
            Some(opened) => opened,
            None => self.open(key).await?,
        };
        let begun = request.begun_crc32.get().map(|crc32| crc32.get());
        if begun.is_some_and(|begun| begun != opened.crc32) {
            // Perhaps the one that is open is not the one that is on disk now.
            opened = self.open(key).await?;
            if begun != Some(opened.crc32) {
                let words = format!("image {} is another file now, with CRC-32 {:08x}", key.image.0, opened.crc32);
                self.opened = Some(opened);
                return Err((NoImage::Changed, words));
            }
        }
        let (offset, total) = (request.offset.get(), opened.total);
        if offset >= total {
            self.opened = Some(opened);
            return Err((NoImage::Offset, format!("byte {offset} of image {}, which has {total}", key.image.0)));
        }
        if opened.at_hand(offset).is_none() {
            opened = self.read_ahead(opened, offset).await?;
        }
        let bytes = opened.at_hand(offset).unwrap_or_default();
        let chunk = ImageChunk {
            request: request.request,
            camera_boot_id: key.boot_id.into(),
            image_counter: key.image.0.into(),
            exposure: key.exposure,
            exposures: opened.exposures,
            form: key.form.into(),
            total_bytes: total.into(),
            file_crc32: opened.crc32.into(),
            offset: offset.into(),
            bytes_count: (bytes.len() as u16).into(),
            bytes: List::from_slice(bytes),
        };
        self.opened = Some(opened);
        Ok(Message::ImageChunk(Box::new(chunk)))
    }

    async fn open(&self, key: Key) -> Result<Opened, Refused> {
        let (gallery, leave) = (Arc::clone(&self.shared.gallery), self.shared.gallery.enter()?);
        let job = tokio::task::spawn_blocking(move || {
            let _leave = leave;
            gallery.open(key)
        });
        job.await.map_err(broke)?
    }

    async fn read_ahead(&self, mut opened: Opened, offset: u32) -> Result<Opened, Refused> {
        let leave = self.shared.gallery.enter()?;
        let job = tokio::task::spawn_blocking(move || {
            let _leave = leave;
            opened.read_ahead(offset).map(|()| opened)
        });
        job.await.map_err(broke)?.map_err(|error: io::Error| (NoImage::Disk, error.to_string()))
    }

    /// What a chunk, or a refusal in its place, takes of the time.
    fn cost(&self, request: &ImageRequest) -> Duration {
        let (asked, most) = (f64::from(request.rate_bytes_s.get()), self.shared.settings.images.rate_bytes_s);
        // A rate of 0 is refused like anything else.
        Duration::from_secs_f64(CHUNK_BYTES as f64 / if asked > 0.0 { asked.min(most) } else { most })
    }

    /// An answer to a request of then goes now: the next one has its time.
    fn pace(&mut self, request: &ImageRequest, since: Instant) {
        // From when it would have gone, so that timers which wake late do not add up; but never to catch up on more than one.
        let cost = self.cost(request);
        let now = Instant::now();
        let due = self.not_before.max(since);
        self.not_before = due.max(now.checked_sub(cost).unwrap_or(now)) + cost;
    }
}

fn broke(error: JoinError) -> Refused {
    (NoImage::Form, panic_message(error))
}

fn refusal(request: &ImageRequest, (why, words): Refused) -> Message {
    tracing::info!(request = request.request.get(), ?why, words, "no image");
    Message::ImageRefusal(Box::new(ImageRefusal { request: request.request, no_image: why.into(), words: Text::new(&words) }))
}
