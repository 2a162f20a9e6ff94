//! The pictures that peaks are searched in: the frame with its hot pixels clipped, and the same halved again and again for wider
//! kernels.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the picture's own size")]

use super::measure::{HALF, SIDE, Samples, WIDTH};
use crate::image::{CELL_PX, CellStatistics, Frame};
use crate::sky::{Kernel, with_vectors};
use std::ops::Range;

/// A pixel this many times the local noise above all its neighbours is clipped for the search.
const SPIKE_SIGMAS: f32 = 3.0;

/// Samples around the middle of a patch that [`Picture::cut`] reads.
pub const MARGIN: usize = HALF + 2;

/// A picture in file order whose patches, and whose halves, can be had as numbers, ADU.
pub trait Picture {
    /// Columns.
    fn width(&self) -> usize;
    /// Rows.
    fn height(&self) -> usize;
    /// Row `y` of the halved picture: means of 2 × 2 samples.
    fn halve_row(&self, y: usize, scratch: &mut HalveScratch, out: &mut [f32]);
    /// Cuts the patch around a sample that is [`MARGIN`] or more away from every border.
    fn cut(&self, x: usize, y: usize, samples: &mut Samples);
    /// Cuts some lines of the patch, whose core may be clipped; the others stay as they are.
    fn cut_lines(&self, x: usize, y: usize, lines: Range<usize>, samples: &mut Samples);
}

/// A frame, every pixel that stands far above the highest of its eight neighbours clipped.
///
/// A lone hot pixel loses its height, and with it its place among the peaks; a star's highest pixel has neighbours nearly as high, so
/// that only bright stars lose a little. A patch has the whole height of what is shaped like a star.
pub struct Clipped<'a> {
    frame: &'a Frame,
    /// How far a pixel may stand above its neighbours, ADU: for each row of cells, column by column.
    excess: &'a [u16],
}

impl<'a> Clipped<'a> {
    /// The frame, with `excess` as [`Self::excess_of`] made it.
    pub fn new(frame: &'a Frame, excess: &'a [u16]) -> Self {
        Self { frame, excess }
    }

    /// How far pixels may stand above their neighbours, by the noise around them.
    pub fn excess_of(frame: &Frame, cells: &CellStatistics, excess: &mut Vec<u16>) {
        excess.clear();
        for row in 0..frame.height.div_ceil(CELL_PX) {
            let noise = cells.noise_row(row * CELL_PX);
            for x in (0..frame.width).step_by(CELL_PX) {
                let sigma = noise.get((x / CELL_PX).min(noise.len().max(1) - 1)).copied().unwrap_or(0.0);
                let limit = (SPIKE_SIGMAS * sigma).ceil().clamp(1.0, f32::from(u16::MAX)) as u16;
                excess.extend(std::iter::repeat_n(limit, CELL_PX.min(frame.width - x)));
            }
        }
    }

    #[inline(always)]
    fn row(&self, y: usize) -> &[u16] {
        &self.frame.pixels[y * self.frame.width..][..self.frame.width]
    }

    /// Row `y`, clipped; what lies on the border stays as it is.
    #[inline(always)]
    fn clip_row(&self, y: usize, beside: &mut [u16], highest: &mut [u16], out: &mut [u16]) {
        let (width, height) = (self.frame.width, self.frame.height);
        let here = self.row(y);
        if y == 0 || y + 1 == height || width < 3 {
            out.copy_from_slice(here);
            return;
        }
        // Of the rows above and below, and of all three: each is needed by three neighbours.
        let (above, below) = (self.row(y - 1), self.row(y + 1));
        let (beside, highest) = (&mut beside[..width], &mut highest[..width]);
        for x in 0..width {
            beside[x] = above[x].max(below[x]);
            highest[x] = beside[x].max(here[x]);
        }
        (out[0], out[width - 1]) = (here[0], here[width - 1]);
        let n = width - 2;
        let excess = &self.excess[y / CELL_PX * width + 1..][..n];
        let (left, right) = (&highest[..n], &highest[2..][..n]);
        let (beside, here, out) = (&beside[1..][..n], &here[1..][..n], &mut out[1..][..n]);
        for x in 0..n {
            let neighbours = left[x].max(right[x]).max(beside[x]);
            out[x] = here[x].min(neighbours.saturating_add(excess[x]));
        }
    }
}

