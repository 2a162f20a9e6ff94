//! The sources room: finds stars in a frame, and measures where they are and how surely.
//!
//! One search at one scale: clip lone hot pixels → level and smooth → peaks → how each stands against its surroundings → shape of the
//! frame's point spread function → centroids. [`Finder::find`] does it; scale 0 is the picture itself, each further one has half
//! the resolution and so a kernel twice as wide, for pictures out of focus. Uses `image` and `settings`.

mod blur;
mod centroid;
mod finder;
mod kernel;
mod light;
mod lines;
mod measure;
mod motion;
mod peaks;
mod plane;
mod survey;
mod trails;

pub use blur::Figure;
pub use finder::{Finder, Look, Source};
pub use kernel::SearchKernel;
pub use light::{KnownStar, Light, PIECE_SHARE, PlacedStar, REACH_PX};
pub use motion::{Stretch, Trail, Trailed, light_along, shares_along};
