//! Orders: what the hub does with a command that passed every check.

use super::camera::ToCamera;
use super::hub::{Hub, ToHub};
use super::state::{Ending, Settling, State};
use crate::command::{self, Command, Errand, OrderNumber, Refusal, Stage, Tick};
use crate::lens::{AperturePosition, FocusCounts, LensCommand, LensError, LensResult, RequestCounter, autofocus};
use std::path::Path;
use std::process::Stdio;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// A program that a command runs must end within this time; otherwise it is killed.
const PROGRAM_ENDS_WITHIN: Duration = Duration::from_secs(60);

/// The number of no order: what nobody gave.
pub const NOBODY: OrderNumber = OrderNumber(0);

/// How an order went at once, or that its result comes later.
enum Done {
    /// It is done.
    Now(String),
    /// It is done, and ends once it is on disk that it was.
    OnceKept(String),
    /// It has begun, and its result comes as a message.
    Later,
    /// That it begins comes as a message too.
    Asked,
    /// It cannot be done.
    Not(Refusal, String),
}

impl Hub {
    /// Does what an order says, and puts what came of it into the replies.
    pub(super) fn carry_out(&self, state: &mut State, now: Tick, number: OrderNumber, command: Command) {
        tracing::info!(order = number.0, %command, "command");
        let done = match command::apply(&command, &state.settings) {
            Some(Ok(settings)) => {
                state.adopt(Arc::new(settings), &self.initial);
                state.note_commanded(command);
                Done::OnceKept(String::new())
            }
            Some(Err(error)) => Done::Not(Refusal::OutOfRange, error.to_string()),
            None => self.act(state, number, command),
        };
        let (stage, why, words) = match done {
            Done::OnceKept(words) if self.ledger.is_some() => {
                state.settling.push(Settling { number, record: state.records_sent + 1, words });
                return;
            }
            Done::Now(words) | Done::OnceKept(words) => (Stage::Completed, None, words),
            Done::Later => (Stage::Started, None, String::new()),
            Done::Asked => return,
            Done::Not(why, words) => (Stage::Failed, Some(why), words),
        };
        self.report(state, now, number, (stage, why, words));
    }

    fn act(&self, state: &mut State, number: OrderNumber, command: Command) -> Done {
        let commands = &state.settings.commands;
        match command {
            Command::Quit {} => {
                state.ending = Some(Ending::Commanded);
                Done::Now("the program ends".to_owned())
            }
            Command::ShutDown { restart: false } => self.run_program(number, "shut_down_program", &commands.shut_down_program),
            Command::ShutDown { restart: true } => self.run_program(number, "restart_program", &commands.restart_program),
            Command::ResetNetwork {} => self.run_program(number, "network_reset_program", &commands.network_reset_program),
            Command::FactoryReset {} => {
                state.reset(&self.initial);
                self.at_desk(state, self.clock.uptime(), Errand::Disarm);
                Done::OnceKept("the settings of the start are in force".to_owned())
            }
            Command::KnownGood {} => {
                state.reset(&self.initial);
                self.at_desk(state, self.clock.uptime(), Errand::Disarm);
                self.stop_lens(state, number)
            }
            Command::StopLens {} => self.stop_lens(state, number),
            Command::RunFocus {} | Command::AdviseFocus {} | Command::Refocus { .. } => {
                match self.begin_focus(state, number, command) {
                    Ok(()) => Done::Later,
                    Err((why, words)) => Done::Not(why, words),
                }
            }
            Command::AbortFocus { use_result } => {
                if !self.focus.is_running() {
                    return Done::Now("no autofocus was under way".to_owned());
                }
                self.tell_focus(state, autofocus::Event::Abort { use_result });
                Done::Now(String::new())
            }
            Command::AbortSolver {} => {
                self.abort_solver.send_modify(|count| *count = count.wrapping_add(1));
                Done::Now(String::new())
            }
            Command::GetGain {} => self.ask_camera(ToCamera::GetGain(number)),
            Command::SetGain { gain_db } => {
                state.camera_gain = None;
                self.ask_camera(ToCamera::SetGain(number, gain_db))
            }
            _ => match lens_command(&command) {
                Some(asked) if asked.moves_focus() && self.focus.is_running() => {
                    Done::Not(Refusal::Busy, "an autofocus is under way: focus.abort ends it".to_owned())
                }
                Some(asked) => self.ask_lens_for(state, number, asked),
                None => Done::Not(Refusal::NotAvailable, "nothing carries this out yet".to_owned()),
            },
        }
    }

    /// Lets nothing more move: the autofocus ends, and the lens sends nothing more that moves.
    fn stop_lens(&self, state: &mut State, number: OrderNumber) -> Done {
        let done = self.ask_lens_for(state, number, LensCommand::Stop);
        self.tell_focus(state, autofocus::Event::Stop);
        done
    }

    fn ask_lens_for(&self, state: &mut State, number: OrderNumber, command: LensCommand) -> Done {
        match self.ask_lens(state, RequestCounter(number.0), command) {
            Ok(()) => Done::Asked,
            Err(error) => Done::Not(Refusal::Busy, error.to_string()),
        }
    }

