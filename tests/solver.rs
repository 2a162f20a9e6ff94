//! The solver, whole: real images, rendered frames, and every reason for which a frame is not solved.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod shared;

use shared::solver_with;
use stars::image::{self, Frame};
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, Rendered, render};
use stars::sky::{ARCSEC, Attitude, DEG, HOUR, Observer, RowOrder, separation};
use stars::solve::{Cause, Outcome, Prior, Reason, SearchMode, Solver, Stop, Unwatched, Watch};
use std::path::PathBuf;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

fn solver() -> Solver {
    solver_with(|_| ())
}

fn rendered(kind: Kind, index: u64) -> Rendered {
    render(&RenderSpec::new(kind, 77, index), solver().catalogue()).unwrap()
}

/// A clear frame whose attitude is known; rendered once.
fn clear() -> &'static (Frame, Attitude) {
    static CLEAR: OnceLock<(Frame, Attitude)> = OnceLock::new();
    CLEAR.get_or_init(|| {
        let rendered = rendered(Kind::Night, 0);
        (rendered.frame, rendered.truth.attitude.unwrap())
    })
}

fn solve(solver: &mut Solver, frame: &Frame) -> Outcome {
    solver.solve(frame, &Prior::default(), &Unwatched)
}

/// The directory of the real images; `None`, said aloud, where there is none.
fn real_images(test: &str) -> Option<PathBuf> {
    let at = std::env::var_os("STARS_REAL_IMAGES")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    if !at.join("truth.json").is_file() {
        println!("SKIPPED: {test}: no real images at {}", at.display());
        return None;
    }
    Some(at)
}

/// Solves the real images whose path begins so and compares with their truth: image, distance in arcsec, matched.
fn against_truth(at: &std::path::Path, folder: &str, solver: &mut Solver) -> Vec<(String, f64, usize)> {
    let truth: serde_json::Value = serde_json::from_slice(&std::fs::read(at.join("truth.json")).unwrap()).unwrap();
    let images = truth["images"].as_array().unwrap().iter();
    images
        .filter(|i| i["file"].as_str().unwrap().starts_with(folder))
        .map(|i| {
            let file = i["file"].as_str().unwrap();
            let frame = image::read(file, &std::fs::read(at.join(file)).unwrap()).unwrap();
            let outcome = solve(solver, &frame);
            let solution = outcome.solution.unwrap_or_else(|| panic!("{file}: {} {}", outcome.reason, outcome.detail));
            let angle = |key: &str| i[key].as_f64().unwrap() * DEG;
            let expected = Attitude::from_angles(angle("ra_deg"), angle("dec_deg"), angle("roll_deg"));
            let distance = separation(&expected.boresight(), &solution.attitude.boresight()) / ARCSEC;
            assert!(separation(&expected.up(), &solution.attitude.up()) < 60.0 * ARCSEC, "{file}: roll");
            (file.to_owned(), distance, solution.matches.len())
        })
        .collect()
}

#[test]
fn real_images_of_the_flight_are_solved_lost_in_space() {
    let Some(at) = real_images("real_images_of_the_flight_are_solved_lost_in_space") else { return };
    for (file, distance, matched) in against_truth(&at, "flight", &mut solver_with(|s| s.solver.robust = false)) {
        let limit = if file.contains("2012") { 4.0 } else { 1.5 };
        assert!(distance < limit && matched >= 12, "{file}: {distance:.2}″, {matched} matched");
    }
}

#[test]
fn real_images_of_a_wide_field_are_solved_with_the_same_catalogue() {
    let Some(at) = real_images("real_images_of_a_wide_field_are_solved_with_the_same_catalogue") else { return };
    let mut wide = solver_with(|s| {
        s.solver.matching.platescale_min_arcsec_px = 40.33 * 0.95;
        s.solver.matching.platescale_max_arcsec_px = 40.33 * 1.05;
    });
    for (file, distance, matched) in against_truth(&at, "esa", &mut wide) {
        assert!(distance < 8.0 && matched >= 20, "{file}: {distance:.2}″, {matched} matched");
    }
}

#[test]
fn rendered_frames_point_where_they_were_rendered() {
    let mut solver = solver();
    for kind in [Kind::Night, Kind::Float, Kind::HotPix, Kind::Dense] {
        for index in 1..3 {
            let Rendered { frame, truth } = rendered(kind, index);
            let outcome = solve(&mut solver, &frame);
            let solution = outcome.solution.unwrap_or_else(|| panic!("{kind} {index}: {} {}", outcome.reason, outcome.detail));
            let distance = separation(&truth.attitude.unwrap().boresight(), &solution.attitude.boresight());
            assert!(distance < 5.0 * ARCSEC, "{kind} {index}: {:.2}″", distance / ARCSEC);
            assert!((solution.platescale / truth.platescale - 1.0).abs() < 1e-3, "{kind} {index}");
            assert!(solution.false_probability_log10 < -5.6);
        }
    }
}

