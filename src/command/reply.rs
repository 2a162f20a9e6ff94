//! Replies: what became of each command, in stages, until the flight computer has acknowledged them.

use super::in_charge::{BootId, FlightComputer, Tick};
use std::collections::{BTreeMap, VecDeque};

/// Replies that are kept.
pub const REPLIES: usize = 32;

/// How far a command has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
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
    /// The program ended before it was done; how far it came is not known.
    Restarted,
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

/// How a command ended, kept until its computer has been told: over a restart of the program too.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Answer {
    to: FlightComputer,
    boot: BootId,
    code: u8,
    counter: u32,
    stage: Stage,
    why: Option<Refusal>,
    detail: String,
}

/// The last replies.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Replies {
    kept: VecDeque<Reply>,
    last: u32,
    /// The boot of each computer, and up to where it has acknowledged.
    acknowledged: BTreeMap<FlightComputer, (BootId, u32)>,
    /// What an earlier run of the program had not told yet.
    earlier: Vec<Answer>,
}

impl Replies {
    /// With what an earlier run had not told yet.
    pub fn after(earlier: Vec<Answer>) -> Self {
        Self { earlier, ..Self::default() }
    }

    /// How commands ended, as far as their computers have not acknowledged it, oldest first.
    pub fn unanswered(&self) -> impl Iterator<Item = Answer> {
        let waits = |reply: &&Reply| reply.stage.is_last() && self.due(reply.to).any(|due| due.serial == reply.serial);
        let now = self.kept.iter().filter(waits).map(|reply| self.answer(reply.clone()));
        self.earlier.iter().cloned().chain(now)
    }

    /// A reply as it is kept over a restart.
    pub fn answer(&self, reply: Reply) -> Answer {
        let Reply { to, code, counter, stage, why, detail, .. } = reply;
        let boot = self.acknowledged.get(&to).map_or_else(BootId::default, |(boot, _)| *boot);
        Answer { to, boot, code, counter, stage, why, detail }
    }

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
    /// be taken for one of the boot before. What an earlier run of ours had not told this boot yet, it is told now.
    /// Whether it is another boot than before.
    pub fn begin(&mut self, now: Tick, computer: FlightComputer, boot: BootId) -> bool {
        let is_new = self.acknowledged.get(&computer).is_none_or(|(known, _)| *known != boot);
        if is_new {
            self.acknowledged.insert(computer, (boot, self.last));
            let (its, others) = std::mem::take(&mut self.earlier).into_iter().partition(|answer| answer.to == computer);
            self.earlier = others;
            let its: Vec<Answer> = its;
            for Answer { to, code, counter, stage, why, detail, .. } in its.into_iter().filter(|answer| answer.boot == boot) {
                self.add(Reply { serial: 0, to, code, counter, stage, why, detail, at: now });
            }
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

    /// Those that are kept, newest first.
    pub fn newest(&self) -> impl Iterator<Item = &Reply> {
        self.kept.iter().rev()
    }

    /// The last one.
    pub fn last(&self) -> Option<&Reply> {
        self.kept.back()
    }
}
