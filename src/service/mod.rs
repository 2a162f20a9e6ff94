//! The service room: the actors, the channels between them, and nothing that decides.
//!
//! [`start`] wires it together. Each actor is one file with one `run` loop; what it decides, it asks of the rooms before this
//! one. The hub owns what is true now and publishes it as one immutable [`State`]; everybody else reads that.
//!
//! | channel | carries | holds | when it is full |
//! |---|---|---|---|
//! | camera → solver | a captured frame and its prior | 2 | the camera waits; the solver always takes: its newest frame waits, the one that it replaces ends as `skipped` |
//! | camera → hub | image numbers, unreadable images | 64, shared | the sender waits; the hub awaits nobody, so that this is short |
//! | solver → hub | outcomes, readiness | the same | as above |
//! | session → hub | connections, statuses, commands | the same | as above: this one peer is read later; its updates go on |
//! | lens → hub | what is known of it, answers | the same | as above |
//! | housekeeping → hub | what was measured last | the same | as above |
//! | hub → lens | requests | 32 | refused as busy; the lens always takes: beyond 16 that wait it refuses by itself |
//! | legacy session → hub | connections, blocks | the same | as for sessions |
//! | recorder, supervisor → hub | what was kept, lost, started again | the same | as above; the supervisor drops the count |
//! | hub → camera | requests for its gain | 4 | the command fails as `busy` |
//! | hub → ledger | counters of commands | 32 | the command fails as `not_kept` |
//! | ledger, programs → hub | what was kept, what came of it | 64, shared | the sender waits |
//! | hub → recorder | outcomes | 64 | counted as lost; the recorder always takes: beyond `record.queue_frames` the oldest is lost and counted |
//! | hub → everybody | [`State`] | the newest | replaced |
//! | session, legacy session → TCP | updates, answers | 32 KiB of the kernel | the session waits up to `network.silence_s`, skipping its ticks, then closes |
//!
//! No channel leads in a circle of waiting: the hub never waits for a send. [`Running::stop`] ends the edges first, then the
//! solver, the hub and the recorder, so that the last outcome still reaches the disk.

mod camera;
mod clock;
mod codec;
mod file;
mod flight_computer;
mod focus;
mod housekeeping;
mod hub;
mod inbox;
mod index;
mod keys;
mod ledger;
mod legacy;
mod lens;
mod listener;
mod orders;
mod parts;
mod recorder;
mod runs;
mod session;
mod solver;
mod state;
mod supervisor;
mod twin;
mod update;

pub use camera::MakeSource;
pub use clock::{Clock, utc_now};
pub use codec::{Codec, LinkError};
pub use file::{FileError, read_file};
pub use flight_computer::{STATUS_PERIOD, Seen, Sighting, fly};
pub use housekeeping::{Measurements, Quantity, Reading, SensorError, is_simulated, read_once};
pub use index::{IndexOrigin, Prepared, prepare};
pub use keys::Keys;
pub use lens::{Handle as LensHandle, LensAlone, SimulatedLens, ToLens};
pub use parts::{Parts, PartsError, Stars, load_bad_pixels, load_catalogue, simulated_lens, simulated_sky};
pub use runs::Run;
pub use session::Closed;
pub use solver::{MakeSolver, Solve};
pub use state::{Actor, CameraState, Counters, Ending, Finished, Peer, Readiness, Restart, Simulated, State};

use crate::command::{Guard, Memory, UNDER_WAY};
use crate::lens::Rules;
use crate::settings::Settings;
use crate::wire::{Hello, Role};
use camera::CameraActor;
use focus::Focus;
use housekeeping::Housekeeper;
use hub::Hub;
use ledger::{Ledger, LedgerActor};
use legacy::LegacyListener;
use lens::LensActor;
use listener::Listener;
use recorder::Recorder;
use runs::{Asked, Runs};
use session::{Shared, Strangers};
use solver::SolverActor;
use std::net::{IpAddr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64};
use std::time::Duration;
use supervisor::{Backoff, Ended, supervise};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tracing::{Instrument, Span};

