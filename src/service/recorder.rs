//! The recorder: the [keeper](super::keeper) of outcomes, one JSON object a line.

use super::clock::Clock;
use super::hub::ToHub;
use super::keeper::Backlog;
use super::state::Finished;
use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::mpsc;
use tokio::time::Instant;

/// Where outcomes are handed to the recorder.
pub type Handle = mpsc::Sender<Arc<Finished>>;

/// The outcomes that are not on disk yet, and the file that they go to.
#[derive(Clone)]
pub struct Lines {
    /// Whoever writes has it.
    log: Arc<Mutex<LogFile>>,
    items: Arc<Mutex<Items>>,
}

#[derive(Default)]
struct Items {
    waiting: VecDeque<Arc<Finished>>,
    /// What is being written.
    under_way: Option<Arc<Finished>>,
}

impl Lines {
    /// Of a file that lines are appended to; its directory is made if it is not there.
    pub fn new(file: PathBuf) -> Self {
        Self { log: Arc::new(Mutex::new(LogFile::new(file))), items: Arc::default() }
    }

    fn items(&self) -> MutexGuard<'_, Items> {
        // Nothing can break between two steps of a change to it.
        self.items.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Backlog for Lines {
    type Item = Arc<Finished>;
    const WHAT: &'static str = "outcome";

    fn accept(&self, finished: Arc<Finished>) {
        self.items().waiting.push_back(finished);
    }

    fn next_due(&self, now: Instant) -> Option<Instant> {
        let items = self.items();
        (items.under_way.is_some() || !items.waiting.is_empty()).then_some(now)
    }

    fn hurry(&self, _: Instant) {}

    fn write_one(&self, _: Instant) -> io::Result<Option<ToHub>> {
        // One that broke off within a line says so itself.
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        let next = {
            let mut items = self.items();
            let next = items.under_way.take().or_else(|| items.waiting.pop_front());
            items.under_way.clone_from(&next);
            next
        };
        let Some(finished) = next else { return Ok(None) };
        let result = log.append(&finished);
        let mut items = self.items();
        items.under_way = None;
        if result.is_err() {
            items.waiting.push_front(finished);
        }
        result.map(|()| Some(ToHub::Recorded))
    }

    fn lose_one(&self, most: usize) -> Option<Option<ToHub>> {
        let mut items = self.items();
        (items.waiting.len() > most && items.waiting.pop_front().is_some()).then_some(Some(ToHub::RecordLost))
    }

    fn disk_error(&self) -> ToHub {
        ToHub::DiskError
    }
}

/// The name of this start's file: the time, where there is one, and the number of the start, so that no two are the same.
pub fn file_name(clock: &Clock) -> String {
    let time = clock.time().utc.map_or_else(|| "unset".to_owned(), |utc| utc.to_string().replace(':', "-"));
    format!("outcomes-{time}-{:08x}.jsonl", clock.boot_id())
}

/// A file of lines that may be on a bad disk.
struct LogFile {
    path: PathBuf,
    file: Option<File>,
    /// A write broke off and could not be taken back, so that the file may end within a line.
    torn: bool,
}

impl LogFile {
    fn new(path: PathBuf) -> Self {
        Self { path, file: None, torn: false }
    }

    /// Appends one outcome as a line, down to the disk.
    fn append(&mut self, finished: &Finished) -> io::Result<()> {
        let mut line = serde_json::to_string(&finished.report)?;
        line.push('\n');
        let result = self.write(&line);
        result.map_err(|error| {
            self.file = None;
            io::Error::new(error.kind(), format!("{}: {error}", self.path.display()))
        })
    }

    fn write(&mut self, line: &str) -> io::Result<()> {
        // A file whose directory was removed takes lines that nobody can ever read.
        if let Some(file) = &self.file
            && file.metadata()?.nlink() == 0
        {
            self.file = None;
        }
        if self.file.is_none() {
            if let Some(directory) = self.path.parent() {
                std::fs::create_dir_all(directory)?;
            }
            self.file = Some(OpenOptions::new().create(true).append(true).open(&self.path)?);
        }
        let Some(file) = &mut self.file else { return Ok(()) };
        if self.torn && file.metadata()?.len() > 0 {
            file.write_all(b"\n")?;
        }
        self.torn = false;
        let whole = file.metadata()?.len();
        let written = file.write_all(line.as_bytes()).and_then(|()| file.sync_data());
        if written.is_err() {
            // What is there of the line goes again: it will be written once more, and the file has whole lines alone.
            self.torn = file.set_len(whole).is_err();
        }
        written
    }
}
