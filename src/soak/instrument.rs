//! Camera, sky and solver as they are in a soak: the simulated ones, which fail when the schedule says so.

use super::account::{Account, Truth};
use super::gyros::Turned;
use super::schedule::Class;
use crate::camera::{CameraError, Moment, SimulatedSky, Source};
use crate::image::{Frame, ImageCounter, Series};
use crate::service::{MakeSolver, MakeSource, SimulatedLens, Solve, Stars, simulated_sky};
use crate::settings::Settings;
use crate::solve::{Exposures, Outcome, Part, Prior, Report, Stop, Watch};
use rustix::time::{ClockId, clock_gettime};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

/// Kind of the frames of a false sky: artefacts, and no star.
const FALSE_SKY: &str = "nostars";
/// A solver that hangs goes on for this much longer than it may.
const HANGS_FOR: Duration = Duration::from_secs(3);
/// A slow solver takes this long besides.
const SLOW_BY: Duration = Duration::from_millis(1500);
/// A solver that crawls takes this part of its time over each of its steps, of which it has some dozens, and no longer than it may be late.
const CRAWLS_PART: u32 = 12;
const CRAWLS_BY: Duration = Duration::from_millis(900);
/// One image in so many is a series, the one of this number.
const SERIES: (u32, u32) = (8, 3);
/// Time until its last exposure is read out: rates come before it, as a rule.
const READ_OUT: Duration = Duration::from_millis(190);
/// Longest step of the clock: what waits is late by no more.
const STEP: Duration = Duration::from_millis(10);

/// Which faults of the instrument last until when. One that strikes once is taken away when it has struck.
#[derive(Clone, Default)]
pub struct Faults(Arc<Mutex<BTreeMap<Class, Instant>>>);

impl Faults {
    /// A fault begins.
    pub fn begin(&self, class: Class, until: Instant) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(class, until);
    }

    /// Whether it lasts.
    pub fn lasts(&self, class: Class) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get(&class).is_some_and(|until| Instant::now() < *until)
    }

    /// Whether it strikes now, once.
    fn strikes(&self, class: Class) -> bool {
        let lasts = self.lasts(class);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&class);
        lasts
    }
}

/// Lets time pass for work that was done in no time of a paused clock.
#[derive(Clone)]
pub struct Charger(Option<mpsc::Sender<(Duration, std::sync::mpsc::SyncSender<()>)>>);

impl Charger {
    /// For a paused clock; must be made within its runtime.
    pub fn of_paused_clock() -> Self {
        let (sender, mut bills) = mpsc::channel::<(Duration, std::sync::mpsc::SyncSender<()>)>(1);
        tokio::spawn(async move {
            while let Some((mut bill, paid)) = bills.recv().await {
                while !bill.is_zero() {
                    let step = bill.min(STEP);
                    tokio::time::advance(step).await;
                    tokio::task::yield_now().await;
                    bill -= step;
                }
                let _ = paid.send(());
            }
        });
        Self(Some(sender))
    }

    /// For real time, which passes by itself.
    pub fn of_real_time() -> Self {
        Self(None)
    }

    /// Charges time that a thread of the blocking pool has worked.
    fn worked(&self, time: Duration) {
        let Some(sender) = &self.0 else { return };
        let (paid, wait) = std::sync::mpsc::sync_channel(1);
        if sender.blocking_send((time, paid)).is_ok() {
            let _ = wait.recv();
        }
    }

    /// Spends time on a thread of the blocking pool.
    fn spend(&self, time: Duration) {
        if self.0.is_some() {
            self.worked(time);
        } else {
            std::thread::sleep(time);
        }
    }
}

/// Panics, as the schedule wants it.
#[allow(clippy::panic, reason = "that is the fault")]
fn break_off(what: &'static str) {
    std::panic::panic_any(what);
}

/// CPU time of this thread.
fn thread_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), u32::try_from(time.tv_nsec).unwrap_or_default())
}

/// What the camera looks at, and what it tells.
pub struct Outside {
    /// How long the gondola has flown when a run of the service begins.
    pub flown: Duration,
    /// The lens before it.
    pub lens: SimulatedLens,
    /// What the gondola's gyros saw of the last series.
    pub gyros: watch::Sender<Option<Turned>>,
    /// What goes wrong with it.
    pub faults: Faults,
    /// Lets the time pass that a series takes.
    pub charger: Charger,
    /// What it shows.
    pub account: Account,
}

/// The camera.
struct Camera {
    sky: SimulatedSky,
    false_sky: SimulatedSky,
    outside: Arc<Outside>,
}