/// Messages that may wait for the hub: some seconds of everything that can happen in the ordinary way.
const HUB_INBOX: usize = 64;
/// Frames that may wait for the solver's actor, which takes them at once.
const SOLVER_INBOX: usize = 2;
/// Requests that may wait for the camera's actor, which is with a frame for a second at most.
const CAMERA_INBOX: usize = 4;
/// Outcomes that may wait for the recorder's actor, which takes them at once.
const RECORDER_INBOX: usize = 64;
/// Requests that may wait for the lens's actor, which takes them at once.
const LENS_INBOX: usize = 32;
/// Time that each stage gets to end: four of them stay under 2 s.
const STAGE_ENDS_WITHIN: Duration = Duration::from_millis(450);
/// The camera's number in its hello.
const CAMERA_ID: u8 = 1;

/// Why the service did not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The address cannot be had.
    #[error("network.listen = \"{address}\": {error}")]
    Listen {
        /// The address of the settings.
        address: String,
        /// Why not.
        error: std::io::Error,
    },
    /// The address for the legacy dialect cannot be had.
    #[error("legacy.listen = \"{address}\": {error}")]
    LegacyListen {
        /// The address of the settings.
        address: String,
        /// Why not.
        error: std::io::Error,
    },
    /// A part cannot be had.
    #[error(transparent)]
    Parts(#[from] PartsError),
    /// The ledger of commands cannot be had.
    #[error("commands.ledger_directory = \"{directory}\": {error}")]
    Ledger {
        /// The directory of the settings.
        directory: String,
        /// Why not.
        error: std::io::Error,
    },
    /// A key cannot be had; in words, with the setting and the file.
    #[error("{0}")]
    Key(String),
    /// Not an address.
    #[error("network.peers: \"{0}\" is no IP address")]
    Peer(String),
}

/// Actors that end together.
#[derive(Default)]
struct Stage {
    stop: CancellationToken,
    tracker: TaskTracker,
}

impl Stage {
    /// Whether all of it ended in time.
    async fn end(&self) -> bool {
        self.stop.cancel();
        self.tracker.close();
        tokio::time::timeout(STAGE_ENDS_WITHIN, self.tracker.wait()).await.is_ok()
    }
}

/// The running service.
pub struct Running {
    /// The address that flight computers connect to.
    pub address: SocketAddr,
    /// The address that those which speak the legacy dialect connect to, where it is spoken.
    pub legacy_address: Option<SocketAddr>,
    /// What is true now.
    pub state: watch::Receiver<Arc<State>>,
    /// The service's clock.
    pub clock: Clock,
    /// Asks the lens for things.
    pub lens: LensHandle,
    /// The simulated lens, where it is one: says where it truly is, and takes faults.
    pub simulated_lens: Option<SimulatedLens>,
    listener: Listener,
    /// Where it is noted how this run ends; `None` where nothing is kept.
    runs: Option<Runs>,
    legacy: Option<LegacyListener>,
    /// In the order in which they are to end.
    stages: [(&'static str, Stage); 4],
}

impl Running {
    /// Serves a stream as if it had come from `address` through the socket: for simulated flight computers in this process.
    pub async fn serve<S: AsyncRead + AsyncWrite + Send + 'static>(&self, stream: S, address: SocketAddr) {
        self.listener.take(stream, address).await;
    }

    /// The same for the port of the legacy dialect; where that is not spoken the stream is dropped.
    pub async fn serve_legacy<S: AsyncRead + AsyncWrite + Send + 'static>(&self, stream: S, address: SocketAddr) {
        if let Some(legacy) = &self.legacy {
            legacy.take(stream, address).await;
        }
    }

