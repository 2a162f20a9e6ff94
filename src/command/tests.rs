//! The arbitration's and the guard's rules, one by one. That they hold in every state is the model's to show.

use super::guard::{Act, Authenticity, Guard, Sender, Situation, Slot, Verdict};
use super::in_charge::{BootId, Decision, Epoch, Event, FlightComputer, InCharge, Lease, Tick};
use super::{Command, MAX_VALUES, Refusal};
use std::time::Duration;

const A: FlightComputer = FlightComputer(1);
const B: FlightComputer = FlightComputer(2);

fn at(seconds: f64) -> Tick {
    Duration::from_secs_f64(seconds)
}

fn connected(computer: FlightComputer) -> Event {
    Event::Connected { computer, boot: BootId(u32::from(computer.0)) }
}

fn says(from: FlightComputer, claims: bool, uptime: Option<f64>) -> Event {
    Event::Status { from, claims, uptime: uptime.map(at), hears_us: true }
}

fn claim(from: FlightComputer) -> Event {
    says(from, true, None)
}

/// Both connected at 0, A first.
fn both() -> InCharge {
    let mut machine = InCharge::default();
    machine.on(at(0.0), connected(A));
    machine.on(at(0.001), connected(B));
    machine
}

fn holder(machine: &InCharge) -> Option<FlightComputer> {
    machine.lease().map(|lease| lease.computer)
}

#[test]
fn the_one_that_claims_has_the_lease_until_it_withdraws_and_each_lease_has_a_new_epoch() {
    let mut machine = both();
    assert_eq!(machine.on(at(0.5), says(A, false, None)), Decision::Unchanged);
    let first = Lease { computer: B, epoch: Epoch(1), since: at(0.5) };
    assert_eq!(machine.on(at(0.5), claim(B)), Decision::Granted(first));
    assert_eq!(machine.on(at(1.0), claim(B)), Decision::Unchanged);
    assert_eq!(machine.lease(), Some(first));
    assert_eq!(machine.on(at(1.5), says(B, false, None)), Decision::Ended { from: B, lapsed: false });
    let second = Lease { computer: A, epoch: Epoch(2), since: at(2.0) };
    assert_eq!(machine.on(at(2.0), claim(A)), Decision::Granted(second));
}

#[test]
fn a_lease_lapses_three_seconds_after_the_last_status_that_renewed_it() {
    let mut machine = both();
    machine.on(at(1.0), claim(A));
    assert_eq!(machine.on(at(3.999), Event::Time), Decision::Unchanged);
    assert_eq!(machine.deadline(), Some(at(4.0)));
    assert_eq!(machine.on(at(4.0), Event::Time), Decision::Ended { from: A, lapsed: true });
}

#[test]
fn a_status_that_shows_that_we_are_not_heard_renews_nothing() {
    let mut machine = both();
    let deaf = Event::Status { from: A, claims: true, uptime: None, hears_us: false };
    assert_eq!(machine.on(at(0.5), deaf), Decision::Unchanged);
    machine.on(at(1.0), claim(A));
    for step in 1..6 {
        machine.on(at(1.0 + 0.5 * f64::from(step)), deaf);
    }
    assert_eq!(machine.on(at(4.0), deaf), Decision::Ended { from: A, lapsed: true });
}

/// Both claim every half second with what they say of their uptimes; who has the lease in the end.
fn contest(uptime_of_a: impl Fn(f64) -> Option<f64>, uptime_of_b: impl Fn(f64) -> Option<f64>) -> FlightComputer {
    let mut machine = both();
    for step in 1..60 {
        let now = 0.5 * f64::from(step);
        machine.on(at(now), says(A, true, uptime_of_a(now)));
        machine.on(at(now + 0.1), says(B, true, uptime_of_b(now + 0.1)));
        if now < 2.0 {
            assert_eq!(holder(&machine), Some(A), "the holder keeps it until both claims last");
        }
    }
    holder(&machine).unwrap()
}

