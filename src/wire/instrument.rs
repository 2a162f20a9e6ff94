//! Lens and focus as an update tells them.

use super::code::codes;
use super::element::body;
use super::{Coded, I32Le, Maybe, Text, U16Le, U32Le};
use crate::lens::autofocus::{AutofocusStatus, Ending, FocusEstimate, Mode};
use crate::lens::{Doubt, LensState};

codes!(Doubt {
    1 NoLens "no_lens",
    2 NeverRead "never_read",
    3 Requested "requested",
    4 NotReadBack "not_read_back",
    5 TimedOut "timed_out",
    6 UnexpectedReply "unexpected_reply",
    7 Refused "refused",
    8 PortLost "port_lost",
    9 NotLearned "not_learned",
    10 PowerCycled "power_cycled",
    11 CountsLost "counts_lost",
    12 Missed "missed",
});

codes!(Mode {
    1 NotRunning "not_running",
    2 Running "running",
    3 Grace "grace",
});

/// How a run of the autofocus ended, without what it found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum FocusEnding {
    Found,
    EdgeLow,
    EdgeHigh,
    NoPeak,
    TooFew,
    NotConfirmed,
    TimedOut,
    Aborted,
    Stopped,
    LensFailed,
    Better,
    Worse,
}

codes!(FocusEnding {
    1 Found "found",
    2 EdgeLow "edge_low",
    3 EdgeHigh "edge_high",
    4 NoPeak "no_peak",
    5 TooFew "too_few",
    6 NotConfirmed "not_confirmed",
    7 TimedOut "timed_out",
    8 Aborted "aborted",
    9 Stopped "stopped",
    10 LensFailed "lens_failed",
    11 Better "better",
    12 Worse "worse",
});

body! {
    /// What is known of the lens besides where it is.
    pub struct Lens {
        /// The controller answers.
        lens_connected: bool => "";
        /// A move has begun, and its reply has not come.
        lens_moving: bool => "";
        /// Nothing moves by itself until a command moves it.
        lens_stopped: bool => "";
        /// Why the focus is not known, where it is not and does not move.
        focus_doubt: Maybe<Coded<Doubt>> => "";
        /// Why the aperture is not known.
        aperture_doubt: Maybe<Coded<Doubt>> => "";
        /// Focus range that the controller has learned.
        focus_range: Maybe<FocusRange> => "";
        /// Requests that are not answered to their end.
        lens_requests: u8 => "";
        /// What went wrong with the lens since the start.
        lens_errors: U32Le => "";
        /// The last of it, in words.
        lens_last_error: Text<64> => "";
    }
}

body! {
    /// A focus range.
    pub struct FocusRange {
        /// Nearest focus.
        focus_nearest_counts: I32Le => "counts";
        /// Furthest focus.
        focus_furthest_counts: I32Le => "counts";
    }
}

body! {
    /// The autofocus.
    pub struct Focus {
        /// What it is at.
        autofocus_mode: Coded<Mode> => "";
        /// Where it sent the lens last.
        autofocus_requested_counts: Maybe<I32Le> => "counts";
        /// Time since its last run began.
        autofocus_run_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time for which its run may still take images.
        autofocus_time_left_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Images of this run, or of the last, that counted.
        autofocus_images: U16Le => "";
        /// Best focus as this run, or the last that knew, has it.
        autofocus_best: Maybe<Best> => "";
        /// How the last run ended.
        autofocus_ending: Maybe<Coded<FocusEnding>> => "";
        /// What the stars' widths say without a move.
        focus_estimate: Maybe<WidthEstimate> => "";
    }
}

body! {
    /// A best focus.
    pub struct Best {
        /// Position.
        best_focus_counts: f64 => "counts" [-1e6, 1e6];
        /// One standard deviation.
        sigma_best_focus_counts: f64 => "counts" [0.0, 1e6];
        /// By what it drifts.
        best_focus_drift_counts_min: f64 => "counts/min" [-1e6, 1e6];
    }
}

