//! The supervisor: starts an actor again when it panics or ends, with a pause that grows.
//!
//! The other actors do not notice: their channels stay (see [`super::inbox`]), and sessions go on composing updates from
//! the newest state.

use super::hub::{self, ToHub};
use super::pulse::Pulse;
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

/// An actor that ran for so many times the time after which it hangs was well.
const WELL: u32 = 6;

/// An actor that is to stop comes round to hear of it within this time: a good part of what its stage has to end in is left then.
const HEARS_WITHIN: Duration = Duration::from_millis(150);

/// What the supervisor knows of an actor.
pub struct Watched {
    /// Which it is.
    pub actor: Actor,
    /// Shows that its loop comes round.
    pub pulse: Pulse,
    /// One that does not come round for this long hangs.
    pub hangs_after: Duration,
    /// Whom to tell that it was started again.
    pub hub: hub::Handle,
    /// When to end.
    pub stop: CancellationToken,
}

/// Ends where an actor is to stop and does not come round to hear of it.
async fn is_deaf(stop: &CancellationToken, pulse: &Pulse) {
    stop.cancelled().await;
    let told = Instant::now();
    tokio::time::sleep(HEARS_WITHIN).await;
    if pulse.silence() <= told.elapsed() {
        // It has heard, and takes the time that it needs.
        std::future::pending::<()>().await;
    }
}

/// Runs an actor that is to stop from its start to its end; whoever stops it does not wait for ever.
async fn see_to_what_is_left(actor: impl Future<Output = Result<(), Ended>> + Send + 'static) {
    match tokio::spawn(tracing::Instrument::in_current_span(actor)).await {
        Ok(Ok(())) => {}
        Ok(Err(Ended(why))) => tracing::error!(why, "what was left as the service stops is not all seen to"),
        Err(error) => tracing::error!(why = panic_message(error), "what was left as the service stops is not all seen to"),
    }
}

