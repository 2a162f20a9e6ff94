//! Ours and the `tetra3` crate on the same frames in one run: `cargo bench --bench peers -- --kinds night,float --frames 40`.
//!
//! Thread CPU time from 16-bit pixels in memory to the outcome, one thread, lost in space, the plate scale's range alone known;
//! shipped settings on our side, and on the other its own defaults, a finer local background (better on daytime skies), and its fast
//! one-pass extraction. Its database is made of the stars of our catalogue, once, and kept beside the build. Each frame is solved a
//! few times and its median counts. A solution is right within the larger of 5″ and 6 σ of the sky at the picture's centre.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a bench may end where it stands")]

mod shared;

use clap::Parser;
use shared::{quantile, timed};
use stars::catalog::Catalogue;
use stars::image::Frame;
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, Rendered, render};
use stars::sky::{ARCSEC, DEG, RowOrder, Vec3, direction, separation};
use stars::solve::{Outcome, Prior, Solver, Unwatched};
use std::path::PathBuf;
use std::sync::Arc;
use tetra3::centroid_extraction::{CentroidExtractionConfig, CentroidExtractor, FastCentroidConfig, extract_centroids_fast};
use tetra3::{Centroid, GenerateDatabaseConfig, SolveConfig, SolverDatabase};

/// Measures ours and another solver on the same frames
#[derive(Debug, Parser)]
struct Args {
    /// Kinds of frame, as in `stars render --help`
    #[arg(long, value_delimiter = ',', default_value = "night,float")]
    kinds: Vec<Kind>,
    /// Frames of each kind
    #[arg(long, default_value_t = 40)]
    frames: u64,
    /// Seed of the frames
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Times that each frame is solved; their median counts
    #[arg(long, default_value_t = 3)]
    repeats: usize,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// What a solver says of a frame: the direction of the picture's centre, and its σ per axis, rad.
type Answer = Option<(Vec3, f64)>;

/// One way to solve a frame.
type Solve<'a> = Box<dyn FnMut(&Frame) -> Answer + 'a>;

/// A solution is right within this or this many of its own σ, whichever is larger.
const RIGHT: f64 = 5.0 * ARCSEC;
const RIGHT_SIGMAS: f64 = 6.0;

/// Patterns of a field in the other solver's database: four times its default, with which it solves most.
const PATTERNS_PER_FIELD: u32 = 200;

fn main() {
    let args = Args::parse();
    let catalogue = Arc::new(Catalogue::embedded().unwrap());
    let settings = Settings::flight().unwrap();
    let frames: Vec<Rendered> = args
        .kinds
        .iter()
        .flat_map(|&kind| (0..args.frames).map(move |index| (kind, index)))
        // The other solver takes the first row for the top one.
        .map(|(kind, index)| RenderSpec { rows: RowOrder::TopFirst, ..RenderSpec::new(kind, args.seed, index) })
        .map(|spec| render(&spec, &catalogue).unwrap())
        .collect();
    let Some(Rendered { frame: first, .. }) = frames.first() else { return };
    let (width, height) = (first.width, first.height);
    let database = database(&catalogue, &settings, width);
    let solvers = ours(&catalogue, &settings, (width, height)).into_iter().chain(theirs(&database, &settings, (width, height)));

    println!(
        "thread CPU time, pixels to outcome, {width} × {height} px, seed {}, median of {} runs each\n",
        args.seed, args.repeats
    );
    println!(
        "{:<34} {:>10} {:>7} {:>6} {:>6} {:>6} {:>10} {:>8} {:>8}",
        "", "kind", "frames", "must", "right", "wrong", "median ms", "p95 ms", "p99 ms"
    );
    let mut medians = Vec::new();
    for (name, mut solve) in solvers {
        let mut all = Vec::new();
        for &kind in &args.kinds {
            let of_kind = frames.iter().filter(|f| f.truth.kind == kind);
            all.extend(row(&name, kind, of_kind, &mut solve, args.repeats));
        }
        medians.push((name, quantile(&mut all, 0.5)));
    }
    println!();
    let ours: Vec<&(String, f64)> = medians.iter().filter(|(name, _)| name.starts_with("ours")).collect();
    for (their_name, theirs) in medians.iter().filter(|(name, _)| !name.starts_with("ours")) {
        for (our_name, ours) in &ours {
            println!("{our_name} takes {:.2} of {their_name} (medians {ours:.2} and {theirs:.2} ms)", ours / theirs);
        }
    }
}

/// Solves the frames of a kind, prints a row, and returns each frame's time, ms.
fn row<'a>(
    name: &str,
    kind: Kind,
    frames: impl Iterator<Item = &'a Rendered>,
    solve: &mut Solve<'_>,
    repeats: usize,
) -> Vec<f64> {
    let (mut must, mut right, mut wrong, mut times) = (0, 0, 0, Vec::new());
    for Rendered { frame, truth } in frames {
        // Once before the clock runs, so that memory is warm.
        let answer = solve(frame);
        let is_right = answer
            .zip(truth.attitude)
            .map(|((at, sigma), attitude)| separation(&at, &attitude.boresight()) <= RIGHT.max(RIGHT_SIGMAS * sigma));
        must += usize::from(truth.must);
        right += usize::from(truth.must && is_right == Some(true));
        wrong += usize::from(answer.is_some() && is_right != Some(true));
        let mut runs: Vec<f64> = (0..repeats).map(|_| timed(|| solve(std::hint::black_box(frame))).1).collect();
        times.push(quantile(&mut runs, 0.5));
    }
    let [median, p95, p99] = [0.5, 0.95, 0.99].map(|part| quantile(&mut times, part));
    println!(
        "{name:<34} {:>10} {:>7} {must:>6} {right:>6} {wrong:>6} {median:>10.2} {p95:>8.2} {p99:>8.2}",
        kind.name(),
        times.len()
    );
    times
}

