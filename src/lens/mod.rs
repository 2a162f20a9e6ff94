//! The lens room: what the lens is asked, the controller's language, and the state machine that knows at each moment where
//! the lens is or says that it doesn't.
//!
//! Uses settings, image, solve and the command room's [`Tick`](crate::command::Tick); pure, time comes in with each event. Its public face is
//! [`LensCommand`] with its [`LensResult`], the [`LensState`], [`Control`], which speaks with the controller in [`Word`]s, and the
//! [`autofocus`].

pub mod autofocus;
mod control;
mod language;
mod request;
mod rules;
mod state;

pub use control::{Action, Control, Event};
pub use language::{Misread, Reply, Word};
pub use request::{AperturePosition, FocusCounts, LensCommand, LensError, LensResult, RequestCounter};
pub use rules::Rules;
pub use state::{Doubt, FocusKept, Known, LensState};
