//! Plate scale and distortion of many solved frames, which are refused where they do not agree.

use crate::sky::{ARCSEC, Attitude, Mat3};
use crate::solve::{FitPrior, Joint, View, fit_together};

/// Frames that are needed: with fewer a drift in them is not seen.
const LEAST_FRAMES: usize = 20;
/// Matched stars that are needed in all: so many know a distortion of a thousandth to a tenth, where each is off by a fifth of a pixel.
const LEAST_STARS: usize = 300;
/// Between these χ² per degree of freedom has to lie: σ that are wrong by more than 1.7 say nothing of how well a lens fits.
const CHI2_PER_DOF: (f64, f64) = (0.33, 3.0);
/// Scatter of the frames' own plate scales, fraction, beyond which they are not of one lens: four times what cold and focus change.
const MOST_SCATTER: f64 = 2e-3;
/// σ of distortion before anything is known: no lens that is worth flying has more.
const SIGMA_K1: f64 = 2e-2;
/// σ of ln plate scale before anything is known, about the frames' own median.
const SIGMA_LN_PLATESCALE: f64 = 0.05;
/// Distortion is warranted where it is more than so many of its σ: chance in one of two million.
const WARRANTED_SIGMAS: f64 = 5.0;

/// A solved frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Solved {
    /// Its attitude and matched stars.
    pub view: View,
    /// Its own plate scale, rad/px.
    pub platescale: f64,
    /// One σ of that, rad/px.
    pub sigma_platescale: f64,
}

/// What the frames say of the lens.
#[derive(Debug, Clone, PartialEq)]
pub struct Lens {
    /// Frames that were used.
    pub frames: usize,
    /// Stars matched in them, and used.
    pub stars: usize,
    /// Stars that lie too far off.
    pub clipped: usize,
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// One σ of it, rad/px.
    pub sigma_platescale: f64,
    /// Scatter of the frames' own plate scales beyond their σ, fraction.
    pub scatter: f64,
    /// Radial distortion at the half diagonal, about the axis; 0 where it is not warranted.
    pub k1: f64,
    /// The distortion that was found, warranted or not.
    pub k1_found: f64,
    /// One σ of it.
    pub sigma_k1: f64,
    /// Whether the frames have distortion beyond doubt.
    pub warranted: bool,
    /// Where the lens's axis meets the picture, offsets from its centre along left and up, px; (0, 0) where no distortion shows it.
    pub axis: (f64, f64),
    /// One σ of it along left and up, px.
    pub sigma_axis: (f64, f64),
    /// χ² per degree of freedom.
    pub chi2_per_dof: f64,
    /// Attitude of each frame with this lens and its covariance about left, up and boresight, rad²; `None` of one with too few stars.
    pub attitudes: Vec<Option<(Attitude, Mat3)>>,
}

/// Why frames calibrate nothing.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// There are too few of them.
    #[error("{frames} solved frames with {stars} stars, expected at least {LEAST_FRAMES} with {LEAST_STARS}")]
    TooFew {
        /// Solved frames.
        frames: usize,
        /// Stars matched in them.
        stars: usize,
    },
    /// The fit of all frames does not settle.
    #[error("no one lens fits these frames")]
    NoFit,
    /// σ and residuals do not agree.
    #[error("the residuals are not as the σ of the stars say: χ² per degree of freedom is {chi2:.2}, expected {} to {}", CHI2_PER_DOF.0, CHI2_PER_DOF.1)]
    Sigmas {
        /// χ² per degree of freedom.
        chi2: f64,
    },
    /// They are not of one lens.
    #[error("the plate scales of the frames scatter by {:.3} %, expected at most {:.1} %: they are not of one lens", 100.0 * scatter, 100.0 * MOST_SCATTER)]
    Scatter {
        /// Fraction.
        scatter: f64,
    },
}

/// The lens that frames of pictures with this half diagonal, px, have in common. `sigma_axis_px`: how far its axis may be from the centre.
///
/// # Errors
/// Where the frames are too few, do not agree with their own σ, or with each other.
pub fn lens(frames: &[Solved], half_diagonal_px: f64, sigma_axis_px: f64) -> Result<Lens, Refusal> {
    let stars = frames.iter().map(|frame| frame.view.pairs.len()).sum();
    if frames.len() < LEAST_FRAMES || stars < LEAST_STARS {
        return Err(Refusal::TooFew { frames: frames.len(), stars });
    }
    let views: Vec<View> = frames.iter().map(|frame| frame.view.clone()).collect();
    let mut scales: Vec<f64> = frames.iter().map(|frame| frame.platescale).collect();
    scales.sort_by(f64::total_cmp);
    let prior = FitPrior {
        platescale: scales.get(scales.len() / 2).copied().unwrap_or(ARCSEC),
        sigma_ln_platescale: SIGMA_LN_PLATESCALE,
        k1: 0.0,
        sigma_k1: SIGMA_K1,
        axis: (0.0, 0.0),
        sigma_axis_px,
    };
    let free = fit_together(&views, half_diagonal_px, &prior).ok_or(Refusal::NoFit)?;
    let [_, sigma_k1, ..] = free.sigmas;
    let warranted = free.k1.abs() > WARRANTED_SIGMAS * sigma_k1;
    let held = FitPrior { sigma_k1: 0.0, sigma_axis_px: 0.0, ..prior };
    let joint = if warranted { free.clone() } else { fit_together(&views, half_diagonal_px, &held).ok_or(Refusal::NoFit)? };
    let chi2 = joint.chi2_per_dof();
    if !(CHI2_PER_DOF.0..=CHI2_PER_DOF.1).contains(&chi2) {
        return Err(Refusal::Sigmas { chi2 });
    }
    let scatter = scatter(frames);
    if !(scatter <= MOST_SCATTER) {
        return Err(Refusal::Scatter { scatter });
    }
    Ok(as_lens(frames.len(), scatter, warranted, &free, joint))
}

