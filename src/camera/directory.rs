//! A directory of image files as a camera: in the order of their names, the parts of a series as the exposures of one image.
//!
//! A program that puts images there should write them under another name and rename them: an image that is read while it is
//! being written is torn, and is told as unreadable.

use super::{CameraError, Moment, Source};
use crate::image::{Frame, MAX_PARTS, Series, read, series_stem};
use crate::settings::CameraSettings;
use std::collections::{BTreeMap, HashSet, VecDeque};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Extensions of image files, in lower case.
const EXTENSIONS: [&str; 8] = ["fits", "fit", "fts", "tif", "tiff", "png", "jpg", "jpeg"];
/// No image file that we read is longer, bytes: 100 million pixels of 64 bits and their header.
const LONGEST_FILE: u64 = 1 << 30;

/// The camera: image files of a directory.
#[derive(Debug)]
pub struct Directory {
    directory: PathBuf,
    stack_parts: bool,
    repeat: bool,
    /// Highest value of a single exposure, ADU, where the settings say it.
    full_scale: Option<u16>,
    /// What is left of this pass through the directory.
    pending: VecDeque<Files>,
    /// What was shown before and is still there; empty where the directory is repeated.
    shown: HashSet<String>,
}

/// One image's files.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Files {
    /// The series' stem, or the name of an image that stands alone.
    name: String,
    /// File names, in the order of their parts.
    parts: Vec<String>,
}

impl Directory {
    /// The directory that the settings name. It need not be there yet.
    pub fn new(settings: &CameraSettings) -> Self {
        Self {
            directory: PathBuf::from(&settings.directory),
            stack_parts: settings.stack_parts,
            repeat: settings.repeat,
            full_scale: u16::try_from(settings.full_scale_adu).ok().filter(|adu| *adu > 0),
            pending: VecDeque::new(),
            shown: HashSet::new(),
        }
    }

    /// Looks what is there, and begins another pass.
    fn look(&mut self) -> Result<(), CameraError> {
        let names = image_names(&self.directory)
            .map_err(|error| CameraError::Unavailable(format!("{}: {error}", self.directory.display())))?;
        let all = series(names, self.stack_parts);
        if self.repeat {
            self.pending = all.into();
        } else {
            let there: HashSet<&str> = all.iter().map(|series| series.name.as_str()).collect();
            self.shown.retain(|name| there.contains(name.as_str()));
            self.pending = all.into_iter().filter(|series| !self.shown.contains(&series.name)).collect();
        }
        Ok(())
    }

    /// Reads the files of one image; parts that can't be read are left out as long as one can.
    fn load(&self, series: &Files) -> Result<Series, CameraError> {
        let unreadable = |problem: String| CameraError::Unreadable { origin: series.name.clone(), problem };
        let mut image: Option<Series> = None;
        let mut problems = Vec::new();
        for part in series.parts.iter().take(MAX_PARTS) {
            match load(&self.directory.join(part), part) {
                Ok(mut frame) => {
                    frame.full_scale = frame.full_scale.or(self.full_scale);
                    match &mut image {
                        Some(image) => image.push(frame).map_err(|error| unreadable(error.to_string()))?,
                        None => image = Some(frame.into()),
                    }
                }
                Err(problem) => problems.push(problem),
            }
        }
        let Some(image) = image else { return Err(unreadable(problems.join("; "))) };
        let too_many = series.parts.iter().skip(MAX_PARTS).map(|part| format!("{part}: more than {MAX_PARTS} parts"));
        for problem in problems.into_iter().chain(too_many) {
            tracing::warn!(problem, "left out of its series");
        }
        Ok(image)
    }
}

impl Source for Directory {
    fn next(&mut self, _moment: &Moment) -> Result<Series, CameraError> {
        if self.pending.is_empty() {
            self.look()?;
        }
        let series = self.pending.pop_front().ok_or(CameraError::NothingNew)?;
        let image = self.load(&series);
        if !self.repeat {
            self.shown.insert(series.name);
        }
        image
    }
}

