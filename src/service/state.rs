//! The state: one immutable snapshot of all that is true now. The hub alone makes it; everybody else reads the newest.

use super::housekeeping::{self, Measurements};
use super::motion::Motions;
use super::runs::Run;
use super::session::Closed;
use super::strain::Strain;
use crate::camera::LinePulses;
use crate::command::legacy::LegacyGuard;
use crate::command::{BootId, Command, Desk, FlightComputer, Focus, Guard, InCharge, Lease, OrderNumber, Tick};
use crate::image::{ExposedBy, ImageCounter, TriggerCounter};
use crate::lens::autofocus::{Autofocus, AutofocusRules, AutofocusStatus, CurvePoint};
use crate::lens::{AperturePosition, Doubt, FocusCounts, FocusKept, LensCommand, LensState, RequestCounter};
use crate::settings::{CameraKind, LensKind, ObserverSettings, Settings};
use crate::sky::{ClockComparison, ClockQuality, ClockReading, Observer, Utc};
use crate::solve::{Outcome, Prior, Report};
use crate::wire::Status;
use crate::wire::legacy::Picture;
pub use crate::wire::{Actor, Found, Shed};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// All that is true now.
#[derive(Debug, Clone)]
pub struct State {
    /// What is simulated: whatever shows a value says so.
    pub simulated: Simulated,
    /// Whether frames can be solved.
    pub readiness: Readiness,
    /// What the camera does.
    pub camera: CameraState,
    /// What makes the camera expose.
    pub triggers: Triggers,
    /// What the lens's actor says of the lens; [`State::focus_known`] and [`State::aperture_known`] say what can be shown.
    pub lens: Arc<LensState>,
    /// What of the focus outlasts a restart.
    pub focus_kept: FocusKept,
    /// What of it was found at the start.
    pub found: Found,
    /// Requests to the lens that are not answered to their end.
    pub lens_requests: BTreeMap<RequestCounter, LensCommand>,
    /// The order that ends when the lens is at rest.
    pub rests: Option<OrderNumber>,
    /// What the autofocus is at.
    pub autofocus: Arc<AutofocusStatus>,
    /// What the last run of it saw.
    pub focus_curves: Arc<[CurvePoint]>,
    /// The frame that is being solved.
    pub solving: Option<ImageCounter>,
    /// The last frame that ended in an outcome; one that was only skipped is counted and not shown here.
    pub latest: Option<Arc<Finished>>,
    /// When the last frame that was solved was captured.
    pub last_solved: Option<Instant>,
    /// The newest exposure that is on a disk: its image, and its place in its series.
    pub newest_kept: Option<(ImageCounter, u8)>,
    /// How the gondola turned during the last images.
    pub motions: Motions,
    /// The flight computers that are connected.
    pub peers: Vec<Peer>,
    /// Who is in charge.
    pub charge: InCharge,
    /// Which commands have been seen.
    pub guard: Guard,
    /// The same for each flight computer that speaks the legacy dialect.
    pub legacy: BTreeMap<FlightComputer, LegacyGuard>,
    /// The orders under way, and what came of the others.
    pub desk: Desk,
    /// Whether the counters of commands survive a restart.
    pub counters_kept: bool,
    /// The settings in force: those of the start, and what commands made of them.
    pub settings: Arc<Settings>,
    /// CRC-32 of them.
    pub settings_hash: u32,
    /// The commands that changed them, the last of each kind.
    pub commanded: Vec<Command>,
    /// How many of them commands have changed.
    pub settings_commanded: u16,
    /// Records of what outlasts a restart that were sent to the disk.
    pub records_sent: u64,
    /// Orders that end once what they changed is on disk.
    pub settling: Vec<Settling>,
    /// The camera's gain, dB; known only while no change of it is under way.
    pub camera_gain: Option<f64>,
    /// When a flight computer was last heard, or the network was reset by itself.
    pub heard: Instant,
    /// Times that the network was reset by itself.
    pub network_resets: u32,
    /// Set where the program is to end.
    pub ending: Option<Ending>,
    /// The observer as a flight computer in charge last sent it, and when.
    pub observer: Option<(Observer, Instant)>,
    /// Temperatures, pressure and disk.
    pub measured: Arc<Measurements>,
    /// What is left undone for want of time.
    pub strain: Strain,
    /// The last restart of each actor that was ever started again.
    pub restarts: BTreeMap<Actor, Restart>,
    /// Which run of the service this is, and how the last one ended.
    pub run: Run,
    /// What happened since the start.
    pub counters: Counters,
}

