//! The wire room: what goes over TCP between camera and flight computer.
//!
//! A stream is a row of frames (`frame`), each of which carries one message: [`Hello`], [`Refuse`], [`Status`], [`Update`],
//! [`Gyro`], [`Commands`], [`ImageRequest`], [`ImageChunk`] or [`ImageRefusal`]. A body has a **fixed layout**: the same bytes are a `postcard` encoding, a packed little-endian C struct
//! and one Python `struct` format. Each body is declared once, with the name, unit, range and meaning of every field
//! (`body!`), and its [`Table`] comes out of that same declaration; checks, JSON and everything in `proto/` are made from
//! the table, so that none of them can drift apart.
//!
//! [`legacy`] has the structs of the dialect that flew, which are a wire of their own.
//!
//! Pure: bytes in, messages out. Uses `settings`, `sky`, `image`, `solve`, `command` and serde, postcard, bytes and crc.

mod clocks;
mod code;
mod commands;
mod element;
mod frame;
mod gyro;
mod health;
mod hello;
mod image_part;
mod instrument;
mod json;
mod layout;
pub mod legacy;
mod message;
mod refuse;
mod series;
mod status;
#[cfg(test)]
mod tests;
mod times;
mod transfer;
mod triggers;
mod update;

pub use clocks::{Clocks, PeerClock};
pub use code::{Code, Coded};
pub use commands::{CommandReply, CommandSlot, Commands, Control, SLOTS};
pub use element::{Element, I32Le, List, Maybe, Text, U16Le, U32Le};
pub use frame::{MAX_FRAME, OVERHEAD, SYNC};
pub use gyro::{Exposure, Gyro, Rates};
pub use health::{Actor, Found, Health, LastEnd, Shed};
pub use hello::{Hello, MAGIC, Role};
pub use instrument::{Best, Focus, FocusEnding, FocusRange, Lens, WidthEstimate};
pub use layout::{Field, Form, Scalar, Table};
pub use message::{
    Kind, MAX_GARBAGE, Message, PROTOCOL_CURRENT, PROTOCOL_MIN, Reader, WireError, decode_all, schema_hash, tables,
};
pub use refuse::{Refusal, Refuse};
pub use series::{Series, SeriesStart};
pub use status::{EquatorialEstimate, HorizontalEstimate, ObserverPart, Status};
pub use times::Times;
pub use transfer::{CHUNK_BYTES, ImageChunk, ImageForm, ImageRefusal, ImageRequest, NoImage, Wanted};
pub use triggers::Triggers;
pub use update::{
    Authority, Camera, Clock, Corrections, Counters, Equatorial, FrameStatistics, HorizontalPart, Housekeeping, Image, Link,
    Source, Update,
};
