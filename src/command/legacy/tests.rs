//! What the legacy guard lets through and what not, case by case, and with many faults strewn among true commands.

use super::*;
use crate::wire::legacy as wire;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;

/// Place of `set_focus`.
const SET_FOCUS: usize = 11;
/// Time between two blocks, and what a countdown falls by in it.
const PERIOD: Duration = Duration::from_millis(510);
const FALL: u32 = 51;

type Block = [Entry; COMMANDS];

/// A flight computer of old with a link to the guard.
struct World {
    guard: LegacyGuard,
    now: Tick,
    block: Block,
}

impl World {
    /// Connected, with counters that stand anywhere, and the first block sent.
    fn new() -> Self {
        let entry = |index: usize| {
            let mut entry = Entry { countdown: 0, counter: 10 * index as i32 + 7, values: Values::default() };
            entry.values.0[..FLOWN[index].values].fill(1.0);
            entry
        };
        let mut world = Self { guard: LegacyGuard::default(), now: Duration::from_secs(5), block: std::array::from_fn(entry) };
        assert_eq!(world.send(), [], "the first block runs nothing");
        world
    }

    /// The ground gives a command.
    fn give(&mut self, index: usize, value: f64) {
        let entry = &mut self.block[index];
        if FLOWN[index].values > 0 {
            entry.values.0[0] = value;
        }
        entry.countdown = 1500;
        entry.counter = entry.counter.wrapping_add(1);
    }

    /// Time goes by and the block is sent.
    fn send(&mut self) -> Vec<Finding> {
        self.wait(PERIOD);
        self.guard.on(self.now, &self.block)
    }

    /// Time goes by.
    fn wait(&mut self, time: Duration) {
        self.now += time;
        let steps = (time.as_millis() / 10) as u32;
        self.block.iter_mut().for_each(|entry| entry.countdown = entry.countdown.saturating_sub(steps));
    }

    /// Time goes by, and another block than the true one comes.
    fn receive(&mut self, change: impl FnOnce(&mut Block)) -> Vec<Finding> {
        self.wait(PERIOD);
        let mut block = self.block;
        change(&mut block);
        self.guard.on(self.now, &block)
    }

    /// A command is given and runs with the second block; nothing else does.
    fn assert_obeys(&mut self, index: usize, value: f64) {
        self.give(index, value);
        assert_eq!(runs(&self.send()), []);
        assert_eq!(runs(&self.send()), [(index, self.block[index].counter)]);
        assert_eq!(self.send(), []);
    }
}

fn runs(findings: &[Finding]) -> Vec<(usize, i32)> {
    let run = |finding: &Finding| match finding {
        Finding::True { index, counter, .. } => Some((*index, *counter)),
        Finding::Refused { .. } => None,
    };
    findings.iter().filter_map(run).collect()
}

fn reasons(findings: &[Finding]) -> Vec<Refusal> {
    let reason = |finding: &Finding| match finding {
        Finding::True { .. } => None,
        Finding::Refused { why, .. } => Some(*why),
    };
    findings.iter().filter_map(reason).collect()
}

#[test]
fn a_command_runs_once_when_the_next_block_confirms_it() {
    let mut world = World::new();
    world.give(SET_FOCUS, 2345.0);
    assert_eq!(world.send(), []);
    let values = world.block[SET_FOCUS].values;
    assert_eq!(world.send(), [Finding::True { index: SET_FOCUS, counter: 118, values }]);
    for _ in 0..40 {
        assert_eq!(world.send(), []);
    }
    world.assert_obeys(SET_FOCUS, 2345.0);
    world.assert_obeys(8, 9.0);
}

#[test]
fn three_commands_at_once_run_and_four_do_not() {
    let mut world = World::new();
    (0..3).for_each(|index| world.give(index, 0.25));
    assert_eq!(world.send(), []);
    // Three more are announced while these are confirmed.
    (3..6).for_each(|index| world.give(index, 0.25));
    assert_eq!(runs(&world.send()).len(), 3);
    assert_eq!(runs(&world.send()).len(), 3);
    (10..14).for_each(|index| world.give(index, 0.25));
    assert_eq!(reasons(&world.send()), [Refusal::Dialect]);
    assert_eq!(runs(&world.send()), []);
    // They stand there, are not run, and are counted from.
    for _ in 0..4 {
        assert_eq!(runs(&world.send()), []);
    }
    assert_eq!(world.send(), []);
    world.assert_obeys(12, 2.0);
}

