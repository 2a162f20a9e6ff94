//! What the benches share: the thread's own clock, and quantiles.

#![allow(dead_code, reason = "each bench is a program of its own, and does not use all of this")]

use rustix::time::{ClockId, clock_gettime};
use stars::solve::{Stop, Watch};
use std::time::Duration;

/// A watch by the thread's own clock, which never says to stop.
pub struct CpuWatch;

impl Watch for CpuWatch {
    fn elapsed(&self) -> Duration {
        cpu_time()
    }
    fn stop(&self) -> Option<Stop> {
        None
    }
}

/// CPU time of this thread alone: what others on the machine do does not count.
pub fn cpu_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec.unsigned_abs(), now.tv_nsec.unsigned_abs() as u32)
}

/// What some work gives, and the CPU time that it took this thread, ms.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = cpu_time();
    let got = std::hint::black_box(work());
    (got, ms(cpu_time().saturating_sub(start)))
}

/// The value below which a part of all lies; NaN of none.
pub fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (part * values.len() as f64) as usize;
    values.get(place.min(values.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
}

/// A time in milliseconds.
pub fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
