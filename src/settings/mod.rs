//! The settings room: schema, layering (flight < custom < command line), ranges and where each value came from.
//!
//! May use nothing of the other rooms. Its public face is [`Settings`] and its sections, and [`Layers`].

mod schema;

pub use schema::*;
