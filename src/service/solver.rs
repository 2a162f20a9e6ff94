//! The solver's actor: one frame at a time on the blocking pool.
//!
//! While a frame is being solved the newest of those that come waits; the one that it replaces ends as `skipped`. A frame
//! is given up when it is too old or the service stops; a solver that panics, or does not stop when told, ends its frame as
//! `failed` and is made anew. Every frame ends in one outcome.

use super::clock::Clock;
use super::hub::{self, ToHub, sleep_until};
use super::inbox::Inbox;
use super::journal::{self, SolvedNote};
use super::left_behind::LeftBehind;
use super::pulse::Pulse;
use super::state::{Finished, Readiness, Shed, State};
use super::supervisor::{Ended, panic_message};
use crate::image::{Frame, ImageCounter};
use crate::journal::What;
use crate::settings::Settings;
use crate::solve::{Exposures, Motion, Outcome, Prior, Reason, Report, Stop, Tracker, Watch, Window, Witness};
use crate::wire::legacy::Picture;
use std::collections::BTreeMap;
use std::pin::pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::task::JoinHandle;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// A solver that was told to stop and has not within this time is taken to hang; 20 ms are what it promises.
const GRACE: Duration = Duration::from_secs(1);
/// A frame that is still being solved so long after the service was told to stop is given up: less than its stage has.
const LAST_FRAME: Duration = Duration::from_millis(300);

/// What solves frames: [`crate::solve::Solver`] in flight, something slow or broken in a test.
pub trait Solve: Send + 'static {
    /// Solves one frame.
    fn solve(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome;
    /// Solves one frame that is the sum of several exposures, or whose motion is known; a stand-in makes no use of them.
    fn solve_series(&mut self, frame: &Frame, exposures: &Exposures, prior: &Prior, watch: &dyn Watch) -> Outcome {
        let _ = exposures;
        self.solve(frame, prior, watch)
    }
    /// The outcome in the units of the outside, stars named.
    fn report(&self, outcome: &Outcome) -> Report;
    /// Takes other settings from the next frame on; a stand-in has none.
    fn adopt(&mut self, settings: &Arc<Settings>) {
        let _ = settings;
    }
}

/// Makes a solver, ready for frames; blocking, and slow the first time. The error says why frames can't be solved.
pub type MakeSolver = Arc<dyn Fn() -> Result<Box<dyn Solve>, String> + Send + Sync>;

/// A frame on its way to the solver.
#[derive(Debug, Clone)]
pub struct Captured {
    /// The frame: the sum of its exposures.
    pub frame: Arc<Frame>,
    /// Its exposures.
    pub exposures: Vec<Arc<Frame>>,
    /// When it was captured.
    pub at: Instant,
    /// What was known of the pointing then.
    pub prior: Prior,
    /// How the gondola turned during it, once that is known.
    pub motion: Option<Arc<Motion>>,
}

/// Where frames are handed to the solver.
pub type Handle = mpsc::Sender<Captured>;

/// The solver's actor.
#[derive(Clone)]
pub struct SolverActor {
    /// Frames to solve.
    pub inbox: Inbox<Captured>,
    /// Whom to tell the outcomes.
    pub hub: hub::Handle,
    /// Makes a solver.
    pub make: MakeSolver,
    /// Frames that have not ended in an outcome; they outlive the actor, so that each does.
    pub open: Arc<Mutex<BTreeMap<ImageCounter, Captured>>>,
    /// The newest state, for the settings in force.
    pub state: watch::Receiver<Arc<State>>,
    /// Counts the wishes that the frame that is being solved be given up.
    pub abort: watch::Receiver<u32>,
    /// The jobs that have not ended.
    pub left_behind: LeftBehind,
    /// Where the last frame that was looked at is shown, before its outcome is told.
    pub shown: Arc<watch::Sender<Option<Arc<Frame>>>>,
    /// Where it is noted what the solver was given.
    pub journal: journal::Handle,
    /// The service's clock.
    pub clock: Clock,
    /// When to end; the frame that is being solved ends as `aborted`.
    pub stop: CancellationToken,
}

/// What a job gives back: the solver for the next one, and the outcome where there was a frame.
struct Done {
    solver: Result<Box<dyn Solve>, String>,
    finished: Option<Finished>,
    /// Where the solver was stopped; `None` where it was given nothing.
    window: Option<Window>,
}

