//! The triangle index: every triangle of index stars that fits a field, found by its shape, and every short pair by its length.
//!
//! A triangle has its longest side A–B and a third corner C nearer to A. Its shape is x = AC·AB/|AB|² in [0, ½] and
//! y = ±|AB×AC|/|AB|², the sign being that of A·(B×C), so that a mirrored triangle is another one. From chords, so that the shape is
//! exact at any width of field and any attitude. Entries are sorted by bins of x, y and ln|AB|, the last innermost: any range of
//! plate scale is one run of memory.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: every index is made from the lists' own lengths")]

use super::{FieldGeometry, FieldStars, SkyGrid, field::rank_limit};
use crate::settings::CatalogSettings;
use crate::sky::{Kernel, Vec3, with_vectors};
use std::ops::Range;

/// Bins per unit of x and y, and per unit of ln L (trials: 1/48 to 1/192 in x and y make no difference; 1.5 % in L).
const SHAPE_BINS: f64 = 96.0;
const LOG_BINS: f64 = 1.0 / 0.015;
/// Bins along x (0 to ½) and along y (±√¾ and a little).
const X_BINS: usize = 49;
const Y_BINS: usize = 168;
/// Shortest longest side and longest indexed pair, fractions of the diagonal: below, a centroid's error turns the attitude too far;
/// above, there are too many pairs for a last resort.
const SHORTEST_SIDE: f64 = 0.08;
const LONGEST_PAIR: f64 = 0.35;
/// Neighbours of a star that can be told apart by one byte.
const MAX_NEIGHBOURS: usize = 256;

/// One triangle: star A, the places of B and C among its neighbours, and where in its bin x and y lie.
#[derive(Debug, Clone, Copy, Default)]
struct Entry {
    a: u32,
    b: u8,
    c: u8,
    x: u8,
    y: u8,
}

/// A pair of index stars.
#[derive(Debug, Clone, Copy)]
struct Pair {
    chord: f32,
    a: u32,
    b: u32,
}

/// Which triangles a query wants.
#[derive(Debug, Clone, Copy)]
pub struct TriangleQuery {
    /// Shape along the longest side.
    pub x: f64,
    /// Shape across the longest side, signed.
    pub y: f64,
    /// Half width of the box around x and y.
    pub tolerance: f64,
    /// Least and greatest length of the longest side, chord.
    pub length: (f64, f64),
}

/// A triangle of stars that a query wants.
#[derive(Debug, Clone, Copy, Default)]
pub struct FoundTriangle {
    /// Number of the query.
    pub query: u32,
    /// Corners A, B, C.
    pub stars: [u32; 3],
}

/// Entries that may be what a query wants, and where in their bin x and y must lie.
#[derive(Debug)]
struct Run {
    query: u32,
    entries: Range<usize>,
    x: (u8, u8),
    y: (u8, u8),
}

/// Memory for [`TriangleIndex::find`].
#[derive(Debug, Default)]
pub struct Runs(Vec<Run>);

/// Entries in a line of a processor's cache.
const ENTRIES_PER_LINE: usize = 64 / size_of::<Entry>();

/// All triangles and short pairs of index stars of one field.
#[derive(Debug, Clone)]
pub struct TriangleIndex {
    /// Directions of the index stars.
    directions: Vec<Vec3>,
    neighbours: Vec<u32>,
    first_neighbour: Vec<u32>,
    /// Chords of the shortest and longest indexed side A–B.
    sides: (f64, f64),
    log_bins: usize,
    offsets: Vec<u32>,
    entries: Vec<Entry>,
    pairs: Vec<Pair>,
}

