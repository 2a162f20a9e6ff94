//! The camera's actor: asks the source for a frame on its schedule, stamps it, and hands it to the solver.

use super::archive::{self, ToArchive};
use super::auto::{self, Auto, Wanted};
use super::clock::Clock;
use super::housekeeping::Quantity;
use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::left_behind::LeftBehind;
use super::orders::NOBODY;
use super::pulse::Pulse;
use super::solver::{self, Captured};
use super::state::{CameraState, Disk, Finished, ImageNews, Shed, State, Triggers};
use super::supervisor::{Ended, panic_message, panic_text};
use crate::camera::{Ask, CameraError, Moment, SimulatedLine, Source, TriggerDecision, TriggerEvent, TriggerWatch};
use crate::command::OrderNumber;
use crate::image::{CoaddError, ExposedBy, Frame, ImageCounter, Series, Stamp};
use crate::settings::{CameraKind, CameraSettings, Settings};
use crate::sky::ClockReading;
use crate::solve::{Outcome, Reason};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, MissedTickBehavior, sleep_until};
use tokio_util::sync::CancellationToken;

/// Makes a source; blocking. The error says why there is none for now.
pub type MakeSource = Arc<dyn Fn() -> Result<Box<dyn Source>, String> + Send + Sync>;

/// What the camera is asked for besides frames.
#[derive(Debug)]
pub enum ToCamera {
    /// Its gain.
    GetGain(OrderNumber),
    /// To set its gain, dB.
    SetGain(OrderNumber, f64),
}

/// Where requests to the camera go.
pub type Handle = mpsc::Sender<ToCamera>;

/// The camera's actor.
#[derive(Clone)]
pub struct CameraActor {
    /// Makes a source.
    pub make: MakeSource,
    /// Where frames go.
    pub solver: solver::Handle,
    /// Where frames are kept.
    pub archives: Vec<(Disk, archive::Handle)>,
    /// Whom to tell of frames, and of images that were none.
    pub hub: hub::Handle,
    /// The number of the next image; it outlives the actor, so that no number is given twice.
    pub numbers: Arc<AtomicU32>,
    /// The jobs that its driver has not ended.
    pub left_behind: LeftBehind,
    /// The image that was counted and is not handed on yet; it outlives the actor, so that it ends in an outcome.
    pub open: Arc<Mutex<Option<Stamp>>>,
    /// The newest state, for what is known of the pointing at a capture.
    pub state: watch::Receiver<Arc<State>>,
    /// What it is asked for besides frames.
    pub inbox: Inbox<ToCamera>,
    /// The settings of the start; the camera's own do not change.
    pub settings: Arc<Settings>,
    /// The service's clock.
    pub clock: Clock,
    /// When to end.
    pub stop: CancellationToken,
}

/// Why a camera is not asked any more.
const HANGS: &str = "its driver hangs, time after time";

/// A trigger is waited for so long at a time: what else the camera is asked for waits no longer.
const WAIT: Duration = Duration::from_millis(250);
/// Until the next look at a camera that does not wait by itself. An image comes later by no more than that.
const LOOK: Duration = Duration::from_millis(3);
/// No image takes longer from its first exposure to its last.
const LONGEST_IMAGE: Duration = Duration::from_secs(60);
/// Until the next look at a camera that is away.
const AWAY: Duration = Duration::from_secs(1);

/// What the actor's loop holds.
struct Held {
    /// The source; `None` where one has to be made.
    source: Option<Box<dyn Source>>,
    triggers: TriggerWatch,
    /// When to look again for what a trigger made.
    look: Instant,
    /// Exposure and gain by what frames show.
    auto: Auto,
    /// The image whose exposures come one after the other.
    gathering: Option<Gathering>,
}

/// An image that waits for more exposures.
struct Gathering {
    /// Those that came: each is kept already.
    series: Series,
    /// Of the first.
    stamp: Stamp,
    /// When the first was asked for, and the state then.
    at: Instant,
    state: Arc<State>,
    /// Triggers that come later make another image.
    until: Instant,
}

impl Gathering {
    /// How the next exposure is asked for, as the first was.
    fn ask(&self) -> Ask {
        match self.stamp.exposed_by {
            Some(ExposedBy::Trigger) => Ask::Triggered(WAIT.min(self.until.saturating_duration_since(Instant::now()))),
            _ => Ask::Expose,
        }
    }

    /// Whether a trigger that has not come yet may still belong to it.
    fn waits(&self) -> bool {
        self.stamp.exposed_by == Some(ExposedBy::Trigger) && Instant::now() < self.until
    }
}