impl Source for Camera {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let ImageCounter(image) = moment.image;
        let Outside { faults, account, .. } = &*self.outside;
        if faults.lasts(Class::CameraGone) {
            return Err(CameraError::Unavailable("soak: it is gone".to_owned()));
        }
        if faults.strikes(Class::ImageUnreadable) {
            account.unreadable(image);
            return Err(CameraError::Unreadable { origin: format!("soak-{image}"), problem: "it is torn".to_owned() });
        }
        if faults.strikes(Class::CameraPanics) {
            account.unreadable(image);
            break_off("soak: the driver breaks");
        }
        let sky = if faults.lasts(Class::FalseSky) { &mut self.false_sky } else { &mut self.sky };
        let begun = Instant::now();
        let (series, motion) = match exposures_of(image) {
            1 => (sky.next(moment)?, None),
            count => sky.series(moment, count).map(|(series, motion)| (series, Some(motion)))?,
        };
        let attitude = sky.truth().and_then(|truth| truth.attitude);
        let year = moment.utc.map(|utc| utc.julian_year());
        let start = attitude.and_then(|_| sky.gondola().attitude(moment.uptime, year));
        let exposures = series.exposures().len() as u8;
        account.truth(image, Truth { begun: moment.uptime, attitude, start, exposures });
        if let Some(motion) = motion {
            self.outside.charger.spend(Duration::from_secs_f64(motion.length_s()));
            self.outside.gyros.send_replace(Some(Turned { begun, motion }));
            self.outside.charger.spend(READ_OUT);
        }
        Ok(series)
    }
}

/// How many exposures an image has: few are series, which take several times as long to make and to solve.
fn exposures_of(image: u32) -> u8 {
    if image % SERIES.0 == SERIES.1 { 2 + (image / SERIES.0 % 3) as u8 } else { 1 }
}

/// Makes the camera.
pub fn camera(settings: &Arc<Settings>, stars: &Stars, outside: Outside) -> MakeSource {
    let (settings, stars, outside) = (Arc::clone(settings), stars.clone(), Arc::new(outside));
    Arc::new(move || {
        let sky = simulated_sky(&settings, &stars, Some(&outside.lens))?.after(outside.flown);
        let mut other = Settings::clone(&settings);
        FALSE_SKY.clone_into(&mut other.simulate.kind);
        let false_sky = simulated_sky(&other, &stars, None)?.after(outside.flown);
        Ok(Box::new(Camera { sky, false_sky, outside: Arc::clone(&outside) }) as Box<dyn Source>)
    })
}

/// Time passes with every question whether to go on.
struct Crawl<'a> {
    watch: &'a dyn Watch,
    charger: &'a Charger,
    step: Duration,
}

impl Watch for Crawl<'_> {
    fn elapsed(&self) -> Duration {
        self.watch.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        self.stop_at(Part::Search)
    }

    fn stop_at(&self, part: Part) -> Option<Stop> {
        if part == Part::Search {
            self.charger.spend(self.step);
        }
        self.watch.stop_at(part)
    }
}

/// The solver, whose time is charged.
pub fn solver(inner: MakeSolver, faults: &Faults, charger: &Charger) -> MakeSolver {
    struct Charged {
        inner: Box<dyn Solve>,
        faults: Faults,
        charger: Charger,
        timeout: Duration,
    }
    impl Charged {
        /// Solves, with the faults that strike, and has the time charged.
        fn charged(&mut self, watch: &dyn Watch, solve: impl FnOnce(&mut dyn Solve, &dyn Watch) -> Outcome) -> Outcome {
            if self.faults.strikes(Class::SolverPanics) {
                break_off("soak: the solver breaks");
            }
            if self.faults.strikes(Class::SolverHangs) {
                self.charger.spend(self.timeout + HANGS_FOR);
            }
            if self.faults.lasts(Class::SolverSlow) {
                self.charger.spend(SLOW_BY);
            }
            let before = thread_time();
            let crawl = Crawl { watch, charger: &self.charger, step: (self.timeout / CRAWLS_PART).min(CRAWLS_BY) };
            let watch = if self.faults.lasts(Class::SolverCrawls) { &crawl } else { watch };
            let outcome = solve(&mut *self.inner, watch);
            self.charger.worked(thread_time().saturating_sub(before));
            outcome
        }
    }
    impl Solve for Charged {
        fn solve(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome {
            self.charged(watch, |inner, watch| inner.solve(frame, prior, watch))
        }

        fn solve_series(&mut self, frame: &Frame, series: &Exposures, prior: &Prior, watch: &dyn Watch) -> Outcome {
            self.charged(watch, |inner, watch| inner.solve_series(frame, series, prior, watch))
        }

        fn report(&self, outcome: &Outcome) -> Report {
            self.inner.report(outcome)
        }

        fn adopt(&mut self, settings: &Arc<Settings>) {
            self.timeout = Duration::from_secs_f64(settings.solver.timeout_s);
            self.inner.adopt(settings);
        }
    }
    let (faults, charger) = (faults.clone(), charger.clone());
    Arc::new(move || {
        let (inner, timeout) = (inner()?, Duration::ZERO);
        Ok(Box::new(Charged { inner, faults: faults.clone(), charger: charger.clone(), timeout }) as Box<dyn Solve>)
    })
}
