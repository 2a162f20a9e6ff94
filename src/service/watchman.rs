//! The watchman: makes the actors, each with its inbox, and puts them under the supervisor.

use super::archive::{self, Images};
use super::camera::{self, CameraActor, MakeSource};
use super::clock::Clock;
use super::display::{Page, PageSocket, Site};
use super::housekeeping::{self, Housekeeper};
use super::hub;
use super::inbox;
use super::journal::{self, Pages};
use super::keeper::Keeper;
use super::ledger::{self, Ledger, LedgerActor};
use super::left_behind::LeftBehind;
use super::legacy::LegacyListener;
use super::lens::{self, Handle as LensHandle, LensActor, SimulatedLens};
use super::listener::Listener;
use super::pulse::Pulse;
use super::recorder::{self, Lines};
use super::replayer::Replayer;
use super::solver::{self, MakeSolver, SolverActor};
use super::state::{Actor, Disk, Simulated, State};
use super::store::{Store, StoreRules};
use super::supervisor::{Backoff, Ended, Watched, supervise};
use super::{Kept, Pulses, Stage};
use crate::command::{BootId, UNDER_WAY};
use crate::image::Frame;
use crate::lens::Rules;
use crate::settings::Settings;
use std::path::Path;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tracing::{Instrument, Span};

/// Frames that may wait for the solver's actor, which takes them at once.
const SOLVER_INBOX: usize = 2;
/// Requests that may wait for the camera's actor, which is with a frame for a second at most.
const CAMERA_INBOX: usize = 4;
/// Outcomes that may wait for the recorder's actor, which takes them at once.
const RECORDER_INBOX: usize = 64;
/// Entries that may wait for the journal's actor, which takes them at once: a flood of messages.
const JOURNAL_INBOX: usize = 1024;
/// Frames and outcomes that may wait for an archive's actor, which takes them at once.
const ARCHIVE_INBOX: usize = 64;
/// Requests that may wait for the lens's actor, which takes them at once.
const LENS_INBOX: usize = 32;

/// Bytes of a GiB.
const GIB: f64 = (1_u64 << 30) as f64;

/// Puts actors under the supervisor.
pub struct Watchman {
    /// The hub.
    pub hub: hub::Handle,
    /// The settings of the start.
    pub settings: Arc<Settings>,
    /// The newest state.
    pub state: watch::Receiver<Arc<State>>,
    /// The service's clock.
    pub clock: Clock,
    /// Marks the log of a simulation.
    pub span: Span,
    /// The pulses of all actors.
    pub pulses: Pulses,
    /// Where it is noted what the machines are told.
    pub journal: journal::Handle,
}

impl Watchman {
    /// One of nothing yet. The log is marked where images go through anything that is simulated.
    pub fn new(hub: hub::Handle, settings: &Arc<Settings>, state: watch::Receiver<Arc<State>>, clock: Clock) -> Self {
        let span = if Simulated::of(settings).any() { tracing::info_span!("simulated") } else { Span::none() };
        let (pulses, journal) = (Pulses::default(), journal::Handle::default());
        Self { hub, settings: Arc::clone(settings), state, clock, span, pulses, journal }
    }

    /// Keeps an actor running until its stage ends; `start` makes it anew each time.
    pub fn keep<F, A>(&self, stage: &Stage, actor: Actor, start: F)
    where
        F: FnMut(Pulse) -> A + Send + 'static,
        A: Future<Output = Result<(), Ended>> + Send + 'static,
    {
        let pulse = Pulse::new();
        self.pulses.lock().unwrap_or_else(PoisonError::into_inner).push((actor, pulse.clone()));
        let hangs_after = Duration::from_secs_f64(self.settings.service.hang_s);
        let watched = Watched { actor, pulse, hangs_after, hub: self.hub.clone(), stop: stage.stop.clone() };
        let kept = supervise(watched, Backoff::new(&self.settings.service), start);
        stage.tracker.spawn(kept.instrument(self.span.clone()));
    }

