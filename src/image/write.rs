//! Writing image files: FITS to keep, PNG to look at and to feed other programs.

use std::io::{self, Write};

use ::image::codecs::png::PngEncoder;
use ::image::{ExtendedColorType, ImageEncoder};

use super::{Frame, Keyword, fits};
use crate::sky::RowOrder;

/// Why a frame could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file could not be written.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The frame contradicts itself.
    #[error("the frame is {width} × {height} px and has {pixels} pixels")]
    Shape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Values that it holds.
        pixels: usize,
    },
    /// The encoder of PNG refused.
    #[error("PNG: {0}")]
    Png(String),
}

/// Writes a frame as FITS (16 bits with BZERO 32768), its bottom row first whatever its own row order.
///
/// The stamp goes into keywords of at most 8 letters with units in their comments; what is not known is left out. Reading
/// the file gives the same pixels and the same stamp, times to a microsecond; its origin is then the file's name. `keywords` stand
/// after those of the stamp, and checksums at the end.
pub fn write_fits(frame: &Frame, keywords: &[Keyword], out: &mut impl Write) -> Result<(), WriteError> {
    fits::write(frame, keywords, out)
}

/// Writes a frame as a grey PNG of 16 bits, its top row first whatever its own row order. The stamp is not kept.
pub fn write_png(frame: &Frame, out: &mut impl Write) -> Result<(), WriteError> {
    let samples: Vec<u8> = rows(frame, RowOrder::TopFirst)?.flatten().flat_map(|adu| adu.to_ne_bytes()).collect();
    let side = |pixels: usize| u32::try_from(pixels).map_err(|error| WriteError::Png(error.to_string()));
    let (width, height) = (side(frame.width)?, side(frame.height)?);
    let encoded = PngEncoder::new(out).write_image(&samples, width, height, ExtendedColorType::L16);
    encoded.map_err(|error| match error {
        ::image::ImageError::IoError(error) => WriteError::Io(error),
        error => WriteError::Png(error.to_string()),
    })
}

/// The rows of a frame in the wanted order.
pub(super) fn rows(frame: &Frame, order: RowOrder) -> Result<impl Iterator<Item = &[u16]>, WriteError> {
    let (width, height, pixels) = (frame.width, frame.height, frame.pixels.len());
    if width == 0 || height == 0 || width.checked_mul(height) != Some(pixels) {
        return Err(WriteError::Shape { width, height, pixels });
    }
    let flipped = frame.rows != order;
    let row = move |i: usize| if flipped { height - 1 - i } else { i };
    Ok((0..height).filter_map(move |i| frame.pixels.get(row(i) * width..(row(i) + 1) * width)))
}
