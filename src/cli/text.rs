//! An outcome in words, for people: what `stars solve` prints without `--json`.

use crate::sky::{ARCSEC, DEG, HOUR, wrap_two_pi};
use crate::solve::{Outcome, Solution};
use std::time::Duration;

/// One block per outcome: its first line says how it ended, the indented ones give the numbers.
pub fn outcome(outcome: &Outcome) -> String {
    let image = &outcome.stamp.origin;
    let simulated = if outcome.stamp.simulated { " (simulated)" } else { "" };
    match &outcome.solution {
        Some(solution) => format!("{image}{simulated}: solved\n{}", solved(outcome, solution)),
        None => format!("{image}{simulated}: not solved: {}\n{}", reason(outcome), unsolved(outcome)),
    }
}

/// The reason, with the cause where there is one: `no_match (trailed)`.
pub fn reason(outcome: &Outcome) -> String {
    // The words of the wire and of JSON, so that a reader can search for them.
    let word = |value: &dyn erased::Word| value.word();
    match &outcome.cause {
        Some(cause) => format!("{} ({})", word(&outcome.reason), word(cause)),
        None => word(&outcome.reason),
    }
}
