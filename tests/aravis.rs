//! Real cameras, shown on Aravis's own fake GigE Vision camera over the loopback.
//!
//! Needs `arv-fake-gv-camera-0.8` (Debian: aravis-tools). Without it each test says SKIPPED, and fails where `CI` is set.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use stars::camera::{AravisCamera, Ask, CameraError, Moment, Source};
use stars::image::{ExposedBy, Frame, ImageCounter};
use stars::settings::{CameraSettings, PixelFormat, Settings, Trigger};
use stars::sky::{ClockQuality, Utc};
use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

const PROGRAM: &str = "arv-fake-gv-camera-0.8";
const SERIAL: &str = "STARS1";
/// No pixel is wrong.
const WHOLE: [u16; 0] = [];

/// The fake camera. There is one at a time, whichever process runs the test: it has the one port that cameras have.
struct Fake {
    process: Child,
    _alone: File,
}

impl Fake {
    /// Starts it, losing so many packets of a thousand; `None`, and a word about it, where it is not installed.
    fn start(test: &str, lost_per_thousand: u32) -> Option<Self> {
        if Command::new(PROGRAM).arg("--help").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err() {
            assert!(std::env::var_os("CI").is_none(), "{PROGRAM} is missing (Debian: aravis-tools)");
            eprintln!("SKIPPED {test}: {PROGRAM} is missing (Debian: aravis-tools)");
            return None;
        }
        let alone = File::create(std::env::temp_dir().join("stars-test-aravis.lock")).unwrap();
        alone.lock().unwrap();
        Some(Self { process: spawn(lost_per_thousand), _alone: alone })
    }

    /// Takes the camera away as a pulled cable does.
    fn unplug(&mut self) {
        self.process.kill().unwrap();
        self.process.wait().unwrap();
    }

