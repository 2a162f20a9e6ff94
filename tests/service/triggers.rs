//! A camera that others trigger: an image for each trigger, by itself when none comes, and back when they return.

use crate::commands::Ground;
use crate::support::*;
use stars::camera::{CameraError, LinePulses, Moment, SimulatedLine, Source};
use stars::command::Stage;
use stars::image::{ExposedBy, Series, read};
use stars::service::{CameraState, MakeSolver, MakeSource, Parts, Running};
use stars::settings::{CameraKind, Settings, Trigger};
use stars::solve::{Outcome, Reason};
use stars::wire::{Status, Update};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::time::Instant;

/// Sends statuses that count the pulses, each beside an update, until one is as wanted; the pulses go on where `step` is not 0.
async fn fly<S>(peer: &mut Peer<S>, pulses: &mut u32, step: u32, wanted: impl Fn(&Update) -> bool) -> Update
where
    S: tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin,
{
    let began = Instant::now();
    while began.elapsed() < PATIENCE {
        *pulses += step;
        let series = Some(*pulses).into();
        peer.status(Status { boot_id: 7.into(), trigger_pulses: (*pulses).into(), trigger_counter: series, ..claim() }).await;
        let update = peer.update().await;
        if wanted(&update) {
            return update;
        }
    }
    panic!("no such update came");
}

fn exposing(update: &Update) -> Option<ExposedBy> {
    update.triggers.exposing.get()
}

fn taken(update: &Update) -> u32 {
    update.counters.frames_taken.get()
}

#[tokio::test(start_paused = true)]
async fn without_triggers_the_camera_exposes_by_itself_says_so_and_goes_back_when_they_return() {
    let mut settings = settings();
    settings.camera.trigger = Trigger::Line0;
    settings.camera.trigger_timeout_s = 5.0;
    settings.camera.period_s = 2.0;
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let mut peer = Peer::attach(&running, 1 << 16).await.greet(1).await;
    let mut pulses = 70;
    let waiting = fly(&mut peer, &mut pulses, 0, |update| update.authority.you_are_in_charge).await;
    assert_eq!((exposing(&waiting), taken(&waiting)), (Some(ExposedBy::Trigger), 0), "what was sent before counts for nothing");
    assert_eq!(running.state.borrow().camera, CameraState::Waiting);

    let before = pulses;
    let triggered = fly(&mut peer, &mut pulses, 1, |update| taken(update) == 20).await;
    assert!((20..=21).contains(&(pulses - before)), "20 images of {} triggers", pulses - before);
    assert_eq!((exposing(&triggered), triggered.triggers.triggers_stayed_away.get()), (Some(ExposedBy::Trigger), 0));
    let image = triggered.image.get().unwrap();
    assert!(image.image_trigger_counter.get().is_some_and(|counter| counter.get() > before));
    assert_eq!(triggered.triggers.image_exposed_by.value(), Some(ExposedBy::Trigger));

    let alone =
        fly(&mut peer, &mut pulses, 0, |update| update.triggers.image_exposed_by.value() == Some(ExposedBy::Itself)).await;
    assert_eq!((exposing(&alone), alone.triggers.triggers_stayed_away.get()), (Some(ExposedBy::Itself), 1));
    let silent_s = *alone.triggers.last_triggered_age_s.get().unwrap();
    assert!((5.0..8.0).contains(&silent_s), "by itself after {silent_s} s");
    assert_eq!(alone.image.get().unwrap().image_trigger_counter.get(), None, "it belongs to no series of triggers");
    let (since, first) = (Instant::now(), taken(&alone));
    let later = fly(&mut peer, &mut pulses, 0, |update| taken(update) == first + 10).await;
    assert!(since.elapsed().abs_diff(Duration::from_secs(20)) < Duration::from_secs(3), "10 images in {:?}", since.elapsed());
    assert_eq!(later.triggers.triggers_stayed_away.get(), 1, "it is counted once");

    let back = fly(&mut peer, &mut pulses, 1, |update| exposing(update) == Some(ExposedBy::Trigger)).await;
    assert!(back.triggers.last_triggered_age_s.get().is_some_and(|age_s| *age_s < 1.0));
    let (first, before) = (taken(&back), pulses);
    let on = fly(&mut peer, &mut pulses, 1, |update| taken(update) >= first + 20).await;
    assert!((19..=21).contains(&(pulses - before)), "20 images of {} triggers", pulses - before);
    assert_eq!((exposing(&on), on.triggers.triggers_stayed_away.get()), (Some(ExposedBy::Trigger), 1));
}

