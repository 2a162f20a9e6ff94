//! Series of exposures that are trailed, solved with the gyros' rates and without: `cargo bench --bench motion -- --series 300`.
//!
//! One to four exposures of a random bit of sky within 30° of the galactic plane under the sky at float, in each of which every star is a
//! trail of 5 to 30 px; 8 to 15 stars stand 3 to 6 times above the noise of a single exposure, all others less. The gyros' rates have
//! noise. Each series is solved along its trails, and as a plain sum, with shipped settings; the truth is that of the series' middle. And once
//! more along its trails by one who is told where it looks to half a minute of arc: what is not solved then either has too few stars in it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use shared::{CpuWatch, quantile, timed};
use stars::catalog::Catalogue;
use stars::image::{Frame, coadd};
use stars::settings::Settings;
use stars::simulate::Judged;
use stars::simulate::sky::{Kind, Part, RenderSpec, render};
use stars::sky::{ARCSEC, Attitude, DEG, Vec3};
use stars::solve::{AttitudePrior, Motion, Moved, Outcome, Prior, Reason, Report, SearchMode, Solver};
use std::f64::consts::TAU;
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

/// Length of one exposure and of the pause after it, s (the paper: 120 ms, 190 ms); samples a second, Hz.
const EXPOSURE_S: f64 = 0.12;
const GAP_S: f64 = 0.19;
const SAMPLE_HZ: f64 = 100.16;
/// Before the first exposure, s.
const LEAD_S: f64 = 0.05;
/// Length of a trail in one exposure, px.
const STREAK_PX: (f64, f64) = (5.0, 30.0);
/// Stars, and the signal over noise in a single exposure of the faintest and of the brightest.
const STARS: (usize, usize) = (8, 15);
const SNR: (f64, f64) = (3.0, 6.0);
/// Plate scale by which streaks are drawn, arcsec/px.
const PLATESCALE_ARCSEC: f64 = 9.44;

/// One σ of what one who is told where a series looks knows of the boresight, and of the roll, rad.
const TOLD: (f64, f64) = (30.0 * ARCSEC, 300.0 * ARCSEC);

/// How much brighter stars are made than they are to see which are the brightest.
const PROBE: f64 = 10.0;

/// A series as it was, and as the gyros saw it.
struct Drawn {
    truth: Motion,
    measured: Motion,
    exposures: Vec<Arc<Frame>>,
    sum: Frame,
    /// Attitude in the middle of the series.
    middle: Attitude,
    stars: usize,
}

fn draw(catalogue: &Catalogue, seed: u64, index: u64, gyro_noise: f64) -> Drawn {
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(index));
    let count = 1 + (index % 4) as usize;
    let uniform = |random: &mut ChaCha8Rng, (low, high): (f64, f64)| low + (high - low) * random.random::<f64>();
    let (streak, heading) = (uniform(&mut random, STREAK_PX), uniform(&mut random, (0.0, TAU)));
    let rate = streak * PLATESCALE_ARCSEC * ARCSEC / EXPOSURE_S;
    let (elevation, roll) = (uniform(&mut random, (20.0, 50.0)) * DEG, uniform(&mut random, (-3.0, 3.0)) * DEG);
    let length = LEAD_S + count as f64 * (EXPOSURE_S + GAP_S);
    let samples = (length * SAMPLE_HZ).ceil() as usize + 1;
    // The direction turns by up to a quarter of a turn a second.
    let bend = uniform(&mut random, (-0.25, 0.25)) * TAU;
    let rates: Vec<(f64, f64)> = (0..samples)
        .map(|i| {
            let heading = heading + bend * i as f64 / SAMPLE_HZ;
            (rate * heading.cos() / elevation.cos(), rate * heading.sin())
        })
        .collect();
    let exposures = (0..count).map(|k| (LEAD_S + k as f64 * (EXPOSURE_S + GAP_S), EXPOSURE_S)).collect();
    let truth = Motion { rates, sample_rate_hz: SAMPLE_HZ, exposures, elevation, roll, drift: gyro_noise * ARCSEC };
    let sigma = gyro_noise * ARCSEC * SAMPLE_HZ.sqrt();
    let mut noisy = |rate: f64| -> f64 {
        let noise: f64 = StandardNormal.sample(&mut random);
        rate + sigma * noise
    };
    let measured = Motion { rates: truth.rates.iter().map(|(az, el)| (noisy(*az), noisy(*el))).collect(), ..truth.clone() };
    let wanted = random.random_range(STARS.0..=STARS.1);
    let turns = |k: usize| -> Vec<Vec3> {
        let (start, length) = truth.exposures[k];
        let steps = (3.0 * streak).ceil() as usize;
        let track = truth.track();
        (0..steps).map(|i| track.turn_at(start + length * (i as f64 + 0.5) / steps as f64)).collect()
    };
    let spec = |place: usize, starlight: f64, most_flux_adu: f64| RenderSpec {
        photon_bound: false,
        part: Some(Part { place: place as u8, turns: turns(place), starlight, most_flux_adu }),
        ..RenderSpec::new(Kind::Motion, seed, index)
    };
    // How bright the stars are by themselves, and so how much they are dimmed.
    let probe = render(&spec(0, PROBE, f64::INFINITY), catalogue).unwrap().truth;
    let mut stars: Vec<(f64, f64)> = probe.stars.iter().map(|star| (star.snr, star.flux_adu)).collect();
    stars.sort_by(|a, b| b.0.total_cmp(&a.0));
    let faintest = stars[wanted.min(stars.len()) - 1];
    let (starlight, most) = (PROBE * SNR.0 / faintest.0, faintest.1 / faintest.0 * SNR.1);
    let frames: Vec<Frame> = (0..count).map(|place| render(&spec(place, starlight, most), catalogue).unwrap().frame).collect();
    let middle = probe.attitude.unwrap().turned(&truth.track().turn_to_middle());
    let sum = coadd(&frames).unwrap();
    let exposures = frames.into_iter().map(Arc::new).collect();
    Drawn { truth, measured, exposures, sum, middle, stars: wanted.min(stars.len()) }
}

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
        let moved = Moved { exposures: drawn.exposures.clone(), motion: Arc::new(drawn.measured.clone()) };
        solver.prepare(drawn.sum.width, drawn.sum.height);
        let (with, ms) = timed(|| solver.solve_moved(&drawn.sum, &moved, &Prior::default(), &CpuWatch));
        let a = along.add(&with, ms, &drawn, &catalogue);
        let attitude = AttitudePrior { attitude: drawn.middle, sigma: TOLD.0, sigma_roll: TOLD.1 };
        let prior = Prior { attitude: Some(attitude), ..Prior::default() };
        let (with_prior, ms) = timed(|| solver.solve_moved(&drawn.sum, &moved, &prior, &CpuWatch));
        let c = told.add(&with_prior, ms, &drawn, &catalogue);
        let (without, ms) = timed(|| solver.solve(&drawn.sum, &Prior::default(), &CpuWatch));
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
