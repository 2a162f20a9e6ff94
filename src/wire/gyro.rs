//! `Gyro`: how the gondola moved during an exposure, for images that are trailed.

use super::element::body;
use super::{List, Maybe, U16Le, U32Le};
use crate::sky::DEG;
use crate::solve::Motion;

/// Exposures and samples that there is room for.
const EXPOSURES: usize = 16;
/// See [`EXPOSURES`].
const SAMPLES: usize = 2048;

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
        exposures: List<Exposure, EXPOSURES> => "";
        /// How many of the samples below there are.
        samples_count: U16Le => "" [0.0, 2048.0];
        /// The samples, evenly spaced from the first.
        samples: List<Rates, SAMPLES> => "";
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

impl Gyro {
    /// The motion of an image by its two counters, its first sample at a time of the sender's own clock; exposures and samples beyond those
    /// that there is room for are left out.
    pub fn new(motion: &Motion, (trigger, image): (u32, u32), start_uptime_s: f64) -> Self {
        let exposure = |&(start, length): &(f64, f64)| Exposure { start_s: start as f32, duration_s: length as f32 };
        let rates = |&(az, el): &(f64, f64)| Rates { az_rate_deg_s: (az / DEG) as f32, el_rate_deg_s: (el / DEG) as f32 };
        let exposures: Vec<Exposure> = motion.exposures.iter().map(exposure).take(EXPOSURES).collect();
        let samples: Vec<Rates> = motion.rates.iter().map(rates).take(SAMPLES).collect();
        Self {
            trigger_counter: trigger.into(),
            image_counter: image.into(),
            start_uptime_s,
            sample_rate_hz: motion.sample_rate_hz,
            elevation_deg: Some(motion.elevation / DEG).into(),
            exposures_count: exposures.len() as u8,
            exposures: List::from_slice(&exposures),
            samples_count: (samples.len() as u16).into(),
            samples: List::from_slice(&samples),
        }
    }
}
