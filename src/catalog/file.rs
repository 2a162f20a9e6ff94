//! The catalogue file: its layout, its checks, and the stars in it.
//!
//! Little-endian throughout. A header of 64 bytes, then records of 17 bytes, brightest star first:
//!
//! | header at | type | what |
//! |---|---|---|
//! | 0 | 8 bytes | `STARSCAT` |
//! | 8 | u16 | version of the layout: 1 |
//! | 10 | u16 | bytes in a record: 17 |
//! | 12 | u32 | number of records |
//! | 16 | f64 | epoch of the positions, Julian year |
//! | 24 | u32 | CRC-32 (IEEE) of all records |
//! | 28 | 32 bytes | origin, printable ASCII, filled up with zeros |
//! | 60 | u32 | CRC-32 (IEEE) of the 60 bytes before |
//!
//! | record at | type | what |
//! |---|---|---|
//! | 0 | u32 | right ascension, turns / 2³² (0.3 mas) |
//! | 4 | i32 | declination, turns / 2³² |
//! | 8 | i16 | proper motion in right ascension times cos(dec), mas/yr |
//! | 10 | i16 | proper motion in declination, mas/yr |
//! | 12 | i16 | magnitude in Gaia RP, 0.001 mag |
//! | 14 | u24 | Hipparcos number, 0 where it has none |
//!
//! `scripts/build-catalog.py` writes it.

use super::names::{Names, NamesError};
use crate::sky::{ARCSEC, Vec3, direction};
use crc::{CRC_32_ISO_HDLC, Crc, Table};
use std::f64::consts::TAU;

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
    /// The surveys that it was made from.
    pub origin: String,
}

/// Why a catalogue was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum CatalogueError {
    /// Not a catalogue of ours.
    #[error("not a star catalogue: it begins with {found:?}, expected \"STARSCAT\"")]
    Foreign {
        /// Its first bytes, at most 8, as text.
        found: String,
    },
    /// Of another layout than this program reads.
    #[error("catalogue format {found}, expected {FORMAT}")]
    Format {
        /// Version of its layout.
        found: u16,
    },
    /// Records of another size.
    #[error("records of {found} bytes, expected {RECORD_BYTES}")]
    RecordSize {
        /// Bytes in a record, by the header.
        found: u16,
    },
    /// Cut short, or with something after its end.
    #[error("{found} bytes long, expected {expected} for {what}")]
    Length {
        /// Bytes in the file.
        found: usize,
        /// Bytes that there should be.
        expected: u64,
        /// What needs that many.
        what: String,
    },
    /// Altered, by one of its checksums.
    #[error("altered: checksum of the {part} is {found:08x}, expected {expected:08x}")]
    Altered {
        /// `header` or `records`.
        part: &'static str,
        /// Checksum of what is there.
        found: u32,
        /// Checksum that was written with it.
        expected: u32,
    },
    /// A field of the header that no catalogue has.
    #[error("header: {field} is {found}, expected {expected}")]
    Header {
        /// Which.
        field: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        expected: String,
    },
    /// A star that cannot be.
    #[error("star {index}: {field} is {found}, expected {expected}")]
    Star {
        /// Position in the file, from 0.
        index: usize,
        /// Which of its fields.
        field: &'static str,
        /// What it is.
        found: i64,
        /// What it may be.
        expected: String,
    },
    /// The proper names that are built into the program can't be read.
    #[error("names of stars: {0}")]
    Names(#[from] NamesError),
}

/// Version of the layout that this program reads.
const FORMAT: u16 = 1;
const MAGIC: [u8; 8] = *b"STARSCAT";
const HEADER_BYTES: usize = 64;
const RECORD_BYTES: usize = 17;
/// Epochs, Julian year: what a survey of this or the last century can have.
const EPOCHS: std::ops::RangeInclusive<f64> = 1900.0..=2100.0;
/// 1.5 million stars: three times as many as are shipped, and 60 MB in memory.
const MAX_COUNT: u32 = 1_500_000;
/// The longest file that can be a catalogue, bytes; who reads one from disk need not read more.
pub const MAX_FILE_BYTES: usize = HEADER_BYTES + MAX_COUNT as usize * RECORD_BYTES;
/// A quarter turn in the file's unit.
const POLE: i32 = 1 << 30;
/// Turns / 2³² in radians.
const POSITION_UNIT: f64 = TAU / 4_294_967_296.0;
/// mas/yr in rad/yr.
const MOTION_UNIT: f64 = ARCSEC / 1000.0;
/// Barnard's star moves fastest, 10.4 arcsec/yr; mas/yr.
const FASTEST: i16 = 11_000;
/// From brighter than Sirius to fainter than a survey of bright stars holds, 0.001 mag.
const MAGNITUDES: std::ops::RangeInclusive<i16> = -3_000..=20_000;
/// The highest number in the Hipparcos catalogue (ESA 1997).
const HIGHEST_HIP: u32 = 120_416;

