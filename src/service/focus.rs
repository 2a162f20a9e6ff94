//! Focus: what the hub does for the autofocus. It brings it images and the lens's answers, and the lens its moves.

use super::housekeeping::Quantity;
use super::hub::Hub;
use super::state::{Finished, State};
use crate::command::{Command, OrderNumber, Refusal, Stage, Tick};
use crate::journal::{What, mark};
use crate::lens::autofocus::{
    self, Autofocus, AutofocusRules, Decision, Ending, Event, Finding, FocusImage, Learned, Mode, SweepPlan,
};
use crate::lens::{FocusCounts, LensCommand, LensError, LensResult, RequestCounter};
use crate::settings::FocusSettings;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::time::Instant;

/// Requests of the program itself are numbered from here, those of the ground below.
const OWN_REQUESTS: u32 = 1 << 31;

/// The autofocus, and what it waits for. It outlives the hub's actor, so that a run goes on when that is started again.
#[derive(Clone)]
pub struct Focus(Arc<Mutex<Desk>>);

struct Desk {
    autofocus: Autofocus,
    /// The order that a run belongs to.
    order: Option<OrderNumber>,
    /// The move that the run waits for.
    moving: Option<RequestCounter>,
    /// Requests made.
    requests: u32,
}

impl Focus {
    /// An autofocus by the settings, which knows what an earlier run of the program learned.
    pub fn new(settings: &FocusSettings, learned: &Learned) -> Self {
        let autofocus = Autofocus::knowing(AutofocusRules::new(settings), learned);
        Self(Arc::new(Mutex::new(Desk { autofocus, order: None, moving: None, requests: 0 })))
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        // Nothing can break between two steps of a change to it.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What it has learned.
    pub fn learned(&self) -> Learned {
        self.desk().autofocus.learned()
    }

    /// When to look at the time, if nothing happens before.
    pub fn deadline(&self) -> Option<Tick> {
        self.desk().autofocus.deadline()
    }

    /// Whether a run is under way.
    pub fn is_running(&self) -> bool {
        self.desk().order.is_some()
    }
}

impl Hub {
    /// Begins a run for an order.
    pub(super) fn begin_focus(&self, state: &mut State, number: OrderNumber, command: Command) -> Result<(), (Refusal, String)> {
        let settings = &state.settings.focus;
        let from = state.focus_known();
        let sweep = |advise_only| {
            let (min, max) = (FocusCounts(settings.search_min_counts), FocusCounts(settings.search_max_counts));
            Event::Run { plan: SweepPlan { min, max, step: settings.step_counts, advise_only }, from }
        };
        let event = match command {
            Command::AdviseFocus {} => sweep(true),
            Command::Refocus { step_counts } => Event::Refocus { by: step_counts, from },
            _ => sweep(false),
        };
        let now = self.clock.uptime();
        let decision = {
            let mut desk = self.focus.desk();
            if desk.order.is_some() {
                return Err((Refusal::Busy, "an autofocus is under way".to_owned()));
            }
            desk.order = Some(number);
            self.run_focus(&mut desk, now, event)
        };
        if let Decision::Refused(why) = decision {
            self.focus.desk().order = None;
            let refusal = if why == autofocus::Refusal::Busy { Refusal::Busy } else { Refusal::UnsafeState };
            return Err((refusal, why.to_string()));
        }
        self.follow_focus(state, now, decision);
        Ok(())
    }

    /// Tells the autofocus, and notes it.
    fn run_focus(&self, desk: &mut Desk, now: Tick, event: Event) -> Decision {
        let decision = desk.autofocus.on(now, event.clone());
        self.journal.note(now, What::Focus { event, led_to: mark(&decision) });
        decision
    }

    /// Something happened that the autofocus should know.
    pub(super) fn tell_focus(&self, state: &mut State, event: Event) {
        let now = self.clock.uptime();
        let decision = self.run_focus(&mut self.focus.desk(), now, event);
        self.follow_focus(state, now, decision);
    }