    /// Ends the service within 2 s: no further frame, the current one aborted, the last outcome kept. Names what did not end
    /// in time, if anything.
    pub async fn stop(self) -> Vec<&'static str> {
        let noted = note_end(self.runs, if self.state.borrow().ending.is_some() { Asked::Commanded } else { Asked::Here });
        let ended = async {
            let mut late = Vec::new();
            for (name, stage) in &self.stages {
                if !stage.end().await {
                    late.push(*name);
                }
            }
            late
        };
        tokio::join!(ended, noted).0
    }
}

/// Notes how this run ends, beside all else, if the disk lets it in time.
async fn note_end(runs: Option<Runs>, asked: Asked) {
    let Some(runs) = runs else { return };
    let noted = tokio::task::spawn_blocking(move || runs.end(asked));
    match tokio::time::timeout(STAGE_ENDS_WITHIN, noted).await {
        Ok(Ok(Ok(()))) => {}
        Ok(Ok(Err(error))) => tracing::error!(%error, "the end of this run is not noted"),
        Ok(Err(_)) | Err(_) => tracing::error!("the end of this run is not noted in time"),
    }
}

/// Starts the service of the settings on its own address.
///
/// # Errors
/// See [`StartError`].
pub async fn start(settings: Arc<Settings>) -> Result<Running, StartError> {
    let address = settings.network.listen.clone();
    let listener = TcpListener::bind(&address).await.map_err(|error| StartError::Listen { address, error })?;
    let parts = Parts::of(&settings)?;
    start_with(settings, parts, listener)
}

/// Starts the service with the given camera, solver and lens on a bound socket. Where the settings have a simulated lens and the parts
/// none, there is one that nobody looks at.
///
/// # Errors
/// See [`StartError`].
pub fn start_with(settings: Arc<Settings>, parts: Parts, socket: TcpListener) -> Result<Running, StartError> {
    let lens = match parts.lens {
        Some(lens) => Some(lens),
        None => simulated_lens(&settings)?,
    };
    let address = socket.local_addr().map_err(|error| StartError::Listen { address: settings.network.listen.clone(), error })?;
    let allowed = addresses(&settings.network.peers)?;
    let legacy = legacy::bind(&settings.legacy)
        .map_err(|error| StartError::LegacyListen { address: settings.legacy.listen.clone(), error })?;
    let clock = Clock::start();
    let simulated = Simulated::of(&settings);
    let keys = Keys::read(&settings.commands).map_err(StartError::Key)?;
    let (ledger, memory) = open_ledger(&settings.commands.ledger_directory)?;
    let (runs, run) = begin_run(&settings.commands.ledger_directory)?;
    let at_start = State { counters_kept: ledger.is_some(), run, ..State::new(Arc::clone(&settings), Guard::new(memory)) };
    let (publish, state) = watch::channel(Arc::new(at_start));
    let [edges, solving, owning, keeping] = std::array::from_fn(|_| Stage::default());
    let (to_hub, hub_inbox) = inbox::channel(HUB_INBOX);
    let (abort_solver, abort) = watch::channel(0);
    let hub = hub::Handle::new(to_hub);
    let span = if simulated.any() { tracing::info_span!("simulated") } else { Span::none() };
    span.in_scope(|| {
        let Run { number, last_end } = run;
        let (camera, lens) = (settings.camera.kind, settings.lens.kind);
        tracing::info!(%address, ?camera, ?lens, run = number, ?last_end, "serving");
    });
    let watchman = Watchman { hub: hub.clone(), settings: Arc::clone(&settings), state: state.clone(), clock, span };

    let recorder = watchman.keep_recorder(&keeping);
    let ledger = ledger.map(|ledger| watchman.keep_ledger(&keeping, ledger));
    let to_lens = watchman.keep_lens(&edges, lens.as_ref());
    let to_solver = watchman.keep_solver(&solving, parts.solver, abort);
    let camera = parts.camera.map(|make| watchman.keep_camera(&edges, make, to_solver));
    watchman.keep_housekeeping(&edges);
    let owner = Hub {
        inbox: hub_inbox,
        state: Arc::new(publish),
        recorder,
        clock,
        ledger,
        camera,
        lens: to_lens.clone(),
        focus: Focus::new(&settings.focus),
        abort_solver,
        initial: Arc::clone(&settings),
        own: hub.clone(),
        stop: owning.stop.clone(),
    };
    watchman.keep(&owning, Actor::Hub, move || owner.clone().run());
    let shared = Arc::new(Shared {
        hello: our_hello(&settings, &clock),
        settings: Arc::clone(&settings),
        clock,
        state: state.clone(),
        hub,
        keys,
        strangers: Strangers::default(),
        stop: edges.stop.clone(),
    });
    let next = Arc::new(AtomicU64::new(1));
    let legacy = legacy.map(|socket| LegacyListener::new(socket, next.clone(), shared.clone(), edges.tracker.clone()));
    let places = Arc::new(Semaphore::new(settings.network.max_connections as usize));
    let tracker = edges.tracker.clone();
    let listener = Listener { socket: Arc::new(socket), allowed, places, next, shared, tracker };
    watchman.open_doors(&edges, &listener, legacy.as_ref());
    let stages = [("camera or connections", edges), ("solver", solving), ("hub", owning), ("recorder", keeping)];
    let legacy_address = legacy.as_ref().and_then(LegacyListener::address);
    Ok(Running { address, legacy_address, state, clock, lens: to_lens, simulated_lens: lens, listener, legacy, runs, stages })
}

