//! The guard: which command of a block runs, and which does not and why.
//!
//! A flight computer sends a block of the commands that it was given of late, twice a second, for as long as each matters. The
//! memory of a flight computer can go wrong, and so can a link: blocks come twice, late, in another order, zeroed, or with
//! half of a command changed. A command runs only if all of this holds, in this order:
//!
//! 1. the block carries the right code of authentication, where one is required;
//! 2. it comes from the boot that said hello on this connection;
//! 3. it is not the first whole one of that boot: that shows only where its counters stand;
//! 4. the values of the command carry the seal that they were given together with its counter ([`Slot::seal`]);
//! 5. the counter is greater than any that this boot has shown for this command;
//! 6. its computer holds the lease, and made the block under this lease;
//! 7. the ground gave it within the window, counting the time that the block can have been on its way;
//! 8. it is a command, and its values are in range.
//!
//! From check 5 on, whatever the verdict is, the counter is used up: a command that was refused never runs later, when things
//! have changed that the ground did not see. What runs is told by [`Verdict::Run`]; before it does, the caller keeps
//! [`Guard::memory`] on disk.

use super::checks::{Check, Checks};
use super::definition::{CommandError, MAX_VALUES};
use super::dictionary::Command;
use super::in_charge::{BootId, Epoch, FlightComputer, Lease};
use super::reply::Refusal;
use std::collections::BTreeMap;
use std::time::Duration;

/// Boots of a computer that are remembered, the last ones: a block of an earlier one is no news.
const BOOTS: usize = 4;
/// Computers that are remembered. There are two; the rest is room for the ground's.
const COMPUTERS: usize = 16;

/// What is to be done with a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Act {
    /// Run it.
    Run,
    /// Make it ready to be fired.
    Arm,
    /// Run it, which was armed.
    Fire,
}

/// A command as it stands in a block.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Slot {
    /// The command's number.
    pub code: u8,
    /// What to do with it.
    pub act: Act,
    /// Counts the sender's commands of this code since its start, from 1.
    pub counter: u32,
    /// Time since the ground gave it, by the sender's clock, s.
    pub age_s: f64,
    /// Its values.
    pub values: [f64; MAX_VALUES],
    /// Made when the ground gave the command, and kept beside it: [`Slot::seal_of`].
    pub seal: u32,
}

impl Slot {
    /// CRC-32 (IEEE) over code, act, counter and values, little-endian, in this order: a command of which only a part changed in
    /// its sender's memory does not carry it.
    pub fn seal_of(code: u8, act: Act, counter: u32, values: &[f64; MAX_VALUES]) -> u32 {
        let mut crc = crc32fast::Hasher::new();
        crc.update(&[code, act as u8 + 1]);
        crc.update(&counter.to_le_bytes());
        values.iter().for_each(|value| crc.update(&value.to_le_bytes()));
        crc.finalize()
    }

    /// Whether it carries the seal that it was given with.
    pub fn is_sealed(&self) -> bool {
        self.seal == Self::seal_of(self.code, self.act, self.counter, &self.values)
    }

    /// A command with its seal.
    pub fn new(command: &Command, act: Act, counter: u32, age_s: f64) -> Self {
        let (code, values) = (command.code(), command.wire_values());
        Self { code, act, counter, age_s, values, seal: Self::seal_of(code, act, counter, &values) }
    }
}

/// Whether a block shows the key of its sender.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub enum Authenticity {
    /// It does.
    Shown,
    /// It shows none, and none is required.
    NotRequired,
    /// It shows none or a wrong one, and one is required.
    Failed,
}

/// Where a block comes from.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Sender {
    /// Who sent it.
    pub computer: FlightComputer,
    /// The boot that said hello on the connection.
    pub boot: BootId,
    /// What the block says of itself.
    pub block_boot: BootId,
    /// The lease that the block was made under, and the run of ours that granted it; `None` in a dialect that has no word for it.
    pub under: Option<(BootId, Epoch)>,
    /// How long the block can have been on its way: the age of the update of ours that it answers.
    pub delay: Duration,
    /// Whether it shows the key.
    pub authenticity: Authenticity,
}