/// Sixteen bytes at a time: 8 MB take 4 ms, a byte at a time 20 ms.
const CRC: Crc<u32, Table<16>> = Crc::<u32, Table<16>>::new(&CRC_32_ISO_HDLC);

/// The catalogue that is built into the program.
const EMBEDDED: &[u8] = include_bytes!("../../config/catalog/stars.bin");

/// All stars, brightest first.
#[derive(Debug, Clone)]
pub struct Catalogue {
    /// What the file's header said.
    pub header: CatalogueHeader,
    /// The stars, brightest first; a star's position here is its identity in matches.
    pub stars: Vec<Star>,
}

impl Catalogue {
    /// Reads and checks a catalogue file: every byte of it is under a checksum, and every field within its range.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CatalogueError> {
        let header = read_header(bytes)?;
        let records = bytes.get(HEADER_BYTES..).unwrap_or_default();
        let expected = HEADER_BYTES as u64 + header.count as u64 * RECORD_BYTES as u64;
        if bytes.len() as u64 != expected {
            return Err(CatalogueError::Length { found: bytes.len(), expected, what: format!("{} stars", header.count) });
        }
        verify("records", records, header.checksum)?;
        let stars = read_stars(records)?;
        Ok(Self { header, stars })
    }

    /// The catalogue that is built into the program (`config/catalog/stars.bin`).
    pub fn embedded() -> Result<Self, CatalogueError> {
        if let Err(error) = Names::embedded() {
            return Err(error.clone().into());
        }
        Self::from_bytes(EMBEDDED)
    }

    /// What to call the star at `index`: its proper name, else `HIP n`, else `G<index>`.
    pub fn name(&self, index: usize) -> String {
        match self.stars.get(index).map(|star| star.hip) {
            None | Some(0) => format!("G{index}"),
            Some(hip) => match proper_name(hip) {
                Some(name) => name.to_owned(),
                None => format!("HIP {hip}"),
            },
        }
    }

    /// The position of a star in the catalogue, by its proper name or by what [`Catalogue::name`] calls it, in any case
    /// of letters; a bare number is a Hipparcos number.
    pub fn find(&self, name: &str) -> Option<usize> {
        let name = name.trim().to_lowercase();
        if let Some(index) = name.strip_prefix('g').and_then(|digits| digits.parse().ok()) {
            return (index < self.stars.len()).then_some(index);
        }
        let number = name.strip_prefix("hip").unwrap_or(&name).trim().parse();
        let hip = match number {
            Ok(hip) => hip,
            Err(_) => Names::embedded().as_ref().ok()?.hip(&name)?,
        };
        self.stars.iter().position(|star| star.hip == hip && hip != 0)
    }
}

fn proper_name(hip: u32) -> Option<&'static str> {
    Names::embedded().as_ref().ok()?.of(hip)
}

/// The `N` bytes from `at` on; [`read_header`] has made sure that they are there.
fn field<const N: usize>(header: &[u8; HEADER_BYTES], at: usize) -> [u8; N] {
    let mut out = [0; N];
    for (to, from) in out.iter_mut().zip(header.iter().skip(at)) {
        *to = *from;
    }
    out
}

/// Refuses bytes whose checksum is not the one that was written with them.
fn verify(part: &'static str, bytes: &[u8], expected: u32) -> Result<(), CatalogueError> {
    let found = CRC.checksum(bytes);
    if found == expected { Ok(()) } else { Err(CatalogueError::Altered { part, found, expected }) }
}

