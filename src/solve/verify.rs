//! Verification: how much better a candidate attitude explains the sources than chance does.
//!
//! Null hypothesis: sources lie anywhere on the picture. Alternative: each source is, with probability 1 − d, one of the catalogued stars
//! that the attitude puts there, and no star is two sources. The mean of the ratio of the two likelihoods over all poses exceeds e^T by
//! chance with probability under e^−T (Markov), and it is at least what the peak around one pose adds to it: the ratio there, times the
//! part of all poses that the peak fills (Laplace). So `−ln peak − log odds` bounds the probability that the best candidate is false, and
//! the threshold follows from what was searched, not from experience.

use super::fit::{FitPrior, Pair, Pose, fit};
use super::track::{LensPrior, REACH_SIGMAS};
use crate::catalog::Field;
use crate::settings::SolverSettings;
use crate::sky::Vec3;

/// A source as the matcher sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatternSource {
    /// Offset from the centre along left, px.
    pub left: f64,
    /// Offset from the centre along up, px.
    pub up: f64,
    /// One σ of either, px.
    pub sigma: f64,
    /// Brightness, −2.5 log10 of the flux.
    pub mag: f64,
    /// Direction in the camera frame at the plate scale in the middle of its range.
    pub direction: Vec3,
    /// Covariance of the offsets, left-left, up-up, left-up, px², where they are not known alike.
    pub covariance: Option<(f64, f64, f64)>,
    /// Probability that it is no catalogued star.
    pub stray: f64,
}

/// Least flux that has a brightness: far below what any source has, in ADU or in electrons.
const LEAST_FLUX: f64 = 1e-3;

impl PatternSource {
    /// A source at offsets from the centre along left and up, px, with one σ of either, px, and its flux in any unit, for a camera
    /// whose plate scale is about `platescale`, rad/px.
    pub fn new(left: f64, up: f64, sigma: f64, flux: f64, platescale: f64) -> Self {
        let direction = Vec3::new(left * platescale, up * platescale, 1.0).normalize();
        Self { left, up, sigma, mag: -2.5 * flux.max(LEAST_FLUX).log10(), direction, covariance: None, stray: STRAY }
    }

    /// The same of a source along its trail: with the covariance of its place, left-left, up-up, left-up, px², and the probability that
    /// noise alone made it.
    #[must_use]
    pub fn trailed(self, covariance: (f64, f64, f64), noise: f64) -> Self {
        /// No source is noise beyond doubt.
        const MOST: f64 = 0.99;
        Self { covariance: Some(covariance), stray: 1.0 - (1.0 - STRAY) * (1.0 - noise.clamp(0.0, MOST)), ..self }
    }

    /// Its place as that of a star, with a floor of its σ, px.
    pub fn pair(&self, star: Vec3, floor: f64) -> Pair {
        match self.covariance {
            None => Pair::round(self.left, self.up, self.sigma.hypot(floor), star),
            Some((ll, uu, lu)) => Pair::with_covariance(self.left, self.up, (ll + floor * floor, uu + floor * floor, lu), star),
        }
    }

    /// Density of its place, px⁻², where a star is in truth at an offset and what no noise explains has this σ, px.
    fn density(&self, left: f64, up: f64, extra: f64) -> f64 {
        let (dl, du) = (left - self.left, up - self.up);
        let Some((ll, uu, lu)) = self.covariance else {
            let variance = extra * extra + self.sigma * self.sigma;
            return (-0.5 * (dl * dl + du * du) / variance).exp() / (std::f64::consts::TAU * variance);
        };
        let (ll, uu) = (ll + extra * extra, uu + extra * extra);
        let determinant = ll * uu - lu * lu;
        let distance_sq = (uu * dl * dl - 2.0 * lu * dl * du + ll * du * du) / determinant;
        (-0.5 * distance_sq).exp() / (std::f64::consts::TAU * determinant.sqrt())
    }
}

/// How many of some sources are more than noise.
pub fn beyond_noise(sources: &[PatternSource]) -> f64 {
    sources.iter().map(|source| (1.0 - source.stray) / (1.0 - STRAY)).sum()
}

/// A source and the star of the field that it may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Assigned {
    /// Index of the source.
    pub source: usize,
    /// Index of the star among the field's.
    pub star: usize,
}