    /// Sends a request to the lens. Until it is answered, what it may change is not known.
    pub(super) fn ask_lens(&self, state: &mut State, counter: RequestCounter, command: LensCommand) -> Result<(), LensError> {
        self.lens.request(counter, command)?;
        state.lens_requests.insert(counter, command);
        Ok(())
    }

    /// An answer of the lens: to a request of the autofocus, or to an order.
    pub(super) fn take_lens_result(&self, state: &mut State, now: Tick, counter: RequestCounter, result: &LensResult) {
        tracing::info!(request = counter.0, ?result, "lens");
        let asked = match result {
            LensResult::Started => state.lens_requests.get(&counter).copied(),
            _ => state.lens_requests.remove(&counter),
        };
        if self.take_own_move(state, counter, result) {
            return;
        }
        let is_stop = asked == Some(LensCommand::Stop);
        let number = OrderNumber(counter.0);
        let is_known_good =
            |(other, order): (OrderNumber, &command::Order)| other == number && matches!(order.command, Command::KnownGood {});
        if *result == LensResult::Completed && state.desk.under_way().any(is_known_good) {
            state.rests = Some(number);
            return self.tell_rest(state);
        }
        let (stage, why, words) = match result {
            LensResult::Started => (Stage::Started, None, String::new()),
            LensResult::Completed => (Stage::Completed, None, asked.map_or_else(String::new, |asked| state.lens_words(asked))),
            LensResult::Failed(LensError::NotThere) if is_stop => (Stage::Completed, None, "there is no lens".to_owned()),
            LensResult::Failed(error) => (Stage::Failed, Some(why_failed(error)), error.to_string()),
        };
        self.report(state, now, number, (stage, why, words));
    }

    /// Ends the order for the flight defaults once nothing moves any more: a move that had begun cannot be stopped.
    pub(super) fn tell_rest(&self, state: &mut State) {
        if state.lens.focus.is_moving() || state.lens.aperture.is_moving() {
            return;
        }
        if let Some(number) = state.rests.take() {
            let words = "flight defaults, lens at rest".to_owned();
            self.report(state, self.clock.uptime(), number, (Stage::Completed, None, words));
        }
    }

    fn ask_camera(&self, request: ToCamera) -> Done {
        match self.camera.as_ref().map(|camera| camera.try_send(request)) {
            Some(Ok(())) => Done::Later,
            Some(Err(_)) => Done::Not(Refusal::Busy, "the camera has as many requests as it may".to_owned()),
            None => Done::Not(Refusal::Device, "there is no camera".to_owned()),
        }
    }

    /// Resets the network because no flight computer was heard for long: as the command would, but nobody is told.
    pub(super) fn reset_after_lull(&self, state: &mut State) {
        let program = state.settings.commands.network_reset_program.clone();
        tracing::warn!(program, "no flight computer was heard for long: the network is reset");
        state.heard = Instant::now();
        state.network_resets = state.network_resets.saturating_add(1);
        self.run_program(NOBODY, "network_reset_program", &program);
    }

    /// Runs a program of the settings, with no arguments and nothing to read; its end comes back as a message.
    fn run_program(&self, number: OrderNumber, setting: &'static str, program: &str) -> Done {
        if program.is_empty() {
            return Done::Not(Refusal::Program, format!("commands.{setting} is empty"));
        }
        let (hub, program) = (self.own.clone(), program.to_owned());
        tokio::spawn(async move {
            let result = run(Path::new(&program)).await.map_err(|problem| format!("{program}: {problem}"));
            hub.tell(ToHub::Program { number, result }).await;
        });
        Done::Later
    }
}

/// What a command asks the lens, where it asks it for something.
fn lens_command(command: &Command) -> Option<LensCommand> {
    Some(match *command {
        Command::FlushLens {} => LensCommand::Flush,
        Command::InitFocus {} => LensCommand::InitFocus,
        Command::GetFocus {} => LensCommand::GetFocus,
        Command::SetFocus { position_counts } => LensCommand::SetFocus(FocusCounts(position_counts)),
        Command::MoveFocus { step_counts } => LensCommand::MoveFocus(step_counts),
        Command::InitAperture {} => LensCommand::InitAperture,
        Command::GetAperture {} => LensCommand::GetAperture,
        Command::SetAperture { position_counts } => LensCommand::SetAperture(AperturePosition(position_counts)),
        _ => return None,
    })
}

fn why_failed(error: &LensError) -> Refusal {
    match error {
        LensError::Stopped => Refusal::Stopped,
        LensError::Busy => Refusal::Busy,
        LensError::OutOfRange { .. } => Refusal::OutOfRange,
        _ => Refusal::Device,
    }
}

/// Runs a program to its end.
async fn run(program: &Path) -> Result<(), String> {
    let mut command = tokio::process::Command::new(program);
    command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).kill_on_drop(true);
    let mut child = command.spawn().map_err(|error| error.to_string())?;
    match tokio::time::timeout(PROGRAM_ENDS_WITHIN, child.wait()).await {
        Err(_) => Err(format!("did not end within {} s", PROGRAM_ENDS_WITHIN.as_secs())),
        Ok(Err(error)) => Err(error.to_string()),
        Ok(Ok(status)) if status.success() => Ok(()),
        Ok(Ok(status)) => Err(status.to_string()),
    }
}
