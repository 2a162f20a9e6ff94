//! The final fit where sources may not be whole stars: trailed ones, discs, trails in pieces.
//!
//! The pose says where the stars are; their light, laid on top of each other, says where its middle lies; each matched star is measured
//! anew with that light as its template; and the pose is fitted to those. Twice, because the first pose may be that of one piece.

use super::fit::{Fit, Pair, Pose, fit};
use super::refine::moved;
use super::solver::{Context, Solver};
use super::verify::{Assigned, PatternSource, project_stars};
use crate::catalog::FieldStar;
use crate::sources::{KnownStar, Light, PIECE_SHARE, PlacedStar, REACH_PX, Source};

/// Stars are looked at for pieces where fewer of the sources tried than this are catalogued stars, or where they are wider than this.
const WHOLE_STARS_FRACTION: f64 = 0.75;
pub const SHARP_SIGMA_PX: f64 = 1.6;
/// Light no wider than this (long axis, in bins of two pixels), its middle where the sources were found but for this and a few σ, is that
/// of whole stars that the search has measured in the picture itself, better than halved.
pub const WHOLE_LIGHT_PX: f64 = 3.5;
const NEAR_PX: f64 = 0.2;
const NEAR_SIGMAS: f64 = 3.0;
/// Above this χ² per degree of freedom what was measured of the sources are not their stars' middles but bright spots in their discs.
const ILL_MEASURED_CHI2: f64 = 2.0;
/// Where a wide kernel was needed and the light can't be told, a star's middle is doubtful by this part of the kernel's width (from
/// rendered trails of 5 to 30 px).
const KERNEL_DOUBT: f64 = 1.5;
/// By so much a trail typically turns over its length, rad, rms (rendered trails: half of them straight, the others by up to 100°).
const BEND_RAD: f64 = 0.7;
/// A star further from the fit than this many σ (after inflation by the fit's own scatter) is left out; least number that is fitted.
const CLIP_SIGMAS: f64 = 3.5;
const LEAST_STARS: usize = 4;
/// Stars that lie further than this from the fit, rms per axis, px, were not measured but something else near them.
const WORST_RMS_PX: f64 = 2.0;
/// Above this χ² per degree of freedom stars of several kinds of pieces may be among them, and the middle is not surer than this part of
/// the rms (from rendered trails in pieces).
const POOR_CHI2: f64 = 4.0;
const POOR_OF_RMS: f64 = 0.5;
/// By this much more doubtful is the middle where a piece may not be seen, one σ per axis, px: of 140 rendered trails two miss a piece, and
/// are 1.3 and 1.6 px off per axis.
const HIDDEN_PX: f64 = 0.45;
/// A piece is surely not hidden where the stars that show none beside them all miss it with less than this probability.
const SURELY_SEEN: f64 = 1e-3;
/// Points are beside their light where the square of its distance is this many times that of chance, as by chance one frame in a hundred
/// has it. (Where any excess counts, two frames in three have σ a fifth too large.)
const SURELY_BESIDE: f64 = 4.6;
/// Pieces of a star's light nearer than this are seen together, px.
pub const SEEN_PX: f64 = 0.75 * REACH_PX;
/// Times that light and pose are measured in turn, and that stars are left out.
const ROUNDS: usize = 3;
const CLIP_ROUNDS: usize = 3;

/// How the final fit ended.
pub enum LightFit {
    /// The sources are whole stars where they were found; or nothing better is known, and all of them may be off by `doubt_px` (one σ).
    AsFound {
        /// Error that all sources have in common, px.
        doubt_px: f64,
    },
    /// Fitted to the stars measured anew.
    Anew(Box<Anew>),
}

/// A fit to stars measured by the light of all.
pub struct Anew {
    /// The fit.
    pub fit: Fit,
    /// The matches that it is made of.
    pub matches: Vec<Assigned>,
    /// Each source that was measured anew.
    pub placed: Vec<(usize, PlacedStar)>,
    /// Error that all stars have in common, px.
    pub sigma_px: f64,
}

