//! The guard of the legacy dialect: which command of a block that a flight program of old sends is a true one.
//!
//! Its block has a counter and a countdown for each of its 34 commands, and beside them the values of all. When the ground gives
//! a command the program sets its values, starts its countdown (hundredths of a second, falling to 0) and adds 1 to its counter.
//! There is no checksum and no number of a boot, so that what the memory of a flight computer makes of a block has to be told by
//! the block alone. A command is **announced** by a block in which its counter is 1 above where it stood, with a live
//! countdown, and **runs** when the next block confirms it: the same counter and values, and a countdown that fell and lives.
//! Nothing runs
//!
//! 1. by the first block of a connection: that shows only where the counters stand;
//! 2. by a block in which everything is zero, or in which more than [`MOST_CHANGED`] commands changed their counters;
//! 3. where a counter went back, or up by more than 1, or values changed without it;
//! 4. where the countdown is dead, longer than any that the ground can set, does not fall, or falls faster than time runs here
//!    (blocks that were held up come in a bunch: then the first that comes in its time confirms);
//! 5. where this command ran before with this counter and these values.
//!
//! What was refused stays refused. A counter that stands elsewhere for good is where the next command counts from: after
//! [`LASTING`] if it went up, and after [`OUTLIVED`] if it went back, when every countdown of before is dead; so a memory that is
//! wiped and restored runs nothing twice.

mod flown;
#[cfg(test)]
mod tests;

pub use flown::{FLOWN, Flown, Meaning, meanings};

use super::definition::MAX_VALUES;
use super::in_charge::{LASTING, Tick};
use super::reply::Refusal;
use std::time::Duration;

/// Commands that the dialect has.
pub const COMMANDS: usize = 34;
/// Commands whose counters may change from one block to the next: the ground sends one or two a second.
pub const MOST_CHANGED: usize = 3;
/// Longest countdown that the ground can set, hundredths of a second (`xsc_is_new_window_period`).
pub const LONGEST_COUNTDOWN: u32 = 2000;
/// One step of a countdown: the flight program's main loop.
const STEP: Duration = Duration::from_millis(10);
/// After this time every countdown is dead.
pub const OUTLIVED: Duration = Duration::from_secs(20);
/// Between two blocks at least this part of the time must have gone by here that went by on the countdown.
const PACE: u32 = 2;

/// The values of a command as plain numbers in the dialect's own units and order, zeros after them. Compared bit by bit.
#[derive(Debug, Clone, Copy, Default, serde::Serialize, serde::Deserialize)]
pub struct Values(pub [f64; MAX_VALUES]);

impl PartialEq for Values {
    fn eq(&self, other: &Self) -> bool {
        self.0.iter().zip(&other.0).all(|(a, b)| a.to_bits() == b.to_bits())
    }
}

/// A command as it stands in a block.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Entry {
    /// What is left of the time that it may be run in, hundredths of a second.
    pub countdown: u32,
    /// Counts the commands of this kind.
    pub counter: i32,
    /// Its values.
    pub values: Values,
}

/// What the guard makes of a block.
#[derive(Debug, Clone, PartialEq)]
pub enum Finding {
    /// A true command, whoever may command and whatever its values.
    True {
        /// Its place among the 34.
        index: usize,
        /// Its counter.
        counter: i32,
        /// Its values.
        values: Values,
    },
    /// Something that runs nothing.
    Refused {
        /// The command's place; `None` where the whole block is refused.
        index: Option<usize>,
        /// Its counter.
        counter: i32,
        /// Why.
        why: Refusal,
        /// The reason in words.
        detail: String,
    },
}

/// A reason with its words.
type Refused = (Refusal, String);

/// The guard for one flight computer, from connection to connection.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LegacyGuard {
    /// Where every command stands; empty until the first block of a connection.
    stands: Vec<Stand>,
    /// Counter and values with which each command ran last.
    ran: Vec<Option<(i32, Values)>>,
}

/// Where one command stands.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Stand {
    counter: i32,
    values: Values,
    /// What stands in the blocks instead.
    change: Option<Change>,
}

/// A counter other than the one before, with the values beside it.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Change {
    counter: i32,
    values: Values,
    since: Tick,
    /// What would confirm it; `None` once it was refused.
    announced: Option<Announced>,
}

