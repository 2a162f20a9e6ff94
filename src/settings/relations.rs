//! What settings must be to each other.

use super::error::{Layer, Origin, Problem, SettingsError};
use super::layers::Setting;
use super::schema::Settings;
use toml::Value;

/// Pairs of which the first must be below the second, or (true) may equal it.
const ORDERED: &[(&str, &str, bool)] = &[
    ("auto_exposure.sky_low", "auto_exposure.sky_high", false),
    ("auto_exposure.exposure_min_s", "auto_exposure.exposure_max_s", true),
    ("auto_exposure.gain_min_db", "auto_exposure.gain_max_db", true),
    ("lens.simulated.start_counts", "lens.simulated.range_counts", true),
    ("focus.search_min_counts", "focus.search_max_counts", false),
    ("focus.backlash_counts", "focus.refocus_counts", false),
    ("catalog.index_stars_per_field", "catalog.verification_stars_per_field", true),
    ("solver.sources.max_sources", "solver.sources.max_found", true),
    ("solver.matching.platescale_min_arcsec_px", "solver.matching.platescale_max_arcsec_px", false),
    ("solver.matching.min_matched", "solver.sources.max_found", true),
    ("solver.tracking.min_matched", "solver.matching.min_matched", true),
    ("solver.requirements.elevation.min_deg", "solver.requirements.elevation.max_deg", false),
    ("network.update_period_s", "network.silence_s", false),
    ("housekeeping.period_s", "housekeeping.max_age_s", false),
    ("housekeeping.temperature_lens.low_c", "housekeeping.temperature_lens.high_c", false),
    ("housekeeping.temperature_computer.low_c", "housekeeping.temperature_computer.high_c", false),
    ("housekeeping.temperature_vessel.low_c", "housekeeping.temperature_vessel.high_c", false),
    ("housekeeping.temperature_plate.low_c", "housekeeping.temperature_plate.high_c", false),
    ("housekeeping.temperature_dcdc.low_c", "housekeeping.temperature_dcdc.high_c", false),
    ("housekeeping.temperature_flange.low_c", "housekeeping.temperature_flange.high_c", false),
    ("housekeeping.pressure.low_atm", "housekeeping.pressure.high_atm", false),
    ("housekeeping.temperature_lens.red_low_c", "housekeeping.temperature_lens.low_c", true),
    ("housekeeping.temperature_lens.high_c", "housekeeping.temperature_lens.red_high_c", true),
    ("housekeeping.temperature_computer.red_low_c", "housekeeping.temperature_computer.low_c", true),
    ("housekeeping.temperature_computer.high_c", "housekeeping.temperature_computer.red_high_c", true),
    ("housekeeping.temperature_vessel.red_low_c", "housekeeping.temperature_vessel.low_c", true),
    ("housekeeping.temperature_vessel.high_c", "housekeeping.temperature_vessel.red_high_c", true),
    ("housekeeping.temperature_plate.red_low_c", "housekeeping.temperature_plate.low_c", true),
    ("housekeeping.temperature_plate.high_c", "housekeeping.temperature_plate.red_high_c", true),
    ("housekeeping.temperature_dcdc.red_low_c", "housekeeping.temperature_dcdc.low_c", true),
    ("housekeeping.temperature_dcdc.high_c", "housekeeping.temperature_dcdc.red_high_c", true),
    ("housekeeping.temperature_flange.red_low_c", "housekeeping.temperature_flange.low_c", true),
    ("housekeeping.temperature_flange.high_c", "housekeeping.temperature_flange.red_high_c", true),
    ("housekeeping.pressure.red_low_atm", "housekeeping.pressure.low_atm", true),
    ("housekeeping.pressure.high_atm", "housekeeping.pressure.red_high_atm", true),
    ("housekeeping.disk_red_gib", "housekeeping.disk_low_gib", true),
    ("display.solution_age_yellow_s", "display.solution_age_red_s", false),
    ("display.disk_red_d", "display.disk_yellow_d", false),
    ("service.restart_delay_s", "service.restart_delay_max_s", true),
];

/// Refuses settings that contradict each other; the error stands where the last word was spoken.
pub(super) fn check(settings: &Settings, all: &[Setting]) -> Result<(), SettingsError> {
    for (low, high, may_equal) in ORDERED {
        check_order(find(all, low), find(all, high), *may_equal)?;
    }
    check_border(settings, all)?;
    check_legacy(settings, all)?;
    check_lock(settings, all)?;
    check_mask(settings, all)
}

