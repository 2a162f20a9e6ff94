//! Blocks of the program that flew, one after the other: read or refused, with finite numbers, and judged by the guard, which runs
//! nothing whose counter it has seen.

use stars::command::legacy::{Finding, LegacyGuard};
use stars::wire::legacy::{BLOCK_BYTES, Block};
use std::time::Duration;

/// Between two blocks, ms: a byte says how long.
const STEP_MS: u64 = 20;

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let (mut guard, mut now) = (LegacyGuard::default(), Duration::ZERO);
    let mut whole = [0; BLOCK_BYTES];
    guard.connected();
    // Each piece begins with a pause and a place, and changes the block from there on.
    for piece in data.chunks(64) {
        let [pause, low, high, change @ ..] = piece else { return };
        now += Duration::from_millis(STEP_MS * u64::from(*pause));
        let at = usize::from(u16::from_le_bytes([*low, *high])) % BLOCK_BYTES;
        whole.iter_mut().skip(at).zip(change).for_each(|(byte, change)| *byte = *change);
        let Ok(block) = Block::unpack(&whole) else { continue };
        let status = serde_json::to_string(&block.status()).expect("a status has a JSON form");
        assert!(!status.is_empty());
        if let Some(Ok(gyro)) = block.motion.as_ref().map(|motion| motion.gyro()) {
            let finite =
                gyro.samples.as_slice().iter().all(|rates| rates.az_rate_deg_s.is_finite() && rates.el_rate_deg_s.is_finite());
            assert!(finite && gyro.exposures_count > 0);
        }
        let ran = |findings: &[Finding]| findings.iter().filter(|finding| matches!(finding, Finding::True { .. })).count();
        guard.on(now, &block.commands);
        assert_eq!(ran(&guard.on(now, &block.commands)), 0, "a command ran twice");
    }
}
