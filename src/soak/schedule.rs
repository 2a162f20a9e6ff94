//! The schedule: which fault begins when, and how long it lasts.

use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// What goes wrong: the failures of field reports on flights like this one, as far as software can show them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Class {
    /// A flight computer dies and starts anew, its counters lost.
    ComputerReboots,
    /// It neither reads nor sends for a while.
    ComputerStalls,
    /// Its connection is cut.
    LinkCut,
    /// It reads slowly.
    LinkSlow,
    /// It sends nothing, and holds its connection.
    ComputerSilent,
    /// Both claim to be in charge.
    BothClaim,
    /// Neither does.
    NeitherClaims,
    /// Claims come and go.
    ClaimFlickers,
    /// A block of zeros where commands should be.
    ZeroedBlock,
    /// Every counter has jumped, with nothing that the ground gave.
    CountersJumped,
    /// Values changed under a counter that did not.
    HalfChanged,
    /// A counter changed under values that did not.
    CounterAlone,
    /// A block of long ago comes again.
    BlockReplayed,
    /// A command that the ground gave too long ago.
    StaleCommand,
    /// The computer that is not in charge commands.
    StandByCommands,
    /// Its uptime runs backwards.
    UptimeBackwards,
    /// Latitude, sidereal time and estimates are wrong.
    WrongPointing,
    /// It knows neither where it is nor where it points.
    NoPointing,
    /// Its clock is set to 1970.
    ComputerClock,
    /// It speaks a version that nobody knows.
    WrongVersion,
    /// A message breaks off, and the connection with it.
    TornMessage,
    /// Bytes without sense.
    Garbage,
    /// Hundreds of messages at once.
    Flood,
    /// Strangers take every place and say nothing.
    Strangers,
    /// Gyro rates of a series come when its image has ended.
    GyroLate,
    /// They do not come.
    GyroMissing,
    /// They name another image, or another series of triggers.
    GyroOfAnother,
    /// One of them is no number.
    GyroNotFinite,
    /// They are wrong by far.
    GyroWrong,
    /// The computer that is not in charge sends them, and the other one none.
    StandByGyro,
    /// The camera gives nothing.
    CameraGone,
    /// An image that cannot be read.
    ImageUnreadable,
    /// The camera's driver breaks.
    CameraPanics,
    /// A sky full of what is no star.
    FalseSky,
    /// The solver breaks.
    SolverPanics,
    /// It does not stop when told.
    SolverHangs,
    /// It takes seconds.
    SolverSlow,
    /// It takes so long over each step that its frames grow too old, or are given up by command.
    SolverCrawls,
    /// Lens replies come too late.
    LensLate,
    /// They are garbled.
    LensGarbled,
    /// The lens refuses every word.
    LensError,
    /// It takes words, and does them later.
    LensStalls,
    /// It says nothing.
    LensSilent,
    /// Its power is cut.
    LensPowerCycle,
    /// Its motor is stuck.
    LensStuck,
    /// Its motor slips.
    LensSlips,
    /// Its count jumps.
    LensCountsLost,
    /// Its count jumps as it moves.
    LensCountsLostMoving,
    /// Its port vanishes.
    LensVanishes,
    /// The disk for outcomes refuses.
    RecordDiskDead,
    /// The disk for what outlasts a restart refuses.
    LedgerDiskDead,
    /// The disk is full.
    DiskFull,
    /// A sensor gives nonsense, or nothing.
    SensorDead,
    /// UTC jumps by years, or is lost.
    UtcJumps,
    /// The camera's actor panics, ends or hangs; so do the others.
    CameraActor,
    /// See there.
    SolverActor,
    /// See there.
    LensActor,
    /// See there.
    HousekeepingActor,
    /// See there.
    ListenerActor,
    /// See there.
    RecorderActor,
    /// See there.
    ArchiveActor,
    /// See there.
    DisplayActor,
    /// See there.
    LedgerActor,
    /// See there.
    HubActor,
    /// The service ends, and is started again.
    ServiceRestarts,
}

impl Class {
    /// Every class.
    pub const ALL: [Self; 65] = [
        Self::ComputerReboots,
        Self::ComputerStalls,
        Self::LinkCut,
        Self::LinkSlow,
        Self::ComputerSilent,
        Self::BothClaim,
        Self::NeitherClaims,
        Self::ClaimFlickers,
        Self::ZeroedBlock,
        Self::CountersJumped,
        Self::HalfChanged,
        Self::CounterAlone,
        Self::BlockReplayed,
        Self::StaleCommand,
        Self::StandByCommands,
        Self::UptimeBackwards,
        Self::WrongPointing,
        Self::NoPointing,
        Self::ComputerClock,
        Self::WrongVersion,
        Self::TornMessage,
        Self::Garbage,
        Self::Flood,
        Self::Strangers,
        Self::GyroLate,
        Self::GyroMissing,
        Self::GyroOfAnother,
        Self::GyroNotFinite,
        Self::GyroWrong,
        Self::StandByGyro,
        Self::CameraGone,
        Self::ImageUnreadable,
        Self::CameraPanics,
        Self::FalseSky,
        Self::SolverPanics,
        Self::SolverHangs,
        Self::SolverSlow,
        Self::SolverCrawls,
        Self::LensLate,
        Self::LensGarbled,
        Self::LensError,
        Self::LensStalls,
        Self::LensSilent,
        Self::LensPowerCycle,
        Self::LensStuck,
        Self::LensSlips,
        Self::LensCountsLost,
        Self::LensCountsLostMoving,
        Self::LensVanishes,
        Self::RecordDiskDead,
        Self::LedgerDiskDead,
        Self::DiskFull,
        Self::SensorDead,
        Self::UtcJumps,
        Self::CameraActor,
        Self::SolverActor,
        Self::LensActor,
        Self::HousekeepingActor,
        Self::ListenerActor,
        Self::RecorderActor,
        Self::ArchiveActor,
        Self::DisplayActor,
        Self::LedgerActor,
        Self::HubActor,
        Self::ServiceRestarts,
    ];

