//! A simulated flight computer: what it says, from what it knows. The socket is the service room's.

use crate::sky::{ClockQuality, Observer, Utc};
use crate::wire::{Clock, EquatorialEstimate, Hello, HorizontalEstimate, ObserverPart, Role, Status, Update};
use std::time::Duration;

/// A flight computer. Time comes in as the time since its start.
#[derive(Debug, Clone)]
pub struct FlightComputer {
    /// Its number, 1 or 2.
    pub id: u8,
    /// Number of this start.
    pub boot_id: u32,
    /// Whether it claims to be in charge.
    pub claims_charge: bool,
    /// The observer at its start; sidereal time runs on from there.
    pub observer: Option<Observer>,
    /// Its estimate of the pointing against the horizon.
    pub horizontal: Option<HorizontalEstimate>,
    /// Its estimate of the pointing on the sky.
    pub equatorial: Option<EquatorialEstimate>,
    /// The series of triggers that images belong to.
    pub trigger: Option<u32>,
    link: Link,
}

/// What it counts of one connection.
#[derive(Debug, Clone, Copy, Default)]
struct Link {
    statuses: u32,
    updates: u32,
    last_sequence: Option<u32>,
}

impl FlightComputer {
    /// A computer that knows nothing and claims nothing.
    pub fn new(id: u8, boot_id: u32) -> Self {
        Self {
            id,
            boot_id,
            claims_charge: false,
            observer: None,
            horizontal: None,
            equatorial: None,
            trigger: None,
            link: Link::default(),
        }
    }

    /// Begins a connection: its hello, and counters from zero.
    pub fn connect(&mut self) -> Hello {
        self.link = Link::default();
        Hello::new(Role::FlightComputer, self.id, &format!("simulated fc{}", self.id), self.boot_id, None)
    }

    /// The next status, to be sent now.
    pub fn status(&mut self, uptime: Duration, clock: (Option<Utc>, ClockQuality)) -> Status {
        let sequence = self.link.statuses;
        self.link.statuses = sequence.wrapping_add(1);
        Status {
            sequence: sequence.into(),
            boot_id: self.boot_id.into(),
            uptime_s: uptime.as_secs_f64(),
            claims_charge: self.claims_charge,
            clock: Clock::new(clock.0, clock.1),
            observer: self.observer.map(|start| ObserverPart::from(start.after(uptime.as_secs_f64()))).into(),
            horizontal_estimate: self.horizontal.into(),
            equatorial_estimate: self.equatorial.into(),
            trigger_counter: self.trigger.into(),
            updates_received: self.link.updates.into(),
            last_update_sequence: self.link.last_sequence.into(),
            ..Status::default()
        }
    }

    /// Takes note of an update.
    pub fn on_update(&mut self, update: &Update) {
        self.link.updates = self.link.updates.wrapping_add(1);
        self.link.last_sequence = Some(update.link.sequence.get());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::HOUR;
    use crate::wire::{Link as UpdateLink, Message};

    const UNSET: (Option<Utc>, ClockQuality) = (None, ClockQuality::Unset);

    #[test]
    fn sidereal_time_runs_on_faster_than_the_clock_and_wraps() {
        let start = Observer { latitude: -1.3, sidereal_time: 23.5 * HOUR };
        let mut computer = FlightComputer { observer: Some(start), ..FlightComputer::new(1, 7) };
        let observer = computer.status(Duration::from_secs(3600), UNSET).observer().unwrap();
        assert!((observer.sidereal_time / HOUR - 0.502_737_9).abs() < 1e-6, "{}", observer.sidereal_time / HOUR);
        assert!((observer.latitude + 1.3).abs() < 1e-12);
    }

    #[test]
    fn a_status_says_what_was_received_and_a_new_connection_counts_from_zero() {
        let mut computer = FlightComputer { trigger: Some(5), claims_charge: true, ..FlightComputer::new(2, 7) };
        assert_eq!(computer.connect().id, 2);
        computer.status(Duration::ZERO, UNSET);
        let link = UpdateLink { sequence: 9.into(), ..UpdateLink::default() };
        computer.on_update(&Update { link, ..Update::default() });
        let status = computer.status(Duration::from_secs(1), UNSET);
        assert_eq!((status.sequence.get(), status.updates_received.get()), (1, 1));
        assert_eq!(status.last_update_sequence.get().map(|sequence| sequence.get()), Some(9));
        assert!(status.claims_charge && status.observer().is_none());
        assert_eq!(status.trigger().map(|trigger| trigger.0), Some(5));
        computer.connect();
        assert_eq!(computer.status(Duration::from_secs(2), UNSET).sequence.get(), 0);
    }

    #[test]
    fn what_it_says_can_be_read() {
        let mut computer = FlightComputer::new(1, 7);
        let hello = Message::Hello(Box::new(computer.connect()));
        let status = Message::Status(Box::new(computer.status(Duration::ZERO, UNSET)));
        for message in [hello, status] {
            let body = message.body().unwrap();
            assert_eq!(Message::decode(message.kind() as u8, 1, &body), Ok((message, 0)));
        }
    }
}
