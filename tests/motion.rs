//! Series of trailed exposures: solved along the trails that the gyros tell, and not by gyros that the exposures contradict.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

#[path = "shared/dim.rs"]
mod dim;
mod shared;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use shared::solver_with;
use stars::camera::{Ask, Moment, SimulatedSky};
use stars::catalog::Catalogue;
use stars::image::{Frame, ImageCounter, Series, coadd};
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

fn solve(sum: &Frame, exposures: Vec<Arc<Frame>>, motion: Motion) -> Outcome {
    solver_with(|_| ()).solve_moved(sum, &Moved { exposures, motion: Arc::new(motion) }, &Prior::default(), &Unwatched)
}

#[test]
fn a_trailed_series_is_solved_along_its_trails_at_the_middle_of_its_light() {
    let (sky, series, motion) = series(40);
    let outcome = solve(&series.sum().unwrap(), series.into_exposures(), motion);
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
    let outcome = solve(&coadd(&exposures).unwrap(), exposures, motion);
    assert_ne!(outcome.mode, SearchMode::Motion, "{:?} {}", outcome.reason, outcome.detail);
}

#[test]
fn what_a_few_sources_leave_in_doubt_the_light_of_stars_too_faint_to_be_sources_decides() {
    /// log₁₀ of what the sources of this one alone come to: the probability up to which it would be chance.
    const BY_SOURCES: f64 = -3.5;
    /// And of the light of the others, at the least.
    const BY_LIGHT: f64 = -5.0;
    let drawn = dim::draw(&Catalogue::embedded().unwrap(), 7, 156, 4.0);
    assert_eq!((drawn.stars, drawn.truth.exposures.len()), (9, 1), "few stars in a single exposure");
    let outcome = solve(&drawn.sum, drawn.exposures, drawn.measured);
    assert_eq!((outcome.reason, outcome.mode), (Reason::Solved, SearchMode::Motion), "{}", outcome.detail);
    let solution = outcome.solution.unwrap();
    assert!(solution.false_probability_log10 < BY_SOURCES + BY_LIGHT, "{}", solution.false_probability_log10);
    let judged = Judged::new(&PointingReport::new(&solution), &drawn.middle).unwrap();
    assert!(judged.error < 3.0 * judged.sigma, "{judged:?}");
}
