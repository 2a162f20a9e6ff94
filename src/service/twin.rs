//! Twin files: a small value on disk that survives whatever breaks off while it is written.
//!
//! Two files of a fixed size are written in turn, each with a number and a checksum: whatever is torn, the other one is whole. Since
//! they never grow, a full disk does not stop them.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

/// Bytes of a file.
const FILE_BYTES: usize = 64 * 1024;
/// What a file begins with.
const MAGIC: &[u8; 8] = b"STARSLG1";
/// Magic, number, length; the payload follows, and its checksum over all of these.
const HEAD: usize = 8 + 8 + 4;

/// The two files of a value.
#[derive(Debug, Clone)]
pub struct Twin<T> {
    directory: PathBuf,
    name: &'static str,
    number: u64,
    value: PhantomData<fn(T)>,
}

impl<T: Serialize + DeserializeOwned> Twin<T> {
    /// Opens the files of this name in a directory, which is made if it is not there, and reads what is kept in them; nothing where
    /// there is nothing yet. A complaint names a file that is damaged; what the other one has is taken then.
    ///
    /// # Errors
    /// Where the directory cannot be made.
    pub fn open(directory: &Path, name: &'static str) -> io::Result<(Self, Option<T>, Vec<String>)> {
        fs::create_dir_all(directory)?;
        let mut twin = Self { directory: directory.to_owned(), name, number: 0, value: PhantomData };
        let (mut newest, mut complaints) = (None, Vec::new());
        for place in 0..2 {
            let path = twin.path(place);
            match read(&path) {
                Ok(Some((number, value))) if number > twin.number => (twin.number, newest) = (number, Some(value)),
                Ok(_) => {}
                Err(error) => complaints.push(format!("{}: {error}", path.display())),
            }
        }
        Ok((twin, newest, complaints))
    }

    /// The directory of the files.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    fn path(&self, place: u64) -> PathBuf {
        self.directory.join(format!("{}.{place}", self.name))
    }

    /// Writes the value into the older file, and waits until the disk has it.
    ///
    /// # Errors
    /// As the disk says.
    pub fn write(&mut self, value: &T) -> io::Result<()> {
        let number = self.number + 1;
        let bytes = encode(number, value)?;
        let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(self.path(number % 2))?;
        file.write_all(&bytes)?;
        file.sync_data()?;
        self.number = number;
        Ok(())
    }
}

fn encode(number: u64, value: &impl Serialize) -> io::Result<Vec<u8>> {
    let payload = postcard::to_stdvec(value).map_err(io::Error::other)?;
    let length = u32::try_from(payload.len()).map_err(io::Error::other)?;
    let mut bytes = Vec::with_capacity(FILE_BYTES);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&number.to_le_bytes());
    bytes.extend_from_slice(&length.to_le_bytes());
    bytes.extend_from_slice(&payload);
    bytes.extend_from_slice(&crc32fast::hash(&bytes).to_le_bytes());
    if bytes.len() > FILE_BYTES {
        return Err(io::Error::other("more than a file has room for"));
    }
    bytes.resize(FILE_BYTES, 0);
    Ok(bytes)
}

/// What a file has; `None` where there is none.
fn read<T: DeserializeOwned>(path: &Path) -> io::Result<Option<(u64, T)>> {
    let mut bytes = Vec::new();
    match File::open(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
        Ok(file) => file.take(FILE_BYTES as u64).read_to_end(&mut bytes)?,
    };
    decode(&bytes).map(Some).ok_or_else(|| io::Error::other("damaged"))
}

fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<(u64, T)> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::{Act, Authenticity, BootId, Command, FlightComputer, Guard, Memory, Sender, Situation, Slot};
    use std::time::Duration;

    fn open(directory: &Path) -> io::Result<(Twin<Memory>, Option<Memory>, Vec<String>)> {
        Twin::open(directory, "commands")
    }

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
        let (mut ledger, first, _) = open(directory.path()).unwrap();
        assert_eq!(first, None);
        for commands in 1..=5 {
            ledger.write(&memory(commands)).unwrap();
            let (_, read, complaints) = open(directory.path()).unwrap();
            assert_eq!(read, Some(memory(commands)));
            assert!(complaints.is_empty());
        }
        for place in 0..2 {
            assert_eq!(fs::metadata(ledger.path(place)).unwrap().len(), FILE_BYTES as u64);
        }
    }

    #[test]
    fn a_file_torn_at_any_byte_leaves_what_was_kept_before() {
        let directory = tempfile::tempdir().unwrap();
        let (mut ledger, ..) = open(directory.path()).unwrap();
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
            let (_, read, _) = open(directory.path()).unwrap();
            assert!(read == Some(memory(2)) || read == Some(memory(3)), "torn at {torn}");
        }
        for cut in [0, 5, 30, used - 1] {
            fs::write(&path, &whole[..cut]).unwrap();
            let (_, read, complaints) = open(directory.path()).unwrap();
            assert_eq!((read, complaints.len()), (Some(memory(2)), 1), "cut at {cut}");
        }
    }

    #[test]
    fn a_directory_that_cannot_be_had_is_an_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(open(&file.path().join("ledger")).is_err());
    }
}
