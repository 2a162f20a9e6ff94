//! Horizontal coordinates: azimuth from north through east, elevation up, roll from the zenith towards growing azimuth.

use super::{ARCSEC, Attitude, Mat3, Vec3, wrap_pi, wrap_two_pi};

/// Where the observer stands and how far the sky has turned.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Observer {
    /// Geodetic latitude, rad, north positive.
    pub latitude: f64,
    /// Local sidereal time, rad.
    pub sidereal_time: f64,
}

/// A pointing in horizontal coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Horizontal {
    /// Azimuth from north through east, rad, in [0, 2π).
    pub azimuth: f64,
    /// Elevation, rad.
    pub elevation: f64,
    /// Angle of the picture's up direction from the zenith, positive towards growing azimuth, rad, in (−π, π].
    pub roll: f64,
}

/// How fast sidereal time runs, rad/s: one turn in a mean sidereal day of 86 164.0905 s (IERS Conventions 2010, table 1.1).
const SIDEREAL_RATE: f64 = std::f64::consts::TAU / 86_164.090_5;

impl Observer {
    /// The same place when `seconds` have gone by.
    pub fn after(&self, seconds: f64) -> Self {
        Self { latitude: self.latitude, sidereal_time: wrap_two_pi(self.sidereal_time + SIDEREAL_RATE * seconds) }
    }

    /// Axes north, east, zenith of the local horizon in the equatorial frame of date.
    fn horizon(&self) -> [Vec3; 3] {
        let (sin_lst, cos_lst) = self.sidereal_time.sin_cos();
        let (sin_lat, cos_lat) = self.latitude.sin_cos();
        [
            Vec3::new(-sin_lat * cos_lst, -sin_lat * sin_lst, cos_lat),
            Vec3::new(-sin_lst, cos_lst, 0.0),
            Vec3::new(cos_lat * cos_lst, cos_lat * sin_lst, sin_lat),
        ]
    }

    /// Unit vector, in the equatorial frame of date, towards an azimuth and elevation, rad.
    pub fn direction_of(&self, azimuth: f64, elevation: f64) -> Vec3 {
        let [north, east, zenith] = self.horizon();
        (north * azimuth.cos() + east * azimuth.sin()) * elevation.cos() + zenith * elevation.sin()
    }
}

/// The horizontal pointing of an attitude for an observer.
///
/// `julian_year`: the epoch of date that ICRS is precessed to, because sidereal time is of date; `None` takes ICRS as it is.
pub fn horizontal_of(attitude: &Attitude, observer: &Observer, julian_year: Option<f64>) -> Horizontal {
    let precession = julian_year.map_or_else(Mat3::identity, precess_from_j2000);
    let boresight = precession * attitude.boresight();
    let up = precession * attitude.up();
    let [north, east, zenith] = observer.horizon();
    let (b_north, b_east, b_zenith) = (boresight.dot(&north), boresight.dot(&east), boresight.dot(&zenith));
    let azimuth = wrap_two_pi(b_east.atan2(b_north));
    let elevation = b_zenith.atan2(b_north.hypot(b_east));
    // Towards growing azimuth, and towards the zenith, at the boresight.
    let along = -north * azimuth.sin() + east * azimuth.cos();
    let upward = zenith * elevation.cos() - (north * azimuth.cos() + east * azimuth.sin()) * elevation.sin();
    Horizontal { azimuth, elevation, roll: wrap_pi(up.dot(&along).atan2(up.dot(&upward))) }
}

/// Precession matrix from J2000 to a Julian epoch.
///
/// IAU 2006 equatorial angles ζ, z, θ (Capitaine, Wallace and Chapront 2003, A&A 412, 567, eq. 40, first three terms);
/// good to 0.01″ within a century. Nutation (under 20″) is left out, and said to be.
pub fn precess_from_j2000(julian_year: f64) -> Mat3 {
    let t = (julian_year - 2000.0) / 100.0;
    let zeta = (2.650_545 + t * (2_306.083_227 + t * (0.298_849_9 + t * 0.018_018_28))) * ARCSEC;
    let z = (-2.650_545 + t * (2_306.077_181 + t * (1.092_734_8 + t * 0.018_268_37))) * ARCSEC;
    let theta = t * (2_004.191_903 + t * (-0.429_493_4 - t * 0.041_822_64)) * ARCSEC;
    let about_z = |angle: f64| {
        let (s, c) = angle.sin_cos();
        Mat3::new(c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0)
    };
    let (s, c) = theta.sin_cos();
    let about_y = Mat3::new(c, 0.0, -s, 0.0, 1.0, 0.0, s, 0.0, c);
    about_z(-z) * about_y * about_z(-zeta)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{DEG, HOUR, direction, ra_dec, separation};

    #[test]
    fn the_flight_images_have_the_horizontal_pointing_of_their_reference() {
        // Reference solutions of the two flight images, without precession.
        let cases = [
            ((136.564602, -43.967823, 165.25276), (-76.9389955, 12.2452777777778), (301.268, 51.904, -0.823)),
            ((117.879916, -42.590657, 179.81838), (-77.4288695, 8.01361111111111), (357.005, 55.149, -0.704)),
        ];
        for ((ra, dec, roll), (lat, lst), (az, el, h_roll)) in cases {
            let attitude = Attitude::from_angles(ra * DEG, dec * DEG, roll * DEG);
            let observer = Observer { latitude: lat * DEG, sidereal_time: lst * HOUR };
            let h = horizontal_of(&attitude, &observer, None);
            assert!((h.azimuth / DEG - az).abs() < 2e-3, "{}", h.azimuth / DEG);
            assert!((h.elevation / DEG - el).abs() < 2e-3, "{}", h.elevation / DEG);
            assert!((h.roll / DEG - h_roll).abs() < 5e-3, "{}", h.roll / DEG);
            assert!(separation(&observer.direction_of(h.azimuth, h.elevation), &attitude.boresight()) < 1e-9);
        }
    }

    #[test]
    fn a_sidereal_day_later_the_sky_is_back() {
        let observer = Observer { latitude: -1.3, sidereal_time: 6.1 };
        assert!((observer.after(86_164.090_5).sidereal_time - 6.1).abs() < 1e-12);
        assert!((observer.after(3600.0).sidereal_time - wrap_two_pi(6.1 + 15.041_068_64 * DEG)).abs() < 1e-8);
    }

    #[test]
    fn precession_moves_the_equinox_by_fifty_arcseconds_a_year() {
        let (ra, dec) = ra_dec(&(precess_from_j2000(2050.0) * direction(0.0, 0.0)));
        assert!((ra / ARCSEC / 50.0 - 46.12).abs() < 0.05, "{}", ra / ARCSEC / 50.0);
        assert!((dec / ARCSEC / 50.0 - 20.04).abs() < 0.05);
    }
}
