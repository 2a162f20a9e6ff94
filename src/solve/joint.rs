//! One lens, many frames: the attitude of each, and the plate scale and the lens that all have in common.
//!
//! Each frame's normal equations have three parameters of its own, which are eliminated (the Schur complement), so that what is solved for
//! all frames together has the four of the lens alone, however many frames there are.

use super::fit::{AXIS_LEFT, AXIS_UP, FitPrior, K1, LN_PLATESCALE, PARAMETERS, Pair, Pose, normal_equations};
use crate::sky::{Attitude, Mat3, Vec3};
use nalgebra::{SMatrix, SVector};

/// Parameters of the lens: ln plate scale, k1, axis along left and up.
const OF_LENS: usize = PARAMETERS - LN_PLATESCALE;
/// Pairs that a frame needs, so that its own parameters are held by more than themselves.
const LEAST_PAIRS: usize = 4;
/// A pair is left out where it lies further off than this many of its σ, inflated by the scatter of all.
const CLIP_SIGMAS: f64 = 4.0;
/// Times that pairs are left out, and taken in again.
const ROUNDS: usize = 3;

/// One frame of many: what was matched in it.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// About where it looked.
    pub attitude: Attitude,
    /// Its sources and the stars that they are.
    pub pairs: Vec<Pair>,
}

/// What many frames show together.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// Radial distortion at the half diagonal, about the axis.
    pub k1: f64,
    /// Where the lens's axis meets the picture, offsets from its centre along left and up, px.
    pub axis: (f64, f64),
    /// One σ of ln plate scale, k1 and the axis (px), as large as the residuals say.
    pub sigmas: [f64; OF_LENS],
    /// Attitude of each frame, and its covariance about left, up and boresight, rad², for the lens as it is; `None` of a frame that has too
    /// few pairs.
    pub attitudes: Vec<Option<(Attitude, Mat3)>>,
    /// Sum of squared residuals over σ², both axes.
    pub chi2: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Pairs that were used.
    pub used: usize,
    /// Pairs that lie too far off.
    pub clipped: usize,
}

impl Joint {
    /// χ² per degree of freedom.
    pub fn chi2_per_dof(&self) -> f64 {
        self.chi2 / self.dof.max(1.0)
    }
}

/// Fits the attitude of each frame and one lens for all, by Gauss–Newton from the middle of the prior; pairs far off are left out.
///
/// `None` where no frame has enough pairs, one lies behind the camera, or the steps do not settle.
pub fn fit_together(views: &[View], half_diagonal_px: f64, prior: &FitPrior) -> Option<Joint> {
    let mut state = State {
        lens: Pose {
            k1: prior.k1,
            axis: prior.axis,
            ..Pose::undistorted(Attitude::from_angles(0.0, 0.0, 0.0), prior.platescale)
        },
        attitudes: views.iter().map(|view| view.attitude).collect(),
    };
    let mut kept: Vec<Vec<Pair>> = views.iter().map(|view| view.pairs.clone()).collect();
    let mut fitted = state.settle(&kept, half_diagonal_px, prior)?;
    for _ in 0..ROUNDS {
        let scatter = fitted.chi2_per_dof().max(1.0);
        let near = |pair: &&Pair, attitude: &Attitude| {
            let seen = state.pose(attitude).project(&pair.star, half_diagonal_px);
            seen.is_some_and(|(left, up)| pair.distance_sq(left, up) < CLIP_SIGMAS * CLIP_SIGMAS * scatter)
        };
        let next: Vec<Vec<Pair>> = views
            .iter()
            .zip(&state.attitudes)
            .map(|(view, attitude)| view.pairs.iter().filter(|pair| near(pair, attitude)).copied().collect())
            .collect();
        if next == kept {
            break;
        }
        kept = next;
        fitted = state.settle(&kept, half_diagonal_px, prior)?;
    }
    fitted.clipped = views.iter().map(|view| view.pairs.len()).sum::<usize>().saturating_sub(kept.iter().map(Vec::len).sum());
    Some(fitted)
}

/// Where the fit stands.
struct State {
    /// The lens; its attitude means nothing.
    lens: Pose,
    attitudes: Vec<Attitude>,
}

/// What one frame contributes.
struct Part {
    of_lens: SMatrix<f64, OF_LENS, OF_LENS>,
    cross: SMatrix<f64, OF_LENS, 3>,
    inverse: Mat3,
    gradient_lens: SVector<f64, OF_LENS>,
    gradient: Vec3,
    chi2: f64,
}

impl State {
    fn pose(&self, attitude: &Attitude) -> Pose {
        Pose { attitude: *attitude, ..self.lens }
    }

