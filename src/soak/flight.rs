//! A flight: the service, its computers and the schedule, from beginning to end.

use super::account::{Account, Book, POISON_COUNTS, SENSOR_C};
use super::computer::{Computer, Connect, Handle, Line};
use super::gyros::Turned;
use super::images;
use super::instrument::{Charger, Faults, Outside, camera, solver};
use super::page;
use super::report::Report;
use super::resources::Held;
use super::schedule::{Class, schedule};
use crate::camera::Gondola;
use crate::command::{Act, Command, Tick};
use crate::service::{Door, Doors, Parts, Running, SimulatedLens, SimulatedUtc, Stars, StartError, start_with};
use crate::settings::{CameraKind, LensKind, SensorSource, Settings};
use crate::simulate::lens::Received;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::watch;
use tokio::task::{JoinHandle, JoinSet};
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until};

/// What is to be flown.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Names the flight: the same seed flies the same.
    pub seed: u64,
    /// How long.
    pub duration: Duration,
    /// Mean time between faults.
    pub every: Duration,
    /// Whether time is real; otherwise the clock of the runtime must be paused.
    pub real: bool,
    /// Where records and what outlasts a restart are kept. Where that is a small disk of its own it is filled now and then.
    pub directory: PathBuf,
    /// Whether UTC is the machine's, which others may set; otherwise it is made up, and jumps.
    pub machine_clock: bool,
}

impl Plan {
    /// What can go wrong in it.
    fn classes(&self) -> Vec<Class> {
        let can_be = |class: &Class| match class {
            Class::DiskFull => is_small(&self.directory),
            Class::UtcJumps => !self.machine_clock,
            _ => true,
        };
        Class::ALL.into_iter().filter(can_be).collect()
    }
}

/// Bytes of a GiB, and what images may take of a disk that is not small, bytes.
const GIB: f64 = (1_u64 << 30) as f64;
const IMAGES_BYTES: f64 = 2e9;
/// What images leave free, bytes: enough for the log of a flight.
const RESERVE_BYTES: f64 = 8e6;
/// What journals may take of a disk that is small, bytes.
const SMALL_JOURNAL_BYTES: f64 = 32e6;
/// A disk of up to this size may be filled, bytes.
const SMALL_DISK: u64 = 256 << 20;
/// The file that fills it.
pub(super) const BALLAST: &str = "ballast";

/// Whether a directory's disk is one that may be filled.
fn is_small(directory: &Path) -> bool {
    rustix::fs::statvfs(directory).is_ok_and(|disk| disk.f_blocks.saturating_mul(disk.f_frsize) <= SMALL_DISK)
}

/// How far a flight has come.
#[derive(Debug, Clone)]
pub struct Progress {
    /// Time flown.
    pub flown: Duration,
    /// Time that it took.
    pub taken: Duration,
    /// What was counted by now.
    pub book: Book,
    /// What the process holds of the machine.
    pub held: Option<Held>,
}

/// Time between looks at what the process holds, on a clock that jumps and in real time.
const LOOKS: (Duration, Duration) = (Duration::from_secs(3600), Duration::from_secs(10));
/// The computer that is not well for so long is not in charge any more.
const WATCHDOG: Duration = Duration::from_secs(2);
/// How often the computers look at each other.
const LOOK: Duration = Duration::from_millis(250);
/// Shortest and longest time between commands of the ground, s.
const GROUND_S: (u64, u64) = (20, 90);
/// Values of honest commands: timeouts from here on, ms, each a little more than the last, and positions about the best focus, counts.
const FIRST_TIMEOUT_MS: u32 = 5_000;
const FOCUS: (i32, i32) = (2985, 3015);
/// So long without a solution, or without knowledge of the focus, the ground waits before it sees to the lens.
const PATIENCE: Duration = Duration::from_secs(1800);
/// The file that one sensor reads: the temperature of the lens.
pub(super) const SENSOR: &str = "sensor";
/// Best focus, and where the lens is at the start, counts.
const BEST_COUNTS: i32 = 3000;
/// After a fault of the instrument its commands may take this long.
pub(super) const DISTURBED_AFTER: Duration = Duration::from_secs(60);
/// A clock of 2026-12-20.
pub(super) const UNIX_S: f64 = 1_797_724_800.0;
/// Time between frames, s: the flight's own, and one that is quicker where time is real.
const PERIOD_S: f64 = 40.0;
const REAL_PERIOD_S: f64 = 5.0;
/// Time between readings of the sensors, s: each takes a thread, and a flight has two million.
const SENSORS_S: f64 = 5.0;
/// One run of the service in so many has quick frames, from the one of this number on; and the time between them, s.
const QUICK_RUN: (usize, usize) = (128, 5);
const QUICK_PERIOD_S: f64 = 1.0;
/// By then a disk that is back has what waited for it: longer than the longest pause of the recorder.
const DISK_BACK: Duration = Duration::from_secs(15);
/// Bytes that a line within the process holds.
const LINE_BYTES: usize = 64 * 1024;

