//! What every setting may be: type, unit and range, in the order of the flight file.

use super::sensor::SensorSource;
use super::span::parse_span;
use toml::Value;

/// What a value may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    /// `true` or `false`.
    Switch,
    /// A whole number of a range, ends included.
    Whole { min: i64, max: i64 },
    /// A number of a range, ends included; never NaN or infinite.
    Number { min: f64, max: f64 },
    /// One of a few words.
    Choice(&'static [&'static str]),
    /// Printable ASCII of this length at most, not empty.
    Name { max: usize },
    /// Printable ASCII of this length at most, or empty.
    OptionalText { max: usize },
    /// A path, not empty.
    Path,
    /// A path, or empty.
    OptionalPath,
    /// An IP address with a port.
    Listen,
    /// IP addresses.
    Peers { max: usize },
    /// Words of 32 bits.
    Words { max: usize },
    /// Where a sensor's value comes from.
    Sensor,
}

/// One setting: its dotted key, its unit (empty for none) and what it may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rule {
    pub(super) key: &'static str,
    pub(super) unit: &'static str,
    pub(super) kind: Kind,
}

/// The settings that differ between the cameras of a flight, because their hardware does: a flight's custom file must set
/// them all. (The paper's eight: name, focus range, plate scale and mounted roll.)
pub const PER_CAMERA: [&str; 8] = [
    "camera.name",
    "focus.search_min_counts",
    "focus.search_max_counts",
    "solver.matching.platescale_min_arcsec_px",
    "solver.matching.platescale_max_arcsec_px",
    "solver.requirements.horizontal_roll.enabled",
    "solver.requirements.horizontal_roll.min_deg",
    "solver.requirements.horizontal_roll.max_deg",
];

const U32_MAX: i64 = u32::MAX as i64;
/// Longest path, bytes (Linux's own limit).
const PATH_BYTES: usize = 4096;
const CAMERAS: &[&str] = &["directory", "sky", "aravis", "none"];
const TRIGGERS: &[&str] = &["software", "free", "line0", "line1", "line2", "line3"];
const CLOCK_REFERENCES: &[&str] = &["unknown", "chrony", "ptp"];
const PIXEL_FORMATS: &[&str] = &["mono8", "mono10", "mono12", "mono14", "mono16"];
const LENSES: &[&str] = &["serial", "simulated", "none"];
const FRAMES: &[&str] = &[
    "night",
    "float",
    "gradient",
    "defocus",
    "defocus30",
    "motion",
    "multiexp",
    "hotpix",
    "sparse",
    "dense",
    "saturated",
    "faint",
];

const fn switch(key: &'static str) -> Rule {
    Rule { key, unit: "", kind: Kind::Switch }
}
const fn whole(key: &'static str, unit: &'static str, min: i64, max: i64) -> Rule {
    Rule { key, unit, kind: Kind::Whole { min, max } }
}
const fn number(key: &'static str, unit: &'static str, min: f64, max: f64) -> Rule {
    Rule { key, unit, kind: Kind::Number { min, max } }
}
const fn word(key: &'static str, kind: Kind) -> Rule {
    Rule { key, unit: "", kind }
}