    fn part(&self, pairs: &[Pair], attitude: &Attitude, half_diagonal_px: f64) -> Option<Part> {
        // The prior of the lens counts once, for all frames.
        let none = FitPrior {
            platescale: self.lens.platescale,
            sigma_ln_platescale: f64::INFINITY,
            k1: 0.0,
            sigma_k1: f64::INFINITY,
            axis: (0.0, 0.0),
            sigma_axis_px: f64::INFINITY,
        };
        let (lower, gradient, chi2) = normal_equations(pairs, &self.pose(attitude), half_diagonal_px, &none)?;
        let full = lower.lower_triangle() + lower.lower_triangle().transpose() - SMatrix::from_diagonal(&lower.diagonal());
        Some(Part {
            of_lens: full.fixed_view::<OF_LENS, OF_LENS>(LN_PLATESCALE, LN_PLATESCALE).into(),
            cross: full.fixed_view::<OF_LENS, 3>(LN_PLATESCALE, 0).into(),
            inverse: Mat3::from(full.fixed_view::<3, 3>(0, 0)).cholesky()?.inverse(),
            gradient_lens: gradient.fixed_rows::<OF_LENS>(LN_PLATESCALE).into(),
            gradient: gradient.fixed_rows::<3>(0).into(),
            chi2,
        })
    }

    /// Steps until nothing moves any more.
    fn settle(&mut self, pairs: &[Vec<Pair>], half_diagonal_px: f64, prior: &FitPrior) -> Option<Joint> {
        const STEPS: usize = 20;
        /// A step this small ends the fit: of ln plate scale and k1, of which the greatest field has a thousandth of a pixel.
        const SETTLED: f64 = 1e-8;
        /// The same of the axis, px: it moves nothing but as far as there is distortion.
        const SETTLED_AXIS_PX: f64 = 1e-2;
        for _ in 0..STEPS {
            let mut normal = SMatrix::<f64, OF_LENS, OF_LENS>::zeros();
            let mut gradient = SVector::<f64, OF_LENS>::zeros();
            let mut parts = Vec::with_capacity(pairs.len());
            for (pairs, attitude) in pairs.iter().zip(&self.attitudes) {
                let part = if pairs.len() < LEAST_PAIRS { None } else { Some(self.part(pairs, attitude, half_diagonal_px)?) };
                if let Some(part) = &part {
                    normal += part.of_lens - part.cross * part.inverse * part.cross.transpose();
                    gradient += part.gradient_lens - part.cross * part.inverse * part.gradient;
                }
                parts.push(part);
            }
            let mut from_prior = SVector::<f64, OF_LENS>::zeros();
            for (at, weight, pull) in prior.pulls(&self.lens) {
                let place = at - LN_PLATESCALE;
                *normal.get_mut((place, place))? += weight;
                *gradient.get_mut(place)? += weight * pull;
                *from_prior.get_mut(place)? = weight;
            }
            let inverse = normal.cholesky()?.inverse();
            let step = inverse * gradient;
            if !step.iter().all(|value| value.is_finite()) {
                return None;
            }
            let used: usize = parts.iter().zip(pairs).filter(|(part, _)| part.is_some()).map(|(_, pairs)| pairs.len()).sum();
            let frames = parts.iter().flatten().count();
            let held = inverse.diagonal().dot(&from_prior);
            let joint = Joint {
                platescale: self.lens.platescale,
                k1: self.lens.k1,
                axis: self.lens.axis,
                sigmas: [0.0; OF_LENS],
                attitudes: Vec::new(),
                chi2: parts.iter().flatten().map(|part| part.chi2).sum(),
                dof: (2 * used) as f64 - (3 * frames + OF_LENS) as f64 + held,
                used,
                clipped: 0,
            };
            let [ln_scale, k1, left, up]: [f64; OF_LENS] = step.into();
            if ln_scale.abs() < SETTLED && k1.abs() < SETTLED && left.abs().max(up.abs()) < SETTLED_AXIS_PX {
                let inflation = joint.chi2_per_dof().max(1.0);
                let sigmas = inverse.diagonal().map(|variance| (variance.max(0.0) * inflation).sqrt()).into();
                let known =
                    |(part, attitude): (&Option<Part>, &Attitude)| part.as_ref().map(|p| (*attitude, p.inverse * inflation));
                let attitudes = parts.iter().zip(&self.attitudes).map(known).collect();
                return (frames > 0).then_some(Joint { sigmas, attitudes, ..joint });
            }
            self.advance(&parts, &step);
        }
        None
    }

