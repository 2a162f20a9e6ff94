//! The pattern search: triangles of sources, then pairs, looked up in the index, screened and verified.
//!
//! Triangles come in the order of the faintest source in them, so that one bright false source blocks nothing. A triangle's
//! candidates are screened by turning all sources onto the sky and asking a bitmap whether a star is there; few false ones pass.
//! What is left is verified in full. The budget is counted in candidates, so that the same frame always gives the same outcome.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: indices run over the list of sources itself")]

use super::Stop;
use super::fit::Pose;
use super::verify::{FrameGeometry, Hypothesis, PatternSource, ln_hypotheses, verify};
use crate::catalog::{Field, TriangleQuery, shape};
use crate::sky::{Attitude, Kernel, Vec3, with_vectors};

/// Half width of the box in which a triangle's shape is looked for, px over the longest side (trials: loses nothing at 1 px of
/// centroid error).
const SHAPE_TOLERANCE_PX: f64 = 2.5;
/// Sources beyond the pattern that must fall on a star: with few sources two are enough, with many chance gives two.
const FEW_SOURCES: usize = 9;
/// Sources that a pattern can be made of: as many as a word has bits.
pub const MAX_SOURCES: usize = 32;
/// Triangles remembered for the display.
const REMEMBERED: usize = 64;
/// Share of the budget that pairs may use: a last resort.
const PAIR_SHARE: f64 = 0.01;

/// Whether the boresight may point in a direction.
pub type Allows<'a> = &'a dyn Fn(&Vec3) -> bool;

/// What the search is bound by.
pub struct SearchRules<'a> {
    /// Fewest matches of a solution.
    pub min_matched: usize,
    /// Greatest ln probability that a solution is false.
    pub max_false_ln: f64,
    /// Candidates that may be screened.
    pub budget: u64,
    /// The part of the sky that the prior allows, where the boresight may be inside it: fraction and test.
    pub region: Option<(f64, Allows<'a>)>,
    /// Whether only attitudes inside the region are looked at.
    pub region_only: bool,
    /// Asked every few hundred candidates.
    pub stop: &'a dyn Fn() -> Option<Stop>,
}

/// How a search ended.
#[derive(Debug, Clone, PartialEq)]
pub enum SearchEnd {
    /// A candidate that chance does not explain.
    Found(Hypothesis),
    /// Everything was tried; the best candidate, if any was worth verifying.
    Exhausted(Option<Hypothesis>),
    /// The budget is used up; as `Exhausted`.
    Budget(Option<Hypothesis>),
    /// Stopped from outside.
    Stopped(Stop),
}

/// Tallies of a search.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SearchTally {
    /// Candidates screened.
    pub candidates: u64,
    /// Candidates verified.
    pub verified: u64,
    /// The last triangles tried, as indices of sources.
    pub triangles: Vec<[u8; 3]>,
}

/// Three directions' own tangent plane: at their middle, the first axis along the side from the first to the second.
struct Plane {
    middle: Vec3,
    along: Vec3,
    across: Vec3,
}

impl Plane {
    fn new(a: &Vec3, b: &Vec3, middle: Vec3) -> Self {
        let middle = middle.normalize();
        let ab = b - a;
        let along = (ab - middle * ab.dot(&middle)).normalize();
        Self { along, across: middle.cross(&along), middle }
    }

    #[inline]
    fn project(&self, d: &Vec3) -> (f64, f64) {
        let depth = 1.0 / d.dot(&self.middle);
        (d.dot(&self.along) * depth, d.dot(&self.across) * depth)
    }

    #[inline]
    fn lift(&self, (u, v): (f64, f64)) -> Vec3 {
        self.middle + self.along * u + self.across * v
    }
}

/// Rotation, scale and shift in a plane: w = a z + d as complex numbers.
struct Similarity {
    a: (f64, f64),
    d: (f64, f64),
}

impl Similarity {
    /// Least squares over the given points.
    #[inline(always)]
    fn fit<const N: usize>(from: &[(f64, f64); N], to: &[(f64, f64); N]) -> Self {
        let n = N as f64;
        let mean = |p: &[(f64, f64); N]| (p.iter().map(|q| q.0).sum::<f64>() / n, p.iter().map(|q| q.1).sum::<f64>() / n);
        let (zm, wm) = (mean(from), mean(to));
        let (mut re, mut im, mut norm) = (0.0, 0.0, 0.0);
        for (z, w) in from.iter().zip(to) {
            let (zx, zy, wx, wy) = (z.0 - zm.0, z.1 - zm.1, w.0 - wm.0, w.1 - wm.1);
            re += wx * zx + wy * zy;
            im += wy * zx - wx * zy;
            norm += zx * zx + zy * zy;
        }
        let a = (re / norm, im / norm);
        Self { a, d: (wm.0 - (a.0 * zm.0 - a.1 * zm.1), wm.1 - (a.0 * zm.1 + a.1 * zm.0)) }
    }

    #[inline]
    fn apply(&self, z: (f64, f64)) -> (f64, f64) {
        (self.a.0 * z.0 - self.a.1 * z.1 + self.d.0, self.a.0 * z.1 + self.a.1 * z.0 + self.d.1)
    }

