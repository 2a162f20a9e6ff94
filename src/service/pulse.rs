//! Pulses: an actor shows that its loop comes round. One that does not is started again, and the program that has one which does not is
//! not fit to go on: see [`super::Running::hopeless`].

use super::supervisor::Ended;
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::Notify;
use tokio::time::{Instant, Sleep, sleep, sleep_until};

/// An actor's loop comes round at least this often, whatever it waits for.
const PERIOD: Duration = Duration::from_secs(1);

/// An actor that hung so often, one start after the other, is not helped by another start.
const HANGS: u32 = 3;

/// The pulse of one actor.
#[derive(Debug, Clone)]
pub struct Pulse(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    beat: Mutex<Beat>,
    upset: Notify,
}

#[derive(Debug)]
struct Beat {
    last: Instant,
    /// Times that it hung, one start after the other.
    hangs: u32,
    /// It cannot work in this process any more.
    given_up: bool,
    upset: Option<Upset>,
}

/// How an actor is made to fail, by whoever has the service in its hands and shows that the others do not notice: see
/// [`super::Running::upset`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Upset {
    /// It panics.
    Panics,
    /// It ends as if it had had an error.
    Ends,
    /// It waits for something that never comes, with all that it holds.
    Hangs,
}

impl Pulse {
    /// One that beats now for the first time.
    pub fn new() -> Self {
        let beat = Mutex::new(Beat { last: Instant::now(), hangs: 0, given_up: false, upset: None });
        Self(Arc::new(Shared { beat, upset: Notify::new() }))
    }

    /// Beats.
    pub fn beat(&self) {
        self.lock().last = Instant::now();
    }

    /// Beats, and ends when the next beat is due: the last branch of an actor's `select!`.
    pub fn rest(&self) -> Sleep {
        self.beat();
        sleep(PERIOD)
    }

    fn lock(&self) -> MutexGuard<'_, Beat> {
        self.0.beat.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn last(&self) -> Instant {
        self.lock().last
    }

    /// The actor was given up: it hung, or not.
    pub fn ended(&self, hung: bool) {
        let mut beat = self.lock();
        beat.hangs = if hung { beat.hangs.saturating_add(1) } else { 0 };
    }

    /// It cannot work in this process any more, though its loop comes round; or it can again.
    pub fn give_up(&self, given_up: bool) {
        self.lock().given_up = given_up;
    }

    /// For how long it has not beaten.
    pub fn silence(&self) -> Duration {
        self.last().elapsed()
    }

    /// Whether there is no hope for the actor in this process: it has not beaten for `limit`, hangs after each start, or has given up.
    pub fn is_hopeless(&self, limit: Duration) -> bool {
        let Beat { hangs, given_up, .. } = *self.lock();
        given_up || hangs >= HANGS || self.silence() > limit
    }

    /// Makes the actor fail where it waits next.
    pub fn upset(&self, how: Upset) {
        self.lock().upset = Some(how);
        self.0.upset.notify_one();
    }

    /// Runs the actor until it ends or is upset.
    pub async fn run(&self, actor: impl Future<Output = Result<(), Ended>>) -> Result<(), Ended> {
        let mut actor = pin!(actor);
        let told = async {
            loop {
                self.0.upset.notified().await;
                if let Some(how) = self.lock().upset.take() {
                    return how;
                }
            }
        };
        let how = tokio::select! {
            biased;
            ended = &mut actor => return ended,
            how = told => how,
        };
        match how {
            // Whoever upset it knows: the hook of panics need not tell.
            Upset::Panics => std::panic::resume_unwind(Box::new("upset")),
            Upset::Ends => Err(Ended("upset".to_owned())),
            // What it holds is not dropped before it is given up.
            Upset::Hangs => std::future::pending().await,
        }
    }

    /// Ends once it has not beaten for so long.
    pub async fn lost(&self, limit: Duration) {
        loop {
            let at = self.last() + limit;
            if Instant::now() >= at {
                return;
            }
            sleep_until(at).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn it_is_lost_when_it_has_not_beaten_for_long_enough_and_not_before() {
        let (pulse, limit) = (Pulse::new(), Duration::from_secs(10));
        let began = Instant::now();
        let actor = pulse.clone();
        tokio::spawn(async move {
            for _ in 0..30 {
                actor.rest().await;
            }
        });
        pulse.lost(limit).await;
        assert_eq!(began.elapsed(), Duration::from_secs(39), "thirty beats, the first at once, and then ten seconds without");
        assert_eq!(pulse.silence(), limit);
    }
}
