//! The stars of a frame: where they fall, how bright they are, and which of them could be seen.

use super::bound::{Light, photon_bound};
use super::psf::Stamp;
use super::random::{Dice, Purpose};
use super::scene::Scene;
use super::sensor::Sensor;
use super::truth::{MUST_CLIPPED_BELOW, MUST_SNR, MUST_STARS, TrueStar, Truth};
use super::{RenderSpec, backdrop::Glow};
use crate::catalog::Catalogue;
use crate::sky::Attitude;

/// RP magnitude of a star that gives 1 ADU in the mean of the exposures.
const ZERO_POINT_MAG: f64 = 13.4;
/// Scatter of the camera's band against RP, one σ, mag.
const COLOUR_SCATTER_MAG: f64 = 0.14;
/// Least SNR of a star that the truth tells of.
const TOLD_SNR: f64 = 3.0;

/// The image of one star.
#[derive(Debug, Clone)]
pub(super) struct StarImage {
    star: usize,
    flux_adu: f64,
    x: f64,
    y: f64,
    /// Its way over the sensor: x, y, weight.
    path: Vec<(f64, f64, f64)>,
    stamp: Stamp,
    /// Light of the sky under it, ADU over bias, and the fraction of all light that passes there.
    sky_adu: f64,
    passed: f64,
}

impl StarImage {
    /// Takes note of the sky's light and the dimming at its middle; a star whose middle is off the sensor has none.
    pub fn measure_sky(&mut self, light: &[f32], transmission: &[f32], width: usize) {
        let (column, row) = (self.x.round(), self.y.round());
        if column < 0.0 || row < 0.0 || column >= width as f64 {
            return;
        }
        let at = row as usize * width + column as usize;
        if let (Some(&light), Some(&passed)) = (light.get(at), transmission.get(at)) {
            (self.sky_adu, self.passed) = (f64::from(light), f64::from(passed));
        }
    }

    /// Matched-filter signal over noise; zero where its middle is off the sensor.
    fn snr(&self, sensor: &Sensor) -> f64 {
        self.flux_adu * self.passed * self.stamp.sharpness() / sensor.noise_adu(self.sky_adu * self.passed)
    }

    /// Adds its light, ADU, to an image of `width` columns.
    pub fn paint(&self, light: &mut [f32], width: usize) {
        self.stamp.paint(self.flux_adu, light, width);
    }
}

/// The images of all stars that reach the sensor, brightest first. A star that overflows adds its halo to the scene.
pub(super) fn expose(spec: &RenderSpec, scene: &mut Scene, catalogue: &Catalogue) -> Vec<StarImage> {
    let years = spec.epoch_yr - catalogue.header.epoch_yr;
    let boresight = scene.attitude.boresight();
    let radius = scene.optics.field_radius();
    let cos_radius = radius.cos();
    let declinations = {
        let dec = boresight.z.clamp(-1.0, 1.0).asin();
        dec - radius..dec + radius
    };
    let attitudes: Vec<(Attitude, f64)> =
        scene.path.iter().map(|(turn, weight)| (scene.attitude.turned(turn), *weight)).collect();
    let mut images = Vec::new();
    for (index, star) in catalogue.stars.iter().enumerate() {
        if !declinations.contains(&star.dec) {
            continue;
        }
        let direction = star.direction_after(years);
        if direction.dot(&boresight) < cos_radius {
            continue;
        }
        let path: Option<Vec<_>> = attitudes
            .iter()
            .map(|(attitude, weight)| scene.optics.to_pixel(&attitude.to_camera(&direction)).map(|(x, y)| (x, y, *weight)))
            .collect();
        let Some((path, stamp)) = path.and_then(|path| {
            let stamp = scene.psf.stamp(&path, spec.width, spec.height)?;
            Some((path, stamp))
        }) else {
            continue;
        };
        let scatter = COLOUR_SCATTER_MAG * Dice::new(spec.camera.unwrap_or(spec.seed), 0, index as u64, Purpose::Star).normal();
        let overflow = scene.overflowing.filter(|(which, _)| *which == index).map_or(1.0, |(_, times)| times);
        let mean_flux = libm::pow(10.0, 0.4 * (ZERO_POINT_MAG - f64::from(star.mag) - scatter)) * overflow;
        let flux_adu = (mean_flux * scene.sensor.sum_over_mean * scene.starlight).min(scene.most_flux_adu);
        let x = path.iter().map(|step| step.0 * step.2).sum();
        let y = path.iter().map(|step| step.1 * step.2).sum();
        if overflow > 1.0 {
            scene.backdrop.glows.push(halo(x, y, flux_adu));
        }
        images.push(StarImage { star: index, flux_adu, x, y, path, stamp, sky_adu: 0.0, passed: 0.0 });
    }
    images
}

