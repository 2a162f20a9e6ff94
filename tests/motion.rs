//! Series of trailed exposures: solved along the trails that the gyros tell, and not by gyros that the exposures contradict.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod shared;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use shared::solver_with;
use stars::camera::{Ask, Moment, SimulatedSky};
use stars::catalog::Catalogue;
use stars::image::{Frame, ImageCounter, Series};
use stars::settings::Settings;
use stars::simulate::{Judged, measured};
use stars::sky::{ARCSEC, ClockQuality};
use stars::solve::{Motion, Moved, Outcome, PointingReport, Prior, Reason, SearchMode, Unwatched};
use std::sync::Arc;
use std::time::Duration;

/// Noise of the gyros, rad/s/√Hz.
const NOISE: f64 = 4.0 * ARCSEC;

/// A series of four exposures of a scanning gondola, its motion as gyros measured it, and the camera that saw it.
fn series(seconds: u64) -> (SimulatedSky, Series, Motion) {
    let mut sky = SimulatedSky::new(&Settings::flight().unwrap(), Arc::new(Catalogue::embedded().unwrap())).unwrap();
    let moment = Moment {
        image: ImageCounter(3),
        uptime: Duration::from_secs(seconds),
        utc: None,
        quality: ClockQuality::Unset,
        sigma_s: None,
        ask: Ask::Expose,
    };
    let (series, motion) = sky.series(&moment, 4).unwrap();
    (sky, series, measured(&motion, NOISE, &mut ChaCha8Rng::seed_from_u64(seconds)))
}

fn solve(exposures: Vec<Arc<Frame>>, motion: Motion) -> Outcome {
    let frames: Vec<Frame> = exposures.iter().map(|exposure| Frame::clone(exposure)).collect();
    let sum = Series::new(frames).unwrap().sum().unwrap();
    solver_with(|_| ()).solve_moved(&sum, &Moved { exposures, motion: Arc::new(motion) }, &Prior::default(), &Unwatched)
}

#[test]
fn a_trailed_series_is_solved_along_its_trails_at_the_middle_of_its_light() {
    let (sky, series, motion) = series(40);
    let outcome = solve(series.into_exposures(), motion);
    assert_eq!((outcome.reason, outcome.mode), (Reason::Solved, SearchMode::Motion), "{}", outcome.detail);
    let solution = outcome.solution.unwrap();
    let judged = Judged::new(&PointingReport::new(&solution), &sky.truth().unwrap().attitude.unwrap()).unwrap();
    assert!(judged.is_covered() && judged.sigma < 2.0, "{judged:?}");
    let start = solution.start.unwrap();
    assert!((start.before_middle_s - 0.525).abs() < 1e-3, "{} s", start.before_middle_s);
}

#[test]
fn rates_that_put_stars_into_an_exposure_which_has_none_are_not_used() {
    let (_, series, motion) = series(40);
    let mut exposures = series.into_exposures();
    // A cloud came before the last but one.
    let third = Arc::make_mut(&mut exposures[2]);
    let mut sorted = third.pixels.clone();
    sorted.sort_unstable();
    let sky = sorted[sorted.len() / 2];
    third.pixels.iter_mut().for_each(|adu| *adu = (*adu).min(sky + 12));
    let outcome = solve(exposures, motion);
    assert_ne!(outcome.mode, SearchMode::Motion, "{:?} {}", outcome.reason, outcome.detail);
}