impl TriangleIndex {
    /// Builds the index of a field: about a second for fifteen stars a field of 4° × 3°.
    pub fn build(field: &FieldStars, settings: &CatalogSettings, geometry: &FieldGeometry) -> Self {
        let limit = rank_limit(settings.index_stars_per_field);
        let directions: Vec<Vec3> = field.stars.iter().filter(|s| s.rank < limit).map(|s| s.direction).collect();
        let chord = |angle: f64| 2.0 * (0.5 * angle).sin();
        let sides = (chord(SHORTEST_SIDE * geometry.diagonal), chord(settings.longest_side_fraction * geometry.diagonal));
        let (neighbours, first_neighbour) = find_neighbours(&directions, sides.1);
        let log_bins = ((sides.1 / sides.0).ln() * LOG_BINS) as usize + 1;
        let mut index = Self {
            directions,
            neighbours,
            first_neighbour,
            sides,
            log_bins,
            offsets: vec![0; X_BINS * Y_BINS * log_bins + 1],
            entries: Vec::new(),
            pairs: Vec::new(),
        };
        // Sorted by bin with one count and one move; within a bin the order is that of star A.
        let mut unsorted = Vec::new();
        let mut offsets = std::mem::take(&mut index.offsets);
        with_vectors(Enumerate { index: &index, unsorted: &mut unsorted });
        for &(bin, _) in &unsorted {
            offsets[bin as usize + 1] += 1;
        }
        for i in 1..offsets.len() {
            offsets[i] += offsets[i - 1];
        }
        let mut next = offsets.clone();
        let mut entries = vec![Entry::default(); unsorted.len()];
        for (bin, entry) in unsorted {
            let place = &mut next[bin as usize];
            entries[*place as usize] = entry;
            *place += 1;
        }
        index.offsets = offsets;
        index.entries = entries;
        index.pairs = index.short_pairs(chord(LONGEST_PAIR * geometry.diagonal));
        index
    }

    /// Direction of an index star.
    pub fn direction(&self, star: u32) -> &Vec3 {
        &self.directions[star as usize]
    }

