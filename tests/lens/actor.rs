//! The actor against the simulated controller on its pseudo-terminal, opened by its path: every command against every fault.
//!
//! Real bytes need real time, so that everything here runs a number of times faster than in flight (`STARS_LENS_SPEEDUP`, 6):
//! the controller, the motor and all timeouts. `scripts/prove lens` runs it at the flight's own pace.

use stars::lens::{
    AperturePosition, Doubt, FocusCounts, Known, LensCommand, LensError, LensResult, LensState, RequestCounter, Rules,
};
use stars::service::{LensAlone, SimulatedLens};
use stars::settings::{LensSettings, Settings};
use stars::simulate::lens::FaultKind;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;
use tokio::time::Instant;

fn speedup() -> f64 {
    std::env::var("STARS_LENS_SPEEDUP").ok().and_then(|text| text.parse().ok()).unwrap_or(6.0)
}

/// The flight's settings, so many times faster.
fn settings() -> LensSettings {
    let mut lens = Settings::flight().unwrap().lens;
    let speedup = speedup();
    for time in [
        &mut lens.reply_timeout_s,
        &mut lens.move_timeout_s,
        &mut lens.learn_timeout_s,
        &mut lens.retry_pause_s,
        &mut lens.check_period_s,
        &mut lens.search_period_s,
        &mut lens.relearn_pause_s,
    ] {
        *time /= speedup;
    }
    lens.simulated.speedup = speedup;
    lens
}

/// Flight seconds.
fn flight(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds / speedup())
}

/// A test that has waited this long for something has failed. Machines may be busy: nothing is proved by its coming sooner.
const PATIENCE: Duration = Duration::from_secs(60);
/// Time between two looks at what is known.
const LOOK: Duration = Duration::from_millis(20);

/// So many looks in a row at something wrong are no lateness.
const WRONG_LOOKS: u32 = 25;

/// A lens with its actor.
struct Bench {
    simulated: SimulatedLens,
    link: LensAlone,
    rules: Rules,
    next: u32,
    ended: BTreeMap<u32, LensResult>,
    /// Looks in a row at which something known was wrong.
    wrong: u32,
}

impl Bench {
    fn start(settings: &LensSettings, seed: u64) -> Self {
        let simulated = SimulatedLens::new(settings, seed).unwrap();
        let link = LensAlone::start(settings, Some(&simulated));
        Self { simulated, link, rules: Rules::of(settings), next: 0, ended: BTreeMap::new(), wrong: 0 }
    }

    /// One whose lens is known, with the aperture a little closed.
    async fn known(settings: &LensSettings, seed: u64) -> Self {
        let mut bench = Self::start(settings, seed);
        bench.until_known().await;
        // A busy machine may be too late for a reply: another time, then.
        while bench.state().aperture != Known::Known(AperturePosition(4)) {
            let closed = bench.ask(LensCommand::SetAperture(AperturePosition(4)));
            bench.end_of(closed, PATIENCE).await.expect("it never ended");
            bench.until_known().await;
        }
        bench
    }

    async fn until_known(&mut self) {
        let patience = Instant::now() + PATIENCE;
        while !is_known(&self.state()) {
            assert!(Instant::now() < patience, "{:?}", self.state());
            self.wait(flight(0.5)).await;
        }
    }

    fn state(&self) -> LensState {
        self.link.state()
    }

    fn ask(&mut self, command: LensCommand) -> u32 {
        self.next += 1;
        self.link.handle().request(RequestCounter(self.next), command).unwrap();
        self.next
    }

    /// Lets time pass, and checks at each step that what is known is right.
    async fn wait(&mut self, time: Duration) {
        let until = Instant::now() + time;
        loop {
            let step = (Instant::now() + LOOK).min(until);
            if let Ok(Some((counter, result))) = tokio::time::timeout_at(step, self.link.answer()).await
                && result != LensResult::Started
            {
                assert_eq!(self.ended.insert(counter.0, result), None, "request {} ended twice", counter.0);
            }
            self.check();
            if Instant::now() >= until {
                return;
            }
        }
    }

    /// How the request ended, if it did so within this time.
    async fn end_of(&mut self, counter: u32, limit: Duration) -> Option<LensResult> {
        let until = Instant::now() + limit;
        while !self.ended.contains_key(&counter) && Instant::now() < until {
            self.wait(Duration::from_millis(1)).await;
        }
        self.ended.get(&counter).cloned()
    }

