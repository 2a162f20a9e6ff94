//! The outcome as JSON: what `stars solve --json` prints, the recorder keeps and the display shows.
//!
//! Degrees, arcseconds and milliseconds, with the unit in each name. A number that is not finite is null, so a line is JSON
//! whatever happened. Every key is there in every line; what is not known is null.

use super::{
    AttitudePrior, Cause, FoundBy, Outcome, Prior, Reason, SearchMode, SeriesStart, Solution, SourceReport, StageTimes,
    Statistics,
};
use crate::catalog::Catalogue;
use crate::image::ExposedBy;
use crate::sky::{ARCSEC, ClockQuality, DEG, HOUR, Mat3, Observer, RowOrder, ra_dec};
use serde::Serialize;
use std::time::Duration;

/// One outcome in the units of the outside, ready to be serialised. Field names are an interface: add, never change.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Where the image came from: the path as given, or what the camera calls it.
    pub image: String,
    /// The camera's running number of the image.
    pub image_counter: u32,
    /// The series of triggers that the image belongs to.
    pub trigger_counter: Option<u32>,
    /// What made the camera expose: the program, a trigger of others', or itself for want of one.
    pub exposed_by: Option<ExposedBy>,
    /// Middle of the exposure, ISO 8601, UTC.
    pub captured_utc: Option<String>,
    /// How far that time can be believed.
    pub clock: Option<ClockQuality>,
    /// One σ of that time.
    pub captured_sigma_s: Option<f64>,
    /// The same middle since the start of the program that took it, on a clock that never jumps.
    pub captured_uptime_s: Option<f64>,
    /// Rendered, or taken while camera or lens are simulated.
    pub simulated: bool,
    /// Packets of the image that never came: where they belong its pixels are 0.
    pub missing_packets: u32,
    /// Images that the camera took before this one, and that never came.
    pub missed_frames: u32,
    /// Exposure time of one exposure.
    pub exposure_s: Option<f64>,
    /// Gain of the camera.
    pub gain_db: Option<f64>,
    /// Focus, encoder counts, where it stood still for the image.
    pub focus_counts: Option<i32>,
    /// Aperture, 0 is open, where it stood still for the image.
    pub aperture_counts: Option<i32>,
    /// Temperature of the camera, as it tells it itself.
    pub temperature_camera_c: Option<f64>,
    /// Temperature of the lens.
    pub temperature_lens_c: Option<f64>,
    /// Whether there is a pointing.
    pub solved: bool,
    /// How the frame ended.
    pub reason: Reason,
    /// What the frame's own evidence says was wrong.
    pub cause: Option<Cause>,
    /// Diameter of the discs, or length of the trails, that stars are, where that is the cause.
    pub blur_px: Option<f64>,
    /// Direction of the trails, from x towards y, in file order.
    pub blur_angle_deg: Option<f64>,
    /// The reason in words.
    pub detail: String,
    /// How sources were searched for.
    pub mode: SearchMode,
    /// How the pointing was found: near where it was expected, or anywhere on the sky; null where not solved.
    pub search: Option<FoundBy>,
    /// The pointing; its fields are null where not solved.
    #[serde(flatten)]
    pub pointing: PointingReport,
    /// Sources matched to stars; 0 where not solved.
    pub matched: usize,
    /// Sources found.
    pub sources_found: usize,
    /// Sources that patterns were made of.
    pub sources_tried: usize,
    /// Candidate attitudes screened.
    pub candidates_tried: u64,
    /// The best candidate that was not served, and how many matched in it.
    pub candidate: Option<CandidateReport>,
    /// The prior as given.
    pub prior: PriorReport,
    /// How far the pointing lies from a prior that turned out wrong.
    pub prior_disagreement_deg: Option<f64>,
    /// Statistics of the frame.
    pub stats: StatisticsReport,
    /// Which end of the picture the first row is, from which the sources' rows are counted; null where nothing was looked at.
    pub row_order: Option<RowOrder>,
    /// Sources, brightest first.
    pub sources: Vec<SourceEntry>,
    /// The last triangles tried, as ids of sources.
    pub triangles: Vec<[u8; 3]>,
    /// Where the time went.
    pub time_ms: TimesReport,
    /// Which corrections the pointing has.
    pub corrections: Vec<Correction>,
}