/// The memory of [`Picture::halve_row`].
#[derive(Debug, Clone, Default)]
pub struct HalveScratch {
    /// The higher one of the pixels above and below.
    beside: Vec<u16>,
    /// The highest one of these and the pixel between them.
    highest: Vec<u16>,
    /// Two rows, clipped.
    clipped: [Vec<u16>; 2],
}

impl Picture for Clipped<'_> {
    #[inline(always)]
    fn width(&self) -> usize {
        self.frame.width
    }

    #[inline(always)]
    fn height(&self) -> usize {
        self.frame.height
    }

    #[inline(always)]
    fn halve_row(&self, y: usize, scratch: &mut HalveScratch, out: &mut [f32]) {
        let HalveScratch { beside, highest, clipped } = scratch;
        for row in [&mut *beside, &mut *highest].into_iter().chain(&mut *clipped) {
            row.resize(self.frame.width, 0);
        }
        for (line, out) in clipped.iter_mut().enumerate() {
            self.clip_row(2 * y + line, beside, highest, out);
        }
        add_pairs(&clipped[0], &clipped[1], out);
    }

    #[inline(always)]
    fn cut_lines(&self, x: usize, y: usize, lines: Range<usize>, samples: &mut Samples) {
        let excess = self.excess[y / CELL_PX * self.frame.width + x];
        for j in lines {
            let (y, x) = (y + j - HALF, x - HALF - 1);
            let (above, here, below) = (self.row(y - 1), self.row(y), self.row(y + 1));
            clip([&above[x..][..WIDTH + 2], &here[x..][..WIDTH + 2], &below[x..][..WIDTH + 2]], excess, &mut samples[j]);
            samples[j][WIDTH - 1] = 0.0;
        }
    }

    #[inline(always)]
    fn cut(&self, x: usize, y: usize, samples: &mut Samples) {
        self.cut_lines(x, y, 0..SIDE, samples);
        restore_core(samples, |j| {
            let row = &self.row(y + j - HALF)[x - CORE..][..2 * CORE + 1];
            std::array::from_fn(|i| f32::from(row[i]))
        });
    }
}

/// The middle one of three rows without its ends, clipped.
#[inline(always)]
fn clip(rows: [&[u16]; 3], excess: u16, out: &mut [f32; WIDTH]) {
    let at = |row: usize, shift: usize| rows[row][shift..].first_chunk::<WIDTH>().unwrap_or(&[0; WIDTH]);
    let (a0, a1, a2) = (at(0, 0), at(0, 1), at(0, 2));
    let (h0, h1, h2) = (at(1, 0), at(1, 1), at(1, 2));
    let (b0, b1, b2) = (at(2, 0), at(2, 1), at(2, 2));
    for x in 0..WIDTH {
        let rows = a0[x].max(a1[x]).max(a2[x]).max(b0[x]).max(b1[x].max(b2[x]));
        let highest = rows.max(h0[x].max(h2[x]));
        out[x] = f32::from(h1[x].min(highest.saturating_add(excess)));
    }
}

/// Half the side of what is looked at for the core of a star, px.
const CORE: usize = 3;

/// Puts back the true height of a star's core from the unclipped picture, and leaves out what is a lone hot pixel.
///
/// A star's four nearest neighbours stand above its four corners nearly half as much as it stands above them; a hot pixel's do not.
#[inline(always)]
fn restore_core(samples: &mut Samples, raw: impl Fn(usize) -> [f32; 2 * CORE + 1]) {
    /// The steepness of a star.
    const STAR_STEEPNESS: f32 = 3.0;
    for j in HALF - CORE..=HALF + CORE {
        // Hardly any row has a clipped pixel: that is seen for all its pixels at once.
        let raw = raw(j);
        let mut clipped = false;
        for i in 0..=2 * CORE {
            clipped |= raw[i] > samples[j][HALF - CORE + i];
        }
        for i in (HALF - CORE..=HALF + CORE).filter(|_| clipped) {
            let raw = raw[i + CORE - HALF];
            if raw > samples[j][i] {
                let s = &*samples;
                let sides = 0.25 * (s[j - 1][i] + s[j + 1][i] + s[j][i - 1] + s[j][i + 1]);
                let corners = 0.25 * (s[j - 1][i - 1] + s[j - 1][i + 1] + s[j + 1][i - 1] + s[j + 1][i + 1]);
                if raw - sides < STAR_STEEPNESS * (sides - corners) {
                    samples[j][i] = raw;
                }
            }
        }
    }
}

