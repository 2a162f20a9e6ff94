//! Statistics of a frame in cells of 16 × 16 px: mean, noise, gain, saturation (stars-paper, "Solving - Statistics").

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows and cells are cut from the frame's own size")]

use super::Frame;
use super::cell::{CellSums, Lines};
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

/// Neighbouring pixels' differences tell the noise even on a slope; the third lowest of nine such estimates, of 240 differences each, is
/// low by this factor (trials on plain noise).
const THIRD_OF_NINE: f32 = 0.967;

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
    /// Median of the standard deviations of the cells without a saturated pixel (where there are such), ADU.
    pub image_noise: f64,
    /// Gain, ADU/e⁻, where enough clean cells show it.
    pub gain: Option<f64>,
    /// Value from which a pixel is saturated, ADU; `None` where none is.
    pub saturation: Option<u16>,
    /// Number of saturated pixels.
    pub saturated_px: usize,
    /// Noise of each cell from the differences of neighbouring pixels, ADU; infinite where a pixel is saturated.
    step_sigma: Vec<f32>,
    /// Local noise of each cell, ADU.
    noise: Vec<f32>,
    /// Whether a cell, or one of its neighbours, has nothing but saturated pixels; empty where none has.
    beside_clipped: Vec<bool>,
    /// Scratch for medians.
    sorted: Vec<f32>,
    noise_rows: NoiseRows,
}

/// The memory of [`CellStatistics::map_noise`].
#[derive(Debug, Clone, Default, PartialEq)]
struct NoiseRows {
    lowest: [Vec<u32>; 3],
    padded: Vec<u32>,
}

impl CellStatistics {
    /// Measures a frame, in the memory of the last one. `full_scale`: the camera's highest value where it is known, ADU.
    pub fn measure(&mut self, frame: &Frame, full_scale: Option<u16>) {
        self.columns = frame.width / CELL_PX;
        self.rows = frame.height / CELL_PX;
        for list in [&mut self.mean, &mut self.sigma, &mut self.step_sigma] {
            list.resize(self.columns * self.rows, 0.0);
        }
        self.max.resize(self.columns * self.rows, 0);
        if self.columns > 0 {
            gather_soonest(self, frame);
        }
        self.image_mean = self.mean.iter().map(|&m| f64::from(m)).sum::<f64>() / self.mean.len().max(1) as f64;
        self.find_saturation(frame, full_scale);
        if let Some(level) = self.saturation {
            // Clipped pixels have no noise to tell of.
            self.step_sigma.iter_mut().zip(&self.max).filter(|(_, max)| **max >= level).for_each(|(s, _)| *s = f32::INFINITY);
        }
        self.map_clipped();
        self.image_noise = self.median_noise();
        with_vectors(MapNoise(self));
        self.gain = self.lowest_gain();
    }

    /// Whether a position in file order lies on or at the border of a saturated area: what stands out there is the border.
    pub fn is_beside_clipped(&self, x: usize, y: usize) -> bool {
        let (cx, cy) = ((x / CELL_PX).min(self.columns.max(1) - 1), (y / CELL_PX).min(self.rows.max(1) - 1));
        self.beside_clipped.get(cy * self.columns + cx).copied().unwrap_or(false)
    }

    fn map_clipped(&mut self) {
        self.beside_clipped.clear();
        let Some(level) = self.saturation.map(f32::from) else { return };
        if self.mean.iter().all(|&mean| mean < level) {
            return;
        }
        self.beside_clipped.resize(self.columns * self.rows, false);
        for (at, _) in self.mean.iter().enumerate().filter(|(_, mean)| **mean >= level) {
            let (cx, cy) = (at % self.columns, at / self.columns);
            for y in cy.saturating_sub(1)..(cy + 2).min(self.rows) {
                for x in cx.saturating_sub(1)..(cx + 2).min(self.columns) {
                    self.beside_clipped[y * self.columns + x] = true;
                }
            }
        }
    }

    /// Noise of a pixel around a position in file order, ADU: the third lowest of the nine cells around it, so that what a cell itself
    /// holds (a star, an edge) does not hide it. Slopes do not count as noise.
    pub fn local_noise(&self, x: usize, y: usize) -> f32 {
        let (cx, cy) = ((x / CELL_PX).min(self.columns.max(1) - 1), (y / CELL_PX).min(self.rows.max(1) - 1));
        self.noise.get(cy * self.columns + cx).copied().unwrap_or(self.image_noise as f32)
    }

    /// Local noise of a row of cells, ADU, for the pixel row `y`.
    pub fn noise_row(&self, y: usize) -> &[f32] {
        let row = (y / CELL_PX).min(self.rows.max(1) - 1);
        self.noise.get(row * self.columns..(row + 1) * self.columns).unwrap_or_default()
    }

