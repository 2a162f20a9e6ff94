//! `stars watch`: the state of a running service as a page in a terminal.

use super::{NEGATIVE, print};
use anyhow::{Context, bail, ensure};
use std::io::{IsTerminal, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::process::ExitCode;
use std::time::Duration;

/// The service answers within this time, or there is none.
const ANSWERS_WITHIN: Duration = Duration::from_secs(5);
/// More than a page has, bytes.
const MAX_ANSWER: u64 = 64 * 1024;
/// Takes a terminal to its upper left corner, and clears it from there.
const CLEAR: &str = "\x1b[H\x1b[J";

/// Shows the state of a running service as a page in a terminal
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars watch                                   the page, every second
  stars watch --connect 192.168.1.10:8080       of another computer
  stars watch --ten --every 1                   ten lines, for a link of 9600 baud
  stars watch --once                            once, for a file or a program
It only shows. Exits 1 with --once where no service answers; without it, it waits for one.")]
pub struct Args {
    /// Address of the service's page: its display.listen
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    connect: SocketAddr,
    /// Ten lines of plain ASCII, less than 960 bytes
    #[arg(long)]
    ten: bool,
    /// Show it once
    #[arg(long)]
    once: bool,
    /// Seconds from one to the next
    #[arg(long, value_name = "S", default_value_t = 1.0, value_parser = |text: &str| super::within(text, 0.1, 3600.0))]
    every: f64,
}

impl Args {
    /// Shows it until interrupted, or once.
    ///
    /// # Errors
    /// Where stdout cannot be written.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let path = if self.ten { "/text?ten=1" } else { "/text" };
        let clear = if std::io::stdout().is_terminal() && !self.once { CLEAR } else { "" };
        loop {
            match fetch(self.connect, path) {
                Ok(text) => print(&format!("{clear}{}", text.trim_end()))?,
                Err(error) if self.once => {
                    // Nobody is left to tell where even stderr is closed.
                    let _ = writeln!(std::io::stderr(), "stars: {}: {error:#}", self.connect);
                    return Ok(ExitCode::from(NEGATIVE));
                }
                Err(error) => print(&format!("{clear}{}: {error:#}", self.connect))?,
            }
            if self.once {
                return Ok(ExitCode::SUCCESS);
            }
            std::thread::sleep(Duration::from_secs_f64(self.every));
        }
    }
}

/// What a route answers, as text.
fn fetch(address: SocketAddr, path: &str) -> anyhow::Result<String> {
    let mut stream = TcpStream::connect_timeout(&address, ANSWERS_WITHIN).context("no service answers there")?;
    stream.set_read_timeout(Some(ANSWERS_WITHIN))?;
    stream.set_write_timeout(Some(ANSWERS_WITHIN))?;
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n")?;
    let mut answer = Vec::new();
    stream.take(MAX_ANSWER).read_to_end(&mut answer).context("the answer broke off")?;
    let answer = String::from_utf8_lossy(&answer);
    let Some((head, body)) = answer.split_once("\r\n\r\n") else { bail!("the answer is none of a page's") };
    let status = head.lines().next().unwrap_or_default();
    ensure!(status.starts_with("HTTP/1.1 200"), "{status}: {}", body.trim_end());
    Ok(body.to_owned())
}
