//! From the state to what an update says of temperatures, pressure, disk and restarts.

use super::Quantity;
use crate::service::state::{Disk, State};
use crate::wire::{Actor, Health, Housekeeping, Text};
use tokio::time::Instant;

/// The values that are known.
pub fn housekeeping(state: &State, now: Instant) -> Housekeeping {
    let value = |quantity| state.measured.value(quantity, now, &state.settings).into();
    Housekeeping {
        temperature_lens_c: value(Quantity::TemperatureLens),
        temperature_computer_c: value(Quantity::TemperatureComputer),
        temperature_vessel_c: value(Quantity::TemperatureVessel),
        temperature_plate_c: value(Quantity::TemperaturePlate),
        temperature_dcdc_c: value(Quantity::TemperatureDcdc),
        temperature_flange_c: value(Quantity::TemperatureFlange),
        pressure_atm: value(Quantity::Pressure),
        disk_free_gib: value(Quantity::DiskFree),
    }
}

/// Their ages and alarms; restarts.
pub fn health(state: &State, now: Instant) -> Health {
    let age = |quantity| state.measured.age_s(quantity, now).into();
    let alarm = |quantity| state.measured.is_alarming(quantity, now, &state.settings);
    let restarts = |actor| state.counters.restarts.get(&actor).copied().unwrap_or_default().into();
    let disk_is_known = state.measured.value(Quantity::DiskFree, now, &state.settings).is_some();
    let images = |disk| state.counters.images.get(&disk).copied().unwrap_or_default();
    let (images, copies) = (images(Disk::Images), images(Disk::Copies));
    let last = state.restarts.iter().max_by_key(|(_, restart)| restart.at);
    Health {
        simulated_housekeeping: state.simulated.housekeeping,
        temperature_lens_age_s: age(Quantity::TemperatureLens),
        temperature_computer_age_s: age(Quantity::TemperatureComputer),
        temperature_vessel_age_s: age(Quantity::TemperatureVessel),
        temperature_plate_age_s: age(Quantity::TemperaturePlate),
        temperature_dcdc_age_s: age(Quantity::TemperatureDcdc),
        temperature_flange_age_s: age(Quantity::TemperatureFlange),
        pressure_age_s: age(Quantity::Pressure),
        disk_free_age_s: age(Quantity::DiskFree),
        temperature_lens_alarm: alarm(Quantity::TemperatureLens),
        temperature_computer_alarm: alarm(Quantity::TemperatureComputer),
        temperature_vessel_alarm: alarm(Quantity::TemperatureVessel),
        temperature_plate_alarm: alarm(Quantity::TemperaturePlate),
        temperature_dcdc_alarm: alarm(Quantity::TemperatureDcdc),
        temperature_flange_alarm: alarm(Quantity::TemperatureFlange),
        pressure_alarm: alarm(Quantity::Pressure),
        disk_free_alarm: alarm(Quantity::DiskFree),
        disk_days_left: state.measured.disk_days_left.filter(|_| disk_is_known).into(),
        run_number: state.run.number.into(),
        last_end: state.run.last_end.into(),
        kept_at_start: state.found.into(),
        restarts_lens: restarts(Actor::Lens),
        restarts_ledger: restarts(Actor::Ledger),
        restarts_housekeeping: restarts(Actor::Housekeeping),
        restarts_archive: restarts(Actor::Archive),
        shed: state.strain.shed().into(),
        images_kept: images.kept.into(),
        images_lost: images.lost.into(),
        images_thinned: images.thinned.into(),
        images_disk_errors: images.disk_errors.into(),
        copies_kept: copies.kept.into(),
        copies_lost: copies.lost.into(),
        copies_thinned: copies.thinned.into(),
        copies_disk_errors: copies.disk_errors.into(),
        last_restart: last.map(|(actor, _)| *actor).into(),
        last_restart_reason: last.map_or_else(Text::default, |(_, restart)| Text::new(&restart.why)),
        last_restart_age_s: last.map(|(_, restart)| now.saturating_duration_since(restart.at).as_secs_f64()).into(),
    }
}
