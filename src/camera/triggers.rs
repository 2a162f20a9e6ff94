//! What a camera does that others trigger, when they no longer do: after a while it exposes by itself, until a trigger comes again.

use crate::image::ExposedBy;
use crate::settings::CameraSettings;
use std::time::Duration;

/// Watches for triggers that stay away. Time comes in as the time since the service's start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct TriggerWatch {
    exposing: ExposedBy,
    /// How long a trigger is waited for; `None`: for ever.
    timeout: Option<Duration>,
    /// When the last trigger came, or the watch began.
    last: Duration,
}

/// What the watch is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TriggerEvent {
    /// An image came that a trigger made.
    Triggered,
    /// Nothing happened but time.
    Time,
}

/// What follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TriggerDecision {
    /// All stays as it is.
    Unchanged,
    /// No trigger came for so long: the camera is to expose by itself.
    ByItself {
        /// Since the last trigger, or since the watch began.
        silent: Duration,
    },
    /// Triggers are back: it is to wait for them again.
    Returned,
}

impl TriggerWatch {
    /// Begins at `now`; `before`: what made the camera expose until then, which goes on.
    pub fn new(settings: &CameraSettings, before: ExposedBy, now: Duration) -> Self {
        let exposing = match (settings.trigger.is_line(), before) {
            (false, _) => ExposedBy::Asked,
            (true, ExposedBy::Itself) => ExposedBy::Itself,
            (true, _) => ExposedBy::Trigger,
        };
        let timeout = Duration::try_from_secs_f64(settings.trigger_timeout_s).ok().filter(|timeout| !timeout.is_zero());
        Self { exposing, timeout, last: now }
    }

    /// What makes the camera expose.
    pub fn exposing(&self) -> ExposedBy {
        self.exposing
    }

    /// Takes what happened.
    pub fn on(&mut self, now: Duration, event: TriggerEvent) -> TriggerDecision {
        match (self.exposing, event) {
            (ExposedBy::Asked, _) => TriggerDecision::Unchanged,
            (before, TriggerEvent::Triggered) => {
                (self.exposing, self.last) = (ExposedBy::Trigger, now);
                if before == ExposedBy::Itself { TriggerDecision::Returned } else { TriggerDecision::Unchanged }
            }
            (_, TriggerEvent::Time) if self.deadline().is_some_and(|deadline| now >= deadline) => {
                self.exposing = ExposedBy::Itself;
                TriggerDecision::ByItself { silent: now.saturating_sub(self.last) }
            }
            (_, TriggerEvent::Time) => TriggerDecision::Unchanged,
        }
    }

    /// When it wants to be asked again, if no trigger comes before.
    pub fn deadline(&self) -> Option<Duration> {
        self.timeout.filter(|_| self.exposing == ExposedBy::Trigger).and_then(|timeout| self.last.checked_add(timeout))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Settings, Trigger};

    fn watch(trigger: Trigger, trigger_timeout_s: f64, before: ExposedBy) -> TriggerWatch {
        let settings = CameraSettings { trigger, trigger_timeout_s, ..Settings::flight().unwrap().camera };
        TriggerWatch::new(&settings, before, at(100))
    }

    fn at(seconds: u64) -> Duration {
        Duration::from_secs(seconds)
    }

    #[test]
    fn a_camera_without_triggers_exposes_by_itself_until_one_comes() {
        let mut watch = watch(Trigger::Line0, 30.0, ExposedBy::Trigger);
        assert_eq!(watch.on(at(120), TriggerEvent::Triggered), TriggerDecision::Unchanged);
        assert_eq!(watch.deadline(), Some(at(150)));
        assert_eq!(watch.on(at(149), TriggerEvent::Time), TriggerDecision::Unchanged);
        assert_eq!(watch.on(at(151), TriggerEvent::Time), TriggerDecision::ByItself { silent: at(31) });
        assert_eq!((watch.exposing(), watch.deadline()), (ExposedBy::Itself, None));
        assert_eq!(watch.on(at(500), TriggerEvent::Time), TriggerDecision::Unchanged, "it is told once");
        assert_eq!(watch.on(at(501), TriggerEvent::Triggered), TriggerDecision::Returned);
        assert_eq!((watch.exposing(), watch.deadline()), (ExposedBy::Trigger, Some(at(531))));
    }

    #[test]
    fn it_waits_for_ever_where_it_is_to_and_a_camera_that_nobody_triggers_is_let_alone() {
        let mut for_ever = watch(Trigger::Line0, 0.0, ExposedBy::Trigger);
        assert_eq!((for_ever.deadline(), for_ever.on(at(1_000_000), TriggerEvent::Time)), (None, TriggerDecision::Unchanged));
        let mut software = watch(Trigger::Software, 30.0, ExposedBy::Asked);
        assert_eq!((software.exposing(), software.deadline()), (ExposedBy::Asked, None));
        assert_eq!(software.on(at(1000), TriggerEvent::Triggered), TriggerDecision::Unchanged);
    }

    #[test]
    fn what_was_before_a_restart_goes_on() {
        assert_eq!(watch(Trigger::Line0, 30.0, ExposedBy::Itself).exposing(), ExposedBy::Itself);
        assert_eq!(watch(Trigger::Line0, 30.0, ExposedBy::Asked).exposing(), ExposedBy::Trigger);
    }
}
