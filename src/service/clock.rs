//! The process's clocks: the one place that asks the machine for UTC.
//!
//! Intervals, ages and deadlines come from tokio's monotonic clock, which tests may pause. UTC only stamps, with its
//! quality; it may be wrong or jump by years, and nothing waits for it. Where the machine's clock is stepped the time that was held is
//! carried on ([`Timekeeper`]).

use crate::settings::{ClockReference, ClockSettings};
use crate::sky::{ClockQuality, ClockReading, Timekeeper, Utc};
use std::hash::{BuildHasher, Hasher};
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, UNIX_EPOCH};
use tokio::time::Instant;

/// Where systemd-timesyncd and chrony's `chrony-wait` leave a mark once the clock follows a reference, and where `ptp4l` has its socket.
const SYNCHRONISED_MARKS: [&str; 2] = ["/run/systemd/timesync/synchronized", "/run/chrony/synchronized"];
const PTP_MARKS: [&str; 1] = ["/run/ptp4l"];

/// Monotonic time since the service started, and the number of this start.
#[derive(Debug, Clone, Copy)]
pub struct Clock {
    started: Instant,
    boot_id: u32,
    /// A UTC that is made up, where it is.
    simulated: Option<&'static SimulatedUtc>,
    /// What sets the machine's clock, and one σ of it, s, where it is known.
    reference: ClockReference,
    sigma_s: Option<f64>,
    /// The time that is held; it lasts as long as the program.
    keeper: &'static Mutex<Timekeeper>,
}

/// A UTC that follows the monotonic clock, and can be set.
#[derive(Debug)]
pub struct SimulatedUtc(Mutex<Simulated>);

#[derive(Debug)]
struct Simulated {
    unix_s: Option<f64>,
    at: Instant,
    quality: ClockQuality,
    sigma_s: Option<f64>,
}

impl SimulatedUtc {
    /// One that stands at a Unix time now, s. It lasts as long as the program.
    pub fn begin(unix_s: f64) -> &'static Self {
        let simulated = Simulated { unix_s: Some(unix_s), at: Instant::now(), quality: ClockQuality::FreeRunning, sigma_s: None };
        Box::leak(Box::new(Self(Mutex::new(simulated))))
    }

    /// Sets it to a Unix time, s; `None` for a clock that was never set. It follows nothing then, as with the kernel's.
    pub fn set(&self, unix_s: Option<f64>) {
        let (quality, sigma_s) = (ClockQuality::FreeRunning, None);
        *self.lock() = Simulated { unix_s, at: Instant::now(), quality, sigma_s };
    }

    /// Has it follow a reference, with one σ in s.
    pub fn follow(&self, quality: ClockQuality, sigma_s: Option<f64>) {
        let mut simulated = self.lock();
        (simulated.quality, simulated.sigma_s) = (quality, sigma_s);
    }

    /// The Unix time, s.
    pub fn unix_s(&self) -> Option<f64> {
        let simulated = self.lock();
        simulated.unix_s.map(|unix_s| unix_s + simulated.at.elapsed().as_secs_f64())
    }

    fn reading(&self) -> ClockReading {
        let utc = self.unix_s().and_then(Utc::from_unix);
        let Simulated { quality, sigma_s, .. } = *self.lock();
        if utc.is_some() { ClockReading { utc, quality, sigma_s } } else { ClockReading::UNSET }
    }

    fn lock(&self) -> MutexGuard<'_, Simulated> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Clock {
    /// Starts the clock, and draws the number of this start.
    pub fn start() -> Self {
        // The keys of a hasher are the one random number that the standard library draws from the system.
        let drawn = std::collections::hash_map::RandomState::new().build_hasher().finish();
        let keeper = Box::leak(Box::default());
        let (reference, sigma_s) = (ClockReference::Unknown, None);
        Self { started: Instant::now(), boot_id: drawn as u32, simulated: None, reference, sigma_s, keeper }
    }

    /// The same by the settings; `simulated`: a UTC that is made up, where it is.
    pub fn of(settings: &ClockSettings, simulated: Option<&'static SimulatedUtc>) -> Self {
        let sigma_s = Some(settings.sigma_s).filter(|sigma_s| *sigma_s > 0.0);
        Self { simulated, reference: settings.reference, sigma_s, ..Self::start() }
    }

    /// UTC now, and how far it can be believed: by the machine's clock, or one that is made up, as long as that is not stepped.
    pub fn time(&self) -> ClockReading {
        let reading = self.simulated.map_or_else(|| self.machine(), SimulatedUtc::reading);
        self.keeper.lock().unwrap_or_else(PoisonError::into_inner).read(self.uptime(), reading)
    }

    /// What the machine's clock says.
    fn machine(&self) -> ClockReading {
        let ptp = self.reference == ClockReference::Ptp;
        let (utc, quality) = if ptp { machine_utc(&PTP_MARKS) } else { utc_now() };
        if quality != ClockQuality::Synchronised {
            return ClockReading { utc, quality, sigma_s: None };
        }
        let quality = match self.reference {
            ClockReference::Unknown => quality,
            ClockReference::Chrony => ClockQuality::Chrony,
            ClockReference::Ptp => ClockQuality::Ptp,
        };
        ClockReading { utc, quality, sigma_s: self.sigma_s }
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
    machine_utc(&SYNCHRONISED_MARKS)
}

fn machine_utc(marks: &[&str]) -> (Option<Utc>, ClockQuality) {
    #[allow(clippy::disallowed_methods, reason = "this is the one place")]
    let since_1970 = std::time::SystemTime::now().duration_since(UNIX_EPOCH).ok();
    let utc = since_1970.and_then(|time| Utc::from_unix(time.as_secs_f64()));
    let quality = match utc {
        None => ClockQuality::Unset,
        Some(_) if marks.iter().any(|mark| Path::new(mark).exists()) => ClockQuality::Synchronised,
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