#[test]
fn a_faint_trail_in_two_pieces_of_which_one_does_not_show_is_not_served_as_the_whole() {
    let mut solver = solver_with(|s| {
        (s.solver.matching.platescale_min_arcsec_px, s.solver.matching.platescale_max_arcsec_px) = (9.2, 9.7);
    });
    let spec = RenderSpec::new(Kind::Motion, 11, 93);
    let Rendered { frame, truth } = render(&spec, solver.catalogue()).unwrap();
    let outcome = solve(&mut solver, &frame);
    // Its brightest piece alone is a good match, 68″ from the middle of the path.
    let Some(solution) = &outcome.solution else {
        assert_eq!(outcome.cause, Some(Cause::Trailed), "{}", outcome.detail);
        return;
    };
    let off = separation(&truth.attitude.unwrap().boresight(), &solution.attitude.boresight());
    let sigma = ((solution.covariance[(0, 0)] + solution.covariance[(1, 1)]) / 2.0).sqrt();
    println!("{:.1}″ off, σ {:.1}″", off / ARCSEC, sigma / ARCSEC);
    assert!(off < 6.0 * sigma, "{:.1}″ off, σ {:.1}″", off / ARCSEC, sigma / ARCSEC);
}

#[test]
fn the_same_frame_gives_the_same_outcome_whatever_came_before_it() {
    let (frame, _) = clear();
    let mut fresh = solver();
    let mut used = solver();
    solve(&mut used, &rendered(Kind::HotPix, 3).frame);
    assert_eq!(solve(&mut fresh, frame), solve(&mut used, frame));
}

#[test]
fn a_mirrored_sky_and_a_sky_without_stars_are_not_solved() {
    let mut mirrored = solver_with(|s| s.camera.mirrored = true);
    assert!(solve(&mut mirrored, &clear().0).solution.is_none());
    let outcome = solve(&mut solver(), &rendered(Kind::NoStars, 0).frame);
    assert!(outcome.solution.is_none());
    assert!(matches!(outcome.reason, Reason::NoMatch | Reason::Undecided | Reason::TooFewSources), "{}", outcome.reason);
}

#[test]
fn flat_and_full_frames_say_so() {
    let mut solver = solver();
    for (value, reason) in [(0, Reason::NoContrast), (1000, Reason::NoContrast), (u16::MAX, Reason::TooBright)] {
        let frame = Frame::new(320, 256, vec![value; 320 * 256], RowOrder::BottomFirst).unwrap();
        assert_eq!(solve(&mut solver, &frame).reason, reason, "{value}");
    }
}

#[test]
fn tiny_and_thin_frames_end_in_an_outcome() {
    let mut solver = solver();
    for (w, h) in [(1, 1), (3, 5000), (5000, 3), (17, 17), (64, 40)] {
        let pixels = (0..w * h).map(|i| 1000 + (i * 7919 % 13) as u16).collect();
        let frame = Frame::new(w, h, pixels, RowOrder::TopFirst).unwrap();
        assert!(solve(&mut solver, &frame).solution.is_none());
    }
}

#[test]
fn a_solver_that_is_switched_off_says_so() {
    assert_eq!(solve(&mut solver_with(|s| s.solver.enabled = false), &clear().0).reason, Reason::Disabled);
    let outcome = solve(&mut solver_with(|s| s.solver.matching.enabled = false), &clear().0);
    assert_eq!(outcome.reason, Reason::Disabled);
    assert!(!outcome.sources.is_empty(), "sources are still found");
}

/// A watch that says stop after being asked so many times.
struct StopAfter(AtomicUsize, Stop);

impl Watch for StopAfter {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }
    fn stop(&self) -> Option<Stop> {
        let asked = self.0.load(Ordering::Relaxed).saturating_sub(1);
        self.0.store(asked, Ordering::Relaxed);
        (asked == 0).then_some(self.1)
    }
}

