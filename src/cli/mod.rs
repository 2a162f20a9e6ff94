//! The command line: one file per subcommand, no logic of its own.

mod render;

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
enum Command {
    Render(render::Args),
}

impl Command {
    fn run(self) -> anyhow::Result<ExitCode> {
        match self {
            Self::Render(args) => args.run(),
        }
    }
}

/// The work was done and the answer is negative.
pub const NEGATIVE: u8 = 1;
/// The call or a file is wrong.
pub const WRONG: u8 = 2;

/// Runs the program: 0 on success, 1 where the answer is negative, 2 where the call or a file is wrong.
pub fn main() -> ExitCode {
    match Cli::parse().command.run() {
        Ok(code) => code,
        Err(error) => {
            eprintln!("stars: {error:#}");
            ExitCode::from(WRONG)
        }
    }
}
