//! Commands that change settings: what they set.

use super::dictionary::Command;
use super::value::ShowFocus;
use crate::settings::{Settings, SettingsError};

/// What a command that does nothing but change settings sets, as the settings room reads it; empty for any other.
fn assignments(command: &Command) -> Vec<String> {
    let set =
        |section: &str, values: &[(&str, String)]| values.iter().map(|(key, value)| format!("{section}.{key}={value}")).collect();
    let range = |name: &str, enabled: bool, min_deg: f64, max_deg: f64| {
        let values = [("enabled", enabled.to_string()), ("min_deg", float(min_deg)), ("max_deg", float(max_deg))];
        set(&format!("solver.requirements.{name}"), &values)
    };
    let circle = |name: &str, enabled: bool, radius_deg: f64| {
        let values = [("enabled", enabled.to_string()), ("radius_deg", float(radius_deg))];
        set(&format!("solver.requirements.{name}"), &values)
    };
    match *command {
        Command::ConfigureDisplay { .. } | Command::SetZoom { .. } | Command::SetFocusDisplay { .. } => of_display(command),
        Command::SetNetworkLull { enabled, delay_s } => {
            set("commands", &[("network_lull", enabled.to_string()), ("network_lull_s", float(delay_s))])
        }
        Command::SendImages { enabled } => set("images", &[("send", enabled.to_string())]),
        Command::SetSeries { readout_delay_s } => set("camera", &[("series_s", float(readout_delay_s))]),
        Command::SetBrightness { enabled, level_ke_s_px, gain_db, actual_exposure_s, simulated_exposure_s } => set(
            "brightness",
            &[
                ("enabled", enabled.to_string()),
                ("level_ke_s_px", float(level_ke_s_px)),
                ("gain_db", float(gain_db)),
                ("actual_exposure_s", float(actual_exposure_s)),
                ("simulated_exposure_s", float(simulated_exposure_s)),
            ],
        ),
        Command::SetFocusRange { min_counts, max_counts, step_counts } => set(
            "focus",
            &[
                ("search_min_counts", min_counts.to_string()),
                ("search_max_counts", max_counts.to_string()),
                ("step_counts", step_counts.to_string()),
            ],
        ),
        Command::ConfigureSolver { enabled, timeout_s } => {
            set("solver", &[("enabled", enabled.to_string()), ("timeout_s", float(timeout_s))])
        }
        Command::MaskSources { enabled, field_0, field_1, field_2 } => {
            set("solver.mask", &[("enabled", enabled.to_string()), ("fields", format!("[{field_0}, {field_1}, {field_2}]"))])
        }
        Command::FindSources { snr_threshold, max_sources, robust } => [
            set("solver.sources", &[("snr_threshold", float(snr_threshold)), ("max_sources", max_sources.to_string())]),
            set("solver", &[("robust", robust.to_string())]),
        ]
        .concat(),
        Command::LimitCells { cell_px, max_per_cell } => {
            set("solver.sources", &[("cell_px", cell_px.to_string()), ("max_per_cell", max_per_cell.to_string())])
        }
        Command::UseMotion { enabled } => set("solver.motion", &[("enabled", enabled.to_string())]),
        Command::MatchStars { enabled, tolerance_px, platescale_min_arcsec_px, platescale_max_arcsec_px } => set(
            "solver.matching",
            &[
                ("enabled", enabled.to_string()),
                ("tolerance_px", float(tolerance_px)),
                ("platescale_min_arcsec_px", float(platescale_min_arcsec_px)),
                ("platescale_max_arcsec_px", float(platescale_max_arcsec_px)),
            ],
        ),
        Command::RequireHorizontalLocation { enabled, radius_deg } => circle("horizontal_location", enabled, radius_deg),
        Command::RequireEquatorialLocation { enabled, radius_deg } => circle("equatorial_location", enabled, radius_deg),
        Command::RequireHorizontalRoll { enabled, min_deg, max_deg } => range("horizontal_roll", enabled, min_deg, max_deg),
        Command::RequireElevation { enabled, min_deg, max_deg } => range("elevation", enabled, min_deg, max_deg),
        Command::RequireEquatorialRoll { enabled, min_deg, max_deg } => range("equatorial_roll", enabled, min_deg, max_deg),
        Command::RequireMatching { pointing_error_max_arcsec, fit_error_max_px, min_matched } => [
            set(
                "solver.requirements",
                &[("pointing_error_max_arcsec", float(pointing_error_max_arcsec)), ("fit_error_max_px", float(fit_error_max_px))],
            ),
            set("solver.matching", &[("min_matched", min_matched.to_string())]),
        ]
        .concat(),
        _ => Vec::new(),
    }
}

