//! Tracking: what is known of a frame before it is solved, from the frames before it.
//!
//! The last solution says where the camera looked, and the flight computer's estimates, then and now, say how far it has turned since;
//! without them it may have drifted. Plate scale and distortion stay what they were. Time comes in as time since any fixed moment of a
//! clock that does not jump.

use super::outcome::{FoundBy, Outcome, Prior};
use super::requirements::Circle;
use crate::settings::TrackingSettings;
use crate::sky::{Attitude, DEG, Vec3, direction, separation};
use std::f64::consts::{PI, TAU};
use std::time::Duration;

/// An attitude known beforehand.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct AttitudePrior {
    /// The attitude, ICRS.
    pub attitude: Attitude,
    /// One σ of the boresight for each axis on the sky, rad.
    pub sigma: f64,
    /// One σ of the turn about the boresight, rad.
    pub sigma_roll: f64,
}

/// What is known beforehand of how the camera projects.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct LensPrior {
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// One σ of its natural logarithm.
    pub sigma_ln: f64,
    /// Radial distortion at the half diagonal.
    pub k1: f64,
    /// One σ of it.
    pub sigma_k1: f64,
}

/// How far beyond its σ a prior is believed to hold: it is outside in one case of 3000 (two axes), and then the frame is solved lost in
/// space.
pub const REACH_SIGMAS: f64 = 4.0;
/// A solution with fewer matches says more of the prior than of the lens, unless it was found lost in space.
const LENS_MATCHES: usize = 10;
/// σ of the distortion that a solution leaves, fraction at half the diagonal: what twenty stars of 0.1 px give (rendered frames).
const SIGMA_K1: f64 = 2e-4;

/// How a quantity is spread around what is expected of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spread {
    /// As a Gaussian of this σ, rad.
    Sigma(f64),
    /// Evenly, up to this far away, rad.
    Within(f64),
}

impl Spread {
    /// How far away it is looked for, rad.
    pub fn reach(&self) -> f64 {
        match *self {
            Self::Sigma(sigma) => REACH_SIGMAS * sigma,
            Self::Within(reach) => reach,
        }
    }

    /// Inverse of the density at a distance, for one axis, rad: as wide as an even spread of the same density would be.
    pub fn width_at(&self, distance: f64) -> f64 {
        match *self {
            Self::Sigma(sigma) => TAU.sqrt() * sigma * (0.5 * (distance / sigma).powi(2)).exp(),
            Self::Within(reach) => 2.0 * reach,
        }
    }

    /// The same for two axes of the sky, sr.
    pub fn area_at(&self, distance: f64) -> f64 {
        match *self {
            Self::Sigma(sigma) => TAU * sigma * sigma * (0.5 * (distance / sigma).powi(2)).exp(),
            Self::Within(reach) => TAU * (1.0 - reach.min(PI).cos()),
        }
    }
}

/// The attitudes that a prior expects.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region {
    /// In the middle; its roll means nothing where any roll may be.
    pub attitude: Attitude,
    /// The boresight, around the middle's.
    pub boresight: Spread,
    /// The turn about the boresight, around the middle's.
    pub roll: Spread,
}

impl Region {
    /// What the prior says; without an attitude, the circles in which the boresight is required to be, with any roll.
    pub fn of(prior: &Prior, circles: &[Circle]) -> Option<Self> {
        if let Some(AttitudePrior { attitude, sigma, sigma_roll }) = prior.attitude {
            let sound = sigma > 0.0 && sigma_roll > 0.0 && sigma.is_finite() && sigma_roll.is_finite();
            // Beyond half a turn any roll is as good as another.
            let roll = if REACH_SIGMAS * sigma_roll < PI { Spread::Sigma(sigma_roll) } else { Spread::Within(PI) };
            return sound.then_some(Self { attitude, boresight: Spread::Sigma(sigma), roll });
        }
        let circle = circles.iter().min_by(|a, b| a.radius.total_cmp(&b.radius))?;
        let aside = if circle.centre.z.abs() < 0.9 { Vec3::z() } else { Vec3::x() };
        let attitude = Attitude::from_boresight_up(&circle.centre, &aside)?;
        Some(Self { attitude, boresight: Spread::Within(circle.radius), roll: Spread::Within(PI) })
    }