/// What the soak is made of.
pub(super) struct Soak {
    pub(super) plan: Plan,
    /// When the flight, and its UTC, began.
    pub(super) began: Instant,
    pub(super) settings: Arc<Settings>,
    stars: Stars,
    pub(super) lens: SimulatedLens,
    pub(super) faults: Faults,
    charger: Charger,
    pub(super) account: Account,
    /// `None`: the machine's.
    pub(super) utc: Option<&'static SimulatedUtc>,
    pub(super) handles: [Handle; 2],
    /// What the gondola's gyros saw of the last series.
    gyros: watch::Sender<Option<Turned>>,
    /// How the service is entered, while it runs.
    door: Arc<Mutex<Option<Door>>>,
    /// Its page, while it runs.
    page: page::Door,
}

/// Flies the plan by these settings; `show` is told how far it is now and then.
///
/// # Errors
/// Where the service cannot be started, and that no fault explains.
pub async fn fly(plan: Plan, settings: &Settings, mut show: impl FnMut(&Progress)) -> Result<Report, StartError> {
    let settings = Arc::new(adapted(settings, &plan));
    let lens = if plan.real {
        SimulatedLens::new(&settings.lens, plan.seed)
    } else {
        SimulatedLens::on_a_line(&settings.lens, plan.seed)
    };
    let lens = lens.map_err(|why| StartError::Parts(crate::service::PartsError::Faults(why)))?;
    let soak = Soak {
        stars: Stars::of(&settings),
        lens,
        faults: Faults::default(),
        charger: if plan.real { Charger::of_real_time() } else { Charger::of_paused_clock() },
        account: Account::default(),
        began: Instant::now(),
        utc: (!plan.machine_clock).then(|| SimulatedUtc::begin(UNIX_S)),
        handles: [Handle::new(), Handle::new()],
        gyros: watch::Sender::new(None),
        door: Arc::default(),
        page: page::Door::default(),
        settings,
        plan,
    };
    let (began, began_really) = (soak.began, real_time());
    show_sensor(&soak.plan.directory.join(SENSOR)).await;
    let mut tasks = JoinSet::new();
    let mut running = soak.start().await?;
    soak.computers().into_iter().for_each(|computer| drop(tasks.spawn(computer.fly())));
    tasks.spawn(watch_each_other(soak.handles.clone()));
    tasks.spawn(page::look(soak.page.clone(), soak.account.clone()));
    tasks.spawn(ground(soak.handles.clone(), soak.account.clone(), soak.plan.seed));
    let classes = soak.plan.classes();
    let mut faults = schedule(soak.plan.seed, soak.plan.duration, soak.plan.every, &classes).into_iter().peekable();
    let mut counts: BTreeMap<Class, u32> = classes.iter().map(|class| (*class, 0)).collect();
    let mut words = Tick::ZERO;
    let mut samples: Vec<Held> = Vec::new();
    let mut progress = interval(if soak.plan.real { LOOKS.1 } else { LOOKS.0 });
    progress.set_missed_tick_behavior(MissedTickBehavior::Skip);
    let mut watcher = soak.watch(&running);
    loop {
        let next = faults.peek().map_or(soak.plan.duration, |fault| fault.at);
        tokio::select! {
            biased;
            () = sleep_until(began + next) => match faults.next() {
                None => break,
                Some(fault) => {
                    *counts.entry(fault.class).or_default() += 1;
                    if fault.class == Class::ServiceRestarts {
                        soak.end(running, watcher, &mut words).await;
                        sleep(Duration::from_millis(100)).await;
                        running = soak.start().await?;
                        watcher = soak.watch(&running);
                    } else {
                        soak.begin(&fault, &running, &mut tasks);
                    }
                }
            },
            _ = progress.tick() => {
                soak.look_at_the_lens(&mut words);
                // Those that have ended hold their memory until they are asked for it.
                while tasks.try_join_next().is_some() {}
                let (flown, taken) = (began.elapsed(), real_time().saturating_sub(began_really));
                let held = Held::now(flown);
                samples.extend(held);
                show(&Progress { flown, taken, book: soak.account.so_far(), held });
            }
        }
    }
    // What is under way comes to its end before the books are closed.
    sleep(Duration::from_secs(20)).await;
    // A disk that is dead or full comes back by its own task.
    soak.end(running, watcher, &mut words).await;
    tasks.abort_all();
    Ok(Report::new(&soak.plan, began.elapsed(), &soak.account.so_far(), &counts, &samples))
}

