//! How long a frame takes from pixels in memory to outcome: `cargo bench --bench solve -- --kind night --kind float --frames 100`.
//!
//! Thread CPU time, taken outside `Solver::solve`, one thread, lost in space, shipped settings. The frames are rendered
//! first and solved once, so that the index is built and memory is warm; then each is solved a few times and its median
//! counts. The stages are the solver's own account of the same time, and need not add up to the whole.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use shared::{CpuWatch, ms, quantile, timed};
use stars::catalog::Catalogue;
use stars::image::Frame;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::solve::{Outcome, Prior, Reason, Solver, StageTimes};
use std::sync::Arc;
use std::time::Duration;

/// Measures the solver
#[derive(Debug, Parser)]
struct Args {
    /// Kinds of frame, as in `stars render --help`
    #[arg(long, default_values = ["night", "float"])]
    kind: Vec<Kind>,
    /// Frames of each kind
    #[arg(long, default_value_t = 50)]
    frames: u64,
    /// Seed of the frames
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Times that each frame is solved; their median counts
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// The search as shipped, normal and then robust, instead of the two apart
    #[arg(long)]
    shipped: bool,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// How a frame is solved.
type Search = fn(&mut Solver, &Frame) -> Outcome;
/// A stage's name and how to take its time from an outcome.
type Stage = (&'static str, fn(&StageTimes) -> Duration);

const SEARCHES: [(&str, Search); 2] = [
    ("normal", |solver, frame| solver.solve(frame, &Prior::default(), &CpuWatch)),
    ("robust", |solver, frame| solver.solve_robust(frame, &Prior::default(), &CpuWatch)),
];
/// The first of them with the robust one allowed to follow.
const SHIPPED: [(&str, Search); 1] = [("shipped", SEARCHES[0].1)];
const STAGES: [Stage; 4] = [("statistics", |t| t.statistics), ("find", |t| t.find), ("match", |t| t.match_), ("fit", |t| t.fit)];

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let mut settings = Settings::flight().unwrap();
    settings.solver.robust = args.shipped;
    let specs = args.kind.iter().flat_map(|&kind| (0..args.frames).map(move |index| (kind, index)));
    let frames: Vec<Frame> =
        specs.map(|(kind, index)| render(&RenderSpec::new(kind, args.seed, index), &catalogue).unwrap().frame).collect();
    let Some(first) = frames.first() else { return };
    let mut solver = Solver::new(catalogue, Arc::new(settings));
    solver.prepare(first.width, first.height);
    let kinds: Vec<&str> = args.kind.iter().map(|kind| kind.name()).collect();
    println!("{} frames of {} × {} px: {}; seed {}", frames.len(), first.width, first.height, kinds.join(", "), args.seed);
    println!("thread CPU time, median of {} runs each\n", args.repeats);
    println!("{:<22} {:>9} {:>9} {:>9} {:>9} {:>8}", "", "median", "p95", "p99", "max", "solved");
    // What no search is done without: every pixel read once.
    let read = |frame: &Frame| frame.pixels.iter().fold(0, |sum: u16, pixel| sum.wrapping_add(*pixel));
    let mut reads: Vec<f64> = frames.iter().map(|frame| median_ms(args.repeats, || read(frame))).collect();
    row("read-once", &mut reads, "");
    let searches = if args.shipped { &SHIPPED[..] } else { &SEARCHES[..] };
    for &(name, search) in searches {
        let mut totals = Vec::new();
        let mut stages = [const { Vec::new() }; STAGES.len()];
        let mut solved = 0;
        for frame in &frames {
            let outcome = search(&mut solver, frame);
            solved += usize::from(outcome.reason == Reason::Solved);
            totals.push(median_ms(args.repeats, || search(&mut solver, std::hint::black_box(frame))));
            STAGES.iter().zip(&mut stages).for_each(|((_, stage), times)| times.push(ms(stage(&outcome.times))));
        }
        row(name, &mut totals, &format!("{solved}"));
        for ((stage, _), times) in STAGES.iter().zip(&mut stages) {
            row(&format!("  {stage}"), times, "");
        }
    }
}

/// Median of the CPU times of some runs, ms.
fn median_ms<T>(repeats: usize, mut work: impl FnMut() -> T) -> f64 {
    let mut runs: Vec<f64> = (0..repeats).map(|_| timed(&mut work).1).collect();
    quantile(&mut runs, 0.5)
}

fn row(name: &str, times: &mut [f64], solved: &str) {
    let [median, p95, p99, max] = [0.5, 0.95, 0.99, 1.0].map(|part| quantile(times, part));
    println!("{name:<22} {median:>6.2} ms {p95:>6.2} ms {p99:>6.2} ms {max:>6.2} ms {solved:>8}");
}