/// Every setting there is. A test holds the flight file and the schema to it.
pub(super) const RULES: &[Rule] = &[
    word("camera.name", Kind::Name { max: 16 }),
    word("camera.kind", Kind::Choice(CAMERAS)),
    word("camera.directory", Kind::Path),
    word("camera.device", Kind::OptionalText { max: 256 }),
    word("camera.trigger", Kind::Choice(TRIGGERS)),
    number("camera.trigger_timeout_s", "s", 0.0, 86_400.0),
    number("camera.exposure_s", "s", 1e-5, 5.0),
    number("camera.gain_db", "dB", -50.0, 100.0),
    word("camera.pixel_format", Kind::Choice(PIXEL_FORMATS)),
    word("camera.features", Kind::OptionalText { max: 4096 }),
    whole("camera.series_exposures", "", 1, 16),
    number("camera.series_s", "s", 0.1, 10.0),
    switch("camera.stack_parts"),
    switch("camera.repeat"),
    number("camera.startup_delay_s", "s", 0.0, 3600.0),
    number("camera.period_s", "s", 0.001, 86_400.0),
    whole("camera.width_px", "px", 64, 16_384),
    whole("camera.height_px", "px", 64, 16_384),
    switch("camera.mirrored"),
    whole("camera.full_scale_adu", "ADU", 0, U32_MAX),
    number("camera.ideal_gain_adu_per_e", "ADU per electron", 1e-6, 1000.0),
    switch("auto_exposure.enabled"),
    number("auto_exposure.sky_low", "of full scale", 0.0, 1.0),
    number("auto_exposure.sky_high", "of full scale", 0.001, 0.9),
    number("auto_exposure.saturated_max", "of all pixels", 0.0, 1.0),
    whole("auto_exposure.enough_sources", "", 0, 10_000),
    number("auto_exposure.exposure_min_s", "s", 1e-5, 5.0),
    number("auto_exposure.exposure_max_s", "s", 1e-5, 5.0),
    number("auto_exposure.gain_min_db", "dB", -50.0, 100.0),
    number("auto_exposure.gain_max_db", "dB", -50.0, 100.0),
    word("simulate.kind", Kind::Choice(FRAMES)),
    whole("simulate.seed", "", 0, i64::MAX),
    number("simulate.elevation_deg", "deg", -90.0, 90.0),
    number("simulate.scan_rate_deg_s", "deg/s", 0.0, 10.0),
    number("simulate.scan_amplitude_deg", "deg", 0.0, 180.0),
    number("simulate.latitude_deg", "deg", -90.0, 90.0),
    whole("simulate.best_focus_counts", "encoder counts", 0, 65_535),
    switch("brightness.allowed"),
    switch("brightness.enabled"),
    number("brightness.level_ke_s_px", "thousands of electrons/s and pixel", 0.0, 10_000.0),
    number("brightness.gain_db", "dB", -50.0, 10.0),
    number("brightness.actual_exposure_s", "s", 0.01, 10.0),
    number("brightness.simulated_exposure_s", "s", 0.01, 10.0),
    word("lens.kind", Kind::Choice(LENSES)),
    word("lens.port", Kind::Path),
    whole("lens.baud", "baud", 300, 4_000_000),
    switch("lens.init_on_startup"),
    switch("lens.relearn"),
    number("lens.relearn_pause_s", "s", 0.001, 86_400.0),
    whole("lens.large_move_counts", "counts", 0, 65_535),
    whole("lens.tolerance_counts", "counts", 0, 1000),
    number("lens.reply_timeout_s", "s", 0.01, 60.0),
    number("lens.move_timeout_s", "s", 0.01, 600.0),
    number("lens.learn_timeout_s", "s", 0.01, 600.0),
    whole("lens.retries", "times", 0, 10),
    number("lens.retry_pause_s", "s", 0.001, 600.0),
    number("lens.check_period_s", "s", 0.01, 3600.0),
    number("lens.search_period_s", "s", 0.01, 3600.0),
    whole("lens.simulated.range_counts", "counts", 1, 65_535),
    whole("lens.simulated.start_counts", "counts", 0, 65_535),
    number("lens.simulated.speed_counts_s", "counts/s", 1.0, 1e6),
    number("lens.simulated.backlash_counts", "counts", 0.0, 1000.0),
    number("lens.simulated.speedup", "", 1.0, 1000.0),
    word("lens.simulated.faults", Kind::OptionalText { max: 4096 }),
    whole("focus.search_min_counts", "encoder counts", 0, 65_535),
    whole("focus.search_max_counts", "encoder counts", 0, 65_535),
    whole("focus.step_counts", "encoder counts", 1, 1000),
    number("focus.time_allowed_s", "s", 10.0, 86_400.0),
    number("focus.grace_s", "s", 0.0, 3600.0),
    whole("focus.backlash_counts", "encoder counts", 0, 1000),
    whole("focus.refocus_counts", "encoder counts", 1, 1000),
    number("focus.blur_px_per_count", "px a count", 0.0001, 10.0),
    number("focus.sharp_width_px", "px", 0.5, 100.0),
    word("catalog.file", Kind::OptionalPath),
    word("catalog.cache_directory", Kind::OptionalPath),
    number("catalog.epoch_yr", "Julian year", 1950.0, 2100.0),
    number("catalog.blend_px", "px", 0.0, 100.0),
    number("catalog.index_stars_per_field", "stars", 5.0, 100.0),
    number("catalog.verification_stars_per_field", "stars", 5.0, 1000.0),
    number("catalog.longest_side_fraction", "fraction of the field's diagonal", 0.05, 1.0),
    switch("solver.enabled"),
    number("solver.timeout_s", "s", 0.001, 3600.0),
    switch("solver.robust"),
    whole("solver.threads", "threads", 1, 2),
    number("solver.saturation_limit_fraction", "fraction of the frame", 0.0, 1.0),
    switch("solver.prior_veto"),
    number("solver.sources.snr_threshold", "σ of the local noise", 0.0, 100.0),
    number("solver.sources.min_snr", "signal over noise", 0.0, 1000.0),
    whole("solver.sources.max_sources", "sources", 4, 32),
    whole("solver.sources.max_found", "sources", 3, 1000),
    whole("solver.sources.cell_px", "px", 8, 16_384),
    whole("solver.sources.max_per_cell", "sources", 1, 100),
    whole("solver.sources.border_px", "px", 0, 1000),
    word("solver.sources.bad_pixels_file", Kind::OptionalPath),
    switch("solver.mask.enabled"),
    whole("solver.mask.block_px", "px", 8, 16_384),
    word("solver.mask.fields", Kind::Words { max: 4096 }),
    switch("solver.matching.enabled"),
    number("solver.matching.platescale_min_arcsec_px", "arcsec/px", 0.1, 1000.0),
    number("solver.matching.platescale_max_arcsec_px", "arcsec/px", 0.1, 1000.0),
    number("solver.matching.tolerance_px", "px", 0.1, 100.0),
    whole("solver.matching.min_matched", "sources", 3, 100),
    number("solver.matching.max_false_probability_log10", "log10", -100.0, -1.0),
    whole("solver.matching.candidate_budget", "candidates", 1, 1_000_000_000),
    switch("solver.tracking.enabled"),
    whole("solver.tracking.min_matched", "sources", 3, 100),
    number("solver.tracking.max_age_s", "s", 0.1, 86_400.0),
    number("solver.tracking.drift_deg_s", "deg/s", 0.00001, 10.0),
    number("solver.tracking.estimate_sigma_deg", "deg", 0.0001, 90.0),
    number("solver.tracking.estimate_drift_deg_s", "deg/s", 0.0, 10.0),
    number("solver.tracking.platescale_sigma", "fraction", 0.00001, 0.1),
    switch("solver.motion.enabled"),
    number("solver.motion.wait_s", "s", 0.0, 60.0),
    number("solver.motion.roll_deg", "deg", -180.0, 180.0),
    number("solver.motion.gyro_drift_arcsec", "arcsec", 0.0, 1000.0),
    number("solver.fit.distortion_k1", "fraction at half the diagonal", -0.1, 0.1),
    number("solver.fit.distortion_sigma", "fraction at half the diagonal", 0.0, 0.1),
    number("solver.fit.axis_left_px", "px", -1000.0, 1000.0),
    number("solver.fit.axis_up_px", "px", -1000.0, 1000.0),
    number("solver.fit.axis_sigma_px", "px", 0.001, 1000.0),
    number("solver.fit.centroid_floor_px", "px", 0.0, 10.0),
    switch("solver.fit.proper_motion"),
    switch("solver.fit.aberration"),
    switch("solver.fit.precession"),
    switch("solver.fit.refraction"),
    number("solver.fit.pressure_hpa", "hPa", 0.0, 1100.0),
    number("solver.fit.temperature_c", "°C", -150.0, 60.0),
    number("solver.requirements.pointing_error_max_arcsec", "arcsec", 0.001, 360_000.0),
    number("solver.requirements.fit_error_max_px", "px", 0.001, 100_000.0),
    switch("solver.requirements.horizontal_location.enabled"),
    number("solver.requirements.horizontal_location.radius_deg", "deg", 0.001, 180.0),
    number("solver.requirements.horizontal_location.az_deg", "deg", -360.0, 360.0),
    number("solver.requirements.horizontal_location.el_deg", "deg", -90.0, 90.0),
    switch("solver.requirements.horizontal_roll.enabled"),
    number("solver.requirements.horizontal_roll.min_deg", "deg", -360.0, 360.0),
    number("solver.requirements.horizontal_roll.max_deg", "deg", -360.0, 360.0),
    switch("solver.requirements.elevation.enabled"),
    number("solver.requirements.elevation.min_deg", "deg", -90.0, 90.0),
    number("solver.requirements.elevation.max_deg", "deg", -90.0, 90.0),
    switch("solver.requirements.equatorial_location.enabled"),
    number("solver.requirements.equatorial_location.radius_deg", "deg", 0.001, 180.0),
    number("solver.requirements.equatorial_location.ra_deg", "deg", -360.0, 360.0),
    number("solver.requirements.equatorial_location.dec_deg", "deg", -90.0, 90.0),
    switch("solver.requirements.equatorial_roll.enabled"),
    number("solver.requirements.equatorial_roll.min_deg", "deg", -360.0, 360.0),
    number("solver.requirements.equatorial_roll.max_deg", "deg", -360.0, 360.0),
    switch("observer.from_flight_computer"),
    number("observer.max_age_s", "s", 0.1, 86_400.0),
    switch("observer.from_settings"),
    number("observer.latitude_deg", "deg", -90.0, 90.0),
    number("observer.sidereal_time_h", "h", 0.0, 24.0),
    switch("observer.from_image"),
    word("network.listen", Kind::Listen),
    word("network.peers", Kind::Peers { max: 64 }),
    number("network.update_period_s", "s", 0.05, 60.0),
    number("network.silence_s", "s", 0.1, 3600.0),
    whole("network.max_connections", "connections", 4, 64),
    whole("network.connections_per_s", "connections/s", 1, 10_000),
    switch("images.send"),
    number("images.rate_bytes_s", "bytes/s", 1000.0, 1e6),
    switch("legacy.enabled"),
    word("legacy.listen", Kind::Listen),
    word("legacy.peers", Kind::Peers { max: 2 }),
    switch("legacy.images"),
    whole("legacy.images_port", "", 1, 65_535),
    number("commands.window_s", "s", 0.5, 600.0),
    switch("commands.require_authentication"),
    word("commands.key_file_1", Kind::OptionalPath),
    word("commands.key_file_2", Kind::OptionalPath),
    word("commands.ledger_directory", Kind::OptionalPath),
    word("commands.shut_down_program", Kind::OptionalPath),
    word("commands.restart_program", Kind::OptionalPath),
    word("commands.network_reset_program", Kind::OptionalPath),
    switch("commands.network_lull"),
    number("commands.network_lull_s", "s", 60.0, 86400.0),
    word("display.listen", Kind::Listen),
    whole("display.max_clients", "", 1, 256),
    whole("display.history_frames", "", 1, 1000),
    whole("display.history_mib", "MiB", 0, 4096),
    number("display.rate_hz", "Hz", 1.0, 30.0),
    switch("display.full_screen"),
    switch("display.image_only"),
    switch("display.show_requirements"),
    number("display.brightness", "", 0.5, 4.0),
    whole("display.zoom_x_px", "px", 0, 1000),
    whole("display.zoom_y_px", "px", 0, 1000),
    number("display.zoom", "", 1.0, 4.0),
    word("display.focus_panel", Kind::Choice(&["auto", "on", "off"])),
    number("display.solution_age_yellow_s", "s", 1.0, 86_400.0),
    number("display.solution_age_red_s", "s", 1.0, 86_400.0),
    number("display.disk_yellow_d", "d", 0.0, 1000.0),
    number("display.disk_red_d", "d", 0.0, 1000.0),
    switch("record.enabled"),
    word("record.directory", Kind::Path),
    whole("record.queue_frames", "outcomes", 1, 4096),
    switch("record.images"),
    word("record.images_directory", Kind::OptionalPath),
    word("record.copies_directory", Kind::OptionalPath),
    number("record.images_limit_gib", "GiB", 0.0, 1e6),
    number("record.reserve_gib", "GiB", 0.0, 1e6),
    whole("record.queue_images", "images", 1, 1024),
    switch("record.journal"),
    number("record.journal_limit_gib", "GiB", 0.0, 1e6),
    number("housekeeping.period_s", "s", 0.05, 3600.0),
    number("housekeeping.max_age_s", "s", 0.1, 86_400.0),
    number("housekeeping.command_timeout_s", "s", 0.05, 60.0),
    number("housekeeping.disk_low_gib", "GiB", 0.0, 1e6),
    number("housekeeping.disk_red_gib", "GiB", 0.0, 1e6),
    word("housekeeping.temperature_lens.source", Kind::Sensor),
    number("housekeeping.temperature_lens.low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_lens.high_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_lens.red_low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_lens.red_high_c", "°C", -273.15, 1000.0),
    word("housekeeping.temperature_computer.source", Kind::Sensor),
    number("housekeeping.temperature_computer.low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_computer.high_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_computer.red_low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_computer.red_high_c", "°C", -273.15, 1000.0),
    word("housekeeping.temperature_vessel.source", Kind::Sensor),
    number("housekeeping.temperature_vessel.low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_vessel.high_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_vessel.red_low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_vessel.red_high_c", "°C", -273.15, 1000.0),
    word("housekeeping.temperature_plate.source", Kind::Sensor),
    number("housekeeping.temperature_plate.low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_plate.high_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_plate.red_low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_plate.red_high_c", "°C", -273.15, 1000.0),
    word("housekeeping.temperature_dcdc.source", Kind::Sensor),
    number("housekeeping.temperature_dcdc.low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_dcdc.high_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_dcdc.red_low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_dcdc.red_high_c", "°C", -273.15, 1000.0),
    word("housekeeping.temperature_flange.source", Kind::Sensor),
    number("housekeeping.temperature_flange.low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_flange.high_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_flange.red_low_c", "°C", -273.15, 1000.0),
    number("housekeeping.temperature_flange.red_high_c", "°C", -273.15, 1000.0),
    word("housekeeping.pressure.source", Kind::Sensor),
    number("housekeeping.pressure.low_atm", "atm", 0.0, 100.0),
    number("housekeeping.pressure.high_atm", "atm", 0.0, 100.0),
    number("housekeeping.pressure.red_low_atm", "atm", 0.0, 100.0),
    number("housekeeping.pressure.red_high_atm", "atm", 0.0, 100.0),
    number("service.restart_delay_s", "s", 0.001, 60.0),
    number("service.restart_delay_max_s", "s", 0.001, 3600.0),
    number("service.hang_s", "s", 2.0, 3600.0),
    word("clock.reference", Kind::Choice(CLOCK_REFERENCES)),
    number("clock.sigma_s", "s", 0.0, 100.0),
];