body! {
    /// What the stars' widths say of the focus without a move: how far the best one is, and not on which side.
    pub struct WidthEstimate {
        /// Full width at half maximum of the stars at this position.
        star_width_px: f64 => "px" [0.0, 1e4];
        /// Distance of the best focus.
        focus_distance_counts: f64 => "counts" [0.0, 1e6];
        /// One standard deviation of it.
        sigma_focus_distance_counts: f64 => "counts" [0.0, 1e6];
        /// Measured against a sweep; otherwise against the settings.
        focus_distance_calibrated: bool => "";
        /// Change of the width with time.
        star_width_px_per_hour: Maybe<f64> => "px/h" [-1e6, 1e6];
        /// Change of the width with the lens's temperature.
        star_width_px_per_kelvin: Maybe<f64> => "px/K" [-1e6, 1e6];
    }
}

impl Lens {
    /// From what is known; `requests`: those not answered to their end.
    pub fn new(lens: &LensState, requests: usize) -> Self {
        let range = lens.range.map(|(nearest, furthest)| FocusRange {
            focus_nearest_counts: nearest.0.into(),
            focus_furthest_counts: furthest.0.into(),
        });
        Self {
            lens_connected: lens.connected,
            lens_moving: lens.focus.is_moving() || lens.aperture.is_moving(),
            lens_stopped: lens.stopped,
            focus_doubt: lens.focus.doubt().into(),
            aperture_doubt: lens.aperture.doubt().into(),
            focus_range: range.into(),
            lens_requests: u8::try_from(requests).unwrap_or(u8::MAX),
            lens_errors: lens.errors.values().fold(0, |sum: u32, count| sum.saturating_add(*count)).into(),
            lens_last_error: Text::new(lens.last_error.as_deref().unwrap_or_default()),
        }
    }
}

impl Focus {
    /// From what the autofocus says.
    pub fn new(status: &AutofocusStatus) -> Self {
        let best = status.best.map(|best| Best {
            best_focus_counts: best.counts.value,
            sigma_best_focus_counts: best.counts.sigma,
            best_focus_drift_counts_min: best.drift_per_min.value,
        });
        Self {
            autofocus_mode: status.mode.into(),
            autofocus_requested_counts: status.requested.map(|counts| counts.0).into(),
            autofocus_run_age_s: status.run_age.map(|age| age.as_secs_f64()).into(),
            autofocus_time_left_s: status.time_left.map(|left| left.as_secs_f64()).into(),
            autofocus_images: u16::try_from(status.images).unwrap_or(u16::MAX).into(),
            autofocus_best: best.into(),
            autofocus_ending: status.last.as_ref().map(|finding| FocusEnding::of(&finding.ending)).into(),
            focus_estimate: status.estimate.as_ref().map(WidthEstimate::new).into(),
        }
    }
}

impl FocusEnding {
    fn of(ending: &Ending) -> Self {
        use crate::lens::autofocus::Side;
        match ending {
            Ending::Found => Self::Found,
            Ending::Edge(Side::Low) => Self::EdgeLow,
            Ending::Edge(Side::High) => Self::EdgeHigh,
            Ending::NoPeak => Self::NoPeak,
            Ending::TooFew => Self::TooFew,
            Ending::NotConfirmed => Self::NotConfirmed,
            Ending::TimedOut => Self::TimedOut,
            Ending::Aborted => Self::Aborted,
            Ending::Stopped => Self::Stopped,
            Ending::LensFailed(_) => Self::LensFailed,
            Ending::Better(_) => Self::Better,
            Ending::Worse(_) => Self::Worse,
        }
    }
}

impl WidthEstimate {
    fn new(estimate: &FocusEstimate) -> Self {
        Self {
            star_width_px: estimate.width_px.value,
            focus_distance_counts: estimate.distance_counts.value,
            sigma_focus_distance_counts: estimate.distance_counts.sigma,
            focus_distance_calibrated: estimate.calibrated,
            star_width_px_per_hour: estimate.slope.width_px_per_hour.map(|slope| slope.value).into(),
            star_width_px_per_kelvin: estimate.slope.width_px_per_kelvin.map(|slope| slope.value).into(),
        }
    }
}
