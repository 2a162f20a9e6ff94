//! A bitmap of the sky: is there a verification star near this direction? One memory access per question.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a cell's number is below the size by construction")]

use super::FieldStars;
use crate::sky::Vec3;

/// Six faces of a cube of `side` × `side` bits; a bit is set where a star may be within the tolerance.
#[derive(Debug, Clone)]
pub struct SkyBitmap {
    side: usize,
    words: Vec<u64>,
}

/// Most bits along a face: a bitmap of 7 MB stays in a small computer's cache (trials: 3072 beats 4096).
const MAX_SIDE: f64 = 3072.0;

impl SkyBitmap {
    /// Sets the discs of `tolerance` rad around the verification stars of a field.
    pub fn build(field: &FieldStars, rank_limit: u8, tolerance: f64) -> Self {
        // Cells no smaller than the discs, so that the nine points below touch every cell that a disc does.
        let side = (std::f64::consts::FRAC_PI_2 / (1.5 * tolerance)).clamp(8.0, MAX_SIDE) as usize;
        let mut bitmap = Self { side, words: vec![0; (6 * side * side).div_ceil(64)] };
        for star in field.stars.iter().filter(|s| s.rank < rank_limit) {
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
        bitmap
    }

    /// Whether a star may be within the tolerance of a direction, which need not be of unit length.
    #[inline]
    pub fn hit(&self, direction: &Vec3) -> bool {
        let cell = self.cell(direction);
        self.words[cell / 64] >> (cell % 64) & 1 != 0
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.words[..])
    }

    #[inline]
    fn cell(&self, d: &Vec3) -> usize {
        let (ax, ay, az) = (d.x.abs(), d.y.abs(), d.z.abs());
        let (face, major, u, v) = if az >= ax && az >= ay {
            (if d.z > 0.0 { 0 } else { 1 }, az, d.x, d.y)
        } else if ax >= ay {
            (if d.x > 0.0 { 2 } else { 3 }, ax, d.y, d.z)
        } else {
            (if d.y > 0.0 { 4 } else { 5 }, ay, d.z, d.x)
        };
        let half = 0.5 * self.side as f64;
        let at = |w: f64| ((w / major * half + half) as usize).min(self.side - 1);
        (face * self.side + at(v)) * self.side + at(u)
    }
}
