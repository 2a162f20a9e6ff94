//! The store: a directory of images as FITS files, each whole or not there, and room made for new ones by the rule of the shelf.
//!
//! Blocking: the archive calls it on the blocking pool.

use super::file::free_bytes;
use crate::image::{Frame, ImageCounter, Keyword, Shelf, Stamp, series_stem, write_fits};
use crate::sky::{ClockQuality, Utc};
use crate::solve::{Outcome, keywords};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// What a file that is being written is called until it is whole.
const UNFINISHED: &str = "part";
/// Images that go at most before one is kept, where the images are more than they may be.
const MOST_THINNED: u32 = 64;
/// Images that go at most for one that is kept, where the disk has too little room: what others fill it with never costs them all.
const MOST_FOR_RESERVE: u32 = 2;

/// Where images are kept, and how much room they may take.
#[derive(Debug, Clone)]
pub struct StoreRules {
    /// The directory, made if it is not there.
    pub directory: PathBuf,
    /// What all of them may take, bytes; 0: as much as there is.
    pub limit_bytes: u64,
    /// What stays free on the disk, bytes.
    pub reserve_bytes: u64,
    /// The number of this start, which is part of each name.
    pub boot_id: u32,
    /// Name of the camera.
    pub camera: String,
    /// Optics turn the picture over.
    pub mirrored: bool,
}

/// A store, as far as it has been looked through.
#[derive(Debug)]
pub struct Store {
    rules: StoreRules,
    /// What is there; `None` until it has been looked through.
    shelf: Option<Shelf<PathBuf>>,
    /// The file in the making.
    bytes: Vec<u8>,
    /// Images that went to make room for one that could not be kept after all: they are told with the next one.
    thinned: u32,
}

/// What came of keeping an image.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Saved {
    /// Its file.
    pub path: PathBuf,
    /// Images that went to make room.
    pub thinned: u32,
}

impl Store {
    /// A store that nobody has looked into yet.
    pub fn new(rules: StoreRules) -> Self {
        Self { rules, shelf: None, bytes: Vec::new(), thinned: 0 }
    }

    /// Keeps an image, with what its solving ended in where that is known; down to the disk, so that it outlasts a power cut. `replaces`: the
    /// file of the same image, kept before that was known.
    ///
    /// # Errors
    /// Of the disk; `StorageFull` where there is no room that may be made. What was there is still there then.
    pub fn save(&mut self, frame: &Frame, outcome: Option<&Outcome>, replaces: Option<&Path>) -> io::Result<Saved> {
        let mut shelf = match self.shelf.take() {
            Some(shelf) => shelf,
            None => look_through(&self.rules.directory)?,
        };
        let saved = self.save_to(&mut shelf, frame, outcome, replaces);
        // After an error it is looked through again: what it cannot let go is still there.
        self.shelf = saved.is_ok().then_some(shelf);
        saved
    }

    fn save_to(
        &mut self,
        shelf: &mut Shelf<PathBuf>,
        frame: &Frame,
        outcome: Option<&Outcome>,
        replaces: Option<&Path>,
    ) -> io::Result<Saved> {
        self.encode(frame, outcome)?;
        let path = replaces.map_or_else(|| self.rules.directory.join(name(&frame.stamp, self.rules.boot_id)), Path::to_owned);
        let directory = path.parent().unwrap_or(&self.rules.directory).to_owned();
        fs::create_dir_all(&directory)?;
        // The old file has the same length, near enough, but is there until the new one is.
        self.make_room(shelf)?;
        let unfinished = path.with_extension(UNFINISHED);
        if let Err(error) = put(&unfinished, &path, &directory, &self.bytes) {
            let _ = fs::remove_file(&unfinished);
            return Err(error);
        }
        if replaces.is_none() {
            shelf.put(frame.stamp.image, path.clone(), self.bytes.len() as u64);
        }
        Ok(Saved { path, thinned: std::mem::take(&mut self.thinned) })
    }

    fn encode(&mut self, frame: &Frame, outcome: Option<&Outcome>) -> io::Result<()> {
        let mut all = vec![
            Keyword::new("INSTRUME", self.rules.camera.as_str(), "name of the camera"),
            Keyword::new("BOOTID", i64::from(self.rules.boot_id), "number of the start of the program"),
        ];
        if let Some(outcome) = outcome {
            all.extend(keywords(outcome, (frame.width, frame.height), self.rules.mirrored));
        }
        self.bytes.clear();
        write_fits(frame, &all, &mut self.bytes).map_err(io::Error::other)
    }

