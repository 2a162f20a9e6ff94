//! Gathers what a directory holds of solved frames: from records, or by solving its images; and what its images say of hot pixels.

use crate::calibrate::{HotPixels, Solved};
use crate::cli::export::{each_line, records_in};
use crate::image::{self, BadPixels, Frame};
use crate::service::{load_bad_pixels, load_catalogue, prepare, read_file};
use crate::settings::Settings;
use crate::sky::{ARCSEC, Aberration, Attitude, CameraModel, DEG, RowOrder, Utc, Vec3, direction};
use crate::solve::{Outcome, Pair, Pose, Prior, Solver, Unwatched, View};
use anyhow::{Context, bail};
use serde_json::{Map, Value};
use std::fs;
use std::io::{Write, stderr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Images that are read at most, evenly taken from all.
const MOST_IMAGES: usize = 1000;
/// Directories below the one that is named: those of records have one for images, with one for each day.
const DEPTH: usize = 3;
/// Longest file that is read, bytes.
const MAX_FILE_BYTES: usize = 1 << 30;

/// A solved frame, and when it was taken.
pub struct Shot {
    /// The series of triggers.
    trigger: Option<u64>,
    /// Middle of its exposure, s since 1970.
    utc_s: Option<f64>,
    /// What was matched in it.
    pub solved: Solved,
}

impl Shot {
    /// Whether another camera's was taken together with it: by their triggers, or else within so many seconds.
    pub fn is_together_with(&self, other: &Self, within_s: f64) -> bool {
        match (self.trigger, other.trigger, self.utc_s, other.utc_s) {
            (Some(one), Some(two), ..) => one == two,
            (_, _, Some(one), Some(two)) => (one - two).abs() <= within_s,
            _ => false,
        }
    }
}

/// What a directory holds.
pub struct Gathered {
    /// It.
    pub directory: String,
    /// Its solved frames.
    pub shots: Vec<Shot>,
    /// Half the diagonal of its pictures, px.
    pub half_diagonal_px: f64,
    /// What its images say of hot pixels, if that was asked for and it has any.
    pub hot: Option<HotPixels>,
    /// Frames, solved or not.
    frames: usize,
    /// Whether they come from records; else images were solved.
    from_records: bool,
}

impl Gathered {
    /// Where it comes from, in words.
    pub fn source(&self) -> String {
        let what = if self.from_records { "records" } else { "images" };
        let times = || self.shots.iter().filter_map(|shot| shot.utc_s);
        let (first, last) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
        let span = Utc::from_unix(first).zip(Utc::from_unix(last)).map_or(String::new(), |(a, b)| format!(", {a} to {b}"));
        format!("{} of {}: {} of {} solved{span}", what, self.directory, self.shots.len(), self.frames)
    }
}

/// Gathers a directory; `hot`: look for hot pixels too; `jobs`: images at a time.
///
/// # Errors
/// Where it cannot be read, has neither records nor images, or the settings' catalogue or list of bad pixels is wrong.
pub fn gather(directory: &Path, settings: &Arc<Settings>, hot: bool, jobs: usize) -> anyhow::Result<Gathered> {
    let name = directory.display().to_string();
    let mut images = Vec::new();
    images_in(directory, DEPTH, &mut images).with_context(|| format!("{name} cannot be read"))?;
    images.sort();
    if images.len() > MOST_IMAGES {
        let step = images.len() as f64 / MOST_IMAGES as f64;
        images = (0..MOST_IMAGES).filter_map(|nth| images.get((nth as f64 * step) as usize).cloned()).collect();
    }
    let records = records_in(directory).unwrap_or_default();
    if images.is_empty() && records.is_empty() {
        bail!("{name} has neither records (outcomes-*.jsonl) nor images (*.fits)");
    }
    let from_records = !records.is_empty();
    let camera = &settings.camera;
    let model = CameraModel {
        width: camera.width_px as usize,
        height: camera.height_px as usize,
        platescale: ARCSEC,
        k1: 0.0,
        rows: RowOrder::BottomFirst,
        mirrored: camera.mirrored,
    };
    let mut gathered = Gathered {
        directory: name,
        shots: Vec::new(),
        half_diagonal_px: model.half_diagonal_px(),
        hot: None,
        frames: 0,
        from_records,
    };
    if from_records {
        gathered.take_records(&records, settings, &model)?;
    }
    if !images.is_empty() && (hot || !from_records) {
        gathered.take_images(&images, settings, hot, jobs)?;
    }
    Ok(gathered)
}

fn images_in(directory: &Path, depth: usize, into: &mut Vec<PathBuf>) -> std::io::Result<()> {
    for entry in fs::read_dir(directory)? {
        let path = entry?.path();
        if path.is_dir() {
            if depth > 0 {
                images_in(&path, depth - 1, into)?;
            }
        } else if path.extension().is_some_and(|ending| ["fits", "fit", "fts"].iter().any(|known| ending == *known)) {
            into.push(path);
        }
    }
    Ok(())
}

impl Gathered {
    fn take_records(&mut self, records: &[PathBuf], settings: &Settings, model: &CameraModel) -> anyhow::Result<()> {
        let mut frames = 0;
        let mut shots = Vec::new();
        let mut take = |outcome: &Map<String, Value>| {
            frames += 1;
            let rows = row_order(outcome);
            shots.extend(rows.and_then(|rows| shot_of_record(outcome, settings, &CameraModel { rows, ..*model })));
        };
        // Nobody is left to tell where even stderr is closed.
        each_line(records, |line| take(&line.outcome), |complaint| drop(writeln!(stderr(), "stars: {complaint}")))?;
        (self.frames, self.shots) = (frames, shots);
        Ok(())
    }

    fn take_images(&mut self, files: &[PathBuf], settings: &Arc<Settings>, hot: bool, jobs: usize) -> anyhow::Result<()> {
        let bad_pixels = load_bad_pixels(settings)?;
        // The first that can be read says what size the others have.
        let Some(first) = files.iter().find_map(|file| read(file)) else { bail!("{}: no image can be read", self.directory) };
        let size = (first.width, first.height);
        let solver = if self.from_records {
            None
        } else {
            let catalogue = Arc::new(load_catalogue(&settings.catalog.file).map_err(anyhow::Error::msg)?);
            let mut solver = Solver::new(catalogue, Arc::clone(settings));
            let prepared = prepare(&mut solver, size.0, size.1);
            prepared.complaints.iter().for_each(|complaint| drop(writeln!(stderr(), "stars: {complaint}")));
            self.half_diagonal_px = 0.5 * (size.0 as f64).hypot(size.1 as f64);
            Some(solver)
        };
        let work = Work { files, settings, bad_pixels: &bad_pixels, size, hot, next: AtomicUsize::new(0) };
        let parts = thread::scope(|scope| {
            let workers: Vec<_> = (0..jobs.min(files.len())).map(|_| scope.spawn(|| work.run(solver.clone()))).collect();
            workers
                .into_iter()
                .map(|worker| worker.join().map_err(|_| anyhow::anyhow!("an image broke a worker")))
                .collect::<Vec<_>>()
        });
        let mut shots = Vec::new();
        for part in parts {
            let (some, hot) = part?;
            shots.extend(some);
            match (&mut self.hot, hot) {
                (Some(all), Some(hot)) => all.merge(&hot),
                (none, hot) => *none = hot,
            }
        }
        if !self.from_records {
            // As the files are named, whichever worker had them.
            shots.sort_by_key(|(place, _)| *place);
            self.frames = files.len();
            self.shots = shots.into_iter().map(|(_, shot)| shot).collect();
        }
        Ok(())
    }
}

/// What the workers on images share.
struct Work<'a> {
    files: &'a [PathBuf],
    settings: &'a Settings,
    bad_pixels: &'a BadPixels,
    size: (usize, usize),
    hot: bool,
    next: AtomicUsize,
}

