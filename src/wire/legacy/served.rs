//! From what is true now to the variables that a flight computer of old is sent.

use super::{Answer, Blob, Variables};
use crate::image::{ImageCounter, Stamp};
use crate::sky::RowOrder;
use crate::solve::{HorizontalSolution, Outcome, Solution, Statistics};
use crate::wire::{Camera, Housekeeping};

/// The size of a picture and which end of it the first row is: what places in a file mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Picture {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Which end of the picture the first row is.
    pub rows: RowOrder,
}

impl Picture {
    /// A place in file order as one to the right of and up from the centre, px.
    fn centred(&self, x: f64, y: f64) -> (f64, f64) {
        let right = x - (self.width as f64 - 1.0) / 2.0;
        let along = y - (self.height as f64 - 1.0) / 2.0;
        (right, if self.rows == RowOrder::BottomFirst { along } else { -along })
    }
}

impl Answer {
    /// Camera, lens and the time since the start.
    pub fn note_camera(&mut self, camera: &Camera, run_time_s: f64) {
        let variables = &mut self.variables;
        variables.ctr_stars = signed(camera.next_image_counter.get());
        variables.stars_run_time = run_time_s as i32;
        variables.cam_gain_valid = camera.gain_db.get().is_some();
        if let Some(gain_db) = camera.gain_db.get() {
            variables.cam_gain_db = *gain_db;
        }
        variables.lens_focus = camera.focus_counts.get().map_or(-1, |counts| counts.get());
        variables.lens_aperture = camera.aperture_counts.get().map_or(-1, |counts| counts.get());
    }

    /// Temperatures, pressure and disk; what is not known stays as it was.
    pub fn note_housekeeping(&mut self, housekeeping: &Housekeeping) {
        let variables = &mut self.variables;
        for (variable, value) in [
            (&mut variables.hk_temp_lens, housekeeping.temperature_lens_c),
            (&mut variables.hk_temp_comp, housekeeping.temperature_computer_c),
            (&mut variables.hk_temp_vessel, housekeeping.temperature_vessel_c),
            (&mut variables.hk_temp_plate, housekeeping.temperature_plate_c),
            (&mut variables.hk_temp_dcdc, housekeeping.temperature_dcdc_c),
            (&mut variables.hk_temp_flange, housekeeping.temperature_flange_c),
            (&mut variables.hk_pressure, housekeeping.pressure_atm),
            (&mut variables.hk_disk, housekeeping.disk_free_gib),
        ] {
            if let Some(known) = value.get() {
                *variable = *known;
            }
        }
    }

    /// An image that is being solved: nothing is known of it yet.
    pub fn note_begun(&mut self, image: ImageCounter) {
        self.variables.image_ctr_stars = signed(image.0);
        self.variables.image_ctr_fcp = -1;
        self.variables.image_num_exposures = -1;
        self.variables.forget_image();
    }

    /// An image that ended in an outcome. `served`: its pointing may be told; `picture`: where it has sources; `ideal_gain`:
    /// ADU/e⁻ at 0 dB.
    pub fn note_outcome(&mut self, outcome: &Outcome, picture: Option<Picture>, served: bool, ideal_gain: f64) {
        let variables = &mut self.variables;
        variables.forget_image();
        variables.note_stamp(&outcome.stamp);
        if let Some(statistics) = &outcome.statistics {
            variables.note_statistics(statistics, ideal_gain);
        }
        let peaks = outcome.sources.iter().map(|source| source.peak);
        if let Some(peak) = peaks.max_by(f64::total_cmp) {
            (variables.image_afocus_metric_valid, variables.image_afocus_metric) = (true, peak);
        }
        if let Some(solution) = outcome.solution.as_ref().filter(|_| served) {
            variables.note_solution(solution);
            variables.image_num_blobs_found = signed(outcome.sources.len());
            variables.image_num_blobs_matched = signed(solution.matches.len());
        }
        let Some(picture) = picture else { return };
        self.blobs_ctr_stars = signed(outcome.stamp.image.0);
        let blob = |source: &crate::solve::SourceReport| {
            let (x, y) = picture.centred(source.x, source.y);
            Blob { x, y, flux: source.flux, peak_to_flux: if source.flux > 0.0 { source.peak / source.flux } else { 0.0 } }
        };
        self.blobs = outcome.sources.iter().take(super::MAX_BLOBS).map(blob).collect();
    }
}