/// A frame that is given to the solver.
#[derive(Clone)]
struct Given {
    /// The frame, its prior with what earlier ones have shown.
    captured: Captured,
    /// The prior as it was sent.
    sent: Prior,
    /// Whether it is given again, because its motion has come.
    again: bool,
}

/// How a job ended: its frame, and what it gave back or why there is nothing.
type Ending = Option<(Option<Given>, Result<Done, String>)>;

/// A frame that was not solved and waits for its motion.
struct Held {
    given: Given,
    /// What it ends in where none comes.
    finished: Finished,
    until: Instant,
}

/// What is under way on the blocking pool.
struct Job {
    /// The frame; `None` while a solver is being made ready.
    given: Option<Given>,
    /// The settings that it is done with.
    settings: Arc<Settings>,
    /// When to stop waiting for it.
    hangs_at: Instant,
    handle: JoinHandle<Done>,
}

impl SolverActor {
    /// Runs until stopped.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let mut inbox = self.inbox.open().await;
        let left: Vec<Captured> = self.open().values().cloned().collect();
        for captured in left {
            self.give_up(captured, Reason::Failed, "the solver's part of the program was started again").await;
        }
        // What this actor's own frames have shown: one that is started again begins lost in space.
        let (mut tracker, first) = (Tracker::default(), Instant::now());
        self.journal.note(self.clock.tick(first), What::SolverBegins);
        let mut in_force = InForce::default();
        let mut job = Some(self.start(None, None, in_force.of(&self.state.borrow())));
        let mut solver = None;
        let mut waiting: Option<Captured> = None;
        let mut held: Option<Held> = None;
        let mut state = self.state.clone();
        let mut overdue = pin!(async {
            self.stop.cancelled().await;
            tokio::time::sleep(LAST_FRAME).await;
        });
        loop {
            if job.is_none()
                && let Some(motion) = held.as_ref().and_then(|held| self.motion_of(&held.given.captured))
                && let Some(Held { given: Given { captured, sent, .. }, .. }) = held.take()
            {
                let given = Given { captured: Captured { motion: Some(motion), ..captured }, sent, again: true };
                job = Some(self.start(solver.take(), Some(given), in_force.of(&self.state.borrow())));
            }
            if job.is_none()
                && let Some(mut captured) = waiting.take()
            {
                self.let_go(&mut held).await;
                captured.motion = self.motion_of(&captured);
                let at = captured.at.saturating_duration_since(first);
                let settings = in_force.of(&self.state.borrow());
                let sent = captured.prior.clone();
                captured.prior = tracker.prior(at, captured.prior, &settings.solver.tracking);
                self.hub.tell(ToHub::Solving(Some(captured.frame.stamp.image))).await;
                pulse.give_up(self.left_behind.too_many());
                job = Some(self.start(solver.take(), Some(Given { captured, sent, again: false }), settings));
            }
            tokio::select! {
                biased;
                ended = finish(&mut job), if job.is_some() => {
                    if let (Some(Job { settings, .. }), Some((Some(given), Ok(done)))) = (job.take(), &ended)
                        && let Some(finished) = &done.finished
                    {
                        let since = finished.captured.saturating_duration_since(first);
                        tracker.learn(since, &finished.outcome, &settings.solver.tracking);
                        self.note(given, since, done.window, settings, &finished.outcome);
                    }
                    let ended = self.hold(ended, &mut held);
                    solver = self.settle(ended).await;
                }
                // A frame that is being solved is waited for; a solver that is being made is not.
                () = self.stop.cancelled(), if job.as_ref().is_none_or(|job| job.given.is_none()) => {
                    self.let_go(&mut held).await;
                    return self.abort(&mut inbox).await;
                }
                () = &mut overdue => return self.abort(&mut inbox).await,
                Some(captured) = inbox.recv() => {
                    self.open().insert(captured.frame.stamp.image, captured.clone());
                    if let Some(older) = waiting.replace(captured) {
                        self.give_up(older, Reason::Skipped, "a newer frame took its place").await;
                    }
                }
                () = sleep_until(held.as_ref().map(|held| held.until)), if held.is_some() => self.let_go(&mut held).await,
                Ok(()) = state.changed(), if held.is_some() => {}
                () = pulse.rest() => {}
            }
        }
    }

    /// How the gondola turned during a frame, where that is known and is to be used.
    fn motion_of(&self, captured: &Captured) -> Option<Arc<Motion>> {
        let state = self.state.borrow();
        state.motions.of(&captured.frame.stamp).filter(|_| state.settings.solver.motion.enabled)
    }

    /// Takes out of a job the outcome of a frame that was not solved and whose motion may still come: it waits for that.
    fn hold(&self, ended: Ending, held: &mut Option<Held>) -> Ending {
        let settings = self.settings();
        let now = Instant::now();
        let may_come = settings.solver.motion.enabled && self.state.borrow().motions.are_sent(now) && !self.stop.is_cancelled();
        match ended {
            Some((Some(given), Ok(Done { solver, finished: Some(finished), window })))
                if may_come && given.captured.motion.is_none() && finished.outcome.reason.is_for_want_of_stars() =>
            {
                let until = given.captured.at + Duration::from_secs_f64(settings.solver.motion.wait_s);
                *held = Some(Held { given, finished, until });
                Some((None, Ok(Done { solver, finished: None, window })))
            }
            ended => ended,
        }
    }

    /// Ends the frame that waits for its motion as it is.
    async fn let_go(&self, held: &mut Option<Held>) {
        if let Some(Held { finished, .. }) = held.take() {
            self.end(finished).await;
        }
    }

    fn settings(&self) -> Arc<Settings> {
        Arc::clone(&self.state.borrow().settings)
    }

    /// Puts a frame, or the making of a solver, on the blocking pool.
    fn start(&self, solver: Option<Box<dyn Solve>>, given: Option<Given>, settings: Arc<Settings>) -> Job {
        let now = Instant::now();
        let timeout = Duration::from_secs_f64(settings.solver.timeout_s);
        let deadline = given.as_ref().map_or(now, |given| given.captured.at) + timeout;
        let (abort, aborts) = (self.abort.clone(), *self.abort.borrow());
        let watch = JobWatch { started: now, deadline, stop: self.stop.clone(), abort, aborts };
        let (make, theirs) = (Arc::clone(&self.make), given.as_ref().map(|given| given.captured.clone()));
        let in_force = Arc::clone(&settings);
        let running = self.left_behind.start();
        let handle = tokio::task::spawn_blocking(move || match running {
            Some(_running) => work(solver, &make, theirs, &watch, &in_force),
            None => work(None, &broken(), theirs, &watch, &in_force),
        });
        Job { given, settings, hangs_at: deadline.max(now) + GRACE, handle }
    }

    /// Notes what the solver was given and what it answered, where it was asked.
    fn note(&self, given: &Given, since: Duration, window: Option<Window>, settings: Arc<Settings>, outcome: &Outcome) {
        let Some(window) = window else { return };
        self.journal.solved(|| {
            let Given { captured, sent, again } = given.clone();
            SolvedNote { captured, sent, since, again, settings, window, outcome: outcome.clone() }
        });
    }

    /// Tells the hub how a job ended; gives back the solver if it can be used again.
    async fn settle(&self, ended: Ending) -> Option<Box<dyn Solve>> {
        let (given, result) = ended?;
        match result {
            Ok(Done { solver, finished, .. }) => {
                let readiness = solver.as_ref().map_or_else(|why| Readiness::Broken(why.clone()), |_| Readiness::Ready);
                self.hub.tell(ToHub::Readiness(readiness)).await;
                if let Some(finished) = finished {
                    self.end(finished).await;
                }
                solver.ok()
            }
            Err(why) => {
                tracing::error!(why, "the solver broke; a fresh one takes its place");
                match given {
                    Some(Given { captured, .. }) => self.give_up(captured, Reason::Failed, &format!("the solver {why}")).await,
                    None => self.hub.tell(ToHub::Readiness(Readiness::Broken(why))).await,
                }
                None
            }
        }
    }

    async fn give_up(&self, captured: Captured, reason: Reason, detail: &str) {
        let mut outcome = Outcome::unsolved(captured.frame.stamp.clone(), reason, detail);
        outcome.prior = captured.prior;
        self.end(Finished::without_stars(outcome, captured.at)).await;
    }

    /// Tells the hub the outcome of a frame, which is open until that is done.
    async fn end(&self, finished: Finished) {
        let image = finished.outcome.stamp.image;
        if finished.outcome.reason != Reason::Skipped
            && let Some(captured) = self.open().get(&image)
        {
            self.shown.send_replace(Some(Arc::clone(&captured.frame)));
        }
        self.hub.tell(ToHub::Finished(Box::new(finished))).await;
        self.open().remove(&image);
    }

    fn open(&self) -> MutexGuard<'_, BTreeMap<ImageCounter, Captured>> {
        // Nothing can break between two steps of a change to it.
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends what has not ended, so that every frame has its outcome.
    async fn abort(&self, inbox: &mut mpsc::Receiver<Captured>) -> Result<(), Ended> {
        let open: Vec<Captured> = self.open().values().cloned().collect();
        for captured in open.into_iter().chain(std::iter::from_fn(|| inbox.try_recv().ok())) {
            self.give_up(captured, Reason::Aborted, "the service stops").await;
        }
        Ok(())
    }
}

