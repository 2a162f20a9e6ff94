//! `stars fcp`: a simulated flight computer, to see what a camera serves.

mod log;

use super::{ConfigArgs, NEGATIVE, print, within};
use crate::command::{Act, Command, Definition, Key, parse_order};
use crate::service::{Clock, fly, read_file};
use crate::settings::parse_span;
use crate::simulate::FlightComputer;
use crate::sky::{DEG, HOUR, Observer};
use crate::wire::{EquatorialEstimate, HorizontalEstimate};
use anyhow::Context;
use log::{End, Log};
use std::io::{Write, stderr};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use tokio::io::AsyncBufReadExt;
use tokio::sync::mpsc;

/// Sightings that may wait to be printed; then the computer reads no more, and the camera sees a slow peer.
const QUEUE: usize = 256;
/// Longest script or key file, bytes.
const LONGEST_SCRIPT: usize = 1 << 20;
/// Time for the connection to be closed at the end.
const LAST_WORD: Duration = Duration::from_millis(100);
/// With `--updates`, this many attempts without ever a connection are enough to say that there is no camera.
const ATTEMPTS: u32 = 4;

/// A simulated flight computer: connects to a camera, exchanges status every 0.5 s, prints what it gets
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  stars fcp --id 1 --in-charge
  stars fcp --connect 192.168.1.6:2017 --id 2 --json --updates 1200 > ten-minutes.jsonl
  stars fcp --connect 127.0.0.1:2017 --id 1 --in-charge --latitude-deg=-77.5 --sidereal-time-h 8.1
  stars fcp --id 1 --in-charge --send 'lens.set_focus 3030' --send 'solver.configure 1 20'
  stars fcp --id 1 --in-charge --send 'arm service.quit' --send 'fire service.quit'
  stars fcp --commands                  every command with its values
Commands are sent one after the other, each when the one before has had its last reply; those that only stop things are sent at once.
Nothing is sent before the link is up and, with --in-charge, the lease is held; without it they are refused: not_in_charge. Without
--updates and --duration it ends when all of them are answered. A value that begins with a minus needs the equals sign. SIGINT and
SIGTERM end it cleanly. Exit code 1: a command was rejected, failed or never answered; with --updates or commands, there was no camera
in 4 attempts; with --updates, the duration ended first.")]
pub struct Args {
    /// Camera to connect to, host:port [default: the setting network.listen]
    #[arg(long, value_name = "ADDR", value_parser = address)]
    connect: Option<String>,
    /// Which flight computer this is, 1 to 255
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..))]
    id: u8,
    /// Claim to be in charge
    #[arg(long)]
    in_charge: bool,
    /// End after so many updates
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    updates: Option<u64>,
    /// End after this time, such as 40s
    #[arg(long, value_name = "TIME", value_parser = parse_span)]
    duration: Option<Duration>,
    /// Time before connecting again, seconds or such as 250ms
    #[arg(long, value_name = "TIME", default_value = "9", value_parser = seconds_or_span)]
    retry: Duration,
    /// One JSON object a line
    #[arg(long)]
    json: bool,
    /// Observer's latitude to send, north positive
    #[arg(long, value_name = "DEG", requires = "sidereal_time_h", value_parser = |text: &str| within(text, -90.0, 90.0))]
    latitude_deg: Option<f64>,
    /// Observer's local sidereal time to send, now; it runs on from there
    #[arg(long, value_name = "H", requires = "latitude_deg", value_parser = |text: &str| within(text, 0.0, 24.0))]
    sidereal_time_h: Option<f64>,
    /// Estimated azimuth of the boresight to send
    #[arg(long, value_name = "DEG", requires = "el_deg", value_parser = |text: &str| within(text, 0.0, 360.0))]
    az_deg: Option<f64>,
    /// Estimated elevation of the boresight to send
    #[arg(long, value_name = "DEG", requires = "az_deg", value_parser = |text: &str| within(text, -90.0, 90.0))]
    el_deg: Option<f64>,
    /// Estimated right ascension of the boresight to send
    #[arg(long, value_name = "DEG", requires = "dec_deg", value_parser = |text: &str| within(text, 0.0, 360.0))]
    ra_deg: Option<f64>,
    /// Estimated declination of the boresight to send
    #[arg(long, value_name = "DEG", requires = "ra_deg", value_parser = |text: &str| within(text, -90.0, 90.0))]
    dec_deg: Option<f64>,
    /// Command to send, such as 'lens.set_focus 3030'; 'arm …' and 'fire …' for a hazardous one. Repeatable
    #[arg(long, value_name = "COMMAND", value_parser = order)]
    send: Vec<Order>,
    /// File with a command a line, '#' begins a comment; '-' for stdin, whose lines are sent as they come
    #[arg(long, value_name = "FILE")]
    script: Option<String>,
    /// File with the key that this computer shares with the camera, 64 hexadecimal digits
    #[arg(long, value_name = "FILE")]
    key_file: Option<PathBuf>,
    /// Print every command with its values, and end
    #[arg(long)]
    commands: bool,
    /// Number of the series of triggers that images belong to, to send
    #[arg(long, value_name = "N")]
    trigger: Option<u32>,
    #[command(flatten)]
    config: ConfigArgs,
}

