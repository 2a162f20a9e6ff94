//! Keepers: actors that bring to a disk what others give them.
//!
//! The disk may be slow, full or dead: what is to be kept waits in a bounded backlog, from which the oldest is lost and counted; an error is
//! counted, logged and tried again later, and nobody else is held up.

use super::hub::{self, ToHub, sleep_until};
use super::inbox::Inbox;
use super::pulse::Pulse;
use super::supervisor::{Backoff, Ended, panic_message};
use std::io;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// What is not on disk yet, and what it is written with. It outlives the actor, so that nothing is lost with it: a clone is the same one.
pub trait Backlog: Clone + Send + 'static {
    /// What it is given.
    type Item: Send + 'static;
    /// What it keeps, for the log.
    const WHAT: &'static str;
    /// Takes what is to be kept.
    fn accept(&self, item: Self::Item);
    /// When the next is due, if nothing comes before; `None` where none will be by itself.
    fn next_due(&self, now: Instant) -> Option<Instant>;
    /// Makes all that waits due: nothing more will come.
    fn hurry(&self, now: Instant);
    /// Writes the oldest that is due; what is to be told of it, if anything. Blocking.
    fn write_one(&self, now: Instant) -> io::Result<Option<ToHub>>;
    /// Loses one where more than so many wait, and what is to be told of that, if anything; `None` where there are not too many.
    fn lose_one(&self, most: usize) -> Option<Option<ToHub>>;
    /// What is told of an error of the disk.
    fn disk_error(&self) -> ToHub;
}

/// The actor of a backlog.
#[derive(Clone)]
pub struct Keeper<B: Backlog> {
    /// What it is given.
    pub inbox: Inbox<B::Item>,
    /// Whom to tell what was kept and what was lost.
    pub hub: hub::Handle,
    /// What is not on disk yet.
    pub backlog: B,
    /// How many may wait for the disk.
    pub queue: usize,
    /// Pauses after an error of the disk.
    pub backoff: Backoff,
    /// When to end.
    pub stop: CancellationToken,
}

/// What the actor holds while it runs.
struct Desk {
    writing: Option<JoinHandle<io::Result<Option<ToHub>>>>,
    not_before: Instant,
}

impl<B: Backlog> Keeper<B> {
    /// Runs until stopped; then what waits is written, as far as the disk takes it.
    pub async fn run(mut self, pulse: Pulse) -> Result<(), Ended> {
        let inbox = self.inbox.clone();
        let mut inbox = inbox.open().await;
        let mut desk = Desk { writing: None, not_before: Instant::now() };
        let mut ending = false;
        loop {
            let due = self.write_next(&mut desk);
            if ending && desk.writing.is_none() {
                return Ok(());
            }
            tokio::select! {
                biased;
                done = async { desk.writing.as_mut()?.await.into() }, if desk.writing.is_some() => {
                    desk.writing = None;
                    let Some(done) = done else { continue };
                    self.after_write(&mut desk, done.map_err(|error| Ended(panic_message(error)))?).await;
                }
                () = self.stop.cancelled(), if !ending => {
                    ending = true;
                    while let Ok(item) = inbox.try_recv() {
                        self.accept(item).await;
                    }
                    // A disk that had an error a moment ago is tried once more.
                    desk.not_before = Instant::now();
                    self.backlog.hurry(desk.not_before);
                }
                Some(item) = inbox.recv(), if !ending => self.accept(item).await,
                () = sleep_until(due), if desk.writing.is_none() => {}
                () = pulse.rest() => {}
            }
        }
    }

    /// Starts to write the oldest that is due, unless the disk is busy or had an error a moment ago; or says when one will be.
    fn write_next(&self, desk: &mut Desk) -> Option<Instant> {
        if desk.writing.is_some() {
            return None;
        }
        let now = Instant::now();
        let due = self.backlog.next_due(now)?.max(desk.not_before);
        if due <= now {
            let backlog = self.backlog.clone();
            desk.writing = Some(tokio::task::spawn_blocking(move || backlog.write_one(now)));
        }
        Some(due)
    }

    async fn accept(&self, item: B::Item) {
        self.backlog.accept(item);
        self.lose_what_is_too_much().await;
    }

    async fn after_write(&mut self, desk: &mut Desk, result: io::Result<Option<ToHub>>) {
        match result {
            Ok(news) => {
                self.backoff.reset();
                if let Some(news) = news {
                    self.hub.tell(news).await;
                }
            }
            Err(error) => {
                let pause = self.backoff.pause();
                tracing::warn!(%error, again_in_s = pause.as_secs_f64(), "{} not kept yet", B::WHAT);
                desk.not_before = Instant::now() + pause;
                self.hub.tell(self.backlog.disk_error()).await;
            }
        }
        self.lose_what_is_too_much().await;
    }

    async fn lose_what_is_too_much(&self) {
        while let Some(lost) = self.backlog.lose_one(self.queue) {
            if let Some(lost) = lost {
                self.hub.tell(lost).await;
            }
        }
    }
}
