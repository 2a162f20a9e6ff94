//! The program from the outside: the line from an image to both flight computers, exit codes, signals.

use crate::support::*;
use stars::catalog::Catalogue;
use stars::image::write_fits;
use stars::service::{Finished, Parts, Running};
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::sky::{Attitude, separation};
use stars::solve::Reason;
use stars::wire::Update;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;

/// The program's indexes are kept with what the build makes, not in the user's home.
const HOME: &str = env!("CARGO_TARGET_TMPDIR");

fn stars() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stars"));
    command.env_remove("RUST_LOG").env("HOME", HOME).current_dir(HOME);
    command
}

fn run(arguments: &[&str]) -> Output {
    stars().args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// The service with a real solver on a directory of one torn image and one rendered one.
async fn service_on_a_directory(directory: &std::path::Path) -> (Running, Attitude) {
    let spec = RenderSpec::new(Kind::Float, 5, 0);
    let rendered = render(&spec, &Catalogue::embedded().unwrap()).unwrap();
    let mut bytes = Vec::new();
    write_fits(&rendered.frame, &[], &mut bytes).unwrap();
    std::fs::write(directory.join("b.fits"), &bytes).unwrap();
    std::fs::write(directory.join("a.fits"), &bytes[..bytes.len() / 2]).unwrap();
    let mut settings = settings();
    settings.camera.kind = stars::settings::CameraKind::Directory;
    settings.camera.directory = directory.display().to_string();
    settings.lens.kind = stars::settings::LensKind::Simulated;
    settings.network.update_period_s = 0.1;
    let parts = Parts::of(&Arc::new(settings.clone())).unwrap();
    (start(settings, parts).await, rendered.truth.attitude.unwrap())
}

fn is_solved(update: &Update) -> bool {
    update.image.get().and_then(|image| image.reason.get()) == Some(Reason::Solved)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_torn_image_is_told_and_the_next_is_solved_and_served_to_both_computers() {
    let directory = tempfile::tempdir().unwrap();
    let (running, truth) = service_on_a_directory(directory.path()).await;
    let computers = [1, 2].map(|id| {
        let address = running.address;
        tokio::spawn(async move { Peer::connect(address).await.greet(id).await.update_where(is_solved).await })
    });
    for computer in computers {
        let update = computer.await.unwrap();
        let pointing = *update.image.get().unwrap().equatorial.get().unwrap();
        let (ra, dec) = (pointing.ra_deg.to_radians(), pointing.dec_deg.to_radians());
        let off = separation(&Attitude::from_angles(ra, dec, 0.0).boresight(), &truth.boresight());
        assert!(off.to_degrees() * 3600.0 < 5.0, "{off}");
        assert!(update.link.simulated_lens && !update.link.simulated_camera);
    }
    let state = running.state.borrow().clone();
    assert_eq!((state.counters.frames_unreadable, state.counters.frames_solved), (1, 1));
    let Finished { report, .. } = &**state.latest.as_ref().unwrap();
    assert!(report.simulated, "the lens is simulated, and the outcome does not say so");
    assert!(running.stop().await.is_empty());
}

/// A running service and the address that it listens on, taken from its first log line.
fn spawn_service(arguments: &[&str]) -> (Child, String, std::thread::JoinHandle<String>) {
    // Other services that run meanwhile have the page's usual port.
    let arguments = arguments.iter().chain(&["--set", "display.listen=127.0.0.1:0"]);
    let mut child = stars().arg("run").args(arguments).stderr(Stdio::piped()).spawn().unwrap();
    let mut log = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    log.read_line(&mut line).unwrap();
    let address = line.split("address=").nth(1).expect(&line).split_whitespace().next().unwrap().to_owned();
    // Somebody must read the rest, or the log would block the program.
    let rest = std::thread::spawn(move || log.lines().map_while(Result::ok).fold(line, |text, line| text + &line + "\n"));
    (child, address, rest)
}

#[tokio::test]
async fn sigterm_ends_it_cleanly_with_a_last_word_to_its_peers() {
    let arguments = ["--set", "network.listen=127.0.0.1:0", "--set", "record.enabled=false", "--set", "camera.kind=none"];
    let (mut child, address, log) = spawn_service(&arguments);
    let mut peer = Peer::connect(address.parse().unwrap()).await.greet(1).await;
    peer.update().await;
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert_eq!(peer.last_word().await.unwrap().refusal.get(), Some(stars::wire::Refusal::ShuttingDown));
    // It would be 1 if a part had not ended in its time, which is under 2 s for all of them.
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let log = log.join().unwrap();
    assert!(log.lines().all(|line| ["simulated", "stop", "the index"].iter().any(|word| line.contains(word))), "{log}");
}

#[test]
fn a_duration_ends_it_and_a_taken_address_is_a_wrong_call() {
    let quiet = ["record.enabled=false", "camera.kind=none", "display.listen=127.0.0.1:0"].map(|setting| ["--set", setting]);
    let quiet = [quiet.as_flattened(), &["--duration", "100ms"]].concat();
    let free = run(&[&["run", "--set", "network.listen=127.0.0.1:0"], &quiet[..]].concat());
    assert_eq!(free.status.code(), Some(0), "{}", text(&free.stderr));
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let listen = format!("network.listen={}", taken.local_addr().unwrap());
    let refused = run(&[&["run", "--set", &listen], &quiet[..]].concat());
    assert_eq!(refused.status.code(), Some(2));
    let complaint = text(&refused.stderr);
    assert!(complaint.lines().count() == 1 && complaint.contains("network.listen"), "{complaint}");
}

#[test]
fn a_disk_that_is_full_keeps_whole_lines_alone() {
    let there = tempfile::tempdir().unwrap();
    std::fs::write(there.path().join("a.fits"), "no image").unwrap();
    let records = there.path().join("records");
    let settings = [
        "network.listen=127.0.0.1:0",
        "camera.kind=directory",
        &format!("camera.directory={}", there.path().display()),
        "camera.repeat=true",
        "camera.startup_delay_s=0",
        "camera.period_s=0.02",
        &format!("record.directory={}", records.display()),
    ];
    // Files of at most 8 KiB: the write that goes beyond breaks off in the middle, as on a full disk.
    let limited = r#"trap '' XFSZ; ulimit -f 8; exec "$0" "$@""#;
    let run = Command::new("bash")
        .env("HOME", HOME)
        .args(["-c", limited, env!("CARGO_BIN_EXE_stars"), "run", "--duration", "3s"])
        .args(settings.iter().flat_map(|setting| ["--set", setting]))
        .output()
        .unwrap();
    let log = text(&run.stderr);
    assert_eq!(run.status.code(), Some(0), "{log}");
    assert!(log.contains("outcome not kept yet"), "{log}");
    let mut files = std::fs::read_dir(&records).unwrap().map(|entry| entry.unwrap().path());
    let file = files.find(|path| path.extension().is_some_and(|ending| ending == "jsonl")).unwrap();
    let kept = std::fs::read_to_string(file).unwrap();
    assert!(kept.lines().count() > 1 && kept.ends_with('\n'), "{kept}");
    for line in kept.lines() {
        assert!(serde_json::from_str::<serde_json::Value>(line).is_ok(), "{line}");
    }
}

#[test]
fn a_list_of_bad_pixels_that_is_wrong_starts_nothing() {
    let list = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(list.path(), "12 34\nfive six\n").unwrap();
    let setting = format!("solver.sources.bad_pixels_file={}", list.path().display());
    let refused = run(&["run", "--duration", "100ms", "--set", "network.listen=127.0.0.1:0", "--set", &setting]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("line 2"), "{}", text(&refused.stderr));
}

#[cfg(not(feature = "aravis"))]
#[test]
fn a_camera_without_a_driver_starts_nothing_and_the_self_test_says_so() {
    let aravis = ["network.listen=127.0.0.1:0", "display.listen=127.0.0.1:0", "record.enabled=false", "camera.kind=aravis"];
    let aravis = aravis.map(|setting| ["--set", setting]);
    let aravis = aravis.as_flattened();
    let refused = run(&[&["run", "--duration", "100ms"][..], aravis].concat());
    assert_eq!(refused.status.code(), Some(2));
    let complaint = text(&refused.stderr);
    assert!(
        complaint.lines().count() == 1 && complaint.contains("aravis") && complaint.contains("--features aravis"),
        "{complaint}"
    );
    let tested = run(&[&["selftest"][..], aravis].concat());
    assert_eq!(tested.status.code(), Some(1));
    assert!(text(&tested.stdout).lines().any(|line| line.starts_with("BAD") && line.contains("aravis")));
}

#[test]
fn the_demonstration_shows_solutions_beside_the_truth_and_ends_well() {
    let shown = run(&["demo", "--images", "4", "--duration", "100s"]);
    let lines = text(&shown.stdout);
    assert_eq!(shown.status.code(), Some(0), "{lines}{}", text(&shown.stderr));
    assert!(lines.contains("the page: http://127.0.0.1:"), "{lines}");
    assert_eq!(lines.lines().filter(|line| line.contains("truth") && line.contains("covered")).count(), 4, "{lines}");
    assert_eq!(lines.matches("a series, along its trails").count(), 1, "{lines}");
    assert!(lines.contains("0 wrong"), "{lines}");
}

#[test]
fn the_self_test_says_ready_or_why_not() {
    let disk = tempfile::tempdir().unwrap();
    let records = format!("record.directory={}", disk.path().join("records").display());
    let ready =
        run(&["selftest", "--set", "network.listen=127.0.0.1:0", "--set", "display.listen=127.0.0.1:0", "--set", &records]);
    let said = text(&ready.stdout);
    assert_eq!(ready.status.code(), Some(0), "{said}");
    assert!(said.ends_with("ready\n") && said.contains("simulated"), "{said}");
    let left: Vec<_> = std::fs::read_dir(disk.path().join("records")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["images"], "it left something behind");
    assert_eq!(std::fs::read_dir(disk.path().join("records/images")).unwrap().count(), 0, "it left something behind");

    let file = disk.path().join("file");
    std::fs::write(&file, "").unwrap();
    let records = format!("record.directory={}/records", file.display());
    let nowhere = ["camera.kind=directory", "camera.directory=/nowhere", "lens.kind=serial", "lens.port=/nowhere", &records];
    let mut arguments = vec!["selftest", "--set", "network.listen=192.0.2.1:2017"];
    arguments.extend(nowhere.iter().flat_map(|setting| ["--set", setting]));
    let not_ready = run(&arguments);
    let said = text(&not_ready.stdout);
    assert_eq!(not_ready.status.code(), Some(1), "{said}");
    for name in ["camera", "lens", "network", "disk"] {
        assert!(said.lines().any(|line| line.starts_with("BAD") && line.contains(name)), "{name}: {said}");
    }
    assert!(said.ends_with("not ready: 4 checks are bad\n"), "{said}");
}
