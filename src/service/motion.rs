//! What the flight computer in charge says of how the gondola turned while an image was exposed: the blocks of gyro rates that can be used.
//!
//! A block belongs to the image whose two counters it names, the camera's and the flight computer's. What comes too late, names an image
//! that is not there, or cannot be, is refused with its reason, and the image is solved as if nothing had come.

use super::state::State;
use crate::image::{ImageCounter, Stamp, TriggerCounter};
use crate::sky::{ARCSEC, DEG};
use crate::solve::Motion;
use crate::wire::Gyro;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// Blocks that are remembered: of the image that is being solved, of the one that waits, and of the next.
const REMEMBERED: usize = 4;
/// A flight computer that has sent no block for so long is not waited for.
const EXPECTED: Duration = Duration::from_secs(600);

/// The motion of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct Given {
    image: ImageCounter,
    trigger: TriggerCounter,
    motion: Arc<Motion>,
}

/// The motions that are known.
#[derive(Debug, Clone, Default)]
pub struct Motions {
    given: VecDeque<Given>,
    last: Option<Instant>,
    /// Blocks that could not be used.
    pub refused: u32,
}

impl Motions {
    /// The motion of an image, where it is known.
    pub fn of(&self, stamp: &Stamp) -> Option<Arc<Motion>> {
        let given = self.given.iter().rev().find(|given| given.image == stamp.image && Some(given.trigger) == stamp.trigger)?;
        Some(Arc::clone(&given.motion))
    }

    /// Whether there is somebody who sends them.
    pub fn are_sent(&self, now: Instant) -> bool {
        self.last.is_some_and(|last| now.saturating_duration_since(last) < EXPECTED)
    }

    /// Takes a block that was judged.
    pub fn take(&mut self, judged: Result<Given, String>, now: Instant) {
        self.last = Some(now);
        match judged {
            Ok(given) => {
                self.given.push_back(given);
                if self.given.len() > REMEMBERED {
                    self.given.pop_front();
                }
            }
            Err(why) => {
                self.refused = self.refused.saturating_add(1);
                tracing::warn!(why, "gyro rates are not used");
            }
        }
    }
}

/// The motion in a block of the flight computer in charge, or why it cannot be used.
pub fn judge(gyro: &Gyro, state: &State) -> Result<Given, String> {
    let settings = &state.settings.solver.motion;
    if !settings.enabled {
        return Err("solver.motion.enabled is false".to_owned());
    }
    let (image, trigger) = (ImageCounter(gyro.image_counter.get()), TriggerCounter(gyro.trigger_counter.get()));
    let last = state.latest.as_ref().map(|finished| &finished.outcome);
    if let Some(ended) = last.map(|outcome| outcome.stamp.image).filter(|ended| *ended >= image) {
        return Err(format!("for image {} they come too late: image {} has ended", image.0, ended.0));
    }
    if image > state.counters.next_image {
        return Err(format!("there is no image {} yet, the next is {}", image.0, state.counters.next_image.0));
    }
    let seen = last.and_then(|outcome| outcome.solution.as_ref()?.horizontal).map(|horizontal| horizontal.pointing);
    let elevation = gyro.elevation_deg.get().map(|el| el * DEG).or(seen.map(|pointing| pointing.elevation));
    let elevation = elevation.ok_or("the elevation is not known")?;
    let exposures =
        gyro.exposures.as_slice().get(..gyro.exposures_count.into()).ok_or("there is no room for so many exposures")?;
    let samples = gyro.samples.as_slice().get(..gyro.samples_count.get().into()).ok_or("there is no room for so many samples")?;
    let motion = Motion {
        rates: samples.iter().map(|rates| (f64::from(rates.az_rate_deg_s) * DEG, f64::from(rates.el_rate_deg_s) * DEG)).collect(),
        sample_rate_hz: gyro.sample_rate_hz,
        exposures: exposures.iter().map(|exposure| (f64::from(exposure.start_s), f64::from(exposure.duration_s))).collect(),
        elevation,
        roll: seen.map_or(settings.roll_deg * DEG, |pointing| pointing.roll),
        drift: settings.gyro_drift_arcsec * ARCSEC,
    };
    motion.check(exposures.len()).map_err(|error| format!("for image {}: {error}", image.0))?;
    Ok(Given { image, trigger, motion: Arc::new(motion) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Guard;
    use crate::service::state::Finished;
    use crate::settings::Settings;
    use crate::solve::{Outcome, Reason};
    use crate::wire::{Exposure, List, Maybe, Rates};

    fn state(next: u32, ended: Option<u32>) -> State {
        let mut state = State::new(Arc::new(Settings::flight().unwrap()), Guard::default());
        state.counters.next_image = ImageCounter(next);
        state.latest = ended.map(|image| {
            let stamp = Stamp { image: ImageCounter(image), ..Stamp::default() };
            Arc::new(Finished::without_stars(Outcome::unsolved(stamp, Reason::NoMatch, ""), Instant::now()))
        });
        state
    }

    fn gyro(image: u32, trigger: u32) -> Gyro {
        Gyro {
            image_counter: image.into(),
            trigger_counter: trigger.into(),
            sample_rate_hz: 100.0,
            elevation_deg: Some(40.0).into(),
            exposures_count: 1,
            exposures: List::from_slice(&[Exposure { start_s: 0.1, duration_s: 0.2 }]),
            samples_count: 50.into(),
            samples: List::from_slice(&[Rates { az_rate_deg_s: 0.1, el_rate_deg_s: 0.0 }; 50]),
            ..Gyro::default()
        }
    }

    #[tokio::test]
    async fn a_motion_is_that_of_the_image_with_both_its_counters() {
        let state = state(7, Some(5));
        let mut motions = Motions::default();
        assert!(!motions.are_sent(Instant::now()));
        for image in [6, 7] {
            motions.take(judge(&gyro(image, 90 + image), &state), Instant::now());
        }
        assert!(motions.are_sent(Instant::now()));
        let of = |image: u32, trigger: Option<u32>| {
            motions.of(&Stamp { image: ImageCounter(image), trigger: trigger.map(TriggerCounter), ..Stamp::default() })
        };
        assert!(of(6, Some(96)).is_some() && of(7, Some(97)).is_some());
        assert!(of(6, Some(97)).is_none() && of(6, None).is_none() && of(8, Some(98)).is_none());
        assert_eq!(motions.refused, 0);
    }

    #[tokio::test]
    async fn what_cannot_be_used_is_refused_with_its_reason() {
        let refused = |gyro: &Gyro, state: &State| judge(gyro, state).unwrap_err();
        assert!(refused(&gyro(5, 1), &state(7, Some(5))).contains("too late"));
        assert!(refused(&gyro(8, 1), &state(7, Some(5))).contains("no image 8 yet"));
        assert!(refused(&Gyro { elevation_deg: Maybe::unknown(), ..gyro(6, 1) }, &state(7, None)).contains("elevation"));
        assert!(refused(&Gyro { samples_count: 20.into(), ..gyro(6, 1) }, &state(7, None)).contains("exposure 0 lies outside"));
        assert!(refused(&Gyro { exposures_count: 17, ..gyro(6, 1) }, &state(7, None)).contains("no room"));
        let mut off = Settings::flight().unwrap();
        off.solver.motion.enabled = false;
        let mut state = state(7, None);
        state.settings = Arc::new(off);
        assert!(refused(&gyro(6, 1), &state).contains("solver.motion.enabled"));
        let mut motions = Motions::default();
        motions.take(judge(&gyro(6, 1), &state), Instant::now());
        assert_eq!(motions.refused, 1);
    }
}