#[test]
fn a_stop_is_obeyed_at_whatever_point_it_comes() {
    let mut solver = solver();
    let frame = rendered(Kind::NoStars, 1).frame;
    let patient = StopAfter(AtomicUsize::new(usize::MAX), Stop::TimedOut);
    assert_eq!(solver.solve(&frame, &Prior::default(), &patient).reason, Reason::NoMatch);
    let asked_in_all = usize::MAX - patient.0.load(Ordering::Relaxed);
    assert!(asked_in_all > 20, "it asks in every stage, and in the long ones often: {asked_in_all}");
    let obeyed = |asked: usize| {
        let watch = StopAfter(AtomicUsize::new(asked), Stop::TimedOut);
        solver.solve(&frame, &Prior::default(), &watch).reason == Reason::TimedOut
    };
    let obeyed: Vec<bool> = (1..=asked_in_all).map(obeyed).collect();
    // Once every pattern was tried the outcome stands, and only the search for its cause ends: there are no two ways about it.
    let tried = obeyed.iter().position(|obeyed| !obeyed).unwrap_or(asked_in_all);
    assert!(obeyed.iter().skip(tried).all(|obeyed| !obeyed), "{obeyed:?}");
    assert!(tried * 4 > asked_in_all * 3, "a stop is obeyed at {tried} of {asked_in_all} points");
    let watch = StopAfter(AtomicUsize::new(5), Stop::Aborted);
    assert_eq!(solver.solve(&frame, &Prior::default(), &watch).reason, Reason::Aborted);
}

#[test]
fn sharp_stars_that_a_wide_kernel_finds_are_measured_in_the_picture_itself() {
    let mut solver = solver();
    for index in 0..3 {
        let frame = rendered(Kind::Float, index).frame;
        let [normal, wide] = [solve(&mut solver, &frame), solver.solve_robust(&frame, &Prior::default(), &Unwatched)];
        let sigma = |outcome: &Outcome| outcome.solution.as_ref().unwrap().covariance.diagonal().map(f64::sqrt);
        // In a picture halved once a star's middle is less well known, and by so much are the middle and the turn of the field.
        let times = sigma(&wide).component_div(&sigma(&normal));
        assert!(times.iter().all(|times| *times < 1.2), "{index}: {times}");
    }
}

#[test]
fn a_fit_that_is_too_poor_is_made_again_by_the_sources_of_another_search() {
    // Discs whose pieces the normal search takes for stars: enough to know them by, not to tell the boresight well.
    let Rendered { frame, truth, .. } = render(&RenderSpec::new(Kind::Defocus, 20261, 104), solver().catalogue()).unwrap();
    let with = |robust: bool| solve(&mut solver_with(|s| s.solver.robust = robust), &frame);
    let poor = with(false);
    assert!(poor.reason == Reason::Requirement && poor.detail.starts_with("pointing_error"), "{} {}", poor.reason, poor.detail);
    let solution = with(true).solution.unwrap();
    let error = separation(&solution.attitude.boresight(), &truth.attitude.unwrap().boresight());
    assert!(error < 3.0 * solution.sigmas().x.hypot(solution.sigmas().y), "{}″", error / ARCSEC);
}

#[test]
fn two_threads_end_as_one_does_and_obey_a_stop() {
    let (mut one, mut two) = (solver(), solver_with(|s| s.solver.threads = 2));
    let kinds = [Kind::Float, Kind::Gradient, Kind::Defocus30, Kind::Motion, Kind::Motion, Kind::Saturated, Kind::NoStars];
    let (mut normal, mut robust, mut unsolved) = (0, 0, 0);
    for (index, kind) in kinds.into_iter().enumerate() {
        let frame = rendered(kind, index as u64).frame;
        let outcomes = [&mut one, &mut two].map(|solver| {
            let mut outcome = solve(solver, &frame);
            outcome.times = Default::default();
            outcome
        });
        match (&outcomes[0].solution, outcomes[0].mode) {
            (None, _) => unsolved += 1,
            (_, SearchMode::Normal) => normal += 1,
            (_, SearchMode::Robust) => robust += 1,
            (_, SearchMode::Motion) => unreachable!("nothing is known of its motion"),
        }
        assert_eq!(format!("{:?}", outcomes[0]), format!("{:?}", outcomes[1]), "{kind:?}");
    }
    assert!(normal > 0 && robust > 0 && unsolved > 0, "{normal} {robust} {unsolved}");
    let watch = StopAfter(AtomicUsize::new(5), Stop::Aborted);
    assert_eq!(two.solve(&rendered(Kind::NoStars, 1).frame, &Prior::default(), &watch).reason, Reason::Aborted);
}

