//! The sweep: once widely through the range, then about the peak, then to the best focus and a look at it.

use super::curves::Samples;
use super::plan::{Pace, Pass};
use super::run::{End, Goal, Next, position_of};
use super::verdict::{Peak, Side, Verdict, judge};
use super::{AutofocusRules, Ending, FocusImage, Metric, Refusal, SweepPlan};
use crate::command::Tick;
use std::time::Duration;

/// Parts of the time allowed by which the wide pass is done, one that is repeated, and those about the peak.
const WIDE_PART: f64 = 0.5;
const REPEATED_PART: f64 = 0.8;
const CLOSE_PART: f64 = 0.87;
/// Wide passes, passes about the peak, and moves to the best focus.
const WIDE_PASSES: u8 = 2;
const CLOSE_PASSES: u8 = 2;
const SETTLINGS: u8 = 2;
/// Images with known stars that confirm the focus, and images taken for that at most.
const CONFIRMING: u32 = 2;
const CONFIRMING_AT_MOST: u32 = 5;
/// Stars at the best focus have this part at least of the peak that their curves have there.
const CONFIRMED: f64 = 0.7;
/// A best focus nearer than this to where the lens stands is not worth a move, counts.
const NEAR_ENOUGH: f64 = 3.0;
/// Least positions that a range must have room for.
const LEAST_POSITIONS: i32 = 5;

/// Where the sweep is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Stage {
    /// Widely through the range, for the n-th time.
    Wide(Pass, u8),
    /// About the peak, for the n-th time.
    Close(Pass, u8),
    /// At the best focus, for the n-th time, with images taken there.
    Settled(u8, u32),
}

/// A sweep under way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sweep {
    begun: Tick,
    allowed: Duration,
    step: i32,
    advise_only: bool,
    /// First and last position that images are taken at.
    range: (i32, i32),
    /// Width of the curve as these optics should have it, counts.
    width: f64,
    stage: Stage,
    samples: Samples,
    /// Positions that images were waited for at, sorted.
    visited: Vec<i32>,
    peak: Option<Box<Peak>>,
    /// The position that the pass asked for last.
    ordered: Option<i32>,
    /// Peaks at the best focus over what they should be there.
    confirming: Vec<Metric>,
}

impl Sweep {
    /// A sweep through positions `range`, all of which can be approached from below.
    pub fn new(now: Tick, rules: &AutofocusRules, plan: &SweepPlan, range: (i32, i32)) -> Result<Self, Refusal> {
        let step = plan.step.max(1);
        if range.1.saturating_sub(range.0) < step.saturating_mul(LEAST_POSITIONS - 1) {
            return Err(Refusal::RangeTooNarrow);
        }
        let pass = Pass { first: range.0, last: range.1, step, until: now + rules.time_allowed.mul_f64(WIDE_PART) };
        Ok(Self {
            begun: now,
            allowed: rules.time_allowed,
            step,
            advise_only: plan.advise_only,
            range,
            width: rules.curve_width(),
            stage: Stage::Wide(pass, 1),
            samples: Samples::default(),
            visited: Vec::new(),
            peak: None,
            ordered: None,
            confirming: Vec::new(),
        })
    }

    /// The first position.
    pub fn first(&self) -> i32 {
        self.range.0
    }

    /// The lens stands somewhere, and waits for an image.
    pub fn stands_at(&mut self, position: i32) {
        if let Err(place) = self.visited.binary_search(&position) {
            self.visited.insert(place, position);
        }
    }

    /// Takes an image that counts.
    pub fn take(&mut self, position: i32, image: &FocusImage) {
        self.samples.add(position, image);
        let confirms = matches!(self.stage, Stage::Settled(..));
        if let (true, Some(peak), Some(sample)) = (confirms, &self.peak, self.samples.iter().last()) {
            self.confirming.extend(peak.against(sample));
        }
    }

    /// What is next, after an image or where none came.
    pub fn next(&mut self, now: Tick, here: i32, pace: &mut Pace) -> Next {
        match self.stage {
            Stage::Wide(pass, round) => match self.along(&pass, here, now, pace) {
                Some(next) => Next::Go(next),
                None => self.after_wide(now, round, pace),
            },
            Stage::Close(pass, round) => match self.along(&pass, here, now, pace) {
                Some(next) => Next::Go(next),
                None => self.after_close(now, round, pace),
            },
            Stage::Settled(round, images) => {
                self.stage = Stage::Settled(round, images + 1);
                let enough = self.confirming.len() >= CONFIRMING as usize || images + 1 >= CONFIRMING_AT_MOST;
                if enough { self.after_settling(now, here, round, pace) } else { Next::Stay }
            }
        }
    }

    /// The pass's next position; one that the lens was sent to, and did not quite reach, is not asked for again.
    fn along(&mut self, pass: &Pass, here: i32, now: Tick, pace: &Pace) -> Option<i32> {
        let next = pass.after(here, now, pace).filter(|next| self.ordered != Some(*next));
        self.ordered = next;
        next
    }

