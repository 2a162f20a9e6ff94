//! The autofocus on rendered frames: `cargo bench --bench autofocus -- --runs 20`.
//!
//! Each run begins 300 counts from the best focus, on either side. The blur disc grows by 0.05 px a count, the best focus drifts by 2
//! counts a minute, the gears have 5 counts of backlash, the gondola turns by 1° a minute over a sky at float, and 30 % of the frames
//! that are solved count as unsolved. Frames come every 20 s, and are solved lost in space by the shipped settings.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a bench may end where it stands"
)]

#[path = "../tests/autofocus/world.rs"]
mod world;

use clap::Parser;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use stars::catalog::Catalogue;
use stars::lens::FocusCounts;
use stars::lens::autofocus::{Autofocus, AutofocusRules, Event, FocusImage, SweepPlan};
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::sky::{ARCSEC, Attitude, DEG, Vec3};
use stars::solve::{Prior, Solver, Unwatched};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use std::time::Duration;
use world::{BACKLASH, BLUR_PX_PER_COUNT, DRIFT_PER_MIN, Exposure, Lens, World};

/// Measures how near the autofocus comes to the best focus
#[derive(Debug, Parser)]
struct Args {
    /// Runs
    #[arg(long, default_value_t = 20)]
    runs: u64,
    /// Seed of the first run
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Time between frames
    #[arg(long, default_value_t = 20.0)]
    period_s: f64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// How far off a run begins, counts; turn of the gondola, deg/min; part of the frames that count as unsolved.
const OFF: i32 = 300;
const GONDOLA_DEG_PER_MIN: f64 = 1.0;
const UNSOLVED: f64 = 0.3;
/// Length of an exposure, for the trail that the turn makes, s.
const EXPOSURE_S: f64 = 0.1;

/// The sky that the camera of a run sees, and what was solved of it.
struct Sky<'a> {
    solver: &'a mut Solver,
    random: ChaCha8Rng,
    seed: u64,
    /// Right ascension at the start, declination, roll, rad.
    start: (f64, f64, f64),
    solved: u32,
}

impl Sky<'_> {
    fn show(&mut self, exposure: &Exposure) -> FocusImage {
        let rate = GONDOLA_DEG_PER_MIN * DEG / 60.0;
        let (ra, dec, roll) = self.start;
        let spec = RenderSpec {
            attitude: Some(Attitude::from_angles(ra + rate * exposure.time_s / dec.cos(), dec, roll)),
            sweep: Some(Vec3::new(0.0, rate * EXPOSURE_S, 0.0)),
            disc_px: Some(exposure.disc_px),
            platescale: (9.45 * ARCSEC, 9.45 * ARCSEC),
            camera: Some(self.seed),
            ..RenderSpec::new(Kind::Float, self.seed, u64::from(exposure.index))
        };
        let rendered = render(&spec, self.solver.catalogue()).unwrap();
        let mut outcome = self.solver.solve(&rendered.frame, &Prior::default(), &Unwatched);
        if self.random.random_range(0.0..1.0) < UNSOLVED {
            outcome.solution = None;
        }
        self.solved += u32::from(outcome.solution.is_some());
        FocusImage::new(&outcome, Duration::from_secs_f64(exposure.time_s), exposure.position, None)
    }
}

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let settings = Settings::flight().unwrap();
    let mut solver = Solver::new(catalogue, Arc::new(settings.clone()));
    let plan = SweepPlan {
        min: FocusCounts(settings.focus.search_min_counts),
        max: FocusCounts(settings.focus.search_max_counts),
        step: settings.focus.step_counts,
        advise_only: false,
    };
    println!(
        "{BLUR_PX_PER_COUNT} px a count, {DRIFT_PER_MIN} counts/min, backlash {BACKLASH}, a frame every {} s",
        args.period_s
    );
    for seed in args.seed..args.seed + args.runs {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let best = random.random_range(2620.0..2980.0);
        let off = if random.random_range(0.0..1.0) < 0.5 { OFF } else { -OFF };
        let drift = if random.random_range(0.0..1.0) < 0.5 { DRIFT_PER_MIN } else { -DRIFT_PER_MIN };
        let start = (random.random_range(0.0..TAU), random.random_range(-1.0..1.0), random.random_range(-PI..PI));
        let mut world = World { lens: Lens::at(best as i32 + off), best, drift, period_s: args.period_s };
        let mut sky = Sky { solver: &mut solver, random, seed, start, solved: 0 };
        let mut autofocus = Autofocus::new(AutofocusRules::new(&settings.focus));
        let event = Event::Run { plan, from: Some(FocusCounts(world.lens.encoder)) };
        let ended = world.run(&mut autofocus, event, &mut |exposure| sky.show(exposure), None);
        let outside = world.lens.orders.iter().filter(|order| !(plan.min.0..=plan.max.0).contains(order)).count();
        let sigma = ended.finding.best.map_or(f64::NAN, |best| best.counts.sigma);
        println!(
            "run {seed}: {:?}, off {:.1} counts, told sigma {sigma:.1}, {:.0} s, {} frames, {} solved, {} moves, {outside} outside",
            ended.finding.ending,
            ended.off,
            ended.time_s,
            ended.images,
            sky.solved,
            world.lens.orders.len()
        );
    }
}