/// Dims all stars until `count` of them are over the SNR that counts.
pub(super) fn dim_to(count: usize, images: &mut [StarImage], sensor: &Sensor) {
    let mut snrs: Vec<f64> = images.iter().map(|image| image.snr(sensor)).collect();
    snrs.sort_by(|a, b| b.total_cmp(a));
    let (Some(&last), Some(&next)) = (snrs.get(count.saturating_sub(1)), snrs.get(count)) else { return };
    // In the middle between the last that is to be seen and the next one.
    let dimming = (MUST_SNR / (last * next).sqrt()).min(1.0);
    images.iter_mut().for_each(|image| image.flux_adu *= dimming);
}

/// The light of a very bright star that the lens scatters.
fn halo(x: f64, y: f64, flux_adu: f64) -> Glow {
    /// Fraction of the flux, and distance in which the halo falls by e, px.
    const FRACTION: f64 = 0.02;
    const RADIUS_PX: f64 = 25.0;
    Glow { x, y, radius_px: RADIUS_PX, level_adu: FRACTION * flux_adu / (std::f64::consts::TAU * RADIUS_PX * RADIUS_PX) }
}

/// What the frame shows, and whether it must be solved.
pub(super) fn judge(spec: &RenderSpec, scene: &Scene, catalogue: &Catalogue, images: &[StarImage], pixels: &[u16]) -> Truth {
    let (width, height) = (spec.width, spec.height);
    let sensor = &scene.sensor;
    let full = sensor.full_scale_adu;
    let clipped_fraction = clipped(pixels, full) as f64 / pixels.len().max(1) as f64;
    let mut stars: Vec<TrueStar> = images
        .iter()
        .filter_map(|image| {
            Some(TrueStar {
                star: image.star,
                x: image.x,
                y: image.y,
                mag: catalogue.stars.get(image.star)?.mag,
                flux_adu: image.flux_adu * image.passed,
                snr: image.snr(sensor),
                clipped: is_clipped(image, pixels, width, full),
            })
        })
        .filter(|star| star.snr >= TOLD_SNR)
        .collect();
    stars.sort_by(|a, b| b.flux_adu.total_cmp(&a.flux_adu));
    let years = spec.epoch_yr - catalogue.header.epoch_yr;
    let informed = images.iter().filter_map(|image| {
        let (flux_adu, sky_adu) = (image.flux_adu * image.passed, image.sky_adu * image.passed);
        let light = Light { psf: &scene.psf, stamp: &image.stamp, path: &image.path, flux_adu, sky_adu };
        Some((catalogue.stars.get(image.star)?.direction_after(years), light.information(sensor)))
    });
    let photon_bound = if scene.stars && spec.photon_bound { photon_bound(scene, informed) } else { None };
    let stars_over_snr5 = stars.iter().filter(|star| star.snr > MUST_SNR && !star.clipped).count();
    Truth {
        kind: spec.kind,
        seed: spec.seed,
        index: spec.index,
        epoch_yr: spec.epoch_yr,
        size: (width, height),
        attitude: scene.stars.then_some(scene.attitude),
        platescale: scene.optics.platescale_at_centre(),
        k1: scene.optics.lens().k1,
        must: scene.stars && stars_over_snr5 >= MUST_STARS && clipped_fraction < MUST_CLIPPED_BELOW,
        stars_over_snr5,
        photon_bound,
        clipped_fraction,
        cause: spec.kind.cause(),
        blur_px: scene.blur_px,
        psf_sigma_px: scene.psf_sigma_px,
        sky_adu: scene.backdrop.sky_adu,
        noise_adu: sensor.noise_adu(scene.backdrop.sky_adu),
        hot_pixels: Vec::new(),
        stars,
    }
}

/// Pixels that are clipped.
fn clipped(pixels: &[u16], full: u16) -> usize {
    /// So many are counted in the width of a pixel, which makes a vector of it.
    const RUN: usize = 4096;
    let in_run = |run: &[u16]| usize::from(run.iter().map(|&pixel| u16::from(pixel >= full)).sum::<u16>());
    pixels.chunks(RUN).map(in_run).sum()
}

/// Whether a pixel that gets a good part of the star's light is clipped.
fn is_clipped(image: &StarImage, pixels: &[u16], width: usize, full: u16) -> bool {
    let peak = image.stamp.weights.iter().copied().fold(0.0, f32::max);
    image.stamp.pixels(width).any(|(at, weight)| weight > 0.3 * peak && pixels.get(at).is_some_and(|&pixel| pixel >= full))
}
