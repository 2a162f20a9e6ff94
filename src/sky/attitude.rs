//! The attitude: how the camera frame is turned against ICRS.

use super::{Mat3, Vec3, direction, ra_dec, wrap_pi};
use std::f64::consts::FRAC_PI_2;

/// Rotation from the camera frame (left, up, boresight) to ICRS.
///
/// Always a proper rotation: the constructors take angles or re-orthonormalise, because nalgebra's conversions from
/// a matrix may hang on one that is not (its issues 1099, 1529, 1583).
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Attitude {
    /// Columns: left, up, boresight in ICRS.
    axes: Mat3,
}

impl Attitude {
    /// From the boresight's right ascension and declination and the roll, rad.
    pub fn from_angles(ra: f64, dec: f64, roll: f64) -> Self {
        let boresight = direction(ra, dec);
        let east = direction(ra + FRAC_PI_2, 0.0);
        let north = boresight.cross(&east);
        let (sin, cos) = roll.sin_cos();
        let left = east * cos - north * sin;
        let up = east * sin + north * cos;
        Self { axes: Mat3::from_columns(&[left, up, boresight]) }
    }

    /// From a boresight and an up direction, neither need be of unit length nor at right angles.
    ///
    /// `None` where the two are parallel or not finite.
    pub fn from_boresight_up(boresight: &Vec3, up: &Vec3) -> Option<Self> {
        let b = boresight.try_normalize(f64::MIN_POSITIVE)?;
        let u = (up - b * b.dot(up)).try_normalize(1e-12)?;
        if !(b + u).iter().all(|c| c.is_finite()) {
            return None;
        }
        Some(Self { axes: Mat3::from_columns(&[u.cross(&b), u, b]) })
    }

    /// Boresight, unit vector in ICRS.
    pub fn boresight(&self) -> Vec3 {
        self.axes.column(2).into()
    }

    /// The picture's up direction, unit vector in ICRS.
    pub fn up(&self) -> Vec3 {
        self.axes.column(1).into()
    }

    /// The picture's left direction, unit vector in ICRS.
    pub fn left(&self) -> Vec3 {
        self.axes.column(0).into()
    }

    /// Right ascension in [0, 2π), declination, and roll in (−π, π], rad.
    pub fn angles(&self) -> (f64, f64, f64) {
        let (ra, dec) = ra_dec(&self.boresight());
        let east = direction(ra + FRAC_PI_2, 0.0);
        let north = self.boresight().cross(&east);
        let up = self.up();
        (ra, dec, wrap_pi(up.dot(&east).atan2(up.dot(&north))))
    }

    /// A direction of the camera frame in ICRS.
    pub fn to_sky(&self, camera: &Vec3) -> Vec3 {
        self.axes * camera
    }

    /// An ICRS direction in the camera frame.
    pub fn to_camera(&self, sky: &Vec3) -> Vec3 {
        self.axes.tr_mul(sky)
    }

    /// The attitude turned by a rotation vector given in the camera frame (left, up, boresight), rad.
    pub fn turned(&self, rotation: &Vec3) -> Self {
        // Rodrigues' formula; sines of a library, so that they are the same on any machine.
        let angle = rotation.norm();
        let half = libm::sin(0.5 * angle);
        let (sine, cosine) =
            if angle > 0.0 { (libm::sin(angle) / angle, 2.0 * (half / angle) * (half / angle)) } else { (1.0, 0.5) };
        let turn = |v: Vec3| v + rotation.cross(&v) * sine + rotation.cross(&rotation.cross(&v)) * cosine;
        let (boresight, up) = (turn(Vec3::z()), turn(Vec3::y()));
        Self::from_boresight_up(&self.to_sky(&boresight), &self.to_sky(&up)).unwrap_or(*self)
    }

    /// The turn that leads to another attitude, as [`Self::turned`] takes it; of less than a right angle.
    pub fn turn_to(&self, other: &Self) -> Vec3 {
        let seen = |axis: Vec3, of_other: Vec3| axis.cross(&self.to_camera(&of_other));
        let twice = seen(Vec3::x(), other.left()) + seen(Vec3::y(), other.up()) + seen(Vec3::z(), other.boresight());
        let sine = 0.5 * twice.norm();
        if sine > 0.0 { twice * (0.5 * libm::asin(sine.min(1.0)) / sine) } else { Vec3::zeros() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{DEG, separation};

    #[test]
    fn angles_come_back() {
        for &(ra, dec, roll) in &[(10.0, 20.0, 30.0), (359.0, -80.0, -170.0), (120.0, 0.0, 180.0), (1.0, 89.9, 12.0)] {
            let (r, d, p) = Attitude::from_angles(ra * DEG, dec * DEG, roll * DEG).angles();
            assert!((r / DEG - ra).abs() < 1e-9 && (d / DEG - dec).abs() < 1e-9 && (p / DEG - roll).abs() < 1e-9);
        }
    }

    #[test]
    fn up_at_roll_ninety_is_east() {
        let attitude = Attitude::from_angles(1.0, 0.3, FRAC_PI_2);
        assert!(separation(&attitude.up(), &direction(1.0 + FRAC_PI_2, 0.0)) < 1e-12);
    }

    #[test]
    fn camera_and_sky_are_inverse_and_right_handed() {
        let attitude = Attitude::from_angles(2.0, -0.7, 0.4);
        let v = Vec3::new(0.1, -0.2, 0.97);
        assert!((attitude.to_camera(&attitude.to_sky(&v)) - v).norm() < 1e-14);
        assert!((attitude.left().cross(&attitude.up()) - attitude.boresight()).norm() < 1e-14);
    }

    #[test]
    fn the_turn_to_another_attitude_leads_there() {
        let attitude = Attitude::from_angles(2.0, -0.7, 0.4);
        for turn in [Vec3::new(0.3, -0.2, 0.9), Vec3::new(1e-7, 2e-9, -3e-8), Vec3::zeros()] {
            assert!((attitude.turn_to(&attitude.turned(&turn)) - turn).norm() < 1e-12 + 1e-9 * turn.norm());
        }
    }

    #[test]
    fn degenerate_axes_are_refused() {
        assert!(Attitude::from_boresight_up(&Vec3::z(), &Vec3::z()).is_none());
        assert!(Attitude::from_boresight_up(&Vec3::zeros(), &Vec3::z()).is_none());
        assert!(Attitude::from_boresight_up(&Vec3::new(f64::NAN, 0.0, 1.0), &Vec3::x()).is_none());
    }
}
