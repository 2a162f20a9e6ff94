//! Everything that one camera needs of the sky.

use super::{Catalogue, FieldGeometry, FieldStars, SkyBitmap, TriangleIndex, rank_limit};
use crate::settings::{CatalogSettings, Settings};
use crate::sky::ARCSEC;
use std::f64::consts::PI;

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
        let index_stars_per_field = settings.catalog.index_stars_per_field.min(affordable_stars(&settings.catalog, &geometry));
        let triangles =
            TriangleIndex::build(&stars, &CatalogSettings { index_stars_per_field, ..settings.catalog.clone() }, &geometry);
        let verification_rank = rank_limit(settings.catalog.verification_stars_per_field);
        let bitmap = SkyBitmap::build(&stars, verification_rank, matching.tolerance_px * geometry.platescale);
        Self { geometry, platescale_range: (range.0 * ARCSEC, range.1 * ARCSEC), stars, triangles, bitmap, verification_rank }
    }
}

/// Pairs of neighbours of index stars that an index is made of, at most: six times as many as for the flight camera, which is
/// about 1 GB while the index is built. A field of 2° has nearly as many.
const MOST_PAIRS: f64 = 5e8;

/// Index stars per field with which the triangles keep within [`MOST_PAIRS`], so that no settings fill the memory: their number
/// grows with the third power of the density.
fn affordable_stars(settings: &CatalogSettings, geometry: &FieldGeometry) -> f64 {
    let neighbourhood = PI * (settings.longest_side_fraction * geometry.diagonal).powi(2);
    let density = (MOST_PAIRS / (4.0 * PI * neighbourhood.powi(2))).cbrt();
    density * geometry.area
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the flight's settings with a longest side, for a field of this width and height, px, at this plate scale, arcsec/px.
    fn affordable(longest_side_fraction: f64, size: (usize, usize), platescale: f64) -> f64 {
        let settings = CatalogSettings { longest_side_fraction, ..Settings::flight().unwrap().catalog };
        affordable_stars(&settings, &FieldGeometry::new(size.0, size.1, (platescale, platescale), settings.blend_px))
    }

    #[test]
    fn fields_from_two_degrees_have_the_stars_that_the_flight_settings_want_and_no_field_has_too_many() {
        let Settings { catalog, .. } = Settings::flight().unwrap();
        for platescale in [4.0, 9.45, 40.0, 50.0] {
            let most = affordable(catalog.longest_side_fraction, (1536, 1024), platescale);
            assert!(most > catalog.index_stars_per_field, "{platescale}: {most}");
        }
        let crowded = affordable(1.0, (1536, 1024), 9.45);
        assert!((10.0..20.0).contains(&crowded), "{crowded}");
    }
}
