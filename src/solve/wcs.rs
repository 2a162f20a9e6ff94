//! Where an image points, in keywords that any program for images of the sky understands.

#![allow(clippy::indexing_slicing, reason = "matrices of a fixed size, indexed by the terms of one polynomial")]

use super::fit::Pose;
use super::{Outcome, Solution};
use crate::image::Keyword;
use crate::sky::{ARCSEC, DEG};
use nalgebra::{SMatrix, SVector};

/// Highest power of an offset in the polynomial: one of radial distortion and its inverse has the third and the fifth.
const ORDER: usize = 5;
/// Its terms, powers along right and up, from the second order on.
const TERMS: [(usize, usize); 18] = [
    (2, 0),
    (1, 1),
    (0, 2),
    (3, 0),
    (2, 1),
    (1, 2),
    (0, 3),
    (4, 0),
    (3, 1),
    (2, 2),
    (1, 3),
    (0, 4),
    (5, 0),
    (4, 1),
    (3, 2),
    (2, 3),
    (1, 4),
    (0, 5),
];
/// Points along each side at which the polynomial is fitted.
const POINTS: u32 = 13;

/// What an outcome has to say of its image, as keywords for a file whose first row is the bottom one: how it ended and, where it was
/// solved, the world coordinates (FITS 4.0, § 8; distortion as a SIP polynomial: Shupe et al. 2005, ASP Conf. Ser. 347, 491), σ, and
/// what a false match would take. `width` and `height` in pixels; `mirrored`: optics turn the picture over.
pub fn keywords(outcome: &Outcome, (width, height): (usize, usize), mirrored: bool) -> Vec<Keyword> {
    let mut keywords = vec![Keyword::new("OUTCOME", outcome.reason.to_string().as_str(), "how its solving ended")];
    if let Some(cause) = outcome.cause {
        keywords.push(Keyword::new("CAUSE", cause.to_string().as_str(), "what was wrong with it"));
    }
    if let Some(solution) = &outcome.solution {
        keywords.extend(world(solution, (width, height), mirrored));
    }
    keywords
}

fn world(solution: &Solution, (width, height): (usize, usize), mirrored: bool) -> Vec<Keyword> {
    let (ra, dec, roll) = solution.attitude.angles();
    let scale = solution.platescale / DEG;
    let left = if mirrored { scale } else { -scale };
    let sigma = |axis: usize| solution.covariance[(axis, axis)].max(0.0).sqrt() / ARCSEC;
    let mut keywords = vec![
        Keyword::new("WCSAXES", 2_i64, "axes of the world coordinates"),
        Keyword::new("CTYPE1", "RA---TAN-SIP", "gnomonic, with distortion"),
        Keyword::new("CTYPE2", "DEC--TAN-SIP", "gnomonic, with distortion"),
        Keyword::new("CUNIT1", "deg", "unit of CRVAL1 and CD1_i"),
        Keyword::new("CUNIT2", "deg", "unit of CRVAL2 and CD2_i"),
        Keyword::new("RADESYS", "ICRS", "axes of the world coordinates"),
        Keyword::new("CRPIX1", (width as f64 + 1.0) / 2.0, "[pixel] centre, the boresight"),
        Keyword::new("CRPIX2", (height as f64 + 1.0) / 2.0, "[pixel] centre, the boresight"),
        Keyword::new("CRVAL1", ra / DEG, "[deg] right ascension of the boresight"),
        Keyword::new("CRVAL2", dec / DEG, "[deg] declination of the boresight"),
        Keyword::new("CD1_1", left * roll.cos(), "[deg/pixel] east for each pixel right"),
        Keyword::new("CD1_2", scale * roll.sin(), "[deg/pixel] east for each pixel up"),
        Keyword::new("CD2_1", -left * roll.sin(), "[deg/pixel] north for each pixel right"),
        Keyword::new("CD2_2", scale * roll.cos(), "[deg/pixel] north for each pixel up"),
    ];
    keywords.extend(distortion(solution, (width, height), mirrored));
    keywords.extend([
        Keyword::new("ROLL", roll / DEG, "[deg] position angle of up, from north by east"),
        Keyword::new("PLTSCALE", solution.platescale / ARCSEC, "[arcsec/pixel] at the centre"),
        Keyword::new("SIGEAST", sigma(0), "[arcsec] one sigma of the boresight east"),
        Keyword::new("SIGNORTH", sigma(1), "[arcsec] one sigma of the boresight north"),
        Keyword::new("SIGROLL", sigma(2), "[arcsec] one sigma of the roll"),
        Keyword::new("MATCHED", solution.matches.len() as i64, "stars matched"),
        Keyword::new("RMSPIX", solution.rms_px, "[pixel] residual of a star, rms per axis"),
        Keyword::new("FALSELOG", solution.false_probability_log10, "log10 of the bound on its being false"),
    ]);
    keywords
}

