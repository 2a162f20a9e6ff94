//! The calibrate room: what the solved frames of a night or a flight say of the camera itself.
//!
//! [`fn@lens`] has plate scale and distortion that all frames have in common, and whether distortion is warranted; [`HotPixels`] those pixels
//! that stand above their neighbours wherever the camera looks; [`fn@offset`] how a second camera is turned against it. [`Calibration`]
//! writes them as settings, and [`guard`] says whether such settings may be put in force. Texts and frames come in; no disk, no clock.

mod fragment;
mod hot_pixels;
mod lens;
mod offset;

pub use fragment::{Calibration, FragmentError, GuardError, guard, list_of, list_text, seal, sealed, with_list};
pub use hot_pixels::{HotPixels, SkyStands, has_moved};
pub use lens::{Lens, Refusal, Solved, lens};
pub use offset::{Offset, OffsetError, offset};
