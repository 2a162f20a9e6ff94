//! The pattern search: triangles of sources, looked up in the index, screened and verified.
//!
//! Triangles come in the order of the faintest source in them, so that one bright false source blocks nothing. A triangle's
//! candidates are screened by turning all sources onto the sky and asking a bitmap whether a star is there; few false ones pass.
//! What is left is verified in full. The budget is counted in candidates, so that the same frame always gives the same outcome.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: indices run over the list of sources itself")]

use super::Stop;
use super::fit::Pose;
use super::verify::{FrameGeometry, Hypothesis, PatternSource, beyond_noise, verify};
use crate::catalog::{Field, FoundTriangle, POINTS, Runs, TriangleQuery, shape};
use crate::sky::{Attitude, Kernel, Vec3, with_vectors};

/// How far a corner may lie from where the star is, in its own σ and, beyond that, for the optics' distortion, px (trials: wider
/// boxes bring more chance candidates than right ones; more triangles in the index are the cheaper hedge).
const CORNER_SIGMAS: f64 = 2.0;
const DISTORTED_PX: f64 = 1.0;
/// Sources beyond the pattern that must fall on a star: with few sources two are enough, with many chance gives two.
const FEW_SOURCES: usize = 9;
/// Sources of either end of the list that are looked at first: a pose of which none of them beyond the corners falls on a star is not
/// looked at further. (Each look waits for memory; of ten stars among twenty sources, three of them corners, at least one is among
/// these. Both ends, since those that rank alike are alike: in a frame out of focus the sharp ones are false and come first.)
const FIRST_LOOK: usize = 6;
/// Sources that a pattern can be made of: as many as are screened at once.
pub const MAX_SOURCES: usize = POINTS;
/// Triangles remembered for the display.
const REMEMBERED: usize = 64;

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

impl SearchRules<'_> {
    /// Whether chance does not explain a hypothesis.
    pub fn are_met_by(&self, hypothesis: &Hypothesis) -> bool {
        hypothesis.false_ln <= self.max_false_ln && hypothesis.matches.len() >= self.min_matched
    }
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

/// A search over one list of sources.
pub struct PatternSearch<'a> {
    field: &'a Field,
    sources: &'a [PatternSource],
    geometry: &'a FrameGeometry,
    rules: &'a SearchRules<'a>,
    need: usize,
    best: Option<Hypothesis>,
    tally: SearchTally,
    /// What of the sources does not depend on a triangle.
    prepared: Prepared,
    /// How the plane of the sources lies on the sky, for each candidate.
    lifted: Vec<[Vec3; 3]>,
    /// Cells of the sky that the sources fall into, for each candidate.
    cells: Vec<[u32; MAX_SOURCES]>,
}

/// Sources as the search wants them: measured once, where every triangle would do it again.
struct Prepared {
    /// Directions, component by component; where there are fewer, those of the first.
    directions: [[f32; MAX_SOURCES]; 3],
    /// How far each may lie from its star, rad at the middle plate scale.
    tolerance: [f64; MAX_SOURCES],
    /// Chord between each two.
    chord: [[f64; MAX_SOURCES]; MAX_SOURCES],
}

impl Prepared {
    fn new(sources: &[PatternSource], field: &Field, geometry: &FrameGeometry) -> Self {
        let first = sources.first().map_or_else(Vec3::z, |source| source.direction);
        let directions =
            [0, 1, 2].map(|axis| std::array::from_fn(|i| sources.get(i).map_or(&first, |source| &source.direction)[axis] as f32));
        let reach = |source: &PatternSource| (CORNER_SIGMAS * source.sigma).hypot(DISTORTED_PX).min(geometry.tolerance);
        let tolerance = std::array::from_fn(|i| sources.get(i).map_or(0.0, |source| field.geometry.platescale * reach(source)));
        let mut chord = [[0.0; MAX_SOURCES]; MAX_SOURCES];
        for (chords, source) in chord.iter_mut().zip(sources) {
            for (chord, other) in chords.iter_mut().zip(sources) {
                *chord = (source.direction - other.direction).norm();
            }
        }
        Self { directions, tolerance, chord }
    }
}

