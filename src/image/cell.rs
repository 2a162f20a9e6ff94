//! Sums over the pixels of one cell of 16 × 16, from which its mean and its noise are made.
//!
//! Values that lie near each other, as those of sky do, are summed in whole numbers of 16 bits, two products an instruction where the
//! processor has AVX2; those of the few other cells (stars, borders of a glare) as floating-point numbers. Which it is depends on the
//! values alone, so that every processor has the same statistics.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a cell lies within the lines that it is cut from")]

use super::CELL_PX;

/// The lines of a row of cells.
pub(super) type Lines<'a> = [&'a [u16]; CELL_PX];

/// Sums over a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CellSums {
    /// Mean, ADU.
    pub mean: f32,
    /// Variance of the pixels, ADU².
    pub variance: f32,
    /// Variance of a pixel as the differences of each and the one a row before tell it, ADU².
    pub step_variance: f32,
    /// Highest value, ADU.
    pub max: u16,
}

/// Pixels of a cell, and differences of rows in it.
const PIXELS: f32 = (CELL_PX * CELL_PX) as f32;
const STEPS: f32 = (CELL_PX * (CELL_PX - 1)) as f32;
/// Values that differ by no more than this are summed in whole numbers: the squares of 32 such differences fit 31 bits.
const NARROW: u16 = 8191;

impl CellSums {
    /// Of the cell whose first column is `x`.
    #[inline(always)]
    pub fn of(lines: &Lines<'_>, x: usize) -> Self {
        let narrow = Whole::of(lines, x);
        if narrow.is_narrow() { narrow.sums() } else { wide(lines, x) }
    }

    /// As [`Self::of`], on a processor that has AVX2.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    #[inline]
    pub fn of_avx2(lines: &Lines<'_>, x: usize) -> Self {
        let narrow = Whole::of_avx2(lines, x);
        if narrow.is_narrow() { narrow.sums() } else { wide(lines, x) }
    }
}

/// Sums in whole numbers, of differences from the first pixel; they mean something where the cell is narrow.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Whole {
    first: u16,
    min: u16,
    max: u16,
    sum: i32,
    squares: i64,
    /// Of each pixel and the one a row before.
    step_squares: i64,
    /// The last row less the first.
    steps: i32,
}

