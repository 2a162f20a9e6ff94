//! The ledger: keeps on disk what outlasts a restart. The counter of a command is there before the command runs, so that none runs again;
//! the rest follows when it changes.

use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::kept::Kept;
use super::pulse::Pulse;
use super::supervisor::{Ended, panic_message};
use super::twin::Twin;
use crate::command::OrderNumber;
use std::path::Path;
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// A disk that has not ended a write within this time does not answer.
const WRITES_WITHIN: Duration = Duration::from_secs(5);

/// What the ledger is asked to keep.
#[derive(Debug)]
pub struct Keep {
    /// The order that waits for it, where one does.
    pub number: Option<OrderNumber>,
    /// The number of the record.
    pub record: u64,
    /// All that is kept, the counter of the order in it.
    pub kept: Kept,
}

/// Where the hub hands counters to the ledger.
pub type Handle = mpsc::Sender<Keep>;

/// What is kept, on disk: the counters of sixteen computers' last four boots have room.
pub type Ledger = Twin<Kept>;

/// Name of its files.
pub const NAME: &str = "kept";

/// Opens the ledger of a directory; see [`Twin::open`].
pub fn open(directory: &Path) -> (Ledger, Option<Kept>, Vec<String>) {
    Twin::open(directory, NAME)
}

/// The ledger's actor.
#[derive(Clone)]
pub struct LedgerActor {
    /// What to keep.
    pub inbox: Inbox<Keep>,
    /// Whom to tell when it is kept.
    pub hub: hub::Handle,
    /// The files; a write that hangs has them.
    pub ledger: Arc<Mutex<Ledger>>,
    /// When to end.
    pub stop: CancellationToken,
}

impl LedgerActor {
    /// Runs until stopped; what it was asked to keep before is still kept.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let mut inbox = self.inbox.open().await;
        loop {
            let Keep { number, record, kept } = tokio::select! {
                biased;
                Some(keep) = inbox.recv() => keep,
                () = self.stop.cancelled() => return Ok(()),
                () = pulse.rest() => continue,
            };
            let kept = self.write(kept).await;
            self.hub.tell(ToHub::Kept { number, record, kept }).await;
        }
    }

    /// Writes it on the blocking pool, unless the disk has an earlier write that it does not end.
    async fn write(&self, kept: Kept) -> Result<(), String> {
        let ledger = Arc::clone(&self.ledger);
        let job = tokio::task::spawn_blocking(move || {
            let mut ledger = match ledger.try_lock() {
                Ok(ledger) => ledger,
                Err(TryLockError::Poisoned(ledger)) => ledger.into_inner(), // A file is written whole or not believed.
                Err(TryLockError::WouldBlock) => return Err("the disk does not answer".to_owned()),
            };
            ledger.write(&kept).map_err(|error| format!("{}: {error}", ledger.directory().display()))
        });
        match tokio::time::timeout(WRITES_WITHIN, job).await {
            Ok(Ok(kept)) => kept,
            Ok(Err(error)) => Err(panic_message(error)),
            Err(_) => Err("the disk did not answer in time".to_owned()),
        }
    }
}