/// An order that is done, and ends once that is on disk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settling {
    /// The order.
    pub number: OrderNumber,
    /// The first record that has it.
    pub record: u64,
    /// What came of it.
    pub words: String,
}

/// Why the program is to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// A command said so.
    Commanded,
}

/// Which parts of the instrument are simulated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Simulated {
    /// Images do not come from a real camera.
    pub camera: bool,
    /// The lens is not a real one.
    pub lens: bool,
    /// A value of the housekeeping is made up.
    pub housekeeping: bool,
}

/// An outcome, the same in the units of the outside, and when its frame was captured.
#[derive(Debug, Clone, PartialEq)]
pub struct Finished {
    /// What the frame ended in.
    pub outcome: Outcome,
    /// The same outcome for logs, telemetry and the display.
    pub report: Report,
    /// When the frame was captured.
    pub captured: Instant,
    /// What the places of its sources refer to, where it was looked at.
    pub picture: Option<Picture>,
}

/// Whether frames can be solved.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Readiness {
    /// Catalogue and index are being made ready.
    Starting,
    /// Frames are solved.
    Ready,
    /// No frame can be solved, and why.
    Broken(String),
}

/// What the camera does.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum CameraState {
    /// It has not been asked yet, or there is none.
    Idle,
    /// It gave a frame when it was last asked.
    Working,
    /// It is there, and waits for a trigger.
    Waiting,
    /// It gave none, and why.
    Unavailable(String),
}

/// What makes the camera expose, and what came of triggers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Triggers {
    /// What makes it expose now.
    pub exposing: ExposedBy,
    /// When the last image was captured that a trigger made.
    pub last: Option<Instant>,
    /// Times that triggers stayed away for `camera.trigger_timeout_s`.
    pub stayed_away: u32,
}

/// A flight computer that is connected.
#[derive(Debug, Clone, PartialEq)]
pub struct Peer {
    /// Who.
    pub computer: FlightComputer,
    /// Which start of its program it is.
    pub boot: BootId,
    /// The number of its connection: a later one is higher.
    pub connection: u64,
    /// When it connected.
    pub connected: Instant,
    /// Its last status, and when it came.
    pub status: Option<(Arc<Status>, Instant)>,
    /// Its clock, against the time since our start.
    pub clock: ClockComparison,
}

/// What happened since the start.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counters {
    /// The number that the next image will have.
    pub next_image: ImageCounter,
    /// Frames that the camera gave, unreadable ones included.
    pub frames_taken: u32,
    /// Frames solved.
    pub frames_solved: u32,
    /// Frames replaced by a newer one before their turn.
    pub frames_skipped: u32,
    /// Images that could not be read.
    pub frames_unreadable: u32,
    /// Lines that the recorder wrote.
    pub records_written: u32,
    /// Outcomes that the recorder could not keep.
    pub records_lost: u32,
    /// Times that the disk refused.
    pub disk_errors: u32,
    /// What became of images on each disk.
    pub images: BTreeMap<Disk, ImageCounters>,
    /// Times that each actor was started again.
    pub restarts: BTreeMap<Actor, u32>,
    /// Connections that ended, by the reason.
    pub closed: BTreeMap<Closed, u32>,
}

/// Where images are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Disk {
    /// The camera's disk.
    Images,
    /// A second one.
    Copies,
}

/// What became of images on a disk.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct ImageCounters {
    /// Kept.
    pub kept: u32,
    /// Not kept.
    pub lost: u32,
    /// Kept earlier, and gone to make room.
    pub thinned: u32,
    /// Times that the disk refused.
    pub disk_errors: u32,
}

/// What an archive tells.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ImageNews {
    /// An image is on disk.
    Kept {
        /// Its number.
        image: ImageCounter,
        /// Its place in its series; 0 where it stands alone.
        exposure: u8,
        /// Images that went to make room.
        thinned: u32,
    },
    /// One could not be kept.
    Lost,
    /// The disk refused.
    DiskError,
}

impl ImageCounters {
    /// Counts what an archive tells.
    pub fn count(&mut self, news: ImageNews) {
        let add = |count: &mut u32, more| *count = count.saturating_add(more);
        match news {
            ImageNews::Kept { thinned, .. } => {
                add(&mut self.kept, 1);
                add(&mut self.thinned, thinned);
            }
            ImageNews::Lost => add(&mut self.lost, 1),
            ImageNews::DiskError => add(&mut self.disk_errors, 1),
        }
    }
}

/// An actor's last restart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Restart {
    /// Why it had ended.
    pub why: Arc<str>,
    /// When it was started again.
    pub at: Instant,
}

