//! The desk: takes the orders that the guard let through, has hazardous ones armed before they are fired, hands them out, and keeps
//! the replies.
//!
//! An order's way: the guard lets it through → [`Desk::take`] says [`Step::Keep`] → its counter is on disk → [`Desk::kept`] says
//! [`Step::Do`] → its actor reports [`Desk::report`]. Each step leaves a [`Reply`].

use super::dictionary::{Command, Hazard};
use super::guard::{Act, Order, Verdict};
use super::in_charge::{BootId, FlightComputer, Tick};
use super::reply::{Refusal, Replies, Reply, Stage};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// An armed command may be fired for this long.
pub const ARMED: Duration = Duration::from_secs(10);
/// Orders that may be under way at a time.
pub const UNDER_WAY: usize = 32;

/// The number of an order here: requests to actors carry it, and their results repeat it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct OrderNumber(pub u32);

/// What the caller is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Keep the guard's memory on disk, then call [`Desk::kept`] with this number.
    Keep(OrderNumber),
    /// Do it, and call [`Desk::report`] with this number.
    Do(OrderNumber, Command),
}

/// What the desk knows of the lens, to tell a large move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Focus {
    /// Where it is, where that is known, counts.
    pub position: Option<i32>,
    /// A move further than this is large, counts.
    pub large_move: u32,
}

/// An order that has not had its last reply.
#[derive(Debug, Clone, Copy, PartialEq)]
struct UnderWay {
    number: OrderNumber,
    order: Order,
}

/// A command that was armed.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Armed {
    from: FlightComputer,
    command: Command,
    until: Tick,
}

/// What was counted since the start.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CommandCounts {
    /// Orders that the guard and the desk let through.
    pub accepted: u32,
    /// What was refused, by the reason.
    pub refused: BTreeMap<Refusal, u32>,
    /// The last reason.
    pub last: Option<Refusal>,
}

/// The desk.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Desk {
    /// The replies.
    pub replies: Replies,
    /// The counts.
    pub counts: CommandCounts,
    under_way: VecDeque<UnderWay>,
    armed: Option<Armed>,
    last: OrderNumber,
    /// The last refusals told: one that stands in block after block is counted each time and told once.
    told: BTreeMap<(FlightComputer, u8), (u32, Refusal)>,
}

impl Desk {
    /// A computer connects. What another boot of it was told is not for this one.
    pub fn begin(&mut self, computer: FlightComputer, boot: BootId) {
        if self.replies.begin(computer, boot) {
            self.told.retain(|(who, _), _| *who != computer);
        }
    }

    /// Takes a verdict of the guard.
    pub fn take(&mut self, now: Tick, from: FlightComputer, verdict: Verdict, focus: Focus) -> Option<Step> {
        match verdict {
            Verdict::Run(order) => match self.may(now, &order, focus) {
                Ok(()) => {
                    self.last = OrderNumber(self.last.0.wrapping_add(1));
                    self.under_way.push_back(UnderWay { number: self.last, order });
                    Some(Step::Keep(self.last))
                }
                Err((why, detail)) => {
                    self.refuse(now, from, order.command.code(), order.counter, why, detail);
                    None
                }
            },
            Verdict::Refused { code, counter, why, detail } => {
                self.refuse(now, from, code, counter, why, detail);
                None
            }
        }
    }

    /// The counter of an order is on disk, or could not be brought there.
    pub fn kept(&mut self, now: Tick, number: OrderNumber, kept: Result<(), String>) -> Option<Step> {
        let order = self.order(number)?;
        if let Err(problem) = kept
            && !runs_unkept(&order.command)
        {
            self.report(now, number, Stage::Failed, Some(Refusal::NotKept), problem);
            return None;
        }
        self.counts.accepted = self.counts.accepted.saturating_add(1);
        self.reply(now, &order, Stage::Accepted, None, order.command.to_string());
        if order.act == Act::Arm {
            self.armed = Some(Armed { from: order.from, command: order.command, until: now + ARMED });
            let detail = format!("armed for {} s: {}", ARMED.as_secs(), order.command);
            self.report(now, number, Stage::Completed, None, detail);
            return None;
        }
        Some(Step::Do(number, order.command))
    }