/// A command and what is to be done with it.
type Order = (Act, Command);

/// A command as it is written, `arm` or `fire` before a hazardous one.
fn order(text: &str) -> Result<Order, String> {
    parse_order(text).map_err(|error| error.to_string())
}

/// The command of a line of a script, where there is one.
fn line_order(line: &str) -> Option<Result<Order, String>> {
    let text = line.split('#').next().unwrap_or_default().trim();
    (!text.is_empty()).then(|| order(text))
}

/// A host and a port, not yet looked up.
fn address(text: &str) -> Result<String, String> {
    let wrong = || format!("'{text}' is no address, expected host:port such as 127.0.0.1:2017");
    let (host, port) = text.rsplit_once(':').ok_or_else(wrong)?;
    match port.parse::<u16>() {
        Ok(1..) if !host.is_empty() => Ok(text.to_owned()),
        _ => Err(wrong()),
    }
}

fn seconds_or_span(text: &str) -> Result<Duration, String> {
    parse_span(text).or_else(|error| parse_span(&format!("{text}s")).map_err(|_| error))
}

impl Args {
    /// Flies until enough updates came, the duration ended or a signal said so.
    ///
    /// # Errors
    /// Where the settings are wrong, the machine gives no runtime, or stdout cannot be written.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        if self.commands {
            print(&Definition::all().iter().map(Definition::help).collect::<Vec<_>>().join("\n"))?;
            return Ok(ExitCode::SUCCESS);
        }
        let listen = self.config.load()?.settings.network.listen;
        let camera = self.connect.clone().unwrap_or(listen);
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        runtime.context("the runtime cannot be started")?.block_on(self.watch(camera))
    }

    async fn watch(self, camera: String) -> anyhow::Result<ExitCode> {
        let (sender, mut sightings) = mpsc::channel(QUEUE);
        let (to_ground, ground) = mpsc::channel(QUEUE);
        let orders = self.orders()?;
        let commanding = !orders.is_empty() || self.script.is_some();
        let from_stdin = self.script.as_deref() == Some("-");
        let until_answered = commanding && !from_stdin && self.updates.is_none() && self.duration.is_none();
        let flight = tokio::spawn(fly(self.computer()?, camera, self.retry, ground, sender));
        tokio::spawn(async move {
            for order in orders {
                if to_ground.send(order).await.is_err() {
                    return;
                }
            }
            if from_stdin {
                read_stdin(to_ground).await;
            }
        });
        let mut log = Log::new(self.json, self.updates).ending(until_answered);
        let end = tokio::select! {
            end = log.read(&mut sightings) => end?,
            () = interrupted() => End::Signal,
            () = tokio::time::sleep(self.duration.unwrap_or(Duration::MAX)) => End::Duration,
        };
        drop(sightings);
        // It ends with its channel; a camera that hangs is not waited for.
        let _ = tokio::time::timeout(LAST_WORD, flight).await;
        log.farewell(end)?;
        Ok(match end {
            End::Unreachable => ExitCode::from(NEGATIVE),
            End::Duration if self.updates.is_some() => ExitCode::from(NEGATIVE),
            _ if log.refused > 0 => ExitCode::from(NEGATIVE),
            End::Duration | End::Signal | End::Enough | End::Answered => ExitCode::SUCCESS,
        })
    }

    /// The commands of the options and of the script, in this order.
    fn orders(&self) -> anyhow::Result<Vec<Order>> {
        let mut orders = self.send.clone();
        if let Some(name) = self.script.as_ref().filter(|name| *name != "-") {
            let bytes = read_file(Path::new(name), LONGEST_SCRIPT, "a command a line")?;
            for (number, line) in String::from_utf8_lossy(&bytes).lines().enumerate() {
                if let Some(order) = line_order(line) {
                    orders.push(order.map_err(|problem| anyhow::anyhow!("{name}:{}: {problem}", number + 1))?);
                }
            }
        }
        Ok(orders)
    }

    /// The computer that the options describe.
    fn computer(&self) -> anyhow::Result<FlightComputer> {
        let mut computer = FlightComputer::new(self.id, Clock::start().boot_id());
        let observer = self.latitude_deg.zip(self.sidereal_time_h);
        computer.claims_charge = self.in_charge;
        computer.observer = observer.map(|(lat, time)| Observer { latitude: lat * DEG, sidereal_time: time * HOUR });
        computer.horizontal = self.az_deg.zip(self.el_deg).map(|(az_deg, el_deg)| HorizontalEstimate { az_deg, el_deg });
        computer.equatorial = self.ra_deg.zip(self.dec_deg).map(|(ra_deg, dec_deg)| EquatorialEstimate { ra_deg, dec_deg });
        computer.trigger = self.trigger;
        if let Some(path) = &self.key_file {
            let text = read_file(path, LONGEST_SCRIPT, "a key")?;
            let key = Key::parse(&String::from_utf8_lossy(&text));
            computer.key = Some(key.with_context(|| path.display().to_string())?);
        }
        Ok(computer)
    }
}

