//! Command blocks of the native dialect, over the wire: each broken in one way by construction, honest ones strewn in.

use bytes::BytesMut;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use stars::command::{
    Act, Authenticity, BootId, Command, Definition, Event, FlightComputer, Guard, InCharge, Key, MAX_VALUES, Refusal, Sender,
    Situation, Slot, Verdict,
};
use stars::wire::{CommandSlot, Commands, List, Message, decode_all};
use std::collections::BTreeMap;
use std::time::Duration;

const OURS: u32 = 0xA1B2_C3D4;
const WINDOW_S: f64 = 15.0;

/// How a block is broken.
const BREAKS: [&str; 14] = [
    "zeroed",
    "replayed",
    "other values under the same counter",
    "stale",
    "from the future",
    "half changed",
    "of another boot",
    "under another lease",
    "of another run of ours",
    "not in charge",
    "out of range",
    "unknown",
    "delayed",
    "forged",
];

/// What came of all of them.
#[derive(Debug, Default)]
pub struct Tally {
    /// Broken blocks, by how they are broken.
    pub broken: BTreeMap<&'static str, u64>,
    /// Broken blocks of which a command ran, with the first of them.
    pub ran: Vec<String>,
    /// Honest blocks given, and how many of them ran exactly once.
    pub honest: u64,
    pub honest_once: u64,
    /// Reasons given.
    pub refused: BTreeMap<Refusal, u64>,
}

struct World {
    random: ChaCha8Rng,
    guard: Guard,
    charge: InCharge,
    key: Key,
    boot: u32,
    /// The next counter of each command.
    next: BTreeMap<u8, u32>,
    /// The last honest blocks.
    given: Vec<Slot>,
}

/// A block as it arrives, and what is true of its way.
struct Arrival {
    from: u8,
    block: Commands,
    delay: Duration,
    forged: bool,
}

impl World {
    fn new(seed: u64) -> Self {
        let mut charge = InCharge::default();
        for (computer, claims) in [(1, true), (2, false)] {
            let computer = FlightComputer(computer);
            charge.on(Duration::ZERO, Event::Connected { computer, boot: BootId(7) });
            charge.on(Duration::ZERO, Event::Status { from: computer, claims, uptime: None, hears_us: true });
        }
        let key = Key::parse(&"5a".repeat(32)).unwrap();
        let random = ChaCha8Rng::seed_from_u64(seed);
        let mut world = Self { random, guard: Guard::default(), charge, key, boot: 7, next: BTreeMap::new(), given: Vec::new() };
        world.reboot();
        world
    }

    /// The computer starts anew; its first block seeds.
    fn reboot(&mut self) {
        self.boot = self.boot.wrapping_add(1);
        self.next.clear();
        self.given.clear();
        let block = self.block(&[]);
        self.arrive(Arrival { from: 1, block, delay: Duration::ZERO, forged: false });
    }

    fn epoch(&self) -> u32 {
        self.charge.lease().unwrap().epoch.0
    }

    fn block(&self, slots: &[Slot]) -> Commands {
        let slots: Vec<CommandSlot> = slots.iter().map(CommandSlot::new).collect();
        Commands {
            boot_id: self.boot.into(),
            camera_boot_id: OURS.into(),
            lease_epoch: self.epoch().into(),
            last_update_sequence: Some(1u32).into(),
            slots_count: slots.len() as u8,
            slots: List::from_slice(&slots),
            ..Commands::default()
        }
    }

    /// A true command with a new counter.
    fn fresh(&mut self) -> Slot {
        let all = Definition::all();
        let definition = &all[self.random.random_range(0..all.len())];
        let mut values = [0.0; MAX_VALUES];
        for (value, parameter) in values.iter_mut().zip(&definition.parameters) {
            let between = self.random.random_range(parameter.low..=parameter.high);
            *value = if parameter.allows(between) { between } else { between.round() };
        }
        let command = Command::from_wire(definition.code, &values).unwrap();
        let counter = self.next.entry(definition.code).or_insert(0);
        *counter += self.random.random_range(1..3);
        let counter = *counter;
        Slot::new(&command, Act::Run, counter, self.random.random_range(0.0..WINDOW_S / 2.0))
    }

    fn resealed(slot: Slot) -> Slot {
        Slot { seal: Slot::seal_of(slot.code, slot.act, slot.counter, &slot.values), ..slot }
    }

