//! The pre-flight review: what must still be set before a flight, and what a flight's own files change.

use super::layers::{Loaded, Setting};
use super::schema::{CameraKind, LensKind, Settings};
use super::sensor::SensorSource;

/// Why `camera.kind = "aravis"` gives no camera, to follow the setting.
pub const NO_ARAVIS: &str =
    "is \"aravis\", which this program was built without: build it with --features aravis (Debian: libaravis-dev)";

/// One thing that keeps these settings from flying.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Finding {
    /// The setting.
    pub key: &'static str,
    /// What is wrong with it and what to do.
    pub why: String,
}

/// The result of the review.
#[derive(Debug, Clone, PartialEq)]
pub struct Review<'a> {
    /// What must still be set; nothing when the settings are ready for a flight.
    pub findings: Vec<Finding>,
    /// The per-camera settings, in the order of the flight file.
    pub per_camera: Vec<&'a Setting>,
    /// Every other setting that is not the flight file's own: each wants a reason.
    pub other_overrides: Vec<&'a Setting>,
}

/// Reviews settings for a flight: its own camera, lens and address, and the per-camera settings set in the custom file.
pub fn review(loaded: &Loaded) -> Review<'_> {
    let mut findings = real_hardware(&loaded.settings);
    let (per_camera, others): (Vec<&Setting>, Vec<&Setting>) = loaded.all.iter().partition(|setting| setting.is_per_camera());
    let file = loaded.custom_file.as_deref().map_or("a custom file (--custom FILE)".to_owned(), |name| format!("'{name}'"));
    for setting in &per_camera {
        if setting.custom.is_none() {
            findings.push(Finding { key: setting.key, why: format!("differs between cameras: set it in {file}") });
        }
    }
    let other_overrides = others.into_iter().filter(|setting| setting.custom.is_some() || setting.is_overridden()).collect();
    Review { findings, per_camera, other_overrides }
}

/// What of the outside is simulated or out of reach.
fn real_hardware(settings: &Settings) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut find = |key, why: &str| findings.push(Finding { key, why: why.to_owned() });
    match settings.camera.kind {
        CameraKind::Sky => find("camera.kind", "is \"sky\", a simulation: set the flight's own camera"),
        CameraKind::None => find("camera.kind", "is \"none\": set the flight's own camera"),
        CameraKind::Aravis if !cfg!(feature = "aravis") => find("camera.kind", NO_ARAVIS),
        CameraKind::Aravis | CameraKind::Directory => (),
    }
    match settings.lens.kind {
        LensKind::Simulated => find("lens.kind", "is \"simulated\": set the flight's own lens"),
        LensKind::None => find("lens.kind", "is \"none\": set the flight's own lens"),
        LensKind::Serial => (),
    }
    let house = &settings.housekeeping;
    for (key, source) in [
        ("housekeeping.temperature_lens.source", &house.temperature_lens.source),
        ("housekeeping.temperature_computer.source", &house.temperature_computer.source),
        ("housekeeping.temperature_vessel.source", &house.temperature_vessel.source),
        ("housekeeping.temperature_plate.source", &house.temperature_plate.source),
        ("housekeeping.temperature_dcdc.source", &house.temperature_dcdc.source),
        ("housekeeping.temperature_flange.source", &house.temperature_flange.source),
        ("housekeeping.pressure.source", &house.pressure.source),
    ] {
        if *source == SensorSource::Simulated {
            find(key, "is \"simulated\": set a sensor, or \"\" where there is none");
        }
    }
    if settings.brightness.allowed {
        find("brightness.allowed", "is true: a command could pretend a brighter sky than there is");
    }
    if is_loopback(&settings.network.listen) {
        find("network.listen", "is a loopback address, which no flight computer reaches: set the flight's own");
    }
    if settings.legacy.enabled && is_loopback(&settings.legacy.listen) {
        find("legacy.listen", "is a loopback address, which no flight computer reaches: set the flight's own");
    }
    findings
}

/// An IPv4 loopback address may come dressed as IPv6 (`::ffff:127.0.0.1`).
fn is_loopback(listen: &str) -> bool {
    listen.parse::<core::net::SocketAddr>().is_ok_and(|address| address.ip().to_canonical().is_loopback())
}
