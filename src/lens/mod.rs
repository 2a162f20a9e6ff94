//! The lens room: where the lens is, and where it should be.
//!
//! Uses the rooms before it; no clock, no port. Its public face is [`FocusCounts`] and the [`autofocus`], a plain state machine to
//! which time comes with each event.

pub mod autofocus;

/// A focus position, encoder counts from the near stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
pub struct FocusCounts(pub i32);