    /// What is known is right. A task on a busy machine may hear of a change late, so that the lens is ahead of what is known for a
    /// few looks; the tests in made-up time allow nothing of the kind.
    fn check(&mut self) {
        let state = self.state();
        let (motor, aperture) = (self.simulated.true_motor(), self.simulated.true_aperture());
        let off = state.focus.value().map_or(0.0, |focus| (f64::from(focus.0) - motor).abs());
        let right = off <= f64::from(self.rules.tolerance) && state.aperture.value().is_none_or(|known| known.0 == aperture);
        self.wrong = if right { 0 } else { self.wrong + 1 };
        assert!(self.wrong < WRONG_LOOKS, "is at {motor}, aperture {aperture}, and known is {state:?}");
    }

    /// The words that move, as the controller received them.
    fn moving_words(&self) -> Vec<String> {
        self.simulated.received().into_iter().map(|one| one.word).filter(|word| crate::world::moves(word)).collect()
    }
}

fn is_known(state: &LensState) -> bool {
    state.focus.value().is_some() && state.aperture.value().is_some()
}

const COMMANDS: [LensCommand; 9] = [
    LensCommand::Flush,
    LensCommand::InitFocus,
    LensCommand::GetFocus,
    LensCommand::SetFocus(FocusCounts(3030)),
    LensCommand::MoveFocus(-330),
    LensCommand::InitAperture,
    LensCommand::GetAperture,
    LensCommand::SetAperture(AperturePosition(9)),
    LensCommand::Stop,
];

/// Whether the fault comes before the command, or when it is under way.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Moment {
    Before,
    UnderWay,
}

/// What a case came to.
#[derive(Debug)]
struct Case {
    kind: FaultKind,
    command: LensCommand,
    moment: Moment,
    result: LensResult,
    /// Flight seconds from the fault's end until focus and aperture were known.
    known_again: Option<f64>,
    state: LensState,
}

/// How long faults last, flight seconds: some shorter than a timeout, some longer than all retries.
const LASTS_S: [f64; 2] = [4.0, 25.0];

async fn case(kind: FaultKind, command: LensCommand, moment: Moment, lasts_s: f64, seed: u64) -> Case {
    let settings = settings();
    let mut bench = Bench::known(&settings, seed).await;
    let lasts = flight(lasts_s);
    let began = Instant::now();
    let asked = match moment {
        Moment::Before => {
            bench.simulated.inject(kind, lasts);
            bench.ask(command)
        }
        Moment::UnderWay => {
            let words = bench.moving_words().len();
            let asked = bench.ask(command);
            bench.wait(flight(0.2)).await;
            // Counts that are lost after the reading before a move and before the move can't be noticed, so let it have begun.
            let patience = Instant::now() + PATIENCE;
            while command.moves() && bench.moving_words().len() == words && !bench.ended.contains_key(&asked) {
                assert!(Instant::now() < patience, "{:?}", bench.state());
                bench.wait(Duration::from_millis(1)).await;
            }
            bench.simulated.inject(kind, lasts);
            asked
        }
    };
    // A request may wait for what the lens does by itself, which ends as well; and a busy machine is no fault of the lens's.
    let limit = bench.rules.longest(command) + bench.rules.longest(LensCommand::InitFocus) + PATIENCE;
    let result = bench.end_of(asked, limit).await.unwrap_or_else(|| panic!("{command:?} never ended: {:?}", bench.state()));
    let words = bench.moving_words();
    let over = began + lasts;
    bench.wait(over.saturating_duration_since(Instant::now())).await;
    let mut known_again = None;
    while known_again.is_none() && over.elapsed() < flight(60.0) {
        bench.wait(flight(0.5)).await;
        known_again = is_known(&bench.state()).then(|| over.elapsed().as_secs_f64() * speedup());
    }
    if command == LensCommand::Stop {
        assert_eq!(bench.moving_words(), words, "it moved after a stop");
    }
    let state = bench.state();
    for unknown in [doubt(state.focus), doubt(state.aperture)].into_iter().flatten() {
        assert_ne!(unknown, Doubt::NeverRead, "{kind:?} {command:?}: unknown without a reason");
    }
    Case { kind, command, moment, result, known_again, state }
}

fn doubt<T>(known: Known<T>) -> Option<Doubt> {
    if let Known::Unknown(doubt) = known { Some(doubt) } else { None }
}

