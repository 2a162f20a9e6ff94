//! Peaks: where a smoothed picture stands above its surroundings (stars-paper, "Solving - Source Finding").
//!
//! Level: means of 4 × 4 samples; each such cell's level is the mean of a ring of cells around it, so that a star does not raise its
//! own level. Smooth: three taps each way. A peak is a local maximum of the difference above the threshold.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the plane's own size")]

use super::plane::Plane;
use crate::image::CELL_PX;
use crate::sky::{Kernel, with_vectors};

/// Samples along the side of a coarse cell.
const COARSE: usize = 4;
/// Smallest picture that is searched, samples along a side.
const LEAST_SIDE: usize = 3 * CELL_PX;

/// A local maximum of the smoothed picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Column in the plane.
    pub x: usize,
    /// Row in the plane.
    pub y: usize,
    /// Height above the level, ADU.
    pub height: f32,
    /// The cell of the search that it was kept in, counted row after row.
    pub cell: u32,
}

impl Peak {
    /// The cell of a side, samples, that it lies in: column and row.
    pub fn cell_of(&self, side: usize) -> (usize, usize) {
        (self.x / side, self.y / side)
    }
}

/// Three taps along each axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Taps {
    /// Weight of either neighbour; the middle has the rest of 1.
    pub side: f32,
}

impl Taps {
    /// A Gaussian of σ 1 sample.
    pub const WIDE: Self = Self { side: 0.274_068_62 };
    /// For a star of σ 1 px in a picture halved once: with the halving about as wide as the star (95 % of the matched filter's signal).
    pub const SHARP: Self = Self { side: 0.2 };

    fn middle(self) -> f32 {
        1.0 - 2.0 * self.side
    }

    /// Noise of the smoothed picture over that of a sample.
    pub fn noise(self) -> f32 {
        self.middle() * self.middle() + 2.0 * self.side * self.side
    }
}

/// How peaks are chosen.
pub struct PeakRules<'a> {
    /// The smoothing.
    pub taps: Taps,
    /// Distance of the ring around a coarse cell, in such cells: the nearer, the better the level follows a bent sky.
    pub ring: usize,
    /// Samples closer to the border are left out.
    pub border: usize,
    /// Side of the cells that limit crowding, samples.
    pub cell: usize,
    /// Highest peaks kept in one cell.
    pub per_cell: usize,
    /// Threshold of each block of [`CELL_PX`] × [`CELL_PX`] samples, ADU, row after row, with this many a row.
    pub thresholds: &'a [f32],
    /// Blocks of thresholds along a row.
    pub threshold_columns: usize,
    /// Whether nothing is taken from a sample's place.
    pub masked: &'a dyn Fn(usize, usize) -> bool,
}

impl PeakRules<'_> {
    /// Thresholds of the blocks of row `y`.
    #[inline(always)]
    fn thresholds_of_row(&self, y: usize) -> &[f32] {
        let rows = self.thresholds.len() / self.threshold_columns;
        &self.thresholds[(y / CELL_PX).min(rows - 1) * self.threshold_columns..][..self.threshold_columns]
    }

    /// The threshold at a sample, ADU.
    pub fn threshold_at(&self, x: usize, y: usize) -> f32 {
        self.thresholds_of_row(y)[(x / CELL_PX).min(self.threshold_columns - 1)]
    }
}

/// The memory of a search.
#[derive(Debug, Clone, Default)]
pub struct PeakFinder {
    /// Means of 4 × 4 samples, with as many more cells on every side as the ring is wide.
    coarse: Plane,
    /// Sums down the sides of the rings of one row.
    sides: Vec<f32>,
    level: Vec<f32>,
    /// The level at the middles of the two rows of coarse cells around the present row, sample by sample.
    level_rows: [Vec<f32>; 2],
    across: Vec<f32>,
    smooth: Plane,
    scan: Scan,
    cells: Cells,
}

/// Rows of the smoothed picture that peaks are searched in at a time.
const ROWS: usize = 3;

impl PeakFinder {
    /// Finds the peaks of a plane, cell after cell, the highest of each first. `keep_on` is asked every few rows; where it says no,
    /// the search ends with `false`. `whole`: whether all of [`Self::smooth`] is kept, for those who search it again.
    pub fn find(
        &mut self,
        plane: &Plane,
        rules: &PeakRules<'_>,
        keep_on: &dyn Fn() -> bool,
        whole: bool,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        with_vectors(Search { finder: self, plane, rules, keep_on, whole, peaks })
    }