#[tokio::test(start_paused = true)]
async fn a_camera_that_is_to_wait_for_ever_does_and_one_that_nobody_triggers_is_as_it_was() {
    for (trigger, by) in [(Trigger::Line0, ExposedBy::Trigger), (Trigger::Software, ExposedBy::Asked)] {
        let mut settings = settings();
        (settings.camera.trigger, settings.camera.trigger_timeout_s) = (trigger, 0.0);
        let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
        tokio::time::sleep(Duration::from_secs(30)).await;
        let state = running.state.borrow().clone();
        assert_eq!((state.triggers.exposing, state.triggers.stayed_away), (by, 0));
        let images = state.counters.frames_taken;
        assert_eq!(images > 100, trigger == Trigger::Software, "{images} images of {trigger:?}");
    }
}

/// Settings of a camera that gives series of three, kept in a directory.
fn series_of_three(trigger: Trigger, directory: &Path) -> Settings {
    let mut settings = settings();
    // It has its own line, as a real one.
    (settings.camera.kind, settings.camera.trigger, settings.camera.trigger_timeout_s) = (CameraKind::Aravis, trigger, 0.0);
    (settings.camera.series_exposures, settings.camera.series_s, settings.camera.period_s) = (3, 0.3, 0.1);
    (settings.record.enabled, settings.record.images, settings.record.reserve_gib) = (true, true, 0.0);
    settings.record.directory = directory.display().to_string();
    settings
}

/// A camera with a line of its own, on which so many pulses were sent by now.
fn on_line(pulses: &Arc<AtomicU32>) -> Option<MakeSource> {
    let (make, pulses) = (plain_camera()?, Arc::clone(pulses));
    Some(Arc::new(move || {
        let pulses = Arc::clone(&pulses);
        let told = Box::new(move || Some(LinePulses { boot: 1, count: pulses.load(Ordering::Relaxed) }));
        Ok(Box::new(SimulatedLine::new(make()?, told)) as Box<dyn Source>)
    }))
}

/// A solver that says how many exposures it had.
fn counts_exposures() -> MakeSolver {
    solver(|frame, _, _| Outcome::unsolved(frame.stamp.clone(), Reason::NoMatch, format!("{}", frame.stamp.exposures.max(1))))
}

/// What an image ended with.
async fn ended(running: &Running, image: u32) -> String {
    let mut state = running.state.clone();
    let of = |finished: &stars::service::Finished| finished.outcome.stamp.image.0 == image;
    let seen = state.wait_for(|state| state.latest.as_deref().is_some_and(of));
    let state = tokio::time::timeout(PATIENCE, seen).await.expect("it never ended").unwrap().clone();
    state.latest.as_ref().unwrap().outcome.detail.clone()
}

