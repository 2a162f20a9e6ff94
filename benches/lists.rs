//! How well lists of sources are matched, without pixels: `cargo bench --bench lists -- --count 2000 --none 2000`.
//!
//! Lists with stars: attitudes uniform over the sphere, a gnomonic camera whose plate scale is known to ±1 %, centroids and
//! magnitudes with noise, one star in ten missing, and false sources uniform in place and in magnitude, which puts most of them
//! among the brightest, for real stars crowd the faint end. Lists that must not be solved: no stars at all, or a mirrored sky.
//! Thread CPU time of the search alone, with shipped settings.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use shared::{quantile, timed};
use stars::catalog::{Catalogue, Field, FieldKey};
use stars::settings::Settings;
use stars::sky::{Attitude, Vec3};
use stars::solve::{FrameGeometry, PatternSearch, PatternSource, Pose, SearchEnd, SearchRules, SearchTally};
use std::f64::consts::{LN_10, PI, TAU};

/// Measures the match of source lists
#[derive(Debug, Parser)]
struct Args {
    /// Lists with stars, of each case
    #[arg(long, default_value_t = 2000)]
    count: u64,
    /// Lists that must not be solved, in all
    #[arg(long, default_value_t = 2000)]
    none: u64,
    /// Seed of the lists
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// The flight camera: columns and rows, px; plate scale in the middle of its range, arcsec/px; half width of the range.
const WIDTH: usize = 1536;
const HEIGHT: usize = 1024;
const PLATESCALE_ARCSEC: f64 = 9.45;
const PLATESCALE_KNOWN_TO: f64 = 0.01;
/// Centroid σ of a list, px; noise of a magnitude; share of stars that are not seen.
const SIGMA_PX: (f64, f64) = (0.3, 1.0);
const MAG_NOISE: f64 = 0.5;
const DROPPED: f64 = 0.1;
/// Brighter than the brightest star by up to this: the false sources among them; and those brighter than all.
const FALSE_MAG_ABOVE: f64 = 0.5;
const TOP_MAG_ABOVE: (f64, f64) = (0.6, 2.0);
/// A solution is right where no corner of the picture, nor its centre, is further off than this, px.
const RIGHT_PX: f64 = 30.0;

/// True stars, false sources, and false sources brighter than all.
const CASES: [(usize, usize, usize); 3] = [(8, 8, 0), (8, 5, 3), (10, 10, 0)];
/// Lists that must not be solved.
const NONE: [&str; 5] = ["uniform", "few", "mirrored", "clustered", "linear"];
/// Bounds on the probability of chance, whose truth is counted.
const BOUNDS_LOG10: [i32; 4] = [-1, -2, -3, -4];

/// A source before the camera's model is applied: offsets along left and up, px, and magnitude.
#[derive(Debug, Clone, Copy)]
struct Spot {
    left: f64,
    up: f64,
    mag: f64,
}

/// Draws lists for one field.
struct Draw<'a> {
    field: &'a Field,
    random: ChaCha8Rng,
}