/// Makes no solver: earlier ones have the threads that there are for them.
fn broken() -> MakeSolver {
    Arc::new(|| Err("the solver hangs, time after time".to_owned()))
}

/// The settings in force for a frame: those of the state, or those of a computer that has time for the normal search alone.
#[derive(Default)]
struct InForce(Option<(Arc<Settings>, Arc<Settings>)>);

impl InForce {
    fn of(&mut self, state: &State) -> Arc<Settings> {
        if state.strain.shed() < Shed::Solving {
            return Arc::clone(&state.settings);
        }
        // Made once for each: who compares the settings of two frames by their place sees that they are the same.
        if let Some((of, lean)) = &self.0
            && Arc::ptr_eq(of, &state.settings)
        {
            return Arc::clone(lean);
        }
        let mut lean = Settings::clone(&state.settings);
        (lean.solver.robust, lean.solver.threads) = (false, 1);
        let lean = Arc::new(lean);
        self.0 = Some((Arc::clone(&state.settings), Arc::clone(&lean)));
        lean
    }
}

/// Waits for the job's end, or for the moment at which it is taken to hang.
async fn finish(job: &mut Option<Job>) -> Ending {
    let job = job.as_mut()?;
    let result = match tokio::time::timeout_at(job.hangs_at, &mut job.handle).await {
        Ok(joined) => joined.map_err(panic_message),
        Err(_) => Err("did not stop when told".to_owned()),
    };
    Some((job.given.take(), result))
}

