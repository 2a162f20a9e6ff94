//! The legacy dialect: the packed structs of protocol version 3 of the program that flew, as a flight program of old sends and
//! reads them.
//!
//! No frames, no checksum: on a connection [`Block`]s of 2580 bytes come one after the other, and [`Answer`]s of 1004 bytes go.
//! Little-endian, members of a C struct with 4-byte packing; what lies between them is padding. Both are read and written by the
//! offsets of the structs, which `proto/legacy.h` has as C.
//!
//! Values go out as they flew: radians, the equatorial roll with the other sign, σ of right ascension and azimuth as angles of
//! those coordinates instead of on the sky, −1 for what is not known.

mod answer;
mod block;
mod bytes;
mod motion;
mod served;

pub use answer::{Answer, Blob, MAX_BLOBS, Variables};
pub use block::{Block, BlockError};
pub use motion::{Recorded, Step};
pub use served::Picture;

/// The protocol's version, the last member of both structs.
pub const VERSION: u32 = 3;
/// Bytes of what a flight computer sends.
pub const BLOCK_BYTES: usize = 2580;
/// Bytes of what it is sent.
pub const ANSWER_BYTES: usize = 1004;
