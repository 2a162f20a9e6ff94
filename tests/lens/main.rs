//! The lens: what it is asked ends in the right known position, or in one that is unknown for a reason, whatever the controller
//! does; and it becomes known again by itself.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a test may fail by panicking"
)]

mod actor;
mod control;
mod world;
