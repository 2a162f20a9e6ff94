//! The journal's file: the [keeper](super::keeper) of every input that the core sees, so that a flight can be run again.
//!
//! Whoever drives a machine of the core [notes](Handle::note) what it told the machine; that costs no more than a place in a queue, and
//! where there is none the entry is counted, and the journal says itself how many are missing. Entries go to the disk together, every few
//! seconds, into files of a bounded length. The journal gives way to the log: see [`Rules`].

use super::clock::Clock;
use super::file::free_bytes;
use super::hub::ToHub;
use super::keeper::Backlog;
use super::solver::Captured;
use crate::command::{BootId, Tick};
use crate::image::Frame;
use crate::journal::{Begin, Entry, Exposure, OutcomeMark, Solved, Text, What, Writer, pixel_sum};
use crate::settings::Settings;
use crate::sky::ClockReading;
use crate::solve::{Outcome, Prior, Window};
use std::collections::{BTreeSet, VecDeque};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// Entries that may wait for the disk: half an hour of what two flight computers and a lens send.
pub const WAITING: usize = 16_384;
/// Frames of which the pixels are held until there is time for their checksums.
const WITH_PIXELS: usize = 8;
/// Entries are written together where they come within this time, which is what a power cut costs; a frame waits no longer than the second,
/// so that it can soon be run again.
const TOGETHER: Duration = Duration::from_secs(5);
const FRAME_WITHIN: Duration = Duration::from_secs(1);
/// Entries that are written at a time.
const AT_A_TIME: usize = 1024;
/// A file is not made longer, bytes: some hours of a flight. What is thinned goes by files.
const FILE_BYTES: u64 = 16 << 20;
/// Frames that operators may have run again by the running service: as many as the strip of its page has by the flight's settings.
const RECENT: usize = 120;
/// How the files are called.
const PREFIX: &str = "journal-";
/// See [`PREFIX`].
pub const EXTENSION: &str = "journal";

/// A frame and what the solver made of it, before there was time to write it down.
#[derive(Debug, Clone)]
pub struct SolvedNote {
    /// The frame, and what was known of it beforehand with what earlier ones had shown.
    pub captured: Captured,
    /// What the flight computer sent of the pointing.
    pub sent: Prior,
    /// When it was captured, since the solver's actor began.
    pub since: Duration,
    /// Whether it was solved before, and is again because its motion has come.
    pub again: bool,
    /// The settings in force.
    pub settings: Arc<Settings>,
    /// Where it was stopped.
    pub window: Window,
    /// How it ended.
    pub outcome: Outcome,
}

/// What is to be noted.
#[derive(Debug, Clone)]
pub enum Note {
    /// An entry as it will stand there.
    Entry(Entry),
    /// A frame, with its time.
    Solved(Tick, Box<SolvedNote>),
    /// The same, its pixels gone.
    Written(Recent),
}

/// A frame that was written down, and the settings that it was solved with.
#[derive(Debug, Clone)]
pub struct Recent {
    /// When it was captured.
    pub at: Tick,
    /// The frame.
    pub solved: Box<Solved>,
    /// The settings.
    pub settings: Arc<Settings>,
}

/// Where entries are noted; by default nowhere.
#[derive(Debug, Clone, Default)]
pub struct Handle(Option<Open>);

#[derive(Debug, Clone)]
struct Open {
    sender: mpsc::Sender<Note>,
    clock: Clock,
    lost: Arc<AtomicU32>,
    recent: Arc<Mutex<VecDeque<Recent>>>,
}

impl Handle {
    /// Where a backlog's notes are handed to its keeper.
    pub fn new(sender: mpsc::Sender<Note>, clock: Clock, pages: &Pages) -> Self {
        Self(Some(Open { sender, clock, lost: Arc::clone(&pages.lost), recent: Arc::clone(&pages.recent) }))
    }

    /// Notes what a machine was told at a time; never waits.
    pub fn note(&self, at: Tick, what: What) {
        if let Some(open) = &self.0 {
            open.put(Note::Entry(Entry { at, what }));
        }
    }

    /// Notes what the solver made of a frame.
    pub fn solved(&self, note: impl FnOnce() -> SolvedNote) {
        if let Some(open) = &self.0 {
            let note = note();
            open.put(Note::Solved(open.clock.tick(note.captured.at), Box::new(note)));
        }
    }