#[test]
fn a_zeroed_block_does_nothing_and_is_no_first_block() {
    let zero = |block: &mut Block| *block = [Entry::default(); COMMANDS];
    let mut world = World::new();
    world.give(SET_FOCUS, 1.0);
    world.send();
    assert_eq!(reasons(&world.receive(zero)), [Refusal::Dialect]);
    // The next blocks announce and confirm anew.
    assert_eq!(world.send(), []);
    assert_eq!(runs(&world.send()), [(SET_FOCUS, 118)]);
    world.guard.connected();
    world.receive(zero);
    world.give(SET_FOCUS, 2.0);
    assert_eq!(world.send(), [], "the first block that is not zeroed shows where the counters stand");
    assert_eq!(world.send(), []);
}

#[test]
fn everything_changed_at_once_does_nothing() {
    let mut world = World::new();
    let found = world.receive(|block| {
        block.iter_mut().for_each(|entry| (entry.counter, entry.countdown) = (entry.counter + 1, 1500));
    });
    assert_eq!(reasons(&found), [Refusal::Dialect]);
    assert_eq!(world.send(), []);
    world.assert_obeys(3, 4.0);
}

#[test]
fn what_is_not_confirmed_does_not_run() {
    let counter = |block: &mut Block, by: i32| block[SET_FOCUS].counter += by;
    let announced = |block: &mut Block| (block[SET_FOCUS].countdown, block[SET_FOCUS].values.0[0]) = (1500, 8.0);
    // Gone again.
    let mut world = World::new();
    assert_eq!(world.receive(|block| (counter(block, 1), announced(block)).0), []);
    assert_eq!(reasons(&world.send()), [Refusal::HalfChanged]);
    world.assert_obeys(SET_FOCUS, 5.0);
    // Other values.
    let mut world = World::new();
    world.give(SET_FOCUS, 5.0);
    world.send();
    assert_eq!(reasons(&world.receive(|block| block[SET_FOCUS].values.0[0] = 6.0)), [Refusal::HalfChanged]);
    assert_eq!(runs(&world.send()), [], "once refused it was refused for good");
    // A countdown that stands still, grows, is dead, or was never alive, or longer than there is.
    for (countdowns, why) in [
        ([1449, 1449, 1398], Refusal::Replayed),
        ([1449, 1500, 1449], Refusal::Replayed),
        ([60, 0, 0], Refusal::Stale),
        ([0, 0, 0], Refusal::Stale),
        ([0, 1400, 1349], Refusal::Stale),
        ([2001, 1950, 1899], Refusal::Dialect),
        ([u32::MAX, u32::MAX - 51, u32::MAX - 102], Refusal::Dialect),
    ] {
        let mut world = World::new();
        let mut found = Vec::new();
        for countdown in countdowns {
            found.extend(world.receive(|block| (counter(block, 1), block[SET_FOCUS].countdown = countdown).1));
        }
        assert_eq!(runs(&found), [], "{countdowns:?}");
        assert_eq!(reasons(&found)[0], why, "{countdowns:?}");
    }
    // A counter that went back, or jumped.
    for (by, why) in [(-1, Refusal::Replayed), (-118, Refusal::Replayed), (2, Refusal::Dialect), (100_000, Refusal::Dialect)] {
        let mut world = World::new();
        for countdown in [1500, 1449] {
            let found = world.receive(|block| (counter(block, by), block[SET_FOCUS].countdown = countdown).1);
            assert_eq!(reasons(&found), [why]);
        }
        assert_eq!(world.send(), []);
        world.assert_obeys(SET_FOCUS, 5.0);
    }
}

#[test]
fn values_that_change_alone_do_nothing() {
    let mut world = World::new();
    assert_eq!(reasons(&world.receive(|block| block[SET_FOCUS].values.0[0] = 9.0)), [Refusal::HalfChanged]);
    assert_eq!(reasons(&world.receive(|block| block[SET_FOCUS].values.0[0] = f64::NAN)), [Refusal::HalfChanged]);
    assert_eq!(world.receive(|block| block[SET_FOCUS].values.0[0] = f64::NAN), []);
    assert_eq!(reasons(&world.send()), [Refusal::HalfChanged]);
    world.assert_obeys(SET_FOCUS, 5.0);
}

