//! Visitors: how often each address connects. One that comes again and again costs a handshake each time, and no more.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Connections are counted for so long.
const WINDOW: Duration = Duration::from_secs(1);
/// Addresses that are remembered; many more at once are as many strangers, for whom there are places elsewhere.
const REMEMBERED: usize = 256;

/// Counts the connections of each address in the last second or so.
#[derive(Debug)]
pub struct Visitors {
    most: u32,
    seen: Mutex<BTreeMap<IpAddr, (Instant, u32)>>,
}

impl Visitors {
    /// At most so many of one address in a second.
    pub fn new(most: u32) -> Self {
        Self { most, seen: Mutex::default() }
    }

    /// An address connects: how many times too often that is in this second, 0 where it is not.
    pub fn enter(&self, address: IpAddr, now: Instant) -> u32 {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.len() >= REMEMBERED {
            seen.retain(|_, (since, _)| now.saturating_duration_since(*since) < WINDOW);
        }
        if seen.len() >= REMEMBERED && !seen.contains_key(&address) {
            seen.pop_first();
        }
        let (since, count) = seen.entry(address.to_canonical()).or_insert((now, 0));
        if now.saturating_duration_since(*since) >= WINDOW {
            (*since, *count) = (now, 0);
        }
        *count = count.saturating_add(1);
        count.saturating_sub(self.most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn an_address_that_comes_too_often_is_told_and_no_other_is() {
        let (visitors, start) = (Visitors::new(3), Instant::now());
        let at = |last: u8, ms| visitors.enter(IpAddr::from([10, 0, 0, last]), start + Duration::from_millis(ms));
        assert_eq!([0, 10, 20, 30, 40].map(|ms| at(1, ms)), [0, 0, 0, 1, 2]);
        assert_eq!(at(2, 50), 0);
        assert_eq!([999, 1000, 1010].map(|ms| at(1, ms)), [3, 0, 0]);
        let strangers = (0..100_000_u32).map(|n| visitors.enter(IpAddr::from(n.to_be_bytes()), start)).sum::<u32>();
        assert_eq!((strangers, visitors.seen.lock().unwrap().len()), (0, REMEMBERED));
    }
}
