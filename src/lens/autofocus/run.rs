//! A run: what sweeps and refocuses have in common. One move at a time, a limit of time, and an orderly end.

use super::approach::Carriage;
use super::compare::Refocus;
use super::curves::Samples;
use super::plan::Pace;
use super::sweep::Sweep;
use super::travel::{Arrival, Travel};
use super::verdict::{BestFocus, Peak};
use super::{AutofocusRules, Decision, Ending, Finding, FocusImage, Left, Refusal, SweepPlan};
use crate::command::Tick;
use crate::lens::FocusCounts;
use std::time::Duration;

/// A position is given up without an image after this many times the time that a step takes, and not before this.
const PATIENCE_STEPS: u32 = 3;
const PATIENCE: Duration = Duration::from_secs(30);

/// What a task wants next.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Next {
    /// More images where the lens stands.
    Stay,
    /// The lens at a position.
    Go(i32),
    /// To end.
    End(End),
}

/// An end that is wanted.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct End {
    pub ending: Ending,
    pub best: Option<BestFocus>,
    pub confirmed: Option<bool>,
    /// Where the lens is to be left.
    pub to: Goal,
}

/// Where a run leaves the lens.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Goal {
    Best(i32),
    Start,
}

impl End {
    /// An end without a find: back to where the lens was.
    pub fn empty(ending: Ending) -> Self {
        Self { ending, best: None, confirmed: None, to: Goal::Start }
    }
}

/// What is done.
#[derive(Debug, Clone, PartialEq)]
enum Task {
    Sweep(Box<Sweep>),
    Refocus(Box<Refocus>),
}

/// A run under way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Run {
    task: Task,
    travel: Travel,
    start: Option<i32>,
    ends: Tick,
    /// What is said when the lens is where it is to be left.
    leaving: Option<(Finding, Option<i32>)>,
}

/// The best focus as it will be at a time, as a position.
pub(super) fn position_of(best: &BestFocus) -> i32 {
    best.counts.value.round().clamp(-1e9, 1e9) as i32
}

impl Run {
    /// Begins a sweep.
    pub fn sweep(
        now: Tick,
        rules: &AutofocusRules,
        plan: &SweepPlan,
        from: Option<FocusCounts>,
        pace: &mut Pace,
    ) -> Result<(Self, Decision), Refusal> {
        let carriage = Carriage::new(plan.min.0, plan.max.0, rules.backlash, from);
        let sweep = Sweep::new(now, rules, plan, (carriage.lowest(), carriage.highest()))?;
        let inside = |from: FocusCounts| (plan.min..=plan.max).contains(&from);
        match from {
            None if plan.advise_only => return Err(Refusal::PositionUnknown),
            Some(from) if plan.advise_only && !inside(from) => return Err(Refusal::OutsideRange),
            _ => {}
        }
        let start = from.filter(|from| inside(*from));
        Ok(Self::begin(now, rules, carriage, start, sweep.first(), Task::Sweep(Box::new(sweep)), pace))
    }

    /// Begins a refocus.
    pub fn refocus(
        now: Tick,
        rules: &AutofocusRules,
        by: i32,
        from: Option<FocusCounts>,
        pace: &mut Pace,
    ) -> Result<(Self, Decision), Refusal> {
        let from = from.ok_or(Refusal::PositionUnknown)?;
        let refocus = Refocus::new(rules, by, from)?;
        let (low, high) = (from.0.saturating_sub(rules.refocus).max(0), from.0.saturating_add(rules.refocus));
        let carriage = Carriage::new(low, high, rules.backlash, Some(from));
        Ok(Self::begin(now, rules, carriage, Some(from), from.0, Task::Refocus(Box::new(refocus)), pace))
    }

    fn begin(
        now: Tick,
        rules: &AutofocusRules,
        carriage: Carriage,
        start: Option<FocusCounts>,
        first: i32,
        task: Task,
        pace: &mut Pace,
    ) -> (Self, Decision) {
        pace.begin();
        let mut travel = Travel::new(carriage, now);
        // A carriage begins without its backlash taken up, so that there is always a move.
        let decision = travel.go(now, first).unwrap_or(Decision::Unchanged);
        let start = start.map(|at| at.0);
        (Self { task, travel, start, ends: now + rules.time_allowed, leaving: None }, decision)
    }

    /// An image came.
    pub fn image(&mut self, now: Tick, image: &FocusImage, pace: &mut Pace) -> Decision {
        let Some((position, stands_still)) = self.travel.place_of(image) else { return Decision::Unchanged };
        match &mut self.task {
            Task::Sweep(sweep) => sweep.take(position, image),
            Task::Refocus(refocus) => refocus.take(position, image),
        }
        if !stands_still || self.leaving.is_some() {
            return Decision::Unchanged;
        }
        pace.step(now);
        self.proceed(now, position, pace)
    }

