//! What a field is derived from.

use super::{Catalogue, FieldGeometry, rank_limit};
use crate::settings::Settings;
use std::f64::consts::PI;

/// Everything that a field is derived from: fields with the same key are the same, bit for bit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldKey {
    /// The catalogue: its checksum, its number of stars, and its epoch, Julian year.
    pub catalogue: (u32, u32, f64),
    /// Width and height of a frame, px.
    pub size: (usize, usize),
    /// Least and greatest plate scale, arcsec/px.
    pub platescale_range: (f64, f64),
    /// Epoch of observation, Julian year.
    pub epoch_yr: f64,
    /// Stars closer than this are one, px.
    pub blend_px: f64,
    /// A source this near to where a star should be may be that star, px.
    pub tolerance_px: f64,
    /// Stars per field that candidates are checked against.
    pub verification_stars_per_field: f64,
    /// What the triangles are wanted to be made of.
    pub wanted: Density,
}

/// How many triangles an index has.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Density {
    /// Brightest stars per field that triangles are made of.
    pub stars_per_field: f64,
    /// Longest side, fraction of the field's diagonal.
    pub longest_side: f64,
}

/// Pairs of neighbours of index stars that an index is made of, at most: nearly twice as many as for the flight camera. About a third
/// of them are the sides of a triangle of 8 bytes, so that an index has 100 MB of them at most and all is built in two seconds.
const MOST_PAIRS: f64 = 4e7;
/// Where there would be more, the longest side is shortened down to this fraction of the diagonal, and then stars are left out: the
/// pairs go down with the fourth power of the one and the third of the other, and short triangles are nearly as good as long ones.
const SHORTENED_TO: f64 = 0.45;
/// Numbers in a key.
const NUMBERS: usize = 13;

impl FieldKey {
    /// The key of the field of a camera of `width` × `height` px.
    pub fn new(catalogue: &Catalogue, settings: &Settings, width: usize, height: usize) -> Self {
        let (header, catalog, matching) = (&catalogue.header, &settings.catalog, &settings.solver.matching);
        Self {
            catalogue: (header.checksum, u32::try_from(catalogue.stars.len()).unwrap_or(u32::MAX), header.epoch_yr),
            size: (width, height),
            platescale_range: (matching.platescale_min_arcsec_px, matching.platescale_max_arcsec_px),
            epoch_yr: catalog.epoch_yr,
            blend_px: catalog.blend_px,
            tolerance_px: matching.tolerance_px,
            verification_stars_per_field: catalog.verification_stars_per_field,
            wanted: Density { stars_per_field: catalog.index_stars_per_field, longest_side: catalog.longest_side_fraction },
        }
    }

    /// The field of view.
    pub fn geometry(&self) -> FieldGeometry {
        FieldGeometry::new(self.size.0, self.size.1, self.platescale_range, self.blend_px)
    }

    /// As many triangles as are wanted, or as many as the memory allows: no settings fill it.
    pub fn density(&self) -> Density {
        let FieldGeometry { diagonal, area, .. } = self.geometry();
        let Density { stars_per_field, longest_side } = self.wanted;
        let neighbourhood = |side: f64| PI * (side * diagonal).powi(2);
        let pairs = |side: f64| 2.0 * PI / area * stars_per_field * (stars_per_field / area * neighbourhood(side)).powi(2);
        let shorter = longest_side * (MOST_PAIRS / pairs(longest_side)).powf(0.25);
        let longest_side = shorter.max(SHORTENED_TO).min(longest_side);
        let thinner = stars_per_field * (MOST_PAIRS / pairs(longest_side)).cbrt();
        Density { stars_per_field: thinner.min(stars_per_field), longest_side }
    }

    /// Rank below which a star is a verification star.
    pub fn verification_rank(&self) -> u8 {
        rank_limit(self.verification_stars_per_field)
    }

    /// A source this near to where a star should be may be that star, rad, in the middle of the range of plate scales.
    pub fn tolerance(&self) -> f64 {
        self.tolerance_px * self.geometry().platescale
    }

    /// Every number of the key.
    pub fn numbers(&self) -> [u64; NUMBERS] {
        let (checksum, count, epoch_yr) = self.catalogue;
        [
            checksum.into(),
            count.into(),
            epoch_yr.to_bits(),
            self.size.0 as u64,
            self.size.1 as u64,
            self.platescale_range.0.to_bits(),
            self.platescale_range.1.to_bits(),
            self.epoch_yr.to_bits(),
            self.blend_px.to_bits(),
            self.tolerance_px.to_bits(),
            self.verification_stars_per_field.to_bits(),
            self.wanted.stars_per_field.to_bits(),
            self.wanted.longest_side.to_bits(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of the flight's settings with a longest side, for frames of 1536 × 1024 px at this plate scale, arcsec/px.
    fn density(longest_side: f64, platescale: f64) -> Density {
        let settings = Settings::flight().unwrap();
        let catalogue = Catalogue::embedded().unwrap();
        let mut key = FieldKey::new(&catalogue, &settings, 1536, 1024);
        key.platescale_range = (platescale, platescale);
        key.wanted.longest_side = longest_side;
        key.density()
    }

    #[test]
    fn the_flights_field_and_wider_ones_have_what_is_wanted_and_no_field_has_too_much() {
        for platescale in [9.45, 40.0, 60.0] {
            assert_eq!(density(0.52, platescale), Density { stars_per_field: 15.0, longest_side: 0.52 });
        }
        let narrow = density(0.52, 6.6);
        assert_eq!(narrow.stars_per_field, 15.0);
        assert!((0.45..0.52).contains(&narrow.longest_side), "{narrow:?}");
        let tiny = density(0.6, 1.0);
        assert_eq!(tiny.longest_side, SHORTENED_TO);
        assert!((3.0..15.0).contains(&tiny.stars_per_field), "{tiny:?}");
        // Triangles that are short already are not lengthened.
        assert_eq!(density(0.3, 9.45), Density { stars_per_field: 15.0, longest_side: 0.3 });
    }
}