    /// Keeps the recorder running, where there is to be one.
    pub fn keep_recorder(&self, stage: &Stage) -> Option<recorder::Handle> {
        let record = &self.settings.record;
        if !record.enabled {
            return None;
        }
        let (to_recorder, inbox) = inbox::channel(RECORDER_INBOX);
        let actor = Keeper {
            inbox,
            hub: self.hub.clone(),
            backlog: Lines::new(Path::new(&record.directory).join(recorder::file_name(&self.clock))),
            queue: record.queue_frames as usize,
            backoff: Backoff::new(&self.settings.service),
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Recorder, move |pulse| actor.clone().run(pulse));
        Some(to_recorder)
    }

    /// Keeps the journal, where there is to be one; it begins with what this run begins from.
    #[must_use]
    pub fn keep_journal(mut self, stage: &Stage, kept: &Kept) -> Self {
        let record = &self.settings.record;
        if !(record.enabled && record.journal) {
            return self;
        }
        let (to_journal, inbox) = inbox::channel(JOURNAL_INBOX);
        let backlog = Pages::new(journal::Rules {
            directory: Path::new(&record.directory).to_owned(),
            limit_bytes: (record.journal_limit_gib * GIB) as u64,
            reserve_bytes: (record.reserve_gib * GIB) as u64,
            stem: journal::stem(&self.clock),
            boot: BootId(self.clock.boot_id()),
        });
        self.journal = journal::Handle::new(to_journal, self.clock, &backlog);
        self.journal.note(self.clock.uptime(), journal::begin(&self.clock, &self.settings, kept));
        let (hub, backoff, stop) = (self.hub.clone(), Backoff::new(&self.settings.service), stage.stop.clone());
        let actor = Keeper { inbox, hub, backlog, queue: journal::WAITING, backoff, stop };
        // To whoever counts restarts it is a second recorder, as there may be a second archive.
        self.keep(stage, Actor::Recorder, move |pulse| actor.clone().run(pulse));
        self
    }

    /// Keeps an archive running for each disk on which images are kept.
    pub fn keep_archives(&self, stage: &Stage) -> Vec<(Disk, archive::Handle)> {
        let record = &self.settings.record;
        let keep = |(disk, (_, directory))| {
            let (to_archive, inbox) = inbox::channel(ARCHIVE_INBOX);
            let rules = StoreRules {
                directory,
                limit_bytes: (record.images_limit_gib * GIB) as u64,
                reserve_bytes: (record.reserve_gib * GIB) as u64,
                boot_id: self.clock.boot_id(),
                camera: self.settings.camera.name.clone(),
                mirrored: self.settings.camera.mirrored,
            };
            let queue = record.queue_images as usize;
            let (hub, backoff, stop) = (self.hub.clone(), Backoff::new(&self.settings.service), stage.stop.clone());
            let backlog = Images::new(disk, Store::new(rules));
            let actor = Keeper { inbox, hub, backlog, queue, backoff, stop };
            self.keep(stage, Actor::Archive, move |pulse| actor.clone().run(pulse));
            (disk, to_archive)
        };
        [Disk::Images, Disk::Copies].into_iter().zip(record.image_directories()).map(keep).collect()
    }

    /// Keeps the ledger running.
    pub fn keep_ledger(&self, stage: &Stage, ledger: Ledger) -> ledger::Handle {
        let (to_ledger, inbox) = inbox::channel(UNDER_WAY);
        let ledger = Arc::new(Mutex::new(ledger));
        let actor = LedgerActor { inbox, hub: self.hub.clone(), ledger, stop: stage.stop.clone() };
        self.keep(stage, Actor::Ledger, move |pulse| actor.clone().run(pulse));
        to_ledger
    }

