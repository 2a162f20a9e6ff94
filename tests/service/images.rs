//! Promises of the archive: every frame is kept as the camera gave it, whatever becomes of its solving, and nobody waits for the disk.

use crate::commands::Ground;
use crate::support::*;
use stars::command::Stage;
use stars::image::{BadPixels, ImageCounter, checksum_holds, read};
use stars::service::{Actor, Disk, ImageCounters, Parts, Running, Shed, State};
use stars::settings::Settings;
use stars::solve::Reason;
use stars::wire::Status;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

async fn until(running: &Running, wanted: impl FnMut(&Arc<State>) -> bool) -> Arc<State> {
    let mut state = running.state.clone();
    let seen = tokio::time::timeout(PATIENCE, state.wait_for(wanted)).await.expect("it never came").unwrap();
    Arc::clone(&seen)
}

fn images(state: &State, disk: Disk) -> ImageCounters {
    state.counters.images.get(&disk).copied().unwrap_or_default()
}

fn keeping(directory: &Path) -> Settings {
    let mut settings = settings();
    settings.camera.period_s = 0.02;
    settings.service.restart_delay_s = 0.01;
    settings.service.restart_delay_max_s = 0.1;
    settings.record.enabled = true;
    settings.record.images = true;
    settings.record.reserve_gib = 0.0;
    settings.record.directory = directory.join("record").display().to_string();
    settings
}

/// The files of a store by the number of their image, each read and its checksum judged; the header as text.
fn kept(directory: &Path) -> BTreeMap<u32, String> {
    let files = |directory: &Path| -> Vec<PathBuf> {
        std::fs::read_dir(directory).into_iter().flatten().map(|entry| entry.unwrap().path()).collect()
    };
    let mut kept = BTreeMap::new();
    for file in files(directory).iter().flat_map(|day| files(day)) {
        let bytes = std::fs::read(&file).unwrap();
        let name = file.display().to_string();
        assert_eq!(checksum_holds(&bytes), Some(true), "{name}");
        let image = read(&name, &bytes).unwrap();
        assert_eq!(image.pixels, frame().pixels, "{name}");
        assert_eq!(kept.insert(image.stamp.image.0, String::from_utf8_lossy(&bytes).into_owned()), None, "kept twice: {name}");
    }
    kept
}

