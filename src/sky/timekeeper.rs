//! UTC carried on a clock that never jumps: a clock of the computer's that is set back or forth changes nothing but how far the time can
//! be believed.
//!
//! A clock that follows its reference is slewed, and the monotonic clock with it; only a step parts the two. What is stepped is not
//! followed, unless it follows a reference now and what was held does not, or has stood for a while.

use super::{ClockQuality, Utc};
use std::time::Duration;

/// A difference to what was expected beyond this is a step, s: nothing that follows NTP is slewed over more (RFC 5905, "step threshold").
const STEP_S: f64 = 0.128;
/// A clock that was stepped while it follows its reference is believed after this time: it was the reference that had been wrong, or a
/// leap second.
const STANDS: Duration = Duration::from_secs(60);
/// By how much a clock without a reference may be off more with each second, as one σ (RFC 5905, "frequency tolerance" Φ).
const DRIFT: f64 = 15e-6;

/// What a clock says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockReading {
    /// UTC, where it is within the years that make sense.
    pub utc: Option<Utc>,
    /// How far it can be believed.
    pub quality: ClockQuality,
    /// One σ of it, s, where that is known.
    pub sigma_s: Option<f64>,
}

impl ClockReading {
    /// The reading of a clock that nobody set.
    pub const UNSET: Self = Self { utc: None, quality: ClockQuality::Unset, sigma_s: None };
}

/// The time that is held.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Timekeeper {
    held: Option<Held>,
    /// When the clock was stepped last, and its Unix time less that which is held, s: while that is not followed.
    stepped: Option<(Duration, f64)>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    at: Duration,
    unix_s: f64,
    sigma_s: Option<f64>,
    /// Whether the clock that it comes from followed its reference.
    followed: bool,
}

impl Held {
    /// Carried on without its clock.
    fn at(self, now: Duration) -> Self {
        let elapsed_s = now.saturating_sub(self.at).as_secs_f64();
        Self {
            at: now,
            unix_s: self.unix_s + elapsed_s,
            sigma_s: self.sigma_s.map(|sigma_s| sigma_s + DRIFT * elapsed_s),
            followed: self.followed,
        }
    }
}

impl Timekeeper {
    /// The time at `now` on the monotonic clock, when the computer's clock says `reading`.
    pub fn read(&mut self, now: Duration, reading: ClockReading) -> ClockReading {
        let Some(before) = self.held else { return self.follow(now, reading, None) };
        let carried = before.at(now);
        let Some(utc) = reading.utc else { return self.hold(carried) };
        let off_s = utc.unix_s() - carried.unix_s;
        if off_s.abs() <= STEP_S {
            return self.follow(now, reading, carried.sigma_s);
        }
        let (since, _) = *self.stepped.get_or_insert((now, off_s));
        if self.stepped.is_some_and(|(_, other_s)| (other_s - off_s).abs() > STEP_S) {
            self.stepped = Some((now, off_s));
            return self.hold(carried);
        }
        let stands = now.saturating_sub(since) >= STANDS;
        if reading.quality.follows() && (stands || !carried.followed) {
            return self.follow(now, reading, None);
        }
        self.hold(carried)
    }

    /// Takes what the clock says; `carried_s`: σ of what was held, for a clock that does not know its own.
    fn follow(&mut self, now: Duration, reading: ClockReading, carried_s: Option<f64>) -> ClockReading {
        let sigma_s = reading.sigma_s.or(carried_s);
        self.stepped = None;
        let followed = reading.quality.follows();
        self.held = reading.utc.map(|utc| Held { at: now, unix_s: utc.unix_s(), sigma_s, followed });
        ClockReading { sigma_s, ..reading }
    }