/// A candidate that was looked at in full.
#[derive(Debug, Clone, PartialEq)]
pub struct Hypothesis {
    /// Fitted pose.
    pub pose: Pose,
    /// One-to-one matches.
    pub matches: Vec<Assigned>,
    /// ln of the likelihood ratio.
    pub log_odds: f64,
    /// ln of the part of all poses that are searched, over the whole sky, that fit as well as this one.
    pub ln_peak: f64,
    /// Upper bound of the probability that a candidate as good as this is chance, natural logarithm.
    pub false_ln: f64,
}

/// What verification needs to know of the frame.
#[derive(Debug, Clone, Copy)]
pub struct FrameGeometry {
    /// Columns and rows, px.
    pub size: (f64, f64),
    /// Half the diagonal, px.
    pub half_diagonal: f64,
    /// A source within this distance of a star may be it, px.
    pub tolerance: f64,
    /// Error of a centroid that no noise explains, px.
    pub floor: f64,
    /// Least and greatest plate scale that is looked for, rad/px.
    pub platescale_range: (f64, f64),
    /// What is known of the camera.
    pub prior: FitPrior,
}

impl FrameGeometry {
    /// The geometry of frames of `width` × `height` px, for which `field` was made.
    pub fn new(settings: &SolverSettings, field: &Field, width: usize, height: usize) -> Self {
        let size = (width as f64, height as f64);
        let (low, high) = field.platescale_range;
        Self {
            size,
            half_diagonal: 0.5 * size.0.hypot(size.1),
            tolerance: settings.matching.tolerance_px,
            floor: settings.fit.centroid_floor_px,
            platescale_range: field.platescale_range,
            prior: FitPrior {
                platescale: field.geometry.platescale,
                // Three of these reach well past the range: it must not pull a plate scale that is inside.
                sigma_ln_platescale: (high - low) / (high + low),
                k1: settings.fit.distortion_k1,
                sigma_k1: settings.fit.distortion_sigma,
                axis: (settings.fit.axis_left_px, settings.fit.axis_up_px),
                sigma_axis_px: settings.fit.axis_sigma_px,
            },
        }
    }

    /// The same where earlier frames have shown plate scale and distortion. One outside the range is not believed.
    pub fn with_lens(self, lens: &LensPrior) -> Self {
        let reach = REACH_SIGMAS * lens.sigma_ln;
        let (low, high) = self.platescale_range;
        let platescale_range = (low.max(lens.platescale * (1.0 - reach)), high.min(lens.platescale * (1.0 + reach)));
        if !(platescale_range.0 < platescale_range.1 && lens.sigma_ln > 0.0 && lens.k1.is_finite()) {
            return self;
        }
        let prior = FitPrior {
            platescale: lens.platescale,
            sigma_ln_platescale: lens.sigma_ln.min(self.prior.sigma_ln_platescale),
            k1: lens.k1,
            sigma_k1: lens.sigma_k1.min(self.prior.sigma_k1),
            ..self.prior
        };
        Self { platescale_range, prior, ..self }
    }
}

impl FrameGeometry {
    /// Whether the plate scale is known so well that no star is far off its place for that.
    pub fn knows_lens(&self) -> bool {
        /// One σ at the corner, px: as wide as a sharp star is.
        const UNSEEN_PX: f64 = 1.0;
        self.prior.sigma_ln_platescale * self.half_diagonal < UNSEEN_PX
    }
}

/// A source that is more than noise is no catalogued star with this probability.
const STRAY: f64 = 0.5;
/// Positional errors beyond a source's own σ that are averaged over, px: distortion, blends, the fit itself.
const EXTRA_SIGMAS: [f64; 3] = [SHARPEST_PX, 0.6, 1.2];
/// The least of them.
pub const SHARPEST_PX: f64 = 0.25;
/// Scatter of star magnitudes about those seen, and the density of chance magnitudes, per mag; a share that knows nothing.
const MAG_SIGMA: f64 = 0.65;
const MAG_CHANCE: f64 = 0.25;
const MAG_UNKNOWN: f64 = 0.03;
/// How many of a picture's brightest stars the sources may be made of, as parts of the greatest number, that are averaged over: nearly
/// all sources are stars and some stars are missing, or most sources are false.
const DEPTHS: [f64; 3] = [1.0, 0.5, 0.25];
/// Share of the probability for the stars that ought to be seen; the rest is for fainter ones.
const BRIGHT_SHARE: f64 = 0.75;

