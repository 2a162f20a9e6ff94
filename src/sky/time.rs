//! Times: UTC as a stamp that may be wrong.

/// How far a clock can be believed, the least first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockQuality {
    /// Nobody set it.
    Unset,
    /// It was set once and runs by itself.
    FreeRunning,
    /// It follows a reference, of which nothing more is known.
    Synchronised,
    /// It is a flight computer's, whose own follows a reference, carried over by what it sends.
    FlightComputer,
    /// It follows NTP servers or a receiver of time signals by way of chrony.
    Chrony,
    /// It follows a clock on the network by PTP.
    Ptp,
}

impl ClockQuality {
    /// Whether it follows a reference of its own.
    pub fn follows(self) -> bool {
        matches!(self, Self::Synchronised | Self::Chrony | Self::Ptp)
    }
}

/// A UTC instant inside the years in which this program can make sense of a clock, 1990 to 2090.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, serde::Serialize, serde::Deserialize)]
pub struct Utc {
    unix_s: f64,
}

/// 1990-01-01 and 2090-01-01 as Unix times: outside, a clock is broken rather than early or late.
const SANE_UNIX_S: std::ops::Range<f64> = 631_152_000.0..3_786_912_000.0;
/// Unix time of J2000.0 (2000-01-01 12:00), leap seconds aside.
const J2000_UNIX_S: f64 = 946_728_000.0;
/// Seconds of a Julian year.
const JULIAN_YEAR_S: f64 = 365.25 * 86_400.0;

impl Utc {
    /// From seconds since 1970; `None` for a clock outside 1990 to 2090 or not a number.
    pub fn from_unix(unix_s: f64) -> Option<Self> {
        SANE_UNIX_S.contains(&unix_s).then_some(Self { unix_s })
    }

    /// From a calendar date and time; `None` where there is no such date or it is outside 1990 to 2090.
    pub fn from_calendar(year: i32, month: u32, day: u32, hour: u32, minute: u32, second: f64) -> Option<Self> {
        let days_in_month = match month {
            2 if year % 4 == 0 && (year % 100 != 0 || year % 400 == 0) => 29,
            2 => 28,
            4 | 6 | 9 | 11 => 30,
            1..=12 => 31,
            _ => return None,
        };
        if !(1..=days_in_month).contains(&day) || hour > 23 || minute > 59 || !(0.0..61.0).contains(&second) {
            return None;
        }
        // Days from the civil calendar, counting years from March (Hinnant, "chrono-compatible low-level date algorithms").
        let y = i64::from(year) - i64::from(month <= 2);
        let era = y.div_euclid(400);
        let year_of_era = y.rem_euclid(400);
        let day_of_year = (153 * ((i64::from(month) + 9) % 12) + 2) / 5 + i64::from(day) - 1;
        let days = era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year - 719_468;
        Self::from_unix(days as f64 * 86_400.0 + f64::from(hour) * 3600.0 + f64::from(minute) * 60.0 + second)
    }

    /// From ISO 8601: `2013-01-01T06:11:24.859`, with or without a fraction or a Z; `None` for anything else.
    pub fn parse(text: &str) -> Option<Self> {
        let (date, time) = text.trim_end_matches('Z').split_once('T')?;
        let mut date = date.splitn(3, '-');
        let mut time = time.splitn(3, ':');
        Self::from_calendar(
            date.next()?.parse().ok()?,
            date.next()?.parse().ok()?,
            date.next()?.parse().ok()?,
            time.next()?.parse().ok()?,
            time.next()?.parse().ok()?,
            time.next()?.parse().ok()?,
        )
    }

    /// Seconds since 1970.
    pub fn unix_s(&self) -> f64 {
        self.unix_s
    }

    /// Julian epoch, years.
    pub fn julian_year(&self) -> f64 {
        2000.0 + (self.unix_s - J2000_UNIX_S) / JULIAN_YEAR_S
    }

    /// Calendar date and time: year, month, day, hour, minute, second.
    pub fn calendar(&self) -> (i64, u32, u32, u32, u32, f64) {
        let days = (self.unix_s / 86_400.0).floor();
        let of_day = self.unix_s - days * 86_400.0;
        let z = days as i64 + 719_468;
        let era = z.div_euclid(146_097);
        let doe = z.rem_euclid(146_097);
        let yoe = (doe - doe / 1460 + doe / 36_524 - doe / 146_096) / 365;
        let doy = doe - (365 * yoe + yoe / 4 - yoe / 100);
        let mp = (5 * doy + 2) / 153;
        let day = (doy - (153 * mp + 2) / 5 + 1) as u32;
        let month = if mp < 10 { mp + 3 } else { mp - 9 } as u32;
        let year = yoe + era * 400 + i64::from(month <= 2);
        let (hour, rest) = ((of_day / 3600.0).floor(), of_day % 3600.0);
        (year, month, day, hour as u32, (rest / 60.0).floor() as u32, rest % 60.0)
    }
}

impl std::fmt::Display for Utc {
    /// ISO 8601 to the millisecond, as in `2013-01-01T06:11:24.859`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        // Rounded first, so that no second reads 60.000.
        let rounded = Self { unix_s: (self.unix_s * 1000.0).round() / 1000.0 };
        let (year, month, day, hour, minute, second) = rounded.calendar();
        write!(f, "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{:06.3}", (second * 1000.0).round() / 1000.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_calendar_is_that_of_a_known_day() {
        let t = Utc::from_calendar(2013, 1, 1, 6, 11, 24.859).unwrap();
        assert!((t.unix_s() - 1_357_020_684.859).abs() < 1e-6);
        assert_eq!(t.to_string(), "2013-01-01T06:11:24.859");
        assert!((t.julian_year() - 2013.0).abs() < 2e-3);
        assert_eq!(Utc::from_calendar(2024, 2, 29, 0, 0, 0.0).unwrap().to_string(), "2024-02-29T00:00:00.000");
    }

    #[test]
    fn mad_clocks_are_refused() {
        assert!(Utc::from_unix(0.0).is_none());
        assert!(Utc::from_unix(f64::NAN).is_none());
        assert!(Utc::from_calendar(2013, 2, 29, 0, 0, 0.0).is_none());
        assert!(Utc::from_calendar(9999, 1, 1, 0, 0, 0.0).is_none());
    }
}