    /// Over the wire, to the guard: what it says of the block.
    fn arrive(&mut self, arrival: Arrival) -> Vec<Verdict> {
        let signed = arrival.block.signed(&self.key);
        let mut frame = BytesMut::new();
        Message::Commands(Box::new(signed)).encode(&mut frame).unwrap();
        let Some(Ok(Message::Commands(block))) = decode_all(&frame).pop() else { panic!("a block that is none") };
        let tag = block.tag().filter(|tag| !arrival.forged && self.key.verifies(&block.tagged_bytes(), tag));
        let sender = Sender {
            computer: FlightComputer(arrival.from),
            boot: BootId(self.boot),
            block_boot: BootId(block.boot_id.get()),
            under: Some(block.under()),
            delay: arrival.delay,
            authenticity: if tag.is_some() { Authenticity::Shown } else { Authenticity::Failed },
        };
        let now = Situation { lease: self.charge.lease(), ours: BootId(OURS), window_s: WINDOW_S };
        self.guard.on(&sender, &now, &block.slots())
    }

    /// A block that is broken in the given way.
    fn broken(&mut self, how: &str) -> Arrival {
        let mut slot = self.fresh();
        let mut arrival = Arrival { from: 1, block: Commands::default(), delay: Duration::ZERO, forged: false };
        let other = self.random.random_range(1..u32::MAX);
        match how {
            "zeroed" => return arrival,
            "replayed" | "other values under the same counter" if self.given.is_empty() => slot.seal ^= other,
            "replayed" => slot = self.given[self.random.random_range(0..self.given.len())],
            "other values under the same counter" => {
                slot = self.given[self.random.random_range(0..self.given.len())];
                slot.values[self.random.random_range(0..MAX_VALUES)] += f64::from(other);
                slot = Self::resealed(slot);
            }
            "stale" => slot.age_s = self.random.random_range(WINDOW_S + 1e-6..1e6),
            "from the future" => slot.age_s = -self.random.random_range(1e-6..1e6),
            "half changed" => match self.random.random_range(0..4) {
                0 => slot.counter ^= other,
                1 => slot.code ^= (other % 255 + 1) as u8,
                2 => slot.act = if slot.act == Act::Run { Act::Fire } else { Act::Run },
                _ => slot.values[self.random.random_range(0..MAX_VALUES)] += f64::from(other),
            },
            "not in charge" => arrival.from = 2,
            "out of range" => {
                let count = Definition::of_code(slot.code).unwrap().parameters.len();
                // A value that the command does not have is out of range too.
                let place = self.random.random_range(0..(count + 1).min(MAX_VALUES));
                slot.values[place] = 5e9 + f64::from(other);
                slot = Self::resealed(slot);
            }
            "unknown" => {
                slot.code = 200 + (other % 50) as u8;
                let counter = self.next.entry(slot.code).or_insert(0);
                *counter += 1;
                slot.counter = *counter;
                slot = Self::resealed(slot);
            }
            "delayed" => arrival.delay = Duration::from_secs_f64(self.random.random_range(WINDOW_S..1e6) + 1e-6),
            "forged" => arrival.forged = true,
            _ => {}
        }
        arrival.block = self.block(&[slot]);
        match how {
            "of another boot" => arrival.block.boot_id = (self.boot ^ other).into(),
            "under another lease" => arrival.block.lease_epoch = (self.epoch() ^ other).into(),
            "of another run of ours" => arrival.block.camera_boot_id = (OURS ^ other).into(),
            _ => {}
        }
        arrival
    }
}

/// Sends so many broken blocks, and an honest one after each `every` of them on the average.
pub fn send(blocks: u64, every: u32, seed: u64) -> Tally {
    let mut world = World::new(seed);
    let mut tally = Tally::default();
    let note = |tally: &mut Tally, verdicts: &[Verdict]| {
        for verdict in verdicts {
            if let Verdict::Refused { why, .. } = verdict {
                *tally.refused.entry(*why).or_default() += 1;
            }
        }
    };
    for number in 0..blocks {
        let how = BREAKS[world.random.random_range(0..BREAKS.len())];
        let arrival = world.broken(how);
        let verdicts = world.arrive(arrival);
        *tally.broken.entry(how).or_default() += 1;
        if verdicts.iter().any(|verdict| matches!(verdict, Verdict::Run(_))) {
            tally.ran.push(format!("block {number}, {how}: {verdicts:?}"));
        }
        note(&mut tally, &verdicts);
        if world.random.random_range(0..every) == 0 {
            if world.random.random_range(0..50) == 0 {
                world.reboot();
            }
            let slot = world.fresh();
            world.given.push(slot);
            if world.given.len() > 64 {
                world.given.remove(0);
            }
            // A block is sent again for as long as its command matters.
            let runs: usize = (0..3)
                .map(|_| {
                    let block = world.block(&[slot]);
                    let verdicts = world.arrive(Arrival { from: 1, block, delay: Duration::from_millis(600), forged: false });
                    verdicts
                        .iter()
                        .filter(|verdict| matches!(verdict, Verdict::Run(order) if order.counter == slot.counter))
                        .count()
                })
                .sum();
            tally.honest += 1;
            tally.honest_once += u64::from(runs == 1);
        }
    }
    tally
}
