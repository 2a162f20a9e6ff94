//! How another clock stands against ours, told from messages that it stamped.
//!
//! A message comes later than it was stamped and never earlier: of many, the one that came soonest tells most (NTP's clock filter, RFC 5905
//! § 10). One way alone is seen, so that a delay which every message has counts as offset.

use std::collections::VecDeque;
use std::time::Duration;

/// Messages count for this long, and so many of them at most.
const WINDOW: Duration = Duration::from_secs(60);
const MOST: usize = 128;
/// A message that is off by more than this, s, is late or tells of a clock that was set: so many of them in a row, which agree, tell of that.
const JUMP_S: f64 = 0.5;
const JUMPED: usize = 3;
/// No offset is known better, s: what the machines need to stamp and to read.
const LEAST_SIGMA_S: f64 = 1e-3;

/// Another clock, as its messages show it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ClockComparison {
    samples: VecDeque<Sample>,
    /// The last messages that fit none before them.
    strange: Vec<Sample>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Sample {
    /// When it came, on a clock of ours that never jumps.
    at: Duration,
    offset_s: f64,
}

/// How far another clock is ahead of ours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockOffset {
    /// Its time minus ours, s.
    pub offset_s: f64,
    /// One σ of that, s: what messages usually take longer than the soonest.
    pub sigma_s: f64,
    /// How old the last message is.
    pub age: Duration,
}

impl ClockComparison {
    /// Notes a message that came `at`, when our clock said `ours`, and that says `theirs`; both in s since the same time.
    pub fn note(&mut self, at: Duration, ours: f64, theirs: f64) {
        let sample = Sample { at, offset_s: theirs - ours };
        if !sample.offset_s.is_finite() {
            return;
        }
        if self.offset(at).is_some_and(|known| (sample.offset_s - known.offset_s).abs() > JUMP_S) {
            self.strange.push(sample);
            let agree = self.strange.iter().all(|other| (other.offset_s - sample.offset_s).abs() <= JUMP_S);
            if !agree {
                self.strange = vec![sample];
            } else if self.strange.len() >= JUMPED {
                self.samples = self.strange.drain(..).collect();
            }
            return;
        }
        self.strange.clear();
        self.samples.push_back(sample);
        while self.samples.len() > MOST || self.samples.front().is_some_and(|first| first.at + WINDOW < at) {
            self.samples.pop_front();
        }
    }

    /// What the messages of the last minute tell; `None` where none came.
    pub fn offset(&self, now: Duration) -> Option<ClockOffset> {
        let mut offsets: Vec<f64> =
            self.samples.iter().filter(|sample| sample.at + WINDOW >= now).map(|sample| sample.offset_s).collect();
        offsets.sort_by(f64::total_cmp);
        let (soonest, median) = (*offsets.last()?, *offsets.get(offsets.len() / 2)?);
        let last = self.samples.back().map_or(now, |sample| sample.at);
        Some(ClockOffset { offset_s: soonest, sigma_s: (soonest - median).max(LEAST_SIGMA_S), age: now.saturating_sub(last) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Messages every half a second, from a clock that is `ahead` of ours, each on its way for as long as `delay` says; ours at the start.
    fn messages(clock: &mut ClockComparison, from: u32, to: u32, ours: f64, ahead: f64, delay: impl Fn(u32) -> f64) {
        for n in from..to {
            let sent = f64::from(n) * 0.5;
            let came = sent + delay(n);
            clock.note(Duration::from_secs_f64(came), ours + came, ours + sent + ahead);
        }
    }

    #[test]
    fn the_soonest_message_tells_the_offset_whatever_the_others_take() {
        let mut clock = ClockComparison::default();
        messages(&mut clock, 0, 100, 1.4e9, 12.25, |n| 0.002 + 0.01 * f64::from(n % 7));
        let offset = clock.offset(Duration::from_secs(50)).unwrap();
        assert!((offset.offset_s - 12.248).abs() < 1e-6 && (0.02..0.04).contains(&offset.sigma_s), "{offset:?}");
        assert!(offset.age < Duration::from_secs(1));
        assert_eq!(clock.offset(Duration::from_secs(200)), None, "what is a minute old tells nothing");
    }

    #[test]
    fn one_late_message_changes_nothing_and_a_clock_that_was_set_is_believed_after_three() {
        let mut clock = ClockComparison::default();
        messages(&mut clock, 0, 20, 1.4e9, -3.0, |n| if n == 10 { 4.0 } else { 0.001 });
        assert!((clock.offset(Duration::from_secs(10)).unwrap().offset_s + 3.001).abs() < 1e-6);
        // Ours is set back by a year.
        messages(&mut clock, 20, 22, 1.4e9 - 3.2e7, 3.2e7 - 3.0, |_| 0.001);
        assert!(clock.offset(Duration::from_secs(11)).unwrap().offset_s < 0.0);
        messages(&mut clock, 22, 23, 1.4e9 - 3.2e7, 3.2e7 - 3.0, |_| 0.001);
        let offset = clock.offset(Duration::from_secs(12)).unwrap();
        assert!((offset.offset_s - (3.2e7 - 3.001)).abs() < 1e-3, "{offset:?}");
    }

    #[test]
    fn a_clock_that_says_nonsense_is_not_noted() {
        let mut clock = ClockComparison::default();
        clock.note(Duration::ZERO, 1.4e9, f64::NAN);
        clock.note(Duration::ZERO, 1.4e9, f64::INFINITY);
        assert_eq!(clock, ClockComparison::default());
    }
}
