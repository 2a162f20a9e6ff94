//! How requests and own tasks are worked off, step by step.

use super::axis::{Axis, Misfit, Wish};
use super::job::{Job, Step};
use super::{Action, Control, Phase, answer};
use crate::command::Tick;
use crate::lens::language::{Reply, Word};
use crate::lens::request::{AperturePosition, FocusCounts, LensCommand, LensError, LensResult};
use crate::lens::state::{Doubt, Known};
use std::time::Duration;

/// A reading that says what it should counts when it came this often alike.
const EXPECTED_TIMES: u32 = 2;
/// Any other: what is garbled is seldom garbled alike.
const SURPRISING_TIMES: u32 = 4;

impl Control {
    /// Begins with what is due next: what the lens must do by itself to be known, then the requests, then reads by and by.
    /// Whether there was anything.
    pub(super) fn begin_next(&mut self, now: Tick, out: &mut Vec<Action>) -> bool {
        let own = self.own_task().filter(|(at, command)| *at <= now && (command.moves() || self.queue.is_empty()));
        let job = match own {
            Some((_, command)) => self.own_job(now, command),
            None => match self.queue.pop_front() {
                Some((counter, command)) => Job::new(Some(counter), command),
                None => return false,
            },
        };
        let (command, counter) = (job.command, job.counter);
        self.job = Some(job);
        match command {
            LensCommand::Flush => {
                self.start(out);
                self.sync(now, None, 0, out);
            }
            LensCommand::SetAperture(AperturePosition(wanted)) if wanted < 0 => {
                let error = LensError::OutOfRange { wanted: wanted.into(), nearest: 0, furthest: i32::MAX };
                self.finish(now, Err(error), out);
            }
            _ => {
                if counter.is_none() && command.moves() {
                    tracing::info!(?command, "the lens moves by itself to be known again");
                }
                self.send(now, out);
            }
        }
        true
    }

    /// A task of its own. Learning ends with going back, unless a command that waits goes somewhere else.
    fn own_job(&mut self, now: Tick, command: LensCommand) -> Job {
        let waits = |concerned: fn(LensCommand) -> bool| self.queue.iter().any(|(_, command)| concerned(*command));
        match command {
            LensCommand::InitFocus => {
                let back = !waits(LensCommand::moves_focus);
                self.focus.learning(now, back);
            }
            LensCommand::InitAperture => {
                let back = !waits(LensCommand::moves_aperture);
                self.aperture.learning(now, back);
            }
            _ => {}
        }
        Job::new(None, command)
    }

    /// What focus or aperture want by themselves, and when: the earlier.
    pub(super) fn own_task(&self) -> Option<(Tick, LensCommand)> {
        let pause = self.rules.relearn.then_some(self.rules.relearn_pause);
        let focus = self.focus.wish(pause).map(|(at, wish)| {
            (
                at,
                match wish {
                    Wish::Read => LensCommand::GetFocus,
                    Wish::Learn => LensCommand::InitFocus,
                    Wish::GoTo(to) => LensCommand::SetFocus(to),
                },
            )
        });
        let aperture = self.aperture.wish(pause).map(|(at, wish)| {
            (
                at,
                match wish {
                    Wish::Read => LensCommand::GetAperture,
                    Wish::Learn => LensCommand::InitAperture,
                    Wish::GoTo(to) => LensCommand::SetAperture(to),
                },
            )
        });
        focus.into_iter().chain(aperture).min_by_key(|(at, _)| *at)
    }

    /// Sends the word of the present step.
    pub(super) fn send(&mut self, now: Tick, out: &mut Vec<Action>) {
        let Some(word) = self.job.as_ref().and_then(Job::word) else { return };
        self.start(out);
        if word.moves_focus() {
            self.focus.begin_move(self.job.as_ref().and_then(|job| job.way));
        }
        if word.moves_aperture() {
            self.aperture.begin_move(None);
        }
        if word == Word::LearnFocus {
            self.range = None;
        }
        out.push(Action::Send(word.bytes()));
        self.phase = Phase::Awaiting { word, deadline: now + self.rules.timeout(word) };
    }

    /// Tells the asker that it is under way.
    fn start(&mut self, out: &mut Vec<Action>) {
        if let Some(job) = self.job.as_mut().filter(|job| !job.started) {
            job.started = true;
            answer(out, job.counter, LensResult::Started);
        }
    }

