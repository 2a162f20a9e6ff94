//! The 34 commands of the legacy dialect, and which of ours each is.
//!
//! Their values come in radians and radians per pixel, and go on in our units. A value that ours has no place for is left out
//! where the command means the same without it, and refuses the command where it does not; the interface control document says
//! which is which.

use super::super::definition::MAX_VALUES;
use super::{COMMANDS, Values};
use crate::sky::{ARCSEC, DEG};

/// A command of the dialect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Flown {
    /// What the program that flew calls it.
    pub name: &'static str,
    /// The number of ours that it is; the first, where it is two.
    pub code: u8,
    /// How many values it has in a block, in the order of the block.
    pub values: usize,
}

const fn flown(name: &'static str, code: u8, values: usize) -> Flown {
    Flown { name, code, values }
}

/// Every command, in the order of the wire.
pub const FLOWN: [Flown; COMMANDS] = [
    flown("quit", 1, 0),
    flown("shutdown", 2, 2),
    flown("network_reset", 3, 3),
    flown("main_settings", 7, 5),
    flown("display_zoom", 8, 3),
    flown("image_client", 9, 1),
    flown("multi_triggering", 10, 1),
    flown("motion_psf", 65, 3),
    flown("flush_birger", 20, 0),
    flown("init_focus", 21, 0),
    flown("get_focus", 22, 0),
    flown("set_focus", 23, 1),
    flown("set_focus_incremental", 24, 1),
    flown("run_autofocus", 40, 0),
    flown("set_autofocus_range", 41, 3),
    flown("abort_autofocus", 42, 1),
    flown("autofocus_display_mode", 44, 1),
    flown("init_aperture", 25, 0),
    flown("get_aperture", 26, 0),
    flown("set_aperture", 27, 1),
    flown("get_gain", 11, 0),
    flown("set_gain", 12, 1),
    flown("brightness", 13, 5),
    flown("solver_general", 60, 2),
    flown("solver_abort", 61, 0),
    flown("solver_mask", 62, 4),
    flown("solver_blob_finder", 63, 4),
    flown("solver_blob_cells", 64, 2),
    flown("solver_pattern_matcher", 66, 7),
    flown("solver_filter_hor_location", 80, 2),
    flown("solver_filter_hor_roll", 81, 3),
    flown("solver_filter_hor_el", 82, 3),
    flown("solver_filter_eq_location", 83, 2),
    flown("solver_filter_matching", 85, 3),
];

/// What a command of the dialect means here.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Meaning {
    /// One of our commands, its values not yet checked.
    Ours {
        /// Its number.
        code: u8,
        /// Its values, zeros after them.
        values: [f64; MAX_VALUES],
    },
    /// Nothing that can be said with ours, and why.
    Nothing(&'static str),
}

/// Numbers of our commands that the dialect says in another way than value by value.
const SHUT_DOWN: u8 = 2;
const RESET_NETWORK: u8 = 3;
const SET_NETWORK_LULL: u8 = 4;
const USE_MOTION: u8 = 65;
const FIND_SOURCES: u8 = 63;
const MATCH_STARS: u8 = 66;
const HORIZONTAL_LOCATION: u8 = 80;
const HORIZONTAL_ROLL: u8 = 81;
const ELEVATION: u8 = 82;
const EQUATORIAL_LOCATION: u8 = 83;
const MATCHING: u8 = 85;
/// What our commands take as the radius of a requirement, deg.
const RADIUS_DEG: (f64, f64) = (0.1, 180.0);

/// What the command at a place means, with the values as they stand in the block: one command of ours, or two.
pub fn meanings(index: usize, values: &Values) -> Vec<Meaning> {
    let Some(flown) = FLOWN.get(index) else { return vec![Meaning::Nothing("no such command")] };
    let ours = |values: &[f64]| vec![Meaning::ours(flown.code, values)];
    let [v0, v1, v2, v3, v4, v5, ..] = values.0;
    match flown.code {
        SHUT_DOWN if v0 != 1.0 => vec![Meaning::Nothing("shutdown_now is not set")],
        SHUT_DOWN => ours(&[v1]),
        RESET_NETWORK => {
            let reset = (v0 == 1.0).then(|| Meaning::ours(RESET_NETWORK, &[]));
            reset.into_iter().chain([Meaning::ours(SET_NETWORK_LULL, &[v1, v2])]).collect()
        }
        USE_MOTION => ours(&[v0]),
        FIND_SOURCES => ours(&[v0, v1, v2]),
        MATCH_STARS if v5 != 0.0 => vec![Meaning::Nothing("the plate scale is always fitted: give it a narrow range instead")],
        MATCH_STARS => ours(&[v0, v2, tidy(v3 / ARCSEC), tidy(v4 / ARCSEC)]),
        HORIZONTAL_LOCATION | EQUATORIAL_LOCATION => ours(&[v0, radius_deg(v0, v1)]),
        HORIZONTAL_ROLL | ELEVATION => ours(&[v0, tidy(v1 / DEG), tidy(v2 / DEG)]),
        MATCHING => ours(&[tidy(v0 / ARCSEC), v1, v2]),
        _ => ours(values.0.get(..flown.values).unwrap_or_default()),
    }
}

impl Meaning {
    fn ours(code: u8, given: &[f64]) -> Self {
        let mut values = [0.0; MAX_VALUES];
        values.iter_mut().zip(given).for_each(|(to, from)| *to = *from);
        Self::Ours { code, values }
    }
}