/// The polynomial that takes offsets in the picture to those of an ideal lens, fitted over the picture to what the pose says.
fn distortion(solution: &Solution, (width, height): (usize, usize), mirrored: bool) -> Vec<Keyword> {
    let half_diagonal = 0.5 * (width as f64).hypot(height as f64);
    let pose = Pose { attitude: solution.attitude, platescale: solution.platescale, k1: solution.k1, axis: solution.axis };
    let side = if mirrored { 1.0 } else { -1.0 };
    let mut normal = SMatrix::<f64, 18, 18>::zeros();
    let mut right_hand = [SVector::<f64, 18>::zeros(); 2];
    let place = |i: u32, side: usize| (f64::from(i) / f64::from(POINTS - 1) - 0.5) * side as f64;
    for (i, j) in (0..POINTS).flat_map(|i| (0..POINTS).map(move |j| (i, j))) {
        let (right, up) = (place(i, width), place(j, height));
        let (left_ideal, up_ideal) = pose.without_lens(side * right, up, half_diagonal);
        let (x, y) = (right / half_diagonal, up / half_diagonal);
        let terms = SVector::<f64, 18>::from_fn(|k, _| x.powi(TERMS[k].0 as i32) * y.powi(TERMS[k].1 as i32));
        normal += terms * terms.transpose();
        right_hand[0] += terms * (side * left_ideal - right);
        right_hand[1] += terms * (up_ideal - up);
    }
    let mut keywords = Vec::new();
    // A grid of more points on a side than powers leaves no doubt of any term.
    let Some(factor) = normal.cholesky() else { return keywords };
    for (name, right_hand) in ["A", "B"].into_iter().zip(&right_hand) {
        let fitted = factor.solve(right_hand);
        keywords.push(Keyword::new(format!("{name}_ORDER"), ORDER as i64, "highest order of the distortion"));
        for (k, (p, q)) in TERMS.into_iter().enumerate() {
            let value = fitted[k] / half_diagonal.powi((p + q) as i32);
            keywords.push(Keyword::new(format!("{name}_{p}_{q}"), value, "distortion"));
        }
    }
    keywords
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{KeywordValue, Stamp};
    use crate::sky::{Attitude, Mat3, Vec3, direction};
    use crate::solve::Reason;
    use std::collections::BTreeMap;

    /// The direction of a pixel, counted from 1, as the standards say it follows from the keywords.
    fn sky(keywords: &BTreeMap<String, f64>, x: f64, y: f64) -> Vec3 {
        let of = |name: &str| keywords.get(name).copied().unwrap_or(0.0);
        let (right, up) = (x - of("CRPIX1"), y - of("CRPIX2"));
        let distortion = |name: &str| -> f64 {
            let terms = (0..=5_i32).flat_map(|p| (0..=5_i32 - p).map(move |q| (p, q)));
            terms.map(|(p, q)| of(&format!("{name}_{p}_{q}")) * right.powi(p) * up.powi(q)).sum()
        };
        let (right, up) = (right + distortion("A"), up + distortion("B"));
        let xi = (of("CD1_1") * right + of("CD1_2") * up) * DEG;
        let eta = (of("CD2_1") * right + of("CD2_2") * up) * DEG;
        let (ra, dec) = (of("CRVAL1") * DEG, of("CRVAL2") * DEG);
        let centre = direction(ra, dec);
        let east = direction(ra + std::f64::consts::FRAC_PI_2, 0.0);
        (centre + east * xi + centre.cross(&east) * eta).normalize()
    }

    #[test]
    fn the_keywords_place_each_pixel_where_the_solution_does() {
        let (width, height) = (1536, 1024);
        let half_diagonal = 0.5 * 1536_f64.hypot(1024.0);
        for (mirrored, k1, axis) in [(false, 0.0, (0.0, 0.0)), (false, 1.2e-3, (20.0, -14.0)), (true, -3e-3, (-8.0, 25.0))] {
            let attitude = Attitude::from_angles(4.0, -0.9, 2.2);
            let solution = Solution {
                attitude,
                platescale: 9.5 * ARCSEC,
                k1,
                axis,
                covariance: Mat3::identity(),
                sigma_platescale: 0.0,
                rms_px: 0.1,
                chi2_per_dof: 1.0,
                matches: Vec::new(),
                false_probability_log10: -9.0,
                horizontal: None,
                epoch_yr: None,
                start: None,
                served: None,
            };
            let outcome = Outcome { solution: Some(solution), ..Outcome::unsolved(Stamp::default(), Reason::Solved, "") };
            let numbers = keywords(&outcome, (width, height), mirrored).into_iter().filter_map(|keyword| match keyword.value {
                KeywordValue::Real(value) => Some((keyword.name, value)),
                _ => None,
            });
            let numbers: BTreeMap<String, f64> = numbers.collect();
            let pose = Pose { attitude, platescale: 9.5 * ARCSEC, k1, axis };
            for (x, y) in [(1.0, 1.0), (1536.0, 1024.0), (768.5, 512.5), (1.0, 1024.0), (300.0, 900.0)] {
                let seen = pose.project(&sky(&numbers, x, y), half_diagonal).unwrap();
                let right = x - 768.5;
                let wanted = (if mirrored { right } else { -right }, y - 512.5);
                let off = (seen.0 - wanted.0).hypot(seen.1 - wanted.1);
                assert!(off < 2e-3, "{off} px at {x}, {y}, mirrored {mirrored}");
            }
        }
    }

    #[test]
    fn an_image_that_was_not_solved_says_why_and_has_no_coordinates() {
        let outcome = Outcome::unsolved(Stamp::default(), Reason::NoMatch, "");
        let keywords = keywords(&outcome, (10, 10), false);
        assert_eq!(keywords, [Keyword::new("OUTCOME", "no_match", "how its solving ended")]);
    }
}