/// Fits the pose to the light of the matched stars, where there is reason to. `sources` get their new offsets; the first `tried` of
/// them are those that patterns were made of. `years`: from the field's epoch to that of observation.
pub fn fit_by_light(
    solver: &Solver,
    context: &Context<'_>,
    first: &Fit,
    matches: &[Assigned],
    sources: &mut [PatternSource],
    tried: usize,
    years: f64,
) -> LightFit {
    let matched = matches.iter().filter(|m| m.source < tried).count();
    let in_pieces = (matched as f64) < WHOLE_STARS_FRACTION * tried as f64;
    let trailed = solver.finder.psf_axes.is_none_or(|(long, _)| long > SHARP_SIGMA_PX);
    let bent_px = solver.finder.psf_axes.map_or(0.0, bent_px);
    if !(in_pieces || trailed || context.scale > 0) {
        return LightFit::AsFound { doubt_px: bent_px };
    }
    let kernel_px = if context.scale == 0 { 0.0 } else { (1 << context.scale) as f64 };
    let unseen = LightFit::AsFound { doubt_px: KERNEL_DOUBT * kernel_px };
    let mut best: Option<Box<Anew>> = None;
    let mut pose_fit = first.clone();
    // How far the sources as they were found may be off, where they are those of whole stars.
    let mut whole_px: Option<f64> = None;
    for _ in 0..ROUNDS {
        let stars = known_stars(context, &pose_fit.pose, matches, sources);
        let Some(light) = solver.finder.light(&solver.cells, &stars.iter().map(|(_, star)| *star).collect::<Vec<_>>()) else {
            return best.map_or(unseen, LightFit::Anew);
        };
        let near = light.middle.0.hypot(light.middle.1) < NEAR_PX + NEAR_SIGMAS * light.sigma;
        let whole = near && light.axes.0 < WHOLE_LIGHT_PX;
        if whole && best.is_none() && context.scale == 0 {
            let hidden_px = if trailed && !shows_no_piece(solver, matches) { hidden_px(&light) } else { 0.0 };
            let doubt_px = beside_px(&light).max(hidden_px).max(bent_px);
            if first.chi2_per_dof() < ILL_MEASURED_CHI2 {
                return LightFit::AsFound { doubt_px };
            }
            whole_px = Some(doubt_px);
        }
        // The light is elsewhere, and not known well enough: so far may everything be off.
        let apart_px = light.middle.0.hypot(light.middle.1) * std::f64::consts::FRAC_1_SQRT_2;
        let elsewhere = LightFit::AsFound { doubt_px: apart_px.max(KERNEL_DOUBT * kernel_px).max(whole_px.unwrap_or(0.0)) };
        if light.doubtful && !near {
            return elsewhere;
        }
        let Some(anew) = fit_placed(solver, context, &light, &pose_fit, matches, &stars, years) else {
            return elsewhere;
        };
        pose_fit = anew.fit.clone();
        best = Some(Box::new(anew));
    }
    let Some(best) = best else { return unseen };
    if let Some(doubt_px) = whole_px
        && variance_px2(first) + doubt_px * doubt_px < variance_px2(&best.fit).max(best.sigma_px * best.sigma_px)
    {
        return LightFit::AsFound { doubt_px };
    }
    for (source, star) in &best.placed {
        if let Some(source) = sources.get_mut(*source) {
            (source.left, source.up) = context.camera.offsets(star.x, star.y);
            source.sigma = (0.5 * (star.covariance.0 + star.covariance.1)).sqrt();
        }
    }
    LightFit::Anew(best)
}

/// How far the places of trailed stars may be off the middle of their light because their trail is bent, one σ per axis, px. `axes`: σ of
/// their light along and across, px.
///
/// An arc of length L that turns by θ has the third moment ∫x²y = L³θ/360 about its middle; a Gaussian as wide as the light in the mean,
/// laid where it fits best, is off by half of that over the sum of both variances along it, across the trail alone.
fn bent_px((long, short): (f64, f64)) -> f64 {
    const THIRD_MOMENT: f64 = 1.0 / 360.0;
    let length = (12.0 * (long * long - short * short)).max(0.0).sqrt();
    let across = 0.5 * THIRD_MOMENT * length.powi(3) * BEND_RAD / (long * long + short * short);
    across * std::f64::consts::FRAC_1_SQRT_2
}

/// By how much more than chance has it are the sources beside their light, one σ per axis, px: what a trail that is not even on both
/// sides does.
fn beside_px(light: &Light) -> f64 {
    let chance_sq = light.sigma * light.sigma;
    let beside_sq = 0.5 * (light.middle.0.powi(2) + light.middle.1.powi(2)) - chance_sq;
    if beside_sq < (SURELY_BESIDE - 1.0) * chance_sq { 0.0 } else { beside_sq.max(0.0).sqrt() }
}