/// What the blocking pool gives back: the source for the next time, and the image.
struct Shot {
    source: Option<Box<dyn Source>>,
    /// The gain of a source that was made for this frame, dB, where it has one.
    gain_db: Option<f64>,
    /// The camera's temperature, °C, where it offers one.
    temperature_c: Option<f64>,
    image: Result<Series, CameraError>,
}

impl Shot {
    /// No image, and why.
    fn none(source: Option<Box<dyn Source>>, why: String) -> Self {
        Self { source, gain_db: None, temperature_c: None, image: Err(CameraError::Unavailable(why)) }
    }
}

impl CameraActor {
    /// Runs until stopped.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let left = self.open.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(stamp) = left {
            let outcome = Outcome::unsolved(stamp, Reason::Failed, "the camera's part of the program was started again");
            self.hub.tell(ToHub::Finished(Box::new(Finished::without_stars(outcome, Instant::now())))).await;
            self.set_open(None);
        }
        let camera = &self.settings.camera;
        let first = self.clock.started() + Duration::from_secs_f64(camera.startup_delay_s);
        let mut schedule = tokio::time::interval_at(first.max(Instant::now()), Duration::from_secs_f64(camera.period_s));
        schedule.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let triggers =
            TriggerWatch::new(camera, self.state.borrow().triggers.exposing, self.clock.tick(first.max(Instant::now())));
        let mut held = Held { source: None, triggers, look: first, auto: Auto::default(), gathering: None };
        let mut inbox = self.inbox.open().await;
        loop {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => return self.hand_on(&mut held).await,
                // All exposures of an image have the same light.
                Some(request) = inbox.recv(), if held.gathering.is_none() => {
                    held.auto.note_request(&request);
                    held.source = self.answer(held.source.take(), request).await?;
                }
                _ = schedule.tick(), if held.gathering.is_none() && held.triggers.exposing() != ExposedBy::Trigger => {
                    pulse.give_up(self.left_behind.too_many());
                    self.take_one(&mut held, Ask::Expose).await?;
                }
                () = sleep_until(held.look), if held.gathering.is_some() || held.triggers.exposing() != ExposedBy::Asked => {
                    pulse.beat();
                    pulse.give_up(self.left_behind.too_many());
                    let ask = held.gathering.as_ref().map_or(Ask::Triggered(WAIT), Gathering::ask);
                    self.take_one(&mut held, ask).await?;
                    self.watch(&mut held.triggers, TriggerEvent::Time).await;
                }
                () = pulse.rest() => {}
            }
        }
    }

    /// Does what is asked of the camera's gain, and reads it back.
    async fn answer(&self, source: Option<Box<dyn Source>>, request: ToCamera) -> Result<Option<Box<dyn Source>>, Ended> {
        let make = Arc::clone(&self.make);
        let (number, wanted) = match request {
            ToCamera::GetGain(number) => (number, None),
            ToCamera::SetGain(number, gain_db) => (number, Some(gain_db)),
        };
        let running = self.left_behind.start();
        let job = tokio::task::spawn_blocking(move || {
            let Some(_running) = running else { return (None, Err(HANGS.to_owned())) };
            let mut source = match source.map_or_else(|| make(), Ok) {
                Ok(source) => source,
                Err(why) => return (None, Err(why)),
            };
            let set = wanted.map_or(Ok(()), |gain_db| source.set_gain(gain_db));
            let gain = set.and_then(|()| source.gain()).map_err(|error| error.to_string());
            (Some(source), gain)
        });
        let Some(answer) = self.stop.run_until_cancelled(job).await else { return Ok(None) };
        let (source, result) = answer.map_err(|error| Ended(panic_message(error)))?;
        self.hub.tell(ToHub::Gain { number, result }).await;
        Ok(source)
    }

    /// Takes note of triggers that came, or did not; tells what follows.
    async fn watch(&self, triggers: &mut TriggerWatch, event: TriggerEvent) {
        let decision = triggers.on(self.clock.uptime(), event);
        let Triggers { mut last, mut stayed_away, .. } = self.state.borrow().triggers;
        match decision {
            TriggerDecision::Unchanged if event == TriggerEvent::Time => return,
            TriggerDecision::Unchanged => {}
            TriggerDecision::ByItself { silent } => {
                stayed_away = stayed_away.saturating_add(1);
                tracing::warn!(silent_s = silent.as_secs(), "no trigger comes: the camera exposes by itself");
            }
            TriggerDecision::Returned => tracing::info!("triggers are back: the camera waits for them"),
        }
        if event == TriggerEvent::Triggered {
            last = Some(Instant::now());
        }
        self.hub.tell(ToHub::Triggers(Triggers { exposing: triggers.exposing(), last, stayed_away })).await;
    }

    /// Takes one exposure on its way; puts the source back. When it is to end, a source that is slow is left behind; an exposure that
    /// came is not.
    async fn take_one(&self, held: &mut Held, ask: Ask) -> Result<(), Ended> {
        let at = Instant::now();
        let image = held.gathering.as_ref().map_or_else(|| self.next_number(), |gathering| gathering.stamp.image);
        let uptime = self.clock.tick(at);
        let state = Arc::clone(&self.state.borrow());
        let make = Arc::clone(&self.make);
        let ClockReading { utc, quality, sigma_s } = state.time(uptime, self.clock.time());
        let moment = Moment { image, uptime, utc, quality, sigma_s, ask };
        let source = held.source.take();
        let light = if held.gathering.is_none() { held.auto.next(&state) } else { None };
        let running = self.left_behind.start();
        let job = tokio::task::spawn_blocking(move || match running {
            Some(_running) => shoot(source, &make, &moment, light),
            None => Shot::none(source, HANGS.to_owned()),
        });
        let Some(shot) = self.stop.run_until_cancelled(job).await else { return Ok(()) };
        let Shot { source, gain_db, temperature_c, image: taken } = shot.map_err(|error| Ended(panic_message(error)))?;
        (held.source, held.look) = (source, Instant::now() + LOOK);
        if let Some(gain_db) = gain_db {
            self.hub.tell(ToHub::Gain { number: NOBODY, result: Ok(gain_db) }).await;
        }
        let none = match taken {
            Ok(series) => return self.take_in(held, series, (state, at), (gain_db, temperature_c)).await,
            Err(CameraError::NothingNew) if held.gathering.as_ref().is_some_and(Gathering::waits) => return Ok(()),
            Err(none) => none,
        };
        self.hand_on(held).await?;
        match none {
            CameraError::Unreadable { origin, problem } => {
                let mut stamp = Stamp { origin, ..Stamp::default() };
                self.number(self.next_number(), &state, &mut stamp);
                self.count(&stamp).await;
                self.tell(&state, CameraState::Working).await;
                let outcome = Outcome::unsolved(stamp, Reason::Unreadable, problem);
                self.hub.tell(ToHub::Finished(Box::new(Finished::without_stars(outcome, at)))).await;
                self.set_open(None);
            }
            CameraError::NothingNew if held.triggers.exposing() != ExposedBy::Asked => {
                self.tell(&state, CameraState::Waiting).await;
            }
            none => {
                held.look = Instant::now() + AWAY;
                self.tell(&state, CameraState::Unavailable(none.to_string())).await;
            }
        }
        Ok(())
    }

    /// Keeps what came, and puts it to its image, which is handed on where it is complete.
    async fn take_in(
        &self,
        held: &mut Held,
        mut new: Series,
        (state, at): (Arc<State>, Instant),
        (gain_db, temperature_c): (Option<f64>, Option<f64>),
    ) -> Result<(), Ended> {
        let asked = held.triggers.exposing() == ExposedBy::Asked;
        new.stamp(|stamp| stamp.exposed_by = stamp.exposed_by.or(asked.then_some(ExposedBy::Asked)));
        let by = new.exposures().first().and_then(|exposure| exposure.stamp.exposed_by);
        let belongs =
            |to: &Gathering| to.stamp.exposed_by == by && new.exposures().iter().all(|exposure| to.series.takes(exposure));
        if held.gathering.as_ref().is_some_and(|gathering| !belongs(gathering)) {
            self.hand_on(held).await?;
        }
        // A directory tells by its names what belongs together.
        let alone = new.exposures().len() == 1 && self.settings.camera.kind != CameraKind::Directory;
        let wanted = if alone { self.settings.camera.series_exposures as usize } else { 1 };
        let place = held.gathering.as_ref().map_or(0, |gathering| gathering.series.exposures().len());
        let first = held.gathering.as_ref().map(|gathering| &gathering.stamp);
        let image = first.map_or_else(|| self.next_number(), |first| first.image);
        new.stamp(|stamp| {
            stamp.trigger = stamp.trigger.or(first.and_then(|first| first.trigger));
            self.number(image, &state, stamp);
            stamp.temperature_camera_c = stamp.temperature_camera_c.or(temperature_c);
            // What was set for this frame is not in the state yet.
            stamp.gain_db = stamp.gain_db.or(gain_db);
            self.note_instrument(&state, at, stamp);
            if wanted > 1 {
                stamp.part = u8::try_from(place).ok();
            }
        });
        // Before anything is waited for: whatever becomes of this actor, the exposures are where they are kept.
        let lost = self.keep(&state, new.exposures());
        if by == Some(ExposedBy::Trigger) {
            self.watch(&mut held.triggers, TriggerEvent::Triggered).await;
        }
        for disk in lost {
            self.hub.tell(ToHub::Image(disk, ImageNews::Lost)).await;
        }
        self.tell(&state, CameraState::Working).await;
        match held.gathering.take() {
            Some(gathering) => held.gathering = Some(added(gathering, new).await?),
            None => {
                let Some(stamp) = new.exposures().first().map(|exposure| exposure.stamp.clone()) else { return Ok(()) };
                self.count(&stamp).await;
                let series = if wanted > 1 { expecting_more(new).await? } else { new };
                let wait = Duration::try_from_secs_f64(self.state.borrow().settings.camera.series_s).unwrap_or_default();
                held.gathering = Some(Gathering { series, stamp, at, state, until: Instant::now() + wait });
            }
        }
        if place + 1 >= wanted {
            return self.hand_on(held).await;
        }
        held.look = Instant::now();
        Ok(())
    }

    /// Hands the image that was gathered to the solver: the sum of its exposures.
    async fn hand_on(&self, held: &mut Held) -> Result<(), Ended> {
        let Some(Gathering { series, at, state, .. }) = held.gathering.take() else { return Ok(()) };
        let (sum, exposures) = match series.exposures() {
            [_] => series.into_sum(),
            // Where 16 bits do not hold the sums there is a pass over the picture to be made, and large pictures take time.
            _ => tokio::task::spawn_blocking(move || series.into_sum()).await.map_err(|error| Ended(panic_message(error)))?,
        };
        let Some(frame) = sum.map(Arc::new).or_else(|| exposures.first().cloned()) else { return Ok(()) };
        held.auto.note(&frame);
        let prior = state.prior(self.middle(&frame, at), &state.settings.observer);
        let captured = Captured { frame, exposures, at, prior, motion: None };
        self.solver.send(captured).await.map_err(|_| Ended("the solver's inbox is gone".to_owned()))?;
        self.set_open(None);
        Ok(())
    }

    /// The middle of the light of a frame that was asked for at a time; that time, where its stamp has none of this run.
    fn middle(&self, frame: &Frame, asked: Instant) -> Instant {
        let uptime = frame.stamp.uptime_s.and_then(|seconds| Duration::try_from_secs_f64(seconds).ok());
        let middle = uptime.and_then(|uptime| self.clock.started().checked_add(uptime));
        middle.filter(|middle| (asked..=asked + LONGEST_IMAGE).contains(middle)).unwrap_or(asked)
    }

    /// Hands exposures to those who keep them; says where there is no room for one, or no time. They are solved all the same.
    fn keep(&self, state: &State, exposures: &[Arc<Frame>]) -> Vec<Disk> {
        let shed = state.strain.shed() >= Shed::Images;
        let lost = |archive: &archive::Handle, exposure: &Arc<Frame>| {
            shed || archive.try_send(ToArchive::Frame(Arc::clone(exposure))).is_err()
        };
        let pairs =
            exposures.iter().flat_map(|exposure| self.archives.iter().map(move |(disk, archive)| (disk, archive, exposure)));
        pairs.filter(|(_, archive, exposure)| lost(archive, exposure)).map(|(disk, ..)| *disk).collect()
    }

    /// Stamps a frame with the gain, the lens's temperature, and with where the lens stood for all of it; nothing where that is not known, or it moved.
    fn note_instrument(&self, before: &State, at: Instant, stamp: &mut Stamp) {
        let after = self.state.borrow();
        let stood = before.lens_requests.is_empty() && after.lens_requests.is_empty();
        let focus = before.focus_known().filter(|focus| stood && after.focus_known() == Some(*focus));
        let aperture = before.aperture_known().filter(|aperture| after.aperture_known() == Some(*aperture));
        stamp.focus_counts = stamp.focus_counts.or(focus.map(|focus| focus.0));
        stamp.aperture_counts = stamp.aperture_counts.or(aperture.map(|aperture| aperture.0));
        let celsius = before.measured.value(Quantity::TemperatureLens, at, &before.settings);
        stamp.temperature_lens_c = stamp.temperature_lens_c.or(celsius);
        stamp.gain_db = stamp.gain_db.or(before.camera_gain.filter(|gain| after.camera_gain == Some(*gain)));
    }

    /// The number of the next image.
    fn next_number(&self) -> ImageCounter {
        ImageCounter(self.numbers.load(Ordering::Relaxed))
    }

    /// Gives an image its number, the series of triggers that it belongs to, and the mark of a simulation.
    fn number(&self, image: ImageCounter, state: &State, stamp: &mut Stamp) {
        self.numbers.store(image.0.wrapping_add(1), Ordering::Relaxed);
        stamp.image = image;
        let by_itself = stamp.exposed_by == Some(ExposedBy::Itself);
        stamp.trigger = stamp.trigger.or_else(|| state.trigger().filter(|_| !by_itself));
        stamp.simulated |= state.simulated.any();
    }

    /// Has an image counted: from now on it must end in an outcome.
    async fn count(&self, stamp: &Stamp) {
        let next = ImageCounter(stamp.image.0.wrapping_add(1));
        self.hub.tell(ToHub::Captured { next }).await;
        self.set_open(Some(stamp.clone()));
    }

    fn set_open(&self, stamp: Option<Stamp>) {
        *self.open.lock().unwrap_or_else(PoisonError::into_inner) = stamp;
    }

    /// Tells how the camera is where that changed.
    async fn tell(&self, before: &State, now: CameraState) {
        if before.camera != now {
            if let CameraState::Unavailable(why) = &now {
                tracing::warn!(why, "no frame from the camera");
            }
            self.hub.tell(ToHub::Camera(now)).await;
        }
    }
}

