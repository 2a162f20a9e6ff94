//! `stars soak` as a user runs it: a short flight under many faults.

use std::process::Command;

#[test]
fn half_an_hour_with_a_fault_every_ten_seconds_loses_nothing_and_says_how_to_fly_it_again() {
    let soak = ["soak", "--duration", "30m", "--every", "10s", "--seed", "3"];
    let output = Command::new(env!("CARGO_BIN_EXE_stars")).args(soak).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert!(said.contains("again: stars soak --seed 3 --duration 1800s --every 10s"), "{said}");
    assert!(said.matches("PASS").count() >= 7 && !said.contains("FAIL"), "{said}");
}
