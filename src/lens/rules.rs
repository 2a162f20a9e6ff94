//! The settings of the lens as the state machine uses them.

use super::request::LensCommand;
use crate::settings::LensSettings;
use std::time::Duration;

/// Times, tolerances and permissions.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Rules {
    /// A reply to a word that doesn't move comes within this time.
    pub reply_timeout: Duration,
    /// A reply to a word that moves comes within this time.
    pub move_timeout: Duration,
    /// A reply to the word that learns the range comes within this time.
    pub learn_timeout: Duration,
    /// Times that a word that doesn't move is sent again.
    pub retries: u32,
    /// Pause before something unknown is read again.
    pub retry_pause: Duration,
    /// Time between reads of a lens at rest.
    pub check_period: Duration,
    /// Time between searches for the controller.
    pub search_period: Duration,
    /// A position this near to another is the same.
    pub tolerance: u32,
    /// Make lens and aperture ready when the controller is found for the first time.
    pub init_on_startup: bool,
    /// Learn the range anew by itself, and go back, after the controller forgot it or lost counts.
    pub relearn: bool,
    /// Not again within this time.
    pub relearn_pause: Duration,
}

impl Rules {
    /// The longest that a request can take from its start to its end, whatever the controller does.
    pub fn longest(&self, command: LensCommand) -> Duration {
        let attempts = self.retries + 1;
        let in_step = self.reply_timeout * attempts;
        let reading = (self.reply_timeout * 2 + in_step) * attempts;
        let moving = if command == LensCommand::InitFocus { self.learn_timeout } else { self.move_timeout };
        in_step + reading * 2 + if command.moves() { moving } else { Duration::ZERO }
    }

    /// What the settings say.
    pub fn of(settings: &LensSettings) -> Self {
        let time = Duration::from_secs_f64;
        Self {
            reply_timeout: time(settings.reply_timeout_s),
            move_timeout: time(settings.move_timeout_s),
            learn_timeout: time(settings.learn_timeout_s),
            retries: settings.retries,
            retry_pause: time(settings.retry_pause_s),
            check_period: time(settings.check_period_s),
            search_period: time(settings.search_period_s),
            tolerance: settings.tolerance_counts,
            init_on_startup: settings.init_on_startup,
            relearn: settings.relearn,
            relearn_pause: time(settings.relearn_pause_s),
        }
    }
}
