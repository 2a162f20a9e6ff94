//! The triangle index: the triangles of index stars that a field may show, found by their shape.
//!
//! A triangle has its longest side A–B and a third corner C nearer to A. Its shape is x = AC·AB/|AB|² in [0, ½] and
//! y = ±|AB×AC|/|AB|², the sign being that of A·(B×C), so that a mirrored triangle is another one. From chords, so that the shape is
//! exact at any width of field and any attitude. Entries are sorted by bins of x, y and ln|AB|, the last innermost: any range of
//! plate scale is one run of memory.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: every index is made from the lists' own lengths")]

use super::cache::{FieldFileError, Loader, Saver, are_offsets, direction_bytes, is_direction, read_direction, sane};
use super::pages::in_large_pages;
use super::{Density, FieldGeometry, FieldStars, Pace, SkyGrid, field::rank_limit};
use crate::sky::{Kernel, Vec3, with_vectors};
use std::io;
use std::ops::Range;

/// Bins per unit of x and y, and per unit of ln L (trials: 1/48 to 1/192 in x and y make no difference; 1.5 % in L).
const SHAPE_BINS: f64 = 96.0;
const LOG_BINS: f64 = 1.0 / 0.015;
/// Bins along x (0 to ½) and along y (±√¾ and a little).
const X_BINS: usize = 49;
const Y_BINS: usize = 168;
/// Shortest longest side, fraction of the diagonal: below, a centroid's error turns the attitude too far.
const SHORTEST_SIDE: f64 = 0.08;
/// Greatest rank of a corner and greatest sum of a triangle's three ranks, of the rank below which there are as many stars as are wanted.
/// One or two corners may be faint where the others are bright: of the brightest stars of a field some are not seen, and of all the
/// triangles that fill the same memory these leave the fewest fields without one (trials: half as many as with all corners below the
/// same rank).
const FAINTEST_CORNER: f64 = 1.63;
const CORNERS_TOGETHER: f64 = 2.0;
/// Neighbours of a star that can be told apart by one byte.
const MAX_NEIGHBOURS: usize = 256;

/// One triangle: star A (32 bits), the places of B and C among its neighbours, and where in its bin x and y lie (8 bits each). A
/// word, because fresh words come as zeros that take no memory before they are written.
#[derive(Debug, Clone, Copy)]
struct Entry(u64);

impl Entry {
    #[inline(always)]
    fn new(a: u32, rest: [u8; 4]) -> Self {
        Self(u64::from(u32::from_le_bytes(rest)) << 32 | u64::from(a))
    }

    #[inline(always)]
    fn a(self) -> usize {
        self.0 as u32 as usize
    }

    /// The places of B and C, x and y.
    #[inline(always)]
    fn rest(self) -> [u8; 4] {
        ((self.0 >> 32) as u32).to_le_bytes()
    }
}

/// A triangle before it is sorted: its bin among those with its bin of x, and what its [`Entry`] holds.
#[derive(Debug, Clone, Copy)]
struct Unsorted {
    bin: u32,
    a: u32,
    rest: [u8; 4],
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

/// All triangles of index stars of one field.
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
    /// [`Entry`]s.
    entries: Vec<u64>,
}

impl TriangleIndex {
    /// Builds the index of a field: half a second for fifteen stars a field of 4° × 3°. `None` where the pace ends it.
    pub fn build(field: &FieldStars, density: &Density, geometry: &FieldGeometry, pace: &mut Pace<'_>) -> Option<Self> {
        let limit = f64::from(rank_limit(density.stars_per_field));
        let (faintest, together) = ((FAINTEST_CORNER * limit) as u8, (CORNERS_TOGETHER * limit) as u8);
        let stars = || field.stars.iter().filter(|s| s.rank <= faintest);
        let mut directions = in_large_pages(stars().count());
        directions.extend(stars().map(|s| s.direction));
        let ranks: Vec<u8> = stars().map(|s| s.rank).collect();
        let (neighbours, first_neighbour) = find_neighbours(&directions, &ranks, together, sides(density, geometry).1, pace)?;
        let mut index = Self { directions, neighbours, first_neighbour, ..Self::empty(density, geometry) };
        let mut columns = vec![Vec::new(); X_BINS];
        with_vectors(Enumerate { index: &index, ranks: &ranks, together, pace, columns: &mut columns })?;
        index.sort(columns, pace)?;
        Some(index)
    }

