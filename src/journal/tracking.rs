//! Tracking run again: what was known of each frame beforehand, from the outcomes of those before it.

use super::entry::Solved;
use crate::settings::TrackingSettings;
use crate::solve::{FoundBy, Outcome, Prior, Tracker};

/// The tracker, as it is driven by a journal.
#[derive(Debug, Clone, Default)]
pub struct Tracking {
    tracker: Tracker,
    /// Not all is known of what it was told: entries are missing, or a frame's outcome is.
    in_doubt: bool,
}

impl Tracking {
    /// One that may have been told something before.
    pub fn in_doubt() -> Self {
        Self { tracker: Tracker::default(), in_doubt: true }
    }

    /// Something is missing.
    pub fn doubt(&mut self) {
        self.in_doubt = true;
    }

    /// Whether it is known to be told all.
    pub fn is_sure(&self) -> bool {
        !self.in_doubt
    }

    /// What is known of a frame beforehand.
    pub fn prior(&self, solved: &Solved, settings: &TrackingSettings) -> Prior {
        self.tracker.prior(solved.since, solved.sent.clone(), settings)
    }

    /// A frame ended. A solution that was found without any help tells all over again what frames after it are told.
    pub fn learn(&mut self, solved: &Solved, outcome: &Outcome, settings: &TrackingSettings) {
        self.tracker.learn(solved.since, outcome, settings);
        self.in_doubt &= !(outcome.solution.is_some() && outcome.found_by == Some(FoundBy::LostInSpace));
    }
}
