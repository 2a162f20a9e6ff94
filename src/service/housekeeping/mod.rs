//! Housekeeping: temperatures, pressure and disk, each read from its sensor, with its age and limits.
//!
//! `sensor` has what is read and how, `actor` reads all of them side by side and tells the hub, `trend` says when the disk is full,
//! `telemetry` puts it into an update, and `gauges` on the display. Here is what the others hold on to: the quantities and what was measured.

mod actor;
mod gauges;
mod sensor;
mod telemetry;
mod trend;

pub use actor::Housekeeper;
pub use gauges::gauges;
pub use sensor::{Sensor, SensorError, sensors};
pub use telemetry::{health, housekeeping};

use crate::settings::{CameraKind, SensorSource, Settings, TemperatureSettings};
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// What is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quantity {
    /// Temperature of the lens, °C.
    TemperatureLens,
    /// Temperature of the computer, °C.
    TemperatureComputer,
    /// Temperature of the vessel, °C.
    TemperatureVessel,
    /// Temperature of the plate, °C.
    TemperaturePlate,
    /// Temperature of the DC-DC converter, °C.
    TemperatureDcdc,
    /// Temperature of the flange, °C.
    TemperatureFlange,
    /// Pressure in the vessel, atm.
    Pressure,
    /// Free space on the disk of the records, GiB.
    DiskFree,
}

/// A value, and when it was asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// In the unit of its quantity.
    pub value: f64,
    /// When it was asked for, so that its age is never told too low.
    pub at: Instant,
}

/// What was measured last.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Measurements {
    /// The last reading of each quantity that was ever read.
    pub readings: BTreeMap<Quantity, Reading>,
    /// Time until the disk is full, days; `None` while it does not fill.
    pub disk_days_left: Option<f64>,
}

/// Where the values of a quantity come from, and its yellow and red limits.
struct Rule<'a> {
    source: &'a SensorSource,
    low: f64,
    high: f64,
    red: (f64, f64),
}

impl Quantity {
    /// All of them.
    pub const ALL: [Self; 8] = [
        Self::TemperatureLens,
        Self::TemperatureComputer,
        Self::TemperatureVessel,
        Self::TemperaturePlate,
        Self::TemperatureDcdc,
        Self::TemperatureFlange,
        Self::Pressure,
        Self::DiskFree,
    ];

    /// Its name in the settings and in an update, without the unit.
    pub fn name(self) -> &'static str {
        match self {
            Self::TemperatureLens => "temperature_lens",
            Self::TemperatureComputer => "temperature_computer",
            Self::TemperatureVessel => "temperature_vessel",
            Self::TemperaturePlate => "temperature_plate",
            Self::TemperatureDcdc => "temperature_dcdc",
            Self::TemperatureFlange => "temperature_flange",
            Self::Pressure => "pressure",
            Self::DiskFree => "disk_free",
        }
    }

    /// Its unit, and what it can be in that unit.
    fn possible(self) -> (&'static str, std::ops::RangeInclusive<f64>) {
        match self {
            Self::Pressure => ("atm", 0.0..=100.0),
            Self::DiskFree => ("GiB", 0.0..=1e9),
            _ => ("°C", -273.15..=1000.0),
        }
    }

    fn rule(self, settings: &Settings) -> Rule<'_> {
        fn temperature(settings: &TemperatureSettings) -> Rule<'_> {
            let red = (settings.red_low_c, settings.red_high_c);
            Rule { source: &settings.source, low: settings.low_c, high: settings.high_c, red }
        }
        let house = &settings.housekeeping;
        match self {
            Self::TemperatureLens => temperature(&house.temperature_lens),
            Self::TemperatureComputer => temperature(&house.temperature_computer),
            Self::TemperatureVessel => temperature(&house.temperature_vessel),
            Self::TemperaturePlate => temperature(&house.temperature_plate),
            Self::TemperatureDcdc => temperature(&house.temperature_dcdc),
            Self::TemperatureFlange => temperature(&house.temperature_flange),
            Self::Pressure => {
                let pressure = &house.pressure;
                let red = (pressure.red_low_atm, pressure.red_high_atm);
                Rule { source: &pressure.source, low: pressure.low_atm, high: pressure.high_atm, red }
            }
            // Always the disk itself.
            Self::DiskFree => {
                let red = (house.disk_red_gib, f64::INFINITY);
                Rule { source: &SensorSource::None, low: house.disk_low_gib, high: f64::INFINITY, red }
            }
        }
    }

    /// Where its values come from, with the choice of `auto` made.
    fn source(self, settings: &Settings) -> &SensorSource {
        match self.rule(settings).source {
            SensorSource::Auto if settings.camera.kind == CameraKind::Sky => &SensorSource::Simulated,
            SensorSource::Auto => &SensorSource::None,
            source => source,
        }
    }
}

