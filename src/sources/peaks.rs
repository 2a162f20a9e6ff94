//! Peaks: where a smoothed picture stands above its surroundings (stars-paper, "Solving - Source Finding").
//!
//! Level: means of 4 × 4 samples; each such cell's level is the mean of the ring of 28 cells four away from it, so that a star
//! does not raise its own level. Smooth: a Gaussian of σ 1 over three taps each way. A peak is a local maximum of the difference
//! above the threshold. One pass over the picture, with a ring of three rows.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the plane's own size")]

use super::plane::{Plane, Sample};
use crate::image::CELL_PX;
use crate::sky::{Kernel, with_vectors};

/// Samples along the side of a coarse cell, and the ring's distance in coarse cells.
const COARSE: usize = 4;
const RING: usize = 4;
/// Weights of a Gaussian of σ 1 sample over three taps, normalised.
const SIDE_TAP: f32 = 0.274_068_62;
const MIDDLE_TAP: f32 = 0.451_862_77;

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

/// How peaks are chosen.
pub struct PeakRules<'a> {
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

/// The memory of a search.
#[derive(Debug, Clone, Default)]
pub struct PeakFinder {
    rows_sum: Vec<f32>,
    coarse: Vec<f32>,
    along: Vec<f32>,
    across: Vec<f32>,
    level: Vec<f32>,
    level_row: Vec<f32>,
    smooth: [Vec<f32>; 3],
    excess: [Vec<f32>; 3],
    cells: Vec<Vec<Peak>>,
}

impl PeakFinder {
    /// Finds the peaks of a plane, cell after cell, the highest of each first. `keep_on` is asked every few rows; where it says no, the
    /// search ends with `false`.
    pub fn find<T: Sample>(
        &mut self,
        plane: &Plane<T>,
        rules: &PeakRules<'_>,
        keep_on: &dyn Fn() -> bool,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        with_vectors(Search { finder: self, plane, rules, keep_on, peaks })
    }

    #[inline(always)]
    fn search<T: Sample>(
        &mut self,
        plane: &Plane<T>,
        rules: &PeakRules<'_>,
        keep_on: &dyn Fn() -> bool,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        peaks.clear();
        let (width, height) = (plane.width, plane.height);
        if width < 3 * CELL_PX || height < 3 * CELL_PX || rules.cell == 0 {
            return true;
        }
        self.measure_level(plane);
        let columns = width.div_ceil(rules.cell);
        self.cells.resize_with(columns * height.div_ceil(rules.cell), Vec::new);
        self.cells.iter_mut().for_each(Vec::clear);
        for ring in [&mut self.smooth, &mut self.excess] {
            ring.iter_mut().for_each(|row| row.resize(width, 0.0));
        }
        self.level_row.resize(width, 0.0);
        smooth_row(plane.row(0), &mut self.smooth[0]);
        smooth_row(plane.row(1), &mut self.smooth[1]);
        // Row y of the excess needs the smoothed rows y − 1 to y + 1; a peak in row y needs the excess of the same three.
        for y in 1..height - 1 {
            if y % 64 == 0 && !keep_on() {
                return false;
            }
            smooth_row(plane.row(y + 1), &mut self.smooth[(y + 1) % 3]);
            if y % COARSE == 0 || y == 1 {
                self.expand_level(y / COARSE, width);
            }
            let (above, here, below) = (&self.smooth[(y - 1) % 3], &self.smooth[y % 3], &self.smooth[(y + 1) % 3]);
            excess_row(above, here, below, &self.level_row, &mut self.excess[y % 3]);
            if y > rules.border && y >= 3 && y - 1 < height - rules.border {
                self.scan_row(y - 1, width, columns, rules);
            }
        }
        for cell in &self.cells {
            peaks.extend_from_slice(cell);
        }
        true
    }

