//! The simulate room: simulated twins of the outside: the sky renderer, the lens controller, the
//! flight computer, its gyros and a thin link.
//!
//! Uses all rooms before it; pure and seeded, no files. Its public face is [`sky`], [`lens`],
//! [`FlightComputer`], [`measured`], [`ThinLink`] and [`brighten`].

mod brightness;
mod flight_computer;
mod gyros;
mod judge;
pub mod lens;
pub mod sky;
mod thin_link;

pub use brightness::brighten;
pub use flight_computer::{FlightComputer, Given};
pub use gyros::measured;
pub use judge::{COVERED_SIGMA, Judged};
pub use thin_link::ThinLink;
