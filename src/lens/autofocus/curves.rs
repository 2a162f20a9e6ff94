//! The curves that a run collects: peaks against position, of each star and of the brightest source.

use super::fit::Point;
use super::verdict::Curve;
use super::{FocusImage, Metric, StarId};
use crate::command::Tick;
use crate::lens::FocusCounts;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};

/// Images kept: a sweep of the full range with the finest step has 100, and two passes about the peak.
const MAX_IMAGES: usize = 400;
/// Stars kept of an image, the highest peaks.
const MAX_STARS: usize = 24;

/// What an image taken at a known position showed.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sample {
    pub position: i32,
    pub captured: Tick,
    pub brightest: Option<Metric>,
    pub stars: Vec<(StarId, Metric)>,
    pub width_px: Option<Metric>,
}

/// A point of a curve, for the display.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Which curve.
    pub curve: Curve,
    /// Position.
    pub position: FocusCounts,
    /// Peak, ADU.
    pub peak: Metric,
}

/// What a run has seen.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Samples(VecDeque<Sample>);

impl Samples {
    /// Takes an image that was taken at a position that counts.
    pub fn add(&mut self, position: i32, image: &FocusImage) {
        let sound = |metric: &Metric| metric.value.is_finite() && metric.sigma.is_finite() && metric.sigma > 0.0;
        let mut stars: Vec<_> = image.stars.iter().filter(|(_, peak)| sound(peak)).copied().collect();
        stars.sort_by(|a, b| b.1.value.total_cmp(&a.1.value));
        stars.truncate(MAX_STARS);
        if self.0.len() >= MAX_IMAGES {
            self.0.pop_front();
        }
        let (brightest, width_px) = (image.brightest.filter(sound), image.width_px.filter(sound));
        self.0.push_back(Sample { position, captured: image.captured, brightest, stars, width_px });
    }

    /// All that was seen.
    pub fn iter(&self) -> impl Iterator<Item = &Sample> {
        self.0.iter()
    }

    /// The stars' curves, of those seen at two positions or more.
    pub fn star_curves(&self) -> Vec<(StarId, Vec<Point>)> {
        let mut curves: BTreeMap<StarId, Vec<Point>> = BTreeMap::new();
        for sample in &self.0 {
            for (star, peak) in &sample.stars {
                curves.entry(*star).or_default().push(point(sample, peak));
            }
        }
        curves.into_iter().filter(|(_, points)| has_two_places(points)).collect()
    }

    /// The curve of the brightest source.
    pub fn brightest_curve(&self) -> Vec<Point> {
        self.0.iter().filter_map(|sample| Some(point(sample, sample.brightest.as_ref()?))).collect()
    }

    /// All points, for the display.
    pub fn points(&self) -> Vec<CurvePoint> {
        let of = |sample: &Sample, curve, peak| CurvePoint { curve, position: FocusCounts(sample.position), peak };
        let brightest = self.0.iter().filter_map(|sample| Some(of(sample, Curve::Brightest, sample.brightest?)));
        let stars = self.0.iter().flat_map(|sample| sample.stars.iter().map(|(id, peak)| of(sample, Curve::Star(*id), *peak)));
        brightest.chain(stars).collect()
    }
}

fn point(sample: &Sample, peak: &Metric) -> Point {
    Point { x: f64::from(sample.position), t: minutes(sample.captured), y: peak.value, sigma: peak.sigma }
}

fn has_two_places(points: &[Point]) -> bool {
    points.first().is_some_and(|first| points.iter().any(|point| point.x != first.x))
}

/// A time in minutes, as the fit has it.
pub(super) fn minutes(at: Tick) -> f64 {
    at.as_secs_f64() / 60.0
}