impl Work<'_> {
    /// Takes one image after the other until none is left.
    fn run(&self, mut solver: Option<Solver>) -> (Vec<(usize, Shot)>, Option<HotPixels>) {
        let mut hot = self.hot.then(|| HotPixels::new(self.size.0, self.size.1));
        let mut shots = Vec::new();
        loop {
            let place = self.next.fetch_add(1, Ordering::Relaxed);
            let Some(file) = self.files.get(place) else { return (shots, hot) };
            let Some(mut frame) = read(file).filter(|frame| (frame.width, frame.height) == self.size) else { continue };
            if let Some(hot) = &mut hot {
                hot.add(&frame);
            }
            if let Some(solver) = &mut solver {
                self.bad_pixels.apply(&mut frame);
                let outcome = solver.solve(&frame, &Prior::default(), &Unwatched);
                shots.extend(shot_of_outcome(&outcome, &frame, self.settings).map(|shot| (place, shot)));
            }
        }
    }
}

/// An image; one that cannot be read is named, and left out.
fn read(path: &Path) -> Option<Frame> {
    let name = path.display().to_string();
    let bytes = read_file(path, MAX_FILE_BYTES, "an image").map_err(anyhow::Error::from);
    let frame = bytes.and_then(|bytes| Ok(image::read(&name, &bytes)?));
    frame.inspect_err(|error| drop(writeln!(stderr(), "stars: {error:#}"))).ok()
}

