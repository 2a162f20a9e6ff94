//! Requirements: what a solution must satisfy besides being no chance (stars-paper, "Pattern Matching"; each refuses by its name).

use super::{Prior, Solution};
use crate::settings::{AngleRange, RequirementSettings, Settings};
use crate::sky::{ARCSEC, DEG, Horizontal, Observer, Vec3, direction, precess_from_j2000, separation, wrap_two_pi};

/// A refusal in words: which requirement, its value, its limit.
#[derive(Debug, Clone, PartialEq)]
pub enum Refusal {
    /// The pose is not the one that is wanted.
    Pose(String),
    /// The pose is not known well enough: other sources of the same frame may tell it better.
    Fit(String),
}

/// A circle on the sky that the boresight is expected in.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// The name of the requirement.
    pub name: &'static str,
    /// Its centre, ICRS.
    pub centre: Vec3,
    /// Its radius, rad.
    pub radius: f64,
}

impl Circle {
    /// The part of the sky inside.
    pub fn sky_fraction(&self) -> f64 {
        0.5 * (1.0 - self.radius.min(std::f64::consts::PI).cos())
    }

    /// Whether a direction lies inside.
    pub fn contains(&self, d: &Vec3) -> bool {
        separation(&self.centre, d) < self.radius
    }
}

/// Where the enabled location limits expect the boresight: the flight computer's estimate, or the settings' own centre.
///
/// The horizontal one is left out where latitude or sidereal time are unknown. `julian_year`: epoch of date of the sidereal time.
pub fn expected_circles(
    limits: &RequirementSettings,
    prior: &Prior,
    observer: Option<&Observer>,
    julian_year: Option<f64>,
) -> Vec<Circle> {
    let mut circles = Vec::new();
    let equatorial = &limits.equatorial_location;
    if equatorial.enabled {
        let (ra, dec) = prior.equatorial.unwrap_or((equatorial.ra_deg * DEG, equatorial.dec_deg * DEG));
        circles.push(Circle { name: "equatorial_location", centre: direction(ra, dec), radius: equatorial.radius_deg * DEG });
    }
    let horizontal = &limits.horizontal_location;
    if let (true, Some(observer)) = (horizontal.enabled, observer) {
        let (az, el) = prior.horizontal.unwrap_or((horizontal.az_deg * DEG, horizontal.el_deg * DEG));
        let of_date = observer.direction_of(az, el);
        let centre = julian_year.map_or(of_date, |year| precess_from_j2000(year).transpose() * of_date);
        circles.push(Circle { name: "horizontal_location", centre, radius: horizontal.radius_deg * DEG });
    }
    circles
}

/// Checks everything but the locations, `min_matched` being the fewest matched sources; the first refusal ends it. Requirements on the horizon are skipped where it is unknown.
pub fn check(solution: &Solution, min_matched: usize, settings: &Settings) -> Result<(), Refusal> {
    let limits = &settings.solver.requirements;
    let matching = &settings.solver.matching;
    let (_, _, roll) = solution.attitude.angles();
    in_range("equatorial_roll", roll, &limits.equatorial_roll)?;
    if let Some(horizontal) = &solution.horizontal {
        let Horizontal { elevation, roll, .. } = horizontal.pointing;
        in_range("horizontal_roll", roll, &limits.horizontal_roll)?;
        in_range("elevation", elevation, &limits.elevation)?;
    }
    let platescale = solution.platescale / ARCSEC;
    let (low, high) = (matching.platescale_min_arcsec_px, matching.platescale_max_arcsec_px);
    if !(low..=high).contains(&platescale) {
        return Err(Refusal::Pose(format!("platescale: {platescale:.4}″/px is outside {low} to {high}″/px")));
    }
    let sigmas = solution.sigmas() / ARCSEC;
    let pointing_error = 0.5 * (sigmas.x + sigmas.y);
    if pointing_error.is_nan() || pointing_error > limits.pointing_error_max_arcsec {
        return Err(Refusal::Fit(format!("pointing_error: {pointing_error:.2}″ is above {}″", limits.pointing_error_max_arcsec)));
    }
    if solution.rms_px.is_nan() || solution.rms_px > limits.fit_error_max_px {
        return Err(Refusal::Fit(format!("fit_error: {:.3} px is above {} px", solution.rms_px, limits.fit_error_max_px)));
    }
    if solution.matches.len() < min_matched {
        return Err(Refusal::Fit(format!("min_matched: {} matched, {min_matched} are required", solution.matches.len())));
    }
    Ok(())
}

/// Whether an angle, rad, lies in a range that may wrap: from its lower end upwards to its upper end.
fn in_range(name: &str, angle: f64, range: &AngleRange) -> Result<(), Refusal> {
    if !range.enabled {
        return Ok(());
    }
    let width = (range.max_deg - range.min_deg) * DEG;
    let above = wrap_two_pi(angle - range.min_deg * DEG);
    // The lower end itself may come out a rounding error below a full turn.
    let at_lower_end = std::f64::consts::TAU - above < 1e-12;
    if above <= width || at_lower_end {
        return Ok(());
    }
    Err(Refusal::Pose(format!("{name}: {:.4}° is outside {}° to {}°", angle / DEG, range.min_deg, range.max_deg)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn range(min_deg: f64, max_deg: f64) -> AngleRange {
        AngleRange { enabled: true, min_deg, max_deg }
    }

    #[test]
    fn ranges_hold_at_both_ends_and_wrap() {
        for (angle, min, max, inside) in [
            (4.99, -5.0, 5.0, true),
            (5.01, -5.0, 5.0, false),
            (-4.99, -5.0, 5.0, true),
            (-5.0, -5.0, 5.0, true),
            (-5.01, -5.0, 5.0, false),
            (358.0, -5.0, 5.0, true),
            (179.0, 170.0, 190.0, true),
            (-175.0, 170.0, 190.0, true),
            (-165.0, 170.0, 190.0, false),
            (12.0, -180.0, 180.0, true),
        ] {
            assert_eq!(in_range("roll", angle * DEG, &range(min, max)).is_ok(), inside, "{angle} in {min}..{max}");
        }
    }

    #[test]
    fn a_range_that_is_not_enabled_refuses_nothing() {
        assert!(in_range("roll", 2.0, &AngleRange { enabled: false, ..range(0.0, 1.0) }).is_ok());
    }

    #[test]
    fn a_circle_knows_its_share_of_the_sky() {
        let circle = |radius| Circle { name: "x", centre: Vec3::z(), radius };
        assert!((circle(90.0 * DEG).sky_fraction() - 0.5).abs() < 1e-12);
        assert!((circle(180.0 * DEG).sky_fraction() - 1.0).abs() < 1e-12);
        assert!(circle(0.1).contains(&direction(1.0, 90.0 * DEG - 0.0999)));
        assert!(!circle(0.1).contains(&direction(1.0, 90.0 * DEG - 0.1001)));
    }
}
