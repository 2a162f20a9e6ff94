//! The site: what there is to serve, and what is ready to be sent.

use super::gather::snapshot;
use super::history::{Entry, History, Past};
use crate::display::{FrameView, Snapshot, draw, encode};
use crate::image::{Frame, ImageCounter};
use crate::service::clock::Clock;
use crate::service::replay::Again;
use crate::service::replayer::{MOST, ReplayError, Replayer};
use crate::service::state::{Shed, State};
use crate::settings::Settings;
use bytes::Bytes;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// After a picture was drawn the next one is drawn no sooner than so many times what it took: whoever asks for pictures without end gets
/// a fifth of a processor at most.
const RESTS_AFTER_DRAWING: u32 = 4;
/// While the computer is too slow for all of its work the state goes this seldom.
const PERIOD_WHEN_STRAINED: Duration = Duration::from_secs(2);

/// Why there is no picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NoPicture {
    /// There is no such frame, or its pixels are gone.
    Gone,
    /// The computer is too slow for all of its work, and pictures are what it leaves undone first.
    NoTime,
    /// Drawing broke.
    Broke,
}

/// What there is to serve.
pub struct Site {
    state: watch::Receiver<Arc<State>>,
    frames: watch::Receiver<Option<Arc<Frame>>>,
    clock: Clock,
    history: Mutex<History>,
    /// The newest state as an event, for all who read.
    published: watch::Sender<Bytes>,
    places: Arc<Semaphore>,
    /// Held by whoever draws.
    drawing: Arc<Semaphore>,
    /// The last picture drawn.
    picture: Mutex<Option<(ImageCounter, Bytes)>>,
    replayer: Replayer,
    stop: CancellationToken,
}

impl Site {
    /// By the settings of the start.
    pub fn new(
        settings: &Settings,
        state: watch::Receiver<Arc<State>>,
        frames: watch::Receiver<Option<Arc<Frame>>>,
        clock: Clock,
        replayer: Replayer,
        stop: CancellationToken,
    ) -> Self {
        Self {
            state,
            frames,
            clock,
            history: Mutex::new(History::new(&settings.display)),
            published: watch::channel(Bytes::new()).0,
            places: Arc::new(Semaphore::new(settings.display.max_clients as usize)),
            drawing: Arc::new(Semaphore::new(1)),
            picture: Mutex::default(),
            replayer,
            stop,
        }
    }

    /// The state, for whoever waits for the next one.
    pub fn watch(&self) -> watch::Receiver<Arc<State>> {
        self.state.clone()
    }

    /// The newest state.
    fn state(&self) -> Arc<State> {
        Arc::clone(&self.state.borrow())
    }

    /// Takes what is new; whether a frame ended.
    pub fn look(&self) -> bool {
        let state = self.state();
        let Some(finished) = &state.latest else { return false };
        let shown = self.frames.borrow().clone();
        self.history().take(finished, shown.as_ref(), &state.settings)
    }

    fn history(&self) -> MutexGuard<'_, History> {
        // Nothing can break between two steps of a change to it.
        self.history.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether anybody reads events.
    pub fn is_read(&self) -> bool {
        self.published.receiver_count() > 0
    }

    /// Time from one event to the next, unless a frame ends.
    pub fn period(&self) -> Duration {
        let state = self.state.borrow();
        if state.strain.shed() >= Shed::Display {
            return PERIOD_WHEN_STRAINED;
        }
        Duration::from_secs_f64(1.0 / state.settings.display.rate_hz)
    }

    /// Makes the newest state ready for all who read; each takes it when it can, or the one after.
    pub fn publish(&self) {
        self.published.send_replace(self.event());
    }

    /// The newest state as an event.
    pub fn event(&self) -> Bytes {
        // A state that can't be written as JSON there is none: a browser would see that nothing comes.
        let json = serde_json::to_string(&self.snapshot()).unwrap_or_default();
        Bytes::from(format!("retry: 1000\nevent: state\ndata: {json}\n\n"))
    }

    /// For whoever reads every event, or the newest.
    pub fn subscribe(&self) -> watch::Receiver<Bytes> {
        self.published.subscribe()
    }

    /// The newest state as it is shown.
    pub fn snapshot(&self) -> Snapshot {
        let state = self.state();
        let pixels = self.history().get(None).is_some_and(|past| past.frame.is_some());
        snapshot(&state, &self.clock, pixels)
    }

    /// All that is shown of a frame: the last, or the one of a number.
    pub fn view(&self, image: Option<u32>) -> Option<FrameView> {
        self.history().view(image, &self.state().settings)
    }

    /// The strip, and how many numbers were passed over.
    pub fn strip(&self) -> (Vec<Entry>, u64) {
        self.history().strip()
    }

    /// A frame's pixels.
    ///
    /// # Errors
    /// See [`NoPicture`].
    pub fn pixels(&self, image: Option<u32>) -> Result<Arc<Frame>, NoPicture> {
        self.has_time()?;
        self.history().get(image).and_then(|past| past.frame).ok_or(NoPicture::Gone)
    }

    fn has_time(&self) -> Result<(), NoPicture> {
        if self.state.borrow().strain.shed() >= Shed::Display { Err(NoPicture::NoTime) } else { Ok(()) }
    }

    /// A frame's picture, as PNG: drawn on the blocking pool, one at a time.
    ///
    /// # Errors
    /// See [`NoPicture`].
    pub async fn picture(&self, image: Option<u32>) -> Result<Bytes, NoPicture> {
        self.has_time()?;
        let drawing = Arc::clone(&self.drawing).acquire_owned().await.map_err(|_| NoPicture::Broke)?;
        let Past { finished, frame: Some(frame) } = self.history().get(image).ok_or(NoPicture::Gone)? else {
            return Err(NoPicture::Gone);
        };
        let number = finished.outcome.stamp.image;
        if let Some((drawn, bytes)) = &*self.drawn()
            && *drawn == number
        {
            return Ok(bytes.clone());
        }
        let settings = Arc::clone(&self.state().settings);
        let began = Instant::now();
        let job = tokio::task::spawn_blocking(move || {
            let past = Past { finished, frame: None };
            encode(&draw(&frame, &past.view(&settings)))
        });
        let bytes = Bytes::from(job.await.map_err(|_| NoPicture::Broke)?.map_err(|_| NoPicture::Broke)?);
        *self.drawn() = Some((number, bytes.clone()));
        let rest = began.elapsed() * RESTS_AFTER_DRAWING;
        tokio::spawn(async move {
            tokio::time::sleep(rest).await;
            drop(drawing);
        });
        Ok(bytes)
    }

    fn drawn(&self) -> MutexGuard<'_, Option<(ImageCounter, Bytes)>> {
        self.picture.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A frame, or all of the last, solved again beside live ones with `set` (`key=value`).
    ///
    /// # Errors
    /// See [`ReplayError`].
    pub async fn replay(&self, image: Option<ImageCounter>, set: Vec<String>) -> Result<Vec<Again>, ReplayError> {
        match image {
            Some(image) => self.replayer.run_image(image, set).await,
            None => self.replayer.run(MOST, set).await,
        }
    }

    /// A place for a connection, if there is one.
    pub fn place(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.places).try_acquire_owned().ok()
    }

    /// Ends when the service stops.
    pub async fn stopped(&self) {
        self.stop.cancelled().await;
    }
}
