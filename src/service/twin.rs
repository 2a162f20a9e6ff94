//! Twin files: a small value on disk that survives whatever breaks off while it is written.
//!
//! Two files of a fixed size hold the same, each with a number and a checksum. They are written one after the other, the second when the
//! disk has the first: whatever is torn or damaged, the other one is whole. Since they never grow, a full disk does not stop them, as it
//! would stop a new file that takes the place of an old one.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read, Write};
use std::marker::PhantomData;
use std::path::{Path, PathBuf};

/// Files of a value.
const COPIES: usize = 2;
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
    /// Reads what is kept in the files of this name in a directory; nothing where there is nothing yet. A complaint names a file that is
    /// damaged or cannot be read; what the other one has is taken then. A disk that is dead now may be back for the next write.
    pub fn open(directory: &Path, name: &'static str) -> (Self, Option<T>, Vec<String>) {
        let mut twin = Self { directory: directory.to_owned(), name, number: 0, value: PhantomData };
        let (mut newest, mut complaints, mut missing) = (None, Vec::new(), Vec::new());
        for place in 0..COPIES {
            let path = twin.path(place);
            match read(&path) {
                Ok(Some((number, value))) if number > twin.number => (twin.number, newest) = (number, Some(value)),
                Ok(Some(_)) => {}
                Ok(None) => missing.push(format!("{}: missing", path.display())),
                Err(error) => complaints.push(format!("{}: {error}", path.display())),
            }
        }
        // Where neither is there, nothing was kept yet.
        if missing.len() < COPIES {
            complaints.append(&mut missing);
        }
        (twin, newest, complaints)
    }

    /// The directory of the files.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    fn path(&self, place: usize) -> PathBuf {
        path(&self.directory, self.name, place)
    }

    /// Writes the value into both files, and waits until the disk has it. One copy is enough to go on with.
    ///
    /// # Errors
    /// As the disk says, where it takes neither.
    pub fn write(&mut self, value: &T) -> io::Result<()> {
        let number = self.number + 1;
        let bytes = encode(number, value)?;
        // While the first is written, the second has what was kept before.
        match (self.write_copy(0, &bytes), self.write_copy(1, &bytes)) {
            (Err(error), Err(_)) => return Err(error),
            (Err(error), Ok(())) | (Ok(()), Err(error)) => tracing::warn!(name = self.name, %error, "one copy of two is kept"),
            (Ok(()), Ok(())) => {}
        }
        self.number = number;
        Ok(())
    }

    fn write_copy(&self, place: usize, bytes: &[u8]) -> io::Result<()> {
        fs::create_dir_all(&self.directory)?;
        let mut file = OpenOptions::new().write(true).create(true).truncate(false).open(self.path(place))?;
        file.write_all(bytes)?;
        file.sync_data()
    }
}

/// The files of a value of this name in a directory.
pub(super) fn files(directory: &Path, name: &str) -> impl Iterator<Item = PathBuf> {
    (0..COPIES).map(move |place| path(directory, name, place))
}