/// Whether any value is made up.
pub fn is_simulated(settings: &Settings) -> bool {
    Quantity::ALL.iter().any(|quantity| *quantity.source(settings) == SensorSource::Simulated)
}

/// Reads every sensor of the settings once: its name, and the value with its unit or why there is none. Blocks, and is to be called
/// within a runtime.
pub fn read_once(settings: &Settings) -> Vec<(&'static str, Result<String, SensorError>)> {
    let all = sensors(settings, &CancellationToken::new());
    let read = all.into_iter().map(|(quantity, mut sensor)| {
        let value = sensor.read(Duration::ZERO);
        (quantity.name(), value.map(|value| format!("{value:.1} {}", quantity.possible().0)))
    });
    read.collect()
}

impl Measurements {
    /// A value, where it is not too old to be known.
    pub fn value(&self, quantity: Quantity, now: Instant, settings: &Settings) -> Option<f64> {
        let reading = self.readings.get(&quantity)?;
        let age = now.saturating_duration_since(reading.at);
        (age <= Duration::from_secs_f64(settings.housekeeping.max_age_s)).then_some(reading.value)
    }

    /// Time since a value was read, however old it is, s.
    pub fn age_s(&self, quantity: Quantity, now: Instant) -> Option<f64> {
        self.readings.get(&quantity).map(|reading| now.saturating_duration_since(reading.at).as_secs_f64())
    }

    /// Whether a value is known and outside its limits.
    pub fn is_alarming(&self, quantity: Quantity, now: Instant, settings: &Settings) -> bool {
        let Rule { low, high, .. } = quantity.rule(settings);
        self.value(quantity, now, settings).is_some_and(|value| !(low..=high).contains(&value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_value_is_known_and_may_alarm_until_it_is_too_old_while_its_age_goes_on() {
        let settings = Settings::flight().unwrap();
        let (max_age, house) = (Duration::from_secs_f64(settings.housekeeping.max_age_s), &settings.housekeeping);
        let (low, high) = (house.temperature_lens.low_c, house.temperature_lens.high_c);
        let at = Instant::now();
        let seen = |value| Measurements {
            readings: BTreeMap::from([(Quantity::TemperatureLens, Reading { value, at })]),
            ..Measurements::default()
        };
        for (value, alarming) in [(low - 0.1, true), (low, false), (0.0, false), (high, false), (high + 0.1, true)] {
            let seen = seen(value);
            assert_eq!(seen.value(Quantity::TemperatureLens, at + max_age, &settings), Some(value));
            assert_eq!(seen.is_alarming(Quantity::TemperatureLens, at + max_age, &settings), alarming, "{value}");
            let later = at + max_age + Duration::from_millis(1);
            assert_eq!(seen.value(Quantity::TemperatureLens, later, &settings), None);
            assert!(!seen.is_alarming(Quantity::TemperatureLens, later, &settings));
            assert_eq!(seen.age_s(Quantity::TemperatureLens, later), Some(house.max_age_s + 0.001));
        }
        assert_eq!(seen(1.0).age_s(Quantity::Pressure, at), None);
        assert!(!seen(1.0).is_alarming(Quantity::Pressure, at, &settings));
    }

    #[test]
    fn little_free_space_alarms_and_much_never_does() {
        let settings = Settings::flight().unwrap();
        let at = Instant::now();
        for (free, alarming) in [(0.0, true), (settings.housekeeping.disk_low_gib, false), (1e9, false)] {
            let readings = BTreeMap::from([(Quantity::DiskFree, Reading { value: free, at })]);
            let seen = Measurements { readings, ..Measurements::default() };
            assert_eq!(seen.is_alarming(Quantity::DiskFree, at, &settings), alarming, "{free} GiB");
        }
    }

    #[test]
    fn values_are_made_up_beside_a_simulated_camera_and_nowhere_else_unless_it_is_said() {
        let mut settings = Settings::flight().unwrap();
        assert_eq!(settings.camera.kind, CameraKind::Sky);
        assert!(is_simulated(&settings));
        settings.camera.kind = CameraKind::Directory;
        assert!(!is_simulated(&settings));
        settings.housekeeping.pressure.source = SensorSource::Simulated;
        assert!(is_simulated(&settings));
    }
}