    /// Number of index stars, triangles and pairs.
    pub fn counts(&self) -> (usize, usize, usize) {
        (self.directions.len(), self.entries.len(), self.pairs.len())
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.directions[..])
            + size_of_val(&self.neighbours[..])
            + size_of_val(&self.first_neighbour[..])
            + size_of_val(&self.offsets[..])
            + size_of_val(&self.entries[..])
            + size_of_val(&self.pairs[..])
    }

    /// Chords of the shortest and longest side A–B that the index holds.
    pub fn sides(&self) -> (f64, f64) {
        self.sides
    }

    /// Longest pair that the index holds, chord.
    pub fn longest_pair(&self) -> f64 {
        self.pairs.last().map_or(0.0, |p| f64::from(p.chord))
    }

    /// Finds the triangles of every query, in the queries' order.
    ///
    /// Much of the time goes into waiting for memory, so it is asked for many triangles at once: each pass reads what the one before
    /// it has found out where to read.
    #[inline(always)]
    pub fn find(&self, queries: &[TriangleQuery], runs: &mut Runs, found: &mut Vec<FoundTriangle>) {
        runs.0.clear();
        for (number, query) in queries.iter().enumerate() {
            self.runs_of(number as u32, query, &mut runs.0);
        }
        // One entry of each line of memory, so that the lines are on their way when they are needed.
        let on_their_way = runs.0.iter().flat_map(|run| self.entries[run.entries.clone()].iter().step_by(ENTRIES_PER_LINE));
        std::hint::black_box(on_their_way.fold(0, |sum, entry| sum ^ entry.a));
        let mut count = 0;
        for run in &runs.0 {
            let entries = &self.entries[run.entries.clone()];
            found.resize(count + entries.len(), FoundTriangle::default());
            // Each is written where the next one goes and counted if it fits: no branch that could be guessed wrong.
            for entry in entries {
                found[count] = FoundTriangle { query: run.query, stars: [entry.a, u32::from(entry.b), u32::from(entry.c)] };
                let (x, y) = (entry.x, entry.y);
                count += usize::from((x >= run.x.0) & (x <= run.x.1) & (y >= run.y.0) & (y <= run.y.1));
            }
        }
        found.truncate(count);
        for FoundTriangle { stars: [a, b, c], .. } in found.iter_mut() {
            let first = self.first_neighbour[*a as usize];
            (*b, *c) = (self.neighbours[(first + *b) as usize], self.neighbours[(first + *c) as usize]);
        }
        found.retain(|triangle| {
            let [a, b, _] = triangle.stars;
            let side_sq = (self.directions[b as usize] - self.directions[a as usize]).norm_squared();
            let (least, greatest) = queries[triangle.query as usize].length;
            side_sq >= least * least && side_sq <= greatest * greatest
        });
    }

    /// The runs of entries that a query looks through.
    #[inline(always)]
    fn runs_of(&self, number: u32, query: &TriangleQuery, runs: &mut Vec<Run>) {
        let Some(lengths) = self.log_range(query.length) else { return };
        let (x0, y0) = (query.x * SHAPE_BINS, query.y * SHAPE_BINS + 0.5 * Y_BINS as f64);
        let t = query.tolerance * SHAPE_BINS;
        let bins = |centre: f64, count: usize| {
            let first = (centre - t).max(0.0) as usize;
            let last = (centre + t).clamp(-1.0, count as f64 - 1.0);
            first..if last < 0.0 { 0 } else { last as usize + 1 }
        };
        for ix in bins(x0, X_BINS) {
            for iy in bins(y0, Y_BINS) {
                let base = (ix * Y_BINS + iy) * self.log_bins;
                // In units of 1/256 of a bin, relative to this bin's corner; a bin that is touched at all has a part inside.
                let range = |centre: f64, bin: usize| {
                    let (centre, t) = ((centre - bin as f64) * 256.0 - 0.5, t * 256.0);
                    ((centre - t).clamp(0.0, 255.0) as u8, (centre + t).clamp(0.0, 255.0) as u8)
                };
                let entries = self.offsets[base + lengths.start] as usize..self.offsets[base + lengths.end] as usize;
                runs.push(Run { query: number, entries, x: range(x0, ix), y: range(y0, iy) });
            }
        }
    }

    /// Calls `visit` with every pair of a length, chord, once; which star is which is left to the caller.
    pub fn pairs(&self, length: (f64, f64), mut visit: impl FnMut([u32; 2])) {
        let first = self.pairs.partition_point(|p| f64::from(p.chord) < length.0);
        for pair in self.pairs[first..].iter().take_while(|p| f64::from(p.chord) <= length.1) {
            visit([pair.a, pair.b]);
        }
    }

    /// Bins of ln L that a range of lengths touches; `None` where it lies outside the index.
    fn log_range(&self, length: (f64, f64)) -> Option<Range<usize>> {
        if !(length.1 >= self.sides.0 && length.0 <= self.sides.1) {
            return None;
        }
        let bin = |l: f64| (((l / self.sides.0).ln() * LOG_BINS).max(0.0) as usize).min(self.log_bins - 1);
        Some(bin(length.0)..bin(length.1) + 1)
    }

    /// The bin and entry of every triangle, in the order of star A.
    #[inline(always)]
    fn enumerate(&self, unsorted: &mut Vec<(u32, Entry)>) {
        let mut near = Neighbourhood::default();
        for (a, at) in self.directions.iter().enumerate() {
            near.gather(
                at,
                &self.directions,
                &self.neighbours[self.first_neighbour[a] as usize..self.first_neighbour[a + 1] as usize],
            );
            for b in 0..near.len() {
                let length_sq = near.distance_sq[b];
                let length = f64::from(length_sq).sqrt();
                if length < self.sides.0 {
                    continue;
                }
                let log_bin = (((length / self.sides.0).ln() * LOG_BINS) as usize).min(self.log_bins - 1);
                let normal = at.cross(&near.direction(b));
                near.measure_from(b);
                for c in 0..b {
                    let (ac_sq, bc_sq) = (near.distance_sq[c], near.from_b_sq[c]);
                    // C is nearer to A, and A–B is the longest side; ties go both ways, so no triangle is lost.
                    if bc_sq > length_sq || ac_sq > bc_sq {
                        continue;
                    }
                    let x = 0.5 * (ac_sq + length_sq - bc_sq) / length_sq;
                    let height = (ac_sq / length_sq - x * x).max(0.0).sqrt();
                    let y = if normal.dot(&near.direction(c)) < 0.0 { -height } else { height };
                    let (sx, sy) = (x * SHAPE_BINS as f32, y * SHAPE_BINS as f32 + 0.5 * Y_BINS as f32);
                    let (ix, iy) = ((sx as usize).min(X_BINS - 1), (sy as usize).min(Y_BINS - 1));
                    let in_bin = |s: f32, i: usize| ((s - i as f32) * 256.0) as u8;
                    unsorted.push((
                        ((ix * Y_BINS + iy) * self.log_bins + log_bin) as u32,
                        Entry { a: a as u32, b: b as u8, c: c as u8, x: in_bin(sx, ix), y: in_bin(sy, iy) },
                    ));
                }
            }
        }
    }

    /// Every pair up to a chord, by length.
    fn short_pairs(&self, longest: f64) -> Vec<Pair> {
        let mut pairs = Vec::new();
        for (a, at) in self.directions.iter().enumerate() {
            for &b in &self.neighbours[self.first_neighbour[a] as usize..self.first_neighbour[a + 1] as usize] {
                let chord = (self.directions[b as usize] - at).norm();
                if (b as usize) > a && chord >= self.sides.0 && chord <= longest {
                    pairs.push(Pair { chord: chord as f32, a: a as u32, b });
                }
            }
        }
        pairs.sort_by(|p, q| p.chord.total_cmp(&q.chord).then(p.a.cmp(&q.a)).then(p.b.cmp(&q.b)));
        pairs
    }
}

