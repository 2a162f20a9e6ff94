//! The command line: one file per subcommand, no logic of its own.
//!
//! A subcommand is a file with `pub struct Args` (clap) and `Args::run(self) -> anyhow::Result<ExitCode>`, and one line in
//! `Command` and in `Command::run`. Every one exits 0 on success, [`NEGATIVE`] where the work was done and the answer is
//! negative, and [`WRONG`] with one line on stderr where the call or a file is wrong: for that it returns the error.

mod bundle;
mod calibrate;
mod catalog;
mod config;
mod demo;
mod export;
mod fcp;
mod memory;
mod render;
mod replay;
mod run;
mod selftest;
mod settings;
mod soak;
mod solve;
mod text;
mod view;
mod watch;

pub use config::ConfigArgs;

use clap::{CommandFactory, Parser, Subcommand, error::ErrorKind};
use std::io::{ErrorKind::BrokenPipe, Write};
use std::process::ExitCode;

/// Star camera flight software.
#[derive(Debug, Parser)]
#[command(name = "stars", version, disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
enum Command {
    Bundle(bundle::Args),
    Calibrate(calibrate::Args),
    Catalog(catalog::Args),
    Demo(demo::Args),
    Export(export::Args),
    Fcp(fcp::Args),
    Render(render::Args),
    Replay(replay::Args),
    Run(run::Args),
    Selftest(selftest::Args),
    Settings(settings::Args),
    Soak(soak::Args),
    Solve(solve::Args),
    View(view::Args),
    Watch(watch::Args),
}

impl Command {
    fn run(self) -> anyhow::Result<ExitCode> {
        match self {
            Self::Bundle(args) => args.run(),
            Self::Calibrate(args) => args.run(),
            Self::Catalog(args) => args.run(),
            Self::Demo(args) => args.run(),
            Self::Export(args) => args.run(),
            Self::Fcp(args) => args.run(),
            Self::Render(args) => args.run(),
            Self::Replay(args) => args.run(),
            Self::Run(args) => args.run(),
            Self::Selftest(args) => args.run(),
            Self::Settings(args) => args.run(),
            Self::Soak(args) => args.run(),
            Self::Solve(args) => args.run(),
            Self::View(args) => args.run(),
            Self::Watch(args) => args.run(),
        }
    }
}

/// The work was done and the answer is negative.
pub const NEGATIVE: u8 = 1;
/// The call or a file is wrong.
pub const WRONG: u8 = 2;

/// Runs the program: 0 on success, 1 where the answer is negative, 2 where the call or a file is wrong.
pub fn main() -> ExitCode {
    memory::give_back_what_is_large();
    match Cli::try_parse() {
        Ok(cli) => cli.command.run().unwrap_or_else(|error| refuse(&format!("{error:#}"))),
        Err(error) => usage(&error),
    }
}

/// Prints to stdout with a line end. A reader that has seen enough (`stars settings | head`) is no error.
///
/// # Errors
/// Where stdout cannot be written, such as a full disk.
pub fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() != BrokenPipe => Err(anyhow::Error::new(error).context("stdout cannot be written")),
        _ => Ok(()),
    }
}

/// A number of a range as a command line has it, ends included; never NaN.
fn within(text: &str, low: f64, high: f64) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("'{text}' is not a number from {low} to {high}"))
}

/// One line on stderr that says what is wrong with the call.
fn refuse(message: &str) -> ExitCode {
    let one_line = message.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
    // Nobody is left to tell where even stderr is closed.
    let _ = writeln!(std::io::stderr(), "stars: {one_line}");
    ExitCode::from(WRONG)
}

/// Help and version are answers; anything else is a wrong call, of which clap's first paragraph is enough.
fn usage(error: &clap::Error) -> ExitCode {
    let text = error.to_string();
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => match print(text.trim_end()) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => refuse(&format!("{error:#}")),
        },
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand | ErrorKind::MissingSubcommand => {
            let known: Vec<_> = Cli::command().get_subcommands().map(|command| command.get_name().to_owned()).collect();
            refuse(&format!("no subcommand, expected one of: {} (see 'stars --help')", known.join(", ")))
        }
        _ => {
            let first = text.split("\n\n").next().unwrap_or_default();
            refuse(&format!("{} (see --help)", first.trim_start_matches("error: ")))
        }
    }
}
