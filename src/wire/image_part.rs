//! From an outcome to what an update says of it.

use super::status::ObserverPart;
use super::update::{Corrections, Equatorial, FrameStatistics, HorizontalPart, Image, Source};
use super::{List, Maybe, Text};
use crate::solve::{Correction, Outcome, PointingReport, Report, SourceEntry, StatisticsReport};

/// Sources that an update has room for.
const SOURCES: usize = 20;

impl Image {
    /// An outcome in the units of the wire. `report`: the same outcome's; `ideal_gain`: ADU/e⁻ at 0 dB.
    /// The age is left unknown: who sends it knows it.
    pub fn new(outcome: &Outcome, report: &Report, ideal_gain: f64) -> Self {
        let stamp = &outcome.stamp;
        let found: Vec<Source> = report.sources.iter().take(SOURCES).map(Source::new).collect();
        let peaks = report.sources.iter().filter_map(|source| source.peak);
        let solved = report.solved;
        Self {
            image_counter: stamp.image.0.into(),
            image_trigger_counter: stamp.trigger.map(|counter| counter.0).into(),
            exposures: stamp.exposures.max(1),
            exposure_s: stamp.exposure_s.into(),
            captured_unix_s: stamp.captured.map(|(utc, _)| utc.unix_s()).into(),
            captured_quality: stamp.captured.map(|(_, quality)| quality).into(),
            image_age_s: Maybe::unknown(),
            reason: outcome.reason.into(),
            cause: outcome.cause.into(),
            detail: Text::new(&outcome.detail),
            mode: outcome.mode.into(),
            statistics: FrameStatistics::new(&report.stats, ideal_gain).into(),
            focus_metric_adu: peaks.max_by(f64::total_cmp).into(),
            sources_found: saturate(report.sources_found).into(),
            sources_tried: saturate(report.sources_tried).into(),
            sources_matched: saturate(report.matched).into(),
            candidates_tried: u32::try_from(report.candidates_tried).unwrap_or(u32::MAX).into(),
            solve_time_ms: Some(report.time_ms.total).into(),
            equatorial: solved.then(|| Equatorial::new(&report.pointing)).flatten().into(),
            horizontal: solved.then(|| HorizontalPart::new(&report.pointing)).flatten().into(),
            prior_disagreement_deg: report.prior_disagreement_deg.into(),
            corrections: Corrections::new(&report.corrections),
            sources_count: u8::try_from(found.len()).unwrap_or(SOURCES as u8),
            sources: List::from_slice(&found),
        }
    }
}

fn saturate(count: usize) -> u16 {
    u16::try_from(count).unwrap_or(u16::MAX)
}

impl FrameStatistics {
    fn new(stats: &StatisticsReport, ideal_gain: f64) -> Option<Self> {
        Some(Self {
            mean_adu: stats.mean?,
            noise_adu: stats.noise?,
            measured_gain_adu_per_e: stats.gain.into(),
            measured_gain_db: stats.gain.map(|gain| 20.0 * (gain / ideal_gain).log10()).into(),
            saturated_px: u32::try_from(stats.saturated_px?).unwrap_or(u32::MAX).into(),
            saturated_fraction: stats.saturated_fraction?,
            fwhm_px: stats.fwhm_px.into(),
        })
    }
}

impl Equatorial {
    /// `None` where one of the numbers that make a pointing is not known.
    fn new(pointing: &PointingReport) -> Option<Self> {
        let (east, north) = (pointing.sigma_east_arcsec?, pointing.sigma_north_arcsec?);
        Some(Self {
            ra_deg: pointing.ra_deg?,
            dec_deg: pointing.dec_deg?,
            roll_deg: pointing.roll_deg?,
            sigma_east_arcsec: east,
            sigma_north_arcsec: north,
            sigma_roll_arcsec: pointing.sigma_roll_arcsec?,
            sigma_pointing_arcsec: (east + north) / 2.0,
            covariance_arcsec2: pointing.covariance_arcsec2?.map(List::from).into(),
            platescale_arcsec_px: pointing.platescale_arcsec_px?,
            sigma_platescale_arcsec_px: pointing.sigma_platescale_arcsec_px.into(),
            distortion_k1: pointing.distortion_k1.into(),
            rms_px: pointing.rms_px?,
            chi2_per_dof: pointing.chi2_per_dof.into(),
            false_probability_log10: pointing.false_probability_log10.map(|bound| bound.min(0.0)).into(),
            epoch_yr: pointing.epoch_yr.into(),
        })
    }
}

impl HorizontalPart {
    fn new(pointing: &PointingReport) -> Option<Self> {
        let (az, el) = (pointing.sigma_az_arcsec?, pointing.sigma_el_arcsec?);
        let observer = pointing.observer.as_ref()?;
        Some(Self {
            az_deg: pointing.az_deg?,
            el_deg: pointing.el_deg?,
            horizontal_roll_deg: pointing.horizontal_roll_deg?,
            sigma_az_arcsec: az,
            sigma_el_arcsec: el,
            // The horizon does not blur: both rolls turn about the same boresight.
            sigma_horizontal_roll_arcsec: pointing.sigma_roll_arcsec?,
            sigma_horizontal_pointing_arcsec: (az + el) / 2.0,
            observer: ObserverPart {
                latitude_deg: observer.latitude_deg?,
                sidereal_time_h: observer.sidereal_time_h?.rem_euclid(24.0),
            },
            equinox_yr: pointing.equinox_yr.into(),
        })
    }
}