/// The rule of a key.
pub(super) fn rule(key: &str) -> Option<&'static Rule> {
    RULES.iter().find(|rule| rule.key == key)
}

/// The first setting of a section, where the key names one.
pub(super) fn first_of_section(key: &str) -> Option<&'static str> {
    RULES.iter().map(|rule| rule.key).find(|full| full.strip_prefix(key).is_some_and(|rest| rest.starts_with('.')))
}

impl Rule {
    /// The allowed values, as in the brackets of the flight file.
    pub(super) fn range(&self) -> String {
        match self.kind {
            Kind::Switch => "true, false".into(),
            Kind::Whole { min, max } => format!("{min} to {max}"),
            Kind::Number { min, max } => format!("{min} to {max}"),
            Kind::Choice(words) => words.iter().map(|word| format!("\"{word}\"")).collect::<Vec<_>>().join(", "),
            Kind::Name { max } => format!("1 to {max} printable ASCII characters"),
            Kind::OptionalText { max } => format!("up to {max} printable ASCII characters"),
            Kind::Path => "path".into(),
            Kind::OptionalPath => "path or empty".into(),
            Kind::Listen => "IP address:port".into(),
            Kind::Peers { max } => format!("list of IP addresses, at most {max}"),
            Kind::Words { max } => format!("list of words of 32 bits, at most {max}"),
            Kind::Sensor => "sensor".into(),
        }
    }