impl Simulated {
    /// As the settings have it.
    pub fn of(settings: &Settings) -> Self {
        Self {
            camera: settings.camera.kind == CameraKind::Sky,
            lens: settings.lens.kind == LensKind::Simulated,
            housekeeping: housekeeping::is_simulated(settings),
        }
    }

    /// Whether anything is that an image goes through.
    pub fn any(self) -> bool {
        self.camera || self.lens
    }
}

impl Finished {
    /// An outcome in which nothing was matched, so that no star needs a name.
    pub fn without_stars(outcome: Outcome, captured: Instant) -> Self {
        Self { report: Report::without_stars(&outcome), outcome, captured, picture: None }
    }
}

impl State {
    /// The state at the start.
    pub fn new(settings: Arc<Settings>, guard: Guard) -> Self {
        Self {
            simulated: Simulated::of(&settings),
            readiness: Readiness::Starting,
            camera: CameraState::Idle,
            triggers: Triggers {
                exposing: if settings.camera.trigger.is_line() { ExposedBy::Trigger } else { ExposedBy::Asked },
                ..Triggers::default()
            },
            lens: Arc::new(LensState::unknown(Doubt::NeverRead)),
            focus_kept: FocusKept::default(),
            found: Found::Nothing,
            lens_requests: BTreeMap::new(),
            rests: None,
            autofocus: Arc::new(Autofocus::new(AutofocusRules::new(&settings.focus)).status(Tick::ZERO)),
            focus_curves: Arc::default(),
            solving: None,
            latest: None,
            last_solved: None,
            newest_kept: None,
            motions: Motions::default(),
            peers: Vec::new(),
            charge: InCharge::default(),
            guard,
            legacy: BTreeMap::new(),
            desk: Desk::default(),
            counters_kept: false,
            settings_hash: settings.fingerprint() as u32,
            settings,
            commanded: Vec::new(),
            records_sent: 0,
            settling: Vec::new(),
            settings_commanded: 0,
            camera_gain: None,
            heard: Instant::now(),
            network_resets: 0,
            ending: None,
            observer: None,
            measured: Arc::default(),
            strain: Strain::default(),
            restarts: BTreeMap::new(),
            run: Run::default(),
            counters: Counters::default(),
        }
    }

    /// Who may command.
    pub fn in_charge(&self) -> Option<Lease> {
        self.charge.lease()
    }

    /// Whether a connection is the one that its flight computer has now.
    pub fn is_current(&self, computer: FlightComputer, connection: u64) -> bool {
        self.peers.iter().any(|peer| peer.computer == computer && peer.connection == connection)
    }

    /// Where the focus is; known only where every request that concerns it has been answered.
    pub fn focus_known(&self) -> Option<FocusCounts> {
        let asked = self.lens_requests.values().any(|command| command.concerns_focus());
        self.lens.focus.value().filter(|_| !asked)
    }

    /// Where the aperture is, as [`Self::focus_known`].
    pub fn aperture_known(&self) -> Option<AperturePosition> {
        let asked = self.lens_requests.values().any(|command| command.concerns_aperture());
        self.lens.aperture.value().filter(|_| !asked)
    }

    /// What a request to the lens has led to, in words.
    pub fn lens_words(&self, command: LensCommand) -> String {
        match (command.concerns_focus(), command.concerns_aperture()) {
            (true, _) => self.lens.focus.value().map_or_else(String::new, |at| format!("focus at {at} counts")),
            (_, true) => self.lens.aperture.value().map_or_else(String::new, |at| format!("aperture at {at}")),
            _ => String::new(),
        }
    }

    /// Where the focus is, to tell a large move.
    pub fn focus(&self) -> Focus {
        Focus { position: self.focus_known().map(|counts| counts.0), large_move: self.settings.lens.large_move_counts }
    }

    /// When the network is to be reset by itself, if no flight computer is heard before; `None` where it is not to be.
    pub fn lull_ends(&self) -> Option<Instant> {
        let commands = &self.settings.commands;
        let wanted = commands.network_lull && !commands.network_reset_program.is_empty();
        wanted.then(|| self.heard + Duration::from_secs_f64(commands.network_lull_s))
    }

    /// Takes note of a command that changes settings: it is the last of its kind.
    pub fn note_commanded(&mut self, command: Command) {
        self.commanded.retain(|earlier| earlier.code() != command.code());
        self.commanded.push(command);
    }

    /// Puts the settings of the start in force again.
    pub fn reset(&mut self, initial: &Arc<Settings>) {
        self.commanded.clear();
        self.adopt(Arc::clone(initial), initial);
    }

