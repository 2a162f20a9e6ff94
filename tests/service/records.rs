//! The promise to analysts: what the Python package reads from a log is what the service found, object for object.

use crate::support::*;
use serde_json::Value;
use stars::image::Frame;
use stars::service::{MakeSolver, Parts, Solve};
use stars::sky::{ARCSEC, Attitude, Mat3};
use stars::solve::{FoundBy, Match, Outcome, Prior, Reason, Report, Solution, SourceReport, StarEntry, Watch};
use std::fs;
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

const FRAMES: u32 = 1000;

/// A solver whose frames end in all ways, with numbers that need all their digits; it notes what it reports.
struct Noting {
    reports: Arc<Mutex<Vec<String>>>,
    /// Frames that the camera may give: the next one when this one has ended, so that none is skipped.
    allowed: Arc<AtomicU32>,
}

/// A number from 0 to 1 that no other frame has.
fn odd(image: u32, salt: u32) -> f64 {
    (f64::from(image) * 0.618_033_988_749 + f64::from(salt) * 0.414_213_562_373).fract()
}

fn solved(image: u32) -> Solution {
    let of = |salt| odd(image, salt);
    Solution {
        attitude: Attitude::from_angles(std::f64::consts::TAU * of(1), 3.0 * of(2) - 1.5, std::f64::consts::TAU * of(3)),
        start: None,
        platescale: (9.0 + of(4)) * ARCSEC,
        k1: 1e-3 * of(5),
        axis: (0.0, 0.0),
        covariance: Mat3::from_diagonal_element(of(6) * 1e-12),
        sigma_platescale: 1e-4 * ARCSEC * of(7),
        rms_px: of(8),
        chi2_per_dof: if image.is_multiple_of(50) { f64::NAN } else { of(9) },
        matches: vec![Match { source: 1, star: 0, residual_px: (0.1, of(10)) }],
        false_probability_log10: -10.0 * of(11),
        horizontal: None,
        epoch_yr: Some(2013.0 + of(12)),
        served: None,
    }
}

impl Solve for Noting {
    fn solve(&mut self, frame: &Frame, _: &Prior, _: &dyn Watch) -> Outcome {
        let image = frame.stamp.image.0;
        let reason = [Reason::Solved, Reason::NoMatch, Reason::Undecided, Reason::TooFewSources][image as usize % 4];
        let mut outcome = Outcome::unsolved(frame.stamp.clone(), reason, format!("№ {image}: “{}″”\u{2028}\\", odd(image, 20)));
        let source = |i: u32| SourceReport {
            x: 1536.0 * odd(image, 30 + i),
            y: 1024.0 * odd(image, 40 + i),
            sigma_px: odd(image, 50 + i),
            flux: 1e5 * odd(image, 60 + i),
            snr: 100.0 * odd(image, 70 + i),
            peak: 4e3 * odd(image, 80 + i),
            saturated: i == 0,
        };
        outcome.sources = (0..image % 7 + 2).map(source).collect();
        outcome.solution = (reason == Reason::Solved).then(|| solved(image));
        outcome.candidate = (reason == Reason::Undecided).then(|| solved(image));
        outcome.found_by = Some(FoundBy::LostInSpace);
        outcome.triangles = vec![[0, 1, 2]; image as usize % 5];
        outcome
    }

    fn report(&self, outcome: &Outcome) -> Report {
        let mut report = Report::without_stars(outcome);
        if report.solved
            && let Some(source) = report.sources.get_mut(1)
        {
            let name = "α Cen".to_owned();
            source.star =
                Some(StarEntry { id: 7, name, ra_deg: Some(219.9), dec_deg: None, mag: Some(-0.01), residual_px: Some(0.1) });
        }
        self.reports.lock().unwrap().push(serde_json::to_string(&report).unwrap());
        self.allowed.store((outcome.stamp.image.0 + 2).min(FRAMES), Ordering::Relaxed);
        report
    }
}

/// What the package makes of a directory of logs, against the service's own outcomes in a file: how many there are, which differ, and what
/// was damaged. (Compared there: every digit counts, and this library's reader of numbers may be off in the last one.)
const READ: &str = "
import json, sys
import starslog
log = starslog.read_log(sys.argv[1])
own = [json.loads(line) for line in open(sys.argv[2], encoding='utf-8').read().split('\\n') if line]
read = [solution.to_dict() for solution in log.solutions]
differing = [place for place, (one, other) in enumerate(zip(read, own)) if one != other]
print(json.dumps([len(read), len(own), differing, [[damage.line, damage.why] for damage in log.damaged]]))
";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_python_package_reads_a_thousand_outcomes_as_the_service_had_them_and_tells_of_the_torn_last_line() {
    let directory = tempfile::tempdir().unwrap();
    let (reports, allowed) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicU32::new(1)));
    let mut settings = settings();
    (settings.camera.period_s, settings.record.enabled) = (0.001, true);
    // None may be lost to a disk that is slow.
    settings.record.queue_frames = 2 * FRAMES;
    settings.record.directory = directory.path().display().to_string();
    // However slow the disk is, none is lost.
    settings.record.queue_frames = 4096;
    let (notes, camera) = (Arc::clone(&reports), camera_of(&allowed));
    let solver: MakeSolver =
        Arc::new(move || Ok(Box::new(Noting { reports: Arc::clone(&notes), allowed: Arc::clone(&allowed) }) as Box<dyn Solve>));
    let running = start(settings, Parts { camera, solver, lens: None }).await;
    let mut state = running.state.clone();
    let enough = state.wait_for(|state| state.counters.records_written >= FRAMES);
    tokio::time::timeout(4 * PATIENCE, enough).await.expect("it never came").unwrap();
    assert!(running.stop().await.is_empty());
    let reports = reports.lock().unwrap().clone();
    let log = fs::read_dir(directory.path()).unwrap().map(|entry| entry.unwrap().path()).find(|path| path.is_file()).unwrap();
    let mut bytes = fs::read(&log).unwrap();
    // A power cut within the last line: of a line that is long enough, its first half.
    let whole = bytes.len();
    let first = bytes.iter().position(|byte| *byte == b'\n').unwrap();
    bytes.extend_from_within(..first / 2);
    assert!(bytes.len() > whole);
    fs::write(&log, bytes).unwrap();

    let scripts = concat!(env!("CARGO_MANIFEST_DIR"), "/scripts");
    let own = directory.path().join("own.txt");
    fs::write(&own, reports.join("\n")).unwrap();
    let mut python = Command::new("python3");
    let read = python.env("PYTHONPATH", scripts).args(["-c", READ]).arg(directory.path()).arg(&own).output().unwrap();
    assert!(read.status.success(), "{}", String::from_utf8_lossy(&read.stderr));
    let read: Value = serde_json::from_slice(&read.stdout).unwrap();
    assert_eq!((&read[0], &read[1], &read[2]), (&FRAMES.into(), &FRAMES.into(), &Value::Array(Vec::new())), "{read}");
    let damaged = &read[3];
    assert_eq!(damaged.as_array().unwrap().len(), 1, "{damaged}");
    assert_eq!(damaged[0][0], FRAMES + 1);
    assert!(damaged[0][1].as_str().unwrap().starts_with("torn"), "{damaged}");
}
