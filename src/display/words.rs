//! Words and angles as people write them.

use crate::sky::{DEG, HOUR, wrap_two_pi};
use crate::solve::Outcome;

/// The reason by its name in JSON, with the cause where there is one: `no_match (trailed)`.
pub fn reason(outcome: &Outcome) -> String {
    match outcome.cause {
        Some(cause) => format!("{} ({cause})", outcome.reason),
        None => outcome.reason.to_string(),
    }
}

/// Right ascension, rad, as hours, minutes and seconds to 0.01 s: `09h06m15.50s`.
pub fn hms(ra: f64) -> String {
    const HUNDREDTHS_OF_A_DAY: u64 = 24 * 360_000;
    // Rounded first, so that no second reads 60.00.
    let hundredths = (wrap_two_pi(ra) / HOUR * 360_000.0).round() as u64 % HUNDREDTHS_OF_A_DAY;
    let (hours, minutes, rest) = (hundredths / 360_000, hundredths / 6_000 % 60, hundredths % 6_000);
    format!("{hours:02}h{minutes:02}m{:02}.{:02}s", rest / 100, rest % 100)
}

/// Declination, rad, as degrees, minutes and seconds to 0.1″: `-43°58′04.2″`.
pub fn dms(dec: f64) -> String {
    let tenths = (dec.abs() / DEG * 36_000.0).round() as u64;
    let (degrees, minutes, rest) = (tenths / 36_000, tenths / 600 % 60, tenths % 600);
    let sign = if dec < 0.0 { '-' } else { '+' };
    format!("{sign}{degrees:02}°{minutes:02}′{:02}.{}″", rest / 10, rest % 10)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_read_as_astronomers_write_them() {
        assert_eq!(hms(136.564602 * DEG), "09h06m15.50s");
        assert_eq!(dms(-43.967823 * DEG), "-43°58′04.2″");
        assert_eq!(dms(0.0), "+00°00′00.0″");
    }

    #[test]
    fn no_part_of_an_angle_reads_sixty() {
        assert_eq!(hms(-1e-9), "00h00m00.00s");
        assert_eq!(hms((1.0 - 1e-8) * HOUR), "01h00m00.00s");
        assert_eq!(dms(-(10.0 - 1e-7) * DEG), "-10°00′00.0″");
    }
}