    /// The last frames that were written down, the oldest first.
    pub fn recent(&self) -> Vec<Recent> {
        let recent = self.0.iter().map(|open| open.recent.lock().unwrap_or_else(PoisonError::into_inner).clone());
        recent.flatten().collect()
    }
}

impl Open {
    fn put(&self, note: Note) {
        if self.sender.try_send(note).is_err() {
            self.lost.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Where journals are kept, and how much room they may take.
///
/// Where they take more than the limit, or the disk has less free than half of what images leave free, the oldest files go, down to the
/// one that is being written; and where that does not help nothing is written. So the log has a disk of its own, near enough: images leave
/// the reserve to log and journal, and the journal leaves half of it to the log.
#[derive(Debug, Clone)]
pub struct Rules {
    /// The directory, made if it is not there.
    pub directory: PathBuf,
    /// What all of them may take, bytes; 0: as much as there is.
    pub limit_bytes: u64,
    /// What stays free on the disk, bytes.
    pub reserve_bytes: u64,
    /// What this run's files are called before their number.
    pub stem: String,
    /// The number of this start.
    pub boot: BootId,
}

/// What this start's files are called before their number: the time, where there is one, and the number of the start.
pub fn stem(clock: &Clock) -> String {
    let time = clock.time().utc.map_or_else(|| "unset".to_owned(), |utc| utc.to_string().replace(':', "-"));
    format!("{PREFIX}{time}-{:08x}", clock.boot_id())
}

/// The journals in a directory with their lengths, bytes, the oldest first.
///
/// # Errors
/// Of the disk.
pub fn files(directory: &Path) -> io::Result<Vec<(PathBuf, u64)>> {
    let mut found = Vec::new();
    for file in fs::read_dir(directory)? {
        let file = file?;
        let (path, meta) = (file.path(), file.metadata()?);
        let name = file.file_name();
        if meta.is_file() && path.extension().is_some_and(|e| e == EXTENSION) && name.to_string_lossy().starts_with(PREFIX) {
            found.push((meta.mtime(), meta.mtime_nsec(), path, meta.len()));
        }
    }
    found.sort_unstable();
    Ok(found.into_iter().map(|(.., path, bytes)| (path, bytes)).collect())
}

/// What waits to be written, and when it is to be.
#[derive(Default)]
struct Waiting {
    notes: VecDeque<Note>,
    due: Option<Instant>,
}

/// What waits to be written, and the files that it goes to.
#[derive(Clone)]
pub struct Pages {
    /// Whoever writes has it.
    book: Arc<Mutex<Book>>,
    waiting: Arc<Mutex<Waiting>>,
    lost: Arc<AtomicU32>,
    recent: Arc<Mutex<VecDeque<Recent>>>,
    /// Nothing more will come.
    hurries: Arc<AtomicBool>,
    /// The number of this start.
    boot: BootId,
}

impl Pages {
    /// By these rules.
    pub fn new(rules: Rules) -> Self {
        Self {
            boot: rules.boot,
            book: Arc::new(Mutex::new(Book::new(rules))),
            waiting: Arc::default(),
            lost: Arc::default(),
            recent: Arc::default(),
            hurries: Arc::default(),
        }
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting> {
        // Nothing can break between two steps of a change to it.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The oldest that waits; after the last none is due.
    fn next(&self) -> Option<Note> {
        let mut waiting = self.waiting();
        let note = waiting.notes.pop_front();
        if waiting.notes.is_empty() {
            waiting.due = None;
        }
        note
    }

    /// Puts what waits on the page.
    fn fill(&self, book: &mut Book) {
        let lost = self.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            book.page.add(&Entry { at: Tick::ZERO, what: What::Lost(lost) });
        }
        for _ in 0..AT_A_TIME {
            let Some(note) = self.next() else { break };
            let frame = match note {
                Note::Entry(entry) => {
                    book.page.add(&entry);
                    continue;
                }
                Note::Solved(at, note) => recent(at, &note, self.boot, |frame| Some(pixel_sum(frame))),
                Note::Written(recent) => recent,
            };
            book.add_frame(&frame);
            self.remember(frame);
        }
    }

    fn remember(&self, recent: Recent) {
        let mut all = self.recent.lock().unwrap_or_else(PoisonError::into_inner);
        while all.len() >= RECENT {
            all.pop_front();
        }
        all.push_back(recent);
    }
}

impl Backlog for Pages {
    type Item = Note;
    const WHAT: &'static str = "journal";

    fn accept(&self, note: Note) {
        let mut waiting = self.waiting();
        let within = if matches!(note, Note::Solved(..)) { FRAME_WITHIN } else { TOGETHER };
        let due = Instant::now() + within;
        waiting.due = Some(waiting.due.map_or(due, |earlier| earlier.min(due)));
        waiting.notes.push_back(note);
        // The disk is slow: pixels are not held for it.
        let has_pixels = |note: &&mut Note| matches!(note, Note::Solved(..));
        let too_many = waiting.notes.iter_mut().filter(has_pixels).count().saturating_sub(WITH_PIXELS);
        for note in waiting.notes.iter_mut().filter(has_pixels).take(too_many) {
            if let Note::Solved(at, solved) = note {
                *note = Note::Written(recent(*at, solved, self.boot, |_| None));
            }
        }
    }

    fn next_due(&self, now: Instant) -> Option<Instant> {
        let due = self.waiting().due?;
        Some(if self.hurries.load(Ordering::Relaxed) { now } else { due })
    }

    fn hurry(&self, _: Instant) {
        self.hurries.store(true, Ordering::Relaxed);
    }

    fn write_one(&self, now: Instant) -> io::Result<Option<ToHub>> {
        let mut book = self.book.lock().unwrap_or_else(PoisonError::into_inner);
        book.make_ready()?;
        // What an earlier attempt left comes first, and alone: what waits, waits in its bounds.
        if book.unwritten.is_empty() {
            self.fill(&mut book);
        }
        let written = book.write();
        if written.is_err() {
            self.waiting().due.get_or_insert(now);
        }
        written.map(|()| None)
    }

    fn lose_one(&self, most: usize) -> Option<Option<ToHub>> {
        let mut waiting = self.waiting();
        (waiting.notes.len() > most && waiting.notes.pop_front().is_some()).then(|| {
            self.lost.fetch_add(1, Ordering::Relaxed);
            None
        })
    }

    fn disk_error(&self) -> ToHub {
        ToHub::DiskError
    }
}

/// A frame as it is written down.
fn recent(at: Tick, note: &SolvedNote, boot: BootId, checksum: impl Fn(&Frame) -> Option<u32>) -> Recent {
    Recent { at, solved: Box::new(written(note, boot, checksum)), settings: Arc::clone(&note.settings) }
}

fn written(note: &SolvedNote, boot: BootId, checksum: impl Fn(&Frame) -> Option<u32>) -> Solved {
    let SolvedNote { captured, sent, since, again, settings, window, outcome } = note;
    let frame = &captured.frame;
    let exposure =
        |frame: &Arc<Frame>| Exposure { part: frame.stamp.part, full_scale: frame.full_scale, checksum: checksum(frame) };
    let px = |count: usize| u32::try_from(count).unwrap_or(u32::MAX);
    Solved {
        boot,
        stamp: frame.stamp.clone(),
        size_px: (px(frame.width), px(frame.height)),
        rows: frame.rows,
        full_scale: frame.full_scale,
        exposures: captured.exposures.iter().map(exposure).collect(),
        since: *since,
        sent: sent.clone(),
        prior: captured.prior.clone(),
        again: *again,
        motion: captured.motion.as_deref().cloned(),
        settings: settings.fingerprint(),
        window: *window,
        outcome: OutcomeMark::of(outcome),
    }
}

/// The settings as an entry has them.
pub fn text_of(settings: &Settings) -> Text {
    Text { fingerprint: settings.fingerprint(), toml: settings.to_toml() }
}

/// How a run began.
pub fn begin(clock: &Clock, settings: &Settings, kept: &super::Kept) -> What {
    let ClockReading { utc, quality, .. } = clock.time();
    What::Begin(Box::new(Begin {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        boot: BootId(clock.boot_id()),
        utc: utc.map(|utc| (utc, quality)),
        settings: text_of(settings),
        epoch: kept.epoch,
        counters: kept.counters.clone(),
        answers: kept.answers.clone(),
        learned: kept.learned,
    }))
}

/// The file that is being written.
struct Book {
    rules: Rules,
    file: Option<File>,
    path: PathBuf,
    /// The number of the file in this run.
    number: u32,
    /// Settings that this file has, by their fingerprints.
    introduced: BTreeSet<u64>,
    /// The last settings looked at: their fingerprint takes a while.
    last: Option<Arc<Settings>>,
    /// Entries on their way into the file.
    page: Writer,
    /// Bytes that an earlier attempt could not write.
    unwritten: Vec<u8>,
}

impl Book {
    fn new(rules: Rules) -> Self {
        Self {
            path: PathBuf::new(),
            rules,
            file: None,
            number: 0,
            introduced: BTreeSet::new(),
            last: None,
            page: Writer::default(),
            unwritten: Vec::new(),
        }
    }

    /// Opens the next file where there is none that can be gone on with, and makes room.
    fn make_ready(&mut self) -> io::Result<()> {
        let whole = match &self.file {
            // A file whose directory was removed takes entries that nobody can ever read.
            Some(file) => Some(file.metadata()?).filter(|meta| meta.nlink() > 0).map(|meta| meta.len()),
            None => None,
        };
        if self.unwritten.is_empty() && whole.is_none_or(|bytes| bytes >= FILE_BYTES) {
            fs::create_dir_all(&self.rules.directory)?;
            self.path = self.rules.directory.join(format!("{}-{:04}.{EXTENSION}", self.rules.stem, self.number));
            self.file = Some(OpenOptions::new().create(true).append(true).open(&self.path)?);
            self.number = self.number.saturating_add(1);
            (self.introduced, self.last) = (BTreeSet::new(), None);
        }
        self.make_room()
    }

    fn make_room(&self) -> io::Result<()> {
        let Rules { directory, limit_bytes, reserve_bytes, .. } = &self.rules;
        let is_short = || free_bytes(directory).map(|free| free < reserve_bytes / 2);
        let mut all = files(directory)?.into_iter().filter(|(path, _)| *path != self.path).collect::<VecDeque<_>>();
        let own = self.file.as_ref().map_or(Ok(0), |file| file.metadata().map(|meta| meta.len()))?;
        while let Some((path, _)) = all.front() {
            let taken = own + all.iter().map(|(_, bytes)| bytes).sum::<u64>();
            if !(is_short()? || (*limit_bytes > 0 && taken > *limit_bytes)) {
                break;
            }
            fs::remove_file(path)?;
            all.pop_front();
        }
        if is_short()? {
            return Err(io::Error::new(io::ErrorKind::StorageFull, "what is free is held in reserve for the log"));
        }
        Ok(())
    }

    /// Puts settings there before the first frame that was solved with them.
    fn introduce(&mut self, settings: &Arc<Settings>) {
        if self.last.as_ref().is_some_and(|last| Arc::ptr_eq(last, settings)) {
            return;
        }
        self.last = Some(Arc::clone(settings));
        if self.introduced.insert(settings.fingerprint()) {
            self.page.add(&Entry { at: Tick::ZERO, what: What::Settings(text_of(settings)) });
        }
    }

    fn add_frame(&mut self, Recent { at, solved, settings }: &Recent) {
        self.introduce(settings);
        self.page.add(&Entry { at: *at, what: What::Solved(solved.clone()) });
    }

    /// Writes what was added, down to the disk.
    fn write(&mut self) -> io::Result<()> {
        self.unwritten.extend(self.page.take());
        let Some(file) = &mut self.file else { return Ok(()) };
        let whole = file.metadata()?.len();
        let written = file.write_all(&self.unwritten).and_then(|()| file.sync_data());
        if let Err(error) = written {
            // What is there of it goes again; a reader skips it where it does not.
            let _ = file.set_len(whole);
            return Err(io::Error::new(error.kind(), format!("{}: {error}", self.path.display())));
        }
        self.unwritten.clear();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::Reader;

    fn rules(directory: &Path, limit_bytes: u64) -> Rules {
        let (stem, boot) = (format!("{PREFIX}unset-00000007"), BootId(7));
        Rules { directory: directory.to_owned(), limit_bytes, reserve_bytes: 0, stem, boot }
    }

    fn note(number: u32) -> Note {
        Note::Entry(Entry { at: Tick::from_secs(number.into()), what: What::LegacyConnected(crate::command::FlightComputer(1)) })
    }

    fn entries(directory: &Path) -> Vec<Entry> {
        let files = files(directory).unwrap();
        files.iter().flat_map(|(path, _)| Reader::new(&fs::read(path).unwrap()).collect::<Vec<_>>()).collect()
    }

    #[tokio::test]
    async fn what_a_slow_disk_has_no_time_for_is_lost_the_oldest_first_and_the_journal_says_how_many() {
        let directory = tempfile::tempdir().unwrap();
        let pages = Pages::new(rules(directory.path(), 0));
        (0..10).for_each(|number| pages.accept(note(number)));
        while pages.lose_one(4).is_some() {}
        assert!(pages.next_due(Instant::now()).is_some_and(|due| due > Instant::now()), "written together");
        pages.write_one(Instant::now()).unwrap();
        let entries = entries(directory.path());
        assert!(matches!(entries[0].what, What::Lost(6)), "{entries:?}");
        assert_eq!(entries[1..].iter().map(|entry| entry.at.as_secs()).collect::<Vec<_>>(), [6, 7, 8, 9]);
        assert_eq!(pages.next_due(Instant::now()), None);
    }

    #[tokio::test]
    async fn a_disk_that_refuses_and_comes_back_costs_no_entry() {
        let directory = tempfile::tempdir().unwrap();
        let inside = directory.path().join("records");
        fs::write(&inside, "no directory").unwrap();
        let pages = Pages::new(rules(&inside, 0));
        (0..3).for_each(|number| pages.accept(note(number)));
        assert!(pages.write_one(Instant::now()).is_err());
        fs::remove_file(&inside).unwrap();
        pages.write_one(Instant::now()).unwrap();
        // One that is removed under it is written anew.
        fs::remove_dir_all(&inside).unwrap();
        pages.accept(note(3));
        pages.write_one(Instant::now()).unwrap();
        assert_eq!(entries(&inside).iter().map(|entry| entry.at.as_secs()).collect::<Vec<_>>(), [3]);
        assert_eq!(pages.lost.load(Ordering::Relaxed), 0);
    }

    #[tokio::test]
    async fn the_oldest_journals_go_beyond_the_limit_and_nothing_else_does() {
        let directory = tempfile::tempdir().unwrap();
        let other = ["outcomes-unset-00000001.jsonl", "notes.journal", "journal-of-mine.txt"];
        other.iter().for_each(|name| fs::write(directory.path().join(name), [1; 500]).unwrap());
        for number in 0..5_u64 {
            let path = directory.path().join(format!("journal-unset-0000000{number}-0000.journal"));
            fs::write(&path, [1; 500]).unwrap();
            let modified = std::time::UNIX_EPOCH + Duration::from_secs(number);
            File::options().write(true).open(&path).unwrap().set_modified(modified).unwrap();
        }
        let pages = Pages::new(rules(directory.path(), 1200));
        pages.accept(note(1));
        pages.write_one(Instant::now()).unwrap();
        let names = |files: Vec<(PathBuf, u64)>| {
            let name = |(path, _): &(PathBuf, u64)| path.file_name().unwrap().to_string_lossy().into_owned();
            files.iter().map(name).collect::<Vec<_>>()
        };
        let left =
            ["journal-unset-00000003-0000.journal", "journal-unset-00000004-0000.journal", "journal-unset-00000007-0000.journal"];
        assert_eq!(names(files(directory.path()).unwrap()), left);
        assert!(other.iter().all(|name| directory.path().join(name).exists()));
        // A disk that others fill: old journals go, nothing more is written, and what waits stays.
        let full = Pages::new(Rules { reserve_bytes: u64::MAX, ..rules(directory.path(), 0) });
        full.accept(note(2));
        assert_eq!(full.write_one(Instant::now()).unwrap_err().kind(), io::ErrorKind::StorageFull);
        assert!(full.next_due(Instant::now()).is_some());
        assert!(other.iter().all(|name| directory.path().join(name).exists()));
    }
}
