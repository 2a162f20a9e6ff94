//! The fit: attitude, plate scale and radial distortion from matched sources, with their covariance.

#![allow(clippy::indexing_slicing, reason = "matrices of a fixed size, indexed by constants below it")]

use crate::sky::{Attitude, Mat3, Vec3};
use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

/// A source and the star that it is taken for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Observed offset from the centre along left, px.
    pub left: f64,
    /// Observed offset from the centre along up, px.
    pub up: f64,
    /// Inverse of the covariance of the two offsets: left-left, up-up, left-up, px⁻².
    pub information: (f64, f64, f64),
    /// The star's direction, ICRS.
    pub star: Vec3,
}

impl Pair {
    /// A source that is known as well along left as along up: one σ of either, px.
    pub fn round(left: f64, up: f64, sigma: f64, star: Vec3) -> Self {
        let weight = 1.0 / (sigma * sigma);
        Self { left, up, information: (weight, weight, 0.0), star }
    }

    /// A source whose offsets have a covariance: left-left, up-up, left-up, px².
    pub fn with_covariance(left: f64, up: f64, (uu, vv, uv): (f64, f64, f64), star: Vec3) -> Self {
        let det = uu * vv - uv * uv;
        Self { left, up, information: (vv / det, uu / det, -uv / det), star }
    }

    /// Squared distance of an offset from the source's, in σ².
    pub fn distance_sq(&self, left: f64, up: f64) -> f64 {
        let (du, dv) = (self.left - left, self.up - up);
        let (uu, vv, uv) = self.information;
        uu * du * du + vv * dv * dv + 2.0 * uv * du * dv
    }
}

/// How the camera stands and projects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Attitude of the camera frame.
    pub attitude: Attitude,
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// Radial distortion at the half diagonal.
    pub k1: f64,
}

impl Pose {
    /// Offsets from the centre along left and up, px, at which a direction is seen; `None` behind the camera.
    pub fn project(&self, star: &Vec3, half_diagonal_px: f64) -> Option<(f64, f64)> {
        let c = self.attitude.to_camera(star);
        if c.z <= 0.0 {
            return None;
        }
        let (u, v) = (c.x / c.z / self.platescale, c.y / c.z / self.platescale);
        let stretch = 1.0 + self.k1 * (u * u + v * v) / (half_diagonal_px * half_diagonal_px);
        Some((u * stretch, v * stretch))
    }
}

/// Number of fitted parameters: rotation about left, up and boresight, ln plate scale, k1.
const PARAMETERS: usize = 5;
type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
type Vector = SVector<f64, PARAMETERS>;

/// What is known before the fit, as one σ each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitPrior {
    /// Plate scale in the middle of its range, rad/px.
    pub platescale: f64,
    /// σ of ln plate scale.
    pub sigma_ln_platescale: f64,
    /// k1.
    pub k1: f64,
    /// σ of k1.
    pub sigma_k1: f64,
}

/// A fitted pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: Pose,
    /// Covariance of the parameters: rotation about left, up, boresight (rad), ln plate scale, k1. As the σ of the sources say, not inflated.
    covariance: Matrix,
    /// Sum of squared residuals over σ², both axes.
    pub chi2: f64,
    /// Number of pairs.
    pub pairs: usize,
}

impl Fit {
    /// χ² per degree of freedom. The priors count as far as they hold a parameter, so two numbers a pair less three for the attitude and
    /// one for the plate scale are left.
    pub fn chi2_per_dof(&self) -> f64 {
        self.chi2 / (2 * self.pairs).saturating_sub(4).max(1) as f64
    }