/// What the guard needs to know besides.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Situation {
    /// Who may command.
    pub lease: Option<Lease>,
    /// This run of ours.
    pub ours: BootId,
    /// A ground command older than this is stale, s.
    pub window_s: f64,
}

/// A command that passed, as an order to the rest of the program.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Order {
    /// Who gave it.
    pub from: FlightComputer,
    /// Its counter there.
    pub counter: u32,
    /// What to do with it.
    pub act: Act,
    /// The command.
    pub command: Command,
}

/// What becomes of a command in a block.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Verdict {
    /// It runs.
    Run(Order),
    /// It does not.
    Refused {
        /// The command's number; 0 where the whole block is refused.
        code: u8,
        /// Its counter.
        counter: u32,
        /// Why.
        why: Refusal,
        /// The reason in words.
        detail: String,
    },
}

/// What one boot of one computer has shown: the counter of each command, with the seal that it came with.
#[derive(Debug, Clone, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct Boot {
    boot: BootId,
    /// A whole block of it was seen, so that its counters are known.
    seeded: bool,
    counters: BTreeMap<u8, (u32, u32)>,
}

/// What must survive a restart: the counters of each boot of each computer, the last used last.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct Memory(BTreeMap<FlightComputer, Vec<Boot>>);

/// The guard. Its state is small and hashable.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct Guard {
    memory: Memory,
    checks: Checks,
}

impl Guard {
    /// A guard that remembers.
    pub fn new(memory: Memory) -> Self {
        Self { memory, checks: Checks::default() }
    }

    /// A guard that makes these checks alone.
    #[cfg(test)]
    pub(super) fn with(checks: Checks) -> Self {
        Self { checks, ..Self::default() }
    }

    /// What must be kept before a command runs.
    pub fn memory(&self) -> &Memory {
        &self.memory
    }

    /// Judges a block: a verdict for each command that is news, none for what only stands there still.
    pub fn on(&mut self, sender: &Sender, situation: &Situation, slots: &[Slot]) -> Vec<Verdict> {
        if sender.authenticity == Authenticity::Failed && self.checks.has(Check::Key) {
            return whole(Refusal::NotAuthentic, "the block does not show the key of its sender");
        }
        if sender.block_boot != sender.boot && self.checks.has(Check::Boot) {
            return whole(Refusal::WrongBoot, "the block is not of the boot that said hello");
        }
        let mut boot = self.memory.take(sender.computer, sender.block_boot);
        let checks = self.checks;
        let verdicts = slots.iter().filter_map(|slot| judge(&mut boot, sender, situation, slot, checks)).collect();
        boot.seeded |= slots.iter().all(Slot::is_sealed);
        self.memory.put(sender.computer, boot);
        verdicts
    }
}

fn whole(why: Refusal, detail: &str) -> Vec<Verdict> {
    vec![Verdict::Refused { code: 0, counter: 0, why, detail: detail.to_owned() }]
}

impl Memory {
    /// What is remembered of a boot, taken out to be worked on; [`Self::put`] puts it back.
    fn take(&mut self, computer: FlightComputer, boot: BootId) -> Boot {
        let boots = self.0.get_mut(&computer);
        let known = boots.and_then(|boots| boots.iter().position(|known| known.boot == boot).map(|place| boots.remove(place)));
        known.unwrap_or_else(|| Boot { boot, seeded: false, counters: BTreeMap::new() })
    }

    /// Remembers a boot as the last that was heard of.
    fn put(&mut self, computer: FlightComputer, boot: Boot) {
        if !self.0.contains_key(&computer) && self.0.len() >= COMPUTERS {
            self.0.pop_last();
        }
        let boots = self.0.entry(computer).or_default();
        if boots.len() >= BOOTS {
            boots.remove(0);
        }
        boots.push(boot);
    }
}

