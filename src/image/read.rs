//! Reading image files: what kind a file is, and what can be wrong with it.

use super::{Frame, fits, name, raster};
use crate::sky::ClockQuality;

/// Longest side of an image, px: beyond any detector that a star camera would carry.
const MAX_SIDE_PX: i64 = 30_000;
/// Most pixels of an image.
const MAX_PIXELS: usize = 100_000_000;

/// Why a file could not be read as an image.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{name}: {problem}")]
pub struct ReadError {
    /// The file's name, as given.
    pub name: String,
    /// What is wrong with it.
    pub problem: Problem,
}

/// What is wrong with an image file.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Problem {
    /// None of the kinds of file that are read.
    #[error("begins with \"{begins}\", expected a FITS, TIFF, PNG or JPEG file")]
    UnknownFormat {
        /// The first bytes, made printable.
        begins: String,
    },
    /// A FITS header without its end.
    #[error("FITS header: no END card in the first {searched} bytes")]
    NoEnd {
        /// Bytes that were looked at.
        searched: usize,
    },
    /// A keyword that every FITS image has is not there.
    #[error("FITS header: {keyword} is missing")]
    MissingKeyword {
        /// The keyword.
        keyword: &'static str,
    },
    /// A keyword whose value cannot be used.
    #[error("FITS header: {keyword} is \"{value}\", expected {expected}")]
    BadKeyword {
        /// The keyword.
        keyword: &'static str,
        /// Its value in the file.
        value: String,
        /// What it should have been.
        expected: &'static str,
    },
    /// The first header has no image with it.
    #[error("FITS header: NAXIS is 0, expected an image in the first header; extensions and compressed tiles are not read")]
    NoImage,
    /// An image without pixels.
    #[error("the image has no pixels")]
    Empty,
    /// More pixels than any camera has.
    #[error("the image claims {width} × {height} px, at most {MAX_SIDE_PX} px a side and {MAX_PIXELS} px are read")]
    TooLarge {
        /// Columns claimed.
        width: i64,
        /// Rows claimed.
        height: i64,
    },
    /// The file ends too early.
    #[error("cut short: {what} need {need} bytes, the file has {got}")]
    Cut {
        /// What should have been there.
        what: &'static str,
        /// Bytes that it needs.
        need: usize,
        /// Bytes that there are.
        got: usize,
    },
    /// A small file that claims to hold a huge image.
    #[error("claims {claimed} bytes of pixels in a file of {file} bytes, which no honest compression reaches")]
    Bomb {
        /// Bytes of pixels claimed.
        claimed: usize,
        /// Bytes of the file.
        file: usize,
    },
    /// A pixel that 16 bits do not hold.
    #[error("the pixel at x {x}, y {y} is {value}, expected at most 65535")]
    ValueTooLarge {
        /// The pixel's value.
        value: f64,
        /// Its column.
        x: usize,
        /// Its row.
        y: usize,
    },
    /// Most pixels are negative or have no value.
    #[error("{unusable} of {of} pixels are negative or have no value")]
    MostlyUnusable {
        /// Pixels without use.
        unusable: usize,
        /// Pixels in all.
        of: usize,
    },
    /// A floating-point image from 0 to 1: its scale in ADU is not known.
    #[error("the pixels reach {highest} only, expected ADU: an image scaled to 1 would lose its contents")]
    Normalised {
        /// Highest value.
        highest: f64,
    },
    /// The decoder of a format refused the file.
    #[error("{format}: {message}")]
    Decoder {
        /// Name of the format.
        format: &'static str,
        /// The decoder's words.
        message: String,
    },
}

/// Reads an image file: FITS, TIFF, PNG or JPEG, by its contents, 8 or 16 bits, grey (of colour, the luminance).
///
/// `name` names the file in errors, becomes the stamp's origin, and gives the capture time where the file has none.
/// Rows are counted from the bottom in FITS and from the top in the others. `full_scale` is known for 8 bits, and for
/// FITS where the keyword `SATURATE` says it.
pub fn read(name: &str, bytes: &[u8]) -> Result<Frame, ReadError> {
    let mut frame = detect(bytes).map_err(|problem| ReadError { name: name.to_owned(), problem })?;
    let in_name = || name::time_in_name(name).map(|time| (time, ClockQuality::FreeRunning));
    frame.stamp.captured = frame.stamp.captured.or_else(in_name);
    frame.stamp.origin = name.to_owned();
    Ok(frame)
}

fn detect(bytes: &[u8]) -> Result<Frame, Problem> {
    if bytes.starts_with(fits::MAGIC) {
        return fits::read(bytes);
    }
    if let Some(format) = raster::Format::of(bytes) {
        return raster::read(format, bytes);
    }
    let begins = bytes.get(..bytes.len().min(8)).unwrap_or_default().escape_ascii().to_string();
    Err(Problem::UnknownFormat { begins })
}

/// Width and height that a file claims, where they are those of an image that we read.
pub(super) fn check_size(width: i64, height: i64) -> Result<(usize, usize), Problem> {
    if width == 0 || height == 0 {
        return Err(Problem::Empty);
    }
    match (usize::try_from(width), usize::try_from(height)) {
        (Ok(w), Ok(h)) if width.max(height) <= MAX_SIDE_PX && w * h <= MAX_PIXELS => Ok((w, h)),
        _ => Err(Problem::TooLarge { width, height }),
    }
}
