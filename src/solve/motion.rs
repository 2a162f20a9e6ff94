//! How the gondola turned during a series of exposures, as its gyros say, and the trails that stars leave by it
//! (stars-paper, "Solving - Motion PSF").

use crate::sky::{CameraModel, Vec3};
use crate::sources::{Stretch, Trail};
use nalgebra::{Matrix2, Rotation3, Vector2};
use std::f64::consts::FRAC_PI_2;

/// Steps along a trail: a third of a pixel is far below a star's width, px.
const STEP_PX: f64 = 1.0 / 3.0;
/// Steps at most.
const MOST_STEPS: f64 = 2000.0;
/// Furthest that a star may go from where it was at the start, px: beyond it hardly a trail is whole on a picture.
const FURTHEST_PX: f64 = 256.0;
/// Longest trail of a single exposure, px: a star's light is spread so thin by then that none is seen.
const LONGEST_PX: f64 = 100.0;
/// Exposures of a series at most.
const MOST_EXPOSURES: usize = crate::image::MAX_PARTS;

/// Gyro rates over a series of exposures. Times are from the first sample.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Motion {
    /// Rates about the vertical (azimuth, from north through east) and in elevation, rad/s, evenly spaced.
    pub rates: Vec<(f64, f64)>,
    /// Samples a second, Hz.
    pub sample_rate_hz: f64,
    /// Start and length of each exposure, s.
    pub exposures: Vec<(f64, f64)>,
    /// Elevation of the boresight, rad.
    pub elevation: f64,
    /// Horizontal roll of the camera, rad.
    pub roll: f64,
    /// One σ of the angle by which the gyros drift in a second, rad; it grows with the root of the time.
    pub drift: f64,
}

/// Why a motion cannot be used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MotionError {
    /// Not one for each exposure.
    #[error("{given} exposures, the image has {wanted}")]
    Exposures {
        /// How many it has.
        given: usize,
        /// How many there are.
        wanted: usize,
    },
    /// Something is no number, or outside of what can be.
    #[error("{0} is not a number that can be")]
    Number(&'static str),
    /// An exposure that the samples do not cover.
    #[error("exposure {0} lies outside of the samples")]
    NotCovered(usize),
    /// Stars move too far.
    #[error("stars move {0:.0} px, at most {FURTHEST_PX:.0} are followed")]
    TooFar(f64),
    /// The trail of one exposure is too long.
    #[error("stars move {0:.0} px in one exposure, at most {LONGEST_PX:.0} are followed")]
    TooLong(f64),
}

