//! The catalogue room: stars, their names, thinning for a camera, and the triangle index.
//!
//! Uses `sky` and `settings`. No disk: [`Catalogue::from_bytes`] takes what the caller read.

mod file;
mod names;

pub use file::{Catalogue, CatalogueError, CatalogueHeader, MAX_FILE_BYTES, Star};
pub use names::{Names, NamesError};
