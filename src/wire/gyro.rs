//! `Gyro`: how the gondola moved during an exposure, for images that are trailed.

use super::element::body;
use super::{List, Maybe, U16Le, U32Le};

body! {
    /// Gyro rates over one series of exposures, flight computer to camera, once after each series.
    pub struct Gyro {
        /// The series of triggers, as the flight computer counts them.
        trigger_counter: U32Le => "";
        /// The image that the series makes, as the camera counts them.
        image_counter: U32Le => "";
        /// First sample, on the sender's own clock (`uptime_s` of its status).
        start_uptime_s: f64 => "s" [0.0, 1e10];
        /// Samples per second.
        sample_rate_hz: f64 => "Hz" [0.001, 10000.0];
        /// Elevation of the boresight during the series.
        elevation_deg: Maybe<f64> => "deg" [-90.0, 90.0];
        /// How many of the exposures below there were.
        exposures_count: u8 => "" [0.0, 16.0];
        /// The exposures of the series.
        exposures: List<Exposure, 16> => "";
        /// How many of the samples below there are.
        samples_count: U16Le => "" [0.0, 2048.0];
        /// The samples, evenly spaced from the first.
        samples: List<Rates, 2048> => "";
    }
}

body! {
    /// One exposure of a series.
    pub struct Exposure {
        /// Start after the first sample.
        start_s: f32 => "s" [0.0, 1e6];
        /// Length.
        duration_s: f32 => "s" [0.0, 1e6];
    }
}

body! {
    /// One gyro sample.
    pub struct Rates {
        /// Rate in azimuth about the vertical, growing from north through east; not the rate on the sky, which is smaller by cos(elevation).
        az_rate_deg_s: f32 => "deg/s" [-1000.0, 1000.0];
        /// Rate in elevation, upwards.
        el_rate_deg_s: f32 => "deg/s" [-1000.0, 1000.0];
    }
}