    /// The smoothed picture above its level, after a search that kept it.
    pub fn smooth(&self) -> &Plane {
        &self.smooth
    }

    #[inline(always)]
    fn search(
        &mut self,
        plane: &Plane,
        rules: &PeakRules<'_>,
        keep_on: &dyn Fn() -> bool,
        whole: bool,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        peaks.clear();
        let (width, height) = (plane.width, plane.height);
        let kept = if whole { height } else { ROWS };
        (self.smooth.width, self.smooth.height) = (width, kept);
        self.smooth.pixels.resize(width * kept, 0.0);
        if width < LEAST_SIDE || height < LEAST_SIDE || rules.cell == 0 {
            self.smooth.pixels.fill(0.0);
            return true;
        }
        // The border has no neighbours to be smoothed with.
        self.smooth.pixels[..width].fill(0.0);
        self.smooth.pixels[width * (kept - 1)..].fill(0.0);
        self.measure_coarse(plane, rules.ring);
        let coarse_rows = height / COARSE;
        self.cells.begin((width, height), rules.cell);
        for row in self.level_rows.iter_mut().chain([&mut self.across]) {
            row.resize(width, 0.0);
        }
        // The row of coarse cells below the present row, whose level is measured with that of the one above; none yet.
        let mut measured = 0;
        // The row of blocks whose thresholds are spread over its samples.
        let mut blocks = None;
        for y in 1..height - 1 {
            if y % 64 == 0 && !keep_on() {
                return false;
            }
            // Between the middles of two rows of coarse cells the level goes on a straight line, and so beyond the outermost.
            let middle_after = (y + COARSE / 2) / COARSE;
            let between = middle_after.clamp(1, coarse_rows - 1);
            if between != measured {
                match measured {
                    0 => self.measure_level(0, rules.ring, 0),
                    _ => self.level_rows.swap(0, 1),
                }
                self.measure_level(between, rules.ring, 1);
                measured = between;
            }
            let part = (y as f32 + 0.5) / COARSE as f32 - (between as f32 - 0.5);
            self.smooth_row(plane, y, y % kept, rules.taps, part);
            // A peak in a row needs the rows above and below it.
            if y > rules.border && y >= ROWS && y - 1 < height - rules.border {
                if blocks != Some((y - 1) / CELL_PX) {
                    blocks = Some((y - 1) / CELL_PX);
                    self.scan.begin(rules.thresholds_of_row(y - 1), width);
                }
                let rows = [self.smooth.row((y - 2) % kept), self.smooth.row((y - 1) % kept), self.smooth.row(y % kept)];
                self.scan.keep_peaks(rows, y - 1, rules, &mut self.cells);
            }
        }
        for cell in &self.cells.peaks {
            peaks.extend_from_slice(cell);
        }
        true
    }

    /// Means of coarse cells. Beyond the border they go on as they came, on a straight line, so that a slope stays one.
    #[inline(always)]
    fn measure_coarse(&mut self, plane: &Plane, ring: usize) {
        let (w, h) = (plane.width / COARSE, plane.height / COARSE);
        let coarse = &mut self.coarse;
        (coarse.width, coarse.height) = (w + 2 * ring, h + 2 * ring);
        coarse.pixels.resize(coarse.width * coarse.height, 0.0);
        self.across.resize(COARSE * w, 0.0);
        for y in 0..h {
            let rows: [&[f32]; COARSE] = [0, 1, 2, 3].map(|i| &plane.row(COARSE * y + i)[..COARSE * w]);
            add_four(rows, &mut self.across[..COARSE * w]);
            let row = &mut coarse.pixels[(y + ring) * coarse.width..][..coarse.width];
            for (out, q) in row[ring..].iter_mut().zip(self.across.chunks_exact(COARSE)) {
                *out = ((q[0] + q[1]) + (q[2] + q[3])) * (1.0 / (COARSE * COARSE) as f32);
            }
            for i in 1..=ring {
                row[ring - i] = 2.0 * row[ring] - row[ring + i];
                row[ring + w - 1 + i] = 2.0 * row[ring + w - 1] - row[ring + w - 1 - i];
            }
        }
        let stride = coarse.width;
        for i in 1..=ring {
            for x in 0..stride {
                let at = |y: usize| y * stride + x;
                coarse.pixels[at(ring - i)] = 2.0 * coarse.pixels[at(ring)] - coarse.pixels[at(ring + i)];
                let last = ring + h - 1;
                coarse.pixels[at(last + i)] = 2.0 * coarse.pixels[at(last)] - coarse.pixels[at(last - i)];
            }
        }
    }

