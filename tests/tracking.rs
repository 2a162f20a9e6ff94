//! What a prior does: fewer stars are enough with a good one, and a wrong one does no harm.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod shared;

use shared::solver_with;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, Rendered, render};
use stars::sky::{ARCSEC, Attitude, DEG, Vec3, separation};
use stars::solve::{
    AttitudePrior, FoundBy, FrameGeometry, LensPrior, NearRules, NearSearch, Outcome, PatternSource, Pose, Prior, Reason, Region,
    SearchEnd, Solver, Tracker, Unwatched,
};
use std::sync::Arc;
use std::time::Duration;

fn solver() -> Solver {
    solver_with(|_| ())
}

fn frame(kind: Kind, index: u64) -> Rendered {
    let catalogue = solver().catalogue().clone();
    render(&RenderSpec::new(kind, 3, index), &catalogue).unwrap()
}

/// What is known beforehand: the truth, turned by some degrees about left, up and boresight.
fn prior(rendered: &Rendered, off_deg: [f64; 3]) -> Prior {
    let attitude = rendered.truth.attitude.unwrap();
    let tilted = attitude.turned(&Vec3::new(off_deg[0] * DEG, off_deg[1] * DEG, 0.0));
    let (sin, cos) = (off_deg[2] * DEG).sin_cos();
    let attitude = Attitude::from_boresight_up(&tilted.boresight(), &(tilted.up() * cos + tilted.left() * sin)).unwrap();
    Prior {
        attitude: Some(AttitudePrior { attitude, sigma: 0.1 * DEG, sigma_roll: 0.5 * DEG }),
        lens: Some(LensPrior {
            platescale: rendered.truth.platescale * 1.0003,
            sigma_ln: 5e-4,
            k1: rendered.truth.k1,
            sigma_k1: 2e-4,
        }),
        ..Prior::default()
    }
}

fn is_right(outcome: &Outcome, rendered: &Rendered) -> bool {
    let solution = outcome.solution.as_ref().unwrap();
    let sigmas = solution.sigmas();
    let off = separation(&solution.attitude.boresight(), &rendered.truth.attitude.unwrap().boresight());
    off <= (5.0 * ARCSEC).max(6.0 * sigmas.x.hypot(sigmas.y) / 2f64.sqrt())
}

#[test]
fn frames_with_few_stars_are_solved_with_a_prior_and_none_wrongly_with_a_wrong_one() {
    let mut solver = solver();
    let (mut alone, mut tracked, mut of_three_or_four) = (0, 0, 0);
    const FRAMES: u64 = 8;
    for index in 0..FRAMES {
        let rendered = frame(Kind::Faint, index);
        assert!((3..=6).contains(&rendered.truth.stars_over_snr5));
        let outcome = solver.solve(&rendered.frame, &Prior::default(), &Unwatched);
        alone += u32::from(outcome.reason == Reason::Solved);
        let outcome = solver.solve(&rendered.frame, &prior(&rendered, [0.08, -0.1, 0.4]), &Unwatched);
        if let Some(solution) = &outcome.solution {
            assert!(is_right(&outcome, &rendered), "frame {index}");
            assert!(solution.false_probability_log10 <= -5.6 && solution.matches.len() >= 3);
            tracked += u32::from(outcome.found_by == Some(FoundBy::Tracked));
            of_three_or_four += u32::from(rendered.truth.stars_over_snr5 < 5);
        }
        for wrong in [[5.0, 0.0, 0.0], [-1.0, 2.0, 0.0], [0.0, 0.0, 20.0], [0.0, 0.0, 180.0]] {
            let outcome = solver.solve(&rendered.frame, &prior(&rendered, wrong), &Unwatched);
            assert!(
                outcome.solution.is_none() || (outcome.found_by == Some(FoundBy::LostInSpace) && is_right(&outcome, &rendered))
            );
        }
        let mut mirrored = Settings::flight().unwrap();
        mirrored.camera.mirrored = true;
        let flight = solver.settings().clone();
        solver.set_settings(Arc::new(mirrored));
        assert!(solver.solve(&rendered.frame, &prior(&rendered, [0.0; 3]), &Unwatched).solution.is_none());
        solver.set_settings(flight);
    }
    assert!(tracked > alone && of_three_or_four > 0, "{tracked} with a prior, {alone} without, of {FRAMES}");
}

