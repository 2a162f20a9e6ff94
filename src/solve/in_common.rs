//! What all stars of a trailed series have in common: the error of the pointing that comes of trails which are not quite as they are taken
//! to be.
//!
//! A star is put where its trails fit best. What of a trail tells the place along it is its ends, and across it the whole: so trails in
//! several directions weigh an error of their shape differently, and what would cancel out over the series does not, for all stars alike.
//! The fit answers to an error w(t) of the track by Σ B w, where B = N⁻¹ ∫ ∇λ ∇gᵀ of a moment whose light is g, λ is the light of its
//! exposure, and N = Σ ∫ ∇λ ∇λᵀ over the exposures. Where all light is Gaussian these are closed forms.

use super::motion::Motion;
use crate::sources::Trail;
use nalgebra::{Matrix2, Vector2};

/// Variance of a star's light without motion, px²: as the search along trails takes it to be.
const STAR_VARIANCE: f64 = 1.0 + 1.0 / 12.0;
/// Distance between the moments that are looked at, px: they must not fall apart into stars. And how many of an exposure, at least and at most.
const STEP_PX: f64 = 1.5;
const MOMENTS: (usize, usize) = (4, 70);

/// How the place of a star that is fitted along trails answers to errors of them. In file order, px.
#[derive(Debug, Clone)]
pub struct InCommon {
    /// Moments, in the order of time: time, s; place, px; part of the light; answer of the fit.
    moments: Vec<(f64, Vector2<f64>, f64, Matrix2<f64>)>,
}

impl InCommon {
    /// Of trails with their motion; `None` where no place can be fitted.
    pub fn of(motion: &Motion, trails: &[Trail]) -> Option<Self> {
        let mut moments = Vec::new();
        let mut normal = Matrix2::zeros();
        for (trail, (start, length)) in trails.iter().zip(&motion.exposures) {
            let count = ((trail.span() / STEP_PX) as usize).clamp(MOMENTS.0, MOMENTS.1).min(trail.places.len().max(1));
            let part = |i: usize| (i as f64 + 0.5) / count as f64;
            let place = |i: usize| {
                // Places stand for equal parts of the time, each for its middle.
                let at = (part(i) * trail.places.len() as f64 - 0.5).max(0.0);
                let here = trail.places.get(at as usize)?;
                let next = trail.places.get(at as usize + 1).unwrap_or(here);
                let on = |here: f64, next: f64| here + at.fract() * (next - here);
                Some(Vector2::new(on(here.0, next.0), on(here.1, next.1)))
            };
            let places: Vec<Vector2<f64>> = (0..count).filter_map(place).collect();
            let light = trail.share / places.len().max(1) as f64;
            for (i, here) in places.iter().enumerate() {
                let answer: Matrix2<f64> =
                    places.iter().map(|other| slopes_in_common(here - other)).sum::<Matrix2<f64>>() * (light * light);
                normal += answer;
                moments.push((start + length * part(i), *here, light, answer));
            }
        }
        let inverse = normal.try_inverse()?;
        moments.iter_mut().for_each(|moment| moment.3 = inverse * moment.3);
        moments.sort_by(|a, b| a.0.total_cmp(&b.0));
        Some(Self { moments })
    }

    /// Covariance of the place against the middle of the light, and against the start of the first exposure, px², that a random walk of the
    /// track makes whose steps have this covariance in a second, px²/s.
    pub fn of_walk(&self, walk: &Matrix2<f64>, start_s: f64) -> (Matrix2<f64>, Matrix2<f64>) {
        let (mut of_middle, mut of_start) = (Matrix2::zeros(), Matrix2::zeros());
        let (mut later, mut later_light) = (Matrix2::zeros(), 0.0);
        // A step moves all that comes after it.
        for (i, (time, _, light, answer)) in self.moments.iter().enumerate().rev() {
            later += answer;
            later_light += light;
            let before = i.checked_sub(1).and_then(|before| self.moments.get(before)).map_or(start_s, |moment| moment.0);
            let span = (time - before).max(0.0);
            let off = later - Matrix2::identity() * later_light;
            of_middle += off * walk * off.transpose() * span;
            of_start += later * walk * later.transpose() * span;
        }
        (of_middle, of_start)
    }

    /// By how much the place is off where trails are longer than they are taken to be by this fraction, px.
    pub fn of_stretch(&self, fraction: f64) -> Vector2<f64> {
        let off =
            |(_, place, light, answer): &(f64, Vector2<f64>, f64, Matrix2<f64>)| (answer - Matrix2::identity() * *light) * place;
        self.moments.iter().map(off).sum::<Vector2<f64>>() * fraction
    }
}

/// ∫ ∇g ∇gᵀ of two Gaussians of a star's width so far apart: minus the second derivatives of a Gaussian of twice its variance.
fn slopes_in_common(apart: Vector2<f64>) -> Matrix2<f64> {
    let variance = 2.0 * STAR_VARIANCE;
    let height = libm::exp(-0.5 * apart.norm_squared() / variance) / (std::f64::consts::TAU * variance);
    (Matrix2::identity() - apart * apart.transpose() / variance) * (height / variance)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trail(from: (f64, f64), to: (f64, f64), share: f64) -> Trail {
        let part = |i: u32| (f64::from(i) + 0.5) / 90.0;
        let place = |i: u32| (from.0 + part(i) * (to.0 - from.0), from.1 + part(i) * (to.1 - from.1));
        Trail { places: (0..90).map(place).collect(), share, ..Trail::default() }
    }

    fn motion(count: u32) -> Motion {
        Motion { exposures: (0..count).map(|i| (0.3 * f64::from(i), 0.1)).collect(), ..Motion::default() }
    }

    #[test]
    fn a_shift_of_all_is_a_shift_and_a_straight_track_keeps_its_middle_when_stretched() {
        let trails = [trail((-60.0, -30.0), (-40.0, -20.0), 0.5), trail((40.0, 20.0), (60.0, 30.0), 0.5)];
        let common = InCommon::of(&motion(2), &trails).unwrap();
        let all: Matrix2<f64> = common.moments.iter().map(|moment| moment.3).sum();
        assert!((all - Matrix2::identity()).norm() < 1e-9);
        assert!(common.of_stretch(0.02).norm() < 1e-6);
    }

    #[test]
    fn across_a_straight_trail_a_walk_counts_by_its_mean_and_along_it_by_its_ends() {
        let common = InCommon::of(&motion(1), &[trail((-45.0, 0.0), (45.0, 0.0), 1.0)]).unwrap();
        let (of_middle, of_start) = common.of_walk(&Matrix2::identity(), 0.0);
        // The mean of a walk of a tenth of a second has a third of that as its variance; the mean of its ends against it a twelfth, a little
        // less where the ends are as blurred as a star is.
        assert!((of_start.m22 / (0.1 / 3.0) - 1.0).abs() < 0.05 && of_middle.m22 < 0.03 * 0.1 / 12.0, "{of_start} {of_middle}");
        assert!((0.7..1.0).contains(&(of_middle.m11 / (0.1 / 12.0))), "{of_middle}");
    }

    #[test]
    fn trails_in_two_directions_do_not_keep_their_middle() {
        // Across the first the second tells nothing that is near as good, and so both shift.
        let trails = [trail((-60.0, 0.0), (-30.0, 0.0), 0.5), trail((45.0, -15.0), (45.0, 15.0), 0.5)];
        let off = InCommon::of(&motion(2), &trails).unwrap().of_stretch(0.01);
        assert!(off.norm() > 0.2, "{off}");
    }
}
