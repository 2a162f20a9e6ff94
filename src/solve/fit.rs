//! The fit: attitude, plate scale and lens from matched sources, with their covariance.
//!
//! A lens's axis does not quite meet the middle of the sensor. About an axis at a = (a, b) px the picture is that of a plane touched
//! there: with g = (u, v) the gnomonic offsets, px, about the picture's centre, and s the plate scale, rad/px, the offsets on the
//! tilted plane are P = M g / (1 + s² g·a), a change of the plane touched. To second order in s·a, with up kept up and the plate scale
//! that at the centre, M is (1 + e, 0; s²ab, 1 − e), e = ¼s²(a² − b²). Radial distortion is about the axis: p = P + k₁ |P − a|²/R² (P − a).
//! In narrow fields hardly any star tells where the axis is; then its prior is what makes σ as large as it must be.

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
    /// Radial distortion at the half diagonal, about the axis.
    pub k1: f64,
    /// Where the lens's axis meets the picture: offsets from its centre along left and up, px.
    pub axis: (f64, f64),
}

impl Pose {
    /// A pose through a lens without distortion, its axis in the middle.
    pub fn undistorted(attitude: Attitude, platescale: f64) -> Self {
        Self { attitude, platescale, k1: 0.0, axis: (0.0, 0.0) }
    }

    /// Offsets from the centre along left and up, px, at which a direction is seen; `None` behind the camera.
    pub fn project(&self, star: &Vec3, half_diagonal_px: f64) -> Option<(f64, f64)> {
        let c = self.attitude.to_camera(star);
        if c.z <= 0.0 {
            return None;
        }
        let (u, v) = (c.x / c.z / self.platescale, c.y / c.z / self.platescale);
        Some(self.through_lens(u, v, half_diagonal_px).0)
    }

    /// Gnomonic offsets, px, that the lens puts at these: by fixed point, each step gains two digits.
    pub fn without_lens(&self, left: f64, up: f64, half_diagonal_px: f64) -> (f64, f64) {
        const STEPS: usize = 8;
        (0..STEPS).fold((left, up), |(u, v), _| {
            let ((x, y), _) = self.through_lens(u, v, half_diagonal_px);
            (u + left - x, v + up - y)
        })
    }

    /// Where the lens puts gnomonic offsets, px; and their distance from its axis, which the distortion is in proportion to.
    #[inline]
    fn through_lens(&self, u: f64, v: f64, half_diagonal_px: f64) -> ((f64, f64), (f64, f64)) {
        let (a, b) = self.axis;
        let s2 = self.platescale * self.platescale;
        let depth = 1.0 + s2 * (u * a + v * b);
        let uneven = 0.25 * s2 * (a * a - b * b);
        let (u, v) = (u * (1.0 + uneven) / depth, (v * (1.0 - uneven) + s2 * a * b * u) / depth);
        let (x, y) = (u - a, v - b);
        let stretch = self.k1 * (x * x + y * y) / (half_diagonal_px * half_diagonal_px);
        ((u + stretch * x, v + stretch * y), (x, y))
    }
}

/// Number of fitted parameters: rotation about left, up and boresight, ln plate scale, k1, axis along left and up.
pub(super) const PARAMETERS: usize = 7;
/// Their places from which on a prior holds them.
pub(super) const LN_PLATESCALE: usize = 3;
pub(super) const K1: usize = 4;
pub(super) const AXIS_LEFT: usize = 5;
pub(super) const AXIS_UP: usize = 6;
pub(super) type Matrix = SMatrix<f64, PARAMETERS, PARAMETERS>;
pub(super) type Vector = SVector<f64, PARAMETERS>;

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
    /// Where the lens's axis meets the picture, px along left and up.
    pub axis: (f64, f64),
    /// σ of it per axis, px.
    pub sigma_axis_px: f64,
}

