//! A bitmap of the sky: is there a verification star near this direction? One memory access per question.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a cell's number is below the size by construction")]

use super::cache::{FieldFileError, Loader, Saver, sane};
use super::pages::in_large_pages;
use super::{FieldStars, Pace};
use crate::sky::Vec3;
use std::io;

/// Six faces of a cube of `side` × `side` bits; a bit is set where a star may be within the tolerance.
#[derive(Debug, Clone)]
pub struct SkyBitmap {
    side: usize,
    words: Vec<u64>,
}

/// Points that are asked for at once, at most; and how many go into a vector.
pub const POINTS: usize = 32;
const LANES: usize = 8;
/// Most bits along a face: a bitmap of 7 MB stays in a small computer's cache (trials: 3072 beats 4096).
const MAX_SIDE: f64 = 3072.0;

impl SkyBitmap {
    /// Sets the discs of `tolerance` rad around the verification stars of a field; `None` where the pace ends it.
    pub fn build(field: &FieldStars, rank_limit: u8, tolerance: f64, pace: &mut Pace<'_>) -> Option<Self> {
        let mut bitmap = Self::empty(tolerance);
        for star in field.stars.iter().filter(|s| s.rank < rank_limit) {
            pace.step(1)?;
            let d = star.direction;
            let e1 = d.cross(&if d.z.abs() < 0.9 { Vec3::z() } else { Vec3::x() }).normalize();
            let e2 = d.cross(&e1);
            for i in [-tolerance, 0.0, tolerance] {
                for j in [-tolerance, 0.0, tolerance] {
                    let cell = bitmap.cell(&(d + e1 * i + e2 * j));
                    bitmap.words[cell / 64] |= 1 << (cell % 64);
                }
            }
        }
        Some(bitmap)
    }

    /// A sky without stars.
    fn empty(tolerance: f64) -> Self {
        // Cells no smaller than the discs, so that the nine points above touch every cell that a disc does.
        let side = (std::f64::consts::FRAC_PI_2 / (1.5 * tolerance)).clamp(8.0, MAX_SIDE) as usize;
        let count = (6 * side * side).div_ceil(64);
        let mut words = in_large_pages(count);
        words.resize(count, 0);
        Self { side, words }
    }

    /// Writes the bits; the side follows from the tolerance.
    pub fn save(&self, saver: &mut Saver<'_>) -> io::Result<()> {
        saver.list(&self.words, |word| word.to_le_bytes())
    }

    /// Reads the bitmap of a tolerance, rad.
    pub fn load(loader: &mut Loader<'_>, tolerance: f64) -> Result<Self, FieldFileError> {
        let mut bitmap = Self::empty(tolerance);
        let words = loader.list(|bytes| u64::from_le_bytes(*bytes))?;
        sane("bits", words.len() == bitmap.words.len())?;
        bitmap.words = words;
        Ok(bitmap)
    }

    /// The cells of the first `count` points of a plane, lifted onto the sky, for [`Self::hits`].
    ///
    /// Point i lifts to `plane[0] + x[i] plane[1] + y[i] plane[2]`, of any length.
    #[inline(always)]
    pub fn cells(&self, plane: &[Vec3; 3], x: &[f32; POINTS], y: &[f32; POINTS], count: usize) -> [u32; POINTS] {
        let (face, axes) = face_of(&plane[0]);
        // The face's own axes: two along it, the third out of it.
        let [m, a, c] = plane.map(|v| [v[axes[0]] as f32, v[axes[1]] as f32, v[axes[2]] as f32]);
        let (half, side, first) = (0.5 * self.side as f32, self.side as u32, (face * self.side * self.side) as u32);
        // Half a cell lower, because whole numbers are made by rounding.
        let (offset, lowest, end) = (half - 0.5, -0.5, 2.0 * half - 0.5);
        let mut cells = [0u32; POINTS];
        let mut over = [0u32; LANES];
        let lanes = x.as_chunks::<LANES>().0.iter().zip(y.as_chunks::<LANES>().0);
        for (cells, (x, y)) in cells.as_chunks_mut::<LANES>().0.iter_mut().zip(lanes).take(count.div_ceil(LANES)) {
            for i in 0..LANES {
                let depth = half / (m[2] + x[i] * a[2] + y[i] * c[2]).abs();
                let u = (m[0] + x[i] * a[0] + y[i] * c[0]) * depth + offset;
                let v = (m[1] + x[i] * a[1] + y[i] * c[1]) * depth + offset;
                over[i] |= u32::from(!((u >= lowest) & (v >= lowest) & (u < end) & (v < end)));
                // No checks of overflow, which would keep it from being done in vectors: what is over the edge is done again below.
                cells[i] = whole(v).wrapping_mul(side).wrapping_add(whole(u)).wrapping_add(first);
            }
        }
        if over != [0; LANES] {
            // Over the face's edge: few fields have such points.
            for i in 0..count.min(POINTS) {
                cells[i] = self.cell(&(plane[0] + plane[1] * f64::from(x[i]) + plane[2] * f64::from(y[i]))) as u32;
            }
        }
        cells
    }

