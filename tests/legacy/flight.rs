//! A C program with the structs that flew against the running service.

use crate::settings;
use crate::support::start;
use serde_json::Value;
use stars::catalog::Catalogue;
use stars::command::{Refusal, Stage};
use stars::image::write_fits;
use stars::service::Parts;
use stars::settings::CameraKind;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::sky::{ARCSEC, Attitude, DEG, separation, wrap_pi};
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

/// Compiles the program against the header.
fn compile(into: &Path) -> String {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let program = into.join("flight").display().to_string();
    let include = format!("-I{}", root.join("proto").display());
    let source = root.join("tests/legacy/flight.c").display().to_string();
    let arguments = ["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", &include, "-o", &program, &source];
    let output = Command::new("gcc").args(arguments).output().expect("gcc is needed to check proto/ and does not start");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    program
}

/// A directory with one rendered image, and where that looks.
fn image(directory: &Path) -> Attitude {
    let rendered = render(&RenderSpec::new(Kind::Float, 5, 0), &Catalogue::embedded().unwrap()).unwrap();
    let mut bytes = Vec::new();
    write_fits(&rendered.frame, &[], &mut bytes).unwrap();
    std::fs::write(directory.join("a.fits"), bytes).unwrap();
    rendered.truth.attitude.unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_c_program_gets_solutions_runs_one_command_once_and_nothing_by_broken_blocks() {
    let seconds = std::env::var("STARS_LEGACY_S").unwrap_or_else(|_| "60".to_owned());
    assert!(seconds.parse::<f64>().unwrap() >= 22.0, "the broken blocks take 20 s");
    let room = tempfile::tempdir().unwrap();
    let program = compile(room.path());
    let images = room.path().join("images");
    std::fs::create_dir(&images).unwrap();
    let truth = image(&images);
    let mut settings = settings();
    settings.camera.kind = CameraKind::Directory;
    settings.camera.directory = images.display().to_string();
    settings.camera.repeat = true;
    settings.camera.period_s = 2.0;
    let parts = Parts::of(&Arc::new(settings.clone())).unwrap();
    let running = start(settings, parts).await;
    let port = running.legacy_address.unwrap().port().to_string();
    let flight = tokio::process::Command::new(&program).args([&port, "127.0.0.2", &seconds]).output();
    let output = flight.await.unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8(output.stdout).unwrap();
    println!("{said}");
    check_solutions(&serde_json::from_str(&said).unwrap(), &truth, seconds.parse().unwrap());

    let state = running.state.borrow().clone();
    assert_eq!(state.settings.solver.timeout_s, 7.5, "the command ran");
    assert_eq!(state.desk.counts.accepted, 1, "and nothing else");
    let stages: Vec<_> =
        state.desk.replies.due(stars::command::FlightComputer(1)).map(|reply| (reply.code, reply.stage)).collect();
    assert_eq!(stages.iter().filter(|stage| **stage == (60, Stage::Completed)).count(), 1, "{stages:?}");
    let refused = |why| state.desk.counts.refused.get(&why).copied().unwrap_or_default();
    println!("refused: {:?}", state.desk.counts.refused);
    assert!(refused(Refusal::Dialect) >= 3, "one zeroed block, two with every counter changed");
    assert!(refused(Refusal::Stale) >= 3, "three with a dead countdown");
    assert!(refused(Refusal::HalfChanged) >= 1, "values without their counter");
    assert!(running.stop().await.is_empty());
}

fn check_solutions(said: &Value, truth: &Attitude, seconds: f64) {
    let number = |name: &str| said[name].as_f64().unwrap_or_else(|| panic!("{name}: {said}"));
    assert_eq!(number("unsound"), 0.0);
    // Two a second, less a few where the machine is busy.
    assert!(number("answers") > seconds * 1.8, "{said}");
    assert!(number("solutions") > 10.0 && number("images") > 5.0, "{said}");
    assert!(number("horizontal") > 5.0, "latitude and sidereal time are the flight computer's: {said}");
    assert_eq!(number("image_ctr_fcp"), 7.0);
    let (_, dec, roll) = truth.angles();
    let there = Attitude::from_angles(number("ra"), number("dec"), 0.0);
    assert!(separation(&there.boresight(), &truth.boresight()) < 5.0 * ARCSEC, "{said}");
    assert!(wrap_pi(number("roll") + roll).abs() < 0.1 * DEG, "the roll has the other sign: {said}");
    assert!(number("sigma_ra") > 0.0 && number("sigma_pointing") < 10.0 * ARCSEC);
    let mean = (number("sigma_ra") * dec.cos() + number("sigma_dec")) / 2.0;
    assert!((mean / number("sigma_pointing") - 1.0).abs() < 1e-3, "{said}");
    assert!((9.2..9.7).contains(&(number("iplate") / ARCSEC)), "{said}");
    assert!(number("mean") > 1000.0 && number("matched") >= 5.0 && number("blobs") > 5.0, "{said}");
    assert!(number("blob_x").abs() < 768.0 && number("blob_y").abs() < 512.0, "{said}");
}
