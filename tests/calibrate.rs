//! `stars calibrate` as an operator uses it: what rendered frames of one camera say of it, put in force on command, and taken back.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

fn stars(at: &Path, arguments: &[&str]) -> Output {
    // Its index is kept with what the build makes, not in the user's home.
    Command::new(env!("CARGO_BIN_EXE_stars"))
        .current_dir(at)
        .env("HOME", env!("CARGO_TARGET_TMPDIR"))
        .args(arguments)
        .output()
        .unwrap()
}

fn out(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

/// The value of a setting, as it is in force in a directory.
fn setting(at: &Path, key: &str) -> (Value, String) {
    let output = stars(at, &["settings", "--json"]);
    let all: Value = serde_json::from_slice(&output.stdout).unwrap();
    let one = all["settings"].as_array().unwrap().iter().find(|setting| setting["key"] == key).unwrap().clone();
    (one["value"].clone(), one["origin"].as_str().unwrap().to_owned())
}

#[test]
fn rendered_frames_calibrate_their_camera_and_records_of_them_do_so_too() {
    let directory = TempDir::new().unwrap();
    let at = directory.path();
    for (seed, more) in [("31", &[][..]), ("32", &["--beside", "31", "--turned=-40,25,300"][..])] {
        let common = ["render", "--kind", "hotpix", "--seed", seed, "--camera", seed, "--count", "24", "--platescale", "9.4"];
        assert!(stars(at, &[&common[..], &["--out", seed], more].concat()).status.success());
    }
    let measured = stars(at, &["calibrate", "31", "--other", "32", "--out", "calibration.toml", "--json", "--jobs", "2"]);
    assert!(measured.status.success(), "{measured:?}");
    let found: Value = serde_json::from_slice(&measured.stdout).unwrap();
    let truth: Value = serde_json::from_slice(&fs::read(at.join("31/hotpix-31-0.truth.json")).unwrap()).unwrap();
    let number = |value: &Value| value.as_f64().unwrap();
    let scale = number(&found["platescale_arcsec_px"]) / number(&truth["platescale_arcsec_px"]) - 1.0;
    assert!(scale.abs() < 3e-4, "{scale}");
    assert!((number(&found["distortion_k1"]) - number(&truth["k1"])).abs() < 5.0 * number(&found["sigma_distortion_k1"]));
    let set = |value: &Value| -> BTreeSet<(u64, u64)> {
        value.as_array().unwrap().iter().map(|pixel| (pixel[0].as_u64().unwrap(), pixel[1].as_u64().unwrap())).collect()
    };
    let (hot, true_hot) = (set(&found["hot_pixels"]), set(&truth["hot_pixels"]));
    assert!(hot.intersection(&true_hot).count() * 100 >= true_hot.len() * 97, "{} of {}", hot.len(), true_hot.len());
    assert!(hot.difference(&true_hot).count() * 50 <= hot.len(), "{} of {}", hot.len(), true_hot.len());
    let offset = &found["offset"];
    // Turned about left by −40″ the boresight goes up, about up by 25″ to the left.
    assert!((number(&offset["up_arcsec"]) - 40.0).abs() < 1.0 && (number(&offset["left_arcsec"]) - 25.0).abs() < 1.0, "{offset}");
    assert!((number(&offset["roll_arcsec"]) - 300.0).abs() < 30.0, "{offset}");

    // The same from the outcomes that the service would have recorded.
    fs::create_dir(at.join("records")).unwrap();
    let files: Vec<String> = (0..24).map(|i| format!("31/hotpix-31-{i}.fits")).collect();
    let solve = [&["solve", "--json"][..], &files.iter().map(String::as_str).collect::<Vec<_>>()].concat();
    fs::write(at.join("records/outcomes-2013-01-01T00-00-00.000-00000001.jsonl"), stars(at, &solve).stdout).unwrap();
    let recorded: Value = serde_json::from_slice(&stars(at, &["calibrate", "records", "--json"]).stdout).unwrap();
    let difference = number(&recorded["platescale_arcsec_px"]) / number(&found["platescale_arcsec_px"]) - 1.0;
    assert!(difference.abs() < 2e-5, "{difference}");
    assert!(
        recorded["hot_pixels"].is_null() && recorded["source"].as_str().unwrap().starts_with("records of records"),
        "{recorded}"
    );

    // Too few are refused, and nothing is written.
    fs::create_dir(at.join("few")).unwrap();
    fs::copy(at.join("31/hotpix-31-0.fits"), at.join("few/0.fits")).unwrap();
    let few = stars(at, &["calibrate", "few", "--out", "few.toml"]);
    assert_eq!(few.status.code(), Some(1));
    assert!(out(&few).contains("refused: few: 1 solved frames") && !at.join("few.toml").exists(), "{few:?}");

    applied_and_undone(at, hot.len());
}

/// What was measured there is put in force with its list of hot pixels, logged, guarded, and taken back.
fn applied_and_undone(at: &Path, hot_pixels: usize) {
    let before = setting(at, "solver.fit.distortion_sigma");
    assert_eq!(before.1, "flight file");
    let applied = stars(at, &["calibrate", "--apply", "calibration.toml"]);
    assert!(applied.status.success(), "{applied:?}");
    assert!(out(&applied).contains("solver.fit.distortion_sigma = "), "{applied:?}");
    let after = setting(at, "solver.fit.distortion_sigma");
    assert!(after.1.starts_with("state/calibration.toml:") && after.0 != before.0, "{after:?}");
    let list = setting(at, "solver.sources.bad_pixels_file").0.as_str().unwrap().to_owned();
    assert!(list.starts_with("state/bad_pixels-"), "{list}");
    let lines = fs::read_to_string(at.join(&list)).unwrap();
    assert_eq!(lines.lines().filter(|line| !line.starts_with('#')).count(), hot_pixels);
    assert!(stars(at, &["solve", "31/hotpix-31-3.fits"]).status.success(), "what is in force solves the camera's frames");

    // A second one, and both taken back.
    assert!(stars(at, &["calibrate", "--apply", "calibration.toml"]).status.success());
    assert!(stars(at, &["calibrate", "--undo"]).status.success());
    assert_eq!(setting(at, "solver.fit.distortion_sigma"), after);
    let nothing = stars(at, &["calibrate", "--undo"]);
    assert!(nothing.status.code() == Some(1) && out(&nothing).contains("nothing to undo"), "{nothing:?}");
    let log = fs::read_to_string(at.join("state/calibration.log")).unwrap();
    assert_eq!(log.lines().count(), 3, "{log}");

    // What was changed by hand is not taken, and neither is what the guard refuses.
    let text = fs::read_to_string(at.join("calibration.toml")).unwrap();
    fs::write(at.join("forged.toml"), text.replace("distortion_sigma = 0", "distortion_sigma = 0.0")).unwrap();
    let forged = stars(at, &["calibrate", "--apply", "forged.toml"]);
    assert_eq!(forged.status.code(), Some(2), "{forged:?}");
    fs::write(at.join("other.toml"), "[solver.matching]\nplatescale_min_arcsec_px = 9.6\nplatescale_max_arcsec_px = 9.8\n")
        .unwrap();
    let mad = stars(at, &["calibrate", "--custom", "other.toml", "--apply", "calibration.toml"]);
    assert!(mad.status.code() == Some(1) && out(&mad).contains("outside the range"), "{mad:?}");

    // A damaged one in force is named and left out: it keeps nothing from starting.
    fs::write(at.join("state/calibration.toml"), &text[..text.len() / 2]).unwrap();
    let damaged = stars(at, &["settings", "--json"]);
    assert!(damaged.status.success());
    assert!(String::from_utf8_lossy(&damaged.stderr).contains("the calibration is left out"), "{damaged:?}");
    assert_eq!(setting(at, "solver.fit.distortion_sigma"), before);
}
