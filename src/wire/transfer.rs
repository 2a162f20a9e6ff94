//! Images for flight computers that ask: a request, and its one answer. From version 3 on.
//!
//! Each chunk is asked for by itself, so that never more than one is on its way, and a break costs one at most: whoever goes on asks for the
//! byte that comes next.

use super::code::codes;
use super::element::body;
use super::{Coded, List, Maybe, Text, U16Le, U32Le};

/// Bytes of an image that a chunk carries at most: less than half an update, and the first of a view has the sources and the thumbnail.
pub const CHUNK_BYTES: usize = 2048;

/// Which image is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Wanted {
    /// The one with a number.
    Image,
    /// The newest that is kept.
    Newest,
    /// The next one, once it is kept.
    Next,
}

codes!(Wanted {
    1 Image "image",
    2 Newest "newest",
    3 Next "next",
});

/// In which form an image goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageForm {
    /// The FITS file as it is kept.
    Raw,
    /// The packets of the view over a thin link, one after the other.
    View,
}

codes!(ImageForm {
    1 Raw "raw",
    2 View "view",
});

/// Why a request for an image is not met.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum NoImage {
    /// There is no such image yet.
    NeverWas,
    /// It is not on disk: it went to make room, or was never kept.
    NotKept,
    /// It is another file than the one that was begun.
    Changed,
    /// The offset lies at its end or beyond.
    Offset,
    /// The rate is 0.
    Rate,
    /// The number of the image is missing.
    NoNumber,
    /// The disk cannot be read.
    Disk,
    /// Nothing can be made of it in this form.
    Form,
    /// Too many are read at once.
    Busy,
}

codes!(NoImage {
    1 NeverWas "never_was",
    2 NotKept "not_kept",
    3 Changed "changed",
    4 Offset "offset",
    5 Rate "rate",
    6 NoNumber "no_number",
    7 Disk "disk",
    8 Form "form",
    9 Busy "busy",
});

body! {
    /// Asks for a piece of an image, flight computer to camera. It has one answer, a chunk or a refusal; a request that comes before the answer to the one before takes its place.
    pub struct ImageRequest {
        /// Any number; the answer repeats it.
        request: U32Le => "";
        /// Which image.
        wanted: Coded<Wanted> => "";
        /// The start of the camera that numbered the image; where it is not known, the present one.
        camera_boot_id: Maybe<U32Le> => "";
        /// The image, by the camera's number. Of `next`: the last one that the sender has; where it is not known, all that are kept by now.
        image_counter: Maybe<U32Le> => "";
        /// Place of the exposure in its series, 0 for an image that stands alone. Of `next`: that of the last one.
        exposure: u8 => "" [0.0, 15.0];
        /// In which form.
        form: Coded<ImageForm> => "";
        /// First byte that is wanted.
        offset: U32Le => "bytes";
        /// `file_crc32` of the chunks before, so that what goes on is the same file.
        begun_crc32: Maybe<U32Le> => "";
        /// Most bytes of image in a second; the camera's own limit (`images.rate_bytes_s`) holds too.
        rate_bytes_s: U32Le => "bytes/s";
    }
}

body! {
    /// A piece of an image, camera to flight computer.
    pub struct ImageChunk {
        /// Number of the request that it answers.
        request: U32Le => "";
        /// The start of the camera that numbered the image.
        camera_boot_id: U32Le => "";
        /// The image.
        image_counter: U32Le => "";
        /// Place of the exposure in its series.
        exposure: u8 => "" [0.0, 15.0];
        /// How many exposures of the image are on disk.
        exposures: u8 => "" [0.0, 16.0];
        /// In which form.
        form: Coded<ImageForm> => "";
        /// Bytes of the whole.
        total_bytes: U32Le => "bytes";
        /// CRC-32 of the whole (IEEE, as zlib's).
        file_crc32: U32Le => "";
        /// Place of the first byte below in the whole.
        offset: U32Le => "bytes";
        /// How many of the bytes below there are.
        bytes_count: U16Le => "" [0.0, 2048.0];
        /// The bytes.
        bytes: List<u8, 2048> => "";
    }
}

body! {
    /// Why a request for an image is not met, camera to flight computer.
    pub struct ImageRefusal {
        /// Number of the request that it answers.
        request: U32Le => "";
        /// Why.
        no_image: Coded<NoImage> => "";
        /// The reason in words.
        words: Text<96> => "";
    }
}

const _: () = assert!(CHUNK_BYTES == 2048);

impl ImageChunk {
    /// The bytes of the image.
    pub fn bytes(&self) -> &[u8] {
        self.bytes.as_slice().get(..self.bytes_count.get().into()).unwrap_or_default()
    }
}
