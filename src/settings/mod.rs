//! The settings room: schema, layering (flight < custom < calibration < command line), ranges and where each value came from.
//!
//! Texts go in, checked settings come out; reading files is the command line's. A value that this room let through is of its
//! type, in its range, finite, and in accord with the others, so nobody checks it again. May use nothing of the other rooms.
//!
//! Its public face: [`Settings`] and its sections; [`Layers`], which loads them, and [`Loaded`], which knows where each value
//! came from; [`review`], the pre-flight review; [`parse_span`] for times such as `40s`.
//!
//! A new setting is three lines: in the schema, in the flight file and in the ranges. Tests hold the three to each other.

mod error;
mod layers;
mod near;
mod preflight;
mod ranges;
mod relations;
mod schema;
mod sensor;
mod span;
#[cfg(test)]
mod tests;
mod text;

pub use error::{Layer, Origin, Problem, SettingsError};
pub use layers::{FLIGHT_TOML, Layers, Loaded, Setting};
pub use preflight::{Finding, NO_ARAVIS, Review, review};
pub use ranges::PER_CAMERA;
pub use schema::*;
pub use sensor::SensorSource;
pub use span::parse_span;
pub use text::MAX_TEXT_BYTES;

impl Settings {
    /// The settings of the built-in flight file alone.
    ///
    /// # Errors
    /// Where the built-in file is wrong, which a test excludes.
    pub fn flight() -> Result<Self, SettingsError> {
        Ok(Layers::embedded().load()?.settings)
    }

    /// All of them as the text of a flight file, from which they are read again to the last bit.
    pub fn to_toml(&self) -> String {
        // Settings are plain structs with text keys, so that nothing of them has no place in TOML.
        toml::to_string(self).unwrap_or_default()
    }

    /// How many settings have another value in `other`.
    pub fn differences(&self, other: &Self) -> u16 {
        fn count(a: &serde_json::Value, b: &serde_json::Value) -> u16 {
            match (a, b) {
                (serde_json::Value::Object(a), serde_json::Value::Object(b)) => {
                    a.iter().map(|(key, value)| b.get(key).map_or(1, |other| count(value, other))).sum()
                }
                (a, b) => u16::from(a != b),
            }
        }
        let json = |settings: &Self| serde_json::to_value(settings).unwrap_or_default();
        count(&json(self), &json(other))
    }

    /// A number by which two programs can tell whether they run with the same settings: CRC-64/XZ of their JSON.
    /// The same settings give the same number wherever they came from and on every machine.
    pub fn fingerprint(&self) -> u64 {
        // Settings are plain structs with text keys, so their JSON cannot fail; nothing in the program relies on it either.
        let json = serde_json::to_vec(self).unwrap_or_default();
        crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(&json)
    }
}
