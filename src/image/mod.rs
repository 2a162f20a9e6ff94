//! The image room: a frame and its stamp, image files in and out, statistics, co-adding, mask, bad pixels, auto-level.
//!
//! Uses `sky` (times, observer) and `settings`. No disk: readers take bytes, writers take `Write`.
//!
//! * [`read()`] a file of any kind into a [`Frame`]; [`write_fits`] and [`write_png`] write one; [`checksum_holds`] judges one;
//! * [`series_stem`] and [`time_in_name`] say what a file's name tells; [`coadd()`] adds up a [`Series`];
//! * [`Shelf`] says which of the images that are kept go when there is no room for more;
//! * [`BadPixels`] and [`Mask`] take away what cannot be believed;
//! * [`CellStatistics`] say how bright, noisy and saturated an image is;
//! * [`auto_level`] and [`to_grey8`] make an image visible; [`view`] sends it over a thin link.

mod bad_pixels;
mod cell;
mod coadd;
mod fits;
mod frame;
mod level;
mod mask;
mod name;
mod raster;
mod read;
mod series;
mod shelf;
mod statistics;
mod tiff;
pub mod view;
mod write;

pub use bad_pixels::{BadPixels, BadPixelsError};
pub use coadd::{CoaddError, MAX_PARTS, coadd};
pub use fits::{Keyword, KeywordValue, checksum_holds};
pub use frame::{ExposedBy, Frame, ImageCounter, Stamp, TriggerCounter};
pub use level::{Level, LevelMeter, auto_level, to_grey8};
pub use mask::{Mask, MaskError};
pub use name::{series_stem, time_in_name};
pub use read::{Problem, ReadError, read};
pub use series::Series;
pub use shelf::{Shelf, Shelved};
pub use statistics::{CELL_PX, CellStatistics};
pub use write::{WriteError, write_fits, write_png};
