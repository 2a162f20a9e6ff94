//! Where in the work on a frame a stop struck: the one thing of a solve that its inputs do not decide.
//!
//! A frame that grew too old, or was given up by command, was stopped at a moment of the machine's clock. The solver asks whether to stop
//! at the same places each time, so that the number of the question which was answered with a stop is that moment, for good: a
//! [`Witness`] counts the questions, and a [`Rerun`] answers them so again.

use super::{Part, Stop, Watch};
use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Where stops struck: for each part of the work how many questions were answered with going on before the first that was not, and that
/// answer. `None`: it was never stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Window([Option<(u64, Stop)>; PARTS]);

/// Parts of the work.
const PARTS: usize = 3;

impl Window {
    /// Whether the making of the index was stopped: who has the index already cannot be stopped there again.
    pub fn is_before_search(&self) -> bool {
        self.0.first().is_some_and(Option::is_some)
    }

    /// Whether any part was stopped.
    pub fn is_stopped(&self) -> bool {
        self.0.iter().any(Option::is_some)
    }
}

/// Questions of one part: how many went by, and the stop that all from there on are answered with (0: none yet).
#[derive(Debug, Default)]
struct Count {
    asked: AtomicU64,
    stopped: AtomicU64,
}

/// A stop as a number that is not 0.
const TIMED_OUT: u64 = 1;
const ABORTED: u64 = 2;

impl Count {
    fn stop(&self) -> Option<Stop> {
        match self.stopped.load(Ordering::Relaxed) {
            TIMED_OUT => Some(Stop::TimedOut),
            ABORTED => Some(Stop::Aborted),
            _ => None,
        }
    }
}

/// Passes another watch on, and notes where it says to stop; a part that it stopped once stays stopped in the same way.
pub struct Witness<'a> {
    watch: &'a dyn Watch,
    counts: [Count; PARTS],
}

impl<'a> Witness<'a> {
    /// Of a watch.
    pub fn new(watch: &'a dyn Watch) -> Self {
        Self { watch, counts: Default::default() }
    }

    /// Where it said to stop.
    pub fn window(&self) -> Window {
        Window(self.counts.each_ref().map(|count| count.stop().map(|stop| (count.asked.load(Ordering::Relaxed), stop))))
    }
}

impl Watch for Witness<'_> {
    fn elapsed(&self) -> Duration {
        self.watch.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        self.stop_at(Part::Search)
    }

    fn stop_at(&self, part: Part) -> Option<Stop> {
        // Each part is one thread's, so that its count needs no order among others.
        let Some(count) = self.counts.get(part as usize) else { return self.watch.stop() };
        if let Some(stop) = count.stop() {
            return Some(stop);
        }
        let stop = self.watch.stop_at(part);
        match stop {
            None => _ = count.asked.fetch_add(1, Ordering::Relaxed),
            Some(Stop::TimedOut) => count.stopped.store(TIMED_OUT, Ordering::Relaxed),
            Some(Stop::Aborted) => count.stopped.store(ABORTED, Ordering::Relaxed),
        }
        stop
    }
}

/// Says to stop where a witness noted it, whatever the time is.
pub struct Rerun<'a> {
    window: Window,
    asked: [AtomicU64; PARTS],
    /// Ends the work early, which is no outcome then.
    cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl<'a> Rerun<'a> {
    /// Stops as in this window, or where `cancelled` says that nobody wants the outcome any more.
    pub fn new(window: Window, cancelled: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { window, asked: Default::default(), cancelled }
    }
}

impl Watch for Rerun<'_> {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }

    fn stop(&self) -> Option<Stop> {
        self.stop_at(Part::Search)
    }

    fn stop_at(&self, part: Part) -> Option<Stop> {
        if (self.cancelled)() {
            return Some(Stop::Aborted);
        }
        let (place, asked) = (self.window.0.get(part as usize)?, self.asked.get(part as usize)?);
        let number = asked.fetch_add(1, Ordering::Relaxed);
        place.filter(|(after, _)| number >= *after).map(|(_, stop)| stop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Says to stop from the question of this number on, all parts counted, first in one way and then in the other.
    struct Stops(u64, AtomicU64);

    impl Watch for Stops {
        fn elapsed(&self) -> Duration {
            Duration::ZERO
        }
        fn stop(&self) -> Option<Stop> {
            let asked = self.1.fetch_add(1, Ordering::Relaxed);
            (asked >= self.0).then_some(if asked == self.0 { Stop::TimedOut } else { Stop::Aborted })
        }
    }

    #[test]
    fn a_stop_strikes_again_where_it_struck_whatever_part_asked() {
        use Part::{Index, Search, Survey};
        let questions = [Index, Search, Survey, Search, Search, Survey, Index, Search, Survey];
        for at in 0..questions.len() as u64 + 2 {
            let stops = Stops(at, AtomicU64::new(0));
            let witness = Witness::new(&stops);
            let answers = questions.map(|part| witness.stop_at(part));
            let window = witness.window();
            assert_eq!(window.is_stopped(), at < questions.len() as u64, "{at}");
            let again = Rerun::new(window, &|| false);
            assert_eq!(questions.map(|part| again.stop_at(part)), answers, "{at}");
        }
    }

    #[test]
    fn a_rerun_that_nobody_wants_any_more_ends() {
        let rerun = Rerun::new(Window::default(), &|| true);
        assert_eq!(rerun.stop(), Some(Stop::Aborted));
    }
}
