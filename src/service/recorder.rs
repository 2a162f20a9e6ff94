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
use std::sync::Arc;
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
    /// The file that lines are appended to; its directory is made if it is not there.
    pub file: PathBuf,
    /// Outcomes that may wait for the disk.
    pub queue: usize,
    /// Pauses after an error of the disk.
    pub backoff: Backoff,
    /// When to end.
    pub stop: CancellationToken,
}

/// The name of this start's file: the time, where there is one, and the number of the start, so that no two are the same.
pub fn file_name(clock: &Clock) -> String {
    let time = clock.utc().0.map_or_else(|| "unset".to_owned(), |utc| utc.to_string().replace(':', "-"));
    format!("outcomes-{time}-{:08x}.jsonl", clock.boot_id())
}

/// A write under way; the log and the outcome come back from it with the result.
type Writing = JoinHandle<(LogFile, Arc<Finished>, io::Result<()>)>;

/// What the actor holds while it runs.
struct Desk {
    waiting: VecDeque<Arc<Finished>>,
    /// The log file, unless a write has it.
    log: Option<LogFile>,
    writing: Option<Writing>,
    not_before: Instant,
}

impl Recorder {
    /// Runs until stopped; then what waits is written, as far as the disk takes it.
    pub async fn run(mut self, pulse: Pulse) -> Result<(), Ended> {
        let inbox = self.inbox.clone();
        let mut inbox = inbox.open().await;
        let log = Some(LogFile::new(self.file.clone()));
        let mut desk = Desk { waiting: VecDeque::new(), log, writing: None, not_before: Instant::now() };
        let mut ending = false;
        loop {
            desk.write_next();
            if ending && desk.writing.is_none() {
                return Ok(());
            }
            tokio::select! {
                biased;
                done = async { desk.writing.as_mut()?.await.into() }, if desk.writing.is_some() => {
                    desk.writing = None;
                    let Some(done) = done else { continue };
                    let (log, finished, result) = done.map_err(|error| Ended(panic_message(error)))?;
                    desk.log = Some(log);
                    self.after_write(&mut desk, finished, result).await;
                }
                () = self.stop.cancelled(), if !ending => {
                    ending = true;
                    while let Ok(finished) = inbox.try_recv() {
                        self.accept(&mut desk.waiting, finished).await;
                    }
                }
                Some(finished) = inbox.recv(), if !ending => self.accept(&mut desk.waiting, finished).await,
                () = tokio::time::sleep_until(desk.not_before), if desk.writing.is_none() && !desk.waiting.is_empty() => {}
                () = pulse.rest() => {}
            }
        }
    }

    async fn after_write(&mut self, desk: &mut Desk, finished: Arc<Finished>, result: io::Result<()>) {
        match result {
            Ok(()) => {
                self.backoff.reset();
                self.hub.tell(ToHub::Recorded).await;
            }
            Err(error) => {
                let pause = self.backoff.pause();
                let again_in_s = pause.as_secs_f64();
                tracing::warn!(file = %self.file.display(), %error, again_in_s, "outcome not kept yet");
                desk.not_before = Instant::now() + pause;
                desk.waiting.push_front(finished);
                self.hub.tell(ToHub::DiskError).await;
                self.lose_what_is_too_much(&mut desk.waiting).await;
            }
        }
    }

    async fn accept(&self, waiting: &mut VecDeque<Arc<Finished>>, finished: Arc<Finished>) {
        waiting.push_back(finished);
        self.lose_what_is_too_much(waiting).await;
    }

    async fn lose_what_is_too_much(&self, waiting: &mut VecDeque<Arc<Finished>>) {
        while waiting.len() > self.queue {
            waiting.pop_front();
            self.hub.tell(ToHub::RecordLost).await;
        }
    }
}

impl Desk {
    /// Starts to write the oldest outcome, unless the disk is busy or had an error a moment ago.
    fn write_next(&mut self) {
        if self.waiting.is_empty() || Instant::now() < self.not_before {
            return;
        }
        if let Some(mut log) = self.log.take()
            && let Some(finished) = self.waiting.pop_front()
        {
            self.writing = Some(tokio::task::spawn_blocking(move || {
                let result = log.append(&finished);
                (log, finished, result)
            }));
        }
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
        if result.is_err() {
            self.file = None;
        }
        result
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
