//! `stars solve` as a caller sees it: exit codes, one answer for each image in order, JSON, pictures.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use image::{ImageBuffer, Luma};
use serde_json::Value;
use stars::catalog::Catalogue;
use stars::image::Frame;
use stars::simulate::sky::{Kind, RenderSpec, Rendered, render};
use stars::sky::RowOrder;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Frames that a test looks at, the same in every run.
const SEED: u64 = 2_000;

fn stars(arguments: &[&str], files: &[PathBuf]) -> Output {
    // Its index is kept with what the build makes, not in the user's home.
    let home = env!("CARGO_TARGET_TMPDIR");
    Command::new(env!("CARGO_BIN_EXE_stars")).env("HOME", home).arg("solve").args(arguments).args(files).output().unwrap()
}

fn code(output: &Output) -> i32 {
    output.status.code().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// The JSON lines of a call.
fn lines(output: &Output) -> Vec<Value> {
    text(&output.stdout).lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// A rendered frame of the flight camera, with its first row on top, as in a PNG.
fn rendered(kind: Kind, index: u64) -> Rendered {
    let spec = RenderSpec { rows: RowOrder::TopFirst, ..RenderSpec::new(kind, SEED, index) };
    render(&spec, &Catalogue::embedded().unwrap()).unwrap()
}

fn write_png(path: &Path, frame: &Frame) {
    let buffer: ImageBuffer<Luma<u16>, _> =
        ImageBuffer::from_raw(frame.width as u32, frame.height as u32, frame.pixels.clone()).unwrap();
    buffer.save(path).unwrap();
}

fn write_blank(path: &Path) {
    write_png(path, &Frame::new(320, 240, vec![1000; 320 * 240], RowOrder::TopFirst).unwrap());
}

#[test]
fn images_are_answered_in_the_order_of_the_arguments_with_their_pointing() {
    let directory = TempDir::new().unwrap();
    let (first, second) = (rendered(Kind::Night, 0), rendered(Kind::Night, 1));
    let blank = directory.path().join("blank.png");
    let files = [directory.path().join("second.png"), blank.clone(), directory.path().join("first.png")];
    write_png(&files[0], &second.frame);
    write_blank(&blank);
    write_png(&files[2], &first.frame);
    let output = stars(&["--json", "--jobs", "3"], &files);
    assert_eq!(code(&output), 1, "{}", text(&output.stderr));
    assert!(output.stderr.is_empty(), "{}", text(&output.stderr));

    let lines = lines(&output);
    let names: Vec<&str> = lines.iter().map(|line| line["image"].as_str().unwrap()).collect();
    assert_eq!(names, files.iter().map(|file| file.to_str().unwrap()).collect::<Vec<_>>());
    for (line, rendered) in [(&lines[0], &second), (&lines[2], &first)] {
        assert_eq!(line["solved"], true, "{line}");
        let (ra, dec, _) = rendered.truth.attitude.unwrap().angles();
        let close = |key: &str, wanted: f64, within: f64| (line[key].as_f64().unwrap() - wanted.to_degrees()).abs() < within;
        assert!(close("ra_deg", ra, 0.01 / dec.cos()) && close("dec_deg", dec, 0.01), "{line}");
        assert!(line["time_ms"]["total"].as_f64().unwrap() > 0.0 && line["time_ms"]["read"].as_f64().unwrap() > 0.0);
    }
    assert_eq!((&lines[1]["solved"], &lines[1]["ra_deg"]), (&Value::Bool(false), &Value::Null));
}

#[test]
fn without_json_a_solved_image_is_a_block_for_people() {
    let directory = TempDir::new().unwrap();
    let file = directory.path().join("sky.png");
    write_png(&file, &rendered(Kind::Night, 0).frame);
    let output = stars(&[], &[file]);
    assert_eq!(code(&output), 0, "{}", text(&output.stderr));
    let said = text(&output.stdout);
    for part in ["sky.png: solved", "RA ", "Dec ", "σ ", "roll ", "plate scale ", "sources matched", " ms"] {
        assert!(said.contains(part), "no {part:?} in:\n{said}");
    }
}

#[test]
fn wrong_files_exit_with_two_after_all_others_were_answered() {
    let directory = TempDir::new().unwrap();
    let at = |name: &str| directory.path().join(name);
    std::fs::write(at("notes.txt"), "no image").unwrap();
    std::fs::write(at("cut.png"), b"\x89PNG\r\n\x1a\n\0\0\0").unwrap();
    write_blank(&at("blank.png"));
    let files = [at("missing.fits"), directory.path().to_owned(), at("notes.txt"), at("cut.png"), at("blank.png")];
    let output = stars(&["--json"], &files);
    assert_eq!(code(&output), 2);
    let reasons: Vec<Value> = lines(&output).iter().map(|line| line["reason"].clone()).collect();
    assert_eq!(reasons[..4], ["unreadable"; 4]);
    assert_ne!(reasons[4], "unreadable");

    let complaints: Vec<&str> = text(&output.stderr).lines().collect();
    assert_eq!(complaints.len(), 4, "{complaints:?}");
    for (complaint, file) in complaints.iter().zip(&files) {
        assert!(complaint.contains(file.to_str().unwrap()) && complaint.contains("expected"), "{complaint}");
    }
}

/// A strip's index would be as long as the strip and as dense as its few pixels ask for: without a limit it fills any memory.
#[test]
fn an_image_of_any_shape_ends_in_an_outcome() {
    let directory = TempDir::new().unwrap();
    for (width, height) in [(1, 1), (3000, 3), (2, 1500)] {
        let file = directory.path().join(format!("{width}x{height}.png"));
        let pixels = (0..width * height).map(|i| 1000 + (i * 7919 % 100) as u16).collect();
        write_png(&file, &Frame::new(width, height, pixels, RowOrder::TopFirst).unwrap());
        let output = stars(&["--json"], &[file]);
        assert_eq!(code(&output), 1, "{width} × {height}: {}", text(&output.stderr));
        assert_ne!(lines(&output)[0]["detail"], "", "{width} × {height}");
    }
}

#[test]
fn a_wrong_call_exits_with_two_and_solves_nothing() {
    let directory = TempDir::new().unwrap();
    let file = directory.path().join("blank.png");
    write_blank(&file);
    for (arguments, part) in [
        (vec!["--set", "solver.robustt=true"], "solver.robustt"),
        (vec!["--jobs", "0"], "--jobs"),
        (vec!["--config", "/no/such/flight.toml"], "/no/such/flight.toml"),
        (vec!["--set", "catalog.file=/no/such/stars.bin"], "/no/such/stars.bin"),
        (vec!["--overlay", file.to_str().unwrap()], "blank.png"),
    ] {
        let output = stars(&arguments, std::slice::from_ref(&file));
        assert_eq!(code(&output), 2, "{arguments:?}");
        assert!(output.stdout.is_empty(), "{arguments:?}");
        assert!(text(&output.stderr).contains(part), "{arguments:?}: {}", text(&output.stderr));
        assert_eq!(text(&output.stderr).lines().count(), 1, "{}", text(&output.stderr));
    }
    assert_eq!(code(&stars(&[], &[])), 2);
}

#[test]
fn every_image_has_its_own_overlay_also_where_names_repeat() {
    let directory = TempDir::new().unwrap();
    let (one, two) = (directory.path().join("one"), directory.path().join("two"));
    std::fs::create_dir_all(&one).unwrap();
    std::fs::create_dir_all(&two).unwrap();
    let files = [one.join("sky.png"), two.join("sky.png")];
    files.iter().for_each(|file| write_blank(file));
    let overlays = directory.path().join("a/b");
    let output = stars(&["--overlay", overlays.to_str().unwrap()], &files);
    assert_eq!(code(&output), 1, "{}", text(&output.stderr));
    for name in ["sky.png", "sky-2.png"] {
        let picture = image::open(overlays.join(name)).unwrap();
        assert!(picture.width() == 320 && picture.height() > 240, "{name}");
    }
}