fn outcome(header: &str) -> Option<&str> {
    header.split("OUTCOME = '").nth(1)?.split('\'').next().map(str::trim_end)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_frame_is_kept_on_both_disks_even_where_the_solver_breaks_or_is_slow() {
    let directory = tempfile::tempdir().unwrap();
    let looked_at = Arc::new(Mutex::new(Vec::new()));
    let notes = Arc::clone(&looked_at);
    let odd = solver(move |frame, _, _| {
        let nth = {
            let mut notes = notes.lock().unwrap();
            notes.push(frame.stamp.image.0);
            notes.len()
        };
        match nth {
            2 => panic!("an image that breaks the solver"),
            // Longer than the archive waits for an outcome.
            3 => std::thread::sleep(Duration::from_millis(900)),
            _ => {}
        }
        no_match(&frame.stamp)
    });
    let mut settings = keeping(directory.path());
    settings.record.queue_images = 200;
    settings.record.copies_directory = directory.path().join("second").display().to_string();
    let running = start(settings, Parts { camera: plain_camera(), solver: odd, lens: None }).await;
    until(&running, |state| {
        images(state, Disk::Copies).kept >= 60
            && state.latest.as_ref().is_some_and(|finished| finished.outcome.stamp.image.0 > 60)
    })
    .await;
    let state = running.state.clone();
    assert!(running.stop().await.is_empty());
    let taken = state.borrow().counters.frames_taken;
    for store in ["record/images", "second"] {
        let kept = kept(&directory.path().join(store));
        assert_eq!(kept.keys().copied().collect::<Vec<_>>(), (0..taken).collect::<Vec<_>>(), "{store}");
        let of = |image| kept.get(&image).and_then(|header| outcome(header));
        let ended = looked_at.lock().unwrap().iter().take(3).map(|image| of(*image)).collect::<Vec<_>>();
        assert_eq!(ended, [Some("no_match"), Some("failed"), Some("no_match")], "{store}");
        assert!(kept.values().any(|header| outcome(header) == Some("skipped")), "{store}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_dead_disk_is_told_at_once_stops_nobody_and_what_waited_is_kept_when_it_is_back() {
    let directory = tempfile::tempdir().unwrap();
    let blocked = directory.path().join("second");
    std::fs::write(&blocked, "a file where the directory should be").unwrap();
    let mut settings = keeping(directory.path());
    settings.record.queue_images = 8;
    settings.record.copies_directory = blocked.display().to_string();
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let first = until(&running, |state| images(state, Disk::Copies).disk_errors >= 1).await;
    assert!(first.counters.frames_taken < 20, "told late: after {} frames", first.counters.frames_taken);
    let state = until(&running, |state| images(state, Disk::Copies).lost >= 10).await;
    assert!(images(&state, Disk::Images).kept >= 10 && images(&state, Disk::Images).lost == 0, "the other disk was held up");
    assert_eq!(state.counters.restarts.get(&Actor::Archive), None);
    std::fs::remove_file(&blocked).unwrap();
    until(&running, |state| images(state, Disk::Copies).kept >= 20).await;
    let state = running.state.clone();
    assert!(running.stop().await.is_empty());
    let copies = images(&state.borrow(), Disk::Copies);
    let (kept, taken) = (kept(&blocked), state.borrow().counters.frames_taken);
    let told = copies.kept + copies.lost;
    // What was under way when it was stopped is kept, and nobody is left to be told.
    assert!(told <= taken && kept.len() as u32 >= copies.kept, "{copies:?}, {} kept of {taken}", kept.len());
}

#[tokio::test]
async fn frames_are_kept_with_their_bad_pixels_and_solved_without() {
    let directory = tempfile::tempdir().unwrap();
    let list = directory.path().join("bad.txt");
    std::fs::write(&list, "3 4\n").unwrap();
    assert_eq!(BadPixels::parse("bad", "3 4").unwrap().len(), 1);
    let images_in = directory.path().join("in");
    std::fs::create_dir(&images_in).unwrap();
    let mut hot = frame();
    hot.pixels[4 * 16 + 3] = 60_000;
    let mut bytes = Vec::new();
    stars::image::write_fits(&hot, &[], &mut bytes).unwrap();
    std::fs::write(images_in.join("hot.fits"), bytes).unwrap();
    let mut settings = keeping(directory.path());
    settings.camera.kind = stars::settings::CameraKind::Directory;
    settings.camera.directory = images_in.display().to_string();
    (settings.camera.width_px, settings.camera.height_px) = (16, 16);
    settings.solver.sources.bad_pixels_file = list.display().to_string();
    let settings = Arc::new(settings);
    let running = start((*settings).clone(), Parts::of(&settings).unwrap()).await;
    let state = until(&running, |state| images(state, Disk::Images).kept >= 1 && state.latest.is_some()).await;
    let report = &state.latest.as_ref().unwrap().report;
    assert_ne!(report.reason, Reason::Failed, "{}", report.detail);
    running.stop().await;
    let day = std::fs::read_dir(directory.path().join("record/images")).unwrap().next().unwrap().unwrap().path();
    let file = std::fs::read_dir(day).unwrap().next().unwrap().unwrap().path();
    assert_eq!(read("kept", &std::fs::read(file).unwrap()).unwrap().pixels, hot.pixels);
}

#[tokio::test]
async fn a_brighter_sky_is_pretended_on_command_where_a_file_allows_it_and_images_are_kept_without() {
    let directory = tempfile::tempdir().unwrap();
    let images_in = directory.path().join("in");
    std::fs::create_dir(&images_in).unwrap();
    let mut bytes = Vec::new();
    stars::image::write_fits(&frame(), &[], &mut bytes).unwrap();
    std::fs::write(images_in.join("night.fits"), bytes).unwrap();
    for allowed in [false, true] {
        let kept_in = directory.path().join(allowed.to_string());
        let mut settings = keeping(&kept_in);
        (settings.camera.kind, settings.camera.repeat) = (stars::settings::CameraKind::Directory, true);
        settings.camera.directory = images_in.display().to_string();
        (settings.camera.width_px, settings.camera.height_px) = (16, 16);
        settings.solver.sources.border_px = 1;
        settings.brightness.allowed = allowed;
        let settings = Arc::new(settings);
        let running = start((*settings).clone(), Parts::of(&settings).unwrap()).await;
        let mean = |state: &State| -> Option<f64> { state.latest.as_ref().and_then(|finished| finished.report.stats.mean) };
        until(&running, |state| mean(state) == Some(100.0)).await;
        let mut ground = Ground::of(&running, 1, true);
        let (_, reply) = ground.run("simulator.set_brightness 1 300 0 0.12 0.12").await;
        if allowed {
            assert_eq!(reply.stage.get(), Some(Stage::Completed), "{reply:?}");
            // 300 ke⁻/s for 0.12 s at 0.04096 ADU/e⁻.
            let bright = until(&running, |state| mean(state).is_some_and(|mean| (mean - 1474.6).abs() < 10.0)).await;
            assert!(bright.latest.as_ref().is_some_and(|finished| finished.outcome.stamp.simulated));
            ground.run("simulator.set_brightness 0 300 0 0.12 0.12").await;
            until(&running, |state| mean(state) == Some(100.0)).await;
        } else {
            assert_eq!(reply.stage.get(), Some(Stage::Failed), "{reply:?}");
            assert!(reply.words.to_string().contains("brightness.allowed"), "{reply:?}");
        }
        running.stop().await;
        // Each as it came.
        assert!(!kept(&kept_in.join("record/images")).is_empty());
    }
}

#[tokio::test]
async fn a_computer_that_is_too_slow_sheds_images_and_then_the_robust_search_and_takes_both_back() {
    let directory = tempfile::tempdir().unwrap();
    let seen = Arc::new(Mutex::new(Vec::new()));
    let notes = Arc::clone(&seen);
    struct Noting(Arc<Mutex<Vec<bool>>>, bool);
    impl stars::service::Solve for Noting {
        fn solve(
            &mut self,
            frame: &stars::image::Frame,
            _: &stars::solve::Prior,
            _: &dyn stars::solve::Watch,
        ) -> stars::solve::Outcome {
            self.0.lock().unwrap().push(self.1);
            no_match(&frame.stamp)
        }
        fn report(&self, outcome: &stars::solve::Outcome) -> stars::solve::Report {
            stars::solve::Report::without_stars(outcome)
        }
        fn adopt(&mut self, settings: &Arc<Settings>) {
            self.1 = settings.solver.robust;
        }
    }
    let make: stars::service::MakeSolver =
        Arc::new(move || Ok(Box::new(Noting(Arc::clone(&notes), true)) as Box<dyn stars::service::Solve>));
    let mut settings = keeping(directory.path());
    settings.network.update_period_s = 0.1;
    let running = start(settings, Parts { camera: plain_camera(), solver: make, lens: None }).await;
    let mut peer = Peer::attach(&running, 1 << 16).await.greet(1).await;
    // All that runs here shares one thread, which is held up time after time.
    let mut shed = Shed::Nothing;
    while shed != Shed::Solving {
        std::thread::sleep(Duration::from_millis(150));
        peer.status(Status::default()).await;
        let update = peer.update().await;
        shed = running.state.borrow().strain.shed();
        assert!(update.health.shed.get().is_some_and(|told| told <= shed), "{:?}", update.health.shed);
    }
    let before = images(&running.state.borrow(), Disk::Images);
    let frames = seen.lock().unwrap().len();
    until(&running, |state| images(state, Disk::Images).lost > before.lost + 5).await;
    let now = images(&running.state.borrow(), Disk::Images);
    assert!(now.kept <= before.kept + 2, "images are kept all the same: {before:?}, {now:?}");
    assert!(seen.lock().unwrap().iter().skip(frames + 2).all(|robust| !robust), "the robust search goes on");
    tokio::time::pause();
    for _ in 0..1000 {
        peer.status(Status::default()).await;
        peer.update().await;
    }
    assert_eq!(running.state.borrow().strain.shed(), Shed::Nothing);
    tokio::time::resume();
    until(&running, |state| images(state, Disk::Images).kept > now.kept).await;
    assert_eq!(seen.lock().unwrap().last(), Some(&true));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_solver_that_never_ends_takes_three_threads_and_no_more() {
    let (never, held) = mpsc::sync_channel::<()>(0);
    let held = Mutex::new(held);
    let endless = solver(move |frame, _, _| {
        let _ = held.lock().unwrap().recv();
        no_match(&frame.stamp)
    });
    let mut settings = settings();
    settings.solver.timeout_s = 0.05;
    let running = start(settings, Parts { camera: plain_camera(), solver: endless, lens: None }).await;
    let words = |state: &State| state.latest.as_ref().map(|finished| finished.outcome.detail.clone()).unwrap_or_default();
    let state = until(&running, |state| words(state).contains("time after time")).await;
    assert!(state.latest.as_ref().unwrap().outcome.stamp.image > ImageCounter(2));
    assert_eq!(running.hopeless(Duration::from_secs(3600)), Some(Actor::Solver));
    let mut peer = Peer::connect(running.address).await.greet(1).await;
    peer.update().await;
    // Once they end all is well again.
    drop(never);
    until(&running, |state| words(state) == "nothing").await;
    tokio::time::timeout(PATIENCE, async {
        while running.hopeless(Duration::from_secs(3600)).is_some() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await
    .expect("it is still given up");
}
