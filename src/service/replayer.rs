//! The replayer: runs the last frames of the running service again, with its settings or with others, while no live frame is solved.
//!
//! It works on the blocking pool, and a frame that it is at is given up as soon as a live one comes, to be begun again when that has ended:
//! the solver asks every few milliseconds whether to go on, which is what a live frame may have less of a processor for.

use super::hub::sleep_until;
use super::journal::{self, RECENT, Recent};
use super::replay::{Again, Replay, Wishes};
use super::solver::MakeSolver;
use super::state::{Shed, State};
use super::supervisor::panic_message;
use crate::journal::{Entry, Text, What};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{Mutex, watch};
use tokio::time::Instant;

/// After this time it is given up: live frames that come all the time leave it none.
const ENDS_WITHIN: Duration = Duration::from_secs(300);

/// Why frames are not run again.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// One is under way already.
    #[error("a replay is under way")]
    Busy,
    /// There is none that was written down.
    #[error("no frame is in the journal yet (record.journal)")]
    Nothing,
    /// Settings that are none, or a solver that cannot be had.
    #[error("{0}")]
    Refused(String),
    /// Live frames left no time for it.
    #[error("live frames left no time for it within {} s", ENDS_WITHIN.as_secs())]
    NoTime,
    /// The solver broke over it.
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

    /// How many frames are written down that may be run again, at most 20.
    pub fn recent(&self) -> usize {
        self.journal.recent().len()
    }

    /// The last frames, at most 20 and at most so many, run again in their order with `set` (`key=value`) beside the settings that
    /// each was solved with; each with how it ended and how it ends now.
    ///
    /// # Errors
    /// See [`ReplayError`].
    pub async fn run(&self, last: usize, set: Vec<String>) -> Result<Vec<Again>, ReplayError> {
        let _turn = self.turn.try_lock().map_err(|_| ReplayError::Busy)?;
        let recent = self.journal.recent();
        let recent = recent.get(recent.len().saturating_sub(last.min(RECENT))..).unwrap_or_default().to_vec();
        if recent.is_empty() {
            return Err(ReplayError::Nothing);
        }
        let wishes = Wishes { set, ..Wishes::default() };
        let mut replay = Some(Replay::with_solver(wishes, Arc::clone(&self.make)));
        let mut frames = Vec::new();
        let until = Instant::now() + ENDS_WITHIN;
        for frame in recent {
            let again = loop {
                tokio::select! {
                    () = self.idle() => {}
                    () = sleep_until(Some(until)) => return Err(ReplayError::NoTime),
                }
                let (back, again) = self.one(replay.take(), frame.clone()).await?;
                replay = Some(back);
                if let Some(again) = again {
                    break again;
                }
            };
            frames.extend(again);
        }
        Ok(frames)
    }

    /// One frame; `None` where a live one came.
    async fn one(&self, replay: Option<Replay>, frame: Recent) -> Result<(Replay, Option<Option<Again>>), ReplayError> {
        let Some(mut replay) = replay else { return Err(ReplayError::Busy) };
        let (state, given_up) = (self.state.clone(), GiveUp(Arc::default()));
        let gone = Arc::clone(&given_up.0);
        let job = tokio::task::spawn_blocking(move || {
            let came = AtomicBool::new(false);
            let cancelled = || {
                let came_now = gone.load(Ordering::Relaxed) || !is_idle(&state.borrow());
                came.fetch_or(came_now, Ordering::Relaxed) || came_now
            };
            let Recent { at, solved, settings } = frame;
            let text = Text { fingerprint: solved.settings, toml: settings.to_toml() };
            replay.take(Entry { at, what: What::Settings(text) }, &cancelled)?;
            let before = replay.checkpoint();
            let again = replay.take(Entry { at, what: What::Solved(solved) }, &cancelled)?;
            if came.load(Ordering::Relaxed) {
                replay.go_back(before);
                return Ok((replay, None));
            }
            Ok((replay, Some(again)))
        });
        let result: Result<_, String> = job.await.map_err(|error| ReplayError::Broken(panic_message(error)))?;
        result.map_err(ReplayError::Refused)
    }

    /// Until no live frame is solved, and the computer has time.
    async fn idle(&self) {
        // Where the service has ended there is nothing to wait for.
        let _ = self.state.clone().wait_for(|state| is_idle(state)).await;
    }
}

fn is_idle(state: &State) -> bool {
    state.solving.is_none() && state.strain.shed() < Shed::Solving
}
