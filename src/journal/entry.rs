//! What a journal holds.

use super::outcome::OutcomeMark;
use crate::command::{Answer, BootId, Epoch, Errand, Event, FlightComputer, Memory, Sender, Situation, Slot, Tick, legacy};
use crate::image::{ImageCounter, Stamp};
use crate::lens::autofocus::{self, Learned};
use crate::lens::{self, FocusKept, Rules};
use crate::sky::{ClockQuality, RowOrder, Utc};
use crate::solve::{Motion, Prior, Reason, Window};
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// One input, and what it led to.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// The time that the machine was told, since the start of the run; of a frame that of its capture.
    pub at: Tick,
    /// What came.
    pub what: What,
}

/// What came, at which machine. `led_to` is the [`mark`](super::mark) of the machine's answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum What {
    /// A run of the service begins.
    Begin(Box<Begin>),
    /// Settings that entries after this one name by their fingerprint.
    Settings(Text),
    /// So many entries that belong here are not there: the disk was too slow for them.
    Lost(u32),
    /// At the arbitration.
    Charge {
        /// What happened.
        event: Event,
        /// The decision.
        led_to: u32,
    },
    /// A block of commands at the guard.
    Block {
        /// Whose.
        sender: Sender,
        /// What else the guard was told.
        situation: Situation,
        /// The commands of the block.
        slots: Vec<Slot>,
        /// The verdicts.
        led_to: u32,
    },
    /// A computer that speaks the legacy dialect connected.
    LegacyConnected(FlightComputer),
    /// Its block, at the guard of the dialect.
    LegacyBlock {
        /// Whose.
        computer: FlightComputer,
        /// All commands of the block.
        commands: Vec<legacy::Entry>,
        /// The findings.
        led_to: u32,
    },
    /// At the desk.
    Desk {
        /// What happened.
        errand: Errand,
        /// The step, and the last reply.
        led_to: u32,
    },
    /// At the autofocus.
    Focus {
        /// What happened.
        event: autofocus::Event,
        /// The decision.
        led_to: u32,
    },
    /// The machine of the lens is made, or made anew.
    LensBegins {
        /// Its rules.
        rules: Rules,
        /// What is known of the focus from before.
        before: FocusKept,
    },
    /// At the machine of the lens: replies, requests, time.
    Lens {
        /// What happened.
        event: lens::Event,
        /// The actions.
        led_to: u32,
    },
    /// What earlier frames have shown is forgotten: the solver's part of the program starts, or starts anew.
    SolverBegins,
    /// The solver was given a frame, and answered.
    Solved(Box<Solved>),
    /// A frame ended without an answer of the solver.
    Ended {
        /// Its number.
        image: ImageCounter,
        /// How.
        reason: Reason,
        /// In words.
        detail: String,
    },
}

/// What a run of the service began from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Begin {
    /// Version of the program.
    pub version: String,
    /// The number of this start, which is part of the names of its images.
    pub boot: BootId,
    /// UTC then, and how far it can be believed.
    pub utc: Option<(Utc, ClockQuality)>,
    /// The settings of the start.
    pub settings: Text,
    /// The last lease of earlier runs.
    pub epoch: Epoch,
    /// The counters of commands.
    pub counters: Memory,
    /// What computers had not been told.
    pub answers: Vec<Answer>,
    /// What the autofocus learned.
    pub learned: Learned,
}

/// Settings as a settings file has them.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Text {
    /// [`crate::settings::Settings::fingerprint`] of them.
    pub fingerprint: u64,
    /// TOML with every setting.
    pub toml: String,
}

/// An exposure of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exposure {
    /// Its place in its series, which is part of its file's name; `None` where it stands alone.
    pub part: Option<u8>,
    /// Highest value that a pixel can have, ADU, where it is known.
    pub full_scale: Option<u16>,
    /// [`pixel_sum`](super::pixel_sum) of it; `None` where there was no time for it.
    pub checksum: Option<u32>,
}

/// A frame that the solver was given, and what it made of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Solved {
    /// The number of the start that took it, which is part of its file's name.
    pub boot: BootId,
    /// All that is known of the frame besides its pixels: its number leads to its file.
    pub stamp: Stamp,
    /// Columns and rows, px.
    pub size_px: (u32, u32),
    /// Which end of the picture the first row is.
    pub rows: RowOrder,
    /// Highest value that a pixel can have, ADU.
    pub full_scale: Option<u16>,
    /// Its exposures; of several it is the sum.
    pub exposures: Vec<Exposure>,
    /// When it was captured, on the clock of the tracking: since the solver's part of the program began.
    pub since: Duration,
    /// What the flight computer sent of the pointing.
    pub sent: Prior,
    /// The same, with what earlier frames had shown.
    pub prior: Prior,
    /// Whether it was solved before, and is again because its motion has come.
    pub again: bool,
    /// How the gondola turned during it, where that was known.
    pub motion: Option<Motion>,
    /// The fingerprint of the settings in force.
    pub settings: u64,
    /// Where it was stopped.
    pub window: Window,
    /// How it ended.
    pub outcome: OutcomeMark,
}