    /// Goes on with what is held.
    fn hold(&mut self, carried: Held) -> ClockReading {
        self.held = Some(carried);
        ClockReading { utc: Utc::from_unix(carried.unix_s), quality: ClockQuality::FreeRunning, sigma_s: carried.sigma_s }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEGAN_S: f64 = 1_356_998_400.0;
    const YEAR_S: f64 = 365.25 * 86_400.0;

    /// A clock that is so far ahead of the truth, which began with the monotonic clock.
    fn reading(now_s: f64, ahead_s: f64, quality: ClockQuality, sigma_s: Option<f64>) -> (Duration, ClockReading) {
        (Duration::from_secs_f64(now_s), ClockReading { utc: Utc::from_unix(BEGAN_S + now_s + ahead_s), quality, sigma_s })
    }

    /// How far the time that is held is ahead of the truth; what it says of itself.
    fn read(keeper: &mut Timekeeper, (now, reading): (Duration, ClockReading)) -> (f64, ClockQuality, Option<f64>) {
        let held = keeper.read(now, reading);
        (held.utc.unwrap().unix_s() - BEGAN_S - now.as_secs_f64(), held.quality, held.sigma_s)
    }

    #[test]
    fn a_clock_that_is_stepped_changes_nothing_but_the_quality() {
        use ClockQuality::{Chrony, FreeRunning};
        let mut keeper = Timekeeper::default();
        assert_eq!(read(&mut keeper, reading(10.0, 0.0, Chrony, Some(1e-4))), (0.0, Chrony, Some(1e-4)));
        for (now_s, ahead_s) in [(11.0, YEAR_S), (20.0, -3.0 * YEAR_S), (110.0, 0.5)] {
            let (off_s, quality, sigma_s) = read(&mut keeper, reading(now_s, ahead_s, FreeRunning, None));
            assert!(off_s.abs() < 1e-6, "{off_s} s off after a step by {ahead_s} s");
            assert_eq!(quality, FreeRunning);
            let drifted_s = 1e-4 + 15e-6 * (now_s - 10.0);
            assert!((sigma_s.unwrap() - drifted_s).abs() < 1e-9, "σ {sigma_s:?} at {now_s} s");
        }
        // Nor does one that is unset, or that goes where no clock makes sense.
        let unset = keeper.read(Duration::from_secs(120), ClockReading::UNSET);
        assert!((unset.utc.unwrap().unix_s() - BEGAN_S - 120.0).abs() < 1e-6);
        assert_eq!(unset.quality, FreeRunning);
        // Where it was, it is as good as it was.
        assert_eq!(read(&mut keeper, reading(130.0, 0.01, Chrony, Some(2e-4))).1, Chrony);
    }

    #[test]
    fn a_clock_that_finds_its_reference_is_followed_at_once_and_one_that_had_it_after_a_minute() {
        use ClockQuality::{Chrony, FreeRunning};
        let mut keeper = Timekeeper::default();
        read(&mut keeper, reading(0.0, -YEAR_S, FreeRunning, None));
        let (off_s, quality, sigma_s) = read(&mut keeper, reading(5.0, 0.0, Chrony, Some(1e-3)));
        assert!(off_s.abs() < 1e-6);
        assert_eq!((quality, sigma_s), (Chrony, Some(1e-3)));
        // A leap second: it says all the while that it follows.
        for now_s in [100.0, 101.0, 159.0] {
            let (off_s, quality, _) = read(&mut keeper, reading(now_s, -1.0, Chrony, Some(1e-3)));
            assert!(off_s.abs() < 1e-6 && quality == FreeRunning, "{off_s} s, {quality:?} at {now_s} s");
        }
        let (off_s, quality, _) = read(&mut keeper, reading(161.0, -1.0, Chrony, Some(1e-3)));
        assert!((off_s + 1.0).abs() < 1e-6 && quality == Chrony, "{off_s} s, {quality:?}");
    }

    #[test]
    fn a_clock_that_steps_about_without_end_is_never_followed() {
        let mut keeper = Timekeeper::default();
        read(&mut keeper, reading(0.0, 0.0, ClockQuality::Synchronised, Some(1e-3)));
        for n in 1..500 {
            let (off_s, ..) =
                read(&mut keeper, reading(f64::from(n), f64::from(n % 7 + 1) * 1e4, ClockQuality::Synchronised, None));
            assert!(off_s.abs() < 1e-5, "{off_s} s off at {n} s");
        }
    }
}