    fn scale(&self) -> f64 {
        self.a.0.hypot(self.a.1)
    }
}

/// A search over one list of sources.
pub struct PatternSearch<'a> {
    field: &'a Field,
    sources: &'a [PatternSource],
    geometry: &'a FrameGeometry,
    rules: &'a SearchRules<'a>,
    need: usize,
    /// ln of the number of hypotheses over the whole sky, and inside the region.
    ln_whole: f64,
    ln_region: f64,
    best: Option<Hypothesis>,
    tally: SearchTally,
}

impl<'a> PatternSearch<'a> {
    /// A search for where `sources`, brightest first, lie on the sky.
    ///
    /// Of more than [`MAX_SOURCES`] the rest is left out.
    pub fn new(field: &'a Field, sources: &'a [PatternSource], geometry: &'a FrameGeometry, rules: &'a SearchRules<'a>) -> Self {
        let sources = &sources[..sources.len().min(MAX_SOURCES)];
        let fraction = rules.region.as_ref().map_or(1.0, |r| r.0);
        Self {
            field,
            sources,
            geometry,
            rules,
            need: if sources.len() > FEW_SOURCES { 3 } else { 2 },
            ln_whole: ln_hypotheses(sources.len(), geometry, field, 1.0),
            ln_region: ln_hypotheses(sources.len(), geometry, field, fraction),
            best: None,
            tally: SearchTally::default(),
        }
    }

    /// Runs the search to its end.
    pub fn run(mut self) -> (SearchEnd, SearchTally) {
        let end = with_vectors(Patterns(&mut self));
        let end = end.unwrap_or_else(|| SearchEnd::Exhausted(self.best.take()));
        (end, self.tally)
    }

    /// Every triangle of sources, by the faintest in it.
    #[inline(always)]
    fn triangles(&mut self) -> Option<SearchEnd> {
        for k in 2..self.sources.len() {
            for j in 1..k {
                for i in 0..j {
                    if let Some(end) = self.triangle([i, j, k]) {
                        return Some(end);
                    }
                }
            }
        }
        None
    }

    /// One triangle of sources, in every labelling that the errors of its corners allow.
    #[inline(always)]
    fn triangle(&mut self, corners: [usize; 3]) -> Option<SearchEnd> {
        let [p, q, r] = corners;
        let mut looked_up = false;
        for [a, b, c] in [[p, q, r], [q, p, r], [p, r, q], [r, p, q], [q, r, p], [r, q, p]] {
            let (x, y, length) = shape(&self.sources[a].direction, &self.sources[b].direction, &self.sources[c].direction);
            let slack = SHAPE_TOLERANCE_PX * self.field.geometry.platescale / length;
            let longest = x * x + y * y <= (1.0 + slack).powi(2) && (1.0 - x).powi(2) + y * y <= (1.0 + slack).powi(2);
            if !longest || x > 0.5 + slack {
                continue;
            }
            let query = TriangleQuery { x, y, tolerance: slack, length: self.length_range(length) };
            let source_plane = self.plane_of_sources([a, b, c]);
            let mut end = None;
            let field = self.field;
            field.triangles.triangles(&query, |stars| {
                if end.is_none() {
                    let star = stars.map(|s| *field.triangles.direction(s));
                    end = self.candidate(&source_plane, &star);
                }
            });
            looked_up = true;
            if end.is_some() {
                self.remember(corners);
                return end;
            }
        }
        if looked_up {
            self.remember(corners);
        }
        None
    }

    /// Every short pair of sources, both ways round, within its share of the budget.
    #[inline(always)]
    fn pairs(&mut self) -> Option<SearchEnd> {
        let spent = self.tally.candidates;
        let allowed = (self.rules.budget as f64 * PAIR_SHARE) as u64;
        for j in 1..self.sources.len() {
            for i in 0..j {
                let length = (self.sources[j].direction - self.sources[i].direction).norm();
                if length < self.field.triangles.sides().0 || length > self.field.triangles.longest_pair() {
                    continue;
                }
                let plane = self.plane_of_sources([i, j]);
                let mut end = None;
                let field = self.field;
                field.triangles.pairs(self.length_range(length), |[a, b]| {
                    for star in [[a, b], [b, a]] {
                        if end.is_none() && self.tally.candidates - spent < allowed {
                            let star = star.map(|s| *field.triangles.direction(s));
                            end = self.candidate(&plane, &star);
                        }
                    }
                });
                if end.is_some() {
                    return end;
                }
                if self.tally.candidates - spent >= allowed {
                    return None;
                }
            }
        }
        None
    }

    /// Lengths on the sky that a length at the middle plate scale may be.
    fn length_range(&self, length: f64) -> (f64, f64) {
        let (low, high) = self.field.platescale_range;
        let middle = self.field.geometry.platescale;
        let slack = SHAPE_TOLERANCE_PX * middle;
        ((length * low / middle - slack).max(0.0), length * high / middle + slack)
    }

