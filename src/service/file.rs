//! Reading files that a caller names: of bounded length, and with errors that say which file and what was expected.

use anyhow::{Context, bail};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The bytes of a file of at most `limit` bytes; `expected` says what it should be, as in `a star catalogue`.
///
/// # Errors
/// Where it can't be opened or read, is a directory, or is longer: naming the wrong file costs nothing.
pub fn read(path: &Path, limit: usize, expected: &str) -> anyhow::Result<Vec<u8>> {
    let name = path.display();
    let file = File::open(path).with_context(|| format!("{name}: cannot be opened, expected {expected}"))?;
    if file.metadata().with_context(|| format!("{name}: cannot be read, expected {expected}"))?.is_dir() {
        bail!("{name}: is a directory, expected {expected}");
    }
    let mut bytes = Vec::new();
    let read = file.take(limit as u64 + 1).read_to_end(&mut bytes);
    read.with_context(|| format!("{name}: cannot be read, expected {expected}"))?;
    if bytes.len() > limit {
        bail!("{name}: is longer than {limit} bytes, expected {expected}");
    }
    Ok(bytes)
}