/// A live countdown: as it was first seen, and as it was seen last and when.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Announced {
    first: u32,
    last: u32,
    at: Tick,
}

impl LegacyGuard {
    /// The computer connected anew: its next block shows where its counters stand.
    pub fn connected(&mut self) {
        self.stands.clear();
    }

    /// Judges a block that came at `now`; what only stands there still is not told.
    pub fn on(&mut self, now: Tick, block: &[Entry; COMMANDS]) -> Vec<Finding> {
        let whole = |detail: String| vec![Finding::Refused { index: None, counter: 0, why: Refusal::Dialect, detail }];
        let nothing = Values::default();
        if block.iter().all(|entry| entry.counter == 0 && entry.countdown == 0 && entry.values == nothing) {
            self.stands.iter_mut().for_each(Stand::forget_announced);
            return whole("the block is zeroed".to_owned());
        }
        if self.stands.is_empty() {
            self.stands = block.iter().map(Stand::of).collect();
            self.ran.resize(COMMANDS, None);
            return Vec::new();
        }
        let changed = self.stands.iter().zip(block).filter(|(stand, entry)| stand.is_news(entry)).count();
        if changed > MOST_CHANGED {
            self.stands.iter_mut().zip(block).for_each(|(stand, entry)| stand.pass_over(now, entry));
            return whole(format!("{changed} commands changed in one block"));
        }
        let mut findings = Vec::new();
        for (index, ((stand, ran), entry)) in self.stands.iter_mut().zip(&mut self.ran).zip(block).enumerate() {
            match stand.judge(now, entry, *ran) {
                None => {}
                Some(Ok(())) => {
                    *ran = Some((entry.counter, entry.values));
                    findings.push(Finding::True { index, counter: entry.counter, values: entry.values });
                }
                Some(Err((why, detail))) => {
                    findings.push(Finding::Refused { index: Some(index), counter: entry.counter, why, detail });
                }
            }
        }
        findings
    }
}

impl Stand {
    fn of(entry: &Entry) -> Self {
        Self { counter: entry.counter, values: entry.values, change: None }
    }

    /// Whether a block shows another counter here than this one and than one that was announced.
    fn is_news(&self, entry: &Entry) -> bool {
        let announced = self.change.filter(|change| change.announced.is_some()).map(|change| change.counter);
        entry.counter != self.counter && Some(entry.counter) != announced
    }

    /// What was announced needs a new announcement.
    fn forget_announced(&mut self) {
        self.change = self.change.filter(|change| change.announced.is_none());
    }

    /// Notes what a block shows of which nothing runs.
    fn pass_over(&mut self, now: Tick, entry: &Entry) {
        self.forget_announced();
        if entry.counter == self.counter {
            self.change = None;
        } else if !self.settled(now, entry) {
            self.refuse(now, entry);
        }
    }

    /// Notes that what stands there was refused, if it was not noted before.
    fn refuse(&mut self, now: Tick, entry: &Entry) {
        if self.change.is_none_or(|change| change.announced.is_some() || !change.is(entry)) {
            self.change = Some(Change { counter: entry.counter, values: entry.values, since: now, announced: None });
        }
    }

    /// Whether what was refused has stood for long enough to count from; then it is where the command stands.
    fn settled(&mut self, now: Tick, entry: &Entry) -> bool {
        let Some(change) = self.change.filter(|change| change.announced.is_none() && change.is(entry)) else { return false };
        let long_enough = if change.counter > self.counter { LASTING } else { OUTLIVED };
        let settled = now.saturating_sub(change.since) >= long_enough;
        if settled {
            *self = Self::of(entry);
        }
        settled
    }

    /// The verdict on what a block shows here; `None` where it is no news, or must be confirmed.
    fn judge(&mut self, now: Tick, entry: &Entry, ran: Option<(i32, Values)>) -> Option<Result<(), Refused>> {
        if entry.counter == self.counter {
            return self.judge_unchanged(entry).map(Err);
        }
        if self.settled(now, entry) {
            return None;
        }
        if let Some(overtaken) = self.overtake(now, entry) {
            return Some(Err(overtaken));
        }
        let verdict = match self.change {
            Some(Change { announced: Some(announced), counter, values, .. }) if counter == entry.counter => {
                if values == entry.values {
                    self.confirm(now, announced, entry)
                } else {
                    Some(Err((Refusal::HalfChanged, "the values changed after their counter".to_owned())))
                }
            }
            Some(change) if change.is(entry) => Some(Err(self.misplaced(entry).unwrap_or_else(|| dead(entry)))),
            _ => self.announce(now, entry, ran),
        };
        match verdict {
            Some(Ok(())) => *self = Self::of(entry),
            Some(Err(_)) => self.refuse(now, entry),
            None => {}
        }
        verdict
    }

