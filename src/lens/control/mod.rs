//! The state machine that speaks with the controller.
//!
//! No clock and no port: the caller brings the time with each event, carries out the [`Action`]s, and asks again at
//! [`Control::deadline`]. The rules:
//!
//! - One word is out at a time. After anything unexpected the line is brought in step again with the word for the version: the
//!   controller answers in order, so that what came before its reply belongs to earlier words.
//! - A word that only asks is sent again a few times; one that moves never is. A reading counts when it came twice
//!   alike, and one that is not what it should be when it came four times.
//! - The focus is read before and after a move. What it reads must be where it was before, and where it should be after.
//! - After any doubt it is unknown until it is read again, or learned again where readings mean nothing any more. (Counts lost in the
//!   moment between that reading and the move can't be noticed, nor can those lost in a move be told from a motor that did not turn
//!   where they are as many as its own.)
//! - After a stop no word that moves is sent until a command moves.

mod axis;
mod job;
mod work;

use super::language::{Misread, Word, printable};
use super::request::{AperturePosition, FocusCounts, LensCommand, LensError, LensResult, RequestCounter};
use super::rules::Rules;
use super::state::{Doubt, FocusKept, Known, LensState};
use crate::command::Tick;
use axis::Axis;
use job::{Job, Step};
use std::collections::{BTreeMap, VecDeque};

/// Requests that may wait behind the one that is under way.
const QUEUE: usize = 16;

/// What happened.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum Event {
    /// What was asked, in this order, since the machine was told last. A stop among them holds for all before it.
    Requests(Vec<(RequestCounter, LensCommand)>),
    /// The port that [`Action::Open`] asked for is open, and what had waited there thrown away.
    Opened {
        /// Its path.
        port: String,
    },
    /// That port can't be had.
    NotOpened {
        /// Why not.
        why: String,
    },
    /// There are not so many ports.
    NoMorePorts,
    /// A line came, without its carriage return.
    Line(Vec<u8>),
    /// The port is gone.
    Lost {
        /// How that showed.
        why: String,
    },
    /// Nothing but that time went by.
    Time,
}

/// What is to be done, in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Action {
    /// Open the port of this number in the list of candidates, from 0.
    Open {
        /// Which.
        nth: usize,
    },
    /// Close the port.
    Close,
    /// Throw the unfinished line away, and send these bytes.
    Send(Vec<u8>),
    /// Tell whoever asked.
    Answer {
        /// The number of the request.
        counter: RequestCounter,
        /// How far it is.
        result: LensResult,
    },
}

/// What the line is at.
#[derive(Debug, Clone, PartialEq)]
enum Phase {
    /// No port; the next search begins then.
    Closed { again: Tick },
    /// This candidate is being opened.
    Opening { nth: usize },
    /// Asking for the version until the answer comes. `probe`: the candidate may be no lens controller.
    Syncing { probe: Option<usize>, tries: u32, heard: bool, deadline: Tick },
    /// In step; nothing is out.
    Ready,
    /// The reply to this word is awaited.
    Awaiting { word: Word, deadline: Tick },
}

/// The state machine.
#[derive(Debug, Clone)]
pub struct Control {
    rules: Rules,
    phase: Phase,
    port: Option<String>,
    version: Option<String>,
    /// Questions for the version that were sent and not answered.
    unanswered: u32,
    /// Whether the controller was ever found.
    found: bool,
    focus: Axis<FocusCounts>,
    range: Option<(FocusCounts, FocusCounts)>,
    /// From stop to stop as it was read last, which no power cycle changes.
    span: Option<FocusCounts>,
    aperture: Axis<AperturePosition>,
    queue: VecDeque<(RequestCounter, LensCommand)>,
    job: Option<Job>,
    errors: BTreeMap<&'static str, u32>,
    last_error: Option<String>,
}