impl FitPrior {
    /// What is expected and how much it weighs, of a parameter that is held, with how far a pose is from it.
    pub(super) fn pulls(&self, pose: &Pose) -> [(usize, f64, f64); PARAMETERS - LN_PLATESCALE] {
        /// What is known better than this is known, in whatever unit.
        const LEAST_SIGMA: f64 = 1e-9;
        let weight = |sigma: f64| sigma.max(LEAST_SIGMA).powi(-2);
        [
            (LN_PLATESCALE, weight(self.sigma_ln_platescale), (self.platescale / pose.platescale).ln()),
            (K1, weight(self.sigma_k1), self.k1 - pose.k1),
            (AXIS_LEFT, weight(self.sigma_axis_px), self.axis.0 - pose.axis.0),
            (AXIS_UP, weight(self.sigma_axis_px), self.axis.1 - pose.axis.1),
        ]
    }
}

/// A fitted pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// The pose.
    pub pose: Pose,
    /// Covariance of the parameters: rotation about left, up, boresight (rad), ln plate scale, k1, axis (px). As the σ of the sources say,
    /// not inflated.
    covariance: Matrix,
    /// Sum of squared residuals over σ², both axes.
    pub chi2: f64,
    /// Degrees of freedom: two a pair, less the parameters as far as the pairs and not the priors hold them.
    dof: f64,
}

impl Fit {
    /// χ² per degree of freedom.
    pub fn chi2_per_dof(&self) -> f64 {
        self.chi2 / self.dof.max(1.0)
    }

    /// ln of the part of all attitudes, and of the plate scales and lenses of the prior, that fit as well as this pose does:
    /// Laplace's approximation of the mean likelihood over all of them, relative to that of the fit.
    pub fn ln_peak(&self, prior: &FitPrior) -> f64 {
        // Four pi of boresights and two pi of rolls.
        let ln_attitudes = (2.0 * TAU * TAU).ln();
        let ln_volume = 0.5 * (PARAMETERS as f64 * TAU.ln() + self.covariance.determinant().max(f64::MIN_POSITIVE).ln());
        // The prior's normal densities at the pose.
        let ln_prior: f64 =
            prior.pulls(&self.pose).iter().map(|(_, weight, off)| 0.5 * ((weight / TAU).ln() - weight * off * off)).sum();
        ln_volume - ln_attitudes + ln_prior
    }

    /// Covariance on the sky at the boresight: east, north, roll (position angle of up), rad²; and σ of ln plate scale.
    ///
    /// As large as the σ of the sources and their residuals together say.
    pub fn sky_covariance(&self) -> (Mat3, f64) {
        let jacobian = sky_jacobian(&self.pose.attitude);
        let rotation: Mat3 = self.covariance.fixed_view::<3, 3>(0, 0).into();
        let inflation = self.inflation();
        let sky = jacobian * rotation * jacobian.transpose() * inflation;
        ((sky + sky.transpose()) * 0.5, (self.covariance[(LN_PLATESCALE, LN_PLATESCALE)].max(0.0) * inflation).sqrt())
    }