    fn judge_unchanged(&mut self, entry: &Entry) -> Option<Refused> {
        let announced = self.change.take().is_some_and(|change| change.announced.is_some());
        if entry.values != self.values {
            self.values = entry.values;
            return Some((Refusal::HalfChanged, "values changed without their counter".to_owned()));
        }
        announced.then(|| (Refusal::HalfChanged, "the counter went back before it was confirmed".to_owned()))
    }

    /// A command that was given before the one announced could be confirmed: it is announced in its place.
    fn overtake(&mut self, now: Tick, entry: &Entry) -> Option<Refused> {
        let before = self.change.filter(|change| change.announced.is_some())?;
        if entry.counter != before.counter.wrapping_add(1) || !is_alive(entry.countdown) {
            return None;
        }
        self.change = Some(Change::announced(now, entry));
        Some((Refusal::Stopped, format!("command {} was overtaken before it was confirmed", before.counter)))
    }

    /// A counter that is new: announced, or refused.
    fn announce(&mut self, now: Tick, entry: &Entry, ran: Option<(i32, Values)>) -> Option<Result<(), Refused>> {
        let refused = if ran == Some((entry.counter, entry.values)) {
            Some((Refusal::Replayed, format!("it ran before with counter {} and these values", entry.counter)))
        } else {
            self.misplaced(entry).or_else(|| (!is_alive(entry.countdown)).then(|| dead(entry)))
        };
        if let Some(refused) = refused {
            return Some(Err(refused));
        }
        self.change = Some(Change::announced(now, entry));
        None
    }

    /// What is wrong with a counter that is not the next one.
    fn misplaced(&self, entry: &Entry) -> Option<Refused> {
        let (before, now) = (self.counter, entry.counter);
        match now.wrapping_sub(before) {
            1 => None,
            step if step > 1 => Some((Refusal::Dialect, format!("the counter went from {before} to {now}"))),
            _ => Some((Refusal::Replayed, format!("counter {now} after {before}"))),
        }
    }

    /// The block after the announcement.
    fn confirm(&mut self, now: Tick, announced: Announced, entry: &Entry) -> Option<Result<(), Refused>> {
        if !is_alive(entry.countdown) {
            return Some(Err(dead(entry)));
        }
        let Some(fallen) = announced.last.checked_sub(entry.countdown).filter(|fallen| *fallen > 0) else {
            return Some(Err((Refusal::Replayed, format!("the countdown stands at {}", entry.countdown))));
        };
        let since = self.change.map_or(now, |change| change.since);
        if now.saturating_sub(since) > STEP * announced.first {
            return Some(Err((Refusal::Stale, "its countdown would be dead by our clock".to_owned())));
        }
        if now.saturating_sub(announced.at) * PACE < STEP * fallen {
            let announced = Announced { last: entry.countdown, at: now, ..announced };
            self.change = self.change.map(|change| Change { announced: Some(announced), ..change });
            return None;
        }
        Some(Ok(()))
    }
}

impl Change {
    fn announced(now: Tick, entry: &Entry) -> Self {
        let announced = Some(Announced { first: entry.countdown, last: entry.countdown, at: now });
        Self { counter: entry.counter, values: entry.values, since: now, announced }
    }

    fn is(&self, entry: &Entry) -> bool {
        self.counter == entry.counter && self.values == entry.values
    }
}

fn is_alive(countdown: u32) -> bool {
    (1..=LONGEST_COUNTDOWN).contains(&countdown)
}

/// Why a countdown lets nothing run.
fn dead(entry: &Entry) -> Refused {
    match entry.countdown {
        0 => (Refusal::Stale, "its countdown is dead".to_owned()),
        long if long > LONGEST_COUNTDOWN => (Refusal::Dialect, format!("no countdown begins at {long}")),
        _ => (Refusal::Stale, "it was refused before".to_owned()),
    }
}
