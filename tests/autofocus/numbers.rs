//! A sky of numbers: stars of a field that drifts by, their peaks as discs blurred by a Gaussian have them, with their noise.

use super::world::Exposure;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use stars::image::ImageCounter;
use stars::lens::autofocus::{FocusImage, Metric, StarId};
use std::f64::consts::{PI, TAU};
use std::time::Duration;

/// The field, deg; stars to 10 mag in a square degree, and how many more there are a magnitude (log10).
const FIELD_DEG: (f64, f64) = (4.0, 2.7);
const STARS_PER_DEG2: f64 = 9.0;
const GROWTH_PER_MAG: f64 = 0.45;
/// Magnitude of a star of 1 ADU; noise of a pixel, ADU; ADU per electron.
const ZERO_MAG: f64 = 13.4;
const NOISE_ADU: f64 = 8.5;
const GAIN: f64 = 0.04;
/// A hot pixel that is mistaken for the brightest source where stars are faint, ADU.
const HOT_ADU: f64 = 40.0;
const SATURATED_ADU: f64 = 2500.0;
/// A star is found over this SNR; a frame with this many is solved.
const FOUND_SNR: f64 = 5.0;
const SOLVED_STARS: usize = 6;

/// The sky.
pub struct Numbers {
    /// Along the drift, across it, flux.
    stars: Vec<(f64, f64, f64)>,
    psf_sigma_px: f64,
    random: ChaCha8Rng,
    /// Drift of the gondola, deg/min.
    pub drift_deg_min: f64,
    /// Part of the frames that are not solved.
    pub unsolved: f64,
}

impl Numbers {
    /// A sky by a seed, long enough for two hours.
    pub fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let length = FIELD_DEG.0 + 130.0;
        let count = (STARS_PER_DEG2 * length * FIELD_DEG.1) as usize;
        let stars = (0..count)
            .map(|_| {
                let magnitude = 10.0 + random.random_range(1e-6f64..1.0).log10() / GROWTH_PER_MAG;
                let flux = 10f64.powf(0.4 * (ZERO_MAG - magnitude));
                (random.random_range(0.0..length), random.random_range(0.0..FIELD_DEG.1), flux)
            })
            .collect();
        let psf_sigma_px = random.random_range(0.85..1.2);
        Self { stars, psf_sigma_px, random, drift_deg_min: 1.0, unsolved: 0.3 }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    /// What an exposure shows.
    pub fn show(&mut self, exposure: &Exposure) -> FocusImage {
        let left = self.drift_deg_min * exposure.time_s / 60.0;
        let seen: Vec<(usize, f64)> = (0..self.stars.len())
            .filter(|i| (left..left + FIELD_DEG.0).contains(&self.stars[*i].0))
            .map(|i| (i, self.stars[i].2))
            .collect();
        let variance = self.psf_sigma_px.powi(2) + exposure.disc_px.powi(2) / 16.0;
        let mut stars: Vec<(StarId, Metric)> = Vec::new();
        for (i, flux) in seen {
            if flux / (NOISE_ADU * (4.0 * PI * variance).sqrt()) > FOUND_SNR {
                let peak = self.peak(flux, exposure.disc_px, variance);
                if peak < SATURATED_ADU {
                    stars.push((StarId(i as u32), metric(peak)));
                }
            }
        }
        let hot = HOT_ADU + NOISE_ADU * self.normal();
        let brightest = stars.iter().map(|(_, peak)| peak.value).fold(hot, f64::max);
        let solved = stars.len() >= SOLVED_STARS && self.random.random_range(0.0..1.0) >= self.unsolved;
        let width = 2.355 * variance.sqrt();
        FocusImage {
            counter: ImageCounter(exposure.index),
            captured: Duration::from_secs_f64(exposure.time_s),
            position: exposure.position,
            brightest: Some(metric(brightest)),
            stars: if solved { stars } else { Vec::new() },
            width_px: (exposure.disc_px < 14.0)
                .then(|| Metric { value: width * (1.0 + 0.03 * self.normal()), sigma: 0.05 * width }),
            temperature_c: Some(-20.0),
        }
    }

    /// The highest pixel of a star: what the disc has in its middle, less where no pixel lies there, and the noise of all that compete.
    fn peak(&mut self, flux: f64, disc_px: f64, variance: f64) -> f64 {
        let s2 = self.psf_sigma_px.powi(2);
        let u = disc_px.powi(2) / (8.0 * s2);
        let middle = flux / (TAU * s2) * if u > 1e-6 { (1.0 - (-u).exp()) / u } else { 1.0 };
        let (dx, dy) = (self.random.random_range(-0.5..0.5f64), self.random.random_range(-0.5..0.5f64));
        let height = middle * (-(dx * dx + dy * dy) / (2.0 * (variance + 1.0 / 12.0))).exp();
        let pixels = (PI / 4.0 * (disc_px - 2.0 * self.psf_sigma_px).max(0.0).powi(2)).max(1.0) as usize;
        let noise = (NOISE_ADU.powi(2) + GAIN * height).sqrt();
        let highest = (0..pixels).map(|_| self.normal()).fold(f64::NEG_INFINITY, f64::max);
        (height + noise * highest).max(1.0)
    }
}

fn metric(peak: f64) -> Metric {
    Metric { value: peak, sigma: (NOISE_ADU.powi(2) + GAIN * peak + (0.08 * peak).powi(2)).sqrt() }
}