    /// By what the variances of the sources are to be multiplied: as their residuals show, together with what is known beforehand, that
    /// they are right. Few residuals show little; the more scatter they show, the less was known of these sources beforehand.
    pub fn inflation(&self) -> f64 {
        /// Degrees of freedom that the knowledge beforehand is worth: σ right to about a fifth (1/√(2·10)).
        const KNOWN_DOF: f64 = 10.0;
        let known = KNOWN_DOF / self.chi2_per_dof().max(1.0);
        (self.chi2 + known) / (self.dof.max(0.0) + known)
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
    /// A step this small, in px at the corner, ends the fit: what is left is far smaller, as its square is.
    const SETTLED_PX: f64 = 1e-3;
    if pairs.len() < 2 {
        return None;
    }
    let mut pose = *start;
    for step in 0..STEPS {
        let (normal, gradient, chi2) = normal_equations(pairs, &pose, half_diagonal_px, prior)?;
        let normal = normal.cholesky()?;
        let delta = normal.solve(&gradient);
        if !delta.iter().all(|d| d.is_finite()) {
            return None;
        }
        pose.attitude = pose.attitude.turned(&Vec3::new(delta[0], delta[1], delta[2]));
        pose.platescale *= delta[LN_PLATESCALE].clamp(-0.5, 0.5).exp();
        pose.k1 += delta[K1];
        pose.axis = (pose.axis.0 + delta[AXIS_LEFT], pose.axis.1 + delta[AXIS_UP]);
        let bend = pose.k1.abs() + (pose.platescale * half_diagonal_px).powi(2);
        let moved_px = (delta[0].abs() + delta[1].abs()) / pose.platescale
            + (delta[2].abs() + delta[LN_PLATESCALE].abs() + delta[K1].abs()) * half_diagonal_px
            + (delta[AXIS_LEFT].abs() + delta[AXIS_UP].abs()) * bend;
        if moved_px < SETTLED_PX || step == STEPS - 1 {
            let covariance = normal.inverse();
            let from_priors: f64 = prior.pulls(&pose).iter().map(|&(at, weight, _)| weight * covariance[(at, at)]).sum();
            let dof = (2 * pairs.len()) as f64 - (PARAMETERS as f64 - from_priors);
            return (moved_px < 1.0).then_some(Fit { pose, covariance, chi2, dof });
        }
    }
    None
}

/// Lower half of the normal matrix and gradient of the weighted problem with its priors, and χ² of the pairs alone.
pub(super) fn normal_equations(
    pairs: &[Pair],
    pose: &Pose,
    half_diagonal_px: f64,
    prior: &FitPrior,
) -> Option<(Matrix, Vector, f64)> {
    let s = pose.platescale;
    let per_r2 = 1.0 / (half_diagonal_px * half_diagonal_px);
    let k_per_r2 = pose.k1 * per_r2;
    let mut normal = [[0.0; PARAMETERS]; PARAMETERS];
    let mut gradient = [0.0; PARAMETERS];
    let mut chi2 = 0.0;
    for pair in pairs {
        let c = pose.attitude.to_camera(&pair.star);
        if c.z <= 0.0 {
            return None;
        }
        let (tx, ty) = (c.x / c.z, c.y / c.z);
        let (u, v) = (tx / s, ty / s);
        let ((left, up), (x, y)) = pose.through_lens(u, v, half_diagonal_px);
        let r2 = x * x + y * y;
        // How the lens passes on a move of the gnomonic offsets. (That of the tilt is left out: a thousandth, of the slopes alone.)
        let (xx, yy, xy) = (1.0 + k_per_r2 * (r2 + 2.0 * x * x), 1.0 + k_per_r2 * (r2 + 2.0 * y * y), 2.0 * k_per_r2 * x * y);
        let passed = |du: f64, dv: f64| (xx * du + xy * dv, xy * du + yy * dv);
        let turns = [
            passed(tx * ty / s, (1.0 + ty * ty) / s),
            passed(-(1.0 + tx * tx) / s, -tx * ty / s),
            passed(ty / s, -tx / s),
            passed(-u, -v),
        ];
        let (tilt_a, tilt_b) = (-s * tx, -s * ty);
        let slope_u = [turns[0].0, turns[1].0, turns[2].0, turns[3].0, x * r2 * per_r2, tilt_a * u + 1.0 - xx, tilt_b * u - xy];
        let slope_v = [turns[0].1, turns[1].1, turns[2].1, turns[3].1, y * r2 * per_r2, tilt_a * v - xy, tilt_b * v + 1.0 - yy];
        let (uu, vv, uv) = pair.information;
        let (du, dv) = (pair.left - left, pair.up - up);
        for i in 0..PARAMETERS {
            // What each slope weighs: the information matrix times the two slopes.
            let (weighted_u, weighted_v) = (uu * slope_u[i] + uv * slope_v[i], vv * slope_v[i] + uv * slope_u[i]);
            for j in 0..=i {
                normal[i][j] += weighted_u * slope_u[j] + weighted_v * slope_v[j];
            }
            gradient[i] += weighted_u * du + weighted_v * dv;
        }
        chi2 += uu * du * du + vv * dv * dv + 2.0 * uv * du * dv;
    }
    for (at, weight, pull) in prior.pulls(pose) {
        normal[at][at] += weight;
        gradient[at] += weight * pull;
    }
    Some((Matrix::from_fn(|i, j| normal[i][j]), Vector::from(gradient), chi2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, DEG, separation};

    const R: f64 = 923.0;
    const PRIOR: FitPrior = FitPrior {
        platescale: 9.5 * ARCSEC,
        sigma_ln_platescale: 0.03,
        k1: 0.0,
        sigma_k1: 2e-3,
        axis: (0.0, 0.0),
        sigma_axis_px: 12.5,
    };

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
        Pose {
            attitude: truth.attitude.turned(&Vec3::new(5e-5, -4e-5, 2e-3)),
            platescale: truth.platescale * 1.01,
            k1: 0.0,
            axis: (0.0, 0.0),
        }
    }

    #[test]
    fn exact_pairs_give_back_the_pose() {
        let truth =
            Pose { attitude: Attitude::from_angles(2.0, -0.8, 1.0), platescale: 9.4 * ARCSEC, k1: -8e-4, axis: (0.0, 0.0) };
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
        let truth =
            Pose { attitude: Attitude::from_angles(1.0, 1.1, -2.0), platescale: 9.5 * ARCSEC, k1: 1e-3, axis: (0.0, 0.0) };
        let (mut east, mut north, mut roll) = (0.0, 0.0, 0.0);
        const TRIALS: usize = 600;
        let mut covariance = Mat3::zeros();
        let (_, _, true_roll) = truth.attitude.angles();
        for _ in 0..TRIALS {
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let noise: Vec<(f64, f64)> = (0..20).map(|_| (0.2 * normal(), 0.2 * normal())).collect();
            let fit = fit(&pairs(&truth, 0.2, |i| noise[i]), &start_near(&truth), R, &PRIOR).unwrap();
            // As the σ say.
            let plain = Fit { chi2: fit.dof, ..fit.clone() };
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

    /// Where a lens puts a star whose axis meets the picture at `axis`, as a plane that touches the sky at the axis has it; and the attitude
    /// of the picture's centre, when that of the lens is `lens`.
    fn through_tilted_lens(lens: &Attitude, s: f64, k1: f64, axis: (f64, f64), star: &Vec3) -> ((f64, f64), Attitude) {
        let place = |c: Vec3| {
            let (u, v) = (c.x / c.z / s, c.y / c.z / s);
            let stretch = 1.0 + k1 * (u * u + v * v) / (R * R);
            (u * stretch + axis.0, v * stretch + axis.1)
        };
        let stretch = 1.0 + k1 * (axis.0 * axis.0 + axis.1 * axis.1) / (R * R);
        let centre = Vec3::new(-axis.0 * s / stretch, -axis.1 * s / stretch, 1.0);
        (place(lens.to_camera(star)), Attitude::from_boresight_up(&lens.to_sky(&centre.normalize()), &lens.up()).unwrap())
    }

    #[test]
    fn a_lens_whose_axis_is_off_the_centre_is_fitted_in_the_widest_field() {
        let (lens, s, k1, axis) = (Attitude::from_angles(1.0, 0.4, 2.0), 58.0 * ARCSEC, 1.2e-3, (17.0, -18.0));
        let (_, truth) = through_tilted_lens(&lens, s, k1, axis, &lens.boresight());
        let mut pairs = Vec::new();
        for i in 0..48 {
            let (u, v) = (-720.0 + 205.0 * (i % 8) as f64, -480.0 + 192.0 * (i / 8) as f64);
            let star = lens.to_sky(&Vec3::new((u - axis.0) * s, (v - axis.1) * s, 1.0).normalize());
            let ((left, up), _) = through_tilted_lens(&lens, s, k1, axis, &star);
            pairs.push(Pair::round(left, up, 0.01, star));
        }
        let start = Pose::undistorted(truth, s * 1.001);
        let fit = fit(&pairs, &start, R, &PRIOR_WIDE).unwrap();
        assert!(separation(&fit.pose.attitude.boresight(), &truth.boresight()) < 0.02 * ARCSEC);
        assert!(separation(&fit.pose.attitude.up(), &truth.up()) < 0.3 * ARCSEC);
        assert!((fit.pose.axis.0 - axis.0).abs() < 0.2 && (fit.pose.axis.1 - axis.1).abs() < 0.2, "{:?}", fit.pose);
        assert!(fit.chi2_per_dof() < 0.1, "{}", fit.chi2_per_dof());
    }

    /// The plate scale of the widest field.
    const PRIOR_WIDE: FitPrior = FitPrior { platescale: 58.0 * ARCSEC, ..PRIOR };

    #[test]
    fn where_no_star_tells_of_the_axis_the_covariance_has_what_its_prior_leaves_open() {
        use rand::{Rng, SeedableRng};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(11);
        let (lens, s, k1) = (Attitude::from_angles(1.0, 0.3, -2.0), 9.5 * ARCSEC, 1.2e-3);
        let (mut square, mut claimed, mut of_noise) = (0.0, 0.0, 0.0);
        const TRIALS: usize = 400;
        for _ in 0..TRIALS {
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let axis = (PRIOR.sigma_axis_px * normal(), PRIOR.sigma_axis_px * normal());
            let (_, truth) = through_tilted_lens(&lens, s, k1, axis, &lens.boresight());
            let pairs: Vec<Pair> = pairs(&Pose::undistorted(lens, s), 0.02, |_| (0.0, 0.0))
                .iter()
                .map(|pair| {
                    let ((left, up), _) = through_tilted_lens(&lens, s, k1, axis, &pair.star);
                    Pair::round(left + 0.02 * normal(), up + 0.02 * normal(), 0.02, pair.star)
                })
                .collect();
            let fit = fit(&pairs, &Pose { k1, ..Pose::undistorted(truth, s) }, R, &PRIOR).unwrap();
            let plain = Fit { chi2: fit.dof, ..fit.clone() };
            let covariance = plain.sky_covariance().0;
            square += separation(&fit.pose.attitude.boresight(), &truth.boresight()).powi(2);
            claimed += covariance[(0, 0)] + covariance[(1, 1)];
            of_noise += 2.0 * (0.02 * s).powi(2) / pairs.len() as f64;
        }
        // 400 trials of two axes know a variance to 5 %.
        assert!((square / claimed - 1.0).abs() < 0.2, "{}", square / claimed);
        assert!(claimed > 2.0 * of_noise, "the axis would not matter here: {}", claimed / of_noise);
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
            let pose = Pose::undistorted(attitude, 1e-5);
            let (sky, _) = Fit { pose, covariance, chi2: 9.0, dof: 9.0 }.sky_covariance();
            for i in 0..3 {
                for j in 0..3 {
                    assert!((sky[(i, j)] - numeric[i] * numeric[j]).abs() < 1e-4, "{axis} {i} {j}");
                }
            }
        }
    }

    #[test]
    fn too_little_or_impossible_input_gives_no_fit() {
        let pose = Pose::undistorted(Attitude::from_angles(0.0, 0.0, 0.0), 1e-5);
        let behind = Pair::round(0.0, 0.0, 1.0, Vec3::new(-1.0, 0.0, 0.0));
        assert!(fit(&[], &pose, R, &PRIOR).is_none());
        assert!(fit(&[behind; 5], &pose, R, &PRIOR).is_none());
        let nan = Pair::round(f64::NAN, 0.0, 1.0, Vec3::new(1.0, 0.0, 0.0));
        assert!(fit(&[nan; 5], &pose, R, &PRIOR).is_none());
    }
}
