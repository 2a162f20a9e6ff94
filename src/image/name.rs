//! What an image file's name says: when it was captured, and which part of a series it is.

use crate::sky::Utc;

/// The capture time in a file's name.
///
/// A name may begin like the flight's, `2012-12-30--08-27-56--625` (milliseconds last), or contain a time like
/// `2019-07-29T204726`. Folders before the name are ignored. `None` where there is neither or it is no date.
pub fn time_in_name(name: &str) -> Option<Utc> {
    let name = name.rsplit('/').next()?.as_bytes();
    let flight = numbers(name, b"####-##-##--##-##-##--###");
    flight.or_else(|| (0..name.len()).find_map(|start| numbers(name.get(start..)?, b"####-##-##T######")))
}

/// The time at the start of a text, where it has the shape of a pattern in which `#` is a digit.
fn numbers(text: &[u8], pattern: &[u8]) -> Option<Utc> {
    let text = text.get(..pattern.len())?;
    let fits = |(&c, &p): (&u8, &u8)| if p == b'#' { c.is_ascii_digit() } else { c == p };
    if !text.iter().zip(pattern).all(fits) {
        return None;
    }
    let mut digits = text.iter().filter(|c| c.is_ascii_digit()).map(|c| u32::from(c - b'0'));
    let mut take = |n| digits.by_ref().take(n).fold(0, |number, digit| number * 10 + digit);
    let (year, month, day) = (take(4), take(2), take(2));
    let (hour, minute, second, millisecond) = (take(2), take(2), take(2), take(3));
    let second = f64::from(second) + f64::from(millisecond) / 1000.0;
    Utc::from_calendar(i32::try_from(year).ok()?, month, day, hour, minute, second)
}

/// Stem and part of a file of a series of exposures: `2013-01-01--06-11-24--859_p0.fits` is part 0 of
/// `2013-01-01--06-11-24--859`. The stem keeps its folder. `None` for an image that stands alone.
pub fn series_stem(name: &str) -> Option<(&str, u32)> {
    let file = name.rfind('/').map_or(0, |slash| slash + 1);
    let (at, _) = name.rmatch_indices("_p").find(|&(at, _)| at > file && part_at(name, at).is_some())?;
    Some((name.get(..at)?, part_at(name, at)?))
}

/// The number after `_p`, which ends the name or stands before its extension.
fn part_at(name: &str, at: usize) -> Option<u32> {
    let (part, after) = name.get(at + 2..).map(|rest| rest.split_at(rest.bytes().take_while(u8::is_ascii_digit).count()))?;
    (after.is_empty() || after.starts_with('.')).then(|| part.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_found_in_the_names_of_the_flight_and_of_the_night_images() {
        let time = |name| time_in_name(name).map(|time| time.to_string());
        assert_eq!(time("2012-12-30--08-27-56--625_p1.fits").as_deref(), Some("2012-12-30T08:27:56.625"));
        assert_eq!(time("2012-12-30/2012-12-30--08-27-56--625.fits").as_deref(), Some("2012-12-30T08:27:56.625"));
        assert_eq!(time("2019-07-29T204726_Alt40_Azi-135_Try1.tiff").as_deref(), Some("2019-07-29T20:47:26.000"));
        assert_eq!(time("night 2019-07-29T204726.png").as_deref(), Some("2019-07-29T20:47:26.000"));
    }

    #[test]
    fn names_without_a_time_or_with_an_impossible_one_give_none() {
        for name in [
            "",
            "dark.fits",
            "2012-13-30--08-27-56--625.fits",
            "2012-12-30--08-27-56",
            "2019-07-29T254726.tiff",
            "x/",
            "é2019-07",
        ] {
            assert_eq!(time_in_name(name), None, "{name}");
        }
    }

    #[test]
    fn parts_of_a_series_share_their_stem() {
        assert_eq!(series_stem("2013-01-01--06-11-24--859_p0.fits"), Some(("2013-01-01--06-11-24--859", 0)));
        assert_eq!(series_stem("2013/a_p3.fits.gz"), Some(("2013/a", 3)));
        assert_eq!(series_stem("a_p1_p2.fits"), Some(("a_p1", 2)));
        for alone in ["a.fits", "a_p.fits", "a_px.fits", "a_p1x.fits", "_p1.fits", "dir_p1/a.fits", "a_p99999999999.fits", ""] {
            assert_eq!(series_stem(alone), None, "{alone}");
        }
    }
}
