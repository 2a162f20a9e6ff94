//! Corrections on request: what is served then, and that without a request, or a date, nothing is corrected.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod shared;

use shared::solver_with;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::sky::{ARCSEC, Aberration, Attitude, ClockQuality, DEG, Mat3, Observer, Utc, Vec3, separation, to_equinox_of};
use stars::solve::{Outcome, Prior, Reason, Report, Unwatched};

fn date() -> Utc {
    Utc::from_calendar(2013, 1, 1, 6, 0, 0.0).unwrap()
}

const OBSERVER: Observer = Observer { latitude: -77.0 * DEG, sidereal_time: 8.0 * 15.0 * DEG };

/// Solves a night frame at some date with changed settings; the outcome and its report.
fn solved(captured: Option<Utc>, change: impl FnOnce(&mut Settings)) -> (Outcome, serde_json::Value) {
    let mut solver = solver_with(change);
    let attitude = Some(Attitude::from_angles(120.0 * DEG, -60.0 * DEG, 30.0 * DEG));
    let mut frame = render(&RenderSpec { attitude, ..RenderSpec::new(Kind::Night, 5, 1) }, solver.catalogue()).unwrap().frame;
    frame.stamp.captured = captured.map(|utc| (utc, ClockQuality::FreeRunning));
    let outcome = solver.solve(&frame, &Prior { observer: Some(OBSERVER), ..Prior::default() }, &Unwatched);
    assert_eq!(outcome.reason, Reason::Solved);
    let report = serde_json::to_value(Report::new(&outcome, solver.catalogue())).unwrap();
    (outcome, report)
}

fn corrections(report: &serde_json::Value) -> Vec<&str> {
    report["corrections"].as_array().unwrap().iter().map(|word| word.as_str().unwrap()).collect()
}

fn boresight(outcome: &Outcome) -> Vec3 {
    outcome.solution.as_ref().unwrap().served_attitude().boresight()
}

/// Asks for all corrections.
fn all(settings: &mut Settings) {
    let fit = &mut settings.solver.fit;
    (fit.aberration, fit.precession, fit.refraction) = (true, true, true);
}

#[test]
fn nothing_is_corrected_that_was_not_asked_for() {
    let (outcome, report) = solved(Some(date()), |_| ());
    assert!(outcome.solution.as_ref().unwrap().served.is_none());
    assert!(!corrections(&report).contains(&"aberration") && !corrections(&report).contains(&"refraction"));
    assert!(report["equatorial_equinox_yr"].is_null());
}

#[test]
fn with_aberration_the_pointing_is_where_the_moving_earth_sees_the_stars() {
    let (plain, _) = solved(Some(date()), |_| ());
    let (outcome, report) = solved(Some(date()), |s| s.solver.fit.aberration = true);
    assert!(corrections(&report).contains(&"aberration"));
    let wanted = Aberration::at(date()).unwrap().seen(&boresight(&plain));
    let moved = separation(&boresight(&plain), &boresight(&outcome));
    assert!((1.0..21.0).contains(&(moved / ARCSEC)), "{}", moved / ARCSEC);
    let off = separation(&wanted, &boresight(&outcome));
    assert!(off < 0.01 * ARCSEC, "{}", off / ARCSEC);
    // The plate scale is that of the lens, and not of the sky that seems smaller ahead: 1e-4 at most.
    let (a, b) = (outcome.solution.unwrap(), plain.solution.unwrap());
    assert!((a.served.unwrap().platescale / b.platescale - 1.0).abs() < 1.1e-4);
    assert_eq!((a.attitude, a.platescale, a.rms_px), (b.attitude, b.platescale, b.rms_px), "the fit is the same");
    // Against the horizon it is seen too.
    let (with, without) = (a.horizontal.unwrap().pointing, b.horizontal.unwrap().pointing);
    let apart = (with.elevation - without.elevation).hypot((with.azimuth - without.azimuth) * with.elevation.cos());
    assert!((apart / moved - 1.0).abs() < 0.01);
}