/// Our two searches: the normal one followed by the robust one where needed, as shipped; and the robust one alone.
fn ours<'a>(catalogue: &Arc<Catalogue>, settings: &Settings, (width, height): (usize, usize)) -> Vec<(String, Solve<'a>)> {
    let mut solver = Solver::new(catalogue.clone(), Arc::new(settings.clone()));
    solver.prepare(width, height);
    let mut robust = solver.clone();
    let answer = |outcome: Outcome| outcome.solution.map(|s| (s.attitude.boresight(), s.sigmas().xy().norm() / 2f64.sqrt()));
    vec![
        ("ours".into(), Box::new(move |frame| answer(solver.solve(frame, &Prior::default(), &Unwatched)))),
        ("ours, robust alone".into(), Box::new(move |frame| answer(robust.solve_robust(frame, &Prior::default(), &Unwatched)))),
    ]
}

/// The other solver with its ways to find sources.
fn theirs<'a>(database: &'a SolverDatabase, settings: &Settings, (width, height): (usize, usize)) -> Vec<(String, Solve<'a>)> {
    let matching = &settings.solver.matching;
    let fov = |platescale: f64| 2.0 * (0.5 * width as f64 * platescale * ARCSEC).atan();
    let (low, high) = (fov(matching.platescale_min_arcsec_px), fov(matching.platescale_max_arcsec_px));
    let config = move || SolveConfig {
        fov_max_error_rad: Some((0.5 * (high - low)) as f32),
        ..SolveConfig::new((0.5 * (low + high)) as f32, width as u32, height as u32)
    };
    let solve = move |centroids: &[Centroid]| -> Answer {
        let solution = database.solve_from_centroids(centroids, &config()).ok()?;
        let (ra, dec) = solution.pixel_to_world(0.0, 0.0);
        let [_, east, north] = solution.attitude_sigma_rad();
        Some((direction(ra * DEG, dec * DEG), ((east * east + north * north) / 2.0).sqrt()))
    };
    let whole = move |extraction: CentroidExtractionConfig| -> Solve<'a> {
        let (mut extractor, mut pixels) = (CentroidExtractor::new(), Vec::new());
        Box::new(move |frame| {
            floats(frame, &mut pixels);
            let found = extractor.extract_from_raw(&pixels, width as u32, height as u32, &extraction).ok()?;
            solve(&found.centroids)
        })
    };
    let mut pixels = Vec::new();
    let fast: Solve<'a> = Box::new(move |frame| {
        floats(frame, &mut pixels);
        solve(&extract_centroids_fast(&pixels, width as u32, height as u32, &FastCentroidConfig::default()).ok()?.centroids)
    });
    // The block and the threshold that solved most daytime frames in trials on other seeds.
    let local =
        CentroidExtractionConfig { local_bg_block_size: Some(16), sigma_threshold: 4.5, ..CentroidExtractionConfig::default() };
    vec![
        ("tetra3, default".into(), whole(CentroidExtractionConfig::default())),
        ("tetra3, 16 px local background".into(), whole(local)),
        ("tetra3, fast extraction".into(), fast),
    ]
}

/// The pixels as the other solver takes them.
fn floats(frame: &Frame, into: &mut Vec<f32>) {
    into.clear();
    into.extend(frame.pixels.iter().map(|&p| f32::from(p)));
}

/// The other solver's database for this camera, from the stars of our catalogue at the frames' epoch: read from beside the build,
/// or made and put there.
fn database(catalogue: &Catalogue, settings: &Settings, width: usize) -> SolverDatabase {
    let matching = &settings.solver.matching;
    let platescale = 0.5 * (matching.platescale_min_arcsec_px + matching.platescale_max_arcsec_px);
    let max_fov_deg = (width as f64 * platescale * ARCSEC / DEG) as f32;
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR"))
        .join(format!("tetra3-{:08x}-{max_fov_deg:.3}-{PATTERNS_PER_FIELD}.db", catalogue.header.checksum));
    let path = path.to_str().expect("a path in UTF-8");
    if let Ok(database) = SolverDatabase::load_from_file(path) {
        return database;
    }
    eprintln!("making {path}: this takes a minute");
    let years = settings.catalog.epoch_yr - catalogue.header.epoch_yr;
    let stars = catalogue.stars.iter().zip(0..).map(|(star, id)| {
        let (ra, dec) = stars::sky::ra_dec(&star.direction_after(years));
        tetra3::Star { id, ra_rad: ra as f32, dec_rad: dec as f32, mag: star.mag }
    });
    let config = GenerateDatabaseConfig {
        max_fov_deg,
        patterns_per_lattice_field: PATTERNS_PER_FIELD,
        epoch_proper_motion_year: None,
        ..GenerateDatabaseConfig::default()
    };
    let database = SolverDatabase::generate_from_star_list(stars.collect(), &config, settings.catalog.epoch_yr).unwrap();
    database.save_to_file(path).unwrap();
    database
}
