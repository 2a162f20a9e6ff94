//! A simulated flight computer: what it says, from what it knows. The socket is the service room's.

use crate::command::{Act, Command, Key, Refusal, Slot};
use crate::sky::{ClockQuality, Observer, Utc};
use crate::solve::Motion;
use crate::wire::{
    Clock, CommandReply, CommandSlot, Commands, EquatorialEstimate, Gyro, Hello, HorizontalEstimate, List, ObserverPart, Role,
    SLOTS, Status, Update,
};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// A command that has no last reply after this time is given up; the camera refuses it by then.
const COMMAND_LASTS: Duration = Duration::from_secs(15);
/// One that was accepted is waited for this long: the slowest is a sweep of the focus.
const ACCEPTED_LASTS: Duration = Duration::from_secs(3600);

/// A command on its way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Given {
    /// What to do with it.
    pub act: Act,
    /// The command.
    pub command: Command,
    /// Its counter.
    pub counter: u32,
    /// When the ground gave it, time since this computer's start.
    pub at: Duration,
    accepted: bool,
}

impl Given {
    /// Whether a reply to its computer is about it. A block that is refused as a whole is answered with no command's number, and so is
    /// a slot of zeros, which says nothing of the others: the reason tells the two apart.
    pub fn is_answered_by(&self, reply: &CommandReply) -> bool {
        let whole = reply.command == 0 && matches!(reply.why.value(), Some(Refusal::NotAuthentic | Refusal::WrongBoot));
        whole || (self.command.code(), self.counter) == (reply.command, reply.counter.get())
    }
}

/// What it knows of commands.
#[derive(Debug, Clone, Default)]
struct Relay {
    counters: BTreeMap<u8, u32>,
    /// Those that wait for their turn: one is under way at a time, so that arming comes before firing; what only stops things overtakes.
    waiting: VecDeque<(Act, Command)>,
    given: Vec<Given>,
    acknowledged: u32,
    camera_boot: u32,
    lease: Option<u32>,
    blocks: u32,
}

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
    /// The key that it shares with the camera.
    pub key: Option<Key>,
    link: Link,
    relay: Relay,
}

