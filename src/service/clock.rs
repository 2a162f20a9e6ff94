//! The process's clocks: the one place that asks the machine for UTC.
//!
//! Intervals, ages and deadlines come from tokio's monotonic clock, which tests may pause. UTC only stamps, with its
//! quality; it may be wrong or jump by years, and nothing waits for it.

use crate::sky::{ClockQuality, Utc};
use std::hash::{BuildHasher, Hasher};
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, UNIX_EPOCH};
use tokio::time::Instant;

/// Where systemd-timesyncd and chrony's `chrony-wait` leave a mark once the clock follows a reference.
const SYNCHRONISED_MARKS: [&str; 2] = ["/run/systemd/timesync/synchronized", "/run/chrony/synchronized"];

/// Monotonic time since the service started, and the number of this start.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    started: Instant,
    boot_id: u32,
    /// A UTC that is made up, where it is.
    simulated: Option<&'static SimulatedUtc>,
}

/// A UTC that follows the monotonic clock, and can be set.
#[derive(Debug)]
pub struct SimulatedUtc(Mutex<(Option<f64>, Instant)>);

impl SimulatedUtc {
    /// One that stands at a Unix time now, s. It lasts as long as the program.
    pub fn begin(unix_s: f64) -> &'static Self {
        Box::leak(Box::new(Self(Mutex::new((Some(unix_s), Instant::now())))))
    }

    /// Sets it to a Unix time, s; `None` for a clock that was never set.
    pub fn set(&self, unix_s: Option<f64>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = (unix_s, Instant::now());
    }

    /// The Unix time, s.
    pub fn unix_s(&self) -> Option<f64> {
        let (unix_s, at) = *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        unix_s.map(|unix_s| unix_s + at.elapsed().as_secs_f64())
    }
}

impl Clock {
    /// Starts the clock, and draws the number of this start.
    pub fn start() -> Self {
        // The keys of a hasher are the one random number that the standard library draws from the system.
        let drawn = std::collections::hash_map::RandomState::new().build_hasher().finish();
        Self { started: Instant::now(), boot_id: drawn as u32, simulated: None }
    }

    /// The same, with a UTC that is made up.
    #[must_use]
    pub fn with_utc(self, simulated: &'static SimulatedUtc) -> Self {
        Self { simulated: Some(simulated), ..self }
    }

    /// UTC now, and how far it can be believed: the machine's, or one that is made up.
    pub fn utc(&self) -> (Option<Utc>, ClockQuality) {
        let Some(simulated) = self.simulated else { return utc_now() };
        let utc = simulated.unix_s().and_then(Utc::from_unix);
        (utc, if utc.is_some() { ClockQuality::FreeRunning } else { ClockQuality::Unset })
    }

    /// Number drawn at random at this start.
    pub fn boot_id(&self) -> u32 {
        self.boot_id
    }

    /// When the service started.
    pub fn started(&self) -> Instant {
        self.started
    }

    /// Time since the start.
    pub fn uptime(&self) -> Duration {
        self.started.elapsed()
    }

    /// A moment as time since the start.
    pub fn tick(&self, moment: Instant) -> Duration {
        moment.saturating_duration_since(self.started)
    }
}

/// UTC now and how far it can be believed; no time where the machine's clock is outside the years that make sense.
pub fn utc_now() -> (Option<Utc>, ClockQuality) {
    #[allow(clippy::disallowed_methods, reason = "this is the one place")]
    let since_1970 = std::time::SystemTime::now().duration_since(UNIX_EPOCH).ok();
    let utc = since_1970.and_then(|time| Utc::from_unix(time.as_secs_f64()));
    let quality = match utc {
        None => ClockQuality::Unset,
        Some(_) if SYNCHRONISED_MARKS.iter().any(|mark| Path::new(mark).exists()) => ClockQuality::Synchronised,
        Some(_) => ClockQuality::FreeRunning,
    };
    (utc, quality)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn uptime_follows_the_clock_that_tests_may_pause() {
        let clock = Clock::start();
        tokio::time::sleep(Duration::from_secs(86_400)).await;
        assert_eq!(clock.uptime(), Duration::from_secs(86_400));
        assert_eq!(clock.tick(clock.started()), Duration::ZERO);
    }

    #[test]
    fn a_clock_outside_sane_years_is_unset_and_one_inside_is_not() {
        let (utc, quality) = utc_now();
        assert_eq!(utc.is_none(), quality == ClockQuality::Unset);
    }
}