/// Variance of a fit's boresight per axis, px².
fn variance_px2(fit: &Fit) -> f64 {
    let (sky, _) = fit.sky_covariance();
    0.5 * (sky.m11 + sky.m22) / fit.pose.platescale.powi(2)
}

/// How far the middle may be off because a piece of the light is not seen, one σ, px.
fn hidden_px(light: &Light) -> f64 {
    if light.faint { HIDDEN_PX } else { 0.0 }
}

/// Whether the matched stars show that their light has no other piece: beside each of them it would be a source, found unless its noise
/// hides it. A star that has a source beside it, whatever that is, shows nothing.
fn shows_no_piece(solver: &Solver, matches: &[Assigned]) -> bool {
    let least = solver.settings().solver.sources.min_snr;
    let found = &solver.found;
    let is_beside = |a: &Source, b: &Source| (a.x - b.x).powi(2) + (a.y - b.y).powi(2) < REACH_PX * REACH_PX;
    let stars = matches.iter().filter_map(|m| Some((m.source, found.get(m.source)?))).filter(|(_, star)| !star.saturated);
    let alone = stars.filter(|&(index, star)| !found.iter().enumerate().any(|(i, other)| i != index && is_beside(star, other)));
    let missed = |star: &Source| 0.5 * libm::erfc((f64::from(PIECE_SHARE) * star.snr - least) * std::f64::consts::FRAC_1_SQRT_2);
    alone.map(|(_, star)| missed(star)).product::<f64>() < SURELY_SEEN
}

/// Stars of the field that a pose puts on the picture, brightest first, with the fluxes that the matched ones let expect.
pub(super) fn known_stars(
    context: &Context<'_>,
    pose: &Pose,
    matches: &[Assigned],
    sources: &[PatternSource],
) -> Vec<(usize, KnownStar)> {
    let field = context.field;
    let star_of = |m: &Assigned| field.stars.stars.get(m.star);
    let mut zero_points: Vec<f64> =
        matches.iter().filter_map(|m| Some(sources.get(m.source)?.mag - f64::from(star_of(m)?.mag))).collect();
    zero_points.sort_by(f64::total_cmp);
    let zero_point = zero_points.get(zero_points.len() / 2).copied().unwrap_or(0.0);
    let mut projected = Vec::new();
    project_stars(field, pose, &context.geometry, u8::MAX, &mut projected);
    let mut stars: Vec<(usize, KnownStar)> = projected
        .into_iter()
        .filter_map(|(index, left, up)| {
            let (x, y) = context.camera.position(left, up);
            let mag = f64::from(field.stars.stars.get(index)?.mag) + zero_point;
            Some((index, KnownStar { x, y, flux: 10f64.powf(-0.4 * mag) }))
        })
        .collect();
    stars.sort_by(|a, b| b.1.flux.total_cmp(&a.1.flux).then(a.0.cmp(&b.0)));
    stars
}