    /// The level of a row of coarse cells: the mean of the ring around each, a square without its corners. And sample by sample, on straight
    /// lines between the middles of cells, into one of the two rows.
    #[inline(always)]
    fn measure_level(&mut self, y: usize, ring: usize, which: usize) {
        let run = 2 * ring - 1;
        let w = self.coarse.width - 2 * ring;
        let y = y + ring;
        self.sides.clear();
        self.sides.resize(self.coarse.width, 0.0);
        for row in y + 1 - ring..y + ring {
            add_to(&mut self.sides, self.coarse.row(row));
        }
        self.level.clear();
        self.level.extend_from_slice(&self.sides[..w]);
        add_to(&mut self.level, &self.sides[2 * ring..]);
        for row in [y - ring, y + ring] {
            for shift in 0..run {
                add_to(&mut self.level, &self.coarse.row(row)[1 + shift..]);
            }
        }
        let share = 1.0 / (4 * run) as f32;
        let row = &mut self.level_rows[which];
        let width = row.len();
        let line = |x: usize, cell: usize| {
            let (left, right) = (self.level[cell], self.level[cell + 1]);
            share * (left + ((x as f32 + 0.5) / COARSE as f32 - 0.5 - cell as f32) * (right - left))
        };
        // Half a cell at either end lies outside the middles, and what fills no cell.
        const HALF: usize = COARSE / 2;
        for x in (0..HALF).chain(COARSE * w - HALF..width) {
            row[x] = line(x, if x < HALF { 0 } else { w - 2 });
        }
        let chunks = row[HALF..COARSE * w - HALF].as_chunks_mut::<COARSE>().0;
        for ((left, right), chunk) in self.level.iter().zip(&self.level[1..]).zip(chunks) {
            let (left, step) = (share * left, share * (right - left) / COARSE as f32);
            for (i, level) in chunk.iter_mut().enumerate() {
                *level = left + (i as f32 + 0.5) * step;
            }
        }
    }

    /// Smooths row `y` both ways and takes the level off, into row `to` of what is kept; its two ends are nought.
    #[inline(always)]
    fn smooth_row(&mut self, plane: &Plane, y: usize, to: usize, taps: Taps, part: f32) {
        let (side, middle) = (taps.side, taps.middle());
        smooth_across([plane.row(y - 1), plane.row(y), plane.row(y + 1)], side, middle, &mut self.across);
        let out = &mut self.smooth.pixels[to * plane.width..][..plane.width];
        smooth_along(&self.across, [&self.level_rows[0], &self.level_rows[1]], part, (side, middle), out);
    }
}

#[inline(always)]
fn add_four(rows: [&[f32]; COARSE], out: &mut [f32]) {
    let n = out.len();
    let rows = rows.map(|row| &row[..n]);
    for x in 0..n {
        out[x] = (rows[0][x] + rows[1][x]) + (rows[2][x] + rows[3][x]);
    }
}

#[inline(always)]
fn add_to(sums: &mut [f32], terms: &[f32]) {
    let n = sums.len().min(terms.len());
    let (sums, terms) = (&mut sums[..n], &terms[..n]);
    for x in 0..n {
        sums[x] += terms[x];
    }
}

#[inline(always)]
fn smooth_across(rows: [&[f32]; 3], side: f32, middle: f32, out: &mut [f32]) {
    let n = out.len();
    let [above, here, below] = rows.map(|row| &row[..n]);
    for x in 0..n {
        out[x] = side * (above[x] + below[x]) + middle * here[x];
    }
}

/// Smooths a row along itself and takes off the level, which lies this `part` of the way between two rows.
#[inline(always)]
fn smooth_along(row: &[f32], levels: [&[f32]; 2], part: f32, (side, middle): (f32, f32), out: &mut [f32]) {
    let n = row.len() - 2;
    (out[0], out[n + 1]) = (0.0, 0.0);
    let (before, here, after) = (&row[..n], &row[1..n + 1], &row[2..n + 2]);
    let (above, below) = (&levels[0][1..n + 1], &levels[1][1..n + 1]);
    let out = &mut out[1..n + 1];
    for x in 0..n {
        let level = above[x] + part * (below[x] - above[x]);
        out[x] = side * (before[x] + after[x]) + middle * here[x] - level;
    }
}