fn check_order(low: Option<&Setting>, high: Option<&Setting>, may_equal: bool) -> Result<(), SettingsError> {
    let (Some(low), Some(high)) = (low, high) else { return Ok(()) };
    let (below, above) = (as_number(&low.value), as_number(&high.value));
    if below < above || (may_equal && below == above) {
        return Ok(());
    }
    let (subject, must_be, other) = match (low.origin >= high.origin, may_equal) {
        (true, false) => (low, "below", high),
        (true, true) => (low, "at most", high),
        (false, false) => (high, "above", low),
        (false, true) => (high, "at least", low),
    };
    let (key, value, than, than_value) = (subject.key, &subject.value, other.key, &other.value);
    contradiction(
        subject.origin.clone(),
        format!("'{key}' = {value} must be {must_be} '{than}' = {than_value} ({})", other.origin.label()),
    )
}

fn check_border(settings: &Settings, all: &[Setting]) -> Result<(), SettingsError> {
    let (width, height) = (settings.camera.width_px, settings.camera.height_px);
    let border = settings.solver.sources.border_px;
    if border.saturating_mul(2) < width.min(height) {
        return Ok(());
    }
    let message = format!("'solver.sources.border_px' = {border} must leave something of a frame of {width} × {height} px");
    contradiction(last_word(all, &["solver.sources.border_px", "camera.width_px", "camera.height_px"]), message)
}

/// Addresses are all that tells flight computers of old apart.
fn check_legacy(settings: &Settings, all: &[Setting]) -> Result<(), SettingsError> {
    let legacy = &settings.legacy;
    let canonical = |text: &String| text.parse().map(|ip: core::net::IpAddr| ip.to_canonical()).ok();
    let peers: Vec<_> = legacy.peers.iter().map(canonical).collect();
    let message = match peers.as_slice() {
        [first, second] if first == second => format!("'legacy.peers' names {} twice", legacy.peers.join(" and ")),
        [] if legacy.enabled => "'legacy.peers' must name the flight computers where 'legacy.enabled' is true".to_owned(),
        _ if legacy.images && !(legacy.enabled && settings.record.enabled && settings.record.images) => {
            let message = "'legacy.images' needs 'legacy.enabled', 'record.enabled' and 'record.images'".to_owned();
            let keys = ["legacy.images", "legacy.enabled", "record.enabled", "record.images"];
            return contradiction(last_word(all, &keys), message);
        }
        _ => return Ok(()),
    };
    contradiction(last_word(all, &["legacy.enabled", "legacy.peers"]), message)
}

/// What is pretended must be allowed by a file: a command alone cannot begin it.
fn check_lock(settings: &Settings, all: &[Setting]) -> Result<(), SettingsError> {
    let brightness = &settings.brightness;
    if brightness.allowed || !brightness.enabled {
        return Ok(());
    }
    let message = "'brightness.enabled' needs 'brightness.allowed'".to_owned();
    contradiction(last_word(all, &["brightness.allowed", "brightness.enabled"]), message)
}

/// A mask is for one frame and one block size; with others its bits would mean other places.
fn check_mask(settings: &Settings, all: &[Setting]) -> Result<(), SettingsError> {
    let mask = &settings.solver.mask;
    let block = mask.block_px.max(1);
    let (columns, rows) = (settings.camera.width_px / block, settings.camera.height_px / block);
    let words = (u64::from(columns) * u64::from(rows)).div_ceil(32);
    let given = mask.fields.len();
    if given == 0 || given as u64 == words {
        return Ok(());
    }
    let message =
        format!("'solver.mask.fields' must have {words} words for {columns} × {rows} blocks of {block} px, or none, not {given}");
    contradiction(last_word(all, &["solver.mask.fields", "solver.mask.block_px", "camera.width_px", "camera.height_px"]), message)
}

fn find<'a>(all: &'a [Setting], key: &str) -> Option<&'a Setting> {
    all.iter().find(|setting| setting.key == key)
}

/// Where the highest of the layers speaks of one of these settings, which all exist.
fn last_word(all: &[Setting], keys: &[&str]) -> Origin {
    let origins = keys.iter().filter_map(|key| find(all, key)).map(|setting| &setting.origin);
    origins.max().cloned().unwrap_or(Origin { layer: Layer::Flight, line: 0, file: "settings".into() })
}

fn contradiction(origin: Origin, message: String) -> Result<(), SettingsError> {
    Err(SettingsError { origin, problem: Problem::Contradiction(message) })
}

fn as_number(value: &Value) -> f64 {
    value.as_float().or_else(|| value.as_integer().map(|n| n as f64)).unwrap_or(f64::NAN)
}