    /// ln of the part of all attitudes, and of the plate scales and distortions of the prior, that fit as well as this pose does:
    /// Laplace's approximation of the mean likelihood over all of them, relative to that of the fit.
    pub fn ln_peak(&self, prior: &FitPrior) -> f64 {
        let ln_gaussian = |off: f64, sigma: f64| -0.5 * (off / sigma).powi(2) - (TAU.sqrt() * sigma).ln();
        // Four pi of boresights and two pi of rolls.
        let ln_attitudes = (2.0 * TAU * TAU).ln();
        let ln_volume = 0.5 * (PARAMETERS as f64 * TAU.ln() + self.covariance.determinant().max(f64::MIN_POSITIVE).ln());
        ln_volume - ln_attitudes
            + ln_gaussian((self.pose.platescale / prior.platescale).ln(), prior.sigma_ln_platescale)
            + ln_gaussian(self.pose.k1 - prior.k1, prior.sigma_k1)
    }

    /// Covariance on the sky at the boresight: east, north, roll (position angle of up), rad²; and σ of ln plate scale.
    ///
    /// Inflated by χ² per degree of freedom where the residuals are larger than the σ of the sources explain.
    pub fn sky_covariance(&self) -> (Mat3, f64) {
        let jacobian = sky_jacobian(&self.pose.attitude);
        let rotation: Mat3 = self.covariance.fixed_view::<3, 3>(0, 0).into();
        let inflation = self.chi2_per_dof().max(1.0);
        let sky = jacobian * rotation * jacobian.transpose() * inflation;
        ((sky + sky.transpose()) * 0.5, (self.covariance[(3, 3)].max(0.0) * inflation).sqrt())
    }
}

/// How a turn of the camera, about left, up and boresight, moves the boresight east and north on the sky and changes the roll.
pub fn sky_jacobian(attitude: &Attitude) -> Mat3 {
    let (_, dec, roll) = attitude.angles();
    let (sin, cos) = roll.sin_cos();
    // Rotations (about left, up, boresight) move the boresight by (left, up) = (ω_up, −ω_left).
    // Going east turns the local north under a picture that keeps its direction: tan δ of roll for each radian.
    let east = [-sin, cos, 0.0];
    let north = [-cos, -sin, 0.0];
    let slope = dec.tan();
    Mat3::new(
        east[0],
        east[1],
        0.0, //
        north[0],
        north[1],
        0.0, //
        slope * east[0],
        slope * east[1],
        -1.0,
    )
}

/// Weighted least squares by Gauss–Newton from a near start.
///
/// `None` where there are too few pairs, one lies behind the camera, or the steps do not settle.
pub fn fit(pairs: &[Pair], start: &Pose, half_diagonal_px: f64, prior: &FitPrior) -> Option<Fit> {
    const STEPS: usize = 8;
    /// A step this small, in px at the corner, ends the fit.
    const SETTLED_PX: f64 = 1e-4;
    if pairs.len() < 2 {
        return None;
    }
    let mut pose = *start;
    for step in 0..STEPS {
        let (normal, gradient, chi2) = normal_equations(pairs, &pose, half_diagonal_px, prior)?;
        let covariance = normal.cholesky()?.inverse();
        let delta = covariance * gradient;
        if !delta.iter().all(|d| d.is_finite()) {
            return None;
        }
        pose.attitude = pose.attitude.turned(&Vec3::new(delta[0], delta[1], delta[2]));
        pose.platescale *= delta[3].clamp(-0.5, 0.5).exp();
        pose.k1 += delta[4];
        let moved_px = (delta[0].abs() + delta[1].abs()) / pose.platescale
            + (delta[2].abs() + delta[3].abs() + delta[4].abs()) * half_diagonal_px;
        if moved_px < SETTLED_PX || step == STEPS - 1 {
            return (moved_px < 1.0).then_some(Fit { pose, covariance, chi2, pairs: pairs.len() });
        }
    }
    None
}

