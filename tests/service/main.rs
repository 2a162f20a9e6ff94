//! The service as a whole: what it promises to two flight computers, whatever the solver, the camera, the disk or the other
//! peer may do. Time is paused where no real socket and no solver is needed.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a test may fail by panicking"
)]
#![allow(clippy::disallowed_methods, reason = "real sockets and processes are asked by the wall clock")]

mod actors;
mod commands;
mod disk;
mod display;
mod housekeeping;
mod images;
mod light;
mod motion;
mod program;
mod records;
mod replay;
mod sessions;
mod support;
mod time;
mod transfer;
mod triggers;