/// Stars of the field that a pose puts on the picture, with where.
pub fn project_stars(field: &Field, pose: &Pose, geometry: &FrameGeometry, rank_below: u8, out: &mut Vec<(usize, f64, f64)>) {
    let near = stars_near(field, pose, geometry, rank_below);
    project(&near, field, pose, geometry, out);
}

/// Stars of the field around the picture that a pose takes: all that are on it, and on that of any pose which differs by no more than
/// some pixels.
fn stars_near(field: &Field, pose: &Pose, geometry: &FrameGeometry, rank_below: u8) -> Vec<usize> {
    /// Part of the half diagonal beyond it: three times the tolerance that flies.
    const MARGIN: f64 = 0.02;
    let mut near = Vec::new();
    let radius = (1.0 + MARGIN) * (geometry.half_diagonal * pose.platescale).atan();
    field.stars.near(&pose.attitude.boresight(), radius, |i, star| {
        if star.rank < rank_below {
            near.push(i);
        }
    });
    near
}

/// Those of some stars that a pose puts on the picture, with where.
fn project(near: &[usize], field: &Field, pose: &Pose, geometry: &FrameGeometry, out: &mut Vec<(usize, f64, f64)>) {
    out.clear();
    let (half_w, half_h) = (0.5 * geometry.size.0 + geometry.tolerance, 0.5 * geometry.size.1 + geometry.tolerance);
    for &i in near {
        if let Some(star) = field.stars.stars.get(i)
            && let Some((left, up)) = pose.project(&star.direction, geometry.half_diagonal)
            && left.abs() <= half_w
            && up.abs() <= half_h
        {
            out.push((i, left, up));
        }
    }
}

/// One-to-one assignment of sources to projected stars within a tolerance that may differ by source: nearest pairs first.
pub fn assign(
    sources: &[PatternSource],
    stars: &[(usize, f64, f64)],
    tolerance: impl Fn(&PatternSource) -> f64,
    matches: &mut Vec<Assigned>,
) {
    let mut close: Vec<(f64, usize, usize)> = Vec::new();
    for (k, source) in sources.iter().enumerate() {
        let limit = tolerance(source).powi(2);
        for &(star, left, up) in stars {
            let distance_sq = (left - source.left).powi(2) + (up - source.up).powi(2);
            if distance_sq <= limit {
                close.push((distance_sq, k, star));
            }
        }
    }
    close.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)).then(a.2.cmp(&b.2)));
    matches.clear();
    for (_, source, star) in close {
        if matches.iter().all(|m| m.source != source && m.star != star) {
            matches.push(Assigned { source, star });
        }
    }
    matches.sort_by_key(|m| m.source);
}

/// The pairs to fit of some matches.
pub fn pairs_of(sources: &[PatternSource], matches: &[Assigned], field: &Field, floor: f64) -> Vec<Pair> {
    matches
        .iter()
        .filter_map(|m| Some((sources.get(m.source)?, field.stars.stars.get(m.star)?)))
        .map(|(source, star)| source.pair(star.direction, floor))
        .collect()
}

/// Looks at a candidate in full: match, fit, match again, fit again, log odds. `None` where too few sources match.
pub fn verify(
    sources: &[PatternSource],
    start: &Pose,
    field: &Field,
    geometry: &FrameGeometry,
    min_matched: usize,
) -> Option<Hypothesis> {
    /// Fewer than these fit many a pose of the whole sky.
    const LEAST: usize = 4;
    verify_from(sources, start, field, geometry, min_matched.max(LEAST), min_matched)
}

