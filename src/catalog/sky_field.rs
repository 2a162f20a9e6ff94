//! Everything that one camera needs of the sky.

use super::{Catalogue, FieldGeometry, FieldStars, SkyBitmap, TriangleIndex, rank_limit};
use crate::settings::Settings;
use crate::sky::ARCSEC;

/// The catalogue as one camera sees it, with its index.
#[derive(Debug, Clone)]
pub struct Field {
    /// What it was derived for.
    pub geometry: FieldGeometry,
    /// Least and greatest plate scale, rad/px.
    pub platescale_range: (f64, f64),
    /// Every star.
    pub stars: FieldStars,
    /// Triangles and pairs of the index stars.
    pub triangles: TriangleIndex,
    /// Where the verification stars are.
    pub bitmap: SkyBitmap,
    /// Rank below which a star is a verification star.
    pub verification_rank: u8,
}

impl Field {
    /// Derives the field of a camera of `width` × `height` px.
    pub fn build(catalogue: &Catalogue, settings: &Settings, width: usize, height: usize) -> Self {
        let matching = &settings.solver.matching;
        let range = (matching.platescale_min_arcsec_px, matching.platescale_max_arcsec_px);
        let geometry = FieldGeometry::new(width, height, range, settings.catalog.blend_px);
        let stars = FieldStars::build(catalogue, &settings.catalog, &geometry);
        let triangles = TriangleIndex::build(&stars, &settings.catalog, &geometry);
        let verification_rank = rank_limit(settings.catalog.verification_stars_per_field);
        let bitmap = SkyBitmap::build(&stars, verification_rank, matching.tolerance_px * geometry.platescale);
        Self { geometry, platescale_range: (range.0 * ARCSEC, range.1 * ARCSEC), stars, triangles, bitmap, verification_rank }
    }
}