/// The peaks that each cell keeps.
#[derive(Debug, Clone, Default)]
struct Cells {
    /// Cells along a row, and the side of one, samples.
    columns: usize,
    side: usize,
    /// Row after row, of each the highest first.
    peaks: Vec<Vec<Peak>>,
    /// Height that a sample of a cell must be above to be kept: once it is full, that of the lowest of its peaks.
    lowest: Vec<f32>,
}

impl Cells {
    /// Empty cells of a side for a picture of a size, samples.
    fn begin(&mut self, (width, height): (usize, usize), side: usize) {
        (self.columns, self.side) = (width.div_ceil(side), side);
        let count = self.columns * height.div_ceil(side);
        self.peaks.resize_with(count, Vec::new);
        self.peaks.iter_mut().for_each(Vec::clear);
        self.lowest.clear();
        self.lowest.resize(count, f32::MIN);
    }

    /// Keeps a sample if it is among the highest of its cell; of equals the earlier.
    #[inline(always)]
    fn keep(&mut self, (x, y): (usize, usize), height: f32, rules: &PeakRules<'_>) {
        let cell = y / self.side * self.columns + x / self.side;
        if height <= self.lowest[cell] || (rules.masked)(x, y) {
            return;
        }
        let peaks = &mut self.peaks[cell];
        let place = peaks.partition_point(|p| p.height >= height);
        if place < rules.per_cell {
            peaks.truncate(rules.per_cell - 1);
            peaks.insert(place, Peak { x, y, height, cell: cell as u32 });
            if let Some(lowest) = peaks.get(rules.per_cell - 1) {
                self.lowest[cell] = lowest.height;
            }
        }
    }
}

/// The memory of a scan of one row.
#[derive(Debug, Clone, Default)]
struct Scan {
    /// Threshold of each sample of the present row of blocks.
    thresholds: Vec<f32>,
    /// Highest one of each three samples above each other.
    highest: Vec<f32>,
    /// Whether a sample is a peak.
    marks: Vec<u8>,
}

impl Scan {
    /// Gets ready for a row of blocks, whose thresholds are given block by block.
    fn begin(&mut self, thresholds: &[f32], width: usize) {
        self.thresholds.clear();
        self.thresholds.extend((0..width).map(|x| thresholds[(x / CELL_PX).min(thresholds.len() - 1)]));
        self.highest.resize(width, 0.0);
        self.marks.resize(width, 0);
    }

    /// Keeps the peaks of the middle one of three rows, which is row `y`.
    #[inline(always)]
    fn keep_peaks(&mut self, rows: [&[f32]; ROWS], y: usize, rules: &PeakRules<'_>, cells: &mut Cells) {
        let width = self.highest.len();
        let border = rules.border.max(1);
        if width <= 2 * border {
            return;
        }
        mark_summits(rows, &self.thresholds, &mut self.highest, &mut self.marks);
        // What lies on the picture's edge has no neighbours, and is no peak; elsewhere almost all marks are nought.
        let (several, rest) = self.marks[border..width - border].as_chunks::<MARKS>();
        let mut last = [0; MARKS];
        last[..rest.len()].copy_from_slice(rest);
        for (n, marks) in several.iter().chain([&last]).enumerate() {
            // A mark is the lowest bit of its byte.
            let mut marks = u128::from_le_bytes(*marks);
            while marks != 0 {
                let x = border + n * MARKS + marks.trailing_zeros() as usize / 8;
                marks &= marks - 1;
                cells.keep((x, y), rows[1][x], rules);
            }
        }
    }
}

/// Marks that are looked at together.
const MARKS: usize = size_of::<u128>();

/// Marks the samples of the middle row that are above their threshold and no lower than their eight neighbours; its ends have none.
#[inline(always)]
fn mark_summits(rows: [&[f32]; ROWS], thresholds: &[f32], highest: &mut [f32], marks: &mut [u8]) {
    let width = highest.len();
    let [above, here, below] = rows.map(|row| &row[..width]);
    let higher = |a: f32, b: f32| if a > b { a } else { b };
    for x in 0..width {
        highest[x] = higher(higher(above[x], below[x]), here[x]);
    }
    let n = width - 2;
    let (left, right) = (&highest[..n], &highest[2..][..n]);
    let [above, here, below, thresholds] = [above, here, below, thresholds].map(|row| &row[1..][..n]);
    let marks = &mut marks[1..][..n];
    for x in 0..n {
        let beside = higher(higher(left[x], right[x]), higher(above[x], below[x]));
        marks[x] = u8::from((here[x] > thresholds[x]) & (here[x] >= beside));
    }
}

