//! The machine's rules, whatever happens in whatever order.

use super::*;
use crate::settings::Settings;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const LOW: i32 = 1000;
const HIGH: i32 = 1400;

fn autofocus() -> Autofocus {
    Autofocus::new(AutofocusRules::new(&Settings::flight().unwrap().focus))
}

fn plan(random: &mut ChaCha8Rng) -> SweepPlan {
    SweepPlan {
        min: FocusCounts(LOW),
        max: FocusCounts(HIGH),
        step: random.random_range(1..60),
        advise_only: random.random_range(0..4) == 0,
    }
}

fn image(random: &mut ChaCha8Rng, now: Tick, position: i32) -> FocusImage {
    let stars = (0..random.random_range(0..4)).map(|id| {
        let peak = 300.0 / (1.0 + ((position - 1200) as f64 / 60.0).powi(2));
        (StarId(id), Metric { value: peak * random.random_range(0.8..1.2), sigma: 8.0 })
    });
    let stars: Vec<_> = stars.collect();
    FocusImage {
        counter: ImageCounter(0),
        captured: now.saturating_sub(Duration::from_millis(random.random_range(0..4000))),
        position: (random.random_range(0..5) > 0).then_some(FocusCounts(position)),
        brightest: stars.first().map(|(_, peak)| *peak),
        width_px: Some(Metric { value: [2.0, f64::NAN, -1.0][random.random_range(0..3)], sigma: 0.1 }),
        temperature_c: Some(-20.0),
        stars,
    }
}

/// Random events in random order, the lens obeying, erring by a count, failing or saying what nobody asked for.
#[test]
fn no_order_leaves_the_range_no_two_are_under_way_and_every_run_ends() {
    let (mut moves, mut ended, mut found) = (0, 0, 0);
    for seed in 0..400 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (mut autofocus, mut now, mut at) = (autofocus(), Duration::from_secs(10), 1200);
        let mut under_way: Option<FocusCounts> = None;
        let mut limits = None;
        let quiet = random.random_range(0..3) > 0;
        for _ in 0..400 {
            now += Duration::from_millis(random.random_range(0..25_000));
            let kind = match autofocus.status(now).mode {
                Mode::Running if quiet => random.random_range(0..8),
                Mode::Running => random.random_range(0..14),
                _ => random.random_range(5..14),
            };
            let event = match (kind, under_way) {
                (0..=4, Some(to)) => Event::Arrived(FocusCounts(to.0 + i32::from(random.random_range(0..8) == 0))),
                (0..=6, _) => Event::Image(image(&mut random, now, at)),
                (7, _) => Event::Time,
                (8, _) => Event::Abort { use_result: random.random_range(0..2) == 0 },
                (9, _) if random.random_range(0..6) == 0 => Event::Stop,
                (10, _) if random.random_range(0..6) == 0 => Event::LensFailed("stalled".into()),
                (11, _) => Event::Refocus { by: random.random_range(-60..60), from: Some(FocusCounts(at)) },
                _ => Event::Run { plan: plan(&mut random), from: (random.random_range(0..3) > 0).then_some(FocusCounts(at)) },
            };
            // A refocus goes 40 counts at most from where the lens is.
            let asked = match event {
                Event::Run { .. } => Some((LOW, HIGH)),
                Event::Refocus { .. } => Some((at - 40, at + 40)),
                _ => None,
            };
            if let Event::Arrived(there) = event {
                (under_way, at) = (None, there.0);
            }
            let running = autofocus.status(now).mode == Mode::Running;
            let decision = autofocus.on(now, event);
            // A refusal leaves what time asks for to the next call.
            let asks_later = autofocus.deadline().is_none_or(|deadline| deadline > now);
            assert!(asks_later || matches!(decision, Decision::Refused(_)), "asked again at once, seed {seed}");
            match decision {
                Decision::Move(to) => {
                    // Only a run that begins answers its own event by a move, so that its limits are those from here on.
                    limits = if running { limits } else { asked };
                    let (low, high) = limits.expect("a move without a run");
                    assert!(under_way.is_none(), "two moves at a time, seed {seed}");
                    assert!((low..=high).contains(&to.0), "sent to {to:?}, seed {seed}");
                    (under_way, moves) = (Some(to), moves + 1);
                }
                Decision::Finished(finding) => {
                    (under_way, limits, ended) = (None, None, ended + 1);
                    found += i32::from(finding.ending == Ending::Found);
                    assert_eq!(autofocus.status(now).mode, Mode::Grace);
                }
                Decision::Refused(_) | Decision::Unchanged => {}
            }
        }
        // Left alone, it ends by itself.
        for _ in 0..100 {
            let Some(deadline) = autofocus.deadline() else { break };
            autofocus.on(deadline, Event::Time);
        }
        assert_eq!((autofocus.status(now).mode, autofocus.deadline()), (Mode::NotRunning, None), "seed {seed}");
    }
    println!("{moves} moves, {ended} runs ended, {found} of them found");
    assert!(moves > 5000 && ended > 200 && found > 20, "{moves} {ended} {found}");
}

