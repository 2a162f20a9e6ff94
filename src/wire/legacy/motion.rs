//! The gyro rates in a block: what the member `motion_psf` has besides the values of its command.

use super::bytes::{f32_at, f64_at, i32_at, put};
use crate::sky::DEG;
use crate::wire::{Exposure, Gyro, List, Rates};

/// Offsets in a block.
const COUNTER_FCP: usize = 380;
const COUNTER_STARS: usize = 384;
const ELEVATION: usize = 396;
const STEPS_AT: usize = 412;
const STEP_BYTES: usize = 12;
/// Steps that there is room for.
const STEPS: usize = 156;
/// Steps in a second: the flight program's main loop, Hz.
const STEP_RATE_HZ: f64 = 100.16;
/// No rate is higher, as in the native message, deg/s.
const FASTEST_DEG_S: f32 = 1000.0;
/// Where no exposure is under way.
const NO_EXPOSURE: i32 = -1;

/// One step of the flight program's main loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Place of the exposure that is under way in its series; negative where none is.
    pub exposure: i32,
    /// Rate in azimuth, about the vertical, rad/s.
    pub az: f32,
    /// Rate in elevation, rad/s.
    pub el: f32,
}

/// Gyro rates over one series of exposures.
#[derive(Debug, Clone, PartialEq)]
pub struct Recorded {
    /// The series of triggers, as the flight computer counts them.
    pub counter_fcp: i32,
    /// The image that it makes, as the camera counts them.
    pub counter_stars: i32,
    /// Elevation at its start, rad.
    pub elevation: f64,
    /// The steps from its start to the last with an exposure.
    pub steps: Vec<Step>,
}

impl Recorded {
    /// What a block has; `None` where no exposure is in it.
    pub(super) fn unpack(bytes: &[u8]) -> Option<Self> {
        let step = |index: usize| {
            let at = STEPS_AT + index * STEP_BYTES;
            Step { exposure: i32_at(bytes, at), az: f32_at(bytes, at + 4), el: f32_at(bytes, at + 8) }
        };
        let last = (0..STEPS).rev().find(|&index| step(index).exposure > NO_EXPOSURE)?;
        Some(Self {
            counter_fcp: i32_at(bytes, COUNTER_FCP),
            counter_stars: i32_at(bytes, COUNTER_STARS),
            elevation: f64_at(bytes, ELEVATION),
            steps: (0..=last).map(step).collect(),
        })
    }

    /// Puts it into a block; steps beyond the room for them are left out, and those that are not given have no exposure.
    pub(super) fn pack(&self, bytes: &mut [u8]) {
        put(bytes, COUNTER_FCP, self.counter_fcp.to_le_bytes());
        put(bytes, COUNTER_STARS, self.counter_stars.to_le_bytes());
        put(bytes, ELEVATION, self.elevation.to_le_bytes());
        let none = Step { exposure: NO_EXPOSURE, az: 0.0, el: 0.0 };
        for (index, step) in self.steps.iter().chain(std::iter::repeat(&none)).take(STEPS).enumerate() {
            let at = STEPS_AT + index * STEP_BYTES;
            put(bytes, at, step.exposure.to_le_bytes());
            put(bytes, at + 4, step.az.to_le_bytes());
            put(bytes, at + 8, step.el.to_le_bytes());
        }
    }

    /// The same as the native message says it. Its own horizontal roll and plate scale are left out: they follow from the pointing.
    ///
    /// # Errors
    /// Why it cannot be meant, in words.
    pub fn gyro(&self) -> Result<Gyro, String> {
        let counter = |name: &str, counter: i32| u32::try_from(counter).map_err(|_| format!("{name} is {counter}"));
        let (trigger, image) = (counter("counter_fcp", self.counter_fcp)?, counter("counter_stars", self.counter_stars)?);
        if !self.elevation.is_finite() {
            return Err("the elevation is not finite".to_owned());
        }
        let sane = |rates: Rates| rates.az_rate_deg_s.abs() <= FASTEST_DEG_S && rates.el_rate_deg_s.abs() <= FASTEST_DEG_S;
        if !self.steps.iter().all(|step| sane(rates(step))) {
            return Err(format!("a rate is not within {FASTEST_DEG_S} deg/s"));
        }
        let exposures = self.exposures()?;
        // The last rate holds to the end of its step, which a number of 32 bits may put a hair beyond.
        let last = self.steps.last();
        let samples: Vec<Rates> = self.steps.iter().chain(last).map(rates).collect();
        Ok(Gyro {
            trigger_counter: trigger.into(),
            image_counter: image.into(),
            start_uptime_s: 0.0,
            sample_rate_hz: STEP_RATE_HZ,
            elevation_deg: Some(self.elevation / DEG).into(),
            exposures_count: exposures.len() as u8,
            exposures: List::from_slice(&exposures),
            samples_count: (samples.len() as u16).into(),
            samples: List::from_slice(&samples),
        })
    }