/// Measures every matched star by the light of all, and fits the pose to those that agree.
fn fit_placed(
    solver: &Solver,
    context: &Context<'_>,
    light: &Light,
    start: &Fit,
    matches: &[Assigned],
    stars: &[(usize, KnownStar)],
    years: f64,
) -> Option<Anew> {
    let (field, geometry) = (context.field, &context.geometry);
    let all: Vec<KnownStar> = stars.iter().map(|(_, star)| *star).collect();
    let mut entries: Vec<(Assigned, PlacedStar, Pair)> = matches
        .iter()
        .filter(|m| solver.found.get(m.source).is_some_and(|s| !s.saturated))
        .filter_map(|m| {
            let (_, known) = stars.iter().find(|(index, _)| *index == m.star)?;
            let placed = solver.finder.place(&solver.cells, light, known, &all)?;
            let star: &FieldStar = field.stars.stars.get(m.star)?;
            let (left, up) = context.camera.offsets(placed.x, placed.y);
            // The axes of the file may run against those of the camera.
            let (left_1, up_1) = context.camera.offsets(placed.x + 1.0, placed.y + 1.0);
            let turn = (left_1 - left) * (up_1 - up);
            let floor_sq = geometry.floor * geometry.floor;
            let (xx, yy, xy) = placed.covariance;
            let covariance = (xx + floor_sq, yy + floor_sq, turn * xy);
            Some((*m, placed, Pair::with_covariance(left, up, covariance, moved(star, field, &solver.catalogue, years))))
        })
        .collect();
    let mut result = None;
    let mut pose = start.pose;
    for _ in 0..CLIP_ROUNDS {
        if entries.len() < LEAST_STARS {
            return None;
        }
        let pairs: Vec<Pair> = entries.iter().map(|(_, _, pair)| *pair).collect();
        let fitted = fit(&pairs, &pose, geometry.half_diagonal, &geometry.prior)?;
        pose = fitted.pose;
        let limit = CLIP_SIGMAS.powi(2) * fitted.chi2_per_dof().max(1.0);
        result = Some(fitted);
        entries.retain(|(_, _, pair)| {
            pose.project(&pair.star, geometry.half_diagonal).is_some_and(|(left, up)| pair.distance_sq(left, up) <= limit)
        });
    }
    let fit = result?;
    let squares = entries.iter().map(|(_, _, pair)| {
        let (left, up) = pose.project(&pair.star, geometry.half_diagonal).unwrap_or((f64::INFINITY, f64::INFINITY));
        (pair.left - left).powi(2) + (pair.up - up).powi(2)
    });
    let rms_px = (squares.sum::<f64>() / (2 * entries.len()) as f64).sqrt();
    if !(rms_px <= WORST_RMS_PX) {
        return None;
    }
    let matches = entries.iter().map(|(m, _, _)| *m).collect();
    let placed = entries.iter().map(|(m, star, _)| (m.source, *star)).collect();
    // Stars that scatter more than their σ say show that the template is not quite theirs; its middle is as much less sure.
    let scatter_sq = fit.chi2_per_dof();
    let misfit_px = if scatter_sq > POOR_CHI2 { POOR_OF_RMS * rms_px } else { 0.0 };
    let cut_px = if light.cut { REACH_PX } else { 0.0 };
    let sigma_px = (light.sigma * scatter_sq.sqrt().max(1.0)).max(misfit_px).max(cut_px).max(hidden_px(light));
    Some(Anew { fit, matches, placed, sigma_px })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// How far a Gaussian as wide as the light of an arc is off its middle, px: along and across.
    fn off_middle(length: f64, turn: f64, star_sigma: f64) -> ((f64, f64), (f64, f64)) {
        const PLACES: usize = 401;
        let heading = |i: usize| turn * ((i as f64 + 0.5) / PLACES as f64 - 0.5);
        let mut at = (0.0, 0.0);
        let mut places = Vec::new();
        for i in 0..PLACES {
            places.push(at);
            at = (at.0 + length / PLACES as f64 * heading(i).cos(), at.1 + length / PLACES as f64 * heading(i).sin());
        }
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| places.iter().map(of).sum::<f64>() / PLACES as f64;
        let (mx, my) = (mean(&|p| p.0), mean(&|p| p.1));
        let (vx, vy) = (mean(&|p| (p.0 - mx).powi(2)), mean(&|p| (p.1 - my).powi(2)));
        let star = star_sigma * star_sigma;
        // Weight times star: Gaussians whose product is one about a point between, with a height that falls with their distance.
        let (wx, wy) = (vx + star, vy + star);
        let (mut x, mut y) = (0.0, 0.0);
        for _ in 0..100 {
            let (mut sum, mut sx, mut sy) = (0.0, 0.0, 0.0);
            for p in &places {
                let (dx, dy) = (p.0 - mx - x, p.1 - my - y);
                let height = (-0.5 * (dx * dx / (wx + star) + dy * dy / (wy + star))).exp();
                sum += height;
                sx += height * dx * wx / (wx + star);
                sy += height * dy * wy / (wy + star);
            }
            (x, y) = (x + sx / sum, y + sy / sum);
        }
        ((x, y), (wx.sqrt(), wy.sqrt()))
    }

    #[test]
    fn a_bent_trail_is_found_beside_its_middle_by_as_much_as_is_said() {
        for length in [2.0, 3.5, 5.0] {
            let ((along, across), axes) = off_middle(length, BEND_RAD, 1.05);
            // Per axis, of one that is off across alone.
            let said = bent_px(axes) * std::f64::consts::SQRT_2;
            assert!(along.abs() < 0.1 * across.abs(), "{along} {across}");
            assert!((0.7..1.5).contains(&(said / across.abs())), "{length} px: {said} for {across}");
        }
    }

    #[test]
    fn round_light_is_where_it_is_found() {
        assert_eq!(bent_px((1.1, 1.1)), 0.0);
        assert!(bent_px((1.1, 1.0)) < 0.002);
    }
}
