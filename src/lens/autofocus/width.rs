//! A focus estimate that moves nothing: the widths of stars over time and temperature.
//!
//! A star's image is as wide as the optics make it and the disc of the defocus, in quadrature: width² = sharp² + (rate·distance)². So a
//! width tells how far the best focus is, and not on which side: both places are given.

use super::curves::Samples;
use super::verdict::Peak;
use super::{AutofocusRules, FWHM_PER_SIGMA, FocusImage, Metric};
use crate::command::Tick;
use crate::lens::FocusCounts;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// Widths kept. Where they are too many, every other goes, and from then on only half as many are kept.
const MAX_WIDTHS: usize = 256;
/// Time between kept widths at first.
const FIRST_SPACING: Duration = Duration::from_secs(10);
/// A disc's diameter adds this part of it in quadrature to the full width at half maximum of a Gaussian of the same extent.
const WIDTH_PER_DISC: f64 = FWHM_PER_SIGMA / 4.0;
/// Widths that a mean is taken of, and that a slope needs.
const RECENT: usize = 5;
const LEAST_FOR_SLOPE: usize = 8;
/// Least σ of the temperatures that a slope needs, K.
const LEAST_SPREAD_K: f64 = 0.3;
/// Images that show the widths of a sweep.
const LEAST_FOR_CALIBRATION: usize = 6;

/// How something changes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Slope {
    /// Change of the stars' width per hour, px/h.
    pub width_px_per_hour: Option<Metric>,
    /// Change of the stars' width with the temperature of the lens, px/K.
    pub width_px_per_kelvin: Option<Metric>,
    /// Change of the distance from best focus with the temperature, counts/K; its sign is that of the distance, which is never negative.
    pub distance_counts_per_kelvin: Option<Metric>,
}

/// What the stars' widths say of the focus.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FocusEstimate {
    /// Mean width of the latest images at this position: full width at half maximum, px.
    pub width_px: Metric,
    /// Where the lens stands.
    pub position: FocusCounts,
    /// How far the best focus is, counts. On which side, widths do not tell.
    pub distance_counts: Metric,
    /// Both places that the best focus may be at, counts.
    pub best_is_at: (f64, f64),
    /// Whether the widths were calibrated by a sweep; otherwise by the settings.
    pub calibrated: bool,
    /// How it changed since the lens stands here.
    pub slope: Slope,
}

/// How wide stars are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Widths {
    /// Full width at half maximum in best focus, px.
    pub sharp_px: f64,
    /// Its growth away from there, in quadrature, px a count.
    pub px_per_count: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Width {
    at: Tick,
    px: Metric,
    temperature_c: Option<f64>,
}

/// Keeps the widths of the images since the lens stands where it stands.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct WidthMonitor {
    /// Width in best focus, px, and its growth, px a count.
    sharp_px: f64,
    rate: f64,
    calibrated: bool,
    position: Option<FocusCounts>,
    spacing: Duration,
    widths: VecDeque<Width>,
    recent: VecDeque<Metric>,
}

impl WidthMonitor {
    pub fn new(rules: &AutofocusRules) -> Self {
        Self {
            sharp_px: rules.sharp_width_px,
            rate: WIDTH_PER_DISC * rules.blur_px_per_count,
            calibrated: false,
            position: None,
            spacing: FIRST_SPACING,
            widths: VecDeque::new(),
            recent: VecDeque::new(),
        }
    }

    /// Takes an image; one without a known position says nothing.
    pub fn take(&mut self, image: &FocusImage) {
        let Some(position) = image.position else { return };
        if self.position != Some(position) {
            (self.position, self.spacing) = (Some(position), FIRST_SPACING);
            self.widths.clear();
            self.recent.clear();
        }
        let Some(px) = image.width_px.filter(|px| px.value > 0.0 && px.sigma > 0.0 && px.value.is_finite()) else { return };
        if self.recent.len() >= RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back(px);
        if self.widths.back().is_some_and(|last| image.captured < last.at + self.spacing) {
            return;
        }
        if self.widths.len() >= MAX_WIDTHS {
            let mut keep = false;
            self.widths.retain(|_| {
                keep = !keep;
                keep
            });
            self.spacing *= 2;
        }
        self.widths.push_back(Width { at: image.captured, px, temperature_c: image.temperature_c.filter(|t| t.is_finite()) });
    }