    /// How far an order has come. After the last stage it is no longer under way; one that is not is ignored.
    pub fn report(&mut self, now: Tick, number: OrderNumber, stage: Stage, why: Option<Refusal>, detail: String) {
        let Some(order) = self.order(number) else { return };
        if stage.is_last() {
            self.under_way.retain(|under_way| under_way.number != number);
        }
        self.reply(now, &order, stage, why, detail);
    }

    /// What a command means that comes in a dialect without a word for arming: one that must be armed arms itself, and fires when
    /// it comes again with the same values while it is armed.
    pub fn act(&self, now: Tick, from: FlightComputer, command: &Command, focus: Focus) -> Act {
        let hazardous = command.definition().is_ok_and(|definition| is_hazardous(definition.hazard, command, focus));
        let armed = self.armed(now).is_some_and(|(who, what, _)| (who, what) == (from, *command));
        match (hazardous, armed) {
            (false, _) => Act::Run,
            (true, false) => Act::Arm,
            (true, true) => Act::Fire,
        }
    }

    /// Whoever commands from now on, nothing is armed.
    pub fn disarm(&mut self) {
        self.armed = None;
    }

    /// What is armed, and until when.
    pub fn armed(&self, now: Tick) -> Option<(FlightComputer, Command, Tick)> {
        let armed = self.armed.filter(|armed| now < armed.until)?;
        Some((armed.from, armed.command, armed.until))
    }

    /// The orders under way.
    pub fn under_way(&self) -> impl Iterator<Item = (OrderNumber, &Order)> {
        self.under_way.iter().map(|under_way| (under_way.number, &under_way.order))
    }

    fn order(&self, number: OrderNumber) -> Option<Order> {
        self.under_way.iter().find(|under_way| under_way.number == number).map(|under_way| under_way.order)
    }

    /// Whether an order may be run now.
    fn may(&mut self, now: Tick, order: &Order, focus: Focus) -> Result<(), (Refusal, String)> {
        let unknown = |error: super::CommandError| (Refusal::UnknownCommand, error.to_string());
        let definition = order.command.definition().map_err(unknown)?;
        if !definition.available {
            return Err((Refusal::NotAvailable, format!("{} is not there yet", definition.name)));
        }
        if self.under_way.len() >= UNDER_WAY && !runs_unkept(&order.command) {
            return Err((Refusal::Busy, format!("{UNDER_WAY} commands are under way")));
        }
        let armed = self.armed(now).filter(|(from, command, _)| (*from, *command) == (order.from, order.command)).is_some();
        match order.act {
            Act::Arm => Ok(()),
            Act::Fire if armed => {
                self.armed = None;
                Ok(())
            }
            Act::Fire => Err((Refusal::NotArmed, "these values were not armed, or too long ago".to_owned())),
            Act::Run => match is_hazardous(definition.hazard, &order.command, focus) {
                false => Ok(()),
                true => Err((Refusal::NotArmed, format!("{} is armed first, then fired", order.command))),
            },
        }
    }

    fn refuse(&mut self, now: Tick, to: FlightComputer, code: u8, counter: u32, why: Refusal, detail: String) {
        let count = self.counts.refused.entry(why).or_default();
        *count = count.saturating_add(1);
        self.counts.last = Some(why);
        if self.told.insert((to, code), (counter, why)) != Some((counter, why)) {
            let reply = Reply { serial: 0, to, code, counter, stage: Stage::Rejected, why: Some(why), detail, at: now };
            self.replies.add(reply);
        }
    }

    fn reply(&mut self, now: Tick, order: &Order, stage: Stage, why: Option<Refusal>, detail: String) {
        let (to, code, counter) = (order.from, order.command.code(), order.counter);
        self.replies.add(Reply { serial: 0, to, code, counter, stage, why, detail, at: now });
    }
}

