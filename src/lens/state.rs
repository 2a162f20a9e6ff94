//! What is known of the lens.

use super::request::{AperturePosition, FocusCounts, LensCommand};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A value that is known, or why it is not. There is no value to show in the other cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Known<T> {
    /// It is this.
    Known(T),
    /// It changes: a word that moves went out, and its reply has not come.
    Moving,
    /// Nobody knows.
    Unknown(Doubt),
}

/// Why a value is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Doubt {
    /// There is no lens.
    NoLens,
    /// Not read since the start.
    NeverRead,
    /// A request that is not answered yet will say or change it.
    Requested,
    /// It was moved, and has not been read back.
    NotReadBack,
    /// A reply did not come in time.
    TimedOut,
    /// A reply was none to what was asked, or text came unasked.
    UnexpectedReply,
    /// The controller refused.
    Refused,
    /// The port is gone, or the controller silent.
    PortLost,
    /// The controller does not know its range, and did not since the start.
    NotLearned,
    /// The controller forgot its range: its power was off.
    PowerCycled,
    /// The count changed though nothing moved.
    CountsLost,
    /// A move ended at another place than it should.
    Missed,
}

impl Doubt {
    /// Whether the counts mean nothing until the range is learned anew.
    pub fn is_mended_by_learning(self) -> bool {
        matches!(self, Self::NotLearned | Self::PowerCycled | Self::CountsLost | Self::Missed)
    }
}

/// What is kept of the focus over a restart of the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub enum FocusKept {
    /// Nothing: it was never known, or something was to move it.
    #[default]
    Unknown,
    /// It stood here.
    At(FocusCounts),
    /// Its counts meant nothing.
    InDoubt,
    /// Its range was being learned anew by itself, and it was to go back here then.
    GoingBack(FocusCounts),
}

impl<T: Copy> Known<T> {
    /// The value where it is known.
    pub fn value(self) -> Option<T> {
        match self {
            Self::Known(value) => Some(value),
            Self::Moving | Self::Unknown(_) => None,
        }
    }

    /// Whether it changes now.
    pub fn is_moving(self) -> bool {
        matches!(self, Self::Moving)
    }

    /// Why it is not known, where it is not and does not change either.
    pub fn doubt(self) -> Option<Doubt> {
        match self {
            Self::Unknown(doubt) => Some(doubt),
            Self::Moving | Self::Known(_) => None,
        }
    }
}

impl Doubt {
    /// Its name.
    pub fn label(self) -> &'static str {
        match self {
            Self::NoLens => "no_lens",
            Self::NeverRead => "never_read",
            Self::Requested => "requested",
            Self::NotReadBack => "not_read_back",
            Self::TimedOut => "timed_out",
            Self::UnexpectedReply => "unexpected_reply",
            Self::Refused => "refused",
            Self::PortLost => "port_lost",
            Self::NotLearned => "not_learned",
            Self::PowerCycled => "power_cycled",
            Self::CountsLost => "counts_lost",
            Self::Missed => "missed",
        }
    }

    /// Whether reading the focus again can't mend it, because what is read would be wrong: the range has to be learned anew.
    pub fn needs_learning(self) -> bool {
        matches!(self, Self::NotLearned | Self::PowerCycled | Self::CountsLost | Self::Missed)
    }
}

/// All that is known of the lens.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct LensState {
    /// The port that the controller is at.
    pub port: Option<String>,
    /// Whether the controller answers there.
    pub connected: bool,
    /// What the controller says of its version.
    pub version: Option<String>,
    /// Where the focus is.
    pub focus: Known<FocusCounts>,
    /// Nearest and furthest focus, where the controller has learned them.
    pub range: Option<(FocusCounts, FocusCounts)>,
    /// Where the aperture is.
    pub aperture: Known<AperturePosition>,
    /// Where the focus goes back to by itself once its range is learned anew.
    pub going_back: Option<FocusCounts>,
    /// A stop stands: focus or aperture, or both, don't move by themselves until a command moves them.
    pub stopped: bool,
    /// The request or own task that is under way.
    pub busy: Option<LensCommand>,
    /// Requests that wait.
    pub waiting: usize,
    /// What went wrong since the start, by the error's label.
    pub errors: BTreeMap<&'static str, u32>,
    /// The last of it, in words.
    pub last_error: Option<String>,
}

impl LensState {
    /// The state of a lens that nothing is known of, for this reason.
    pub fn unknown(doubt: Doubt) -> Self {
        Self {
            port: None,
            connected: false,
            version: None,
            focus: Known::Unknown(doubt),
            range: None,
            aperture: Known::Unknown(doubt),
            going_back: None,
            stopped: false,
            busy: None,
            waiting: 0,
            errors: BTreeMap::new(),
            last_error: None,
        }
    }
}
