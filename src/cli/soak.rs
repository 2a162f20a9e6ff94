//! `stars soak`: the whole service under faults, for as long as a flight.

use super::run::{runtime, start_logging};
use super::{ConfigArgs, NEGATIVE, print};
use crate::settings::parse_span;
use crate::soak::{Plan, Progress, Report, fly};
use anyhow::Context;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use tokio::runtime::Builder;

/// The whole service with two flight computers under a seeded schedule of faults: nothing lost, nothing wrong, nothing run by itself
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars soak --duration 11d             eleven days on a clock that jumps from one event to the next
  stars soak --seed 7 --duration 2h --every 20s
  stars soak --real --duration 1h       in real time, over TCP
Exits 0 if nothing was lost or wrong; 1 if something was. The same seed flies the same again, but for how long a solver takes.")]
pub struct Args {
    /// Time to fly, such as 2h or 11d
    #[arg(long, value_name = "TIME", value_parser = parse_span, default_value = "1h")]
    duration: Duration,
    /// Mean time between faults
    #[arg(long, value_name = "TIME", value_parser = parse_span, default_value = "60s")]
    every: Duration,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// In real time, over TCP; otherwise on a clock that jumps
    #[arg(long)]
    real: bool,
    /// UTC is the machine's, which others may set meanwhile; otherwise it is made up, and jumps
    #[arg(long)]
    machine_clock: bool,
    /// Where records and what outlasts a restart are kept; a small disk of its own is filled now and then [default: a directory that is
    /// removed at the end]
    #[arg(long, value_name = "DIR")]
    directory: Option<PathBuf>,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Flies, and reports.
    ///
    /// # Errors
    /// Where the settings are wrong, the directory cannot be had, or the service cannot be started.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let settings = self.config.load()?.settings;
        start_logging("off");
        hush_panics_of_the_soak();
        let own = std::env::temp_dir().join(format!("stars-soak-{}", std::process::id()));
        let directory = self.directory.clone().unwrap_or_else(|| own.clone());
        std::fs::create_dir_all(&directory).with_context(|| directory.display().to_string())?;
        // A sensor's file has a whole path.
        let directory = std::path::absolute(&directory).with_context(|| directory.display().to_string())?;
        let Self { seed, duration, every, real, machine_clock, .. } = self;
        let plan = Plan { seed, duration, every, real, directory, machine_clock };
        let runtime = if real { runtime()? } else { jumping()? };
        let flown = runtime.block_on(fly(plan, &settings, |progress| {
            // Progress is a courtesy: a closed stdout ends nothing here, and the report at the end says so.
            let _ = print(&line(progress, duration));
        }));
        runtime.shutdown_timeout(Duration::from_millis(100));
        if self.directory.is_none() {
            let _ = std::fs::remove_dir_all(&own);
        }
        let Report { text, good } = flown?;
        print(text.trim_end())?;
        Ok(if good { ExitCode::SUCCESS } else { ExitCode::from(NEGATIVE) })
    }
}

/// A runtime whose clock jumps to the next event when nothing is left to do now.
fn jumping() -> anyhow::Result<tokio::runtime::Runtime> {
    /// A burst of jobs makes threads that the next jobs, which come sooner than on any other clock, would keep for ever.
    const IDLE_THREADS_STAY: Duration = Duration::from_millis(10);
    let mut builder = Builder::new_current_thread();
    builder.enable_all().start_paused(true).thread_keep_alive(IDLE_THREADS_STAY).build().context("the runtime cannot be started")
}

/// How far a flight has come and how fast, and the worst by now, in a line.
fn line(progress: &Progress, duration: Duration) -> String {
    let Progress { flown, taken, book, held } = progress;
    let hours = |time: &Duration| time.as_secs_f64() / 3600.0;
    let rate = hours(flown) / (taken.as_secs_f64() / 60.0).max(f64::EPSILON);
    let mib = held.map_or_else(|| "?".to_owned(), |held| (held.resident_kib / 1024).to_string());
    format!(
        "{:6.2} of {:.1} h, {rate:.2} h/min: {} solved, {} wrong; {} updates, {} late, longest gap {} ms; \
         {} commands, {} lost, {} spurious; {} restarts; {mib} MiB",
        hours(flown),
        hours(&duration),
        book.solved,
        book.wrong.len(),
        book.updates,
        book.late.len(),
        book.longest_gap.as_millis(),
        book.given,
        book.lost.len(),
        book.spurious.len(),
        book.restarts.values().sum::<u32>(),
    )
}

/// Panics that the schedule wants are no news; any other is told as ever.
fn hush_panics_of_the_soak() {
    let tell = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        let wanted = info.payload().downcast_ref::<&str>().is_some_and(|text| text.starts_with("soak: "));
        if !wanted {
            tell(info);
        }
    }));
}