    /// The exposures: rows of steps, numbered from 0 as they come.
    fn exposures(&self) -> Result<Vec<Exposure>, String> {
        let mut rows: Vec<(usize, usize)> = Vec::new();
        let mut before = NO_EXPOSURE;
        for (index, step) in self.steps.iter().enumerate().map(|(index, step)| (index, step.exposure)) {
            let (goes_on, next) = (step > NO_EXPOSURE && step == before, rows.len());
            match rows.last_mut().filter(|_| goes_on) {
                Some((_, count)) => *count += 1,
                None if step <= NO_EXPOSURE => {}
                None if usize::try_from(step).ok() == Some(next) => rows.push((index, 1)),
                None => return Err(format!("exposure {step} after {next} others")),
            }
            before = step;
        }
        let most = Gyro::default().exposures.as_slice().len();
        if rows.len() > most {
            return Err(format!("{} exposures, at most {most} are one series", rows.len()));
        }
        let seconds = |steps: usize| (steps as f64 / STEP_RATE_HZ) as f32;
        Ok(rows.iter().map(|&(start, count)| Exposure { start_s: seconds(start), duration_s: seconds(count) }).collect())
    }
}

fn rates(step: &Step) -> Rates {
    let degrees = |rate: f32| (f64::from(rate) / DEG) as f32;
    Rates { az_rate_deg_s: degrees(step.az), el_rate_deg_s: degrees(step.el) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recorded(exposures: &[i32]) -> Recorded {
        let step = |(index, exposure): (usize, &i32)| Step { exposure: *exposure, az: 1e-3 * index as f32, el: -2e-3 };
        let steps = exposures.iter().enumerate().map(step).collect();
        Recorded { counter_fcp: 41, counter_stars: 12, elevation: 0.75, steps }
    }

    #[test]
    fn it_comes_back_from_its_bytes_up_to_the_last_exposure() {
        let mut bytes = [0; super::super::BLOCK_BYTES];
        let sent = recorded(&[0, 0, -1, 1, 1]);
        recorded(&[0, 0, -1, 1, 1, -1, -1]).pack(&mut bytes);
        assert_eq!(Recorded::unpack(&bytes), Some(sent));
        recorded(&[-1; 20]).pack(&mut bytes);
        assert_eq!(Recorded::unpack(&bytes), None);
        recorded(&[0; 400]).pack(&mut bytes);
        assert_eq!(Recorded::unpack(&bytes).unwrap().steps.len(), STEPS);
    }

    #[test]
    fn its_exposures_are_rows_of_steps() {
        let gyro = recorded(&[-1, 0, 0, -1, -1, 1, 1, 1]).gyro().unwrap();
        assert_eq!((gyro.trigger_counter.get(), gyro.image_counter.get(), gyro.exposures_count), (41, 12, 2));
        let close = |a: f32, b: f64| assert!((f64::from(a) - b).abs() < 1e-6, "{a} {b}");
        let [first, second] = gyro.exposures.as_slice()[..2] else { panic!("two") };
        close(first.start_s, 1.0 / 100.16);
        close(first.duration_s, 2.0 / 100.16);
        close(second.start_s, 5.0 / 100.16);
        close(second.duration_s, 3.0 / 100.16);
        assert_eq!(gyro.samples_count.get(), 9);
        close(gyro.samples.as_slice()[7].az_rate_deg_s, 7e-3_f64.to_degrees());
        close(gyro.samples.as_slice()[8].el_rate_deg_s, -2e-3_f64.to_degrees());
    }

    #[test]
    fn what_cannot_be_meant_is_refused_in_words() {
        let refused = |recorded: Recorded| recorded.gyro().unwrap_err();
        assert!(refused(recorded(&[0, 2])).contains("exposure 2 after 1 others"));
        assert!(refused(recorded(&[1, 1])).contains("exposure 1 after 0"));
        assert!(refused(recorded(&[0, -1, 0])).contains("exposure 0 after 1"));
        assert!(refused(Recorded { counter_stars: -1, ..recorded(&[0]) }).contains("counter_stars"));
        assert!(refused(Recorded { elevation: f64::NAN, ..recorded(&[0]) }).contains("elevation"));
        let mut wild = recorded(&[0, 0]);
        wild.steps[1].az = f32::INFINITY;
        assert!(refused(wild).contains("a rate"));
        assert!(refused(recorded(&(0..20).collect::<Vec<_>>())).contains("at most 16"));
    }
}
