//! `stars replay`: a journal run again.

use super::{NEGATIVE, print};
use crate::image::ImageCounter;
use crate::journal::{Entry, Reader, What};
use crate::service::{Again, Answers, Now, Replay, Tally, Wishes, journals, read_file};
use anyhow::{Context, bail};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use tokio::time::Instant;

/// Runs journals again: the same outcomes to the last bit, or with other settings what would have been
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars replay records                                       every journal of a directory, at full speed
  stars replay records --set solver.robust=false --last 20   the last twenty frames as they would have been
  stars replay records/journal-2026-12-20T05-40-00Z-0000abcd-0000.journal --in-time
Exits 0 if everything came out as it did, and with other settings always; 1 if something did not; 2 if there is nothing to run.
Images are read from where the settings of the flight kept them.")]
pub struct Args {
    /// Journals, or directories of them; in this order
    #[arg(required = true, value_name = "JOURNAL")]
    journals: Vec<PathBuf>,
    /// Another setting than in the flight; may be given often
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// The image of this number alone
    #[arg(long, value_name = "N")]
    image: Option<u32>,
    /// The last frames alone
    #[arg(long, value_name = "N", conflicts_with = "image")]
    last: Option<usize>,
    /// As slowly as it went
    #[arg(long)]
    in_time: bool,
    /// Where the images lie, if not where the settings of the flight say
    #[arg(long, value_name = "DIR")]
    images: Option<PathBuf>,
    /// Only what came out otherwise, and the count
    #[arg(long)]
    quiet: bool,
}

/// No journal is longer, bytes: many times what the service lets one grow to.
const LONGEST: usize = 256 << 20;

impl Args {
    /// Runs them again, and reports.
    ///
    /// # Errors
    /// A file that cannot be read, no journal at all, and settings that do not fit.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let files = self.files()?;
        let frames = match self.last {
            Some(_) => files.iter().map(|file| read(file).map(|bytes| count_frames(&bytes))).sum::<anyhow::Result<usize>>()?,
            None => 0,
        };
        let wishes = Wishes { set: self.set.clone(), images: self.images.clone(), image: self.image.map(ImageCounter) };
        let mut replay = Replay::new(wishes);
        let mut run = Run { passed_over: self.last.map_or(0, |last| frames.saturating_sub(last)), ..Run::default() };
        let began = Instant::now();
        for file in &files {
            let bytes = read(file)?;
            let mut reader = Reader::new(&bytes);
            for entry in reader.by_ref() {
                self.take(&mut replay, &mut run, entry).with_context(|| file.display().to_string())?;
            }
            if reader.skipped() > 0 {
                replay.doubt();
                print(&format!("{}: {} bytes are torn and skipped", file.display(), reader.skipped()))?;
            }
        }
        if replay.tally().entries == 0 {
            bail!("no entry in {} journals", files.len());
        }
        let taken = began.elapsed();
        print(&report(replay.tally(), run.time + run.last, taken, replay.is_otherwise()))?;
        let negative = replay.tally().differs() && !replay.is_otherwise();
        Ok(if negative { ExitCode::from(NEGATIVE) } else { ExitCode::SUCCESS })
    }

    /// The journals that are named, those of a directory in the order of their time.
    fn files(&self) -> anyhow::Result<Vec<PathBuf>> {
        let mut all = Vec::new();
        for path in &self.journals {
            if path.is_dir() {
                let found = journals(path).with_context(|| path.display().to_string())?;
                all.extend(found.into_iter().map(|(path, _)| path));
            } else {
                all.push(path.clone());
            }
        }
        if all.is_empty() {
            bail!("no journal in {}", self.journals.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", "));
        }
        Ok(all)
    }

    fn take(&self, replay: &mut Replay, run: &mut Run, entry: Entry) -> anyhow::Result<()> {
        run.note(&entry);
        if self.in_time {
            run.wait_for(entry.at);
        }
        if matches!(entry.what, What::Solved(_)) && run.passed_over > 0 {
            run.passed_over -= 1;
            replay.pass_over();
            return Ok(());
        }
        let again = replay.take(entry, &|| false).map_err(anyhow::Error::msg)?;
        match again {
            Some(again) if !self.quiet || again.differs() => print(&line(&again, replay.is_otherwise())),
            _ => Ok(()),
        }
    }
}

fn read(file: &Path) -> anyhow::Result<Vec<u8>> {
    Ok(read_file(file, LONGEST, "a journal")?)
}

fn count_frames(bytes: &[u8]) -> usize {
    Reader::new(bytes).filter(|entry| matches!(entry.what, What::Solved(_))).count()
}

/// How far a run is.
#[derive(Default)]
struct Run {
    /// Frames that are still passed over.
    passed_over: usize,
    /// Time that the runs before this one took.
    time: Duration,
    /// The time of the last entry of this run.
    last: Duration,
    /// When this run began here.
    began: Option<Instant>,
}

impl Run {
    fn note(&mut self, entry: &Entry) {
        if matches!(entry.what, What::Begin(_)) {
            self.time += self.last;
            (self.last, self.began) = (Duration::ZERO, None);
        }
        self.last = self.last.max(entry.at);
    }

    fn wait_for(&mut self, at: Duration) {
        let began = *self.began.get_or_insert_with(|| Instant::now().checked_sub(at).unwrap_or_else(Instant::now));
        std::thread::sleep((began + at).saturating_duration_since(Instant::now()));
    }
}

/// A frame in a line.
fn line(again: &Again, otherwise: bool) -> String {
    let Again { at, image, was, now, .. } = again;
    let head = format!("image {} at {:.3} s: {was}", image.0, at.as_secs_f64());
    match now {
        Now::Not(why) => format!("{head}; not run: {why}"),
        Now::Again { differs, .. } if differs.is_empty() => format!("{head}; the same"),
        Now::Again { outcome, .. } if otherwise => format!("{head}; would have been {outcome}"),
        Now::Again { outcome, differs } => format!("{head}; DIFFERS in {}: {outcome}", differs.join(", ")),
    }
}

/// What was counted.
fn report(tally: &Tally, time: Duration, taken: Duration, otherwise: bool) -> String {
    let Tally { runs, entries, lost, machines, priors, frames, reasons, not_run, first } = tally;
    let (time_s, taken_s) = (time.as_secs_f64(), taken.as_secs_f64());
    let mut lines = vec![format!(
        "{entries} entries of {runs} runs, {:.3} h in {taken_s:.1} s: {:.1} times as fast; {lost} entries missing",
        time_s / 3600.0,
        time_s / taken_s.max(f64::EPSILON)
    )];
    let words = |Answers { same, other, unknown }: &Answers| format!("{same} the same, {other} otherwise, {unknown} unknown");
    lines.push(format!("frames: {}", words(frames)));
    let counts = |all: &std::collections::BTreeMap<String, u64>| {
        all.iter().map(|(name, count)| format!("{count} {name}")).collect::<Vec<_>>().join(", ")
    };
    if !reasons.is_empty() {
        lines.push(format!("  of those run: {}", counts(reasons)));
    }
    if !not_run.is_empty() {
        lines.push(format!("  not run: {}", counts(not_run)));
    }
    if !otherwise {
        lines.push(format!("priors: {}", words(priors)));
        lines.extend(machines.iter().map(|(machine, answers)| format!("{}: {}", machine.name(), words(answers))));
        lines.push(match first {
            None => "identical".to_owned(),
            Some(first) => format!("first difference: {first}"),
        });
    }
    lines.join("\n")
}
