//! An outcome in words, for people: what `stars solve` prints without `--json`.

use crate::sky::{ARCSEC, DEG, HOUR, wrap_two_pi};
use crate::solve::{Outcome, Solution};

/// One block per outcome: its first line says how it ended, the indented ones give the numbers.
pub fn block(outcome: &Outcome) -> String {
    let simulated = if outcome.stamp.simulated { " (simulated)" } else { "" };
    let name = format!("{}{simulated}", outcome.stamp.origin);
    let lines = match &outcome.solution {
        Some(solution) => solved(outcome, solution),
        None => unsolved(outcome),
    };
    let first = match &outcome.solution {
        Some(_) => format!("{name}: solved"),
        None => format!("{name}: not solved: {}", reason(outcome)),
    };
    std::iter::once(first).chain(lines.into_iter().map(|line| format!("  {line}"))).collect::<Vec<_>>().join("\n")
}

/// The reason by its name in JSON, with the cause where there is one: `no_match (trailed)`.
pub fn reason(outcome: &Outcome) -> String {
    match outcome.cause {
        Some(cause) => format!("{} ({cause})", outcome.reason),
        None => outcome.reason.to_string(),
    }
}

fn solved(outcome: &Outcome, solution: &Solution) -> Vec<String> {
    let (ra, dec, roll) = solution.served_attitude().angles();
    let sigmas = solution.sigmas() / ARCSEC;
    let epoch = solution.epoch_yr.map_or_else(String::new, |epoch| format!(", stars at {epoch:.1}"));
    let mut lines = vec![
        format!("RA {:.6}° = {}   Dec {:+.6}° = {}   (ICRS{epoch})", ra / DEG, hms(ra), dec / DEG, dms(dec)),
        format!("σ {:.2}″ east, {:.2}″ north   roll {:.4}° ± {:.1}″", sigmas.x, sigmas.y, roll / DEG, sigmas.z),
    ];
    if let Some(horizontal) = &solution.horizontal {
        let pointing = &horizontal.pointing;
        let (az, el, roll) = (pointing.azimuth / DEG, pointing.elevation / DEG, pointing.roll / DEG);
        lines.push(format!("azimuth {az:.4}°   elevation {el:.4}°   horizontal roll {roll:.4}°"));
    }
    lines.push(format!(
        "plate scale {:.4}″/px   {} of {} sources matched, rms {:.2} px   false with p < 1e{:.0}   {}",
        solution.platescale / ARCSEC,
        solution.matches.len(),
        outcome.sources.len(),
        solution.rms_px,
        // Rounded up: it is a bound.
        solution.false_probability_log10.ceil(),
        time(outcome)
    ));
    if let Some(distance) = outcome.prior_disagreement {
        lines.push(format!("the prior was wrong: {:.3}° away", distance / DEG));
    }
    lines
}

fn unsolved(outcome: &Outcome) -> Vec<String> {
    let mut lines = Vec::new();
    if !outcome.detail.is_empty() {
        lines.push(outcome.detail.clone());
    }
    if let Some(candidate) = &outcome.candidate {
        let (ra, dec, _) = candidate.attitude.angles();
        let matched = candidate.matches.len();
        lines.push(format!("best candidate, not served: RA {:.3}° Dec {:+.3}°, {matched} matched", ra / DEG, dec / DEG));
    }
    if outcome.statistics.is_some() {
        lines.push(format!("{} sources found, {} tried   {}", outcome.sources.len(), outcome.sources_tried, time(outcome)));
    }
    lines
}

fn time(outcome: &Outcome) -> String {
    format!("{:.1} ms", outcome.times.total.as_secs_f64() * 1e3)
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
    use crate::image::Stamp;
    use crate::solve::{Cause, Reason};

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

    #[test]
    fn an_unsolved_frame_says_why_in_its_first_lines() {
        let stamp = Stamp { origin: "a.fits".into(), ..Stamp::default() };
        let mut outcome = Outcome::unsolved(stamp, Reason::NoMatch, "no pattern of 12 sources fits");
        outcome.cause = Some(Cause::Trailed);
        assert_eq!(block(&outcome), "a.fits: not solved: no_match (trailed)\n  no pattern of 12 sources fits");
    }
}