    /// Means of coarse cells, and the mean of the ring around each.
    #[inline(always)]
    fn measure_level<T: Sample>(&mut self, plane: &Plane<T>) {
        let (w, h) = (plane.width / COARSE, plane.height / COARSE);
        self.coarse.clear();
        self.rows_sum.resize(w * COARSE, 0.0);
        for y in 0..h {
            let rows: [&[T]; COARSE] = std::array::from_fn(|i| &plane.row(COARSE * y + i)[..w * COARSE]);
            let sums = &mut self.rows_sum[..w * COARSE];
            for x in 0..w * COARSE {
                sums[x] = (rows[0][x].value() + rows[1][x].value()) + (rows[2][x].value() + rows[3][x].value());
            }
            let means = sums.chunks_exact(COARSE).map(|q| ((q[0] + q[1]) + (q[2] + q[3])) * (1.0 / (COARSE * COARSE) as f32));
            self.coarse.extend(means);
        }
        self.level.clear();
        self.level.resize(w * h, 0.0);
        sum_runs(&self.coarse, w, h, &mut self.along, &mut self.across);
        for y in 0..h {
            for x in 0..w {
                if y < RING || y + RING >= h || x < RING || x + RING >= w {
                    self.level[y * w + x] = ring_at_border(&self.coarse, w, h, x, y);
                }
            }
        }
        if w <= 2 * RING || h <= 2 * RING {
            return;
        }
        let inner = w - 2 * RING;
        for y in RING..h - RING {
            let above = &self.along[(y - RING) * w + RING..][..inner];
            let below = &self.along[(y + RING) * w + RING..][..inner];
            let left = &self.across[y * w..][..inner];
            let right = &self.across[y * w + 2 * RING..][..inner];
            let out = &mut self.level[y * w + RING..][..inner];
            for x in 0..inner {
                out[x] = ((above[x] + below[x]) + (left[x] + right[x])) * (1.0 / 28.0);
            }
        }
    }

    /// The level of a row of coarse cells, sample by sample.
    #[inline(always)]
    fn expand_level(&mut self, coarse_y: usize, width: usize) {
        let w = width / COARSE;
        let h = self.level.len() / w;
        let row = &self.level[coarse_y.min(h - 1) * w..][..w];
        for (x, chunk) in self.level_row.chunks_mut(COARSE).enumerate() {
            chunk.fill(row[x.min(w - 1)]);
        }
    }

    /// Keeps the peaks of one row, given the excess of the row and of its neighbours.
    #[inline(always)]
    fn scan_row(&mut self, y: usize, width: usize, columns: usize, rules: &PeakRules<'_>) {
        let here = &self.excess[y % 3][..width];
        let block_rows = rules.thresholds.len() / rules.threshold_columns;
        let thresholds = &rules.thresholds[(y / CELL_PX).min(block_rows - 1) * rules.threshold_columns..];
        let rows = [&self.excess[(y + 2) % 3][..width], here, &self.excess[(y + 1) % 3][..width]];
        for block in 0..width.div_ceil(CELL_PX) {
            let threshold = thresholds[block.min(rules.threshold_columns - 1)];
            let (first, last) = (block * CELL_PX, ((block + 1) * CELL_PX).min(width));
            // Almost every block ends here, without a branch inside it.
            if here[first..last].first_chunk().is_some_and(|block| !any_above(block, threshold)) {
                continue;
            }
            for x in first.max(rules.border)..last.min(width - rules.border) {
                let is_peak = here[x] > threshold && rows.iter().all(|row| row[x - 1..=x + 1].iter().all(|&d| d <= here[x]));
                if is_peak && !(rules.masked)(x, y) {
                    let cell = &mut self.cells[(y / rules.cell) * columns + x / rules.cell];
                    insert(cell, Peak { x, y, height: here[x] }, rules.per_cell);
                }
            }
        }
    }
}

/// One search, as a kernel.
struct Search<'a, T> {
    finder: &'a mut PeakFinder,
    plane: &'a Plane<T>,
    rules: &'a PeakRules<'a>,
    keep_on: &'a dyn Fn() -> bool,
    peaks: &'a mut Vec<Peak>,
}

impl<T: Sample> Kernel for Search<'_, T> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        self.finder.search(self.plane, self.rules, self.keep_on, self.peaks)
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

