//! The picture that peaks are searched in: hot pixels clipped, and halved again and again for wider kernels.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the plane's own size")]

use crate::sky::{Kernel, with_vectors};

/// A sample of a plane.
pub trait Sample: Copy {
    /// Its value, ADU.
    fn value(self) -> f32;
}

impl Sample for u16 {
    #[inline(always)]
    fn value(self) -> f32 {
        f32::from(self)
    }
}

impl Sample for f32 {
    #[inline(always)]
    fn value(self) -> f32 {
        self
    }
}

/// A picture in file order.
#[derive(Debug, Clone, Default)]
pub struct Plane<T> {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples, ADU.
    pub pixels: Vec<T>,
}

impl<T: Copy> Plane<T> {
    /// One row.
    #[inline(always)]
    pub fn row(&self, y: usize) -> &[T] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }
}

/// Copies a picture and clips every pixel that stands more than `excess` ADU above the highest of its eight neighbours.
///
/// A lone hot pixel loses its height, and with it its place among the peaks; a star's highest pixel has neighbours nearly as
/// high, so that only bright stars lose a little, here, where nothing is measured.
pub fn clip_spikes(pixels: &[u16], width: usize, height: usize, excess: u16, out: &mut Plane<u16>) {
    out.width = width;
    out.height = height;
    out.pixels.clear();
    out.pixels.extend_from_slice(pixels);
    if width >= 3 && height >= 3 {
        with_vectors(Clip { pixels, excess, out });
    }
}

struct Clip<'a> {
    pixels: &'a [u16],
    excess: u16,
    out: &'a mut Plane<u16>,
}

impl Kernel for Clip<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Clip { pixels, excess, out } = self;
        let (width, height) = (out.width, out.height);
        for y in 1..height - 1 {
            let above = &pixels[(y - 1) * width..y * width];
            let here = &pixels[y * width..(y + 1) * width];
            let below = &pixels[(y + 1) * width..(y + 2) * width];
            let target = &mut out.pixels[y * width + 1..(y + 1) * width - 1];
            let n = width - 2;
            let (a0, a1, a2) = (&above[..n], &above[1..n + 1], &above[2..n + 2]);
            let (h0, h1, h2) = (&here[..n], &here[1..n + 1], &here[2..n + 2]);
            let (b0, b1, b2) = (&below[..n], &below[1..n + 1], &below[2..n + 2]);
            for x in 0..n {
                let rows = a0[x].max(a1[x]).max(a2[x]).max(b0[x]).max(b1[x].max(b2[x]));
                let highest = rows.max(h0[x].max(h2[x]));
                target[x] = h1[x].min(highest.saturating_add(excess));
            }
        }
    }
}

/// Means of 2 × 2 samples; an odd last row or column is left out.
pub fn halve<T: Sample>(from: &Plane<T>, out: &mut Plane<f32>) {
    with_vectors(Halve { from, out });
}

struct Halve<'a, T> {
    from: &'a Plane<T>,
    out: &'a mut Plane<f32>,
}

impl<T: Sample> Kernel for Halve<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Halve { from, out } = self;
        out.width = from.width / 2;
        out.height = from.height / 2;
        out.pixels.clear();
        for y in 0..out.height {
            let top = from.row(2 * y).chunks_exact(2);
            let bottom = from.row(2 * y + 1).chunks_exact(2);
            out.pixels
                .extend(top.zip(bottom).map(|(t, b)| 0.25 * ((t[0].value() + t[1].value()) + (b[0].value() + b[1].value()))));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hot_pixel_is_clipped_and_a_star_is_not() {
        let mut pixels = vec![100u16; 20 * 10];
        pixels[3 * 20 + 4] = 5000;
        for (x, y, v) in [(12, 5, 400), (11, 5, 300), (13, 5, 310), (12, 4, 290), (12, 6, 305)] {
            pixels[y * 20 + x] = v;
        }
        let mut out = Plane::default();
        clip_spikes(&pixels, 20, 10, 90, &mut out);
        assert_eq!(out.row(3)[4], 190);
        assert_eq!(out.row(5)[12], 400);
    }

    #[test]
    fn halving_takes_means_and_drops_an_odd_edge() {
        let plane = Plane { width: 5, height: 3, pixels: (0..15u16).collect() };
        let mut out = Plane::default();
        halve(&plane, &mut out);
        assert_eq!((out.width, out.height), (2, 1));
        assert_eq!(out.pixels, vec![3.0, 5.0]);
    }
}
