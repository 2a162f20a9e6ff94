//! What a flight computer of old is sent: 44 variables in slots of 8 bytes, then the first sources of an image.

use super::bytes::put;
use super::{ANSWER_BYTES, VERSION};

/// Sources that an answer has room for.
pub const MAX_BLOBS: usize = 20;
/// Bytes of a variable's slot, whatever its type.
const SLOT_BYTES: usize = 8;
/// Offsets of the sources, of the first of them, and of the version.
const BLOBS: usize = 352;
const FIRST_BLOB: usize = BLOBS + 8;
const BLOB_BYTES: usize = 32;
const VERSION_AT: usize = 1000;

/// A type that a variable may have.
trait Slot {
    fn bytes(self) -> [u8; SLOT_BYTES];
}

impl Slot for f64 {
    fn bytes(self) -> [u8; SLOT_BYTES] {
        self.to_le_bytes()
    }
}

impl Slot for i32 {
    fn bytes(self) -> [u8; SLOT_BYTES] {
        u64::from(self.cast_unsigned()).to_le_bytes()
    }
}

impl Slot for bool {
    fn bytes(self) -> [u8; SLOT_BYTES] {
        u64::from(self).to_le_bytes()
    }
}

macro_rules! variables {
    ($($(#[doc = $meaning:literal])+ $name:ident: $type:ty = $initial:literal;)+) => {
        /// The variables, in the order of the wire, by the names that they flew with. They begin as they did there.
        #[derive(Debug, Clone, PartialEq)]
        pub struct Variables {
            $($(#[doc = $meaning])+ pub $name: $type,)+
        }

        impl Default for Variables {
            fn default() -> Self {
                Self { $($name: $initial,)+ }
            }
        }

        impl Variables {
            /// Their names, in the order of the wire.
            pub const NAMES: &'static [&'static str] = &[$(stringify!($name)),+];

            /// Their slots, in the order of the wire.
            fn slots(&self) -> impl Iterator<Item = [u8; SLOT_BYTES]> {
                [$(self.$name.bytes()),+].into_iter()
            }
        }
    };
}

variables! {
    /// Number that the next image will have.
    ctr_stars: i32 = -1;
    /// Time since the start, s.
    stars_run_time: i32 = 0;
    /// Temperature of the lens, °C.
    hk_temp_lens: f64 = 100.0;
    /// Temperature of the computer, °C.
    hk_temp_comp: f64 = 100.0;
    /// Temperature of the vessel, °C.
    hk_temp_vessel: f64 = 100.0;
    /// Temperature of the plate, °C.
    hk_temp_plate: f64 = 100.0;
    /// Temperature of the DC-DC converter, °C.
    hk_temp_dcdc: f64 = 100.0;
    /// Temperature of the flange, °C.
    hk_temp_flange: f64 = 100.0;
    /// Pressure in the vessel, atm.
    hk_pressure: f64 = 0.0;
    /// Free space on the disk, GiB.
    hk_disk: f64 = 0.0;
    /// The gain is known.
    cam_gain_valid: bool = false;
    /// Gain, dB.
    cam_gain_db: f64 = -1.0;
    /// Focus, encoder counts.
    lens_focus: i32 = -1;
    /// Aperture.
    lens_aperture: i32 = -1;
    /// Number of the image that is being solved, or was last.
    image_ctr_stars: i32 = -1;
    /// The flight computer's number of its series of triggers.
    image_ctr_fcp: i32 = -1;
    /// Exposures co-added into it.
    image_num_exposures: i32 = -1;
    /// Mean, ADU.
    image_stats_mean: f64 = -1.0;
    /// Noise, ADU.
    image_stats_noise: f64 = -1.0;
    /// Measured gain, dB.
    image_stats_gaindb: f64 = -1.0;
    /// Saturated pixels.
    image_stats_num_px_sat: i32 = -1;
    /// Saturated pixels as a fraction of the image.
    image_stats_frac_px_sat: f64 = -1.0;
    /// There is a focus metric.
    image_afocus_metric_valid: bool = false;
    /// Peak of the brightest source, ADU.
    image_afocus_metric: f64 = 0.0;
    /// The image is solved.
    image_eq_valid: bool = false;
    /// Right ascension, rad.
    image_eq_ra: f64 = 0.0;
    /// Declination, rad.
    image_eq_dec: f64 = 0.0;
    /// Roll with the sign that flew, rad.
    image_eq_roll: f64 = 0.0;
    /// σ of right ascension, an angle of that coordinate, rad.
    image_eq_sigma_ra: f64 = 0.0;
    /// σ of declination, rad.
    image_eq_sigma_dec: f64 = 0.0;
    /// σ of the roll, rad.
    image_eq_sigma_roll: f64 = 0.0;
    /// Mean σ on the sky, rad.
    image_eq_sigma_pointing: f64 = 0.0;
    /// Plate scale, rad/px.
    image_eq_iplate: f64 = 0.0;
    /// Azimuth and elevation are known.
    image_hor_valid: bool = false;
    /// Azimuth, rad.
    image_hor_az: f64 = 0.0;
    /// Elevation, rad.
    image_hor_el: f64 = 0.0;
    /// Roll against the horizon, rad.
    image_hor_roll: f64 = 0.0;
    /// σ of azimuth, an angle of that coordinate, rad.
    image_hor_sigma_az: f64 = 0.0;
    /// σ of elevation, rad.
    image_hor_sigma_el: f64 = 0.0;
    /// σ of the roll, rad.
    image_hor_sigma_roll: f64 = 0.0;
    /// Mean σ on the sky, rad.
    image_hor_sigma_pointing: f64 = 0.0;
    /// Plate scale, rad/px.
    image_hor_iplate: f64 = 0.0;
    /// Sources found; refreshed with a solution alone.
    image_num_blobs_found: i32 = -1;
    /// Sources matched; the same.
    image_num_blobs_matched: i32 = -1;
}

/// A source.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Blob {
    /// To the right of the picture's centre, px.
    pub x: f64,
    /// Up from it, px.
    pub y: f64,
    /// Flux, ADU.
    pub flux: f64,
    /// Highest pixel over flux.
    pub peak_to_flux: f64,
}

/// What a flight computer is sent.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Answer {
    /// The variables.
    pub variables: Variables,
    /// Number of the image that the sources are of.
    pub blobs_ctr_stars: i32,
    /// The sources, of which as many as there is room for are sent.
    pub blobs: Vec<Blob>,
}

impl Answer {
    /// As it is sent.
    pub fn pack(&self) -> [u8; ANSWER_BYTES] {
        let mut bytes = [0; ANSWER_BYTES];
        let mut fill = |offset: usize, slot: [u8; SLOT_BYTES]| put(&mut bytes, offset, slot);
        self.variables.slots().enumerate().for_each(|(place, slot)| fill(place * SLOT_BYTES, slot));
        for (place, blob) in self.blobs.iter().take(MAX_BLOBS).enumerate() {
            let numbers = [blob.x, blob.y, blob.flux, blob.peak_to_flux];
            let first = FIRST_BLOB + place * BLOB_BYTES;
            numbers.iter().enumerate().for_each(|(number, value)| fill(first + number * SLOT_BYTES, value.bytes()));
        }
        put(&mut bytes, BLOBS, self.blobs_ctr_stars.to_le_bytes());
        put(&mut bytes, BLOBS + 4, (self.blobs.len().min(MAX_BLOBS) as u32).to_le_bytes());
        put(&mut bytes, VERSION_AT, VERSION.to_le_bytes());
        bytes
    }
}

#[cfg(test)]
mod tests {
    use super::super::bytes::{f64_at, i32_at, u32_at};
    use super::*;

    #[test]
    fn variables_sources_and_version_stand_where_they_flew() {
        assert_eq!(Variables::NAMES.len() * SLOT_BYTES, BLOBS);
        assert_eq!(FIRST_BLOB + MAX_BLOBS * BLOB_BYTES, VERSION_AT);
        assert_eq!(VERSION_AT + 4, ANSWER_BYTES);
        let blob = |place: usize| Blob { x: place as f64, y: -2.0, flux: 3e4, peak_to_flux: 0.2 };
        let variables = Variables { image_eq_valid: true, image_eq_ra: 1.5, image_num_blobs_matched: 9, ..Variables::default() };
        let answer = Answer { variables, blobs_ctr_stars: 77, blobs: (0..30).map(blob).collect() };
        let bytes = answer.pack();
        assert_eq!((i32_at(&bytes, 0), f64_at(&bytes, 2 * 8), f64_at(&bytes, 11 * 8)), (-1, 100.0, -1.0));
        assert_eq!((bytes[24 * 8], f64_at(&bytes, 25 * 8), i32_at(&bytes, 43 * 8)), (1, 1.5, 9));
        assert_eq!((i32_at(&bytes, 352), i32_at(&bytes, 356), u32_at(&bytes, 1000)), (77, 20, 3));
        assert_eq!((f64_at(&bytes, 360 + 19 * 32), f64_at(&bytes, 360 + 19 * 32 + 24)), (19.0, 0.2));
    }
}
