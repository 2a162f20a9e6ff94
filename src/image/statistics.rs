//! Statistics of a frame in cells of 16 × 16 px: mean, noise, gain, saturation (stars-paper, "Solving - Statistics").

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows and cells are cut from the frame's own size")]

use super::Frame;
use crate::sky::{Kernel, with_vectors};

/// Side of a cell, px.
pub const CELL_PX: usize = 16;
/// A cell darker than this says nothing about the gain, ADU.
const CLEAN_MEAN_ADU: f64 = 100.0;
/// The gain is the mean of the lowest sixth of the clean cells' gains, if that is more than this many cells.
const GAIN_FRACTION: usize = 6;
const GAIN_CELLS: usize = 100;
/// Pixels at a frame's own highest value that make it a plateau, and not the tops of a few stars.
const PLATEAU_PX: usize = 16;
/// Values below the highest that a plateau must outweigh together, ADU.
const PLATEAU_STEPS: u16 = 3;

/// Mean and noise of the cells of a frame, row after row in file order; only whole cells.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CellStatistics {
    /// Cells along a row.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// Mean of each cell, ADU.
    pub mean: Vec<f32>,
    /// Sample standard deviation of each cell, ADU.
    pub sigma: Vec<f32>,
    /// Highest value of each cell, ADU.
    pub max: Vec<u16>,
    /// Mean of the cells' means, ADU.
    pub image_mean: f64,
    /// Median of the cells' standard deviations, ADU.
    pub image_noise: f64,
    /// Gain, ADU/e⁻, where enough clean cells show it.
    pub gain: Option<f64>,
    /// Value from which a pixel is saturated, ADU; `None` where none is.
    pub saturation: Option<u16>,
    /// Number of saturated pixels.
    pub saturated_px: usize,
    /// Local noise of each cell, ADU.
    noise: Vec<f32>,
    /// Scratch for medians.
    sorted: Vec<f32>,
    columns_of_band: BandColumns,
}

impl CellStatistics {
    /// Measures a frame, in the memory of the last one. `full_scale`: the camera's highest value where it is known, ADU.
    pub fn measure(&mut self, frame: &Frame, full_scale: Option<u16>) {
        self.columns = frame.width / CELL_PX;
        self.rows = frame.height / CELL_PX;
        self.mean.clear();
        self.sigma.clear();
        self.max.clear();
        self.columns_of_band.resize(self.columns * CELL_PX);
        for row in 0..self.rows {
            let first = row * CELL_PX * frame.width;
            let band = &frame.pixels[first..first + CELL_PX * frame.width];
            with_vectors(Gather { columns: &mut self.columns_of_band, band, stride: frame.width });
            for column in 0..self.columns {
                let (mean, sigma, max) = self.columns_of_band.cell(column * CELL_PX);
                self.mean.push(mean);
                self.sigma.push(sigma);
                self.max.push(max);
            }
        }
        self.image_mean = self.mean.iter().map(|&m| f64::from(m)).sum::<f64>() / self.mean.len().max(1) as f64;
        self.find_saturation(frame, full_scale);
        self.map_noise();
        self.image_noise = self.median_noise();
        self.gain = self.lowest_gain();
    }

    /// Noise around a position in file order, ADU: the third lowest of the nine cells around it, so that what a cell itself holds (a star,
    /// an edge) does not hide it.
    pub fn local_noise(&self, x: usize, y: usize) -> f32 {
        let (cx, cy) = ((x / CELL_PX).min(self.columns.max(1) - 1), (y / CELL_PX).min(self.rows.max(1) - 1));
        self.noise.get(cy * self.columns + cx).copied().unwrap_or(self.image_noise as f32)
    }

    /// The local noise of every cell.
    fn map_noise(&mut self) {
        self.noise.clear();
        for cy in 0..self.rows {
            for cx in 0..self.columns {
                let mut lowest = [f32::INFINITY; 3];
                for j in cy.saturating_sub(1)..(cy + 2).min(self.rows) {
                    for i in cx.saturating_sub(1)..(cx + 2).min(self.columns) {
                        let sigma = self.sigma[j * self.columns + i];
                        let kept =
                            [lowest[0].min(sigma), lowest[1].min(lowest[0].max(sigma)), lowest[2].min(lowest[1].max(sigma))];
                        lowest = kept;
                    }
                }
                // A frame of one or two cells has no third.
                let third = lowest.iter().rev().copied().find(|s| s.is_finite());
                self.noise.push(third.unwrap_or(0.0));
            }
        }
    }

