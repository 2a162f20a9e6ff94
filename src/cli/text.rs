//! An outcome in words, for people: what `stars solve` prints without `--json`.

use crate::display::{dms, hms, reason};
use crate::sky::{ARCSEC, DEG};
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Stamp;
    use crate::solve::{Cause, Reason};

    #[test]
    fn an_unsolved_frame_says_why_in_its_first_lines() {
        let stamp = Stamp { origin: "a.fits".into(), ..Stamp::default() };
        let mut outcome = Outcome::unsolved(stamp, Reason::NoMatch, "no pattern of 12 sources fits");
        outcome.cause = Some(Cause::Trailed);
        assert_eq!(block(&outcome), "a.fits: not solved: no_match (trailed)\n  no pattern of 12 sources fits");
    }
}
