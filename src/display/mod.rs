//! The display room: what operators see of the camera, and the tools that they use on it.
//!
//! All of it is pure. [`Snapshot`] is the state as the page, `stars watch` and programs read it; [`FrameView`] is one frame with all that
//! is shown of it; [`draw()`] draws that frame as a picture; [`text_page`] and [`ten_lines`] are the same for a terminal and for a link of
//! 9600 baud; [`FixedSources`] proposes a mask. The page itself is text that a browser reads ([`page()`], [`MASK_TOOL`]). The service
//! fills these in and serves them (`service/display`).
//!
//! The page shows, and prepares commands; only flight computers send them.

mod draw;
mod font;
mod frame;
mod lamps;
mod mask;
mod page;
mod state;
mod text;
mod words;

pub use draw::{draw, encode};
pub use frame::{FrameView, Geometry, MaskView, SourceFate};
pub use lamps::{Lamp, lamps};
pub use mask::{FixedSources, Proposal};
pub use page::{MASK_TOOL, page};
pub use state::{
    CameraPart, ChargePart, CommandPart, CommandsPart, Concern, CountersPart, DiskPart, FocusPart, FocusPoint, FrameMark, Gauge,
    LensPart, Limits, LinkPart, LookPart, RestartPart, SimulatedPart, Snapshot, TimePart,
};
pub use text::{ten_lines, text_page};
pub use words::{dms, hms, reason};
