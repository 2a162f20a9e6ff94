//! A camera that others trigger: an image for each trigger, by itself when none comes, and back when they return.

use crate::support::*;
use stars::image::ExposedBy;
use stars::service::{CameraState, Parts};
use stars::settings::Trigger;
use stars::wire::{Status, Update};
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