/// A picture of its own, ADU.
#[derive(Debug, Clone, Default)]
pub struct Plane {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples in file order.
    pub pixels: Vec<f32>,
}

impl Plane {
    /// One row.
    #[inline(always)]
    pub fn row(&self, y: usize) -> &[f32] {
        &self.pixels[y * self.width..][..self.width]
    }
}

impl Picture for Plane {
    #[inline(always)]
    fn width(&self) -> usize {
        self.width
    }

    #[inline(always)]
    fn height(&self) -> usize {
        self.height
    }

    #[inline(always)]
    fn halve_row(&self, y: usize, _: &mut HalveScratch, out: &mut [f32]) {
        let (top, bottom) = (self.row(2 * y), self.row(2 * y + 1));
        let n = out.len();
        let (top, bottom) = (&top[..2 * n], &bottom[..2 * n]);
        for x in 0..n {
            out[x] = 0.25 * ((top[2 * x] + bottom[2 * x]) + (top[2 * x + 1] + bottom[2 * x + 1]));
        }
    }

    #[inline(always)]
    fn cut(&self, x: usize, y: usize, samples: &mut Samples) {
        self.cut_lines(x, y, 0..SIDE, samples);
    }

    #[inline(always)]
    fn cut_lines(&self, x: usize, y: usize, lines: Range<usize>, samples: &mut Samples) {
        for j in lines {
            samples[j][..SIDE].copy_from_slice(&self.row(y + j - HALF)[x - HALF..][..SIDE]);
            samples[j][WIDTH - 1] = 0.0;
        }
    }
}

/// Means of 2 × 2 samples; an odd last row or column is left out.
pub fn halve<P: Picture>(from: &P, scratch: &mut HalveScratch, out: &mut Plane) {
    with_vectors(Halve { from, scratch, out });
}

struct Halve<'a, P> {
    from: &'a P,
    scratch: &'a mut HalveScratch,
    out: &'a mut Plane,
}

impl<P: Picture> Kernel for Halve<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Halve { from, scratch, out } = self;
        (out.width, out.height) = (from.width() / 2, from.height() / 2);
        out.pixels.resize(out.width * out.height, 0.0);
        for (y, out) in out.pixels.chunks_exact_mut(out.width.max(1)).enumerate() {
            from.halve_row(y, scratch, out);
        }
    }
}

