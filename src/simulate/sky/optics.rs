//! The rendered camera's optics: a lens whose axis does not meet the middle of the sensor.

use crate::sky::{Attitude, CameraModel, Vec3};

/// Projection and radial distortion about an axis that is off the picture's centre.
///
/// The camera frame is that of the picture's centre pixel, as everywhere; the lens has its own, a few arcminutes away.
#[derive(Debug, Clone)]
pub(super) struct Optics {
    /// The lens about its own axis, as if that were the picture's centre.
    lens: CameraModel,
    /// Where the axis meets the picture, offsets from its centre along left and up, px.
    axis: (f64, f64),
    /// The camera frame as seen from the lens's frame.
    mount: Attitude,
}

impl Optics {
    /// A lens whose axis meets the picture `axis` (left, up), px, from the centre.
    pub fn new(lens: CameraModel, axis: (f64, f64)) -> Self {
        let direction = |left: f64, up: f64| {
            let (x, y) = lens.position(left - axis.0, up - axis.1);
            lens.to_direction(x, y)
        };
        let up = direction(0.0, 0.5) - direction(0.0, -0.5);
        let straight = Attitude::from_angles(0.0, std::f64::consts::FRAC_PI_2, 0.0);
        let mount = Attitude::from_boresight_up(&direction(0.0, 0.0), &up).unwrap_or(straight);
        Self { lens, axis, mount }
    }

    /// The picture's size, rows and parity; its plate scale is that of the lens's axis.
    pub fn lens(&self) -> &CameraModel {
        &self.lens
    }

    /// Position in file order, px, of a direction of the camera frame; `None` behind the camera.
    pub fn to_pixel(&self, camera: &Vec3) -> Option<(f64, f64)> {
        let (x, y) = self.lens.to_pixel(&self.mount.to_sky(camera))?;
        let (left, up) = self.lens.offsets(x, y);
        Some(self.lens.position(left + self.axis.0, up + self.axis.1))
    }

    /// Direction in the camera frame of a position in file order, px.
    pub fn to_direction(&self, x: f64, y: f64) -> Vec3 {
        let (left, up) = self.lens.offsets(x, y);
        let (x, y) = self.lens.position(left - self.axis.0, up - self.axis.1);
        self.mount.to_camera(&self.lens.to_direction(x, y))
    }

    /// Plate scale at the picture's centre, rad/px: geometric mean over directions.
    pub fn platescale_at_centre(&self) -> f64 {
        let at = |left: f64, up: f64| {
            let (x, y) = self.lens.position(left, up);
            self.to_direction(x, y)
        };
        let along_x = at(0.5, 0.0) - at(-0.5, 0.0);
        let along_y = at(0.0, 0.5) - at(0.0, -0.5);
        along_x.cross(&along_y).norm().sqrt()
    }

    /// Angle from the centre to the furthest corner, rad, with a little to spare.
    pub fn field_radius(&self) -> f64 {
        let (right, top) = (self.lens.width as f64, self.lens.height as f64);
        let cosine = [(0.0, 0.0), (right, 0.0), (0.0, top), (right, top)]
            .iter()
            .map(|&(x, y)| self.to_direction(x, y).z)
            .fold(1.0, f64::min);
        const SPARE: f64 = 1.02;
        cosine.clamp(-1.0, 1.0).acos() * SPARE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, RowOrder};

    fn optics(rows: RowOrder, mirrored: bool) -> Optics {
        let lens = CameraModel { width: 1536, height: 1024, platescale: 9.5 * ARCSEC, k1: 1.2e-3, rows, mirrored };
        Optics::new(lens, (17.0, -18.0))
    }

    #[test]
    fn the_centre_pixel_is_the_boresight_and_up_is_up() {
        for rows in [RowOrder::BottomFirst, RowOrder::TopFirst] {
            for mirrored in [false, true] {
                let optics = optics(rows, mirrored);
                let (x, y) = optics.to_pixel(&Vec3::z()).unwrap();
                assert!((x - 767.5).abs() < 1e-6 && (y - 511.5).abs() < 1e-6, "{x} {y}");
                let (x, y) = optics.to_pixel(&Vec3::new(0.0, 1e-4, 1.0)).unwrap();
                let (left, up) = optics.lens().offsets(x, y);
                assert!(left.abs() < 1e-5 && up > 1.0, "{left} {up}");
            }
        }
    }

    #[test]
    fn pixels_and_directions_are_inverse() {
        let optics = optics(RowOrder::BottomFirst, false);
        for (x, y) in [(0.0, 0.0), (1535.0, 1023.0), (100.25, 900.5)] {
            let (x2, y2) = optics.to_pixel(&optics.to_direction(x, y)).unwrap();
            assert!((x - x2).abs() < 1e-6 && (y - y2).abs() < 1e-6);
        }
    }

    #[test]
    fn the_plate_scale_at_the_centre_is_nearly_that_of_the_axis() {
        let scale = optics(RowOrder::BottomFirst, false).platescale_at_centre();
        assert!((scale / (9.5 * ARCSEC) - 1.0).abs() < 1e-5);
    }
}