    /// The tangent plane of the sources at some corners.
    #[inline(always)]
    fn plane_of_sources<const N: usize>(&self, corners: [usize; N]) -> SourcePlane<N> {
        let plane = Plane::new(
            &self.sources[corners[0]].direction,
            &self.sources[corners[1]].direction,
            corners.iter().map(|&c| self.sources[c].direction).sum(),
        );
        let up = Vec3::new(0.0, 0.02, 1.0);
        let points = self.sources.iter().take(MAX_SOURCES).map(|s| plane.project(&s.direction));
        let (mut x, mut y) = ([0f32; MAX_SOURCES], [0f32; MAX_SOURCES]);
        for (i, point) in points.enumerate() {
            (x[i], y[i]) = (point.0 as f32, point.1 as f32);
        }
        SourcePlane {
            at: corners.map(|c| plane.project(&self.sources[c].direction)),
            x,
            y,
            corners: corners.iter().map(|&c| 1u32 << c).fold(!0 << (self.sources.len() - 1) << 1, |bits, c| bits | c),
            boresight: plane.project(&Vec3::z()),
            up: plane.project(&up),
        }
    }

    /// Screens one candidate: the corners are these stars; verifies it where enough other sources fall on stars.
    #[inline(always)]
    fn candidate<const N: usize>(&mut self, plane: &SourcePlane<N>, stars: &[Vec3; N]) -> Option<SearchEnd> {
        self.tally.candidates += 1;
        if self.tally.candidates.is_multiple_of(256)
            && let Some(stop) = (self.rules.stop)()
        {
            return Some(SearchEnd::Stopped(stop));
        }
        if self.tally.candidates > self.rules.budget {
            return Some(SearchEnd::Budget(self.best.take()));
        }
        let middle: Vec3 = stars.iter().sum();
        let sky = Plane::new(&stars[0], &stars[1], middle);
        let similarity = Similarity::fit(&plane.at, &stars.map(|s| sky.project(&s)));
        let platescale = self.field.geometry.platescale * similarity.scale();
        let boresight = sky.lift(similarity.apply(plane.boresight));
        let inside = self.rules.region.as_ref().is_none_or(|(_, allows)| allows(&boresight.normalize()));
        if self.rules.region_only && !inside {
            return None;
        }
        // The similarity and the lift in one: a point z goes to m + Re z · p + Im z · q.
        let turned = [
            sky.lift(similarity.d),
            sky.along * similarity.a.0 + sky.across * similarity.a.1,
            sky.across * similarity.a.0 - sky.along * similarity.a.1,
        ];
        let hits = self.field.bitmap.hits(&turned, &plane.x, &plane.y) & !plane.corners;
        if (hits.count_ones() as usize) < self.need {
            return None;
        }
        let up = sky.lift(similarity.apply(plane.up)).normalize() - boresight.normalize();
        let attitude = Attitude::from_boresight_up(&boresight, &up)?;
        self.verified(&Pose { attitude, platescale, k1: 0.0 }, N + self.need)
    }

    /// Verifies a pose; ends the search where chance does not explain it.
    fn verified(&mut self, pose: &Pose, min_matched: usize) -> Option<SearchEnd> {
        self.tally.verified += 1;
        let min_matched = min_matched.min(self.rules.min_matched);
        let mut hypothesis = verify(self.sources, pose, self.field, self.geometry, min_matched)?;
        let inside = self.rules.region.as_ref().is_some_and(|(_, allows)| allows(&hypothesis.pose.attitude.boresight()));
        hypothesis.false_ln = (if inside { self.ln_region } else { self.ln_whole }) - hypothesis.log_odds;
        if hypothesis.false_ln <= self.rules.max_false_ln && hypothesis.matches.len() >= self.rules.min_matched {
            return Some(SearchEnd::Found(hypothesis));
        }
        if self.best.as_ref().is_none_or(|best| hypothesis.false_ln < best.false_ln) {
            self.best = Some(hypothesis);
        }
        None
    }

    fn remember(&mut self, corners: [usize; 3]) {
        if self.tally.triangles.len() == REMEMBERED {
            self.tally.triangles.remove(0);
        }
        self.tally.triangles.push(corners.map(|c| c.min(usize::from(u8::MAX)) as u8));
    }
}

/// All patterns of a search, as a kernel.
struct Patterns<'s, 'a>(&'s mut PatternSearch<'a>);

impl Kernel for Patterns<'_, '_> {
    type Output = Option<SearchEnd>;

    #[inline(always)]
    fn run(self) -> Option<SearchEnd> {
        self.0.triangles().or_else(|| self.0.pairs())
    }
}

/// The sources, the boresight and a point above it in the tangent plane of a pattern with N corners.
struct SourcePlane<const N: usize> {
    /// The corners.
    at: [(f64, f64); N],
    /// Every source.
    x: [f32; MAX_SOURCES],
    y: [f32; MAX_SOURCES],
    /// Bits of what does not count as a hit: the corners, and the places behind the last source.
    corners: u32,
    boresight: (f64, f64),
    up: (f64, f64),
}