#[test]
fn a_wrong_prior_costs_no_solution_and_the_same_prior_gives_the_same_outcome() {
    let mut solver = solver();
    let rendered = frame(Kind::Float, 1);
    for (off, found_by) in
        [([0.05, 0.1, 0.3], FoundBy::Tracked), ([3.0, 1.0, 0.0], FoundBy::LostInSpace), ([0.0, 0.0, 90.0], FoundBy::LostInSpace)]
    {
        let prior = prior(&rendered, off);
        let outcome = solver.solve(&rendered.frame, &prior, &Unwatched);
        assert_eq!((outcome.reason, outcome.found_by), (Reason::Solved, Some(found_by)));
        assert!(is_right(&outcome, &rendered));
        assert_eq!(outcome, solver.solve(&rendered.frame, &prior, &Unwatched));
    }
    // A lens that was moved since: the plate scale is 1 % off what was known, and outside what is believed.
    let mut moved = prior(&rendered, [0.0; 3]);
    moved.attitude = None;
    moved.lens.iter_mut().for_each(|lens| lens.platescale *= 1.01);
    let outcome = solver.solve(&rendered.frame, &moved, &Unwatched);
    assert!(outcome.reason == Reason::Solved && is_right(&outcome, &rendered));
    // Numbers that are none are no prior.
    for sigma in [f64::NAN, -1.0, 0.0, f64::INFINITY] {
        let attitude = Some(AttitudePrior { attitude: rendered.truth.attitude.unwrap(), sigma, sigma_roll: sigma });
        let lens = Some(LensPrior { platescale: sigma, sigma_ln: sigma, k1: sigma, sigma_k1: sigma });
        let outcome = solver.solve(&rendered.frame, &Prior { attitude, lens, ..Prior::default() }, &Unwatched);
        assert!(outcome.reason == Reason::Solved && is_right(&outcome, &rendered), "{sigma}");
    }
}

#[test]
fn tracking_can_be_switched_off() {
    let mut solver = solver();
    let mut settings = Settings::flight().unwrap();
    settings.solver.tracking.enabled = false;
    solver.set_settings(Arc::new(settings));
    let rendered = frame(Kind::Float, 2);
    let outcome = solver.solve(&rendered.frame, &prior(&rendered, [0.0; 3]), &Unwatched);
    assert_eq!((outcome.reason, outcome.found_by), (Reason::Solved, Some(FoundBy::LostInSpace)));
}

#[test]
fn a_tight_circle_around_the_estimate_is_searched_with_any_roll() {
    let mut solver = solver();
    let mut settings = Settings::flight().unwrap();
    settings.solver.requirements.equatorial_location.enabled = true;
    settings.solver.requirements.equatorial_location.radius_deg = 0.5;
    solver.set_settings(Arc::new(settings));
    let rendered = frame(Kind::Float, 3);
    let (ra, dec, _) = rendered.truth.attitude.unwrap().angles();
    let at = |dec| Prior { equatorial: Some((ra, dec)), ..Prior::default() };
    let outcome = solver.solve(&rendered.frame, &at(dec - 0.3 * DEG * dec.signum()), &Unwatched);
    assert_eq!((outcome.reason, outcome.found_by), (Reason::Solved, Some(FoundBy::Tracked)));
    assert!(is_right(&outcome, &rendered));
    let outcome = solver.solve(&rendered.frame, &at(dec - 3.0 * DEG * dec.signum()), &Unwatched);
    assert_eq!((outcome.reason, outcome.found_by), (Reason::Solved, Some(FoundBy::LostInSpace)));
    assert!(outcome.prior_disagreement.is_some() && is_right(&outcome, &rendered));
}

