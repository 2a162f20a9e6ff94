//! The simulate room: simulated twins of the outside: the sky renderer, the lens controller and the
//! flight computer.
//!
//! Uses all rooms before it; pure and seeded, no files. Its public face is [`sky`], [`lens`],
//! [`FlightComputer`] and [`brighten`].

mod brightness;
mod flight_computer;
mod judge;
pub mod lens;
pub mod sky;

pub use brightness::brighten;
pub use flight_computer::{FlightComputer, Given};
pub use judge::{COVERED_SIGMA, Judged};
