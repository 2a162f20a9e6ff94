//! Four exposures against one, out of focus: `cargo bench --bench series -- --series 100`.
//!
//! Each series is four exposures of a bit of sky under the sky at float by a camera that holds still, its stars discs of 2 to 12 px. The first
//! exposure by itself and the sum of all four are solved with shipped settings. What four exposures gain in signal over noise is told by the
//! sources that both have: it should be the root of four.

#![allow(clippy::unwrap_used, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use shared::{CpuWatch, quantile, timed};
use stars::catalog::Catalogue;
use stars::image::{Frame, Series};
use stars::settings::Settings;
use stars::simulate::Judged;
use stars::simulate::sky::{Kind, Part, RenderSpec, Truth, render};
use stars::sky::Vec3;
use stars::solve::{Exposures, Outcome, Prior, Reason, Report, Solver};
use std::sync::Arc;

/// Measures what several exposures gain
#[derive(Debug, Parser)]
struct Args {
    /// Series
    #[arg(long, default_value_t = 100)]
    series: u64,
    /// Seed of the series
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Fraction of the stars' light that comes through
    #[arg(long, default_value_t = 0.5)]
    starlight: f64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// Exposures of a series.
const EXPOSURES: u8 = 4;
/// Diameters of the discs, px: from the least to the greatest, evenly over the series.
const DISCS_PX: (f64, f64) = (2.0, 12.0);
/// Sources of a single exposure that stand out so far have a signal over noise to compare; and are no further from their like in the sum, px.
const SURE_SNR: f64 = 8.0;
const NEAR_PX: f64 = 2.0;

/// Outcomes of one way to solve.
#[derive(Default)]
struct Tally {
    solved: u64,
    wrong: u64,
    times: Vec<f64>,
}

impl Tally {
    fn solve(
        &mut self,
        solver: &mut Solver,
        (frame, exposures): (&Frame, &[Arc<Frame>]),
        truth: &Truth,
        catalogue: &Catalogue,
    ) -> Outcome {
        let exposures = Exposures { exposures: exposures.to_vec(), motion: None };
        let (outcome, ms) = timed(|| solver.solve_series(frame, &exposures, &Prior::default(), &CpuWatch));
        self.times.push(ms);
        if outcome.reason == Reason::Solved {
            self.solved += 1;
            let report = Report::new(&outcome, catalogue);
            self.wrong += u64::from(Judged::new(&report.pointing, &truth.attitude.unwrap()).unwrap().is_wrong());
        }
        outcome
    }

    fn print(&mut self, name: &str, series: u64) {
        let (median, most) = (quantile(&mut self.times, 0.5), quantile(&mut self.times, 0.99));
        println!("{name:<5} solved {} of {series}, wrong {}; median {median:.2} ms, p99 {most:.2} ms", self.solved, self.wrong);
    }
}

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let mut solver = Solver::new(Arc::clone(&catalogue), Arc::new(Settings::flight().unwrap()));
    let (mut one, mut four, mut gains) = (Tally::default(), Tally::default(), Vec::new());
    for index in 0..args.series {
        let part = (index as f64 + 0.5) / args.series as f64;
        let spec = |place: u8| RenderSpec {
            photon_bound: false,
            disc_px: Some(DISCS_PX.0 + part * (DISCS_PX.1 - DISCS_PX.0)),
            part: Some(Part { place, turns: vec![Vec3::zeros()], starlight: args.starlight, most_flux_adu: f64::INFINITY }),
            ..RenderSpec::new(Kind::Float, args.seed, index)
        };
        let rendered: Vec<_> = (0..EXPOSURES).map(|place| render(&spec(place), &catalogue).unwrap()).collect();
        let truth = rendered.first().unwrap().truth.clone();
        let series = Series::new(rendered.into_iter().map(|rendered| rendered.frame).collect()).unwrap();
        let (sum, exposures) = series.into_sum();
        let (single, sum) = (exposures.first().unwrap(), sum.unwrap());
        solver.prepare(sum.width, sum.height);
        let alone = one.solve(&mut solver, (single, std::slice::from_ref(single)), &truth, &catalogue);
        let together = four.solve(&mut solver, (&sum, &exposures), &truth, &catalogue);
        for source in alone.sources.iter().filter(|source| source.snr >= SURE_SNR && !source.saturated) {
            let near = |x: f64, y: f64| (source.x - x).hypot(source.y - y) < NEAR_PX;
            let like = together.sources.iter().find(|other| near(other.x, other.y));
            if let Some(like) = like.filter(|_| truth.stars.iter().any(|star| near(star.x, star.y))) {
                gains.push(like.snr / source.snr);
            }
        }
    }
    one.print("one", args.series);
    four.print("four", args.series);
    println!("gain in signal over noise {:.3} in the median of {} sources", quantile(&mut gains, 0.5), gains.len());
}