    fn advance(&mut self, parts: &[Option<Part>], step: &SVector<f64, OF_LENS>) {
        for (part, attitude) in parts.iter().zip(&mut self.attitudes) {
            if let Some(part) = part {
                *attitude = attitude.turned(&(part.inverse * (part.gradient - part.cross.transpose() * step)));
            }
        }
        let at = |place: usize| step.get(place - LN_PLATESCALE).copied().unwrap_or(0.0);
        self.lens.platescale *= at(LN_PLATESCALE).clamp(-0.5, 0.5).exp();
        self.lens.k1 += at(K1);
        self.lens.axis = (self.lens.axis.0 + at(AXIS_LEFT), self.lens.axis.1 + at(AXIS_UP));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, separation};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const R: f64 = 923.0;
    const PRIOR: FitPrior = FitPrior {
        platescale: 9.45 * ARCSEC,
        sigma_ln_platescale: 0.03,
        k1: 0.0,
        sigma_k1: 5e-3,
        axis: (0.0, 0.0),
        sigma_axis_px: 12.5,
    };

    /// Frames of a camera, sixteen stars each with this error, px; every hundredth star is another one.
    fn views(lens: &Pose, sigma: f64, count: usize, random: &mut ChaCha8Rng) -> (Vec<View>, Vec<Attitude>) {
        let mut truths = Vec::new();
        let views = (0..count).map(|i| {
            let truth = Attitude::from_angles(0.1 * i as f64, 0.02 * i as f64 - 1.0, 0.3 * i as f64);
            truths.push(truth);
            let pose = Pose { attitude: truth, ..*lens };
            let pairs = (0..16).map(|j| {
                let (u, v) = (random.random_range(-760.0..760.0), random.random_range(-500.0..500.0));
                let star = truth.to_sky(&Vec3::new(u * lens.platescale, v * lens.platescale, 1.0).normalize());
                let (left, up) = pose.project(&star, R).unwrap();
                let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
                let astray = if (16 * i + j) % 100 == 0 { 3.0 } else { 0.0 };
                Pair::round(left + sigma * normal() + astray, up + sigma * normal(), sigma, star)
            });
            View { pairs: pairs.collect(), attitude: truth.turned(&Vec3::new(1e-4, -5e-5, 1e-3)) }
        });
        (views.collect(), truths)
    }

    #[test]
    fn many_frames_give_the_lens_that_they_have_in_common_and_its_sigma_is_honest() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let lens =
            Pose { k1: -9e-4, axis: (12.0, -9.0), ..Pose::undistorted(Attitude::from_angles(0.0, 0.0, 0.0), 9.4 * ARCSEC) };
        const TRIALS: usize = 30;
        let mut squares = [0.0; 2];
        for _ in 0..TRIALS {
            let (views, truths) = views(&lens, 0.1, 30, &mut random);
            let joint = fit_together(&views, R, &PRIOR).unwrap();
            assert_eq!((joint.clipped, joint.used), (5, 475));
            assert!((joint.chi2_per_dof() - 1.0).abs() < 0.2, "{}", joint.chi2_per_dof());
            let scale = (joint.platescale / lens.platescale).ln() / joint.sigmas[0];
            let k1 = (joint.k1 - lens.k1) / joint.sigmas[1];
            squares[0] += scale * scale / TRIALS as f64;
            squares[1] += k1 * k1 / TRIALS as f64;
            assert!(joint.sigmas[1] < 1.5e-4 && joint.sigmas[0] < 5e-5, "{:?}", joint.sigmas);
            for (fitted, truth) in joint.attitudes.iter().zip(&truths) {
                let (attitude, covariance) = fitted.unwrap();
                let off = separation(&attitude.boresight(), &truth.boresight());
                assert!(off < 5.0 * (covariance[(0, 0)] + covariance[(1, 1)]).sqrt(), "{}", off / ARCSEC);
            }
        }
        // Thirty trials know a variance to a quarter.
        assert!(squares.iter().all(|square| (0.3..2.0).contains(square)), "{squares:?}");
    }

    #[test]
    fn too_little_gives_no_fit_and_a_frame_with_too_few_pairs_counts_for_nothing() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let lens = Pose::undistorted(Attitude::from_angles(0.0, 0.0, 0.0), 9.4 * ARCSEC);
        assert!(fit_together(&[], R, &PRIOR).is_none());
        let (mut views, _) = views(&lens, 0.1, 3, &mut random);
        views[1].pairs.truncate(3);
        let joint = fit_together(&views, R, &PRIOR).unwrap();
        assert!(joint.attitudes[1].is_none() && joint.attitudes[2].is_some());
        views.iter_mut().for_each(|view| view.pairs.clear());
        assert!(fit_together(&views, R, &PRIOR).is_none());
    }
}