    /// Lets images go until the next one has room.
    fn make_room(&mut self, shelf: &mut Shelf<PathBuf>) -> io::Result<()> {
        let (size, rules, mut gone) = (self.bytes.len() as u64, &self.rules, 0);
        while rules.limit_bytes > 0 && shelf.bytes().saturating_add(size) > rules.limit_bytes && gone < MOST_THINNED {
            let went = u32::from(let_go(shelf)?);
            (gone, self.thinned) = (gone + went, self.thinned.saturating_add(went));
            if shelf.is_empty() {
                break;
            }
        }
        let free = free_bytes(&rules.directory)?;
        let wanted = rules.reserve_bytes.saturating_add(size);
        let short = wanted.saturating_sub(free);
        if short > size.saturating_mul(u64::from(MOST_FOR_RESERVE)) || (short > 0 && shelf.is_empty()) {
            let problem = format!("{free} bytes free, {} are held in reserve", rules.reserve_bytes);
            return Err(io::Error::new(io::ErrorKind::StorageFull, problem));
        }
        let mut made = 0;
        while made < short && !shelf.is_empty() {
            let before = shelf.bytes();
            self.thinned = self.thinned.saturating_add(u32::from(let_go(shelf)?));
            made += before.saturating_sub(shelf.bytes());
        }
        Ok(())
    }
}