/// One search, as a kernel.
struct Search<'a> {
    finder: &'a mut PeakFinder,
    plane: &'a Plane,
    rules: &'a PeakRules<'a>,
    keep_on: &'a dyn Fn() -> bool,
    whole: bool,
    peaks: &'a mut Vec<Peak>,
}

impl Kernel for Search<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        self.finder.search(self.plane, self.rules, self.keep_on, self.whole, self.peaks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn star_field(stars: &[(usize, usize, f32)]) -> Plane {
        let (width, height) = (256, 128);
        let mut pixels = vec![0f32; width * height];
        for y in 0..height {
            for x in 0..width {
                // A gradient, so that the level has something to do.
                pixels[y * width + x] = 500.0 + 0.5 * x as f32;
                for &(sx, sy, a) in stars {
                    let r2 = (x as f32 - sx as f32).powi(2) + (y as f32 - sy as f32).powi(2);
                    pixels[y * width + x] += a * (-0.5 * r2).exp();
                }
            }
        }
        Plane { width, height, pixels }
    }

    fn find(plane: &Plane, per_cell: usize, masked: &dyn Fn(usize, usize) -> bool) -> Vec<(usize, usize)> {
        let thresholds = vec![5.0; 16 * 8];
        let rules = PeakRules {
            taps: Taps::WIDE,
            ring: 2,
            border: 10,
            cell: 128,
            per_cell,
            thresholds: &thresholds,
            threshold_columns: 16,
            masked,
        };
        let mut peaks = Vec::new();
        assert!(PeakFinder::default().find(plane, &rules, &|| true, false, &mut peaks));
        peaks.iter().map(|p| (p.x, p.y)).collect()
    }

    #[test]
    fn stars_are_found_on_a_gradient_at_their_pixels_highest_first() {
        let plane = star_field(&[(40, 40, 100.0), (60, 30, 200.0), (200, 100, 50.0)]);
        assert_eq!(find(&plane, 4, &|_, _| false), [(60, 30), (40, 40), (200, 100)]);
    }

    #[test]
    fn a_cell_gives_no_more_than_its_share() {
        let plane = star_field(&[(40, 40, 100.0), (60, 30, 200.0), (90, 90, 150.0), (200, 100, 50.0)]);
        assert_eq!(find(&plane, 2, &|_, _| false), [(60, 30), (90, 90), (200, 100)]);
    }

    #[test]
    fn nothing_is_taken_from_a_masked_place_or_the_border() {
        let plane = star_field(&[(40, 40, 100.0), (4, 60, 500.0), (250, 100, 500.0), (200, 100, 50.0)]);
        assert_eq!(find(&plane, 2, &|x, _| x < 128), [(200, 100)]);
    }

    #[test]
    fn a_slope_has_no_excess_up_to_the_border() {
        let plane = Plane {
            width: 70,
            height: 50,
            pixels: (0..70 * 50).map(|n| 3.0 * (n % 70) as f32 - 2.0 * (n / 70) as f32).collect(),
        };
        let thresholds = vec![5.0; 5 * 4];
        let taps = Taps::SHARP;
        let rules = PeakRules {
            taps,
            ring: 1,
            border: 1,
            cell: 32,
            per_cell: 2,
            thresholds: &thresholds,
            threshold_columns: 5,
            masked: &|_, _| false,
        };
        let (mut peaks, mut finder) = (Vec::new(), PeakFinder::default());
        assert!(finder.find(&plane, &rules, &|| true, true, &mut peaks));
        let worst = finder.smooth().pixels.iter().fold(0f32, |worst, e| worst.max(e.abs()));
        assert!(worst < 1e-3, "{worst}");
    }

    #[test]
    fn a_flat_picture_has_no_peaks_and_a_tiny_one_no_panic() {
        assert!(find(&star_field(&[]), 2, &|_, _| false).is_empty());
        let tiny = Plane { width: 5, height: 4, pixels: vec![1f32; 20] };
        assert!(find(&tiny, 2, &|_, _| false).is_empty());
    }
}
