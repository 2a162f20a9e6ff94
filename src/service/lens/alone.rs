//! The lens without the rest of the service: for trials of a lens, and of the actor.

use super::{Handle, LensActor, SimulatedLens, serial_ports};
use crate::lens::{Doubt, FocusKept, LensResult, LensState, RequestCounter, Rules};
use crate::service::clock::Clock;
use crate::service::hub::{self, ToHub};
use crate::service::inbox;
use crate::service::journal;
use crate::service::pulse::Pulse;
use crate::settings::LensSettings;
use std::sync::Arc;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::{CancellationToken, DropGuard};

/// Messages that may wait in each direction.
const QUEUE: usize = 64;

/// A lens and its actor, which end when this is dropped.
pub struct LensAlone {
    handle: Handle,
    state: watch::Receiver<LensState>,
    answers: mpsc::Receiver<(RequestCounter, LensResult)>,
    _stop: DropGuard,
}

impl LensAlone {
    /// Starts the lens of the settings; `simulated` where it is one.
    pub fn start(settings: &LensSettings, simulated: Option<&SimulatedLens>) -> Self {
        let stop = CancellationToken::new();
        let (to_hub, hub_inbox) = inbox::channel(QUEUE);
        let (to_lens, inbox) = inbox::channel(QUEUE);
        let actor = LensActor {
            inbox,
            hub: hub::Handle::new(to_hub),
            ports: simulated.map(SimulatedLens::ports).or_else(|| serial_ports(settings)),
            rules: Rules::of(settings),
            focus_before: Arc::new(FocusKept::default),
            open: Arc::default(),
            journal: journal::Handle::default(),
            clock: Clock::start(),
            stop: stop.clone(),
        };
        tokio::spawn(actor.run(Pulse::new()));
        if let Some(simulated) = simulated {
            tokio::spawn(simulated.clone().run(stop.clone()));
        }
        let (publish, state) = watch::channel(LensState::unknown(Doubt::NeverRead));
        let (answer, answers) = mpsc::channel(QUEUE);
        tokio::spawn(async move {
            let mut inbox = hub_inbox.open().await;
            while let Some(message) = inbox.recv().await {
                match message {
                    ToHub::Lens(lens) => drop(publish.send_replace(*lens)),
                    ToHub::LensResult { counter, result } => drop(answer.send((counter, result)).await),
                    _ => {}
                }
            }
        });
        Self { handle: Handle::new(to_lens), state, answers, _stop: stop.drop_guard() }
    }

    /// Asks the lens for things.
    pub fn handle(&self) -> &Handle {
        &self.handle
    }

    /// What is known of it now.
    pub fn state(&self) -> LensState {
        self.state.borrow().clone()
    }

    /// The next answer.
    pub async fn answer(&mut self) -> Option<(RequestCounter, LensResult)> {
        self.answers.recv().await
    }
}
