//! What a prior is worth, and that a wrong one does no harm: `cargo bench --bench tracking -- --frames 200`.
//!
//! Frames with 3 to 6 stars over SNR 5, each solved lost in space, with the true attitude moved by an error that its σ tells, with the
//! plate scale too, and with priors that are wrong: by degrees, in roll, and of a sky that is turned over. Then lists of sources
//! anywhere on the picture, without pixels, near a prior: how often each bound on the probability of chance is kept. Then the time of
//! ordinary frames. Shipped settings, thread CPU time.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use shared::{CpuWatch, ms, quantile, timed};
use stars::catalog::Catalogue;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, Rendered, Truth, render};
use stars::sky::{ARCSEC, Attitude, DEG, Vec3, separation};
use stars::solve::{
    AttitudePrior, FoundBy, FrameGeometry, LensPrior, NearRules, NearSearch, Outcome, PatternSource, Prior, Region, SearchEnd,
    Solver,
};
use std::f64::consts::{LN_10, PI, TAU};
use std::sync::Arc;

/// Measures what a prior is worth
#[derive(Debug, Parser)]
struct Args {
    /// Frames with few stars
    #[arg(long, default_value_t = 200)]
    frames: u64,
    /// Ordinary frames whose time is taken
    #[arg(long, default_value_t = 40)]
    timed: u64,
    /// Lists of sources without a star
    #[arg(long, default_value_t = 200_000)]
    lists: u64,
    /// Seed of the frames
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Error of the prior's boresight for each axis, one σ
    #[arg(long, default_value_t = 0.1)]
    sigma_deg: f64,
    /// Error of the prior's roll, one σ
    #[arg(long, default_value_t = 0.5)]
    sigma_roll_deg: f64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// What is known of the plate scale after a solution, one σ of its logarithm, and of the distortion.
const SIGMA_LN_PLATESCALE: f64 = 5e-4;
const SIGMA_K1: f64 = 2e-4;
/// Bounds on the probability of chance, whose truth is counted.
const BOUNDS_LOG10: [i32; 4] = [-1, -2, -3, -4];

/// What is told beforehand of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Told {
    Nothing,
    Attitude,
    AttitudeAndLens,
    WrongByDegrees,
    WrongRoll,
    /// The right attitude, but the picture is said to be turned over.
    Mirrored,
}

const CASES: [(&str, Told); 6] = [
    ("lost in space", Told::Nothing),
    ("attitude", Told::Attitude),
    ("attitude and plate scale", Told::AttitudeAndLens),
    ("wrong by degrees", Told::WrongByDegrees),
    ("wrong roll", Told::WrongRoll),
    ("mirrored sky", Told::Mirrored),
];

/// The prior of a frame, wrong or right with the error that it says it has.
fn prior(truth: &Truth, told: Told, args: &Args, random: &mut ChaCha8Rng) -> Prior {
    let Some(attitude) = truth.attitude.filter(|_| told != Told::Nothing) else { return Prior::default() };
    let mut normal = || StandardNormal.sample(random);
    let (sigma, sigma_roll) = (args.sigma_deg * DEG, args.sigma_roll_deg * DEG);
    let error = Vec3::new(sigma * normal(), sigma * normal(), sigma_roll * normal());
    let lens_error: f64 = normal();
    let wrong = match told {
        Told::WrongByDegrees => {
            let (far, way): (f64, f64) = (random.random_range(1.0..10.0) * DEG, random.random_range(0.0..TAU));
            Vec3::new(far * way.cos(), far * way.sin(), 0.0)
        }
        Told::WrongRoll => Vec3::new(0.0, 0.0, random.random_range(5.0..175.0) * DEG),
        _ => Vec3::zeros(),
    };
    let attitude = turned(&turned(&attitude, &error), &wrong);
    let lens = LensPrior {
        platescale: truth.platescale * (1.0 + SIGMA_LN_PLATESCALE * lens_error),
        sigma_ln: SIGMA_LN_PLATESCALE,
        k1: truth.k1,
        sigma_k1: SIGMA_K1,
    };
    Prior {
        attitude: Some(AttitudePrior { attitude, sigma, sigma_roll }),
        lens: (told != Told::Attitude).then_some(lens),
        ..Prior::default()
    }
}

