//! The supervisor: starts an actor again when it panics or ends, with a pause that grows.
//!
//! The other actors do not notice: their channels stay (see [`super::inbox`]), and sessions go on composing updates from
//! the newest state.

use super::hub::{self, ToHub};
use super::state::Actor;
use crate::settings::ServiceSettings;
use std::any::Any;
use std::time::Duration;
use tokio::task::JoinError;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Why an actor ended before its time.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Ended(pub String);

/// Pauses between attempts: each is twice the one before, up to a limit.
#[derive(Debug, Clone, Copy)]
pub struct Backoff {
    first: Duration,
    longest: Duration,
    next: Duration,
}

impl Backoff {
    /// The pauses that the settings name.
    pub fn new(settings: &ServiceSettings) -> Self {
        let first = Duration::from_secs_f64(settings.restart_delay_s);
        Self { first, longest: Duration::from_secs_f64(settings.restart_delay_max_s), next: first }
    }

    /// How long to wait before the next attempt.
    pub fn pause(&mut self) -> Duration {
        let pause = self.next;
        self.next = (pause * 2).min(self.longest);
        pause
    }

    /// All is well again: begin with the first pause.
    pub fn reset(&mut self) {
        self.next = self.first;
    }
}

/// Keeps an actor running until `stop`: `start` makes it anew each time. Every new start is counted in the state.
pub async fn supervise<F, A>(actor: Actor, hub: hub::Handle, mut backoff: Backoff, stop: CancellationToken, mut start: F)
where
    F: FnMut() -> A,
    A: Future<Output = Result<(), Ended>> + Send + 'static,
{
    loop {
        let began = Instant::now();
        let ended = tokio::spawn(tracing::Instrument::in_current_span(start())).await;
        if stop.is_cancelled() {
            return;
        }
        let why = match ended {
            Ok(Ok(())) => "it came to its end".to_owned(),
            Ok(Err(Ended(why))) => why,
            Err(error) => panic_message(error),
        };
        if began.elapsed() > backoff.longest {
            backoff.reset();
        }
        let pause = backoff.pause();
        tracing::error!(?actor, why, pause_s = pause.as_secs_f64(), "actor ended, starting it again");
        if stop.run_until_cancelled(tokio::time::sleep(pause)).await.is_none() {
            return;
        }
        // The hub itself reads this once it is back; if its inbox is full, the count must not hold up the new start.
        hub.try_tell(ToHub::Restarted(actor));
    }
}

/// What a task that panicked had to say.
pub fn panic_message(error: JoinError) -> String {
    let Ok(payload) = error.try_into_panic() else { return "cancelled".to_owned() };
    format!("panicked: {}", panic_text(payload.as_ref()))
}

/// What a panic had to say.
pub fn panic_text(payload: &(dyn Any + Send)) -> &str {
    payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str)).unwrap_or("?")
}
