//! The simulate room: simulated twins of the outside: the sky renderer and the flight computer.
//!
//! Uses all rooms before it; pure and seeded, no files. Its public face is [`sky`] and
//! [`FlightComputer`].

mod flight_computer;
pub mod sky;

pub use flight_computer::{FlightComputer, Given};