/// Turned about left and up by the first two, then about the boresight by the third, rad, which may be large.
fn turned(attitude: &Attitude, rotation: &Vec3) -> Attitude {
    let tilted = attitude.turned(&Vec3::new(rotation.x, rotation.y, 0.0));
    let (sin, cos) = rotation.z.sin_cos();
    Attitude::from_boresight_up(&tilted.boresight(), &(tilted.up() * cos + tilted.left() * sin)).unwrap()
}

/// Whether a solution may be served: within the larger of 5″ and 6 σ.
fn is_right(outcome: &Outcome, truth: &Truth) -> bool {
    let (Some(solution), Some(attitude)) = (&outcome.solution, &truth.attitude) else { return false };
    let sigmas = solution.sigmas();
    let sigma = sigmas.x.hypot(sigmas.y) / 2f64.sqrt();
    separation(&solution.attitude.boresight(), &attitude.boresight()) <= (5.0 * ARCSEC).max(6.0 * sigma)
}

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let settings = Settings::flight().unwrap();
    let mut solver = Solver::new(catalogue.clone(), Arc::new(settings.clone()));
    let mut frames: Vec<Rendered> =
        (0..args.frames).map(|index| render(&RenderSpec::new(Kind::Faint, args.seed, index), &catalogue).unwrap()).collect();
    frames.iter_mut().for_each(|rendered| rendered.frame.stamp.origin.clear());
    let Some(first) = frames.first() else { return };
    solver.prepare(first.frame.width, first.frame.height);
    println!(
        "{} faint frames, seed {}, prior of {}° and {}° in roll\n",
        frames.len(),
        args.seed,
        args.sigma_deg,
        args.sigma_roll_deg
    );
    println!("{:<26} {:>9} {:>24} {:>8} {:>6}", "told beforehand", "right %", "of 3 / 4 / 5 / 6 stars", "tracked", "wrong");
    for (name, told) in CASES {
        let mut solver = solver.clone();
        if told == Told::Mirrored {
            let mut mirrored = settings.clone();
            mirrored.camera.mirrored = true;
            solver.set_settings(Arc::new(mirrored));
        }
        faint(name, told, &frames, &mut solver, &args);
    }
    lists(&mut solver, &args);
    times(&mut solver, &catalogue, &args);
}

/// Solves the faint frames with what is told of them.
fn faint(name: &str, told: Told, frames: &[Rendered], solver: &mut Solver, args: &Args) {
    let (mut right, mut wrong, mut tracked) = (0u32, 0u32, 0u32);
    let mut by_stars = [(0u32, 0u32); 4];
    for Rendered { frame, truth } in frames {
        let mut random = ChaCha8Rng::seed_from_u64(args.seed);
        random.set_stream(truth.index);
        let outcome = solver.solve(frame, &prior(truth, told, args, &mut random), &CpuWatch);
        let is_right = told != Told::Mirrored && is_right(&outcome, truth);
        tracked += u32::from(outcome.solution.is_some() && outcome.found_by == Some(FoundBy::Tracked));
        right += u32::from(is_right);
        wrong += u32::from(outcome.solution.is_some() && !is_right);
        if outcome.solution.is_some() && !is_right {
            println!(
                "  wrong: frame {} ({:?}, {} matched)",
                truth.index,
                outcome.found_by,
                outcome.solution.as_ref().map_or(0, |s| s.matches.len())
            );
        }
        if let Some((all, solved)) = by_stars.get_mut(truth.stars_over_snr5.wrapping_sub(3)) {
            *all += 1;
            *solved += u32::from(is_right);
        }
    }
    let percent = |part: u32, all: u32| 100.0 * f64::from(part) / f64::from(all.max(1));
    let shares = by_stars.map(|(all, solved)| format!("{:.0}", percent(solved, all))).join(" / ");
    println!("{name:<26} {:>9.1} {shares:>24} {tracked:>8} {wrong:>6}", percent(right, frames.len() as u32));
}

