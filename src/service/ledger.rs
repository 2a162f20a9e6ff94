//! The ledger: keeps the counters of commands on disk, each before its command runs, so that none runs again after a restart.
//!
//! Two files of a fixed size are written in turn, each with a number and a checksum: whatever is torn, the other one is whole. Since
//! they never grow, a full disk does not stop them.

use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::supervisor::{Ended, panic_message};
use crate::command::{Memory, OrderNumber};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
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

/// Bytes of a file: the counters of sixteen computers' last four boots take less.
const FILE_BYTES: usize = 64 * 1024;
/// What a file begins with.
const MAGIC: &[u8; 8] = b"STARSLG1";
/// Magic, number, length; the payload follows, and its checksum over all of these.
const HEAD: usize = 8 + 8 + 4;

/// The two files.
#[derive(Debug, Clone)]
pub struct Ledger {
    directory: PathBuf,
    number: u64,
}

impl Ledger {
    /// Opens the ledger of a directory, which is made if it is not there, and reads what is kept in it; empty where there is nothing yet.
    /// A complaint names a file that is damaged; what the other one has is taken then.
    ///
    /// # Errors
    /// Where the directory cannot be made or read.
    pub fn open(directory: &Path) -> io::Result<(Self, Memory, Vec<String>)> {
        fs::create_dir_all(directory)?;
        let mut ledger = Self { directory: directory.to_owned(), number: 0 };
        let (mut newest, mut complaints) = (Memory::default(), Vec::new());
        for place in 0..2 {
            let path = ledger.path(place);
            match read(&path) {
                Ok(Some((number, memory))) if number > ledger.number => (ledger.number, newest) = (number, memory),
                Ok(_) => {}
                Err(error) => complaints.push(format!("{}: {error}", path.display())),
            }
        }
        Ok((ledger, newest, complaints))
    }

    fn path(&self, place: u64) -> PathBuf {
        self.directory.join(format!("commands.{place}"))
    }

    /// Writes the counters into the older file, and waits until the disk has them.
    ///
    /// # Errors
    /// As the disk says.
    pub fn write(&mut self, memory: &Memory) -> io::Result<()> {
        let number = self.number + 1;
        let bytes = encode(number, memory)?;
        let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(self.path(number % 2))?;
        file.write_all(&bytes)?;
        file.sync_data()?;
        self.number = number;
        Ok(())
    }
}

fn encode(number: u64, memory: &Memory) -> io::Result<Vec<u8>> {
    let payload = postcard::to_stdvec(memory).map_err(io::Error::other)?;
    let length = u32::try_from(payload.len()).map_err(io::Error::other)?;
    let mut bytes = Vec::with_capacity(FILE_BYTES);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&number.to_le_bytes());
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(&payload);
    bytes.extend_from_slice(&crc32fast::hash(&bytes).to_le_bytes());
    if bytes.len() > FILE_BYTES {
        return Err(io::Error::other("more counters than a file has room for"));
    }
    bytes.resize(FILE_BYTES, 0);
    Ok(bytes)
}

/// What a file has; `None` where there is none.
fn read(path: &Path) -> io::Result<Option<(u64, Memory)>> {
    let mut bytes = Vec::new();
    match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
        Ok(file) => file.take(FILE_BYTES as u64).read_to_end(&mut bytes)?,
    };
    decode(&bytes).map(Some).ok_or_else(|| io::Error::other("damaged"))
}

fn decode(bytes: &[u8]) -> Option<(u64, Memory)> {
    let rest = bytes.strip_prefix(MAGIC)?;
    let (number, rest) = rest.split_first_chunk::<8>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let length = u32::from_le_bytes(*length) as usize;
    let payload = rest.get(..length)?;
    let (sum, _) = rest.get(length..)?.split_first_chunk::<4>()?;
    let whole = bytes.get(..HEAD + length)?;
    if crc32fast::hash(whole) != u32::from_le_bytes(*sum) {
        return None;
    }
    Some((u64::from_le_bytes(*number), postcard::from_bytes(payload).ok()?))
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
                let kept = ledger.write(&memory).map_err(|error| format!("{}: {error}", ledger.directory.display()));
                (ledger, kept)
            });
            let (back, kept) = job.await.map_err(|error| Ended(panic_message(error)))?;
            ledger = back;
            self.hub.tell(ToHub::Kept { number, kept }).await;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{Act, Authenticity, BootId, Command, FlightComputer, Guard, Sender, Situation, Slot};
    use std::time::Duration;

    /// Counters as they are after so many commands.
    fn memory(commands: u32) -> Memory {
        let mut guard = Guard::default();
        let (computer, boot) = (FlightComputer(1), BootId(7));
        let delay = Duration::ZERO;
        let sender = Sender { computer, boot, block_boot: boot, under: None, delay, authenticity: Authenticity::NotRequired };
        let now = Situation { lease: None, ours: BootId(1), window_s: 15.0 };
        for counter in 1..=commands {
            guard.on(&sender, &now, &[Slot::new(&Command::StopLens {}, Act::Run, counter, 0.0)]);
        }
        guard.memory().clone()
    }

    #[test]
    fn what_was_written_last_is_read_and_the_files_keep_their_size() {
        let directory = tempfile::tempdir().unwrap();
        let (mut ledger, first, _) = Ledger::open(directory.path()).unwrap();
        assert_eq!(first, Memory::default());
        for commands in 1..=5 {
            ledger.write(&memory(commands)).unwrap();
            let (_, read, complaints) = Ledger::open(directory.path()).unwrap();
            assert_eq!(read, memory(commands));
            assert!(complaints.is_empty());
        }
        for place in 0..2 {
            assert_eq!(fs::metadata(ledger.path(place)).unwrap().len(), FILE_BYTES as u64);
        }
    }

    #[test]
    fn a_file_torn_at_any_byte_leaves_what_was_kept_before() {
        let directory = tempfile::tempdir().unwrap();
        let (mut ledger, ..) = Ledger::open(directory.path()).unwrap();
        for commands in 1..=3 {
            ledger.write(&memory(commands)).unwrap();
        }
        let path = ledger.path(1);
        let whole = fs::read(&path).unwrap();
        let old = encode(1, &memory(1)).unwrap();
        let used = whole.iter().rposition(|byte| *byte != 0).unwrap() + 1;
        for torn in 0..used {
            // The write got so far over the older record.
            let mixed = [&whole[..torn], &old[torn..]].concat();
            fs::write(&path, mixed).unwrap();
            let (_, read, _) = Ledger::open(directory.path()).unwrap();
            assert!(read == memory(2) || read == memory(3), "torn at {torn}");
        }
        for cut in [0, 5, 30, used - 1] {
            fs::write(&path, &whole[..cut]).unwrap();
            let (_, read, complaints) = Ledger::open(directory.path()).unwrap();
            assert_eq!((read, complaints.len()), (memory(2), 1), "cut at {cut}");
        }
    }

    #[test]
    fn a_directory_that_cannot_be_had_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(Ledger::open(&file.path().join("ledger")).is_err());
    }
}