/// A pointing in degrees and arcseconds.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct PointingReport {
    /// Right ascension of the boresight, ICRS, or of date where `equatorial_equinox_yr` says so.
    pub ra_deg: Option<f64>,
    /// Declination of the boresight, as right ascension.
    pub dec_deg: Option<f64>,
    /// Position angle of the picture's up direction, from North through East.
    pub roll_deg: Option<f64>,
    /// Azimuth of the boresight, from north through east.
    pub az_deg: Option<f64>,
    /// Elevation of the boresight.
    pub el_deg: Option<f64>,
    /// Angle of the picture's up direction from the zenith, positive towards growing azimuth.
    pub horizontal_roll_deg: Option<f64>,
    /// Plate scale at the centre.
    pub platescale_arcsec_px: Option<f64>,
    /// One σ of the plate scale.
    pub sigma_platescale_arcsec_px: Option<f64>,
    /// Radial distortion at the half diagonal.
    pub distortion_k1: Option<f64>,
    /// One σ towards East.
    pub sigma_east_arcsec: Option<f64>,
    /// One σ towards North.
    pub sigma_north_arcsec: Option<f64>,
    /// One σ of the roll.
    pub sigma_roll_arcsec: Option<f64>,
    /// One σ along growing azimuth, on the sky.
    pub sigma_az_arcsec: Option<f64>,
    /// One σ along elevation.
    pub sigma_el_arcsec: Option<f64>,
    /// Covariance: east, north, roll.
    pub covariance_arcsec2: Option<[[f64; 3]; 3]>,
    /// Root mean square of the residuals per axis.
    pub rms_px: Option<f64>,
    /// Weighted sum of squared residuals over the degrees of freedom.
    pub chi2_per_dof: Option<f64>,
    /// Upper bound on the probability that this solution is false.
    pub false_probability_log10: Option<f64>,
    /// Epoch that the stars were moved to, Julian year.
    pub epoch_yr: Option<f64>,
    /// Epoch of the equator and equinox of right ascension, declination and roll, Julian year; null for ICRS.
    pub equatorial_equinox_yr: Option<f64>,
    /// Epoch of the equinox of azimuth and elevation, Julian year; null for ICRS axes.
    pub equinox_yr: Option<f64>,
    /// The observer that azimuth and elevation were computed for.
    pub observer: Option<ObserverReport>,
    /// The pointing at the start of a series whose motion is known; that above is then of the middle of its light.
    pub series_start: Option<SeriesStartReport>,
}

/// The pointing at the start of a series, ICRS.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "as in the pointing")]
pub struct SeriesStartReport {
    pub ra_deg: Option<f64>,
    pub dec_deg: Option<f64>,
    pub roll_deg: Option<f64>,
    pub sigma_east_arcsec: Option<f64>,
    pub sigma_north_arcsec: Option<f64>,
    /// From there to the middle of the light.
    pub before_middle_s: Option<f64>,
}

/// Where an observer stands and how far the sky has turned.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct ObserverReport {
    pub latitude_deg: Option<f64>,
    pub sidereal_time_h: Option<f64>,
}

/// A candidate that was not served.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "as in the pointing")]
pub struct CandidateReport {
    pub ra_deg: Option<f64>,
    pub dec_deg: Option<f64>,
    pub roll_deg: Option<f64>,
    pub platescale_arcsec_px: Option<f64>,
    pub matched: usize,
    pub rms_px: Option<f64>,
    pub false_probability_log10: Option<f64>,
}

/// What was known before the frame was solved.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct PriorReport {
    pub az_deg: Option<f64>,
    pub el_deg: Option<f64>,
    pub ra_deg: Option<f64>,
    pub dec_deg: Option<f64>,
    pub observer: Option<ObserverReport>,
    pub attitude: Option<AttitudePriorReport>,
    pub platescale_arcsec_px: Option<f64>,
    pub sigma_platescale_arcsec_px: Option<f64>,
}

/// The attitude that was expected.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub struct AttitudePriorReport {
    pub ra_deg: Option<f64>,
    pub dec_deg: Option<f64>,
    pub roll_deg: Option<f64>,
    pub sigma_deg: Option<f64>,
    pub sigma_roll_deg: Option<f64>,
}

