//! `stars run`: the flight service.

use super::{ConfigArgs, NEGATIVE};
use crate::service::{self, Inherited, Manager, Running};
use crate::settings::{Layer, Setting, Settings, parse_span};
use anyhow::Context;
use std::convert::Infallible;
use std::io::IsTerminal;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};
use tokio::signal::unix::{SignalKind, signal};

/// Threads for what waits. The work is done on the blocking pool.
const WORKERS: usize = 2;
/// Threads of the blocking pool: camera, solver, recorder, ledger, two archives and each of eight sensors need one; camera and solver may
/// leave two each behind that hang.
const BLOCKING: usize = 24;

/// Updates that still go out after a command to end.
const FAREWELL_UPDATES: f64 = 3.0;

/// Runs the flight service: camera, solver, and updates to the flight computers
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars run                             a simulated sky, on any machine
  stars run --custom custom.toml        a flight
  stars run --set camera.kind=directory --set camera.directory=images --duration 40s
SIGINT and SIGTERM end it cleanly, as the duration does. Logs go to stderr; RUST_LOG sets how much (info).")]
pub struct Args {
    /// End by itself after this time, such as 40s or 11d
    #[arg(long, value_name = "TIME", value_parser = parse_span)]
    duration: Option<Duration>,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Runs the service to its end.
    ///
    /// # Errors
    /// Where the settings are wrong or the address cannot be had.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let loaded = self.config.load()?;
        start_logging("info");
        let calibrated: Vec<String> =
            loaded.all.iter().filter(|setting| setting.origin.layer == Layer::Calibration).map(said).collect();
        if !calibrated.is_empty() {
            tracing::info!("a calibration is in force: {}", calibrated.join(", "));
        }
        let settings = Arc::new(loaded.settings);
        let runtime = runtime()?;
        let ended = runtime.block_on(async {
            let stop = stop_signal()?;
            let farewell = Duration::from_secs_f64(FAREWELL_UPDATES * settings.network.update_period_s);
            let silent_for = silent_for(&settings);
            let manager = Manager::of_this_process();
            let running = service::start(settings, Inherited::take(), manager.clone()).await?;
            manager.ready();
            let mut state = running.state.clone();
            let why = tokio::select! {
                why = until(stop, self.duration) => why,
                never = watch(&running, &manager, silent_for) => match never {},
                Ok(()) = async { state.wait_for(|state| state.ending.is_some()).await.map(drop) } => {
                    // The ground is told that its command was taken.
                    tokio::time::sleep(farewell).await;
                    "a command"
                }
            };
            tracing::info!(why, "stopping");
            manager.stopping();
            anyhow::Ok(end(running).await)
        });
        runtime.shutdown_timeout(Duration::from_millis(100));
        ended
    }
}

/// A setting and where it comes from.
fn said(setting: &Setting) -> String {
    format!("{} = {} ({})", setting.key, setting.value, setting.origin)
}

/// A part that has been silent for so long will not come back: one that hangs is started again sooner.
fn silent_for(settings: &Settings) -> Duration {
    let service = &settings.service;
    Duration::from_secs_f64(2.0 * service.hang_s + service.restart_delay_max_s)
}

/// Tells the watchdog of the service manager that all is well, for as long as it is.
async fn watch(running: &Running, manager: &Manager, silent_for: Duration) -> Infallible {
    let Some(period) = manager.watchdog_period() else { return std::future::pending().await };
    let mut ticks = tokio::time::interval(period);
    loop {
        ticks.tick().await;
        match running.hopeless(silent_for) {
            None => manager.alive(),
            Some(actor) => tracing::error!(?actor, "it does not answer: the watchdog is not told that all is well"),
        }
    }
}

/// The runtime of the service.
///
/// # Errors
/// Where the machine gives no threads.
pub fn runtime() -> anyhow::Result<Runtime> {
    let mut builder = Builder::new_multi_thread();
    builder.worker_threads(WORKERS).max_blocking_threads(BLOCKING).enable_all();
    builder.build().context("the runtime cannot be started")
}

/// Log lines to stderr, from `level` up unless the environment says otherwise.
pub fn start_logging(level: &str) {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env().unwrap_or_else(|_| level.into());
    let terminal = std::io::stderr().is_terminal();
    let log =
        tracing_subscriber::fmt().with_writer(std::io::stderr).with_ansi(terminal).with_env_filter(filter).with_target(false);
    // Only a second call in the same process could fail, and the first one's log serves it too.
    let _ = log.try_init();
}

/// Something that ends when the program is told to: SIGINT or SIGTERM, both listened for from now on.
///
/// # Errors
/// Where the signals cannot be had.
pub fn stop_signal() -> anyhow::Result<impl Future<Output = &'static str>> {
    let mut interrupt = signal(SignalKind::interrupt()).context("SIGINT cannot be listened for")?;
    let mut terminate = signal(SignalKind::terminate()).context("SIGTERM cannot be listened for")?;
    Ok(async move {
        tokio::select! {
            _ = interrupt.recv() => "SIGINT",
            _ = terminate.recv() => "SIGTERM",
        }
    })
}

/// Waits for the signal or the end of the duration, and says which it was.
pub async fn until(stop: impl Future<Output = &'static str>, duration: Option<Duration>) -> &'static str {
    match duration {
        None => stop.await,
        Some(duration) => tokio::time::timeout(duration, stop).await.unwrap_or("end of the duration"),
    }
}

/// Ends the service; a part that does not end in time is named, and makes the exit code negative.
pub async fn end(running: Running) -> ExitCode {
    let late = running.stop().await;
    if late.is_empty() {
        tracing::info!("stopped");
        return ExitCode::SUCCESS;
    }
    tracing::error!(?late, "did not end in time");
    ExitCode::from(NEGATIVE)
}
