//! How a second camera is turned against the first, from frames that both took at the same time.

use crate::sky::{Attitude, Mat3, Vec3};

/// Pairs of frames that are needed.
const LEAST_PAIRS: usize = 10;
/// A pair is left out where it lies further off than this many σ, inflated by the scatter of all.
const CLIP_SIGMAS: f64 = 4.0;
/// Times that the mean is taken, pairs far off left out.
const ROUNDS: usize = 5;
/// χ² per degree of freedom beyond which the pairs do not agree: what moves between the cameras, or between their exposures, is three
/// times what the stars leave open.
const MOST_CHI2: f64 = 9.0;

/// How the second camera is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// Where its boresight is in the first one's frame: to the left, as an azimuth about up, rad.
    pub left: f64,
    /// The same up, as an elevation, rad.
    pub up: f64,
    /// By how much its picture is turned about the boresight, from up to right (against the position angle), rad.
    pub roll: f64,
    /// One σ of the three, rad.
    pub sigmas: Vec3,
    /// Pairs of frames used.
    pub pairs: usize,
    /// Pairs left out.
    pub clipped: usize,
    /// χ² per degree of freedom: over 1, the cameras moved against each other, or were not exposed together.
    pub chi2_per_dof: f64,
}

/// Why there is no offset.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum OffsetError {
    /// Too few frames of both at the same time.
    #[error("{0} pairs of frames at the same time, expected at least {LEAST_PAIRS}")]
    TooFew(usize),
    /// They do not agree.
    #[error(
        "the pairs of frames do not agree: χ² per degree of freedom is {0:.1}, expected at most {MOST_CHI2}: were they exposed together?"
    )]
    Scatter(f64),
}

/// The mean offset of pairs: the first camera's attitude and the second's, each with its covariance about left, up and boresight, rad².
///
/// # Errors
/// Where they are too few, or do not agree with their own σ.
pub fn offset(pairs: &[[(Attitude, Mat3); 2]]) -> Result<Offset, OffsetError> {
    let first = pairs.first().ok_or(OffsetError::TooFew(0))?;
    if pairs.len() < LEAST_PAIRS {
        return Err(OffsetError::TooFew(pairs.len()));
    }
    let mut mean = between(first);
    let (mut chi2, mut used, mut covariance) = (f64::INFINITY, 0, Mat3::zeros());
    for _ in 0..ROUNDS {
        let scatter = chi2.max(1.0);
        let (mut weights, mut sum, mut seen) = (Mat3::zeros(), Vec3::zeros(), Vec::new());
        for pair in pairs {
            // In the second camera's frame: its own error, and that of the first turned into it.
            let turn = between(pair);
            let off = small_turn(&mean, &turn);
            let [(_, of_first), (_, of_second)] = pair;
            let axes = Mat3::from_columns(&[turn.left(), turn.up(), turn.boresight()]);
            let Some(weight) = (of_second + axes.transpose() * of_first * axes).try_inverse() else { continue };
            if off.dot(&(weight * off)) > CLIP_SIGMAS * CLIP_SIGMAS * scatter * 3.0 {
                continue;
            }
            weights += weight;
            sum += weight * off;
            seen.push((off, weight));
        }
        covariance = weights.try_inverse().ok_or(OffsetError::TooFew(seen.len()))?;
        let step = covariance * sum;
        mean = mean.turned(&step);
        used = seen.len();
        let squares: f64 = seen.iter().map(|(off, weight)| (off - step).dot(&(weight * (off - step)))).sum();
        chi2 = squares / (3.0 * (used as f64 - 1.0)).max(1.0);
    }
    if used < LEAST_PAIRS {
        return Err(OffsetError::TooFew(used));
    }
    if !(chi2 <= MOST_CHI2) {
        return Err(OffsetError::Scatter(chi2));
    }
    let (boresight, up) = (mean.boresight(), mean.up());
    Ok(Offset {
        left: boresight.x.atan2(boresight.z),
        up: boresight.y.clamp(-1.0, 1.0).asin(),
        roll: (-up.x).atan2(up.y),
        sigmas: covariance.diagonal().map(|variance| (variance.max(0.0) * chi2.max(1.0)).sqrt()),
        pairs: used,
        clipped: pairs.len() - used,
        chi2_per_dof: chi2,
    })
}