/// Statistics of a frame; all null where it was not looked at.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct StatisticsReport {
    /// Mean of the cells' means, ADU.
    pub mean: Option<f64>,
    /// Median of the cells' standard deviations, ADU.
    pub noise: Option<f64>,
    /// Measured gain, ADU/e⁻.
    pub gain: Option<f64>,
    /// Saturated pixels.
    pub saturated_px: Option<usize>,
    /// Saturated pixels as a fraction of the frame.
    pub saturated_fraction: Option<f64>,
    /// Median full width at half maximum of the better sources.
    pub fwhm_px: Option<f64>,
    /// Lower and upper ADU of the displayed range.
    pub level: Option<(u16, u16)>,
}

/// A source, and the star that it is.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceEntry {
    /// Its place in the list, from 0.
    pub id: usize,
    /// Column, px, in file order.
    pub x: Option<f64>,
    /// Row, px, in file order.
    pub y: Option<f64>,
    /// One σ of the position per axis.
    pub sigma_px: Option<f64>,
    /// Flux above the surroundings, ADU.
    pub flux: Option<f64>,
    /// Matched-filter signal over noise.
    pub snr: Option<f64>,
    /// Highest pixel above the surroundings, ADU.
    pub peak: Option<f64>,
    /// Whether a pixel of it is saturated.
    pub saturated: bool,
    /// The star that it was matched to.
    pub star: Option<StarEntry>,
}

/// A matched star.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StarEntry {
    /// Its place in the catalogue, brightest first.
    pub id: usize,
    /// Its proper name, else `HIP n`, else `G<id>`.
    pub name: String,
    /// Right ascension at the epoch used, ICRS.
    pub ra_deg: Option<f64>,
    /// Declination at the epoch used, ICRS.
    pub dec_deg: Option<f64>,
    /// Gaia RP magnitude.
    pub mag: Option<f64>,
    /// Distance between the star and the source.
    pub residual_px: Option<f64>,
}

/// Time of each stage, ms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[allow(missing_docs, reason = "the stages are those of StageTimes")]
pub struct TimesReport {
    pub read: f64,
    pub statistics: f64,
    pub find: f64,
    #[serde(rename = "match")]
    pub match_: f64,
    pub fit: f64,
    pub total: f64,
}

/// A correction that a pointing may have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum Correction {
    ProperMotion,
    Aberration,
    Precession,
    Refraction,
    Distortion,
}

impl Report {
    /// The report of an outcome whose matches point into `catalogue`.
    pub fn new(outcome: &Outcome, catalogue: &Catalogue) -> Self {
        let mut report = Self::without_stars(outcome);
        if let Some(solution) = &outcome.solution {
            name_stars(&mut report.sources, solution, catalogue);
        }
        report
    }

    /// The report of an outcome whose matches, if it has any, cannot be named: none of its sources has a star.
    pub fn without_stars(outcome: &Outcome) -> Self {
        let stamp = &outcome.stamp;
        let solution = outcome.solution.as_ref();
        Self {
            image: stamp.origin.clone(),
            image_counter: stamp.image.0,
            trigger_counter: stamp.trigger.map(|counter| counter.0),
            exposed_by: stamp.exposed_by,
            captured_utc: stamp.captured.map(|(utc, _)| utc.to_string()),
            clock: stamp.captured.map(|(_, quality)| quality),
            captured_sigma_s: stamp.captured_sigma_s.and_then(finite),
            captured_uptime_s: stamp.uptime_s.and_then(finite),
            simulated: stamp.simulated,
            missing_packets: stamp.missing_packets,
            missed_frames: stamp.missed_frames,
            exposure_s: stamp.exposure_s.and_then(finite),
            gain_db: stamp.gain_db.and_then(finite),
            focus_counts: stamp.focus_counts,
            aperture_counts: stamp.aperture_counts,
            temperature_camera_c: stamp.temperature_camera_c.and_then(finite),
            temperature_lens_c: stamp.temperature_lens_c.and_then(finite),
            solved: outcome.reason == Reason::Solved && solution.is_some(),
            reason: outcome.reason,
            cause: outcome.cause,
            blur_px: outcome.blur.and_then(|blur| finite(blur.size_px)),
            blur_angle_deg: outcome.blur.and_then(|blur| blur.angle).and_then(degrees),
            detail: outcome.detail.clone(),
            mode: outcome.mode,
            search: outcome.found_by.filter(|_| solution.is_some()),
            pointing: solution.map_or_else(PointingReport::default, PointingReport::new),
            matched: solution.map_or(0, |solution| solution.matches.len()),
            sources_found: outcome.sources.len(),
            sources_tried: outcome.sources_tried,
            candidates_tried: outcome.candidates_tried,
            candidate: outcome.candidate.as_ref().map(CandidateReport::new),
            prior: PriorReport::new(&outcome.prior),
            prior_disagreement_deg: outcome.prior_disagreement.and_then(degrees),
            stats: outcome.statistics.as_ref().map_or_else(StatisticsReport::default, StatisticsReport::new),
            row_order: outcome.rows,
            sources: outcome.sources.iter().enumerate().map(|(id, source)| source_entry(id, source)).collect(),
            triangles: outcome.triangles.clone(),
            time_ms: TimesReport::new(&outcome.times),
            corrections: solution.map_or_else(Vec::new, corrections_of),
        }
    }
}