    /// The allowed values in words, with the unit, to follow "must be".
    pub(super) fn expected(&self) -> String {
        let range = self.range();
        let unit = if self.unit.is_empty() { String::new() } else { format!(" ({})", self.unit) };
        match self.kind {
            Kind::Switch => "true or false".into(),
            Kind::Whole { .. } => format!("a whole number from {range}{unit}"),
            Kind::Number { .. } => format!("a number from {range}{unit}"),
            Kind::Choice(_) => format!("one of {range}"),
            Kind::Name { .. } | Kind::OptionalText { .. } => format!("text of {range}"),
            Kind::Path => "text, a path of at most 4096 bytes".into(),
            Kind::OptionalPath => "text, a path of at most 4096 bytes or \"\"".into(),
            Kind::Listen => "text, an IP address and port such as \"10.0.0.2:2017\" or \"[::1]:2017\"".into(),
            Kind::Peers { .. } => format!("a {range}, such as [\"10.0.0.3\"]"),
            Kind::Words { .. } => format!("a {range}, such as [1, 0x1000]"),
            Kind::Sensor => {
                "text, a sensor such as \"file:/path *0.001 +2\", \"command:/path\", \"simulated\", \"auto\" or \"\"".into()
            }
        }
    }

    /// The value if it is allowed, with whole numbers and spans of time made numbers where a number is wanted.
    pub(super) fn accept(&self, value: Value) -> Option<Value> {
        let value = match (self.kind, value) {
            (Kind::Number { .. }, Value::Integer(n)) => Value::Float(n as f64),
            (Kind::Number { .. }, Value::String(span)) if self.unit == "s" => Value::Float(parse_span(&span).ok()?.as_secs_f64()),
            (_, value) => value,
        };
        self.allows(&value).then_some(value)
    }

