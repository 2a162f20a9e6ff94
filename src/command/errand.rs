//! All that happens at the desk as one event each, so that a desk can be driven again by what was written down of it.

use super::definition::CommandError;
use super::desk::{Desk, Focus, OrderNumber, Step};
use super::dictionary::Command;
use super::guard::Verdict;
use super::in_charge::{BootId, FlightComputer, Tick};
use super::reply::{Refusal, Stage};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// What happens at the desk.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Errand {
    /// See [`Desk::begin`].
    Begin {
        /// Who connects.
        computer: FlightComputer,
        /// Which start of its program it is.
        boot: BootId,
    },
    /// A computer has heard replies up to this one.
    Acknowledge {
        /// Who.
        computer: FlightComputer,
        /// The number of the reply.
        serial: u32,
    },
    /// See [`Desk::take`].
    Take {
        /// Whose block it stood in.
        from: FlightComputer,
        /// What the guard said.
        verdict: Verdict,
        /// What is known of the lens.
        focus: Focus,
    },
    /// See [`Desk::kept`].
    Kept {
        /// The order.
        number: OrderNumber,
        /// Why its counter is not on disk, where it is not.
        kept: Result<(), String>,
    },
    /// See [`Desk::report`].
    Report {
        /// The order.
        number: OrderNumber,
        /// How far it is.
        stage: Stage,
        /// Why no further.
        why: Option<Refusal>,
        /// In words.
        detail: String,
    },
    /// See [`Desk::expire`].
    Expire,
    /// See [`Desk::disarm`].
    Disarm,
}

impl Desk {
    /// Takes note of what happens at `now`, which never runs backwards; what the caller is to do.
    pub fn on(&mut self, now: Tick, errand: Errand) -> Option<Step> {
        match errand {
            Errand::Begin { computer, boot } => self.begin(now, computer, boot),
            Errand::Acknowledge { computer, serial } => self.replies.acknowledge(computer, serial),
            Errand::Take { from, verdict, focus } => return self.take(now, from, verdict, focus),
            Errand::Kept { number, kept } => return self.kept(now, number, kept),
            Errand::Report { number, stage, why, detail } => self.report(now, number, stage, why, detail),
            Errand::Expire => self.expire(now),
            Errand::Disarm => self.disarm(),
        }
        None
    }
}

/// As it is written, which [`Command::parse`] reads back to the last bit.
impl Serialize for Command {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Command {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        Self::parse(&text).map_err(|error: CommandError| de::Error::custom(error))
    }
}