    /// The lens is somewhere.
    pub fn arrived(&mut self, now: Tick, at: FocusCounts) -> Decision {
        match self.travel.arrived(now, at) {
            Arrival::Unexpected => Decision::Unchanged,
            Arrival::GoesOn(to) => Decision::Move(to),
            Arrival::Stands => match &mut self.task {
                _ if self.leaving.is_some() => self.leave(now),
                Task::Sweep(sweep) => {
                    sweep.stands_at(at.0);
                    Decision::Unchanged
                }
                Task::Refocus(_) => Decision::Unchanged,
            },
        }
    }

    /// The lens failed.
    pub fn failed(&self, now: Tick, why: String) -> Finding {
        Finding { ending: Ending::LensFailed(why), ..self.stopped(now) }
    }

    /// Ends where the lens is.
    pub fn stopped(&self, now: Tick) -> Finding {
        let best = self.peak().map(|peak| peak.best_at(now));
        Finding { ending: Ending::Stopped, best, left: Left::WhereItWas, confirmed: None }
    }

    /// Ends in an orderly way.
    pub fn abort(&mut self, now: Tick, use_result: bool) -> Decision {
        if self.leaving.is_some() {
            return Decision::Unchanged;
        }
        let found = match &self.task {
            Task::Sweep(sweep) if use_result => sweep.found_by(now),
            _ => None,
        };
        self.end(now, End { ending: Ending::Aborted, ..found.unwrap_or_else(|| End::empty(Ending::Aborted)) })
    }

    /// What the time asks for.
    pub fn check_time(&mut self, now: Tick, pace: &mut Pace) -> Decision {
        if self.travel.move_ends().is_some_and(|end| now >= end) {
            return Decision::Finished(self.failed(now, "no answer to a move".into()));
        }
        if self.leaving.is_some() {
            return Decision::Unchanged;
        }
        if now >= self.ends {
            let found = match &self.task {
                Task::Sweep(sweep) => sweep.found_in_time(now),
                Task::Refocus(_) => None,
            };
            return self.end(now, found.unwrap_or_else(|| End::empty(Ending::TimedOut)));
        }
        match (self.patience_ends(pace), self.travel.carriage().here()) {
            (Some(end), Some(here)) if now >= end => {
                pace.step(now);
                self.travel.wait_anew(now);
                self.proceed(now, here, pace)
            }
            _ => Decision::Unchanged,
        }
    }

    /// When to ask again, if nothing happens before.
    pub fn deadline(&self, pace: &Pace) -> Option<Tick> {
        // A move is not broken off: what the time asks for is seen when it has ended.
        self.travel.move_ends().or_else(|| Some(self.ends.min(self.patience_ends(pace)?)))
    }

    fn patience_ends(&self, pace: &Pace) -> Option<Tick> {
        Some(self.travel.standing_since()? + PATIENCE.max(PATIENCE_STEPS * pace.per_step()))
    }

    /// Asks the task what is next.
    fn proceed(&mut self, now: Tick, here: i32, pace: &mut Pace) -> Decision {
        let next = match &mut self.task {
            Task::Sweep(sweep) => sweep.next(now, here, pace),
            Task::Refocus(refocus) => refocus.next(),
        };
        match next {
            Next::Stay => Decision::Unchanged,
            Next::Go(to) => self.travel.go(now, to).unwrap_or(Decision::Unchanged),
            Next::End(end) => self.end(now, end),
        }
    }

    fn end(&mut self, now: Tick, end: End) -> Decision {
        let (left, to) = match (end.to, self.start) {
            (Goal::Best(to), _) => (Left::AtBest, Some(to)),
            (Goal::Start, Some(start)) => (Left::AtStart, Some(start)),
            (Goal::Start, None) => (Left::WhereItWas, None),
        };
        let finding = Finding { ending: end.ending, best: end.best, left, confirmed: end.confirmed };
        self.leaving = Some((finding, to));
        self.travel.halt();
        if self.travel.target().is_some() { Decision::Unchanged } else { self.leave(now) }
    }

    /// On the way to where the lens is left; the end, once it is there.
    fn leave(&mut self, now: Tick) -> Decision {
        let Some((finding, to)) = &mut self.leaving else { return Decision::Unchanged };
        let order = to.take().and_then(|to| self.travel.go(now, to));
        order.unwrap_or_else(|| Decision::Finished(finding.clone()))
    }

    /// Where the lens is on its way to, or stands.
    pub fn requested(&self) -> Option<FocusCounts> {
        self.travel.target().or_else(|| self.travel.carriage().here().map(FocusCounts))
    }

    /// What was seen.
    pub fn samples(&self) -> &Samples {
        match &self.task {
            Task::Sweep(sweep) => sweep.samples(),
            Task::Refocus(refocus) => refocus.samples(),
        }
    }

    /// The valid peak that the run has found so far.
    pub fn peak(&self) -> Option<&Peak> {
        match &self.task {
            Task::Sweep(sweep) => sweep.peak(),
            Task::Refocus(_) => None,
        }
    }

    /// When images are no longer taken.
    pub fn ends(&self) -> Tick {
        self.ends
    }
}