    /// The local noise of every cell.
    #[inline(always)]
    fn map_noise(&mut self) {
        let (columns, rows) = (self.columns, self.rows);
        self.noise.clear();
        self.noise.resize(columns * rows, 0.0);
        // The lowest three so far of each cell's neighbourhood, as bits: numbers that are not negative have the order of their bits, which
        // compare faster. Infinity left and right of the frame, so that all cells are alike.
        const NONE: u32 = f32::INFINITY.to_bits();
        let NoiseRows { lowest, padded } = &mut self.noise_rows;
        lowest.iter_mut().for_each(|list| list.resize(columns, NONE));
        padded.clear();
        padded.resize(columns + 2, NONE);
        for cy in 0..rows {
            lowest.iter_mut().for_each(|list| list.fill(NONE));
            for j in cy.saturating_sub(1)..(cy + 2).min(rows) {
                for (bits, sigma) in padded[1..=columns].iter_mut().zip(&self.step_sigma[j * columns..]) {
                    *bits = sigma.to_bits();
                }
                for shift in 0..3 {
                    let sigma = &padded[shift..][..columns];
                    let [a, b, c] = &mut *lowest;
                    let (a, b, c) = (&mut a[..columns], &mut b[..columns], &mut c[..columns]);
                    for x in 0..columns {
                        c[x] = c[x].min(b[x].max(sigma[x]));
                        b[x] = b[x].min(a[x].max(sigma[x]));
                        a[x] = a[x].min(sigma[x]);
                    }
                }
            }
            for (x, out) in self.noise[cy * columns..][..columns].iter_mut().enumerate() {
                // A frame of one or two cells has no third; amid clipped cells none is left.
                let third = lowest.iter().rev().map(|list| f32::from_bits(list[x])).find(|s| s.is_finite());
                *out = third.map_or(self.image_noise as f32, |s| s / THIRD_OF_NINE);
            }
        }
    }

    fn median_noise(&mut self) -> f64 {
        self.sorted.clear();
        let clean = self.step_sigma.iter().any(|s| s.is_finite());
        self.sorted
            .extend(self.sigma.iter().zip(&self.step_sigma).filter(|(_, step)| step.is_finite() || !clean).map(|(s, _)| s));
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
        // Summed as whole numbers, so that the result does not depend on the order in which the selection left them.
        const UNIT: f64 = (1_u64 << 32) as f64;
        let sum: u128 = self.sorted[..lowest].iter().map(|&gain| (f64::from(gain) * UNIT) as u128).sum();
        Some(sum as f64 / UNIT / lowest as f64)
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

/// Mean, standard deviation, noise and highest value of every cell, one pass over the frame; `sums_of` takes a cell's sums.
#[inline(always)]
fn gather(cells: &mut CellStatistics, frame: &Frame, sums_of: impl Fn(&Lines<'_>, usize) -> CellSums) {
    for row in 0..cells.rows {
        let lines = std::array::from_fn(|line| &frame.pixels[(row * CELL_PX + line) * frame.width..][..frame.width]);
        let of_row = row * cells.columns..(row + 1) * cells.columns;
        let (means, sigmas) = (&mut cells.mean[of_row.clone()], &mut cells.sigma[of_row.clone()]);
        let (step_sigmas, maxima) = (&mut cells.step_sigma[of_row.clone()], &mut cells.max[of_row]);
        for column in 0..means.len() {
            let sums = sums_of(&lines, column * CELL_PX);
            (means[column], sigmas[column], step_sigmas[column]) = (sums.mean, sums.variance, sums.step_variance);
            maxima[column] = sums.max;
        }
        for list in [sigmas, step_sigmas] {
            list.iter_mut().for_each(|variance| *variance = variance.sqrt());
        }
    }
}

/// As [`gather`], with the sums in the way that this processor does soonest.
fn gather_soonest(cells: &mut CellStatistics, frame: &Frame) {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn with_avx2(cells: &mut CellStatistics, frame: &Frame) {
            gather(cells, frame, |lines, x| CellSums::of_avx2(lines, x));
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // Measured on frames of 1536 × 1024 px: 0.2 ms instead of the 0.35 ms that the compiler's own vectors take.
            #[allow(unsafe_code, reason = "code compiled for AVX2 is called where the processor has it")]
            // SAFETY: the processor was just found to have AVX2, which is all that the call needs.
            return unsafe { with_avx2(cells, frame) };
        }
    }
    gather(cells, frame, CellSums::of);
}

/// The noise map, as a kernel.
struct MapNoise<'a>(&'a mut CellStatistics);

impl Kernel for MapNoise<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.0.map_noise();
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
    fn a_clipped_area_is_known_with_its_border_and_a_clipped_star_is_none() {
        let mut cells = CellStatistics::default();
        cells.measure(
            &frame(160, 160, |x, y| if x < 40 || (x.abs_diff(120) < 8 && y.abs_diff(120) < 8) { 4095 } else { 1000 }),
            Some(4095),
        );
        assert!(cells.is_beside_clipped(0, 0) && cells.is_beside_clipped(47, 80));
        assert!(!cells.is_beside_clipped(48, 80) && !cells.is_beside_clipped(120, 120));
        cells.measure(&frame(160, 160, |x, _| 1000 + (x % 7) as u16), Some(4095));
        assert!(!cells.is_beside_clipped(0, 0));
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