    fn median_noise(&mut self) -> f64 {
        self.sorted.clear();
        self.sorted.extend_from_slice(&self.sigma);
        let middle = self.sorted.len() / 2;
        if self.sorted.is_empty() {
            return 0.0;
        }
        f64::from(*self.sorted.select_nth_unstable_by(middle, f32::total_cmp).1)
    }

    /// Gain from photon noise: variance over mean of the quietest sixth of the cells without a saturated pixel.
    fn lowest_gain(&mut self) -> Option<f64> {
        let saturation = self.saturation.unwrap_or(u16::MAX);
        self.sorted.clear();
        for ((&mean, &sigma), &max) in self.mean.iter().zip(&self.sigma).zip(&self.max) {
            if f64::from(mean) > CLEAN_MEAN_ADU && max < saturation {
                self.sorted.push(sigma * sigma / mean);
            }
        }
        let lowest = self.sorted.len() / GAIN_FRACTION;
        if lowest <= GAIN_CELLS {
            return None;
        }
        self.sorted.select_nth_unstable_by(lowest, f32::total_cmp);
        // Summed in order, so that the result does not depend on how the selection left them.
        self.sorted[..lowest].sort_unstable_by(f32::total_cmp);
        Some(self.sorted[..lowest].iter().map(|&g| f64::from(g)).sum::<f64>() / lowest as f64)
    }

    /// Saturation from the image itself: the camera's full scale, or a plateau at the frame's own highest value.
    fn find_saturation(&mut self, frame: &Frame, full_scale: Option<u16>) {
        self.saturation = None;
        self.saturated_px = 0;
        let highest = self.max.iter().copied().max().unwrap_or(0);
        let level = match full_scale {
            Some(full) if highest >= full => full,
            _ => highest,
        };
        if level == 0 {
            return;
        }
        let (mut count, mut just_below) = (0, 0);
        let below = level.saturating_sub(PLATEAU_STEPS);
        for row in 0..self.rows {
            for column in 0..self.columns {
                if self.max[row * self.columns + column] >= below {
                    for line in 0..CELL_PX {
                        let first = (row * CELL_PX + line) * frame.width + column * CELL_PX;
                        for &pixel in &frame.pixels[first..first + CELL_PX] {
                            count += usize::from(pixel >= level);
                            just_below += usize::from(pixel >= below && pixel < level);
                        }
                    }
                }
            }
        }
        // Counts fall towards the highest value of a sky, and pile up at the end of a scale.
        let plateau = count >= PLATEAU_PX && count > just_below;
        if full_scale == Some(level) || level == u16::MAX || plateau {
            self.saturation = Some(level);
            self.saturated_px = count;
        }
    }
}

/// Sums down the columns of a band of [`CELL_PX`] rows.
#[derive(Debug, Clone, Default, PartialEq)]
struct BandColumns {
    /// First pixel of each column's cell: sums relative to it stay small, so that single precision keeps the variance's digits.
    reference: Vec<f32>,
    sum: Vec<f32>,
    squares: Vec<f32>,
    max: Vec<u16>,
}

impl BandColumns {
    fn resize(&mut self, width: usize) {
        for column in [&mut self.reference, &mut self.sum, &mut self.squares] {
            column.resize(width, 0.0);
        }
        self.max.resize(width, 0);
    }

    /// Mean, sample standard deviation and highest value of the cell whose first column is `x`.
    fn cell(&self, x: usize) -> (f32, f32, u16) {
        const N: f64 = (CELL_PX * CELL_PX) as f64;
        let total = self.sum[x..x + CELL_PX].iter().map(|&s| f64::from(s)).sum::<f64>();
        let squares = self.squares[x..x + CELL_PX].iter().map(|&s| f64::from(s)).sum::<f64>();
        let variance = (squares - total * total / N).max(0.0) / (N - 1.0);
        let highest = self.max[x..x + CELL_PX].iter().copied().max().unwrap_or(0);
        ((f64::from(self.reference[x]) + total / N) as f32, variance.sqrt() as f32, highest)
    }
}

