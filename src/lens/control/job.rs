//! One request on its way, or a task of the lens's own: read before, move, read back.

use super::super::language::{Reply, Word};
use super::super::request::{FocusCounts, LensCommand, RequestCounter};

/// Which of its words is out, or is to be sent next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Step {
    /// Where is it, before it is moved?
    Before,
    /// The word that moves; sent once, never again.
    Move,
    /// Where is it now?
    After,
}

/// What is being done.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Job {
    /// Whose answer it is; `None` for an own task.
    pub counter: Option<RequestCounter>,
    pub command: LensCommand,
    pub step: Step,
    /// Times that this step was begun again.
    pub retries: u32,
    /// A reading that waits for others that say the same, for there is no checksum on the line; and how often it came.
    pub seen: Option<(Reply, u32)>,
    /// Where the focus was before, and where it should be.
    pub way: Option<(FocusCounts, FocusCounts)>,
    /// Whether the asker knows that it is under way.
    pub started: bool,
}

impl Job {
    pub fn new(counter: Option<RequestCounter>, command: LensCommand) -> Self {
        let step = match command {
            LensCommand::SetFocus(_) | LensCommand::MoveFocus(_) => Step::Before,
            LensCommand::InitFocus | LensCommand::InitAperture | LensCommand::SetAperture(_) => Step::Move,
            LensCommand::Flush | LensCommand::GetFocus | LensCommand::GetAperture | LensCommand::Stop => Step::After,
        };
        Self { counter, command, step, retries: 0, seen: None, way: None, started: false }
    }

    /// The word of this step; `None` where the command has none of its own.
    pub fn word(&self) -> Option<Word> {
        Some(match (self.command, self.step) {
            (LensCommand::Flush | LensCommand::Stop, _) => return None,
            (LensCommand::InitFocus, Step::Move) => Word::LearnFocus,
            (LensCommand::SetFocus(to), Step::Move) => Word::SetFocus(to),
            (LensCommand::MoveFocus(by), Step::Move) => Word::MoveFocus(by),
            (LensCommand::InitAperture, Step::Move) => Word::InitAperture,
            (LensCommand::SetAperture(to), Step::Move) => Word::SetAperture(to),
            (command, _) if command.concerns_focus() => Word::ReadFocus,
            _ => Word::ReadAperture,
        })
    }

    /// Whether it was learned just now, so that what is read means something again.
    pub fn has_learned(&self) -> bool {
        matches!(self.command, LensCommand::InitFocus | LensCommand::InitAperture)
    }

    /// On to the next step.
    pub fn advance(&mut self, step: Step) {
        (self.step, self.retries, self.seen) = (step, 0, None);
    }
}
