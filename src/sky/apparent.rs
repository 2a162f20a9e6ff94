//! Apparent places: where the sky seems to be from the moving Earth, on axes of date, and through the air.
//!
//! The fence around `sofars`, routines derived from the IAU's SOFA: it panics on dates far outside this century and on what is no
//! number. Dates come as [`Utc`], which is refused outside 1990 to 2090; directions are unit vectors, and what comes out is checked.

use super::{Mat3, Utc, Vec3};

/// Terrestrial time ahead of UTC, s: 37 leap seconds (since 2017) and 32.184 s. Earlier years had a few less, which is 0.1 mas here.
const TT_AHEAD_S: f64 = 69.184;
/// Julian date of 1970-01-01, as the two parts that keep their digits.
const UNIX_EPOCH_JD: (f64, f64) = (2_400_000.5, 40_587.0);
const DAY_S: f64 = 86_400.0;
/// Speed of light, au a day (IAU 2012: 299 792 458 m/s · 86 400 s / 149 597 870 700 m).
const LIGHT_AU_DAY: f64 = 299_792.458 * DAY_S / 149_597_870.7;

/// Terrestrial time as a Julian date in two parts; barycentric dynamical time is within 2 ms of it.
fn terrestrial(utc: Utc) -> (f64, f64) {
    (UNIX_EPOCH_JD.0, UNIX_EPOCH_JD.1 + (utc.unix_s() + TT_AHEAD_S) / DAY_S)
}

/// How the Earth moves at a moment, for annual aberration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aberration {
    /// Barycentric velocity, ICRS, in units of the speed of light.
    velocity: Vec3,
    /// Distance from the Sun, au.
    sun_distance: f64,
}

impl Aberration {
    /// At a moment. (SOFA's `epv00`, good to 5 mm/s.)
    pub fn at(utc: Utc) -> Option<Self> {
        let (day, part) = terrestrial(utc);
        let ([heliocentric, _], [_, velocity]) = sofars::eph::epv00(day, part)?;
        let this = Self { velocity: Vec3::from(velocity) / LIGHT_AU_DAY, sun_distance: Vec3::from(heliocentric).norm() };
        // The Earth's speed is 1e-4 of light's.
        (this.velocity.norm() < 2e-4 && this.sun_distance > 0.5).then_some(this)
    }

    /// Where a direction, ICRS, is seen: up to 20.6″ nearer to where the Earth goes. (SOFA's `ab`.)
    pub fn seen(&self, direction: &Vec3) -> Vec3 {
        let inverse_lorentz = (1.0 - self.velocity.norm_squared()).sqrt();
        let seen = sofars::astro::ab(&(*direction).into(), &self.velocity.into(), self.sun_distance, inverse_lorentz);
        Vec3::from(seen)
    }
}

/// Rotation from ICRS to the true equator and equinox of a moment: frame bias, precession and nutation, IAU 2006/2000A. (SOFA's `pnm06a`.)
pub fn to_equinox_of(utc: Utc) -> Mat3 {
    let (day, part) = terrestrial(utc);
    Mat3::from(sofars::pnp::pnm06a(day, part)).transpose()
}

/// How the air bends light: ΔZ = A tan Z + B tan³ Z, Z the zenith distance as observed. (SOFA's `refco`, good to 0.01″ at Z = 45°, to 1″
/// at 80°, for the whole air above the observer.)
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refraction {
    a: f64,
    b: f64,
}

/// Wavelength, µm: that of a red-sensitive camera.
const WAVELENGTH_UM: f64 = 0.65;
/// cos Z below which the formula is not followed further (SOFA's own choice in `atioq`: Z = 87°).
const LOWEST_COS: f64 = 0.05;

impl Refraction {
    /// In dry air of a pressure, hPa, and temperature, °C, at the observer.
    pub fn new(pressure_hpa: f64, temperature_c: f64) -> Self {
        let (a, b) = sofars::astro::refco(pressure_hpa, temperature_c, 0.0, WAVELENGTH_UM);
        Self { a, b }
    }