/// A radius in degrees. The flight program's own start at 3 and 30 rad, so that one which is not required is brought into range.
fn radius_deg(required: f64, radius: f64) -> f64 {
    let degrees = tidy(radius / DEG);
    if required == 0.0 && degrees.is_finite() { degrees.clamp(RADIUS_DEG.0, RADIUS_DEG.1) } else { degrees }
}

/// Without the last digits, which two conversions leave: 30.000000000000004° is 30°.
fn tidy(value: f64) -> f64 {
    const DIGITS: f64 = 1e9;
    (value * DIGITS).round() / DIGITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{Command, Definition};

    fn values(given: &[f64]) -> Values {
        let mut values = Values::default();
        values.0[..given.len()].copy_from_slice(given);
        values
    }

    fn index(name: &str) -> usize {
        FLOWN.iter().position(|flown| flown.name == name).unwrap()
    }

    fn said(name: &str, given: &[f64]) -> Vec<String> {
        let said = |meaning: &Meaning| match meaning {
            Meaning::Ours { code, values } => match Command::from_wire(*code, values) {
                Ok(command) => command.to_string(),
                Err(error) => error.to_string(),
            },
            Meaning::Nothing(why) => (*why).to_owned(),
        };
        assert_eq!(given.len(), FLOWN[index(name)].values, "{name}");
        meanings(index(name), &values(given)).iter().map(said).collect()
    }

    #[test]
    fn every_command_is_one_of_ours_but_that_of_another_name_and_none_is_there_twice() {
        for flown in FLOWN {
            assert!(Definition::of_code(flown.code).is_some(), "{}", flown.name);
            assert_eq!(FLOWN.iter().filter(|other| other.code == flown.code).count(), 1, "{}", flown.name);
            assert!(flown.values <= MAX_VALUES);
        }
        // Every ground command that flew can be said, but for those of which one is said by another.
        for definition in Definition::all().iter().filter(|definition| !definition.flown.is_empty()) {
            let there = FLOWN.iter().any(|flown| flown.code == definition.code);
            assert!(there || definition.name == "service.set_network_lull", "{}", definition.name);
        }
    }

    #[test]
    fn commands_are_said_in_our_units() {
        let cases: [(&str, &[f64], &[&str]); 20] = [
            ("quit", &[], &["service.quit"]),
            ("shutdown", &[1.0, 1.0], &["service.shut_down 1"]),
            ("shutdown", &[0.0, 1.0], &["shutdown_now is not set"]),
            ("network_reset", &[0.0, 1.0, 7200.0], &["service.set_network_lull 1 7200"]),
            ("network_reset", &[1.0, 0.0, 720.0], &["service.reset_network", "service.set_network_lull 0 720"]),
            ("main_settings", &[10.0, 1.0, 0.0, 0.0, 1.0], &["display.configure 10 1 0 0 1"]),
            ("set_focus", &[2345.0], &["lens.set_focus 2345"]),
            ("set_focus_incremental", &[-20.0], &["lens.move_focus -20"]),
            ("set_autofocus_range", &[2300.0, 3300.0, 10.0], &["focus.set_range 2300 3300 10"]),
            ("autofocus_display_mode", &[2.0], &["focus.set_display off"]),
            ("set_gain", &[3.5], &["camera.set_gain 3.5"]),
            ("motion_psf", &[1.0, 0.1, 4.6e-5], &["solver.motion 1"]),
            ("solver_mask", &[1.0, 1.0, 4_294_967_295.0, 3.0], &["solver.mask 1 1 4294967295 3"]),
            ("solver_blob_finder", &[1.0, 15.0, 1.0, 2.0], &["solver.sources 1 15 1"]),
            ("solver_blob_cells", &[128.0, 2.0], &["solver.cells 128 2"]),
            (
                "solver_pattern_matcher",
                &[1.0, 1.0, 6.0, 9.4 * ARCSEC, 9.6 * ARCSEC, 0.0, 9.5 * ARCSEC],
                &["solver.matching 1 6 9.4 9.6"],
            ),
            ("solver_filter_hor_location", &[1.0, 0.5], &["requirements.horizontal_location 1 28.647889757"]),
            ("solver_filter_hor_roll", &[1.0, -5.0 * DEG, 7.0 * DEG], &["requirements.horizontal_roll 1 -5 7"]),
            ("solver_filter_eq_location", &[0.0, 30.0], &["requirements.equatorial_location 0 180"]),
            ("solver_filter_matching", &[6.0 * ARCSEC, 10.0, 5.0], &["requirements.matching 6 10 5"]),
        ];
        for (name, given, wanted) in cases {
            assert_eq!(said(name, given), wanted, "{name}");
        }
    }

    #[test]
    fn what_cannot_be_said_or_is_out_of_range_is_refused() {
        let fixed = said("solver_pattern_matcher", &[1.0, 1.0, 6.0, 4.5e-5, 4.6e-5, 1.0, 4.6e-5]);
        assert!(fixed[0].contains("always fitted"));
        assert!(said("solver_filter_eq_location", &[1.0, 30.0])[0].contains("expected a number from 0.1 to 180"));
        assert!(said("network_reset", &[0.0, 1.0, 10.0])[0].contains("expected a number from 60"), "its unit is a trap");
        assert!(said("image_client", &[7.0])[0].contains("expected 0 or 1"), "a byte that is no flag");
        assert!(said("set_gain", &[f64::NAN])[0].contains("expected"));
    }
}
