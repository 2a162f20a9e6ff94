//! The final fit: every source found against every star of the field, at the epoch of observation.

use super::fit::{Fit, Pair, Pose, fit};
use super::verify::{Assigned, FrameGeometry, PatternSource, assign, project_stars};
use super::{Match, Solution};
use crate::catalog::{Catalogue, Field, FieldStar};
use crate::sky::Vec3;

/// A pair is left out where its residual exceeds this many of its σ (after inflation by the fit's own scatter), but never where it is
/// below the least tolerance, nor kept above the greatest, px.
const CLIP_SIGMAS: f64 = 3.5;
const LEAST_TOLERANCE_PX: f64 = 0.1;
const FIRST_TOLERANCE_PX: f64 = 2.5;
const ROUNDS: usize = 4;
/// Stars fainter than the faintest source by more than this are not looked at, mag.
const DEPTH_MARGIN: f64 = 1.0;
/// A source brighter than its star by more than this is something else that lies near it, mag: three times the scatter of magnitudes. (It
/// may be fainter: stars saturate.)
const TOO_BRIGHT_MAG: f64 = 2.0;
/// The scatter that a fit of few pairs shows is not believed below this, of that which the σ explain.
const LEAST_SCATTER: f64 = 1.0;

/// Fits a pose to all sources, starting from a verified one. `years`: from the field's epoch to that of observation.
///
/// Returns the fit and its matches; `None` where it does not settle.
pub fn refine(
    sources: &[PatternSource],
    start: &Pose,
    first: &[Assigned],
    field: &Field,
    catalogue: &Catalogue,
    geometry: &FrameGeometry,
    years: f64,
) -> Option<(Fit, Vec<Assigned>)> {
    let zero_point = zero_point(sources, first, field);
    let faintest = sources.iter().map(|s| s.mag).fold(f64::MIN, f64::max) - zero_point + DEPTH_MARGIN;
    let mut pose = *start;
    let mut scatter = f64::INFINITY;
    let star_at = |index: usize| field.stars.stars.get(index);
    let mut stars = Vec::new();
    project_stars(field, &pose, geometry, u8::MAX, &mut stars);
    stars.retain(|&(i, _, _)| star_at(i).is_some_and(|s| f64::from(s.mag) <= faintest));
    let directions: Vec<Vec3> = stars.iter().filter_map(|&(i, _, _)| Some(moved(star_at(i)?, field, catalogue, years))).collect();
    let put = |stars: &mut [(usize, f64, f64)], pose: &Pose| {
        for ((_, left, up), direction) in stars.iter_mut().zip(&directions) {
            (*left, *up) = pose.project(direction, geometry.half_diagonal).unwrap_or((f64::INFINITY, f64::INFINITY));
        }
    };
    put(&mut stars, &pose);
    let mut matches = Vec::new();
    let mut result = None;
    for _ in 0..ROUNDS {
        let before = std::mem::take(&mut matches);
        assign(sources, &stars, |s| tolerance(s, geometry, scatter), &mut matches);
        matches.retain(|m| {
            let mags = sources.get(m.source).zip(star_at(m.star));
            mags.is_some_and(|(source, star)| source.mag - zero_point >= f64::from(star.mag) - TOO_BRIGHT_MAG)
        });
        // The same matches have the same fit, and that has them again.
        if result.is_some() && matches == before {
            break;
        }
        let pairs = final_pairs(sources, &matches, field, catalogue, geometry, years);
        let fitted = fit(&pairs, &pose, geometry.half_diagonal, &geometry.prior)?;
        pose = fitted.pose;
        scatter = fitted.chi2_per_dof().sqrt().max(LEAST_SCATTER);
        result = Some(fitted);
        // A little further on, the same stars are on the picture.
        put(&mut stars, &pose);
    }
    result.map(|fit| (fit, matches))
}

/// How far from a star a source may lie in this round, px.
fn tolerance(source: &PatternSource, geometry: &FrameGeometry, scatter: f64) -> f64 {
    if scatter.is_infinite() {
        return FIRST_TOLERANCE_PX.max(2.0 * source.sigma).min(geometry.tolerance);
    }
    (CLIP_SIGMAS * scatter * source.sigma.hypot(geometry.floor)).clamp(LEAST_TOLERANCE_PX, geometry.tolerance)
}

/// Median of the brightness of sources less that of their stars, mag.
fn zero_point(sources: &[PatternSource], matches: &[Assigned], field: &Field) -> f64 {
    let mut differences: Vec<f64> =
        matches.iter().filter_map(|m| Some(sources.get(m.source)?.mag - f64::from(field.stars.stars.get(m.star)?.mag))).collect();
    differences.sort_by(f64::total_cmp);
    differences.get(differences.len() / 2).copied().unwrap_or(0.0)
}

/// The pairs of the final fit, with the stars moved to the epoch of observation.
fn final_pairs(
    sources: &[PatternSource],
    matches: &[Assigned],
    field: &Field,
    catalogue: &Catalogue,
    geometry: &FrameGeometry,
    years: f64,
) -> Vec<Pair> {
    matches
        .iter()
        .filter_map(|m| Some((sources.get(m.source)?, field.stars.stars.get(m.star)?)))
        .map(|(source, star)| source.pair(moved(star, field, catalogue, years), geometry.floor))
        .collect()
}

/// Where a star of the field is, `years` after the field's epoch.
///
/// A blend's place is its own; what the brightest star of it moved since the field's epoch is added.
pub fn moved(star: &FieldStar, field: &Field, catalogue: &Catalogue, years: f64) -> Vec3 {
    if years == 0.0 {
        return star.direction;
    }
    let epoch = field.stars.epoch_yr - catalogue.header.epoch_yr;
    let shift = catalogue.stars.get(star.star as usize).map(|s| s.direction_after(epoch + years) - s.direction_after(epoch));
    (star.direction + shift.unwrap_or_default()).normalize()
}

/// The solution of a fit. `star_at`: a star of the field by its place there, as its place in the catalogue and its direction at the image's
/// epoch. `mirror`: signs that turn offsets along left and up into x and y of the file.
pub fn solution_of(
    fit: &Fit,
    matches: &[Assigned],
    sources: &[PatternSource],
    star_at: impl Fn(usize) -> Option<(usize, Vec3)>,
    geometry: &FrameGeometry,
    mirror: (f64, f64),
    false_ln: f64,
) -> Solution {
    let (covariance, sigma_ln_platescale) = fit.sky_covariance();
    let mut squares = 0.0;
    let matched: Vec<Match> = matches
        .iter()
        .filter_map(|m| {
            let (source, (star, direction)) = (sources.get(m.source)?, star_at(m.star)?);
            let (left, up) = fit.pose.project(&direction, geometry.half_diagonal)?;
            let residual = ((left - source.left) * mirror.0, (up - source.up) * mirror.1);
            squares += residual.0 * residual.0 + residual.1 * residual.1;
            Some(Match { source: m.source, star, residual_px: residual })
        })
        .collect();
    Solution {
        attitude: fit.pose.attitude,
        platescale: fit.pose.platescale,
        k1: fit.pose.k1,
        axis: fit.pose.axis,
        covariance,
        sigma_platescale: fit.pose.platescale * sigma_ln_platescale,
        rms_px: (squares / (2 * matched.len()).max(1) as f64).sqrt(),
        chi2_per_dof: fit.chi2_per_dof(),
        matches: matched,
        false_probability_log10: false_ln / std::f64::consts::LN_10,
        horizontal: None,
        epoch_yr: None,
        start: None,
        served: None,
    }
}
