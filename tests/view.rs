//! The thin-link view as those on the ground see it: golden bytes, the decoder in Python, and the command line.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use serde_json::Value;
use stars::catalog::Catalogue;
use stars::image::view::{PACKET_BYTES, View, ViewSource};
use stars::image::{Frame, ImageCounter, TriggerCounter, read, write_fits};
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::sky::{ClockQuality, RowOrder, Utc};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Packets of the small frame, one after the other. They are those of version 1 of the format: where they do not come out any more, give
/// the new format a new version. `STARS_BLESS=1` writes them anew.
fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("proto/golden/view/small.packets")
}

/// A frame of an odd size whose values follow from whole numbers alone: a slope, noise, stars, and single bright and dark pixels.
fn small() -> (Frame, Vec<ViewSource>) {
    let (width, height) = (109, 75);
    let mut state = 1u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        state >> 16
    };
    let mut pixels: Vec<u16> = (0..width * height)
        .map(|i| (1000 + i % width / 4 + (0..6).map(|_| random() as usize % 9).sum::<usize>()) as u16)
        .collect();
    let stars = [(20, 30, 9000), (80, 12, 4000), (107, 74, 2500), (55, 61, 700)];
    for (cx, cy, peak) in stars {
        for (x, y) in
            (0..25).map(|i| (cx + i % 5, cy + i / 5)).filter(|&(x, y)| x >= 2 && y >= 2 && x < width + 2 && y < height + 2)
        {
            pixels[(y - 2) * width + x - 2] += (peak >> (x.abs_diff(cx + 2) + y.abs_diff(cy + 2))) as u16;
        }
    }
    pixels[4000] = u16::MAX;
    pixels[5000] = 0;
    let mut frame = Frame::new(width, height, pixels, RowOrder::TopFirst).unwrap();
    frame.full_scale = Some(16_383);
    frame.stamp.image = ImageCounter(4711);
    frame.stamp.trigger = Some(TriggerCounter(9));
    frame.stamp.captured = Utc::from_calendar(2013, 1, 1, 6, 11, 24.5).map(|utc| (utc, ClockQuality::Synchronised));
    frame.stamp.exposure_s = Some(0.25);
    frame.stamp.exposures = 2;
    frame.stamp.focus_counts = Some(-12);
    let source = |&(x, y, peak): &(usize, usize, usize)| ViewSource { x: x as f64 + 0.25, y: y as f64, flux: 4.0 * peak as f64 };
    (frame, stars.iter().map(source).collect())
}

fn small_view() -> View {
    let (frame, sources) = small();
    View::new(&frame, &sources, PACKET_BYTES).unwrap()
}

fn python(arguments: &[&Path]) -> (i32, Value) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/view.py");
    let output = Command::new("python3").arg(script).args(arguments).output().unwrap();
    (output.status.code().unwrap(), json(&output))
}

fn stars(arguments: &[&str]) -> Output {
    // Its index is kept with what the build makes, not in the user's home.
    Command::new(env!("CARGO_BIN_EXE_stars"))
        .env("HOME", env!("CARGO_TARGET_TMPDIR"))
        .arg("view")
        .args(arguments)
        .output()
        .unwrap()
}

fn json(output: &Output) -> Value {
    let text = std::str::from_utf8(&output.stdout).unwrap();
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text} {}", String::from_utf8_lossy(&output.stderr)))
}

fn pixels(path: &Path) -> Frame {
    read("got", &std::fs::read(path).unwrap()).unwrap()
}

/// The same picture, whichever end its first row is.
fn assert_same(got: &Frame, wanted: &Frame) {
    let rows = |frame: &Frame| {
        let mut rows: Vec<Vec<u16>> = frame.pixels.chunks(frame.width).map(<[u16]>::to_vec).collect();
        if frame.rows == RowOrder::BottomFirst {
            rows.reverse();
        }
        rows
    };
    assert!(rows(got) == rows(wanted));
}

