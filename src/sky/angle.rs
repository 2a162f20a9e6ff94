//! Angles and directions.

use super::Vec3;
use std::f64::consts::{PI, TAU};

/// One degree in radians.
pub const DEG: f64 = PI / 180.0;
/// One arcsecond in radians.
pub const ARCSEC: f64 = DEG / 3600.0;
/// One hour of right ascension or sidereal time in radians.
pub const HOUR: f64 = 15.0 * DEG;

/// The same angle in (−π, π].
pub fn wrap_pi(angle: f64) -> f64 {
    let wrapped = wrap_two_pi(angle);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// The same angle in [0, 2π).
pub fn wrap_two_pi(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(TAU);
    // `rem_euclid` of a tiny negative angle rounds up to the modulus itself.
    if wrapped >= TAU { 0.0 } else { wrapped }
}

/// Unit vector towards a longitude (right ascension) and latitude (declination), rad.
pub fn direction(ra: f64, dec: f64) -> Vec3 {
    let (sin_ra, cos_ra) = ra.sin_cos();
    let (sin_dec, cos_dec) = dec.sin_cos();
    Vec3::new(cos_dec * cos_ra, cos_dec * sin_ra, sin_dec)
}

/// Longitude in [0, 2π) and latitude of a direction of any length, rad.
pub fn ra_dec(v: &Vec3) -> (f64, f64) {
    (wrap_two_pi(v.y.atan2(v.x)), v.z.atan2(v.x.hypot(v.y)))
}

/// Angle between two directions, rad; exact from zero to π (an arc cosine loses arcseconds near both).
pub fn separation(a: &Vec3, b: &Vec3) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_wrap_into_their_half_open_ranges() {
        assert_eq!(wrap_pi(PI), PI);
        assert!((wrap_pi(-PI) - PI).abs() < 1e-15);
        assert!((wrap_pi(3.0 * PI + 0.1) - (-PI + 0.1)).abs() < 1e-12);
        assert_eq!(wrap_two_pi(-1e-20), 0.0);
        assert_eq!(wrap_two_pi(TAU), 0.0);
    }

    #[test]
    fn small_separations_keep_their_digits() {
        let a = direction(1.0, 0.5);
        let b = direction(1.0, 0.5 + 0.01 * ARCSEC);
        assert!((separation(&a, &b) / (0.01 * ARCSEC) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn directions_come_back_as_angles() {
        for (ra, dec) in [(0.0, 0.0), (3.0, 1.2), (6.2, -1.5)] {
            let (ra2, dec2) = ra_dec(&direction(ra, dec));
            assert!((ra - ra2).abs() < 1e-12 && (dec - dec2).abs() < 1e-12);
        }
    }
}