impl Draw<'_> {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.random::<f64>()
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    fn place(&mut self) -> (f64, f64) {
        let (w, h) = (WIDTH as f64 / 2.0, HEIGHT as f64 / 2.0);
        (self.uniform(-w, w), self.uniform(-h, h))
    }

    /// A pose that may be anywhere.
    fn pose(&mut self) -> Pose {
        let attitude = Attitude::from_angles(self.uniform(0.0, TAU), self.uniform(-1.0, 1.0).asin(), self.uniform(-PI, PI));
        let scale = self.uniform(1.0 - PLATESCALE_KNOWN_TO, 1.0 + PLATESCALE_KNOWN_TO);
        Pose::undistorted(attitude, self.field.geometry.platescale * scale)
    }

    /// The `count` stars that look brightest at a pose.
    fn stars(&mut self, pose: &Pose, count: usize, sigma: f64, half_diagonal: f64) -> Vec<Spot> {
        let mut seen = Vec::new();
        // A little more than the half diagonal; what is outside the picture is left out below.
        let radius = (1.1 * half_diagonal * pose.platescale).atan();
        self.field.stars.near(&pose.attitude.boresight(), radius, |_, star| {
            if let Some((left, up)) = pose.project(&star.direction, half_diagonal)
                && left.abs() < WIDTH as f64 / 2.0
                && up.abs() < HEIGHT as f64 / 2.0
            {
                seen.push(Spot { left, up, mag: f64::from(star.mag) });
            }
        });
        seen.retain(|_| self.random.random::<f64>() >= DROPPED);
        for spot in &mut seen {
            spot.mag += MAG_NOISE * self.normal();
            spot.left += sigma * self.normal();
            spot.up += sigma * self.normal();
        }
        seen.sort_by(|a, b| a.mag.total_cmp(&b.mag));
        seen.truncate(count);
        seen
    }

    /// Adds false sources anywhere on the picture to a list of stars: some among them, some brighter than all.
    fn spoil(&mut self, spots: &mut Vec<Spot>, among: usize, on_top: usize) {
        let (brightest, faintest) = spots.iter().fold((f64::MAX, f64::MIN), |(b, f), s| (b.min(s.mag), f.max(s.mag)));
        for i in 0..among + on_top {
            let (left, up) = self.place();
            let mag = if i < among {
                self.uniform(brightest - FALSE_MAG_ABOVE, faintest)
            } else {
                brightest - self.uniform(TOP_MAG_ABOVE.0, TOP_MAG_ABOVE.1)
            };
            spots.push(Spot { left, up, mag });
        }
    }

    /// A list of a kind that must not be solved.
    fn none(&mut self, kind: &str, sigma: f64, half_diagonal: f64) -> Vec<Spot> {
        let count = self.random.random_range(10..=20);
        let mut spots: Vec<Spot> = Vec::new();
        match kind {
            "few" => {
                for _ in 0..self.random.random_range(0..=7) {
                    let (left, up) = self.place();
                    spots.push(Spot { left, up, mag: 0.0 });
                }
            }
            "mirrored" => {
                let pose = self.pose();
                let stars = self.random.random_range(8..=20);
                spots = self.stars(&pose, stars, sigma, half_diagonal);
                spots.iter_mut().for_each(|s| s.left = -s.left);
                self.spoil(&mut spots, 20 - stars, 0);
                return spots;
            }
            "clustered" => {
                let centres: Vec<((f64, f64), f64)> =
                    (0..self.random.random_range(1..=3)).map(|_| (self.place(), self.uniform(20.0, 120.0))).collect();
                for i in 0..count {
                    let ((left, up), width) = centres[i % centres.len()];
                    spots.push(Spot { left: left + width * self.normal(), up: up + width * self.normal(), mag: 0.0 });
                }
            }
            "linear" => {
                // Bad columns and rows, and streaks of any direction; along some of them the sources are evenly spaced.
                let lines: Vec<((f64, f64), f64, bool)> = (0..self.random.random_range(1..=3))
                    .map(|_| {
                        let angle = if self.random.random() {
                            self.uniform(0.0, PI)
                        } else {
                            0.5 * PI * self.random.random_range(0..2) as f64
                        };
                        (self.place(), angle, self.random.random())
                    })
                    .collect();
                for i in 0..count {
                    let ((left, up), angle, even) = lines[i % lines.len()];
                    let along = if even { (i as f64 - 0.5 * count as f64) * 60.0 } else { self.uniform(-700.0, 700.0) };
                    let across = sigma * self.normal();
                    let (sin, cos) = angle.sin_cos();
                    spots.push(Spot { left: left + along * cos - across * sin, up: up + along * sin + across * cos, mag: 0.0 });
                }
            }
            _ => {
                for _ in 0..count {
                    let (left, up) = self.place();
                    spots.push(Spot { left, up, mag: 0.0 });
                }
            }
        }
        spots.retain(|s| s.left.abs() < WIDTH as f64 / 2.0 && s.up.abs() < HEIGHT as f64 / 2.0);
        for spot in &mut spots {
            spot.mag = self.uniform(0.0, 3.0);
        }
        spots
    }
}

