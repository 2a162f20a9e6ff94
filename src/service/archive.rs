//! The archive: keeps every frame on disk, as the camera gave it, with what its solving ended in.
//!
//! Most frames are solved before they are written, and are written once. One whose outcome is long in coming is written without it, and
//! again when it has come: a solver that hangs or breaks costs no frame. The disk may be slow, full or dead: frames wait in a
//! bounded queue, from which the oldest is lost and counted, and nobody else is held up. Two disks are two archives.

use super::hub::{self, ToHub, sleep_until};
use super::inbox::Inbox;
use super::pulse::Pulse;
use super::state::{Disk, Finished, ImageNews};
use super::store::{Saved, Store};
use super::supervisor::{Backoff, Ended, panic_message};
use crate::image::{Frame, ImageCounter};
use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// A frame waits so long for its outcome before it is written without it.
const WAITS_FOR_OUTCOME: Duration = Duration::from_millis(500);

/// What the archive is given.
#[derive(Debug)]
pub enum ToArchive {
    /// A frame, as the camera gave it.
    Frame(Arc<Frame>),
    /// What the solving of one ended in.
    Outcome(Arc<Finished>),
}

/// Where frames are handed to an archive.
pub type Handle = mpsc::Sender<ToArchive>;

/// The actor of an archive.
#[derive(Clone)]
pub struct Archive {
    /// What it is given.
    pub inbox: Inbox<ToArchive>,
    /// Whom to tell what was kept and what was lost.
    pub hub: hub::Handle,
    /// Which of the two disks.
    pub disk: Disk,
    /// What is not on disk yet, and the store.
    pub backlog: Backlog,
    /// Frames that may wait for the disk.
    pub queue: usize,
    /// Pauses after an error of the disk.
    pub backoff: Backoff,
    /// When to end.
    pub stop: CancellationToken,
}

/// A frame on its way to the disk.
#[derive(Clone)]
struct Waiting {
    frame: Arc<Frame>,
    outcome: Option<Arc<Finished>>,
    /// It is written then at the latest.
    due: Instant,
    /// Its file, where it was written without its outcome.
    kept: Option<PathBuf>,
}

impl Waiting {
    fn image(&self) -> ImageCounter {
        self.frame.stamp.image
    }

    fn is_due(&self, now: Instant) -> bool {
        self.outcome.is_some() || (self.kept.is_none() && self.due <= now)
    }
}

/// What is not on disk yet, and the store that it goes to. It outlives the actor, so that nothing is lost with it.
#[derive(Clone)]
pub struct Backlog {
    /// Whoever writes has it.
    store: Arc<Mutex<Store>>,
    frames: Arc<Mutex<Frames>>,
}

#[derive(Default)]
struct Frames {
    waiting: VecDeque<Waiting>,
    /// What is being written; its outcome may come meanwhile.
    under_way: Option<Waiting>,
}

impl Backlog {
    /// Of a store.
    pub fn new(store: Store) -> Self {
        Self { store: Arc::new(Mutex::new(store)), frames: Arc::default() }
    }

    fn frames(&self) -> MutexGuard<'_, Frames> {
        // Nothing can break between two steps of a change to it.
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes the oldest frame that is due; what is to be told of it, if anything. Blocking.
    fn write_one(&self, now: Instant) -> io::Result<Option<ImageNews>> {
        // A store that broke off looks through its directory again.
        let mut store = self.store.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(frame) = self.frames().begin(now) else { return Ok(None) };
        let outcome = frame.outcome.as_deref().map(|finished| &finished.outcome);
        let saved = store.save(&frame.frame, outcome, frame.kept.as_deref());
        let is_first = frame.kept.is_none();
        let mut frames = self.frames();
        let came = frames.under_way.take().and_then(|under_way| under_way.outcome);
        match saved {
            Ok(Saved { path, thinned }) => {
                if frame.outcome.is_none() {
                    frames.waiting.push_front(Waiting { outcome: came, kept: Some(path), ..frame });
                }
                Ok(is_first.then_some(ImageNews::Kept { thinned }))
            }
            Err(error) => {
                let problem = format!("image {}: {error}", frame.image().0);
                frames.waiting.push_front(Waiting { outcome: came, ..frame });
                Err(io::Error::new(error.kind(), problem))
            }
        }
    }
}

impl Frames {
    fn accept(&mut self, message: ToArchive) {
        match message {
            ToArchive::Frame(frame) => {
                let due = Instant::now() + WAITS_FOR_OUTCOME;
                self.waiting.push_back(Waiting { frame, outcome: None, due, kept: None });
            }
            ToArchive::Outcome(finished) => {
                let image = finished.outcome.stamp.image;
                let all = self.waiting.iter_mut().chain(&mut self.under_way);
                all.filter(|frame| frame.image() == image).for_each(|frame| frame.outcome = Some(Arc::clone(&finished)));
            }
        }
    }

