//! The lens's actor: carries bytes, time and requests to the state machine of the lens room, and its answers home.
//!
//! It never waits for the port: words are short, and a port that takes none is lost. A stop therefore reaches the machine
//! at once, whatever the controller does.

mod alone;
mod port;
#[cfg_attr(not(unix), path = "no_terminal.rs")]
mod simulated;

pub use alone::LensAlone;
pub use port::{Ports, serial_ports};
pub use simulated::SimulatedLens;

use super::clock::Clock;
use super::hub::{self, ToHub};
use super::inbox::Inbox;
use super::journal;
use super::pulse::Pulse;
use super::supervisor::Ended;
use crate::journal::{What, mark};
use crate::lens::{
    Action, Control, Doubt, Event, FocusKept, LensCommand, LensError, LensResult, LensState, RequestCounter, Rules,
};
use port::{Opening, Port};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use tokio::sync::mpsc;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// What the lens's actor is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ToLens {
    /// A request. It is answered with the same number: at most once that it started, and once how it ended.
    Request {
        /// Its number.
        counter: RequestCounter,
        /// What is asked.
        command: LensCommand,
    },
}

/// Asks the lens for things.
#[derive(Debug, Clone)]
pub struct Handle(mpsc::Sender<ToLens>);

impl Handle {
    /// A handle on the sending end of the lens's inbox.
    pub fn new(sender: mpsc::Sender<ToLens>) -> Self {
        Self(sender)
    }

    /// Asks, without waiting. The answer comes to the hub.
    ///
    /// # Errors
    /// [`LensError::Busy`] where too much waits for the lens, and the request is not taken.
    pub fn request(&self, counter: RequestCounter, command: LensCommand) -> Result<(), LensError> {
        self.0.try_send(ToLens::Request { counter, command }).map_err(|_| LensError::Busy)
    }
}

/// What is known of the focus from before.
pub type FocusBefore = Arc<dyn Fn() -> FocusKept + Send + Sync>;

/// The lens's actor.
#[derive(Clone)]
pub struct LensActor {
    /// What it is told.
    pub inbox: Inbox<ToLens>,
    /// Whom it answers.
    pub hub: hub::Handle,
    /// Where a controller may be; `None` where there is no lens.
    pub ports: Option<Ports>,
    /// Times, tolerances and permissions.
    pub rules: Rules,
    /// What is known of the focus from before, when the actor starts.
    pub focus_before: FocusBefore,
    /// Requests that were not answered to their end; they outlive the actor, so that each is answered.
    pub open: Arc<Mutex<BTreeSet<RequestCounter>>>,
    /// Where it is noted what the machine is told.
    pub journal: journal::Handle,
    /// The service's clock.
    pub clock: Clock,
    /// When to end.
    pub stop: CancellationToken,
}

/// What the actor has of the outside.
struct Outside {
    ports: Ports,
    port: Option<Port>,
    opening: Opening,
}

impl LensActor {
    /// Runs until stopped.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let lost: Vec<RequestCounter> =
            std::mem::take(&mut *self.open.lock().unwrap_or_else(PoisonError::into_inner)).into_iter().collect();
        for counter in lost {
            self.hub.tell(ToHub::LensResult { counter, result: LensResult::Failed(LensError::Restarted) }).await;
        }
        match self.ports.clone() {
            Some(ports) => self.control(&pulse, Outside { ports, port: None, opening: Opening::default() }).await,
            None => self.refuse(&pulse).await,
        }
    }

    /// There is no lens: whatever is asked is refused.
    async fn refuse(self, pulse: &Pulse) -> Result<(), Ended> {
        self.hub.tell(ToHub::Lens(Box::new(LensState::unknown(Doubt::NoLens)))).await;
        let mut inbox = self.inbox.open().await;
        loop {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => return Ok(()),
                Some(ToLens::Request { counter, .. }) = inbox.recv() => {
                    self.hub.tell(ToHub::LensResult { counter, result: LensResult::Failed(LensError::NotThere) }).await;
                }
                () = pulse.rest() => {}
            }
        }
    }

    async fn control(self, pulse: &Pulse, mut outside: Outside) -> Result<(), Ended> {
        let mut inbox = self.inbox.open().await;
        let before = (self.focus_before)();
        self.journal.note(self.clock.uptime(), What::LensBegins { rules: self.rules.clone(), before });
        let mut control = Control::resuming(self.rules.clone(), before);
        let mut told = None;
        loop {
            let deadline = control.deadline().map(|tick| self.clock.started() + tick);
            let event = tokio::select! {
                biased;
                () = self.stop.cancelled() => return Ok(()),
                Some(first) = inbox.recv() => self.take_all(first, &mut inbox),
                event = outside.next() => event,
                () = hub::sleep_until(deadline) => Event::Time,
                () = pulse.rest() => continue,
            };
            self.carry_out(&mut control, event, &mut outside, &mut told).await;
        }
    }

    /// All that was asked by now, so that a stop comes before the moves that it overtook.
    fn take_all(&self, first: ToLens, inbox: &mut mpsc::Receiver<ToLens>) -> Event {
        let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Vec::new();
        let mut next = Some(first);
        while let Some(ToLens::Request { counter, command }) = next {
            open.insert(counter);
            all.push((counter, command));
            next = inbox.try_recv().ok();
        }
        Event::Requests(all)
    }

    /// Tells the machine, and does what it wants. The hub knows that something will move before it is told to.
    async fn carry_out(&self, control: &mut Control, event: Event, outside: &mut Outside, told: &mut Option<LensState>) {
        let mut event = Some(event);
        while let Some(now) = event.take() {
            let tick = self.clock.tick(Instant::now());
            let actions = control.on(tick, now.clone());
            self.journal.note(tick, What::Lens { event: now, led_to: mark(&actions) });
            let state = control.state();
            if told.as_ref() != Some(&state) {
                self.hub.tell(ToHub::Lens(Box::new(state.clone()))).await;
                *told = Some(state);
            }
            for action in actions {
                match action {
                    Action::Open { nth } => outside.open(nth),
                    Action::Close => outside.port = None,
                    Action::Send(bytes) => event = outside.send(&bytes).err().map(|why| Event::Lost { why }).or(event),
                    Action::Answer { counter, result } => self.answer(counter, result).await,
                }
            }
        }
    }

    async fn answer(&self, counter: RequestCounter, result: LensResult) {
        if result != LensResult::Started {
            self.open.lock().unwrap_or_else(PoisonError::into_inner).remove(&counter);
        }
        self.hub.tell(ToHub::LensResult { counter, result }).await;
    }
}

impl Outside {
    /// The next thing that happens on the port, or to one that is being opened.
    async fn next(&mut self) -> Event {
        if let Some(port) = &mut self.port {
            return match port.line().await {
                Ok(line) => Event::Line(line),
                Err(why) => {
                    self.port = None;
                    Event::Lost { why }
                }
            };
        }
        let (path, opened) = self.opening.done().await;
        match opened {
            Ok(port) => {
                self.port = Some(port);
                Event::Opened { port: path }
            }
            Err(port::NotOpened::NoMore) => Event::NoMorePorts,
            Err(port::NotOpened::Because(why)) => Event::NotOpened { why: format!("{path}: {why}") },
        }
    }

    fn open(&mut self, nth: usize) {
        self.port = None;
        self.opening.begin(self.ports.nth(nth));
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), String> {
        match &mut self.port {
            Some(port) => port.send(bytes),
            None => Ok(()), // It is lost already, and the machine has been told or is about to be.
        }
    }
}