/// The verdict on one command; `None` where it only stands there still.
fn judge(boot: &mut Boot, sender: &Sender, now: &Situation, slot: &Slot, checks: Checks) -> Option<Verdict> {
    let refused = |why: Refusal, detail: String| Some(Verdict::Refused { code: slot.code, counter: slot.counter, why, detail });
    let Slot { code, act, counter, age_s, values, seal } = *slot;
    if checks.has(Check::Seal) && !slot.is_sealed() {
        return refused(Refusal::HalfChanged, "the seal is not that of counter and values".to_owned());
    }
    let (last, last_seal) = boot.counters.get(&code).copied().unwrap_or_default();
    if checks.has(Check::Counter) {
        if counter == last {
            let same = seal == last_seal || counter == 0;
            return if same { None } else { refused(Refusal::HalfChanged, "other values under the same counter".to_owned()) };
        }
        if counter < last {
            return refused(Refusal::Replayed, format!("counter {counter} after {last}"));
        }
    }
    boot.counters.insert(code, (counter, seal));
    if !boot.seeded && checks.has(Check::First) {
        return refused(Refusal::Early, "the first block of a boot runs nothing".to_owned());
    }
    if let Err((why, detail)) = may_command(sender, now, checks) {
        return refused(why, detail);
    }
    let way_s = if checks.has(Check::Delay) { sender.delay.as_secs_f64() } else { 0.0 };
    if checks.has(Check::Age) && !(age_s >= 0.0 && age_s + way_s <= now.window_s) {
        let detail = format!("given {age_s:.1} s ago, up to {way_s:.1} s on the way, the window is {} s", now.window_s);
        return refused(Refusal::Stale, detail);
    }
    Some(read(sender, code, act, counter, &values))
}

/// The last check: it is a command, and its values are in range.
fn read(sender: &Sender, code: u8, act: Act, counter: u32, values: &[f64; MAX_VALUES]) -> Verdict {
    match Command::from_wire(code, values) {
        Ok(command) => Verdict::Run(Order { from: sender.computer, counter, act, command }),
        Err(error) => {
            let unknown = matches!(error, CommandError::UnknownCode(_) | CommandError::UnknownName { .. });
            let why = if unknown { Refusal::UnknownCommand } else { Refusal::OutOfRange };
            Verdict::Refused { code, counter, why, detail: error.to_string() }
        }
    }
}

/// The verdict on a command that the guard of another dialect found to be new and young enough: checks 1, 6 and 8.
pub fn admit(sender: &Sender, situation: &Situation, code: u8, counter: u32, values: &[f64; MAX_VALUES]) -> Verdict {
    let refused = |why, detail: String| Verdict::Refused { code, counter, why, detail };
    if sender.authenticity == Authenticity::Failed {
        return refused(Refusal::NotAuthentic, "its dialect has no word for a key".to_owned());
    }
    match may_command(sender, situation, Checks::default()) {
        Err((why, detail)) => refused(why, detail),
        Ok(()) => read(sender, code, Act::Run, counter, values),
    }
}

/// Whether the sender may command, and made the block knowing so.
fn may_command(sender: &Sender, now: &Situation, checks: Checks) -> Result<(), (Refusal, String)> {
    let holder = now.lease.filter(|lease| lease.computer == sender.computer);
    if checks.has(Check::Holder) && holder.is_none() {
        return Err((Refusal::NotInCharge, "its computer does not hold the lease".to_owned()));
    }
    let (Some((ours, epoch)), Some(lease)) = (sender.under, now.lease) else { return Ok(()) };
    if checks.has(Check::Epoch) && (ours != now.ours || epoch != lease.epoch) {
        return Err((Refusal::NotInCharge, "the block was made under another lease".to_owned()));
    }
    Ok(())
}
