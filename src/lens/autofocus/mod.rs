//! The autofocus: finds the lens position at which stars are sharpest, and goes there if it may.
//!
//! A sweep goes upwards through a range, once widely and then up to three times about the peak, and fits the peaks of the stars (each star has a
//! curve of its own, so that the gondola may drift) or, where they show none, of the brightest source of each image. Positions are
//! always approached from below, so that the gears' backlash is taken up; the best focus may drift, which the passes at different times
//! tell. A refocus goes one bounded step and comes back by itself if the stars did not get better.
//!
//! [`Autofocus`] is a plain state machine: events come in with the time, and each is answered by one [`Decision`]. The rules:
//!
//! 1. one move at a time, and none beyond the run's limits;
//! 2. an image counts only if the lens stood, for its whole exposure, at a position that the run went to and that was approached from
//!    below ([`FocusImage::position`] must be known and that position);
//! 3. a run ends in one [`Finding`], also where the lens fails, and takes images for no longer than the time allowed;
//! 4. after [`Event::Stop`] nothing moves; after [`Event::Abort`] without its result, and where nothing was found, the lens goes back to
//!    where it was.
//!
//! Who moves the lens while a run is under way must stop the run first.

mod approach;
mod compare;
mod curves;
mod fit;
mod image;
mod machine;
mod plan;
mod run;
mod sweep;
mod travel;
mod verdict;
mod width;

#[cfg(test)]
mod tests;

pub use curves::CurvePoint;
pub use machine::{Autofocus, AutofocusStatus, Learned, Mode};
pub use verdict::{BestFocus, Curve, Side};
pub use width::{FocusEstimate, Slope, Widths};

use super::FocusCounts;
use crate::command::Tick;
use crate::image::ImageCounter;
use crate::settings::FocusSettings;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A star's place in the catalogue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct StarId(pub u32);

/// A measured value and one σ of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Metric {
    /// The value.
    pub value: f64,
    /// One σ.
    pub sigma: f64,
}

/// What an image says of the focus.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FocusImage {
    /// The image's number.
    pub counter: ImageCounter,
    /// Middle of the exposure.
    pub captured: Tick,
    /// Where the lens stood during the whole exposure; `None` where that is not known, or it moved.
    pub position: Option<FocusCounts>,
    /// Peak of the brightest source that is not saturated, ADU.
    pub brightest: Option<Metric>,
    /// Peak of each matched star that is not saturated, ADU.
    pub stars: Vec<(StarId, Metric)>,
    /// Full width at half maximum of the better sources, px.
    pub width_px: Option<Metric>,
    /// Temperature of the lens, °C.
    pub temperature_c: Option<f64>,
}

/// Where and how a sweep searches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct SweepPlan {
    /// Nearest position that the lens may take.
    pub min: FocusCounts,
    /// Furthest position that the lens may take.
    pub max: FocusCounts,
    /// Finest step, counts; wider ones are taken where the time asks for them.
    pub step: i32,
    /// Only say where the best focus is, and go back to where the lens was.
    pub advise_only: bool,
}

/// What happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Event {
    /// A sweep is wanted.
    Run {
        /// Where and how.
        plan: SweepPlan,
        /// Where the lens is, if that is known.
        from: Option<FocusCounts>,
    },
    /// One bounded step is wanted: positive away from the near stop.
    Refocus {
        /// The step, counts.
        by: i32,
        /// Where the lens is, if that is known.
        from: Option<FocusCounts>,
    },
    /// The run is to end: at the best focus so far, or where it began.
    Abort {
        /// Go to the best focus so far.
        use_result: bool,
    },
    /// An image ended in its outcome.
    Image(FocusImage),
    /// The lens has made the move, and this is the position that it was verified at.
    Arrived(FocusCounts),
    /// The lens could not make the move; where it is, is not known.
    LensFailed(String),
    /// Nothing may move any more.
    Stop,
    /// Nothing but that time went by.
    Time,
}

