//! The soak room: the whole service under a seeded schedule of faults, with two flight computers that fail and lie, and an account of
//! all that must not be lost, wrong or run that nobody commanded.
//!
//! It runs in real time, or on a paused clock that jumps from one event to the next, on which eleven days take minutes: frames are
//! rendered, solved and kept as ever, and the time that a solver takes is charged to the clock. Uses all rooms before it. Its public
//! face is [`Plan`], [`fly`] and [`Report`].

mod account;
mod computer;
mod faults;
mod flight;
mod gyros;
mod images;
mod instrument;
mod page;
mod report;
mod resources;
mod schedule;

pub use flight::{Plan, Progress, fly};
pub use report::Report;
pub use resources::Held;
pub use schedule::{Class, Fault, schedule};