    /// In which of some cells a star may be within the tolerance: bit i for cell i.
    #[inline(always)]
    pub fn hits(&self, cells: &[u32]) -> u32 {
        let mut bits = 0;
        for (i, &cell) in cells.iter().enumerate().take(POINTS) {
            bits |= ((self.words[cell as usize / 64] >> (cell % 64) & 1) as u32) << i;
        }
        bits
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.words[..])
    }

    /// Number of the cell that a direction lies in.
    fn cell(&self, d: &Vec3) -> usize {
        let (face, [u, v, out]) = face_of(d);
        let half = 0.5 * self.side as f64;
        let at = |w: f64| ((w / d[out].abs() * half + half) as usize).min(self.side - 1);
        (face * self.side + at(d[v])) * self.side + at(d[u])
    }
}

/// The nearest whole number to one between −½ and four million, in an operation that vectors have.
#[inline(always)]
fn whole(value: f32) -> u32 {
    /// In the middle of the numbers whose last place counts ones: 3 · 2²². Its own mantissa is the bit above those that are kept.
    const ONES: f32 = 12_582_912.0;
    (value + ONES).to_bits() & 0x3f_ffff
}

/// The face of the cube that a direction goes through: its number, and which components run along it (two) and out of it.
#[inline(always)]
fn face_of(d: &Vec3) -> (usize, [usize; 3]) {
    let (ax, ay, az) = (d.x.abs(), d.y.abs(), d.z.abs());
    if az >= ax && az >= ay {
        (usize::from(d.z < 0.0), [0, 1, 2])
    } else if ax >= ay {
        (2 + usize::from(d.x < 0.0), [1, 2, 0])
    } else {
        (4 + usize::from(d.y < 0.0), [2, 0, 1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::direction;

    fn bitmap() -> SkyBitmap {
        let side = 512;
        let mut bitmap = SkyBitmap { side, words: vec![0; 6 * side * side / 64] };
        // A spiral of stars over the sphere.
        for i in 0..3000 {
            let cell = bitmap.cell(&spiral(i));
            bitmap.words[cell / 64] |= 1 << (cell % 64);
        }
        bitmap
    }

    fn spiral(i: usize) -> Vec3 {
        direction(i as f64 * 2.399_963, ((i as f64 + 0.5) / 3000.0 * 2.0 - 1.0).asin())
    }

    #[test]
    fn points_hit_where_stars_are_on_every_face_and_over_its_edges() {
        let bitmap = bitmap();
        for i in 0..3000 {
            let star = spiral(i);
            let along = star.cross(&Vec3::new(0.3, 0.5, -0.8)).normalize();
            let across = star.cross(&along);
            for shift in [0.0f32, 0.02, -0.3] {
                let middle = star - along * f64::from(shift);
                let mut x = [0.0; POINTS];
                (x[3], x[17]) = (shift, shift);
                let hits = bitmap.hits(&bitmap.cells(&[middle, along, across], &x, &[0.0; POINTS], 18)[..18]);
                assert_eq!((hits >> 3 & 1, hits >> 17), (1, 1), "star {i}, shift {shift}");
            }
        }
    }

    #[test]
    fn most_of_the_sky_is_empty() {
        let bitmap = bitmap();
        let hits = (0..3000)
            .map(|i| direction(i as f64 * 0.7, ((i as f64 + 0.1) / 3000.0 * 2.0 - 1.0).asin()))
            .filter(|d| bitmap.hits(&bitmap.cells(&[*d, Vec3::x(), Vec3::y()], &[0.0; POINTS], &[0.0; POINTS], 1)[..1]) == 1)
            .count();
        assert!(hits < 60, "{hits} of 3000 at a filling of 0.2 %");
    }
}
