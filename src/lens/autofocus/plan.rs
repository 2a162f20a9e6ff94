//! Plans that finish in time: how far apart the positions of a pass are, by the time that a step is seen to take.

use super::verdict::BestFocus;
use crate::command::Tick;
use std::collections::VecDeque;
use std::time::Duration;

/// Time for a step before any is known: the flight's camera had an image every 40 s.
const ASSUMED_STEP: Duration = Duration::from_secs(40);
/// Steps whose time is remembered.
const REMEMBERED: usize = 5;
/// Half a pass about the peak, widths of the curve, and σ of the peak that are added.
const WINDOW_WIDTHS: f64 = 1.6;
const WINDOW_SIGMAS: f64 = 2.0;
/// Fewest and most positions of a pass about the peak.
const PASS_POSITIONS: (u32, u32) = (5, 16);

/// How long steps take: the camera's images come when they come, and moves take their time.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub(super) struct Pace {
    last_image: Option<Tick>,
    cadence: VecDeque<Duration>,
    last_step: Option<Tick>,
    steps: VecDeque<Duration>,
}

fn remember(list: &mut VecDeque<Duration>, span: Duration) {
    if list.len() >= REMEMBERED {
        list.pop_front();
    }
    list.push_back(span);
}

fn median(list: &VecDeque<Duration>) -> Option<Duration> {
    let mut sorted: Vec<Duration> = list.iter().copied().collect();
    sorted.sort_unstable();
    sorted.get(sorted.len() / 2).copied()
}

impl Pace {
    /// An image was captured.
    pub fn image(&mut self, captured: Tick) {
        if let Some(span) = self.last_image.and_then(|last| captured.checked_sub(last)).filter(|span| !span.is_zero()) {
            remember(&mut self.cadence, span);
        }
        self.last_image = self.last_image.max(Some(captured));
    }

    /// A pass begins: the way there is no step.
    pub fn begin(&mut self) {
        self.last_step = None;
    }

    /// The images of a position are taken.
    pub fn step(&mut self, now: Tick) {
        if let Some(span) = self.last_step.and_then(|last| now.checked_sub(last)) {
            remember(&mut self.steps, span);
        }
        self.last_step = Some(now);
    }

    /// Time from image to image, where known.
    pub fn cadence(&self) -> Option<Duration> {
        median(&self.cadence)
    }

    /// Time that a step takes.
    pub fn per_step(&self) -> Duration {
        let cadence = self.cadence();
        let step = median(&self.steps).or(cadence).unwrap_or(ASSUMED_STEP);
        step.max(cadence.unwrap_or_default()).max(Duration::from_millis(1))
    }

    /// Steps that fit into a time.
    pub fn steps_in(&self, time: Duration) -> u32 {
        (time.as_secs_f64() / self.per_step().as_secs_f64()).min(1e6) as u32
    }
}

/// An upward pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Pass {
    /// First position.
    pub first: i32,
    /// Last position.
    pub last: i32,
    /// Finest step, counts.
    pub step: i32,
    /// When it should be done.
    pub until: Tick,
}

impl Pass {
    /// The position after this one; `None` after the last, or where the time is up.
    pub fn after(&self, here: i32, now: Tick, pace: &Pace) -> Option<i32> {
        let left = self.last.saturating_sub(here);
        if left <= 0 || now >= self.until {
            return None;
        }
        let steps = i32::try_from(pace.steps_in(self.until - now)).unwrap_or(i32::MAX).max(1);
        let widest = left / steps + i32::from(left % steps > 0);
        Some(here.saturating_add(widest.max(self.step).max(1)).min(self.last))
    }

    /// A pass about a best focus that ends at a time; `None` where that leaves no time for one.
    pub fn about(best: &BestFocus, range: (i32, i32), step: i32, now: Tick, until: Tick, pace: &Pace) -> Option<Self> {
        let steps = pace.steps_in(until.saturating_sub(now)).min(PASS_POSITIONS.1);
        if steps < PASS_POSITIONS.0 {
            return None;
        }
        let half = WINDOW_WIDTHS * best.width_counts + WINDOW_SIGMAS * best.counts.sigma;
        let (low, high) = (best.counts.value - half, best.counts.value + half);
        let inside = |x: f64| (x.round().clamp(-1e9, 1e9) as i32).clamp(range.0, range.1);
        let (first, last) = (inside(low), inside(high));
        let spread = (last - first) / i32::try_from(steps - 1).unwrap_or(1).max(1);
        Some(Self { first, last, step: step.max(spread), until })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn s(seconds: u64) -> Tick {
        Duration::from_secs(seconds)
    }

    /// Positions of a pass where each step takes this long.
    fn walk(pass: &Pass, each: Duration) -> (Vec<i32>, Tick) {
        let (mut pace, mut now, mut positions) = (Pace::default(), Tick::ZERO, vec![pass.first]);
        pace.image(now);
        loop {
            now += each;
            pace.image(now);
            pace.step(now);
            match pass.after(positions[positions.len() - 1], now, &pace) {
                Some(next) => positions.push(next),
                None => return (positions, now),
            }
        }
    }

    #[test]
    fn the_default_range_is_swept_in_time_at_any_cadence() {
        let pass = Pass { first: 2300, last: 3300, step: 10, until: s(600) };
        for (each, least) in [(1, 101), (5, 101), (12, 45), (40, 14), (60, 9)] {
            let (positions, end) = walk(&pass, s(each));
            assert_eq!(positions.last(), Some(&3300), "{each} s");
            assert!(positions.len() >= least, "{each} s: {}", positions.len());
            assert!(end <= s(600 + each), "{each} s: {end:?}");
            assert!(positions.windows(2).all(|pair| pair[1] - pair[0] >= 10 || pair[1] == 3300));
        }
    }

    #[test]
    fn a_slow_camera_ends_a_pass_by_the_clock() {
        let (positions, end) = walk(&Pass { first: 0, last: 1000, step: 10, until: s(100) }, s(300));
        assert_eq!((positions.len(), end), (1, s(300)));
    }
}
