//! What the flight computer in charge says of how the gondola turned while an image was exposed: the blocks of gyro rates that can be used.
//!
//! A block belongs to the image whose two counters it names, the camera's and the flight computer's. What comes too late, names an image
//! that is not there, or cannot be, is refused with its reason, and the image is solved as if nothing had come.

use super::state::State;
use crate::image::{ImageCounter, Stamp, TriggerCounter};
use crate::sky::{ARCSEC, DEG};
use crate::solve::Motion;
use crate::wire::Gyro;
use crate::wire::legacy::Recorded;
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
    if !state.settings.solver.motion.enabled {
        return Err("solver.motion.enabled is false".to_owned());
    }
    read(gyro, state)
}

/// The same of a block that came with the command to use it, so that the setting is not asked: that is being done.
pub fn judge_legacy(recorded: Option<&Recorded>, state: &State) -> Result<Given, String> {
    let recorded = recorded.ok_or_else(|| "no exposure is in them".to_owned())?;
    read(&recorded.gyro()?, state)
}

fn read(gyro: &Gyro, state: &State) -> Result<Given, String> {
    let settings = &state.settings.solver.motion;
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
    use crate::wire::legacy::Step;
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

    /// A series of two exposures as a program of old records it, and as the native message says it.
    #[tokio::test]
    async fn a_packet_of_old_gives_the_motion_of_the_native_one() {
        let exposing =
            |index: usize| [0..12, 31..43].iter().position(|row| row.contains(&index)).map_or(-1, |place| place as i32);
        let rate = |index: usize| (0.002 + 1e-5 * index as f32, -0.001 - 2e-5 * index as f32);
        let steps: Vec<Step> = (0..43).map(|i| Step { exposure: exposing(i), az: rate(i).0, el: rate(i).1 }).collect();
        let old = Recorded { counter_fcp: 96, counter_stars: 6, elevation: 0.7, steps };
        let sample = |i: usize| Rates { az_rate_deg_s: rate(i).0.to_degrees(), el_rate_deg_s: rate(i).1.to_degrees() };
        let samples: Vec<Rates> = (0..=43).map(sample).collect();
        let exposure = |start: u8| Exposure { start_s: f32::from(start) / 100.16, duration_s: 12.0 / 100.16 };
        let native = Gyro {
            sample_rate_hz: 100.16,
            elevation_deg: Some(0.7_f64.to_degrees()).into(),
            exposures_count: 2,
            exposures: List::from_slice(&[exposure(0), exposure(31)]),
            samples_count: 44.into(),
            samples: List::from_slice(&samples),
            ..gyro(6, 96)
        };
        let state = state(7, None);
        let (old, native) = (judge_legacy(Some(&old), &state).unwrap(), judge(&native, &state).unwrap());
        assert_eq!((old.image, old.trigger), (native.image, native.trigger));
        let (old, native) = (&old.motion, &native.motion);
        assert_eq!((old.elevation, old.roll, old.drift), (native.elevation, native.roll, native.drift));
        let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
        assert!(old.exposures.iter().zip(&native.exposures).all(|(a, b)| close(a.0, b.0) && close(a.1, b.1)));
        // Up to the last rate: what comes after it holds, or is the next one.
        for moment in 0..43 {
            let apart = (old.track().turn_at(f64::from(moment) * 0.01) - native.track().turn_at(f64::from(moment) * 0.01)).norm();
            assert!(apart < 0.001 * ARCSEC, "{} arcsec", apart / ARCSEC);
        }
        assert!(judge_legacy(None, &state).unwrap_err().contains("no exposure"));
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