/// Normal matrix and gradient of the weighted problem with its priors, and χ² of the pairs alone.
fn normal_equations(pairs: &[Pair], pose: &Pose, half_diagonal_px: f64, prior: &FitPrior) -> Option<(Matrix, Vector, f64)> {
    let s = pose.platescale;
    let k_over_r2 = pose.k1 / (half_diagonal_px * half_diagonal_px);
    let mut normal = Matrix::zeros();
    let mut gradient = Vector::zeros();
    let mut chi2 = 0.0;
    for pair in pairs {
        let c = pose.attitude.to_camera(&pair.star);
        if c.z <= 0.0 {
            return None;
        }
        let (tx, ty) = (c.x / c.z, c.y / c.z);
        let (u, v) = (tx / s, ty / s);
        let r2 = u * u + v * v;
        let stretch = 1.0 + k_over_r2 * r2;
        let ideal_u = Vector::from([tx * ty / s, -(1.0 + tx * tx) / s, ty / s, -u, 0.0]);
        let ideal_v = Vector::from([(1.0 + ty * ty) / s, -tx * ty / s, -tx / s, -v, 0.0]);
        let radial = ideal_u * u + ideal_v * v;
        let mut slope_u = ideal_u * stretch + radial * (2.0 * k_over_r2 * u);
        let mut slope_v = ideal_v * stretch + radial * (2.0 * k_over_r2 * v);
        slope_u[4] = u * r2 / (half_diagonal_px * half_diagonal_px);
        slope_v[4] = v * r2 / (half_diagonal_px * half_diagonal_px);
        let (uu, vv, uv) = pair.information;
        let (du, dv) = (pair.left - u * stretch, pair.up - v * stretch);
        // What each slope weighs: the information matrix times the two slopes.
        let (weighted_u, weighted_v) = (slope_u * uu + slope_v * uv, slope_v * vv + slope_u * uv);
        normal += slope_u * weighted_u.transpose() + slope_v * weighted_v.transpose();
        gradient += weighted_u * du + weighted_v * dv;
        chi2 += pair.distance_sq(u * stretch, v * stretch);
    }
    let scale_weight = 1.0 / prior.sigma_ln_platescale.powi(2);
    normal[(3, 3)] += scale_weight;
    gradient[3] += scale_weight * (prior.platescale / s).ln();
    let k1_weight = 1.0 / prior.sigma_k1.powi(2);
    normal[(4, 4)] += k1_weight;
    gradient[4] += k1_weight * (prior.k1 - pose.k1);
    Some((normal, gradient, chi2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, DEG, separation};

    const R: f64 = 923.0;
    const PRIOR: FitPrior = FitPrior { platescale: 9.5 * ARCSEC, sigma_ln_platescale: 0.03, k1: 0.0, sigma_k1: 2e-3 };

    /// Pairs as a camera of the given pose sees them, on a grid, moved by `noise(i)` px.
    fn pairs(truth: &Pose, sigma: f64, noise: impl Fn(usize) -> (f64, f64)) -> Vec<Pair> {
        let mut pairs = Vec::new();
        for i in 0..20 {
            let (u, v) = (-700.0 + 350.0 * (i % 5) as f64, -450.0 + 300.0 * (i / 5) as f64);
            let camera = Vec3::new(u * truth.platescale, v * truth.platescale, 1.0).normalize();
            let star = truth.attitude.to_sky(&camera);
            let (left, up) = truth.project(&star, R).unwrap();
            let (dx, dy) = noise(i);
            pairs.push(Pair::round(left + dx, up + dy, sigma, star));
        }
        pairs
    }

    fn start_near(truth: &Pose) -> Pose {
        Pose { attitude: truth.attitude.turned(&Vec3::new(5e-5, -4e-5, 2e-3)), platescale: truth.platescale * 1.01, k1: 0.0 }
    }

    #[test]
    fn exact_pairs_give_back_the_pose() {
        let truth = Pose { attitude: Attitude::from_angles(2.0, -0.8, 1.0), platescale: 9.4 * ARCSEC, k1: -8e-4 };
        // Small σ, so that the priors do not pull.
        let fit = fit(&pairs(&truth, 1e-3, |_| (0.0, 0.0)), &start_near(&truth), R, &PRIOR).unwrap();
        assert!(separation(&fit.pose.attitude.boresight(), &truth.attitude.boresight()) < 1e-4 * ARCSEC);
        assert!(separation(&fit.pose.attitude.up(), &truth.attitude.up()) < 0.01 * ARCSEC);
        assert!((fit.pose.platescale / truth.platescale - 1.0).abs() < 1e-7);
        assert!((fit.pose.k1 - truth.k1).abs() < 1e-6);
    }

    #[test]
    fn the_covariance_is_that_of_repeated_trials() {
        use rand::{Rng, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let truth = Pose { attitude: Attitude::from_angles(1.0, 1.1, -2.0), platescale: 9.5 * ARCSEC, k1: 1e-3 };
        let (mut east, mut north, mut roll) = (0.0, 0.0, 0.0);
        const TRIALS: usize = 600;
        let mut covariance = Mat3::zeros();
        let (_, _, true_roll) = truth.attitude.angles();
        for _ in 0..TRIALS {
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let noise: Vec<(f64, f64)> = (0..20).map(|_| (0.2 * normal(), 0.2 * normal())).collect();
            let fit = fit(&pairs(&truth, 0.2, |i| noise[i]), &start_near(&truth), R, &PRIOR).unwrap();
            // Without the inflation, which is one-sided.
            let plain = Fit { chi2: 0.0, ..fit.clone() };
            covariance += plain.sky_covariance().0 / TRIALS as f64;
            let (_, _, r) = fit.pose.attitude.angles();
            let (ra0, dec0, _) = truth.attitude.angles();
            let (ra, dec, _) = fit.pose.attitude.angles();
            east += ((ra - ra0) * dec0.cos()).powi(2) / TRIALS as f64;
            north += (dec - dec0).powi(2) / TRIALS as f64;
            roll += crate::sky::wrap_pi(r - true_roll).powi(2) / TRIALS as f64;
        }
        // 600 trials know a variance to 6 %: 20 % is beyond three of those.
        assert!((east / covariance[(0, 0)] - 1.0).abs() < 0.2, "{}", east / covariance[(0, 0)]);
        assert!((north / covariance[(1, 1)] - 1.0).abs() < 0.2, "{}", north / covariance[(1, 1)]);
        assert!((roll / covariance[(2, 2)] - 1.0).abs() < 0.2, "{}", roll / covariance[(2, 2)]);
    }

    #[test]
    fn moving_the_boresight_east_turns_the_roll_as_the_jacobian_says() {
        let attitude = Attitude::from_angles(0.3, 60.0 * DEG, 0.5);
        let base = attitude.angles();
        for (axis, rotation) in [Vec3::x(), Vec3::y(), Vec3::z()].iter().enumerate() {
            let moved = attitude.turned(&(rotation * 1e-6)).angles();
            let numeric = [(moved.0 - base.0) * base.1.cos(), moved.1 - base.1, moved.2 - base.2].map(|d| d / 1e-6);
            let mut covariance = Matrix::zeros();
            covariance[(axis, axis)] = 1.0;
            let pose = Pose { attitude, platescale: 1e-5, k1: 0.0 };
            let (sky, _) = Fit { pose, covariance, chi2: 0.0, pairs: 9 }.sky_covariance();
            for i in 0..3 {
                for j in 0..3 {
                    assert!((sky[(i, j)] - numeric[i] * numeric[j]).abs() < 1e-4, "{axis} {i} {j}");
                }
            }
        }
    }

    #[test]
    fn too_little_or_impossible_input_gives_no_fit() {
        let pose = Pose { attitude: Attitude::from_angles(0.0, 0.0, 0.0), platescale: 1e-5, k1: 0.0 };
        let behind = Pair::round(0.0, 0.0, 1.0, Vec3::new(-1.0, 0.0, 0.0));
        assert!(fit(&[], &pose, R, &PRIOR).is_none());
        assert!(fit(&[behind; 5], &pose, R, &PRIOR).is_none());
        let nan = Pair::round(f64::NAN, 0.0, 1.0, Vec3::new(1.0, 0.0, 0.0));
        assert!(fit(&[nan; 5], &pose, R, &PRIOR).is_none());
    }
}
