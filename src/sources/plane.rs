//! The pictures that peaks are searched in: the frame with its hot pixels clipped, and the same halved again and again for wider
//! kernels.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the picture's own size")]

use super::measure::{HALF, Samples, WIDTH};
use crate::image::{CELL_PX, CellStatistics, Frame};
use crate::sky::{Kernel, with_vectors};

/// A pixel this many times the local noise above all its neighbours is clipped for the search.
const SPIKE_SIGMAS: f32 = 3.0;

/// Samples around the middle of a patch that [`Picture::cut`] reads.
pub const MARGIN: usize = HALF + 2;

/// A picture in file order whose rows and patches can be had as numbers, ADU.
pub trait Picture {
    /// Columns.
    fn width(&self) -> usize;
    /// Rows.
    fn height(&self) -> usize;
    /// Row `y`, into a buffer of that width.
    fn load(&self, y: usize, out: &mut [f32]);
    /// The patch around a sample that is [`MARGIN`] or more away from every border.
    fn cut(&self, x: usize, y: usize) -> Samples;
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
    fn load(&self, y: usize, out: &mut [f32]) {
        let (width, height) = (self.frame.width, self.frame.height);
        let here = self.row(y);
        if y == 0 || y + 1 == height || width < 3 {
            out.iter_mut().zip(here).for_each(|(out, &pixel)| *out = f32::from(pixel));
            return;
        }
        (out[0], out[width - 1]) = (f32::from(here[0]), f32::from(here[width - 1]));
        let excess = &self.excess[y / CELL_PX * width + 1..][..width - 2];
        clip([self.row(y - 1), here, self.row(y + 1)], excess, &mut out[1..width - 1]);
    }

    #[inline(always)]
    fn cut(&self, x: usize, y: usize) -> Samples {
        let mut samples = [[0f32; WIDTH]; 2 * HALF + 1];
        let excess = [self.excess[y / CELL_PX * self.frame.width + x]; WIDTH];
        for (j, out) in samples.iter_mut().enumerate() {
            let rows = [0, 1, 2].map(|k| &self.row(y + j + k - HALF - 1)[x - HALF - 1..][..WIDTH + 2]);
            clip(rows, &excess, out);
            out[WIDTH - 1] = 0.0;
        }
        restore_core(&mut samples, |i, j| f32::from(self.row(y + j - HALF)[x + i - HALF]));
        samples
    }
}

/// The middle one of three rows without its ends, clipped.
#[inline(always)]
fn clip(rows: [&[u16]; 3], excess: &[u16], out: &mut [f32]) {
    let n = out.len();
    let at = |row: usize, shift: usize| &rows[row][shift..][..n];
    let (a0, a1, a2) = (at(0, 0), at(0, 1), at(0, 2));
    let (h0, h1, h2) = (at(1, 0), at(1, 1), at(1, 2));
    let (b0, b1, b2) = (at(2, 0), at(2, 1), at(2, 2));
    let excess = &excess[..n];
    for x in 0..n {
        let rows = a0[x].max(a1[x]).max(a2[x]).max(b0[x]).max(b1[x].max(b2[x]));
        let highest = rows.max(h0[x].max(h2[x]));
        out[x] = f32::from(h1[x].min(highest.saturating_add(excess[x])));
    }
}

/// Puts back the true height of a star's core from the unclipped picture, and leaves out what is a lone hot pixel.
///
/// A star's four nearest neighbours stand above its four corners nearly half as much as it stands above them; a hot pixel's do not.
#[inline(always)]
fn restore_core(samples: &mut Samples, raw: impl Fn(usize, usize) -> f32) {
    /// Half the side of what is looked at, px, and the steepness of a star.
    const CORE: usize = 3;
    const STAR_STEEPNESS: f32 = 3.0;
    for j in HALF - CORE..=HALF + CORE {
        for i in HALF - CORE..=HALF + CORE {
            let raw = raw(i, j);
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
    fn load(&self, y: usize, out: &mut [f32]) {
        out.copy_from_slice(self.row(y));
    }

    #[inline(always)]
    fn cut(&self, x: usize, y: usize) -> Samples {
        const SIDE: usize = 2 * HALF + 1;
        let mut samples = [[0f32; WIDTH]; SIDE];
        for (j, out) in samples.iter_mut().enumerate() {
            out[..SIDE].copy_from_slice(&self.row(y + j - HALF)[x - HALF..][..SIDE]);
        }
        samples
    }
}

/// Means of 2 × 2 samples; an odd last row or column is left out.
pub fn halve<P: Picture>(from: &P, out: &mut Plane) {
    with_vectors(Halve { from, out });
}

struct Halve<'a, P> {
    from: &'a P,
    out: &'a mut Plane,
}

impl<P: Picture> Kernel for Halve<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Halve { from, out } = self;
        (out.width, out.height) = (from.width() / 2, from.height() / 2);
        out.pixels.resize(out.width * out.height, 0.0);
        let mut rows = [vec![0f32; from.width()], vec![0f32; from.width()]];
        for (y, out) in out.pixels.chunks_exact_mut(out.width.max(1)).enumerate() {
            from.load(2 * y, &mut rows[0]);
            from.load(2 * y + 1, &mut rows[1]);
            add_pairs(&rows[0], &rows[1], out);
        }
    }
}

#[inline(always)]
fn add_pairs(top: &[f32], bottom: &[f32], out: &mut [f32]) {
    let n = out.len();
    let (top, bottom) = (&top[..2 * n], &bottom[..2 * n]);
    for x in 0..n {
        out[x] = 0.25 * ((top[2 * x] + bottom[2 * x]) + (top[2 * x + 1] + bottom[2 * x + 1]));
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
        let mut row = vec![0.0; 20];
        picture.load(3, &mut row);
        assert_eq!((row[4], row[5]), (190.0, 100.0));
        picture.load(5, &mut row);
        assert_eq!(row[12], 400.0);
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
        let samples = Clipped::new(&frame, &excess).cut(20, 20);
        assert_eq!((samples[HALF][HALF], samples[HALF][HALF - 1], samples[0][0]), (900.0, 500.0, 100.0));
        assert_eq!(samples[HALF + 4][HALF + 4], 130.0);
    }

    #[test]
    fn halving_takes_means_and_drops_an_odd_edge() {
        let plane = Plane { width: 5, height: 3, pixels: (0..15u8).map(f32::from).collect() };
        let mut out = Plane::default();
        halve(&plane, &mut out);
        assert_eq!((out.width, out.height), (2, 1));
        assert_eq!(out.pixels, vec![3.0, 5.0]);
    }
}
