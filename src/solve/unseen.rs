//! The light of stars that are too faint to be sources: where a pose is right there is some at each of their places, and noise alone where
//! it is wrong.
//!
//! A candidate of few matched sources may be right and yet no surer than chance. It says where the other stars of the field must be, and how
//! bright: the light there is tested against that by the ratio of the two likelihoods, which the null hypothesis has a mean of one of, so that
//! it lowers the bound of the probability that the candidate is false by as much as it is (Markov; see [`super::verify`]). Nothing is chosen
//! by it: it is asked of the best candidate alone.

use super::along::Along;
use super::solver::Context;
use super::verify::{Hypothesis, PatternSource, project_stars};
use crate::sources::light_along;

/// A star is missing from where it should be with this probability: it varies, or its catalogue does.
const MISSING: f64 = 0.2;
/// Nearer than this to a source, px, light may be the source's.
const NEAR_PX: f64 = 12.0;
/// Stars that are asked, the brightest first; and the least of the signal over noise that one should have to be.
const MOST: usize = 40;
const LEAST_SNR: f64 = 1.0;
/// A star says for a hypothesis no more than one of this signal over noise, which is about the least of a source: of a brighter one that is no
/// source there is something amiss, and light at its place may be anything.
const MOST_SNR: f64 = 3.2;

/// ln of how much likelier the light at the places of stars without a source is where a hypothesis is right than where it is wrong; −ln 2 at
/// the least, for it may be that the light says nothing.
pub(super) fn ln_of_unseen(context: &Context<'_>, along: &Along<'_>, sources: &[PatternSource], hypothesis: &Hypothesis) -> f64 {
    let mut stars = Vec::new();
    project_stars(context.field, &hypothesis.pose, &context.geometry, context.field.verification_rank, &mut stars);
    let mag = |star: usize| context.field.stars.stars.get(star).map_or(f64::INFINITY, |star| f64::from(star.mag));
    let mut zero_points: Vec<f64> =
        hypothesis.matches.iter().filter_map(|m| Some(sources.get(m.source)?.mag - mag(m.star))).collect();
    zero_points.sort_by(f64::total_cmp);
    let Some(zero_point) = zero_points.get(zero_points.len() / 2) else { return 0.0 };
    let is_source = |left: f64, up: f64| sources.iter().any(|source| (source.left - left).hypot(source.up - up) < NEAR_PX);
    stars.retain(|&(_, left, up)| !is_source(left, up));
    stars.sort_by(|a, b| mag(a.0).total_cmp(&mag(b.0)));
    stars.truncate(MOST);
    let places = stars.iter().map(|&(_, left, up)| context.camera.position(left, up));
    let light = light_along(along.exposures, along.cells, along.trails, places);
    let ln_ratio = |(&(star, ..), (light, information)): (&(usize, f64, f64), (f64, f64))| {
        ln_of_star(10_f64.powf(-0.4 * (mag(star) + zero_point)), light, information)
    };
    let all: f64 = stars.iter().zip(light).map(ln_ratio).sum();
    (0.5 * (1.0 + libm::exp(all))).ln()
}

/// ln of how much likelier the light at a place and the information of it are where a star of this flux is than where none is.
fn ln_of_star(flux: f64, light: f64, information: f64) -> f64 {
    if flux * flux * information < LEAST_SNR * LEAST_SNR {
        return 0.0;
    }
    // What is brighter than it should be says no more than what is as bright.
    let ratio = flux * (light.min(flux * information) - 0.5 * flux * information);
    ((1.0 - MISSING) * libm::exp(ratio.min(0.5 * MOST_SNR * MOST_SNR)) + MISSING).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_alone_says_nothing_for_a_star_in_the_mean() {
        // Of information 1 the light of noise is normal.
        for flux in [1.0, 1.7, 2.5, 3.2, 5.0, 20.0] {
            let step = 1e-3;
            let density = |light: f64| (-0.5 * light * light).exp() / std::f64::consts::TAU.sqrt();
            let lights = (-9000..9000).map(|i| f64::from(i) * step);
            let mean: f64 = lights.map(|light| density(light) * ln_of_star(flux, light, 1.0).exp() * step).sum();
            assert!((0.1..=1.0 + 1e-6).contains(&mean), "{flux}: {mean}");
        }
    }

    #[test]
    fn a_star_that_is_there_speaks_for_itself_and_nothing_speaks_without_bounds() {
        assert!(ln_of_star(2.5, 2.5, 1.0) > 2.5, "as bright as it should be");
        assert_eq!(ln_of_star(0.5, 9.0, 1.0), 0.0, "too faint to be asked");
        assert_eq!(ln_of_star(2.5, 1e6, 1.0), ln_of_star(2.5, 2.5, 1.0), "a defect is no star");
        assert!(ln_of_star(1e3, 1e3, 1.0) <= 0.5 * MOST_SNR * MOST_SNR, "nor is what ought to have been a source");
        assert!((ln_of_star(1e3, -1e3, 1.0) - MISSING.ln()).abs() < 1e-9, "a star may be missing");
        assert_eq!(ln_of_star(2.5, 0.0, 0.0), 0.0, "it is not on the picture");
    }
}
