//! The runs of the service: their number, and how the last one ended, from a mark that each leaves on disk.

use super::twin::Twin;
use crate::wire::LastEnd;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::Path;

/// Name of the files of the runs.
pub const NAME: &str = "runs";
/// Where Linux tells one start of the machine from another.
const MACHINE_BOOT: &str = "/proc/sys/kernel/random/boot_id";

/// Which run this is, and how the one before it ended.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Run {
    /// Counts from 1; `None` where nothing is kept.
    pub number: Option<u32>,
    /// `None` for the first, and where nothing is kept.
    pub last_end: Option<LastEnd>,
}

/// What a run leaves on disk.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Mark {
    run: u32,
    /// Which start of the machine it ran under; empty where that is not known.
    machine: String,
    /// How it ended. It is written as still running, so that nothing needs to be done when it breaks off.
    ended: Option<Asked>,
}

/// Who asked a run to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Asked {
    /// The machine or a person at it.
    Here,
    /// A command.
    Commanded,
}

/// The mark of this run.
#[derive(Debug)]
pub struct Runs {
    twin: Twin<Mark>,
    mark: Mark,
}

impl Runs {
    /// Begins a run in a directory; a complaint says what of it is damaged or cannot be written.
    pub fn begin(directory: &Path) -> (Self, Run, Vec<String>) {
        let machine = std::fs::read_to_string(MACHINE_BOOT).unwrap_or_default();
        Self::begin_on(directory, machine.trim())
    }

    fn begin_on(directory: &Path, machine: &str) -> (Self, Run, Vec<String>) {
        let (mut twin, last, mut complaints) = Twin::<Mark>::open(directory, NAME);
        let last_end = last.as_ref().map(|mark| match mark.ended {
            Some(Asked::Here) => LastEnd::Clean,
            Some(Asked::Commanded) => LastEnd::Commanded,
            None if mark.machine == machine => LastEnd::Crashed,
            None => LastEnd::ComputerRestarted,
        });
        let run = last.map_or(0, |mark| mark.run).saturating_add(1);
        let mark = Mark { run, machine: machine.to_owned(), ended: None };
        if let Err(error) = twin.write(&mark) {
            complaints.push(format!("{}: {error}", directory.display()));
        }
        (Self { twin, mark }, Run { number: Some(run), last_end }, complaints)
    }

    /// Notes that this run ends as it was asked to.
    ///
    /// # Errors
    /// As the disk says.
    pub fn end(mut self, asked: Asked) -> io::Result<()> {
        self.mark.ended = Some(asked);
        self.twin.write(&self.mark)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_run_has_the_next_number_and_knows_how_the_last_one_ended() {
        let directory = tempfile::tempdir().unwrap();
        let begin = |machine| {
            let (runs, run, complaints) = Runs::begin_on(directory.path(), machine);
            assert!(complaints.is_empty(), "{complaints:?}");
            (runs, (run.number.unwrap(), run.last_end))
        };
        let (runs, first) = begin("a");
        assert_eq!(first, (1, None));
        runs.end(Asked::Here).unwrap();
        let (runs, second) = begin("a");
        assert_eq!(second, (2, Some(LastEnd::Clean)));
        runs.end(Asked::Commanded).unwrap();
        // A clean end counts even where the machine was started anew since.
        let (runs, third) = begin("b");
        assert_eq!(third, (3, Some(LastEnd::Commanded)));
        drop(runs);
        let (runs, fourth) = begin("b");
        assert_eq!(fourth, (4, Some(LastEnd::Crashed)));
        drop(runs);
        assert_eq!(begin("c").1, (5, Some(LastEnd::ComputerRestarted)));
    }

    #[test]
    fn a_torn_mark_is_complained_about_and_counting_goes_on() {
        let directory = tempfile::tempdir().unwrap();
        for _ in 0..3 {
            Runs::begin_on(directory.path(), "a");
        }
        std::fs::write(directory.path().join("runs.1"), "torn").unwrap();
        let (_, run, complaints) = Runs::begin_on(directory.path(), "a");
        assert_eq!((run.number, complaints.len()), (Some(4), 1), "{complaints:?}");
    }
}
