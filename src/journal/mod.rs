//! The journal room: every input of the core's machines as it came, written so that all of it can be run again.
//!
//! An [`Entry`] is one event at one machine, with the time that the machine was told and a mark of what it answered; a frame stands
//! there by its name and the checksum of its pixels ([`Solved`]), with all else that its solving began from and with where a stop struck.
//! [`Writer`] and [`Reader`] make records of entries and find them again, whatever tore the file. [`Machines`] runs the entries of the
//! machines without pixels again; frames need a solver and their pixels, which whoever drives the replay brings along, and
//! [`Tracking`] tells what was known of each beforehand. Uses the rooms before it; no clock, no disk.

mod entry;
mod machines;
mod outcome;
mod record;
mod tracking;

pub use entry::{Begin, Entry, Exposure, Solved, Text, What};
pub use machines::{Machine, Machines, Seen};
pub use outcome::{OutcomeMark, mark, pixel_sum};
pub use record::{Reader, Writer};
pub use tracking::Tracking;
