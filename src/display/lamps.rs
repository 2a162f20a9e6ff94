//! The requirements as lamps: each with its value, its limit, and whether it holds.

use crate::settings::{AngleRange, Settings};
use crate::sky::{ARCSEC, DEG, direction, separation, wrap_two_pi};
use crate::solve::{Prior, Solution};
use serde::Serialize;

/// How a requirement stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LampState {
    /// It is not required.
    Off,
    /// It is required, and there is nothing to judge.
    Waiting,
    /// It holds.
    Holds,
    /// It does not hold.
    Fails,
}

/// A requirement with its value and limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lamp {
    /// Its name in the settings.
    pub name: &'static str,
    /// How it stands.
    pub state: LampState,
    /// The value, in the unit below; null where there is none.
    pub value: Option<f64>,
    /// Least value allowed; null where there is no such end.
    pub low: Option<f64>,
    /// Greatest value allowed.
    pub high: Option<f64>,
    /// Unit of all three.
    pub unit: &'static str,
}

impl Lamp {
    fn new(
        name: &'static str,
        enabled: bool,
        value: Option<f64>,
        (low, high): (Option<f64>, Option<f64>),
        unit: &'static str,
    ) -> Self {
        let above = |value: f64| low.is_none_or(|low| value >= low) && high.is_none_or(|high| value <= high);
        Self::judged(name, enabled, value, (low, high), unit, above)
    }

    fn judged(
        name: &'static str,
        enabled: bool,
        value: Option<f64>,
        (low, high): (Option<f64>, Option<f64>),
        unit: &'static str,
        holds: impl Fn(f64) -> bool,
    ) -> Self {
        let state = match value {
            _ if !enabled => LampState::Off,
            None => LampState::Waiting,
            Some(value) if holds(value) => LampState::Holds,
            Some(_) => LampState::Fails,
        };
        Self { name, state, value: value.filter(|value| value.is_finite()), low, high, unit }
    }

    /// A range of angles that may go through a full turn, deg.
    fn angle(name: &'static str, range: &AngleRange, value: Option<f64>) -> Self {
        let (min, max) = (range.min_deg, range.max_deg);
        // As the solver has it: from the lower end upwards to the upper end.
        let holds = |value: f64| {
            let above = wrap_two_pi((value - min) * DEG);
            above <= (max - min) * DEG || std::f64::consts::TAU - above < 1e-12
        };
        Self::judged(name, range.enabled, value, (Some(min), Some(max)), "deg", holds)
    }
}

