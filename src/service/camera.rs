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
use crate::image::{ExposedBy, Frame, ImageCounter, Series, Stamp};
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
}

/// What the blocking pool gives back: the source for the next time, and the image.
struct Shot {
    source: Option<Box<dyn Source>>,
    /// The gain of a source that was made for this frame, dB, where it has one.
    gain_db: Option<f64>,
    /// The camera's temperature, °C, where it offers one.
    temperature_c: Option<f64>,
    image: Result<Taken, CameraError>,
}

/// An image that was taken.
struct Taken {
    /// Its exposures, which are kept.
    series: Series,
    /// Their sum, which is solved; `None` where there is one alone.
    sum: Option<Frame>,
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
        let mut held = Held { source: None, triggers, look: first, auto: Auto::default() };
        let mut inbox = self.inbox.open().await;
        loop {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => return Ok(()),
                Some(request) = inbox.recv() => {
                    held.auto.note_request(&request);
                    held.source = self.answer(held.source.take(), request).await?;
                }
                _ = schedule.tick(), if held.triggers.exposing() != ExposedBy::Trigger => {
                    pulse.give_up(self.left_behind.too_many());
                    self.take_one(&mut held, Ask::Expose).await?;
                }
                () = sleep_until(held.look), if held.triggers.exposing() != ExposedBy::Asked => {
                    pulse.give_up(self.left_behind.too_many());
                    self.take_one(&mut held, Ask::Triggered(WAIT)).await?;
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

    /// Takes one frame on its way; puts the source back. When it is to end, a source that is slow is left behind; a frame that
    /// has its number is not.
    async fn take_one(&self, held: &mut Held, ask: Ask) -> Result<(), Ended> {
        let at = Instant::now();
        let image = ImageCounter(self.numbers.load(Ordering::Relaxed));
        let uptime = self.clock.tick(at);
        let state = Arc::clone(&self.state.borrow());
        let make = Arc::clone(&self.make);
        let ClockReading { utc, quality, sigma_s } = state.time(uptime, self.clock.time());
        let moment = Moment { image, uptime, utc, quality, sigma_s, ask };
        let source = held.source.take();
        let light = held.auto.next(&state);
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
        match taken {
            Ok(Taken { mut series, mut sum }) => {
                let asked = held.triggers.exposing() == ExposedBy::Asked;
                let stamp = |stamp: &mut Stamp| {
                    stamp.exposed_by = stamp.exposed_by.or(asked.then_some(ExposedBy::Asked));
                    self.number(image, &state, stamp);
                    stamp.temperature_camera_c = stamp.temperature_camera_c.or(temperature_c);
                    // What was set for this frame is not in the state yet.
                    stamp.gain_db = stamp.gain_db.or(gain_db);
                    self.note_instrument(&state, at, stamp);
                };
                series.stamp(stamp);
                sum.iter_mut().for_each(|sum| stamp(&mut sum.stamp));
                let exposures: Vec<Arc<Frame>> = series.into_exposures().into_iter().map(Arc::new).collect();
                // Before anything is waited for: whatever becomes of this actor, the exposures are where they are kept.
                let lost = self.keep(&state, &exposures);
                held.auto.note(sum.as_ref().or_else(|| exposures.first().map(|frame| &**frame)));
                let Some(frame) = sum.map(Arc::new).or_else(|| exposures.first().cloned()) else { return Ok(()) };
                if frame.stamp.exposed_by == Some(ExposedBy::Trigger) {
                    self.watch(&mut held.triggers, TriggerEvent::Triggered).await;
                }
                self.count(&frame.stamp).await;
                for disk in lost {
                    self.hub.tell(ToHub::Image(disk, ImageNews::Lost)).await;
                }
                self.tell(&state, CameraState::Working).await;
                let prior = state.prior(at, &state.settings.observer);
                let captured = Captured { frame, exposures, at, prior, motion: None };
                self.solver.send(captured).await.map_err(|_| Ended("the solver's inbox is gone".to_owned()))?;
                self.set_open(None);
            }
            Err(CameraError::Unreadable { origin, problem }) => {
                let mut stamp = Stamp { origin, ..Stamp::default() };
                self.number(image, &state, &mut stamp);
                self.count(&stamp).await;
                self.tell(&state, CameraState::Working).await;
                let outcome = Outcome::unsolved(stamp, Reason::Unreadable, problem);
                self.hub.tell(ToHub::Finished(Box::new(Finished::without_stars(outcome, at)))).await;
                self.set_open(None);
            }
            Err(CameraError::NothingNew) if held.triggers.exposing() != ExposedBy::Asked => {
                self.tell(&state, CameraState::Waiting).await;
            }
            Err(none) => {
                held.look = Instant::now() + AWAY;
                self.tell(&state, CameraState::Unavailable(none.to_string())).await;
            }
        }
        Ok(())
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
    let image = series.map(|series| Taken { sum: series.sum(), series });
    let temperature_c = temperature_of(source.as_mut());
    Shot { source: Some(source), gain_db, temperature_c, image }
}

/// The camera's temperature; a driver that panics over it offers none, and the image is there all the same.
fn temperature_of(source: &mut dyn Source) -> Option<f64> {
    catch_unwind(AssertUnwindSafe(|| source.temperature())).ok().flatten().filter(|celsius| celsius.is_finite())
}