/// What the solver has, and how it is asked.
struct Matcher<'a> {
    field: &'a Field,
    geometry: FrameGeometry,
    rules: SearchRules<'a>,
}

impl Matcher<'_> {
    fn sources(&self, mut spots: Vec<Spot>, sigma: f64) -> Vec<PatternSource> {
        spots.sort_by(|a, b| a.mag.total_cmp(&b.mag));
        let scale = self.field.geometry.platescale;
        spots.iter().map(|s| PatternSource::new(s.left, s.up, sigma, 10f64.powf(-0.4 * s.mag), scale)).collect()
    }

    fn search(&self, sources: &[PatternSource]) -> ((SearchEnd, SearchTally), f64) {
        timed(|| PatternSearch::new(self.field, sources, &self.geometry, &self.rules).run())
    }

    /// Whether one who knows the truth could show that it is not chance: what no search can do better than.
    fn would_serve(&self, sources: &[PatternSource], truth: &Pose) -> bool {
        let search = PatternSearch::new(self.field, sources, &self.geometry, &self.rules);
        search.judge(truth, self.rules.min_matched).is_some_and(|hypothesis| self.rules.are_met_by(&hypothesis))
    }

    /// Whether a pose puts the picture's centre and corners where the truth does.
    fn is_right(&self, pose: &Pose, truth: &Pose) -> bool {
        let (w, h) = (self.geometry.size.0 / 2.0, self.geometry.size.1 / 2.0);
        [(0.0, 0.0), (w, h), (w, -h), (-w, h), (-w, -h)].into_iter().all(|(left, up)| {
            let there = truth.attitude.to_sky(&Vec3::new(left * truth.platescale, up * truth.platescale, 1.0));
            pose.project(&there, self.geometry.half_diagonal).is_some_and(|(l, u)| (l - left).hypot(u - up) < RIGHT_PX)
        })
    }
}

fn main() {
    let args = Args::parse();
    let mut settings = Settings::flight().unwrap();
    let matching = &mut settings.solver.matching;
    matching.platescale_min_arcsec_px = PLATESCALE_ARCSEC * (1.0 - PLATESCALE_KNOWN_TO);
    matching.platescale_max_arcsec_px = PLATESCALE_ARCSEC * (1.0 + PLATESCALE_KNOWN_TO);
    let catalogue = Catalogue::embedded().unwrap();
    let field = Field::build(&catalogue, &FieldKey::new(&catalogue, &settings, WIDTH, HEIGHT), &|| true).unwrap();
    let rules = SearchRules {
        min_matched: settings.solver.matching.min_matched as usize,
        max_false_ln: settings.solver.matching.max_false_probability_log10 * LN_10,
        budget: u64::from(settings.solver.matching.candidate_budget),
        region: None,
        region_only: false,
        stop: &|| None,
    };
    let matcher = Matcher { field: &field, geometry: FrameGeometry::new(&settings.solver, &field, WIDTH, HEIGHT), rules };
    println!("lists of sources, seed {}, plate scale known to ±{} %, thread CPU time", args.seed, 100.0 * PLATESCALE_KNOWN_TO);
    println!(
        "\n{:<34} {:>7} {:>9} {:>6} {:>10} {:>10} {:>10} {:>10} {:>9} {:>11}",
        "true + false + brighter than all",
        "lists",
        "right %",
        "wrong",
        "median ms",
        "p99 ms",
        "p99.9 ms",
        "candidates",
        "ns each",
        "possible %"
    );
    for case in CASES {
        with_stars(&matcher, &args, case);
    }
    without_stars(&matcher, &args);
}

