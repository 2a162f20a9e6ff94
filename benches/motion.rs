//! Series of exposures that are trailed, solved with the gyros' rates and without: `cargo bench --bench motion -- --series 300`.
//!
//! One to four exposures of a random bit of sky within 30° of the galactic plane under the sky at float, in each of which every star is a
//! trail of 5 to 30 px; 8 to 15 stars stand 3 to 6 times above the noise of a single exposure, all others less. The gyros' rates have
//! noise. Each series is solved along its trails, and as a plain sum, with shipped settings; the truth is that of the series' middle. And once
//! more along its trails by one who is told where it looks to half a minute of arc: what is not solved then either has too few stars in it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "a bench may end where it stands")]

#[path = "../tests/shared/dim.rs"]
mod dim;
mod shared;

use clap::Parser;
use dim::{Drawn, draw};
use shared::{CpuWatch, quantile, timed};
use stars::catalog::Catalogue;
use stars::settings::Settings;
use stars::simulate::Judged;
use stars::sky::ARCSEC;
use stars::solve::{AttitudePrior, Exposures, Outcome, Prior, Reason, Report, SearchMode, Solver};
use std::sync::Arc;

/// Measures solving along trails
#[derive(Debug, Parser)]
struct Args {
    /// Series
    #[arg(long, default_value_t = 100)]
    series: u64,
    /// Seed of the series
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// The first of them
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Noise of the gyros, arcsec/s/√Hz
    #[arg(long, default_value_t = 4.0)]
    gyro_noise: f64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// One σ of what one who is told where a series looks knows of the boresight, and of the roll, rad.
const TOLD: (f64, f64) = (30.0 * ARCSEC, 300.0 * ARCSEC);

#[derive(Default)]
struct Tally {
    solved: u64,
    wrong: u64,
    times: Vec<f64>,
    /// Errors over σ: boresight per axis, roll.
    chi2: f64,
    roll_chi2: f64,
}

impl Tally {
    fn add(&mut self, outcome: &Outcome, ms: f64, drawn: &Drawn, catalogue: &Catalogue) -> String {
        self.times.push(ms);
        if outcome.reason != Reason::Solved {
            return "-".to_owned();
        }
        let report = Report::new(outcome, catalogue);
        let judged = Judged::new(&report.pointing, &drawn.middle).unwrap();
        self.solved += 1;
        self.chi2 += 0.5 * (judged.error / judged.sigma).powi(2);
        self.roll_chi2 += (judged.roll_error / judged.roll_sigma).powi(2);
        if judged.is_wrong() {
            self.wrong += 1;
            println!("wrong: {:.1}″ off with σ {:.1}″, mode {:?}", judged.error, judged.sigma, outcome.mode);
        }
        let how = if outcome.mode == SearchMode::Motion { 'm' } else { 'n' };
        format!("{how} {:.1}″ of σ {:.1}″", judged.error, judged.sigma)
    }

    fn print(&mut self, name: &str, series: u64) {
        let n = self.solved.max(1) as f64;
        println!(
            "{name:<8} solved {} of {series}, wrong {}; chi2 per axis {:.2}, of roll {:.2}; median {:.2} ms, p99 {:.2} ms",
            self.solved,
            self.wrong,
            self.chi2 / n,
            self.roll_chi2 / n,
            quantile(&mut self.times, 0.5),
            quantile(&mut self.times, 0.99)
        );
    }
}

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let mut solver = Solver::new(Arc::clone(&catalogue), Arc::new(Settings::flight().unwrap()));
    let (mut along, mut told, mut plain) = (Tally::default(), Tally::default(), Tally::default());
    for index in args.first..args.first + args.series {
        let drawn = draw(&catalogue, args.seed, index, args.gyro_noise);
        let moved = Exposures { exposures: drawn.exposures.clone(), motion: Some(Arc::new(drawn.measured.clone())) };
        solver.prepare(drawn.sum.width, drawn.sum.height);
        let (with, ms) = timed(|| solver.solve_series(&drawn.sum, &moved, &Prior::default(), &CpuWatch));
        let a = along.add(&with, ms, &drawn, &catalogue);
        let attitude = AttitudePrior { attitude: drawn.middle, sigma: TOLD.0, sigma_roll: TOLD.1 };
        let prior = Prior { attitude: Some(attitude), ..Prior::default() };
        let (with_prior, ms) = timed(|| solver.solve_series(&drawn.sum, &moved, &prior, &CpuWatch));
        let c = told.add(&with_prior, ms, &drawn, &catalogue);
        let unknown = Exposures { motion: None, ..moved };
        let (without, ms) = timed(|| solver.solve_series(&drawn.sum, &unknown, &Prior::default(), &CpuWatch));
        let b = plain.add(&without, ms, &drawn, &catalogue);
        let turn = drawn.truth.track().turn_to_middle().norm() / ARCSEC;
        println!(
            "{index:>4}: {} exposures, {} stars, {turn:.0}″ to the middle: along {a} ({} sources, {:?} {}), told {c}, plain {b}",
            drawn.exposures.len(),
            drawn.stars,
            with.sources.len(),
            with.reason,
            with.detail
        );
    }
    along.print("along", args.series);
    told.print("told", args.series);
    plain.print("plain", args.series);
}
