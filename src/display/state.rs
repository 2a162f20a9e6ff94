//! The state as the page, `stars watch` and programs read it: one object, with the unit in each name, and null for what is not known.

use crate::command::{Refusal, Stage};
use crate::lens::autofocus::Curve;
use crate::sky::ClockQuality;
use crate::solve::Reason;
use crate::wire::{Actor, Found, LastEnd, Shed};
use serde::Serialize;
use std::collections::BTreeMap;

/// All that is true now, but for the frame itself: that is a [`super::FrameView`].
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning; what they leave open is said in config/OPERATING.md")]
pub struct Snapshot {
    pub camera_name: String,
    pub version: &'static str,
    pub boot_id: u32,
    pub uptime_s: f64,
    pub simulated: SimulatedPart,
    pub time: TimePart,
    /// Whether frames can be solved: `starting`, `ready`, or why not.
    pub solver: String,
    pub camera: CameraPart,
    pub housekeeping: Vec<Gauge>,
    pub disks: Vec<DiskPart>,
    pub lens: LensPart,
    pub focus: FocusPart,
    pub links: Vec<LinkPart>,
    pub charge: ChargePart,
    pub commands: CommandsPart,
    /// The frame that is shown, where there was one.
    pub frame: Option<FrameMark>,
    /// Time since the last frame that was solved was captured.
    pub solution_age: Gauge,
    pub counters: CountersPart,
    pub restarts: Vec<RestartPart>,
    pub run_number: Option<u32>,
    pub last_end: Option<LastEnd>,
    pub kept_at_start: Found,
    pub counters_kept: bool,
    pub settings_hash: u32,
    pub settings_commanded: u16,
    /// What is left undone for want of time.
    pub shed: Shed,
    /// How the page is to look, as the ground commands it.
    pub look: LookPart,
}

/// Which parts are simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct SimulatedPart {
    pub camera: bool,
    pub lens: bool,
    pub housekeeping: bool,
}

/// The camera's clock.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct TimePart {
    pub utc: Option<String>,
    pub quality: ClockQuality,
    pub concern: Concern,
}

/// What the camera does.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct CameraPart {
    /// `idle`, `working`, or why it gives no frame.
    pub state: String,
    pub concern: Concern,
    pub gain_db: Option<f64>,
    pub next_image: u32,
    pub solving: Option<u32>,
    pub exposure_s: Option<f64>,
}

/// How a value is to be looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Concern {
    /// It is not known.
    Unknown,
    /// It is as it should be.
    Good,
    /// It is outside its yellow limits.
    Yellow,
    /// It is outside its red limits.
    Red,
}

/// The limits of a value, ends included; infinite where there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Within these it is good.
    pub yellow: (f64, f64),
    /// Outside these it is bad.
    pub red: (f64, f64),
}

impl Limits {
    /// Limits of a value that is the better the lower it is.
    pub fn below(yellow: f64, red: f64) -> Self {
        Self { yellow: (f64::NEG_INFINITY, yellow), red: (f64::NEG_INFINITY, red) }
    }

    /// Limits of a value that is the better the higher it is.
    pub fn above(yellow: f64, red: f64) -> Self {
        Self { yellow: (yellow, f64::INFINITY), red: (red, f64::INFINITY) }
    }

    /// How a value is to be looked at.
    pub fn judge(&self, value: Option<f64>) -> Concern {
        let inside = |(low, high): (f64, f64), value: f64| (low..=high).contains(&value);
        match value {
            None => Concern::Unknown,
            Some(value) if !inside(self.red, value) => Concern::Red,
            Some(value) if !inside(self.yellow, value) => Concern::Yellow,
            Some(_) => Concern::Good,
        }
    }
}

/// A value with its limits.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct Gauge {
    pub name: &'static str,
    pub unit: &'static str,
    pub value: Option<f64>,
    /// Time since it was read, even where the value is too old to be known.
    pub age_s: Option<f64>,
    /// Within these it is good; null where there is no limit.
    pub yellow: [Option<f64>; 2],
    /// Outside these it is bad.
    pub red: [Option<f64>; 2],
    pub concern: Concern,
}

impl Gauge {
    /// A value, judged.
    pub fn new(name: &'static str, unit: &'static str, value: Option<f64>, limits: Limits) -> Self {
        let value = value.filter(|value| value.is_finite());
        let ends = |(low, high): (f64, f64)| [low, high].map(|end| end.is_finite().then_some(end));
        let Limits { yellow, red } = limits;
        Self { name, unit, value, age_s: None, yellow: ends(yellow), red: ends(red), concern: limits.judge(value) }
    }

    /// The same, read so long ago, s.
    #[must_use]
    pub fn read(self, age_s: Option<f64>) -> Self {
        Self { age_s, ..self }
    }
}