    /// An index without stars.
    fn empty(density: &Density, geometry: &FieldGeometry) -> Self {
        let sides = sides(density, geometry);
        let log_bins = ((sides.1 / sides.0).ln() * LOG_BINS) as usize + 1;
        let bins = X_BINS * Y_BINS * log_bins + 1;
        let mut offsets = in_large_pages(bins);
        offsets.resize(bins, 0);
        Self {
            directions: Vec::new(),
            neighbours: Vec::new(),
            first_neighbour: Vec::new(),
            sides,
            log_bins,
            offsets,
            entries: Vec::new(),
        }
    }

    /// Writes every list.
    pub fn save(&self, saver: &mut Saver<'_>) -> io::Result<()> {
        saver.list(&self.directions, direction_bytes)?;
        saver.list(&self.neighbours, |star| star.to_le_bytes())?;
        saver.list(&self.first_neighbour, |first| first.to_le_bytes())?;
        saver.list(&self.offsets, |offset| offset.to_le_bytes())?;
        saver.list(&self.entries, |entry| entry.to_le_bytes())
    }

    /// Reads the index of a field: no list of it points out of another.
    pub fn load(loader: &mut Loader<'_>, density: &Density, geometry: &FieldGeometry) -> Result<Self, FieldFileError> {
        let word = |bytes: &[u8; 4]| u32::from_le_bytes(*bytes);
        let mut index = Self::empty(density, geometry);
        let bins = index.offsets.len();
        index.directions = loader.list(read_direction)?;
        sane("index stars", index.directions.iter().all(is_direction))?;
        let stars = index.directions.len();
        index.neighbours = loader.list(word)?;
        sane("neighbours", index.neighbours.iter().all(|&star| (star as usize) < stars))?;
        index.first_neighbour = loader.list(word)?;
        let first = &index.first_neighbour;
        sane("neighbourhoods", first.len() == stars + 1 && are_offsets(first, index.neighbours.len()))?;
        index.offsets = loader.list(word)?;
        let counts: Vec<u32> = first.windows(2).map(|ends| ends[1] - ends[0]).collect();
        let mut known = true;
        index.entries = loader.list(|bytes| {
            let entry = Entry(u64::from_le_bytes(*bytes));
            let [b, c, ..] = entry.rest();
            known &= counts.get(entry.a()).is_some_and(|&count| u32::from(b.max(c)) < count);
            entry.0
        })?;
        sane("triangles", known)?;
        sane("bins", index.offsets.len() == bins && are_offsets(&index.offsets, index.entries.len()))?;
        Ok(index)
    }

    /// Direction of an index star.
    pub fn direction(&self, star: u32) -> &Vec3 {
        &self.directions[star as usize]
    }

