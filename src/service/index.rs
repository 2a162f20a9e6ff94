//! The index of triangles on disk, so that only the first start with a camera and its settings builds it.
//!
//! The cache is a help and no more: one that cannot be had, read, believed or written costs a build and a line, never the start.

use crate::catalog::{FILE_PREFIX, Field, FieldKey, MAX_FIELD_BYTES};
use crate::solve::Solver;
use std::ffi::OsString;
use std::fs::{self, DirEntry, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::SystemTime;

/// Indexes that are kept, the last used ones: a camera needs one, and trials with other settings must not fill the disk.
const KEPT: usize = 4;

/// Where an index came from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum IndexOrigin {
    /// The solver had it already.
    Held,
    /// From the cache.
    Read,
    /// Built, from the catalogue.
    Built,
}

/// How a solver was made ready.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Prepared {
    /// Where its index came from.
    pub origin: IndexOrigin,
    /// What is wrong with the cache, for the operator.
    pub complaints: Vec<String>,
}

impl Prepared {
    /// What was done, as in "the index was …".
    pub fn word(&self) -> &'static str {
        match self.origin {
            IndexOrigin::Held => "there",
            IndexOrigin::Read => "read from the cache",
            IndexOrigin::Built => "built",
        }
    }
}

/// Makes a solver ready for frames of `width` × `height` px: with the index from the directory that the settings name, or with a new
/// one, which is then kept there.
pub fn prepare(solver: &mut Solver, width: usize, height: usize) -> Prepared {
    let key = solver.field_key(width, height);
    if solver.field().is_some_and(|field| field.key == key) {
        return Prepared { origin: IndexOrigin::Held, complaints: Vec::new() };
    }
    let name = solver.settings().catalog.cache_directory.clone();
    let directory = directory(&name, std::env::var_os("HOME"));
    let mut complaints = Vec::new();
    if let Ok(Some(directory)) = &directory {
        let file = directory.join(key.file_name());
        match read(&file, &key) {
            Ok(None) => {}
            Ok(Some(field)) => {
                solver.set_field(Arc::new(field));
                return Prepared { origin: IndexOrigin::Read, complaints };
            }
            Err(why) => complaints.push(format!("{}: {why}; the index is built anew", file.display())),
        }
    }
    solver.prepare(width, height);
    let kept = directory.and_then(|directory| match (directory, solver.field()) {
        (Some(directory), Some(field)) => write(&directory, field).map_err(|error| error.to_string()),
        _ => Ok(()),
    });
    if let Err(why) = kept {
        complaints.push(format!("catalog.cache_directory = \"{name}\": the index cannot be kept there: {why}"));
    }
    Prepared { origin: IndexOrigin::Built, complaints }
}

/// The directory of a setting; none where it is empty. A path that begins with `~/` lies in the user's home directory.
fn directory(name: &str, home: Option<OsString>) -> Result<Option<PathBuf>, String> {
    if name.is_empty() {
        return Ok(None);
    }
    let Some(below) = name.strip_prefix("~/") else { return Ok(Some(PathBuf::from(name))) };
    let home = home.filter(|home| !home.is_empty()).ok_or("there is no home directory (HOME is not set)")?;
    Ok(Some(Path::new(&home).join(below)))
}

/// Reads an index; `None` where there is no such file. The error says why it is not believed.
fn read(path: &Path, key: &FieldKey) -> Result<Option<Field>, String> {
    // What is no file, such as a pipe, could keep the start waiting.
    let meta = match fs::metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        meta => meta.map_err(|error| error.to_string())?,
    };
    if !meta.is_file() {
        return Err("is not a file".to_owned());
    }
    if meta.len() > MAX_FIELD_BYTES {
        return Err(format!("is longer than {MAX_FIELD_BYTES} bytes"));
    }
    let mut file = File::open(path).map_err(|error| error.to_string())?;
    let field = Field::load(&mut file, meta.len(), key).map_err(|error| error.to_string())?;
    #[allow(clippy::disallowed_methods, reason = "marks a file as used, by the clock that marks it as written")]
    let now = SystemTime::now();
    // Where it can't be marked, it is forgotten sooner.
    let _ = file.set_modified(now);
    Ok(Some(field))
}

/// Writes an index, whole or not at all. Not forced onto the disk: one that a power cut left in pieces is refused when it is read.
fn write(directory: &Path, field: &Field) -> io::Result<()> {
    /// Tells apart what the threads of one process write at the same time.
    static WRITTEN: AtomicU32 = AtomicU32::new(0);
    fs::create_dir_all(directory)?;
    let name = field.key.file_name();
    let number = WRITTEN.fetch_add(1, Ordering::Relaxed);
    let unfinished = directory.join(format!("{name}.{}-{number}", std::process::id()));
    let written = File::create(&unfinished)
        .and_then(|mut file| field.save(&mut file))
        .and_then(|()| fs::rename(&unfinished, directory.join(&name)));
    if written.is_err() {
        // The first error is the one to tell.
        let _ = fs::remove_file(&unfinished);
    }
    written.and_then(|()| forget(directory))
}

