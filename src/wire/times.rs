//! What an update says of how well its times are known. From version 3 on.

use super::Maybe;
use super::element::body;

body! {
    /// How well times are known.
    pub struct Times {
        /// One standard deviation of the camera computer's clock.
        clock_sigma_s: Maybe<f64> => "s" [0.0, 1e11];
        /// One standard deviation of the middle of the last image's exposure, as UTC.
        captured_sigma_s: Maybe<f64> => "s" [0.0, 1e11];
        /// The same middle as uptime of the camera program, which no clock that is set changes.
        captured_uptime_s: Maybe<f64> => "s" [0.0, 1e10];
    }
}
