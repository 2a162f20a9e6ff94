//! A bitmap of the sky: is there a verification star near this direction? One memory access per question.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a cell's number is below the size by construction")]

use super::cache::{FieldFileError, Loader, Saver, sane};
use super::{FieldStars, Pace};
use crate::sky::Vec3;
use std::io;

/// Six faces of a cube of `side` × `side` bits; a bit is set where a star may be within the tolerance.
#[derive(Debug, Clone)]
pub struct SkyBitmap {
    side: usize,
    words: Vec<u64>,
}

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
        Self { side, words: vec![0; (6 * side * side).div_ceil(64)] }
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

    /// Which points of a plane, lifted onto the sky, have a star within the tolerance: bit i for point i.
    ///
    /// Point i lifts to `plane[0] + x[i] plane[1] + y[i] plane[2]`, of any length; at most 32 points.
    #[inline(always)]
    pub fn hits(&self, plane: &[Vec3; 3], x: &[f32], y: &[f32]) -> u32 {
        let (face, axes) = face_of(&plane[0]);
        // The face's own axes: two along it, the third out of it.
        let [m, a, c] = plane.map(|v| [v[axes[0]] as f32, v[axes[1]] as f32, v[axes[2]] as f32]);
        let sign = if m[2] < 0.0 { -1.0f32 } else { 1.0 };
        let half = 0.5 * self.side as f32;
        let n = x.len().min(y.len()).min(32);
        let (mut u, mut v) = ([0f32; 32], [0f32; 32]);
        for i in 0..n {
            let depth = half / (sign * (m[2] + x[i] * a[2] + y[i] * c[2]));
            u[i] = (m[0] + x[i] * a[0] + y[i] * c[0]) * depth + half;
            v[i] = (m[1] + x[i] * a[1] + y[i] * c[1]) * depth + half;
        }
        let side = self.side as f32;
        let mut bits = 0u32;
        for i in 0..n {
            let cell = if u[i] >= 0.0 && v[i] >= 0.0 && u[i] < side && v[i] < side {
                (face * self.side + v[i] as usize) * self.side + u[i] as usize
            } else {
                // Over the face's edge: few fields have such points.
                self.cell(&(plane[0] + plane[1] * f64::from(x[i]) + plane[2] * f64::from(y[i])))
            };
            bits |= ((self.words[cell / 64] >> (cell % 64) & 1) as u32) << i;
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
                assert_eq!(bitmap.hits(&[middle, along, across], &[shift], &[0.0]) & 1, 1, "star {i}, shift {shift}");
            }
        }
    }

    #[test]
    fn most_of_the_sky_is_empty() {
        let bitmap = bitmap();
        let hits = (0..3000)
            .map(|i| direction(i as f64 * 0.7, ((i as f64 + 0.1) / 3000.0 * 2.0 - 1.0).asin()))
            .filter(|d| bitmap.hits(&[*d, Vec3::x(), Vec3::y()], &[0.0], &[0.0]) == 1)
            .count();
        assert!(hits < 60, "{hits} of 3000 at a filling of 0.2 %");
    }
}
