//! The ledger: keeps the counters of commands on disk, each before its command runs, so that none runs again after a restart.

use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::supervisor::{Ended, panic_message};
use super::twin::Twin;
use crate::command::{Memory, OrderNumber};
use std::io;
use std::path::Path;
use tokio::sync::mpsc;
use tokio_util::sync::CancellationToken;

/// What the ledger is asked to keep.
#[derive(Debug)]
pub struct Keep {
    /// The order that waits for it.
    pub number: OrderNumber,
    /// All counters, that of the order among them.
    pub memory: Memory,
}

/// Where the hub hands counters to the ledger.
pub type Handle = mpsc::Sender<Keep>;

/// The counters of commands on disk: those of sixteen computers' last four boots have room.
pub type Ledger = Twin<Memory>;

/// Opens the ledger of a directory; see [`Twin::open`].
///
/// # Errors
/// Where the directory cannot be made.
pub fn open(directory: &Path) -> io::Result<(Ledger, Memory, Vec<String>)> {
    let (ledger, memory, complaints) = Twin::open(directory, "commands")?;
    Ok((ledger, memory.unwrap_or_default(), complaints))
}

/// The ledger's actor.
#[derive(Clone)]
pub struct LedgerActor {
    /// What to keep.
    pub inbox: Inbox<Keep>,
    /// Whom to tell when it is kept.
    pub hub: hub::Handle,
    /// The files.
    pub ledger: Ledger,
    /// When to end.
    pub stop: CancellationToken,
}

impl LedgerActor {
    /// Runs until stopped.
    pub async fn run(self) -> Result<(), Ended> {
        let mut inbox = self.inbox.open().await;
        let mut ledger = self.ledger;
        loop {
            let keep = tokio::select! {
                biased;
                () = self.stop.cancelled() => return Ok(()),
                Some(keep) = inbox.recv() => keep,
            };
            let Keep { number, memory } = keep;
            let job = tokio::task::spawn_blocking(move || {
                let kept = ledger.write(&memory).map_err(|error| format!("{}: {error}", ledger.directory().display()));
                (ledger, kept)
            });
            let (back, kept) = job.await.map_err(|error| Ended(panic_message(error)))?;
            ledger = back;
            self.hub.tell(ToHub::Kept { number, kept }).await;
        }
    }
}