fn as_lens(frames: usize, scatter: f64, warranted: bool, free: &Joint, joint: Joint) -> Lens {
    let [_, sigma_k1, sigma_left, sigma_up] = free.sigmas;
    let of_scatter = scatter / (frames as f64).sqrt();
    Lens {
        frames: joint.attitudes.iter().flatten().count(),
        stars: joint.used,
        clipped: joint.clipped,
        platescale: joint.platescale,
        sigma_platescale: joint.platescale * joint.sigmas[0].hypot(of_scatter),
        scatter,
        k1: joint.k1,
        k1_found: free.k1,
        sigma_k1,
        warranted,
        axis: joint.axis,
        sigma_axis: (sigma_left, sigma_up),
        chi2_per_dof: joint.chi2_per_dof(),
        attitudes: joint.attitudes,
    }
}

/// By how much the frames' own plate scales differ beyond what their σ explain, fraction: the excess over the weighted mean.
fn scatter(frames: &[Solved]) -> f64 {
    let all = || frames.iter().filter(|frame| frame.sigma_platescale > 0.0);
    let weight = |frame: &Solved| frame.sigma_platescale.powi(-2);
    let (sum, weights) =
        all().fold((0.0, 0.0), |(sum, weights), frame| (sum + weight(frame) * frame.platescale, weights + weight(frame)));
    let (mean, count) = (sum / weights, all().count() as f64);
    let chi2: f64 = all().map(|frame| weight(frame) * (frame.platescale - mean).powi(2)).sum();
    // The variance that makes χ² what it should be, as every frame has it.
    let excess = (chi2 - (count - 1.0)).max(0.0) / weights;
    excess.sqrt() / mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::Vec3;
    use crate::solve::{Pair, Pose};
    use rand::{Rng, SeedableRng};

    const R: f64 = 923.0;

    /// Frames of a lens, twenty stars of 0.1 px each; `stretch`: of their own plate scales; `noise`: of the places over what σ say.
    fn frames(k1: f64, count: usize, stretch: f64, noise: f64) -> Vec<Solved> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(9);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let s = 9.4 * ARCSEC;
        let frame = |i: usize| {
            let attitude = Attitude::from_angles(0.3 * i as f64, 0.01 * i as f64, i as f64);
            let pose = Pose { k1, ..Pose::undistorted(attitude, s) };
            let pairs = (0..20).map(|j| {
                let (u, v) = (-700.0 + 350.0 * f64::from(j % 5), -450.0 + 300.0 * f64::from(j / 5));
                let star = attitude.to_sky(&Vec3::new(u * s, v * s, 1.0).normalize());
                let (left, up) = pose.project(&star, R).unwrap();
                Pair::round(left + 0.1 * noise * normal(), up + 0.1 * noise * normal(), 0.1, star)
            });
            let view = View { attitude, pairs: pairs.collect() };
            let own = s * (1.0 + stretch * if i.is_multiple_of(2) { 1.0 } else { -1.0 });
            Solved { view, platescale: own, sigma_platescale: s * 5e-5 }
        };
        (0..count).map(frame).collect()
    }

    #[test]
    fn a_lens_with_distortion_has_it_and_one_without_has_none() {
        let found = lens(&frames(8e-4, 50, 0.0, 1.0), R, 12.5).unwrap();
        assert!(found.warranted && (found.k1 / 8e-4 - 1.0).abs() < 0.1, "{found:?}");
        assert!((found.platescale / (9.4 * ARCSEC) - 1.0).abs() < 5.0 * found.sigma_platescale / found.platescale);
        assert!(found.scatter < 1e-6 && found.frames == 50);
        let none = lens(&frames(0.0, 50, 0.0, 1.0), R, 12.5).unwrap();
        assert!(!none.warranted && none.k1.abs() < 1e-8 && none.k1_found.abs() < WARRANTED_SIGMAS * none.sigma_k1, "{none:?}");
        assert!(none.sigma_platescale < found.sigma_platescale, "what is not fitted takes nothing from the rest");
    }

    #[test]
    fn few_frames_dishonest_sigmas_and_many_lenses_are_refused() {
        assert!(matches!(lens(&frames(0.0, 19, 0.0, 1.0), R, 12.5), Err(Refusal::TooFew { frames: 19, .. })));
        assert!(matches!(lens(&frames(0.0, 30, 0.0, 2.5), R, 12.5), Err(Refusal::Sigmas { chi2 }) if chi2 > 5.0));
        assert!(matches!(lens(&frames(0.0, 30, 0.0, 0.3), R, 12.5), Err(Refusal::Sigmas { chi2 }) if chi2 < 0.2));
        assert!(matches!(lens(&frames(0.0, 30, 3e-3, 1.0), R, 12.5), Err(Refusal::Scatter { .. })));
        let breathing = lens(&frames(0.0, 30, 5e-4, 1.0), R, 12.5).unwrap();
        assert!((breathing.scatter / 5e-4 - 1.0).abs() < 0.05, "{}", breathing.scatter);
        assert!(breathing.sigma_platescale > 8e-5 * breathing.platescale, "a mean of what scatters is not known better");
    }
}
