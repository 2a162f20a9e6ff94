//! Strain: a computer that is too slow for all of its work leaves the least of it undone, and never the updates.
//!
//! An update that goes out late, though its peer was ready for it, is the sign. Each sign within a while of the last sheds one thing
//! more; a calm time takes one back.

use super::state::Shed;
use std::time::Duration;
use tokio::time::Instant;

/// An update that is late by more than this shows strain: the time between two is to be 0.6 s at most, and 0.5 s is the rule.
pub const LATE: Duration = Duration::from_millis(100);
/// What was shed last is given this long to help before more is.
const HELPS_WITHIN: Duration = Duration::from_secs(2);
/// After so long without a sign one thing is taken back.
const CALM: Duration = Duration::from_secs(30);

/// What has been shed, and since when.
#[derive(Debug, Clone, Copy)]
pub struct Strain {
    shed: Shed,
    /// When the last was shed or taken back; `None` before the first.
    changed: Option<Instant>,
    /// The last sign.
    sign: Option<Instant>,
}

impl Default for Strain {
    fn default() -> Self {
        Self { shed: Shed::Nothing, changed: None, sign: None }
    }
}

impl Strain {
    /// What is left undone.
    pub fn shed(&self) -> Shed {
        self.shed
    }

    /// An update was late.
    pub fn sign(&mut self, now: Instant) {
        self.sign = Some(now);
        if self.changed.is_none_or(|changed| now.saturating_duration_since(changed) >= HELPS_WITHIN) {
            self.change(self.shed.more(), now);
        }
    }

    /// When a calm time will have passed; `None` where nothing is shed.
    pub fn deadline(&self) -> Option<Instant> {
        let last = self.sign.max(self.changed)?;
        (self.shed != Shed::Nothing).then(|| last + CALM)
    }

    /// Takes one thing back where the time was calm.
    pub fn calm(&mut self, now: Instant) {
        if self.deadline().is_some_and(|deadline| deadline <= now) {
            self.change(self.shed.less(), now);
        }
    }

    fn change(&mut self, shed: Shed, now: Instant) {
        if shed != self.shed {
            tracing::warn!(?shed, was = ?self.shed, "the computer's load changes what is left undone");
            (self.shed, self.changed) = (shed, Some(now));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn each_sign_sheds_one_thing_more_in_the_stated_order_and_calm_takes_them_back() {
        let (start, mut strain) = (Instant::now(), Strain::default());
        let at = |s: f64| start + Duration::from_secs_f64(s);
        let mut seen = Vec::new();
        for s in [0.0, 0.5, 1.9, 2.0, 4.5, 7.0, 10.0] {
            strain.sign(at(s));
            seen.push(strain.shed());
        }
        use Shed::{Display, Images, Nothing, Solving};
        assert_eq!(seen, [Display, Display, Display, Images, Solving, Solving, Solving]);
        assert_eq!(strain.deadline(), Some(at(40.0)), "a calm time after the last sign");
        strain.calm(at(39.9));
        assert_eq!(strain.shed(), Solving);
        for (s, left) in [(40.0, Images), (70.0, Display), (100.0, Nothing)] {
            strain.calm(at(s - 0.1));
            assert_ne!(strain.shed(), left);
            strain.calm(at(s));
            assert_eq!(strain.shed(), left);
        }
        assert_eq!(strain.deadline(), None);
    }
}
