//! The image room: a frame and its stamp, image files in and out, statistics, co-adding, mask, bad pixels, auto-level.
//!
//! Uses `sky` (times, observer) and `settings`. No disk: readers and writers take `Read` and `Write`.

mod bad_pixels;
mod fits;
mod frame;
mod level;
mod mask;
mod name;
mod raster;
mod read;
mod statistics;

pub use bad_pixels::{BadPixels, BadPixelsError};
pub use frame::{Frame, ImageCounter, Stamp, TriggerCounter};
pub use level::{Level, auto_level, to_grey8};
pub use mask::{Mask, MaskError};
pub use name::{series_stem, time_in_name};
pub use read::{Problem, ReadError, read};
pub use statistics::{CELL_PX, CellStatistics};
