//! Promises of the housekeeping: values come with their age and leave when their sensor does; restarts and ends have reasons.

use crate::support::*;
use stars::service::{MakeSource, Parts};
use stars::settings::{CameraKind, SensorSource};
use stars::wire::{Actor, LastEnd};
use std::sync::Arc;

#[tokio::test]
async fn an_update_carries_a_value_from_a_file_and_loses_it_when_the_file_goes_away() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("temp");
    std::fs::write(&file, "85250\n").unwrap();
    let mut settings = settings();
    settings.camera.kind = CameraKind::None;
    settings.network.update_period_s = 0.1;
    let house = &mut settings.housekeeping;
    (house.period_s, house.max_age_s) = (0.05, 1.0);
    house.temperature_computer.source = SensorSource::parse(&format!("file:{} *0.001", file.display())).unwrap();
    house.pressure.source = SensorSource::parse("command:/no/such/program").unwrap();
    let running = start_without_camera(settings).await;
    let mut peer = Peer::connect(running.address).await.greet(1).await;
    let seen = peer.update_where(|update| update.housekeeping.temperature_computer_c.get().is_some()).await;
    assert_eq!(seen.housekeeping.temperature_computer_c.get(), Some(&85.25));
    assert!(seen.health.temperature_computer_alarm, "it is above its limit");
    assert!(!seen.health.simulated_housekeeping, "nothing is made up");
    assert!(seen.housekeeping.pressure_atm.get().is_none() && seen.health.pressure_age_s.get().is_none());
    assert!(seen.housekeeping.temperature_lens_c.get().is_none(), "there is no such sensor");
    let disk = peer.update_where(|update| update.housekeeping.disk_free_gib.get().is_some()).await;
    assert!(*disk.housekeeping.disk_free_gib.get().unwrap() > 0.0 && disk.health.disk_free_age_s.get().is_some());

    std::fs::remove_file(&file).unwrap();
    let gone = peer.update_where(|update| update.housekeeping.temperature_computer_c.get().is_none()).await;
    assert!(*gone.health.temperature_computer_age_s.get().unwrap() >= 1.0, "its age goes on");
    assert!(!gone.health.temperature_computer_alarm);
    assert!(gone.housekeeping.disk_free_gib.get().is_some(), "the other sensors go on");

    std::fs::write(&file, "20000").unwrap();
    let back = peer.update_where(|update| update.housekeeping.temperature_computer_c.get().is_some()).await;
    assert_eq!(back.housekeeping.temperature_computer_c.get(), Some(&20.0));
    assert!(!back.health.temperature_computer_alarm);
    assert_eq!(running.stop().await, Vec::<&str>::new());
}

#[tokio::test]
async fn a_made_up_value_says_so() {
    let running = start_without_camera(settings()).await;
    let mut peer = Peer::connect(running.address).await.greet(1).await;
    let seen = peer.update_where(|update| update.housekeeping.pressure_atm.get().is_some()).await;
    assert!(seen.health.simulated_housekeeping);
}

#[tokio::test]
async fn a_restart_is_told_with_its_part_and_its_reason() {
    let fragile: MakeSource = Arc::new(|| panic!("the driver breaks"));
    let running = start(settings(), Parts { camera: Some(fragile), solver: plain_solver(), lens: None }).await;
    let mut peer = Peer::connect(running.address).await.greet(1).await;
    let seen = peer.update_where(|update| update.health.last_restart.get().is_some()).await;
    assert_eq!(seen.health.last_restart.value(), Some(Actor::Camera));
    assert!(seen.counters.restarts_camera.get() > 0);
    let reason = seen.health.last_restart_reason.to_string();
    assert!(reason.contains("the driver breaks"), "{reason}");
    assert!(*seen.health.last_restart_age_s.get().unwrap() < PATIENCE.as_secs_f64());
}

#[tokio::test]
async fn runs_are_counted_and_each_knows_how_the_last_one_ended() {
    let directory = tempfile::tempdir().unwrap();
    let mut settings = settings();
    settings.commands.ledger_directory = directory.path().join("made").display().to_string();
    let mut runs = Vec::new();
    for clean in [true, false, true] {
        let running = start_without_camera(settings.clone()).await;
        let mut peer = Peer::connect(running.address).await.greet(1).await;
        let health = peer.update().await.health;
        runs.push((health.run_number.get().unwrap().get(), health.last_end.value()));
        if clean {
            assert_eq!(running.stop().await, Vec::<&str>::new());
        } else {
            drop(running);
        }
    }
    assert_eq!(runs, [(1, None), (2, Some(LastEnd::Clean)), (3, Some(LastEnd::Crashed))]);
}
