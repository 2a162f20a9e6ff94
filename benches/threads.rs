//! What a second thread is worth: `cargo bench --bench threads -- --frames 50`.
//!
//! The same frames with `solver.threads` 1 and 2, in turn, so that what else the machine does falls on both. Time by the wall from pixels
//! in memory to outcome, of each frame the median of a few runs; shipped settings otherwise, one frame at a time.

#![allow(clippy::unwrap_used, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use shared::{ms, quantile};
use stars::catalog::Catalogue;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::solve::{Prior, SearchMode, Solver, Unwatched};
use std::sync::Arc;
use std::time::Instant;

/// Compares one thread with two
#[derive(Debug, Parser)]
struct Args {
    /// Frames of each kind
    #[arg(long, default_value_t = 50)]
    frames: u64,
    /// Seed of the frames
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Times that each frame is solved with each number of threads
    #[arg(long, default_value_t = 5)]
    repeats: usize,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

const KINDS: [Kind; 5] = [Kind::Float, Kind::Gradient, Kind::Defocus30, Kind::Motion, Kind::NoStars];

#[allow(clippy::disallowed_methods, reason = "no runtime runs here whose clock a test could hold")]
fn now() -> Instant {
    Instant::now()
}

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let mut solvers = [1, 2].map(|threads| {
        let mut settings = Settings::flight().unwrap();
        settings.solver.threads = threads;
        Solver::new(catalogue.clone(), Arc::new(settings))
    });
    println!("{} frames of each kind, seed {}: median time by the wall, ms\n", args.frames, args.seed);
    println!("{:<12} {:>8} {:>10} {:>11} {:>7}", "", "robust", "1 thread", "2 threads", "ratio");
    for kind in KINDS {
        let mut medians = [const { Vec::new() }; 2];
        let mut robust = 0;
        for index in 0..args.frames {
            let frame = render(&RenderSpec::new(kind, args.seed, index), &catalogue).unwrap().frame;
            let mut runs = [const { Vec::new() }; 2];
            for run in 0..=args.repeats {
                for (solver, runs) in solvers.iter_mut().zip(&mut runs) {
                    let started = now();
                    let outcome = std::hint::black_box(solver.solve(&frame, &Prior::default(), &Unwatched));
                    let took = ms(started.elapsed());
                    // The first run of each warms the memory.
                    if run > 0 {
                        runs.push(took);
                    } else {
                        robust += usize::from(outcome.mode == SearchMode::Robust);
                    }
                }
            }
            medians.iter_mut().zip(&mut runs).for_each(|(medians, runs)| medians.push(quantile(runs, 0.5)));
        }
        let [one, two] = medians.map(|mut times| quantile(&mut times, 0.5));
        println!("{:<12} {:>8} {one:>10.2} {two:>11.2} {:>7.2}", kind.to_string(), robust / 2, two / one);
    }
}
