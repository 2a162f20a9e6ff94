//! A journal's entries, one after the other, at the machines that run them again, and at the replay that drives these: whatever an entry says
//! is taken, and answered the same a second time. There is no image of any frame, so that none is solved.

use stars::journal::{Entry, Machines, Reader, Seen, What, Writer};
use stars::service::{Replay, Wishes};
use stars::settings::Settings;
use std::path::PathBuf;
use std::sync::LazyLock;

static FLIGHT: LazyLock<Settings> = LazyLock::new(|| Settings::flight().expect("the flight's own settings"));

/// The journal that has the entries which the bytes begin with, each where the last one ends.
fn journal(mut data: &[u8]) -> Vec<u8> {
    let mut writer = Writer::default();
    while let Ok((entry, rest)) = postcard::take_from_bytes::<Entry>(data) {
        writer.add(&entry);
        data = rest;
    }
    writer.take()
}

fn run(entries: &[Entry]) -> Vec<Seen> {
    let mut machines = Machines::unknown();
    let mut take = |entry: &Entry| {
        match &entry.what {
            What::Begin(begin) => machines = Machines::begin(begin, &FLIGHT),
            What::Lost(_) => machines.doubt(),
            _ => {}
        }
        machines.take(entry.clone())
    };
    entries.iter().map(&mut take).collect()
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let journal = journal(data);
    let entries: Vec<Entry> = Reader::new(&journal).collect();
    assert_eq!(run(&entries), run(&entries));
    let nowhere = PathBuf::from("/nowhere/at/all");
    let wishes = [Vec::new(), vec!["solver.robust=false".to_owned()]];
    for set in wishes {
        let mut replay = Replay::new(Wishes { set, images: Some(nowhere.clone()), image: None });
        for entry in &entries {
            // Settings that are none are told; the rest goes on.
            let taken = replay.take(entry.clone(), &|| false);
            assert!(taken.is_err() || matches!(entry.what, What::Solved(_)) == matches!(taken, Ok(Some(_))));
        }
        assert_eq!(replay.tally().entries, entries.len() as u64);
    }
}
