//! The settings room: schema, layering (flight < custom < command line), ranges and where each value came from.
//!
//! May use nothing of the other rooms. Its public face is [`Settings`] and its sections, and [`Layers`].

mod schema;

pub use schema::*;

/// The flight file that is built into the program: every setting with its flight value.
pub const FLIGHT_TOML: &str = include_str!("../../config/flight.toml");

impl Settings {
    /// The settings of the built-in flight file alone.
    ///
    /// # Errors
    /// Where the built-in file is wrong, which a test excludes.
    pub fn flight() -> Result<Self, toml::de::Error> {
        toml::from_str(FLIGHT_TOML)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_built_in_flight_file_has_every_setting() {
        let settings = Settings::flight().unwrap();
        assert_eq!(settings.solver.matching.min_matched, 5);
        assert_eq!(settings.network.listen, "127.0.0.1:2017");
    }
}
