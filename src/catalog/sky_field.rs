//! Everything that one camera needs of the sky.

use super::{Catalogue, FieldGeometry, FieldKey, FieldStars, Pace, SkyBitmap, TriangleIndex};
use crate::sky::ARCSEC;

/// The catalogue as one camera sees it, with its index.
#[derive(Debug, Clone)]
pub struct Field {
    /// What it was derived from.
    pub key: FieldKey,
    /// The field of view.
    pub geometry: FieldGeometry,
    /// Least and greatest plate scale, rad/px.
    pub platescale_range: (f64, f64),
    /// Every star.
    pub stars: FieldStars,
    /// Triangles of the index stars.
    pub triangles: TriangleIndex,
    /// Where the verification stars are.
    pub bitmap: SkyBitmap,
    /// Rank below which a star is a verification star.
    pub verification_rank: u8,
}

impl Field {
    /// Derives the field with a key of `catalogue`. That takes a second or two; every few milliseconds it asks whether to keep on,
    /// and gives `None` where not.
    pub fn build(catalogue: &Catalogue, key: &FieldKey, keep_on: &dyn Fn() -> bool) -> Option<Self> {
        let pace = &mut Pace::new(keep_on);
        let geometry = key.geometry();
        let stars = FieldStars::build(catalogue, key, &geometry, pace)?;
        let triangles = TriangleIndex::build(&stars, &key.density(), &geometry, pace)?;
        let bitmap = SkyBitmap::build(&stars, key.verification_rank(), key.tolerance(), pace)?;
        Some(Self::of_parts(key, stars, triangles, bitmap))
    }

    /// The field with a key, of what takes long to derive.
    pub(super) fn of_parts(key: &FieldKey, stars: FieldStars, triangles: TriangleIndex, bitmap: SkyBitmap) -> Self {
        let (low, high) = key.platescale_range;
        Self {
            key: *key,
            geometry: key.geometry(),
            platescale_range: (low * ARCSEC, high * ARCSEC),
            stars,
            triangles,
            bitmap,
            verification_rank: key.verification_rank(),
        }
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.stars.bytes() + self.triangles.bytes() + self.bitmap.bytes()
    }
}