/// As [`verify`], with `at_first` sources that must match before the pose is fitted.
pub fn verify_from(
    sources: &[PatternSource],
    start: &Pose,
    field: &Field,
    geometry: &FrameGeometry,
    at_first: usize,
    min_matched: usize,
) -> Option<Hypothesis> {
    let mut pose = *start;
    let mut ln_peak = 0.0;
    let near = stars_near(field, start, geometry, field.verification_rank);
    let (mut stars, mut matches) = (Vec::new(), Vec::new());
    // The first round's tolerance allows for what a small triangle's errors become at the far corner. All σ are nearly equal here: a
    // wrong pair among right ones must not dominate by a small σ.
    const LEAST_SIGMA_PX: f64 = 0.5;
    for tolerance in [geometry.tolerance, 0.6 * geometry.tolerance] {
        project(&near, field, &pose, geometry, &mut stars);
        assign(sources, &stars, |_| tolerance, &mut matches);
        if matches.len() < at_first {
            return None;
        }
        let pairs = pairs_of(sources, &matches, field, geometry.floor.hypot(LEAST_SIGMA_PX));
        let fitted = fit(&pairs, &pose, geometry.half_diagonal, &geometry.prior)?;
        (pose, ln_peak) = (fitted.pose, fitted.ln_peak(&geometry.prior));
    }
    project(&near, field, &pose, geometry, &mut stars);
    assign(sources, &stars, |_| 0.6 * geometry.tolerance, &mut matches);
    if matches.len() < min_matched {
        return None;
    }
    let log_odds = log_odds(sources, &matches, &stars, field, geometry.size.0 * geometry.size.1);
    Some(Hypothesis { pose, matches, log_odds, ln_peak, false_ln: f64::INFINITY })
}

/// ln of the likelihood ratio of an assignment to `stars`, which are those on the picture, with where.
fn log_odds(sources: &[PatternSource], matches: &[Assigned], stars: &[(usize, f64, f64)], field: &Field, area: f64) -> f64 {
    let mag = |star: usize| field.stars.stars.get(star).map_or(f32::INFINITY, |s| s.mag);
    let mut zero_points: Vec<f64> =
        matches.iter().filter_map(|m| Some(sources.get(m.source)?.mag - f64::from(mag(m.star)))).collect();
    zero_points.sort_by(f64::total_cmp);
    let zero_point = zero_points.get(zero_points.len() / 2).copied().unwrap_or(0.0);
    // Of each match: the star's place among the stars on the picture, brightest first, how much likelier it makes the source, and how likely
    // that is stray.
    let mut ranked: Vec<(f64, f64, f64)> = Vec::with_capacity(matches.len());
    for m in matches {
        let Some((source, &(_, left, up))) = sources.get(m.source).zip(stars.iter().find(|s| s.0 == m.star)) else { continue };
        let rank = 1 + stars.iter().filter(|s| mag(s.0) < mag(m.star)).count();
        let density = EXTRA_SIGMAS.iter().map(|extra| source.density(left, up, *extra));
        let density = density.sum::<f64>() / EXTRA_SIGMAS.len() as f64;
        let dm = source.mag - f64::from(mag(m.star)) - zero_point;
        let normal = (-0.5 * (dm / MAG_SIGMA).powi(2)).exp() / (MAG_SIGMA * std::f64::consts::TAU.sqrt());
        ranked.push((rank as f64, area * density * (normal / MAG_CHANCE + MAG_UNKNOWN), source.stray));
    }
    let deepest = 1.3 * beyond_noise(sources) + 4.0;
    let ratios = DEPTHS.map(|depth| {
        let depth = depth * deepest;
        let (mut total, mut left) = (0.0, depth);
        for &(rank, likelier, stray) in &ranked {
            // The one or other of the stars that no other source is.
            let this_star =
                if rank <= depth { BRIGHT_SHARE / left.max(1.0) } else { (1.0 - BRIGHT_SHARE) * depth / (rank * rank) };
            let ratio = (1.0 - stray) * this_star * likelier;
            // What fits no better than chance is chance, and the star is free for another source.
            if ratio > stray {
                total += ratio.ln();
                left -= if rank <= depth { 1.0 } else { 0.0 };
            } else {
                total += stray.ln();
            }
        }
        total
    });
    let greatest = ratios.iter().copied().fold(f64::MIN, f64::max);
    let mean = ratios.iter().map(|ratio| (ratio - greatest).exp()).sum::<f64>() / ratios.len() as f64;
    let matched = |i: usize| matches.iter().any(|m| m.source == i);
    let unmatched: f64 = sources.iter().enumerate().filter(|(i, _)| !matched(*i)).map(|(_, source)| source.stray.ln()).sum();
    unmatched + greatest + mean.ln()
}
