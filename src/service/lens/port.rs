//! The serial port: opened by its path, read line by line.
//!
//! A port whose reading ends has gone (a device unplugged, a pseudo-terminal closed). It is never flushed: that blocks until the
//! device has sent everything, which it may never do; the reply is the acknowledgement.

use crate::settings::{LensKind, LensSettings};
use futures_util::FutureExt;
use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
use tokio::task::JoinHandle;
use tokio_serial::{ClearBuffer, SerialPort, SerialPortBuilderExt, SerialStream};

/// Where a controller may be, in the order in which it is looked for there; asked anew for each search.
#[derive(Clone)]
pub struct Ports {
    candidates: Arc<dyn Fn() -> Vec<Place> + Send + Sync>,
    baud: u32,
}

/// One such place.
#[derive(Clone)]
pub(super) enum Place {
    /// A device of the system.
    Path(PathBuf),
    /// A line within this process, to a simulated controller; `None` while it does not answer.
    Line(Arc<dyn Fn() -> Option<DuplexStream> + Send + Sync>),
}

impl Place {
    fn name(&self) -> String {
        match self {
            Self::Path(path) => path.display().to_string(),
            Self::Line(_) => "within this process".to_owned(),
        }
    }
}

/// Opening takes no longer, or the device hangs.
const OPENS_WITHIN: Duration = Duration::from_secs(5);
/// Longest line, bytes: longer than any reply. What comes without an end is given on in pieces of this.
const LONGEST_LINE: usize = 256;
/// What `lens.port = "auto"` stands for: each of these names with the numbers 0 to 3.
const NAMES: [&str; 3] = ["/dev/ttyUSB", "/dev/ttyACM", "/dev/ttyS"];

/// The ports of the settings; `None` where they have no serial lens.
pub fn serial_ports(settings: &LensSettings) -> Option<Ports> {
    let port = settings.port.clone();
    (settings.kind == LensKind::Serial)
        .then(|| Ports::new(settings.baud, move || if port == "auto" { usual_ports() } else { vec![PathBuf::from(&port)] }))
}

/// Those of the usual names that are there.
fn usual_ports() -> Vec<PathBuf> {
    let all = NAMES.iter().flat_map(|name| (0..4).map(move |number| PathBuf::from(format!("{name}{number}"))));
    all.filter(|path| path.exists()).collect()
}

impl Ports {
    /// Ports of a list that is made anew for each search.
    pub fn new(baud: u32, candidates: impl Fn() -> Vec<PathBuf> + Send + Sync + 'static) -> Self {
        Self { candidates: Arc::new(move || candidates().into_iter().map(Place::Path).collect()), baud }
    }

    /// One line within this process.
    pub(super) fn line(connect: impl Fn() -> Option<DuplexStream> + Send + Sync + 'static) -> Self {
        let place = Place::Line(Arc::new(connect));
        Self { candidates: Arc::new(move || vec![place.clone()]), baud: 0 }
    }

    /// The port of this number.
    pub(super) fn nth(&self, nth: usize) -> Option<(Place, u32)> {
        (self.candidates)().into_iter().nth(nth).map(|place| (place, self.baud))
    }
}

/// Why a port was not opened.
pub(super) enum NotOpened {
    /// There is none of that number.
    NoMore,
    /// The system says why.
    Because(String),
}

/// The port that is being opened.
#[derive(Default)]
pub(super) struct Opening {
    wanted: Option<Option<(Place, u32)>>,
    /// By path: a device that hangs keeps its one thread, and is not asked again before that has come back.
    under_way: BTreeMap<PathBuf, JoinHandle<Result<Port, String>>>,
}

impl Opening {
    /// Begins to open a port, or to say that there is none.
    pub fn begin(&mut self, port: Option<(Place, u32)>) {
        self.wanted = Some(port);
    }