impl PointingReport {
    /// A pointing in the units of the outside.
    pub fn new(solution: &Solution) -> Self {
        let (ra, dec, roll) = solution.served_attitude().angles();
        let sigmas = solution.sigmas();
        let horizontal = solution.horizontal.as_ref();
        Self {
            ra_deg: degrees(ra),
            dec_deg: degrees(dec),
            roll_deg: degrees(roll),
            az_deg: horizontal.and_then(|h| degrees(h.pointing.azimuth)),
            el_deg: horizontal.and_then(|h| degrees(h.pointing.elevation)),
            horizontal_roll_deg: horizontal.and_then(|h| degrees(h.pointing.roll)),
            platescale_arcsec_px: arcsec(solution.served.map_or(solution.platescale, |served| served.platescale)),
            sigma_platescale_arcsec_px: arcsec(solution.sigma_platescale),
            distortion_k1: finite(solution.k1),
            sigma_east_arcsec: arcsec(sigmas.x),
            sigma_north_arcsec: arcsec(sigmas.y),
            sigma_roll_arcsec: arcsec(sigmas.z),
            sigma_az_arcsec: horizontal.and_then(|h| arcsec(h.sigma.0)),
            sigma_el_arcsec: horizontal.and_then(|h| arcsec(h.sigma.1)),
            covariance_arcsec2: covariance_arcsec2(solution.served_covariance()),
            rms_px: finite(solution.rms_px),
            chi2_per_dof: finite(solution.chi2_per_dof),
            false_probability_log10: finite(solution.false_probability_log10),
            epoch_yr: solution.epoch_yr.and_then(finite),
            equatorial_equinox_yr: solution.served.and_then(|served| served.equinox_yr).and_then(finite),
            equinox_yr: horizontal.and_then(|h| h.equinox_yr).and_then(finite),
            observer: horizontal.map(|h| ObserverReport::new(&h.observer)),
            series_start: solution.start.map(|start| SeriesStartReport::new(&start, &solution.covariance)),
        }
    }
}

impl SeriesStartReport {
    fn new(start: &SeriesStart, middle: &Mat3) -> Self {
        let (ra, dec, roll) = start.attitude.angles();
        let sigma = |variance: f64| arcsec((variance + start.variance).sqrt());
        Self {
            ra_deg: degrees(ra),
            dec_deg: degrees(dec),
            roll_deg: degrees(roll),
            sigma_east_arcsec: sigma(middle.m11),
            sigma_north_arcsec: sigma(middle.m22),
            before_middle_s: finite(start.before_middle_s),
        }
    }
}

impl ObserverReport {
    fn new(observer: &Observer) -> Self {
        Self { latitude_deg: degrees(observer.latitude), sidereal_time_h: finite(observer.sidereal_time / HOUR) }
    }
}

impl CandidateReport {
    fn new(candidate: &Solution) -> Self {
        let (ra, dec, roll) = candidate.attitude.angles();
        Self {
            ra_deg: degrees(ra),
            dec_deg: degrees(dec),
            roll_deg: degrees(roll),
            platescale_arcsec_px: arcsec(candidate.platescale),
            matched: candidate.matches.len(),
            rms_px: finite(candidate.rms_px),
            false_probability_log10: finite(candidate.false_probability_log10),
        }
    }
}

impl PriorReport {
    fn new(prior: &Prior) -> Self {
        Self {
            az_deg: prior.horizontal.and_then(|(az, _)| degrees(az)),
            el_deg: prior.horizontal.and_then(|(_, el)| degrees(el)),
            ra_deg: prior.equatorial.and_then(|(ra, _)| degrees(ra)),
            dec_deg: prior.equatorial.and_then(|(_, dec)| degrees(dec)),
            observer: prior.observer.as_ref().map(ObserverReport::new),
            attitude: prior.attitude.as_ref().map(AttitudePriorReport::new),
            platescale_arcsec_px: prior.lens.and_then(|lens| arcsec(lens.platescale)),
            sigma_platescale_arcsec_px: prior.lens.and_then(|lens| arcsec(lens.platescale * lens.sigma_ln)),
        }
    }
}

