//! The outcome: what every frame ends in, solved or not, and what a solution is.

use super::Blur;
use super::served::Served;
use super::track::{AttitudePrior, LensPrior};
use crate::image::Stamp;
use crate::sky::{Attitude, Horizontal, Mat3, Observer, RowOrder, Vec3};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;

/// How a frame ended. A closed list; the order is that of the wire codes, which begin at 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// A pointing was found and satisfies every requirement.
    Solved,
    /// Too many saturated pixels.
    Saturated,
    /// The sky is at the end of the scale.
    TooBright,
    /// Nothing stands out: a flat or blank frame.
    NoContrast,
    /// Fewer sources than a pattern needs.
    TooFewSources,
    /// Sources, but no pattern of stars fits them.
    NoMatch,
    /// A candidate that cannot be told from chance.
    Undecided,
    /// A pattern was found and refused by a requirement.
    Requirement,
    /// The frame grew too old.
    TimedOut,
    /// Given up by command.
    Aborted,
    /// Solving is switched off.
    Disabled,
    /// Replaced by a newer frame before its turn.
    Skipped,
    /// The image could not be read.
    Unreadable,
    /// The solver itself broke.
    Failed,
}

impl Reason {
    /// Whether a frame that ended so was searched to the end, and may be solved where more is known of it.
    pub fn is_for_want_of_stars(self) -> bool {
        matches!(self, Self::TooFewSources | Self::NoMatch | Self::Undecided | Self::Requirement)
    }
}

/// What the frame's own evidence says was wrong. A closed list; the order is that of the wire codes, which begin at 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum Cause {
    Overexposed,
    Saturated,
    NoContrast,
    OutOfFocus,
    Trailed,
    Clouds,
    TooFewStars,
    TooManyArtefacts,
    WrongPlatescale,
    Mirrored,
    WrongPrior,
    LensCovered,
}

impl fmt::Display for Reason {
    /// The name in JSON and logs, as in `too_few_sources`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

impl fmt::Display for Cause {
    /// The name in JSON and logs, as in `out_of_focus`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// How hard sources were searched for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SearchMode {
    /// The narrow kernel alone.
    Normal,
    /// Wide kernels too.
    Robust,
    /// Along the trails that the gondola's motion made.
    Motion,
}

/// How a pattern was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FoundBy {
    /// Near where it was expected.
    Tracked,
    /// Anywhere on the sky.
    LostInSpace,
}

/// What is known of the pointing before a frame is solved.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Prior {
    /// Estimated azimuth and elevation of the boresight, rad.
    pub horizontal: Option<(f64, f64)>,
    /// Estimated right ascension and declination of the boresight, rad.
    pub equatorial: Option<(f64, f64)>,
    /// The observer as the flight computer sent it, if fresh.
    pub observer: Option<Observer>,
    /// The attitude as earlier frames let expect it; none where a frame is to be solved by itself.
    pub attitude: Option<AttitudePrior>,
    /// Plate scale and distortion as earlier frames have shown them.
    pub lens: Option<LensPrior>,
}

/// Statistics of a whole frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Statistics {
    /// Mean of the cells' means, ADU.
    pub mean: f64,
    /// Median of the cells' standard deviations, ADU.
    pub noise: f64,
    /// Measured gain, ADU/e⁻, where enough clean cells show it.
    pub gain: Option<f64>,
    /// Saturated pixels.
    pub saturated_px: usize,
    /// Saturated pixels as a fraction of the frame.
    pub saturated_fraction: f64,
    /// Median full width at half maximum of the better sources, px.
    pub fwhm_px: Option<f64>,
    /// Lower and upper ADU of the displayed range (98 % of the pixels).
    pub level: (u16, u16),
}

/// A source that the search found, brightest first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SourceReport {
    /// Position in file order, px.
    pub x: f64,
    /// Position in file order, px.
    pub y: f64,
    /// One σ of the position per axis, px.
    pub sigma_px: f64,
    /// Flux above the surroundings, ADU.
    pub flux: f64,
    /// Matched-filter signal over noise.
    pub snr: f64,
    /// Highest pixel above the surroundings, ADU.
    pub peak: f64,
    /// Whether a pixel of it is saturated.
    pub saturated: bool,
}

/// A source and the star that it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Index into the outcome's sources.
    pub source: usize,
    /// Index into the catalogue's stars.
    pub star: usize,
    /// Star minus source along x and y, px.
    pub residual_px: (f64, f64),
}