/// Lets the image go that is next; whether it was still there.
fn let_go(shelf: &mut Shelf<PathBuf>) -> io::Result<bool> {
    let Some(image) = shelf.take() else { return Ok(false) };
    match fs::remove_file(&image.name) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

/// Writes a file down to the disk, and gives it its name once it is whole.
fn put(unfinished: &Path, path: &Path, directory: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(unfinished)?;
    file.write_all(bytes)?;
    file.sync_data()?;
    fs::rename(unfinished, path)?;
    File::open(directory)?.sync_all()
}

/// A day's directory and the name in it: the middle of the exposure to the millisecond, the number of the start, that of the image, and the place of an exposure
/// in its series.
fn name(stamp: &Stamp, boot_id: u32) -> PathBuf {
    let time = stamp.captured.filter(|(_, quality)| *quality != ClockQuality::Unset).map(|(utc, _)| utc);
    let (day, time) = time.map_or_else(|| ("unset".to_owned(), "unset".to_owned()), |utc| (day_of(utc), moment_of(utc)));
    let part = stamp.part.map_or_else(String::new, |part| format!("_p{part}"));
    Path::new(&day).join(format!("{time}-{boot_id:08x}-{:08}{part}.fits", stamp.image.0))
}

fn day_of(utc: Utc) -> String {
    let (year, month, day, ..) = utc.calendar();
    format!("{year:04}-{month:02}-{day:02}")
}

fn moment_of(utc: Utc) -> String {
    let (.., hour, minute, second) = utc.calendar();
    let ms = ((second * 1000.0).floor() as u32).min(59_999);
    format!("{}--{hour:02}-{minute:02}-{:02}--{:03}", day_of(utc), ms / 1000, ms % 1000)
}

/// The number of an image that we named; `None` for any other file.
fn number_in(name: &str) -> Option<ImageCounter> {
    let stem = series_stem(name).map_or_else(|| name.strip_suffix(".fits"), |(stem, _)| name.ends_with(".fits").then_some(stem));
    let (rest, number) = stem?.rsplit_once('-')?;
    let (_, boot) = rest.rsplit_once('-')?;
    let ours = boot.len() == 8 && boot.bytes().all(|letter| letter.is_ascii_hexdigit()) && number.len() >= 8;
    number.parse().ok().filter(|_| ours).map(ImageCounter)
}

/// The files of an image by the places of its exposures in their series (0 where it stands alone), by its number and that of the start that
/// numbered it; empty where there is none.
///
/// # Errors
/// Of the disk.
pub fn files_of(directory: &Path, boot_id: u32, image: ImageCounter) -> io::Result<BTreeMap<u8, PathBuf>> {
    let tail = format!("-{boot_id:08x}-{:08}", image.0);
    let mut days = match fs::read_dir(directory) {
        Ok(days) => days.map(|day| day.map(|day| day.path())).collect::<io::Result<Vec<PathBuf>>>()?,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(BTreeMap::new()),
        Err(error) => return Err(error),
    };
    days.sort_unstable();
    let mut files = BTreeMap::new();
    // The newest day first; a series may have begun on the day before.
    for day in days.iter().rev().filter(|day| day.is_dir()) {
        for file in fs::read_dir(day)? {
            let path = file?.path();
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let (stem, part) = series_stem(&name).unwrap_or((name.strip_suffix(".fits").unwrap_or_default(), 0));
            if let (true, Ok(part)) = (name.ends_with(".fits") && stem.ends_with(&tail), u8::try_from(part)) {
                files.insert(part, path);
            }
        }
        if files.contains_key(&0) {
            break;
        }
    }
    Ok(files)
}

/// Every exposure under some directories by the number of the start that took it, its image's number and its place in its series (0 where it
/// stands alone); of two the first directory's. What cannot be looked into has none.
pub fn all_files(directories: &[PathBuf]) -> BTreeMap<(u32, u32, u8), PathBuf> {
    let within = |directory: &Path| fs::read_dir(directory).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut found = BTreeMap::new();
    for day in directories.iter().flat_map(|directory| within(directory).collect::<Vec<_>>()) {
        for path in within(&day) {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            let Some(image) = number_in(&name) else { continue };
            let (stem, part) = series_stem(&name).unwrap_or((name.strip_suffix(".fits").unwrap_or_default(), 0));
            let boot = stem.rsplit('-').nth(1).and_then(|boot| u32::from_str_radix(boot, 16).ok());
            if let (Some(boot), Ok(part)) = (boot, u8::try_from(part)) {
                found.entry((boot, image.0, part)).or_insert(path);
            }
        }
    }
    found
}

/// The images that are there, in the order of their names, which is that of their times; what was never finished goes.
fn look_through(directory: &Path) -> io::Result<Shelf<PathBuf>> {
    let mut found = Vec::new();
    let days = match fs::read_dir(directory) {
        Ok(days) => days,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Shelf::default()),
        Err(error) => return Err(error),
    };
    for day in days {
        let day = day?;
        if !day.file_type()?.is_dir() {
            continue;
        }
        for file in fs::read_dir(day.path())? {
            let file = file?;
            let path = file.path();
            let name = file.file_name();
            let name = name.to_string_lossy();
            if let Some(image) = number_in(&name) {
                found.push((path, image, file.metadata()?.len()));
            } else if name.strip_suffix(UNFINISHED).is_some_and(|stem| number_in(&format!("{stem}fits")).is_some()) {
                fs::remove_file(&path)?;
            }
        }
    }
    found.sort_unstable();
    let mut shelf = Shelf::default();
    found.into_iter().for_each(|(path, image, bytes)| shelf.put(image, path, bytes));
    Ok(shelf)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{checksum_holds, read};
    use crate::sky::RowOrder;

    fn rules(directory: &Path) -> StoreRules {
        let camera = "test".to_owned();
        StoreRules { directory: directory.to_owned(), limit_bytes: 0, reserve_bytes: 0, boot_id: 0xabc, camera, mirrored: false }
    }

    fn frame(image: u32) -> Frame {
        let mut frame = Frame::new(60, 40, vec![image as u16; 2400], RowOrder::BottomFirst).unwrap();
        frame.stamp.image = ImageCounter(image);
        let second = f64::from(image % 60) + 0.25;
        let captured = Utc::from_calendar(2013, 1, 1, 6, image / 60, second).unwrap();
        frame.stamp.captured = Some((captured, ClockQuality::FreeRunning));
        frame
    }

    fn files(directory: &Path) -> Vec<PathBuf> {
        let mut files: Vec<PathBuf> = fs::read_dir(directory)
            .into_iter()
            .flatten()
            .flat_map(|day| fs::read_dir(day.unwrap().path()).unwrap())
            .map(|file| file.unwrap().path())
            .collect();
        files.sort();
        files
    }

    #[test]
    fn an_image_is_kept_under_its_time_and_number_and_can_be_read_again() {
        let directory = tempfile::tempdir().unwrap();
        let mut store = Store::new(rules(directory.path()));
        let saved = store.save(&frame(24), None, None).unwrap();
        assert_eq!(saved.path, directory.path().join("2013-01-01/2013-01-01--06-00-24--250-00000abc-00000024.fits"));
        let bytes = fs::read(&saved.path).unwrap();
        assert_eq!(checksum_holds(&bytes), Some(true));
        let seen = read("seen", &bytes).unwrap();
        assert_eq!((seen.pixels, seen.stamp.image), (frame(24).pixels, ImageCounter(24)));
        let mut unset = frame(25);
        unset.stamp.captured = None;
        let saved = store.save(&unset, None, None).unwrap();
        assert_eq!(saved.path, directory.path().join("unset/unset-00000abc-00000025.fits"));
    }

    #[test]
    fn an_image_is_found_by_its_number_with_all_its_exposures_even_over_midnight() {
        let directory = tempfile::tempdir().unwrap();
        let mut store = Store::new(rules(directory.path()));
        for (image, parts) in [(7, vec![None]), (8, vec![Some(0), Some(1), Some(2)])] {
            for part in parts {
                let mut frame = frame(image);
                frame.stamp.part = part;
                if part == Some(0) {
                    let evening = Utc::from_calendar(2012, 12, 31, 23, 59, 59.5).unwrap();
                    frame.stamp.captured = Some((evening, ClockQuality::FreeRunning));
                }
                store.save(&frame, None, None).unwrap();
            }
        }
        let of = |boot, image| files_of(directory.path(), boot, ImageCounter(image)).unwrap();
        assert_eq!(of(0xabc, 7).keys().copied().collect::<Vec<_>>(), [0]);
        let series = of(0xabc, 8);
        assert_eq!(series.keys().copied().collect::<Vec<_>>(), [0, 1, 2]);
        assert!(series[&0].starts_with(directory.path().join("2012-12-31")), "{series:?}");
        assert!(of(0xabd, 7).is_empty() && of(0xabc, 9).is_empty());
        assert!(files_of(&directory.path().join("none"), 0xabc, ImageCounter(7)).unwrap().is_empty());
    }

    #[test]
    fn the_limit_holds_over_restarts_and_nothing_that_is_not_ours_is_touched() {
        let directory = tempfile::tempdir().unwrap();
        let size = {
            let saved = Store::new(rules(directory.path())).save(&frame(0), None, None).unwrap();
            fs::metadata(saved.path).unwrap().len()
        };
        let day = directory.path().join("2013-01-01");
        let foreign = ["2012-12-30--08-27-56--625_p1.fits", "notes-00000001.fits", "x-zzzzzzzz-00000001.fits", "mine.part"];
        foreign.iter().for_each(|name| fs::write(day.join(name), "not ours").unwrap());
        fs::write(day.join("2013-01-01--06-00-24--250-00000abc-00000024.part"), "torn").unwrap();
        let rules = StoreRules { limit_bytes: 100 * size, ..rules(directory.path()) };
        let mut thinned = 0;
        for start in 0..4_u32 {
            let mut store = Store::new(rules.clone());
            for image in 1 + start * 50..=50 + start * 50 {
                thinned += store.save(&frame(image), None, None).unwrap().thinned;
            }
        }
        let names = files(directory.path());
        assert_eq!((names.len(), thinned), (100 + foreign.len(), 101));
        assert!(foreign.iter().all(|name| names.contains(&day.join(name))));
        assert!(names.iter().all(|path| path.extension().is_some_and(|end| end == "fits") || path.ends_with("mine.part")));
    }

    #[test]
    fn what_others_fill_the_disk_with_costs_no_image() {
        let directory = tempfile::tempdir().unwrap();
        let mut store = Store::new(rules(directory.path()));
        (0..20).for_each(|image| drop(store.save(&frame(image), None, None).unwrap()));
        store.rules.reserve_bytes = u64::MAX / 2;
        let error = store.save(&frame(20), None, None).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(error.to_string().contains("are held in reserve"), "{error}");
        assert_eq!(files(directory.path()).len(), 20);
        // A disk that is just full of our own: one goes, one comes.
        let size = fs::metadata(files(directory.path()).first().unwrap()).unwrap().len();
        store.rules.reserve_bytes = free_bytes(directory.path()).unwrap() - size / 2;
        let thinned: u32 = (20..23).map(|image| store.save(&frame(image), None, None).map_or(0, |saved| saved.thinned)).sum();
        assert!((1..=6).contains(&thinned), "{thinned}");
    }

    #[test]
    fn an_outcome_that_comes_later_replaces_the_file_and_a_dead_disk_leaves_no_half_of_one() {
        let directory = tempfile::tempdir().unwrap();
        let mut store = Store::new(rules(directory.path()));
        let saved = store.save(&frame(7), None, None).unwrap();
        let outcome = Outcome::unsolved(frame(7).stamp, crate::solve::Reason::NoMatch, "");
        let again = store.save(&frame(7), Some(&outcome), Some(&saved.path)).unwrap();
        assert_eq!((&again.path, files(directory.path()).len()), (&saved.path, 1));
        let bytes = fs::read(&again.path).unwrap();
        assert!(String::from_utf8_lossy(&bytes).contains("OUTCOME = 'no_match'"));
        assert_eq!(checksum_holds(&bytes), Some(true));
        // Another stands where the directory should be.
        let blocked = directory.path().join("blocked");
        fs::write(&blocked, "a file").unwrap();
        let mut dead = Store::new(StoreRules { directory: blocked.clone(), ..rules(directory.path()) });
        assert!(dead.save(&frame(8), None, None).is_err());
        fs::remove_file(&blocked).unwrap();
        assert!(dead.save(&frame(8), None, None).is_ok());
    }
}