#[test]
fn a_command_given_again_before_it_was_confirmed_takes_its_place() {
    let mut world = World::new();
    world.give(SET_FOCUS, 5.0);
    world.send();
    world.give(SET_FOCUS, 6.0);
    assert_eq!(reasons(&world.send()), [Refusal::Stopped]);
    assert_eq!(runs(&world.send()), [(SET_FOCUS, 119)]);
    // Twice within one block: which values were meant first cannot be told.
    world.give(SET_FOCUS, 7.0);
    world.give(SET_FOCUS, 8.0);
    for _ in 0..4 {
        assert_eq!(reasons(&world.send()), [Refusal::Dialect]);
    }
    assert_eq!(world.send(), []);
    world.assert_obeys(SET_FOCUS, 9.0);
}

#[test]
fn blocks_that_were_held_up_confirm_nothing_until_time_runs_again() {
    let mut world = World::new();
    world.give(SET_FOCUS, 5.0);
    // 4 s of blocks come in a bunch.
    let mut bunch = Vec::new();
    for _ in 0..8 {
        world.wait(PERIOD);
        bunch.push(world.block);
    }
    for block in &bunch {
        assert_eq!(world.guard.on(world.now, block), []);
    }
    assert_eq!(runs(&world.send()), [(SET_FOCUS, 118)]);
    // 16 s in a bunch: the countdown is dead at its end.
    world.give(SET_FOCUS, 6.0);
    let mut found = Vec::new();
    bunch.clear();
    for _ in 0..32 {
        world.wait(PERIOD);
        bunch.push(world.block);
    }
    bunch.iter().for_each(|block| found.extend(world.guard.on(world.now, block)));
    assert_eq!((runs(&found), reasons(&found).contains(&Refusal::Stale)), (vec![], true));
    // The block that would confirm comes when the command is long stale.
    let mut world = World::new();
    world.give(SET_FOCUS, 6.0);
    world.send();
    let mut late = world.block;
    late[SET_FOCUS].countdown -= FALL;
    world.now += Duration::from_secs(16);
    assert_eq!(reasons(&world.guard.on(world.now, &late)), [Refusal::Stale]);
}

#[test]
fn a_memory_that_is_wiped_and_restored_runs_nothing_twice() {
    for (wiped_for, connects) in [(1, false), (10, false), (60, false), (2, true)] {
        let mut world = World::new();
        world.block[SET_FOCUS].counter = 0;
        world.guard.connected();
        world.send();
        world.assert_obeys(SET_FOCUS, 5.0);
        let before = world.block;
        for _ in 0..wiped_for {
            let found = world.receive(|block| (block[SET_FOCUS].counter, block[SET_FOCUS].countdown) = (0, 0));
            assert_eq!(runs(&found), []);
        }
        if connects {
            world.guard.connected();
            assert_eq!(world.receive(|block| block[SET_FOCUS].counter = 0), []);
        }
        world.block = before;
        world.block[SET_FOCUS].countdown = 1000;
        for _ in 0..10 {
            assert_eq!(runs(&world.send()), [], "wiped for {wiped_for}");
        }
    }
}

#[test]
fn a_counter_that_went_back_for_good_is_counted_from_when_every_countdown_is_dead() {
    let mut world = World::new();
    world.block[SET_FOCUS].counter = 3;
    world.give(SET_FOCUS, 4.0);
    for _ in 0..39 {
        assert_eq!(reasons(&world.send()), [Refusal::Replayed]);
    }
    world.send();
    world.send();
    world.assert_obeys(SET_FOCUS, 6.0);
}