    /// Learns from a sweep how wide stars are in focus and how they grow, where enough of its images tell.
    pub fn calibrate(&mut self, peak: &Peak, samples: &Samples) {
        let pairs = samples.iter().filter_map(|sample| {
            let px = sample.width_px?;
            Some((peak.offset(sample).powi(2), px.value.powi(2), 2.0 * px.value * px.sigma))
        });
        let Some(line) = Line::through(pairs, LEAST_FOR_CALIBRATION) else { return };
        let (at_focus, growth) = (line.at(0.0), line.slope.value);
        if at_focus > 0.0 && growth > 3.0 * line.slope.sigma {
            (self.sharp_px, self.rate, self.calibrated) = (at_focus.sqrt(), growth.sqrt(), true);
        }
    }

    /// What a sweep has shown of the widths; `None` before one has.
    pub fn learned(&self) -> Option<Widths> {
        self.calibrated.then_some(Widths { sharp_px: self.sharp_px, px_per_count: self.rate })
    }

    /// Takes what an earlier sweep has shown.
    pub fn adopt(&mut self, widths: Widths) {
        (self.sharp_px, self.rate, self.calibrated) = (widths.sharp_px, widths.px_per_count, true);
    }

    /// What the widths say; `None` before the first.
    pub fn estimate(&self) -> Option<FocusEstimate> {
        let position = self.position?;
        let weights: f64 = self.recent.iter().map(|px| px.sigma.powi(-2)).sum();
        if self.recent.is_empty() || !(weights > 0.0) {
            return None;
        }
        let mean = self.recent.iter().map(|px| px.value * px.sigma.powi(-2)).sum::<f64>() / weights;
        let width_px = Metric { value: mean, sigma: weights.sqrt().recip() };
        let distance = self.distance(&width_px);
        let here = f64::from(position.0);
        Some(FocusEstimate {
            width_px,
            position,
            distance_counts: distance,
            best_is_at: (here - distance.value, here + distance.value),
            calibrated: self.calibrated,
            slope: self.slopes(),
        })
    }

    /// Distance of the best focus that a width tells. Near focus the width hardly changes, and says only that it is near.
    fn distance(&self, px: &Metric) -> Metric {
        let of = |px: f64| (px * px - self.sharp_px * self.sharp_px).max(0.0).sqrt() / self.rate;
        let (low, value, high) = (of(px.value - px.sigma), of(px.value), of(px.value + px.sigma));
        Metric { value, sigma: (0.5 * (high - low)).max(high - value) }
    }

    fn slopes(&self) -> Slope {
        let hours = |at: Tick| at.as_secs_f64() / 3600.0;
        let over_time = self.widths.iter().map(|w| (hours(w.at), w.px.value, w.px.sigma));
        let warm = || self.widths.iter().filter_map(|w| Some((w.temperature_c?, w.px)));
        let spread = |line: Line| (line.spread > LEAST_SPREAD_K).then_some(line.slope);
        let distances = warm().map(|(t, px)| (t, self.distance(&px))).map(|(t, d)| (t, d.value, d.sigma));
        Slope {
            width_px_per_hour: Line::through(over_time, LEAST_FOR_SLOPE).map(|line| line.slope),
            width_px_per_kelvin: Line::through(warm().map(|(t, px)| (t, px.value, px.sigma)), LEAST_FOR_SLOPE).and_then(spread),
            distance_counts_per_kelvin: Line::through(distances, LEAST_FOR_SLOPE).and_then(spread),
        }
    }
}

/// A straight line by weighted least squares, its errors scaled up by the scatter.
#[derive(Debug, Clone, Copy)]
struct Line {
    mean_x: f64,
    mean_y: f64,
    slope: Metric,
    /// Standard deviation of the abscissae.
    spread: f64,
}

