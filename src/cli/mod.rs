//! The command line: one file per subcommand, no logic of its own.

use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Star camera flight software.
#[derive(Debug, Parser)]
#[command(name = "stars", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
enum Command {}

/// The work was done and the answer is negative.
pub const NEGATIVE: u8 = 1;
/// The call or a file is wrong.
pub const WRONG: u8 = 2;

/// Runs the program: 0 on success, 1 where the answer is negative, 2 where the call or a file is wrong.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    match run(cli.command) {
        Ok(code) => code,
        Err(error) => {
            eprintln!("stars: {error:#}");
            ExitCode::from(WRONG)
        }
    }
}

fn run(command: Command) -> anyhow::Result<ExitCode> {
    match command {}
}
