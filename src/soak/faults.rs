//! What the faults of the schedule do: each to the part of the service, or of what surrounds it, that it concerns.

use super::account::Account;
use super::computer::{Connect, Handle};
use super::flight::{BALLAST, DISTURBED_AFTER, SENSOR, Soak, UNIX_S, show_sensor};
use super::schedule::{Class, Fault};
use crate::command::{Act, Command};
use crate::service::{Actor, Running, SimulatedUtc, State, Upset};
use crate::simulate::lens::FaultKind;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::watch;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep_until, timeout_at};

/// What is written at a time of the file that fills a disk, bytes.
const BALLAST_STEP: usize = 64 << 10;
/// By how much UTC jumps at most, s: thirty years.
const JUMP_S: f64 = 30.0 * 365.25 * 86_400.0;

impl Soak {
    /// The solver takes long over each step.
    fn crawl(&self, until: Instant, running: &Running, tasks: &mut JoinSet<()>) {
        self.faults.begin(Class::SolverCrawls, until);
        tasks.spawn(give_up(running.state.clone(), self.handles.clone(), self.account.clone(), until));
    }

    /// Begins a fault.
    pub(super) fn begin(&self, fault: &Fault, running: &Running, tasks: &mut JoinSet<()>) {
        let until = Instant::now() + fault.lasts;
        let of_lens = |kind| {
            self.lens.inject(kind, fault.lasts);
            self.handles.iter().for_each(|handle| handle.disturb(until + DISTURBED_AFTER));
        };
        let upset = |actor| {
            // By turns: the seed is as good as a draw.
            running.upset(
                actor,
                match fault.seed % 3 {
                    0 => Upset::Panics,
                    1 => Upset::Ends,
                    _ => Upset::Hangs,
                },
            );
            self.handles.iter().for_each(|handle| handle.disturb(until + DISTURBED_AFTER));
        };
        match fault.class {
            Class::LensLate => of_lens(FaultKind::Late),
            Class::LensGarbled => of_lens(FaultKind::Garbled),
            Class::LensError => of_lens(FaultKind::Error),
            Class::LensStalls => of_lens(FaultKind::Stall),
            Class::LensSilent => of_lens(FaultKind::Silent),
            Class::LensPowerCycle => of_lens(FaultKind::PowerCycle),
            Class::LensStuck => of_lens(FaultKind::StuckMotor),
            Class::LensSlips => of_lens(FaultKind::Slip),
            Class::LensCountsLost => of_lens(FaultKind::CountsLost),
            Class::LensCountsLostMoving => of_lens(FaultKind::CountsLostMoving),
            Class::LensVanishes => of_lens(FaultKind::Vanished),
            Class::CameraGone
            | Class::ImageUnreadable
            | Class::CameraPanics
            | Class::FalseSky
            | Class::SolverPanics
            | Class::SolverHangs
            | Class::SolverSlow => self.faults.begin(fault.class, until),
            Class::SolverCrawls => self.crawl(until, running, tasks),
            Class::RecordDiskDead => {
                self.account.disk_dies();
                drop(tasks.spawn(spoil(PathBuf::from(&self.settings.record.directory), until)));
            }
            Class::LedgerDiskDead => {
                self.handles.iter().for_each(|handle| handle.disturb(until + DISTURBED_AFTER));
                drop(tasks.spawn(spoil(PathBuf::from(&self.settings.commands.ledger_directory), until)));
            }
            Class::DiskFull => {
                self.account.disk_dies();
                self.handles.iter().for_each(|handle| handle.disturb(until + DISTURBED_AFTER));
                drop(tasks.spawn(fill(self.plan.directory.join(BALLAST), until)));
            }
            Class::SensorDead => drop(tasks.spawn(mislead(self.plan.directory.join(SENSOR), fault.seed, until))),
            Class::UtcJumps => {
                self.utc.into_iter().for_each(|utc| drop(tasks.spawn(jump(utc, fault.seed, until, self.began))));
            }
            Class::CameraActor => upset(Actor::Camera),
            Class::SolverActor => upset(Actor::Solver),
            Class::LensActor => upset(Actor::Lens),
            Class::HousekeepingActor => upset(Actor::Housekeeping),
            Class::ListenerActor => upset(Actor::Listener),
            Class::RecorderActor => upset(Actor::Recorder),
            Class::ArchiveActor => upset(Actor::Archive),
            Class::DisplayActor => upset(Actor::Display),
            Class::LedgerActor => upset(Actor::Ledger),
            Class::HubActor => upset(Actor::Hub),
            Class::Strangers => drop(tasks.spawn(strangers(self.connect(9), self.settings.network.max_connections, until))),
            _ => self.begin_at_computers(fault, until),
        }
    }

