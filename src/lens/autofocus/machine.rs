//! The state machine's face.

use super::curves::{CurvePoint, Samples};
use super::plan::Pace;
use super::run::Run;
use super::verdict::BestFocus;
use super::width::{FocusEstimate, WidthMonitor, Widths};
use super::{AutofocusRules, Decision, Event, Finding, Refusal};
use crate::command::Tick;
use crate::lens::FocusCounts;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// What the autofocus is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Nothing is under way.
    NotRunning,
    /// A run is under way.
    Running,
    /// A run has ended, and its curves are shown for a while.
    Grace,
}

/// The autofocus: see [the module](super).
#[derive(Debug, Clone, PartialEq)]
pub struct Autofocus {
    rules: AutofocusRules,
    pace: Pace,
    widths: WidthMonitor,
    run: Option<Run>,
    begun: Option<Tick>,
    /// Until when the curves are shown.
    grace_ends: Option<Tick>,
    last: Option<Finding>,
    best: Option<BestFocus>,
    /// What the last run saw.
    seen: Samples,
}

/// What the autofocus learns from its searches: kept, it is there after a restart of the program too.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Learned {
    /// The best focus that a search found last.
    pub best: Option<BestFocus>,
    /// How wide stars are, as a search measured it.
    pub widths: Option<Widths>,
}

/// What telemetry and display are told.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AutofocusStatus {
    /// What it is at.
    pub mode: Mode,
    /// Where the lens was sent last by the run that is under way.
    pub requested: Option<FocusCounts>,
    /// Time since the last run began.
    pub run_age: Option<Duration>,
    /// Time for which images of the run that is under way are still taken, at most.
    pub time_left: Option<Duration>,
    /// Images of this run, or of the last, that counted.
    pub images: usize,
    /// Time from image to image, where known.
    pub cadence: Option<Duration>,
    /// The best focus as the run that is under way, or the last that knew, has it now.
    pub best: Option<BestFocus>,
    /// What the last run found.
    pub last: Option<Finding>,
    /// What the widths of stars say without any move; `None` before the first.
    pub estimate: Option<FocusEstimate>,
}

impl Autofocus {
    /// An autofocus by the rules of the settings.
    pub fn new(rules: AutofocusRules) -> Self {
        Self {
            pace: Pace::default(),
            widths: WidthMonitor::new(&rules),
            run: None,
            begun: None,
            grace_ends: None,
            last: None,
            best: None,
            seen: Samples::default(),
            rules,
        }
    }

    /// An autofocus that knows what an earlier run of the program learned.
    pub fn knowing(rules: AutofocusRules, learned: &Learned) -> Self {
        let mut autofocus = Self::new(rules);
        autofocus.best = learned.best;
        if let Some(widths) = learned.widths {
            autofocus.widths.adopt(widths);
        }
        autofocus
    }

    /// What it has learned that outlasts a run of the program.
    pub fn learned(&self) -> Learned {
        Learned { best: self.best, widths: self.widths.learned() }
    }

    /// Takes an event at a time, which never goes back.
    pub fn on(&mut self, now: Tick, event: Event) -> Decision {
        if self.grace_ends.is_some_and(|end| now >= end) {
            self.grace_ends = None;
        }
        let decision = match self.take(now, event) {
            Decision::Unchanged => self.run.as_mut().map_or(Decision::Unchanged, |run| run.check_time(now, &mut self.pace)),
            decision => decision,
        };
        if let Decision::Finished(finding) = &decision {
            self.finish(now, finding.clone());
        }
        decision
    }

    fn take(&mut self, now: Tick, event: Event) -> Decision {
        match event {
            Event::Run { .. } | Event::Refocus { .. } if self.run.is_some() => Decision::Refused(Refusal::Busy),
            Event::Run { plan, from } => {
                let begun = Run::sweep(now, &self.rules, &plan, from, &mut self.pace);
                self.begin(now, begun)
            }
            Event::Refocus { by, from } => {
                let begun = Run::refocus(now, &self.rules, by, from, &mut self.pace);
                self.begin(now, begun)
            }
            Event::Image(image) => {
                self.pace.image(image.captured);
                self.widths.take(&image);
                self.run.as_mut().map_or(Decision::Unchanged, |run| run.image(now, &image, &mut self.pace))
            }
            Event::Time => Decision::Unchanged,
            of_run => {
                let Some(run) = &mut self.run else { return Decision::Unchanged };
                match of_run {
                    Event::Abort { use_result } => run.abort(now, use_result),
                    Event::Arrived(at) => run.arrived(now, at),
                    Event::LensFailed(why) => Decision::Finished(run.failed(now, why)),
                    _ => Decision::Finished(run.stopped(now)),
                }
            }
        }
    }

    fn begin(&mut self, now: Tick, begun: Result<(Run, Decision), Refusal>) -> Decision {
        match begun {
            Ok((run, decision)) => {
                (self.run, self.begun, self.grace_ends) = (Some(run), Some(now), None);
                decision
            }
            Err(refusal) => Decision::Refused(refusal),
        }
    }

    fn finish(&mut self, now: Tick, finding: Finding) {
        if let Some(run) = self.run.take() {
            if let Some(peak) = run.peak() {
                self.widths.calibrate(peak, run.samples());
            }
            self.seen = run.samples().clone();
        }
        self.best = finding.best.or(self.best);
        self.last = Some(finding);
        self.grace_ends = Some(now + self.rules.grace);
    }

    /// When to call [`Self::on`] with [`Event::Time`], if nothing happens before.
    pub fn deadline(&self) -> Option<Tick> {
        self.run.as_ref().map_or(self.grace_ends, |run| run.deadline(&self.pace))
    }

    /// What telemetry and display are told.
    pub fn status(&self, now: Tick) -> AutofocusStatus {
        let run = self.run.as_ref();
        AutofocusStatus {
            mode: match (run, self.grace_ends) {
                (Some(_), _) => Mode::Running,
                (None, Some(_)) => Mode::Grace,
                (None, None) => Mode::NotRunning,
            },
            requested: run.and_then(Run::requested),
            run_age: self.begun.map(|begun| now.saturating_sub(begun)),
            time_left: run.map(|run| run.ends().saturating_sub(now)),
            images: run.map_or(&self.seen, Run::samples).iter().count(),
            cadence: self.pace.cadence(),
            best: run.and_then(Run::peak).map(|peak| peak.best_at(now)).or(self.best),
            last: self.last.clone(),
            estimate: self.widths.estimate(),
        }
    }

    /// All points of the curves of this run, or of the last, for the display.
    pub fn curves(&self) -> Vec<CurvePoint> {
        self.run.as_ref().map_or(&self.seen, Run::samples).points()
    }
}