impl Motion {
    /// Whether it can be one of so many exposures.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn check(&self, exposures: usize) -> Result<(), MotionError> {
        let given = self.exposures.len();
        if given != exposures || given == 0 || given > MOST_EXPOSURES {
            return Err(MotionError::Exposures { given, wanted: exposures });
        }
        if !(self.sample_rate_hz.is_finite() && self.sample_rate_hz > 0.0) {
            return Err(MotionError::Number("the rate of samples"));
        }
        if !(self.elevation.abs() <= FRAC_PI_2 && self.roll.is_finite() && self.drift.is_finite()) {
            return Err(MotionError::Number("elevation or roll"));
        }
        if !self.rates.iter().all(|(az, el)| az.is_finite() && el.is_finite()) {
            return Err(MotionError::Number("a rate"));
        }
        // The last sample holds until the next one would be due.
        let end = self.rates.len() as f64 / self.sample_rate_hz;
        let covered = |&(start, length): &(f64, f64)| start >= 0.0 && length > 0.0 && start + length <= end;
        match self.exposures.iter().position(|exposure| !covered(exposure)) {
            Some(which) => Err(MotionError::NotCovered(which)),
            None => Ok(()),
        }
    }

    /// The track, summed up.
    pub fn track(&self) -> Track<'_> {
        let mut turned = Vec::with_capacity(self.rates.len());
        let mut sum = (0.0, 0.0);
        let step = 0.5 / self.sample_rate_hz;
        for (i, rate) in self.rates.iter().enumerate() {
            if let Some(before) = i.checked_sub(1).and_then(|before| self.rates.get(before)) {
                sum = (sum.0 + step * (before.0 + rate.0), sum.1 + step * (before.1 + rate.1));
            }
            turned.push(sum);
        }
        let (sin_roll, cos_roll) = (libm::sin(self.roll), libm::cos(self.roll));
        // The zenith's part in the picture's plane, and the horizontal left, on the picture's own axes.
        let upright = Vec3::new(sin_roll, cos_roll, 0.0);
        let level = Vec3::new(cos_roll, -sin_roll, 0.0);
        let zenith = upright * libm::cos(self.elevation) + Vec3::z() * libm::sin(self.elevation);
        let mut track = Track { motion: self, turned, zenith, level, start: (0.0, 0.0) };
        track.start = track.turned_at(self.exposures.first().map_or(0.0, |exposure| exposure.0));
        track
    }

    /// From the first sample to the end of the last exposure, s.
    pub fn length_s(&self) -> f64 {
        self.exposures.last().map_or(0.0, |(start, length)| start + length)
    }

    /// From the start of the first exposure to the middle of the series' light, s.
    pub fn start_to_middle_s(&self) -> f64 {
        self.middle_s() - self.exposures.first().map_or(0.0, |exposure| exposure.0)
    }

    /// Covariance of what the gyros' drift makes of the place of a star in a second, along left and up, rad²/s: in azimuth it is seen smaller
    /// the higher the camera looks.
    pub fn walk(&self) -> Matrix2<f64> {
        let (sin_roll, cos_roll) = (libm::sin(self.roll), libm::cos(self.roll));
        let (level, upright) = (Vector2::new(cos_roll, -sin_roll) * libm::cos(self.elevation), Vector2::new(sin_roll, cos_roll));
        (level * level.transpose() + upright * upright.transpose()) * (self.drift * self.drift)
    }

    /// Variance of the turn from the start to the middle that the gyros' drift makes, per axis, rad²: a third of what it comes to by the end.
    pub fn variance_to_middle(&self) -> f64 {
        let start = self.exposures.first().map_or(0.0, |exposure| exposure.0);
        let end = self.exposures.last().map_or(0.0, |(start, length)| start + length);
        self.drift * self.drift * (end - start).max(0.0) / 3.0
    }

    fn middle_s(&self) -> f64 {
        let light: f64 = self.exposures.iter().map(|(_, length)| length).sum();
        let moment: f64 = self.exposures.iter().map(|(start, length)| length * (start + length / 2.0)).sum();
        if light > 0.0 { moment / light } else { 0.0 }
    }

    /// The trails that stars leave in each exposure, from where they were at the middle of the light: there a plate scale that is not quite
    /// known shifts nothing.
    ///
    /// # Errors
    /// Where stars go too far.
    pub fn trails(&self, camera: &CameraModel) -> Result<Vec<Trail>, MotionError> {
        let light: f64 = self.exposures.iter().map(|(_, length)| length).sum();
        let track = self.track();
        let middle = Rotation3::new(track.turn_to_middle());
        let mut trails: Vec<Trail> =
            self.exposures.iter().map(|exposure| self.trail(&track, camera, *exposure, light, &middle)).collect();
        let mean = |part: &dyn Fn(&Trail) -> f64| trails.iter().map(|trail| trail.share * part(trail)).sum::<f64>();
        let mean_place = |axis: fn(&(f64, f64)) -> f64| {
            mean(&|trail| trail.places.iter().map(axis).sum::<f64>() / trail.places.len().max(1) as f64)
        };
        let (x, y, spin) = (mean_place(|place| place.0), mean_place(|place| place.1), mean(&|trail| trail.spin));
        for trail in &mut trails {
            trail.places.iter_mut().for_each(|place| *place = (place.0 - x, place.1 - y));
            trail.spin -= spin;
        }
        // What is no number, of a star that leaves the camera's half of the sky, is too far as well.
        let followed = |(x, y): &(f64, f64)| x.abs() <= FURTHEST_PX && y.abs() <= FURTHEST_PX;
        if trails.iter().all(|trail| trail.places.iter().all(followed)) {
            return match trails.iter().map(Trail::span).fold(0.0, f64::max) {
                span if span > LONGEST_PX => Err(MotionError::TooLong(span)),
                _ => Ok(trails),
            };
        }
        let finite = |px: f64| if px.is_finite() { px } else { f64::INFINITY };
        Err(MotionError::TooFar(trails.iter().map(|trail| finite(trail.reach())).fold(0.0, f64::max)))
    }

    fn trail(
        &self,
        track: &Track<'_>,
        camera: &CameraModel,
        (start, length): (f64, f64),
        light: f64,
        middle: &Rotation3<f64>,
    ) -> Trail {
        let origin = camera.position(0.0, 0.0);
        // Where the star that is on the boresight at the middle is seen: the camera's turn, backwards.
        let since_middle = |time: f64| middle.inverse() * Rotation3::new(track.turn_at(time));
        let place = |time: f64| {
            let seen = since_middle(time).inverse() * Vec3::z();
            let (x, y) = camera.to_pixel(&seen).unwrap_or((f64::INFINITY, f64::INFINITY));
            (x - origin.0, y - origin.1)
        };
        let of_samples = (0..=32).map(|i| place(start + length * f64::from(i) / 32.0)).collect::<Vec<_>>();
        let long = of_samples.windows(2).map(|pair| match pair {
            [a, b] => (b.0 - a.0).hypot(b.1 - a.1),
            _ => 0.0,
        });
        // At least one, which shows where no number comes of it.
        let steps = ((long.sum::<f64>() / STEP_PX).ceil().min(MOST_STEPS) as usize).max(1);
        // What of the turn about the boresight is left and up in the file's own order of pixels.
        let (left, up) = (camera.position(1.0, 0.0).0 - origin.0, camera.position(0.0, 1.0).1 - origin.1);
        let spin = left * up * since_middle(start + length / 2.0).scaled_axis().z;
        let moment = |step: usize| start + length * (step as f64 + 0.5) / steps as f64;
        Trail {
            places: (0..steps).map(|step| place(moment(step))).collect(),
            share: length / light,
            spin,
            sigma_px: self.variance_to_middle().sqrt() / camera.platescale,
            stretch: Stretch {
                distortion: camera.k1 / camera.half_diagonal_px().powi(2),
                flatness: camera.platescale * camera.platescale,
            },
        }
    }
}

