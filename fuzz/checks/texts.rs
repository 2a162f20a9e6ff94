//! Texts that people or other programs write: commands, keys, sensors, times in names. What is read can be written, and reads the same.

use stars::command::{Command, Key, parse_order};
use stars::image::{series_stem, time_in_name};
use stars::settings::{SensorSource, parse_span};

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(command) = Command::parse(text) {
        assert_eq!(Command::parse(&command.to_string()).expect("what was written can be read"), command);
    }
    let _ = parse_order(text);
    let _ = Key::parse(text);
    let _ = SensorSource::parse(text);
    let _ = parse_span(text);
    if let Some(time) = time_in_name(text) {
        assert!(time.unix_s().is_finite());
    }
    if let Some((stem, _)) = series_stem(text) {
        assert!(text.starts_with(stem));
    }
}