/// Sends the commands that come on stdin; one that is none is told and passed over.
async fn read_stdin(ground: mpsc::Sender<Order>) {
    let mut lines = tokio::io::BufReader::new(tokio::io::stdin()).lines();
    while let Ok(Some(line)) = lines.next_line().await {
        match line_order(&line) {
            None => {}
            Some(Ok(order)) if ground.send(order).await.is_ok() => {}
            Some(Ok(_)) => return,
            // Nobody is left to tell where even stderr is closed.
            Some(Err(problem)) => drop(writeln!(stderr(), "stars: stdin: {problem}")),
        }
    }
}

/// SIGINT, and where there is such a thing SIGTERM.
async fn interrupted() {
    #[cfg(unix)]
    if let Ok(mut terminate) = tokio::signal::unix::signal(tokio::signal::unix::SignalKind::terminate()) {
        tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = terminate.recv() => {}
        }
        return;
    }
    if tokio::signal::ctrl_c().await.is_err() {
        // Signals cannot be had: the default of the system ends the program.
        std::future::pending::<()>().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn args(words: &[&str]) -> Result<Args, String> {
        let all = ["fcp"].iter().chain(words);
        Cli::try_parse_from(all).map(|cli| cli.args).map_err(|error| error.to_string())
    }

    #[test]
    fn the_options_make_the_computer_that_they_describe() {
        let words = ["--connect", "localhost:2017", "--id", "2", "--in-charge", "--latitude-deg=-77.5", "--sidereal-time-h", "6"];
        let computer = args(&words).unwrap().computer().unwrap();
        assert!(computer.id == 2 && computer.claims_charge && computer.horizontal.is_none());
        let observer = computer.observer.unwrap();
        assert!((observer.latitude / DEG + 77.5).abs() < 1e-12 && (observer.sidereal_time / HOUR - 6.0).abs() < 1e-12);
    }

    #[test]
    fn the_retry_reads_as_seconds_or_as_a_span() {
        for (text, seconds) in [("9", 9.0), ("0.5", 0.5), ("250ms", 0.25)] {
            let read = args(&["--connect", "a:1", "--retry", text]).unwrap();
            assert_eq!(read.retry, Duration::from_secs_f64(seconds));
        }
    }

    #[test]
    fn a_wrong_option_is_refused_with_what_was_expected() {
        let cases: [(&[&str], &str); 7] = [
            (&["--connect", "127.0.0.1"], "such as 127.0.0.1:2017"),
            (&["--connect", ":2017"], "such as 127.0.0.1:2017"),
            (&["--connect", "a:0"], "such as 127.0.0.1:2017"),
            (&["--connect", "a:1", "--id", "0"], "1..=255"),
            (&["--connect", "a:1", "--latitude-deg=91", "--sidereal-time-h", "1"], "from -90 to 90"),
            (&["--connect", "a:1", "--latitude-deg=nan", "--sidereal-time-h", "1"], "from -90 to 90"),
            (&["--connect", "a:1", "--az-deg", "10"], "--el-deg"),
        ];
        for (words, expected) in cases {
            let error = args(words).unwrap_err();
            assert!(error.contains(expected), "{words:?}: {error}");
        }
    }
}
