//! Whether a series whose motion is not known stood still. Where it moved, its sum shows every star once for each exposure, and the pattern
//! of one exposure solves as well as any: it points where the camera did during that exposure, and not in the middle of the light.

use super::along::matched_stars;
use super::{Cause, Exposures, Outcome, Reason};
use crate::sources::Trail;
use std::fmt;

/// Stars that lie no further than this from where the sum has them are in one piece with it, and its place is the middle of all, px.
const IN_ONE_PIECE_PX: i16 = 4;
/// Exposures are looked at in no more parts than this: light of several together shows better against the noise.
const PARTS: usize = 4;
/// A part has to be so much likelier to have the stars' light than to have none, ln: one in a thousand. What is served rests on it.
const LIKELIER_LN: f64 = 6.9;

/// Takes a solution back whose stars were not seen to shine in all parts of the series.
pub(super) fn refuse_moved(exposures: &Exposures, outcome: &mut Outcome) {
    if outcome.solution.is_none() || exposures.exposures.len() < 2 {
        return;
    }
    let Some(without) = part_without(exposures, &matched_stars(outcome)) else { return };
    outcome.detail = format!("series: {without}: it moved, and how is not known");
    (outcome.reason, outcome.cause) = (Reason::Requirement, Some(Cause::Trailed));
    outcome.candidate = outcome.solution.take();
}

/// Neighbouring exposures in which stars are not seen.
#[derive(Debug, PartialEq)]
struct Without {
    /// The first and the last, from 0, of so many.
    first: usize,
    last: usize,
    of: usize,
}

impl fmt::Display for Without {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, of } = self;
        write!(f, "stars are not seen to shine in ")?;
        match last - first {
            0 => write!(f, "exposure {}", first + 1),
            _ => write!(f, "exposures {} to {}", first + 1, last + 1),
        }?;
        write!(f, " of {of} as in the others")
    }
}

/// The first part of a series in which these stars, at places of the sum, px, do not shine for certain.
fn part_without(exposures: &Exposures, stars: &[(f64, f64, f64)]) -> Option<Without> {
    let of = exposures.exposures.len();
    let shares = exposures.shares(&exposures.cells(), &vec![in_one_piece(of); of], stars);
    let length = of.div_ceil(PARTS).max(1);
    let parts: Vec<(f64, f64)> = shares.chunks(length).map(mean).collect();
    // Sharp or not, however much of the stars' light this looks at, it is the same in all parts.
    let (all, _) = mean(&parts);
    let shines = |&(share, sigma): &(f64, f64)| {
        let (share, sigma) = (share / all, sigma / all);
        all > 0.0 && (share - 0.5) / (sigma * sigma) > LIKELIER_LN
    };
    let first = length * parts.iter().position(|part| !shines(part))?;
    Some(Without { first, last: (first + length).min(of) - 1, of })
}

/// The mean of some values by their σ, and its own.
fn mean(values: &[(f64, f64)]) -> (f64, f64) {
    let weight = |sigma: f64| 1.0 / (sigma * sigma);
    let weights: f64 = values.iter().map(|(_, sigma)| weight(*sigma)).sum();
    let sum: f64 = values.iter().map(|(value, sigma)| value * weight(*sigma)).sum();
    if weights > 0.0 { (sum / weights, weights.sqrt().recip()) } else { (0.0, f64::INFINITY) }
}

/// What a star in one piece may be in each of so many exposures: anywhere near its place.
fn in_one_piece(exposures: usize) -> Trail {
    let reach = || (-IN_ONE_PIECE_PX..=IN_ONE_PIECE_PX).step_by(2);
    let places = reach().flat_map(|y| reach().map(move |x| (x, y)));
    let near = places.filter(|(x, y)| x * x + y * y <= IN_ONE_PIECE_PX * IN_ONE_PIECE_PX);
    let places = near.map(|(x, y)| (f64::from(x), f64::from(y))).collect();
    Trail { places, share: 1.0 / exposures.max(1) as f64, ..Trail::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Frame;
    use crate::sky::RowOrder;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use std::sync::Arc;

    /// A series whose exposures show the same stars moved by so many px, on skies of their own with a noise of 10 ADU; and the stars, of a
    /// flux in all exposures together, ADU.
    fn series(flux: f64, moved: &[f64], seed: u64) -> (Exposures, Vec<(f64, f64, f64)>) {
        let (width, height) = (384, 192);
        let stars: Vec<_> = (0..8).map(|i| (60.0 + 37.0 * f64::from(i), 50.0 + 29.0 * f64::from(i % 4), flux)).collect();
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let sky = Normal::new(500.0, 10.0).unwrap();
        let each = 1.0 / moved.len() as f64;
        let exposure = |&moved: &f64| {
            let mut pixel = |at: usize| {
                let light = |&(x, y, flux): &(f64, f64, f64)| {
                    let (dx, dy) = ((at % width) as f64 - x - moved, (at / width) as f64 - y);
                    each * flux * libm::exp(-0.5 * (dx * dx + dy * dy)) / std::f64::consts::TAU
                };
                (sky.sample(&mut random) + stars.iter().map(light).sum::<f64>()).round() as u16
            };
            let pixels = (0..width * height).map(&mut pixel).collect();
            Arc::new(Frame::new(width, height, pixels, RowOrder::TopFirst).unwrap())
        };
        (Exposures { exposures: moved.iter().map(exposure).collect(), motion: None }, stars)
    }

    /// Of ten series, in how many it is a part without stars; the first of that.
    fn refused(flux: f64, moved: &[f64]) -> (usize, Option<Without>) {
        let without: Vec<_> = (0..10)
            .filter_map(|seed| {
                let (exposures, stars) = series(flux, moved, seed);
                part_without(&exposures, &stars)
            })
            .collect();
        (without.len(), without.into_iter().next())
    }

    #[test]
    fn stars_that_stand_still_or_nearly_are_in_one_piece() {
        for moved in [[0.0; 2].as_slice(), &[0.0; 3], &[0.0; 16], &[-1.5, 0.0, 1.5], &[-2.0, 2.0]] {
            assert_eq!(refused(3000.0, moved), (0, None), "{moved:?}");
        }
    }

    #[test]
    fn stars_of_one_exposure_alone_are_no_picture_of_the_series() {
        let of = |first, last, of| Some(Without { first, last, of });
        assert_eq!(refused(3000.0, &[0.0, 27.0]), (10, of(1, 1, 2)));
        assert_eq!(refused(3000.0, &[27.0, 0.0]), (10, of(0, 0, 2)));
        assert_eq!(refused(3000.0, &[0.0, 0.0, 0.0, 12.0]), (10, of(3, 3, 4)));
        assert_eq!(refused(3000.0, &[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 30.0, 40.0, 50.0]), (10, of(6, 8, 9)));
        assert_eq!(of(6, 8, 9).unwrap().to_string(), "stars are not seen to shine in exposures 7 to 9 of 9 as in the others");
        assert_eq!(of(1, 1, 2).unwrap().to_string(), "stars are not seen to shine in exposure 2 of 2 as in the others");
    }

    #[test]
    fn what_is_too_faint_to_tell_is_not_believed() {
        let (refused, _) = refused(200.0, &[0.0; 4]);
        assert_eq!(refused, 10);
    }
}
