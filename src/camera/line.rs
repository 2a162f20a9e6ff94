//! The twin of a camera's trigger line: a source that gives an image for each pulse that somebody says was sent.

use super::{Ask, CameraError, Moment, Source};
use crate::image::{ExposedBy, Series};

/// The pulses that a sender says it sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinePulses {
    /// Which start of the sender: another one counts anew.
    pub boot: u32,
    /// Pulses since then.
    pub count: u32,
}

/// Tells of the pulses by now; `None` where nobody does.
pub type TellPulses = Box<dyn FnMut() -> Option<LinePulses> + Send>;

/// Pulses that wait for their exposure at most, as many as a real camera's frames do.
const WAITING: u32 = 16;

/// A source behind a simulated line: an exposure for each pulse.
pub struct SimulatedLine {
    inner: Box<dyn Source>,
    pulses: TellPulses,
    seen: Option<LinePulses>,
    /// Pulses that have had no exposure yet.
    waiting: u32,
}

impl SimulatedLine {
    /// Puts a source behind a line. What was sent before counts for nothing.
    pub fn new(inner: Box<dyn Source>, mut pulses: TellPulses) -> Self {
        let seen = pulses();
        Self { inner, pulses, seen, waiting: 0 }
    }

    /// Whether a pulse waits for its exposure, which it has by that.
    fn pulsed(&mut self) -> bool {
        if let Some(now) = (self.pulses)() {
            let same = self.seen.replace(now).filter(|before| before.boot == now.boot);
            let new = same.map_or(0, |before| now.count.wrapping_sub(before.count));
            self.waiting = self.waiting.saturating_add(new).min(WAITING);
        }
        let pulsed = self.waiting > 0;
        self.waiting = self.waiting.saturating_sub(1);
        pulsed
    }
}

impl Source for SimulatedLine {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let by = match (self.pulsed(), moment.ask) {
            (true, _) => ExposedBy::Trigger,
            (false, Ask::Expose) => ExposedBy::Itself,
            (false, Ask::Triggered(_)) => return Err(CameraError::NothingNew),
        };
        let mut series = self.inner.next(moment)?;
        series.stamp(|stamp| stamp.exposed_by = Some(by));
        Ok(series)
    }

    fn gain(&mut self) -> Result<f64, CameraError> {
        self.inner.gain()
    }

    fn set_gain(&mut self, gain_db: f64) -> Result<(), CameraError> {
        self.inner.set_gain(gain_db)
    }

    fn exposure(&mut self) -> Result<f64, CameraError> {
        self.inner.exposure()
    }

    fn set_exposure(&mut self, exposure_s: f64) -> Result<(), CameraError> {
        self.inner.set_exposure(exposure_s)
    }

    fn temperature(&mut self) -> Option<f64> {
        self.inner.temperature()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{Frame, ImageCounter};
    use crate::sky::{ClockQuality, RowOrder};
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    struct Plain;

    impl Source for Plain {
        fn next(&mut self, _moment: &Moment) -> Result<Series, CameraError> {
            Ok(Frame::new(1, 1, vec![7], RowOrder::TopFirst).unwrap().into())
        }
    }

    #[test]
    fn each_pulse_makes_one_exposure_and_without_one_it_exposes_only_by_itself() {
        let sent = Arc::new(Mutex::new(None));
        let told = Arc::clone(&sent);
        let mut camera = SimulatedLine::new(Box::new(Plain), Box::new(move || *told.lock().unwrap()));
        let mut next = |pulses: Option<(u32, u32)>, ask| {
            *sent.lock().unwrap() = pulses.map(|(boot, count)| LinePulses { boot, count });
            let moment = Moment {
                image: ImageCounter(0),
                uptime: Duration::ZERO,
                utc: None,
                quality: ClockQuality::Unset,
                sigma_s: None,
                ask,
            };
            camera.next(&moment).map(|series| series.exposures()[0].stamp.exposed_by)
        };
        let wait = Ask::Triggered(Duration::from_secs(1));
        let nothing = Err(CameraError::NothingNew);
        assert_eq!(next(None, wait), nothing);
        assert_eq!(next(Some((1, 70)), wait), nothing, "what was sent before counts for nothing");
        assert_eq!(next(Some((1, 71)), wait), Ok(Some(ExposedBy::Trigger)));
        assert_eq!(next(Some((1, 71)), wait), nothing);
        assert_eq!(next(Some((2, 3)), wait), nothing, "the sender began anew");
        for _ in 4..=7 {
            assert_eq!(next(Some((2, 7)), wait), Ok(Some(ExposedBy::Trigger)));
        }
        assert_eq!(next(Some((2, 7)), wait), nothing);
        assert_eq!(next(Some((2, 7)), Ask::Expose), Ok(Some(ExposedBy::Itself)));
        assert_eq!(next(Some((2, 8)), Ask::Expose), Ok(Some(ExposedBy::Trigger)), "its trigger came first");
        assert_eq!(next(None, Ask::Expose), Ok(Some(ExposedBy::Itself)));
        for _ in 0..WAITING {
            assert_eq!(next(Some((2, 5000)), wait), Ok(Some(ExposedBy::Trigger)));
        }
        assert_eq!(next(Some((2, 5000)), wait), nothing, "the others are too old");
    }
}