#[test]
fn what_cannot_be_done_is_refused_with_its_reason() {
    let now = Duration::from_secs(1);
    let whole = SweepPlan { min: FocusCounts(LOW), max: FocusCounts(HIGH), step: 10, advise_only: false };
    let refused = |event| match autofocus().on(now, event) {
        Decision::Refused(why) => Some(why),
        _ => None,
    };
    let run = |plan, from: Option<i32>| refused(Event::Run { plan, from: from.map(FocusCounts) });
    let step = |by, from: Option<i32>| refused(Event::Refocus { by, from: from.map(FocusCounts) });
    assert_eq!(run(whole, None), None);
    assert_eq!(run(whole, Some(2000)), None);
    assert_eq!(run(SweepPlan { max: FocusCounts(LOW + 51), ..whole }, None), Some(Refusal::RangeTooNarrow));
    assert_eq!(run(SweepPlan { max: FocusCounts(LOW + 52), ..whole }, None), None);
    assert_eq!(run(SweepPlan { max: FocusCounts(LOW - 100), ..whole }, None), Some(Refusal::RangeTooNarrow));
    let advice = SweepPlan { advise_only: true, ..whole };
    assert_eq!(run(advice, None), Some(Refusal::PositionUnknown));
    assert_eq!(run(advice, Some(HIGH + 1)), Some(Refusal::OutsideRange));
    assert_eq!(run(advice, Some(HIGH)), None);
    assert_eq!(step(10, None), Some(Refusal::PositionUnknown));
    assert_eq!((step(40, Some(1200)), step(41, Some(1200))), (None, Some(Refusal::StepOutOfRange)));
    assert_eq!((step(-28, Some(1200)), step(-29, Some(1200))), (None, Some(Refusal::StepOutOfRange)));
    assert_eq!(step(0, Some(1200)), Some(Refusal::StepOutOfRange));
    let mut running = autofocus();
    running.on(now, Event::Run { plan: whole, from: None });
    assert_eq!(running.on(now, Event::Refocus { by: 1, from: None }), Decision::Refused(Refusal::Busy));
}

#[test]
fn a_lens_that_does_not_answer_ends_the_run() {
    let mut autofocus = autofocus();
    let plan = SweepPlan { min: FocusCounts(LOW), max: FocusCounts(HIGH), step: 10, advise_only: false };
    assert!(matches!(autofocus.on(Duration::from_secs(1), Event::Run { plan, from: None }), Decision::Move(_)));
    let deadline = autofocus.deadline().unwrap();
    let Decision::Finished(finding) = autofocus.on(deadline, Event::Time) else { panic!("it goes on") };
    assert!(matches!(finding.ending, Ending::LensFailed(_)));
}
