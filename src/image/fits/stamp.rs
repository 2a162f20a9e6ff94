//! The stamp in a header's keywords.
//!
//! Ours have at most 8 letters. The flight's files say `UNKNOWN` in the comment of a value that was not known, and have
//! −1 in its place; a keyword that cannot be read is unknown too, for an image must not be lost by its stamp.

use super::header::{Card, Header};
use crate::image::{ImageCounter, Stamp, TriggerCounter};
use crate::sky::{ClockQuality, DEG, HOUR, Observer, Utc};

/// What a header says of its image. The origin is left empty.
pub(super) fn from_header(header: &Header) -> Stamp {
    let known = |keywords: &[&str]| keywords.iter().find_map(|keyword| header.card(keyword).filter(is_known));
    let integer = |keywords: &[&str]| known(keywords)?.integer();
    let exposure_s = known(&["EXPTIME", "EXPOSURE"]).and_then(|card| card.number()).filter(|&s| s >= 0.0);
    Stamp {
        image: integer(&["IMGCTR", "COUNTER_STARS", "CT_STARS", "FRAMENUM"])
            .and_then(|n| u32::try_from(n).ok())
            .map_or_else(ImageCounter::default, ImageCounter),
        trigger: integer(&["TRIGCTR", "COUNTER_FCP", "CT_MCP"]).and_then(|n| u32::try_from(n).ok()).map(TriggerCounter),
        origin: String::new(),
        captured: captured(header, exposure_s),
        exposure_s,
        exposures: integer(&["NEXP"]).and_then(|n| u8::try_from(n).ok()).unwrap_or(1).max(1),
        // Other programs' GAIN is a setting of their camera without a unit.
        gain_db: known(&["GAIN"]).filter(|card| card.comment.to_ascii_uppercase().contains("DB")).and_then(|card| card.number()),
        focus_counts: integer(&["FOCUS"]).and_then(|n| i32::try_from(n).ok()),
        aperture_counts: integer(&["APERTURE"]).and_then(|n| i32::try_from(n).ok()),
        observer: observer(known(&["APPROX_LAT", "APRX_LAT", "LAT"]), known(&["APPROX_LST", "APRX_LST", "LST"])),
        simulated: header.card("SIMULATE").is_some_and(|card| card.value == "T"),
    }
}

/// Neither marked as unknown nor a bare −1.
fn is_known(card: &Card) -> bool {
    let marked = card.comment.to_ascii_uppercase().contains("UNKNOWN");
    let bare = card.comment.is_empty() && card.number() == Some(-1.0);
    !(marked || bare)
}

/// Latitude in degrees (in hours where the comment says so, which happened) and sidereal time in hours.
fn observer(latitude: Option<Card>, sidereal_time: Option<Card>) -> Option<Observer> {
    let latitude = latitude?;
    let unit = if latitude.comment.to_ascii_uppercase().contains("HOURS") { HOUR } else { DEG };
    let latitude = latitude.number().map(|v| v * unit).filter(|v| v.abs() <= 90.0 * DEG)?;
    let sidereal_time = sidereal_time?.number().filter(|v| (0.0..=24.0).contains(v))? * HOUR;
    Some(Observer { latitude, sidereal_time })
}

/// Middle of the exposure: `DATE-AVG`, or the start `DATE-OBS` and half an exposure.
fn captured(header: &Header, exposure_s: Option<f64>) -> Option<(Utc, ClockQuality)> {
    let quality = match header.text("CLOCK").as_deref() {
        Some("synchronised") => ClockQuality::Synchronised,
        Some("unset") => ClockQuality::Unset,
        _ => ClockQuality::FreeRunning,
    };
    let middle = header.text("DATE-AVG").and_then(|text| iso(&text));
    let from_start = || {
        let start = header.text("DATE-OBS").and_then(|text| iso(&text))?;
        Utc::from_unix(start.unix_s() + exposure_s.unwrap_or(0.0) / 2.0)
    };
    Some((middle.or_else(from_start)?, quality))
}

/// `2013-01-01T06:11:24.859`, with or without a fraction or a Z.
fn iso(text: &str) -> Option<Utc> {
    let (date, time) = text.trim_end_matches('Z').split_once('T')?;
    let mut date = date.splitn(3, '-');
    let mut time = time.splitn(3, ':');
    Utc::from_calendar(
        date.next()?.parse().ok()?,
        date.next()?.parse().ok()?,
        date.next()?.parse().ok()?,
        time.next()?.parse().ok()?,
        time.next()?.parse().ok()?,
        time.next()?.parse().ok()?,
    )
}
