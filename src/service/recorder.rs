//! The recorder: keeps every outcome on disk, one JSON object a line.
//!
//! The disk may be slow, full or dead: outcomes wait in a bounded queue, from which the oldest is lost and counted, an
//! error is counted, logged and tried again later, and nobody else is held up.

use super::clock::Clock;
use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::pulse::Pulse;
use super::state::Finished;
use super::supervisor::{Backoff, Ended, panic_message};
use std::collections::VecDeque;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::mpsc;
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Where outcomes are handed to the recorder.
pub type Handle = mpsc::Sender<Arc<Finished>>;

/// The recorder's actor.
#[derive(Clone)]
pub struct Recorder {
    /// Outcomes to keep.
    pub inbox: Inbox<Arc<Finished>>,
    /// Whom to tell what was kept and what was lost.
    pub hub: hub::Handle,
    /// What is not on disk yet, and the file.
    pub lines: Lines,
    /// Outcomes that may wait for the disk.
    pub queue: usize,
    /// Pauses after an error of the disk.
    pub backoff: Backoff,
    /// When to end.
    pub stop: CancellationToken,
}

/// What is not on disk yet, and the file that it goes to. It outlives the actor, so that nothing is lost with it.
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

    /// Writes the oldest outcome; whether there was one. Blocking.
    fn write_one(&self) -> io::Result<bool> {
        // One that broke off within a line says so itself.
        let mut log = self.log.lock().unwrap_or_else(PoisonError::into_inner);
        let next = {
            let mut items = self.items();
            let next = items.under_way.take().or_else(|| items.waiting.pop_front());
            items.under_way.clone_from(&next);
            next
        };
        let Some(finished) = next else { return Ok(false) };
        let result = log.append(&finished);
        let mut items = self.items();
        items.under_way = None;
        if result.is_err() {
            items.waiting.push_front(finished);
        }
        result.map(|()| true)
    }
}

/// The name of this start's file: the time, where there is one, and the number of the start, so that no two are the same.
pub fn file_name(clock: &Clock) -> String {
    let time = clock.utc().0.map_or_else(|| "unset".to_owned(), |utc| utc.to_string().replace(':', "-"));
    format!("outcomes-{time}-{:08x}.jsonl", clock.boot_id())
}

/// What the actor holds while it runs.
struct Desk {
    writing: Option<JoinHandle<io::Result<bool>>>,
    not_before: Instant,
}

impl Recorder {
    /// Runs until stopped; then what waits is written, as far as the disk takes it.
    pub async fn run(mut self, pulse: Pulse) -> Result<(), Ended> {
        let inbox = self.inbox.clone();
        let mut inbox = inbox.open().await;
        let mut desk = Desk { writing: None, not_before: Instant::now() };
        let mut ending = false;
        loop {
            self.write_next(&mut desk);
            if ending && desk.writing.is_none() {
                return Ok(());
            }
            let waits = desk.writing.is_none() && !self.lines.items().waiting.is_empty();
            tokio::select! {
                biased;
                done = async { desk.writing.as_mut()?.await.into() }, if desk.writing.is_some() => {
                    desk.writing = None;
                    let Some(done) = done else { continue };
                    self.after_write(&mut desk, done.map_err(|error| Ended(panic_message(error)))?).await;
                }
                () = self.stop.cancelled(), if !ending => {
                    ending = true;
                    // A disk that had an error a moment ago is tried once more.
                    desk.not_before = Instant::now();
                    while let Ok(finished) = inbox.try_recv() {
                        self.accept(finished).await;
                    }
                }
                Some(finished) = inbox.recv(), if !ending => self.accept(finished).await,
                () = tokio::time::sleep_until(desk.not_before), if waits => {}
                () = pulse.rest() => {}
            }
        }
    }

    /// Starts to write the oldest outcome, unless the disk is busy or had an error a moment ago.
    fn write_next(&self, desk: &mut Desk) {
        let is_free = desk.writing.is_none() && Instant::now() >= desk.not_before;
        if is_free && !self.lines.items().is_empty() {
            let lines = self.lines.clone();
            desk.writing = Some(tokio::task::spawn_blocking(move || lines.write_one()));
        }
    }

    async fn after_write(&mut self, desk: &mut Desk, result: io::Result<bool>) {
        match result {
            Ok(true) => {
                self.backoff.reset();
                self.hub.tell(ToHub::Recorded).await;
            }
            Ok(false) => {}
            Err(error) => {
                let pause = self.backoff.pause();
                tracing::warn!(%error, again_in_s = pause.as_secs_f64(), "outcome not kept yet");
                desk.not_before = Instant::now() + pause;
                self.hub.tell(ToHub::DiskError).await;
                self.lose_what_is_too_much().await;
            }
        }
    }

    async fn accept(&self, finished: Arc<Finished>) {
        self.lines.items().waiting.push_back(finished);
        self.lose_what_is_too_much().await;
    }

    async fn lose_what_is_too_much(&self) {
        while self.lines.items().lose_one(self.queue) {
            self.hub.tell(ToHub::RecordLost).await;
        }
    }
}

impl Items {
    fn is_empty(&self) -> bool {
        self.waiting.is_empty() && self.under_way.is_none()
    }

    /// Loses the oldest where more than so many wait; whether one was lost.
    fn lose_one(&mut self, queue: usize) -> bool {
        self.waiting.len() > queue && self.waiting.pop_front().is_some()
    }
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