#[test]
fn of_two_lasting_claims_the_less_recently_rebooted_wins_and_a_liar_does_not() {
    let up = |before: f64| move |now: f64| Some(now + before);
    assert_eq!(contest(up(100.0), up(200.0)), B);
    assert_eq!(contest(up(200.0), up(100.0)), A);
    // Without uptimes, and where one has none: the longer connected.
    assert_eq!(contest(|_| None, |_| None), A);
    assert_eq!(contest(|_| None, up(1e6)), A);
    // An uptime that runs backwards, stands for hours and runs backwards, or runs faster than ours.
    assert_eq!(contest(up(100.0), |now| Some(1e6 - now)), A);
    assert_eq!(contest(|now| Some(1e6 - now), up(100.0)), B);
    assert_eq!(contest(up(100.0), |now| Some(1000.0 + 2.0 * now)), A);
    // Two liars: the longer connected.
    assert_eq!(contest(|now| Some(1e6 - now), |now| Some(2e6 - now)), A);
}

#[test]
fn a_claim_that_comes_and_goes_is_not_followed_until_it_stands_for_two_seconds() {
    let mut machine = both();
    machine.on(at(0.5), claim(A));
    machine.on(at(1.0), says(A, false, None));
    for step in 0..4 {
        machine.on(at(1.5 + 0.5 * f64::from(step)), claim(A));
        assert_eq!(holder(&machine), None);
    }
    machine.on(at(3.5), claim(A));
    assert_eq!(holder(&machine), Some(A));
    // The same for a connection that comes and goes.
    machine.on(at(3.6), Event::Disconnected(A));
    machine.on(at(3.7), connected(A));
    machine.on(at(3.8), claim(A));
    assert_eq!(holder(&machine), None);
    machine.on(at(5.8), claim(A));
    assert_eq!(holder(&machine), Some(A));
}

#[test]
fn the_other_has_it_as_soon_as_the_holder_is_gone() {
    let mut machine = both();
    machine.on(at(0.5), claim(A));
    machine.on(at(0.6), claim(B));
    let moved = machine.on(at(1.0), Event::Disconnected(A));
    assert!(matches!(moved, Decision::Moved { from: A, to } if to.computer == B && to.epoch == Epoch(2)), "{moved:?}");
    assert_eq!(machine.on(at(1.1), claim(FlightComputer(9))), Decision::Stranger(FlightComputer(9)));
}

const OURS: BootId = BootId(99);
const LEASE_OF_A: Lease = Lease { computer: A, epoch: Epoch(3), since: Duration::ZERO };

fn sender() -> Sender {
    Sender {
        computer: A,
        boot: BootId(7),
        block_boot: BootId(7),
        under: Some((OURS, LEASE_OF_A.epoch)),
        delay: at(0.5),
        authenticity: Authenticity::NotRequired,
    }
}

fn situation() -> Situation {
    Situation { lease: Some(LEASE_OF_A), ours: OURS, window_s: 15.0 }
}

fn slot(counter: u32, text: &str) -> Slot {
    Slot::new(&Command::parse(text).unwrap(), Act::Run, counter, 1.0)
}

/// A guard that has seen the first block of the boot.
fn seeded() -> Guard {
    let mut guard = Guard::default();
    assert!(guard.on(&sender(), &situation(), &[]).is_empty());
    guard
}