    /// Begins a fault of the flight computers.
    fn begin_at_computers(&self, fault: &Fault, until: Instant) {
        match fault.class {
            Class::BothClaim | Class::NeitherClaims | Class::ClaimFlickers => {
                for handle in &self.handles {
                    handle.begin(fault, until);
                    handle.disturb(until);
                }
            }
            class if Class::GYRO.contains(&class) => {
                // Of the one that is in charge; where the other one tells rates, it tells none.
                let of = |handle: &&Handle| handle.is_in_charge() || class == Class::StandByGyro;
                self.handles.iter().filter(of).for_each(|handle| handle.begin_quietly(fault));
            }
            _ => {
                self.handles.iter().for_each(|handle| handle.disturb(until));
                let stands_by = self.handles.iter().find(|handle| !handle.is_in_charge());
                let of = if fault.class == Class::StandByCommands { stands_by } else { self.handles.get(fault.computer) };
                if let Some(handle) = of {
                    handle.begin(fault, until);
                }
            }
        }
    }
}

/// The ground gives up every second frame that is being solved; the others grow too old.
async fn give_up(mut state: watch::Receiver<Arc<State>>, handles: [Handle; 2], account: Account, until: Instant) {
    let frames = async {
        let mut patient = true;
        while state.wait_for(|state| state.solving.is_some()).await.is_ok() {
            if let Some(handle) = handles.iter().find(|handle| handle.is_in_charge()).filter(|_| !patient) {
                let command = Command::AbortSolver {};
                account.give(&command);
                handle.give(Act::Run, command);
            }
            patient = !patient;
            if state.wait_for(|state| state.solving.is_none()).await.is_err() {
                break;
            }
        }
    };
    let _ = timeout_at(until, frames).await;
}

/// A directory that no file can be written in: another stands in its place.
async fn spoil(directory: PathBuf, until: Instant) {
    let aside = directory.with_extension("aside");
    let put = |from: &Path, to: &Path| std::fs::rename(from, to).is_ok();
    if !put(&directory, &aside) {
        return;
    }
    let _ = std::fs::write(&directory, "no directory");
    sleep_until(until).await;
    let _ = std::fs::remove_file(&directory);
    put(&aside, &directory);
}

/// A file takes all of the disk that is free.
async fn fill(ballast: PathBuf, until: Instant) {
    let path = ballast.clone();
    let filled = tokio::task::spawn_blocking(move || {
        // It ends where the disk does.
        let mut file = std::fs::File::create(path)?;
        loop {
            file.write_all(&[0; BALLAST_STEP])?;
        }
    });
    let _: Result<std::io::Result<()>, _> = filled.await;
    sleep_until(until).await;
    let _ = std::fs::remove_file(ballast);
}

/// A sensor's file goes, holds no number, or nothing at all, and comes back.
async fn mislead(sensor: PathBuf, seed: u64, until: Instant) {
    // The disk may be full: then the sensor shows nothing, which is as good.
    let _ = match seed % 3 {
        0 => std::fs::remove_file(&sensor),
        1 => std::fs::write(&sensor, "nan"),
        _ => std::fs::write(&sensor, ""),
    };
    sleep_until(until).await;
    show_sensor(&sensor).await;
}

/// UTC jumps, or is lost, and comes back.
async fn jump(utc: &'static SimulatedUtc, seed: u64, until: Instant, began: Instant) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    utc.set(if random.random_range(0..4) == 0 { None } else { Some(UNIX_S + random.random_range(-JUMP_S..JUMP_S)) });
    sleep_until(until).await;
    // Not what it was before, which another jump may have made.
    utc.set(Some(UNIX_S + began.elapsed().as_secs_f64()));
}

/// Strangers that take every place, and say nothing.
async fn strangers(connect: Connect, count: u32, until: Instant) {
    let mut lines = Vec::new();
    for _ in 0..count {
        lines.extend(connect().await);
    }
    sleep_until(until).await;
}
