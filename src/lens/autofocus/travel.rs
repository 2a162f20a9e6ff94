//! Where the lens goes and stands during a run, and which images were taken where it stood.

use super::approach::Carriage;
use super::{Decision, FocusImage};
use crate::command::Tick;
use crate::lens::FocusCounts;
use std::collections::VecDeque;
use std::time::Duration;

/// A move is answered within this: the slowest lens takes 70 s for its whole way.
const MOVE_LIMIT: Duration = Duration::from_secs(120);
/// Stands that are remembered: outcomes of images may come after the lens went on.
const REMEMBERED: usize = 4;

/// A time for which the lens stood at a position that counts.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Stand {
    position: i32,
    since: Tick,
    until: Option<Tick>,
}

/// The lens on its ways.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Travel {
    carriage: Carriage,
    /// Since when a move is under way, and where to.
    moving: Option<(Tick, FocusCounts)>,
    stands: VecDeque<Stand>,
    /// Since when the lens stands.
    standing: Tick,
}

/// What an arrival led to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Arrival {
    /// Nobody had sent it.
    Unexpected,
    /// It goes on.
    GoesOn(FocusCounts),
    /// It stands where it was sent.
    Stands,
}

impl Travel {
    pub fn new(carriage: Carriage, now: Tick) -> Self {
        Self { carriage, moving: None, stands: VecDeque::new(), standing: now }
    }

    pub fn carriage(&self) -> &Carriage {
        &self.carriage
    }

    /// Sends the lens to a position; `None` where it is there already, as it should be.
    pub fn go(&mut self, now: Tick, to: i32) -> Option<Decision> {
        if self.stands.back().is_some_and(|stand| stand.position == to && stand.until.is_none()) {
            return None;
        }
        let order = self.carriage.go(to);
        Some(self.send(now, order))
    }

    fn send(&mut self, now: Tick, order: FocusCounts) -> Decision {
        if let Some(stand) = self.stands.back_mut() {
            stand.until.get_or_insert(now);
        }
        self.moving = Some((now, order));
        Decision::Move(order)
    }

    /// The lens is somewhere.
    pub fn arrived(&mut self, now: Tick, at: FocusCounts) -> Arrival {
        if self.moving.take().is_none() {
            return Arrival::Unexpected;
        }
        if let Some(next) = self.carriage.arrived(at) {
            self.send(now, next);
            return Arrival::GoesOn(next);
        }
        self.standing = now;
        if self.carriage.is_taken_up() {
            if self.stands.len() >= REMEMBERED {
                self.stands.pop_front();
            }
            self.stands.push_back(Stand { position: at.0, since: now, until: None });
        }
        Arrival::Stands
    }

    /// Ends the way after the move that is under way.
    pub fn halt(&mut self) {
        self.carriage.halt();
    }

    /// The position of an image that counts, and whether the lens stands there still.
    pub fn place_of(&self, image: &FocusImage) -> Option<(i32, bool)> {
        let position = image.position?.0;
        let during = |stand: &&Stand| image.captured >= stand.since && stand.until.is_none_or(|until| image.captured <= until);
        let stand = self.stands.iter().find(|stand| stand.position == position && during(stand))?;
        Some((position, stand.until.is_none()))
    }

    /// Where a move that is under way goes.
    pub fn target(&self) -> Option<FocusCounts> {
        self.moving.map(|(_, to)| to)
    }

    /// Since when the lens stands; `None` where it moves.
    pub fn standing_since(&self) -> Option<Tick> {
        self.moving.is_none().then_some(self.standing)
    }

    /// The lens stands for longer, as far as [`Self::standing_since`] tells.
    pub fn wait_anew(&mut self, now: Tick) {
        self.standing = now;
    }

    /// When a move that is under way has failed.
    pub fn move_ends(&self) -> Option<Tick> {
        self.moving.map(|(since, _)| since + MOVE_LIMIT)
    }
}
