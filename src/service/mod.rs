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
//! | hub → ledger | what outlasts a restart | 32 | a command that waits for it fails as `not_kept`; all else is sent again |
//! | ledger, programs → hub | what was kept, what came of it | 64, shared | the sender waits |
//! | camera, hub → archive | frames, outcomes | 64 | the frame is counted as lost there, and solved all the same; without its outcome it is kept all the same; the archive always takes: beyond `record.queue_images` the oldest is lost and counted |
//! | hub, lens, solver → journal | what the machines were told | 1024 | counted as lost, which the journal says itself; it always takes: beyond 16,384 the oldest is lost and counted |
//! | hub → recorder | outcomes | 64 | counted as lost; the recorder always takes: beyond `record.queue_frames` the oldest is lost and counted |
//! | session → its server of images | the newest request | 1 | replaced; whoever asks again before an answer came has none to the first |
//! | server of images → session | answers: chunks, refusals | 1 | the server waits, while an update is due |
//! | hub → everybody | [`State`] | the newest | replaced |
//! | solver, hub → display | the newest frame, the newest [`State`] | the newest | replaced: a frame that was not shown is counted as passed over |
//! | display → browser | the newest state as text; frames where asked | 1, and what the kernel holds | replaced: a slow browser skips |
//! | session, legacy session → TCP | updates, chunks of images, answers | 32 KiB of the kernel | the session waits up to `network.silence_s`, skipping its ticks, then closes |
//!
//! No channel leads in a circle of waiting: the hub never waits for a send. [`Running::stop`] ends the edges first, then the
//! solver, the hub, and then recorder and archives, so that the last outcome and the last image still reach the disk.
//!
//! A computer that is too slow for all of this leaves the least of it undone, in a stated order, and never the updates: see [`Shed`].

mod archive;
mod aside;
mod auto;
mod camera;
mod clock;
mod codec;
mod display;
mod file;
mod flight_computer;
mod focus;
mod housekeeping;
mod hub;
mod images;
mod inbox;
mod index;
mod journal;
mod keeper;
mod kept;
mod keys;
mod ledger;
mod left_behind;
mod legacy;
mod lens;
mod listener;
mod manager;
mod motion;
mod orders;
mod parts;
mod pulse;
mod recorder;
mod replay;
mod replayer;
mod runs;
mod session;
mod solver;
mod state;
mod store;
mod strain;
mod supervisor;
mod told;
mod twin;
mod update;
mod visitors;
mod watchman;

pub use camera::MakeSource;
pub use clock::{Clock, SimulatedUtc, utc_now};
pub use codec::{Codec, LinkError};
pub use display::{Page, PageSocket};
pub use file::{FileError, free_bytes, read_file};
pub use flight_computer::{Inputs, STATUS_PERIOD, Seen, Sighting, fly};
pub use housekeeping::{Measurements, Quantity, Reading, SensorError, is_simulated, read_once};
pub use index::{IndexOrigin, Prepared, prepare};
pub use journal::files as journals;
pub use kept::Kept;
pub use keys::Keys;
pub use lens::{Handle as LensHandle, LensAlone, SimulatedLens, ToLens};
pub use manager::{Inherited, LinkName, Manager};
pub use parts::{Parts, PartsError, Stars, load_bad_pixels, load_catalogue, retouched, simulated_lens, simulated_sky};
pub use pulse::Upset;
pub use replay::{Again, Answers, Now, Replay, Tally, Wishes};
pub use replayer::{ReplayError, Replayer};
pub use runs::Run;
pub use session::Closed;
pub use solver::{MakeSolver, Solve};
pub use state::{
    Actor, CameraState, Counters, Disk, Ending, Finished, Found, ImageCounters, Peer, Readiness, Restart, Shed, Simulated, State,
    Triggers,
};
pub use strain::Strain;

use crate::command::{Desk, Guard, InCharge};
use crate::settings::Settings;
use crate::wire::{Hello, Role};
use focus::Focus;
use hub::Hub;
use images::Gallery;
use ledger::Ledger;
use legacy::LegacyListener;
use listener::Listener;
use pulse::Pulse;
use runs::{Asked, Runs};
use session::{Shared, Strangers};
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use visitors::Visitors;
use watchman::Watchman;

/// Messages that may wait for the hub: some seconds of everything that can happen in the ordinary way.
const HUB_INBOX: usize = 64;
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
    /// A key cannot be had; in words, with the setting and the file.
    #[error("{0}")]
    Key(String),
    /// Not an address.
    #[error("network.peers: \"{0}\" is no IP address")]
    Peer(String),
}