/// What became of images on a disk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct DiskPart {
    pub name: &'static str,
    pub images_kept: u32,
    pub images_lost: u32,
    pub images_thinned: u32,
    pub errors: u32,
    pub concern: Concern,
}

/// The lens. A position is null where it is not known, and the words beside it say why.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct LensPart {
    pub port: Option<String>,
    pub connected: bool,
    pub focus_counts: Option<i32>,
    /// `known`, `moving`, or why it is not known.
    pub focus: String,
    pub focus_range_counts: Option<(i32, i32)>,
    pub aperture_counts: Option<i32>,
    pub aperture: String,
    /// A stop stands: it does not move by itself.
    pub stopped: bool,
    pub busy: Option<String>,
    pub waiting: usize,
    pub errors: u32,
    pub last_error: Option<String>,
    pub concern: Concern,
}

/// The autofocus, with its curves.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct FocusPart {
    /// `not_running`, `running` or `grace`: over, and shown for a while.
    pub mode: crate::lens::autofocus::Mode,
    /// Whether its panel is to be shown now.
    pub shown: bool,
    pub requested_counts: Option<i32>,
    pub run_age_s: Option<f64>,
    pub time_left_s: Option<f64>,
    pub images: usize,
    pub best_counts: Option<f64>,
    pub sigma_best_counts: Option<f64>,
    /// Distance from the best focus at which a star's peak has fallen to 63 %.
    pub width_counts: Option<f64>,
    pub drift_counts_per_min: Option<f64>,
    /// From which curves the best focus comes.
    pub from: Option<Curve>,
    /// How the last run ended.
    pub last: Option<String>,
    pub search_counts: (i32, i32),
    /// What was seen: each star's peaks, and those of the brightest source.
    pub points: Vec<FocusPoint>,
    /// What the widths of stars say without any move: how far the best focus is.
    pub distance_counts: Option<f64>,
    pub sigma_distance_counts: Option<f64>,
}

/// A point of a focus curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct FocusPoint {
    /// The star's number in the catalogue; null for the brightest source, whichever that was.
    pub star: Option<u32>,
    pub counts: i32,
    pub peak_adu: f64,
    pub sigma_adu: f64,
}

/// A flight computer's link.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct LinkPart {
    pub computer: u8,
    pub connected: bool,
    pub legacy: bool,
    pub connected_for_s: Option<f64>,
    /// Time since its last status.
    pub status_age_s: Option<f64>,
    pub statuses: Option<u32>,
    pub updates_received: Option<u32>,
    pub claims_charge: bool,
    pub in_charge: bool,
    pub clock_offset_s: Option<f64>,
    pub sigma_clock_s: Option<f64>,
    pub concern: Concern,
}

/// Who may command.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct ChargePart {
    pub computer: Option<u8>,
    pub lease: Option<u32>,
    pub for_s: Option<f64>,
    pub latitude_deg: Option<f64>,
    pub sidereal_time_h: Option<f64>,
    pub concern: Concern,
}

/// What became of commands.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct CommandsPart {
    pub accepted: u32,
    pub refused: BTreeMap<String, u32>,
    pub under_way: usize,
    pub armed: Option<String>,
    /// The last replies, newest first.
    pub last: Vec<CommandPart>,
}

/// One stage of one command.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct CommandPart {
    pub computer: u8,
    pub name: String,
    pub counter: u32,
    pub stage: Stage,
    pub why: Option<Refusal>,
    pub detail: String,
    pub age_s: f64,
}

/// Which frame is shown.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct FrameMark {
    pub image: u32,
    pub reason: Reason,
    pub solved: bool,
    /// Time since it was captured.
    pub age_s: f64,
    /// Whether its pixels can be had.
    pub pixels: bool,
}

/// What happened since the start.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct CountersPart {
    pub frames_taken: u32,
    pub frames_solved: u32,
    pub frames_skipped: u32,
    pub frames_unreadable: u32,
    pub records_written: u32,
    pub records_lost: u32,
    pub disk_errors: u32,
    pub network_resets: u32,
    pub links_closed: BTreeMap<String, u32>,
}

/// An actor that was started again.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct RestartPart {
    pub actor: Actor,
    pub times: u32,
    pub why: Option<String>,
    pub age_s: Option<f64>,
}

