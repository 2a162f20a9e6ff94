//! The legacy port from the outside: a C program with the structs that flew, and sessions with a flight program of old in this
//! process, where time may be paused.
//!
//! `STARS_LEGACY_S`: how long the C program flies, 60 s if not set. Needs `gcc`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod flight;
mod images;
mod sessions;
#[allow(dead_code, reason = "shared with the tests of the service, which use all of it")]
#[path = "../service/support.rs"]
mod support;

use stars::settings::{LensKind, Settings};

/// The settings of the service's tests, with the legacy port open to two addresses of this machine.
fn settings() -> Settings {
    let mut settings = support::settings();
    // Its port is a real one, and does not know of time that is paused.
    settings.lens.kind = LensKind::None;
    settings.commands.ledger_directory = String::new();
    settings.legacy.enabled = true;
    settings.legacy.listen = "127.0.0.1:0".to_owned();
    settings.legacy.peers = ["127.0.0.1", "127.0.0.2"].map(str::to_owned).to_vec();
    settings
}