/// Removes all but the last used indexes, and what a broken-off write left behind.
fn forget(directory: &Path) -> io::Result<()> {
    let is_ours = |entry: &DirEntry| entry.file_name().to_string_lossy().starts_with(FILE_PREFIX);
    let used = |entry: &DirEntry| entry.metadata().and_then(|meta| meta.modified()).unwrap_or(SystemTime::UNIX_EPOCH);
    let ours = fs::read_dir(directory)?.filter_map(Result::ok).filter(is_ours);
    let mut ours: Vec<(SystemTime, PathBuf)> = ours.map(|entry| (used(&entry), entry.path())).collect();
    ours.sort();
    let old = ours.len().saturating_sub(KEPT);
    // Another process may have removed it first.
    ours.iter().take(old).for_each(|(_, path)| drop(fs::remove_file(path)));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::catalog::Catalogue;
    use crate::settings::{Layers, Settings};

    /// A few bright stars for a wide field, so that an index is built at once.
    fn solver(cache: &Path, width: usize) -> Solver {
        let mut catalogue = Catalogue::embedded().unwrap();
        catalogue.stars.truncate(2000);
        let mut settings: Settings = Layers::embedded().load().unwrap().settings;
        settings.catalog.cache_directory = cache.to_str().unwrap().to_owned();
        settings.solver.matching.platescale_min_arcsec_px = 150.0;
        settings.solver.matching.platescale_max_arcsec_px = 160.0 + width as f64 / 1e3;
        Solver::new(Arc::new(catalogue), Arc::new(settings))
    }

    fn prepared(cache: &Path, width: usize) -> Prepared {
        prepare(&mut solver(cache, width), width, 200)
    }

    fn files(cache: &Path) -> Vec<PathBuf> {
        fs::read_dir(cache).unwrap().map(|entry| entry.unwrap().path()).collect()
    }

    #[test]
    fn the_second_start_reads_what_the_first_one_built() {
        let directory = tempfile::tempdir().unwrap();
        let cache = directory.path().join("made/when/needed");
        assert_eq!(prepared(&cache, 300), Prepared { origin: IndexOrigin::Built, complaints: Vec::new() });
        let mut second = solver(&cache, 300);
        assert_eq!(prepare(&mut second, 300, 200).origin, IndexOrigin::Read);
        assert_eq!(prepare(&mut second, 300, 200).origin, IndexOrigin::Held);
        assert_eq!(prepare(&mut second, 200, 300).origin, IndexOrigin::Built, "another size of frame");
        assert_eq!(prepared(&cache, 301).origin, IndexOrigin::Built, "another plate scale");
    }

    #[test]
    fn what_is_not_to_be_believed_is_named_and_replaced() {
        let cache = tempfile::tempdir().unwrap();
        prepared(cache.path(), 300);
        let [file] = &files(cache.path())[..] else { panic!("one file") };
        let whole = fs::read(file).unwrap();
        let mut altered = whole.clone();
        altered[whole.len() / 2] ^= 1;
        for bytes in [&whole[..whole.len() - 1], &altered, b"something else", b""] {
            fs::write(file, bytes).unwrap();
            let Prepared { origin, complaints } = prepared(cache.path(), 300);
            assert_eq!((origin, complaints.len()), (IndexOrigin::Built, 1), "{complaints:?}");
            assert!(complaints[0].starts_with(file.to_str().unwrap()), "{complaints:?}");
            assert_eq!(fs::read(file).unwrap(), whole);
            assert_eq!(prepared(cache.path(), 300).origin, IndexOrigin::Read);
        }
    }

    #[test]
    fn a_cache_that_cannot_be_written_is_one_line_and_the_index_is_there() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut solver = solver(&file.path().join("below-a-file"), 300);
        let Prepared { origin, complaints } = prepare(&mut solver, 300, 200);
        assert_eq!(origin, IndexOrigin::Built);
        assert!(complaints.iter().any(|line| line.starts_with("catalog.cache_directory = ")), "{complaints:?}");
        assert!(solver.field().is_some());
    }

    #[test]
    fn the_last_few_are_kept_and_nothing_else_is_touched() {
        let cache = tempfile::tempdir().unwrap();
        fs::write(cache.path().join("notes.txt"), "mine").unwrap();
        for width in 300..304 + KEPT {
            prepared(cache.path(), width);
        }
        assert_eq!(files(cache.path()).len(), KEPT + 1);
        assert_eq!(prepared(cache.path(), 303 + KEPT).origin, IndexOrigin::Read);
        assert!(cache.path().join("notes.txt").exists());
    }

    #[test]
    fn a_directory_may_lie_at_home_or_be_none() {
        let home = || Some(OsString::from("/home/me"));
        assert_eq!(directory("", home()).unwrap(), None);
        assert_eq!(directory("/var/cache/stars", None).unwrap(), Some(PathBuf::from("/var/cache/stars")));
        assert_eq!(directory("~/.cache/stars", home()).unwrap(), Some(PathBuf::from("/home/me/.cache/stars")));
        assert!(directory("~/.cache/stars", None).unwrap_err().contains("HOME"));
        assert!(directory("~/.cache/stars", Some(OsString::new())).is_err());
    }
}