/// The ledger of counters, and what it remembers; none where the settings name no directory.
fn open_ledger(directory: &str) -> Result<(Option<Ledger>, Memory), StartError> {
    if directory.is_empty() {
        return Ok((None, Memory::default()));
    }
    let opened = ledger::open(Path::new(directory));
    let (ledger, memory, complaints) = opened.map_err(|error| StartError::Ledger { directory: directory.to_owned(), error })?;
    complaints
        .iter()
        .for_each(|complaint| tracing::error!(complaint, "the ledger of commands is damaged; the other copy is used"));
    Ok((Some(ledger), memory))
}

/// The mark of this run, and which it is; none where the settings name no directory.
fn begin_run(directory: &str) -> Result<(Option<Runs>, Run), StartError> {
    if directory.is_empty() {
        return Ok((None, Run::default()));
    }
    let begun = Runs::begin(Path::new(directory));
    let (runs, run, complaints) = begun.map_err(|error| StartError::Ledger { directory: directory.to_owned(), error })?;
    complaints
        .iter()
        .for_each(|complaint| tracing::error!(complaint, "the mark of the last run is damaged, or this one's not kept"));
    Ok((Some(runs), run))
}

/// What the camera says of itself to whoever connects.
fn our_hello(settings: &Settings, clock: &Clock) -> Hello {
    // The lower half of the fingerprint tells settings apart well enough.
    let fingerprint = settings.fingerprint() as u32;
    Hello::new(Role::Camera, CAMERA_ID, &settings.camera.name, clock.boot_id(), Some(fingerprint))
}

/// Puts actors under the supervisor.
struct Watchman {
    hub: hub::Handle,
    settings: Arc<Settings>,
    state: watch::Receiver<Arc<State>>,
    clock: Clock,
    span: Span,
}

impl Watchman {
    /// Keeps an actor running until its stage ends; `start` makes it anew each time.
    fn keep<F, A>(&self, stage: &Stage, actor: Actor, start: F)
    where
        F: FnMut() -> A + Send + 'static,
        A: Future<Output = Result<(), Ended>> + Send + 'static,
    {
        let kept = supervise(actor, self.hub.clone(), Backoff::new(&self.settings.service), stage.stop.clone(), start);
        stage.tracker.spawn(kept.instrument(self.span.clone()));
    }