/// Sums a band whose rows have `stride` pixels.
struct Gather<'a> {
    columns: &'a mut BandColumns,
    band: &'a [u16],
    stride: usize,
}

impl Kernel for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let BandColumns { reference, sum, squares, max } = self.columns;
        let n = sum.len();
        for (reference, first) in reference.chunks_exact_mut(CELL_PX).zip(self.band.chunks_exact(CELL_PX)) {
            reference.fill(f32::from(first[0]));
        }
        sum.fill(0.0);
        squares.fill(0.0);
        max.fill(0);
        let (reference, sum, squares, max) = (&reference[..n], &mut sum[..n], &mut squares[..n], &mut max[..n]);
        for line in self.band.chunks_exact(self.stride) {
            let pixels = &line[..n];
            for x in 0..n {
                let d = f32::from(pixels[x]) - reference[x];
                sum[x] += d;
                squares[x] += d * d;
            }
            for x in 0..n {
                max[x] = max[x].max(pixels[x]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::RowOrder;

    fn frame(width: usize, height: usize, pixel: impl Fn(usize, usize) -> u16) -> Frame {
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| pixel(x, y)).collect();
        Frame::new(width, height, pixels, RowOrder::BottomFirst).unwrap()
    }

    #[test]
    fn mean_and_noise_are_those_of_the_cells() {
        // Alternating ±3 around 1000: sample standard deviation 3·√(256/255).
        let f = frame(64, 48, |x, y| if (x + y) % 2 == 0 { 1003 } else { 997 });
        let mut cells = CellStatistics::default();
        cells.measure(&f, None);
        assert_eq!((cells.columns, cells.rows), (4, 3));
        assert!((cells.image_mean - 1000.0).abs() < 1e-4);
        assert!((cells.image_noise - 3.0 * (256.0f64 / 255.0).sqrt()).abs() < 1e-4);
    }

    #[test]
    fn a_plateau_is_saturation_and_a_single_bright_pixel_is_not() {
        let mut cells = CellStatistics::default();
        cells.measure(&frame(64, 64, |x, y| if x < 8 && y < 8 { 4095 } else { 1000 }), None);
        assert_eq!((cells.saturation, cells.saturated_px), (Some(4095), 64));
        cells.measure(&frame(64, 64, |x, y| if x == 8 && y == 8 { 4095 } else { 1000 }), None);
        assert_eq!((cells.saturation, cells.saturated_px), (None, 0));
        cells.measure(&frame(64, 64, |x, y| if x == 8 && y == 8 { 4095 } else { 1000 }), Some(4095));
        assert_eq!((cells.saturation, cells.saturated_px), (Some(4095), 1));
    }

    #[test]
    fn the_top_of_a_quiet_sky_is_no_plateau() {
        // Few values, as in 8 bits, falling off towards the highest.
        let f = frame(256, 256, |x, y| [10, 10, 10, 11, 9, 10, 11, 12][(x * 31 + y * 17) % 8]);
        let mut cells = CellStatistics::default();
        cells.measure(&f, None);
        assert_eq!(cells.saturation, None);
    }

    #[test]
    fn gain_is_variance_over_mean_of_the_quietest_cells() {
        // Three levels, the outer ones in a quarter of the pixels each: the variance of photons seen with that gain.
        let step = (2.0 * 0.04f64 * 1600.0).sqrt();
        let f = frame(1024, 512, |x, y| (1600.0 + [0.0, step, 0.0, -step][(x + y) % 4] + ((x * y) % 7 / 6) as f64) as u16);
        let mut cells = CellStatistics::default();
        cells.measure(&f, None);
        assert!((cells.gain.unwrap() / 0.04 - 1.0).abs() < 0.1, "{:?}", cells.gain);
    }

    #[test]
    fn a_frame_smaller_than_a_cell_has_no_statistics_and_no_panic() {
        let mut cells = CellStatistics::default();
        cells.measure(&frame(7, 5, |_, _| 9), None);
        assert_eq!((cells.columns, cells.rows, cells.image_noise), (0, 0, 0.0));
        assert_eq!(cells.local_noise(3, 3), 0.0);
    }
}
