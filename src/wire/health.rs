//! `Health`: how old and how good the housekeeping's values are, and what was started again and why.

use super::code::codes;
use super::element::body;
use super::{Coded, Maybe, Text, U32Le};
use serde::Serialize;

/// The parts of the service that are started again when they end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum Actor {
    Camera,
    Lens,
    Solver,
    Hub,
    Recorder,
    Ledger,
    Listener,
    Session,
    Housekeeping,
    LegacyListener,
    Archive,
    Display,
}

codes!(Actor {
    1 Camera "camera",
    2 Lens "lens",
    3 Solver "solver",
    4 Hub "hub",
    5 Recorder "recorder",
    6 Ledger "ledger",
    7 Listener "listener",
    8 Session "session",
    9 Housekeeping "housekeeping",
    10 LegacyListener "legacy_listener",
    11 Archive "archive",
    12 Display "display",
});

/// How the last run of the service ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LastEnd {
    /// It was ended at the computer.
    Clean,
    /// A command ended it.
    Commanded,
    /// It broke off: it crashed or was killed.
    Crashed,
    /// It broke off, and the computer was started anew since.
    ComputerRestarted,
}

codes!(LastEnd {
    1 Clean "clean",
    2 Commanded "commanded",
    3 Crashed "crashed",
    4 ComputerRestarted "computer_restarted",
});

/// What was found at the start of what earlier runs kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Found {
    /// Nothing was kept yet, or nothing is to be.
    Nothing,
    /// Both copies were whole.
    Whole,
    /// One copy was damaged; the other was taken.
    OneCopy,
    /// Both copies were damaged; all begins anew.
    Damaged,
}

codes!(Found {
    1 Nothing "nothing",
    2 Whole "whole",
    3 OneCopy "one_copy",
    4 Damaged "damaged",
});

/// What a computer that is too slow for all of its work leaves undone; each has what stands before it, too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Shed {
    /// Nothing: there is time for all.
    Nothing,
    /// The display is not drawn.
    Display,
    /// Images are not kept.
    Images,
    /// Frames that the normal search does not solve are given up.
    Solving,
}

codes!(Shed {
    1 Nothing "nothing",
    2 Display "display",
    3 Images "images",
    4 Solving "solving",
});

impl Shed {
    /// One thing more.
    #[must_use]
    pub fn more(self) -> Self {
        match self {
            Self::Nothing => Self::Display,
            Self::Display => Self::Images,
            Self::Images | Self::Solving => Self::Solving,
        }
    }

    /// One thing less.
    #[must_use]
    pub fn less(self) -> Self {
        match self {
            Self::Nothing | Self::Display => Self::Nothing,
            Self::Images => Self::Display,
            Self::Solving => Self::Images,
        }
    }
}

body! {
    /// How old and how good the housekeeping's values are, and what was started again and why.
    pub struct Health {
        /// A value of the housekeeping is made up.
        simulated_housekeeping: bool => "";
        /// Time since the lens's temperature was read, even where the value is too old to be known.
        temperature_lens_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the computer's temperature was read.
        temperature_computer_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the vessel's temperature was read.
        temperature_vessel_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the plate's temperature was read.
        temperature_plate_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the DC-DC converter's temperature was read.
        temperature_dcdc_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the flange's temperature was read.
        temperature_flange_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the pressure was read.
        pressure_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// Time since the free space was read.
        disk_free_age_s: Maybe<f64> => "s" [0.0, 1e10];
        /// The lens's temperature is known and outside its limits.
        temperature_lens_alarm: bool => "";
        /// The computer's temperature is known and outside its limits.
        temperature_computer_alarm: bool => "";
        /// The vessel's temperature is known and outside its limits.
        temperature_vessel_alarm: bool => "";
        /// The plate's temperature is known and outside its limits.
        temperature_plate_alarm: bool => "";
        /// The DC-DC converter's temperature is known and outside its limits.
        temperature_dcdc_alarm: bool => "";
        /// The flange's temperature is known and outside its limits.
        temperature_flange_alarm: bool => "";
        /// The pressure is known and outside its limits.
        pressure_alarm: bool => "";
        /// The free space is known and less than its limit.
        disk_free_alarm: bool => "";
        /// Time until the disk is full if it goes on filling as in the last hours; unknown while it does not fill.
        disk_days_left: Maybe<f64> => "d" [0.0, 36525.0];
        /// Counts the runs of the service on this computer, from 1; unknown where nothing is kept.
        run_number: Maybe<U32Le> => "";
        /// How the run before this one ended.
        last_end: Maybe<Coded<LastEnd>> => "";
        /// What was found at the start of what earlier runs kept: counters of commands, commanded settings, the focus.
        kept_at_start: Coded<Found> => "";
        /// Times that the lens's actor was started again.
        restarts_lens: U32Le => "";
        /// Times that the ledger was started again.
        restarts_ledger: U32Le => "";
        /// Times that the housekeeping was started again.
        restarts_housekeeping: U32Le => "";
        /// Times that an archive of images was started again.
        restarts_archive: U32Le => "";
        /// What is left undone for want of time.
        shed: Coded<Shed> => "";
        /// Images kept on disk since the start.
        images_kept: U32Le => "";
        /// Images that could not be kept there.
        images_lost: U32Le => "";
        /// Images kept earlier that went to make room.
        images_thinned: U32Le => "";
        /// Times that this disk refused an image.
        images_disk_errors: U32Le => "";
        /// The same of the second disk, where there is one: images kept.
        copies_kept: U32Le => "";
        /// Images that could not be kept there.
        copies_lost: U32Le => "";
        /// Images kept earlier that went to make room.
        copies_thinned: U32Le => "";
        /// Times that this disk refused an image.
        copies_disk_errors: U32Le => "";
        /// The part of the service that was started again last.
        last_restart: Maybe<Coded<Actor>> => "";
        /// Why it had ended, cut where it is longer; empty where nothing was started again.
        last_restart_reason: Text<64> => "";
        /// Time since then.
        last_restart_age_s: Maybe<f64> => "s" [0.0, 1e10];
    }
}
