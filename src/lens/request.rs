//! What the lens is asked, and how a request may end.

use serde::{Deserialize, Serialize};
use std::fmt;

/// A focus position, encoder counts from the near stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FocusCounts(pub i32);

/// A position of the aperture: 0 is fully open, higher is more closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct AperturePosition(pub i32);

/// Counts the requests of one source; the answer repeats it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct RequestCounter(pub u32);

/// What the lens can be asked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LensCommand {
    /// Throw away what is under way on the line, and get in step with the controller again.
    Flush,
    /// Learn the focus range, by driving to both stops, and read where that ended.
    InitFocus,
    /// Read the focus.
    GetFocus,
    /// Go to a focus position.
    SetFocus(FocusCounts),
    /// Move the focus by so many counts, positive away from the near stop.
    MoveFocus(i32),
    /// Make the aperture ready, which opens it, and read it.
    InitAperture,
    /// Read the aperture.
    GetAperture,
    /// Go to a position of the aperture.
    SetAperture(AperturePosition),
    /// Send nothing more that moves: what waits ends as stopped. A move that has begun goes on, for the controller has no
    /// word to stop it.
    Stop,
}

impl LensCommand {
    /// Whether it moves anything.
    pub fn moves(self) -> bool {
        self.moves_focus() || self.moves_aperture()
    }

    /// Whether it moves the focus.
    pub fn moves_focus(self) -> bool {
        matches!(self, Self::InitFocus | Self::SetFocus(_) | Self::MoveFocus(_))
    }

    /// Whether it moves the aperture.
    pub fn moves_aperture(self) -> bool {
        matches!(self, Self::InitAperture | Self::SetAperture(_))
    }

    /// Whether its result says where the focus is: until then an older value is not shown.
    pub fn concerns_focus(self) -> bool {
        self.moves_focus() || self == Self::GetFocus
    }

    /// Whether its result says where the aperture is.
    pub fn concerns_aperture(self) -> bool {
        self.moves_aperture() || self == Self::GetAperture
    }
}

/// How far a request has come. Started comes at most once, and one of the others at the end, always.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LensResult {
    /// Its first word went to the controller.
    Started,
    /// It is done, and what it moved was read back where it should be.
    Completed,
    /// It is not done, or nobody knows.
    Failed(LensError),
}

/// Why a request failed, or what went wrong on the line.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum LensError {
    /// The settings have no lens.
    #[error("there is no lens (lens.kind = \"none\")")]
    NotThere,
    /// The controller is not found.
    #[error("no lens controller is connected")]
    NotConnected,
    /// Too many requests wait.
    #[error("too many requests wait for the lens")]
    Busy,
    /// A stop came before it was sent.
    #[error("stopped before it was sent")]
    Stopped,
    /// No reply in time.
    #[error("no reply to {0} in time")]
    TimedOut(&'static str),
    /// The controller replied with an error.
    #[error("the controller refused {sent}: {reply}")]
    Refused {
        /// What was asked.
        sent: &'static str,
        /// The reply's text.
        reply: String,
    },
    /// A reply that is not one to what was asked.
    #[error("unexpected reply to {sent}: {reply}")]
    Unexpected {
        /// What was asked.
        sent: &'static str,
        /// The reply's text.
        reply: String,
    },
    /// Text that nothing had asked for.
    #[error("unasked text on the line: {0}")]
    Unasked(String),
    /// The part of the service that speaks with the lens was started again, and does not know how far this had come.
    #[error("the lens's part was started again")]
    Restarted,
    /// The port is gone.
    #[error("the port is lost: {0}")]
    PortLost(String),
    /// The controller does not know its focus range.
    #[error("the controller has not learned its focus range")]
    NotLearned,
    /// The counts are in doubt, and only learning makes them mean something again.
    #[error("reads {read}, which means nothing until it is learned again")]
    InDoubt {
        /// What is read.
        read: i32,
    },
    /// The target is outside the range.
    #[error("{wanted} is outside {nearest} to {furthest}")]
    OutOfRange {
        /// Where to.
        wanted: i64,
        /// Lowest position.
        nearest: i32,
        /// Highest position.
        furthest: i32,
    },
    /// The lens did not move.
    #[error("did not move: wanted {wanted}, is still at {at}")]
    DidNotMove {
        /// Where to.
        wanted: i32,
        /// Where it is.
        at: i32,
    },
    /// The lens ended at another place.
    #[error("missed: wanted {wanted}, reads {reached}")]
    Missed {
        /// Where to.
        wanted: i32,
        /// What is read.
        reached: i32,
    },
    /// The count changed as no move can have changed it.
    #[error("counts lost: reads {read} where it was {was}, and no move leads there")]
    CountsLost {
        /// What was known.
        was: i32,
        /// What is read.
        read: i32,
    },
}

impl LensError {
    /// Its kind in a word, by which errors are counted.
    pub fn label(&self) -> &'static str {
        match self {
            Self::NotThere => "not_there",
            Self::NotConnected => "not_connected",
            Self::Busy => "busy",
            Self::Stopped => "stopped",
            Self::TimedOut(_) => "timed_out",
            Self::Refused { .. } => "refused",
            Self::Unexpected { .. } => "unexpected_reply",
            Self::Unasked(_) => "unasked_text",
            Self::Restarted => "restarted",
            Self::PortLost(_) => "port_lost",
            Self::NotLearned => "not_learned",
            Self::InDoubt { .. } => "in_doubt",
            Self::OutOfRange { .. } => "out_of_range",
            Self::DidNotMove { .. } => "did_not_move",
            Self::Missed { .. } => "missed",
            Self::CountsLost { .. } => "counts_lost",
        }
    }
}

impl fmt::Display for FocusCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl fmt::Display for AperturePosition {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}
