//! The archive: the [keeper](super::keeper) of frames, each as the camera gave it, with what its solving ended in.
//!
//! Most frames are solved before they are written, and are written once. One whose outcome is long in coming is written without it, and
//! again when it has come: a solver that hangs or breaks costs no frame. Two disks are two archives.

use super::aside::aside;
use super::hub::ToHub;
use super::keeper::Backlog;
use super::state::{Disk, Finished, ImageNews};
use super::store::{Saved, Store};
use crate::image::{Frame, ImageCounter};
use std::collections::VecDeque;
use std::io;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// A frame waits so long for its outcome before it is written without it.
const WAITS_FOR_OUTCOME: Duration = Duration::from_millis(500);

/// What the archive is given.
#[derive(Debug, Clone)]
pub enum ToArchive {
    /// A frame, as the camera gave it.
    Frame(Arc<Frame>),
    /// What the solving of one ended in.
    Outcome(Arc<Finished>),
}

/// Where frames are handed to an archive.
pub type Handle = mpsc::Sender<ToArchive>;

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

/// The images that are not on disk yet, and the store that they go to.
#[derive(Clone)]
pub struct Images {
    disk: Disk,
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

impl Images {
    /// Of a store, which is on one of the two disks.
    pub fn new(disk: Disk, store: Store) -> Self {
        Self { disk, store: Arc::new(Mutex::new(store)), frames: Arc::default() }
    }

    fn frames(&self) -> MutexGuard<'_, Frames> {
        // Nothing can break between two steps of a change to it.
        self.frames.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Backlog for Images {
    type Item = ToArchive;
    const WHAT: &'static str = "image";

    fn accept(&self, message: ToArchive) {
        self.frames().accept(message);
    }

    fn next_due(&self, now: Instant) -> Option<Instant> {
        self.frames().next_due(now)
    }

    fn hurry(&self, now: Instant) {
        self.frames().waiting.iter_mut().for_each(|frame| frame.due = now);
    }

    fn write_one(&self, now: Instant) -> io::Result<Option<ToHub>> {
        // A store that broke off looks through its directory again.
        let store = &mut *self.store.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(frame) = self.frames().begin(now) else { return Ok(None) };
        let outcome = frame.outcome.as_deref().map(|finished| &finished.outcome);
        // It is many bytes, and the next frame is on its way.
        let saved = aside(|| store.save(&frame.frame, outcome, frame.kept.as_deref()));
        let is_first = frame.kept.is_none();
        let mut frames = self.frames();
        let came = frames.under_way.take().and_then(|under_way| under_way.outcome);
        match saved {
            Ok(Saved { path, thinned }) => {
                let (image, exposure) = (frame.image(), frame.frame.stamp.part.unwrap_or(0));
                if frame.outcome.is_none() {
                    frames.waiting.push_front(Waiting { outcome: came, kept: Some(path), ..frame });
                }
                Ok(is_first.then_some(ToHub::Image(self.disk, ImageNews::Kept { image, exposure, thinned })))
            }
            Err(error) => {
                let problem = format!("image {} for {:?}: {error}", frame.image().0, self.disk);
                frames.waiting.push_front(Waiting { outcome: came, ..frame });
                Err(io::Error::new(error.kind(), problem))
            }
        }
    }

    fn lose_one(&self, most: usize) -> Option<Option<ToHub>> {
        let was_not_on_disk = self.frames().lose_one(most)?;
        Some(was_not_on_disk.then_some(ToHub::Image(self.disk, ImageNews::Lost)))
    }

    fn disk_error(&self) -> ToHub {
        ToHub::Image(self.disk, ImageNews::DiskError)
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
