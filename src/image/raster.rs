//! TIFF, PNG and JPEG files, through the `image` crate.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use ::image::codecs::{jpeg::JpegDecoder, png::PngDecoder, tiff::TiffDecoder};
use ::image::{DynamicImage, ImageDecoder, ImageResult, Limits};

use super::read::{Problem, check_size};
use super::{Frame, tiff};
use crate::sky::RowOrder;

/// What a decoder may allocate beside the image itself, and the largest image that is decoded whatever the size of its
/// file, bytes.
const ALLOWANCE: usize = 64 << 20;
/// No more bytes of pixels come out of a byte of file: deflate ends at 1032, and a JPEG's darkest block takes two bits.
const MAX_EXPANSION: usize = 1100;

/// A format that is read by the `image` crate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Tiff,
    Png,
    Jpeg,
}

impl Format {
    /// The format of a file, by its first bytes.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        const FIRST: [(&[u8], Format); 6] = [
            (b"II\x2a\0", Format::Tiff),
            (b"MM\0\x2a", Format::Tiff),
            (b"II\x2b\0", Format::Tiff),
            (b"MM\0\x2b", Format::Tiff),
            (b"\x89PNG\r\n\x1a\n", Format::Png),
            (b"\xff\xd8\xff", Format::Jpeg),
        ];
        FIRST.iter().find(|(first, _)| bytes.starts_with(first)).map(|(_, format)| *format)
    }

    fn name(self) -> &'static str {
        match self {
            Self::Tiff => "TIFF",
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
        }
    }
}

/// Reads the (first) image of a file. Rows are in file order, whatever an orientation tag says.
pub(super) fn read(format: Format, bytes: &[u8]) -> Result<Frame, Problem> {
    // The decoders are not ours: one that panics on a hostile file must end as this file's error.
    let decoded = catch_unwind(AssertUnwindSafe(|| decode(format, bytes)));
    let broken = |_| Err(Problem::Decoder { format: format.name(), message: "the decoder broke on this file".to_owned() });
    let (pixels, full_scale, (width, height)) = decoded.unwrap_or_else(broken).and_then(|image| grey(format, image))?;
    let mut frame = Frame::new(width, height, pixels, RowOrder::TopFirst).ok_or(Problem::Empty)?;
    frame.full_scale = full_scale;
    frame.stamp.exposures = 1;
    Ok(frame)
}

fn decode(format: Format, bytes: &[u8]) -> Result<DynamicImage, Problem> {
    let refused = |error: ::image::ImageError| Problem::Decoder { format: format.name(), message: error.to_string() };
    let file = Cursor::new(bytes);
    let mut limits = Limits::default();
    limits.max_alloc = Some(ALLOWANCE as u64);
    match format {
        Format::Tiff => {
            tiff::check_tags(bytes)?;
            finish(TiffDecoder::new(file), limits, bytes.len())
        }
        Format::Png => finish(PngDecoder::with_limits(file, limits.clone()), limits, bytes.len()),
        Format::Jpeg => {
            // The decoder fills the missing part of a cut file with grey and is content.
            let end = bytes.len() - bytes.iter().rev().take_while(|&&b| b == 0).count();
            if !bytes.get(..end).is_some_and(|bytes| bytes.ends_with(b"\xff\xd9")) {
                return Err(Problem::Decoder { format: format.name(), message: "cut short: no end marker".to_owned() });
            }
            finish(JpegDecoder::new(file), limits, bytes.len())
        }
    }
    .map_err(refused)?
}

/// Decodes once the claimed size has been compared with the file's: outside, the decoder's error; inside, ours.
fn finish(
    decoder: ImageResult<impl ImageDecoder>,
    mut limits: Limits,
    file: usize,
) -> ImageResult<Result<DynamicImage, Problem>> {
    let mut decoder = decoder?;
    let (width, height) = decoder.dimensions();
    if let Err(problem) = check_size(width.into(), height.into()) {
        return Ok(Err(problem));
    }
    // A frame has two bytes a pixel, whatever the file has.
    let decoded = usize::try_from(decoder.total_bytes()).unwrap_or(usize::MAX);
    let claimed = decoded.max((width as usize).saturating_mul(height as usize).saturating_mul(size_of::<u16>()));
    if claimed > ALLOWANCE.max(file.saturating_mul(MAX_EXPANSION)) {
        return Ok(Err(Problem::Bomb { claimed, file }));
    }
    limits.max_alloc = Some((decoded.saturating_add(ALLOWANCE)) as u64);
    decoder.set_limits(limits)?;
    DynamicImage::from_decoder(decoder).map(Ok)
}

/// Pixels, full scale, and width and height of a decoded image.
type Grey = (Vec<u16>, Option<u16>, (usize, usize));

fn grey(format: Format, image: DynamicImage) -> Result<Grey, Problem> {
    let size = (image.width() as usize, image.height() as usize);
    let (pixels, full_scale) = match image {
        DynamicImage::ImageLuma16(image) => (image.into_raw(), None),
        DynamicImage::ImageLuma8(image) => (image.as_raw().iter().map(|&v| v.into()).collect(), Some(255)),
        DynamicImage::ImageLumaA8(image) => (first_of::<2, u8>(image.as_raw()), Some(255)),
        DynamicImage::ImageLumaA16(image) => (first_of::<2, u16>(image.as_raw()), None),
        DynamicImage::ImageRgb8(image) => (luminance::<3, u8>(image.as_raw()), Some(255)),
        DynamicImage::ImageRgba8(image) => (luminance::<4, u8>(image.as_raw()), Some(255)),
        DynamicImage::ImageRgb16(image) => (luminance::<3, u16>(image.as_raw()), None),
        DynamicImage::ImageRgba16(image) => (luminance::<4, u16>(image.as_raw()), None),
        other => {
            let message = format!("pixels are {:?}, expected 8 or 16 bits", other.color());
            return Err(Problem::Decoder { format: format.name(), message });
        }
    };
    Ok((pixels, full_scale, size))
}

/// The first of `N` samples a pixel.
fn first_of<const N: usize, T: Copy + Into<u16>>(samples: &[T]) -> Vec<u16> {
    samples.as_chunks::<N>().0.iter().filter_map(|pixel| pixel.first()).map(|&v| v.into()).collect()
}

/// Luminance of red, green and blue, with the weights of ITU-R BT.709 in ten-thousandths, rounded.
fn luminance<const N: usize, T: Copy + Into<u16>>(samples: &[T]) -> Vec<u16> {
    const WEIGHTS: [u32; 3] = [2126, 7152, 722];
    let weigh = |pixel: &[T; N]| {
        let sum: u32 = pixel.iter().zip(WEIGHTS).map(|(&v, weight)| u32::from(v.into()) * weight).sum();
        ((sum + 5_000) / 10_000) as u16
    };
    samples.as_chunks::<N>().0.iter().map(weigh).collect()
}
