//! `stars solve`: solves images from disk and says where they point, or why not.

use super::{ConfigArgs, NEGATIVE, WRONG, print, text};
use crate::display::{FrameView, Geometry, draw, encode};
use crate::image::{self, BadPixels, Frame, Stamp};
use crate::service::{load_bad_pixels, load_catalogue, prepare, read_file};
use crate::settings::Settings;
use crate::solve::{Outcome, Prior, Reason, Report, Solver, Stop, Watch};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::io::{IsTerminal, Write, stderr};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// What an image file may be.
const EXPECTED: &str = "an image (FITS, TIFF, PNG or JPEG)";
/// Longest file that is read, bytes: several times the largest image that the readers take.
const MAX_FILE_BYTES: usize = 1 << 30;

/// Solves images: prints where each one points, or why that could not be found
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars solve flight/*.fits
  stars solve --json --jobs 2 night/*.tiff \\
      --set solver.matching.platescale_min_arcsec_px=38.3 --set solver.matching.platescale_max_arcsec_px=42.4
Exits 0 if all were solved, 1 if some were not, 2 if the call or a file is wrong; all images are answered first.")]
pub struct Args {
    /// Images: FITS, TIFF, PNG or JPEG, of 8 or 16 bits; width and height are taken from them
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print one JSON object a line, in the order of the files
    #[arg(long)]
    json: bool,
    /// Write a picture of each image with its sources, their stars and the pointing, as PNG, into this directory
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Images solved at a time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    jobs: u8,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Solves the images.
    ///
    /// # Errors
    /// Where settings, catalogue or the directory for overlays are wrong. A wrong image is answered by its own line instead.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let settings = Arc::new(self.config.load()?.settings);
        let catalogue = Arc::new(load_catalogue(&settings.catalog.file).map_err(anyhow::Error::msg)?);
        let bad_pixels = load_bad_pixels(&settings)?;
        let overlays = self.overlay.as_deref().map(|directory| overlay_files(directory, &self.files)).transpose()?;
        let batch = Batch {
            files: &self.files,
            overlays,
            json: self.json,
            bad_pixels,
            settings: settings.clone(),
            solver: Mutex::new(Solver::new(catalogue, settings)),
            next: AtomicUsize::new(0),
        };
        let worst = batch.run(usize::from(self.jobs))?;
        Ok(match worst {
            Verdict::Solved => ExitCode::SUCCESS,
            Verdict::NotSolved => ExitCode::from(NEGATIVE),
            Verdict::Wrong => ExitCode::from(WRONG),
        })
    }
}

/// Makes the directory and gives each image a file of its own in it, also where images of two directories share a name.
fn overlay_files(directory: &Path, images: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let name = directory.display();
    fs::create_dir_all(directory).with_context(|| format!("{name}: cannot be made, expected a directory for overlays"))?;
    let mut taken = HashSet::new();
    let mut unique = |image: &PathBuf| {
        let stem = image.file_stem().unwrap_or(image.as_os_str()).to_string_lossy().into_owned();
        let others = (2..).map(|n| format!("{stem}-{n}.png"));
        let free = std::iter::once(format!("{stem}.png")).chain(others).find(|name| taken.insert(name.clone()));
        directory.join(free.unwrap_or(stem))
    };
    Ok(images.iter().map(&mut unique).collect())
}

/// How an image ended, best first: the worst of a call is its exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Verdict {
    Solved,
    NotSolved,
    Wrong,
}

/// What is printed for one image.
struct Answer {
    text: String,
    /// For stderr: which file is wrong, and what was expected.
    complaint: Option<String>,
    verdict: Verdict,
}

/// The images of one call, and what their workers share.
struct Batch<'a> {
    files: &'a [PathBuf],
    overlays: Option<Vec<PathBuf>>,
    json: bool,
    bad_pixels: BadPixels,
    settings: Arc<Settings>,
    /// The solver that workers clone once it is prepared for their size of image, so that one index serves all.
    solver: Mutex<Solver>,
    /// The next image to be taken.
    next: AtomicUsize,
}

impl Batch<'_> {
    /// Solves all images with `jobs` workers, and prints the answers in the order of the files.
    fn run(&self, jobs: usize) -> anyhow::Result<Verdict> {
        let progress = self.progress();
        thread::scope(|scope| {
            let (sender, answers) = sync_channel::<(usize, Answer)>(jobs);
            for _ in 0..jobs.min(self.files.len()) {
                let sender = sender.clone();
                scope.spawn(move || self.work(&sender));
            }
            drop(sender);
            let mut waiting = BTreeMap::new();
            let mut printed = 0;
            let mut worst = Verdict::Solved;
            for (index, answer) in answers {
                progress.inc(1);
                waiting.insert(index, answer);
                while let Some(answer) = waiting.remove(&printed) {
                    printed += 1;
                    worst = worst.max(answer.verdict);
                    progress.suspend(|| show(&answer))?;
                }
            }
            progress.finish_and_clear();
            Ok(worst)
        })
    }

    /// A progress bar where there is much to wait for and somebody to see it.
    fn progress(&self) -> ProgressBar {
        const STYLE: &str = "{bar:40} {pos}/{len} images, {eta} left";
        if self.files.len() < 2 || !stderr().is_terminal() {
            return ProgressBar::hidden();
        }
        let style = ProgressStyle::with_template(STYLE).unwrap_or_else(|_| ProgressStyle::default_bar());
        ProgressBar::new(self.files.len() as u64).with_style(style)
    }

    /// Answers one image after the other until none is left, or nobody listens.
    fn work(&self, answers: &SyncSender<(usize, Answer)>) {
        let mut own: Option<Own> = None;
        loop {
            let index = self.next.fetch_add(1, Ordering::Relaxed);
            let Some(path) = self.files.get(index) else { return };
            let overlay = self.overlays.as_ref().and_then(|files| files.get(index));
            let answer = self.answer(path, overlay.map(PathBuf::as_path), &mut own);
            if answers.send((index, answer)).is_err() {
                return;
            }
        }
    }

    fn answer(&self, path: &Path, overlay: Option<&Path>, own: &mut Option<Own>) -> Answer {
        let name = path.display().to_string();
        let start = now();
        let bytes = read_file(path, MAX_FILE_BYTES, EXPECTED).map_err(anyhow::Error::from);
        let mut frame = match bytes.and_then(|bytes| Ok(image::read(&name, &bytes)?)) {
            Ok(frame) => frame,
            Err(error) => {
                let detail = one_line(&error);
                let stamp = Stamp { origin: name, ..Stamp::default() };
                let outcome = Outcome::unsolved(stamp, Reason::Unreadable, detail.clone());
                let complaint = if detail.contains("expected") { detail } else { format!("{detail}; expected {EXPECTED}") };
                return self.answer_with(&outcome, Some(complaint));
            }
        };
        self.bad_pixels.apply(&mut frame);
        let read = start.elapsed();
        let mut outcome = self.solve(&frame, own);
        outcome.times.read = read;
        let complaint = overlay.and_then(|file| {
            let written = self.write_overlay(file, &frame, &outcome);
            written.err().map(|error| one_line(&error))
        });
        self.answer_with(&outcome, complaint)
    }

    /// Solves a frame with this worker's own solver. A solver that breaks ends the frame, not the call.
    fn solve(&self, frame: &Frame, own: &mut Option<Own>) -> Outcome {
        let size = (frame.width, frame.height);
        let mut solver = match own.take() {
            Some(own) if own.size == size => own.solver,
            _ => {
                let mut shared = self.shared();
                for complaint in prepare(&mut shared, frame.width, frame.height).complaints {
                    // As in `show`.
                    let _ = writeln!(stderr(), "stars: {complaint}");
                }
                shared.clone()
            }
        };
        let limit = Duration::try_from_secs_f64(self.settings.solver.timeout_s).unwrap_or(Duration::MAX);
        let watch = StopWatch { start: now(), limit };
        let solved = catch_unwind(AssertUnwindSafe(|| solver.solve(frame, &Prior::default(), &watch)));
        solved.map_or_else(
            |_| Outcome::unsolved(frame.stamp.clone(), Reason::Failed, "the solver broke on this image"),
            |outcome| {
                *own = Some(Own { size, solver });
                outcome
            },
        )
    }

    fn shared(&self) -> MutexGuard<'_, Solver> {
        // A worker that broke while it held the lock left a solver that can prepare again.
        self.solver.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn write_overlay(&self, file: &Path, frame: &Frame, outcome: &Outcome) -> anyhow::Result<()> {
        let report = Report::new(outcome, self.shared().catalogue());
        let geometry = Geometry::new(frame.width, frame.height, frame.rows, self.settings.camera.mirrored);
        let picture = draw(frame, &FrameView::new(outcome, &report, Some(geometry), &self.settings));
        let name = file.display();
        fs::write(file, encode(&picture)?).with_context(|| format!("{name}: the overlay cannot be written"))
    }

    fn answer_with(&self, outcome: &Outcome, complaint: Option<String>) -> Answer {
        let text = if self.json {
            let report = Report::new(outcome, self.shared().catalogue());
            serde_json::to_string(&report).unwrap_or_else(|error| format!("{{\"solved\":false,\"detail\":\"{error}\"}}"))
        } else {
            text::block(outcome)
        };
        let verdict = match outcome.reason {
            _ if complaint.is_some() => Verdict::Wrong,
            Reason::Solved => Verdict::Solved,
            _ => Verdict::NotSolved,
        };
        Answer { text, complaint, verdict }
    }
}

/// A worker's solver, and the size of image that it is prepared for.
struct Own {
    size: (usize, usize),
    solver: Solver,
}

/// The time since a frame was taken up, and when that is too long.
struct StopWatch {
    start: Instant,
    limit: Duration,
}

impl Watch for StopWatch {
    fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        (self.elapsed() >= self.limit).then_some(Stop::TimedOut)
    }
}

#[allow(clippy::disallowed_methods, reason = "no runtime runs here whose clock a test could hold")]
fn now() -> Instant {
    Instant::now()
}

fn show(answer: &Answer) -> anyhow::Result<()> {
    if let Some(complaint) = &answer.complaint {
        // Nobody is left to tell where even stderr is closed; the exit code still says it.
        let _ = writeln!(stderr(), "stars: {complaint}");
    }
    print(&answer.text)
}

fn one_line(error: &anyhow::Error) -> String {
    format!("{error:#}").lines().map(str::trim).collect::<Vec<_>>().join(" ")
}