/// Time on a clock of the machine that never jumps, whatever the runtime's clock does.
fn real_time() -> Duration {
    let time = clock_gettime(ClockId::Monotonic);
    Duration::new(time.tv_sec.unsigned_abs(), u32::try_from(time.tv_nsec).unwrap_or_default())
}

/// The settings of a soak: everything simulated, on loopback, kept in its directory.
fn adapted(settings: &Settings, plan: &Plan) -> Settings {
    let within = |name: &str| plan.directory.join(name).display().to_string();
    let mut settings = settings.clone();
    settings.camera.kind = CameraKind::Sky;
    settings.camera.startup_delay_s = 0.0;
    settings.camera.period_s = if plan.real { REAL_PERIOD_S } else { PERIOD_S };
    settings.housekeeping.period_s = SENSORS_S;
    settings.housekeeping.temperature_lens.source = SensorSource::Path { path: within(SENSOR), scale: 1.0, offset: 0.0 };
    settings.lens.kind = LensKind::Simulated;
    settings.lens.simulated.start_counts = BEST_COUNTS;
    settings.simulate.best_focus_counts = BEST_COUNTS;
    settings.simulate.seed = plan.seed;
    settings.network.listen = "127.0.0.1:0".to_owned();
    // A page is open all the time: ten states a second for eleven days would be more than all else.
    settings.display.rate_hz = 1.0;
    settings.record.directory = within("record");
    // Room for what else is kept, and for what fills a small disk now and then.
    settings.record.images_limit_gib = if is_small(&plan.directory) { 0.75 * SMALL_DISK as f64 } else { IMAGES_BYTES } / GIB;
    settings.record.reserve_gib = RESERVE_BYTES / GIB;
    settings.record.journal_limit_gib = if is_small(&plan.directory) { SMALL_JOURNAL_BYTES } else { IMAGES_BYTES } / GIB;
    settings.commands.ledger_directory = within("state");
    settings
}

impl Soak {
    async fn start(&self) -> Result<Running, StartError> {
        let mut settings = Settings::clone(&self.settings);
        if self.account.runs() % QUICK_RUN.0 == QUICK_RUN.1 {
            settings.camera.period_s = QUICK_PERIOD_S;
        }
        let settings = Arc::new(settings);
        let parts = Parts::with_stars(&settings, &self.stars)?;
        let outside = Outside {
            flown: self.began.elapsed(),
            lens: self.lens.clone(),
            gyros: self.gyros.clone(),
            faults: self.faults.clone(),
            charger: self.charger.clone(),
            account: self.account.clone(),
        };
        let parts = Parts {
            camera: Some(camera(&self.settings, &self.stars, outside)),
            solver: solver(parts.solver, &self.faults, &self.charger),
            lens: Some(self.lens.clone()),
        };
        let address = self.settings.network.listen.clone();
        let socket = TcpListener::bind(&address).await.map_err(|error| StartError::Listen { address, error })?;
        let doors = Doors { utc: self.utc, ..Doors::from(socket) };
        self.account.begin_run();
        let running = start_with(settings, parts, doors)?;
        self.account.begun_run(running.clock.boot_id(), running.state.borrow().settings.solver.timeout_s);
        *self.door.lock().unwrap_or_else(PoisonError::into_inner) = Some(running.door());
        *self.page.lock().unwrap_or_else(PoisonError::into_inner) = Some(running.page.clone());
        Ok(running)
    }

    /// Watches every state of a run for what takes effect, whatever else is going on.
    fn watch(&self, running: &Running) -> JoinHandle<()> {
        let (mut state, account) = (running.state.clone(), self.account.clone());
        tokio::spawn(async move {
            while state.changed().await.is_ok() {
                let now = Arc::clone(&state.borrow_and_update());
                account.state(&now);
            }
        })
    }

    async fn end(&self, running: Running, watcher: JoinHandle<()>, words: &mut Tick) {
        // What waits for a dead disk would be lost with the run: whoever ends it waits until the disk has it.
        let is_dead = || Path::new(&self.settings.record.directory).is_file() || self.plan.directory.join(BALLAST).exists();
        if is_dead() {
            while is_dead() {
                sleep(Duration::from_secs(1)).await;
            }
            sleep(DISK_BACK).await;
        }
        self.look_at_the_lens(words);
        *self.door.lock().unwrap_or_else(PoisonError::into_inner) = None;
        *self.page.lock().unwrap_or_else(PoisonError::into_inner) = None;
        self.handles.iter().for_each(|handle| handle.disturb(Instant::now() + DISTURBED_AFTER));
        let (state, boot) = (running.state.clone(), running.clock.boot_id());
        let late = running.stop().await;
        // It has seen the last state by now, or will see no other.
        sleep(Duration::from_millis(10)).await;
        watcher.abort();
        let directories = self.settings.record.image_directories();
        let on_disk = directories.first().map(|(_, directory)| images::of_run(directory, boot)).unwrap_or_default();
        self.account.end_run(boot, &state.borrow(), &on_disk, late);
    }