fn read_header(bytes: &[u8]) -> Result<CatalogueHeader, CatalogueError> {
    let start = bytes.get(..MAGIC.len()).unwrap_or(bytes);
    if !MAGIC.starts_with(start) {
        return Err(CatalogueError::Foreign { found: String::from_utf8_lossy(start).into_owned() });
    }
    let Some(header) = bytes.first_chunk::<HEADER_BYTES>() else {
        return Err(CatalogueError::Length { found: bytes.len(), expected: HEADER_BYTES as u64, what: "the header".to_owned() });
    };
    let format = u16::from_le_bytes(field(header, 8));
    if format != FORMAT {
        return Err(CatalogueError::Format { found: format });
    }
    let record = u16::from_le_bytes(field(header, 10));
    if usize::from(record) != RECORD_BYTES {
        return Err(CatalogueError::RecordSize { found: record });
    }
    verify("header", &field::<60>(header, 0), u32::from_le_bytes(field(header, 60)))?;

    let wrong = |field, found: String, expected: String| Err(CatalogueError::Header { field, found, expected });
    let count = u32::from_le_bytes(field(header, 12));
    if count == 0 || count > MAX_COUNT {
        return wrong("number of stars", count.to_string(), format!("1 to {MAX_COUNT}"));
    }
    let epoch_yr = f64::from_le_bytes(field(header, 16));
    if !EPOCHS.contains(&epoch_yr) {
        return wrong("epoch", epoch_yr.to_string(), format!("{} to {}", EPOCHS.start(), EPOCHS.end()));
    }
    let origin = String::from_utf8_lossy(&field::<32>(header, 28)).trim_end_matches('\0').to_owned();
    if !origin.bytes().all(|byte| byte == b' ' || byte.is_ascii_graphic()) {
        return wrong("origin", format!("{origin:?}"), "printable ASCII".to_owned());
    }
    let checksum = u32::from_le_bytes(field(header, 24));
    Ok(CatalogueHeader { format, epoch_yr, count: count as usize, checksum, origin })
}

/// Reads the records; they must be sorted by magnitude, and no Hipparcos number may come twice.
fn read_stars(records: &[u8]) -> Result<Vec<Star>, CatalogueError> {
    let (records, _) = records.as_chunks::<RECORD_BYTES>();
    let mut stars = Vec::with_capacity(records.len());
    let mut seen = vec![false; HIGHEST_HIP as usize + 1];
    let mut brightest = *MAGNITUDES.start();
    for (index, record) in records.iter().enumerate() {
        let &[a0, a1, a2, a3, d0, d1, d2, d3, e0, e1, n0, n1, m0, m1, h0, h1, h2] = record;
        let ra = u32::from_le_bytes([a0, a1, a2, a3]);
        let dec = i32::from_le_bytes([d0, d1, d2, d3]);
        let (pm_ra, pm_dec) = (i16::from_le_bytes([e0, e1]), i16::from_le_bytes([n0, n1]));
        let mag = i16::from_le_bytes([m0, m1]);
        let hip = u32::from_le_bytes([h0, h1, h2, 0]);

        check(index, "declination (turns / 2^32)", dec, -POLE, POLE)?;
        check(index, "proper motion in right ascension (mas/yr)", pm_ra, -FASTEST, FASTEST)?;
        check(index, "proper motion in declination (mas/yr)", pm_dec, -FASTEST, FASTEST)?;
        check(index, "magnitude (0.001 mag), none brighter than the star before,", mag, brightest, *MAGNITUDES.end())?;
        brightest = mag;
        check(index, "Hipparcos number", hip, 0, HIGHEST_HIP)?;
        if let Some(seen) = seen.get_mut(hip as usize)
            && std::mem::replace(seen, hip != 0)
        {
            let expected = "each number once".to_owned();
            return Err(CatalogueError::Star { index, field: "Hipparcos number", found: hip.into(), expected });
        }

        stars.push(Star {
            ra: f64::from(ra) * POSITION_UNIT,
            dec: f64::from(dec) * POSITION_UNIT,
            pm_ra: f64::from(pm_ra) * MOTION_UNIT,
            pm_dec: f64::from(pm_dec) * MOTION_UNIT,
            mag: f32::from(mag) / 1000.0,
            hip,
        });
    }
    Ok(stars)
}

fn check<T: Copy + PartialOrd + Into<i64>>(
    index: usize,
    field: &'static str,
    found: T,
    low: T,
    high: T,
) -> Result<(), CatalogueError> {
    if low <= found && found <= high {
        return Ok(());
    }
    let expected = format!("{} to {}", low.into(), high.into());
    Err(CatalogueError::Star { index, field, found: found.into(), expected })
}

#[cfg(test)]
mod tests;
