//! How well a frame's light lets its attitude be known: the bound that no solver beats.
//!
//! Cramér and Rao: no unbiased estimate has a covariance below the inverse of the information. The pixels tell of a star's place θ
//! Σ (∂λ/∂θ)(∂λ/∂θ)ᵀ / var, λ the light that falls on a pixel and var its noise (photons of star and sky, reading, fixed pattern,
//! rounding), over all pixels that are not clipped, as if flux and sky were known. The frame's information on attitude and plate scale
//! (the lens known but for it) is Σ JᵀFJ over all stars of the catalogue, J being how each star's place moves with them.

use super::psf::{Psf, Stamp};
use super::scene::Scene;
use super::sensor::Sensor;
use crate::sky::{Attitude, Vec3};
use nalgebra::{Matrix2, Matrix2x4, Matrix4, Vector2};

/// Least σ of a frame's attitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhotonBound {
    /// Of the boresight on the sky, rms of its two axes, rad.
    pub axis: f64,
    /// Of the turn about the boresight, rad.
    pub roll: f64,
}

/// A star's light on the sensor.
pub(super) struct Light<'a> {
    pub psf: &'a Psf,
    pub stamp: &'a Stamp,
    /// Way of the star over the sensor: x, y, weight.
    pub path: &'a [(f64, f64, f64)],
    pub flux_adu: f64,
    pub sky_adu: f64,
}

impl Light<'_> {
    /// What the pixels tell of the star's place, px⁻².
    pub fn information(&self, sensor: &Sensor) -> Matrix2<f64> {
        /// Half the step over which slopes are taken, px: far below the width of any star.
        const STEP_PX: f64 = 0.05;
        let moved = |dx: f64, dy: f64| {
            let path: Vec<_> = self.path.iter().map(|&(x, y, weight)| (x + dx, y + dy, weight)).collect();
            let mut stamp = self.stamp.clone();
            self.psf.fill(&path, &mut stamp);
            stamp.weights
        };
        let (right, left) = (moved(STEP_PX, 0.0), moved(-STEP_PX, 0.0));
        let (above, below) = (moved(0.0, STEP_PX), moved(0.0, -STEP_PX));
        let along_x = right.iter().zip(&left);
        let along_y = above.iter().zip(&below);
        let mut information = Matrix2::zeros();
        for ((weight, (right, left)), (above, below)) in self.stamp.weights.iter().zip(along_x).zip(along_y) {
            let light = self.sky_adu + self.flux_adu * f64::from(*weight);
            if light < sensor.full_light_adu() {
                let per_px = self.flux_adu / (2.0 * STEP_PX);
                let slope = Vector2::new(f64::from(right - left), f64::from(above - below)) * per_px;
                information += slope * slope.transpose() / sensor.noise_adu(light).powi(2);
            }
        }
        information
    }
}

/// The bound of a frame whose stars are in these directions and have this information on their places; `None` where they are too few.
pub(super) fn photon_bound(scene: &Scene, stars: impl Iterator<Item = (Vec3, Matrix2<f64>)>) -> Option<PhotonBound> {
    let mut information = Matrix4::zeros();
    for (direction, of_place) in stars {
        if let Some(moves) = moves(scene, &direction) {
            information += moves.transpose() * of_place * moves;
        }
    }
    let variances = information.cholesky()?.inverse().diagonal();
    let bound = PhotonBound { axis: (0.5 * (variances.x + variances.y)).sqrt(), roll: variances.z.sqrt() };
    (bound.axis.is_finite() && bound.roll.is_finite()).then_some(bound)
}

/// How a star's place moves, px, with a turn about left, up and boresight, rad, and with the logarithm of the plate scale.
fn moves(scene: &Scene, direction: &Vec3) -> Option<Matrix2x4<f64>> {
    /// Half the turn over which slopes are taken, rad.
    const STEP: f64 = 1e-6;
    let place = |attitude: &Attitude| scene.optics.to_pixel(&attitude.to_camera(direction)).map(|(x, y)| Vector2::new(x, y));
    let with = |axis: Vec3| {
        let (ahead, behind) = (scene.attitude.turned(&(axis * STEP)), scene.attitude.turned(&(axis * -STEP)));
        Some((place(&ahead)? - place(&behind)?) / (2.0 * STEP))
    };
    let centre = scene.optics.to_pixel(&Vec3::z())?;
    let from_centre = place(&scene.attitude)? - Vector2::new(centre.0, centre.1);
    Some(Matrix2x4::from_columns(&[with(Vec3::x())?, with(Vec3::y())?, with(Vec3::z())?, -from_centre]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_round_star_on_bright_sky_has_the_information_of_the_textbook() {
        let sensor = Sensor::mean_of_four();
        let (sigma, flux, sky) = (1.2, 300.0, 1500.0);
        let psf = Psf::new(sigma, 0.0);
        for phase in [0.0, 0.3, 0.5] {
            let path = [(30.0 + phase, 31.0, 1.0)];
            let stamp = psf.stamp(&path, 60, 60).unwrap();
            let light = Light { psf: &psf, stamp: &stamp, path: &path, flux_adu: flux, sky_adu: sky };
            let information = light.information(&sensor);
            // Σ (∂λ/∂x)² of a Gaussian is F²/(8πσ⁴); a pixel widens it by a twelfth.
            let width = sigma * sigma + 1.0 / 12.0;
            let expected = flux * flux / (8.0 * std::f64::consts::PI * width * width) / sensor.noise_adu(sky).powi(2);
            let got = (information.m11, information.m22);
            assert!((got.0 / expected - 1.0).abs() < 0.05 && (got.1 / expected - 1.0).abs() < 0.05, "{got:?} {expected}");
            assert!(information.m12.abs() < 0.01 * expected);
        }
    }
}
