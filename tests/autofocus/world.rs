//! The world that an autofocus is tried in: a lens with backlash, a best focus that drifts, a camera that exposes when it does.
//!
//! What an exposure shows is the caller's: numbers, or a rendered image that is solved.

#![allow(dead_code, reason = "a test and a bench use it, and neither all of it")]

use stars::lens::FocusCounts;
use stars::lens::autofocus::{Autofocus, Decision, Event, Finding, FocusImage};
use std::time::Duration;

/// What the issue of the trial is: growth of the blur disc, px a count, and the rest of it.
pub const BLUR_PX_PER_COUNT: f64 = 0.05;
/// Drift of the best focus, counts/min.
pub const DRIFT_PER_MIN: f64 = 2.0;
/// Backlash of the gears, counts.
pub const BACKLASH: f64 = 5.0;
/// Speed of the lens, counts/s, and the time that a command takes besides.
const SPEED: f64 = 50.0;
const COMMAND_S: f64 = 1.5;
/// Length of an exposure (a series), s, and the time from its middle to its outcome.
const EXPOSURE_S: f64 = 1.0;
const OUTCOME_S: f64 = 1.2;
/// A trial that takes longer than this never ends, s.
const NEVER_S: f64 = 7200.0;

/// A lens whose glass follows its encoder with backlash.
#[derive(Debug, Clone)]
pub struct Lens {
    /// Encoder, counts.
    pub encoder: i32,
    /// Where the glass is, in counts of an encoder that came from below.
    pub glass: f64,
    /// All positions that it was sent to.
    pub orders: Vec<i32>,
    moving: Option<(f64, i32)>,
}

impl Lens {
    /// A lens that came from above.
    pub fn at(encoder: i32) -> Self {
        Self { encoder, glass: f64::from(encoder) + BACKLASH, orders: Vec::new(), moving: None }
    }

    fn send(&mut self, now: f64, to: i32) {
        assert!(self.moving.is_none(), "two moves at a time");
        self.orders.push(to);
        self.moving = Some((now + COMMAND_S + f64::from((to - self.encoder).abs()) / SPEED, to));
    }

    fn arrive(&mut self, to: i32) {
        (self.encoder, self.moving) = (to, None);
        self.glass = self.glass.clamp(f64::from(to), f64::from(to) + BACKLASH);
    }
}

/// How a trial goes.
#[derive(Debug, Clone)]
pub struct World {
    /// The lens.
    pub lens: Lens,
    /// Best focus at the start, counts, and its drift, counts/min.
    pub best: f64,
    /// As above.
    pub drift: f64,
    /// Time between images, s.
    pub period_s: f64,
}

/// One exposure.
#[derive(Debug, Clone, Copy)]
pub struct Exposure {
    /// Its middle, s.
    pub time_s: f64,
    /// Its number.
    pub index: u32,
    /// Diameter of the discs, px.
    pub disc_px: f64,
    /// Where the lens stood for the whole of it.
    pub position: Option<FocusCounts>,
}

/// How a trial ended.
#[derive(Debug, Clone)]
pub struct Ended {
    /// What was said.
    pub finding: Finding,
    /// When, s.
    pub time_s: f64,
    /// Glass minus true best focus, counts.
    pub off: f64,
    /// Images taken.
    pub images: u32,
}

fn tick(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

impl World {
    /// True best focus at a time, counts.
    pub fn best_at(&self, time_s: f64) -> f64 {
        self.best + self.drift * time_s / 60.0
    }

    /// Runs an autofocus from an event to its finding. `show`: what an exposure shows; `also`: an event that comes from elsewhere at a time.
    pub fn run(
        &mut self,
        autofocus: &mut Autofocus,
        event: Event,
        show: &mut dyn FnMut(&Exposure) -> FocusImage,
        also: Option<(f64, Event)>,
    ) -> Ended {
        let (mut now, mut images, mut also) = (100.0, 0, also.map(|(after, event)| (100.0 + after, event)));
        let mut stood_since = 0.0;
        let mut next_image = now + 0.37 * self.period_s;
        let mut outcomes: Vec<(f64, FocusImage)> = Vec::new();
        let mut event = Some(event);
        loop {
            if let Some(event) = event.take() {
                let decision = autofocus.on(tick(now), event);
                let deadline = autofocus.deadline();
                assert!(deadline.is_none_or(|at| at > tick(now)), "asked again at once: {deadline:?} at {now}");
                match decision {
                    Decision::Unchanged => {}
                    Decision::Move(to) => self.lens.send(now, to.0),
                    Decision::Finished(finding) => {
                        return Ended { finding, time_s: now - 100.0, off: self.lens.glass - self.best_at(now), images };
                    }
                    Decision::Refused(why) => panic!("refused: {why}"),
                }
            }
            let arrival = self.lens.moving.map(|(at, _)| at);
            let outcome = outcomes.first().map(|(at, _)| *at);
            let deadline = autofocus.deadline().map(|at| at.as_secs_f64());
            let other = also.as_ref().map(|(at, _)| *at);
            let first = [Some(next_image), arrival, outcome, deadline, other].into_iter().flatten().fold(f64::INFINITY, f64::min);
            now = first.max(now);
            assert!(now < NEVER_S, "it does not end");
            if arrival == Some(first) {
                let to = self.lens.moving.map_or(self.lens.encoder, |(_, to)| to);
                self.lens.arrive(to);
                stood_since = now;
                event = Some(Event::Arrived(FocusCounts(to)));
            } else if outcome == Some(first) {
                event = Some(Event::Image(outcomes.remove(0).1));
            } else if other == Some(first) {
                event = also.take().map(|(_, event)| event);
            } else if next_image == first {
                let stands = self.lens.moving.is_none() && stood_since <= now - EXPOSURE_S / 2.0;
                let exposure = Exposure {
                    time_s: now,
                    index: images,
                    disc_px: BLUR_PX_PER_COUNT * (self.lens.glass - self.best_at(now)).abs(),
                    position: stands.then_some(FocusCounts(self.lens.encoder)),
                };
                images += 1;
                outcomes.push((now + OUTCOME_S, show(&exposure)));
                next_image += self.period_s;
            } else {
                event = Some(Event::Time);
            }
        }
    }
}
