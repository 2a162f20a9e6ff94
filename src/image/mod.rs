//! The image room: a frame and its stamp, image files in and out, statistics, co-adding, mask, bad pixels, auto-level.
//!
//! Uses `sky` (times, observer) and `settings`. No disk: readers and writers take `Read` and `Write`.

mod fits;
mod frame;
mod name;
mod raster;
mod read;

pub use frame::{Frame, ImageCounter, Stamp, TriggerCounter};
pub use name::{series_stem, time_in_name};
pub use read::{Problem, ReadError, read};