    /// Keeps the recorder running, where there is to be one.
    fn keep_recorder(&self, stage: &Stage) -> Option<recorder::Handle> {
        let record = &self.settings.record;
        if !record.enabled {
            return None;
        }
        let (to_recorder, inbox) = inbox::channel(RECORDER_INBOX);
        let actor = Recorder {
            inbox,
            hub: self.hub.clone(),
            file: Path::new(&record.directory).join(recorder::file_name(&self.clock)),
            queue: record.queue_frames as usize,
            backoff: Backoff::new(&self.settings.service),
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Recorder, move || actor.clone().run());
        Some(to_recorder)
    }

    /// Keeps the ledger running.
    fn keep_ledger(&self, stage: &Stage, ledger: Ledger) -> ledger::Handle {
        let (to_ledger, inbox) = inbox::channel(UNDER_WAY);
        let actor = LedgerActor { inbox, hub: self.hub.clone(), ledger, stop: stage.stop.clone() };
        self.keep(stage, Actor::Ledger, move || actor.clone().run());
        to_ledger
    }

    /// Keeps the lens running: the one of the settings, or a simulated one with its controller.
    fn keep_lens(&self, stage: &Stage, simulated: Option<&SimulatedLens>) -> LensHandle {
        let settings = &self.settings.lens;
        let (to_lens, inbox) = inbox::channel(LENS_INBOX);
        let actor = LensActor {
            inbox,
            hub: self.hub.clone(),
            ports: simulated.map(SimulatedLens::ports).or_else(|| lens::serial_ports(settings)),
            rules: Rules::of(settings),
            open: Arc::default(),
            clock: self.clock,
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Lens, move || actor.clone().run());
        if let Some(controller) = simulated {
            stage.tracker.spawn(controller.clone().run(stage.stop.clone()).instrument(self.span.clone()));
        }
        LensHandle::new(to_lens)
    }

    /// Keeps the solver running.
    fn keep_solver(&self, stage: &Stage, make: MakeSolver, abort: watch::Receiver<u32>) -> solver::Handle {
        let (to_solver, inbox) = inbox::channel(SOLVER_INBOX);
        let (hub, state, stop) = (self.hub.clone(), self.state.clone(), stage.stop.clone());
        let actor = SolverActor { inbox, hub, make, state, abort, stop };
        self.keep(stage, Actor::Solver, move || actor.clone().run());
        to_solver
    }

    /// Keeps the camera running.
    fn keep_camera(&self, stage: &Stage, make: MakeSource, solver: solver::Handle) -> camera::Handle {
        let (to_camera, inbox) = inbox::channel(CAMERA_INBOX);
        let actor = CameraActor {
            make,
            solver,
            hub: self.hub.clone(),
            inbox,
            numbers: Arc::new(AtomicU32::new(0)),
            state: self.state.clone(),
            settings: Arc::clone(&self.settings),
            clock: self.clock,
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Camera, move || actor.clone().run());
        to_camera
    }

    /// Keeps the housekeeping running.
    fn keep_housekeeping(&self, stage: &Stage) {
        let (settings, stop) = (Arc::clone(&self.settings), stage.stop.clone());
        let actor = Housekeeper {
            make: Arc::new(move || housekeeping::sensors(&settings, &stop)),
            period: Duration::from_secs_f64(self.settings.housekeeping.period_s),
            hub: self.hub.clone(),
            clock: self.clock,
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Housekeeping, move || actor.clone().run());
    }

    /// Lets flight computers in.
    fn open_doors(&self, stage: &Stage, listener: &Listener, legacy: Option<&LegacyListener>) {
        let door = listener.clone();
        self.keep(stage, Actor::Listener, move || door.clone().run());
        if let Some(door) = legacy.cloned() {
            self.keep(stage, Actor::LegacyListener, move || door.clone().run());
        }
    }
}

fn addresses(peers: &[String]) -> Result<Arc<[IpAddr]>, StartError> {
    peers.iter().map(|text| text.parse().map_err(|_| StartError::Peer(text.clone()))).collect()
}
