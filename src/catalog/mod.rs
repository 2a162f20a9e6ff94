//! The catalogue room: stars, their names, thinning for a camera, and the triangle index.
//!
//! Uses `sky` and `settings`. No disk: [`Catalogue::from_bytes`] takes what the caller read. For one camera the catalogue becomes a
//! [`Field`]: [`FieldStars`] (moved to the epoch, close pairs merged, ranked), [`TriangleIndex`] (shapes to look up) and [`SkyBitmap`]
//! (to screen candidates with). All of it is derived at start, in under two seconds, so nothing of it is kept on disk.

mod bitmap;
mod field;
mod file;
mod grid;
mod names;
mod sky_field;
mod triangles;

pub use bitmap::{POINTS, SkyBitmap};
pub use field::{FieldGeometry, FieldStar, FieldStars, field_rank, rank_limit};
pub use file::{Catalogue, CatalogueError, CatalogueHeader, MAX_FILE_BYTES, Star};
pub use grid::SkyGrid;
pub use names::{Names, NamesError};
pub use sky_field::Field;
pub use triangles::{FoundTriangle, Runs, TriangleIndex, TriangleQuery, shape};