#[test]
fn the_golden_packets_come_out_and_python_reads_them() {
    let view = small_view();
    if std::env::var_os("STARS_BLESS").is_some_and(|set| set == "1") {
        std::fs::create_dir_all(golden().parent().unwrap()).unwrap();
        std::fs::write(golden(), view.bytes()).unwrap();
    }
    assert!(std::fs::read(golden()).unwrap() == view.bytes(), "the packets are not those of version 1");

    let directory = TempDir::new().unwrap();
    let picture = directory.path().join("got.fits");
    let (code, said) = python(&[&golden(), "--picture".as_ref(), &picture]);
    let (frame, _) = small();
    assert_eq!((code, &said["exact"], &said["missing"]), (0, &Value::Bool(true), &Value::Array(Vec::new())));
    assert_eq!((&said["image"], &said["trigger"], &said["focus"]), (&4711.into(), &9.into(), &(-12).into()));
    assert_eq!(
        (said["exposure"].as_f64(), said["utc"].as_str(), &said["gain"]),
        (Some(0.25), Some("2013-01-01T06:11:24.500000"), &Value::Null)
    );
    assert_eq!((said["sources"][1]["x"].as_f64(), said["sources"][1]["y"].as_f64()), (Some(80.25), Some(12.0)));
    assert_same(&pixels(&picture), &frame);
}

#[test]
fn python_shows_the_same_as_the_program_when_packets_are_missing() {
    let view = small_view();
    let directory = TempDir::new().unwrap();
    let path = |name: &str| directory.path().join(name);
    // Backwards, some lost, one damaged, with noise of the link between them.
    let mut bytes = b"sV noise".to_vec();
    for n in (0..view.len()).rev().filter(|n| n % 5 != 3) {
        bytes.extend_from_slice(view.packet(n).unwrap());
        bytes.extend_from_slice(b"sV\x01");
        if n == 6 {
            let length = bytes.len();
            bytes[length - 20] ^= 4;
        }
    }
    std::fs::write(path("got.packets"), &bytes).unwrap();
    let (code, said) = python(&[
        &path("got.packets"),
        "--picture".as_ref(),
        &path("python.fits"),
        "--thumbnail".as_ref(),
        &path("thumbnail.png"),
    ]);
    let output = stars(&["--decode", path("got.packets").to_str().unwrap(), "--picture", path("rust.fits").to_str().unwrap()]);
    let ours = json(&output);
    assert_eq!((code, output.status.code()), (1, Some(1)));
    assert_eq!((&said["missing"], &said["sources"]), (&ours["missing"], &ours["sources"]));
    assert_eq!(ours["exact"], false);
    assert_same(&pixels(&path("python.fits")), &pixels(&path("rust.fits")));
    assert_eq!((pixels(&path("thumbnail.png")).width, pixels(&path("thumbnail.png")).height), (96, 64));
}

#[test]
fn a_frame_goes_over_a_lossy_link_by_command() {
    let rendered = render(&RenderSpec::new(Kind::Float, 3, 0), &Catalogue::embedded().unwrap()).unwrap();
    let directory = TempDir::new().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let mut fits = Vec::new();
    write_fits(&rendered.frame, &[], &mut fits).unwrap();
    std::fs::write(path("frame.fits"), fits).unwrap();
    let output = stars(&[&path("frame.fits"), "--packets", &path("out"), "--loss", "0.3", "--seed", "1"]);
    let said = json(&output);
    assert_eq!((output.status.code(), &said["exact"]), (Some(0), &Value::Bool(true)));
    let first = &said["first_2_kb"];
    assert_eq!((&first["exact"], &first["thumbnail_px"]), (&Value::Bool(false), &serde_json::json!([96, 64])));
    assert!(first["sent_bytes"].as_u64().unwrap() < 20_000 && first["sources"].as_array().unwrap().len() >= 8);
    assert!(said["bytes"].as_u64().unwrap() < 1_200_000);

    let output = stars(&["--decode", &path("out"), "--picture", &path("got.fits"), "--thumbnail", &path("thumbnail.png")]);
    assert_eq!(output.status.code(), Some(0));
    assert_same(&pixels(path("got.fits").as_ref()), &rendered.frame);
}

#[test]
fn wrong_calls_are_refused_in_a_line() {
    let directory = TempDir::new().unwrap();
    let nothing = directory.path().join("nothing");
    std::fs::write(&nothing, b"no packets").unwrap();
    for arguments in [&["--decode", nothing.to_str().unwrap()][..], &[nothing.to_str().unwrap()], &[]] {
        let output = stars(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert_eq!(output.stderr.iter().filter(|byte| **byte == b'\n').count(), 1);
    }
}
