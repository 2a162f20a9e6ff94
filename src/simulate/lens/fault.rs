//! What may be wrong with a simulated lens controller, and when.

use crate::command::Tick;
use crate::settings::parse_span;
use std::time::Duration;

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FaultKind {
    /// Every reply comes [`LATE`] too late.
    Late,
    /// Every reply has a character altered, lost or too many.
    Garbled,
    /// Every word is refused, and not done.
    Error,
    /// It takes words, and does and answers them when the fault is over.
    Stall,
    /// It takes no word and says nothing; what it was doing goes on.
    Silent,
    /// Its power is off: all stands still, and what it had learned and counted is gone.
    PowerCycle,
    /// The motor does not turn.
    StuckMotor,
    /// Moves end [`SLIP_COUNTS`] short, and the controller's count says so.
    Slip,
    /// Its count jumps by [`LOST_COUNTS`] at once, while nothing moves.
    CountsLost,
    /// Its count jumps by as much at the end of each move.
    CountsLostMoving,
    /// The port is gone.
    Vanished,
}

/// How late a late reply is: later than `lens.reply_timeout_s` and earlier than its double.
pub const LATE: Duration = Duration::from_millis(4500);
/// By how much a move falls short, counts.
pub const SLIP_COUNTS: i32 = 40;
/// By how much the count jumps, counts.
pub const LOST_COUNTS: i32 = 60;

/// A fault with its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fault {
    /// What.
    pub kind: FaultKind,
    /// When it begins.
    pub from: Tick,
    /// When it is over.
    pub until: Tick,
}

impl FaultKind {
    /// Every kind.
    pub const ALL: [Self; 11] = [
        Self::Late,
        Self::Garbled,
        Self::Error,
        Self::Stall,
        Self::Silent,
        Self::PowerCycle,
        Self::StuckMotor,
        Self::Slip,
        Self::CountsLost,
        Self::CountsLostMoving,
        Self::Vanished,
    ];

    /// Its name in the settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Late => "late",
            Self::Garbled => "garbled",
            Self::Error => "error",
            Self::Stall => "stall",
            Self::Silent => "silent",
            Self::PowerCycle => "power_cycle",
            Self::StuckMotor => "stuck_motor",
            Self::Slip => "slip",
            Self::CountsLost => "counts_lost",
            Self::CountsLostMoving => "counts_lost_moving",
            Self::Vanished => "vanished",
        }
    }
}

/// Reads faults as the setting `lens.simulated.faults` has them: `60s late 20s, 2m power_cycle 3s`.
///
/// # Errors
/// What is wrong, and what was expected.
pub fn parse_faults(text: &str) -> Result<Vec<Fault>, String> {
    text.split(',').map(str::trim).filter(|one| !one.is_empty()).map(parse_fault).collect()
}

fn parse_fault(text: &str) -> Result<Fault, String> {
    let words: Vec<&str> = text.split_whitespace().collect();
    let [from, name, lasts] = words.as_slice() else {
        return Err(format!("'{text}' is no fault, expected when, which and for how long, such as '60s late 20s'"));
    };
    let kind = FaultKind::ALL.into_iter().find(|kind| kind.name() == *name).ok_or_else(|| {
        let names: Vec<&str> = FaultKind::ALL.iter().map(|kind| kind.name()).collect();
        format!("'{name}' is no fault, expected one of {}", names.join(", "))
    })?;
    let from = parse_span(from)?;
    Ok(Fault { kind, from, until: from + parse_span(lasts)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_of_faults_is_read() {
        let second = Duration::from_secs;
        assert_eq!(parse_faults(""), Ok(vec![]));
        let wanted = vec![
            Fault { kind: FaultKind::Late, from: second(60), until: second(80) },
            Fault { kind: FaultKind::PowerCycle, from: second(120), until: second(123) },
        ];
        assert_eq!(parse_faults("60s late 20s, 2m power_cycle 3s,"), Ok(wanted));
        for (text, says) in [
            ("late", "such as '60s late 20s'"),
            ("60s slow 2s", "expected one of late, garbled"),
            ("60 late 2s", "'60' is no span of time"),
            ("60s late", "such as '60s late 20s'"),
        ] {
            let error = parse_faults(text).unwrap_err();
            assert!(error.contains(says), "{error}");
        }
    }
}