/// Every command against every fault, before it and while it is under way, short and long: what is known is right at any moment
/// (each case checks that all the time), every request ends within its time, and the lens is known again by itself.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_command_against_every_fault_ends_known_and_right_or_unknown_for_a_reason() {
    let mut running = tokio::task::JoinSet::new();
    let mut seed = 0;
    for kind in FaultKind::ALL {
        for command in COMMANDS {
            for moment in [Moment::Before, Moment::UnderWay] {
                for lasts_s in LASTS_S {
                    seed += 1;
                    running.spawn(case(kind, command, moment, lasts_s, seed));
                }
            }
        }
    }
    let cases = running.join_all().await;
    let (known, unknown): (Vec<&Case>, Vec<&Case>) = cases.iter().partition(|case| case.known_again.is_some());
    let mut times: Vec<f64> = known.iter().filter_map(|case| case.known_again).collect();
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    let slowest = times.last().unwrap();
    let completed = cases.iter().filter(|case| case.result == LensResult::Completed).count();
    println!(
        "lens: {} cases, {completed} completed, {} known again within 60 s (median {median:.1} s, slowest {slowest:.1} s)",
        cases.len(),
        known.len()
    );
    for case in &unknown {
        println!(
            "lens: not known again: {:?} {:?} {:?}: {:?}, {:?}",
            case.command, case.kind, case.moment, case.state.focus, case.state.aperture
        );
    }
    let of = cases.len() as f64;
    println!("lens: wanted: 95 %  got: {:.1} %", 100.0 * known.len() as f64 / of);
    assert!(known.len() as f64 >= 0.95 * of);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stop_overtakes_what_waits_and_the_controller_gets_no_more_words_that_move() {
    let mut slow = settings();
    slow.simulated.speed_counts_s = 400.0; // So that the move takes almost as long as it may.
    let mut bench = Bench::known(&slow, 1).await;
    let moving = bench.ask(LensCommand::SetFocus(FocusCounts(300)));
    let patience = Instant::now() + PATIENCE;
    while bench.state().focus != Known::Moving {
        assert!(Instant::now() < patience, "{:?}", bench.state());
        bench.wait(Duration::from_millis(1)).await;
    }
    let words = bench.moving_words();
    let waiting: Vec<u32> = (0..8).map(|n| bench.ask(LensCommand::SetFocus(FocusCounts(400 + n)))).collect();
    let asked = Instant::now();
    let stop = bench.ask(LensCommand::Stop);
    assert_eq!(bench.end_of(stop, PATIENCE).await, Some(LensResult::Completed));
    for one in waiting {
        assert_eq!(bench.end_of(one, PATIENCE).await, Some(LensResult::Failed(LensError::Stopped)));
    }
    println!("lens: stopped within {} ms", asked.elapsed().as_millis());
    assert_eq!(bench.state().focus, Known::Moving, "the move that has begun is over too soon for this test");
    assert_eq!(bench.end_of(moving, PATIENCE).await, Some(LensResult::Completed));
    bench.wait(flight(30.0)).await;
    assert_eq!(bench.moving_words(), words);
    assert_eq!((bench.state().focus, bench.state().stopped), (Known::Known(FocusCounts(300)), true));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_port_that_comes_back_under_another_path_is_found() {
    let mut bench = Bench::known(&settings(), 1).await;
    let port = bench.simulated.path().map(|path| path.display().to_string());
    assert_eq!(bench.state().port, port);
    bench.simulated.inject(FaultKind::Vanished, flight(10.0));
    bench.wait(flight(2.0)).await;
    assert_eq!((bench.state().connected, bench.simulated.path()), (false, None));
    assert_eq!(bench.state().focus, Known::Unknown(Doubt::PortLost));
    bench.until_known().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_serial_lens_is_the_same_by_the_path_of_the_settings() {
    let mut settings = settings();
    let simulated = SimulatedLens::new(&settings, 1).unwrap();
    tokio::spawn(simulated.clone().run(Default::default()));
    let path: PathBuf = loop {
        if let Some(path) = simulated.path() {
            break path;
        }
        tokio::time::sleep(Duration::from_millis(1)).await;
    };
    settings.kind = stars::settings::LensKind::Serial;
    settings.port = path.display().to_string();
    let link = LensAlone::start(&settings, None);
    let patience = Instant::now() + PATIENCE;
    while !is_known(&link.state()) {
        assert!(Instant::now() < patience, "{:?}", link.state());
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert_eq!(link.state().port, Some(settings.port));
}

#[tokio::test]
async fn without_a_lens_everything_is_refused_as_not_there() {
    let settings = LensSettings { kind: stars::settings::LensKind::None, ..settings() };
    let mut link = LensAlone::start(&settings, None);
    for command in COMMANDS {
        link.handle().request(RequestCounter(7), command).unwrap();
        assert_eq!(link.answer().await, Some((RequestCounter(7), LensResult::Failed(LensError::NotThere))));
    }
    assert_eq!(link.state().focus, Known::Unknown(Doubt::NoLens));
}