/// Where stars are seen at a time, if aberration is to be taken into account: over a wide picture it changes the plate scale by 10⁻⁴.
fn aberration(utc: Option<Utc>, settings: &Settings) -> Option<Aberration> {
    utc.filter(|_| settings.solver.fit.aberration).and_then(Aberration::at)
}

fn pair(
    camera: &CameraModel,
    settings: &Settings,
    (x, y, sigma): (f64, f64, f64),
    star: &Vec3,
    seen: Option<&Aberration>,
) -> Pair {
    let (left, up) = camera.offsets(x, y);
    let star = seen.map_or(*star, |aberration| aberration.seen(star));
    Pair::round(left, up, sigma.hypot(settings.solver.fit.centroid_floor_px), star)
}

/// A frame that was solved here. Its stars are where the fit has them, which is right for blends too.
fn shot_of_outcome(outcome: &Outcome, frame: &Frame, settings: &Settings) -> Option<Shot> {
    let solution = outcome.solution.as_ref()?;
    let pose = Pose { attitude: solution.attitude, platescale: solution.platescale, k1: solution.k1, axis: solution.axis };
    let camera = CameraModel {
        width: frame.width,
        height: frame.height,
        platescale: solution.platescale,
        k1: solution.k1,
        rows: frame.rows,
        mirrored: settings.camera.mirrored,
    };
    let utc = frame.stamp.captured.map(|(utc, _)| utc);
    let seen = aberration(utc, settings);
    let pairs = solution.matches.iter().filter_map(|m| {
        let source = outcome.sources.get(m.source).filter(|source| !source.saturated)?;
        let (left, up) = camera.offsets(source.x + m.residual_px.0, source.y + m.residual_px.1);
        let (u, v) = pose.without_lens(left, up, camera.half_diagonal_px());
        let star = pose.attitude.to_sky(&Vec3::new(u * pose.platescale, v * pose.platescale, 1.0).normalize());
        Some(pair(&camera, settings, (source.x, source.y, source.sigma_px), &star, seen.as_ref()))
    });
    Some(Shot {
        trigger: frame.stamp.trigger.map(|trigger| u64::from(trigger.0)),
        utc_s: utc.map(|utc| utc.unix_s()),
        solved: Solved {
            view: View { attitude: solution.attitude, pairs: pairs.collect() },
            platescale: solution.platescale,
            sigma_platescale: solution.sigma_platescale,
        },
    })
}

/// A frame as a record has it; `None` where it was not solved.
fn shot_of_record(outcome: &Map<String, Value>, settings: &Settings, camera: &CameraModel) -> Option<Shot> {
    let number = |key: &str| outcome.get(key).and_then(Value::as_f64);
    let platescale = number("platescale_arcsec_px")? * ARCSEC;
    let attitude = Attitude::from_angles(number("ra_deg")? * DEG, number("dec_deg")? * DEG, number("roll_deg")? * DEG);
    let utc = outcome.get("captured_utc").and_then(Value::as_str).and_then(Utc::parse);
    let seen = aberration(utc, settings);
    let sources = outcome.get("sources").and_then(Value::as_array)?;
    let pairs = sources.iter().filter_map(|source| {
        let star = source.get("star").filter(|_| source.get("saturated") != Some(&Value::Bool(true)))?;
        let of = |value: &Value, key: &str| value.get(key).and_then(Value::as_f64);
        let place = (of(source, "x")?, of(source, "y")?, of(source, "sigma_px")?);
        let star = direction(of(star, "ra_deg")? * DEG, of(star, "dec_deg")? * DEG);
        Some(pair(camera, settings, place, &star, seen.as_ref()))
    });
    Some(Shot {
        trigger: outcome.get("trigger_counter").and_then(Value::as_u64),
        utc_s: utc.map(|utc| utc.unix_s()),
        solved: Solved {
            view: View { attitude, pairs: pairs.collect() },
            platescale,
            sigma_platescale: number("sigma_platescale_arcsec_px")? * ARCSEC,
        },
    })
}

/// Which end of its picture the first row is, where a record says it.
fn row_order(outcome: &Map<String, Value>) -> Option<RowOrder> {
    match outcome.get("row_order")?.as_str()? {
        "bottom_first" => Some(RowOrder::BottomFirst),
        "top_first" => Some(RowOrder::TopFirst),
        _ => None,
    }
}