impl AttitudePriorReport {
    fn new(prior: &AttitudePrior) -> Self {
        let (ra, dec, roll) = prior.attitude.angles();
        Self {
            ra_deg: degrees(ra),
            dec_deg: degrees(dec),
            roll_deg: degrees(roll),
            sigma_deg: degrees(prior.sigma),
            sigma_roll_deg: degrees(prior.sigma_roll),
        }
    }
}

impl StatisticsReport {
    fn new(statistics: &Statistics) -> Self {
        Self {
            mean: finite(statistics.mean),
            noise: finite(statistics.noise),
            gain: statistics.gain.and_then(finite),
            saturated_px: Some(statistics.saturated_px),
            saturated_fraction: finite(statistics.saturated_fraction),
            fwhm_px: statistics.fwhm_px.and_then(finite),
            level: Some(statistics.level),
        }
    }
}

impl TimesReport {
    fn new(times: &StageTimes) -> Self {
        let ms = |time: Duration| time.as_secs_f64() * 1e3;
        Self {
            read: ms(times.read),
            statistics: ms(times.statistics),
            find: ms(times.find),
            match_: ms(times.match_),
            fit: ms(times.fit),
            total: ms(times.total),
        }
    }
}

/// Gives every matched source its star.
fn name_stars(entries: &mut [SourceEntry], solution: &Solution, catalogue: &Catalogue) {
    let years = solution.epoch_yr.map_or(0.0, |epoch| epoch - catalogue.header.epoch_yr);
    for pair in &solution.matches {
        let (Some(entry), Some(star)) = (entries.get_mut(pair.source), catalogue.stars.get(pair.star)) else { continue };
        let (ra, dec) = ra_dec(&star.direction_after(years));
        entry.star = Some(StarEntry {
            id: pair.star,
            name: catalogue.name(pair.star),
            ra_deg: degrees(ra),
            dec_deg: degrees(dec),
            mag: finite(f64::from(star.mag)),
            residual_px: finite(pair.residual_px.0.hypot(pair.residual_px.1)),
        });
    }
}

fn source_entry(id: usize, source: &SourceReport) -> SourceEntry {
    SourceEntry {
        id,
        x: finite(source.x),
        y: finite(source.y),
        sigma_px: finite(source.sigma_px),
        flux: finite(source.flux),
        snr: finite(source.snr),
        peak: finite(source.peak),
        saturated: source.saturated,
        star: None,
    }
}

/// The corrections that are in a solution's numbers.
fn corrections_of(solution: &Solution) -> Vec<Correction> {
    let of_date = solution.served.is_some_and(|served| served.equinox_yr.is_some());
    let precessed = of_date || solution.horizontal.is_some_and(|h| h.equinox_yr.is_some());
    [
        (solution.epoch_yr.is_some(), Correction::ProperMotion),
        (solution.served.is_some_and(|served| served.aberration), Correction::Aberration),
        (precessed, Correction::Precession),
        (solution.horizontal.is_some_and(|h| h.refracted), Correction::Refraction),
        (solution.k1 != 0.0, Correction::Distortion),
    ]
    .into_iter()
    .filter_map(|(applied, correction)| applied.then_some(correction))
    .collect()
}

fn covariance_arcsec2(covariance: &Mat3) -> Option<[[f64; 3]; 3]> {
    let scaled = covariance / (ARCSEC * ARCSEC);
    scaled.iter().all(|c| c.is_finite()).then(|| scaled.transpose().into())
}

fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn degrees(radians: f64) -> Option<f64> {
    finite(radians / DEG)
}