    /// The reply that belongs to the word came.
    pub(super) fn take_reply(&mut self, now: Tick, reply: Reply, out: &mut Vec<Action>) {
        self.phase = Phase::Ready;
        let Some(job) = self.job.as_mut() else { return };
        if job.step == Step::Move {
            job.advance(Step::After);
            let moved = job.command;
            if moved.moves_focus() {
                self.focus.doubt(Doubt::NotReadBack);
            } else {
                self.aperture.doubt(Doubt::NotReadBack);
            }
            self.send(now, out);
            return;
        }
        let times = match job.seen.take() {
            None => 1,
            Some((before, times)) if before == reply => times + 1,
            Some((before, _)) => {
                let (sent, reply) = (job.word().map_or("", Word::label), format!("{reply:?} after {before:?}"));
                return self.step_failed(now, LensError::Unexpected { sent, reply }, out);
            }
        };
        job.seen = Some((reply.clone(), times));
        if times < if self.is_expected(&reply) { EXPECTED_TIMES } else { SURPRISING_TIMES } {
            self.send(now, out);
        } else {
            self.take_reading(now, reply, out);
        }
    }

    /// Whether a reading says what it should.
    fn is_expected(&self, reply: &Reply) -> bool {
        match (reply, self.job.as_ref()) {
            (Reply::Focus { at, furthest }, Some(job)) => {
                let goal = job.way.filter(|_| job.step == Step::After).map(|(_, goal)| goal);
                let should = goal.or(self.focus.place());
                self.span.is_some_and(|span| self.same(span, *furthest)) && should.is_some_and(|should| self.same(should, *at))
            }
            (Reply::Aperture(at), Some(Job { command: LensCommand::SetAperture(wanted), .. })) => at == wanted,
            (Reply::Aperture(at), _) => self.aperture.place() == Some(*at),
            _ => false,
        }
    }

    fn same(&self, a: FocusCounts, b: FocusCounts) -> bool {
        a.0.abs_diff(b.0) <= self.rules.tolerance
    }

    /// A reading that came often enough alike.
    fn take_reading(&mut self, now: Tick, reply: Reply, out: &mut Vec<Action>) {
        let Some(job) = self.job.clone() else { return };
        let result = match reply {
            Reply::Focus { at, furthest } => self.take_focus(&job, at, furthest),
            Reply::NotLearned => {
                self.power_cycled();
                Err(LensError::NotLearned)
            }
            Reply::Aperture(at) => self.take_aperture(&job, at),
            Reply::Version(_) | Reply::Done => Ok(()),
        };
        match result {
            Ok(()) if job.step == Step::Before => {
                if let Some(job) = self.job.as_mut() {
                    job.advance(Step::Move);
                }
                self.send(now, out);
            }
            result => self.finish(now, result, out),
        }
    }

    /// The controller does not know its focus range. If it did, it has forgotten the aperture as well.
    fn power_cycled(&mut self) {
        self.range = None;
        self.focus.not_learned();
        if self.focus.known == Known::Unknown(Doubt::PowerCycled) {
            self.aperture.not_learned();
        }
    }

