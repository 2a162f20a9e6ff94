//! The camera model: from pixels to directions of the camera frame and back.

use super::Vec3;

/// Which end of the picture the first row of a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowOrder {
    /// The first row is the bottom one: FITS.
    BottomFirst,
    /// The first row is the top one: TIFF, PNG, JPEG.
    TopFirst,
}

impl RowOrder {
    /// A row of a picture with so many, in file order, counted from the bottom instead; or one from the bottom in file order. `None` for
    /// one that is not in it.
    pub fn from_bottom(self, row: usize, height: usize) -> Option<usize> {
        let from_the_other_end = height.checked_sub(1)?.checked_sub(row)?;
        Some(if self == Self::BottomFirst { row } else { from_the_other_end })
    }
}

/// Gnomonic projection with a plate scale and one term of radial distortion.
///
/// An ideal point at distance r_u from the centre, px, is seen at r_d = r_u (1 + k1 (r_u / R)²), R the half diagonal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Plate scale at the centre, rad/px.
    pub platescale: f64,
    /// Radial distortion at the half diagonal, dimensionless.
    pub k1: f64,
    /// Which end of the picture the first row is.
    pub rows: RowOrder,
    /// Optics turn the picture over.
    pub mirrored: bool,
}

impl CameraModel {
    /// Half the diagonal, px.
    pub fn half_diagonal_px(&self) -> f64 {
        0.5 * (self.width as f64).hypot(self.height as f64)
    }

    /// Pixel offsets from the centre along left and up, px, for a position in file order.
    pub fn offsets(&self, x: f64, y: f64) -> (f64, f64) {
        let right = x - (self.width as f64 - 1.0) / 2.0;
        let down_file = y - (self.height as f64 - 1.0) / 2.0;
        (if self.mirrored { right } else { -right }, if self.rows == RowOrder::BottomFirst { down_file } else { -down_file })
    }

    /// The position in file order of offsets along left and up, px: the inverse of [`Self::offsets`].
    pub fn position(&self, left: f64, up: f64) -> (f64, f64) {
        let right = if self.mirrored { left } else { -left };
        let down_file = if self.rows == RowOrder::BottomFirst { up } else { -up };
        (right + (self.width as f64 - 1.0) / 2.0, down_file + (self.height as f64 - 1.0) / 2.0)
    }

    /// Unit vector in the camera frame of a position in file order, px.
    pub fn to_direction(&self, x: f64, y: f64) -> Vec3 {
        let (left, up) = self.offsets(x, y);
        let undistort = 1.0 / self.distortion_at_distorted(left, up);
        Vec3::new(left * undistort * self.platescale, up * undistort * self.platescale, 1.0).normalize()
    }

    /// Position in file order, px, of a direction in the camera frame; `None` behind the camera.
    pub fn to_pixel(&self, camera: &Vec3) -> Option<(f64, f64)> {
        if camera.z <= 0.0 {
            return None;
        }
        let left = camera.x / camera.z / self.platescale;
        let up = camera.y / camera.z / self.platescale;
        let stretch = 1.0 + self.k1 * (left * left + up * up) / self.half_diagonal_px().powi(2);
        Some(self.position(left * stretch, up * stretch))
    }

    /// Whether a position in file order lies on the picture, `margin` px inside its border.
    pub fn contains(&self, x: f64, y: f64, margin: f64) -> bool {
        x >= margin && y >= margin && x <= self.width as f64 - 1.0 - margin && y <= self.height as f64 - 1.0 - margin
    }

    /// r_d / r_u at a distorted offset, by fixed-point iteration (k1 is a few parts in a thousand, each step gains two digits).
    fn distortion_at_distorted(&self, left: f64, up: f64) -> f64 {
        const STEPS: usize = 6;
        let relative_sq = (left * left + up * up) / self.half_diagonal_px().powi(2);
        let mut stretch = 1.0;
        for _ in 0..STEPS {
            stretch = 1.0 + self.k1 * relative_sq / (stretch * stretch);
        }
        stretch
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, Attitude, DEG, direction};

    fn model(rows: RowOrder, mirrored: bool, k1: f64) -> CameraModel {
        CameraModel { width: 1536, height: 1024, platescale: 9.5 * ARCSEC, k1, rows, mirrored }
    }

    #[test]
    fn pixels_and_directions_are_inverse() {
        for rows in [RowOrder::BottomFirst, RowOrder::TopFirst] {
            for mirrored in [false, true] {
                let camera = model(rows, mirrored, -2e-3);
                for (x, y) in [(0.0, 0.0), (767.5, 511.5), (1535.0, 3.0), (20.25, 1000.5)] {
                    let (x2, y2) = camera.to_pixel(&camera.to_direction(x, y)).unwrap();
                    assert!((x - x2).abs() < 1e-6 && (y - y2).abs() < 1e-6);
                }
            }
        }
    }

    #[test]
    fn the_written_convention_of_roll_holds() {
        // ξ (east) = s(−X cos R + Y sin R), η (north) = s(X sin R + Y cos R), X right and Y up of a FITS picture.
        let camera = model(RowOrder::BottomFirst, false, 0.0);
        let (ra, dec, roll) = (1.0, -0.6, 40.0 * DEG);
        let attitude = Attitude::from_angles(ra, dec, roll);
        let (right, up) = (300.0, 120.0);
        let sky = attitude.to_sky(&camera.to_direction(767.5 + right, 511.5 + up));
        let east = direction(ra + std::f64::consts::FRAC_PI_2, 0.0);
        let north = attitude.boresight().cross(&east);
        let depth = sky.dot(&attitude.boresight());
        let s = camera.platescale;
        assert!((sky.dot(&east) / depth - s * (-right * roll.cos() + up * roll.sin())).abs() < 1e-12);
        assert!((sky.dot(&north) / depth - s * (right * roll.sin() + up * roll.cos())).abs() < 1e-12);
    }

    #[test]
    fn nothing_is_seen_behind_the_camera() {
        assert!(model(RowOrder::TopFirst, false, 0.0).to_pixel(&Vec3::new(0.0, 0.1, -1.0)).is_none());
    }
}
