//! What outlasts a restart of the program, beside the mark of each run: the counters of commands, the number of the last lease, the
//! settings that commands changed, how the last of them ended, where the focus was, and what the autofocus learned.
//!
//! It is small, and written whole each time that any of it changes; see [`super::ledger`] for when, and [`super::twin`] for how.

use super::state::State;
use super::twin;
use crate::command::{self, Answer, Command, Epoch, Memory};
use crate::lens::autofocus::Learned;
use crate::lens::{Doubt, FocusKept, Known};
use crate::settings::Settings;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// What is kept.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Kept {
    /// The counters of commands.
    pub counters: Memory,
    /// The number of the last lease.
    pub epoch: Epoch,
    /// The commands that made the settings what they are, as they are written; the last of each kind.
    pub commanded: Vec<String>,
    /// Where the focus was.
    pub focus: FocusKept,
    /// What the autofocus learned.
    pub learned: Learned,
    /// How commands ended that their computers have not been told.
    pub answers: Vec<Answer>,
}

impl Kept {
    /// What one of the two files has; `None` where it is damaged.
    pub fn from_file(bytes: &[u8]) -> Option<Self> {
        twin::decode(bytes).map(|(_, kept)| kept)
    }

    /// What of the state is to be kept.
    pub fn of(state: &State, learned: Learned) -> Self {
        Self {
            counters: state.guard.memory().clone(),
            epoch: state.charge.last_epoch(),
            commanded: state.commanded.iter().map(Command::to_string).collect(),
            focus: state.focus_kept,
            learned,
            answers: state.desk.unanswered(),
        }
    }

    /// The settings of the start as commands of earlier runs changed them, and those commands. A complaint names one that these
    /// settings do not allow any more: it is left out.
    pub fn settings(&self, initial: &Arc<Settings>) -> (Arc<Settings>, Vec<Command>, Vec<String>) {
        let (mut settings, mut commanded, mut complaints) = (Arc::clone(initial), Vec::new(), Vec::new());
        for text in &self.commanded {
            let after = Command::parse(text).map_err(|error| error.to_string()).and_then(|command| {
                let after = command::apply(&command, &settings).ok_or("it changes no setting".to_owned())?;
                Ok((command, after.map_err(|error| error.to_string())?))
            });
            match after {
                Ok((command, after)) => {
                    settings = Arc::new(after);
                    commanded.push(command);
                }
                Err(why) => complaints.push(format!("{text}: {why}")),
            }
        }
        (settings, commanded, complaints)
    }
}

/// What is to be kept of the focus now. Before anything was read or asked, what was kept before stands.
pub fn focus(state: &State) -> FocusKept {
    if let Some(to) = state.lens.going_back.filter(|_| state.lens_requests.is_empty()) {
        return FocusKept::GoingBack(to);
    }
    match (state.lens.focus, state.focus_known()) {
        (_, Some(at)) => FocusKept::At(at),
        (Known::Unknown(Doubt::NeverRead | Doubt::NoLens | Doubt::PortLost), _) if state.lens_requests.is_empty() => {
            state.focus_kept
        }
        (Known::Unknown(doubt), _) if doubt.is_mended_by_learning() => FocusKept::InDoubt,
        _ => FocusKept::Unknown,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_commands_changed_are_changed_again_and_what_does_not_fit_any_more_is_named() {
        let initial = Arc::new(Settings::flight().unwrap());
        let texts =
            ["solver.configure 0 7.5", "focus.set_range 2000 2500 25", "focus.set_range 3 2 1", "lens.stop", "solver.nap 1"];
        let kept = Kept { commanded: texts.map(str::to_owned).to_vec(), ..Kept::default() };
        let (settings, commanded, complaints) = kept.settings(&initial);
        assert_eq!((settings.solver.enabled, settings.solver.timeout_s), (false, 7.5));
        assert_eq!(settings.focus.step_counts, 25);
        assert_eq!(commanded.iter().map(Command::to_string).collect::<Vec<_>>(), texts[..2]);
        assert_eq!(complaints.len(), 3, "{complaints:?}");
        assert!(complaints[0].contains("focus.search_m") && complaints[2].contains("solver.nap"), "{complaints:?}");
    }
}