impl<'a> PatternSearch<'a> {
    /// A search for where `sources`, brightest first, lie on the sky.
    ///
    /// Of more than [`MAX_SOURCES`] the rest is left out.
    pub fn new(field: &'a Field, sources: &'a [PatternSource], geometry: &'a FrameGeometry, rules: &'a SearchRules<'a>) -> Self {
        let sources = &sources[..sources.len().min(MAX_SOURCES)];
        Self {
            field,
            sources,
            geometry,
            rules,
            need: if beyond_noise(sources) > FEW_SOURCES as f64 { 3 } else { 2 },
            best: None,
            tally: SearchTally::default(),
            prepared: Prepared::new(sources, field, geometry),
            lifted: Vec::new(),
            cells: Vec::new(),
        }
    }

    /// Runs the search to its end.
    pub fn run(mut self) -> (SearchEnd, SearchTally) {
        let end = with_vectors(Patterns(&mut self));
        let end = end.unwrap_or_else(|| SearchEnd::Exhausted(self.best.take()));
        (end, self.tally)
    }

    /// Every triangle of sources, by the faintest in it.
    ///
    /// Those with the same two fainter corners are looked up together, which hides much of the wait for memory: one at first, when one
    /// may be enough, and more later.
    #[inline(always)]
    fn triangles(&mut self) -> Option<SearchEnd> {
        let field = self.field;
        let (mut queries, mut planes, mut runs, mut found) = (Vec::new(), Vec::new(), Runs::default(), Vec::new());
        for k in 2..self.sources.len() {
            for j in 1..k {
                queries.clear();
                planes.clear();
                for i in 0..j {
                    self.ask([i, j, k], &mut queries, &mut planes);
                }
                field.triangles.find(&queries, &mut runs, &mut found);
                let (end, looked_at) = self.screen(&planes, &found, |t: &FoundTriangle| (t.query as usize, t.stars));
                self.remember(&planes[..looked_at]);
                if end.is_some() {
                    return end;
                }
            }
        }
        None
    }

    /// What to look up for one triangle of sources: every labelling that the errors of its corners allow.
    #[inline(always)]
    fn ask(&self, [p, q, r]: [usize; 3], queries: &mut Vec<TriangleQuery>, planes: &mut Vec<SourcePlane<3>>) {
        let Prepared { tolerance, chord, .. } = &self.prepared;
        let tolerance = tolerance[p].max(tolerance[q]).max(tolerance[r]);
        for [a, b, c] in [[p, q, r], [q, p, r], [p, r, q], [r, p, q], [q, r, p], [r, q, p]] {
            let (ab, ac, bc) = (chord[a][b], chord[a][c], chord[b][c]);
            let is_longest = ac.max(bc) <= ab + tolerance;
            if is_longest && ac * ac - bc * bc <= 2.0 * tolerance * ab {
                let (x, y, length) = shape(&self.sources[a].direction, &self.sources[b].direction, &self.sources[c].direction);
                queries.push(TriangleQuery { x, y, tolerance: tolerance / length, length: self.length_range(length, tolerance) });
                planes.push(SourcePlane::new(self.sources, &self.prepared.directions, [a, b, c]));
            }
        }
    }

    /// Lengths on the sky that a length at the middle plate scale may be.
    fn length_range(&self, length: f64, slack: f64) -> (f64, f64) {
        let (low, high) = self.geometry.platescale_range;
        let middle = self.field.geometry.platescale;
        ((length * low / middle - slack).max(0.0), length * high / middle + slack)
    }