/// The job itself, on the blocking pool.
fn work(
    solver: Option<Box<dyn Solve>>,
    make: &MakeSolver,
    captured: Option<Captured>,
    watch: &JobWatch,
    settings: &Arc<Settings>,
) -> Done {
    let mut solver = solver.map_or_else(|| make(), Ok);
    if let Ok(solver) = &mut solver {
        solver.adopt(settings);
    }
    let mut window = None;
    let finished = captured.map(|Captured { frame, exposures, at, prior, motion }| match &mut solver {
        Ok(solver) => {
            let witness = Witness::new(watch);
            let outcome = if motion.is_some() || exposures.len() > 1 {
                solver.solve_series(&frame, &Exposures { exposures, motion }, &prior, &witness)
            } else {
                solver.solve(&frame, &prior, &witness)
            };
            window = Some(witness.window());
            let picture = Picture { width: frame.width, height: frame.height, rows: frame.rows };
            Finished { report: solver.report(&outcome), outcome, captured: at, picture: Some(picture) }
        }
        Err(why) => Finished::without_stars(Outcome::unsolved(frame.stamp.clone(), Reason::Failed, why.clone()), at),
    });
    Done { solver, finished, window }
}

/// The solver's view of the clock and of the wish to stop.
struct JobWatch {
    started: Instant,
    deadline: Instant,
    stop: CancellationToken,
    abort: watch::Receiver<u32>,
    /// The wishes to give a frame up that there were before this one.
    aborts: u32,
}

impl Watch for JobWatch {
    fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        if self.stop.is_cancelled() || *self.abort.borrow() != self.aborts {
            Some(Stop::Aborted)
        } else {
            (Instant::now() >= self.deadline).then_some(Stop::TimedOut)
        }
    }
}