/// Lists of 3 to 8 sources anywhere on the picture: how often the best candidate near a prior is below each bound.
fn lists(solver: &mut Solver, args: &Args) {
    let field = solver.field().unwrap().clone();
    let settings = solver.settings().solver.clone();
    let geometry = FrameGeometry::new(&settings, &field, 1536, 1024);
    let lens = LensPrior { platescale: field.geometry.platescale, sigma_ln: SIGMA_LN_PLATESCALE, k1: 0.0, sigma_k1: SIGMA_K1 };
    let geometry = geometry.with_lens(&lens);
    let rules = NearRules { min_matched: 3, max_false_ln: settings.matching.max_false_probability_log10 * LN_10, stop: &|| None };
    let (mut under, mut served) = ([0u64; BOUNDS_LOG10.len()], 0u64);
    for index in 0..args.lists {
        let mut random = ChaCha8Rng::seed_from_u64(args.seed);
        random.set_stream(1 << 63 | index);
        let attitude = Attitude::from_angles(
            random.random_range(0.0..TAU),
            random.random_range(-1.0f64..1.0).asin(),
            random.random_range(-PI..PI),
        );
        let told = AttitudePrior { attitude, sigma: args.sigma_deg * DEG, sigma_roll: args.sigma_roll_deg * DEG };
        let region = Region::of(&Prior { attitude: Some(told), ..Prior::default() }, &[]).unwrap();
        let sigma = random.random_range(0.05..0.5);
        let mut sources: Vec<PatternSource> = (0..random.random_range(3..=8))
            .map(|_| {
                let (left, up) = (random.random_range(-768.0..768.0), random.random_range(-512.0..512.0));
                PatternSource::new(left, up, sigma, 10f64.powf(-0.4 * random.random_range(0.0..3.0)), field.geometry.platescale)
            })
            .collect();
        sources.sort_by(|a, b| a.mag.total_cmp(&b.mag));
        let Some(search) = NearSearch::new(&field, &sources, &geometry, &region, &rules) else { continue };
        let (end, _) = search.run();
        served += u64::from(matches!(end, SearchEnd::Found(_)));
        if let SearchEnd::Found(best) | SearchEnd::Exhausted(Some(best)) | SearchEnd::Budget(Some(best)) = end {
            under.iter_mut().zip(BOUNDS_LOG10).for_each(|(n, bound)| *n += u64::from(best.false_ln <= f64::from(bound) * LN_10));
        }
    }
    println!("\n{} lists of 3 to 8 sources that are no stars, near a prior: {served} served", args.lists);
    for (bound, n) in BOUNDS_LOG10.iter().zip(under) {
        println!("bound 10^{bound}: a share of {:.1e}", n as f64 / args.lists.max(1) as f64);
    }
}

/// The match of ordinary frames, lost in space and tracked.
fn times(solver: &mut Solver, catalogue: &Catalogue, args: &Args) {
    /// Times that each frame is solved; the median counts.
    const REPEATS: usize = 5;
    println!("\n{:<26} {:>11} {:>11} {:>11} {:>8} {:>8}", "float frames", "match", "p95", "whole", "tracked", "wrong");
    let frames: Vec<Rendered> =
        (0..args.timed).map(|index| render(&RenderSpec::new(Kind::Float, args.seed, index), catalogue).unwrap()).collect();
    for (name, told) in CASES.iter().take(4) {
        let (mut matching, mut whole, mut tracked, mut wrong) = (Vec::new(), Vec::new(), 0, 0);
        for Rendered { frame, truth } in &frames {
            let mut random = ChaCha8Rng::seed_from_u64(args.seed);
            random.set_stream(truth.index);
            let prior = prior(truth, *told, args, &mut random);
            let (outcomes, mut took): (Vec<Outcome>, Vec<f64>) =
                (0..REPEATS).map(|_| timed(|| solver.solve(frame, &prior, &CpuWatch))).unzip();
            let mut matched: Vec<f64> = outcomes.iter().map(|outcome| ms(outcome.times.match_)).collect();
            matching.push(quantile(&mut matched, 0.5));
            whole.push(quantile(&mut took, 0.5));
            let last = &outcomes[0];
            tracked += u32::from(last.found_by == Some(FoundBy::Tracked));
            wrong += u32::from(last.solution.is_some() && !is_right(last, truth));
        }
        let [median, p95] = [0.5, 0.95].map(|part| quantile(&mut matching, part));
        let whole = quantile(&mut whole, 0.5);
        println!("{name:<26} {median:>8.3} ms {p95:>8.3} ms {whole:>8.2} ms {tracked:>8} {wrong:>8}");
    }
}
