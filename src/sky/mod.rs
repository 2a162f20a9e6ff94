//! The sky room: angles, directions, the attitude of the camera, how it projects, times and horizontal coordinates.
//!
//! Uses only nalgebra, and sofars behind a fence (`apparent`). Inside, everything is radians and unit vectors in ICRS; conventions are written once, here:
//!
//! * pixels: x = column, y = row in file order, 0-based, centres at integers; the boresight is ((W−1)/2, (H−1)/2);
//! * the camera frame has the axes *left*, *up*, *boresight* of the picture seen with its up direction on top, so that
//!   at roll 0 left is East and up is North ([`Attitude`]);
//! * roll is the position angle of up, from North through East, in (−π, π].

mod angle;
mod apparent;
mod attitude;
mod camera;
mod clocks;
mod horizontal;
mod time;
mod timekeeper;
mod vectors;

pub use angle::{ARCSEC, DEG, HOUR, direction, ra_dec, separation, wrap_pi, wrap_two_pi};
pub use apparent::{Aberration, Refraction, to_equinox_of};
pub use attitude::Attitude;
pub use camera::{CameraModel, RowOrder};
pub use clocks::{ClockComparison, ClockOffset};
pub use horizontal::{Horizontal, Observer, horizontal_of, precess_from_j2000};
pub use time::{ClockQuality, Utc};
pub use timekeeper::{ClockReading, Timekeeper};
pub(crate) use vectors::{Kernel, with_vectors};

/// A direction on the sky or in the camera, a unit vector unless said otherwise.
pub type Vec3 = nalgebra::Vector3<f64>;
/// A 3×3 matrix: a rotation or a covariance.
pub type Mat3 = nalgebra::Matrix3<f64>;
