//! Sensors: what gives a number, from a file, a program, the disk or a simulation.

use super::{Quantity, Rule};
use crate::command::Tick;
use crate::service::file::{FileError, free_bytes, read_file};
use crate::settings::{SensorSource, Settings};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Pid, Signal, kill_process_group};
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::process::Command;
use tokio::runtime::Handle;
use tokio_util::sync::CancellationToken;

/// Bytes that are read for the sake of one number; the kernel says of its own files that they have a page, 64 KiB at most.
const MOST_BYTES: usize = 64 * 1024;
/// Characters of what was said instead of a number that an error repeats.
const REPEATED: usize = 40;
/// Bytes of a GiB.
const GIB: f64 = (1u64 << 30) as f64;
/// Period of a simulated value's swing, s: about that of the day and the night of an orbit, so that a demonstration shows it.
const SWING_S: f64 = 5400.0;

/// Gives a number when it is asked. It may take its time: it is asked on the blocking pool, and not again before it has answered.
pub trait Sensor: Send {
    /// The value now, in the unit of its quantity.
    ///
    /// # Errors
    /// Where there is none.
    fn read(&mut self, now: Tick) -> Result<f64, SensorError>;
}

/// Why there is no value.
#[derive(Debug, thiserror::Error)]
pub enum SensorError {
    /// The file cannot be had.
    #[error(transparent)]
    File(#[from] FileError),
    /// There is no number in what came.
    #[error("no number in \"{0}\"")]
    NoNumber(String),
    /// No such value is possible.
    #[error("{value} {unit} is not possible; is its scale right?")]
    Impossible {
        /// What came.
        value: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// The program cannot be run, or fails.
    #[error("{program}: {problem}")]
    Program {
        /// The program.
        program: String,
        /// What is wrong.
        problem: String,
    },
    /// The disk does not say.
    #[error("free space of {directory}: {problem}")]
    Disk {
        /// The directory.
        directory: String,
        /// What the system says.
        problem: String,
    },
    /// The sensor's own code broke.
    #[error("panicked: {0}")]
    Broke(String),
}

/// The sensors of the settings. To be called within the runtime; programs end when `stop` says so.
pub fn sensors(settings: &Settings, stop: &CancellationToken) -> Vec<(Quantity, Box<dyn Sensor>)> {
    Quantity::ALL.into_iter().filter_map(|quantity| Some((quantity, sensor(quantity, settings, stop)?))).collect()
}

fn sensor(quantity: Quantity, settings: &Settings, stop: &CancellationToken) -> Option<Box<dyn Sensor>> {
    if quantity == Quantity::DiskFree {
        return Some(Box::new(DiskSensor { directory: PathBuf::from(&settings.record.directory) }));
    }
    let source: Box<dyn Sensor> = match quantity.source(settings) {
        SensorSource::None | SensorSource::Auto => return None,
        SensorSource::Simulated => Box::new(SimulatedSensor::new(quantity, settings)),
        SensorSource::Path { path, scale, offset } => {
            Box::new(FileSensor { path: PathBuf::from(path), scale: *scale, offset: *offset })
        }
        SensorSource::Command { program, arguments } => Box::new(CommandSensor {
            program: program.clone(),
            arguments: arguments.clone(),
            limit: Duration::from_secs_f64(settings.housekeeping.command_timeout_s),
            runtime: Handle::current(),
            stop: stop.clone(),
        }),
    };
    Some(Box::new(Plausible { quantity, source }))
}

/// A sensor whose values must be possible.
struct Plausible {
    quantity: Quantity,
    source: Box<dyn Sensor>,
}

impl Sensor for Plausible {
    fn read(&mut self, now: Tick) -> Result<f64, SensorError> {
        let value = self.source.read(now)?;
        let (unit, possible) = self.quantity.possible();
        if possible.contains(&value) { Ok(value) } else { Err(SensorError::Impossible { value, unit }) }
    }
}

/// The first number in a file.
struct FileSensor {
    path: PathBuf,
    scale: f64,
    offset: f64,
}

impl Sensor for FileSensor {
    fn read(&mut self, _: Tick) -> Result<f64, SensorError> {
        let bytes = read_file(&self.path, MOST_BYTES, "a file with a number")?;
        Ok(first_number(&bytes)? * self.scale + self.offset)
    }
}

/// The first number that a program prints.
struct CommandSensor {
    program: String,
    arguments: Vec<String>,
    limit: Duration,
    runtime: Handle,
    stop: CancellationToken,
}

impl Sensor for CommandSensor {
    fn read(&mut self, _: Tick) -> Result<f64, SensorError> {
        let said = self.runtime.block_on(async {
            let answer = tokio::time::timeout(self.limit, self.ask());
            match self.stop.run_until_cancelled(answer).await {
                None => Err("the service ends".to_owned()),
                Some(Err(_)) => Err(format!("did not end within {} s, and was killed", self.limit.as_secs_f64())),
                Some(Ok(Err(error))) => Err(error.to_string()),
                Some(Ok(Ok((status, said)))) => {
                    if status.success() {
                        Ok(said)
                    } else {
                        Err(status.to_string())
                    }
                }
            }
        });
        let program = || self.program.clone();
        first_number(&said.map_err(|problem| SensorError::Program { program: program(), problem })?)
    }
}

impl CommandSensor {
    /// How the program ended, and what it printed. Where this is given up, the program and all that it started is killed.
    async fn ask(&self) -> std::io::Result<(std::process::ExitStatus, Vec<u8>)> {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).process_group(0).kill_on_drop(true);
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn()?;
        let group = Group(child.id().and_then(|id| Pid::from_raw(id.cast_signed())));
        let mut said = Vec::new();
        if let Some(output) = child.stdout.take() {
            output.take(MOST_BYTES as u64).read_to_end(&mut said).await?;
        }
        let status = child.wait().await?;
        group.ended();
        Ok((status, said))
    }
}

/// A program and what it started: killed when dropped, unless it has ended.
struct Group(Option<Pid>);

impl Group {
    /// It has ended by itself, and its number may become another's.
    fn ended(mut self) {
        self.0 = None;
    }
}

impl Drop for Group {
    fn drop(&mut self) {
        if let Some(group) = self.0 {
            // It may be gone already.
            let _ = kill_process_group(group, Signal::KILL);
        }
    }
}

/// The free space of a directory's disk, for a program without privileges.
struct DiskSensor {
    directory: PathBuf,
}

impl Sensor for DiskSensor {
    fn read(&mut self, _: Tick) -> Result<f64, SensorError> {
        let free = free_bytes(&self.directory)
            .map_err(|error| SensorError::Disk { directory: self.directory.display().to_string(), problem: error.to_string() })?;
        Ok(free as f64 / GIB)
    }
}

/// A value that swings slowly within the middle half of its limits.
struct SimulatedSensor {
    middle: f64,
    swing: f64,
    phase: f64,
    random: ChaCha8Rng,
}

impl SimulatedSensor {
    fn new(quantity: Quantity, settings: &Settings) -> Self {
        let Rule { low, high, .. } = quantity.rule(settings);
        let mut random = ChaCha8Rng::seed_from_u64(settings.simulate.seed ^ quantity as u64);
        let phase = random.random_range(0.0..std::f64::consts::TAU);
        Self { middle: f64::midpoint(low, high), swing: (high - low) / 5.0, phase, random }
    }
}

impl Sensor for SimulatedSensor {
    fn read(&mut self, now: Tick) -> Result<f64, SensorError> {
        let angle = std::f64::consts::TAU * now.as_secs_f64() / SWING_S + self.phase;
        Ok(self.middle + self.swing * (angle.sin() + self.random.random_range(-0.01..0.01)))
    }
}

/// The first number in a text, which may stand in it as in `temp=45.3'C`.
fn first_number(bytes: &[u8]) -> Result<f64, SensorError> {
    let text = String::from_utf8_lossy(bytes);
    let mut words = text.split(|c: char| c.is_whitespace() || "=:,;()[]\"".contains(c));
    let number = words.find_map(|word| {
        let without_unit = word.trim_end_matches(|c: char| !c.is_ascii_digit() && c != '.');
        word.parse().or_else(|_| without_unit.parse::<f64>()).ok()
    });
    // One that says that it has no number is believed, whatever number comes behind it.
    number.filter(|number| number.is_finite()).ok_or_else(|| SensorError::NoNumber(text.trim().chars().take(REPEATED).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;
    use std::path::Path;
    use std::time::Instant;

    /// Settings with this source for the lens's temperature.
    fn settings(source: &str) -> Settings {
        let mut settings = Settings::flight().unwrap();
        settings.housekeeping.temperature_lens.source = SensorSource::parse(source).unwrap();
        settings.housekeeping.command_timeout_s = 0.5;
        settings
    }

    /// What a source gives, asked on the blocking pool.
    async fn read(source: &str) -> Result<f64, String> {
        let mut sensor = sensor(Quantity::TemperatureLens, &settings(source), &CancellationToken::new()).unwrap();
        let job = tokio::task::spawn_blocking(move || sensor.read(Duration::ZERO).map_err(|error| error.to_string()));
        job.await.unwrap()
    }

    /// A program with this body.
    fn program(directory: &Path, body: &str) -> String {
        let path = directory.join("program");
        std::fs::write(&path, format!("#!/bin/sh\n{body}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
        path.display().to_string()
    }

    #[test]
    fn a_number_is_found_in_what_files_and_programs_say_and_none_where_there_is_none() {
        let said = |text: &str| first_number(text.as_bytes()).ok();
        for (text, wanted) in [
            ("45312\n", 45312.0),
            ("-3.5e1", -35.0),
            ("temp=45.3'C", 45.3),
            ("lens: +21.5°C (high = 80)", 21.5),
            ("at 2013-01-01 it was 7", 7.0),
            ("t1 0x1F 12", 12.0),
        ] {
            assert_eq!(said(text), Some(wanted), "{text}");
        }
        for text in ["", " \n", "none", "nan", "NaN 3", "inf", "-infinity 5", "1e999", "\u{0}", "é", "-", "."] {
            assert_eq!(said(text), None, "{text}");
        }
        assert_eq!(first_number(&[0xFF, 0xFE]).unwrap_err().to_string(), "no number in \"\u{FFFD}\u{FFFD}\"");
    }

    #[tokio::test]
    async fn a_file_gives_its_number_scaled_or_says_what_is_wrong_with_it() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("temp");
        let source = format!("file:{} *0.001 -2", path.display());
        assert!(read(&source).await.unwrap_err().contains("temp: cannot be opened, expected a file with a number"));
        for (text, wanted) in
            [("45312", Ok(43.312)), ("-1000\n", Ok(-3.0)), ("NaN", Err("no number in \"NaN\"")), ("", Err("no number in \"\""))]
        {
            std::fs::write(&path, text).unwrap();
            assert_eq!(read(&source).await, wanted.map_err(str::to_owned), "{text}");
        }
        std::fs::write(&path, "45312").unwrap();
        let unscaled = read(&format!("file:{}", path.display())).await.unwrap_err();
        assert_eq!(unscaled, "45312 °C is not possible; is its scale right?");
        assert!(read(&format!("file:{}", directory.path().display())).await.unwrap_err().contains("is a directory"));
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_program_gives_its_first_number_if_it_ends_well() {
        let directory = tempfile::tempdir().unwrap();
        let there = directory.path();
        let say = |body: &str| format!("command:{}", program(there, body));
        assert_eq!(read(&(say("echo \"$2 is $1\"; echo 5") + " 12.5 x")).await, Ok(12.5));
        assert!(read(&say("echo 3; exit 4")).await.unwrap_err().ends_with("program: exit status: 4"));
        assert_eq!(read(&say("echo nothing")).await.unwrap_err(), "no number in \"nothing\"");
        assert!(read("command:/no/such/program").await.unwrap_err().starts_with("/no/such/program: No such file"));
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_program_that_hangs_is_killed_with_what_it_started() {
        let directory = tempfile::tempdir().unwrap();
        let mark = directory.path().join("pid");
        let hang = program(directory.path(), &format!("sleep 60 &\necho $! > {}\necho 3\nwait", mark.display()));
        #[allow(clippy::disallowed_methods, reason = "a real program takes real time")]
        let began = Instant::now();
        let said = read(&format!("command:{hang}")).await.unwrap_err();
        assert!(said.ends_with("did not end within 0.5 s, and was killed"), "{said}");
        assert!(began.elapsed() < Duration::from_secs(30));
        let started = std::fs::read_to_string(mark).unwrap().trim().to_owned();
        // Killed, it may wait a little for somebody to ask how it ended.
        let state = || std::fs::read_to_string(format!("/proc/{started}/stat")).unwrap_or_default();
        let is_gone = || state().split_whitespace().nth(2).is_none_or(|state| state == "Z" || state == "X");
        for _ in 0..500 {
            if is_gone() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        panic!("{} goes on", state());
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
    async fn a_program_is_killed_when_the_service_ends() {
        let directory = tempfile::tempdir().unwrap();
        let mut settings = settings(&format!("command:{}", program(directory.path(), "exec sleep 60")));
        settings.housekeeping.command_timeout_s = 60.0;
        let stop = CancellationToken::new();
        let mut sensor = sensor(Quantity::TemperatureLens, &settings, &stop).unwrap();
        let job = tokio::task::spawn_blocking(move || sensor.read(Duration::ZERO).map_err(|error| error.to_string()));
        tokio::time::sleep(Duration::from_millis(50)).await;
        stop.cancel();
        assert!(job.await.unwrap().unwrap_err().ends_with("the service ends"));
    }

    #[test]
    fn the_disk_of_a_directory_that_is_not_there_yet_is_that_of_the_one_above() {
        let directory = tempfile::tempdir().unwrap();
        let free = |path: &Path| DiskSensor { directory: path.to_owned() }.read(Duration::ZERO).unwrap();
        let (here, below) = (free(directory.path()), free(&directory.path().join("not/yet")));
        assert!(here > 0.0 && (here - below).abs() < 1.0, "{here} GiB, {below} GiB");
        assert!(free(Path::new("not yet")) > 0.0);
    }

    #[test]
    fn simulated_values_stay_within_their_limits_and_move() {
        let mut settings = Settings::flight().unwrap();
        settings.simulate.seed = 3;
        let stop = CancellationToken::new();
        let simulated = Quantity::ALL.into_iter().filter(|quantity| *quantity != Quantity::DiskFree);
        for quantity in simulated {
            let mut sensor = sensor(quantity, &settings, &stop).unwrap();
            let Rule { low, high, .. } = quantity.rule(&settings);
            let values: Vec<f64> = (0..200u64).map(|n| sensor.read(Duration::from_secs(n * 60)).unwrap()).collect();
            assert!(values.iter().all(|value| (low..=high).contains(value)), "{quantity:?}");
            let spread = values.iter().copied().fold(f64::MIN, f64::max) - values.iter().copied().fold(f64::MAX, f64::min);
            assert!(spread > 0.3 * (high - low), "{quantity:?}: {spread}");
        }
    }
}
