//! The hub: the one owner of what is true now. It takes what the others tell, and publishes an immutable [`State`].

use super::archive::{self, ToArchive};
use super::camera;
use super::clock::Clock;
use super::focus::Focus;
use super::inbox::Inbox;
use super::journal;
use super::kept::{self, Kept};
use super::ledger::{self, Keep};
use super::lens;
use super::motion;
use super::pulse::Pulse;
use super::recorder;
use super::state::{Finished, Peer, Readiness, Restart, Settling, State};
use super::supervisor::Ended;
pub use super::told::{Handle, ToHub};
use crate::command::{
    Authenticity, BootId, Decision, Errand, Event, FlightComputer, OrderNumber, Refusal, Sender, Situation, Stage, Step, Tick,
    Verdict,
};
use crate::journal::{What, mark};
use crate::lens::autofocus;
use crate::settings::Settings;
use crate::sky::ClockComparison;
use crate::solve::Reason;
use crate::wire::{Commands, Status};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// The hub's actor.
#[derive(Clone)]
pub struct Hub {
    /// What it is told.
    pub inbox: Inbox<ToHub>,
    /// Where the state is published; a hub that is started again goes on from what was published last.
    pub state: Arc<watch::Sender<Arc<State>>>,
    /// Where outcomes go to be kept; `None` where they are not.
    pub recorder: Option<recorder::Handle>,
    /// Where outcomes go that belong to images which are kept.
    pub archives: Vec<archive::Handle>,
    /// The time that the arbitration counts in.
    pub clock: Clock,
    /// Where it is noted what the machines are told.
    pub journal: journal::Handle,
    /// Where what outlasts a restart is kept; `None` where it is not.
    pub ledger: Option<ledger::Handle>,
    /// Where requests to the camera go; `None` where there is none.
    pub camera: Option<camera::Handle>,
    /// Asks the lens for things.
    pub lens: lens::Handle,
    /// The autofocus.
    pub focus: Focus,
    /// Counts the wishes that the frame that is being solved be given up.
    pub abort_solver: watch::Sender<u32>,
    /// The settings of the start.
    pub initial: Arc<Settings>,
    /// Its own inbox, for what it spawns.
    pub own: Handle,
    /// When to end.
    pub stop: CancellationToken,
}

