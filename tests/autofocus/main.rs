//! The autofocus in a world of numbers: it finds the best focus, never leaves its range, and ends however it is treated.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod numbers;
mod world;

use numbers::Numbers;
use stars::lens::FocusCounts;
use stars::lens::autofocus::{Autofocus, AutofocusRules, Ending, Event, Left, SweepPlan};
use stars::settings::Settings;
use world::{DRIFT_PER_MIN, Ended, Lens, World};

const MIN: i32 = 2300;
const MAX: i32 = 3300;
const PLAN: SweepPlan = SweepPlan { min: FocusCounts(MIN), max: FocusCounts(MAX), step: 10, advise_only: false };

fn autofocus() -> Autofocus {
    Autofocus::new(AutofocusRules::new(&Settings::flight().unwrap().focus))
}

/// The trial of a seed: from 300 counts off, on either side, the drift upwards or downwards.
fn world(seed: u64, period_s: f64) -> World {
    let best = 2620.0 + 25.0 * (seed % 16) as f64;
    let off = if seed.is_multiple_of(2) { 300 } else { -300 };
    let drift = if seed % 4 < 2 { DRIFT_PER_MIN } else { -DRIFT_PER_MIN };
    World { lens: Lens::at(best as i32 + off), best, drift, period_s }
}

fn sweep(seed: u64, period_s: f64, plan: SweepPlan, also: Option<(f64, Event)>) -> (Ended, World) {
    let (mut world, mut numbers) = (world(seed, period_s), Numbers::new(seed));
    let from = Some(FocusCounts(world.lens.encoder));
    let ended = world.run(&mut autofocus(), Event::Run { plan, from }, &mut |exposure| numbers.show(exposure), also);
    for order in &world.lens.orders {
        assert!((plan.min.0..=plan.max.0).contains(order), "sent to {order}, out of the range");
    }
    (ended, world)
}

#[test]
fn from_300_counts_off_the_best_focus_is_found_in_20_of_20_runs() {
    for period_s in [20.0, 40.0, 5.0] {
        let (mut within, mut squares) = (0, 0.0);
        for seed in 1..=20 {
            let (ended, world) = sweep(seed, period_s, PLAN, None);
            let best = ended.finding.best;
            println!(
                "{period_s} s, seed {seed}: {:?} off {:.1}, {:.0} s, {} images, {} moves, {best:?} {:?}",
                ended.finding.ending,
                ended.off,
                ended.time_s,
                ended.images,
                world.lens.orders.len(),
                ended.finding.confirmed
            );
            within += i32::from(ended.off.abs() <= 10.0 && ended.finding.ending == Ending::Found);
            let told = best.map_or(0.0, |b| (b.counts.value - world.best_at(100.0 + ended.time_s)) / b.counts.sigma);
            squares += told * told / 20.0;
            assert!(ended.time_s < 1300.0);
        }
        println!("{period_s} s: {within} of 20, mean square in σ {squares:.2}");
        assert!(within >= 19, "{within} of 20 at {period_s} s");
    }
}