/// The sources of a camera that has no line of its own, behind a simulated one where the settings have others trigger it: on it are the
/// pulses that the flight computer in charge says it sent.
pub fn on_line(make: MakeSource, settings: &CameraSettings, state: &watch::Receiver<Arc<State>>) -> MakeSource {
    if settings.kind == CameraKind::Aravis || !settings.trigger.is_line() {
        return make;
    }
    let state = state.clone();
    Arc::new(move || {
        let state = state.clone();
        let pulses = Box::new(move || state.borrow().pulses());
        Ok(Box::new(SimulatedLine::new(make()?, pulses)))
    })
}

/// One image, on the blocking pool. A source that panics over an image has lost that image and is asked for the next one.
fn shoot(source: Option<Box<dyn Source>>, make: &MakeSource, moment: &Moment, light: Option<Wanted>) -> Shot {
    let (made, is_new) = match source {
        Some(source) => (Ok(source), false),
        None => (make(), true),
    };
    let mut source = match made {
        Ok(source) => source,
        Err(why) => return Shot::none(None, why),
    };
    if let Some(light) = light {
        auto::set(source.as_mut(), light);
    }
    let gain_db = if is_new || light.is_some() { source.gain().ok() } else { None };
    let series = catch_unwind(AssertUnwindSafe(|| source.next(moment))).unwrap_or_else(|panic| {
        let problem = format!("the camera panicked: {}", panic_text(panic.as_ref()));
        Err(CameraError::Unreadable { origin: format!("image {}", moment.image.0), problem })
    });
    let temperature_c = temperature_of(source.as_mut());
    Shot { source: Some(source), gain_db, temperature_c, image: series }
}

/// The first of several exposures, with the sum of all begun on the blocking pool.
async fn expecting_more(mut first: Series) -> Result<Series, Ended> {
    let job = tokio::task::spawn_blocking(move || {
        first.expect_more();
        first
    });
    job.await.map_err(|error| Ended(panic_message(error)))
}

/// An image with one more exposure, or with several, which are added to those before on the blocking pool.
async fn added(mut gathering: Gathering, new: Series) -> Result<Gathering, Ended> {
    let job = tokio::task::spawn_blocking(move || {
        let pushed: Result<(), CoaddError> = new.into_exposures().into_iter().try_for_each(|one| gathering.series.push(one));
        if let Err(error) = pushed {
            tracing::warn!(image = gathering.stamp.image.0, %error, "an exposure is not added to its image");
        }
        gathering
    });
    job.await.map_err(|error| Ended(panic_message(error)))
}

/// The camera's temperature; a driver that panics over it offers none, and the image is there all the same.
fn temperature_of(source: &mut dyn Source) -> Option<f64> {
    catch_unwind(AssertUnwindSafe(|| source.temperature())).ok().flatten().filter(|celsius| celsius.is_finite())
}
