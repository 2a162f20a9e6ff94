//! The image room: a frame and its stamp, image files in and out, statistics, co-adding, mask, bad pixels, auto-level.
//!
//! Uses `sky` (times, observer) and `settings`. No disk: readers and writers take `Read` and `Write`.

mod frame;

pub use frame::{Frame, ImageCounter, Stamp, TriggerCounter};