    /// Screens candidates, each a plane of sources whose corners may be the stars found; verifies those where enough other sources fall
    /// on stars. How the search ends, if it does, and the number of planes that were looked at.
    #[inline(always)]
    fn screen<const N: usize, F>(
        &mut self,
        planes: &[SourcePlane<N>],
        found: &[F],
        candidate: impl Fn(&F) -> (usize, [u32; N]),
    ) -> (Option<SearchEnd>, usize) {
        let (field, count) = (self.field, self.sources.len());
        // One step for all candidates and then the next: in none of them has one to wait for the one before.
        let (mut lifted, mut cells) = (std::mem::take(&mut self.lifted), std::mem::take(&mut self.cells));
        lifted.clear();
        lifted.extend(found.iter().map(|place| {
            let (plane, stars) = candidate(place);
            planes[plane].lift(&stars.map(|s| *field.triangles.direction(s)))
        }));
        cells.clear();
        cells.extend(found.iter().zip(&lifted).map(|(place, lifted)| {
            let (plane, _) = candidate(place);
            field.bitmap.cells(lifted, &planes[plane].x, &planes[plane].y, count)
        }));
        let (mut end, mut looked_at) = (None, planes.len());
        for (place, cells) in found.iter().zip(&cells) {
            let (plane, stars) = candidate(place);
            let others = !planes[plane].corner_bits;
            let (head, tail) = (count.min(FIRST_LOOK), count.saturating_sub(FIRST_LOOK).max(FIRST_LOOK).min(count));
            let hits_of =
                |from: usize, to: usize| field.bitmap.hits(&cells[from..to]).checked_shl(from as u32).unwrap_or(0) & others;
            let mut hits = hits_of(0, head) | hits_of(tail, count);
            if hits != 0 {
                hits |= hits_of(head, tail);
            }
            end = self.count_candidate();
            if end.is_none() && hits.count_ones() as usize >= self.need {
                end = self.look_at(&planes[plane], &stars.map(|s| *field.triangles.direction(s)));
            }
            if end.is_some() {
                looked_at = plane + 1;
                break;
            }
        }
        (self.lifted, self.cells) = (lifted, cells);
        (end, looked_at)
    }

    /// Counts a candidate; ends the search where that was too many, or somebody wants it to.
    #[inline(always)]
    fn count_candidate(&mut self) -> Option<SearchEnd> {
        self.tally.candidates += 1;
        if self.tally.candidates.is_multiple_of(256)
            && let Some(stop) = (self.rules.stop)()
        {
            return Some(SearchEnd::Stopped(stop));
        }
        (self.tally.candidates > self.rules.budget).then(|| SearchEnd::Budget(self.best.take()))
    }

    /// Verifies a candidate that passed the screen.
    fn look_at<const N: usize>(&mut self, plane: &SourcePlane<N>, stars: &[Vec3; N]) -> Option<SearchEnd> {
        let lifted = plane.lift(stars);
        let at = |(x, y): (f64, f64)| lifted[0] + lifted[1] * x + lifted[2] * y;
        let boresight = at(plane.boresight).normalize();
        let inside = self.rules.region.as_ref().is_none_or(|(_, allows)| allows(&boresight));
        if self.rules.region_only && !inside {
            return None;
        }
        let attitude = Attitude::from_boresight_up(&boresight, &(at(plane.up).normalize() - boresight))?;
        let platescale = self.field.geometry.platescale * lifted[1].norm();
        self.verified(&Pose::undistorted(attitude, platescale), N + self.need)
    }

    /// Verifies a pose; ends the search where chance does not explain it.
    fn verified(&mut self, pose: &Pose, min_matched: usize) -> Option<SearchEnd> {
        self.tally.verified += 1;
        let hypothesis = self.judge(pose, min_matched)?;
        if self.rules.are_met_by(&hypothesis) {
            return Some(SearchEnd::Found(hypothesis));
        }
        if self.best.as_ref().is_none_or(|best| hypothesis.false_ln < best.false_ln) {
            self.best = Some(hypothesis);
        }
        None
    }

    /// What a pose is worth, however it was come by; `None` where fewer than so many sources match, or than the rules want.
    pub fn judge(&self, pose: &Pose, min_matched: usize) -> Option<Hypothesis> {
        let min_matched = min_matched.min(self.rules.min_matched);
        let mut hypothesis = verify(self.sources, pose, self.field, self.geometry, min_matched)?;
        let region = self.rules.region.as_ref().filter(|(_, allows)| allows(&hypothesis.pose.attitude.boresight()));
        let ln_searched = region.map_or(0.0, |(fraction, _)| fraction.ln());
        hypothesis.false_ln = ln_searched - hypothesis.ln_peak - hypothesis.log_odds;
        Some(hypothesis)
    }

    /// Keeps the last triangles for the display, each once however many labellings it has.
    fn remember(&mut self, planes: &[SourcePlane<3>]) {
        let triangles = &mut self.tally.triangles;
        for plane in planes {
            let mut corners = plane.corners.map(|c| c as u8);
            corners.sort_unstable();
            if triangles.last() != Some(&corners) {
                triangles.push(corners);
            }
        }
        triangles.drain(..triangles.len().saturating_sub(REMEMBERED));
    }
}