/// What it counts of one connection.
#[derive(Debug, Clone, Copy, Default)]
struct Link {
    statuses: u32,
    updates: u32,
    last_sequence: Option<u32>,
    next_image: Option<u32>,
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
            key: None,
            link: Link::default(),
            relay: Relay::default(),
        }
    }

    /// Begins a connection: its hello, and counters from zero.
    pub fn connect(&mut self) -> Hello {
        self.link = Link::default();
        (self.relay.acknowledged, self.relay.lease, self.relay.blocks) = (0, None, 0);
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

    /// The rates of a series that has just been exposed, as its gyros measured them from a time after this computer's start: of the image
    /// that was to be next by the last update, and of the series of triggers by the statuses until now. The next status begins the next one.
    /// `None` where either is not known.
    pub fn turned(&mut self, measured: &Motion, begun: Duration) -> Option<Gyro> {
        let trigger = self.trigger?;
        self.trigger = Some(trigger.wrapping_add(1));
        Some(Gyro::new(measured, (trigger, self.link.next_image?), begun.as_secs_f64()))
    }

    /// Takes note of an update; gives the replies in it that are new.
    pub fn on_update(&mut self, update: &Update) -> Vec<CommandReply> {
        self.link.updates = self.link.updates.wrapping_add(1);
        self.link.last_sequence = Some(update.link.sequence.get());
        self.link.next_image = Some(update.camera.next_image_counter.get());
        let relay = &mut self.relay;
        // A camera that was started again on the same connection counts its replies from 1.
        let boot = update.link.boot_id.get();
        if std::mem::replace(&mut relay.camera_boot, boot) != boot {
            relay.acknowledged = 0;
        }
        let lease = update.control.lease_epoch.get().map(|epoch| epoch.get());
        relay.lease = lease.filter(|_| update.authority.you_are_in_charge);
        let known = relay.acknowledged;
        let new: Vec<_> = update.control.replies().copied().filter(|reply| reply.serial.get() > known).collect();
        new.iter().for_each(|reply| self.on_reply(reply));
        new
    }

    fn on_reply(&mut self, reply: &CommandReply) {
        let relay = &mut self.relay;
        relay.acknowledged = relay.acknowledged.max(reply.serial.get());
        if self.id != reply.flight_computer {
            return;
        }
        let answered = |given: &Given| given.is_answered_by(reply);
        if reply.stage.get().is_some_and(crate::command::Stage::is_last) {
            relay.given.retain(|given| !answered(given));
        }
        relay.given.iter_mut().filter(|given| answered(given)).for_each(|given| given.accepted = true);
    }

    /// Takes a command from the ground, to be given when those before it have had their last reply, or at once where it only stops
    /// things.
    pub fn relay(&mut self, act: Act, command: Command) {
        self.relay.waiting.push_back((act, command));
    }

    /// The next block of commands, to be sent now; `uptime`: time since this computer's start. With it a command that was never
    /// answered and is given up.
    pub fn block(&mut self, uptime: Duration) -> (Commands, Option<Given>) {
        let relay = &mut self.relay;
        let lasts = |given: &Given| if given.accepted { ACCEPTED_LASTS } else { COMMAND_LASTS };
        let is_late = |given: &Given| uptime.saturating_sub(given.at) > lasts(given);
        let given_up = relay.given.iter().position(is_late).map(|place| relay.given.remove(place));
        // The first block of a boot runs nothing, so nothing is given in it. A computer that claims the charge waits until it has it;
        // one that does not is refused, which is for its operator to see.
        let may = (relay.lease.is_some() || !self.claims_charge && self.link.updates > 0) && relay.blocks > 0;
        while may && relay.given.len() < SLOTS {
            let overtakes = |waiting: &(Act, Command)| waiting.1.only_stops();
            let next = if relay.given.is_empty() { Some(0) } else { relay.waiting.iter().position(overtakes) };
            let Some((act, command)) = next.and_then(|place| relay.waiting.remove(place)) else { break };
            let counter = relay.counters.entry(command.code()).or_default();
            *counter = counter.wrapping_add(1);
            relay.given.push(Given { act, command, counter: *counter, at: uptime, accepted: false });
        }
        let slot = |given: &Given| {
            let age_s = uptime.saturating_sub(given.at).as_secs_f64();
            CommandSlot::new(&Slot::new(&given.command, given.act, given.counter, age_s))
        };
        // An accepted command no longer has to be said.
        let slots: Vec<CommandSlot> = relay.given.iter().filter(|given| !given.accepted).map(slot).collect();
        let block = Commands {
            sequence: relay.blocks.into(),
            boot_id: self.boot_id.into(),
            camera_boot_id: relay.camera_boot.into(),
            lease_epoch: relay.lease.unwrap_or_default().into(),
            last_update_sequence: self.link.last_sequence.into(),
            acknowledged: relay.acknowledged.into(),
            slots_count: slots.len() as u8,
            slots: List::from_slice(&slots),
            ..Commands::default()
        };
        relay.blocks = relay.blocks.wrapping_add(1);
        (self.key.as_ref().map_or(block, |key| block.signed(key)), given_up)
    }

    /// Whether the last update said that it is in charge.
    pub fn holds_lease(&self) -> bool {
        self.relay.lease.is_some()
    }

    /// The commands that are given and have not had their last reply.
    pub fn given(&self) -> &[Given] {
        &self.relay.given
    }

    /// Takes the next counter of a command for something else than the ground's command, as a computer does that is in disorder.
    pub fn use_up_counter(&mut self, code: u8, by: u32) -> u32 {
        let counter = self.relay.counters.entry(code).or_default();
        *counter = counter.wrapping_add(by);
        *counter
    }

    /// Commands that have not had their last reply.
    pub fn unanswered(&self) -> usize {
        self.relay.waiting.len() + self.relay.given.len()
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

    /// An update that holds the lease for the computer, with these replies to its commands.
    fn granted(replies: &[(u32, &Given, crate::command::Stage)]) -> Update {
        let reply = |(serial, given, stage): &(u32, &Given, crate::command::Stage)| CommandReply {
            serial: (*serial).into(),
            flight_computer: 1,
            command: given.command.code(),
            counter: given.counter.into(),
            stage: (*stage).into(),
            ..CommandReply::default()
        };
        let mut update = Update::default();
        update.authority.you_are_in_charge = true;
        update.control.lease_epoch = Some(3u32).into();
        let replies: Vec<CommandReply> = replies.iter().map(reply).collect();
        update.control = update.control.with_replies(&replies);
        update
    }

    #[test]
    fn commands_go_one_after_the_other_and_what_only_stops_things_at_once() {
        let mut computer = FlightComputer { claims_charge: true, ..FlightComputer::new(1, 7) };
        computer.connect();
        for text in ["lens.set_focus 3030", "lens.get_focus", "lens.stop"] {
            computer.relay(Act::Run, Command::parse(text).unwrap());
        }
        let given = |computer: &mut FlightComputer, seconds| {
            let (block, _) = computer.block(Duration::from_secs(seconds));
            block.slots().iter().map(|slot| slot.code).collect::<Vec<_>>()
        };
        assert!(given(&mut computer, 1).is_empty(), "nothing without the lease");
        computer.on_update(&granted(&[]));
        assert_eq!(given(&mut computer, 2), [23, 28]);
        assert_eq!(given(&mut computer, 3), [23, 28], "until it is answered");
        let [focus, stop] = [computer.relay.given[0], computer.relay.given[1]];
        computer
            .on_update(&granted(&[(1, &stop, crate::command::Stage::Completed), (2, &focus, crate::command::Stage::Accepted)]));
        assert!(given(&mut computer, 4).is_empty(), "what is accepted need not be said again, and holds up the next");
        computer.on_update(&granted(&[(3, &focus, crate::command::Stage::Failed)]));
        assert_eq!(given(&mut computer, 5), [22]);
        let (_, given_up) = computer.block(Duration::from_secs(5) + COMMAND_LASTS + Duration::from_secs(1));
        assert_eq!(given_up.map(|given| given.command.to_string()), Some("lens.get_focus".to_owned()));
        assert_eq!(computer.unanswered(), 0);
    }
}