    /// An image ended: its stars say something of the focus, where the lens stood still for it.
    pub(super) fn show_focus(&self, state: &mut State, finished: &Finished) {
        let position = finished.outcome.stamp.focus_counts.map(FocusCounts);
        let captured = self.clock.tick(finished.captured);
        let temperature_c = state.measured.value(Quantity::TemperatureLens, Instant::now(), &state.settings);
        self.tell_focus(state, Event::Image(FocusImage::new(&finished.outcome, captured, position, temperature_c)));
    }

    /// The lens answered a request of ours; whether it was one.
    pub(super) fn take_own_move(&self, state: &mut State, counter: RequestCounter, result: &LensResult) -> bool {
        if counter.0 < OWN_REQUESTS {
            return false;
        }
        let expected = self.focus.desk().moving.take_if(|moving| *moving == counter && *result != LensResult::Started).is_some();
        if expected {
            let event = match (result, state.focus_known()) {
                (LensResult::Completed, Some(at)) => Event::Arrived(at),
                (LensResult::Completed, None) => Event::LensFailed("where it is, is not known".to_owned()),
                (LensResult::Failed(LensError::Stopped), _) => Event::Stop,
                (LensResult::Failed(error), _) => Event::LensFailed(error.to_string()),
                (LensResult::Started, _) => return true,
            };
            self.tell_focus(state, event);
        }
        true
    }

    fn follow_focus(&self, state: &mut State, now: Tick, decision: Decision) {
        match decision {
            Decision::Unchanged | Decision::Refused(_) => {}
            Decision::Move(to) => {
                let counter = {
                    let mut desk = self.focus.desk();
                    desk.requests = desk.requests.wrapping_add(1) & !OWN_REQUESTS;
                    let counter = RequestCounter(OWN_REQUESTS | desk.requests);
                    desk.moving = Some(counter);
                    counter
                };
                if let Err(error) = self.ask_lens(state, counter, LensCommand::SetFocus(to)) {
                    self.focus.desk().moving = None;
                    self.tell_focus(state, Event::LensFailed(error.to_string()));
                    return;
                }
            }
            Decision::Finished(finding) => {
                let order = self.focus.desk().order.take();
                self.focus.desk().moving = None;
                let (stage, why, words) = told(&finding);
                tracing::info!(?finding, "autofocus ended: {words}");
                if let Some(number) = order {
                    self.report(state, now, number, (stage, why, words));
                }
            }
        }
        let desk = self.focus.desk();
        let status = desk.autofocus.status(now);
        if status.mode != Mode::NotRunning {
            state.focus_curves = desk.autofocus.curves().into();
        }
        state.autofocus = Arc::new(status);
    }
}

/// What the ground is told of a finding.
fn told(finding: &Finding) -> (Stage, Option<Refusal>, String) {
    let best =
        finding.best.map_or_else(String::new, |best| format!("best {:.1} +- {:.1} counts", best.counts.value, best.counts.sigma));
    match &finding.ending {
        Ending::Found => (Stage::Completed, None, best),
        Ending::Better(_) => (Stage::Completed, None, "the stars are sharper".to_owned()),
        Ending::Worse(_) => (Stage::Completed, None, "not sharper: went back".to_owned()),
        Ending::Edge(side) => {
            (Stage::Failed, Some(Refusal::NoResult), format!("best focus at or beyond the {side:?} end").to_lowercase())
        }
        Ending::NoPeak => (Stage::Failed, Some(Refusal::NoResult), "no clear peak".to_owned()),
        Ending::TooFew => (Stage::Failed, Some(Refusal::NoResult), "too few images that could be used".to_owned()),
        Ending::NotConfirmed => (Stage::Failed, Some(Refusal::NoResult), format!("not as sharp there as it should be; {best}")),
        Ending::TimedOut => (Stage::Failed, Some(Refusal::NoResult), "the time allowed ended".to_owned()),
        Ending::Aborted => (Stage::Failed, Some(Refusal::Stopped), format!("aborted; {best}")),
        Ending::Stopped => (Stage::Failed, Some(Refusal::Stopped), "stopped".to_owned()),
        Ending::LensFailed(why) => (Stage::Failed, Some(Refusal::Device), format!("lens: {why}")),
    }
}
