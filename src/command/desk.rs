//! The desk: takes the orders that the guard let through, has hazardous ones armed before they are fired, hands them out, and keeps
//! the replies.
//!
//! An order's way: the guard lets it through → [`Desk::take`] says [`Step::Keep`] → its counter is on disk → [`Desk::kept`] says
//! [`Step::Do`] → its actor reports [`Desk::report`]. Each step leaves a [`Reply`].

use super::definition::Hazard;
use super::dictionary::Command;
use super::guard::{Act, Order, Verdict};
use super::in_charge::{BootId, FlightComputer, Tick};
use super::reply::{Answer, REPLIES, Refusal, Replies, Reply, Stage};
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// An armed command may be fired for this long.
pub const ARMED: Duration = Duration::from_secs(10);
/// Orders that may be under way at a time; those that only stop things may be as many again.
pub const UNDER_WAY: usize = 32;
/// The disk has kept a counter within this time, or the order fails: a command that comes later than that would surprise the ground.
const KEPT_WITHIN: Duration = Duration::from_secs(5);
/// Whoever carries an order out has reported its end within this time, the longest of the settings: learning the focus range with all
/// that is read about it. The autofocus has a time of its own.
const ENDED_WITHIN: Duration = Duration::from_secs(1800);

/// The number of an order here: requests to actors carry it, and their results repeat it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct OrderNumber(pub u32);

/// What the caller is to do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Keep the guard's memory on disk, then call [`Desk::kept`] with this number.
    Keep {
        /// The order.
        number: OrderNumber,
        /// Whether it waits for the disk; otherwise [`Desk::kept`] is called at once.
        waits: bool,
    },
    /// Do it, and call [`Desk::report`] with this number.
    Do(OrderNumber, Command),
}