/// The second camera's axes in the frame of the first.
fn between([(first, _), (second, _)]: &[(Attitude, Mat3); 2]) -> Attitude {
    let (boresight, up) = (first.to_camera(&second.boresight()), first.to_camera(&second.up()));
    Attitude::from_boresight_up(&boresight, &up).unwrap_or(*second)
}

/// The turn that leads from one to the other, which is small, as a vector in the frame of the first.
fn small_turn(from: &Attitude, to: &Attitude) -> Vec3 {
    let (boresight, up) = (from.to_camera(&to.boresight()), from.to_camera(&to.up()));
    Vec3::new(-boresight.y, boresight.x, -up.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, DEG};
    use rand::{Rng, SeedableRng};

    /// Frames of two cameras, turned against each other by this, with errors of 0.5″ and 8″ in roll.
    fn pairs(turn: &Vec3, count: usize, astray: usize) -> Vec<[(Attitude, Mat3); 2]> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(2);
        let sigma = Vec3::new(0.5, 0.5, 8.0) * ARCSEC;
        let mut error = || {
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            sigma.component_mul(&Vec3::new(normal(), normal(), normal()))
        };
        let covariance = Mat3::from_diagonal(&sigma.component_mul(&sigma));
        let pair = |i: usize| {
            let first = Attitude::from_angles(0.2 * i as f64, 0.01 * i as f64 - 0.5, i as f64);
            let second = first.turned(turn).turned(&if i < astray { Vec3::new(0.01, 0.0, 0.0) } else { Vec3::zeros() });
            [(first.turned(&error()), covariance), (second.turned(&error()), covariance)]
        };
        (0..count).map(pair).collect()
    }

    #[test]
    fn a_turn_however_large_is_found_and_pairs_astray_are_left_out() {
        for turn in [Vec3::new(100.0, -60.0, 400.0) * ARCSEC, Vec3::new(0.0, 90.0 * DEG, 0.0)] {
            let found = offset(&pairs(&turn, 100, 0)).unwrap();
            let truth = Attitude::from_angles(0.0, 0.0, 0.0);
            let seen = between(&[(truth, Mat3::zeros()), (truth.turned(&turn), Mat3::zeros())]);
            let (boresight, up) = (seen.boresight(), seen.up());
            assert!((found.left - boresight.x.atan2(boresight.z)).abs() < 5.0 * found.sigmas.max(), "{found:?}");
            assert!((found.up - boresight.y.asin()).abs() < 5.0 * found.sigmas.max(), "{found:?}");
            assert!((found.roll - (-up.x).atan2(up.y)).abs() < 5.0 * found.sigmas.max(), "{found:?}");
            assert!((0.7..1.4).contains(&found.chi2_per_dof), "{found:?}");
        }
        let small = Vec3::new(100.0, -60.0, 400.0) * ARCSEC;
        let found = offset(&pairs(&small, 100, 1)).unwrap();
        assert_eq!((found.pairs, found.clipped), (99, 1));
        // Turned about left by +100″ the boresight goes down, about up by −60″ to the right.
        assert!((found.up / ARCSEC + 100.0).abs() < 0.5 && (found.left / ARCSEC + 60.0).abs() < 0.5, "{found:?}");
        assert!((found.roll / ARCSEC - 400.0).abs() < 5.0 && found.sigmas.x / ARCSEC < 0.1, "{found:?}");
    }

    #[test]
    fn few_pairs_and_pairs_that_move_are_refused() {
        let turn = Vec3::new(1e-3, 0.0, 0.0);
        assert_eq!(offset(&[]), Err(OffsetError::TooFew(0)));
        assert_eq!(offset(&pairs(&turn, 9, 0)), Err(OffsetError::TooFew(9)));
        let moving: Vec<_> = pairs(&turn, 40, 0)
            .into_iter()
            .enumerate()
            .map(|(i, [a, (b, c)])| [a, (b.turned(&Vec3::new(1e-4 * (i % 7) as f64, 0.0, 0.0)), c)])
            .collect();
        assert!(matches!(offset(&moving), Err(OffsetError::Scatter(_))), "{:?}", offset(&moving));
    }
}