/// Sums of seven coarse cells around each, along its row and across its rows: the sides of a ring, which is a square of side nine
/// without its corners. Where seven do not fit, nothing is written.
#[inline(always)]
fn sum_runs(coarse: &[f32], w: usize, h: usize, along: &mut Vec<f32>, across: &mut Vec<f32>) {
    const REACH: usize = RING - 1;
    const RUN: usize = 2 * REACH + 1;
    for sums in [&mut *along, &mut *across] {
        sums.clear();
        sums.resize(w * h, 0.0);
    }
    if w < RUN || h < RUN {
        return;
    }
    let n = w - 2 * REACH;
    for y in 0..h {
        let runs: [&[f32]; RUN] = std::array::from_fn(|i| &coarse[y * w + i..][..n]);
        let out = &mut along[y * w + REACH..][..n];
        for x in 0..n {
            out[x] = ((runs[0][x] + runs[1][x]) + (runs[2][x] + runs[3][x])) + ((runs[4][x] + runs[5][x]) + runs[6][x]);
        }
    }
    for y in REACH..h - REACH {
        let runs: [&[f32]; RUN] = std::array::from_fn(|i| &coarse[(y + i - REACH) * w..][..w]);
        let out = &mut across[y * w..][..w];
        for x in 0..w {
            out[x] = ((runs[0][x] + runs[1][x]) + (runs[2][x] + runs[3][x])) + ((runs[4][x] + runs[5][x]) + runs[6][x]);
        }
    }
}

/// Mean of those cells of a ring that lie inside the picture.
fn ring_at_border(coarse: &[f32], w: usize, h: usize, x: usize, y: usize) -> f32 {
    let (mut sum, mut n) = (0f32, 0f32);
    let mut add = |cx: usize, cy: usize| {
        // Cells left of or above the picture wrap to huge numbers.
        if cx < w && cy < h {
            sum += coarse[cy * w + cx];
            n += 1.0;
        }
    };
    for i in 0..2 * RING - 1 {
        let (column, row) = ((x + i + 1).wrapping_sub(RING), (y + i + 1).wrapping_sub(RING));
        add(column, y.wrapping_sub(RING));
        add(column, y + RING);
        add(x.wrapping_sub(RING), row);
        add(x + RING, row);
    }
    if n > 0.0 { sum / n } else { 0.0 }
}

/// Smooths a row along itself; its two ends are copied.
#[inline(always)]
fn smooth_row<T: Sample>(row: &[T], out: &mut [f32]) {
    let n = row.len() - 2;
    out[0] = row[0].value();
    out[n + 1] = row[n + 1].value();
    let (left, middle, right) = (&row[..n], &row[1..n + 1], &row[2..n + 2]);
    let out = &mut out[1..n + 1];
    for x in 0..n {
        out[x] = SIDE_TAP * (left[x].value() + right[x].value()) + MIDDLE_TAP * middle[x].value();
    }
}

/// Smooths three rows across and takes the level off.
#[inline(always)]
fn excess_row(above: &[f32], here: &[f32], below: &[f32], level: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (above, here, below, level) = (&above[..n], &here[..n], &below[..n], &level[..n]);
    for x in 0..n {
        out[x] = SIDE_TAP * (above[x] + below[x]) + MIDDLE_TAP * here[x] - level[x];
    }
}

/// Whether any sample of a block is above the threshold.
#[inline(always)]
fn any_above(block: &[f32; CELL_PX], threshold: f32) -> bool {
    let mut above = 0u32;
    for &d in block {
        above += u32::from(d > threshold);
    }
    above != 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn star_field(stars: &[(usize, usize, f32)]) -> Plane<f32> {
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

    fn find(plane: &Plane<f32>, per_cell: usize, masked: &dyn Fn(usize, usize) -> bool) -> Vec<(usize, usize)> {
        let thresholds = vec![5.0; 16 * 8];
        let rules = PeakRules { border: 10, cell: 128, per_cell, thresholds: &thresholds, threshold_columns: 16, masked };
        let mut peaks = Vec::new();
        assert!(PeakFinder::default().find(plane, &rules, &|| true, &mut peaks));
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
    fn a_flat_picture_has_no_peaks_and_a_tiny_one_no_panic() {
        assert!(find(&star_field(&[]), 2, &|_, _| false).is_empty());
        let tiny = Plane { width: 5, height: 4, pixels: vec![1f32; 20] };
        assert!(find(&tiny, 2, &|_, _| false).is_empty());
    }
}
