//! A served pointing beside the truth of a simulation: how far off, whether its own errors cover that, and whether it is wrong.

use crate::sky::{ARCSEC, Attitude, separation, wrap_pi};
use crate::solve::PointingReport;
use crate::wire::{Equatorial, SeriesStart};

/// A solution within this many σ is covered by its own errors: 98.9 % of a sound Gaussian in two dimensions are.
pub const COVERED_SIGMA: f64 = 3.0;
/// A solution is wrong beyond this many σ, where that is more than the limits below.
const WRONG_SIGMA: f64 = 6.0;
/// A solution is not wrong within this distance: 5″, and 60″ where a pixel is over 20″.
const NEVER_WRONG_ARCSEC: (f64, f64) = (5.0, 60.0);
/// The plate scale that parts the two.
const COARSE_ARCSEC_PX: f64 = 20.0;

/// How a pointing compares with the truth. All in arcsec.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Judged {
    /// Distance of the boresights on the sky.
    pub error: f64,
    /// One σ of the boresight, mean of the two axes.
    pub sigma: f64,
    /// Difference of the rolls, after the boresight's own turn is taken out.
    pub roll_error: f64,
    /// One σ of the roll.
    pub roll_sigma: f64,
    /// Plate scale, arcsec/px.
    platescale: f64,
}

impl Judged {
    /// Compares a pointing with the truth; `None` where there is no pointing.
    pub fn new(pointing: &PointingReport, truth: &Attitude) -> Option<Self> {
        let (ra, dec, roll) = (pointing.ra_deg?.to_radians(), pointing.dec_deg?.to_radians(), pointing.roll_deg?.to_radians());
        let served = Attitude::from_angles(ra, dec, roll);
        // Seen along the true boresight, so that meridians that converge near a pole are no error of the roll.
        let up = truth.to_camera(&served.up());
        Some(Self {
            error: separation(&served.boresight(), &truth.boresight()) / ARCSEC,
            sigma: pointing.sigma_east_arcsec?.hypot(pointing.sigma_north_arcsec?) / std::f64::consts::SQRT_2,
            roll_error: wrap_pi(up.x.atan2(up.y)) / ARCSEC,
            roll_sigma: pointing.sigma_roll_arcsec?,
            platescale: pointing.platescale_arcsec_px?,
        })
    }

    /// Compares a pointing as it came over the wire with the truth; `None` where it is incomplete.
    pub fn served(pointing: &Equatorial, truth: &Attitude) -> Option<Self> {
        let report = PointingReport {
            ra_deg: Some(pointing.ra_deg),
            dec_deg: Some(pointing.dec_deg),
            roll_deg: Some(pointing.roll_deg),
            sigma_east_arcsec: Some(pointing.sigma_east_arcsec),
            sigma_north_arcsec: Some(pointing.sigma_north_arcsec),
            sigma_roll_arcsec: Some(pointing.sigma_roll_arcsec),
            platescale_arcsec_px: Some(pointing.platescale_arcsec_px),
            ..PointingReport::default()
        };
        Self::new(&report, truth)
    }

    /// Compares the start of a series as it came over the wire with the truth; `pointing` is that of the same image.
    pub fn start(start: &SeriesStart, pointing: &Equatorial, truth: &Attitude) -> Option<Self> {
        let at_start = Equatorial {
            ra_deg: start.start_ra_deg,
            dec_deg: start.start_dec_deg,
            roll_deg: start.start_roll_deg,
            sigma_east_arcsec: start.start_sigma_east_arcsec,
            sigma_north_arcsec: start.start_sigma_north_arcsec,
            ..*pointing
        };
        Self::served(&at_start, truth)
    }

    /// Whether the pointing's own errors cover how far it is off.
    pub fn is_covered(&self) -> bool {
        self.error <= COVERED_SIGMA * self.sigma
    }

    /// Whether it should never have been served.
    pub fn is_wrong(&self) -> bool {
        let (fine, coarse) = NEVER_WRONG_ARCSEC;
        let limit = if self.platescale > COARSE_ARCSEC_PX { coarse } else { fine };
        self.error > limit.max(WRONG_SIGMA * self.sigma)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::DEG;

    fn pointing(ra_deg: f64, dec_deg: f64, roll_deg: f64) -> PointingReport {
        PointingReport {
            ra_deg: Some(ra_deg),
            dec_deg: Some(dec_deg),
            roll_deg: Some(roll_deg),
            sigma_east_arcsec: Some(0.5),
            sigma_north_arcsec: Some(0.5),
            sigma_roll_arcsec: Some(10.0),
            platescale_arcsec_px: Some(9.5),
            ..PointingReport::default()
        }
    }

    #[test]
    fn errors_are_distances_on_the_sky_and_turns_about_the_boresight() {
        let truth = Attitude::from_angles(40.0 * DEG, 60.0 * DEG, 10.0 * DEG);
        let judged = Judged::new(&pointing(40.0 + 2.0 / 3600.0, 60.0, 10.0), &truth).unwrap();
        assert!((judged.error - 1.0).abs() < 1e-6, "{}", judged.error);
        assert!(judged.is_covered() && !judged.is_wrong());
        let judged = Judged::new(&pointing(40.0, 60.0, 10.0 + 30.0 / 3600.0), &truth).unwrap();
        assert!(judged.error < 1e-6 && (judged.roll_error.abs() - 30.0).abs() < 1e-3, "{}", judged.roll_error);
    }

    #[test]
    fn beyond_five_arcsec_and_six_sigma_it_is_wrong() {
        let truth = Attitude::from_angles(40.0 * DEG, 0.0, 0.0);
        let off = |arcsec: f64, sigma: f64, platescale: f64| {
            let pointing = PointingReport {
                sigma_east_arcsec: Some(sigma),
                sigma_north_arcsec: Some(sigma),
                platescale_arcsec_px: Some(platescale),
                ..pointing(40.0, arcsec / 3600.0, 0.0)
            };
            Judged::new(&pointing, &truth).unwrap().is_wrong()
        };
        assert!(!off(4.9, 0.1, 9.5) && off(5.1, 0.1, 9.5));
        assert!(!off(5.9, 1.0, 9.5) && off(6.1, 1.0, 9.5));
        assert!(!off(59.0, 1.0, 40.0) && off(61.0, 1.0, 40.0));
        assert_eq!(Judged::new(&PointingReport::default(), &truth), None);
    }
}