    /// What can be wrong with the gyro rates of the computer in charge: it strikes at the next series.
    pub const GYRO: [Self; 6] =
        [Self::GyroLate, Self::GyroMissing, Self::GyroOfAnother, Self::GyroNotFinite, Self::GyroWrong, Self::StandByGyro];

    /// Its name in the report, in words.
    pub fn name(self) -> String {
        let debug = format!("{self:?}");
        let mut name = String::new();
        for (place, letter) in debug.chars().enumerate() {
            if letter.is_uppercase() && place > 0 {
                name.push(' ');
            }
            name.extend(letter.to_lowercase());
        }
        name
    }

    /// Shortest and longest that it lasts, s.
    fn lasts_s(self) -> (f64, f64) {
        match self {
            Self::ComputerReboots => (5.0, 60.0),
            Self::ComputerStalls | Self::LinkSlow | Self::ComputerSilent => (1.0, 30.0),
            Self::LinkCut => (0.2, 9.0),
            Self::BothClaim | Self::NeitherClaims | Self::ClaimFlickers => (3.0, 60.0),
            Self::WrongPointing | Self::NoPointing | Self::ComputerClock | Self::FalseSky | Self::UtcJumps => (20.0, 300.0),
            Self::CameraGone | Self::RecordDiskDead | Self::LedgerDiskDead | Self::DiskFull | Self::SensorDead => (5.0, 120.0),
            Self::ImageUnreadable | Self::CameraPanics | Self::SolverPanics | Self::SolverHangs | Self::SolverSlow => {
                (40.0, 120.0)
            }
            // Two frames at least.
            Self::SolverCrawls => (80.0, 160.0),
            Self::LensLate | Self::LensGarbled | Self::LensError | Self::LensStalls | Self::LensSilent => (1.0, 60.0),
            Self::LensPowerCycle | Self::LensStuck | Self::LensSlips | Self::LensVanishes => (1.0, 60.0),
            Self::LensCountsLost | Self::LensCountsLostMoving => (1.0, 10.0),
            Self::Strangers => (1.0, 20.0),
            _ => (0.0, 0.0),
        }
    }
}

/// A fault with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// When it begins, time since the start.
    pub at: Duration,
    /// How long it lasts.
    pub lasts: Duration,
    /// What.
    pub class: Class,
    /// Which flight computer, 0 or 1, where it concerns one.
    pub computer: usize,
    /// A number of its own, for whatever else is to be drawn.
    pub seed: u64,
}

/// Faults of these classes over a time, one in `every` on average at moments that follow no rhythm. Every class comes as often as every
/// other, but for one.
pub fn schedule(seed: u64, duration: Duration, every: Duration, classes: &[Class]) -> Vec<Fault> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (mut faults, mut hat): (Vec<Fault>, Vec<Class>) = (Vec::new(), Vec::new());
    let mut at = Duration::ZERO;
    loop {
        let uniform: f64 = random.random_range(f64::EPSILON..1.0);
        at += every.mul_f64(-uniform.ln());
        if at >= duration {
            return faults;
        }
        if hat.is_empty() {
            hat.extend(classes);
            hat.shuffle(&mut random);
        }
        let Some(class) = hat.pop() else { return faults };
        let (shortest, longest) = class.lasts_s();
        let lasts = Duration::from_secs_f64(random.random_range(shortest..=longest));
        faults.push(Fault { at, lasts, class, computer: random.random_range(0..2), seed: random.random() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn a_seed_names_the_same_faults_and_each_class_comes_as_often_as_every_other() {
        let days = Duration::from_secs(11 * 86_400);
        let flown = |seed| schedule(seed, days, Duration::from_secs(60), &Class::ALL);
        let faults = flown(7);
        assert_eq!(faults, flown(7));
        assert_ne!(faults, flown(8));
        assert!((15_400..16_300).contains(&faults.len()), "{}", faults.len());
        let mut counts = BTreeMap::new();
        for fault in &faults {
            *counts.entry(fault.class).or_insert(0_u32) += 1;
            assert!(fault.at < days);
        }
        let (least, most) = (counts.values().min().unwrap(), counts.values().max().unwrap());
        assert_eq!(counts.len(), Class::ALL.len());
        assert!(most - least <= 1 && *least >= 236, "{counts:?}");
        assert_eq!(Class::LensPowerCycle.name(), "lens power cycle");
    }
}
