//! From the state to the gauges of the display.

use super::{Quantity, Rule};
use crate::display::{Gauge, Limits};
use crate::service::state::State;
use tokio::time::Instant;

/// Every quantity with its limits, and the days until the disk is full.
pub fn gauges(state: &State, now: Instant) -> Vec<Gauge> {
    let settings = &state.settings;
    let gauge = |quantity: Quantity| {
        let Rule { low, high, red, .. } = quantity.rule(settings);
        let value = state.measured.value(quantity, now, settings);
        let limits = Limits { yellow: (low, high), red };
        Gauge::new(quantity.name(), quantity.possible().0, value, limits).read(state.measured.age_s(quantity, now))
    };
    let mut gauges: Vec<Gauge> = Quantity::ALL.into_iter().map(gauge).collect();
    let disk = Quantity::DiskFree;
    let days = state.measured.disk_days_left.filter(|_| state.measured.value(disk, now, settings).is_some());
    let limits = Limits::above(settings.display.disk_yellow_d, settings.display.disk_red_d);
    gauges.push(Gauge::new("disk_days_left", "d", days, limits).read(state.measured.age_s(disk, now)));
    gauges
}
