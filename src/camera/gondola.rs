//! The simulated gondola: how it scans while the sky turns, and what its gyros see of that.

use crate::settings::SimulateSettings;
use crate::sky::{Attitude, DEG, Observer, Vec3, precess_from_j2000, wrap_two_pi};
use crate::solve::Motion;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::time::Duration;

/// Samples of the gyros in a second, Hz.
const SAMPLE_RATE_HZ: f64 = 100.0;
/// From the end of an exposure to the start of the next one of its series, s: as long as the camera that flew took to read one out.
const PAUSE_S: f64 = 0.19;

/// A gondola: where it stands and how it moves. All angles in rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gondola {
    /// The observer at the start; the sidereal time comes from the seed, so that another seed sees another sky.
    start: Observer,
    elevation: f64,
    scan_rate: f64,
    scan_amplitude: f64,
    /// How long it was under way before uptimes began, which are told it.
    flown: Duration,
}

impl Gondola {
    /// The gondola that the settings describe.
    pub fn new(settings: &SimulateSettings) -> Self {
        // Multiples of the golden ratio spread seeds over the day evenly.
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        Self {
            start: Observer {
                latitude: settings.latitude_deg * DEG,
                sidereal_time: (settings.seed as f64 * GOLDEN).fract() * TAU,
            },
            elevation: settings.elevation_deg * DEG,
            scan_rate: settings.scan_rate_deg_s * DEG,
            scan_amplitude: settings.scan_amplitude_deg * DEG,
            flown: Duration::ZERO,
        }
    }

    /// The same gondola, whose uptimes began so much later: it does not begin its flight anew where a program does.
    #[must_use]
    pub fn after(self, flown: Duration) -> Self {
        Self { flown: self.flown + flown, ..self }
    }

    /// Latitude, and sidereal time at a time after the start.
    pub fn observer(&self, uptime: Duration) -> Observer {
        self.start.after((self.flown + uptime).as_secs_f64())
    }

    /// Azimuth: to and fro about North at the scan's rate.
    pub fn azimuth(&self, uptime: Duration) -> f64 {
        if self.scan_amplitude <= 0.0 {
            return 0.0;
        }
        let path = (self.scan_rate * (self.flown + uptime).as_secs_f64()).rem_euclid(4.0 * self.scan_amplitude);
        let swing = if path <= 2.0 * self.scan_amplitude { path } else { 4.0 * self.scan_amplitude - path };
        wrap_two_pi(swing - self.scan_amplitude)
    }

    /// The attitude of a camera whose up direction is towards the zenith. `julian_year`: the epoch of date that azimuth and
    /// elevation refer to; `None` takes sidereal time as that of ICRS.
    pub fn attitude(&self, uptime: Duration, julian_year: Option<f64>) -> Option<Attitude> {
        let observer = self.observer(uptime);
        let azimuth = self.azimuth(uptime);
        let to_icrs = |elevation: f64| {
            let of_date = observer.direction_of(azimuth, elevation);
            julian_year.map_or(of_date, |year| precess_from_j2000(year).tr_mul(&of_date))
        };
        Attitude::from_boresight_up(&to_icrs(self.elevation), &to_icrs(self.elevation + FRAC_PI_2))
    }

    /// How gyros without noise see it turn during a series that begins at a time, with the start and the length of each exposure after that, s.
    pub fn motion(&self, begun: Duration, exposures: &[(f64, f64)]) -> Motion {
        let end = exposures.last().map_or(0.0, |(start, length)| start + length);
        let samples = (end * SAMPLE_RATE_HZ).ceil() as u32 + 1;
        let step = Duration::from_secs_f64(1.0 / SAMPLE_RATE_HZ);
        // The zenith as a camera sees it whose up direction is towards it: left, the third axis of turning in elevation, is level.
        let zenith = Vec3::new(0.0, libm::cos(self.elevation), libm::sin(self.elevation));
        let rate = |sample: u32| {
            let middle = begun + step * sample;
            let [from, to] = [middle.saturating_sub(step / 2), middle + step / 2].map(|at| self.attitude(at, None));
            let turn = from.zip(to).map_or_else(Vec3::zeros, |(from, to)| from.turn_to(&to));
            // Gyros see the Earth turn with it.
            (-turn.dot(&zenith) * SAMPLE_RATE_HZ, -turn.x * SAMPLE_RATE_HZ)
        };
        Motion {
            rates: (0..samples).map(rate).collect(),
            sample_rate_hz: SAMPLE_RATE_HZ,
            exposures: exposures.to_vec(),
            elevation: self.elevation,
            roll: 0.0,
            drift: 0.0,
        }
    }
}

