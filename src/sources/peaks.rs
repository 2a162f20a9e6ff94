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
}

impl Peak {
    /// The cell of a side, samples, that it lies in: column and row.
    pub fn cell(&self, side: usize) -> (usize, usize) {
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
    excess: [Vec<f32>; 3],
    cells: Vec<Vec<Peak>>,
}

impl PeakFinder {
    /// Finds the peaks of a plane, cell after cell, the highest of each first. `keep_on` is asked every few rows; where it says no,
    /// the search ends with `false`. `whole`: gets the smoothed picture above its level, for those who search it again.
    pub fn find(
        &mut self,
        plane: &Plane,
        rules: &PeakRules<'_>,
        keep_on: &dyn Fn() -> bool,
        whole: Option<&mut Plane>,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        with_vectors(Search { finder: self, plane, rules, keep_on, whole, peaks })
    }

    #[inline(always)]
    fn search(
        &mut self,
        plane: &Plane,
        rules: &PeakRules<'_>,
        keep_on: &dyn Fn() -> bool,
        mut whole: Option<&mut Plane>,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        peaks.clear();
        let (width, height) = (plane.width, plane.height);
        if let Some(whole) = whole.as_deref_mut() {
            (whole.width, whole.height) = (width, height);
            whole.pixels.clear();
            whole.pixels.resize(width * height, 0.0);
        }
        if width < LEAST_SIDE || height < LEAST_SIDE || rules.cell == 0 {
            return true;
        }
        self.measure_coarse(plane, rules.ring);
        let coarse_rows = height / COARSE;
        let columns = width.div_ceil(rules.cell);
        self.cells.resize_with(columns * height.div_ceil(rules.cell), Vec::new);
        self.cells.iter_mut().for_each(Vec::clear);
        for row in self.excess.iter_mut().chain(&mut self.level_rows).chain([&mut self.across]) {
            row.resize(width, 0.0);
        }
        // The row of coarse cells below the present row, whose level is measured with that of the one above; none yet.
        let mut measured = 0;
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
            self.excess_row(plane, y, rules.taps, part);
            if let Some(whole) = whole.as_deref_mut() {
                whole.pixels[y * width..][..width].copy_from_slice(&self.excess[y % 3]);
            }
            // A peak in a row needs the excess of the rows above and below it.
            if y > rules.border && y >= 3 && y - 1 < height - rules.border {
                let rows = [&self.excess[(y + 1) % 3][..], &self.excess[(y + 2) % 3], &self.excess[y % 3]];
                scan_row(rows, y - 1, columns, rules, &mut self.cells);
            }
        }
        for cell in &self.cells {
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

    /// Smooths a row both ways and takes the level off; its two ends are nought.
    #[inline(always)]
    fn excess_row(&mut self, plane: &Plane, y: usize, taps: Taps, part: f32) {
        let (side, middle) = (taps.side, taps.middle());
        smooth_across([plane.row(y - 1), plane.row(y), plane.row(y + 1)], side, middle, &mut self.across);
        let out = &mut self.excess[y % 3];
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

/// Keeps the peaks of the middle one of three rows, which is row `y`. `columns`: cells along a row.
#[inline(always)]
fn scan_row(rows: [&[f32]; 3], y: usize, columns: usize, rules: &PeakRules<'_>, cells: &mut [Vec<Peak>]) {
    let here = rows[1];
    let width = here.len();
    let thresholds = rules.thresholds_of_row(y);
    for block in 0..width.div_ceil(CELL_PX) {
        let (first, last) = (block * CELL_PX, ((block + 1) * CELL_PX).min(width));
        let mut threshold = thresholds[block.min(rules.threshold_columns - 1)];
        // In a cell that is full, only what is above the lowest of its peaks is worth a look.
        let cell = (y / rules.cell) * columns + first / rules.cell;
        if first / rules.cell == (last - 1) / rules.cell
            && let Some(lowest) = cells[cell].get(rules.per_cell.saturating_sub(1))
        {
            threshold = threshold.max(lowest.height);
        }
        // Almost every block ends here, without a branch inside it.
        if here[first..last].first_chunk().is_some_and(|block| !any_above(block, threshold)) {
            continue;
        }
        // What lies on the picture's edge has no neighbours, and is no peak.
        let (first, last) = (first.max(rules.border.max(1)), last.min(width.saturating_sub(rules.border.max(1))));
        let mut peaks = summits(rows, first, last, threshold);
        while peaks != 0 {
            let x = first + peaks.trailing_zeros() as usize;
            peaks &= peaks - 1;
            if !(rules.masked)(x, y) {
                insert(&mut cells[(y / rules.cell) * columns + x / rules.cell], Peak { x, y, height: here[x] }, rules.per_cell);
            }
        }
    }
}

/// Which samples of the middle row, of those from `first` to `last`, are above the threshold and no lower than their neighbours: bit 0
/// for the first.
#[inline(always)]
fn summits(rows: [&[f32]; 3], first: usize, last: usize, threshold: f32) -> u32 {
    let mut bits = 0;
    if last == first + CELL_PX {
        // A whole block: without a branch, so that it is done in vectors.
        let [above, here, below] =
            rows.map(|row| row[first - 1..].first_chunk::<{ CELL_PX + 2 }>().unwrap_or(&[f32::MAX; CELL_PX + 2]));
        for i in 0..CELL_PX {
            let at = here[i + 1];
            let beside = (at >= here[i]) & (at >= here[i + 2]);
            let over = (at >= above[i]) & (at >= above[i + 1]) & (at >= above[i + 2]);
            let under = (at >= below[i]) & (at >= below[i + 1]) & (at >= below[i + 2]);
            bits |= u32::from((at > threshold) & beside & over & under) << i;
        }
    } else {
        for x in first..last {
            let at = rows[1][x];
            let is_peak = at > threshold && rows.iter().all(|row| row[x - 1..=x + 1].iter().all(|&d| d <= at));
            bits |= u32::from(is_peak) << (x - first);
        }
    }
    bits
}

/// One search, as a kernel.
struct Search<'a> {
    finder: &'a mut PeakFinder,
    plane: &'a Plane,
    rules: &'a PeakRules<'a>,
    keep_on: &'a dyn Fn() -> bool,
    whole: Option<&'a mut Plane>,
    peaks: &'a mut Vec<Peak>,
}

impl Kernel for Search<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        self.finder.search(self.plane, self.rules, self.keep_on, self.whole, self.peaks)
    }
}

/// Keeps the highest `most` peaks of a cell, highest first; of equals the earlier.
fn insert(cell: &mut Vec<Peak>, peak: Peak, most: usize) {
    let place = cell.partition_point(|p| p.height >= peak.height);
    if place < most {
        cell.truncate(most - 1);
        cell.insert(place, peak);
    }
}

/// Whether any sample of a block is above the threshold.
#[inline(always)]
fn any_above(block: &[f32; CELL_PX], threshold: f32) -> bool {
    let mut highest = [f32::MIN; CELL_PX / 4];
    for quarter in block.chunks_exact(CELL_PX / 4) {
        for k in 0..CELL_PX / 4 {
            highest[k] = if quarter[k] > highest[k] { quarter[k] } else { highest[k] };
        }
    }
    highest[0] > threshold || highest[1] > threshold || highest[2] > threshold || highest[3] > threshold
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
        assert!(PeakFinder::default().find(plane, &rules, &|| true, None, &mut peaks));
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
        let (mut peaks, mut whole) = (Vec::new(), Plane::default());
        assert!(PeakFinder::default().find(&plane, &rules, &|| true, Some(&mut whole), &mut peaks));
        let worst = whole.pixels.iter().fold(0f32, |worst, e| worst.max(e.abs()));
        assert!(worst < 1e-3, "{worst}");
    }

    #[test]
    fn a_flat_picture_has_no_peaks_and_a_tiny_one_no_panic() {
        assert!(find(&star_field(&[]), 2, &|_, _| false).is_empty());
        let tiny = Plane { width: 5, height: 4, pixels: vec![1f32; 20] };
        assert!(find(&tiny, 2, &|_, _| false).is_empty());
    }
}
