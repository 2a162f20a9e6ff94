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
use stars::solve::{Cause, Exposures, Motion, Outcome, PointingReport, Prior, Reason, SearchMode, Unwatched};
use std::sync::Arc;
use std::time::Duration;

/// Noise of the gyros, rad/s/√Hz.
const NOISE: f64 = 4.0 * ARCSEC;

/// A series of four exposures of a scanning gondola, its motion as gyros measured it, and the camera that saw it.
fn series(seconds: u64) -> (SimulatedSky, Series, Motion) {
    series_of(4, 1000 * seconds)
}

fn series_of(exposures: u8, millis: u64) -> (SimulatedSky, Series, Motion) {
    series_by(&Settings::flight().unwrap(), exposures, millis)
}

fn series_by(settings: &Settings, exposures: u8, millis: u64) -> (SimulatedSky, Series, Motion) {
    let mut sky = SimulatedSky::new(settings, Arc::new(Catalogue::embedded().unwrap())).unwrap();
    let moment = Moment {
        image: ImageCounter(3),
        uptime: Duration::from_millis(millis),
        utc: None,
        quality: ClockQuality::Unset,
        sigma_s: None,
        ask: Ask::Expose,
    };
    let (series, motion) = sky.series(&moment, exposures).unwrap();
    (sky, series, measured(&motion, NOISE, &mut ChaCha8Rng::seed_from_u64(millis)))
}

fn solve(sum: &Frame, exposures: Vec<Arc<Frame>>, motion: Motion) -> Outcome {
    solver_with(|_| ()).solve_series(sum, &Exposures { exposures, motion: Some(Arc::new(motion)) }, &Prior::default(), &Unwatched)
}

#[test]
fn a_trailed_series_is_solved_along_its_trails_at_the_middle_of_its_light() {
    let (sky, series, motion) = series(40);
    let (sum, exposures) = series.into_sum();
    let outcome = solve(&sum.unwrap(), exposures, motion);
    assert_eq!((outcome.reason, outcome.mode), (Reason::Solved, SearchMode::Motion), "{}", outcome.detail);
    let solution = outcome.solution.unwrap();
    let judged = Judged::new(&PointingReport::new(&solution), &sky.truth().unwrap().attitude.unwrap()).unwrap();
    assert!(judged.is_covered() && judged.sigma < 2.0, "{judged:?}");
    let start = solution.start.unwrap();
    assert!((start.before_middle_s - 0.525).abs() < 1e-3, "{} s", start.before_middle_s);
    // The sky turns by 7″ from the start to the middle.
    let middle = Duration::from_secs_f64(40.0 + start.before_middle_s);
    let horizontal = solution.horizontal.unwrap();
    let off = (horizontal.pointing.azimuth - sky.gondola().azimuth(middle)).sin() * horizontal.pointing.elevation.cos();
    assert!(off.abs() < 3.0 * horizontal.sigma.0, "{}″ along azimuth, σ {}″", off / ARCSEC, horizontal.sigma.0 / ARCSEC);
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

/// Of a series of so many exposures, when a scanning gondola turns round: whether its sum alone is solved wrongly, and how it ends where its
/// exposures are known, and no motion.
fn of_unknown_motion(exposures: u8, millis: u64) -> (bool, Outcome) {
    let (sky, series, _) = series_of(exposures, millis);
    let truth = sky.truth().unwrap().attitude.unwrap();
    let wrong = |outcome: &Outcome| {
        let pointing = outcome.solution.as_ref().map(PointingReport::new);
        pointing.is_some_and(|pointing| Judged::new(&pointing, &truth).unwrap().is_wrong())
    };
    let (sum, exposures) = series.into_sum();
    let (sum, mut solver) = (sum.unwrap(), solver_with(|_| ()));
    let alone = solver.solve(&sum, &Prior::default(), &Unwatched);
    let series = solver.solve_series(&sum, &Exposures { exposures, motion: None }, &Prior::default(), &Unwatched);
    assert!(!wrong(&series), "{millis} ms: {:?}", series.solution);
    (wrong(&alone), series)
}

#[test]
fn the_stars_of_one_exposure_are_not_taken_for_those_of_a_series_that_moved() {
    for millis in [133_294, 399_602, 932_938] {
        let (sum_is_wrong, outcome) = of_unknown_motion(4, millis);
        assert!(sum_is_wrong, "at {millis} ms there is nothing to be seen here");
        assert_eq!((outcome.reason, outcome.cause), (Reason::Requirement, Some(Cause::Trailed)));
        assert!(outcome.detail.starts_with("series: stars are not seen to shine in exposure 1 of 4"), "{}", outcome.detail);
        assert!(outcome.candidate.is_some());
    }
}

#[test]
fn a_series_that_stood_still_needs_no_motion() {
    // There and back: both exposures see the same sky.
    let (_, outcome) = of_unknown_motion(2, 133_174);
    assert_eq!(outcome.reason, Reason::Solved, "{}", outcome.detail);
    // And one that does not scan.
    let mut settings = Settings::flight().unwrap();
    settings.simulate.scan_amplitude_deg = 0.0;
    let (_, series, _) = series_by(&settings, 4, 7000);
    let (sum, exposures) = series.into_sum();
    let still = Exposures { exposures, motion: None };
    let outcome = solver_with(|_| ()).solve_series(&sum.unwrap(), &still, &Prior::default(), &Unwatched);
    assert_eq!(outcome.reason, Reason::Solved, "{}", outcome.detail);
}