/// Whether it must be armed.
fn is_hazardous(hazard: Hazard, command: &Command, focus: Focus) -> bool {
    match (hazard, command) {
        (Hazard::None, _) => false,
        (Hazard::Always, _) => true,
        (Hazard::LargeMove, Command::SetFocus { position_counts }) => {
            focus.position.is_none_or(|at| position_counts.abs_diff(at) > focus.large_move)
        }
        (Hazard::LargeMove, Command::MoveFocus { step_counts }) => {
            focus.position.is_none() || step_counts.unsigned_abs() > focus.large_move
        }
        (Hazard::LargeMove, _) => true,
    }
}

/// What only stops things runs whatever else is wrong: done twice it does no harm, not done it may.
fn runs_unkept(command: &Command) -> bool {
    matches!(
        command,
        Command::StopLens { .. }
            | Command::KnownGood { .. }
            | Command::AbortSolver { .. }
            | Command::AbortFocus { use_result: false }
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const FC: FlightComputer = FlightComputer(1);
    const AT_3000: Focus = Focus { position: Some(3000), large_move: 500 };

    fn order(counter: u32, act: Act, text: &str) -> Verdict {
        Verdict::Run(Order { from: FC, counter, act, command: Command::parse(text).unwrap() })
    }

    fn at(seconds: u64) -> Tick {
        Duration::from_secs(seconds)
    }

    fn stages(desk: &Desk) -> Vec<(u32, Stage, Option<Refusal>)> {
        desk.replies.due(FC).map(|reply| (reply.counter, reply.stage, reply.why)).collect()
    }

    /// Takes an order whose counter reaches the disk.
    fn run(desk: &mut Desk, now: Tick, verdict: Verdict, focus: Focus) -> Option<Step> {
        let Some(Step::Keep(number)) = desk.take(now, FC, verdict, focus) else { return None };
        desk.kept(now, number, Ok(()))
    }

    #[test]
    fn an_order_is_kept_before_it_is_done_and_every_stage_is_told() {
        let mut desk = Desk::default();
        let Some(Step::Keep(number)) = desk.take(at(1), FC, order(1, Act::Run, "lens.set_focus 3030"), AT_3000) else { panic!() };
        assert!(stages(&desk).is_empty());
        let step = desk.kept(at(1), number, Ok(())).unwrap();
        assert_eq!(step, Step::Do(number, Command::SetFocus { position_counts: 3030 }));
        desk.report(at(2), number, Stage::Started, None, String::new());
        desk.report(at(3), number, Stage::Completed, None, "at 3030".to_owned());
        desk.report(at(4), number, Stage::Failed, None, "nobody waits for this".to_owned());
        assert_eq!(stages(&desk), [(1, Stage::Accepted, None), (1, Stage::Started, None), (1, Stage::Completed, None)]);
        assert_eq!(desk.under_way().count(), 0);
    }

    #[test]
    fn an_order_whose_counter_cannot_be_kept_fails_unless_it_only_stops_things() {
        let mut desk = Desk::default();
        for (counter, text, runs) in [(1, "lens.set_focus 3030", false), (2, "lens.stop", true), (3, "service.known_good", true)]
        {
            let Some(Step::Keep(number)) = desk.take(at(1), FC, order(counter, Act::Run, text), AT_3000) else { panic!() };
            assert_eq!(desk.kept(at(1), number, Err("disk".to_owned())).is_some(), runs, "{text}");
        }
        assert_eq!(stages(&desk)[0], (1, Stage::Failed, Some(Refusal::NotKept)));
    }

    #[test]
    fn a_hazardous_command_runs_only_when_the_same_one_was_armed_ten_seconds_ago_at_most() {
        let mut desk = Desk::default();
        assert_eq!(run(&mut desk, at(0), order(1, Act::Run, "service.quit"), AT_3000), None);
        assert_eq!(run(&mut desk, at(1), order(2, Act::Fire, "service.quit"), AT_3000), None);
        assert_eq!(run(&mut desk, at(2), order(3, Act::Arm, "service.quit"), AT_3000), None);
        assert!(desk.armed(at(11)).is_some() && desk.armed(at(12)).is_none());
        assert_eq!(run(&mut desk, at(12), order(4, Act::Fire, "service.quit"), AT_3000), None);
        assert_eq!(run(&mut desk, at(20), order(5, Act::Arm, "service.shut_down 1"), AT_3000), None);
        assert_eq!(run(&mut desk, at(20), order(6, Act::Fire, "service.shut_down 0"), AT_3000), None);
        assert!(run(&mut desk, at(21), order(7, Act::Fire, "service.shut_down 1"), AT_3000).is_some());
        assert_eq!(run(&mut desk, at(21), order(8, Act::Fire, "service.shut_down 1"), AT_3000), None, "armed once, fired once");
        assert_eq!(desk.counts.refused.get(&Refusal::NotArmed), Some(&5));
        desk.take(at(30), FC, order(9, Act::Arm, "service.quit"), AT_3000);
        desk.disarm();
        assert_eq!(run(&mut desk, at(31), order(10, Act::Fire, "service.quit"), AT_3000), None);
    }

    #[test]
    fn large_focus_moves_and_those_from_an_unknown_position_must_be_armed() {
        let unknown = Focus { position: None, ..AT_3000 };
        let cases = [
            ("lens.set_focus 3500", AT_3000, true),
            ("lens.set_focus 3501", AT_3000, false),
            ("lens.set_focus 2499", AT_3000, false),
            ("lens.set_focus 3000", unknown, false),
            ("lens.move_focus -500", AT_3000, true),
            ("lens.move_focus -501", AT_3000, false),
            ("lens.move_focus 1", unknown, false),
        ];
        for (text, focus, runs) in cases {
            let mut desk = Desk::default();
            assert_eq!(run(&mut desk, at(0), order(1, Act::Run, text), focus).is_some(), runs, "{text}");
            assert_eq!(run(&mut desk, at(0), order(2, Act::Arm, text), focus), None);
            assert!(run(&mut desk, at(1), order(3, Act::Fire, text), focus).is_some(), "{text}");
        }
    }

    #[test]
    fn what_is_not_there_yet_is_answered_so() {
        let mut desk = Desk::default();
        for definition in super::super::Definition::all().iter().filter(|definition| !definition.available) {
            let mut values = [0.0; super::super::MAX_VALUES];
            values.iter_mut().zip(&definition.parameters).for_each(|(value, parameter)| *value = parameter.low);
            let command = Command::from_wire(definition.code, &values).unwrap();
            let verdict = Verdict::Run(Order { from: FC, counter: 1, act: Act::Run, command });
            assert_eq!(run(&mut desk, at(0), verdict, AT_3000), None);
            assert_eq!(desk.replies.last().unwrap().why, Some(Refusal::NotAvailable));
        }
    }

    #[test]
    fn replies_are_due_until_acknowledged_and_the_last_32_are_kept() {
        let mut desk = Desk::default();
        desk.begin(FC, BootId(1));
        for counter in 1..=20 {
            run(&mut desk, at(0), order(counter, Act::Arm, "service.quit"), AT_3000);
        }
        assert_eq!(desk.replies.due(FC).count(), 32);
        let serial = desk.replies.due(FC).nth(9).unwrap().serial;
        desk.replies.acknowledge(FC, serial);
        desk.replies.acknowledge(FC, serial - 3);
        desk.replies.acknowledge(FC, 1_000_000);
        assert_eq!(desk.replies.due(FC).count(), 22);
        desk.begin(FC, BootId(1));
        assert_eq!(desk.replies.due(FC).count(), 22, "the same boot connects again");
        desk.begin(FC, BootId(2));
        assert_eq!(desk.replies.due(FC).count(), 0, "what another boot was told is not for this one");
        assert_eq!(desk.replies.due(FlightComputer(2)).count(), 32);
    }

    #[test]
    fn a_refusal_that_stands_in_block_after_block_is_told_once() {
        let mut desk = Desk::default();
        let refused = |counter| Verdict::Refused { code: 23, counter, why: Refusal::Replayed, detail: String::new() };
        for counter in [7, 7, 7, 6, 7] {
            desk.take(at(0), FC, refused(counter), AT_3000);
        }
        assert_eq!(desk.counts.refused.get(&Refusal::Replayed), Some(&5));
        assert_eq!(desk.replies.due(FC).count(), 3);
    }
}