#[test]
fn with_precession_the_pointing_is_of_date_and_its_errors_turn_along() {
    let (plain, _) = solved(Some(date()), |_| ());
    let (outcome, report) = solved(Some(date()), |s| s.solver.fit.precession = true);
    assert!(corrections(&report).contains(&"precession"));
    assert!((report["equatorial_equinox_yr"].as_f64().unwrap() - 2013.0).abs() < 0.01);
    assert!(separation(&(to_equinox_of(date()) * boresight(&plain)), &boresight(&outcome)) < 1e-9);
    let (ra, dec, _) = outcome.solution.as_ref().unwrap().served_attitude().angles();
    assert!((report["ra_deg"].as_f64().unwrap() - ra / DEG).abs() < 1e-9);
    assert!((report["dec_deg"].as_f64().unwrap() - dec / DEG).abs() < 1e-9);
    let (before, after) = (plain.solution.unwrap().covariance, outcome.solution.unwrap().served.unwrap().covariance);
    // A turn keeps the area of the ellipse, and the sum of the squares of its axes.
    let sum = |c: &Mat3| c[(0, 0)] + c[(1, 1)];
    let area = |c: &Mat3| c[(0, 0)] * c[(1, 1)] - c[(0, 1)] * c[(0, 1)];
    assert!((sum(&after) / sum(&before) - 1.0).abs() < 1e-6 && (area(&after) / area(&before) - 1.0).abs() < 1e-6);
}

#[test]
fn with_refraction_the_elevation_is_the_one_seen_and_the_equatorial_pointing_stays() {
    let (plain, _) = solved(Some(date()), |_| ());
    let (outcome, report) = solved(Some(date()), |s| {
        s.solver.fit.refraction = true;
        s.solver.fit.pressure_hpa = 1010.0;
        s.solver.fit.temperature_c = 10.0;
    });
    assert!(corrections(&report).contains(&"refraction"));
    assert_eq!(boresight(&plain), boresight(&outcome));
    let pointing = |outcome: Outcome| outcome.solution.unwrap().horizontal.unwrap().pointing;
    let (with, without) = (pointing(outcome), pointing(plain));
    // R = 58.2″ cot(elevation) at 10 °C and 1010 hPa (Allen, Astrophysical Quantities), for elevations over 20°.
    assert!(without.elevation > 20.0 * DEG);
    let wanted = 58.2 / without.elevation.tan();
    let lift = (with.elevation - without.elevation) / ARCSEC;
    assert!((lift - wanted).abs() < 0.03 * wanted, "{lift}″, {wanted}″ wanted");
    assert!((with.azimuth - without.azimuth).abs() < 1.0 * ARCSEC);
}

#[test]
fn without_a_date_there_is_a_solution_and_no_correction_that_needs_one() {
    let (outcome, report) = solved(None, all);
    assert!(outcome.solution.unwrap().served.is_none());
    assert!(!corrections(&report).contains(&"aberration") && !corrections(&report).contains(&"precession"));
}

#[test]
fn a_clock_that_is_decades_off_costs_no_solution() {
    for unix_s in [631_152_000.0, 3_786_911_999.0] {
        let (outcome, _) = solved(Utc::from_unix(unix_s), all);
        assert!(outcome.solution.unwrap().served.is_some());
    }
}

#[test]
fn residuals_are_those_from_where_the_stars_are_now() {
    // ε Indi moves by 4.7″ a year.
    let (ra, dec) = (330.84 * DEG, -56.79 * DEG);
    let mut solver = solver_with(|_| ());
    let years = 3.0;
    let epoch_yr = solver.settings().catalog.epoch_yr + years;
    let attitude = Some(Attitude::from_angles(ra, dec, 0.0));
    let spec = RenderSpec { attitude, epoch_yr, ..RenderSpec::new(Kind::Night, 5, 1) };
    let mut frame = render(&spec, solver.catalogue()).unwrap().frame;
    let captured = Utc::from_unix((epoch_yr - 1970.0) * 365.25 * 86_400.0).unwrap();
    frame.stamp.captured = Some((captured, ClockQuality::FreeRunning));
    let outcome = solver.solve(&frame, &Prior::default(), &Unwatched);
    let solution = outcome.solution.as_ref().unwrap();
    let moving = |star: usize| {
        let star = &solver.catalogue().stars[star];
        separation(&star.direction_after(0.0), &star.direction_after(years)) > 10.0 * ARCSEC
    };
    let fast: Vec<f64> =
        solution.matches.iter().filter(|m| moving(m.star)).map(|m| m.residual_px.0.hypot(m.residual_px.1)).collect();
    assert!(!fast.is_empty() && fast.iter().all(|residual| *residual < 0.5), "{fast:?}");
}
