//! The stamp in a header's keywords.
//!
//! What we write has at most 8 letters, and a value that is not known is left out. The flight's files say `UNKNOWN` in the comment of a value that was not known, and have
//! −1 in its place; a keyword that cannot be read is unknown too, for an image must not be lost by its stamp.

use super::header::{Card, Header};
use super::write::Cards;
use crate::image::{ExposedBy, ImageCounter, Stamp, TriggerCounter};
use crate::sky::{ClockQuality, DEG, HOUR, Observer, Utc};

/// What `EXPBY` says of what made the camera expose.
const EXPOSED_BY: [(ExposedBy, &str); 3] =
    [(ExposedBy::Asked, "asked"), (ExposedBy::Trigger, "trigger"), (ExposedBy::Itself, "itself")];

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
        captured_sigma_s: known(&["CLKSIGMA"]).and_then(|card| card.number()).filter(|&s| s >= 0.0),
        uptime_s: known(&["UPTIME"]).and_then(|card| card.number()),
        exposed_by: header.text("EXPBY").and_then(|word| EXPOSED_BY.iter().find(|(_, name)| *name == word).map(|(by, _)| *by)),
        exposure_s,
        exposures: integer(&["NEXP"]).and_then(|n| u8::try_from(n).ok()).unwrap_or(1).max(1),
        part: integer(&["EXPNO"]).and_then(|n| u8::try_from(n).ok()),
        // Other programs' GAIN is a setting of their camera without a unit.
        gain_db: known(&["GAIN"]).filter(|card| card.comment.to_ascii_uppercase().contains("DB")).and_then(|card| card.number()),
        focus_counts: integer(&["FOCUS"]).and_then(|n| i32::try_from(n).ok()),
        aperture_counts: integer(&["APERTURE"]).and_then(|n| i32::try_from(n).ok()),
        temperature_camera_c: known(&["CCD-TEMP"]).and_then(|card| card.number()),
        temperature_lens_c: known(&["LENSTEMP"]).and_then(|card| card.number()),
        observer: observer(known(&["APPROX_LAT", "APRX_LAT", "LAT"]), known(&["APPROX_LST", "APRX_LST", "LST"])),
        simulated: header.card("SIMULATE").is_some_and(|card| card.value == "T"),
        missing_packets: integer(&["PKTLOST"]).and_then(|n| u32::try_from(n).ok()).unwrap_or(0),
        missed_frames: integer(&["IMGLOST"]).and_then(|n| u32::try_from(n).ok()).unwrap_or(0),
    }
}

/// Writes what is known of an image. Angles are in degrees and hours, as in the flight's files.
pub(super) fn to_cards(stamp: &Stamp, cards: &mut Cards) {
    cards.text("FRAMEID", &stamp.origin, "where the image came from");
    cards.integer("IMGCTR", stamp.image.0, "number of the image");
    if let Some(trigger) = stamp.trigger {
        cards.integer("TRIGCTR", trigger.0, "number of its series of triggers");
    }
    if let Some((_, name)) = EXPOSED_BY.iter().find(|(by, _)| stamp.exposed_by == Some(*by)) {
        cards.text("EXPBY", name, "what made the camera expose");
    }
    if let Some((middle, quality)) = stamp.captured {
        cards.text("TIMESYS", "UTC", "time scale of the dates");
        let start = Utc::from_unix(middle.unix_s() - stamp.exposure_s.unwrap_or(0.0) / 2.0);
        if let Some(start) = start {
            cards.text("DATE-OBS", &microseconds(start), "start of the exposure");
        }
        cards.text("DATE-AVG", &microseconds(middle), "middle of the exposure");
        if let Some((_, name)) = CLOCKS.iter().find(|(of, _)| *of == quality) {
            cards.text("CLOCK", name, "quality of the clock");
        }
        if let Some(sigma) = stamp.captured_sigma_s {
            cards.real("CLKSIGMA", sigma, "[s] one sigma of the dates");
        }
    }
    if let Some(uptime) = stamp.uptime_s {
        cards.real("UPTIME", uptime, "[s] middle, since the program's start");
    }
    if let Some(exposure) = stamp.exposure_s {
        cards.real("EXPTIME", exposure, "[s] one exposure");
    }
    cards.integer("NEXP", stamp.exposures.max(1), "exposures added up");
    if let Some(part) = stamp.part {
        cards.integer("EXPNO", part, "its place among the exposures of its series");
    }
    if let Some(gain) = stamp.gain_db {
        cards.real("GAIN", gain, "[dB] gain of the camera");
    }
    if let Some(focus) = stamp.focus_counts {
        cards.integer("FOCUS", focus, "[count] focus position");
    }
    if let Some(aperture) = stamp.aperture_counts {
        cards.integer("APERTURE", aperture, "[count] aperture position, 0 is open");
    }
    if let Some(celsius) = stamp.temperature_camera_c {
        cards.real("CCD-TEMP", celsius, "[Celsius] temperature of the camera");
    }
    if let Some(celsius) = stamp.temperature_lens_c {
        cards.real("LENSTEMP", celsius, "[Celsius] temperature of the lens");
    }
    if let Some(observer) = stamp.observer {
        cards.real("LAT", observer.latitude / DEG, "[deg] latitude of the observer");
        cards.real("LST", observer.sidereal_time / HOUR, "[h] local sidereal time");
    }
    cards.logical("SIMULATE", stamp.simulated, "taken by a simulated camera or lens");
    if stamp.missing_packets > 0 {
        cards.integer("PKTLOST", stamp.missing_packets, "packets that never came: pixels of 0");
    }
    if stamp.missed_frames > 0 {
        cards.integer("IMGLOST", stamp.missed_frames, "images before it that never came");
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
    let said = header.text("CLOCK");
    let quality =
        CLOCKS.iter().find(|(_, name)| said.as_deref() == Some(name)).map_or(ClockQuality::FreeRunning, |(quality, _)| *quality);
    let middle = header.text("DATE-AVG").and_then(|text| Utc::parse(&text));
    let from_start = || {
        let start = header.text("DATE-OBS").and_then(|text| Utc::parse(&text))?;
        Utc::from_unix(start.unix_s() + exposure_s.unwrap_or(0.0) / 2.0)
    };
    Some((middle.or_else(from_start)?, quality))
}

/// What `CLOCK` says of a clock.
const CLOCKS: [(ClockQuality, &str); 6] = [
    (ClockQuality::Unset, "unset"),
    (ClockQuality::FreeRunning, "free-running"),
    (ClockQuality::Synchronised, "synchronised"),
    (ClockQuality::FlightComputer, "flight-computer"),
    (ClockQuality::Chrony, "chrony"),
    (ClockQuality::Ptp, "ptp"),
];

/// ISO 8601 to the microsecond: what a double of seconds since 1970 holds.
fn microseconds(time: Utc) -> String {
    let total = (time.unix_s() * 1e6).round() as i64;
    let seconds = total.div_euclid(1_000_000);
    // A rounding up past the last second of the range stays within it.
    let whole = Utc::from_unix(seconds as f64).unwrap_or(time);
    let (year, month, day, hour, minute, second) = whole.calendar();
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{:02}.{:06}", second.floor(), total.rem_euclid(1_000_000))
}