impl Whole {
    #[inline(always)]
    fn of(lines: &Lines<'_>, x: usize) -> Self {
        let first = lines[0][x];
        let mut sums = Self { first, min: u16::MAX, ..Self::default() };
        let mut before = row(lines, 0, x);
        let top = before;
        for y in 0..CELL_PX {
            let here = row(lines, y, x);
            for i in 0..CELL_PX {
                let difference = i32::from(here[i].wrapping_sub(first) as i16);
                let step = i32::from(here[i].wrapping_sub(before[i]) as i16);
                sums.sum += difference;
                sums.squares += i64::from(difference * difference);
                sums.step_squares += i64::from(step * step);
                sums.min = sums.min.min(here[i]);
                sums.max = sums.max.max(here[i]);
            }
            before = here;
        }
        sums.steps = before.iter().zip(&top).map(|(last, first)| i32::from(*last) - i32::from(*first)).sum();
        sums
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    #[inline]
    fn of_avx2(lines: &Lines<'_>, x: usize) -> Self {
        use bytemuck::cast;
        use std::arch::x86_64::{
            __m256i, _mm256_add_epi32, _mm256_madd_epi16, _mm256_max_epu16, _mm256_min_epu16, _mm256_set1_epi16,
            _mm256_setzero_si256, _mm256_sub_epi16,
        };
        let line = |y: usize| -> __m256i { cast(row(lines, y, x)) };
        let (first, ones) = (_mm256_set1_epi16(lines[0][x] as i16), _mm256_set1_epi16(1));
        let (mut sum, mut squares, mut step_squares) = (_mm256_setzero_si256(), _mm256_setzero_si256(), _mm256_setzero_si256());
        let top = line(0);
        let (mut before, mut min, mut max) = (top, top, top);
        for y in 0..CELL_PX {
            let here = line(y);
            let (difference, step) = (_mm256_sub_epi16(here, first), _mm256_sub_epi16(here, before));
            sum = _mm256_add_epi32(sum, _mm256_madd_epi16(difference, ones));
            squares = _mm256_add_epi32(squares, _mm256_madd_epi16(difference, difference));
            step_squares = _mm256_add_epi32(step_squares, _mm256_madd_epi16(step, step));
            (min, max) = (_mm256_min_epu16(min, here), _mm256_max_epu16(max, here));
            before = here;
        }
        let steps = _mm256_madd_epi16(_mm256_sub_epi16(before, top), ones);
        let lanes = |v: __m256i| cast::<_, [i32; CELL_PX / 2]>(v);
        let whole = |v: __m256i| lanes(v).into_iter().fold(0, i32::wrapping_add);
        let long = |v: __m256i| lanes(v).into_iter().map(i64::from).sum();
        Self {
            first: lines[0][x],
            min: cast::<_, [u16; CELL_PX]>(min).into_iter().fold(u16::MAX, u16::min),
            max: cast::<_, [u16; CELL_PX]>(max).into_iter().fold(0, u16::max),
            sum: whole(sum),
            squares: long(squares),
            step_squares: long(step_squares),
            steps: whole(steps),
        }
    }

    #[inline(always)]
    fn is_narrow(&self) -> bool {
        self.max - self.min <= NARROW
    }

    #[inline(always)]
    fn sums(&self) -> CellSums {
        // Whole numbers up to the last step: n times the squares less the square of the sum is n (n − 1) times the variance.
        let spread = |n: i64, squares: i64, sum: i32| (n * squares - i64::from(sum) * i64::from(sum)) as f32;
        CellSums {
            mean: f32::from(self.first) + self.sum as f32 * (1.0 / PIXELS),
            variance: spread(PIXELS as i64, self.squares, self.sum) * (1.0 / (PIXELS * (PIXELS - 1.0))),
            // A difference has twice the variance of a pixel; a slope gives all differences a mean, which is taken off.
            step_variance: spread(STEPS as i64, self.step_squares, self.steps) * (0.5 / (STEPS * (STEPS - 1.0))),
            max: self.max,
        }
    }
}

/// Sums as floating-point numbers, relative to the first pixel: they stay small, so that single precision keeps the variance's digits.
#[inline(always)]
fn wide(lines: &Lines<'_>, x: usize) -> CellSums {
    let first = f32::from(lines[0][x]);
    let (mut sum, mut squares, mut step_squares) = ([0f32; CELL_PX], [0f32; CELL_PX], [0f32; CELL_PX]);
    let top = row(lines, 0, x);
    let (mut before, mut max) = (top, top);
    for y in 0..CELL_PX {
        let here = row(lines, y, x);
        for i in 0..CELL_PX {
            let (d, step) = (f32::from(here[i]) - first, f32::from(here[i]) - f32::from(before[i]));
            sum[i] += d;
            squares[i] += d * d;
            step_squares[i] += step * step;
            max[i] = max[i].max(here[i]);
        }
        before = here;
    }
    let steps: [f32; CELL_PX] = std::array::from_fn(|i| f32::from(before[i]) - f32::from(top[i]));
    let spread = |n: f32, squares: f32, sum: f32| (squares - sum * sum * (1.0 / n)).max(0.0) * (1.0 / (n - 1.0));
    CellSums {
        mean: first + total(&sum) * (1.0 / PIXELS),
        variance: spread(PIXELS, total(&squares), total(&sum)),
        step_variance: 0.5 * spread(STEPS, total(&step_squares), total(&steps)),
        max: max.into_iter().fold(0, u16::max),
    }
}

#[inline(always)]
fn row(lines: &Lines<'_>, y: usize, x: usize) -> [u16; CELL_PX] {
    lines[y][x..].first_chunk().copied().unwrap_or([0; CELL_PX])
}

/// The sum of sixteen numbers, always in the same order.
#[inline(always)]
fn total(values: &[f32; CELL_PX]) -> f32 {
    let mut eight = [0f32; CELL_PX / 2];
    for k in 0..CELL_PX / 2 {
        eight[k] = values[k] + values[k + CELL_PX / 2];
    }
    ((eight[0] + eight[4]) + (eight[1] + eight[5])) + ((eight[2] + eight[6]) + (eight[3] + eight[7]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    /// Cells of values between two limits.
    fn cells(low: u16, high: u16) -> Vec<Vec<[u16; CELL_PX]>> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(u64::from(low) << 16 | u64::from(high));
        let mut row = || std::array::from_fn(|_| random.random_range(low..=high));
        (0..40).map(|_| (0..CELL_PX).map(|_| row()).collect()).collect()
    }

    fn lines(cell: &[[u16; CELL_PX]]) -> Lines<'_> {
        std::array::from_fn(|y| &cell[y][..])
    }

    const RANGES: [(u16, u16); 6] =
        [(1400, 1460), (0, 0), (0, NARROW), (57_000, 57_000 + NARROW), (0, u16::MAX), (65_535, 65_535)];

    #[test]
    fn the_sums_are_those_of_the_definition() {
        for (low, high) in RANGES {
            for cell in cells(low, high) {
                let got = CellSums::of(&lines(&cell), 0);
                let values: Vec<f64> = cell.iter().flatten().map(|&v| f64::from(v)).collect();
                let mean = values.iter().sum::<f64>() / 256.0;
                let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 255.0;
                let steps: Vec<f64> = values.iter().skip(CELL_PX).zip(&values).map(|(v, before)| v - before).collect();
                let step = steps.iter().sum::<f64>() / 240.0;
                let step_variance = steps.iter().map(|s| (s - step).powi(2)).sum::<f64>() / 239.0 / 2.0;
                let close = |got: f32, wanted: f64| (f64::from(got) - wanted).abs() <= 1e-5 * wanted.max(1e-3);
                assert!(close(got.mean, mean) && close(got.variance, variance) && close(got.step_variance, step_variance));
                assert_eq!(got.max, cell.iter().flatten().copied().max().unwrap());
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[test]
    fn every_processor_has_the_same_sums() {
        if !std::arch::is_x86_feature_detected!("avx2") {
            println!("SKIPPED: every_processor_has_the_same_sums: this processor has no AVX2");
            return;
        }
        for (low, high) in RANGES {
            for cell in cells(low, high) {
                #[allow(unsafe_code, reason = "code compiled for AVX2 is called where the processor has it")]
                // SAFETY: the processor was just found to have AVX2.
                let vectors = unsafe { CellSums::of_avx2(&lines(&cell), 0) };
                assert_eq!(vectors, CellSums::of(&lines(&cell), 0));
            }
        }
    }
}