    /// Whether the lens was sent where no honest command sends it.
    fn look_at_the_lens(&self, seen: &mut Tick) {
        let before = *seen;
        for Received { at, word } in self.lens.received().into_iter().filter(|received| received.at > before) {
            let to = word.strip_prefix("fa").and_then(|counts| counts.trim().parse::<i32>().ok());
            if to.is_some_and(|counts| POISON_COUNTS.contains(&counts)) {
                self.account.lens_moved(&word);
            }
            *seen = at;
        }
    }

    fn computers(&self) -> Vec<Computer> {
        let gondola = Gondola::new(&self.settings.simulate);
        let computer = |(place, handle): (usize, &Handle)| Computer {
            place,
            handle: handle.clone(),
            account: self.account.clone(),
            connect: self.connect(place),
            utc: self.utc,
            gondola,
            flight_began: self.began,
            gyros: self.gyros.subscribe(),
            seed: self.plan.seed.wrapping_mul(2).wrapping_add(place as u64),
        };
        self.handles.iter().enumerate().map(computer).collect()
    }

    /// How a computer connects: over TCP where time is real, otherwise over a line within the process.
    pub(super) fn connect(&self, place: usize) -> Connect {
        let (door, real) = (Arc::clone(&self.door), self.plan.real);
        Arc::new(move || {
            let door = door.lock().unwrap_or_else(PoisonError::into_inner).clone();
            Box::pin(async move {
                let door = door?;
                if real {
                    let stream = TcpStream::connect(door.address()).await.ok()?;
                    stream.set_nodelay(true).ok()?;
                    return Some(Box::new(stream) as Box<dyn Line>);
                }
                let (near, far) = tokio::io::duplex(LINE_BYTES);
                let host = Ipv4Addr::new(127, 0, 0, 2 + u8::try_from(place).unwrap_or_default());
                door.enter(far, SocketAddr::from((host, 1))).await;
                Some(Box::new(near) as Box<dyn Line>)
            })
        })
    }
}

/// The computers' watchdog: the one that is not well hands the charge over to one that is.
async fn watch_each_other(handles: [Handle; 2]) {
    let mut ticks = interval(LOOK);
    let mut charge = 0;
    loop {
        ticks.tick().await;
        let well = handles.each_ref().map(|handle| handle.is_well(WATCHDOG));
        match (charge, well) {
            (0, [false, true]) => charge = 1,
            (1, [true, false]) => charge = 0,
            _ => {}
        }
        handles.iter().enumerate().for_each(|(place, handle)| handle.set_in_charge(place == charge));
    }
}

/// The ground: gives commands to the computer in charge, by way of both, as a relay would that knows which one listens.
async fn ground(handles: [Handle; 2], account: Account, seed: u64) {
    let mut random = ChaCha8Rng::seed_from_u64(seed ^ 0x6772_6f75_6e64);
    let mut timeout_ms = FIRST_TIMEOUT_MS;
    loop {
        sleep(Duration::from_secs(random.random_range(GROUND_S.0..=GROUND_S.1))).await;
        let command = match random.random_range(0..10) {
            0..=5 => {
                timeout_ms += 1;
                Command::ConfigureSolver { enabled: true, timeout_s: f64::from(timeout_ms) / 1000.0 }
            }
            6 | 7 => Command::SetFocus { position_counts: random.random_range(FOCUS.0..=FOCUS.1) },
            8 => Command::GetFocus {},
            // Where the focus stands is not known any more, or it is not where it is thought to be: its range is learned anew.
            _ if account.unsolved_for() > PATIENCE || account.focus_unknown_for() > PATIENCE => Command::InitFocus {},
            _ => Command::AbortFocus { use_result: false },
        };
        // A lens that lost its place is at an end of its range: any move of it may be a large one.
        let acts: &[Act] = match command {
            Command::SetFocus { .. } | Command::InitFocus {} => &[Act::Arm, Act::Fire],
            _ => &[Act::Run],
        };
        if let Some(handle) = handles.iter().find(|handle| handle.is_in_charge()) {
            for &act in acts {
                account.give(&command);
                handle.give(act, command);
            }
        }
    }
}

/// The sensor's file holds its value, once its disk takes it.
pub(super) async fn show_sensor(sensor: &Path) {
    while std::fs::write(sensor, SENSOR_C.to_string()).is_err() {
        sleep(Duration::from_secs(1)).await;
    }
}