/// What a command for the display sets.
fn of_display(command: &Command) -> Vec<String> {
    let set = |values: &[(&str, String)]| values.iter().map(|(key, value)| format!("display.{key}={value}")).collect();
    match *command {
        Command::ConfigureDisplay { rate_hz, full_screen, image_only, show_requirements, brightness } => set(&[
            ("rate_hz", float(rate_hz)),
            ("full_screen", full_screen.to_string()),
            ("image_only", image_only.to_string()),
            ("show_requirements", show_requirements.to_string()),
            ("brightness", float(brightness)),
        ]),
        Command::SetZoom { x_px, y_px, magnification } => {
            set(&[("zoom_x_px", x_px.to_string()), ("zoom_y_px", y_px.to_string()), ("zoom", float(magnification))])
        }
        Command::SetFocusDisplay { show } => {
            let word = match show {
                ShowFocus::Auto => "auto",
                ShowFocus::On => "on",
                ShowFocus::Off => "off",
            };
            set(&[("focus_panel", format!("{word:?}"))])
        }
        _ => Vec::new(),
    }
}

/// The settings after a command; those that it does not touch stay as they are. `None` where it changes none.
///
/// # Errors
/// Where a value is outside what this camera's settings allow, or the settings would contradict each other.
pub fn apply(command: &Command, before: &Settings) -> Option<Result<Settings, SettingsError>> {
    let assignments = assignments(command);
    (!assignments.is_empty()).then(|| before.commanded(&assignments))
}

/// A float as the settings room reads one: always with a point or an exponent.
fn float(value: f64) -> String {
    format!("{value:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_command_sets_what_it_says_and_nothing_else() {
        let before = Settings::flight().unwrap();
        let after = |text: &str| apply(&Command::parse(text).unwrap(), &before).unwrap().unwrap();
        let mut wanted = before.clone();
        (wanted.solver.enabled, wanted.solver.timeout_s) = (false, 7.5);
        assert_eq!(after("solver.configure 0 7.5"), wanted);
        wanted = before.clone();
        (wanted.solver.mask.enabled, wanted.solver.mask.fields) = (true, vec![1, 4_294_967_295, 3]);
        assert_eq!(after("solver.mask 1 1 4294967295 3"), wanted);
        wanted = before.clone();
        let elevation = &mut wanted.solver.requirements.elevation;
        (elevation.enabled, elevation.min_deg, elevation.max_deg) = (true, -5.0, 60.0);
        assert_eq!(after("requirements.elevation 1 -5 60"), wanted);
        wanted = before.clone();
        (wanted.focus.search_min_counts, wanted.focus.search_max_counts, wanted.focus.step_counts) = (2000, 2500, 25);
        assert_eq!(after("focus.set_range 2000 2500 25"), wanted);
        assert!(apply(&Command::parse("lens.stop").unwrap(), &before).is_none());
    }

    #[test]
    fn settings_that_would_contradict_each_other_are_refused_with_their_names() {
        let before = Settings::flight().unwrap();
        for (text, named) in [
            ("requirements.elevation 1 60 -5", "solver.requirements.elevation.min_deg"),
            ("focus.set_range 3000 2000 10", "focus.search_m"),
            ("solver.matching 1 6 9.7 9.2", "platescale_m"),
        ] {
            let error = apply(&Command::parse(text).unwrap(), &before).unwrap().unwrap_err().to_string();
            assert!(error.contains(named) && error.contains("command"), "{error}");
        }
    }

    #[test]
    fn every_command_that_sets_something_is_taken_at_both_ends_of_its_range_or_refused_in_words() {
        let before = Settings::flight().unwrap();
        let mut changed = 0;
        for definition in super::super::Definition::all() {
            for end in [0, 1] {
                let mut values = [0.0; super::super::MAX_VALUES];
                let ends = definition.parameters.iter().map(|p| [p.low, p.high][end]);
                values.iter_mut().zip(ends).for_each(|(value, end)| *value = end);
                match apply(&Command::from_wire(definition.code, &values).unwrap(), &before) {
                    Some(Ok(after)) => changed += usize::from(after != before),
                    Some(Err(error)) => assert!(!error.to_string().is_empty()),
                    None => {}
                }
            }
        }
        assert!(changed >= 15, "{changed}");
    }
}