/// A pointing.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Attitude of the camera frame in ICRS.
    pub attitude: Attitude,
    /// The same at the start of the series, where its motion is known: the attitude above is that at the middle of its light.
    pub start: Option<SeriesStart>,
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// Fitted radial distortion k1.
    pub k1: f64,
    /// Where the lens's axis meets the picture, as fitted: offsets from its centre along left and up, px.
    pub axis: (f64, f64),
    /// Covariance on the sky at the boresight: east, north, roll, rad².
    pub covariance: Mat3,
    /// One σ of the plate scale, rad/px.
    pub sigma_platescale: f64,
    /// Root mean square of the residuals per axis, px.
    pub rms_px: f64,
    /// Weighted sum of squared residuals over the degrees of freedom.
    pub chi2_per_dof: f64,
    /// Sources matched to stars.
    pub matches: Vec<Match>,
    /// Upper bound on the probability that this solution is false, log10.
    pub false_probability_log10: f64,
    /// The same pointing against the horizon, where latitude and sidereal time are known.
    pub horizontal: Option<HorizontalSolution>,
    /// Epoch that the stars were moved to, Julian year; `None` where proper motion was not applied.
    pub epoch_yr: Option<f64>,
    /// The same pointing with aberration, or on axes of date, where that was asked for; the fields above have neither.
    pub served: Option<Served>,
}

/// The pointing at the start of a series whose motion is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SeriesStart {
    /// Attitude of the camera frame in ICRS.
    pub attitude: Attitude,
    /// From there to the middle of the light, s.
    pub before_middle_s: f64,
    /// What the gyros' drift adds to the covariance of the middle, rad² per axis.
    pub variance: f64,
}

/// A pointing against the horizon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HorizontalSolution {
    /// Azimuth, elevation, roll.
    pub pointing: Horizontal,
    /// One σ along growing azimuth (on the sky) and along elevation, rad. The roll's is the equatorial one.
    pub sigma: (f64, f64),
    /// Latitude and sidereal time used.
    pub observer: Observer,
    /// Epoch of the equinox that azimuth and elevation refer to; `None` for ICRS axes.
    pub equinox_yr: Option<f64>,
    /// Whether azimuth and elevation are those seen through the air.
    pub refracted: bool,
}

/// CPU or wall time of each stage, as the caller's watch tells it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageTimes {
    /// Reading the file, where there was one.
    pub read: Duration,
    /// Statistics and level.
    pub statistics: Duration,
    /// Finding sources.
    pub find: Duration,
    /// Matching.
    pub match_: Duration,
    /// Fit and requirements.
    pub fit: Duration,
    /// From pixels in memory to outcome.
    pub total: Duration,
}

/// What every frame ends in.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// The frame's stamp.
    pub stamp: Stamp,
    /// How it ended.
    pub reason: Reason,
    /// What the frame's own evidence says was wrong.
    pub cause: Option<Cause>,
    /// How large the images of stars are where that is the cause.
    pub blur: Option<Blur>,
    /// In words: which requirement refused, its value, its limit; which limit ended the search.
    pub detail: String,
    /// Which end of the picture the first row is, where the frame was looked at: what the places of sources refer to.
    pub rows: Option<RowOrder>,
    /// Statistics, where the frame was looked at.
    pub statistics: Option<Statistics>,
    /// How the sources were searched for.
    pub mode: SearchMode,
    /// How the solution, or the candidate, was found.
    pub found_by: Option<FoundBy>,
    /// Sources found, brightest first.
    pub sources: Vec<SourceReport>,
    /// How many of them patterns were made of.
    pub sources_tried: usize,
    /// The pointing; only where `reason` is [`Reason::Solved`].
    pub solution: Option<Solution>,
    /// The best candidate that was not served: `Undecided` and `Requirement`.
    pub candidate: Option<Solution>,
    /// The last 64 triangles tried, as indices of sources.
    pub triangles: Vec<[u8; 3]>,
    /// Candidates screened.
    pub candidates_tried: u64,
    /// The prior as given.
    pub prior: Prior,
    /// Distance of the solution from the prior's pointing, rad, where it lies outside the limit (the prior was wrong).
    pub prior_disagreement: Option<f64>,
    /// Where the time went.
    pub times: StageTimes,
}

impl Outcome {
    /// An outcome that says only why: nothing was searched.
    pub fn unsolved(stamp: Stamp, reason: Reason, detail: impl Into<String>) -> Self {
        Self {
            stamp,
            reason,
            cause: None,
            blur: None,
            detail: detail.into(),
            rows: None,
            statistics: None,
            mode: SearchMode::Normal,
            found_by: None,
            sources: Vec::new(),
            sources_tried: 0,
            solution: None,
            candidate: None,
            triangles: Vec::new(),
            candidates_tried: 0,
            prior: Prior::default(),
            prior_disagreement: None,
            times: StageTimes::default(),
        }
    }
}

impl Solution {
    /// The attitude as it is served: on the axes and with the corrections that were asked for.
    pub fn served_attitude(&self) -> &Attitude {
        self.served.as_ref().map_or(&self.attitude, |served| &served.attitude)
    }

    /// The covariance of what is served, on its axes.
    pub fn served_covariance(&self) -> &Mat3 {
        self.served.as_ref().map_or(&self.covariance, |served| &served.covariance)
    }

    /// One σ east, north and in roll, rad, as it is served.
    pub fn sigmas(&self) -> Vec3 {
        self.served_covariance().diagonal().map(|variance| variance.max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_and_causes_read_as_in_json() {
        assert_eq!(Reason::TooFewSources.to_string(), "too_few_sources");
        assert_eq!(Cause::OutOfFocus.to_string(), "out_of_focus");
    }
}
