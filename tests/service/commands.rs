//! Commands from the flight computer's end: sent by the simulated one, seen to take effect, seen in the updates.

use crate::support::{PATIENCE, plain_camera, plain_solver, settings, start};
use stars::command::{Act, Command, Definition, Hazard, MAX_VALUES, Refusal, Stage};
use stars::lens::{Doubt, LensCommand, RequestCounter};
use stars::service::{LensHandle, Parts, Running, Seen, Sighting, SimulatedLens, fly};
use stars::settings::{LensKind, Settings};
use stars::simulate::FlightComputer;
use stars::simulate::lens::FaultKind;
use stars::wire::{CommandReply, Found, Update};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::timeout;

/// A flight computer in charge, and what it has seen.
pub struct Ground {
    orders: mpsc::Sender<(Act, Command)>,
    sightings: mpsc::Receiver<Sighting>,
    last: Option<Box<Update>>,
}

impl Ground {
    pub fn of(running: &Running, id: u8, in_charge: bool) -> Self {
        let mut computer = FlightComputer::new(id, 1000 + u32::from(id));
        computer.claims_charge = in_charge;
        Self::fly(running, computer)
    }

    fn fly(running: &Running, computer: FlightComputer) -> Self {
        let ((orders, ground), (sender, sightings)) = (mpsc::channel(64), mpsc::channel(256));
        tokio::spawn(fly(computer, running.address.to_string(), Duration::from_millis(100), ground, sender));
        Self { orders, sightings, last: None }
    }

    /// The next reply to a command of this computer.
    async fn reply(&mut self) -> CommandReply {
        loop {
            let sighting = timeout(PATIENCE, self.sightings.recv()).await.expect("no reply in time").unwrap();
            match sighting.seen {
                Seen::Reply(reply) => return *reply,
                Seen::Unanswered(given) => panic!("not answered: {given:?}"),
                Seen::Update(update) => self.last = Some(update),
                _ => {}
            }
        }
    }

    /// Gives a command and waits for its last reply.
    async fn give(&mut self, act: Act, text: &str) -> (Vec<Stage>, CommandReply) {
        let command = Command::parse(text).unwrap();
        self.orders.send((act, command)).await.unwrap();
        let mut stages = Vec::new();
        loop {
            let reply = self.reply().await;
            if reply.command != command.code() {
                continue;
            }
            let stage = reply.stage.get().unwrap();
            stages.push(stage);
            if stage.is_last() {
                return (stages, reply);
            }
        }
    }

    pub async fn run(&mut self, text: &str) -> (Vec<Stage>, CommandReply) {
        let (stages, reply) = self.give(Act::Run, text).await;
        if reply.why.value() != Some(Refusal::NotArmed) {
            return (stages, reply);
        }
        assert_eq!(self.give(Act::Arm, text).await.0, [Stage::Accepted, Stage::Completed], "arming {text}");
        self.give(Act::Fire, text).await
    }

    /// An update after now for which something holds.
    async fn update(&mut self, holds: impl Fn(&Update) -> bool) -> Box<Update> {
        loop {
            let sighting = timeout(PATIENCE, self.sightings.recv()).await.expect("no such update in time").unwrap();
            if let Seen::Update(update) = sighting.seen
                && holds(&update)
            {
                return update;
            }
        }
    }
}

/// A quick simulated lens, and a camera without stars.
fn lens_settings() -> Settings {
    let mut settings = settings();
    settings.lens.kind = LensKind::Simulated;
    settings.lens.simulated.speedup = 50.0;
    settings.lens.reply_timeout_s = 1.0;
    settings
}