/// The pulse of every actor.
type Pulses = Arc<Mutex<Vec<(Actor, Pulse)>>>;

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
    pulses: Pulses,
    listener: Listener,
    replayer: Replayer,
    /// Where it is noted how this run ends; `None` where nothing is kept.
    runs: Option<Runs>,
    legacy: Option<LegacyListener>,
    /// The page for browsers.
    pub page: Page,
    /// In the order in which they are to end.
    stages: [(&'static str, Stage); 4],
}

/// A way into a running service: for simulated flight computers in this process.
#[derive(Clone)]
pub struct Door {
    listener: Listener,
    address: SocketAddr,
}

impl Door {
    /// The address that flight computers connect to.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Serves a stream as if it had come from an address through the socket.
    pub async fn enter<S: AsyncRead + AsyncWrite + Send + 'static>(&self, stream: S, from: SocketAddr) {
        self.listener.take(stream, from, None).await;
    }
}

impl Running {
    /// Runs the last frames again, for operators who ask what other settings would have given.
    pub fn replayer(&self) -> Replayer {
        self.replayer.clone()
    }

    /// A way in that outlasts this handle.
    pub fn door(&self) -> Door {
        Door { listener: self.listener.clone(), address: self.address }
    }

    /// Serves a stream as if it had come from `address` through the socket: for simulated flight computers in this process.
    pub async fn serve<S: AsyncRead + AsyncWrite + Send + 'static>(&self, stream: S, address: SocketAddr) {
        self.listener.take(stream, address, None).await;
    }

    /// The same for the port of the legacy dialect; where that is not spoken the stream is dropped.
    pub async fn serve_legacy<S: AsyncRead + AsyncWrite + Send + 'static>(&self, stream: S, address: SocketAddr) {
        if let Some(legacy) = &self.legacy {
            legacy.take(stream, address).await;
        }
    }

    /// An actor for which there is no hope in this process, if there is one: its loop has not come round for `limit`, or it hangs after
    /// each start.
    pub fn hopeless(&self, limit: Duration) -> Option<Actor> {
        let pulses = self.pulses.lock().unwrap_or_else(PoisonError::into_inner);
        pulses.iter().find(|(_, pulse)| pulse.is_hopeless(limit)).map(|(actor, _)| *actor)
    }

    /// Makes an actor fail, as it never does by itself: for whoever shows that the others do not notice. Only who holds this can.
    pub fn upset(&self, actor: Actor, how: Upset) {
        let pulses = self.pulses.lock().unwrap_or_else(PoisonError::into_inner);
        pulses.iter().filter(|(of, _)| *of == actor).for_each(|(_, pulse)| pulse.upset(how));
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

/// Where flight computers come in.
pub struct Doors {
    /// The socket that they connect to.
    pub door: TcpListener,
    /// That for the legacy dialect, where an earlier run left it open.
    pub legacy_door: Option<std::net::TcpListener>,
    /// Connections that an earlier run left open.
    pub links: Vec<(LinkName, std::net::TcpStream)>,
    /// Keeps all of them open when this run breaks off.
    pub manager: Manager,
    /// A UTC that is made up, where it is.
    pub utc: Option<&'static SimulatedUtc>,
    /// Where browsers connect; by default nowhere.
    pub page: PageSocket,
}

impl From<TcpListener> for Doors {
    fn from(door: TcpListener) -> Self {
        Self { door, legacy_door: None, links: Vec::new(), manager: Manager::default(), utc: None, page: PageSocket::default() }
    }
}

impl Doors {
    /// On the address of the settings: the socket of an earlier run, or a new one.
    async fn of(settings: &Settings, inherited: Inherited, manager: Manager) -> Result<Self, StartError> {
        let address = settings.network.listen.clone();
        let door = match manager::fitting(inherited.door, &address) {
            Some(door) => TcpListener::from_std(door),
            None => TcpListener::bind(&address).await,
        };
        let door = door.map_err(|error| StartError::Listen { address, error })?;
        let legacy_door = manager::fitting(inherited.legacy_door, &settings.legacy.listen);
        let page = PageSocket::open(&settings.display.listen);
        Ok(Self { door, legacy_door, links: inherited.links, manager, utc: None, page })
    }
}

/// Starts the service of the settings on its own address, with what an earlier run left open.
///
/// # Errors
/// See [`StartError`].
pub async fn start(settings: Arc<Settings>, inherited: Inherited, manager: Manager) -> Result<Running, StartError> {
    let doors = Doors::of(&settings, inherited, manager).await?;
    let parts = Parts::of(&settings)?;
    start_with(settings, parts, doors)
}

/// Starts the service with the given camera, solver and lens on bound sockets. Where the settings have a simulated lens and the parts
/// none, there is one that nobody looks at.
///
/// # Errors
/// See [`StartError`].
pub fn start_with(settings: Arc<Settings>, parts: Parts, doors: impl Into<Doors>) -> Result<Running, StartError> {
    let Doors { door: socket, legacy_door, links, manager, utc, page } = doors.into();
    let lens = parts.lens.map_or_else(|| simulated_lens(&settings), |lens| Ok(Some(lens)))?;
    let address = socket.local_addr().map_err(|error| StartError::Listen { address: settings.network.listen.clone(), error })?;
    let allowed = addresses(&settings.network.peers)?;
    let legacy = legacy::bind(&settings.legacy, legacy_door)
        .map_err(|error| StartError::LegacyListen { address: settings.legacy.listen.clone(), error })?;
    let clock = Clock::of(&settings.clock, utc);
    let keys = Keys::read(&settings.commands).map_err(StartError::Key)?;
    let (ledger, kept, found) = open_ledger(&settings.commands.ledger_directory);
    let (runs, run) = begin_run(&settings.commands.ledger_directory);
    let at_start = State { counters_kept: ledger.is_some(), run, found, ..resumed(&settings, &kept) };
    let (publish, state) = watch::channel(Arc::new(at_start));
    let [edges, solving, owning, keeping] = std::array::from_fn(|_| Stage::default());
    let ((to_hub, hub_inbox), (abort_solver, abort)) = (inbox::channel(HUB_INBOX), watch::channel(0));
    let hub = hub::Handle::new(to_hub);
    let watchman = Watchman::new(hub.clone(), &settings, state.clone(), clock).keep_journal(&keeping, &kept);
    watchman.span.in_scope(|| announce(address, &settings, run, &kept));

    let recorder = watchman.keep_recorder(&keeping);
    let ledger = ledger.map(|ledger| watchman.keep_ledger(&keeping, ledger));
    let to_lens = watchman.keep_lens(&edges, lens.as_ref());
    let replayer = Replayer::new(watchman.journal.clone(), Arc::clone(&parts.solver), state.clone());
    let (page, shown) = watchman.keep_display(&edges, page, replayer.clone());
    let to_solver = watchman.keep_solver(&solving, parts.solver, abort, shown);
    let archives = watchman.keep_archives(&keeping);
    let camera = parts.camera.map(|make| watchman.keep_camera(&edges, make, to_solver, archives.clone()));
    watchman.keep_housekeeping(&edges);
    let owner = Hub {
        inbox: hub_inbox,
        state: Arc::new(publish),
        recorder,
        archives: archives.into_iter().map(|(_, archive)| archive).collect(),
        clock,
        journal: watchman.journal.clone(),
        ledger,
        camera,
        lens: to_lens.clone(),
        focus: Focus::new(&settings.focus, &kept.learned),
        abort_solver,
        initial: Arc::clone(&settings),
        own: hub.clone(),
        stop: owning.stop.clone(),
    };
    watchman.keep(&owning, Actor::Hub, move |pulse| owner.clone().run(pulse));
    manager.keep_doors(&socket, legacy.as_ref());
    let shared = Arc::new(Shared {
        manager,
        hello: our_hello(&settings, &clock),
        settings: Arc::clone(&settings),
        clock,
        state: state.clone(),
        hub,
        gallery: Arc::new(Gallery::new(Arc::clone(&settings))),
        keys,
        strangers: Strangers::default(),
        visitors: Visitors::new(settings.network.connections_per_s),
        stop: edges.stop.clone(),
    });
    let seats = Seats { socket, allowed, legacy, tracker: edges.tracker.clone() };
    let (listener, legacy) = seats.take(shared, links);
    watchman.open_doors(&edges, &listener, legacy.as_ref());
    let stages = [("camera or connections", edges), ("solver", solving), ("hub", owning), ("recorder or archive", keeping)];
    let legacy_address = legacy.as_ref().and_then(LegacyListener::address);
    Ok(Running {
        address,
        legacy_address,
        state,
        clock,
        lens: to_lens,
        simulated_lens: lens,
        pulses: watchman.pulses,
        listener,
        replayer,
        legacy,
        page,
        runs,
        stages,
    })
}

/// What flight computers are let in with.
struct Seats {
    socket: TcpListener,
    allowed: Arc<[IpAddr]>,
    legacy: Option<TcpListener>,
    tracker: TaskTracker,
}

impl Seats {
    /// The listeners; connections that an earlier run left open go on.
    fn take(self, shared: Arc<Shared>, links: Vec<(LinkName, std::net::TcpStream)>) -> (Listener, Option<LegacyListener>) {
        let Self { socket, allowed, legacy, tracker } = self;
        let last = links.iter().map(|(link, _)| link.connection).max().unwrap_or_default();
        let next = Arc::new(AtomicU64::new(last.saturating_add(1)));
        let legacy = legacy.map(|socket| LegacyListener::new(socket, next.clone(), shared.clone(), tracker.clone()));
        let places = Arc::new(Semaphore::new(shared.settings.network.max_connections as usize));
        let listener = Listener { socket: Arc::new(socket), allowed, places, next, shared, tracker };
        links.into_iter().for_each(|(link, stream)| listener.resume(link, stream));
        (listener, legacy)
    }
}

/// A line of the log for the start.
fn announce(address: SocketAddr, settings: &Settings, run: Run, kept: &Kept) {
    let Run { number, last_end } = run;
    let commanded = kept.commanded.join("; ");
    let (camera, lens) = (settings.camera.kind, settings.lens.kind);
    tracing::info!(%address, ?camera, ?lens, run = number, ?last_end, commanded, "serving");
}

/// The calibration in force, in the directory of what outlasts a restart; the one before it, and the log of both.
pub const CALIBRATION: &str = "calibration.toml";
/// See [`CALIBRATION`].
pub const CALIBRATION_BEFORE: &str = "calibration.before.toml";
/// See [`CALIBRATION`].
pub const CALIBRATION_LOG: &str = "calibration.log";

/// The files of a directory that outlast a restart, whether they are there or not; what else lies beside them is not ours.
pub fn state_files(directory: &Path) -> Vec<PathBuf> {
    let twins = [ledger::NAME, runs::NAME].into_iter().flat_map(|name| twin::files(directory, name));
    let calibration = [CALIBRATION, CALIBRATION_BEFORE, CALIBRATION_LOG].map(|name| directory.join(name));
    twins.chain(calibration).collect()
}

/// The ledger, what it kept, and in what state that was found; none where the settings name no directory.
fn open_ledger(directory: &str) -> (Option<Ledger>, Kept, Found) {
    if directory.is_empty() {
        return (None, Kept::default(), Found::Nothing);
    }
    let (ledger, kept, complaints) = ledger::open(Path::new(directory));
    let found = match (&kept, complaints.is_empty()) {
        (Some(_), true) => Found::Whole,
        (Some(_), false) => Found::OneCopy,
        (None, true) => Found::Nothing,
        (None, false) => Found::Damaged,
    };
    complaints.iter().for_each(|complaint| tracing::error!(complaint, ?found, "a copy of what was kept is damaged"));
    (Some(ledger), kept.unwrap_or_default(), found)
}

/// The state of the start, with what earlier runs left.
fn resumed(initial: &Arc<Settings>, kept: &Kept) -> State {
    let (settings, commanded, complaints) = kept.settings(initial);
    complaints.iter().for_each(|complaint| tracing::error!(complaint, "a setting that was commanded is not taken again"));
    let mut state = State::new(Arc::clone(initial), Guard::new(kept.counters.clone()));
    state.adopt(settings, initial);
    State {
        commanded,
        charge: InCharge::after(kept.epoch),
        desk: Desk::after(kept.answers.clone()),
        focus_kept: kept.focus,
        ..state
    }
}

/// The mark of this run, and which it is; none where the settings name no directory.
fn begin_run(directory: &str) -> (Option<Runs>, Run) {
    if directory.is_empty() {
        return (None, Run::default());
    }
    let (runs, run, complaints) = Runs::begin(Path::new(directory));
    complaints
        .iter()
        .for_each(|complaint| tracing::error!(complaint, "the mark of the last run is damaged, or this one's not kept"));
    (Some(runs), run)
}

/// What the camera says of itself to whoever connects.
fn our_hello(settings: &Settings, clock: &Clock) -> Hello {
    // The lower half of the fingerprint tells settings apart well enough.
    let fingerprint = settings.fingerprint() as u32;
    Hello::new(Role::Camera, CAMERA_ID, &settings.camera.name, clock.boot_id(), Some(fingerprint))
}

fn addresses(peers: &[String]) -> Result<Arc<[IpAddr]>, StartError> {
    peers.iter().map(|text| text.parse().map_err(|_| StartError::Peer(text.clone()))).collect()
}
