//! A directory of image files as a camera: in the order of their names, the parts of a series co-added.
//!
//! A program that puts images there should write them under another name and rename them: an image that is read while it is
//! being written is torn, and is told as unreadable.

use super::{CameraError, Moment, Source};
use crate::image::{Frame, read, series_stem};
use crate::settings::CameraSettings;
use std::collections::{BTreeMap, HashSet, VecDeque};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Extensions of image files, in lower case.
const EXTENSIONS: [&str; 8] = ["fits", "fit", "fts", "tif", "tiff", "png", "jpg", "jpeg"];
/// Parts of a series that are co-added: as many exposures as the camera that flew took in a row.
const MOST_PARTS: usize = 4;
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
    pending: VecDeque<Series>,
    /// What was shown before and is still there; empty where the directory is repeated.
    shown: HashSet<String>,
}

/// One frame's files.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Series {
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

    /// Reads the files of one frame; parts that can't be read are left out as long as one can.
    fn load(&self, series: &Series) -> Result<Frame, CameraError> {
        let mut frames = Vec::new();
        let mut problems = Vec::new();
        for part in series.parts.iter().take(MOST_PARTS) {
            match load(&self.directory.join(part), part) {
                Ok(mut frame) => {
                    frame.full_scale = frame.full_scale.or(self.full_scale);
                    frames.push(frame);
                }
                Err(problem) => problems.push(problem),
            }
        }
        let unreadable = |problem: String| CameraError::Unreadable { origin: series.name.clone(), problem };
        if frames.is_empty() {
            return Err(unreadable(problems.join("; ")));
        }
        for problem in problems {
            tracing::warn!(problem, "left out of its series");
        }
        match frames.len() {
            1 => frames.pop().ok_or(CameraError::NothingNew),
            parts => Err(unreadable(format!("{parts} parts, and nothing adds them up yet"))),
        }
    }
}

impl Source for Directory {
    fn next(&mut self, _moment: &Moment) -> Result<Frame, CameraError> {
        if self.pending.is_empty() {
            self.look()?;
        }
        let series = self.pending.pop_front().ok_or(CameraError::NothingNew)?;
        let frame = self.load(&series);
        if !self.repeat {
            self.shown.insert(series.name);
        }
        frame
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
fn series(names: Vec<String>, stack_parts: bool) -> Vec<Series> {
    if !stack_parts {
        return names.into_iter().map(|name| Series { name: name.clone(), parts: vec![name] }).collect();
    }
    let mut stems: BTreeMap<String, Vec<(u32, String)>> = BTreeMap::new();
    for name in names {
        let (stem, part) = series_stem(&name).map_or((name.clone(), 0), |(stem, part)| (stem.to_owned(), part));
        stems.entry(stem).or_default().push((part, name));
    }
    let sorted = |(name, mut parts): (String, Vec<(u32, String)>)| {
        parts.sort_unstable();
        Series { name, parts: parts.into_iter().map(|(_, name)| name).collect() }
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
