//! What outlasts a restart: the bytes of a file, and a value behind a right checksum. It is refused, or can be gone on with: settings
//! that are in range, and counters that refuse what ran before.

use stars::command::{Act, Authenticity, BootId, Command, FlightComputer, Guard, Sender, Situation, Slot};
use stars::service::Kept;
use stars::settings::Settings;
use std::sync::{Arc, LazyLock};
use std::time::Duration;

static INITIAL: LazyLock<Arc<Settings>> = LazyLock::new(|| Arc::new(Settings::flight().expect("the flight's own settings")));

fn go_on(kept: &Kept) {
    let (settings, commanded, complaints) = kept.settings(&INITIAL);
    assert!(commanded.len() + complaints.len() == kept.commanded.len());
    assert!(!serde_json::to_string(&*settings).expect("settings serialise").contains("null"));
    let mut guard = Guard::new(kept.counters.clone());
    let (computer, boot, delay) = (FlightComputer(1), BootId(7), Duration::ZERO);
    let sender = Sender { computer, boot, block_boot: boot, under: None, delay, authenticity: Authenticity::NotRequired };
    let now = Situation { lease: None, ours: BootId(1), window_s: 15.0 };
    for counter in [1, 2, u32::MAX] {
        guard.on(&sender, &now, &[Slot::new(&Command::StopLens {}, Act::Run, counter, 0.0)]);
    }
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    Kept::from_file(data).iter().for_each(go_on);
    // The same as the value of a file whose checksum is right.
    let mut file = b"STARSLG1\x01\0\0\0\0\0\0\0".to_vec();
    file.extend((data.len() as u32).to_le_bytes());
    file.extend(data);
    file.extend(crc32fast::hash(&file).to_le_bytes());
    Kept::from_file(&file).iter().for_each(go_on);
}
