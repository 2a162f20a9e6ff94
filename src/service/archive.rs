//! The archive: keeps every frame on disk, as the camera gave it, with what its solving ended in.
//!
//! Most frames are solved before they are written, and are written once. One whose outcome is long in coming is written without it, and
//! again when it has come: a solver that hangs or breaks costs no frame. The disk may be slow, full or dead: frames wait in a
//! bounded queue, from which the oldest is lost and counted, and nobody else is held up. Two disks are two archives.

use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::pulse::Pulse;
use super::state::{Disk, Finished, ImageNews};
use super::store::{Saved, Store, StoreRules};
use super::supervisor::{Backoff, Ended, panic_message};
use crate::image::{Frame, ImageCounter};
use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
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
    /// Where images are kept, and how much room they may take.
    pub rules: StoreRules,
    /// Frames that may wait for the disk.
    pub queue: usize,
    /// Pauses after an error of the disk.
    pub backoff: Backoff,
    /// When to end.
    pub stop: CancellationToken,
}

/// A frame on its way to the disk.
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
}

/// A write under way; the store and the frame come back from it with the result.
struct Writing {
    image: ImageCounter,
    /// Its outcome, where that came meanwhile.
    outcome: Option<Arc<Finished>>,
    job: JoinHandle<(Store, Waiting, io::Result<Saved>)>,
}

/// What the actor holds while it runs.
struct Desk {
    waiting: VecDeque<Waiting>,
    /// The store, unless a write has it.
    store: Option<Store>,
    writing: Option<Writing>,
    not_before: Instant,
}

impl Archive {
    /// Runs until stopped; then what waits is written, as far as the disk takes it.
    pub async fn run(mut self, pulse: Pulse) -> Result<(), Ended> {
        let inbox = self.inbox.clone();
        let mut inbox = inbox.open().await;
        let store = Some(Store::new(self.rules.clone()));
        let mut desk = Desk { waiting: VecDeque::new(), store, writing: None, not_before: Instant::now() };
        let mut ending = false;
        loop {
            desk.write_next();
            if ending && desk.writing.is_none() {
                return Ok(());
            }
            let (due, idle) = (desk.next_due(), desk.writing.is_none());
            tokio::select! {
                biased;
                done = async { (&mut desk.writing.as_mut()?.job).await.into() }, if desk.writing.is_some() => {
                    let outcome = desk.writing.take().and_then(|writing| writing.outcome);
                    let Some(done) = done else { continue };
                    let (store, mut waiting, result) = done.map_err(|error| Ended(panic_message(error)))?;
                    desk.store = Some(store);
                    let was_final = waiting.outcome.is_some();
                    waiting.outcome = waiting.outcome.or(outcome);
                    self.after_write(&mut desk, waiting, was_final, result).await;
                }
                () = self.stop.cancelled(), if !ending => {
                    ending = true;
                    while let Ok(message) = inbox.try_recv() {
                        self.accept(&mut desk, message).await;
                    }
                    desk.waiting.iter_mut().for_each(|waiting| waiting.due = Instant::now());
                }
                Some(message) = inbox.recv(), if !ending => self.accept(&mut desk, message).await,
                () = tokio::time::sleep_until(due), if idle && !desk.waiting.is_empty() => {}
                () = pulse.rest() => {}
            }
        }
    }

    async fn accept(&self, desk: &mut Desk, message: ToArchive) {
        match message {
            ToArchive::Frame(frame) => {
                let due = Instant::now() + WAITS_FOR_OUTCOME;
                desk.waiting.push_back(Waiting { frame, outcome: None, due, kept: None });
                self.lose_what_is_too_much(desk).await;
            }
            ToArchive::Outcome(finished) => desk.take_outcome(finished),
        }
    }

    async fn after_write(&mut self, desk: &mut Desk, mut waiting: Waiting, was_final: bool, result: io::Result<Saved>) {
        match result {
            Ok(Saved { path, thinned }) => {
                self.backoff.reset();
                if waiting.kept.is_none() {
                    self.tell(ImageNews::Kept { thinned }).await;
                }
                if !was_final {
                    waiting.kept = Some(path);
                    desk.waiting.push_front(waiting);
                }
            }
            Err(error) => {
                let pause = self.backoff.pause();
                let (directory, again_in_s) = (self.rules.directory.display(), pause.as_secs_f64());
                tracing::warn!(%directory, %error, again_in_s, image = waiting.image().0, "image not kept yet");
                desk.not_before = Instant::now() + pause;
                desk.waiting.push_front(waiting);
                self.tell(ImageNews::DiskError).await;
            }
        }
        self.lose_what_is_too_much(desk).await;
    }

    /// Of too many, those go first that are on disk already and wait for their outcomes alone, and then the oldest.
    async fn lose_what_is_too_much(&self, desk: &mut Desk) {
        while desk.waiting.len() > self.queue {
            let place = desk.waiting.iter().position(|waiting| waiting.kept.is_some()).unwrap_or(0);
            if desk.waiting.remove(place).is_some_and(|waiting| waiting.kept.is_none()) {
                self.tell(ImageNews::Lost).await;
            }
        }
    }

    async fn tell(&self, news: ImageNews) {
        self.hub.tell(ToHub::Image(self.disk, news)).await;
    }
}

impl Desk {
    fn take_outcome(&mut self, finished: Arc<Finished>) {
        let image = finished.outcome.stamp.image;
        if let Some(waiting) = self.waiting.iter_mut().find(|waiting| waiting.image() == image) {
            waiting.outcome = Some(finished);
        } else if let Some(writing) = self.writing.as_mut().filter(|writing| writing.image == image) {
            writing.outcome = Some(finished);
        }
    }

    /// When the next frame is to be written, if nothing comes before.
    fn next_due(&self) -> Instant {
        let due = |waiting: &Waiting| match (&waiting.outcome, &waiting.kept) {
            (Some(_), _) => Some(Instant::now()),
            (None, None) => Some(waiting.due),
            (None, Some(_)) => None,
        };
        // Where all wait for outcomes alone, these come through the inbox.
        let soonest = self.waiting.iter().filter_map(due).min().unwrap_or_else(|| Instant::now() + WAITS_FOR_OUTCOME);
        soonest.max(self.not_before)
    }

    /// Starts to write the oldest frame that is to be written now, unless the disk is busy or had an error a moment ago.
    fn write_next(&mut self) {
        let now = Instant::now();
        if self.writing.is_some() || now < self.not_before {
            return;
        }
        let is_due = |waiting: &Waiting| waiting.outcome.is_some() || (waiting.kept.is_none() && waiting.due <= now);
        if let Some(place) = self.waiting.iter().position(is_due)
            && let Some(mut store) = self.store.take()
            && let Some(waiting) = self.waiting.remove(place)
        {
            let image = waiting.image();
            let job = tokio::task::spawn_blocking(move || {
                let outcome = waiting.outcome.as_deref().map(|finished| &finished.outcome);
                let result = store.save(&waiting.frame, outcome, waiting.kept.as_deref());
                (store, waiting, result)
            });
            self.writing = Some(Writing { image, outcome: None, job });
        }
    }
}
