//! Every input that fuzzing has found worth keeping, through the same checks: what held once holds.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::indexing_slicing,
    reason = "a test may fail by panicking"
)]

#[path = "../../fuzz/checks/bad_pixels.rs"]
mod bad_pixels;
#[path = "../../fuzz/checks/body.rs"]
mod body;
#[path = "../../fuzz/checks/catalogue.rs"]
mod catalogue;
#[path = "../../fuzz/checks/image.rs"]
mod image;
#[path = "../../fuzz/checks/index.rs"]
mod index;
#[path = "../../fuzz/checks/journal.rs"]
mod journal;
#[path = "../../fuzz/checks/kept.rs"]
mod kept;
#[path = "../../fuzz/checks/legacy.rs"]
mod legacy;
#[path = "../../fuzz/checks/lens_reply.rs"]
mod lens_reply;
#[path = "../../fuzz/checks/replay.rs"]
mod replay;
#[path = "../../fuzz/checks/settings.rs"]
mod settings;
#[path = "../../fuzz/checks/solve.rs"]
mod solve;
#[path = "../../fuzz/checks/texts.rs"]
mod texts;
#[path = "../../fuzz/checks/view.rs"]
mod view;
#[path = "../../fuzz/checks/wire.rs"]
mod wire;

use std::panic::{AssertUnwindSafe, catch_unwind};

/// Runs the inputs of a target: each stands in its file behind its length, four bytes, lowest first (`fuzz/corpora.py`).
fn run(target: &str, check: fn(&[u8])) {
    let path = format!("{}/fuzz/corpora/{target}", env!("CARGO_MANIFEST_DIR"));
    let packed = std::fs::read(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
    let (mut rest, mut inputs) = (packed.as_slice(), 0);
    while let Some((length, after)) = rest.split_first_chunk::<4>() {
        let (input, after) = after.split_at(u32::from_le_bytes(*length) as usize);
        let held = catch_unwind(AssertUnwindSafe(|| check(input)));
        assert!(held.is_ok(), "{path}: input {inputs} of {} bytes: {}", input.len(), input.escape_ascii());
        (rest, inputs) = (after, inputs + 1);
    }
    assert!(rest.is_empty() && inputs >= 1, "{path}: {inputs} inputs");
    println!("{target}: {inputs} inputs");
}

macro_rules! corpora {
    ($($name:ident)*) => {
        $(
            #[test]
            fn $name() {
                run(stringify!($name), $name::check);
            }
        )*
    };
}

mod every_kept_input_holds {
    use super::*;

    corpora!(bad_pixels body catalogue image index journal kept legacy lens_reply replay settings solve texts view wire);
}