impl Variables {
    /// Nothing is known of the image: flags are off, and the pointing's numbers stay, as they did.
    fn forget_image(&mut self) {
        self.image_eq_valid = false;
        self.image_hor_valid = false;
        self.image_afocus_metric_valid = false;
        self.image_stats_mean = -1.0;
        self.image_stats_noise = -1.0;
        self.image_stats_gaindb = -1.0;
        self.image_stats_num_px_sat = -1;
        self.image_stats_frac_px_sat = -1.0;
    }

    fn note_stamp(&mut self, stamp: &Stamp) {
        self.image_ctr_stars = signed(stamp.image.0);
        self.image_ctr_fcp = stamp.trigger.map_or(-1, |trigger| signed(trigger.0));
        self.image_num_exposures = i32::from(stamp.exposures.max(1));
    }

    fn note_statistics(&mut self, statistics: &Statistics, ideal_gain: f64) {
        self.image_stats_mean = statistics.mean;
        self.image_stats_noise = statistics.noise;
        self.image_stats_gaindb = statistics.gain.map_or(-1.0, |gain| 20.0 * (gain / ideal_gain).log10());
        self.image_stats_num_px_sat = signed(statistics.saturated_px);
        self.image_stats_frac_px_sat = statistics.saturated_fraction;
    }

    fn note_solution(&mut self, solution: &Solution) {
        let (ra, dec, roll) = solution.served_attitude().angles();
        let sigma = solution.sigmas();
        let platescale = solution.served.map_or(solution.platescale, |served| served.platescale);
        self.image_eq_valid = true;
        (self.image_eq_ra, self.image_eq_dec, self.image_eq_roll) = (ra, dec, -roll);
        (self.image_eq_sigma_ra, self.image_eq_sigma_dec) = (as_coordinate(sigma.x, dec), sigma.y);
        self.image_eq_sigma_roll = sigma.z;
        self.image_eq_sigma_pointing = (sigma.x + sigma.y) / 2.0;
        self.image_eq_iplate = platescale;
        let Some(HorizontalSolution { pointing, sigma: (sigma_az, sigma_el), .. }) = solution.horizontal else { return };
        self.image_hor_valid = true;
        (self.image_hor_az, self.image_hor_el) = (pointing.azimuth, pointing.elevation);
        self.image_hor_roll = pointing.roll;
        (self.image_hor_sigma_az, self.image_hor_sigma_el) = (as_coordinate(sigma_az, pointing.elevation), sigma_el);
        self.image_hor_sigma_roll = sigma.z;
        self.image_hor_sigma_pointing = (sigma_az + sigma_el) / 2.0;
        self.image_hor_iplate = platescale;
    }
}

/// A σ along a parallel of the sky as the angle of the coordinate, where the parallel has the latitude; a whole turn at most.
fn as_coordinate(sigma: f64, latitude: f64) -> f64 {
    (sigma / latitude.cos().abs()).min(std::f64::consts::TAU)
}

