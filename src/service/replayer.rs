//! The replayer: runs the last frames of the running service again, with its settings or with others, while no live frame is solved.
//!
//! It works on the blocking pool, and a frame that it is at is given up as soon as a live one comes, to be begun again when that has ended:
//! the solver asks every few milliseconds whether to go on, which is what a live frame may have less of a processor for. There is one at a
//! time, and a computer that has not enough time for all of its work leaves it undone first, with the display.

use super::hub::sleep_until;
use super::journal::{self, Recent};
use super::replay::{Again, Replay, Wishes};
use super::solver::MakeSolver;
use super::state::{Shed, State};
use super::supervisor::panic_message;
use crate::image::ImageCounter;
use crate::journal::{Entry, Text, What};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{Mutex, OwnedMutexGuard, watch};
use tokio::time::{Instant, timeout_at};

/// Frames that are run again together, at most.
pub const MOST: usize = 20;
/// After this time it is given up: live frames that come all the time leave it none.
const ENDS_WITHIN: Duration = Duration::from_secs(300);
/// A solver that was told to stop and has not within this time is taken to hang.
const GRACE: Duration = Duration::from_secs(1);

/// Why frames are not run again.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// One is under way already.
    #[error("a replay is under way")]
    Busy,
    /// There is none that was written down.
    #[error("no frame is in the journal yet (record.enabled, record.journal)")]
    Nothing,
    /// It is none of those that are remembered.
    #[error("image {} is not written down yet, or not any more: images {} to {} are", image.0, first.0, last.0)]
    Gone {
        /// The one that was wanted.
        image: ImageCounter,
        /// The oldest that is there.
        first: ImageCounter,
        /// The newest.
        last: ImageCounter,
    },
    /// Settings that are none.
    #[error("{0}")]
    Refused(String),
    /// The computer has other things to do.
    #[error("the computer is too slow for all of its work: this waits")]
    Strained,
    /// Live frames left no time for it.
    #[error("live frames left no time for it within {} s", ENDS_WITHIN.as_secs())]
    NoTime,
    /// The solver broke over it, or cannot be had.
    #[error("the solver {0}")]
    Broken(String),
}

/// Runs the last frames of the running service again.
#[derive(Clone)]
pub struct Replayer {
    journal: journal::Handle,
    make: MakeSolver,
    state: watch::Receiver<Arc<State>>,
    /// Whoever has it is at work.
    turn: Arc<Mutex<()>>,
}

/// What is at work. It goes with the job on the blocking pool, so that a next one does not begin before that has ended, even where nobody
/// waits for it any more.
struct Work {
    replay: Replay,
    until: Instant,
    _turn: OwnedMutexGuard<()>,
}

/// Ends the work of whoever waits for it no longer.
struct GiveUp(Arc<AtomicBool>);

impl Drop for GiveUp {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Replayer {
    /// With solvers like the service's own, of the frames that are written down.
    pub fn new(journal: journal::Handle, make: MakeSolver, state: watch::Receiver<Arc<State>>) -> Self {
        Self { journal, make, state, turn: Arc::default() }
    }

    /// How many frames are remembered that may be run again.
    pub fn recent(&self) -> usize {
        self.journal.recent().len()
    }

    /// The last frames, at most 20 and at most so many, run again in their order with `set` (`key=value`) beside the settings that
    /// each was solved with; each with how it ended and how it ends now.
    ///
    /// # Errors
    /// See [`ReplayError`].
    pub async fn run(&self, last: usize, set: Vec<String>) -> Result<Vec<Again>, ReplayError> {
        let recent = self.journal.recent();
        let frames = recent.get(recent.len().saturating_sub(last.min(MOST))..).unwrap_or_default().to_vec();
        self.run_all(frames, Wishes { set, ..Wishes::default() }).await
    }

    /// The same for one image; it is there twice where it was solved twice, the second time with its motion.
    ///
    /// # Errors
    /// See [`ReplayError`].
    pub async fn run_image(&self, image: ImageCounter, set: Vec<String>) -> Result<Vec<Again>, ReplayError> {
        let recent = self.journal.recent();
        let number = |frame: &Recent| frame.solved.stamp.image;
        if let (Some(first), Some(last)) = (recent.first().map(number), recent.last().map(number))
            && !recent.iter().any(|frame| number(frame) == image)
        {
            return Err(ReplayError::Gone { image, first, last });
        }
        let frames = recent.into_iter().filter(|frame| number(frame) == image).collect();
        self.run_all(frames, Wishes { set, image: Some(image), ..Wishes::default() }).await
    }

    async fn run_all(&self, frames: Vec<Recent>, wishes: Wishes) -> Result<Vec<Again>, ReplayError> {
        let turn = Arc::clone(&self.turn).try_lock_owned().map_err(|_| ReplayError::Busy)?;
        if frames.is_empty() {
            return Err(ReplayError::Nothing);
        }
        if has_no_time(&self.state.borrow()) {
            return Err(ReplayError::Strained);
        }
        let until = Instant::now() + ENDS_WITHIN;
        let mut work = Work { replay: Replay::with_solver(wishes, Arc::clone(&self.make)), until, _turn: turn };
        let mut all = Vec::new();
        for frame in frames {
            let again = loop {
                tokio::select! {
                    biased;
                    () = sleep_until(Some(until)) => return Err(ReplayError::NoTime),
                    () = self.idle() => {}
                }
                let (back, again) = self.one(work, frame.clone()).await?;
                work = back;
                if let Some(again) = again {
                    break again;
                }
            };
            all.extend(again);
        }
        Ok(all)
    }

    /// One frame; `None` where a live one came.
    async fn one(&self, mut work: Work, frame: Recent) -> Result<(Work, Option<Option<Again>>), ReplayError> {
        let (state, given_up) = (self.state.clone(), GiveUp(Arc::default()));
        let (gone, until) = (Arc::clone(&given_up.0), work.until);
        let job = tokio::task::spawn_blocking(move || {
            let came = AtomicBool::new(false);
            let cancelled = || {
                let came_now = gone.load(Ordering::Relaxed) || Instant::now() >= until || !is_idle(&state.borrow());
                came.fetch_or(came_now, Ordering::Relaxed) || came_now
            };
            let Recent { at, solved, settings } = frame;
            let text = Text { fingerprint: solved.settings, toml: settings.to_toml() };
            let Work { replay, .. } = &mut work;
            replay.take(Entry { at, what: What::Settings(text) }, &cancelled).map_err(ReplayError::Refused)?;
            let before = replay.checkpoint();
            let again = replay.take(Entry { at, what: What::Solved(solved) }, &cancelled);
            let again = again.map_err(|why| ReplayError::Broken(format!("cannot be had: {why}")))?;
            if came.load(Ordering::Relaxed) {
                replay.go_back(before);
                return Ok((work, None));
            }
            Ok((work, Some(again)))
        });
        let joined = timeout_at(until + GRACE, job).await;
        let joined = joined.map_err(|_| ReplayError::Broken("did not stop when told".to_owned()))?;
        joined.map_err(|error| ReplayError::Broken(panic_message(error)))?
    }

    /// Until no live frame is solved, and the computer has time.
    async fn idle(&self) {
        // Where the service has ended there is nothing to wait for.
        let _ = self.state.clone().wait_for(|state| is_idle(state)).await;
    }
}

fn is_idle(state: &State) -> bool {
    state.solving.is_none() && !has_no_time(state)
}

/// What the display asks for is the first thing that a computer without enough time leaves undone.
fn has_no_time(state: &State) -> bool {
    state.strain.shed() >= Shed::Display
}