    /// Puts other settings in force.
    pub fn adopt(&mut self, settings: Arc<Settings>, initial: &Settings) {
        self.settings_hash = settings.fingerprint() as u32;
        self.settings_commanded = settings.differences(initial);
        self.settings = settings;
    }

    /// Takes what an archive tells.
    pub fn note_image(&mut self, disk: Disk, news: ImageNews) {
        self.counters.images.entry(disk).or_default().count(news);
        if let ImageNews::Kept { image, exposure, .. } = news {
            self.newest_kept = self.newest_kept.max(Some((image, exposure)));
        }
    }

    /// Whether there is time to send images.
    pub fn may_send_images(&self) -> bool {
        self.strain.shed() < Shed::Images
    }

    /// Whether a connection has been replaced by a newer one of the same flight computer.
    pub fn has_replaced(&self, computer: FlightComputer, connection: u64) -> bool {
        self.peers.iter().any(|peer| peer.computer == computer && peer.connection > connection)
    }

    /// The last status of the flight computer in charge.
    pub fn status_in_charge(&self) -> Option<&Status> {
        let holder = self.in_charge()?;
        let peer = self.peers.iter().find(|peer| peer.computer == holder.computer)?;
        peer.status.as_ref().map(|(status, _)| &**status)
    }

    /// The series of triggers that an image captured now belongs to, as the flight computer in charge counts them.
    pub fn trigger(&self) -> Option<TriggerCounter> {
        self.status_in_charge().and_then(Status::trigger)
    }

    /// UTC at `uptime`, when our clock says `ours`: where that follows no reference, the best of the flight computers' whose does.
    pub fn time(&self, uptime: Duration, ours: ClockReading) -> ClockReading {
        if ours.quality.follows() {
            return ours;
        }
        let follows = |status: &Status| status.clock.clock_quality.get().is_some_and(ClockQuality::follows);
        let theirs = self.peers.iter().filter(|peer| peer.status.as_ref().is_some_and(|(status, _)| follows(status)));
        let best = theirs.filter_map(|peer| peer.clock.offset(uptime)).min_by(|a, b| a.sigma_s.total_cmp(&b.sigma_s));
        let utc = best.and_then(|clock| Some((Utc::from_unix(uptime.as_secs_f64() + clock.offset_s)?, clock.sigma_s)));
        utc.map_or(ours, |(utc, sigma_s)| ClockReading {
            utc: Some(utc),
            quality: ClockQuality::FlightComputer,
            sigma_s: Some(sigma_s),
        })
    }

    /// The trigger pulses that the flight computer in charge says it sent.
    pub fn pulses(&self) -> Option<LinePulses> {
        let status = self.status_in_charge()?;
        Some(LinePulses { boot: status.boot_id.get(), count: status.trigger_pulses.get() })
    }

    /// What is known of the pointing of a frame captured `now`. The estimates are those of the last status of the computer
    /// in charge (at most as old as a claim may be); the observer is the last that any computer in charge sent, its sidereal
    /// time carried forward, until it is older than `observer.max_age_s`.
    pub fn prior(&self, now: Instant, settings: &ObserverSettings) -> Prior {
        let sent = self.status_in_charge().map(Status::prior).unwrap_or_default();
        let observer = self.observer.filter(|_| settings.from_flight_computer).and_then(|(observer, at)| {
            let age_s = now.saturating_duration_since(at).as_secs_f64();
            (age_s <= settings.max_age_s).then(|| observer.after(age_s))
        });
        Prior { observer, ..sent }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::DEG;

    #[tokio::test(start_paused = true)]
    async fn an_observer_is_carried_forward_until_it_is_too_old() {
        let settings = Settings::flight().unwrap().observer;
        let mut state = State::new(Arc::new(Settings::flight().unwrap()), Guard::default());
        let sent = Observer { latitude: -1.3, sidereal_time: 10.0 * DEG };
        let at = Instant::now();
        state.observer = Some((sent, at));
        assert_eq!(state.prior(at, &settings).observer, Some(sent));
        let later = state.prior(at + Duration::from_secs(240), &settings).observer.unwrap();
        assert!((later.sidereal_time / DEG - 10.0 - 1.002_738).abs() < 1e-5, "{}", later.sidereal_time / DEG);
        let limit = Duration::from_secs_f64(settings.max_age_s);
        assert!(state.prior(at + limit, &settings).observer.is_some());
        assert!(state.prior(at + limit + Duration::from_secs(1), &settings).observer.is_none());
        let unwanted = ObserverSettings { from_flight_computer: false, ..settings };
        assert!(state.prior(at, &unwanted).observer.is_none());
    }
}
