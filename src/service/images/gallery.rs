//! The gallery: images that are kept, opened for whoever asks, as they lie on disk or as a view over a thin link.
//!
//! Blocking. What a reader holds is a buffer, or its part in one of the newest views; so many read at once, and one view is made at a time, by
//! a thread that gives way to all others.

use super::super::aside::aside;
use super::super::file::read_file;
use super::super::parts::load_bad_pixels;
use super::super::store::files_of;
use super::super::supervisor::panic_text;
use crate::image::view::{PACKET_BYTES, View, ViewSource};
use crate::image::{self, CellStatistics, Frame, ImageCounter};
use crate::settings::Settings;
use crate::sources::{Finder, Look, SearchKernel};
use crate::wire::{CHUNK_BYTES, ImageForm, NoImage};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Reads of files, and views in the making or waited for, at a time: a disk that hangs takes so many threads and no more.
const AT_ONCE: usize = 4;
/// Bytes that are read at a time, so that not each chunk asks the disk.
const READ_BYTES: usize = 64 * 1024;
/// Views that are remembered: those of a series of four; fewer where they are large.
const VIEWS: usize = 4;
/// What all of them may take, bytes; the newest is remembered whatever it takes.
const VIEWS_BYTES: usize = 32 << 20;
/// Longest file that is read as an image: the largest frame that a view is made of, its header, and its pixels in two bytes.
const MAX_FILE_BYTES: usize = 2 * image::view::MOST_PIXELS + (1 << 20);
/// Fewer sources than this in a search for sharp ones, and those out of focus are searched for.
const FEW_SOURCES: usize = 4;

/// One exposure in one form.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key {
    /// The start of the camera that numbered the image.
    pub boot_id: u32,
    /// The image.
    pub image: ImageCounter,
    /// Its place in its series, 0 where it stands alone.
    pub exposure: u8,
    /// In which form.
    pub form: ImageForm,
}

/// Why there is nothing to send, and the same in words.
pub type Refused = (NoImage, String);

/// Images that are kept.
pub struct Gallery {
    /// The directories of the disks that they are kept on.
    directories: Vec<PathBuf>,
    settings: Arc<Settings>,
    views: Mutex<VecDeque<(Key, Arc<[u8]>)>>,
    at_once: Arc<Semaphore>,
}

/// An exposure that is being sent.
#[derive(Debug)]
pub struct Opened {
    /// Which.
    pub key: Key,
    /// How many exposures of its image are on disk.
    pub exposures: u8,
    /// Bytes of it.
    pub total: u32,
    /// CRC-32 of all of them.
    pub crc32: u32,
    bytes: Bytes,
}

/// Where its bytes come from.
#[derive(Debug)]
enum Bytes {
    /// The file, which stays what it was when it was opened, whatever becomes of its name; and what was read of it, from where on.
    File { file: File, from: u64, ahead: Vec<u8> },
    /// A view.
    View(Arc<[u8]>),
}

impl Gallery {
    /// Of the disks that the settings name.
    pub fn new(settings: Arc<Settings>) -> Self {
        let directories = settings.record.image_directories().into_iter().map(|(_, directory)| directory).collect();
        Self { directories, settings, views: Mutex::default(), at_once: Arc::new(Semaphore::new(AT_ONCE)) }
    }

    /// Leave to read, for as long as it lives.
    ///
    /// # Errors
    /// Where too many have it.
    pub fn enter(&self) -> Result<OwnedSemaphorePermit, Refused> {
        Arc::clone(&self.at_once).try_acquire_owned().map_err(|_| (NoImage::Busy, "too many images are read at once".to_owned()))
    }

    /// Opens an exposure.
    ///
    /// # Errors
    /// Where it is not on disk, or nothing can be made of it.
    pub fn open(&self, key: Key) -> Result<Opened, Refused> {
        let (path, exposures) = self.find(key)?;
        let on_disk = |error: io::Error| (NoImage::Disk, error.to_string());
        match key.form {
            ImageForm::Raw => {
                let mut file = File::open(path).map_err(on_disk)?;
                let (total, crc32) = measure(&mut file).map_err(on_disk)?;
                let total = u32::try_from(total).map_err(|_| (NoImage::Form, format!("a file of {total} bytes")))?;
                Ok(Opened { key, exposures, total, crc32, bytes: Bytes::File { file, from: 0, ahead: Vec::new() } })
            }
            ImageForm::View => {
                let bytes = self.view(key, &path)?;
                let crc32 = crc32fast::hash(&bytes);
                Ok(Opened { key, exposures, total: bytes.len() as u32, crc32, bytes: Bytes::View(bytes) })
            }
        }
    }

    /// An exposure as a frame, and its file.
    ///
    /// # Errors
    /// As for [`Self::open`].
    pub fn frame(&self, key: Key) -> Result<(Frame, PathBuf), Refused> {
        let (path, _) = self.find(key)?;
        Ok((read_frame(&path)?, path))
    }

