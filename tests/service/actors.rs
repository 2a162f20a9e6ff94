//! Promises of the actors: every frame ends in one outcome, and whatever breaks is started again and counted.

use crate::support::*;
use stars::camera::CameraError;
use stars::image::ImageCounter;
use stars::service::{Actor, CameraState, Closed, MakeSolver, MakeSource, Parts, Readiness, Running, State};
use stars::settings::CameraKind;
use stars::sky::{ARCSEC, Attitude, Mat3};
use stars::solve::{FoundBy, Outcome, Prior, Reason, Solution, Stop};
use stars::wire::{HorizontalEstimate, ObserverPart, Status};
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, mpsc};
use std::time::Duration;

/// Waits until the state is as wanted.
async fn until(running: &Running, wanted: impl FnMut(&Arc<State>) -> bool) -> Arc<State> {
    let mut state = running.state.clone();
    let seen = tokio::time::timeout(PATIENCE, state.wait_for(wanted)).await.expect("it never came").unwrap();
    Arc::clone(&seen)
}

fn latest(state: &State) -> Option<&Outcome> {
    state.latest.as_ref().map(|finished| &finished.outcome)
}

fn restarts(state: &State, actor: Actor) -> u32 {
    state.counters.restarts.get(&actor).copied().unwrap_or_default()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn both_computers_get_every_update_while_the_solver_is_busy() {
    let (release, held) = mpsc::sync_channel::<()>(1);
    let held = Mutex::new(held);
    let busy = solver(move |frame, _, _| {
        let _ = held.lock().unwrap().recv();
        no_match(&frame.stamp)
    });
    let mut settings = settings();
    settings.network.update_period_s = 0.1;
    settings.camera.period_s = 0.05;
    let running = start(settings, Parts { camera: plain_camera(), solver: busy, lens: None }).await;
    until(&running, |state| state.solving.is_some()).await;
    let mut peers = [Peer::connect(running.address).await.greet(1).await, Peer::connect(running.address).await.greet(2).await];
    for n in 0..20 {
        for peer in &mut peers {
            peer.status(Status::default()).await;
            let update = peer.update().await;
            assert!(update.counters.solving, "the solver is not busy");
            assert_eq!(update.link.sequence.get(), n, "an update was left out");
        }
    }
    assert!(running.state.borrow().counters.frames_skipped > 5);
    drop(release);
}

#[tokio::test]
async fn every_frame_ends_in_one_outcome_and_the_newest_waits() {
    let directory = tempfile::tempdir().unwrap();
    let (release, held) = mpsc::sync_channel::<()>(3);
    let held = Mutex::new(held);
    let slow = solver(move |frame, _, _| {
        let _ = held.lock().unwrap().recv();
        no_match(&frame.stamp)
    });
    let mut settings = settings();
    settings.camera.period_s = 0.02;
    settings.record.enabled = true;
    settings.record.directory = directory.path().join("made").display().to_string();
    let running = start(settings, Parts { camera: plain_camera(), solver: slow, lens: None }).await;
    until(&running, |state| state.counters.frames_skipped >= 5).await;
    for _ in 0..3 {
        release.send(()).unwrap();
    }
    until(&running, |state| latest(state).is_some_and(|outcome| outcome.stamp.image.0 > 0)).await;
    drop(release);
    let state = running.state.clone();
    assert!(running.stop().await.is_empty());
    let taken = state.borrow().counters.frames_taken;
    let file = std::fs::read_dir(directory.path().join("made")).unwrap().next().unwrap().unwrap().path();
    let lines: Vec<serde_json::Value> =
        std::fs::read_to_string(file).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let images: BTreeSet<u64> = lines.iter().map(|line| line["image_counter"].as_u64().unwrap()).collect();
    assert_eq!(lines.len(), images.len(), "a frame has two outcomes");
    assert_eq!(images, (0..u64::from(taken)).collect(), "a frame has no outcome");
    let reasons: BTreeSet<&str> = lines.iter().map(|line| line["reason"].as_str().unwrap()).collect();
    assert!(reasons.is_superset(&["no_match", "skipped"].into()) && !reasons.contains("failed"), "{reasons:?}");
}

#[tokio::test]
async fn a_solver_that_panics_fails_its_frame_and_the_next_is_solved() {
    let fragile = solver(|frame, _, _| {
        assert!(frame.stamp.image != ImageCounter(0), "an image that breaks the solver");
        no_match(&frame.stamp)
    });
    let frames = Arc::new(AtomicU32::new(1));
    let running = start(settings(), Parts { camera: camera_of(&frames), solver: fragile, lens: None }).await;
    let failed = until(&running, |state| latest(state).is_some()).await;
    let outcome = latest(&failed).unwrap();
    assert_eq!((outcome.stamp.image, outcome.reason), (ImageCounter(0), Reason::Failed));
    assert!(outcome.detail.contains("an image that breaks the solver"), "{}", outcome.detail);
    frames.store(2, Ordering::Relaxed);
    let next = until(&running, |state| latest(state).is_some_and(|outcome| outcome.reason == Reason::NoMatch)).await;
    assert_eq!(next.readiness, Readiness::Ready);
    assert_eq!(restarts(&next, Actor::Solver), 0, "the actor itself goes on");
}

#[tokio::test]
async fn a_frame_that_is_too_old_is_given_up() {
    let endless = solver(|frame, _, watch| {
        loop {
            if let Some(stop) = watch.stop() {
                assert_eq!(stop, Stop::TimedOut);
                return Outcome::unsolved(frame.stamp.clone(), Reason::TimedOut, "too old");
            }
            std::thread::yield_now();
        }
    });
    let mut settings = settings();
    settings.solver.timeout_s = 0.3;
    let running = start(settings, Parts { camera: plain_camera(), solver: endless, lens: None }).await;
    let state = until(&running, |state| latest(state).is_some()).await;
    assert_eq!(latest(&state).unwrap().reason, Reason::TimedOut);
    assert!(state.latest.as_ref().unwrap().captured.elapsed() >= Duration::from_millis(300));
}

#[tokio::test]
async fn a_solver_that_does_not_stop_when_told_is_left_behind() {
    let (release, held) = mpsc::sync_channel::<()>(1);
    let held = Mutex::new(held);
    let deaf = solver(move |frame, _, _| {
        if frame.stamp.image == ImageCounter(0) {
            let _ = held.lock().unwrap().recv();
        }
        no_match(&frame.stamp)
    });
    let mut settings = settings();
    settings.solver.timeout_s = 0.1;
    let frames = Arc::new(AtomicU32::new(1));
    let running = start(settings, Parts { camera: camera_of(&frames), solver: deaf, lens: None }).await;
    let state = until(&running, |state| latest(state).is_some()).await;
    let outcome = latest(&state).unwrap();
    assert_eq!((outcome.stamp.image, outcome.reason), (ImageCounter(0), Reason::Failed));
    frames.store(2, Ordering::Relaxed);
    until(&running, |state| latest(state).is_some_and(|outcome| outcome.reason == Reason::NoMatch)).await;
    drop(release);
}

#[tokio::test]
async fn a_catalogue_that_is_refused_is_told_with_every_frame_and_updates_go_on() {
    let mut settings = settings();
    settings.catalog.file = "/nowhere/stars.bin".to_owned();
    let shared = Arc::new(settings.clone());
    let parts = Parts { camera: plain_camera(), ..Parts::of(&shared).unwrap() };
    let running = start(settings, parts).await;
    let state = until(&running, |state| latest(state).is_some()).await;
    let outcome = latest(&state).unwrap();
    assert_eq!(outcome.reason, Reason::Failed);
    assert!(outcome.detail.contains("/nowhere/stars.bin"), "{}", outcome.detail);
    assert!(matches!(state.readiness, Readiness::Broken(_)));
    Peer::connect(running.address).await.greet(1).await.update().await;
}

#[tokio::test]
async fn an_actor_that_breaks_is_started_again_and_counted_and_nobody_else_notices() {
    let attempts = Arc::new(AtomicU32::new(0));
    let tried = Arc::clone(&attempts);
    let sound = plain_camera().unwrap();
    let camera: MakeSource = Arc::new(move || {
        assert!(tried.fetch_add(1, Ordering::Relaxed) >= 3, "no driver yet");
        sound()
    });
    let mut settings = settings();
    settings.service.restart_delay_s = 0.01;
    let running = start(settings, Parts { camera: Some(camera), solver: plain_solver(), lens: None }).await;
    let mut peer = Peer::connect(running.address).await.greet(1).await;
    let update = peer.update_where(|update| update.image.get().is_some()).await;
    assert_eq!(update.counters.restarts_camera.get(), 3);
    assert_eq!(running.state.borrow().counters.closed, Default::default());
}

#[tokio::test]
async fn an_image_that_breaks_the_reader_is_unreadable_and_the_next_is_taken() {
    let hostile = camera(|moment| {
        assert!(moment.image.0 != 1, "a pixel of no colour");
        Ok(frame())
    });
    let running = start(settings(), Parts { camera: hostile, solver: plain_solver(), lens: None }).await;
    let state = until(&running, |state| latest(state).is_some_and(|outcome| outcome.stamp.image.0 >= 2)).await;
    assert_eq!((state.counters.frames_unreadable, restarts(&state, Actor::Camera)), (1, 0));
}

#[tokio::test]
async fn a_camera_without_images_is_told_and_asked_again() {
    let asked = AtomicU32::new(0);
    let late = camera(move |_| match asked.fetch_add(1, Ordering::Relaxed) {
        0..=1 => Err(CameraError::Unavailable("the bus is reset".to_owned())),
        _ => Ok(frame()),
    });
    let running = start(settings(), Parts { camera: late, solver: plain_solver(), lens: None }).await;
    until(&running, |state| state.camera == CameraState::Unavailable("the bus is reset".to_owned())).await;
    let state = until(&running, |state| state.camera == CameraState::Working && latest(state).is_some()).await;
    assert_eq!(latest(&state).unwrap().stamp.image, ImageCounter(0), "what was no image took a number");
}

#[tokio::test]
async fn a_dead_disk_is_counted_stops_nobody_and_is_used_again_when_it_is_back() {
    let disk = tempfile::tempdir().unwrap();
    let blocked = disk.path().join("records");
    std::fs::write(&blocked, "a file where the directory should be").unwrap();
    let mut settings = settings();
    settings.camera.period_s = 0.02;
    settings.service.restart_delay_s = 0.01;
    settings.service.restart_delay_max_s = 0.1;
    settings.record.enabled = true;
    settings.record.queue_frames = 4;
    settings.record.directory = blocked.display().to_string();
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let state = until(&running, |state| state.counters.records_lost >= 10 && state.counters.disk_errors >= 2).await;
    assert_eq!(state.counters.records_written, 0);
    assert!(state.counters.frames_taken >= 10, "the camera was held up");
    assert_eq!(restarts(&state, Actor::Recorder), 0);
    std::fs::remove_file(&blocked).unwrap();
    until(&running, |state| state.counters.records_written >= 5).await;
    running.stop().await;
    let file = std::fs::read_dir(&blocked).unwrap().next().unwrap().unwrap().path();
    for line in std::fs::read_to_string(file).unwrap().lines() {
        assert_eq!(serde_json::from_str::<serde_json::Value>(line).unwrap()["reason"], "no_match");
    }
}

#[tokio::test]
async fn records_whose_file_was_removed_go_on_in_a_new_one() {
    let disk = tempfile::tempdir().unwrap();
    let records = disk.path().join("records");
    let mut settings = settings();
    settings.camera.period_s = 0.02;
    settings.record.enabled = true;
    settings.record.directory = records.display().to_string();
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    until(&running, |state| state.counters.records_written >= 3).await;
    let file = std::fs::read_dir(&records).unwrap().next().unwrap().unwrap().path();
    std::fs::remove_file(&file).unwrap();
    let before = running.state.borrow().counters.records_written;
    until(&running, |state| state.counters.records_written >= before + 5).await;
    running.stop().await;
    // One or two may have been under way when it vanished.
    assert!(std::fs::read_to_string(file).unwrap().lines().count() >= 3);
}

#[tokio::test]
async fn the_priors_of_the_computer_in_charge_go_with_the_frame() {
    let seen: Arc<Mutex<Vec<Prior>>> = Arc::default();
    let record = Arc::clone(&seen);
    let watching = solver(move |frame, prior, _| {
        record.lock().unwrap().push(prior.clone());
        no_match(&frame.stamp)
    });
    let running = start(settings(), Parts { camera: plain_camera(), solver: watching, lens: None }).await;
    let mut idle = Peer::connect(running.address).await.greet(1).await;
    let mut charged = Peer::connect(running.address).await.greet(2).await;
    let estimate = |az_deg| Some(HorizontalEstimate { az_deg, el_deg: 40.0 }).into();
    let observer = Some(ObserverPart { latitude_deg: -77.0, sidereal_time_h: 3.0 }).into();
    idle.status(Status { horizontal_estimate: estimate(10.0), ..Status::default() }).await;
    let said = Status { horizontal_estimate: estimate(200.0), observer, trigger_counter: Some(77).into(), ..claim() };
    charged.status(said).await;
    let state = until(&running, |state| latest(state).is_some_and(|outcome| outcome.stamp.trigger.is_some())).await;
    assert_eq!(latest(&state).unwrap().stamp.trigger.unwrap().0, 77);
    let priors = seen.lock().unwrap();
    let prior = priors.iter().find(|prior| prior.horizontal.is_some()).expect("no prior reached the solver");
    assert!((prior.horizontal.unwrap().0.to_degrees() - 200.0).abs() < 1e-9);
    let observer = prior.observer.unwrap();
    assert!((observer.latitude.to_degrees() + 77.0).abs() < 1e-9);
    // The sidereal time has gone on since.
    let turned = observer.sidereal_time.to_degrees() - 45.0;
    assert!((0.0..PATIENCE.as_secs_f64() * 15.1 / 3600.0).contains(&turned), "{turned}");
}

/// What a solver says that has found the boresight.
fn solved(frame: &stars::image::Frame) -> Outcome {
    let solution = Solution {
        attitude: Attitude::from_angles(1.0, -0.5, 0.2),
        platescale: 9.5 * ARCSEC,
        k1: 0.0,
        axis: (0.0, 0.0),
        covariance: Mat3::identity() * ARCSEC * ARCSEC,
        sigma_platescale: 1e-3 * ARCSEC,
        rms_px: 0.1,
        chi2_per_dof: 1.0,
        matches: Vec::new(),
        false_probability_log10: -20.0,
        horizontal: None,
        epoch_yr: None,
        start: None,
        served: None,
    };
    let found_by = Some(FoundBy::LostInSpace);
    Outcome { solution: Some(solution), found_by, ..Outcome::unsolved(frame.stamp.clone(), Reason::Solved, "") }
}

#[tokio::test]
async fn what_a_solution_showed_goes_with_the_next_frame_and_a_solver_that_broke_does_not_take_it_along() {
    let seen: Arc<Mutex<Vec<Prior>>> = Arc::default();
    let record = Arc::clone(&seen);
    let telling = solver(move |frame, prior, _| {
        record.lock().unwrap().push(prior.clone());
        assert!(frame.stamp.image != ImageCounter(1), "an image that breaks the solver");
        solved(frame)
    });
    let running = start(settings(), Parts { camera: plain_camera(), solver: telling, lens: None }).await;
    until(&running, |state| state.counters.frames_solved >= 2).await;
    let priors = seen.lock().unwrap();
    assert_eq!((priors[0].attitude, priors[0].lens), (None, None), "the first frame is lost in space");
    for prior in &priors[1..3] {
        let attitude = prior.attitude.expect("the last solution says where the camera looked");
        assert_eq!(attitude.attitude, Attitude::from_angles(1.0, -0.5, 0.2));
        assert!(attitude.sigma > ARCSEC && prior.lens.is_some_and(|lens| lens.platescale == 9.5 * ARCSEC));
    }
    let age = |prior: &Prior| prior.attitude.map_or(0.0, |attitude| attitude.sigma);
    assert!(age(&priors[2]) > age(&priors[1]), "an older solution is surer than a newer one");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_service_stops_within_two_seconds_in_the_middle_of_everything() {
    let (near, held) = mpsc::sync_channel::<()>(1);
    let held = Mutex::new(held);
    let stuck = camera(move |moment| {
        if moment.image.0 == 3 {
            let _ = held.lock().unwrap().recv_timeout(Duration::from_secs(30));
        }
        Ok(frame())
    });
    let endless = solver(|frame, _, watch| {
        loop {
            if watch.stop() == Some(Stop::Aborted) {
                return Outcome::unsolved(frame.stamp.clone(), Reason::Aborted, "stopped");
            }
            std::thread::yield_now();
        }
    });
    let mut settings = settings();
    settings.camera.period_s = 0.02;
    let running = start(settings, Parts { camera: stuck, solver: endless, lens: None }).await;
    let mut peer = Peer::connect(running.address).await.greet(1).await;
    until(&running, |state| state.counters.frames_taken == 3).await;
    let state = running.state.clone();
    // Each of four stages has 450 ms, and what does not keep to them is named.
    assert_eq!(running.stop().await, Vec::<&str>::new());
    assert_eq!(peer.last_word().await.unwrap().refusal.get(), Some(stars::wire::Refusal::ShuttingDown));
    let state = state.borrow();
    assert_eq!(latest(&state).unwrap().reason, Reason::Aborted);
    assert_eq!(state.counters.closed.get(&Closed::Stopping), Some(&1));
    drop(near);
}

#[tokio::test]
async fn it_stops_at_once_while_a_solver_is_being_made_and_the_frame_that_waits_has_its_outcome() {
    let (release, held) = mpsc::sync_channel::<()>(8);
    let held = Mutex::new(held);
    let ready = plain_solver();
    let slow: MakeSolver = Arc::new(move || {
        let _ = held.lock().unwrap().recv();
        ready()
    });
    let frames = Arc::new(AtomicU32::new(1));
    let running = start(settings(), Parts { camera: camera_of(&frames), solver: slow, lens: None }).await;
    let state = until(&running, |state| state.counters.frames_taken == 1).await;
    assert_eq!(state.readiness, Readiness::Starting);
    let state = running.state.clone();
    assert_eq!(running.stop().await, Vec::<&str>::new());
    assert_eq!(latest(&state.borrow()).unwrap().reason, Reason::Aborted);
    drop(release);
}

#[tokio::test]
async fn updates_say_what_is_simulated() {
    for (camera, lens, said) in [("sky", "none", (true, false)), ("none", "simulated", (false, true))] {
        let mut settings = settings();
        settings.camera.kind = if camera == "sky" { CameraKind::Sky } else { CameraKind::None };
        settings.lens.kind = serde_json::from_value(lens.into()).unwrap();
        let running = start_without_camera(settings).await;
        let update = Peer::connect(running.address).await.greet(1).await.update().await;
        assert_eq!((update.link.simulated_camera, update.link.simulated_lens), said);
    }
}
