//! What is served of a pointing where corrections are asked for: as seen from the moving Earth, on axes of date, against the horizon.
//!
//! The solver works with the catalogue's places throughout. A correction moves all of a picture's stars nearly alike, so it is a turn and
//! a stretch of the whole, which is found from a grid over the picture.

use super::fit::{FitPrior, Pair, Pose, fit, sky_jacobian};
use super::solver::Context;
use super::{HorizontalSolution, Solution};
use crate::settings::FitSettings;
use crate::sky::{Aberration, Attitude, Mat3, Refraction, Vec3, horizontal_of, precess_from_j2000, to_equinox_of};
use std::f64::consts::FRAC_PI_2;

/// A pointing with the corrections that were asked for and could be had.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Served {
    /// Attitude on the axes that were asked for.
    pub attitude: Attitude,
    /// Covariance on the sky at the boresight on those axes: east, north, roll, rad².
    pub covariance: Mat3,
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// Epoch of the equator and equinox that the axes are of, Julian year; `None` for ICRS.
    pub equinox_yr: Option<f64>,
    /// Whether the stars were put where they are seen from the moving Earth.
    pub aberration: bool,
}

/// What is served of a solution; `None` where no correction was asked for, or none could be had, for want of a date.
pub fn served(context: &Context<'_>, solution: &Solution, settings: &FitSettings) -> Option<Served> {
    let (utc, _) = context.frame.stamp.captured?;
    let seen = aberrated(context, solution, settings);
    if seen.is_none() && !settings.precession {
        return None;
    }
    let pose = seen.unwrap_or_else(|| pose_of(solution));
    let attitude = if settings.precession {
        let matrix = to_equinox_of(utc);
        Attitude::from_boresight_up(&(matrix * pose.attitude.boresight()), &(matrix * pose.attitude.up()))?
    } else {
        pose.attitude
    };
    let turn = sky_jacobian(&attitude) * sky_jacobian(&solution.attitude).try_inverse()?;
    let covariance = turn * solution.covariance * turn.transpose();
    Some(Served {
        attitude,
        covariance: (covariance + covariance.transpose()) * 0.5,
        platescale: pose.platescale,
        equinox_yr: settings.precession.then(|| utc.julian_year()),
        aberration: seen.is_some(),
    })
}

/// A solution against the horizon, where the observer is known; with the aberration and refraction that were asked for.
pub fn horizontal(context: &Context<'_>, solution: &Solution, settings: &FitSettings) -> Option<HorizontalSolution> {
    let observer = context.observer?;
    let mut pose = aberrated(context, solution, settings).unwrap_or_else(|| pose_of(solution));
    let mut refracted = false;
    if settings.refraction {
        let air = Refraction::new(settings.pressure_hpa, settings.temperature_c);
        let zenith = observer.direction_of(0.0, FRAC_PI_2);
        let zenith = context.year.map_or(zenith, |year| precess_from_j2000(year).transpose() * zenith);
        if let Some(seen) = as_seen(context, &pose, |star| air.seen(star, &zenith)) {
            (pose, refracted) = (seen, true);
        }
    }
    let pointing = horizontal_of(&pose.attitude, &observer, context.year);
    // The horizontal axes at the boresight are the equatorial ones turned by the difference of the two rolls.
    let (_, _, roll) = solution.attitude.angles();
    let (sin, cos) = (roll + pointing.roll).sin_cos();
    let c = &solution.covariance;
    let (east, north, both) = (c[(0, 0)], c[(1, 1)], c[(0, 1)]);
    let along = cos * cos * east + sin * sin * north - 2.0 * sin * cos * both;
    let upward = sin * sin * east + cos * cos * north + 2.0 * sin * cos * both;
    Some(HorizontalSolution {
        pointing,
        sigma: (along.max(0.0).sqrt(), upward.max(0.0).sqrt()),
        observer,
        equinox_yr: context.year,
        refracted,
    })
}

/// The pose among stars that are where they are seen from the moving Earth, where that was asked for and the date is known.
fn aberrated(context: &Context<'_>, solution: &Solution, settings: &FitSettings) -> Option<Pose> {
    let (utc, _) = context.frame.stamp.captured.filter(|_| settings.aberration)?;
    let aberration = Aberration::at(utc)?;
    as_seen(context, &pose_of(solution), |star| aberration.seen(star))
}

fn pose_of(solution: &Solution) -> Pose {
    Pose { attitude: solution.attitude, platescale: solution.platescale, k1: solution.k1, axis: solution.axis }
}

/// The pose that puts the picture where a pose puts it, when every direction is `moved`.
fn as_seen(context: &Context<'_>, pose: &Pose, moved: impl Fn(&Vec3) -> Vec3) -> Option<Pose> {
    /// Places of the grid along each side, from border to border.
    const ALONG: [f64; 5] = [-0.5, -0.25, 0.0, 0.25, 0.5];
    /// So sure are the places of the grid, px, that the fit's prior does not count.
    const SIGMA_PX: f64 = 1e-3;
    let (geometry, s) = (&context.geometry, pose.platescale);
    let places = ALONG.iter().flat_map(|x| ALONG.iter().map(move |y| (x * geometry.size.0, y * geometry.size.1)));
    let pairs: Option<Vec<Pair>> = places
        .map(|(left, up)| {
            let direction = pose.attitude.to_sky(&Vec3::new(left * s, up * s, 1.0).normalize());
            let (left, up) = pose.project(&direction, geometry.half_diagonal)?;
            Some(Pair::round(left, up, SIGMA_PX, moved(&direction)))
        })
        .collect();
    // The lens stays as it is.
    let prior =
        FitPrior { platescale: s, sigma_ln_platescale: 1.0, k1: pose.k1, sigma_k1: 1e-9, axis: pose.axis, sigma_axis_px: 1e-6 };
    Some(fit(&pairs?, pose, geometry.half_diagonal, &prior)?.pose)
}