impl Line {
    /// Through points (x, y, σ of y), of which there must be some.
    fn through(points: impl Iterator<Item = (f64, f64, f64)>, least: usize) -> Option<Self> {
        let points: Vec<_> = points.filter(|(x, y, sigma)| x.is_finite() && y.is_finite() && *sigma > 0.0).collect();
        if points.len() < least.max(3) {
            return None;
        }
        let sum = |of: &dyn Fn(f64, f64) -> f64| points.iter().map(|(x, y, s)| of(*x, *y) / (s * s)).sum::<f64>();
        let weights = sum(&|_, _| 1.0);
        let (mean_x, mean_y) = (sum(&|x, _| x) / weights, sum(&|_, y| y) / weights);
        let (xx, xy) = (sum(&|x, _| (x - mean_x).powi(2)), sum(&|x, y| (x - mean_x) * (y - mean_y)));
        let slope = xy / xx;
        let chi2 = sum(&|x, y| (y - mean_y - slope * (x - mean_x)).powi(2)) / (points.len() - 2) as f64;
        let sigma = (chi2.max(1.0) / xx).sqrt();
        let sound = slope.is_finite() && sigma.is_finite();
        sound.then_some(Self { mean_x, mean_y, slope: Metric { value: slope, sigma }, spread: (xx / weights).sqrt() })
    }

    fn at(&self, x: f64) -> f64 {
        self.mean_y + self.slope.value * (x - self.mean_x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::ImageCounter;

    fn rules() -> AutofocusRules {
        AutofocusRules::new(&crate::settings::Settings::flight().unwrap().focus)
    }

    fn image(seconds: u64, position: i32, width: f64, temperature_c: f64) -> FocusImage {
        FocusImage {
            counter: ImageCounter(0),
            captured: Duration::from_secs(seconds),
            position: Some(FocusCounts(position)),
            brightest: None,
            stars: Vec::new(),
            width_px: Some(Metric { value: width, sigma: 0.05 * width }),
            temperature_c: Some(temperature_c),
        }
    }

    #[test]
    fn a_width_tells_how_far_the_best_focus_is_and_both_sides_are_given() {
        let rules = rules();
        let mut monitor = WidthMonitor::new(&rules);
        assert_eq!(monitor.estimate(), None);
        for i in 0..5 {
            let disc = rules.blur_px_per_count * 100.0;
            monitor.take(&image(20 * i, 3000, rules.sharp_width_px.hypot(WIDTH_PER_DISC * disc), -20.0));
        }
        let estimate = monitor.estimate().unwrap();
        assert!((estimate.distance_counts.value - 100.0).abs() < 1e-6);
        assert!((estimate.best_is_at.0 - 2900.0).abs() < 1e-6 && (estimate.best_is_at.1 - 3100.0).abs() < 1e-6);
        assert!(estimate.distance_counts.sigma > 1.0 && estimate.distance_counts.sigma < 20.0);
    }

    #[test]
    fn drift_with_temperature_is_found_over_days_in_bounded_memory_and_forgotten_after_a_move() {
        let mut monitor = WidthMonitor::new(&rules());
        // 2 to 12 px in two days of cooling by 20 K, an image every 40 s.
        const IMAGES: u64 = 2 * 86_400 / 40;
        for i in 0..IMAGES {
            let part = i as f64 / IMAGES as f64;
            monitor.take(&image(40 * i, 3000, 2.0 + 10.0 * part, -20.0 - 20.0 * part));
        }
        assert!(monitor.widths.len() <= MAX_WIDTHS);
        let slope = monitor.estimate().unwrap().slope;
        let (hour, kelvin) = (slope.width_px_per_hour.unwrap(), slope.width_px_per_kelvin.unwrap());
        assert!((hour.value - 10.0 / 48.0).abs() < 0.01, "{hour:?}");
        assert!((kelvin.value + 0.5).abs() < 0.02, "{kelvin:?}");
        assert!(slope.distance_counts_per_kelvin.unwrap().value < -10.0);
        monitor.take(&image(40 * IMAGES, 3010, 2.0, -40.0));
        assert_eq!(monitor.estimate().unwrap().slope.width_px_per_hour, None);
    }
}