impl Hub {
    /// Runs until stopped; then what it was told before is still taken.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let mut inbox = self.inbox.open().await;
        let mut state = State::clone(&self.state.borrow());
        // Not known to be on disk: the first record goes there at once, and mends a damaged copy.
        let mut last = None;
        loop {
            let at = |tick: Option<Tick>| tick.map(|tick| self.clock.started() + tick);
            let (lapse, focus, order) = (at(state.charge.deadline()), at(self.focus.deadline()), at(state.desk.deadline()));
            tokio::select! {
                biased;
                Some(message) = inbox.recv() => self.take(&mut state, message),
                () = sleep_until(lapse) => self.arbitrate(&mut state, Event::Time, Instant::now()),
                () = sleep_until(state.lull_ends()) => self.reset_after_lull(&mut state),
                () = sleep_until(order) => drop(self.at_desk(&mut state, self.clock.uptime(), Errand::Expire)),
                () = sleep_until(state.strain.deadline()) => state.strain.calm(Instant::now()),
                () = sleep_until(focus) => self.tell_focus(&mut state, autofocus::Event::Time),
                () = self.stop.cancelled() => return Ok(()),
                () = pulse.rest() => continue,
            }
            state.focus_kept = kept::focus(&state);
            self.keep_what_changed(&mut state, &mut last);
            self.state.send_replace(Arc::new(state.clone()));
        }
    }

    /// Sends what outlasts a restart to the disk where it changed; where there is no room for it now, then the next time.
    fn keep_what_changed(&self, state: &mut State, last: &mut Option<Kept>) {
        let kept = Kept::of(state, self.focus.learned());
        let waited_for = state.settling.iter().any(|settling| settling.record > state.records_sent);
        if (last.as_ref() != Some(&kept) || waited_for) && self.keep(state, None, kept.clone()) == Some(true) {
            *last = Some(kept);
        }
    }

    /// Sends a record to the disk; whether there was room for it, and `None` where nothing is kept.
    fn keep(&self, state: &mut State, number: Option<OrderNumber>, kept: Kept) -> Option<bool> {
        let record = state.records_sent + 1;
        let sent = self.ledger.as_ref()?.try_send(Keep { number, record, kept }).is_ok();
        state.records_sent += u64::from(sent);
        Some(sent)
    }

    /// A record is on disk, or could not be brought there: the orders whose doing it has end.
    fn settle(&self, state: &mut State, record: u64, kept: &Result<(), String>) {
        let (done, waiting) = std::mem::take(&mut state.settling).into_iter().partition(|settling| settling.record <= record);
        state.settling = waiting;
        let done: Vec<Settling> = done;
        for Settling { number, words, .. } in done {
            let words = kept.as_ref().map_or_else(|why| format!("done, but not kept over a restart: {why}"), |()| words);
            self.take_result(state, number, Ok(words));
        }
    }

    /// Takes what it was told into the state.
    fn take(&self, state: &mut State, message: ToHub) {
        let counters = &mut state.counters;
        match message {
            ToHub::Captured { next } => {
                counters.next_image = next;
                counters.frames_taken = counters.frames_taken.saturating_add(1);
            }
            ToHub::Camera(camera) => state.camera = camera,
            ToHub::Triggers(triggers) => state.triggers = triggers,
            ToHub::Readiness(readiness) if readiness != state.readiness => {
                let uptime_s = format_args!("{:.2}", self.clock.uptime().as_secs_f64());
                match &readiness {
                    Readiness::Broken(why) => tracing::error!(why, %uptime_s, "frames cannot be solved"),
                    now => tracing::info!(%uptime_s, "solver: {now:?}"),
                }
                state.readiness = readiness;
            }
            ToHub::Readiness(_) => {}
            ToHub::Solving(image) => state.solving = image,
            ToHub::Finished(finished) => self.take_outcome(state, Arc::from(finished)),
            ToHub::Connected { computer, connection, boot } => self.take_connection(state, computer, connection, boot),
            ToHub::Status { computer, connection, status, at, hears_us } => {
                if state.is_current(computer, connection) {
                    let uptime = Duration::try_from_secs_f64(status.uptime_s).ok();
                    self.take_status(state, computer, status, at, uptime, hears_us);
                }
            }
            ToHub::Commands { computer, connection, block, delay, authenticity } => {
                if state.is_current(computer, connection) {
                    self.take_block(state, computer, &block, delay, authenticity);
                }
            }
            ToHub::Gyro { computer, connection, gyro } => {
                let in_charge = state.in_charge().is_some_and(|lease| lease.computer == computer);
                if state.is_current(computer, connection) && in_charge {
                    let judged = motion::judge(&gyro, state);
                    state.motions.take(judged, Instant::now());
                }
            }
            ToHub::LegacyConnected { computer, connection } => self.take_legacy_connection(state, computer, connection),
            ToHub::LegacyBlock { computer, connection, block, at } => {
                if state.is_current(computer, connection) {
                    self.take_legacy_block(state, computer, &block, at);
                }
            }
            ToHub::Kept { number, record, kept } => {
                self.settle(state, record, &kept);
                self.take_kept(state, number, kept);
            }
            ToHub::Program { number, result } => {
                self.take_result(state, number, result.map(|()| String::new()).map_err(|why| (Refusal::Program, why)))
            }
            ToHub::Gain { number, result } => {
                state.camera_gain = result.as_ref().ok().copied();
                let words = result.map(|gain_db| format!("{gain_db} dB"));
                self.take_result(state, number, words.map_err(|why| (Refusal::Device, why)));
            }
            ToHub::Closed { connection, why } => {
                let count = counters.closed.entry(why).or_default();
                *count = count.saturating_add(1);
                self.take_end(state, connection);
            }
            ToHub::Recorded => counters.records_written = counters.records_written.saturating_add(1),
            ToHub::RecordLost => counters.records_lost = counters.records_lost.saturating_add(1),
            ToHub::DiskError => counters.disk_errors = counters.disk_errors.saturating_add(1),
            ToHub::Image(disk, news) => state.note_image(disk, news),
            ToHub::Late => state.strain.sign(Instant::now()),
            ToHub::Lens(lens) => {
                state.lens = Arc::from(lens);
                self.tell_rest(state);
            }
            ToHub::LensResult { counter, result } => self.take_lens_result(state, self.clock.uptime(), counter, &result),
            ToHub::Measured(measured) => state.measured = Arc::from(measured),
            ToHub::Restarted { actor, why } => {
                state.restarts.insert(actor, Restart { why: why.into(), at: Instant::now() });
                let count = counters.restarts.entry(actor).or_default();
                *count = count.saturating_add(1);
            }
        }
    }

    fn take_outcome(&self, state: &mut State, finished: Arc<Finished>) {
        let outcome = &finished.outcome;
        log_outcome(&finished);
        if finished.picture.is_none() {
            let (image, reason, detail) = (outcome.stamp.image, outcome.reason, outcome.detail.clone());
            self.journal.note(self.clock.tick(finished.captured), What::Ended { image, reason, detail });
        }
        let counters = &mut state.counters;
        let counter = match outcome.reason {
            Reason::Solved => Some(&mut counters.frames_solved),
            Reason::Skipped => Some(&mut counters.frames_skipped),
            Reason::Unreadable => Some(&mut counters.frames_unreadable),
            _ => None,
        };
        if let Some(counter) = counter {
            *counter = counter.saturating_add(1);
        }
        if state.solving == Some(outcome.stamp.image) {
            state.solving = None;
        }
        if let Some(recorder) = &self.recorder
            && recorder.try_send(Arc::clone(&finished)).is_err()
        {
            counters.records_lost = counters.records_lost.saturating_add(1);
        }
        for archive in &self.archives {
            // Where there is no room for it now, the image is kept without its outcome.
            let _ = archive.try_send(ToArchive::Outcome(Arc::clone(&finished)));
        }
        if outcome.reason == Reason::Solved {
            state.last_solved = Some(finished.captured);
        }
        self.show_focus(state, &finished);
        if finished.outcome.reason != Reason::Skipped {
            state.latest = Some(finished);
        }
    }

    pub(super) fn take_connection(&self, state: &mut State, computer: FlightComputer, connection: u64, boot: BootId) {
        if state.has_replaced(computer, connection) {
            return; // It was overtaken by a later connection of the same computer, and will see that itself.
        }
        let now = Instant::now();
        state.peers.retain(|peer| peer.computer != computer);
        state.peers.push(Peer { computer, boot, connection, connected: now, status: None, clock: ClockComparison::default() });
        self.at_desk(state, self.clock.uptime(), Errand::Begin { computer, boot });
        self.arbitrate(state, Event::Connected { computer, boot }, now);
    }

    /// What a computer says of itself; `uptime`: where it says how long it has been running.
    pub(super) fn take_status(
        &self,
        state: &mut State,
        computer: FlightComputer,
        status: Box<Status>,
        at: Instant,
        uptime: Option<Duration>,
        hears_us: bool,
    ) {
        let Some(peer) = state.peers.iter_mut().find(|peer| peer.computer == computer) else { return };
        state.heard = at;
        let claims = status.claims_charge;
        let observer = status.observer();
        if let Some(theirs) = status.clock.clock_unix_s.get() {
            // Against the clock that never jumps, so that nothing which is done to ours changes it.
            peer.clock.note(self.clock.tick(at), self.clock.tick(at).as_secs_f64(), *theirs);
        }
        peer.status = Some((Arc::from(status), at));
        self.arbitrate(state, Event::Status { from: computer, claims, uptime, hears_us }, Instant::now());
        if state.in_charge().is_some_and(|lease| lease.computer == computer)
            && let Some(observer) = observer
        {
            state.observer = Some((observer, at));
        }
    }

    /// A block of commands: the guard judges it, and what it lets through is kept before it is done.
    fn take_block(
        &self,
        state: &mut State,
        computer: FlightComputer,
        block: &Commands,
        delay: Duration,
        authenticity: Authenticity,
    ) {
        let Some(boot) = state.peers.iter().find(|peer| peer.computer == computer).map(|peer| peer.boot) else { return };
        let now = self.clock.uptime();
        self.at_desk(state, now, Errand::Acknowledge { computer, serial: block.acknowledged.get() });
        let block_boot = BootId(block.boot_id.get());
        let sender = Sender { computer, boot, block_boot, under: Some(block.under()), delay, authenticity };
        let situation = Situation {
            lease: state.in_charge(),
            ours: BootId(self.clock.boot_id()),
            window_s: state.settings.commands.window_s,
        };
        let slots = block.slots();
        let verdicts = state.guard.on(&sender, &situation, &slots);
        self.journal.note(now, What::Block { sender, situation, slots, led_to: mark(&verdicts) });
        for verdict in verdicts {
            self.take_verdict(state, now, computer, verdict);
        }
    }

    /// A verdict goes to the desk; what is refused stands in the log as often as a reply tells it.
    pub(super) fn take_verdict(&self, state: &mut State, now: Tick, computer: FlightComputer, verdict: Verdict) {
        let before = state.desk.replies.last().map(|reply| reply.serial);
        let errand = Errand::Take { from: computer, verdict, focus: state.focus() };
        let step = self.at_desk(state, now, errand);
        if let Some(reply) = state.desk.replies.last()
            && reply.stage == Stage::Rejected
            && Some(reply.serial) != before
        {
            let (code, counter, why, detail) = (reply.code, reply.counter, reply.why, &reply.detail);
            tracing::info!(computer = computer.0, code, counter, ?why, detail, "command refused");
        }
        self.follow(state, now, step);
    }

    /// Takes the next step of an order.
    pub(super) fn follow(&self, state: &mut State, now: Tick, step: Option<Step>) {
        match step {
            None => {}
            Some(Step::Do(number, command)) => self.carry_out(state, now, number, command),
            Some(Step::Keep { number, waits }) => {
                let kept = Kept::of(state, self.focus.learned());
                match self.keep(state, Some(number), kept) {
                    _ if !waits => self.take_step(state, number, Ok(())),
                    Some(true) => {}
                    Some(false) => self.take_kept(state, Some(number), Err("the disk is behind".to_owned())),
                    None => self.take_kept(state, Some(number), Ok(())),
                }
            }
        }
    }

    fn take_kept(&self, state: &mut State, number: Option<OrderNumber>, kept: Result<(), String>) {
        state.counters_kept = kept.is_ok() && self.ledger.is_some();
        if let Err(problem) = &kept {
            tracing::error!(problem, "what outlasts a restart cannot be kept");
        }
        if let Some(number) = number {
            self.take_step(state, number, kept);
        }
    }

    /// An order goes on: its counter is on disk, it does not wait for that, or it fails for want of it.
    fn take_step(&self, state: &mut State, number: OrderNumber, kept: Result<(), String>) {
        let now = self.clock.uptime();
        let step = self.at_desk(state, now, Errand::Kept { number, kept });
        self.follow(state, now, step);
    }

    /// The result of an order that took its time.
    fn take_result(&self, state: &mut State, number: OrderNumber, result: Result<String, (Refusal, String)>) {
        let (stage, why, words) = match result {
            Ok(words) => (Stage::Completed, None, words),
            Err((why, words)) => (Stage::Failed, Some(why), words),
        };
        self.report(state, self.clock.uptime(), number, (stage, why, words));
    }

    fn take_end(&self, state: &mut State, connection: u64) {
        if let Some(place) = state.peers.iter().position(|peer| peer.connection == connection) {
            let peer = state.peers.swap_remove(place);
            self.arbitrate(state, Event::Disconnected(peer.computer), Instant::now());
        }
    }

    fn arbitrate(&self, state: &mut State, event: Event, now: Instant) {
        let before = state.in_charge();
        let tick = self.clock.tick(now);
        let decision = state.charge.on(tick, event);
        self.journal.note(tick, What::Charge { event, led_to: mark(&decision) });
        match decision {
            Decision::Unchanged | Decision::Stranger(_) => {}
            Decision::Granted(to) => tracing::info!(to = to.computer.0, epoch = to.epoch.0, "in charge"),
            Decision::Moved { from, to } => {
                tracing::info!(from = from.0, to = to.computer.0, epoch = to.epoch.0, "charge went over")
            }
            Decision::Ended { from, lapsed } => tracing::info!(from = from.0, lapsed, "nobody is in charge"),
        }
        if before != state.in_charge() {
            self.at_desk(state, tick, Errand::Disarm);
        }
    }

    /// Brings an errand to the desk; what is to be done then.
    pub(super) fn at_desk(&self, state: &mut State, now: Tick, errand: Errand) -> Option<Step> {
        let step = state.desk.on(now, errand.clone());
        self.journal.note(now, What::Desk { errand, led_to: mark(&(step, state.desk.replies.last())) });
        step
    }

    /// Tells the desk how far an order is: its stage, why no further, and in words.
    pub(super) fn report(&self, state: &mut State, now: Tick, number: OrderNumber, said: (Stage, Option<Refusal>, String)) {
        let (stage, why, detail) = said;
        self.at_desk(state, now, Errand::Report { number, stage, why, detail });
    }
}