/// Start and length of each of so many exposures of one series, after its start, s.
pub fn exposures_of_a_series(count: u8, exposure_s: f64) -> Vec<(f64, f64)> {
    (0..count).map(|place| (f64::from(place) * (exposure_s + PAUSE_S), exposure_s)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use crate::sky::{ARCSEC, horizontal_of, separation};

    fn settings() -> Settings {
        Settings::flight().unwrap()
    }

    #[test]
    fn the_gondola_scans_within_its_limits_and_holds_its_elevation() {
        let settings = settings();
        let gondola = Gondola::new(&settings.simulate);
        let limit = settings.simulate.scan_amplitude_deg * DEG + 1e-9;
        let mut previous = gondola.azimuth(Duration::ZERO);
        for second in 1..600 {
            let uptime = Duration::from_secs(second);
            let azimuth = gondola.azimuth(uptime);
            let from_north = crate::sky::wrap_pi(azimuth);
            assert!(from_north.abs() <= limit, "{second} s: {}°", from_north / DEG);
            let moved = crate::sky::wrap_pi(azimuth - previous).abs();
            assert!(moved <= settings.simulate.scan_rate_deg_s * DEG + 1e-9);
            previous = azimuth;
            let attitude = gondola.attitude(uptime, Some(2027.0)).unwrap();
            let horizontal = horizontal_of(&attitude, &gondola.observer(uptime), Some(2027.0));
            assert!((horizontal.elevation - settings.simulate.elevation_deg * DEG).abs() < 1e-9);
            assert!(crate::sky::wrap_pi(horizontal.azimuth - azimuth).abs() < 1e-9);
            assert!(horizontal.roll.abs() < 1e-9);
        }
    }

    #[test]
    fn a_gondola_that_does_not_scan_sees_the_sky_turn() {
        let still = SimulateSettings { scan_amplitude_deg: 0.0, latitude_deg: 0.0, elevation_deg: 90.0, ..settings().simulate };
        let gondola = Gondola::new(&still);
        let [a, b] = [0, 3600].map(|s| gondola.attitude(Duration::from_secs(s), None).unwrap().boresight());
        assert!((separation(&a, &b) / DEG - 15.041).abs() < 1e-3);
    }

    #[test]
    fn a_gondola_that_was_under_way_is_where_it_would_be_without_a_restart() {
        let gondola = Gondola::new(&settings().simulate);
        let (before, uptime) = (Duration::from_secs(5000), Duration::from_secs(77));
        assert_eq!(gondola.after(before).attitude(uptime, None), gondola.attitude(before + uptime, None));
    }

    #[test]
    fn its_gyros_see_the_turn_from_one_attitude_to_the_other() {
        let gondola = Gondola::new(&settings().simulate);
        let begun = Duration::from_secs(20);
        let exposures = exposures_of_a_series(4, 0.12);
        let motion = gondola.motion(begun, &exposures);
        motion.check(4).unwrap();
        let start = gondola.attitude(begun, None).unwrap();
        for (at, length) in exposures {
            let end = gondola.attitude(begun + Duration::from_secs_f64(at + length), None).unwrap();
            let seen = start.turned(&motion.track().turn_at(at + length));
            // The camera turns about a third axis too, by the sky's turn: no gyro tells that.
            assert!(separation(&seen.boresight(), &end.boresight()) < 3.0 * ARCSEC, "{at} s");
            assert!(separation(&start.boresight(), &end.boresight()) > 600.0 * ARCSEC * (at + length));
        }
    }
}