    fn allows(&self, value: &Value) -> bool {
        match (self.kind, value) {
            (Kind::Switch, Value::Boolean(_)) => true,
            (Kind::Whole { min, max }, Value::Integer(n)) => (min..=max).contains(n),
            // A NaN is in no range.
            (Kind::Number { min, max }, Value::Float(x)) => (min..=max).contains(x),
            (Kind::Peers { max }, Value::Array(all)) => {
                all.len() <= max && all.iter().all(|one| one.as_str().is_some_and(|ip| ip.parse::<core::net::IpAddr>().is_ok()))
            }
            (Kind::Words { max }, Value::Array(all)) => {
                all.len() <= max && all.iter().all(|one| one.as_integer().is_some_and(|word| (0..=U32_MAX).contains(&word)))
            }
            (kind, Value::String(text)) => allows_text(kind, text),
            _ => false,
        }
    }

    /// A value as it stands on a command line: TOML, or bare words where text is wanted or nothing else fits.
    pub(super) fn read_bare(&self, text: &str) -> Value {
        match text.parse::<Value>() {
            Ok(value @ Value::String(_)) => value,
            Ok(value) if !self.wants_text() => value,
            _ => Value::String(text.into()),
        }
    }

    fn wants_text(&self) -> bool {
        matches!(
            self.kind,
            Kind::Choice(_)
                | Kind::Name { .. }
                | Kind::OptionalText { .. }
                | Kind::Path
                | Kind::OptionalPath
                | Kind::Listen
                | Kind::Sensor
        )
    }
}

fn allows_text(kind: Kind, text: &str) -> bool {
    let path = |empty: bool| (empty || !text.is_empty()) && text.len() <= PATH_BYTES && !text.chars().any(char::is_control);
    let printable = || text.bytes().all(|c| c == b' ' || c.is_ascii_graphic());
    match kind {
        Kind::Choice(words) => words.contains(&text),
        Kind::Name { max } => (1..=max).contains(&text.len()) && printable(),
        Kind::OptionalText { max } => text.len() <= max && printable(),
        Kind::Path => path(false),
        Kind::OptionalPath => path(true),
        Kind::Listen => text.parse::<core::net::SocketAddr>().is_ok(),
        Kind::Sensor => text.len() <= PATH_BYTES && SensorSource::parse(text).is_ok(),
        _ => false,
    }
}