    /// Keeps the lens running: the one of the settings, or a simulated one with its controller.
    pub fn keep_lens(&self, stage: &Stage, simulated: Option<&SimulatedLens>) -> LensHandle {
        let (settings, state) = (&self.settings.lens, self.state.clone());
        let (to_lens, inbox) = inbox::channel(LENS_INBOX);
        let actor = LensActor {
            inbox,
            hub: self.hub.clone(),
            ports: simulated.map(SimulatedLens::ports).or_else(|| lens::serial_ports(settings)),
            rules: Rules::of(settings),
            focus_before: Arc::new(move || state.borrow().focus_kept),
            open: Arc::default(),
            journal: self.journal.clone(),
            clock: self.clock,
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Lens, move |pulse| actor.clone().run(pulse));
        if let Some(controller) = simulated {
            stage.tracker.spawn(controller.clone().run(stage.stop.clone()).instrument(self.span.clone()));
        }
        LensHandle::new(to_lens)
    }

    /// Keeps the solver running.
    pub fn keep_solver(
        &self,
        stage: &Stage,
        make: MakeSolver,
        abort: watch::Receiver<u32>,
        shown: watch::Sender<Option<Arc<Frame>>>,
    ) -> solver::Handle {
        let (to_solver, inbox) = inbox::channel(SOLVER_INBOX);
        let (hub, state, stop) = (self.hub.clone(), self.state.clone(), stage.stop.clone());
        let (left_behind, shown) = (LeftBehind::default(), Arc::new(shown));
        let (journal, clock) = (self.journal.clone(), self.clock);
        let actor =
            SolverActor { inbox, hub, make, open: Arc::default(), state, abort, left_behind, shown, journal, clock, stop };
        self.keep(stage, Actor::Solver, move |pulse| actor.clone().run(pulse));
        to_solver
    }

    /// Keeps the camera running.
    pub fn keep_camera(
        &self,
        stage: &Stage,
        make: MakeSource,
        solver: solver::Handle,
        archives: Vec<(Disk, archive::Handle)>,
    ) -> camera::Handle {
        let (to_camera, inbox) = inbox::channel(CAMERA_INBOX);
        let actor = CameraActor {
            make: camera::on_line(make, &self.settings.camera, &self.state),
            solver,
            archives,
            hub: self.hub.clone(),
            inbox,
            numbers: Arc::new(AtomicU32::new(0)),
            left_behind: LeftBehind::default(),
            open: Arc::default(),
            state: self.state.clone(),
            settings: Arc::clone(&self.settings),
            clock: self.clock,
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Camera, move |pulse| actor.clone().run(pulse));
        to_camera
    }

    /// Keeps the housekeeping running.
    pub fn keep_housekeeping(&self, stage: &Stage) {
        let (settings, stop) = (Arc::clone(&self.settings), stage.stop.clone());
        let actor = Housekeeper {
            make: Arc::new(move || housekeeping::sensors(&settings, &stop)),
            period: Duration::from_secs_f64(self.settings.housekeeping.period_s),
            hub: self.hub.clone(),
            clock: self.clock,
            stop: stage.stop.clone(),
        };
        self.keep(stage, Actor::Housekeeping, move |pulse| actor.clone().run(pulse));
    }

    /// Keeps the display running; gives the page, and where frames are shown.
    pub fn keep_display(
        &self,
        stage: &Stage,
        socket: PageSocket,
        replayer: Replayer,
    ) -> (Page, watch::Sender<Option<Arc<Frame>>>) {
        let (shown, frames) = watch::channel(None);
        let site = Site::new(&self.settings, self.state.clone(), frames, self.clock, replayer, stage.stop.clone());
        let page = Page::new(site, socket, stage.tracker.clone());
        let actor = page.clone();
        self.keep(stage, Actor::Display, move |pulse| actor.clone().run(pulse));
        (page, shown)
    }

    /// Lets flight computers in.
    pub fn open_doors(&self, stage: &Stage, listener: &Listener, legacy: Option<&LegacyListener>) {
        let door = listener.clone();
        self.keep(stage, Actor::Listener, move |pulse| door.clone().run(pulse));
        if let Some(door) = legacy.cloned() {
            self.keep(stage, Actor::LegacyListener, move |pulse| door.clone().run(pulse));
        }
    }
}