    /// Where a direction is seen, with the zenith in the same axes, both unit vectors: nearer to the zenith.
    pub fn seen(&self, direction: &Vec3, zenith: &Vec3) -> Vec3 {
        let (cos, across) = (direction.dot(zenith), direction - zenith * direction.dot(zenith));
        let Some(outward) = across.try_normalize(1e-12) else { return *direction };
        let distance = across.norm().atan2(cos);
        let furthest = LOWEST_COS.acos();
        let mut seen = distance;
        // Each round is nearer by the change of the bending over itself, a thousandth or less but near the horizon.
        for _ in 0..5 {
            let tan = seen.clamp(0.0, furthest).tan();
            seen = distance - (self.a * tan + self.b * tan.powi(3));
        }
        zenith * seen.cos() + outward * seen.sin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{ARCSEC, DEG, direction, precess_from_j2000, ra_dec, separation};

    #[test]
    fn aberration_is_that_of_the_published_test_of_sofa() {
        // `t_ab` of SOFA's t_sofa_c.c.
        let aberration = Aberration {
            velocity: Vec3::new(2.104_401_889_365_378_6e-5, -8.910_892_330_442_932e-5, -3.863_371_479_771_657e-5),
            sun_distance: 0.999_809_213_957_087_9,
        };
        let seen = aberration.seen(&Vec3::new(-0.763_219_685_467_379_5, -0.608_694_539_830_603_8, -0.216_764_085_806_398_83));
        let wanted = Vec3::new(-0.763_163_109_421_955_6, -0.608_755_308_250_559_1, -0.216_792_626_936_847_13);
        assert!((seen - wanted).norm() < 1e-11, "{}", (seen - wanted).norm());
    }

    #[test]
    fn the_earths_velocity_is_that_of_the_published_test_of_sofa() {
        // `t_epv00` at MJD 53411.52501161 (TDB): barycentric velocity, au a day.
        let utc = Utc::from_unix((53_411.525_011_61 - 40_587.0) * DAY_S - TT_AHEAD_S).unwrap();
        let aberration = Aberration::at(utc).unwrap();
        let wanted = Vec3::new(-0.010_918_742_681_168_233, -0.012_465_254_617_328_615, -0.005_404_773_180_966_231);
        // A Unix time in seconds keeps 0.2 µs.
        assert!(
            (aberration.velocity * LIGHT_AU_DAY - wanted).norm() < 1e-9 * wanted.norm(),
            "{:?}",
            aberration.velocity * LIGHT_AU_DAY
        );
    }

    #[test]
    fn the_matrix_of_date_is_that_of_the_published_test_of_sofa() {
        // `t_pnm06a` at MJD 50123.9999 (TT).
        let utc = Utc::from_unix((50_123.999_9 - 40_587.0) * DAY_S - TT_AHEAD_S).unwrap();
        let wanted = Mat3::new(
            0.999_999_583_279_420_5,
            0.837_238_277_263_096_2e-3,
            0.363_968_477_114_062_3e-3,
            -0.837_253_374_474_368_4e-3,
            0.999_999_648_649_286_2,
            0.413_290_594_461_102e-4,
            -0.363_933_746_962_946_5e-3,
            -0.416_337_760_591_066_4e-4,
            0.999_999_932_909_426,
        );
        assert!((to_equinox_of(utc) - wanted).norm() < 1e-10, "{}", to_equinox_of(utc) - wanted);
    }

    #[test]
    fn the_matrix_of_date_is_precession_but_for_nutation() {
        let utc = Utc::from_calendar(2030, 6, 1, 0, 0, 0.0).unwrap();
        let star = direction(2.0, -0.7);
        let apart = separation(&(to_equinox_of(utc) * star), &(precess_from_j2000(utc.julian_year()) * star));
        assert!(apart < 20.0 * ARCSEC, "{}", apart / ARCSEC);
    }

    #[test]
    fn aberration_turns_round_with_the_year_and_is_never_more_than_21_arcseconds() {
        let star = direction(1.0, 0.2);
        let shift = |month| {
            let seen = Aberration::at(Utc::from_calendar(2013, month, 1, 0, 0, 0.0).unwrap()).unwrap().seen(&star);
            let ((ra, dec), (ra_0, dec_0)) = (ra_dec(&seen), ra_dec(&star));
            ((ra - ra_0) * dec_0.cos() / ARCSEC, (dec - dec_0) / ARCSEC)
        };
        let (january, july) = (shift(1), shift(7));
        assert!((january.0 + july.0).hypot(january.1 + july.1) < 1.0, "{january:?} {july:?}");
        assert!((1..=12).all(|month| shift(month).0.hypot(shift(month).1) < 21.0));
    }

    #[test]
    fn no_clock_that_is_a_clock_breaks_it() {
        for unix_s in [631_152_000.0, 1e9, 3_786_911_999.0] {
            let utc = Utc::from_unix(unix_s).unwrap();
            let star = direction(1.0, 0.2);
            assert!(separation(&Aberration::at(utc).unwrap().seen(&star), &star) < 21.0 * ARCSEC);
            assert!(separation(&(to_equinox_of(utc) * star), &star) < 2.0 * DEG);
        }
    }

    #[test]
    fn refraction_has_the_constants_of_the_published_test_of_sofa() {
        // `t_refco`: 800 hPa, 10 °C, humidity 0.9, 0.4 µm.
        let (a, b) = sofars::astro::refco(800.0, 10.0, 0.9, 0.4);
        assert!((a - 0.226_494_995_624_141_5e-3).abs() < 1e-15 && (b + 0.259_865_826_172_934_3e-6).abs() < 1e-18);
    }

    #[test]
    fn refraction_lifts_by_an_arcminute_at_45_degrees_and_by_nothing_in_the_zenith() {
        let (zenith, air) = (Vec3::z(), Refraction::new(1010.0, 10.0));
        let lift = |elevation_deg: f64| {
            let star = direction(0.3, elevation_deg * DEG);
            let seen = air.seen(&star, &zenith);
            assert!((seen.norm() - 1.0).abs() < 1e-12 && (ra_dec(&seen).0 - 0.3).abs() < 1e-9);
            (ra_dec(&seen).1 / DEG - elevation_deg) * 3600.0
        };
        // Allen, Astrophysical Quantities: R = 58.2″ at 45° (10 °C, 1010 hPa); Saemundsson's formula has 5.3′ at 10°.
        assert!((lift(45.0) - 58.2).abs() < 1.0, "{}", lift(45.0));
        assert!((lift(10.0) - 318.0).abs() < 6.0, "{}", lift(10.0));
        assert_eq!(air.seen(&zenith, &zenith), zenith);
        for elevation in [-90.0, -30.0, 0.0, 1.0] {
            assert!(lift(elevation).is_finite());
        }
        let none = Refraction::new(0.0, 10.0);
        assert!((none.seen(&direction(0.3, 0.2), &zenith) - direction(0.3, 0.2)).norm() < 1e-12);
    }
}