    /// The file of an exposure, where it is on disk.
    pub fn file(&self, key: Key) -> Option<PathBuf> {
        self.find(key).ok().map(|(path, _)| path)
    }

    /// The file of an exposure on the first disk that has it, and how many exposures of its image there are.
    fn find(&self, key: Key) -> Result<(PathBuf, u8), Refused> {
        let Key { boot_id, image, exposure, .. } = key;
        if self.directories.is_empty() {
            return Err((NoImage::NotKept, "no images are kept".to_owned()));
        }
        let (mut trouble, mut others) = (None, 0);
        for directory in &self.directories {
            match files_of(directory, boot_id, image) {
                Ok(mut files) => {
                    let exposures = files.keys().next_back().map_or(0, |last| last.saturating_add(1));
                    if let Some(path) = files.remove(&exposure) {
                        return Ok((path, exposures));
                    }
                    others = others.max(exposures);
                }
                Err(error) => trouble = trouble.or(Some((NoImage::Disk, error.to_string()))),
            }
        }
        let words = match others {
            0 => format!("image {} is not on disk: it went to make room, or was never kept", image.0),
            others => format!("image {} has {others} exposures on disk, none with number {exposure}", image.0),
        };
        Err(trouble.unwrap_or((NoImage::NotKept, words)))
    }

    /// The packets of an exposure; they are made once, and remembered for a while.
    fn view(&self, key: Key, path: &Path) -> Result<Arc<[u8]>, Refused> {
        // Whoever makes one has it: the others wait, and find theirs made or have their turn.
        let mut views = self.views.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, view)) = views.iter().find(|(other, _)| *other == key) {
            return Ok(Arc::clone(view));
        }
        let made = catch_unwind(AssertUnwindSafe(|| aside(|| self.make_view(path))));
        let view = made.unwrap_or_else(|panic| Err((NoImage::Form, panic_text(panic.as_ref()).to_owned())))?;
        views.push_front((key, Arc::clone(&view)));
        let bytes = |views: &VecDeque<(Key, Arc<[u8]>)>| views.iter().map(|(_, view)| view.len()).sum::<usize>();
        while views.len() > VIEWS || (views.len() > 1 && bytes(&views) > VIEWS_BYTES) {
            views.pop_back();
        }
        Ok(view)
    }

    fn make_view(&self, path: &Path) -> Result<Arc<[u8]>, Refused> {
        let frame = read_frame(path)?;
        let sources = self.sources(&frame);
        let view = View::new(&frame, &sources, PACKET_BYTES).map_err(|error| (NoImage::Form, error.to_string()))?;
        Ok(Arc::from(view.bytes()))
    }

    /// The sources of a frame, brightest first, found without a catalogue.
    fn sources(&self, frame: &Frame) -> Vec<ViewSource> {
        let mut frame = frame.clone();
        if let Ok(bad) = load_bad_pixels(&self.settings) {
            bad.apply(&mut frame);
        }
        let (mut cells, mut finder, mut found) = (CellStatistics::default(), Finder::default(), Vec::new());
        cells.measure(&frame, frame.full_scale);
        let look = Look { settings: &self.settings.solver.sources, masked: &|_, _| false, keep_on: &|| true };
        finder.begin(&frame, &cells);
        finder.find(&frame, &cells, &look, SearchKernel::Sharp, &mut found);
        if found.len() < FEW_SOURCES
            && let Some(widest) = finder.survey(&frame, &cells, &look).and_then(|kernels| kernels.first().copied())
        {
            finder.find(&frame, &cells, &look, widest, &mut found);
        }
        found.iter().map(|source| ViewSource { x: source.x, y: source.y, flux: source.flux }).collect()
    }
}

fn read_frame(path: &Path) -> Result<Frame, Refused> {
    let bytes = read_file(path, MAX_FILE_BYTES, "an image").map_err(|error| (NoImage::Disk, error.to_string()))?;
    image::read(&path.display().to_string(), &bytes).map_err(|error| (NoImage::Form, error.to_string()))
}

/// Length and CRC-32 of a file.
fn measure(file: &mut File) -> io::Result<(u64, u32)> {
    let (mut buffer, mut digest, mut total) = (vec![0; READ_BYTES], crc32fast::Hasher::new(), 0);
    loop {
        let count = file.read(&mut buffer)?;
        if count == 0 {
            return Ok((total, digest.finalize()));
        }
        digest.update(buffer.get(..count).unwrap_or_default());
        total += count as u64;
    }
}

impl Opened {
    /// The bytes of the chunk at a place, where they need no reading.
    pub fn at_hand(&self, offset: u32) -> Option<&[u8]> {
        let wanted = CHUNK_BYTES.min(self.total.saturating_sub(offset) as usize);
        let (bytes, place) = match &self.bytes {
            Bytes::File { from, ahead, .. } => (ahead.as_slice(), u64::from(offset).checked_sub(*from)?),
            Bytes::View(bytes) => (&**bytes, u64::from(offset)),
        };
        let place = usize::try_from(place).ok()?;
        bytes.get(place..place.checked_add(wanted)?)
    }