/// How the page is to look: the ground's display commands.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct LookPart {
    pub rate_hz: f64,
    pub full_screen: bool,
    pub image_only: bool,
    pub requirements: bool,
    pub brightness: f64,
    /// Centre of what is magnified, as a fraction of the picture from its left and from its top.
    pub zoom_at: [f64; 2],
    pub zoom: f64,
    /// `auto`, `on` or `off`.
    pub focus: String,
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::lens::autofocus::Mode;

    fn focus() -> FocusPart {
        FocusPart {
            mode: Mode::NotRunning,
            shown: false,
            requested_counts: None,
            run_age_s: None,
            time_left_s: None,
            images: 0,
            best_counts: None,
            sigma_best_counts: None,
            width_counts: None,
            drift_counts_per_min: None,
            from: None,
            last: None,
            search_counts: (0, 1),
            points: Vec::new(),
            distance_counts: None,
            sigma_distance_counts: None,
        }
    }

    fn lens() -> LensPart {
        LensPart {
            port: None,
            connected: true,
            focus_counts: Some(3030),
            focus: "known".to_owned(),
            focus_range_counts: None,
            aperture_counts: None,
            aperture: "timed_out".to_owned(),
            stopped: false,
            busy: None,
            waiting: 0,
            errors: 0,
            last_error: None,
            concern: Concern::Yellow,
        }
    }

    /// A camera whose vessel is a little warm and whose aperture is not known.
    pub fn snapshot() -> Snapshot {
        let warm = Gauge::new("temperature_vessel", "°C", Some(55.0), Limits { yellow: (-20.0, 50.0), red: (-40.0, 70.0) });
        Snapshot {
            camera_name: "north".to_owned(),
            version: "0",
            boot_id: 1,
            uptime_s: 100.0,
            simulated: SimulatedPart { camera: true, lens: true, housekeeping: true },
            time: TimePart { utc: None, quality: ClockQuality::Unset, concern: Concern::Yellow },
            solver: "ready".to_owned(),
            camera: CameraPart {
                state: "working".to_owned(),
                concern: Concern::Good,
                gain_db: None,
                next_image: 8,
                solving: None,
                exposure_s: None,
            },
            housekeeping: vec![warm],
            disks: Vec::new(),
            lens: lens(),
            focus: focus(),
            links: Vec::new(),
            charge: ChargePart {
                computer: None,
                lease: None,
                for_s: None,
                latitude_deg: None,
                sidereal_time_h: None,
                concern: Concern::Yellow,
            },
            commands: CommandsPart {
                accepted: 1,
                refused: BTreeMap::new(),
                under_way: 0,
                armed: None,
                last: vec![CommandPart {
                    computer: 1,
                    name: "lens.get_aperture".to_owned(),
                    counter: 7,
                    stage: Stage::Failed,
                    why: Some(Refusal::Device),
                    detail: "timed_out".to_owned(),
                    age_s: 1.0,
                }],
            },
            frame: None,
            solution_age: Gauge::new("solution_age", "s", None, Limits::below(10.0, 60.0)),
            counters: CountersPart {
                frames_taken: 8,
                frames_solved: 1,
                frames_skipped: 0,
                frames_unreadable: 0,
                records_written: 8,
                records_lost: 0,
                disk_errors: 0,
                network_resets: 0,
                links_closed: BTreeMap::new(),
            },
            restarts: Vec::new(),
            run_number: None,
            last_end: None,
            kept_at_start: Found::Nothing,
            counters_kept: false,
            settings_hash: 0,
            settings_commanded: 0,
            shed: Shed::Nothing,
            look: LookPart {
                rate_hz: 10.0,
                full_screen: false,
                image_only: false,
                requirements: true,
                brightness: 1.0,
                zoom_at: [0.5, 0.5],
                zoom: 1.0,
                focus: "auto".to_owned(),
            },
        }
    }

    #[test]
    fn a_value_is_judged_by_both_pairs_of_limits_their_ends_included() {
        let limits = Limits { yellow: (0.0, 40.0), red: (-20.0, 60.0) };
        for (value, concern) in [
            (None, Concern::Unknown),
            (Some(0.0), Concern::Good),
            (Some(40.0), Concern::Good),
            (Some(40.1), Concern::Yellow),
            (Some(-20.0), Concern::Yellow),
            (Some(-20.1), Concern::Red),
            (Some(61.0), Concern::Red),
        ] {
            assert_eq!(limits.judge(value), concern, "{value:?}");
        }
        assert_eq!(Limits::below(10.0, 60.0).judge(Some(11.0)), Concern::Yellow);
        assert_eq!(Limits::above(10.0, 2.0).judge(Some(1.0)), Concern::Red);
    }

    #[test]
    fn a_gauge_shows_no_limit_where_there_is_none_and_never_a_number_that_is_none() {
        let gauge = Gauge::new("disk_days_left", "d", Some(f64::INFINITY), Limits::above(10.0, 2.0)).read(Some(1.0));
        let json = serde_json::to_value(&gauge).unwrap();
        assert_eq!(json["value"], serde_json::Value::Null);
        assert_eq!(json["concern"], "unknown");
        assert_eq!(json["yellow"], serde_json::json!([10.0, null]));
    }
}