#[test]
fn a_wrong_prior_costs_no_solution_unless_it_may_veto() {
    let (frame, truth) = clear();
    let (ra, dec, _) = truth.angles();
    let limit = |s: &mut Settings| {
        s.solver.requirements.equatorial_location.enabled = true;
        s.solver.requirements.equatorial_location.radius_deg = 5.0;
    };
    let at = |offset: f64| Prior { equatorial: Some((ra, dec + offset * DEG * -dec.signum())), ..Prior::default() };
    let mut lenient = solver_with(limit);
    let right = lenient.solve(frame, &at(4.99), &Unwatched);
    assert_eq!((right.reason, right.cause, right.prior_disagreement), (Reason::Solved, None, None));
    let wrong = lenient.solve(frame, &at(5.01), &Unwatched);
    assert_eq!((wrong.reason, wrong.cause), (Reason::Solved, Some(Cause::WrongPrior)));
    assert!((wrong.prior_disagreement.unwrap() / DEG - 5.01).abs() < 0.01);
    let mut strict = solver_with(|s| {
        limit(s);
        s.solver.prior_veto = true;
    });
    assert_eq!(strict.solve(frame, &at(4.99), &Unwatched).reason, Reason::Solved);
    assert!(strict.solve(frame, &at(5.01), &Unwatched).solution.is_none());
}

/// Solves the clear frame with a change of the settings and an observer; the outcome's reason and detail.
fn with_requirement(change: impl FnOnce(&mut Settings), observer: Option<Observer>) -> (Reason, String) {
    let prior = Prior { observer, ..Prior::default() };
    let outcome = solver_with(change).solve(&clear().0, &prior, &Unwatched);
    (outcome.reason, outcome.detail)
}

#[test]
fn every_requirement_refuses_by_its_name_just_beyond_its_limit() {
    let (frame, _) = clear();
    let observer = Observer { latitude: -77.0 * DEG, sidereal_time: 8.0 * HOUR };
    let prior = Prior { observer: Some(observer), ..Prior::default() };
    let solution = solver().solve(frame, &prior, &Unwatched).solution.unwrap();
    let (_, _, roll) = solution.attitude.angles();
    let horizontal = solution.horizontal.unwrap().pointing;
    let sigmas = solution.sigmas() / ARCSEC;
    let error = 0.5 * (sigmas.x + sigmas.y);
    let matched = solution.matches.len() as u32;
    let platescale = solution.platescale / ARCSEC;
    /// A margin that no rounding reaches, in the unit of each.
    const M: f64 = 1e-6;
    type Change = Box<dyn Fn(&mut Settings, f64)>;
    let range = |pick: fn(&mut Settings) -> &mut stars::settings::AngleRange, angle: f64| -> Change {
        Box::new(move |s, beyond| {
            let range = pick(s);
            range.enabled = true;
            range.min_deg = angle / DEG + beyond;
            range.max_deg = angle / DEG + 10.0;
        })
    };
    let cases: Vec<(&str, Change)> = vec![
        ("equatorial_roll", range(|s| &mut s.solver.requirements.equatorial_roll, roll)),
        ("horizontal_roll", range(|s| &mut s.solver.requirements.horizontal_roll, horizontal.roll)),
        ("elevation", range(|s| &mut s.solver.requirements.elevation, horizontal.elevation)),
        ("pointing_error", Box::new(move |s, beyond| s.solver.requirements.pointing_error_max_arcsec = error - beyond)),
        ("fit_error", Box::new(move |s, beyond| s.solver.requirements.fit_error_max_px = solution.rms_px - beyond)),
    ];
    for (name, change) in &cases {
        assert_eq!(with_requirement(|s| change(s, -M), Some(observer)).0, Reason::Solved, "{name} inside");
        // One search alone: another one's fit may be the better by more than the margin.
        let alone = |s: &mut Settings| {
            s.solver.robust = false;
            change(s, M);
        };
        let (reason, detail) = with_requirement(alone, Some(observer));
        assert_eq!(reason, Reason::Requirement, "{name} outside");
        assert!(detail.starts_with(name), "{detail}");
    }
    for name in ["horizontal_roll", "elevation"] {
        let (_, change) = cases.iter().find(|(n, _)| n == &name).unwrap();
        assert_eq!(with_requirement(|s| change(s, M), None).0, Reason::Solved, "{name} is skipped without an observer");
    }
    let fewest = |n: u32| with_requirement(|s| s.solver.matching.min_matched = n, None).0;
    assert_eq!(fewest(5.min(matched)), Reason::Solved);
    assert_ne!(fewest(matched + 1), Reason::Solved, "min_matched");
    assert!((9.2..=9.7).contains(&platescale));
}
