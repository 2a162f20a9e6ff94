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

/// ln of how much likelier the light at the places of stars without a source is where a hypothesis is right than where it is wrong; 0 at the
/// least but for ln 2, for it may be that the light says nothing.
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
        let flux = 10_f64.powf(-0.4 * (mag(star) + zero_point));
        if flux * flux * information < LEAST_SNR * LEAST_SNR {
            return 0.0;
        }
        // What is brighter than it should be says no more than what is as bright.
        let ratio = flux * (light.min(flux * information) - 0.5 * flux * information);
        ((1.0 - MISSING) * libm::exp(ratio) + MISSING).ln()
    };
    let all: f64 = stars.iter().zip(light).map(ln_ratio).sum();
    (0.5 * (1.0 + libm::exp(all))).ln()
}
