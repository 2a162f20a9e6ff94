//! How long a frame is on its way: `cargo bench --bench latency -- --frames 300`.
//!
//! From the moment at which a camera's driver has the last pixel in memory to that at which the solver has the frame before it, by the wall,
//! in the running service: the camera's actor, the archive on a disk, the hub and the solver's actor. The exposures of a series are handed
//! over one by one, as they are read out, and added up on the way; bad pixels are replaced in a copy, as in flight. Exits 1 where a hundredth of
//! the frames or more took over 5 ms.

#![allow(clippy::unwrap_used, reason = "a bench may end where it stands")]
#![allow(clippy::disallowed_methods, reason = "what is measured is the time by the wall")]

mod shared;

use clap::Parser;
use shared::{ms, quantile};
use stars::camera::{CameraError, Moment, Source};
use stars::image::{BadPixels, Frame, ImageCounter, Series};
use stars::service::{MakeSolver, MakeSource, Parts, Solve, retouched, start_with};
use stars::settings::{LensKind, Settings};
use stars::sky::RowOrder;
use stars::solve::{Outcome, Prior, Reason, Report, Watch};
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{Arc, Mutex};
use std::time::Instant;
use tokio::net::TcpListener;

/// Measures the way of a frame from the camera's driver to the solver
#[derive(Debug, Parser)]
struct Args {
    /// Frames of each case
    #[arg(long, default_value_t = 300)]
    frames: u32,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

const WIDTH: usize = 1536;
const HEIGHT: usize = 1024;
/// Wanted at most of 99 % of the frames, ms.
const WANTED_MS: f64 = 5.0;
/// Bad pixels of a sensor that has many.
const BAD_PIXELS: usize = 1500;

/// When the last pixel of each image was in memory, and when the solver had it.
#[derive(Default)]
struct Times {
    came: BTreeMap<ImageCounter, Instant>,
    /// ms.
    taken: Vec<f64>,
}

type Notes = Arc<Mutex<Times>>;

struct Camera {
    pixels: Vec<u16>,
    notes: Notes,
}

impl Source for Camera {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let exposure = Frame::new(WIDTH, HEIGHT, self.pixels.clone(), RowOrder::TopFirst).unwrap();
        // Of the last exposure of an image, this is what stays.
        self.notes.lock().unwrap().came.insert(moment.image, Instant::now());
        Ok(exposure.into())
    }
}

struct Solver {
    notes: Notes,
}

impl Solve for Solver {
    fn solve(&mut self, frame: &Frame, _: &Prior, _: &dyn Watch) -> Outcome {
        let now = Instant::now();
        let mut notes = self.notes.lock().unwrap();
        let came = notes.came.remove(&frame.stamp.image).unwrap();
        notes.taken.push(ms(now - came));
        Outcome::unsolved(frame.stamp.clone(), Reason::NoMatch, "not looked at")
    }

    fn report(&self, outcome: &Outcome) -> Report {
        Report::without_stars(outcome)
    }
}

/// The times of so many images, ms, of so many exposures.
async fn measure(frames: u32, exposures: u32, bad_pixels: BadPixels) -> Vec<f64> {
    let directory = tempfile::tempdir().unwrap();
    let mut settings = Settings::flight().unwrap();
    settings.network.listen = "127.0.0.1:0".to_owned();
    settings.camera.startup_delay_s = 0.0;
    settings.camera.period_s = 0.1;
    settings.camera.series_exposures = exposures;
    settings.lens.kind = LensKind::None;
    settings.commands.ledger_directory = String::new();
    settings.record.directory = directory.path().display().to_string();
    settings.record.reserve_gib = 0.0;
    settings.record.images_limit_gib = 0.2;
    let notes = Notes::default();
    let (for_camera, for_solver) = (Arc::clone(&notes), Arc::clone(&notes));
    let pixels: Vec<u16> = (0..WIDTH * HEIGHT).map(|i| 1000 + (i * 7919 % 97) as u16).collect();
    let camera: MakeSource = Arc::new(move || {
        let camera = Camera { pixels: pixels.clone(), notes: Arc::clone(&for_camera) };
        Ok(Box::new(camera) as Box<dyn Source>)
    });
    let solver: MakeSolver = Arc::new(move || {
        let solver = Solver { notes: Arc::clone(&for_solver) };
        Ok(Box::new(solver) as Box<dyn Solve>)
    });
    let settings = Arc::new(settings);
    let solver = retouched(solver, Arc::clone(&settings), Arc::new(bad_pixels));
    let socket = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let running = start_with(settings, Parts { camera: Some(camera), solver, lens: None }, socket).unwrap();
    let mut state = running.state.clone();
    state.wait_for(|state| state.counters.frames_taken >= frames).await.unwrap();
    running.stop().await;
    std::mem::take(&mut notes.lock().unwrap().taken)
}

fn main() -> ExitCode {
    let args = Args::parse();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let list: String = (0..BAD_PIXELS).map(|i| format!("{} {}\n", i * 7919 % WIDTH, i * 104_729 % HEIGHT)).collect();
    let bad_pixels = BadPixels::parse("bad", &list).unwrap();
    let mut failed = false;
    let none = BadPixels::default;
    for (name, exposures, bad) in
        [("one exposure", 1, none()), ("one exposure, 1500 bad pixels", 1, bad_pixels), ("four exposures, added up", 4, none())]
    {
        let mut taken = runtime.block_on(measure(args.frames, exposures, bad));
        let (middle, most, all) = (quantile(&mut taken, 0.5), quantile(&mut taken, 0.99), quantile(&mut taken, 1.0));
        let passed = most <= WANTED_MS && taken.len() as u32 >= args.frames * 9 / 10;
        failed |= !passed;
        println!(
            "wanted: {name}: last pixel to solver in {WANTED_MS} ms, 99 % of {}  got: median {middle:.2} ms, 99 % in {most:.2} ms, all in \
             {all:.2} ms  {}",
            taken.len(),
            if passed { "PASS" } else { "FAIL" }
        );
    }
    ExitCode::from(u8::from(failed))
}
