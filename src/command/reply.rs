//! Replies: what became of each command, in stages, until the flight computer has acknowledged them.

use super::in_charge::{BootId, FlightComputer, Tick};
use std::collections::{BTreeMap, VecDeque};

/// Replies that are kept.
pub const REPLIES: usize = 32;

/// How far a command has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Stage {
    /// It passed every check and will be run.
    Accepted,
    /// It has begun.
    Started,
    /// It is done.
    Completed,
    /// It was not let through.
    Rejected,
    /// It was let through and could not be done.
    Failed,
}

impl Stage {
    /// Whether nothing more comes after it.
    pub fn is_last(self) -> bool {
        matches!(self, Self::Completed | Self::Rejected | Self::Failed)
    }
}

/// Why a command was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// Its computer does not hold the lease, or did not when it sent it.
    NotInCharge,
    /// The ground gave it too long ago.
    Stale,
    /// Its counter is older than one that came before.
    Replayed,
    /// A value is out of its range.
    OutOfRange,
    /// As much is under way as may be.
    Busy,
    /// It must be armed first.
    NotArmed,
    /// There is no such command.
    UnknownCommand,
    /// It cannot be done safely now.
    UnsafeState,
    /// The sender does not show its key.
    NotAuthentic,
    /// Counter and values do not belong together.
    HalfChanged,
    /// It came in the first block of a boot.
    Early,
    /// The block is of another boot than the connection.
    WrongBoot,
    /// Its part of the program is not there.
    NotAvailable,
    /// Its counter could not be kept on disk.
    NotKept,
    /// Something newer took its place, or it was stopped.
    Stopped,
    /// The device did not do it.
    Device,
    /// The program that it runs could not be run, or is not set.
    Program,
    /// The dialect's guard did not let it through.
    Dialect,
    /// It was done and led to nothing: no best focus was found.
    NoResult,
}

/// One stage of one command.
#[derive(Debug, Clone, PartialEq)]
pub struct Reply {
    /// Counts all replies since the start, from 1.
    pub serial: u32,
    /// Who gave the command.
    pub to: FlightComputer,
    /// The command's number.
    pub code: u8,
    /// Its counter there.
    pub counter: u32,
    /// How far it has come.
    pub stage: Stage,
    /// Why it went no further.
    pub why: Option<Refusal>,
    /// The reason, or what came of it, in words.
    pub detail: String,
    /// When.
    pub at: Tick,
}

/// The last replies.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Replies {
    kept: VecDeque<Reply>,
    last: u32,
    /// The boot of each computer, and up to where it has acknowledged.
    acknowledged: BTreeMap<FlightComputer, (BootId, u32)>,
}

impl Replies {
    /// Adds a reply; its serial number.
    pub fn add(&mut self, reply: Reply) -> u32 {
        self.last = self.last.wrapping_add(1);
        if self.kept.len() >= REPLIES {
            self.kept.pop_front();
        }
        self.kept.push_back(Reply { serial: self.last, ..reply });
        self.last
    }

    /// A computer connects. Another boot than before has nothing to do with what was answered until now: a counter of its own could
    /// be taken for one of the boot before.
    /// Whether it is another boot than before.
    pub fn begin(&mut self, computer: FlightComputer, boot: BootId) -> bool {
        let is_new = self.acknowledged.get(&computer).is_none_or(|(known, _)| *known != boot);
        if is_new {
            self.acknowledged.insert(computer, (boot, self.last));
        }
        is_new
    }

    /// A computer has everything up to this serial number. One that was never given is ignored.
    pub fn acknowledge(&mut self, computer: FlightComputer, serial: u32) {
        if let Some((_, known)) = self.acknowledged.get_mut(&computer).filter(|_| serial <= self.last) {
            *known = serial.max(*known);
        }
    }

    /// What a computer has not acknowledged, oldest first: the replies to its own commands and to the other's.
    pub fn due(&self, computer: FlightComputer) -> impl Iterator<Item = &Reply> {
        let known = self.acknowledged.get(&computer).map_or(0, |(_, serial)| *serial);
        self.kept.iter().filter(move |reply| reply.serial > known)
    }

    /// The last one.
    pub fn last(&self) -> Option<&Reply> {
        self.kept.back()
    }
}