    /// Reads from a place on, so that what comes there is at hand.
    ///
    /// # Errors
    /// Of the disk; also where the file has become shorter.
    pub fn read_ahead(&mut self, offset: u32) -> io::Result<()> {
        let Bytes::File { file, from, ahead } = &mut self.bytes else { return Ok(()) };
        *from = u64::from(offset);
        ahead.resize(READ_BYTES.min(self.total.saturating_sub(offset) as usize), 0);
        let read = file.read_exact_at(ahead, *from);
        if read.is_err() {
            ahead.clear();
        }
        read
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::store::{Store, StoreRules};
    use super::*;
    use crate::image::view::{Assembly, MOST_PIXELS, packets_in};
    use crate::sky::RowOrder;

    fn gallery(directory: &Path) -> Gallery {
        let mut settings = Settings::flight().unwrap();
        settings.record.directory = directory.join("first").display().to_string();
        settings.record.copies_directory = directory.join("second").display().to_string();
        Gallery::new(Arc::new(settings))
    }

    /// Keeps a small frame with a spot on one of the disks.
    fn keep(directory: &Path, image: u32) -> (Frame, PathBuf) {
        let pixels = (0..64 * 48u32).map(|place| 1000 + (place * 7919 % 61) as u16).collect();
        let mut frame = Frame::new(64, 48, pixels, RowOrder::BottomFirst).unwrap();
        frame.stamp.image = ImageCounter(image);
        let rules = StoreRules {
            directory: directory.to_owned(),
            limit_bytes: 0,
            reserve_bytes: 0,
            boot_id: 9,
            camera: "x0".to_owned(),
            mirrored: false,
        };
        let saved = Store::new(rules).save(&frame, None, None).unwrap();
        (frame, saved.path)
    }

    fn key(image: u32, form: ImageForm) -> Key {
        Key { boot_id: 9, image: ImageCounter(image), exposure: 0, form }
    }

    /// All of it, chunk by chunk.
    fn all(opened: &mut Opened) -> Vec<u8> {
        let mut bytes = Vec::new();
        while bytes.len() < opened.total as usize {
            let offset = bytes.len() as u32;
            if opened.at_hand(offset).is_none() {
                opened.read_ahead(offset).unwrap();
            }
            bytes.extend_from_slice(opened.at_hand(offset).unwrap());
        }
        bytes
    }

    #[test]
    fn an_image_is_read_from_either_disk_and_to_its_end_though_it_goes_meanwhile() {
        let room = tempfile::tempdir().unwrap();
        let gallery = gallery(room.path());
        let (_, first) = keep(&room.path().join("first/images"), 3);
        let (_, second) = keep(&room.path().join("second"), 4);
        for (image, path) in [(3, first), (4, second)] {
            let wanted = std::fs::read(&path).unwrap();
            let mut opened = gallery.open(key(image, ImageForm::Raw)).unwrap();
            std::fs::remove_file(&path).unwrap();
            assert_eq!(all(&mut opened), wanted);
            assert_eq!((opened.total as usize, opened.crc32), (wanted.len(), crc32fast::hash(&wanted)));
            let (why, words) = gallery.open(key(image, ImageForm::Raw)).unwrap_err();
            assert_eq!(why, NoImage::NotKept);
            assert!(words.contains("went to make room"), "{words}");
        }
    }

    #[test]
    fn a_view_is_made_once_is_exact_and_few_are_remembered() {
        let room = tempfile::tempdir().unwrap();
        let gallery = gallery(room.path());
        let kept: Vec<_> = (0..6).map(|image| keep(&room.path().join("second"), image)).collect();
        let mut opened = gallery.open(key(5, ImageForm::View)).unwrap();
        let bytes = all(&mut opened);
        let mut assembly = Assembly::new(None, MOST_PIXELS);
        packets_in(&bytes).for_each(|packet| assert!(assembly.take(packet).is_ok()));
        assert!(assembly.is_exact());
        assert_eq!(assembly.picture().unwrap().pixels, kept[5].0.pixels);
        // The same bytes, though they could not be made again.
        std::fs::write(&kept[5].1, "no image any more").unwrap();
        assert_eq!(all(&mut gallery.open(key(5, ImageForm::View)).unwrap()), bytes);
        (0..4).for_each(|image| drop(gallery.open(key(image, ImageForm::View)).unwrap()));
        assert_eq!(gallery.open(key(5, ImageForm::View)).unwrap_err().0, NoImage::Form);
        assert!(gallery.views.lock().unwrap().len() <= VIEWS);
    }

    #[test]
    fn no_more_than_a_few_read_at_once() {
        let room = tempfile::tempdir().unwrap();
        let gallery = gallery(room.path());
        let mut inside: Vec<_> = std::iter::from_fn(|| gallery.enter().ok()).collect();
        assert_eq!((inside.len(), gallery.enter().unwrap_err().0), (AT_ONCE, NoImage::Busy));
        inside.pop();
        assert!(gallery.enter().is_ok());
    }
}