/// The enumeration, as a kernel.
struct Enumerate<'a> {
    index: &'a TriangleIndex,
    unsorted: &'a mut Vec<(u32, Entry)>,
}

impl Kernel for Enumerate<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.index.enumerate(self.unsorted);
    }
}

/// The neighbours of one star, relative to it: single precision keeps a chord to a part in a million.
#[derive(Default)]
struct Neighbourhood {
    at: Vec3,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    distance_sq: Vec<f32>,
    from_b_sq: Vec<f32>,
}

impl Neighbourhood {
    fn gather(&mut self, at: &Vec3, directions: &[Vec3], neighbours: &[u32]) {
        self.at = *at;
        for list in [&mut self.x, &mut self.y, &mut self.z, &mut self.distance_sq] {
            list.clear();
        }
        for &n in neighbours {
            let d = directions[n as usize] - at;
            self.x.push(d.x as f32);
            self.y.push(d.y as f32);
            self.z.push(d.z as f32);
            self.distance_sq.push(d.norm_squared() as f32);
        }
        self.from_b_sq.resize(neighbours.len(), 0.0);
    }

    fn len(&self) -> usize {
        self.x.len()
    }

    /// Direction of a neighbour.
    fn direction(&self, n: usize) -> Vec3 {
        self.at + Vec3::new(f64::from(self.x[n]), f64::from(self.y[n]), f64::from(self.z[n]))
    }

    /// Squared chords from neighbour `b` to those before it.
    #[inline(always)]
    fn measure_from(&mut self, b: usize) {
        let (bx, by, bz) = (self.x[b], self.y[b], self.z[b]);
        let (x, y, z, out) = (&self.x[..b], &self.y[..b], &self.z[..b], &mut self.from_b_sq[..b]);
        for c in 0..b {
            let (dx, dy, dz) = (x[c] - bx, y[c] - by, z[c] - bz);
            out[c] = dx * dx + dy * dy + dz * dz;
        }
    }
}

/// The neighbours of each star within a chord, nearest first; where there are more than fit a byte, the nearest.
fn find_neighbours(directions: &[Vec3], chord: f64) -> (Vec<u32>, Vec<u32>) {
    let radius = 2.0 * (0.5 * chord).asin();
    let (grid, order) = SkyGrid::build(directions, 0.5 * radius);
    let mut neighbours = Vec::new();
    let mut first = vec![0u32];
    let mut near: Vec<(f64, u32)> = Vec::new();
    for (a, at) in directions.iter().enumerate() {
        near.clear();
        grid.ranges_near(at, radius, |range| {
            for &b in &order[range] {
                let distance_sq = (directions[b as usize] - at).norm_squared();
                if b as usize != a && distance_sq <= chord * chord {
                    near.push((distance_sq, b));
                }
            }
        });
        near.sort_by(|p, q| p.0.total_cmp(&q.0).then(p.1.cmp(&q.1)));
        neighbours.extend(near.iter().take(MAX_NEIGHBOURS).map(|&(_, b)| b));
        first.push(neighbours.len() as u32);
    }
    (neighbours, first)
}

/// Shape of the triangle with the longest side A–B and third corner C: x, y and the chord |AB|.
pub fn shape(a: &Vec3, b: &Vec3, c: &Vec3) -> (f64, f64, f64) {
    let (ab, ac) = (b - a, c - a);
    let length_sq = ab.norm_squared();
    let x = ac.dot(&ab) / length_sq;
    let y = (ab.cross(&ac).norm() / length_sq).copysign(a.cross(b).dot(c));
    (x, y, length_sq.sqrt())
}