async fn running() -> Running {
    start(lens_settings(), Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await
}

const DONE: [Stage; 3] = [Stage::Accepted, Stage::Started, Stage::Completed];

#[tokio::test(flavor = "multi_thread")]
async fn a_focus_command_moves_the_lens_and_every_stage_is_told_once() {
    let running = running().await;
    let mut ground = Ground::of(&running, 1, true);
    ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    let (stages, reply) = ground.run("lens.set_focus 3030").await;
    assert_eq!((stages, reply.words.to_string().as_str()), (DONE.to_vec(), "focus at 3030 counts"));
    // What was acknowledged is not repeated.
    let update = ground.update(|update| update.control.replies_count == 0).await;
    assert_eq!(update.camera.focus_counts.get().unwrap().get(), 3030);
    let lens = running.simulated_lens.as_ref().unwrap();
    assert!((lens.true_motor() - 3030.0).abs() < 4.0, "{}", lens.true_motor());
    assert_eq!(update.authority.commands_accepted.get(), 1);
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stand_by_computer_may_not_command_and_sees_the_others_replies() {
    let running = running().await;
    let mut one = Ground::of(&running, 1, true);
    let mut two = Ground::of(&running, 2, false);
    one.update(|update| update.authority.you_are_in_charge && update.camera.focus_counts.get().is_some()).await;
    one.run("lens.set_focus 2900").await;
    loop {
        let sighting = timeout(PATIENCE, two.sightings.recv()).await.unwrap().unwrap();
        if let Seen::Overheard(reply) = sighting.seen {
            assert_eq!(reply.flight_computer, 1);
            break;
        }
    }
    let (stages, reply) = two.give(Act::Run, "lens.stop").await;
    assert_eq!((stages, reply.why.value()), (vec![Stage::Rejected], Some(Refusal::NotInCharge)));
    let update = two.update(|update| update.authority.commands_refused.get() > 0).await;
    assert!(!update.authority.you_are_in_charge);
    assert_eq!(update.authority.in_charge_id.get(), Some(&1));
    assert_eq!(update.authority.last_refusal.value(), Some(Refusal::NotInCharge));
    assert_eq!(update.authority.commands_accepted.get(), 1);
    assert!(running.stop().await.is_empty());
}

/// Stops the lens, as an operator at its side would.
fn stop(lens: &LensHandle) {
    lens.request(RequestCounter(1 << 30), LensCommand::Stop).unwrap();
}

/// The least and the greatest values of a command, as they are written.
fn ends(definition: &Definition) -> Vec<String> {
    let of = |end: fn(&stars::command::Parameter) -> f64| {
        let mut values = [0.0; MAX_VALUES];
        values.iter_mut().zip(&definition.parameters).for_each(|(value, parameter)| *value = end(parameter));
        Command::from_wire(definition.code, &values).unwrap().to_string()
    };
    let mut ends = vec![of(|parameter| parameter.low), of(|parameter| parameter.high)];
    ends.dedup();
    ends
}

/// What a command may end with at the ends of its range here: done, or refused with a reason that fits what it asks for.
fn may_end_with(name: &str, reply: &CommandReply) -> bool {
    match (reply.stage.get().unwrap(), reply.why.value()) {
        (Stage::Completed, None) => true,
        // Beyond what this lens, or this camera's settings, can do.
        (Stage::Failed, Some(Refusal::OutOfRange)) => {
            [
                "lens.set_focus",
                "lens.move_focus",
                "lens.set_aperture",
                "focus.set_range",
                "solver.matching",
                "solver.mask",
                "solver.cells",
                "simulator.set_brightness",
            ]
            .contains(&name)
                || name.starts_with("requirements.")
        }
        // A camera without a gain, programs that are not set, a sweep without stars.
        (Stage::Failed, Some(Refusal::Device)) => name.starts_with("camera.") || name == "lens.set_aperture",
        (Stage::Failed, Some(Refusal::Program)) => ["service.shut_down", "service.reset_network"].contains(&name),
        (Stage::Failed, Some(Refusal::UnsafeState | Refusal::Stopped | Refusal::NoResult)) => name.starts_with("focus."),
        _ => false,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_command_is_taken_at_both_ends_of_its_range_and_ends_with_a_reason() {
    let mut settings = lens_settings();
    settings.network.update_period_s = 0.1;
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let mut ground = Ground::of(&running, 1, true);
    ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    let mut given = 0;
    for definition in Definition::all().iter().filter(|definition| definition.name != "service.quit") {
        for text in ends(definition) {
            let is_run = matches!(definition.name, "focus.run" | "focus.advise" | "focus.refocus");
            let reply = if is_run {
                // It would take minutes: it is stopped once it has begun.
                let command = Command::parse(&text).unwrap();
                for act in if definition.hazard == Hazard::Always { vec![Act::Arm, Act::Fire] } else { vec![Act::Run] } {
                    ground.orders.send((act, command)).await.unwrap();
                }
                loop {
                    let reply = ground.reply().await;
                    match reply.stage.get().unwrap() {
                        _ if reply.command != command.code() => {}
                        Stage::Started => ground.orders.send((Act::Run, Command::StopLens {})).await.unwrap(),
                        Stage::Completed if reply.words.to_string().starts_with("armed") => {}
                        stage if stage.is_last() => break reply,
                        _ => {}
                    }
                }
            } else {
                ground.run(&text).await.1
            };
            assert!(may_end_with(definition.name, &reply), "{text}: {reply:?}");
            given += 1;
        }
    }
    assert!(given > 60, "{given}");
    let (stages, _) = ground.run("service.quit").await;
    assert_eq!(stages, [Stage::Accepted, Stage::Completed]);
    assert!(running.state.borrow().ending.is_some());
    assert!(running.stop().await.is_empty());
}

/// A program that leaves a mark, and ends with a code.
fn program(room: &std::path::Path, name: &str, code: u8) -> String {
    let path = room.join(name);
    std::fs::write(&path, format!("#!/bin/sh\ntouch {}/{name}.ran\nexit {code}\n", room.display())).unwrap();
    std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    path.to_str().unwrap().to_owned()
}

#[tokio::test(flavor = "multi_thread")]
async fn shut_down_restart_and_network_reset_run_the_programs_of_the_settings() {
    let room = tempfile::tempdir().unwrap();
    let mut settings = settings();
    settings.commands.shut_down_program = program(room.path(), "off", 3);
    settings.commands.restart_program = program(room.path(), "restart", 0);
    settings.commands.network_reset_program = room.path().join("nowhere").to_str().unwrap().to_owned();
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let mut ground = Ground::of(&running, 1, true);
    assert_eq!(ground.run("service.shut_down 1").await.0, DONE);
    assert!(room.path().join("restart.ran").exists() && !room.path().join("off.ran").exists());
    let (_, failed) = ground.run("service.shut_down 0").await;
    assert_eq!(failed.why.value(), Some(Refusal::Program));
    assert!(failed.words.to_string().contains("exit status: 3") || failed.words.to_string().contains("off"), "{}", failed.words);
    let (_, missing) = ground.run("service.reset_network").await;
    assert_eq!((missing.stage.get(), missing.why.value()), (Some(Stage::Failed), Some(Refusal::Program)));
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_network_without_flight_computers_is_reset_again_and_again_but_not_while_one_is_heard() {
    let room = tempfile::tempdir().unwrap();
    let mut settings = settings();
    settings.commands.network_reset_program = program(room.path(), "reset", 0);
    settings.commands.network_lull_s = 2.0;
    let running = start(settings, Parts { camera: None, solver: plain_solver(), lens: None }).await;
    let mut state = running.state.clone();
    timeout(PATIENCE, state.wait_for(|state| state.network_resets >= 2)).await.expect("no reset").unwrap();
    timeout(PATIENCE, async {
        while !room.path().join("reset.ran").exists() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await
    .expect("the program did not run");
    let mut ground = Ground::of(&running, 1, false);
    ground.update(|_| true).await;
    let before = running.state.borrow().network_resets;
    ground.update(|update| update.link.statuses_received.get() >= 8).await;
    assert!(running.state.borrow().network_resets <= before + 1, "reset while a computer is heard");
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn known_good_leads_back_to_the_settings_of_the_start_with_the_lens_at_rest() {
    let running = running().await;
    let initial = running.state.borrow().settings.clone();
    let mut ground = Ground::of(&running, 1, true);
    ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    for text in ["solver.configure 0 7.5", "requirements.elevation 1 -5 60", "solver.mask 1 1 2 3"] {
        assert_eq!(ground.run(text).await.0, [Stage::Accepted, Stage::Completed], "{text}");
    }
    let update = ground.update(|update| update.control.settings_commanded.get() >= 5).await;
    assert!(!running.state.borrow().settings.solver.enabled);
    assert_ne!(update.link.settings_hash.get(), initial.fingerprint() as u32);
    for act in [Act::Arm, Act::Fire] {
        ground.orders.send((act, Command::parse("focus.run").unwrap())).await.unwrap();
    }
    ground.update(|update| update.focus.autofocus_mode.get() == Some(stars::lens::autofocus::Mode::Running)).await;
    // The simulated computer gives one command at a time: another one in charge would not wait either. The run ends by the lens.
    stop(&running.lens);
    assert_eq!(ground.run("service.known_good").await.1.stage.get(), Some(Stage::Completed));
    let update = ground.update(|update| update.control.settings_commanded.get() == 0).await;
    assert_eq!(update.link.settings_hash.get(), initial.fingerprint() as u32);
    assert_eq!(running.state.borrow().settings, initial);
    assert!(!update.lens.lens_moving && update.lens.lens_stopped);
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn known_good_ends_the_autofocus_and_waits_for_a_move_that_has_begun() {
    let mut settings = lens_settings();
    settings.lens.simulated.speedup = 1.0;
    settings.lens.simulated.speed_counts_s = 100.0;
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let mut ground = Ground::of(&running, 1, true);
    ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    // The first move of the sweep takes seconds.
    for act in [Act::Arm, Act::Fire] {
        ground.orders.send((act, Command::parse("focus.run").unwrap())).await.unwrap();
    }
    ground.update(|update| update.lens.lens_moving).await;
    ground.orders.send((Act::Run, Command::parse("service.known_good").unwrap())).await.unwrap();
    let (mut sweep, mut rest) = (None, None);
    while sweep.is_none() || rest.is_none() {
        let reply = ground.reply().await;
        let stage = reply.stage.get().unwrap();
        match reply.command {
            40 if stage.is_last() && reply.why.value().is_some() => sweep = Some(reply),
            6 if stage.is_last() => {
                let lens = std::sync::Arc::clone(&running.state.borrow().lens);
                assert!(!lens.focus.is_moving(), "at rest, it is said, and it moves");
                rest = Some(stage);
            }
            _ => {}
        }
    }
    assert_eq!(sweep.unwrap().why.value(), Some(Refusal::Stopped));
    assert_eq!(rest, Some(Stage::Completed));
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn what_ran_before_a_restart_of_the_camera_does_not_run_after_it() {
    let room = tempfile::tempdir().unwrap();
    let settings = || {
        let mut settings = lens_settings();
        settings.commands.ledger_directory = room.path().to_str().unwrap().to_owned();
        settings
    };
    let parts = || Parts { camera: plain_camera(), solver: plain_solver(), lens: None };
    let first = start(settings(), parts()).await;
    let mut ground = Ground::of(&first, 1, true);
    let update = ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    assert!(update.control.counters_kept);
    assert_eq!(ground.run("lens.set_focus 3030").await.0, DONE);
    drop(ground);
    assert!(first.stop().await.is_empty());
    // The same boot of the computer, whose memory of counters was lost: its first command has a counter that was there before.
    let second = start(settings(), parts()).await;
    let mut ground = Ground::of(&second, 1, true);
    ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    let (stages, reply) = ground.give(Act::Run, "lens.set_focus 3040").await;
    assert_eq!((stages, reply.why.value()), (vec![Stage::Rejected], Some(Refusal::HalfChanged)));
    assert_eq!(ground.run("lens.set_focus 3050").await.0, DONE, "the next counter is new");
    assert!(second.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn commanded_settings_the_last_lease_and_the_focus_outlast_a_restart_and_a_lens_that_lost_its_counts_meanwhile_is_found_out()
 {
    let room = tempfile::tempdir().unwrap();
    let settings = || {
        let mut settings = lens_settings();
        settings.lens.relearn = false;
        settings.lens.init_on_startup = false;
        settings.commands.ledger_directory = room.path().to_str().unwrap().to_owned();
        settings
    };
    let lens = SimulatedLens::new(&settings().lens, 1).unwrap();
    let begin = || start(settings(), Parts { camera: plain_camera(), solver: plain_solver(), lens: Some(lens.clone()) });

    let running = begin().await;
    let mut ground = Ground::of(&running, 1, true);
    ground.update(|update| update.lens.lens_connected).await;
    assert_eq!(ground.run("lens.init_focus").await.0, DONE);
    assert_eq!(ground.run("lens.set_focus 3030").await.0, DONE);
    assert_eq!(ground.run("solver.configure 0 7.5").await.0, [Stage::Accepted, Stage::Completed]);
    assert_eq!(ground.run("solver.configure 0 8.5").await.0, [Stage::Accepted, Stage::Completed]);
    let before = ground.update(|update| update.control.settings_commanded.get() == 2).await;
    assert_eq!(before.health.kept_at_start.get(), Some(Found::Nothing));
    drop(ground);
    assert!(running.stop().await.is_empty());

    let running = begin().await;
    assert_eq!(running.state.borrow().settings.solver.timeout_s, 8.5);
    let mut ground = Ground::of(&running, 1, true);
    let after = ground.update(|update| update.camera.focus_counts.get().is_some() && update.authority.you_are_in_charge).await;
    assert_eq!(after.camera.focus_counts.get().unwrap().get(), 3030);
    assert_eq!(after.health.kept_at_start.get(), Some(Found::Whole));
    assert_eq!(after.control.settings_commanded.get(), 2);
    assert!(after.control.lease_epoch.get().unwrap().get() > before.control.lease_epoch.get().unwrap().get());
    drop(ground);
    assert!(running.stop().await.is_empty());

    // While nobody looks, the motor turns by what nobody counted.
    lens.inject(FaultKind::CountsLost, Duration::from_secs(1));
    std::fs::write(room.path().join("kept.0"), "damaged").unwrap();
    let running = begin().await;
    let mut ground = Ground::of(&running, 1, true);
    let found = ground.update(|update| update.lens.lens_connected && update.lens.focus_doubt.value().is_some()).await;
    assert_eq!(found.health.kept_at_start.get(), Some(Found::OneCopy));
    ground.update(|update| update.lens.focus_doubt.value() == Some(Doubt::CountsLost)).await;
    assert_eq!(ground.run("service.factory_reset").await.0, [Stage::Accepted, Stage::Completed]);
    drop(ground);
    assert!(running.stop().await.is_empty());

    let running = begin().await;
    assert_eq!(running.state.borrow().settings_commanded, 0);
    assert_eq!(running.state.borrow().found, Found::Whole, "a damaged copy is whole again after the next write");
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_disk_that_is_dead_at_the_start_keeps_commands_from_running_and_is_used_once_it_is_back() {
    let room = tempfile::tempdir().unwrap();
    let directory = room.path().join("state");
    std::fs::write(&directory, "a file in its place").unwrap();
    let mut settings = lens_settings();
    settings.commands.ledger_directory = directory.to_str().unwrap().to_owned();
    let running = start(settings, Parts { camera: plain_camera(), solver: plain_solver(), lens: None }).await;
    let mut ground = Ground::of(&running, 1, true);
    let update = ground.update(|update| update.camera.focus_counts.get().is_some()).await;
    assert_eq!(update.health.kept_at_start.get(), Some(Found::Damaged));
    let (_, reply) = ground.run("lens.set_focus 3030").await;
    assert_eq!((reply.stage.get(), reply.why.value()), (Some(Stage::Failed), Some(Refusal::NotKept)));
    assert!(reply.words.to_string().contains("state"), "{}", reply.words);
    assert_eq!(ground.run("lens.stop").await.1.stage.get(), Some(Stage::Completed), "what only stops things does not wait");
    std::fs::remove_file(&directory).unwrap();
    assert_eq!(ground.run("lens.set_focus 3040").await.0, DONE);
    assert!(running.stop().await.is_empty());
}
