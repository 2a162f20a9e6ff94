//! Many command blocks that break a guard: `cargo bench --bench blocks -- --blocks 10000000`. What ran, and what it took.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a bench may end where it stands"
)]

#[path = "../tests/blocks/native.rs"]
mod native;

use clap::Parser;
use std::process::ExitCode;

#[derive(Parser)]
struct Args {
    /// Broken blocks
    #[arg(long, default_value_t = 10_000_000)]
    blocks: u64,
    /// One honest block for so many broken ones
    #[arg(long, default_value_t = 100)]
    every: u32,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

fn main() -> ExitCode {
    let args = Args::parse();
    let tally = native::send(args.blocks, args.every, args.seed);
    let given: u64 = tally.broken.values().sum();
    println!("native: {given} broken blocks, of which ran: wanted 0, got {}", tally.ran.len());
    tally.ran.iter().take(5).for_each(|line| println!("  {line}"));
    println!("native: honest blocks that ran exactly once: wanted {}, got {}", tally.honest, tally.honest_once);
    println!("native: reasons given: {:?}", tally.refused);
    let pass = tally.ran.is_empty() && tally.honest == tally.honest_once;
    println!("{}", if pass { "PASS" } else { "FAIL" });
    ExitCode::from(u8::from(!pass))
}