/// All patterns of a search, as a kernel.
struct Patterns<'s, 'a>(&'s mut PatternSearch<'a>);

impl Kernel for Patterns<'_, '_> {
    type Output = Option<SearchEnd>;

    #[inline(always)]
    fn run(self) -> Option<SearchEnd> {
        self.0.triangles()
    }
}

/// A little way up from the boresight, in the camera frame: with the boresight it gives the roll.
const ABOVE_BORESIGHT: f64 = 0.02;

/// The sources in the tangent plane at the middle of a pattern with N corners, counted from the corners' mean.
struct SourcePlane<const N: usize> {
    /// The corners, over the sum of their squared distances from the mean.
    corner_weights: [(f64, f64); N],
    /// Every source.
    x: [f32; MAX_SOURCES],
    y: [f32; MAX_SOURCES],
    /// Which sources the corners are; as bits, for they do not count as hits.
    corners: [usize; N],
    corner_bits: u32,
    boresight: (f64, f64),
    /// A point above the boresight.
    up: (f64, f64),
}

impl<const N: usize> SourcePlane<N> {
    #[inline(always)]
    fn new(sources: &[PatternSource], directions: &[[f32; MAX_SOURCES]; 3], corners: [usize; N]) -> Self {
        let at = corners.map(|c| sources[c].direction);
        let middle = at.iter().sum::<Vec3>().normalize();
        let along = (at[1] - at[0]).cross(&middle).normalize();
        let across = middle.cross(&along);
        let project = |d: &Vec3| {
            let depth = 1.0 / d.dot(&middle);
            (d.dot(&along) * depth, d.dot(&across) * depth)
        };
        let projected = at.map(|d| project(&d));
        let mean = projected.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p.0 / N as f64, sum.1 + p.1 / N as f64));
        let from_mean = |p: (f64, f64)| (p.0 - mean.0, p.1 - mean.1);
        let spread: f64 = projected.iter().map(|&p| from_mean(p)).map(|p| p.0 * p.0 + p.1 * p.1).sum();
        // The places of all need no more than single precision, in which vectors have them.
        let single = |v: &Vec3| [v.x as f32, v.y as f32, v.z as f32];
        let ([a, b, c], mean_x, mean_y) = ([&along, &across, &middle].map(single), mean.0 as f32, mean.1 as f32);
        let [dx, dy, dz] = directions;
        let (mut x, mut y) = ([0f32; MAX_SOURCES], [0f32; MAX_SOURCES]);
        for i in 0..MAX_SOURCES {
            let depth = 1.0 / (dx[i] * c[0] + dy[i] * c[1] + dz[i] * c[2]);
            x[i] = (dx[i] * a[0] + dy[i] * a[1] + dz[i] * a[2]) * depth - mean_x;
            y[i] = (dx[i] * b[0] + dy[i] * b[1] + dz[i] * b[2]) * depth - mean_y;
        }
        Self {
            corner_weights: projected.map(from_mean).map(|p| (p.0 / spread, p.1 / spread)),
            x,
            y,
            corners,
            corner_bits: corners.iter().fold(0, |bits, &c| bits | 1 << c),
            boresight: from_mean(project(&Vec3::z())),
            up: from_mean(project(&Vec3::new(0.0, ABOVE_BORESIGHT, 1.0))),
        }
    }

    /// How the plane lies on the sky where the corners are these stars: a point (x, y) at `[0] + x [1] + y [2]`. Rotation, scale and
    /// shift by least squares, in the stars' own tangent plane.
    #[inline(always)]
    fn lift(&self, stars: &[Vec3; N]) -> [Vec3; 3] {
        let middle = stars.iter().sum::<Vec3>().normalize();
        let projected = stars.map(|s| s / s.dot(&middle));
        let mean = projected.iter().sum::<Vec3>() / N as f64;
        let (mut from_x, mut from_y) = (Vec3::zeros(), Vec3::zeros());
        for (star, &(x, y)) in projected.iter().zip(&self.corner_weights) {
            from_x += (star - mean) * x;
            from_y += (star - mean) * y;
        }
        // A quarter turn takes the image of x to that of y: of the two that the corners give, the mean counts.
        let along = from_x - middle.cross(&from_y);
        [mean, along, middle.cross(&along)]
    }
}
