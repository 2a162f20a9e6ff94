//! `stars soak` as a user runs it: a short flight under many faults.

#![allow(clippy::unwrap_used, reason = "this is a test")]

use stars::journal::{Reader, What, Writer};
use std::path::Path;
use std::process::Command;

#[test]
fn half_an_hour_with_a_fault_every_ten_seconds_loses_nothing_and_says_how_to_fly_it_again() {
    let directory = tempfile::tempdir().unwrap();
    let soak = ["soak", "--duration", "30m", "--every", "10s", "--seed", "4", "--directory"];
    let output = Command::new(env!("CARGO_BIN_EXE_stars")).args(soak).arg(directory.path()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("again: stars soak --seed 4 --duration 1800s --every 10s"), "{said}");
    assert!(said.matches("PASS").count() >= 7 && !said.contains("FAIL"), "{said}");
    let (said, differs) = replay(directory.path(), &[]);
    assert!(said.ends_with("identical\n") && !differs, "{said}");
    for wanted in [" timed_out", " aborted", " solved"] {
        assert!(said.contains(wanted), "{said}");
    }
    assert!(["desk: ", "guard: ", "in charge: ", "lens: "].iter().all(|machine| count(&said, machine) > 50), "{said}");
    assert!(count(&said, "frames: ") > 20 && count(&said, "priors: ") > 5, "{said}");
    // Other settings give other outcomes, and that is no failure.
    let (said, differs) = replay(directory.path(), &["--set", "solver.enabled=false", "--last", "3"]);
    assert!(said.contains("would have been disabled") && !differs, "{said}");
    // What was changed in it since does not come out the same.
    let journal = std::fs::read_dir(directory.path().join("record")).unwrap().map(|file| file.unwrap().path());
    let journal =
        journal.filter(|path| path.extension().is_some_and(|e| e == "journal")).max_by_key(|path| path.metadata().unwrap().len());
    let journal = journal.unwrap();
    let mut writer = Writer::default();
    for mut entry in Reader::new(&std::fs::read(&journal).unwrap()) {
        if let What::Charge { led_to, .. } = &mut entry.what {
            *led_to ^= 1;
        }
        writer.add(&entry);
    }
    std::fs::write(&journal, writer.take()).unwrap();
    let (said, differs) = replay(directory.path(), &["--image", "1"]);
    assert!(differs && said.contains("first difference: in charge at "), "{said}");
}

/// What `stars replay` says of a soak's journals, and whether something came out otherwise.
fn replay(directory: &Path, arguments: &[&str]) -> (String, bool) {
    let mut stars = Command::new(env!("CARGO_BIN_EXE_stars"));
    let output = stars.arg("replay").arg(directory.join("record")).args(arguments).output().unwrap();
    let said = format!("{}{}", String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout));
    assert!(matches!(output.status.code(), Some(0 | 1)), "{said}");
    (said, output.status.code() == Some(1))
}

/// The number after a word.
fn count(said: &str, word: &str) -> u32 {
    let line = said.lines().find_map(|line| line.strip_prefix(word)).unwrap_or_default();
    line.split(' ').next().and_then(|number| number.parse().ok()).unwrap_or_default()
}
