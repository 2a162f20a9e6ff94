//! The solve room: from a frame to its outcome.
//!
//! [`Solver::solve`] runs the stages in order: statistics, sources, match, fit, requirements, verification. Uses all rooms
//! before it; no clock, no disk: time and the wish to stop come in through [`Watch`].
//!
//! Who has sources already, and no frame, uses the match alone: [`PatternSearch`].

mod abreast;
mod along;
mod cause;
mod conclude;
mod copies;
mod diagnose;
mod fit;
mod in_common;
mod joint;
mod light;
mod motion;
mod near;
mod outcome;
mod pattern;
mod refine;
mod report;
mod requirements;
mod second_look;
mod served;
mod sharpen;
mod solver;
mod still;
mod track;
mod tracked;
mod unseen;
mod verify;
mod wcs;
mod window;

pub use along::Exposures;
pub use cause::Blur;
pub use fit::{FitPrior, Pair, Pose};
pub use joint::{Joint, View, fit_together};
pub use motion::{Motion, MotionError, Track};
pub use near::{NearRules, NearSearch};
pub use outcome::{
    Cause, FoundBy, HorizontalSolution, Match, Outcome, Prior, Reason, SearchMode, SeriesStart, Solution, SourceReport,
    StageTimes, Statistics,
};
pub use pattern::{Allows, MAX_SOURCES, PatternSearch, SearchEnd, SearchRules, SearchTally};
pub use report::{
    AttitudePriorReport, CandidateReport, Correction, ObserverReport, PointingReport, PriorReport, Report, SeriesStartReport,
    SourceEntry, StarEntry, StatisticsReport, TimesReport,
};
pub use served::Served;
pub use solver::Solver;
pub use track::{AttitudePrior, LensPrior, Region, Spread, Tracker};
pub use verify::{Assigned, FrameGeometry, Hypothesis, PatternSource};
pub use wcs::keywords;
pub use window::{Rerun, Window, Witness};

use std::time::Duration;

/// Why a search is to end before its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Stop {
    /// The frame is too old.
    TimedOut,
    /// Somebody asked for it.
    Aborted,
}

/// The parts of the work on a frame that ask whether to stop, each always in the same order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Making the index, which is not done for every frame.
    Index,
    /// The searches and all that follows them.
    Search,
    /// The survey on the second thread.
    Survey,
}

/// The solver's window on the world: how much time went by, and whether to stop. Asked every few milliseconds, whether to stop also from
/// the solver's second thread.
pub trait Watch: Sync {
    /// Time since some fixed moment; only differences are used, and only to report.
    fn elapsed(&self) -> Duration;
    /// Whether to give up now.
    fn stop(&self) -> Option<Stop>;
    /// The same, asked by a part of the work: who writes down where a stop struck tells them apart.
    fn stop_at(&self, part: Part) -> Option<Stop> {
        let _ = part;
        self.stop()
    }
}

/// A watch that never stops and does not tell the time.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unwatched;

impl Watch for Unwatched {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }
    fn stop(&self) -> Option<Stop> {
        None
    }
}