fn arcsec(radians: f64) -> Option<f64> {
    finite(radians / ARCSEC)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::{CatalogueHeader, Star};
    use crate::image::{ImageCounter, Stamp};
    use crate::sky::{Attitude, Horizontal, Utc};
    use crate::solve::{HorizontalSolution, Match};
    use serde_json::{Value, json};

    /// The keys of interfaces.md, which others hold on to.
    const PROMISED: [&str; 22] = [
        "image",
        "solved",
        "reason",
        "cause",
        "detail",
        "ra_deg",
        "dec_deg",
        "roll_deg",
        "platescale_arcsec_px",
        "sigma_east_arcsec",
        "sigma_north_arcsec",
        "sigma_roll_arcsec",
        "covariance_arcsec2",
        "rms_px",
        "matched",
        "sources_found",
        "sources_tried",
        "false_probability_log10",
        "stats",
        "sources",
        "time_ms",
        "corrections",
    ];

    fn catalogue() -> Catalogue {
        let star = Star { ra: 1.0, dec: 0.5, pm_ra: 0.0, pm_dec: 10.0 * ARCSEC, mag: 3.25, hip: 0 };
        Catalogue {
            header: CatalogueHeader { format: 1, epoch_yr: 2016.0, count: 1, checksum: 0, origin: String::new() },
            stars: vec![star],
        }
    }

    fn stamp() -> Stamp {
        Stamp {
            image: ImageCounter(7),
            origin: "a/b.fits".into(),
            captured: Utc::from_unix(1_357_020_684.859).map(|utc| (utc, ClockQuality::FreeRunning)),
            ..Stamp::default()
        }
    }

    fn solved() -> Outcome {
        let sigma = ARCSEC;
        let mut covariance = Mat3::from_diagonal(&crate::sky::Vec3::new(sigma, 2.0 * sigma, 30.0 * sigma).map(|s| s * s));
        covariance[(0, 1)] = 0.5 * sigma * sigma;
        let source = SourceReport { x: 10.5, y: 20.25, sigma_px: 0.1, flux: 1e4, snr: 50.0, peak: 900.0, saturated: false };
        let solution = Solution {
            attitude: Attitude::from_angles(120.0 * DEG, -43.0 * DEG, 165.0 * DEG),
            platescale: 9.5 * ARCSEC,
            k1: 1e-3,
            axis: (0.0, 0.0),
            covariance,
            sigma_platescale: 1e-3 * ARCSEC,
            rms_px: 0.3,
            chi2_per_dof: 1.1,
            matches: vec![Match { source: 1, star: 0, residual_px: (0.3, -0.4) }],
            false_probability_log10: -20.0,
            horizontal: Some(HorizontalSolution {
                pointing: Horizontal { azimuth: 301.0 * DEG, elevation: 52.0 * DEG, roll: -0.8 * DEG },
                sigma: (ARCSEC, ARCSEC),
                observer: Observer { latitude: -77.0 * DEG, sidereal_time: 12.0 * HOUR },
                equinox_yr: Some(2013.0),
                refracted: false,
            }),
            epoch_yr: Some(2013.0),
            start: None,
            served: None,
        };
        Outcome {
            sources: vec![source, source],
            sources_tried: 2,
            solution: Some(solution),
            statistics: Some(Statistics { mean: 1000.0, noise: 20.0, ..Statistics::default() }),
            times: StageTimes { total: Duration::from_micros(3500), ..StageTimes::default() },
            ..Outcome::unsolved(stamp(), Reason::Solved, "")
        }
    }

    fn value(outcome: &Outcome) -> Value {
        serde_json::to_value(Report::new(outcome, &catalogue())).unwrap()
    }

    fn near(value: &Value, wanted: f64) -> bool {
        value.as_f64().is_some_and(|got| (got - wanted).abs() < 1e-9 * wanted.abs().max(1.0))
    }

    #[test]
    fn a_solution_has_the_promised_keys_and_units() {
        let report = value(&solved());
        for key in PROMISED {
            assert!(report.get(key).is_some_and(|v| key == "cause" || !v.is_null()), "{key}");
        }
        assert_eq!(report["image"], "a/b.fits");
        assert_eq!((&report["solved"], &report["reason"]), (&json!(true), &json!("solved")));
        for (key, wanted) in [
            ("ra_deg", 120.0),
            ("dec_deg", -43.0),
            ("roll_deg", 165.0),
            ("az_deg", 301.0),
            ("el_deg", 52.0),
            ("horizontal_roll_deg", -0.8),
            ("platescale_arcsec_px", 9.5),
            ("sigma_east_arcsec", 1.0),
            ("sigma_north_arcsec", 2.0),
            ("sigma_roll_arcsec", 30.0),
            ("rms_px", 0.3),
            ("matched", 1.0),
            ("sources_found", 2.0),
            ("false_probability_log10", -20.0),
        ] {
            assert!(near(&report[key], wanted), "{key} is {}", report[key]);
        }
        assert!(near(&report["covariance_arcsec2"][0][1], 0.5) && near(&report["covariance_arcsec2"][2][2], 900.0));
        assert_eq!(report["corrections"], json!(["proper_motion", "precession", "distortion"]));
        assert_eq!(report["captured_utc"], "2013-01-01T06:11:24.859");
        for key in ["mean", "noise", "gain", "saturated_px", "saturated_fraction", "fwhm_px"] {
            assert!(report["stats"].get(key).is_some(), "{key}");
        }
        for key in ["read", "statistics", "find", "match", "fit", "total"] {
            assert!(report["time_ms"][key].is_f64(), "{key}");
        }
        assert!(near(&report["time_ms"]["total"], 3.5));
    }

    #[test]
    fn a_matched_source_carries_its_star_at_the_epoch_used() {
        let report = value(&solved());
        let sources = report["sources"].as_array().unwrap();
        for key in ["id", "x", "y", "flux", "snr", "peak", "star"] {
            assert!(sources[0].get(key).is_some(), "{key}");
        }
        assert_eq!(sources[0]["star"], Value::Null);
        let star = &sources[1]["star"];
        assert_eq!(sources[1]["id"], 1);
        assert_eq!((&star["id"], &star["mag"]), (&json!(0), &json!(3.25)));
        assert!(star["name"].is_string() && near(&star["residual_px"], 0.5));
        // Three years before the catalogue's epoch, at 10″ a year.
        let moved = star["dec_deg"].as_f64().unwrap() - 0.5 / DEG;
        assert!((moved * 3600.0 + 30.0).abs() < 1e-3, "{moved}");
    }

    #[test]
    fn an_unsolved_frame_has_the_same_keys_and_nulls() {
        let report = value(&Outcome::unsolved(stamp(), Reason::TooFewSources, "2 sources, 3 are needed"));
        let keys = |v: &Value| v.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
        assert_eq!(keys(&report), keys(&value(&solved())));
        assert_eq!((&report["solved"], &report["reason"]), (&json!(false), &json!("too_few_sources")));
        assert_eq!(report["detail"], "2 sources, 3 are needed");
        for key in ["ra_deg", "dec_deg", "roll_deg", "platescale_arcsec_px", "covariance_arcsec2", "rms_px", "cause"] {
            assert!(report[key].is_null(), "{key}");
        }
        assert!(report["stats"]["mean"].is_null() && report["corrections"] == json!([]));
    }

    #[test]
    fn a_candidate_that_was_refused_is_told_apart_from_a_solution() {
        let outcome = Outcome { candidate: solved().solution, solution: None, reason: Reason::Requirement, ..solved() };
        let report = value(&outcome);
        assert!(report["ra_deg"].is_null() && report["matched"] == 0 && report["sources"][1]["star"].is_null());
        assert!(near(&report["candidate"]["ra_deg"], 120.0) && report["candidate"]["matched"] == 1);
    }

    #[test]
    fn numbers_that_are_none_become_null_and_bad_indices_are_left_out() {
        let mut outcome = solved();
        outcome.statistics = Some(Statistics { mean: f64::NAN, gain: Some(f64::INFINITY), ..Statistics::default() });
        outcome.sources[0].flux = f64::NEG_INFINITY;
        outcome.prior_disagreement = Some(f64::NAN);
        if let Some(solution) = outcome.solution.as_mut() {
            solution.covariance[(2, 2)] = f64::NAN;
            solution.rms_px = f64::NAN;
            solution.false_probability_log10 = f64::NEG_INFINITY;
            solution.matches.push(Match { source: 99, star: 0, residual_px: (0.0, 0.0) });
            solution.matches.push(Match { source: 0, star: 99, residual_px: (0.0, 0.0) });
        }
        let line = serde_json::to_string(&Report::new(&outcome, &catalogue())).unwrap();
        assert!(!line.contains("NaN") && !line.contains("inf") && !line.contains('\n'));
        let report: Value = serde_json::from_str(&line).unwrap();
        for key in ["rms_px", "covariance_arcsec2", "false_probability_log10", "prior_disagreement_deg"] {
            assert!(report[key].is_null(), "{key}");
        }
        assert!(report["stats"]["mean"].is_null() && report["stats"]["gain"].is_null());
        assert!(report["sources"][0]["flux"].is_null() && report["sources"][0]["star"].is_null());
    }
}