/// Names of the image files in a directory, sorted.
fn image_names(directory: &Path) -> io::Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(directory)? {
        let Ok(name) = entry?.file_name().into_string() else { continue };
        let extension = Path::new(&name).extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        if extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str())) && !name.starts_with('.') {
            names.push(name);
        }
    }
    names.sort_unstable();
    Ok(names)
}

/// Puts the parts of a series together, in the order of their numbers; series stay in the order of their names.
fn series(names: Vec<String>, stack_parts: bool) -> Vec<Files> {
    if !stack_parts {
        return names.into_iter().map(|name| Files { name: name.clone(), parts: vec![name] }).collect();
    }
    let mut stems: BTreeMap<String, Vec<(u32, String)>> = BTreeMap::new();
    for name in names {
        let (stem, part) = series_stem(&name).map_or((name.clone(), 0), |(stem, part)| (stem.to_owned(), part));
        stems.entry(stem).or_default().push((part, name));
    }
    let sorted = |(name, mut parts): (String, Vec<(u32, String)>)| {
        parts.sort_unstable();
        Files { name, parts: parts.into_iter().map(|(_, name)| name).collect() }
    };
    stems.into_iter().map(sorted).collect()
}

fn load(path: &Path, name: &str) -> Result<Frame, String> {
    let wrong = |error: io::Error| format!("{name}: {error}");
    let length = fs::metadata(path)
        .map_err(wrong)
        .and_then(|meta| if meta.is_file() { Ok(meta.len()) } else { Err(format!("{name}: not a file")) })?;
    if length > LONGEST_FILE {
        return Err(format!("{name}: {length} bytes, at most {LONGEST_FILE} are read"));
    }
    let bytes = fs::read(path).map_err(wrong)?;
    read(name, &bytes).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Ask;
    use crate::image::{ImageCounter, write_fits};
    use crate::settings::Settings;
    use crate::sky::{ClockQuality, RowOrder};
    use std::time::Duration;
    use tempfile::TempDir;

    /// Puts a small image there, all pixels of one value.
    fn put(there: &TempDir, name: &str, adu: u16) {
        let frame = Frame::new(8, 8, vec![adu; 64], RowOrder::BottomFirst).unwrap();
        let mut bytes = Vec::new();
        write_fits(&frame, &[], &mut bytes).unwrap();
        fs::write(there.path().join(name), bytes).unwrap();
    }

    fn camera(there: &TempDir, change: impl FnOnce(&mut CameraSettings)) -> Directory {
        let mut settings = Settings::flight().unwrap().camera;
        settings.directory = there.path().display().to_string();
        change(&mut settings);
        Directory::new(&settings)
    }

    fn next(camera: &mut Directory) -> Result<Frame, CameraError> {
        let image = ImageCounter(0);
        let series = camera.next(&Moment {
            image,
            uptime: Duration::ZERO,
            utc: None,
            quality: ClockQuality::Unset,
            sigma_s: None,
            ask: Ask::Expose,
        })?;
        let (sum, exposures) = series.into_sum();
        Ok(sum.unwrap_or_else(|| Frame::clone(&exposures[0])))
    }

    /// Names of the next frames until there is nothing new.
    fn shown(camera: &mut Directory) -> Vec<String> {
        std::iter::from_fn(|| next(camera).ok()).map(|frame| frame.stamp.origin).collect()
    }

    #[test]
    fn images_come_in_the_order_of_their_names_and_new_ones_when_all_were_shown() {
        let there = tempfile::tempdir().unwrap();
        for name in ["b.fits", "a.fits", "c.FITS", "notes.txt", ".hidden.fits"] {
            put(&there, name, 5);
        }
        let mut camera = camera(&there, |_| {});
        assert_eq!(shown(&mut camera), ["a.fits", "b.fits", "c.FITS"]);
        assert_eq!(next(&mut camera), Err(CameraError::NothingNew));
        put(&there, "aa.fits", 5);
        assert_eq!(shown(&mut camera), ["aa.fits"]);
        fs::remove_file(there.path().join("b.fits")).unwrap();
        assert_eq!(next(&mut camera), Err(CameraError::NothingNew));
        put(&there, "b.fits", 6);
        assert_eq!(shown(&mut camera), ["b.fits"], "an image that came back is new");
    }

    #[test]
    fn a_repeated_directory_begins_again_and_finds_what_is_new() {
        let there = tempfile::tempdir().unwrap();
        put(&there, "b.fits", 5);
        let mut camera = camera(&there, |settings| settings.repeat = true);
        let mut name = || next(&mut camera).unwrap().stamp.origin;
        assert_eq!([name(), name()], ["b.fits", "b.fits"]);
        put(&there, "a.fits", 5);
        assert_eq!([name(), name(), name()], ["a.fits", "b.fits", "a.fits"]);
    }

    #[test]
    fn the_parts_of_a_series_are_added_unless_they_are_not_to_be() {
        let there = tempfile::tempdir().unwrap();
        for (name, adu) in [("s_p0.fits", 1), ("s_p1.fits", 10), ("s_p10.fits", 100), ("s_p2.fits", 1000), ("t.fits", 7)] {
            put(&there, name, adu);
        }
        let mut together = camera(&there, |_| {});
        let frame = next(&mut together).unwrap();
        assert_eq!((frame.pixels[0], frame.stamp.exposures), (1111, 4));
        assert_eq!(next(&mut together).unwrap().pixels[0], 7);
        assert_eq!(next(&mut together), Err(CameraError::NothingNew));
        let mut apart = camera(&there, |settings| settings.stack_parts = false);
        assert_eq!(shown(&mut apart).len(), 5);
    }

    #[test]
    fn a_part_too_many_and_a_torn_one_are_left_out_of_their_series() {
        let there = tempfile::tempdir().unwrap();
        for part in 0..17 {
            put(&there, &format!("s_p{part}.fits"), 1 << part.min(15));
        }
        fs::write(there.path().join("s_p1.fits"), "SIMPLE  =").unwrap();
        let frame = next(&mut camera(&there, |_| {})).unwrap();
        assert_eq!((frame.pixels[0], frame.stamp.exposures), (u16::MAX - 2, 15));
    }

    #[test]
    fn a_torn_image_is_unreadable_and_the_next_is_shown() {
        let there = tempfile::tempdir().unwrap();
        put(&there, "a.fits", 5);
        put(&there, "b.fits", 5);
        let whole = fs::read(there.path().join("a.fits")).unwrap();
        fs::write(there.path().join("a.fits"), &whole[..2890]).unwrap();
        fs::create_dir(there.path().join("aa.fits")).unwrap();
        let mut camera = camera(&there, |_| {});
        for (name, what) in [("a.fits", "cut short"), ("aa.fits", "not a file")] {
            let Err(CameraError::Unreadable { origin, problem }) = next(&mut camera) else { panic!("{name} was read") };
            assert_eq!(origin, name);
            assert!(problem.contains(what), "{problem}");
        }
        assert_eq!(shown(&mut camera), ["b.fits"]);
    }

    #[test]
    fn a_directory_that_is_not_there_is_named_and_used_once_it_is() {
        let there = tempfile::tempdir().unwrap();
        let path = there.path().join("later");
        let mut camera = camera(&there, |settings| settings.directory = path.display().to_string());
        let Err(CameraError::Unavailable(why)) = next(&mut camera) else { panic!("it is there") };
        assert!(why.contains("later"), "{why}");
        fs::create_dir(&path).unwrap();
        assert_eq!(next(&mut camera), Err(CameraError::NothingNew));
    }
}