/// Means of pairs of pixels in two rows. Two pixels make one number of 32 bits, whose halves add up faster than pixels that would first
/// have to be sorted into even and odd ones.
#[inline(always)]
fn add_pairs(top: &[u16], bottom: &[u16], out: &mut [f32]) {
    let n = out.len();
    let (top, bottom) = (&top.as_chunks::<2>().0[..n], &bottom.as_chunks::<2>().0[..n]);
    let both = |pair: [u16; 2]| u32::from(pair[0]) | u32::from(pair[1]) << 16;
    let sum = |pair: u32| (pair & 0xffff) + (pair >> 16);
    for x in 0..n {
        let four = sum(both(top[x])).wrapping_add(sum(both(bottom[x])));
        out[x] = 0.25 * four as i32 as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::RowOrder;

    #[test]
    fn a_hot_pixel_is_clipped_and_a_star_is_not() {
        let mut pixels = vec![100u16; 20 * 10];
        pixels[3 * 20 + 4] = 5000;
        for (x, y, v) in [(12, 5, 400), (11, 5, 300), (13, 5, 310), (12, 4, 290), (12, 6, 305)] {
            pixels[y * 20 + x] = v;
        }
        let frame = Frame::new(20, 10, pixels, RowOrder::BottomFirst).unwrap();
        let excess = vec![90; 20];
        let picture = Clipped::new(&frame, &excess);
        let mut rows = [vec![0; 20], vec![0; 20], vec![0; 20]];
        let [beside, highest, row] = &mut rows;
        picture.clip_row(3, beside, highest, row);
        assert_eq!((row[4], row[5]), (190, 100));
        picture.clip_row(5, beside, highest, row);
        assert_eq!(row[12], 400);
        let mut half = Plane::default();
        halve(&picture, &mut HalveScratch::default(), &mut half);
        assert_eq!((half.row(1)[2], half.row(2)[6]), (0.25 * 490.0, 0.25 * (290.0 + 400.0 + 100.0 + 310.0)));
    }

    #[test]
    fn every_pixel_is_clipped_by_its_own_neighbours_whatever_the_width() {
        for (width, height) in [(2, 2), (3, 4), (35, 6), (36, 7), (67, 6), (70, 40), (131, 5)] {
            let value = |n: usize| (n.wrapping_mul(2_654_435_761) >> 7) % 900;
            let frame =
                Frame::new(width, height, (0..width * height).map(|n| value(n) as u16).collect(), RowOrder::TopFirst).unwrap();
            let excess: Vec<u16> = (0..width * height.div_ceil(CELL_PX)).map(|n| value(n + 7) as u16 / 9).collect();
            let pixel = |x: usize, y: usize| frame.pixels[y * width + x];
            let clipped = |x: usize, y: usize| {
                if x == 0 || y == 0 || x + 1 == width || y + 1 == height {
                    return pixel(x, y);
                }
                let around = (y - 1..y + 2).flat_map(|j| (x - 1..x + 2).map(move |i| (i, j))).filter(|place| *place != (x, y));
                let highest = around.map(|(i, j)| pixel(i, j)).max().unwrap();
                pixel(x, y).min(highest + excess[y / CELL_PX * width + x])
            };
            let mut half = Plane::default();
            halve(&Clipped::new(&frame, &excess), &mut HalveScratch::default(), &mut half);
            for y in 0..height / 2 {
                for x in 0..width / 2 {
                    let four = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(i, j)| f32::from(clipped(2 * x + i, 2 * y + j)));
                    assert_eq!(half.row(y)[x], 0.25 * four.iter().sum::<f32>(), "{width} × {height}, ({x}, {y})");
                }
            }
        }
    }

    #[test]
    fn a_patch_has_the_whole_star_and_no_hot_pixel() {
        let mut pixels = vec![100u16; 40 * 40];
        pixels[24 * 40 + 24] = 5000;
        for (x, y, v) in [(20, 20, 900), (19, 20, 500), (21, 20, 500), (20, 19, 500), (20, 21, 500)] {
            pixels[y * 40 + x] = v;
        }
        for (x, y) in [(19, 19), (21, 19), (19, 21), (21, 21)] {
            pixels[y * 40 + x] = 300;
        }
        let frame = Frame::new(40, 40, pixels, RowOrder::BottomFirst).unwrap();
        let excess = vec![30; 3 * 40];
        let mut samples = [[0.0; WIDTH]; SIDE];
        Clipped::new(&frame, &excess).cut(20, 20, &mut samples);
        assert_eq!((samples[HALF][HALF], samples[HALF][HALF - 1], samples[0][0]), (900.0, 500.0, 100.0));
        assert_eq!(samples[HALF + 4][HALF + 4], 130.0);
    }

    #[test]
    fn halving_takes_means_and_drops_an_odd_edge() {
        let plane = Plane { width: 5, height: 3, pixels: (0..15u8).map(f32::from).collect() };
        let mut out = Plane::default();
        halve(&plane, &mut HalveScratch::default(), &mut out);
        assert_eq!((out.width, out.height), (2, 1));
        assert_eq!(out.pixels, vec![3.0, 5.0]);
    }
}