/// A count as the dialect's signed number.
fn signed(count: impl TryInto<i32>) -> i32 {
    count.try_into().unwrap_or(i32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::TriggerCounter;
    use crate::sky::{ARCSEC, Attitude, CameraModel, DEG, HOUR, Mat3, Observer, direction, horizontal_of};
    use crate::solve::{Reason, SourceReport};

    const ATTITUDE: (f64, f64, f64) = (136.564602 * DEG, -43.967823 * DEG, 165.25276 * DEG);

    fn solution() -> Solution {
        let (ra, dec, roll) = ATTITUDE;
        let attitude = Attitude::from_angles(ra, dec, roll);
        let observer = Observer { latitude: -76.9389955 * DEG, sidereal_time: 12.2452777777778 * HOUR };
        let pointing = horizontal_of(&attitude, &observer, None);
        let sigma = (1.5 * ARCSEC, 2.5 * ARCSEC);
        Solution {
            attitude,
            platescale: 9.44 * ARCSEC,
            k1: 0.0,
            axis: (0.0, 0.0),
            covariance: Mat3::from_diagonal(&nalgebra::Vector3::new(1.0, 4.0, 900.0)) * ARCSEC * ARCSEC,
            sigma_platescale: 1e-3 * ARCSEC,
            rms_px: 0.2,
            chi2_per_dof: 1.1,
            matches: Vec::new(),
            false_probability_log10: -20.0,
            horizontal: Some(HorizontalSolution { pointing, sigma, observer, equinox_yr: None, refracted: false }),
            epoch_yr: None,
            start: None,
            served: None,
        }
    }

    fn source(x: f64, y: f64) -> SourceReport {
        SourceReport { x, y, sigma_px: 0.1, flux: 3e4, snr: 50.0, peak: 600.0, saturated: false }
    }

    fn outcome(reason: Reason) -> Outcome {
        let stamp = Stamp { image: ImageCounter(7), trigger: Some(TriggerCounter(3)), exposures: 2, ..Stamp::default() };
        Outcome {
            solution: (reason == Reason::Solved).then(solution),
            statistics: Some(Statistics { mean: 5e3, noise: 40.0, gain: Some(0.2), saturated_px: 2, ..Statistics::default() }),
            sources: vec![source(767.5, 511.5), source(1067.5, 521.5)],
            ..Outcome::unsolved(stamp, reason, "")
        }
    }

    const PICTURE: Picture = Picture { width: 1536, height: 1024, rows: RowOrder::BottomFirst };

    fn answer(outcome: &Outcome, served: bool) -> Answer {
        let mut answer = Answer::default();
        answer.note_outcome(outcome, Some(PICTURE), served, 0.02);
        answer
    }

    /// Where the projection of the program that flew puts a point of the sky, px right and up, by its own rule.
    fn flown_projection(sky: (f64, f64), centre: (f64, f64), roll: f64, iplate: f64, east_is_left: bool) -> (f64, f64) {
        let (d, alpha) = (sky.1, sky.0 - centre.0);
        let depth = centre.1.sin() * d.sin() + centre.1.cos() * d.cos() * alpha.cos();
        let xi = d.cos() * alpha.sin() / depth;
        let eta = (centre.1.cos() * d.sin() - centre.1.sin() * d.cos() * alpha.cos()) / depth;
        let (u, v) = (if east_is_left { -xi } else { xi } / iplate, eta / iplate);
        (roll.cos() * u - roll.sin() * v, roll.sin() * u + roll.cos() * v)
    }

    #[test]
    fn the_rolls_are_those_of_the_projection_that_flew() {
        let variables = answer(&outcome(Reason::Solved), true).variables;
        let camera =
            CameraModel { width: 1536, height: 1024, platescale: 9.44 * ARCSEC, k1: 0.0, rows: PICTURE.rows, mirrored: false };
        let (solution, pixel) = (solution(), (1200.0, 700.0));
        let star = solution.attitude.to_sky(&camera.to_direction(pixel.0, pixel.1));
        let wanted = PICTURE.centred(pixel.0, pixel.1);
        let close = |got: (f64, f64)| assert!((got.0 - wanted.0).hypot(got.1 - wanted.1) < 1e-6, "{got:?} {wanted:?}");
        let v = &variables;
        close(flown_projection(
            crate::sky::ra_dec(&star),
            (v.image_eq_ra, v.image_eq_dec),
            v.image_eq_roll,
            v.image_eq_iplate,
            true,
        ));
        // The star's azimuth and elevation: those of a boresight that looks at it.
        let (ra, dec) = crate::sky::ra_dec(&star);
        let observer = solution.horizontal.unwrap().observer;
        let there = horizontal_of(&Attitude::from_angles(ra, dec, 0.0), &observer, None);
        let at = (there.azimuth, there.elevation);
        close(flown_projection(at, (v.image_hor_az, v.image_hor_el), v.image_hor_roll, v.image_hor_iplate, false));
        assert!((direction(ra, dec) - star).norm() < 1e-12);
    }

    #[test]
    fn a_solution_goes_out_in_radians_with_the_sigmas_of_its_coordinates() {
        let v = answer(&outcome(Reason::Solved), true).variables;
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        assert!(v.image_eq_valid && v.image_hor_valid);
        close(v.image_eq_ra, ATTITUDE.0);
        close(v.image_eq_dec, ATTITUDE.1);
        close(v.image_eq_roll, -ATTITUDE.2);
        close(v.image_eq_sigma_ra, ARCSEC / ATTITUDE.1.cos());
        close(v.image_eq_sigma_dec, 2.0 * ARCSEC);
        close(v.image_eq_sigma_roll, 30.0 * ARCSEC);
        close(v.image_eq_sigma_pointing, 1.5 * ARCSEC);
        close(v.image_eq_iplate, 9.44 * ARCSEC);
        close(v.image_hor_sigma_az, 1.5 * ARCSEC / v.image_hor_el.cos());
        close(v.image_hor_sigma_pointing, 2.0 * ARCSEC);
        assert_eq!((v.image_ctr_stars, v.image_ctr_fcp, v.image_num_exposures), (7, 3, 2));
        assert_eq!((v.image_stats_mean, v.image_stats_gaindb, v.image_stats_num_px_sat), (5e3, 20.0, 2));
        assert_eq!((v.image_num_blobs_found, v.image_afocus_metric), (2, 600.0));
    }

    #[test]
    fn sources_are_placed_from_the_centre_right_and_up_whichever_row_is_first() {
        let blobs = answer(&outcome(Reason::NoMatch), true).blobs;
        assert_eq!(blobs[1], Blob { x: 300.0, y: 10.0, flux: 3e4, peak_to_flux: 0.02 });
        assert_eq!(Picture { rows: RowOrder::TopFirst, ..PICTURE }.centred(767.5, 521.5), (0.0, -10.0));
    }

    #[test]
    fn what_may_not_be_told_or_is_not_there_is_not_valid() {
        let withheld = answer(&outcome(Reason::Solved), false).variables;
        assert!(!withheld.image_eq_valid && !withheld.image_hor_valid);
        assert_eq!((withheld.image_eq_ra, withheld.image_num_blobs_found), (0.0, -1));
        // The numbers of a solution stay, and its flags go, with the next image; its statistics go at once.
        let mut answer = answer(&outcome(Reason::Solved), true);
        answer.note_begun(ImageCounter(8));
        let v = &answer.variables;
        assert!(!v.image_eq_valid && !v.image_hor_valid && !v.image_afocus_metric_valid);
        assert_eq!((v.image_ctr_stars, v.image_ctr_fcp, v.image_stats_mean, v.image_stats_num_px_sat), (8, -1, -1.0, -1));
        assert!(v.image_eq_ra > 0.0);
        answer.note_outcome(&outcome(Reason::NoMatch), None, true, 0.02);
        assert!(!answer.variables.image_eq_valid);
        assert_eq!((answer.variables.image_ctr_stars, answer.blobs.len()), (7, 2), "its sources were those of the last picture");
    }

    #[test]
    fn camera_and_housekeeping_are_minus_one_or_as_they_were_where_they_are_not_known() {
        let mut answer = Answer::default();
        let camera = Camera {
            next_image_counter: 12.into(),
            gain_db: Some(3.0).into(),
            focus_counts: Some(2800).into(),
            ..Camera::default()
        };
        answer.note_camera(&camera, 61.9);
        let housekeeping = Housekeeping { temperature_plate_c: Some(-20.0).into(), ..Housekeeping::default() };
        answer.note_housekeeping(&housekeeping);
        let v = &answer.variables;
        assert_eq!((v.ctr_stars, v.stars_run_time, v.lens_focus, v.lens_aperture), (12, 61, 2800, -1));
        assert_eq!((v.cam_gain_valid, v.cam_gain_db, v.hk_temp_plate, v.hk_temp_lens), (true, 3.0, -20.0, 100.0));
        answer.note_camera(&Camera::default(), 62.0);
        answer.note_housekeeping(&Housekeeping::default());
        let v = &answer.variables;
        assert_eq!((v.cam_gain_valid, v.cam_gain_db, v.lens_focus, v.hk_temp_plate), (false, 3.0, -1, -20.0));
    }
}
