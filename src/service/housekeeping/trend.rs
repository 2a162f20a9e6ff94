//! The trend of the free space: when the disk will be full if it goes on filling as in the last hours.
//!
//! The slope is the median of those between samples that are a sixth of the window apart: a file that comes or goes lies between a
//! fifth of the pairs at most, so that one or two of them do not change it.

use crate::command::Tick;
use std::collections::VecDeque;
use std::time::Duration;

/// Samples that are kept.
const SAMPLES: usize = 96;
/// Fewer say nothing.
const FEWEST: usize = 12;
/// Part of the samples that lies between the two of a pair.
const APART: usize = 6;
/// Time between samples at the start; it doubles whenever they would be too many.
const FIRST_SPACING: Duration = Duration::from_secs(5);
/// Samples reach back this far at least once the service has run for so long.
const WINDOW: Duration = Duration::from_secs(4 * 3600);
/// A disk that takes longer to fill than this does not fill, days: a hundred years.
const LONGEST_DAYS: f64 = 36_525.0;
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// Samples of the free space over the last hours.
#[derive(Debug, Clone)]
pub struct Trend {
    samples: VecDeque<(Tick, f64)>,
    spacing: Duration,
}

impl Default for Trend {
    fn default() -> Self {
        Self { samples: VecDeque::new(), spacing: FIRST_SPACING }
    }
}

impl Trend {
    /// Takes a value, GiB, if it is time for the next sample.
    pub fn note(&mut self, now: Tick, free_gib: f64) {
        if self.samples.back().is_some_and(|(last, _)| now.saturating_sub(*last) < self.spacing) {
            return;
        }
        self.samples.push_back((now, free_gib));
        if self.samples.len() <= SAMPLES {
            return;
        }
        if self.spacing * (SAMPLES as u32) < WINDOW {
            self.spacing *= 2;
            let mut even = false;
            self.samples.retain(|_| {
                even = !even;
                even
            });
        } else {
            self.samples.pop_front();
        }
    }

    /// Time until there is no free space left, days; `None` while the disk does not fill or too little is known.
    pub fn days_left(&self) -> Option<f64> {
        let (_, free) = self.samples.back()?;
        let days = free / -self.slope()? / DAY_S;
        (0.0..=LONGEST_DAYS).contains(&days).then_some(days)
    }

    /// Median slope, GiB/s.
    fn slope(&self) -> Option<f64> {
        if self.samples.len() < FEWEST {
            return None;
        }
        let later = self.samples.iter().skip(self.samples.len() / APART);
        let pairs = self.samples.iter().zip(later);
        let mut slopes: Vec<f64> = pairs.map(|((t0, y0), (t1, y1))| (y1 - y0) / t1.saturating_sub(*t0).as_secs_f64()).collect();
        let middle = slopes.len() / 2;
        Some(*slopes.select_nth_unstable_by(middle, f64::total_cmp).1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The days left that are told at the end of so many hours, read every half second or as often as `step` says.
    fn told(hours: f64, step: f64, free: impl Fn(f64) -> f64) -> Option<f64> {
        let mut trend = Trend::default();
        let mut t = 0.0;
        while t <= hours * 3600.0 {
            trend.note(Duration::from_secs_f64(t), free(t));
            assert!(trend.samples.len() <= SAMPLES);
            t += step;
        }
        trend.days_left()
    }

    /// Records of 3 MiB every 20 s and a disk of 100 GiB.
    fn filling(t: f64) -> f64 {
        100.0 - (t / 20.0).floor() * 3.0 / 1024.0
    }

    fn truth(t: f64) -> f64 {
        filling(t) / (3.0 / 1024.0 / 20.0) / DAY_S
    }

    #[test]
    fn a_steady_filling_is_told_after_minutes_and_days() {
        for (hours, step, within) in [(0.1, 0.5, 0.15), (1.0, 0.5, 0.03), (6.0, 0.5, 0.03), (72.0, 7.0, 0.03)] {
            let days = told(hours, step, filling).unwrap();
            assert!((days / truth(hours * 3600.0) - 1.0).abs() < within, "{days} after {hours} h");
        }
    }

    #[test]
    fn a_file_that_comes_or_goes_at_any_time_does_not_change_it() {
        for size in [-20.0, 20.0] {
            for part in 1..10 {
                let at = f64::from(part) / 10.0 * 4.0 * 3600.0;
                let free = |t: f64| filling(t) - if t > at { size } else { 0.0 };
                let days = told(4.0, 0.5, free).unwrap();
                let wanted = free(4.0 * 3600.0) / (3.0 / 1024.0 / 20.0) / DAY_S;
                assert!((days / wanted - 1.0).abs() < 0.1, "{days} instead of {wanted}: {size} GiB at {part}/10");
            }
        }
    }

    #[test]
    fn a_change_of_pace_is_followed_within_hours() {
        // Ten times as many records from the third day on.
        let from = 48.0 * 3600.0;
        let free = |t: f64| 100.0 - (t.min(from) + 10.0 * (t - from).max(0.0)) * 3.0 / 1024.0 / 20.0;
        let days = told(54.0, 1.0, free).unwrap();
        let wanted = free(54.0 * 3600.0) / (30.0 / 1024.0 / 20.0) / DAY_S;
        assert!((days / wanted - 1.0).abs() < 0.05, "{days} instead of {wanted}");
    }

    #[test]
    fn a_disk_that_does_not_fill_has_no_end() {
        assert_eq!(told(1.0, 1.0, |_| 100.0), None);
        assert_eq!(told(1.0, 1.0, |t| 100.0 + t), None);
        assert_eq!(told(0.005, 1.0, filling), None, "too early to say");
        assert_eq!(told(1.0, 1.0, |t| 100.0 - t * 1e-12), None, "in thousands of years");
        assert_eq!(told(1.0, 1.0, |t| (3.0 - t).max(0.0)), None, "it is full, and does not fill any more");
    }
}