/// The exposures that were kept, by image and place.
fn kept(directory: &Path) -> Vec<(u32, Option<u8>)> {
    let entries = |directory: &Path| std::fs::read_dir(directory).into_iter().flatten().map(|entry| entry.unwrap().path());
    let files = entries(&directory.join("images")).flat_map(|day| entries(&day).collect::<Vec<_>>());
    let stamp = |file: std::path::PathBuf| read("kept", &std::fs::read(file).unwrap()).unwrap().stamp;
    let mut kept: Vec<_> = files.map(stamp).map(|stamp| (stamp.image.0, stamp.part)).collect();
    kept.sort_unstable();
    kept
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn triggers_within_the_time_of_a_series_make_one_image_and_a_command_sets_that_time() {
    let directory = tempfile::tempdir().unwrap();
    let pulses = Arc::new(AtomicU32::new(0));
    let trigger = |more: u32| pulses.fetch_add(more, Ordering::Relaxed);
    let pause = |ms: u64| tokio::time::sleep(Duration::from_millis(ms));
    let settings = series_of_three(Trigger::Line0, directory.path());
    let running = start(settings, Parts { camera: on_line(&pulses), solver: counts_exposures(), lens: None }).await;
    let mut ground = Ground::of(&running, 1, true);
    running.state.clone().wait_for(|state| state.camera == CameraState::Waiting).await.unwrap();
    trigger(3);
    assert_eq!(ended(&running, 0).await, "3");
    trigger(1);
    pause(50).await;
    trigger(1);
    assert_eq!(ended(&running, 1).await, "2", "no third came in time");
    trigger(1);
    pause(700).await;
    trigger(1);
    assert_eq!(ended(&running, 2).await, "1");
    assert_eq!(ended(&running, 3).await, "1", "the second came too late");
    let (_, reply) = ground.run("camera.set_series 9").await;
    assert_eq!(reply.stage.get(), Some(Stage::Completed), "{reply:?}");
    trigger(1);
    pause(700).await;
    trigger(3);
    assert_eq!(ended(&running, 4).await, "3", "what came after 0.7 s belongs to it now");
    // The last waits for others when the program ends.
    running.state.clone().wait_for(|state| state.counters.next_image.0 == 6).await.unwrap();
    running.stop().await;
    let of = |image: u32, exposures: u8| (0..exposures).map(move |place| (image, Some(place)));
    let wanted: Vec<_> = [(0, 3), (1, 2), (2, 1), (3, 1), (4, 3), (5, 1)].into_iter().flat_map(|(i, n)| of(i, n)).collect();
    assert_eq!(kept(directory.path()), wanted);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_camera_that_is_asked_makes_whole_series_and_what_breaks_off_is_an_image_of_what_came() {
    struct Breaks(u32);
    impl Source for Breaks {
        fn next(&mut self, _: &Moment) -> Result<Series, CameraError> {
            self.0 += 1;
            match self.0 {
                6 => Err(CameraError::Unavailable("it is away".to_owned())),
                11 => panic!("it breaks"),
                _ => Ok(frame().into()),
            }
        }
    }
    let directory = tempfile::tempdir().unwrap();
    let settings = series_of_three(Trigger::Software, directory.path());
    let camera: MakeSource = Arc::new(|| Ok(Box::new(Breaks(0)) as Box<dyn Source>));
    let seen = Arc::new(Mutex::new(Vec::new()));
    let notes = Arc::clone(&seen);
    let solver = solver(move |frame, _, _| {
        notes.lock().unwrap().push((frame.stamp.image.0, frame.stamp.exposures.max(1)));
        no_match(&frame.stamp)
    });
    let running = start(settings, Parts { camera: Some(camera), solver, lens: None }).await;
    running.state.clone().wait_for(|state| state.counters.next_image.0 >= 7).await.unwrap();
    running.stop().await;
    // Calls 1 to 3; 4 and 5, then it is away; 7 to 9; 10, then it breaks over image 4; 12 to 14.
    assert_eq!(seen.lock().unwrap().get(..5), Some([(0, 3), (1, 2), (2, 3), (3, 1), (5, 3)].as_slice()));
    let kept = kept(directory.path());
    let of = |image: u32| kept.iter().filter(|(of, _)| *of == image).map(|(_, place)| place.unwrap()).collect::<Vec<_>>();
    assert_eq!([1, 2, 3, 4].map(of), [vec![0, 1], vec![0, 1, 2], vec![0], vec![]]);
}