/// What the desk knows of the lens, to tell a large move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
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
    /// Whether its counter is on disk, or it did not wait for that.
    kept: bool,
    /// When it has failed, if nothing is heard of it; `None` where it has a time of its own.
    until: Option<Tick>,
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
    /// A desk that has to tell what an earlier run of the program had not told yet.
    pub fn after(earlier: Vec<Answer>) -> Self {
        Self { replies: Replies::after(earlier), ..Self::default() }
    }

    /// What would have to be told after a restart now: how commands ended, and that those under way did not end.
    pub fn unanswered(&self) -> Vec<Answer> {
        let broken = self.under_way.iter().map(|UnderWay { order, .. }| {
            let (to, code, counter) = (order.from, order.command.code(), order.counter);
            let (stage, why, detail) =
                (Stage::Failed, Some(Refusal::Restarted), "the program ended before it was done".to_owned());
            self.replies.answer(Reply { serial: 0, to, code, counter, stage, why, detail, at: Tick::ZERO })
        });
        let mut all: Vec<Answer> = self.replies.unanswered().chain(broken).collect();
        all.drain(..all.len().saturating_sub(REPLIES));
        all
    }

    /// A computer connects. What another boot of it was told is not for this one.
    pub fn begin(&mut self, now: Tick, computer: FlightComputer, boot: BootId) {
        if self.replies.begin(now, computer, boot) {
            self.told.retain(|(who, _), _| *who != computer);
        }
    }

    /// Takes a verdict of the guard.
    pub fn take(&mut self, now: Tick, from: FlightComputer, verdict: Verdict, focus: Focus) -> Option<Step> {
        match verdict {
            Verdict::Run(order) => match self.may(now, &order, focus) {
                Ok(()) => {
                    self.last = OrderNumber(self.last.0.wrapping_add(1));
                    let (number, until) = (self.last, Some(now + KEPT_WITHIN));
                    self.under_way.push_back(UnderWay { number, order, kept: false, until });
                    Some(Step::Keep { number, waits: !order.command.only_stops() })
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

    /// The counter of an order is on disk, or could not be brought there. An order that did not wait for it is not told again.
    pub fn kept(&mut self, now: Tick, number: OrderNumber, kept: Result<(), String>) -> Option<Step> {
        let under_way = self.under_way.iter_mut().find(|under_way| under_way.number == number && !under_way.kept)?;
        under_way.kept = true;
        let has_its_own_time =
            matches!(under_way.order.command, Command::RunFocus {} | Command::AdviseFocus {} | Command::Refocus { .. });
        under_way.until = (!has_its_own_time).then_some(now + ENDED_WITHIN);
        let order = under_way.order;
        if let Err(problem) = kept {
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

    /// When to call [`Self::expire`], if nothing happens before.
    pub fn deadline(&self) -> Option<Tick> {
        self.under_way.iter().filter_map(|under_way| under_way.until).min()
    }

    /// Fails the orders of which nothing was heard for too long: a disk that hangs, a part of the program that broke over them.
    pub fn expire(&mut self, now: Tick) {
        let late = |under_way: &&UnderWay| under_way.until.is_some_and(|until| now >= until);
        let late: Vec<(OrderNumber, bool)> =
            self.under_way.iter().filter(late).map(|under_way| (under_way.number, under_way.kept)).collect();
        for (number, kept) in late {
            let (why, after) = if kept { (Refusal::Device, ENDED_WITHIN) } else { (Refusal::NotKept, KEPT_WITHIN) };
            let who = if kept { "nothing was heard of it" } else { "the disk did not keep its counter" };
            self.report(now, number, Stage::Failed, Some(why), format!("{who} within {} s", after.as_secs()));
        }
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
        let room = if order.command.only_stops() { 2 * UNDER_WAY } else { UNDER_WAY };
        if self.under_way.len() >= room {
            return Err((Refusal::Busy, format!("{} commands are under way", self.under_way.len())));
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
        let Some(Step::Keep { number, .. }) = desk.take(now, FC, verdict, focus) else { return None };
        desk.kept(now, number, Ok(()))
    }

    #[test]
    fn an_order_is_kept_before_it_is_done_and_every_stage_is_told() {
        let mut desk = Desk::default();
        let taken = desk.take(at(1), FC, order(1, Act::Run, "lens.set_focus 3030"), AT_3000);
        let Some(Step::Keep { number, waits: true }) = taken else { panic!("{taken:?}") };
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
    fn an_order_whose_counter_cannot_be_kept_fails_and_one_that_only_stops_things_does_not_wait_for_it() {
        let mut desk = Desk::default();
        for (counter, text, waits) in [
            (1, "lens.set_focus 3030", true),
            (2, "lens.stop", false),
            (3, "service.known_good", false),
            (4, "focus.abort 1", true),
        ] {
            let taken = desk.take(at(1), FC, order(counter, Act::Run, text), AT_3000);
            let Some(Step::Keep { number, waits: said }) = taken else { panic!("{taken:?}") };
            assert_eq!(said, waits, "{text}");
            let kept = if waits { Err("disk".to_owned()) } else { Ok(()) };
            assert_eq!(desk.kept(at(1), number, kept).is_some(), !waits, "{text}");
            assert_eq!(desk.kept(at(2), number, Ok(())), None, "{text}: what the disk says later runs nothing again");
        }
        assert_eq!(stages(&desk)[0], (1, Stage::Failed, Some(Refusal::NotKept)));
    }

    #[test]
    fn what_was_not_told_before_a_restart_is_told_after_it_to_the_same_boot_alone() {
        let mut desk = Desk::default();
        desk.begin(at(0), FC, BootId(7));
        for (counter, text) in [(1, "lens.get_focus"), (2, "camera.get_gain"), (3, "lens.flush"), (4, "solver.configure 1 20")] {
            let Some(Step::Do(number, _)) = run(&mut desk, at(1), order(counter, Act::Run, text), AT_3000) else {
                panic!("{text}")
            };
            if counter != 3 {
                desk.report(at(2), number, Stage::Completed, None, format!("{counter} done"));
            }
            if counter == 1 {
                let told = desk.replies.last().unwrap().serial;
                desk.replies.acknowledge(FC, told);
            }
        }
        let kept = desk.unanswered();
        assert_eq!(kept.len(), 3);
        let told = |boot| {
            let mut desk = Desk::after(kept.clone());
            desk.begin(at(0), FlightComputer(2), BootId(7));
            assert_eq!(desk.unanswered(), kept, "another computer has nothing to do with it, and it waits on");
            desk.begin(at(1), FC, BootId(boot));
            let due: Vec<_> = desk.replies.due(FC).map(|reply| (reply.counter, reply.stage, reply.why)).collect();
            assert_eq!(desk.unanswered().len(), due.len());
            due
        };
        let (done, broken) = (Stage::Completed, (3, Stage::Failed, Some(Refusal::Restarted)));
        assert_eq!(told(7), [(2, done, None), (4, done, None), broken]);
        assert_eq!(told(8), []);
    }

    #[test]
    fn an_order_of_which_nothing_is_heard_fails_in_its_time_and_gives_its_place_back() {
        let mut desk = Desk::default();
        let start = |desk: &mut Desk, counter, text| {
            let Some(Step::Keep { number, .. }) = desk.take(at(0), FC, order(counter, Act::Run, text), AT_3000) else { panic!() };
            number
        };
        start(&mut desk, 1, "lens.get_focus");
        let asked = start(&mut desk, 1, "camera.get_gain");
        desk.kept(at(1), asked, Ok(()));
        assert_eq!(desk.deadline(), Some(at(5)));
        desk.expire(at(5));
        assert_eq!(stages(&desk).last(), Some(&(1, Stage::Failed, Some(Refusal::NotKept))));
        assert_eq!(desk.deadline(), Some(at(1801)));
        desk.expire(at(1801));
        assert_eq!(stages(&desk).last(), Some(&(1, Stage::Failed, Some(Refusal::Device))));
        assert_eq!((desk.deadline(), desk.under_way().count()), (None, 0));
    }

    #[test]
    fn as_many_as_may_be_are_under_way_and_a_stop_still_finds_room_though_not_without_end() {
        let mut desk = Desk::default();
        for counter in 1..=40 {
            desk.take(at(0), FC, order(counter, Act::Run, "lens.get_focus"), AT_3000);
        }
        assert_eq!(desk.under_way().count(), UNDER_WAY);
        assert_eq!(desk.replies.last().unwrap().why, Some(Refusal::Busy));
        for counter in 1..=40 {
            desk.take(at(0), FC, order(counter, Act::Run, "lens.stop"), AT_3000);
        }
        assert_eq!(desk.under_way().count(), 2 * UNDER_WAY);
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
    fn replies_are_due_until_acknowledged_and_the_last_32_are_kept() {
        let mut desk = Desk::default();
        desk.begin(at(1), FC, BootId(1));
        for counter in 1..=20 {
            run(&mut desk, at(0), order(counter, Act::Arm, "service.quit"), AT_3000);
        }
        assert_eq!(desk.replies.due(FC).count(), 32);
        let serial = desk.replies.due(FC).nth(9).unwrap().serial;
        desk.replies.acknowledge(FC, serial);
        desk.replies.acknowledge(FC, serial - 3);
        desk.replies.acknowledge(FC, 1_000_000);
        assert_eq!(desk.replies.due(FC).count(), 22);
        desk.begin(at(1), FC, BootId(1));
        assert_eq!(desk.replies.due(FC).count(), 22, "the same boot connects again");
        desk.begin(at(1), FC, BootId(2));
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