/// How the camera turned, from the start of the first exposure on.
#[derive(Debug, Clone)]
pub struct Track<'a> {
    motion: &'a Motion,
    /// By each sample, since the first one, azimuth and elevation, rad.
    turned: Vec<(f64, f64)>,
    /// Azimuth and elevation by the start, rad.
    start: (f64, f64),
    /// The axes of azimuth and elevation, on (left, up, boresight).
    zenith: Vec3,
    level: Vec3,
}

impl Track<'_> {
    /// The camera's turn about (left, up, boresight) from the start of the first exposure to a time, rad: in elevation about the level
    /// axis, and in azimuth about the vertical, which does not turn with it.
    pub fn turn_at(&self, time_s: f64) -> Vec3 {
        let (az, el) = self.turned_at(time_s);
        let (az, el) = (az - self.start.0, el - self.start.1);
        (Rotation3::new(-self.zenith * az) * Rotation3::new(-self.level * el)).scaled_axis()
    }

    /// The mean of it over the series' light: where its middle is.
    pub fn turn_to_middle(&self) -> Vec3 {
        /// Moments of an exposure.
        const MOMENTS: u32 = 32;
        let light: f64 = self.motion.exposures.iter().map(|(_, length)| length).sum();
        let of_exposure = |&(start, length): &(f64, f64)| {
            let moment = |i: u32| start + length * (f64::from(i) + 0.5) / f64::from(MOMENTS);
            (0..MOMENTS).map(|i| self.turn_at(moment(i))).sum::<Vec3>() * (length / light / f64::from(MOMENTS))
        };
        self.motion.exposures.iter().map(of_exposure).sum()
    }

    /// Azimuth and elevation by a time since the first sample, rad; between samples rates go on a straight line, after the last one they stay.
    fn turned_at(&self, time_s: f64) -> (f64, f64) {
        let samples = (time_s * self.motion.sample_rate_hz).max(0.0);
        let last = self.turned.len().saturating_sub(1);
        let whole = (samples.floor() as usize).min(last);
        let rest = samples - whole as f64;
        let rate = |i: usize| self.motion.rates.get(i.min(last)).copied().unwrap_or((0.0, 0.0));
        let (here, next, sum) = (rate(whole), rate(whole + 1), self.turned.get(whole).copied().unwrap_or((0.0, 0.0)));
        let on = |sum: f64, here: f64, next: f64| sum + rest * (here + 0.5 * rest * (next - here)) / self.motion.sample_rate_hz;
        (on(sum.0, here.0, next.0), on(sum.1, here.1, next.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, Attitude, DEG, Observer, RowOrder, separation, wrap_pi};

    fn camera() -> CameraModel {
        CameraModel {
            width: 1536,
            height: 1024,
            platescale: 9.44 * ARCSEC,
            k1: 0.0,
            rows: RowOrder::BottomFirst,
            mirrored: false,
        }
    }

    /// An attitude against the horizon, the sky of date being the observer's own.
    fn looking(azimuth: f64, elevation: f64, roll: f64) -> Attitude {
        let observer = Observer { latitude: -77.0 * DEG, sidereal_time: 1.0 };
        let boresight = observer.direction_of(azimuth, elevation);
        let level = Attitude::from_boresight_up(&boresight, &observer.direction_of(azimuth, elevation + FRAC_PI_2)).unwrap();
        // The up direction turned towards growing azimuth, which is to the right.
        let up = level.up() * roll.cos() - level.left() * roll.sin();
        Attitude::from_boresight_up(&boresight, &up).unwrap()
    }

    fn steady(az: f64, el: f64) -> Motion {
        Motion {
            rates: vec![(az, el); 201],
            sample_rate_hz: 100.0,
            exposures: vec![(0.3, 0.12), (0.61, 0.12)],
            elevation: 41.0 * DEG,
            roll: 7.0 * DEG,
            drift: 4.0 * ARCSEC,
        }
    }

    #[test]
    fn the_turn_leads_from_the_attitude_at_the_start_to_a_later_one() {
        let (az, el) = (0.5 * DEG, -0.3 * DEG);
        let motion = steady(az, el);
        let start = looking(1.0, motion.elevation, motion.roll);
        for time in [0.3, 0.5, 1.2] {
            let turned = start.turned(&motion.track().turn_at(time));
            let wanted = looking(1.0 + az * (time - 0.3), motion.elevation + el * (time - 0.3), motion.roll);
            assert!(separation(&turned.boresight(), &wanted.boresight()) < 0.05 * ARCSEC, "{time} s");
            let (.., roll) = turned.angles();
            assert!(wrap_pi(roll - wanted.angles().2).abs() < 1.0 * ARCSEC, "{time} s");
        }
        let middle = motion.track().turn_to_middle();
        assert!((middle - motion.track().turn_at(0.3 + motion.start_to_middle_s())).norm() < 1.0 * ARCSEC);
        assert!((motion.start_to_middle_s() - 0.215).abs() < 1e-12);
    }

    #[test]
    fn trails_are_where_a_fixed_star_is_seen_by_the_camera_that_turns() {
        for (rows, mirrored) in [(RowOrder::BottomFirst, false), (RowOrder::TopFirst, false), (RowOrder::TopFirst, true)] {
            let camera = CameraModel { rows, mirrored, ..camera() };
            let motion = steady(0.3 * DEG, 0.1 * DEG);
            let trails = motion.trails(&camera).unwrap();
            let start = looking(2.0, motion.elevation, motion.roll);
            let star = start.boresight();
            let origin = camera.to_pixel(&start.turned(&motion.track().turn_to_middle()).to_camera(&star)).unwrap();
            for (trail, (begin, length)) in trails.iter().zip(&motion.exposures) {
                assert!((trail.share - 0.5).abs() < 1e-12);
                let n = trail.places.len();
                for (step, place) in trail.places.iter().enumerate() {
                    let time = begin + length * (step as f64 + 0.5) / n as f64;
                    let seen = camera.to_pixel(&start.turned(&motion.track().turn_at(time)).to_camera(&star)).unwrap();
                    let off = (seen.0 - origin.0 - place.0).hypot(seen.1 - origin.1 - place.1);
                    assert!(off < 0.05, "{rows:?} {mirrored}: {off} px");
                }
            }
        }
    }

    #[test]
    fn rates_that_change_are_integrated() {
        let mut motion = steady(0.0, 0.0);
        motion.rates = (0..201).map(|i| (f64::from(i) / 100.0, 1.0)).collect();
        let track = motion.track();
        assert!((track.turned_at(1.505).0 - 1.505 * 1.505 / 2.0).abs() < 1e-12);
        assert!((track.turned_at(5.0).1 - 5.0).abs() < 1e-12);
        assert_eq!(Motion { rates: Vec::new(), ..motion }.track().turned_at(1.0), (0.0, 0.0));
    }

    #[test]
    fn a_motion_that_cannot_be_is_refused_by_what_is_wrong() {
        let good = steady(0.1, 0.1);
        assert_eq!(good.check(2), Ok(()));
        assert_eq!(good.check(3), Err(MotionError::Exposures { given: 2, wanted: 3 }));
        let with = |change: fn(&mut Motion)| {
            let mut motion = good.clone();
            change(&mut motion);
            motion.check(motion.exposures.len().max(1)).unwrap_err().to_string()
        };
        assert!(with(|m| m.exposures.clear()).contains("0 exposures"));
        assert!(with(|m| m.sample_rate_hz = f64::NAN).contains("rate of samples"));
        assert!(with(|m| m.rates[7].1 = f64::INFINITY).contains("a rate"));
        assert!(with(|m| m.elevation = 2.0).contains("elevation"));
        assert!(with(|m| m.exposures[1].1 = 5.0).contains("exposure 1 lies outside"));
        assert!(with(|m| m.exposures[0].0 = -0.1).contains("exposure 0 lies outside"));
        for rate in [9.0, 90.0, 300.0, 1000.0] {
            assert!(matches!(steady(rate * DEG, 0.0).trails(&camera()), Err(MotionError::TooFar(_))), "{rate} deg/s");
        }
        let one = Motion { exposures: vec![(0.3, 0.12)], ..steady(4.0 * DEG, 0.0) };
        assert!(matches!(one.trails(&camera()), Err(MotionError::TooLong(_))));
    }
}
