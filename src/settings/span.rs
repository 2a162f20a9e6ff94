//! Spans of time as people write them: `11d`, `40s`, `250ms`.

use std::time::Duration;

/// Units in seconds.
const UNITS: [(&str, f64); 6] = [("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("min", 60.0), ("h", 3600.0), ("d", 86_400.0)];
/// Longest span that is understood, s: about 30,000 years, far inside what `Duration` holds.
const LONGEST_S: f64 = 1e12;

/// Reads a span of time such as `11d`, `12h`, `30m`, `40s`, `1.5s` or `250ms`.
///
/// # Errors
/// What was expected, where the text is none.
pub fn parse_span(text: &str) -> Result<Duration, String> {
    let wrong = || format!("'{text}' is no span of time, expected a number with ms, s, m, h or d, such as 250ms, 40s or 11d");
    let digits = text.trim_end_matches(|c: char| c.is_ascii_lowercase());
    let unit = text.get(digits.len()..).unwrap_or_default();
    let (_, seconds) = UNITS.into_iter().find(|(name, _)| *name == unit).ok_or_else(wrong)?;
    if !digits.chars().all(|c| c.is_ascii_digit() || c == '.') {
        return Err(wrong());
    }
    let total = digits.parse::<f64>().map_err(|_| wrong())? * seconds;
    if total <= LONGEST_S { Ok(Duration::from_secs_f64(total)) } else { Err(wrong()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_read_like_people_write_them() {
        for (text, seconds) in
            [("11d", 950_400.0), ("2h", 7200.0), ("10min", 600.0), ("3m", 180.0), ("40s", 40.0), ("250ms", 0.25), ("1.5s", 1.5)]
        {
            assert_eq!(parse_span(text).unwrap().as_secs_f64(), seconds, "{text}");
        }
    }

    #[test]
    fn anything_else_is_refused_with_an_example() {
        for text in ["", "5", "s", "-5s", "5 s", "5y", "1e400d", "nans", "infs", "9999999999999d", "1.2.3s", "5S", "é"] {
            let error = parse_span(text).unwrap_err();
            assert!(error.contains("such as 250ms"), "{text}: {error}");
        }
    }
}