impl Control {
    /// A machine that begins to search for the controller at the first event.
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            phase: Phase::Closed { again: Tick::ZERO },
            port: None,
            version: None,
            unanswered: 0,
            found: false,
            focus: Axis::new(),
            range: None,
            span: None,
            aperture: Axis::new(),
            queue: VecDeque::new(),
            job: None,
            errors: BTreeMap::new(),
            last_error: None,
        }
    }

    /// The same, after an earlier run of the program that left the focus so: a controller that lost power or counts meanwhile is found out.
    pub fn resuming(rules: Rules, focus: FocusKept) -> Self {
        let mut control = Self::new(rules);
        match focus {
            FocusKept::Unknown => {}
            FocusKept::At(at) => control.focus.resume(at),
            FocusKept::InDoubt => control.focus.unlearn(Doubt::CountsLost),
            FocusKept::GoingBack(to) => {
                // Whether its range was learned by then nobody knows any more: it is learned once more.
                control.focus.resume(to);
                control.focus.unlearn(Doubt::CountsLost);
            }
        }
        control
    }

    /// Takes note of an event at `now`, which never runs backwards.
    pub fn on(&mut self, now: Tick, event: Event) -> Vec<Action> {
        let mut out = Vec::new();
        match event {
            Event::Requests(all) => all.into_iter().for_each(|(counter, command)| self.take_request(counter, command, &mut out)),
            Event::Opened { port } => self.take_port(now, port, &mut out),
            Event::NotOpened { why } => {
                tracing::debug!(why, "no lens controller there");
                self.next_port(&mut out);
            }
            Event::NoMorePorts => self.phase = Phase::Closed { again: now + self.rules.search_period },
            Event::Line(line) => self.take_line(now, &line, &mut out),
            Event::Lost { why } => self.lose(now, why, &mut out),
            Event::Time => {}
        }
        // Text without end may not keep the time from passing.
        self.take_time(now, &mut out);
        while matches!(self.phase, Phase::Ready) && self.job.is_none() && self.begin_next(now, &mut out) {}
        out
    }

    /// When to call [`Self::on`] with [`Event::Time`], if nothing happens before.
    pub fn deadline(&self) -> Option<Tick> {
        match self.phase {
            Phase::Closed { again } => Some(again),
            Phase::Opening { .. } => None,
            Phase::Syncing { deadline, .. } | Phase::Awaiting { deadline, .. } => Some(deadline),
            Phase::Ready => self.own_task().map(|(at, _)| at),
        }
    }

    /// All that is known now. A value that an open request will say or change is not shown.
    pub fn state(&self) -> LensState {
        let asked = self.job.iter().filter(|job| job.counter.is_some()).map(|job| job.command);
        let open = || self.queue.iter().map(|(_, command)| *command).chain(asked.clone());
        LensState {
            port: self.port.clone(),
            connected: self.is_connected(),
            version: self.version.clone(),
            focus: shown(self.focus.known, open().any(LensCommand::concerns_focus)),
            range: self.range,
            aperture: shown(self.aperture.known, open().any(LensCommand::concerns_aperture)),
            going_back: self.focus.goes_back_to(),
            stopped: self.focus.stopped || self.aperture.stopped,
            busy: self.job.as_ref().map(|job| job.command),
            waiting: self.queue.len(),
            errors: self.errors.clone(),
            last_error: self.last_error.clone(),
        }
    }

    fn is_connected(&self) -> bool {
        matches!(self.phase, Phase::Ready | Phase::Awaiting { .. } | Phase::Syncing { probe: None, .. })
    }

    fn take_request(&mut self, counter: RequestCounter, command: LensCommand, out: &mut Vec<Action>) {
        let refused = if command == LensCommand::Stop {
            self.stop(out);
            answer(out, Some(counter), LensResult::Completed);
            return;
        } else if !self.is_connected() {
            LensError::NotConnected
        } else if self.queue.len() >= QUEUE {
            LensError::Busy
        } else {
            if command.moves_focus() {
                self.focus.taken_over();
            }
            if command.moves_aperture() {
                self.aperture.taken_over();
            }
            self.queue.push_back((counter, command));
            return;
        };
        answer(out, Some(counter), LensResult::Failed(refused));
    }

    /// From here on no word that moves goes out.
    fn stop(&mut self, out: &mut Vec<Action>) {
        self.focus.stop();
        self.aperture.stop();
        let (moving, other): (VecDeque<_>, VecDeque<_>) = self.queue.drain(..).partition(|(_, command)| command.moves());
        self.queue = other;
        for (counter, _) in moving {
            answer(out, Some(counter), LensResult::Failed(LensError::Stopped));
        }
        if let Some(job) = self.job.as_mut().filter(|job| job.command.moves() && job.step == Step::Before) {
            // Its reading is awaited, and is worth having; what it was for is over.
            answer(out, job.counter.take(), LensResult::Failed(LensError::Stopped));
            job.command = LensCommand::GetFocus;
            job.step = Step::After;
        }
    }

    fn take_port(&mut self, now: Tick, port: String, out: &mut Vec<Action>) {
        let Phase::Opening { nth } = self.phase else { return };
        self.port = Some(port);
        self.unanswered = 0;
        self.sync(now, Some(nth), 0, out);
    }

    /// This candidate is none: on to the next.
    fn next_port(&mut self, out: &mut Vec<Action>) {
        let (Phase::Opening { nth } | Phase::Syncing { probe: Some(nth), .. }) = self.phase else { return };
        self.port = None;
        self.phase = Phase::Opening { nth: nth + 1 };
        out.push(Action::Open { nth: nth + 1 });
    }

    /// Asks for the version; the carriage return before it ends whatever half of a word the controller may have.
    fn sync(&mut self, now: Tick, probe: Option<usize>, tries: u32, out: &mut Vec<Action>) {
        self.unanswered = self.unanswered.saturating_add(1);
        self.phase = Phase::Syncing { probe, tries, heard: false, deadline: now + self.rules.reply_timeout };
        let mut bytes = b"\r".to_vec();
        bytes.extend(Word::Version.bytes());
        out.push(Action::Send(bytes));
    }

    fn take_line(&mut self, now: Tick, line: &[u8], out: &mut Vec<Action>) {
        let marker = Word::Version.read(line).is_ok();
        if marker {
            self.unanswered = self.unanswered.saturating_sub(1);
        }
        match &mut self.phase {
            Phase::Closed { .. } | Phase::Opening { .. } => {}
            Phase::Syncing { heard, .. } if marker => {
                *heard = true;
                self.version = str::from_utf8(line).ok().map(|text| text.trim().trim_start_matches("s:").to_owned());
                if self.unanswered == 0 {
                    self.in_step(now, out);
                }
            }
            // Belongs to a word before, whose failure is counted already; a late answer about the version harms nobody.
            Phase::Syncing { .. } => tracing::debug!(line = printable(line), "late on the lens line"),
            Phase::Ready | Phase::Awaiting { .. } if marker => {}
            Phase::Ready => {
                self.note(&LensError::Unasked(printable(line)));
                self.focus.doubt(Doubt::UnexpectedReply);
                self.aperture.doubt(Doubt::UnexpectedReply);
                (self.focus.due, self.aperture.due) = (now, now);
                self.sync(now, None, 0, out);
            }
            Phase::Awaiting { word, .. } => {
                let (word, sent) = (*word, word.label());
                match word.read(line) {
                    Ok(reply) => self.take_reply(now, reply, out),
                    Err(Misread::Refused(reply)) => self.step_failed(now, LensError::Refused { sent, reply }, out),
                    Err(Misread::Unexpected(reply)) => self.step_failed(now, LensError::Unexpected { sent, reply }, out),
                }
            }
        }
    }

    fn take_time(&mut self, now: Tick, out: &mut Vec<Action>) {
        match self.phase {
            Phase::Closed { again } if now >= again => {
                self.phase = Phase::Opening { nth: 0 };
                out.push(Action::Open { nth: 0 });
            }
            Phase::Syncing { probe, tries, heard, deadline } if now >= deadline => {
                if heard {
                    // It answers; those answers that are missing will not come any more.
                    self.unanswered = 0;
                    self.in_step(now, out);
                } else if tries < self.rules.retries {
                    self.sync(now, probe, tries + 1, out);
                } else if probe.is_some() {
                    out.push(Action::Close);
                    self.next_port(out);
                } else {
                    self.lose(now, "the controller does not answer".to_owned(), out);
                }
            }
            Phase::Awaiting { word, deadline } if now >= deadline => {
                self.step_failed(now, LensError::TimedOut(word.label()), out);
            }
            _ => {}
        }
    }

    /// The line is in step with the controller.
    fn in_step(&mut self, now: Tick, out: &mut Vec<Action>) {
        if let Phase::Syncing { probe: Some(_), .. } = self.phase {
            let version = self.version.as_deref().unwrap_or_default();
            tracing::info!(port = self.port, version, "lens controller found");
            if !self.found {
                let learn = self.rules.init_on_startup && !self.focus.stopped;
                (self.focus.learn_first, self.aperture.learn_first) = (learn, learn);
            }
            self.found = true;
            (self.focus.due, self.aperture.due) = (now, now);
        }
        self.phase = Phase::Ready;
        match &self.job {
            Some(job) if job.command == LensCommand::Flush => self.finish(now, Ok(()), out),
            Some(_) => self.send(now, out),
            None => {}
        }
    }

    /// The controller is gone: nothing that waits for it will be done later, when nobody expects it.
    fn lose(&mut self, now: Tick, why: String, out: &mut Vec<Action>) {
        match self.phase {
            Phase::Closed { .. } | Phase::Opening { .. } => return,
            Phase::Syncing { probe: Some(_), .. } => {
                out.push(Action::Close);
                self.next_port(out);
                return;
            }
            _ => {}
        }
        let error = LensError::PortLost(why);
        self.note(&error);
        out.push(Action::Close);
        let open = self.queue.drain(..).map(|(counter, _)| Some(counter)).chain(self.job.take().map(|job| job.counter));
        for counter in open {
            answer(out, counter, LensResult::Failed(error.clone()));
        }
        self.focus.doubt(Doubt::PortLost);
        self.aperture.doubt(Doubt::PortLost);
        self.range = None;
        self.port = None;
        self.phase = Phase::Closed { again: now + self.rules.search_period };
    }

    /// Counts an error and keeps its words.
    fn note(&mut self, error: &LensError) {
        let count = self.errors.entry(error.label()).or_default();
        *count = count.saturating_add(1);
        tracing::warn!(%error, "lens");
        self.last_error = Some(error.to_string());
    }
}

/// What is shown of a value: not one that an open request is about to say or change.
fn shown<T>(known: Known<T>, open: bool) -> Known<T> {
    match known {
        Known::Known(_) if open => Known::Unknown(Doubt::Requested),
        known => known,
    }
}

fn answer(out: &mut Vec<Action>, counter: Option<RequestCounter>, result: LensResult) {
    if let Some(counter) = counter {
        out.push(Action::Answer { counter, result });
    }
}
