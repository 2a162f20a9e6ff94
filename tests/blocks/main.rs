//! Command blocks with right framing and checksum that break a guard: none runs, and each honest one runs exactly once. The long form
//! is `scripts/prove blocks`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a test may fail by panicking"
)]

mod native;

#[test]
fn no_broken_native_block_runs_and_each_honest_one_runs_once() {
    let tally = native::send(100_000, 100, 1);
    assert!(tally.ran.is_empty(), "{}", tally.ran[0]);
    assert!(tally.honest > 500 && tally.honest == tally.honest_once, "{} of {}", tally.honest_once, tally.honest);
    assert_eq!(tally.broken.len(), 14);
    assert!(tally.refused.len() >= 8, "{:?}", tally.refused);
}