/// Keeps an actor running until it is to stop: `start` makes it anew each time. Every new start is counted in the state. One that is not
/// in its place when it is to stop is started once more, so that what it left is seen to.
pub async fn supervise<F, A>(watched: Watched, mut backoff: Backoff, mut start: F)
where
    F: FnMut(Pulse) -> A,
    A: Future<Output = Result<(), Ended>> + Send + 'static,
{
    let Watched { actor, pulse, hangs_after, hub, stop } = watched;
    loop {
        let began = Instant::now();
        pulse.beat();
        let (running, theirs) = (start(pulse.clone()), pulse.clone());
        let mut task = tokio::spawn(tracing::Instrument::in_current_span(async move { theirs.run(running).await }));
        let ended = tokio::select! {
            biased;
            ended = &mut task => Some(ended),
            // One that is to stop takes the time that it needs: whoever stops it does not wait for ever.
            () = pulse.lost(hangs_after), if !stop.is_cancelled() => None,
            () = is_deaf(&stop, &pulse) => None,
        };
        if stop.is_cancelled() {
            if !matches!(ended, Some(Ok(Ok(())))) {
                task.abort();
                see_to_what_is_left(start(pulse)).await;
            }
            return;
        }
        // One that was well for long before it hung has been helped by its last start.
        let was_well = began.elapsed() > hangs_after * WELL;
        if was_well {
            pulse.ended(false);
        }
        pulse.ended(ended.is_none());
        let why = match ended {
            Some(Ok(Ok(()))) => "it came to its end".to_owned(),
            Some(Ok(Err(Ended(why)))) => why,
            Some(Err(error)) => panic_message(error),
            None => {
                // It ends where it waits next; one that does not even wait keeps its thread, and the program is started again for it.
                task.abort();
                format!("it hung for {} s", hangs_after.as_secs_f64())
            }
        };
        if began.elapsed() > backoff.longest {
            backoff.reset();
        }
        let pause = backoff.pause();
        tracing::error!(?actor, why, pause_s = pause.as_secs_f64(), "actor ended, starting it again");
        if stop.run_until_cancelled(tokio::time::sleep(pause)).await.is_none() {
            see_to_what_is_left(start(pulse)).await;
            return;
        }
        // The hub itself reads this once it is back; if its inbox is full, the count must not hold up the new start.
        hub.try_tell(ToHub::Restarted { actor, why });
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::inbox;
    use crate::service::pulse::Upset;
    use std::sync::{Arc, Mutex};

    #[tokio::test(start_paused = true)]
    async fn an_actor_that_hangs_after_each_start_is_hopeless_and_one_that_hangs_now_and_then_is_not() {
        let limit = Duration::from_secs(40);
        for (well_for, hopeless) in [(Duration::ZERO, true), (Duration::from_secs(100), false)] {
            let (sender, _inbox) = inbox::channel(64);
            let settings = ServiceSettings { restart_delay_s: 1.0, restart_delay_max_s: 4.0, hang_s: 10.0 };
            let (pulse, stop) = (Pulse::new(), CancellationToken::new());
            let hub = hub::Handle::new(sender);
            let hangs_after = Duration::from_secs(10);
            let watched = Watched { actor: Actor::Camera, pulse: pulse.clone(), hangs_after, hub, stop: stop.clone() };
            let start = move |pulse: Pulse| async move {
                let until = Instant::now() + well_for;
                while Instant::now() < until {
                    pulse.rest().await;
                }
                std::future::pending().await
            };
            let supervised = tokio::spawn(supervise(watched, Backoff::new(&settings), start));
            tokio::time::sleep(Duration::from_secs(20)).await;
            assert!(!pulse.is_hopeless(limit), "one hang is none");
            tokio::time::sleep(Duration::from_secs(1000)).await;
            assert_eq!(pulse.is_hopeless(limit), hopeless, "well for {well_for:?}");
            stop.cancel();
            supervised.abort();
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_actor_that_is_upset_fails_as_it_is_told_and_is_started_again() {
        let (sender, inbox) = inbox::channel(64);
        let settings = ServiceSettings { restart_delay_s: 1.0, restart_delay_max_s: 4.0, hang_s: 10.0 };
        let (pulse, stop) = (Pulse::new(), CancellationToken::new());
        let hub = hub::Handle::new(sender);
        let watched =
            Watched { actor: Actor::Lens, pulse: pulse.clone(), hangs_after: Duration::from_secs(10), hub, stop: stop.clone() };
        let start = |pulse: Pulse| async move {
            loop {
                pulse.rest().await;
            }
        };
        let supervised = tokio::spawn(supervise(watched, Backoff::new(&settings), start));
        for (how, within_s) in [(Upset::Panics, 1), (Upset::Ends, 2), (Upset::Hangs, 11)] {
            tokio::time::sleep(Duration::from_secs(20)).await;
            assert!(pulse.silence() <= Duration::from_secs(1), "before {how:?}");
            pulse.upset(how);
            tokio::time::sleep(Duration::from_secs(within_s)).await;
        }
        tokio::time::sleep(Duration::from_secs(20)).await;
        assert!(pulse.silence() <= Duration::from_secs(1));
        supervised.abort();
        let mut inbox = inbox.open().await;
        let told = std::iter::from_fn(|| inbox.try_recv().ok());
        let reasons: Vec<String> =
            told.filter_map(|message| if let ToHub::Restarted { why, .. } = message { Some(why) } else { None }).collect();
        assert_eq!(reasons, ["panicked: upset", "upset", "it hung for 10 s"]);
    }

    #[tokio::test(start_paused = true)]
    async fn an_actor_that_hangs_or_waits_for_its_new_start_when_it_is_to_stop_is_started_once_more_to_see_to_what_it_left() {
        for (how, ends_within) in [(Upset::Hangs, HEARS_WITHIN), (Upset::Panics, Duration::ZERO)] {
            let (sender, _inbox) = inbox::channel(64);
            let settings = ServiceSettings { restart_delay_s: 10.0, restart_delay_max_s: 10.0, hang_s: 10.0 };
            let (pulse, stop) = (Pulse::new(), CancellationToken::new());
            let hub = hub::Handle::new(sender);
            let hangs_after = Duration::from_secs(10);
            let watched = Watched { actor: Actor::Recorder, pulse: pulse.clone(), hangs_after, hub, stop: stop.clone() };
            let seen_to = Arc::new(Mutex::new(0));
            let (left, ends) = (Arc::clone(&seen_to), stop.clone());
            let start = move |pulse: Pulse| {
                let (left, ends) = (Arc::clone(&left), ends.clone());
                async move {
                    loop {
                        tokio::select! {
                            () = ends.cancelled() => break,
                            () = pulse.rest() => {}
                        }
                    }
                    *left.lock().unwrap() += 1;
                    Ok(())
                }
            };
            let supervised = tokio::spawn(supervise(watched, Backoff::new(&settings), start));
            tokio::time::sleep(Duration::from_secs(2)).await;
            pulse.upset(how);
            tokio::time::sleep(Duration::from_secs(2)).await;
            let told = Instant::now();
            stop.cancel();
            supervised.await.unwrap();
            assert_eq!((*seen_to.lock().unwrap(), told.elapsed()), (1, ends_within), "{how:?}");
        }
    }

    #[tokio::test(start_paused = true)]
    async fn an_actor_that_keeps_breaking_or_hangs_is_started_again_with_growing_pauses_each_counted() {
        let (sender, inbox) = inbox::channel(64);
        let (stop, starts) = (CancellationToken::new(), Arc::new(Mutex::new(Vec::new())));
        let settings = ServiceSettings { restart_delay_s: 1.0, restart_delay_max_s: 4.0, hang_s: 30.0 };
        let (seen, began, ends) = (Arc::clone(&starts), Instant::now(), stop.clone());
        let start = move |pulse: Pulse| {
            let mut starts = seen.lock().unwrap();
            starts.push(began.elapsed().as_secs());
            let (number, stop) = (starts.len(), ends.clone());
            async move {
                match number {
                    1 => panic!("it breaks"),
                    2 => Err(Ended("it gives up".to_owned())),
                    3 | 4 => Ok(()),
                    // It runs for longer than the longest pause before it breaks again: the first pause is due.
                    5 => {
                        tokio::time::sleep(Duration::from_secs(10)).await;
                        panic!("it breaks late")
                    }
                    // It waits for something that never comes.
                    6 => std::future::pending().await,
                    _ => loop {
                        tokio::select! {
                            () = stop.cancelled() => return Ok(()),
                            () = pulse.rest() => {}
                        }
                    },
                }
            }
        };
        let hub = hub::Handle::new(sender);
        let hangs_after = Duration::from_secs_f64(settings.hang_s);
        let watched = Watched { actor: Actor::Camera, pulse: Pulse::new(), hangs_after, hub, stop: stop.clone() };
        let supervised = tokio::spawn(supervise(watched, Backoff::new(&settings), start));
        tokio::time::sleep(Duration::from_secs(200)).await;
        assert_eq!(*starts.lock().unwrap(), [0, 1, 3, 7, 11, 22, 53]);
        stop.cancel();
        supervised.await.unwrap();
        let mut inbox = inbox.open().await;
        let told = std::iter::from_fn(|| inbox.try_recv().ok());
        let reasons: Vec<String> = told
            .filter_map(|message| match message {
                ToHub::Restarted { actor: Actor::Camera, why } => Some(why),
                _ => None,
            })
            .collect();
        let end = "it came to its end";
        let hung = "it hung for 30 s";
        assert_eq!(reasons, ["panicked: it breaks", "it gives up", end, end, "panicked: it breaks late", hung]);
    }
}