impl Corrections {
    fn new(applied: &[Correction]) -> Self {
        Self {
            corrected_proper_motion: applied.contains(&Correction::ProperMotion),
            corrected_aberration: applied.contains(&Correction::Aberration),
            corrected_precession: applied.contains(&Correction::Precession),
            corrected_refraction: applied.contains(&Correction::Refraction),
            corrected_distortion: applied.contains(&Correction::Distortion),
        }
    }
}

impl Source {
    fn new(entry: &SourceEntry) -> Self {
        let number = |value: Option<f64>| value.unwrap_or(0.0) as f32;
        Self {
            x_px: number(entry.x),
            y_px: number(entry.y),
            sigma_px: number(entry.sigma_px),
            flux_adu: number(entry.flux),
            peak_adu: number(entry.peak),
            snr: number(entry.snr),
            saturated: entry.saturated,
            star_id: entry.star.as_ref().and_then(|star| u32::try_from(star.id).ok()).into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalogue;
    use crate::image::{ImageCounter, Stamp, TriggerCounter};
    use crate::sky::{ARCSEC, Attitude, DEG, HOUR, Horizontal, Mat3, Observer};
    use crate::solve::{HorizontalSolution, Reason, Solution, SourceReport, Statistics};

    fn source(x: f64, peak: f64) -> SourceReport {
        SourceReport { x, y: 20.0, sigma_px: 0.1, flux: 3e4, snr: 50.0, peak, saturated: false }
    }

    fn solution() -> Solution {
        Solution {
            attitude: Attitude::from_angles(136.5 * DEG, -44.0 * DEG, 165.0 * DEG),
            platescale: 9.44 * ARCSEC,
            k1: 0.0,
            axis: (0.0, 0.0),
            covariance: Mat3::from_diagonal(&nalgebra::Vector3::new(1.0, 4.0, 900.0)) * ARCSEC * ARCSEC,
            sigma_platescale: 1e-3 * ARCSEC,
            rms_px: 0.2,
            chi2_per_dof: 1.1,
            matches: Vec::new(),
            false_probability_log10: f64::NEG_INFINITY,
            horizontal: Some(HorizontalSolution {
                pointing: Horizontal { azimuth: 301.0 * DEG, elevation: 52.0 * DEG, roll: -0.8 * DEG },
                sigma: (1.5 * ARCSEC, 2.5 * ARCSEC),
                observer: Observer { latitude: -77.0 * DEG, sidereal_time: -HOUR },
                equinox_yr: None,
                refracted: false,
            }),
            epoch_yr: Some(2013.0),
            start: None,
            served: None,
        }
    }

    fn outcome() -> Outcome {
        let stamp = Stamp { image: ImageCounter(7), trigger: Some(TriggerCounter(3)), ..Stamp::default() };
        Outcome {
            statistics: Some(Statistics { mean: 5e3, noise: 40.0, gain: Some(0.2), ..Statistics::default() }),
            sources: (0..30).map(|place| source(f64::from(place), 100.0 + f64::from(place % 7))).collect(),
            sources_tried: 20,
            ..Outcome::unsolved(stamp, Reason::NoMatch, "no pattern fits")
        }
    }

    fn image(outcome: &Outcome) -> Image {
        let catalogue = Catalogue::embedded().unwrap();
        Image::new(outcome, &Report::new(outcome, &catalogue), 0.02)
    }

    #[test]
    fn an_unsolved_image_has_its_sources_and_no_pointing() {
        let image = image(&outcome());
        assert_eq!(image.reason.get(), Some(Reason::NoMatch));
        assert_eq!(image.detail.to_string(), "no pattern fits");
        assert_eq!((image.sources_count, image.sources_found.get(), image.sources_matched.get()), (20, 30, 0));
        assert_eq!(image.sources.as_slice()[19].x_px, 19.0);
        assert_eq!(image.focus_metric_adu.get(), Some(&106.0));
        assert_eq!(image.statistics.get().unwrap().measured_gain_db.get(), Some(&20.0));
        assert!(image.equatorial.get().is_none() && image.horizontal.get().is_none());
    }

    #[test]
    fn a_solved_image_has_its_pointing_in_degrees_and_arcseconds() {
        let solved = Outcome { reason: Reason::Solved, solution: Some(solution()), ..outcome() };
        let image = image(&solved);
        let equatorial = image.equatorial.get().unwrap();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} {b}");
        close(equatorial.ra_deg, 136.5);
        close(equatorial.dec_deg, -44.0);
        close(equatorial.roll_deg, 165.0);
        close(equatorial.sigma_north_arcsec, 2.0);
        close(equatorial.sigma_pointing_arcsec, 1.5);
        close(equatorial.covariance_arcsec2.as_slice()[2].as_slice()[2], 900.0);
        close(equatorial.platescale_arcsec_px, 9.44);
        let horizontal = image.horizontal.get().unwrap();
        close(horizontal.az_deg, 301.0);
        close(horizontal.sigma_horizontal_pointing_arcsec, 2.0);
        close(horizontal.observer.sidereal_time_h, 23.0);
    }

    #[test]
    fn a_bound_that_is_no_number_is_not_known_and_costs_no_pointing() {
        let solved = Outcome { reason: Reason::Solved, solution: Some(solution()), ..outcome() };
        let equatorial = *image(&solved).equatorial.get().unwrap();
        assert_eq!(equatorial.false_probability_log10.get(), None);
    }
}