/// All requirements, for a solution or a candidate that was refused; without one they wait.
pub fn lamps(solution: Option<&Solution>, prior: &Prior, settings: &Settings) -> Vec<Lamp> {
    let (limits, matching) = (&settings.solver.requirements, &settings.solver.matching);
    let horizontal = solution.and_then(|solution| solution.horizontal).map(|horizontal| horizontal.pointing);
    let (eq, hor) = (&limits.equatorial_location, &limits.horizontal_location);
    let (ra, dec) = prior.equatorial.unwrap_or((eq.ra_deg * DEG, eq.dec_deg * DEG));
    let (az, el) = prior.horizontal.unwrap_or((hor.az_deg * DEG, hor.el_deg * DEG));
    let from_estimate = solution.map(|solution| separation(&direction(ra, dec), &solution.attitude.boresight()) / DEG);
    let from_horizontal = horizontal.map(|at| separation(&direction(az, el), &direction(at.azimuth, at.elevation)) / DEG);
    let roll = solution.map(|solution| solution.attitude.angles().2 / DEG);
    let sigmas = solution.map(|solution| solution.sigmas() / ARCSEC);
    let below = |high: f64| (None, Some(high));
    vec![
        Lamp::new("horizontal_location", hor.enabled, from_horizontal, below(hor.radius_deg), "deg"),
        Lamp::angle("horizontal_roll", &limits.horizontal_roll, horizontal.map(|at| at.roll / DEG)),
        Lamp::angle("elevation", &limits.elevation, horizontal.map(|at| at.elevation / DEG)),
        Lamp::new("equatorial_location", eq.enabled, from_estimate, below(eq.radius_deg), "deg"),
        Lamp::angle("equatorial_roll", &limits.equatorial_roll, roll),
        Lamp::new(
            "platescale",
            true,
            solution.map(|solution| solution.platescale / ARCSEC),
            (Some(matching.platescale_min_arcsec_px), Some(matching.platescale_max_arcsec_px)),
            "arcsec/px",
        ),
        Lamp::new(
            "pointing_error",
            true,
            sigmas.map(|sigmas| 0.5 * (sigmas.x + sigmas.y)),
            below(limits.pointing_error_max_arcsec),
            "arcsec",
        ),
        Lamp::new("fit_error", true, solution.map(|solution| solution.rms_px), below(limits.fit_error_max_px), "px"),
        Lamp::new(
            "min_matched",
            true,
            solution.map(|solution| solution.matches.len() as f64),
            (Some(f64::from(matching.min_matched)), None),
            "sources",
        ),
        Lamp::new(
            "max_false_probability",
            true,
            solution.map(|solution| solution.false_probability_log10),
            below(matching.max_false_probability_log10),
            "log10",
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::outcome;
    use super::*;
    use crate::solve::Reason;

    fn of(solution: Option<&Solution>, settings: &Settings) -> Vec<(&'static str, LampState)> {
        lamps(solution, &Prior::default(), settings).into_iter().map(|lamp| (lamp.name, lamp.state)).collect()
    }

    #[test]
    fn a_requirement_that_fails_is_the_one_whose_value_is_outside_its_limit() {
        let mut settings = Settings::flight().unwrap();
        let solution = outcome(Reason::Solved).0.solution.unwrap();
        let state = |settings: &Settings, name| of(Some(&solution), settings).into_iter().find(|lamp| lamp.0 == name).unwrap().1;
        assert_eq!(state(&settings, "fit_error"), LampState::Holds);
        settings.solver.requirements.fit_error_max_px = 0.05;
        assert_eq!(state(&settings, "fit_error"), LampState::Fails);
        assert_eq!(state(&settings, "min_matched"), LampState::Fails, "one of it is matched");
        settings.solver.requirements.equatorial_location.enabled = true;
        settings.solver.requirements.equatorial_location.radius_deg = 1.0;
        (settings.solver.requirements.equatorial_location.ra_deg, settings.solver.requirements.equatorial_location.dec_deg) =
            (1.0 / DEG, 0.5 / DEG);
        assert_eq!(state(&settings, "equatorial_location"), LampState::Holds);
        settings.solver.requirements.equatorial_location.dec_deg += 2.0;
        assert_eq!(state(&settings, "equatorial_location"), LampState::Fails);
    }

    #[test]
    fn a_range_of_roll_may_go_through_a_full_turn() {
        let range = AngleRange { enabled: true, min_deg: 170.0, max_deg: 190.0 };
        for (value, state) in [(-175.0, LampState::Holds), (170.0, LampState::Holds), (-165.0, LampState::Fails)] {
            assert_eq!(Lamp::angle("equatorial_roll", &range, Some(value)).state, state, "{value}");
        }
    }

    #[test]
    fn without_a_pointing_what_is_required_waits_and_what_is_not_is_off() {
        let settings = Settings::flight().unwrap();
        for (name, state) in of(None, &settings) {
            let enabled = match name {
                "horizontal_location" => settings.solver.requirements.horizontal_location.enabled,
                "horizontal_roll" => settings.solver.requirements.horizontal_roll.enabled,
                "elevation" => settings.solver.requirements.elevation.enabled,
                "equatorial_location" => settings.solver.requirements.equatorial_location.enabled,
                "equatorial_roll" => settings.solver.requirements.equatorial_roll.enabled,
                _ => true,
            };
            assert_eq!(state == LampState::Off, !enabled, "{name}");
            assert!(!enabled || state == LampState::Waiting, "{name}");
        }
    }
}