/// A fault in a block: each breaks one rule by construction.
fn spoil(kind: u32, block: &mut Block, earlier: &[Block], rng: &mut ChaCha8Rng) {
    let place = rng.random_range(0..COMMANDS);
    let other = &mut block[place];
    match kind {
        0 => *block = [Entry::default(); COMMANDS],
        1 => block.iter_mut().for_each(|entry| (entry.counter, entry.countdown) = (entry.counter + 1, 1500)),
        2 => (0..4).for_each(|next| {
            let entry = &mut block[(place + next) % COMMANDS];
            (entry.counter, entry.countdown) = (entry.counter + 1, rng.random_range(1..=1500));
        }),
        3 => (other.counter, other.countdown) = (other.counter + 1, 0),
        4 => (other.counter, other.countdown) = (other.counter + 1, rng.random_range(LONGEST_COUNTDOWN + 1..=u32::MAX)),
        5 => (other.counter, other.countdown) = (other.counter + rng.random_range(2..=1000), rng.random_range(1..=1500)),
        6 => (other.counter, other.countdown) = (other.counter - rng.random_range(1..=1000), rng.random_range(1..=1500)),
        7 => {
            // `set_focus` to `set_autofocus_range`: the first two have a value of four bytes.
            let entry = &mut block[SET_FOCUS + place % 2];
            entry.values.0[0] += f64::from(rng.random_range(1..1000));
        }
        // Never confirmed: it comes again with the same countdown, or the next block has the counter of before.
        8 => (other.counter, other.countdown) = (other.counter + 1, rng.random_range(1..=1500)),
        // A block of before.
        _ => *block = earlier[rng.random_range(0..earlier.len())],
    }
}

/// How many kinds of fault there are.
const FAULTS: u32 = 10;
/// Blocks of before that may come again.
const EARLIER: usize = 16;

/// A block as it arrives: as bytes, in the struct that flew.
fn over_the_wire(block: &Block) -> Block {
    let sent = wire::Block {
        in_charge: true,
        counter_fcp: -1,
        observer: None,
        horizontal: None,
        equatorial: None,
        motion: None,
        commands: *block,
    };
    let received = wire::Block::unpack(&sent.pack()).unwrap().commands;
    assert_eq!(received, *block);
    received
}

/// `STARS_BLOCKS`: how many blocks are spoilt; a hundredth as many commands are true.
#[test]
fn of_many_spoilt_blocks_none_runs_and_each_true_command_among_them_runs_once() {
    let spoilt: u32 = std::env::var("STARS_BLOCKS").ok().and_then(|count| count.parse().ok()).unwrap_or(100_000);
    let mut rng = ChaCha8Rng::seed_from_u64(20_261);
    let mut world = World::new();
    let mut earlier = VecDeque::from([world.block]);
    let (mut given, mut ran, mut refused, mut blocks) = (0u32, 0u32, 0u64, 0u32);
    let mut check = |findings: &[Finding], wanted: Option<(usize, i32)>| {
        ran += wanted.is_some() as u32;
        assert_eq!(runs(findings), wanted.into_iter().collect::<Vec<_>>());
        refused += reasons(findings).len() as u64;
    };
    while blocks < spoilt || given < spoilt / 100 {
        // Faults, each followed by the truth so that it does not last.
        for _ in 0..50 {
            let kind = rng.random_range(0..FAULTS);
            let mut changed = world.block;
            spoil(kind, &mut changed, earlier.make_contiguous(), &mut rng);
            world.now += PERIOD;
            let changed = over_the_wire(&changed);
            check(&world.guard.on(world.now, &changed), None);
            // The same once more, word for word, as a link that repeats would.
            world.now += PERIOD;
            check(&world.guard.on(world.now, &changed), None);
            check(&world.send(), None);
            blocks += 2;
        }
        // A true command, with a fault before it, or between the two blocks that it takes.
        let index = rng.random_range(0..COMMANDS);
        world.give(index, f64::from(given % 200));
        given += 1;
        check(&world.send(), None);
        if rng.random_bool(0.5) {
            let kind = rng.random_range(0..2);
            let found = world.receive(|block| spoil(kind, block, &[], &mut rng));
            check(&found, None);
            blocks += 1;
            check(&world.send(), None);
        }
        world.block = over_the_wire(&world.block);
        let confirmed = world.send();
        check(&confirmed, Some((index, world.block[index].counter)));
        earlier.push_back(world.block);
        if earlier.len() > EARLIER {
            earlier.pop_front();
        }
    }
    println!("{blocks} spoilt blocks: none ran, {refused} refusals; {given} true commands: {ran} ran, each once");
    assert_eq!(given, ran);
    assert!(refused > u64::from(blocks) / 2);
}