    fn plug_in(&mut self) {
        self.process = spawn(0);
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

fn spawn(lost_per_thousand: u32) -> Child {
    let mut command = Command::new(PROGRAM);
    command.args(["--interface", "127.0.0.1", "--serial", SERIAL]);
    if lost_per_thousand > 0 {
        command.args(["--gvsp-lost-ratio", &lost_per_thousand.to_string()]);
    }
    let process = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    std::thread::sleep(Duration::from_millis(300));
    process
}

/// Settings of the fake camera: what it sends for an exposure of 10 ms at 0 dB is known pixel by pixel.
fn settings() -> CameraSettings {
    let mut camera = Settings::flight().unwrap().camera;
    camera.device = "127.0.0.1".to_owned();
    (camera.width_px, camera.height_px) = (256, 192);
    camera.exposure_s = 0.01;
    camera.pixel_format = PixelFormat::Mono8;
    camera
}

fn free(frames_per_s: u32) -> CameraSettings {
    CameraSettings { trigger: Trigger::Free, features: format!("AcquisitionFrameRate={frames_per_s}"), ..settings() }
}

fn moment() -> Moment {
    Moment {
        image: ImageCounter(0),
        uptime: Duration::ZERO,
        utc: Utc::from_calendar(2026, 12, 30, 8, 0, 0.0),
        quality: ClockQuality::FreeRunning,
        sigma_s: Some(0.5),
        ask: Ask::Expose,
    }
}

fn next(camera: &mut AravisCamera) -> Frame {
    Arc::unwrap_or_clone(camera.next(&moment()).unwrap().into_exposures().remove(0))
}

/// The camera's own number of a frame; where that was in a lost packet, by its place after the last.
fn number(frame: &Frame) -> u64 {
    let number = frame.stamp.origin.rsplit(' ').next().unwrap();
    number.split('+').map(|part| part.parse::<u64>().unwrap()).sum()
}

/// Pixels that are not what the camera sent for them: its ramp moves by one with each frame.
fn wrong(frame: &Frame, gain: u64) -> Vec<u16> {
    let sent = |at: usize| ((at % frame.width + at / frame.width) as u64 + number(frame)) % 255 * (1 + gain);
    let pixels = frame.pixels.iter().enumerate();
    pixels.filter(|(at, pixel)| u64::from(**pixel) != sent(*at).min(255)).map(|(_, pixel)| *pixel).collect()
}

#[test]
fn frames_come_whole_one_after_the_other_with_what_is_known_of_them() {
    let Some(_fake) = Fake::start("frames_come_whole", 0) else { return };
    let mut camera = AravisCamera::new(&free(50));
    let mut last = None;
    for _ in 0..50 {
        let frame = next(&mut camera);
        assert_eq!((frame.width, frame.height, frame.pixels.len(), frame.full_scale), (256, 192, 256 * 192, Some(255)));
        assert_eq!((frame.stamp.missing_packets, frame.stamp.missed_frames), (0, 0));
        assert!(frame.stamp.origin.starts_with("Aravis Fake STARS1 "), "{}", frame.stamp.origin);
        assert!((frame.stamp.exposure_s.unwrap() - 0.01).abs() < 1e-6);
        assert_eq!(wrong(&frame, 0), WHOLE);
        assert!(last.is_none_or(|last| number(&frame) == last + 1), "{} after {last:?}", number(&frame));
        last = Some(number(&frame));
        let (captured, _) = frame.stamp.captured.unwrap();
        let after = captured.unix_s() - moment().utc.unwrap().unix_s();
        assert!((-0.5..0.5).contains(&after), "captured {after} s after it was asked for");
    }
    assert_eq!(camera.temperature(), None, "it has none");
}

#[test]
fn sixteen_bits_are_taken_as_they_are_and_where_numbers_begin_again_nothing_is_missed() {
    let Some(_fake) = Fake::start("sixteen_bits", 0) else { return };
    let mut settings = free(500);
    (settings.width_px, settings.height_px) = (64, 64);
    settings.pixel_format = PixelFormat::Mono16;
    let mut camera = AravisCamera::new(&settings);
    let (mut missed, mut begun_again) = (0, false);
    let mut last = number(&next(&mut camera));
    for _ in 0..700 {
        let frame = next(&mut camera);
        assert_eq!((frame.pixels.len(), frame.full_scale), (64 * 64, Some(65_535)));
        missed += frame.stamp.missed_frames;
        begun_again |= number(&frame) < last;
        last = number(&frame);
    }
    assert!(begun_again, "the last is {last}");
    // At this rate a machine that is busy may lose some, but not as many as a number that is taken wrongly.
    assert!(missed < 100, "{missed} missed");
}

#[test]
fn each_trigger_gives_one_frame_and_nothing_comes_without() {
    let Some(_fake) = Fake::start("each_trigger", 0) else { return };
    let mut camera = AravisCamera::new(&settings());
    let mut last = number(&next(&mut camera));
    for pause_ms in [0, 0, 0, 150, 300, 0, 700, 0] {
        std::thread::sleep(Duration::from_millis(pause_ms));
        let frame = next(&mut camera);
        assert_eq!((number(&frame), frame.stamp.missed_frames), (last + 1, 0), "after {pause_ms} ms");
        assert_eq!(wrong(&frame, 0), WHOLE);
        last = number(&frame);
    }
}

#[test]
fn a_camera_on_a_line_gives_nothing_without_a_trigger_and_exposes_by_itself_when_told_to() {
    let Some(_fake) = Fake::start("a_camera_on_a_line", 0) else { return };
    // The fake one has no line: told to listen to one it sends nothing, as one that nobody triggers.
    let mut camera = AravisCamera::new(&CameraSettings { trigger: Trigger::Line0, ..free(1) });
    let mut ask = |ask| camera.next(&Moment { ask, ..moment() }).map(|series| series.into_exposures().remove(0));
    for _ in 0..3 {
        assert_eq!(ask(Ask::Triggered(Duration::from_millis(300))), Err(CameraError::NothingNew));
        let frame = ask(Ask::Expose).unwrap();
        assert_eq!((frame.stamp.exposed_by, frame.stamp.missed_frames), (Some(ExposedBy::Itself), 0));
        assert_eq!(wrong(&frame, 0), WHOLE);
    }
}

#[test]
fn gain_and_exposure_are_what_was_set_and_a_gain_that_it_has_not_is_refused() {
    let Some(_fake) = Fake::start("gain_and_exposure", 0) else { return };
    let mut camera = AravisCamera::new(&settings());
    assert_eq!(camera.gain(), Ok(0.0));
    assert_eq!(wrong(&next(&mut camera), 0), WHOLE);
    camera.set_gain(3.0).unwrap();
    assert_eq!(camera.gain(), Ok(3.0));
    assert_eq!(wrong(&next(&mut camera), 3), WHOLE, "four times as bright");
    let Err(CameraError::Unavailable(why)) = camera.set_gain(60.0) else { panic!("60 dB were taken") };
    assert!(why.contains("Aravis Fake STARS1 does not take a gain of 60 dB"), "{why}");
    assert_eq!(camera.gain(), Ok(3.0));
    drop(camera);
    let mut camera = AravisCamera::new(&CameraSettings { exposure_s: 0.1, gain_db: 1.0, ..settings() });
    let frame = next(&mut camera);
    assert!((frame.stamp.exposure_s.unwrap() - 0.1).abs() < 1e-6);
    assert_eq!((camera.gain(), wrong(&frame, 2)), (Ok(1.0), vec![]), "ten times the exposure adds what another 1 does");
}

#[test]
fn a_camera_that_is_taken_away_is_told_and_used_again_when_it_returns() {
    for trigger in [Trigger::Software, Trigger::Free] {
        let Some(mut fake) = Fake::start("a_camera_that_is_taken_away", 0) else { return };
        let mut camera = AravisCamera::new(&CameraSettings { trigger, ..settings() });
        next(&mut camera);
        camera.set_gain(2.0).unwrap();
        fake.unplug();
        let mut told = Vec::new();
        let (since, mut longest) = (Instant::now(), Duration::ZERO);
        // What it had sent before it went is still given.
        while told.len() < 2 {
            let asked = Instant::now();
            let answer = camera.next(&moment());
            longest = longest.max(asked.elapsed());
            match answer {
                Ok(frame) => assert!(since.elapsed() < Duration::from_secs(1), "{}", frame.exposures()[0].stamp.origin),
                Err(CameraError::Unavailable(why)) => told.push(why),
                Err(other) => panic!("{other}"),
            }
            assert!(since.elapsed() < Duration::from_secs(18), "{told:?}");
        }
        assert!(told[0].contains("Aravis Fake STARS1"), "{told:?}");
        assert!(told[1].contains("127.0.0.1: cannot be opened"), "{told:?}");
        println!("{trigger:?}: {told:?} after {:.1} s", since.elapsed().as_secs_f64());
        assert!(longest < Duration::from_secs(5), "one answer took {longest:?}");
        fake.plug_in();
        let frame = next(&mut camera);
        assert_eq!((frame.stamp.missed_frames, camera.gain()), (0, Ok(2.0)), "its gain is as it was");
        assert_eq!(wrong(&next(&mut camera), 2), WHOLE);
    }
}

#[test]
fn a_frame_with_lost_packets_is_marked_and_has_zeros_for_them() {
    let Some(_fake) = Fake::start("a_frame_with_lost_packets", 30) else { return };
    let mut camera = AravisCamera::new(&free(50));
    // One that has its number, to count from.
    let mut last = loop {
        let frame = next(&mut camera);
        if !frame.stamp.origin.contains(['?', '+']) {
            break number(&frame);
        }
    };
    let first = last;
    let (mut marked, mut missed, mut nameless) = (0, 0, 0);
    for _ in 0..100 {
        let frame = next(&mut camera);
        last = number(&frame);
        nameless += u64::from(frame.stamp.origin.contains('+'));
        let wrong = wrong(&frame, 0);
        assert!(wrong.iter().all(|pixel| *pixel == 0), "{}: {} pixels are of another image", frame.stamp.origin, wrong.len());
        assert!(wrong.is_empty() || frame.stamp.missing_packets > 0, "{} pixels are missing and it is not marked", wrong.len());
        marked += u64::from(frame.stamp.missing_packets > 0);
        missed += u64::from(frame.stamp.missed_frames);
    }
    println!("{marked} of 100 marked, {nameless} without their number, {missed} missed");
    assert!((40..95).contains(&marked), "{marked} of 100 marked; about two thirds have a packet lost");
    assert_eq!(last - first, 100 + missed, "what was given and what was missed are all that was sent");
}

#[test]
fn settings_that_the_camera_cannot_have_are_told_by_their_names() {
    let Some(_fake) = Fake::start("settings_that_the_camera_cannot_have", 0) else { return };
    let refused = |settings: CameraSettings| match AravisCamera::new(&settings).next(&moment()) {
        Err(CameraError::Unavailable(why)) => why,
        other => panic!("{other:?}"),
    };
    for (settings, named) in [
        (CameraSettings { pixel_format: PixelFormat::Mono12, ..settings() }, "PixelFormat"),
        (CameraSettings { width_px: 10_000, ..settings() }, "Width"),
        (CameraSettings { features: "NoSuchThing=1".to_owned(), ..settings() }, "camera.features"),
        (CameraSettings { trigger: Trigger::Line3, ..settings() }, "TriggerSource"),
        (CameraSettings { device: "no such camera".to_owned(), ..settings() }, "no such camera"),
    ] {
        let why = refused(settings);
        assert!(why.contains(named), "{why}");
    }
}
