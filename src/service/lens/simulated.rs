//! The simulated lens controller on a pseudo-terminal, which is opened by its path as a real port is.
//!
//! When the port "vanishes" the terminal is closed, and later there is another one, with another path: [`SimulatedLens::ports`]
//! gives the present one.

use super::port::{Ports, Stream};
use crate::settings::LensSettings;
use crate::simulate::lens::{Controller, Fault, FaultKind, Received, parse_faults};
use std::fs::File;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::DuplexStream;
use tokio::sync::Notify;
use tokio::time::Instant;
use tokio_serial::{SerialPort, SerialStream};
use tokio_util::sync::CancellationToken;

/// Bytes that a line within this process holds.
const LINE_BYTES: usize = 4096;
/// Pause before it is looked again whether somebody opened the port.
const UNOPENED_PAUSE: Duration = Duration::from_millis(5);
/// Pause before another pseudo-terminal is asked for where there was none.
const NO_TERMINAL_PAUSE: Duration = Duration::from_secs(1);

/// A handle on the simulated lens: for the simulated sky, whose sharpness depends on it, and for whoever injects faults.
#[derive(Clone)]
pub struct SimulatedLens(Arc<Shared>);

struct Shared {
    controller: Mutex<Controller>,
    path: Mutex<Option<PathBuf>>,
    /// Its end of the line within this process that its port is, where that is no pseudo-terminal.
    line: Option<Mutex<Option<DuplexStream>>>,
    /// Something was injected, or somebody wants to speak to it.
    changed: Notify,
    began: Instant,
    baud: u32,
}

impl SimulatedLens {
    /// The lens of the settings, with their faults. It is there as soon as [`Self::run`] runs.
    ///
    /// # Errors
    /// What is wrong with `lens.simulated.faults`.
    pub fn new(settings: &LensSettings, seed: u64) -> Result<Self, String> {
        Self::made(settings, seed, None)
    }

    /// One whose port is a line within this process: on a paused clock, which does not wait for a terminal of the system.
    ///
    /// # Errors
    /// What is wrong with `lens.simulated.faults`.
    pub fn on_a_line(settings: &LensSettings, seed: u64) -> Result<Self, String> {
        Self::made(settings, seed, Some(Mutex::default()))
    }

    fn made(settings: &LensSettings, seed: u64, line: Option<Mutex<Option<DuplexStream>>>) -> Result<Self, String> {
        let mut controller = Controller::new(&settings.simulated, seed);
        for fault in parse_faults(&settings.simulated.faults)? {
            controller.inject(fault);
        }
        Ok(Self(Arc::new(Shared {
            controller: Mutex::new(controller),
            path: Mutex::new(None),
            line,
            changed: Notify::new(),
            began: Instant::now(),
            baud: settings.baud,
        })))
    }

    /// Where the optics truly are now, counts from the near stop. Any thread may ask.
    pub fn true_focus(&self) -> f64 {
        self.controller().true_focus(self.now())
    }

    /// Where the motor truly is now, counts from the near stop: what a right reading says.
    pub fn true_motor(&self) -> f64 {
        self.controller().true_motor(self.now())
    }

    /// Where the aperture truly is.
    pub fn true_aperture(&self) -> i32 {
        self.controller().true_aperture()
    }

    /// Begins a fault now, for this long.
    pub fn inject(&self, kind: FaultKind, lasts: Duration) {
        let from = self.now();
        self.controller().inject(Fault { kind, from, until: from + lasts });
        self.0.changed.notify_one();
    }

    /// The words that it received, oldest first.
    pub fn received(&self) -> Vec<Received> {
        self.controller().received().cloned().collect()
    }