/// Sleeps until then; for ever, where there is no then.
pub async fn sleep_until(moment: Option<Instant>) {
    match moment {
        Some(moment) => tokio::time::sleep_until(moment).await,
        None => std::future::pending().await,
    }
}

/// One line for each outcome: what the flight computers are told, in short.
fn log_outcome(finished: &Finished) {
    let report = &finished.report;
    let (image, origin, reason) = (report.image_counter, report.image.as_str(), report.reason);
    let ms = format_args!("{:.1}", report.time_ms.total);
    let pointing = &report.pointing;
    match (pointing.ra_deg, pointing.dec_deg, pointing.roll_deg) {
        (Some(ra), Some(dec), Some(roll)) => {
            let (ra_deg, dec_deg, roll_deg) = (format_args!("{ra:.5}"), format_args!("{dec:.5}"), format_args!("{roll:.4}"));
            tracing::info!(image, origin, %ra_deg, %dec_deg, %roll_deg, matched = report.matched, %ms, "solved");
        }
        _ => tracing::info!(image, origin, %reason, detail = report.detail, %ms, "not solved"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Guard;
    use crate::image::ImageCounter;
    use crate::image::Stamp;
    use crate::service::inbox;
    use crate::service::session::Closed;
    use crate::solve::Outcome;
    use std::time::Duration;
    use tokio::sync::mpsc;

    fn hub(own: mpsc::Sender<ToHub>, inbox: Inbox<ToHub>) -> (Hub, watch::Receiver<Arc<State>>) {
        let settings = Arc::new(Settings::flight().unwrap());
        let (publish, state) = watch::channel(Arc::new(State::new(Arc::clone(&settings), Guard::default())));
        let hub = Hub {
            inbox,
            state: Arc::new(publish),
            recorder: None,
            archives: Vec::new(),
            clock: Clock::start(),
            journal: journal::Handle::default(),
            ledger: None,
            camera: None,
            lens: lens::Handle::new(mpsc::channel(1).0),
            focus: Focus::new(&settings.focus, &autofocus::Learned::default()),
            abort_solver: watch::channel(0).0,
            initial: settings,
            own: Handle::new(own),
            stop: CancellationToken::new(),
        };
        (hub, state)
    }

    fn finished(image: u32, reason: Reason) -> ToHub {
        let stamp = Stamp { image: ImageCounter(image), ..Stamp::default() };
        ToHub::Finished(Box::new(Finished::without_stars(Outcome::unsolved(stamp, reason, ""), Instant::now())))
    }

    #[tokio::test]
    async fn a_hub_that_is_started_again_goes_on_from_what_was_published() {
        let (sender, inbox) = inbox::channel(8);
        let (hub, state) = hub(sender.clone(), inbox);
        sender.send(ToHub::Captured { next: ImageCounter(4) }).await.unwrap();
        sender.send(finished(3, Reason::NoMatch)).await.unwrap();
        let first = tokio::spawn(hub.clone().run(Pulse::new()));
        state.clone().wait_for(|state| state.latest.is_some()).await.unwrap();
        first.abort();
        assert!(first.await.unwrap_err().is_cancelled());
        sender.send(ToHub::Captured { next: ImageCounter(5) }).await.unwrap();
        tokio::spawn(hub.run(Pulse::new()));
        let now = Arc::clone(&*state.clone().wait_for(|state| state.counters.next_image.0 == 5).await.unwrap());
        assert_eq!(now.counters.frames_taken, 2);
        assert_eq!(now.latest.as_ref().unwrap().outcome.stamp.image, ImageCounter(3));
    }

    #[tokio::test]
    async fn a_skipped_frame_is_counted_and_does_not_hide_the_last_outcome() {
        let (sender, inbox) = inbox::channel(8);
        let (hub, state) = hub(sender.clone(), inbox);
        tokio::spawn(hub.run(Pulse::new()));
        sender.send(finished(3, Reason::NoMatch)).await.unwrap();
        sender.send(finished(4, Reason::Skipped)).await.unwrap();
        let now = Arc::clone(&*state.clone().wait_for(|state| state.counters.frames_skipped == 1).await.unwrap());
        assert_eq!(now.latest.as_ref().unwrap().outcome.stamp.image, ImageCounter(3));
    }

    #[tokio::test(start_paused = true)]
    async fn the_end_of_an_old_connection_does_not_touch_the_new_one() {
        let (sender, inbox) = inbox::channel(8);
        let (hub, state) = hub(sender.clone(), inbox);
        tokio::spawn(hub.run(Pulse::new()));
        let computer = FlightComputer(1);
        let status = Status { claims_charge: true, ..Status::default() };
        let said =
            |connection| ToHub::Status { computer, connection, status: Box::new(status), at: Instant::now(), hears_us: true };
        let connected = |connection| ToHub::Connected { computer, connection, boot: BootId(9) };
        let old = [connected(1), said(1), connected(2)];
        let late = [said(2), said(1), ToHub::Closed { connection: 1, why: Closed::Replaced }];
        for message in old.into_iter().chain(late).chain([connected(1)]) {
            sender.send(message).await.unwrap();
        }
        // A claim that came back after a break must last before it counts.
        tokio::time::sleep(crate::command::LASTING + Duration::from_millis(1)).await;
        let now = Arc::clone(&*state.borrow());
        assert_eq!(now.peers.len(), 1);
        assert_eq!(now.peers[0].connection, 2);
        assert_eq!(now.in_charge().map(|lease| lease.computer), Some(computer));
    }
}
