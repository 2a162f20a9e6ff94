//! The catalogue room: stars, their names, thinning for a camera, and the triangle index.
//!
//! Uses `sky` and `settings`. No disk: [`Catalogue::from_bytes`] takes what the caller read. For one camera the catalogue becomes a
//! [`Field`]: [`FieldStars`] (moved to the epoch, close pairs merged, ranked), [`TriangleIndex`] (shapes to look up) and [`SkyBitmap`]
//! (to screen candidates with). That takes a second or two; [`Field::save`] and [`Field::load`] keep it under its [`FieldKey`].

mod bitmap;
mod cache;
mod field;
mod file;
mod grid;
mod key;
mod names;
mod pace;
mod pages;
mod sky_field;
mod triangles;

pub use bitmap::{POINTS, SkyBitmap};
pub use cache::{FILE_PREFIX, FieldFileError, MAX_FIELD_BYTES};
pub use field::{FieldGeometry, FieldStar, FieldStars, rank_limit};
pub use file::{Catalogue, CatalogueError, CatalogueHeader, MAX_FILE_BYTES, Star};
pub use grid::SkyGrid;
pub use key::{Density, FieldKey};
pub use names::{Names, NamesError};
pub use pace::Pace;
pub use sky_field::Field;
pub use triangles::{FoundTriangle, Runs, TriangleIndex, TriangleQuery, shape};