    /// Its port, as long as it has one.
    pub fn path(&self) -> Option<PathBuf> {
        self.0.path.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Its port for the lens's actor.
    pub fn ports(&self) -> Ports {
        let lens = self.clone();
        if self.0.line.is_some() {
            return Ports::line(move || lens.connect());
        }
        Ports::new(self.0.baud, move || lens.path().into_iter().collect())
    }

    /// The other end of a new line to it, while its port is there.
    fn connect(&self) -> Option<DuplexStream> {
        let line = self.0.line.as_ref()?;
        let now = self.now();
        if !self.controller().has_port(now) {
            return None;
        }
        let (ours, theirs) = tokio::io::duplex(LINE_BYTES);
        *line.lock().unwrap_or_else(PoisonError::into_inner) = Some(ours);
        self.0.changed.notify_one();
        Some(theirs)
    }

    /// Is the controller until stopped.
    pub async fn run(self, stop: CancellationToken) {
        let _ = stop.run_until_cancelled(self.live()).await;
        self.set_path(None);
    }

    async fn live(&self) {
        loop {
            if let Some(line) = &self.0.line {
                let ours = line.lock().unwrap_or_else(PoisonError::into_inner).take();
                match ours {
                    Some(ours) => self.serve(Stream::Line(ours)).await,
                    None => {
                        self.step(&[]);
                        self.wait().await;
                    }
                }
                continue;
            }
            match self.terminal() {
                Ok((master, _held, path)) => {
                    self.set_path(Some(path));
                    self.serve(Stream::Serial(master)).await;
                    self.set_path(None);
                }
                Err(error) => {
                    tracing::error!(%error, "no pseudo-terminal for the simulated lens");
                    tokio::time::sleep(NO_TERMINAL_PAUSE).await;
                }
            }
            while !self.step(&[]).1 {
                self.wait().await;
            }
        }
    }

    /// Makes a pseudo-terminal, raw, so that it does not give back to us what we send. We hold the end that the lens's actor opens too,
    /// as a plain file that keeps nobody out: where nobody holds it, ours hangs up for good in the eyes of tokio, which then reads it
    /// over and over.
    fn terminal(&self) -> Result<(SerialStream, File, PathBuf), String> {
        let (master, mut end) = SerialStream::pair().map_err(|error| error.to_string())?;
        end.set_exclusive(false).map_err(|error| error.to_string())?;
        let path = PathBuf::from(end.name().ok_or("it has no name")?);
        // It must not become the terminal that this process takes its signals from.
        let flags = rustix::fs::OFlags::NOCTTY.bits() as i32;
        let held = File::options().read(true).write(true).custom_flags(flags).open(&path);
        let held = held.map_err(|error| error.to_string())?;
        Ok((master, held, path))
    }

    /// Is at the other end of the terminal until the port vanishes.
    async fn serve(&self, mut master: Stream) {
        loop {
            let mut bytes = [0; 256];
            let length = tokio::select! {
                read = master.read(&mut bytes) => match read {
                    Ok(0) => return,
                    Ok(length) => length,
                    // Nobody has it open.
                    Err(_) => {
                        let _ = tokio::time::timeout(UNOPENED_PAUSE, self.wait()).await;
                        0
                    }
                },
                () = self.wait() => 0,
            };
            let (out, has_port) = self.step(bytes.get(..length).unwrap_or_default());
            if !has_port {
                return;
            }
            if let Err(error) = if out.is_empty() { Ok(0) } else { master.try_write(&out) } {
                tracing::debug!(%error, "nobody reads what the simulated lens says");
            }
        }
    }

    /// The controller takes bytes and says what it has to; and whether its port is there.
    fn step(&self, bytes: &[u8]) -> (Vec<u8>, bool) {
        let now = self.now();
        let mut controller = self.controller();
        let out = controller.on(now, bytes);
        (out, controller.has_port(now))
    }

    /// Until the controller has something to do.
    async fn wait(&self) {
        let deadline = self.controller().deadline().map(|tick| self.0.began + tick);
        let _ = tokio::time::timeout_at(
            deadline.unwrap_or_else(|| Instant::now() + Duration::from_secs(3600)),
            self.0.changed.notified(),
        )
        .await;
    }

    fn set_path(&self, path: Option<PathBuf>) {
        *self.0.path.lock().unwrap_or_else(PoisonError::into_inner) = path;
    }

    fn controller(&self) -> MutexGuard<'_, Controller> {
        self.0.controller.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> Duration {
        self.0.began.elapsed()
    }
}