    /// Takes the oldest frame that is due; one whose writing broke off is.
    fn begin(&mut self, now: Instant) -> Option<Waiting> {
        let next = self.under_way.take().or_else(|| {
            let place = self.waiting.iter().position(|frame| frame.is_due(now))?;
            self.waiting.remove(place)
        });
        self.under_way.clone_from(&next);
        next
    }

    /// When the next frame is due, if nothing comes before; `None` where none will be by itself.
    fn next_due(&self, now: Instant) -> Option<Instant> {
        let due = |frame: &Waiting| if frame.is_due(now) { Some(now) } else { frame.kept.is_none().then_some(frame.due) };
        self.waiting.iter().filter_map(due).chain(self.under_way.is_some().then_some(now)).min()
    }

    /// Loses one where more than so many wait: one that is on disk already and waits for its outcome alone, or else the oldest. Whether one
    /// is not on disk now; `None` where there are not too many.
    fn lose_one(&mut self, queue: usize) -> Option<bool> {
        let place = self.waiting.iter().position(|frame| frame.kept.is_some()).unwrap_or(0);
        let frame = if self.waiting.len() > queue { self.waiting.remove(place) } else { None };
        frame.map(|frame| frame.kept.is_none())
    }
}

/// What the actor holds while it runs.
struct Desk {
    writing: Option<JoinHandle<io::Result<Option<ImageNews>>>>,
    not_before: Instant,
}

impl Archive {
    /// Runs until stopped; then what waits is written, as far as the disk takes it.
    pub async fn run(mut self, pulse: Pulse) -> Result<(), Ended> {
        let inbox = self.inbox.clone();
        let mut inbox = inbox.open().await;
        let mut desk = Desk { writing: None, not_before: Instant::now() };
        let mut ending = false;
        loop {
            let due = self.write_next(&mut desk);
            if ending && desk.writing.is_none() {
                return Ok(());
            }
            tokio::select! {
                biased;
                done = async { desk.writing.as_mut()?.await.into() }, if desk.writing.is_some() => {
                    desk.writing = None;
                    let Some(done) = done else { continue };
                    self.after_write(&mut desk, done.map_err(|error| Ended(panic_message(error)))?).await;
                }
                () = self.stop.cancelled(), if !ending => {
                    ending = true;
                    while let Ok(message) = inbox.try_recv() {
                        self.accept(message).await;
                    }
                    // A disk that had an error a moment ago is tried once more.
                    desk.not_before = Instant::now();
                    self.backlog.frames().waiting.iter_mut().for_each(|frame| frame.due = desk.not_before);
                }
                Some(message) = inbox.recv(), if !ending => self.accept(message).await,
                () = sleep_until(due), if desk.writing.is_none() => {}
                () = pulse.rest() => {}
            }
        }
    }

    /// Starts to write the oldest frame that is due, unless the disk is busy or had an error a moment ago; or says when one will be.
    fn write_next(&self, desk: &mut Desk) -> Option<Instant> {
        if desk.writing.is_some() {
            return None;
        }
        let now = Instant::now();
        let due = self.backlog.frames().next_due(now)?.max(desk.not_before);
        if due <= now {
            let backlog = self.backlog.clone();
            desk.writing = Some(tokio::task::spawn_blocking(move || backlog.write_one(now)));
        }
        Some(due)
    }

    async fn accept(&self, message: ToArchive) {
        self.backlog.frames().accept(message);
        self.lose_what_is_too_much().await;
    }

    async fn after_write(&mut self, desk: &mut Desk, result: io::Result<Option<ImageNews>>) {
        match result {
            Ok(news) => {
                self.backoff.reset();
                if let Some(news) = news {
                    self.tell(news).await;
                }
            }
            Err(error) => {
                let pause = self.backoff.pause();
                tracing::warn!(disk = ?self.disk, %error, again_in_s = pause.as_secs_f64(), "image not kept yet");
                desk.not_before = Instant::now() + pause;
                self.tell(ImageNews::DiskError).await;
            }
        }
        self.lose_what_is_too_much().await;
    }

    async fn lose_what_is_too_much(&self) {
        loop {
            let lost = self.backlog.frames().lose_one(self.queue);
            match lost {
                None => return,
                Some(true) => self.tell(ImageNews::Lost).await,
                Some(false) => {}
            }
        }
    }

    async fn tell(&self, news: ImageNews) {
        self.hub.tell(ToHub::Image(self.disk, news)).await;
    }
}