fn path(directory: &Path, name: &str, place: usize) -> PathBuf {
    directory.join(format!("{name}.{place}"))
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

/// The number and the value in the bytes of a file; `None` where it is damaged.
pub(super) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<(u64, T)> {
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
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::time::Duration;

    fn open(directory: &Path) -> (Twin<Memory>, Option<Memory>, Vec<String>) {
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
        let (mut ledger, first, complaints) = open(directory.path());
        assert_eq!((first, complaints.len()), (None, 0));
        for commands in 1..=5 {
            ledger.write(&memory(commands)).unwrap();
            let (_, read, complaints) = open(directory.path());
            assert_eq!(read, Some(memory(commands)));
            assert!(complaints.is_empty());
        }
        for place in 0..COPIES {
            assert_eq!(fs::metadata(ledger.path(place)).unwrap().len(), FILE_BYTES as u64);
        }
    }

    /// Directory with two whole copies of three commands, what each has of it, and what each would have had of two.
    fn three_commands() -> (tempfile::TempDir, Vec<PathBuf>, Vec<u8>, Vec<u8>) {
        let directory = tempfile::tempdir().unwrap();
        let (mut ledger, ..) = open(directory.path());
        for commands in 1..=3 {
            ledger.write(&memory(commands)).unwrap();
        }
        let paths: Vec<_> = (0..COPIES).map(|place| ledger.path(place)).collect();
        let whole = fs::read(&paths[0]).unwrap();
        assert_eq!(whole, fs::read(&paths[1]).unwrap());
        (directory, paths, whole, encode(2, &memory(2)).unwrap())
    }

    #[test]
    fn a_write_that_breaks_off_at_any_byte_leaves_what_was_kept_before_or_after_it() {
        let (directory, paths, whole, old) = three_commands();
        let used = whole.iter().rposition(|byte| *byte != 0).unwrap() + 1;
        for torn in 0..=used {
            let mixed = [&whole[..torn], &old[torn..]].concat();
            // In the first file, while the second has what was before; then in the second.
            for (first, second) in [(&mixed, &old), (&whole, &mixed)] {
                fs::write(&paths[0], first).unwrap();
                fs::write(&paths[1], second).unwrap();
                let (_, read, _) = open(directory.path());
                let newest = if first == &whole { 3..=3 } else { 2..=3 };
                assert!(newest.map(memory).any(|memory| read == Some(memory)), "torn at {torn}");
            }
        }
    }

    #[test]
    fn a_copy_that_is_cut_damaged_or_gone_is_complained_about_and_the_other_is_taken() {
        let (directory, paths, whole, _) = three_commands();
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let used = whole.iter().rposition(|byte| *byte != 0).unwrap() + 1;
        for path in &paths {
            let check = |what: String| {
                let (_, read, complaints) = open(directory.path());
                assert_eq!((read, complaints.len()), (Some(memory(3)), 1), "{what}");
            };
            for cut in 0..used {
                fs::write(path, &whole[..cut]).unwrap();
                check(format!("cut at {cut}"));
            }
            for _ in 0..1000 {
                let mut damaged = whole.clone();
                for _ in 0..random.random_range(1..=8) {
                    let at = random.random_range(0..used);
                    damaged[at] ^= random.random_range(1..=255_u8);
                }
                if damaged != whole {
                    fs::write(path, &damaged).unwrap();
                    check(format!("{damaged:?}"));
                }
            }
            fs::remove_file(path).unwrap();
            check("gone".to_owned());
            fs::write(path, &whole).unwrap();
        }
    }

    #[test]
    fn where_both_are_damaged_nothing_is_believed_and_both_are_named() {
        let (directory, paths, whole, _) = three_commands();
        let mut random = ChaCha8Rng::seed_from_u64(2);
        for _ in 0..1000 {
            for path in &paths {
                let mut damaged = whole.clone();
                damaged[random.random_range(0..HEAD + 8)] ^= random.random_range(1..=255_u8);
                fs::write(path, &damaged).unwrap();
            }
            let (_, read, complaints) = open(directory.path());
            assert_eq!((read, complaints.len()), (None, 2));
        }
    }

    #[test]
    fn a_directory_that_cannot_be_had_is_named_and_used_once_it_can() {
        let room = tempfile::tempdir().unwrap();
        let directory = room.path().join("state");
        fs::write(&directory, "a file").unwrap();
        let (mut ledger, read, complaints) = open(&directory);
        assert_eq!((read, complaints.len()), (None, 2));
        assert!(complaints[0].contains("state/commands.0"), "{complaints:?}");
        assert!(ledger.write(&memory(1)).is_err());
        fs::remove_file(&directory).unwrap();
        ledger.write(&memory(1)).unwrap();
        assert_eq!(open(&directory).1, Some(memory(1)));
    }
}
