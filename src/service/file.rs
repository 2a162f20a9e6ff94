//! Reading files that settings or a caller name: of bounded length, and with errors that say which file and what was expected.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Why a file cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The system refuses.
    #[error("{name}: cannot be {done}, expected {expected}: {error}")]
    Io {
        /// The file.
        name: String,
        /// What could not be done with it.
        done: &'static str,
        /// What it should be.
        expected: &'static str,
        /// The system's own words.
        error: io::Error,
    },
    /// It is a directory.
    #[error("{name}: is a directory, expected {expected}")]
    Directory {
        /// The directory.
        name: String,
        /// What it should be.
        expected: &'static str,
    },
    /// It is longer than such a file can be.
    #[error("{name}: is longer than {limit} bytes, expected {expected}")]
    TooLong {
        /// The file.
        name: String,
        /// Greatest length, bytes.
        limit: usize,
        /// What it should be.
        expected: &'static str,
    },
}

/// The bytes of a file of at most `limit` bytes; `expected` says what it should be, as in `a star catalogue`. A pipe is read too.
///
/// # Errors
/// Where it can't be opened or read, is a directory, or is longer: naming the wrong file costs nothing.
pub fn read_file(path: &Path, limit: usize, expected: &'static str) -> Result<Vec<u8>, FileError> {
    let name = || path.display().to_string();
    let refused = |done| move |error| FileError::Io { name: name(), done, expected, error };
    let too_long = || FileError::TooLong { name: name(), limit, expected };
    let file = File::open(path).map_err(refused("opened"))?;
    let meta = file.metadata().map_err(refused("read"))?;
    if meta.is_dir() {
        return Err(FileError::Directory { name: name(), expected });
    }
    // Before a byte of it is read; what has no length of its own, such as a pipe, is measured as it comes.
    if meta.len() > limit as u64 {
        return Err(too_long());
    }
    let mut bytes = Vec::new();
    file.take(limit as u64 + 1).read_to_end(&mut bytes).map_err(refused("read"))?;
    if bytes.len() > limit { Err(too_long()) } else { Ok(bytes) }
}

/// Free space of the disk that a directory is on, or will be on once it is made, for a program without privileges, bytes.
///
/// # Errors
/// Of the disk.
pub fn free_bytes(directory: &Path) -> io::Result<u64> {
    let there = directory.ancestors().find(|path| path.exists()).filter(|path| !path.as_os_str().is_empty());
    let there = there.unwrap_or(if directory.is_absolute() { Path::new("/") } else { Path::new(".") });
    let disk = rustix::fs::statvfs(there)?;
    Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_read_up_to_its_limit_and_everything_else_is_refused_by_name() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        std::fs::write(at("ten"), "0123456789").unwrap();
        assert_eq!(read_file(&at("ten"), 10, "ten digits").unwrap(), b"0123456789");
        let refused = |name: &str, limit| read_file(&at(name), limit, "ten digits").unwrap_err().to_string();
        assert!(refused("ten", 9).ends_with("ten: is longer than 9 bytes, expected ten digits"));
        assert!(refused("", 9).ends_with("is a directory, expected ten digits"));
        assert!(refused("none", 9).contains("none: cannot be opened, expected ten digits: "));
        // Endless, and without a length of its own.
        let endless = read_file(Path::new("/dev/zero"), 9, "ten digits").unwrap_err();
        assert!(matches!(endless, FileError::TooLong { limit: 9, .. }), "{endless}");
    }
}