    /// The port when it is open, or why it is not. Waits for ever where none was asked for; may be dropped and called again.
    pub async fn done(&mut self) -> (String, Result<Port, NotOpened>) {
        let Some(wanted) = self.wanted.clone() else { return std::future::pending().await };
        let Some((place, baud)) = wanted else {
            self.wanted = None;
            return (String::new(), Err(NotOpened::NoMore));
        };
        let name = place.name();
        let path = match place {
            Place::Path(path) => path,
            Place::Line(connect) => {
                self.wanted = None;
                let silent = || NotOpened::Because("nobody is there".to_owned());
                return (name, connect().map(|line| Port::on(Stream::Line(line))).ok_or_else(silent));
            }
        };
        let target = path.clone();
        let task = self
            .under_way
            .entry(path.clone())
            .or_insert_with(|| tokio::task::spawn_blocking(move || Port::open(&target.to_string_lossy(), baud)));
        let opened = tokio::time::timeout(OPENS_WITHIN, task).await;
        self.wanted = None;
        let opened = match opened {
            Ok(opened) => {
                self.under_way.remove(&path);
                opened.unwrap_or_else(|error| Err(error.to_string())).map_err(NotOpened::Because)
            }
            Err(_) => Err(NotOpened::Because("it hangs".to_owned())),
        };
        (name, opened)
    }
}

/// What bytes go over.
pub(super) enum Stream {
    Serial(SerialStream),
    Line(DuplexStream),
}

impl Stream {
    /// What came, into a chunk. May be dropped and called again without losing anything.
    pub async fn read(&mut self, chunk: &mut [u8]) -> io::Result<usize> {
        match self {
            Self::Serial(stream) => stream.read(chunk).await,
            Self::Line(line) => line.read(chunk).await,
        }
    }

    /// Sends what goes out at once.
    pub fn try_write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Serial(stream) => stream.try_write(bytes),
            Self::Line(line) => line.write(bytes).now_or_never().unwrap_or_else(|| Err(io::ErrorKind::WouldBlock.into())),
        }
    }
}

/// An open port.
pub(super) struct Port {
    stream: Stream,
    buffer: Vec<u8>,
}

impl Port {
    /// Opens a port for us alone, and throws away what waits there; blocking.
    fn open(path: &str, baud: u32) -> Result<Self, String> {
        let stream = tokio_serial::new(path, baud).open_native_async().map_err(|error| error.to_string())?;
        stream.clear(ClearBuffer::All).map_err(|error| error.to_string())?;
        Ok(Self::on(Stream::Serial(stream)))
    }

    fn on(stream: Stream) -> Self {
        Self { stream, buffer: Vec::new() }
    }

    /// The next line, without its end; empty ones are left out. May be dropped and called again without losing anything.
    ///
    /// # Errors
    /// The port is gone, and how that showed.
    pub async fn line(&mut self) -> Result<Vec<u8>, String> {
        loop {
            if let Some(end) = self.buffer.iter().position(|byte| matches!(byte, b'\r' | b'\n')) {
                let rest = self.buffer.split_off(end + 1);
                let mut line = std::mem::replace(&mut self.buffer, rest);
                line.pop();
                if !line.is_empty() {
                    return Ok(line);
                }
                continue;
            }
            if self.buffer.len() >= LONGEST_LINE {
                return Ok(std::mem::take(&mut self.buffer));
            }
            let mut chunk = [0; LONGEST_LINE];
            match self.stream.read(&mut chunk).await {
                Ok(0) => return Err("its end".to_owned()),
                Ok(length) => self.buffer.extend(chunk.iter().take(length)),
                Err(error) => return Err(error.to_string()),
            }
        }
    }

    /// Throws away what came and was not read, and sends. A port that does not take a few bytes at once is gone.
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.buffer.clear();
        match self.stream.try_write(bytes) {
            Ok(sent) if sent == bytes.len() => Ok(()),
            Ok(_) => Err("it takes no more bytes".to_owned()),
            Err(error) => Err(error.to_string()),
        }
    }
}