    /// How far an attitude lies from the middle: the boresight, and the turn about it, rad.
    pub fn distance(&self, attitude: &Attitude) -> (f64, f64) {
        let up = self.attitude.to_camera(&attitude.up());
        (separation(&self.attitude.boresight(), &attitude.boresight()), up.x.atan2(up.y).abs())
    }
}

/// The last solution.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Last {
    at: Duration,
    attitude: AttitudePrior,
    /// Where the flight computer thought that the camera looked, up being the zenith.
    estimate: Option<Attitude>,
}

/// What earlier frames have shown. Empty at a start: the first frame is solved lost in space.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Tracker {
    last: Option<Last>,
    lens: Option<LensPrior>,
}

impl Tracker {
    /// Takes note of how a frame captured at a time ended.
    pub fn learn(&mut self, at: Duration, outcome: &Outcome, settings: &TrackingSettings) {
        let Some(solution) = outcome.solution.as_ref().filter(|_| self.last.is_none_or(|last| last.at <= at)) else { return };
        let sigmas = solution.sigmas();
        let attitude = AttitudePrior { attitude: solution.attitude, sigma: sigmas.x.max(sigmas.y), sigma_roll: sigmas.z };
        self.last = Some(Last { at, attitude, estimate: estimated(&outcome.prior) });
        if outcome.found_by == Some(FoundBy::LostInSpace) || solution.matches.len() >= LENS_MATCHES {
            self.lens = Some(LensPrior {
                platescale: solution.platescale,
                sigma_ln: settings.platescale_sigma.hypot(solution.sigma_platescale / solution.platescale),
                k1: solution.k1,
                sigma_k1: SIGMA_K1,
            });
        }
    }

    /// What is known of a frame captured at a time: to what the flight computer `sent` is added what earlier frames have shown.
    pub fn prior(&self, at: Duration, sent: Prior, settings: &TrackingSettings) -> Prior {
        if !settings.enabled {
            return sent;
        }
        let attitude = self.last.and_then(|last| last.carried(at, &sent, settings));
        Prior { attitude, lens: self.lens, ..sent }
    }
}

impl Last {
    /// The attitude as it is expected at a time; `None` where that is too long ago.
    fn carried(&self, at: Duration, sent: &Prior, settings: &TrackingSettings) -> Option<AttitudePrior> {
        let age_s = at.saturating_sub(self.at).as_secs_f64();
        if at < self.at || age_s > settings.max_age_s {
            return None;
        }
        let AttitudePrior { attitude, sigma, sigma_roll } = self.attitude;
        let (attitude, drift_deg) = match self.estimate.zip(estimated(sent)) {
            Some((then, now)) => (
                // Turned as the estimate has turned: where the flight computer is off by the same then and now, it is right. (The
                // estimates are of date; turning in ICRS instead is off by a third of a degree in the turn's axis.)
                turned_with(&attitude, &then, &now)?,
                settings.estimate_sigma_deg + settings.estimate_drift_deg_s * age_s,
            ),
            None => (attitude, settings.drift_deg_s * age_s),
        };
        let drift = drift_deg * DEG;
        Some(AttitudePrior { attitude, sigma: sigma.hypot(drift), sigma_roll: sigma_roll.hypot(drift) })
    }
}

/// The attitude turned by what takes one attitude to another.
fn turned_with(attitude: &Attitude, then: &Attitude, now: &Attitude) -> Option<Attitude> {
    let turned = |v: &Vec3| now.to_sky(&then.to_camera(v));
    Attitude::from_boresight_up(&turned(&attitude.boresight()), &turned(&attitude.up()))
}

