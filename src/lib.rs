//! `stars`: the program on a star camera's own computer.
//!
//! It takes images of the daytime sky, finds the stars in them, works out the pointing with no prior knowledge, and
//! serves it to two flight computers. The rooms below are listed in the order in which a room may use others: only those
//! above it. Everything before `camera` is pure: no runtime, no clock, no disk, no sockets.

pub mod calibrate;
pub mod camera;
pub mod catalog;
pub mod cli;
pub mod command;
pub mod display;
pub mod image;
pub mod journal;
pub mod lens;
pub mod service;
pub mod settings;
pub mod simulate;
pub mod sky;
pub mod soak;
pub mod solve;
pub mod sources;
pub mod wire;