/// What an event led to.
#[derive(Debug, Clone, PartialEq)]
pub enum Decision {
    /// All stays as it was.
    Unchanged,
    /// The lens is to go there; [`Event::Arrived`] or [`Event::LensFailed`] is expected.
    Move(FocusCounts),
    /// The run ended.
    Finished(Finding),
    /// The run did not begin.
    Refused(Refusal),
}

/// Why a run did not begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, thiserror::Error)]
#[serde(rename_all = "snake_case")]
pub enum Refusal {
    /// Another is under way.
    #[error("an autofocus is under way")]
    Busy,
    /// The range has no room for a curve beside the backlash.
    #[error("the range is too narrow for a curve")]
    RangeTooNarrow,
    /// The run must come back to where the lens is, which is not known.
    #[error("the lens position is not known")]
    PositionUnknown,
    /// The run must come back to where the lens is, which is outside its range.
    #[error("the lens is outside the range")]
    OutsideRange,
    /// Nought, or more than the settings allow.
    #[error("the step is nought or too long")]
    StepOutOfRange,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Ending {
    /// The best focus was found.
    Found,
    /// The stars get better up to the end of the range: the best focus is there or beyond.
    Edge(Side),
    /// Nothing that looks like a focus: no clear peak.
    NoPeak,
    /// Too few images that could be used.
    TooFew,
    /// The best focus was found, but the stars are not as sharp there as they should be.
    NotConfirmed,
    /// The time allowed ended before anything was found.
    TimedOut,
    /// Given up by command.
    Aborted,
    /// Stopped by command.
    Stopped,
    /// The lens failed, and why.
    LensFailed(String),
    /// The stars got better by the step: logarithm of the ratio of their peaks.
    Better(Metric),
    /// They did not: logarithm of the ratio.
    Worse(Metric),
}

/// Where a run left the lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Left {
    /// At what it found.
    AtBest,
    /// Where it was before the run.
    AtStart,
    /// Where it happened to be.
    WhereItWas,
}

/// What a run found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// How it ended.
    pub ending: Ending,
    /// The best focus, where one is known.
    pub best: Option<BestFocus>,
    /// Where the lens was left.
    pub left: Left,
    /// Whether images taken there show the stars as sharp as they should be; `None` where there were none to tell.
    pub confirmed: Option<bool>,
}

/// The rules that the settings make.
#[derive(Debug, Clone, PartialEq)]
pub struct AutofocusRules {
    /// Images are taken for this long at most.
    pub time_allowed: Duration,
    /// The display shows the curves for this long after a run.
    pub grace: Duration,
    /// The last way to a position is upwards for this long at least, counts: no less than the backlash.
    pub backlash: i32,
    /// Furthest that a refocus goes from where the lens was, counts.
    pub refocus: i32,
    /// Growth of the blur disc's diameter away from best focus, px a count.
    pub blur_px_per_count: f64,
    /// Full width at half maximum of stars in best focus, px.
    pub sharp_width_px: f64,
}

impl AutofocusRules {
    /// The rules of section `[focus]`.
    pub fn new(settings: &FocusSettings) -> Self {
        Self {
            time_allowed: Duration::from_secs_f64(settings.time_allowed_s),
            grace: Duration::from_secs_f64(settings.grace_s),
            backlash: settings.backlash_counts,
            refocus: settings.refocus_counts,
            blur_px_per_count: settings.blur_px_per_count,
            sharp_width_px: settings.sharp_width_px,
        }
    }

    /// The width of a focus curve that these optics should have, counts: √8 of the Gaussian's σ over the growth of the disc.
    fn curve_width(&self) -> f64 {
        8f64.sqrt() * self.sharp_width_px / FWHM_PER_SIGMA / self.blur_px_per_count
    }
}

/// Full width at half maximum of a Gaussian, in σ.
const FWHM_PER_SIGMA: f64 = 2.354_820_045;
