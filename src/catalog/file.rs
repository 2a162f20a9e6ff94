//! The catalogue file: its layout, its checks, and the stars in it.

use crate::sky::{Vec3, direction};

/// One star.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Star {
    /// Right ascension at the catalogue's epoch, ICRS, rad.
    pub ra: f64,
    /// Declination at the catalogue's epoch, ICRS, rad.
    pub dec: f64,
    /// Proper motion in right ascension times cos(dec), rad/yr.
    pub pm_ra: f64,
    /// Proper motion in declination, rad/yr.
    pub pm_dec: f64,
    /// Magnitude in Gaia RP, the band closest to what a red-filtered daytime camera sees.
    pub mag: f32,
    /// Hipparcos number, 0 where it has none.
    pub hip: u32,
}

impl Star {
    /// Unit vector at an epoch `years` after the catalogue's.
    pub fn direction_after(&self, years: f64) -> Vec3 {
        let u = direction(self.ra, self.dec);
        let (sin_ra, cos_ra) = self.ra.sin_cos();
        let (sin_dec, cos_dec) = self.dec.sin_cos();
        let east = Vec3::new(-sin_ra, cos_ra, 0.0);
        let north = Vec3::new(-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec);
        (u + (east * self.pm_ra + north * self.pm_dec) * years).normalize()
    }
}

/// What the header of a catalogue file says.
#[derive(Debug, Clone, PartialEq)]
pub struct CatalogueHeader {
    /// Version of the layout.
    pub format: u16,
    /// Epoch of the positions, Julian year.
    pub epoch_yr: f64,
    /// Number of stars.
    pub count: usize,
    /// CRC-32 (IEEE) of the star records.
    pub checksum: u32,
}

/// Why a catalogue was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CatalogueError {
    /// Not a catalogue of ours.
    #[error("not a star catalogue: it does not begin with its magic")]
    Foreign,
}

/// All stars, brightest first.
#[derive(Debug, Clone)]
pub struct Catalogue {
    /// What the file's header said.
    pub header: CatalogueHeader,
    /// The stars, brightest first; a star's position here is its identity in matches.
    pub stars: Vec<Star>,
}

impl Catalogue {
    /// Reads and checks a catalogue file.
    pub fn from_bytes(_bytes: &[u8]) -> Result<Self, CatalogueError> {
        Err(CatalogueError::Foreign)
    }

    /// The catalogue that is built into the program (`config/catalog/stars.bin`).
    pub fn embedded() -> Result<Self, CatalogueError> {
        Self::from_bytes(&[])
    }

    /// What to call the star at `index`: its proper name, else `HIP n`, else `G<index>`.
    pub fn name(&self, index: usize) -> String {
        format!("G{index}")
    }
}
