//! How the flight computers' clocks stand against the camera's, and so against each other. From version 3 on.

use super::List;
use super::element::body;
use crate::sky::ClockOffset;

/// Flight computers that may be connected.
const COMPUTERS: usize = 2;

body! {
    /// How the clocks of the connected flight computers stand against the camera's.
    pub struct Clocks {
        /// How many of the clocks below are known.
        clocks_count: u8 => "" [0.0, 2.0];
        /// The clocks.
        clocks: List<PeerClock, 2> => "";
    }
}

body! {
    /// One computer's clock.
    pub struct PeerClock {
        /// Whose, by the `id` of its hello.
        flight_computer: u8 => "" [0.0, 255.0];
        /// Its clock minus the camera's, by the soonest of its statuses of the last minute: what every status takes is in it.
        offset_s: f64 => "s" [-1e11, 1e11];
        /// What its statuses usually take longer than the soonest.
        sigma_s: f64 => "s" [0.0, 1e11];
        /// Age of the last of them.
        age_s: f64 => "s" [0.0, 1e10];
    }
}

impl Clocks {
    /// Of computers, by their numbers; more than there is room for are left out.
    pub fn new(offsets: impl Iterator<Item = (u8, ClockOffset)>) -> Self {
        let clock = |(flight_computer, offset): (u8, ClockOffset)| PeerClock {
            flight_computer,
            offset_s: offset.offset_s,
            sigma_s: offset.sigma_s,
            age_s: offset.age.as_secs_f64(),
        };
        let clocks: Vec<PeerClock> = offsets.take(COMPUTERS).map(clock).collect();
        Self { clocks_count: clocks.len() as u8, clocks: List::from_slice(&clocks) }
    }
}