    fn after_wide(&mut self, now: Tick, round: u8, pace: &mut Pace) -> Next {
        match self.judge() {
            Verdict::Peak(peak) => {
                self.peak = Some(peak);
                self.close_in(now, 1, pace)
            }
            Verdict::Edge(side) => Next::End(End::empty(Ending::Edge(side))),
            Verdict::NoPeak | Verdict::TooFew if round < WIDE_PASSES => {
                let pass = Pass {
                    first: self.range.0,
                    last: self.range.1,
                    step: self.step,
                    until: self.begun + self.allowed.mul_f64(REPEATED_PART),
                };
                self.stage = Stage::Wide(pass, round + 1);
                pace.begin();
                Next::Go(pass.first)
            }
            Verdict::NoPeak => Next::End(End::empty(Ending::NoPeak)),
            Verdict::TooFew => Next::End(End::empty(Ending::TooFew)),
        }
    }

    fn after_close(&mut self, now: Tick, round: u8, pace: &mut Pace) -> Next {
        match self.judge() {
            Verdict::Peak(peak) => {
                self.peak = Some(peak);
                if round < CLOSE_PASSES { self.close_in(now, round + 1, pace) } else { self.settle(now, 1, pace) }
            }
            Verdict::Edge(side) => Next::End(End::empty(Ending::Edge(side))),
            Verdict::NoPeak | Verdict::TooFew => Next::End(End::empty(Ending::NoPeak)),
        }
    }

    /// Begins a pass about the peak, if there is time for one.
    fn close_in(&mut self, now: Tick, round: u8, pace: &mut Pace) -> Next {
        let until = self.begun + self.allowed.mul_f64(CLOSE_PART);
        let left = until.saturating_sub(now);
        let share = left / u32::from(CLOSE_PASSES.saturating_sub(round) + 1);
        let pass = self.peak.as_ref().and_then(|peak| {
            let best = peak.best_at(now + share / 2);
            // Where there is no time for all passes, there may be for one.
            [now + share, until].into_iter().find_map(|until| Pass::about(&best, self.range, self.step, now, until, pace))
        });
        match pass {
            Some(pass) => {
                self.stage = Stage::Close(pass, round);
                pace.begin();
                Next::Go(pass.first)
            }
            None => self.settle(now, 1, pace),
        }
    }

    /// Goes to where the best focus will be when the lens is looked at.
    fn settle(&mut self, now: Tick, round: u8, pace: &mut Pace) -> Next {
        let Some(peak) = &self.peak else { return Next::End(End::empty(Ending::NoPeak)) };
        let best = peak.best_at(now + pace.per_step() * (CONFIRMING / 2));
        if self.advise_only {
            return Next::End(End { best: Some(best), ..End::empty(Ending::Found) });
        }
        self.stage = Stage::Settled(round, 0);
        self.confirming.clear();
        pace.begin();
        Next::Go(self.inside(position_of(&best)))
    }

    fn after_settling(&mut self, now: Tick, here: i32, round: u8, pace: &mut Pace) -> Next {
        let (sum, weights) = self.confirming.iter().fold((0.0, 0.0), |(sum, weights), ratio| {
            let weight = (ratio.sigma * ratio.sigma).recip();
            (sum + weight * ratio.value, weights + weight)
        });
        let confirmed = (weights > 0.0).then(|| sum / weights + 2.0 / weights.sqrt() >= CONFIRMED);
        // What was seen here may have moved the peak a little; a peak that it took away was none.
        match self.judge() {
            Verdict::Peak(peak) => self.peak = Some(peak),
            _ => return Next::End(self.not_confirmed(now)),
        }
        let Some(best) = self.peak.as_ref().map(|peak| peak.best_at(now)) else { return Next::End(self.not_confirmed(now)) };
        let off = (best.counts.value - f64::from(here)).abs();
        if off > NEAR_ENOUGH.max(best.counts.sigma) && round < SETTLINGS {
            return self.settle(now, round + 1, pace);
        }
        if confirmed == Some(false) {
            return Next::End(self.not_confirmed(now));
        }
        Next::End(End { ending: Ending::Found, best: Some(best), confirmed, to: Goal::Best(here) })
    }

    fn not_confirmed(&self, now: Tick) -> End {
        let best = self.peak.as_ref().map(|peak| peak.best_at(now));
        End { best, confirmed: Some(false), ..End::empty(Ending::NotConfirmed) }
    }

    /// The end where what was found is used.
    pub fn found_by(&self, now: Tick) -> Option<End> {
        let Verdict::Peak(peak) = self.judge() else { return None };
        let best = peak.best_at(now);
        let to = if self.advise_only { Goal::Start } else { Goal::Best(self.inside(position_of(&best))) };
        Some(End { ending: Ending::Found, best: Some(best), confirmed: None, to })
    }

    /// The end where the time is up.
    pub fn found_in_time(&self, now: Tick) -> Option<End> {
        // A single wide pass that was cut off has not seen the whole range.
        if matches!(self.stage, Stage::Wide(_, 1)) { None } else { self.found_by(now) }
    }

    fn judge(&self) -> Verdict {
        match judge(&self.samples, &self.visited, self.width) {
            // Where the pass ended before the range did, this is no edge of it.
            Verdict::Edge(Side::High) if self.visited.last().is_none_or(|last| *last < self.range.1 - self.step) => {
                Verdict::NoPeak
            }
            verdict => verdict,
        }
    }

    fn inside(&self, position: i32) -> i32 {
        position.clamp(self.range.0, self.range.1)
    }

    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    pub fn peak(&self) -> Option<&Peak> {
        self.peak.as_deref()
    }
}