/// Where the flight computer thinks that the camera looks, up being the zenith, so that it turns as a gondola does; `None` where it did
/// not say, or the zenith is not known.
fn estimated(sent: &Prior) -> Option<Attitude> {
    let observer = sent.observer?;
    let horizontal = sent.horizontal.map(|(az, el)| observer.direction_of(az, el));
    let boresight = horizontal.or_else(|| sent.equatorial.map(|(ra, dec)| direction(ra, dec)))?;
    Attitude::from_boresight_up(&boresight, &observer.direction_of(0.0, 0.5 * PI))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Stamp;
    use crate::settings::Settings;
    use crate::sky::{ARCSEC, Mat3, Observer, horizontal_of};
    use crate::solve::{Reason, Solution};

    const S: fn(u64) -> Duration = Duration::from_secs;

    fn settings() -> TrackingSettings {
        Settings::flight().unwrap().solver.tracking
    }

    fn solved(attitude: Attitude, prior: Prior) -> Outcome {
        let solution = Solution {
            attitude,
            platescale: 9.5 * ARCSEC,
            k1: 1e-3,
            axis: (0.0, 0.0),
            covariance: Mat3::from_diagonal(&Vec3::new(1.0, 2.0, 40.0).map(|s| (s * ARCSEC) * (s * ARCSEC))),
            sigma_platescale: 1e-3 * ARCSEC,
            rms_px: 0.1,
            chi2_per_dof: 1.0,
            matches: Vec::new(),
            false_probability_log10: -20.0,
            horizontal: None,
            epoch_yr: None,
            start: None,
            served: None,
        };
        let found_by = Some(FoundBy::LostInSpace);
        Outcome { solution: Some(solution), prior, found_by, ..Outcome::unsolved(Stamp::default(), Reason::Solved, "") }
    }

    #[test]
    fn the_last_solution_is_believed_less_with_time_and_then_not_at_all() {
        let settings = settings();
        let mut tracker = Tracker::default();
        assert_eq!(tracker.prior(S(5), Prior::default(), &settings), Prior::default());
        let attitude = Attitude::from_angles(1.0, 0.5, 2.0);
        tracker.learn(S(10), &solved(attitude, Prior::default()), &settings);
        let at = |s| tracker.prior(S(s), Prior::default(), &settings);
        let prior = at(10).attitude.unwrap();
        assert!((prior.sigma / ARCSEC - 2.0).abs() < 1e-9 && (prior.sigma_roll / ARCSEC - 40.0).abs() < 1e-9);
        let later = at(30).attitude.unwrap();
        assert_eq!(later.attitude, attitude);
        assert!((later.sigma / DEG - 20.0 * settings.drift_deg_s).abs() < 1e-3);
        assert!(at(10 + settings.max_age_s as u64).attitude.is_some());
        let too_old = at(11 + settings.max_age_s as u64);
        assert!(too_old.attitude.is_none() && too_old.lens.is_some_and(|lens| lens.platescale == 9.5 * ARCSEC));
        assert!(at(9).attitude.is_none(), "of a frame from before nothing is known");
        assert_eq!(tracker.prior(S(10), Prior::default(), &TrackingSettings { enabled: false, ..settings }), Prior::default());
    }

    #[test]
    fn an_unsolved_frame_teaches_nothing() {
        let settings = settings();
        let mut tracker = Tracker::default();
        tracker.learn(S(1), &Outcome::unsolved(Stamp::default(), Reason::NoMatch, ""), &settings);
        assert_eq!(tracker, Tracker::default());
    }

    #[test]
    fn the_attitude_follows_a_flight_computer_that_is_off_by_the_same_all_the_time() {
        let settings = settings();
        let observer = Observer { latitude: -77.0 * DEG, sidereal_time: 1.0 };
        // The gondola turns by 25° in azimuth while the sky turns too; the flight computer is off by a degree.
        let attitude_at = |observer: &Observer, az: f64| {
            let boresight = observer.direction_of(az, 40.0 * DEG);
            Attitude::from_boresight_up(&boresight, &observer.direction_of(0.0, 0.5 * PI)).unwrap()
        };
        let sent = |observer: Observer, az: f64| Prior {
            horizontal: Some((az + 1.0 * DEG, 40.0 * DEG)),
            observer: Some(observer),
            ..Prior::default()
        };
        let later = observer.after(100.0);
        let mut tracker = Tracker::default();
        tracker.learn(S(0), &solved(attitude_at(&observer, 1.0), sent(observer, 1.0)), &settings);
        let az = 1.0 + 25.0 * DEG;
        let prior = tracker.prior(S(100), sent(later, az), &settings).attitude.unwrap();
        let truth = attitude_at(&later, az);
        assert!(separation(&prior.attitude.boresight(), &truth.boresight()) < 1e-9);
        assert!((horizontal_of(&prior.attitude, &later, None).roll).abs() < 1e-9);
        assert!((prior.sigma / DEG - settings.estimate_sigma_deg - 100.0 * settings.estimate_drift_deg_s).abs() < 1e-3);
        // Without an estimate now, it may be anywhere near where it was.
        let blind = tracker.prior(S(100), Prior::default(), &settings).attitude.unwrap();
        assert!(blind.sigma > prior.sigma);
    }

    #[test]
    fn a_region_knows_how_far_off_an_attitude_is() {
        let attitude = Attitude::from_angles(1.0, 0.5, 2.0);
        let prior = Prior { attitude: Some(AttitudePrior { attitude, sigma: 0.01, sigma_roll: 0.02 }), ..Prior::default() };
        let region = Region::of(&prior, &[]).unwrap();
        let (off, roll) = region.distance(&attitude.turned(&Vec3::new(0.003, 0.004, 0.0)));
        assert!((off - 0.005).abs() < 1e-6 && roll < 1e-4);
        let (off, roll) = region.distance(&attitude.turned(&Vec3::new(0.0, 0.0, -0.03)));
        assert!(off < 1e-9 && (roll - 0.03).abs() < 1e-4);
        assert_eq!((region.boresight.reach(), region.roll.reach()), (0.04, 0.08));
        let mad = |sigma| Prior { attitude: Some(AttitudePrior { attitude, sigma, sigma_roll: 0.02 }), ..Prior::default() };
        assert!([f64::NAN, 0.0, f64::INFINITY].into_iter().all(|sigma| Region::of(&mad(sigma), &[]).is_none()));
    }

    #[test]
    fn a_circle_alone_leaves_the_roll_open() {
        let circle = |radius| Circle { name: "x", centre: Vec3::z(), radius };
        let region = Region::of(&Prior::default(), &[circle(0.2), circle(0.1)]).unwrap();
        assert_eq!((region.boresight, region.roll), (Spread::Within(0.1), Spread::Within(PI)));
        assert!(Region::of(&Prior::default(), &[]).is_none());
    }

    #[test]
    fn an_even_spread_is_as_wide_as_it_reaches() {
        let (sigma, reach) = (Spread::Sigma(0.01), Spread::Within(0.04));
        assert!((reach.area_at(0.0) / (PI * 0.04 * 0.04) - 1.0).abs() < 1e-3 && reach.width_at(0.03) == 0.08);
        // In the middle a Gaussian is denser, at its reach thinner, than what is spread evenly as far.
        assert!(sigma.area_at(0.0) < reach.area_at(0.0) && sigma.area_at(0.04) > reach.area_at(0.04));
        assert!(sigma.width_at(0.0) < reach.width_at(0.0) && sigma.width_at(0.04) > reach.width_at(0.04));
    }
}