fn why(verdicts: &[Verdict]) -> Option<Refusal> {
    match verdicts {
        [Verdict::Refused { why, .. }] => Some(*why),
        [Verdict::Run(_)] => None,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_true_command_runs_once_however_often_it_is_sent() {
    let mut guard = seeded();
    let command = slot(1, "lens.set_focus 3030");
    let [Verdict::Run(order)] = &guard.on(&sender(), &situation(), &[command])[..] else { panic!("it does not run") };
    assert_eq!((order.from, order.counter, order.act), (A, 1, Act::Run));
    for age_s in [1.5, 2.0, 14.0, 100.0] {
        assert!(guard.on(&sender(), &situation(), &[Slot { age_s, ..command }]).is_empty());
    }
    assert_eq!(why(&guard.on(&sender(), &situation(), &[slot(2, "lens.set_focus 3030")])), None);
}

#[test]
fn each_check_refuses_by_its_name() {
    let good = slot(1, "lens.set_focus 3030");
    let sealed = |slot: Slot| Slot { seal: Slot::seal_of(slot.code, slot.act, slot.counter, &slot.values), ..slot };
    let late = |delay: f64| Sender { delay: at(delay), ..sender() };
    let cases: [(Sender, Situation, Slot, Refusal); 14] = [
        (Sender { authenticity: Authenticity::Failed, ..sender() }, situation(), good, Refusal::NotAuthentic),
        (Sender { block_boot: BootId(8), ..sender() }, situation(), good, Refusal::WrongBoot),
        (sender(), situation(), Slot { seal: good.seal ^ 1, ..good }, Refusal::HalfChanged),
        (sender(), situation(), Slot { counter: 2, ..good }, Refusal::HalfChanged),
        (sender(), situation(), Slot { values: [0.0; MAX_VALUES], ..good }, Refusal::HalfChanged),
        (sender(), Situation { lease: None, ..situation() }, good, Refusal::NotInCharge),
        (sender(), Situation { lease: Some(Lease { computer: B, ..LEASE_OF_A }), ..situation() }, good, Refusal::NotInCharge),
        (Sender { under: Some((OURS, Epoch(2))), ..sender() }, situation(), good, Refusal::NotInCharge),
        (Sender { under: Some((BootId(1), LEASE_OF_A.epoch)), ..sender() }, situation(), good, Refusal::NotInCharge),
        (sender(), situation(), Slot { age_s: 15.1, ..good }, Refusal::Stale),
        (sender(), situation(), Slot { age_s: -0.1, ..good }, Refusal::Stale),
        (late(14.5), situation(), good, Refusal::Stale),
        (sender(), situation(), sealed(Slot { values: [70_000.0, 0., 0., 0., 0., 0., 0., 0.], ..good }), Refusal::OutOfRange),
        (sender(), situation(), sealed(Slot { code: 250, ..good }), Refusal::UnknownCommand),
    ];
    for (sender, situation, slot, wanted) in cases {
        let mut guard = seeded();
        assert_eq!(why(&guard.on(&sender, &situation, &[slot])), Some(wanted));
    }
    let mut guard = seeded();
    assert_eq!(why(&guard.on(&sender(), &situation(), &[slot(5, "lens.stop")])), None);
    assert_eq!(why(&guard.on(&sender(), &situation(), &[slot(4, "lens.stop")])), Some(Refusal::Replayed));
    assert_eq!(why(&guard.on(&late(1e9), &situation(), &[slot(6, "lens.stop")])), Some(Refusal::Stale));
}

#[test]
fn a_refused_command_never_runs_later() {
    let mut guard = seeded();
    let command = slot(1, "lens.set_focus 3030");
    let without = Situation { lease: None, ..situation() };
    assert_eq!(why(&guard.on(&sender(), &without, &[command])), Some(Refusal::NotInCharge));
    assert!(guard.on(&sender(), &situation(), &[command]).is_empty());
}

#[test]
fn the_first_whole_block_of_a_boot_runs_nothing_and_a_broken_one_is_not_the_first() {
    let mut guard = Guard::default();
    let command = slot(1, "lens.stop");
    assert_eq!(why(&guard.on(&sender(), &situation(), &[Slot { seal: 0, ..command }])), Some(Refusal::HalfChanged));
    assert_eq!(why(&guard.on(&sender(), &situation(), &[command])), Some(Refusal::Early));
    assert_eq!(why(&guard.on(&sender(), &situation(), &[slot(2, "lens.stop")])), None);
    // Another boot begins anew, and the old one's counters are still known when it comes back.
    let other = Sender { boot: BootId(8), block_boot: BootId(8), ..sender() };
    assert_eq!(why(&guard.on(&other, &situation(), &[slot(1, "lens.stop")])), Some(Refusal::Early));
    assert!(guard.on(&sender(), &situation(), &[slot(2, "lens.stop")]).is_empty());
}

#[test]
fn a_guard_that_remembers_refuses_after_a_restart_what_ran_before_it() {
    let mut guard = seeded();
    assert_eq!(why(&guard.on(&sender(), &situation(), &[slot(1, "lens.stop")])), None);
    let kept = postcard::to_stdvec(guard.memory()).unwrap();
    let mut again = Guard::new(postcard::from_bytes(&kept).unwrap());
    assert!(again.on(&sender(), &situation(), &[slot(1, "lens.stop")]).is_empty());
    assert_eq!(why(&again.on(&sender(), &situation(), &[slot(2, "lens.stop")])), None);
}