    /// Number of index stars and of triangles.
    pub fn counts(&self) -> (usize, usize) {
        (self.directions.len(), self.entries.len())
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.directions[..])
            + size_of_val(&self.neighbours[..])
            + size_of_val(&self.first_neighbour[..])
            + size_of_val(&self.offsets[..])
            + size_of_val(&self.entries[..])
    }

    /// Chords of the shortest and longest side A–B that the index holds.
    pub fn sides(&self) -> (f64, f64) {
        self.sides
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
        std::hint::black_box(on_their_way.fold(0, |sum, entry| sum ^ entry));
        let mut count = 0;
        for run in &runs.0 {
            let entries = &self.entries[run.entries.clone()];
            found.resize(count + entries.len(), FoundTriangle::default());
            // Each is written where the next one goes and counted if it fits: no branch that could be guessed wrong.
            for &entry in entries {
                let entry = Entry(entry);
                let [b, c, x, y] = entry.rest();
                found[count] = FoundTriangle { query: run.query, stars: [entry.a() as u32, u32::from(b), u32::from(c)] };
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

    /// Bins of ln L that a range of lengths touches; `None` where it lies outside the index.
    fn log_range(&self, length: (f64, f64)) -> Option<Range<usize>> {
        if !(length.1 >= self.sides.0 && length.0 <= self.sides.1) {
            return None;
        }
        let bin = |l: f64| (((l / self.sides.0).ln() * LOG_BINS).max(0.0) as usize).min(self.log_bins - 1);
        Some(bin(length.0)..bin(length.1) + 1)
    }

    /// Sorts triangles by bin; within a bin their order stays. One bin of x after the other: what is sorted at a time, and where it
    /// goes, stays in the processor's cache, and each list is gone before the next one needs the memory.
    fn sort(&mut self, columns: Vec<Vec<Unsorted>>, pace: &mut Pace<'_>) -> Option<()> {
        let bins = Y_BINS * self.log_bins;
        self.entries = in_large_pages(columns.iter().map(Vec::len).sum());
        self.offsets.clear();
        for column in columns {
            pace.step(column.len() / ENTRIES_PER_STEP)?;
            let mut next = vec![0u32; bins];
            for triangle in &column {
                next[triangle.bin as usize] += 1;
            }
            let mut end = self.entries.len() as u32;
            for next in &mut next {
                self.offsets.push(end);
                end += std::mem::replace(next, end);
            }
            self.entries.resize(end as usize, 0);
            for triangle in &column {
                let next = &mut next[triangle.bin as usize];
                self.entries[*next as usize] = Entry::new(triangle.a, triangle.rest).0;
                *next += 1;
            }
        }
        self.offsets.push(self.entries.len() as u32);
        Some(())
    }

    /// Puts every triangle into the list of its bin of x, in the order of star A; `None` where the pace ends it.
    #[inline(always)]
    fn enumerate(&self, ranks: &[u8], together: u8, pace: &mut Pace<'_>, columns: &mut [Vec<Unsorted>]) -> Option<()> {
        let mut near = Neighbourhood::default();
        // Neighbours C of the triangles with one side A–B.
        let mut corners = [0u8; MAX_NEIGHBOURS];
        for (a, at) in self.directions.iter().enumerate() {
            near.gather(
                at,
                &self.directions,
                ranks,
                &self.neighbours[self.first_neighbour[a] as usize..self.first_neighbour[a + 1] as usize],
            );
            for b in 0..near.len() {
                let length_sq = near.distance_sq[b];
                let length = f64::from(length_sq).sqrt();
                if length < self.sides.0 {
                    continue;
                }
                let log_bin = (((length / self.sides.0).ln() * LOG_BINS) as usize).min(self.log_bins - 1);
                pace.step(1)?;
                near.measure_from(b);
                // C is nearer to A, and A–B is the longest side; ties go both ways, so no triangle is lost. Sorted out without a
                // branch, which would be guessed wrong for each third neighbour.
                let mut count = 0;
                let most = together - ranks[a] - near.rank[b];
                for c in 0..b {
                    let (ac_sq, bc_sq) = (near.distance_sq[c], near.from_b_sq[c]);
                    corners[count] = c as u8;
                    count += usize::from((bc_sq <= length_sq) & (ac_sq <= bc_sq) & (near.rank[c] <= most));
                }
                let normal = near.normal(b);
                for &corner in &corners[..count] {
                    let c = usize::from(corner);
                    let (ac_sq, bc_sq) = (near.distance_sq[c], near.from_b_sq[c]);
                    let x = 0.5 * (ac_sq + length_sq - bc_sq) / length_sq;
                    let height = (ac_sq / length_sq - x * x).max(0.0).sqrt();
                    let above = normal[0] * near.x[c] + normal[1] * near.y[c] + normal[2] * near.z[c];
                    let y = height.copysign(above);
                    let (sx, sy) = (x * SHAPE_BINS as f32, y * SHAPE_BINS as f32 + 0.5 * Y_BINS as f32);
                    let (ix, iy) = ((sx as usize).min(X_BINS - 1), (sy as usize).min(Y_BINS - 1));
                    let in_bin = |s: f32, i: usize| ((s - i as f32) * 256.0) as u8;
                    columns[ix].push(Unsorted {
                        bin: (iy * self.log_bins + log_bin) as u32,
                        a: a as u32,
                        rest: [b as u8, corner, in_bin(sx, ix), in_bin(sy, iy)],
                    });
                }
            }
        }
        Some(())
    }
}

/// Triangles that are sorted in a step of the pace.
const ENTRIES_PER_STEP: usize = 16;

/// Chord of an angle, rad.
fn chord(angle: f64) -> f64 {
    2.0 * (0.5 * angle).sin()
}

/// Chords of the shortest and longest side A–B of a triangle.
fn sides(density: &Density, geometry: &FieldGeometry) -> (f64, f64) {
    (chord(SHORTEST_SIDE * geometry.diagonal), chord(density.longest_side * geometry.diagonal))
}

/// The enumeration, as a kernel.
struct Enumerate<'a, 'p> {
    index: &'a TriangleIndex,
    /// Of the index stars, and the most that a triangle's have together.
    ranks: &'a [u8],
    together: u8,
    pace: &'a mut Pace<'p>,
    columns: &'a mut [Vec<Unsorted>],
}

impl Kernel for Enumerate<'_, '_> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self) -> Option<()> {
        self.index.enumerate(self.ranks, self.together, self.pace, self.columns)
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
    rank: Vec<u8>,
    from_b_sq: Vec<f32>,
}

impl Neighbourhood {
    fn gather(&mut self, at: &Vec3, directions: &[Vec3], ranks: &[u8], neighbours: &[u32]) {
        self.at = *at;
        self.rank.clear();
        self.rank.extend(neighbours.iter().map(|&n| ranks[n as usize]));
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

    /// A normal of the plane through the star, a neighbour and the middle of the sphere.
    fn normal(&self, b: usize) -> [f32; 3] {
        let normal = self.at.cross(&Vec3::new(f64::from(self.x[b]), f64::from(self.y[b]), f64::from(self.z[b])));
        [normal.x as f32, normal.y as f32, normal.z as f32]
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

/// The neighbours of each star within a chord, nearest first, that may be in a triangle with it; where there are more than fit a byte,
/// the nearest.
fn find_neighbours(
    directions: &[Vec3],
    ranks: &[u8],
    together: u8,
    chord: f64,
    pace: &mut Pace<'_>,
) -> Option<(Vec<u32>, Vec<u32>)> {
    let radius = 2.0 * (0.5 * chord).asin();
    let (grid, order) = SkyGrid::build(directions, 0.5 * radius, pace)?;
    let mut neighbours = Vec::new();
    let mut first = vec![0u32];
    let mut near: Vec<(f64, u32)> = Vec::new();
    for (a, at) in directions.iter().enumerate() {
        pace.step(1 + near.len() / 16)?;
        near.clear();
        grid.ranges_near(at, radius, |range| {
            for &b in &order[range] {
                let distance_sq = (directions[b as usize] - at).norm_squared();
                if b as usize != a && ranks[a] + ranks[b as usize] <= together && distance_sq <= chord * chord {
                    near.push((distance_sq, b));
                }
            }
        });
        near.sort_by(|p, q| p.0.total_cmp(&q.0).then(p.1.cmp(&q.1)));
        neighbours.extend(near.iter().take(MAX_NEIGHBOURS).map(|&(_, b)| b));
        first.push(neighbours.len() as u32);
    }
    // How many there are was not known before.
    let mut packed = in_large_pages(neighbours.len());
    packed.append(&mut neighbours);
    Some((packed, first))
}

/// Shape of the triangle with the longest side A–B and third corner C: x, y and the chord |AB|.
pub fn shape(a: &Vec3, b: &Vec3, c: &Vec3) -> (f64, f64, f64) {
    let (ab, ac) = (b - a, c - a);
    let length_sq = ab.norm_squared();
    let x = ac.dot(&ab) / length_sq;
    let y = (ab.cross(&ac).norm() / length_sq).copysign(a.cross(b).dot(c));
    (x, y, length_sq.sqrt())
}
