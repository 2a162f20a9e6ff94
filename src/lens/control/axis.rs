//! One thing that moves, focus or aperture: what is known of where it is, and where it should go back to.

use crate::command::Tick;
use crate::lens::state::{Doubt, Known};
use std::time::Duration;

/// Attempts to go back to where it was after its range was learned anew.
const WAYS_BACK: u32 = 3;

/// Focus or aperture.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis<T> {
    /// What is shown of it when no request is open.
    pub known: Known<T>,
    /// Between which positions the next reading must be: where it was known to be, and where it was told to go since.
    expected: Option<(T, T)>,
    /// Where it was last known to be.
    home: Option<T>,
    /// Why its counts mean nothing until they are learned anew.
    unlearned: Option<Doubt>,
    /// Where it is to go back to.
    back: Option<Back<T>>,
    /// Learn it: the controller was found for the first time, and the settings want that.
    pub learn_first: bool,
    /// Nothing moves it by itself.
    pub stopped: bool,
    /// When it is to be read again.
    pub due: Tick,
    /// When it last was learned by itself.
    relearned: Option<Tick>,
}

/// A way back.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Back<T> {
    to: T,
    attempts: u32,
    at: Tick,
}

/// What an axis wants to have done by itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Wish<T> {
    Read,
    Learn,
    GoTo(T),
}

/// A reading that does not fit what was known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Misfit<T> {
    /// It was there, and was told to go nowhere that leads here.
    Lost { was: T },
    /// Its counts mean nothing for now.
    InDoubt,
}

impl<T: Copy> Axis<T> {
    pub fn new() -> Self {
        Self {
            known: Known::Unknown(Doubt::NeverRead),
            expected: None,
            home: None,
            unlearned: None,
            back: None,
            learn_first: false,
            stopped: false,
            due: Tick::ZERO,
            relearned: None,
        }
    }

    /// One that an earlier run of the program knew to be at `at`.
    pub fn resume(&mut self, at: T) {
        self.expected = Some((at, at));
        self.home = Some(at);
    }

    /// A word that moves it goes out; on which way, if that is known.
    pub fn begin_move(&mut self, way: Option<(T, T)>) {
        self.known = Known::Moving;
        self.expected = way;
    }

    /// Where it should be, if it should be at one place.
    pub fn place(&self) -> Option<T>
    where
        T: PartialEq,
    {
        self.expected.filter(|(from, to)| from == to).map(|(at, _)| at)
    }

    /// Something went wrong that leaves it unknown. A doubt that only learning mends stays.
    pub fn doubt(&mut self, doubt: Doubt) {
        self.known = Known::Unknown(self.unlearned.unwrap_or(doubt));
    }

    /// Its counts mean nothing any more.
    pub fn unlearn(&mut self, doubt: Doubt) {
        self.unlearned = Some(doubt);
        self.expected = None;
        self.known = Known::Unknown(doubt);
    }

    /// The controller does not know its range: forgotten if it was known before.
    pub fn not_learned(&mut self) {
        self.unlearn(if self.home.is_some() { Doubt::PowerCycled } else { Doubt::NotLearned });
    }

    /// Takes a reading. `learned`: its counts mean something again.
    pub fn accept(&mut self, read: T, learned: bool, is_between: impl Fn(T, (T, T)) -> bool) -> Result<(), Misfit<T>> {
        if let Some((was, _)) = self.expected.filter(|way| !is_between(read, *way)) {
            self.unlearn(Doubt::CountsLost);
            return Err(Misfit::Lost { was });
        }
        if let Some(doubt) = self.unlearned.filter(|_| !learned) {
            self.known = Known::Unknown(doubt);
            return Err(Misfit::InDoubt);
        }
        self.unlearned = None;
        self.known = Known::Known(read);
        self.expected = Some((read, read));
        self.home = Some(read);
        Ok(())
    }

    /// A command will move it: it goes nowhere by itself any more.
    pub fn taken_over(&mut self) {
        self.back = None;
        self.learn_first = false;
        self.stopped = false;
    }

    /// Nothing moves it by itself until a command does.
    pub fn stop(&mut self) {
        self.taken_over();
        self.stopped = true;
    }

    /// It begins to be learned by itself; `back`: and goes back then to where it was last known to be.
    pub fn learning(&mut self, now: Tick, back: bool) {
        self.learn_first = false;
        if self.unlearned.is_some() {
            self.relearned = Some(now);
            let home = self.home.filter(|_| back).map(|to| Back { to, attempts: 0, at: now });
            self.back = self.back.or(home);
        }
    }

    /// It went back by itself, or did not.
    pub fn went_back(&mut self, done: bool, again: Tick) {
        self.back = self.back.filter(|back| !done && back.attempts + 1 < WAYS_BACK).map(|back| Back {
            attempts: back.attempts + 1,
            at: again,
            ..back
        });
    }

    /// Where it goes back to by itself, once it is learned where it has to be.
    pub fn goes_back_to(&self) -> Option<T> {
        let home = self.home.filter(|_| self.unlearned.is_some() && !self.stopped);
        self.back.map(|back| back.to).or(home)
    }

    /// What it wants next, and when. `pause`: between learning it by itself; `None` where it may not be.
    pub fn wish(&self, pause: Option<Duration>) -> Option<(Tick, Wish<T>)> {
        if self.learn_first {
            return Some((Tick::ZERO, Wish::Learn));
        }
        let Some(doubt) = self.unlearned else {
            return Some(match self.back.filter(|_| matches!(self.known, Known::Known(_))) {
                Some(back) => (back.at, Wish::GoTo(back.to)),
                None => (self.due, Wish::Read),
            });
        };
        if let Some(pause) = pause.filter(|_| !self.stopped && self.home.is_some()) {
            return Some((self.relearned.map_or(Tick::ZERO, |then| then + pause), Wish::Learn));
        }
        // Counts that jumped are not read again by themselves: they would read the same, and be as wrong.
        matches!(doubt, Doubt::NotLearned | Doubt::PowerCycled).then_some((self.due, Wish::Read))
    }
}