/// Lists of stars and false sources.
fn with_stars(matcher: &Matcher<'_>, args: &Args, (stars, among, on_top): (usize, usize, usize)) {
    let case = ((stars * 100 + among) * 100 + on_top) as u64;
    let (mut right, mut wrong, mut times, mut candidates, mut possible) = (0u64, 0u64, Vec::new(), 0u64, 0u64);
    for index in 0..args.count {
        let mut draw = Draw { field: matcher.field, random: ChaCha8Rng::seed_from_u64(args.seed) };
        draw.random.set_stream(case << 32 | index);
        let (truth, sigma) = (draw.pose(), draw.uniform(SIGMA_PX.0, SIGMA_PX.1));
        let mut spots = draw.stars(&truth, stars, sigma, matcher.geometry.half_diagonal);
        draw.spoil(&mut spots, among, on_top);
        let sources = matcher.sources(spots, sigma);
        possible += u64::from(matcher.would_serve(&sources, &truth));
        let ((end, tally), time) = matcher.search(&sources);
        if let SearchEnd::Found(found) = end {
            let is_right = matcher.is_right(&found.pose, &truth);
            (right, wrong) = (right + u64::from(is_right), wrong + u64::from(!is_right));
        }
        times.push(time);
        candidates += tally.candidates;
    }
    let spent: f64 = times.iter().sum();
    let [median, p99, p999] = [0.5, 0.99, 0.999].map(|part| quantile(&mut times, part));
    println!(
        "{:<34} {:>7} {:>9.3} {wrong:>6} {median:>10.3} {p99:>10.3} {p999:>10.3} {:>10.0} {:>9.0} {:>11.3}",
        format!("{stars}+{among}+{on_top}"),
        args.count,
        100.0 * right as f64 / args.count.max(1) as f64,
        candidates as f64 / args.count.max(1) as f64,
        1e6 * spent / candidates.max(1) as f64,
        100.0 * possible as f64 / args.count.max(1) as f64,
    );
}

/// Lists that must not be solved, a fifth of each kind: how often each bound on the probability of chance is kept.
fn without_stars(matcher: &Matcher<'_>, args: &Args) {
    println!(
        "\n{:<34} {:>7} {:>9} {:>24} {:>10} {:>10}",
        "must not be solved", "lists", "served", "best under 10^-1 … -4", "median ms", "p99 ms"
    );
    let mut sums = [0u64; BOUNDS_LOG10.len()];
    let (mut lists, mut served_in_all) = (0u64, 0u64);
    let mut all_times = Vec::new();
    for (number, kind) in NONE.iter().enumerate() {
        let (mut served, mut under, mut times) = (0u64, [0u64; BOUNDS_LOG10.len()], Vec::new());
        for index in 0..args.none / NONE.len() as u64 {
            let mut draw = Draw { field: matcher.field, random: ChaCha8Rng::seed_from_u64(args.seed) };
            draw.random.set_stream(1 << 63 | (number as u64) << 32 | index);
            let sigma = draw.uniform(SIGMA_PX.0, SIGMA_PX.1);
            let spots = draw.none(kind, sigma, matcher.geometry.half_diagonal);
            let ((end, _), time) = matcher.search(&matcher.sources(spots, sigma));
            times.push(time);
            served += u64::from(matches!(end, SearchEnd::Found(_)));
            if let SearchEnd::Found(best) | SearchEnd::Exhausted(Some(best)) | SearchEnd::Budget(Some(best)) = end {
                under
                    .iter_mut()
                    .zip(BOUNDS_LOG10)
                    .for_each(|(n, bound)| *n += u64::from(best.false_ln <= f64::from(bound) * LN_10));
            }
        }
        sums.iter_mut().zip(under).for_each(|(sum, n)| *sum += n);
        (lists, served_in_all) = (lists + times.len() as u64, served_in_all + served);
        all_times.extend_from_slice(&times);
        none_row(kind, served, &under, &mut times);
    }
    none_row("all", served_in_all, &sums, &mut all_times);
    for (bound, n) in BOUNDS_LOG10.iter().zip(sums) {
        println!("bound 10^{bound}: {n} of {lists}, a share of {:.1e}", n as f64 / lists.max(1) as f64);
    }
}

fn none_row(name: &str, served: u64, under: &[u64], times: &mut [f64]) {
    let [median, p99] = [0.5, 0.99].map(|part| quantile(times, part));
    let under = under.iter().map(u64::to_string).collect::<Vec<_>>().join(" ");
    println!("{name:<34} {:>7} {served:>9} {under:>24} {median:>10.3} {p99:>10.3}", times.len());
}