    fn take_focus(&mut self, job: &Job, at: FocusCounts, furthest: FocusCounts) -> Result<(), LensError> {
        self.range = Some((FocusCounts(0), furthest));
        let tolerance = self.rules.tolerance;
        let is_between = |at: FocusCounts, (a, b): (FocusCounts, FocusCounts)| {
            (i64::from(a.0.min(b.0)) - i64::from(tolerance)..=i64::from(a.0.max(b.0)) + i64::from(tolerance))
                .contains(&i64::from(at.0))
        };
        if let Some(was) = self.span.replace(furthest).filter(|was| !self.same(*was, furthest)) {
            // The lens is as long as it was: counts were lost between its stops.
            self.focus.unlearn(Doubt::CountsLost);
            return Err(LensError::CountsLost { was: was.0, read: furthest.0 });
        }
        if let (Step::After, Some((start, goal))) = (job.step, job.way)
            && !self.same(at, goal)
            && !self.same(at, start)
        {
            self.focus.unlearn(Doubt::Missed);
            return Err(LensError::Missed { wanted: goal.0, reached: at.0 });
        }
        let accepted =
            self.focus.accept(at, job.has_learned(), is_between).map_err(|misfit| misfit_of(misfit, at.0, |was| was.0));
        match accepted {
            // Moving by counts in doubt is for a command to decide; what it leads to stays in doubt.
            Err(LensError::InDoubt { .. }) if job.step == Step::Before && job.counter.is_some() => {}
            accepted => accepted?,
        }
        match (job.step, job.way) {
            (Step::After, Some((_, goal))) if !self.same(at, goal) => Err(LensError::DidNotMove { wanted: goal.0, at: at.0 }),
            (Step::Before, _) => {
                let wanted = match job.command {
                    LensCommand::SetFocus(to) => i64::from(to.0),
                    LensCommand::MoveFocus(by) => i64::from(at.0) + i64::from(by),
                    _ => i64::from(at.0),
                };
                let goal = i32::try_from(wanted).ok().filter(|goal| (0..=furthest.0).contains(goal));
                let goal = goal.ok_or(LensError::OutOfRange { wanted, nearest: 0, furthest: furthest.0 })?;
                if let Some(job) = self.job.as_mut() {
                    job.way = Some((at, FocusCounts(goal)));
                }
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn take_aperture(&mut self, job: &Job, at: AperturePosition) -> Result<(), LensError> {
        self.aperture
            .accept(at, job.has_learned(), |at, (was, _)| at == was)
            .map_err(|misfit| misfit_of(misfit, at.0, |was| was.0))?;
        match job.command {
            LensCommand::SetAperture(wanted) if wanted != at => Err(LensError::Missed { wanted: wanted.0, reached: at.0 }),
            _ => Ok(()),
        }
    }

    /// The present step went wrong. A question is asked again, a few times; whatever it was, the line is brought in step first.
    pub(super) fn step_failed(&mut self, now: Tick, error: LensError, out: &mut Vec<Action>) {
        self.note(&error);
        let doubt = match error {
            LensError::TimedOut(_) => Doubt::TimedOut,
            LensError::Refused { .. } => Doubt::Refused,
            _ => Doubt::UnexpectedReply,
        };
        let Some(job) = self.job.as_mut() else { return self.sync(now, None, 0, out) };
        if job.command.concerns_focus() {
            self.focus.doubt(doubt);
        } else {
            self.aperture.doubt(doubt);
        }
        if job.step != Step::Move && job.retries < self.rules.retries {
            job.retries += 1;
            job.seen = None;
        } else {
            self.end_job(now, Err(error), out);
        }
        self.sync(now, None, 0, out);
    }

    /// The job is over, and the line in step.
    pub(super) fn finish(&mut self, now: Tick, result: Result<(), LensError>, out: &mut Vec<Action>) {
        if let Err(error) = &result {
            self.note(error);
        }
        self.end_job(now, result, out);
        self.phase = Phase::Ready;
    }

    fn end_job(&mut self, now: Tick, result: Result<(), LensError>, out: &mut Vec<Action>) {
        let Some(job) = self.job.take() else { return };
        let again = now + self.rules.retry_pause;
        let done = result.is_ok();
        match job.command {
            LensCommand::SetFocus(_) if job.counter.is_none() => self.focus.went_back(done, again),
            LensCommand::SetAperture(_) if job.counter.is_none() => self.aperture.went_back(done, again),
            _ => {}
        }
        let check = now + self.rules.check_period;
        if job.command.concerns_focus() {
            self.focus.due = next_read(&self.focus, job.step, now, again, check);
            // What befell the one may have befallen the other.
            if !done {
                self.aperture.due = self.aperture.due.min(again);
            }
        } else if job.command.concerns_aperture() {
            self.aperture.due = next_read(&self.aperture, job.step, now, again, check);
            if !done {
                self.focus.due = self.focus.due.min(again);
            }
        }
        answer(out, job.counter, result.map_or_else(LensResult::Failed, |()| LensResult::Completed));
    }
}

/// When to read again: by and by where it is known, at once after a move of which nobody knows how it ended, else after a pause.
fn next_read<T>(axis: &Axis<T>, step: Step, now: Tick, again: Tick, check: Tick) -> Tick {
    match axis.known {
        Known::Known(_) | Known::Unknown(Doubt::NotLearned | Doubt::PowerCycled) => check,
        _ if step == Step::Move => now,
        _ => again,
    }
}

fn misfit_of<T>(misfit: Misfit<T>, read: i32, counts: impl Fn(T) -> i32) -> LensError {
    match misfit {
        Misfit::Lost { was } => LensError::CountsLost { was: counts(was), read },
        Misfit::InDoubt => LensError::InDoubt { read },
    }
}

impl super::super::rules::Rules {
    /// How long a reply to this word may take.
    fn timeout(&self, word: Word) -> Duration {
        match word {
            Word::LearnFocus => self.learn_timeout,
            Word::SetFocus(_) | Word::MoveFocus(_) | Word::InitAperture | Word::SetAperture(_) => self.move_timeout,
            Word::Version | Word::ReadFocus | Word::ReadAperture => self.reply_timeout,
        }
    }
}
