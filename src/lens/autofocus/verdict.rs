//! What the curves say: a best focus with its error, an edge, or nothing.

use super::curves::{Sample, Samples, minutes};
use super::fit::{Fit, FitPrior, Point, fit};
use super::{Metric, StarId};
use crate::command::Tick;
use serde::{Deserialize, Serialize};

/// One σ of what the best focus may drift by, counts/min, as far as it is known beforehand.
const DRIFT_SIGMA: f64 = 2.0;
/// A curve betters χ² by this much over a constant, in units of its scatter: 6 σ, as there were many to choose from.
const CLEAR_GAIN: f64 = 36.0;
/// Positions with data that a curve needs, and on either side of its peak.
const LEAST_POSITIONS: usize = 5;
const LEAST_BESIDE: usize = 2;
/// A best focus less sure than this part of the curve's width is none.
const SURE: f64 = 0.5;

/// Whose peaks a curve is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Curve {
    /// The brightest source of each image.
    Brightest,
    /// One star. Of a best focus: the stars, of which this one is the brightest.
    Star(StarId),
}

/// An end of the range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Towards the near stop.
    Low,
    /// Away from it.
    High,
}

/// A best focus.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BestFocus {
    /// Position at the time that it was asked for, approached from below, counts.
    pub counts: Metric,
    /// By what it drifts, counts/min.
    pub drift_per_min: Metric,
    /// Distance from it at which a star's peak has fallen to 63 %, counts.
    pub width_counts: f64,
    /// From which curves.
    pub curve: Curve,
}

/// What the curves say.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Verdict {
    Peak(Box<Peak>),
    Edge(Side),
    NoPeak,
    TooFew,
}

/// A valid peak.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Peak {
    fit: Fit,
    curve: Curve,
    stars: Vec<StarId>,
}

impl Peak {
    /// The best focus at a time.
    pub fn best_at(&self, now: Tick) -> BestFocus {
        let (counts, sigma) = self.fit.best_at(minutes(now));
        let (drift, drift_sigma) = self.fit.drift();
        BestFocus {
            counts: Metric { value: counts, sigma },
            drift_per_min: Metric { value: drift, sigma: drift_sigma },
            width_counts: self.fit.width(),
            curve: self.curve,
        }
    }

    /// Whether the stars tell it, not the brightest source.
    pub fn is_by_stars(&self) -> bool {
        self.curve != Curve::Brightest
    }

    /// Peaks of an image's known stars over those that the curves have at its place and time: their mean and its σ.
    pub fn against(&self, sample: &Sample) -> Option<Metric> {
        let (mut sum, mut weights) = (0.0, 0.0);
        for (star, amplitude) in self.stars.iter().zip(&self.fit.amplitudes) {
            let seen = sample.stars.iter().find(|(id, _)| id == star);
            let expected = self.fit.peak(*amplitude, f64::from(sample.position), minutes(sample.captured));
            if let Some((_, peak)) = seen
                && expected > 0.0
            {
                let weight = (expected / peak.sigma).powi(2);
                sum += weight * peak.value / expected;
                weights += weight;
            }
        }
        (weights > 0.0).then(|| Metric { value: sum / weights, sigma: weights.sqrt().recip() })
    }

    /// How far the lens stood from the best focus when an image was taken, counts.
    pub fn offset(&self, sample: &Sample) -> f64 {
        f64::from(sample.position) - self.fit.best_at(minutes(sample.captured)).0
    }
}

/// What the curves say, by stars where they have a valid peak. `visited`: positions that images were taken at; `width`: of the curve as
/// expected, counts.
pub(super) fn judge(samples: &Samples, visited: &[i32], width: f64) -> Verdict {
    let (stars, curves): (Vec<StarId>, Vec<Vec<Point>>) = samples.star_curves().into_iter().unzip();
    let prior = FitPrior { width, drift_sigma: DRIFT_SIGMA };
    let by_stars = judge_curves(&curves, visited, &prior, |fit| {
        let brightest = stars.iter().zip(&fit.amplitudes).max_by(|a, b| a.1.total_cmp(b.1));
        (Curve::Star(brightest.map_or(StarId(0), |(id, _)| *id)), stars.clone())
    });
    if let Verdict::Peak(_) | Verdict::Edge(_) = by_stars {
        return by_stars;
    }
    let by_brightest = judge_curves(&[samples.brightest_curve()], visited, &prior, |_| (Curve::Brightest, Vec::new()));
    match by_brightest {
        Verdict::TooFew => by_stars,
        other => other,
    }
}

fn judge_curves(
    curves: &[Vec<Point>],
    visited: &[i32],
    prior: &FitPrior,
    whose: impl Fn(&Fit) -> (Curve, Vec<StarId>),
) -> Verdict {
    let mut seen: Vec<f64> = curves.iter().flatten().map(|point| point.x).collect();
    seen.sort_by(f64::total_cmp);
    seen.dedup();
    if seen.len() < LEAST_POSITIONS {
        return Verdict::TooFew;
    }
    let Some(fit) = fit(curves, prior) else { return Verdict::NoPeak };
    let (best, sigma) = fit.best_at(fit.mean_time());
    if !(fit.gain > CLEAR_GAIN) || fit.amplitudes.iter().all(|height| *height <= 0.0) {
        return Verdict::NoPeak;
    }
    let below = |positions: &mut dyn Iterator<Item = f64>| positions.filter(|x| *x < best).count();
    let visited_below = below(&mut visited.iter().map(|x| f64::from(*x)));
    if visited_below < LEAST_BESIDE {
        return Verdict::Edge(Side::Low);
    }
    if visited.len() - visited_below < LEAST_BESIDE {
        return Verdict::Edge(Side::High);
    }
    let seen_below = below(&mut seen.iter().copied());
    if seen_below < LEAST_BESIDE || seen.len() - seen_below < LEAST_BESIDE || !(sigma < SURE * fit.width()) {
        return Verdict::NoPeak;
    }
    let (curve, stars) = whose(&fit);
    Verdict::Peak(Box::new(Peak { fit, curve, stars }))
}