#[test]
fn a_series_of_frames_is_tracked_from_the_second_on_and_lost_in_space_after_a_pause() {
    let mut solver = solver();
    let settings = solver.settings().solver.tracking.clone();
    let catalogue = solver.catalogue().clone();
    let mut tracker = Tracker::default();
    let mut found_by = Vec::new();
    // Every 5 s a degree and a half is far more than the settings reckon with; a hundredth of that is not.
    for (index, (at_s, dec_deg)) in
        [(0, -40.0), (5, -40.03), (10, -40.06), (15, -41.6), (20, -41.63), (2000, -41.63)].iter().enumerate()
    {
        let spec = RenderSpec {
            attitude: Some(Attitude::from_angles(2.0, dec_deg * DEG, 0.5)),
            camera: Some(9),
            ..RenderSpec::new(Kind::Float, 3, index as u64)
        };
        let rendered = render(&spec, &catalogue).unwrap();
        let at = Duration::from_secs(*at_s);
        let prior = tracker.prior(at, Prior::default(), &settings);
        let outcome = solver.solve(&rendered.frame, &prior, &Unwatched);
        assert!(outcome.reason == Reason::Solved && is_right(&outcome, &rendered), "frame {index}");
        found_by.extend(outcome.found_by);
        tracker.learn(at, &outcome, &settings);
    }
    use FoundBy::{LostInSpace, Tracked};
    assert_eq!(found_by, [LostInSpace, Tracked, Tracked, LostInSpace, Tracked, LostInSpace]);
}

#[test]
fn three_stars_alone_are_enough_near_where_they_are_expected_and_nowhere_else() {
    const HALF_DIAGONAL_PX: f64 = 923.0;
    let solver = solver();
    let field = solver.field().unwrap();
    let settings = &solver.settings().solver;
    let (mut found, mut lists) = (0, 0);
    for index in 0..200 {
        let turn = f64::from(index);
        let attitude = Attitude::from_angles(turn * 2.4, (turn / 100.0 - 0.995).asin(), turn);
        let pose = Pose::undistorted(attitude, field.geometry.platescale * 1.004);
        let mut stars = Vec::new();
        field.stars.near(&attitude.boresight(), 2.0 * DEG, |_, star| {
            let (left, up) = pose.project(&star.direction, HALF_DIAGONAL_PX).unwrap();
            if left.abs() < 700.0 && up.abs() < 480.0 {
                stars.push((f64::from(star.mag), left, up));
            }
        });
        stars.sort_by(|a, b| a.0.total_cmp(&b.0));
        let sources: Vec<PatternSource> = stars
            .iter()
            .take(3)
            .enumerate()
            // Off by a tenth of a pixel each way.
            .map(|(i, &(mag, left, up))| {
                let off = if i == 1 { 0.1 } else { -0.1 };
                PatternSource::new(left + off, up - off, 0.1, 10f64.powf(-0.4 * mag), field.geometry.platescale)
            })
            .collect();
        let lens = LensPrior { platescale: pose.platescale, sigma_ln: 5e-4, k1: 0.0, sigma_k1: 2e-4 };
        let geometry = FrameGeometry::new(settings, field, 1536, 1024).with_lens(&lens);
        let rules = NearRules { min_matched: 3, max_false_ln: -5.6 * std::f64::consts::LN_10, stop: &|| None };
        let search = |off: &Vec3| {
            let attitude = attitude.turned(off);
            let told = AttitudePrior { attitude, sigma: 0.05 * DEG, sigma_roll: 0.2 * DEG };
            let region = Region::of(&Prior { attitude: Some(told), ..Prior::default() }, &[]).unwrap();
            NearSearch::new(field, &sources, &geometry, &region, &rules).unwrap().run().0
        };
        lists += 1;
        if let SearchEnd::Found(hypothesis) = search(&Vec3::new(0.04 * DEG, -0.05 * DEG, 0.2 * DEG)) {
            assert_eq!(hypothesis.matches.len(), 3);
            let off = separation(&hypothesis.pose.attitude.boresight(), &attitude.boresight());
            assert!(off < 20.0 * ARCSEC, "list {index}: {}″", off / ARCSEC);
            found += 1;
        }
        for wrong in [Vec3::new(1.0 * DEG, 0.0, 0.0), Vec3::new(0.0, -4.0 * DEG, 0.0), Vec3::new(0.0, 0.0, 5.0 * DEG)] {
            assert!(!matches!(search(&wrong), SearchEnd::Found(_)), "list {index}");
        }
    }
    assert!(found > lists * 9 / 10, "{found} of {lists}");
}
