//! Jobs that were given up while they ran: a thread cannot be taken from code that does not end, so there must not be many.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// So many jobs of one actor may be left behind; the pool has room for them beside all else that needs a thread.
const MOST: usize = 3;

/// Counts the jobs of one actor that run; it outlives the actor.
#[derive(Debug, Clone, Default)]
pub struct LeftBehind(Arc<AtomicUsize>);

/// A job that runs, for as long as it lives.
#[derive(Debug)]
pub struct Running(Arc<AtomicUsize>);

impl LeftBehind {
    /// Notes a job that starts; `None` where so many earlier ones have not ended that it must not.
    pub fn start(&self) -> Option<Running> {
        let one_more = |running| (running < MOST).then_some(running + 1);
        self.0.fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_more).ok()?;
        Some(Running(Arc::clone(&self.0)))
    }

    /// Whether no other job may start.
    pub fn too_many(&self) -> bool {
        self.0.load(Ordering::Relaxed) >= MOST
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_jobs_are_left_behind_and_one_that_ends_makes_room() {
        let left = LeftBehind::default();
        let mut jobs: Vec<Running> = std::iter::from_fn(|| left.start()).collect();
        assert_eq!((jobs.len(), left.too_many()), (MOST, true));
        jobs.pop();
        assert!(!left.too_many() && left.clone().start().is_some());
    }
}
