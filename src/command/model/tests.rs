//! The arbitration and the guard against the worst that two flight computers and their links can do: every state of a model is
//! visited, and every step of it runs the code that flies.
//!
//! The model has two computers. Each connects and disconnects, reboots once, goes deaf (our updates no longer arrive there), lies
//! about its uptime once, claims and withdraws, and is given commands by the ground. What it sends, status and block together,
//! is a packet; two packets of each may be on their way at a time, and each may be lost, overtaken, delayed, delivered twice,
//! zeroed, half changed, forged, or come under another boot's name. Time goes in steps of [`STEP`].
//!
//! What disturbs (all but sending, delivering and time) may happen a few times in a history. Ages beyond what a rule looks at are
//! one class, and histories that lead to the same classes are one state.

use super::super::checks::{Check, Checks};
use super::super::guard::{Act, Authenticity, Guard, Sender, Situation, Slot, Verdict};
use super::super::in_charge::{BootId, Epoch, Event, FlightComputer, InCharge, LASTING, LEASE, Tick, UNREST, Uptime};
use super::super::{Command, MAX_VALUES};
use std::collections::hash_map::DefaultHasher;
use std::collections::{HashSet, VecDeque};
use std::hash::{Hash, Hasher};
use std::time::Duration;

/// Longer than a lasting claim takes, shorter than a lease.
const STEP: Duration = Duration::from_secs(2);
/// A link that holds a packet for so long is closed by then.
const HELD: Duration = Duration::from_secs(6);
/// Ground commands are good for this long, s: two steps are too long.
const WINDOW_S: f64 = 3.0;
/// How often something may disturb where a check is left out: the search ends at the first rule that is broken.
const BUDGET_WITHOUT: u8 = 2;
/// Commands that the ground gives a computer in one boot.
const COMMANDS: u32 = 2;
const OURS: BootId = BootId(99);
const COMMAND: Command = Command::StopLens {};

/// What a computer sends at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Packet {
    claims: bool,
    uptime: Duration,
    hears: bool,
    boot: u32,
    epoch: Epoch,
    counter: u32,
    given: Tick,
    sent: Tick,
    /// One that was sent later has arrived.
    overtaken: bool,
}

/// A computer, and what is known of it that no program can know.
#[derive(Debug, Clone)]
struct Computer {
    up: bool,
    boot: u32,
    booted: Tick,
    deaf: bool,
    lies: bool,
    claims: bool,
    counter: u32,
    given: Tick,
    epoch: Epoch,
    flight: Vec<Packet>,
    /// When the camera last heard a claim from it that renews: with both ways of the link alive.
    renewed: Option<Tick>,
    /// Since when it has been heard to claim without a break, and when that last ended.
    claiming: Option<Tick>,
    ended: Option<Tick>,
    /// Whether a true uptime was heard in this boot, and whether one ever ran backwards: a lie, or a packet that was overtaken.
    heard: bool,
    caught: bool,
    /// Blocks of each boot that were delivered.
    blocks: [bool; 2],
    /// Commands of each boot that ran.
    ran: [u8; 2],
}

/// How a packet is delivered.
#[derive(Debug, Clone, Copy, PartialEq)]
enum How {
    Whole,
    Twice,
    Zeroed,
    HalfChanged,
    Forged,
    OtherBoot,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    Time,
    Connect(usize),
    Disconnect(usize),
    Reboot(usize),
    Deafen(usize),
    Lie(usize),
    Claim(usize),
    Give(usize),
    Send(usize),
    Lose(usize, usize),
    Deliver(usize, usize, How),
}

#[derive(Debug, Clone)]
struct World {
    now: Tick,
    budget: u8,
    /// Packets that may be on their way at a time, on one link or on both.
    room: usize,
    charge: InCharge,
    guard: Guard,
    computers: [Computer; 2],
}

fn computer(number: u8) -> Computer {
    Computer {
        up: false,
        boot: 0,
        // Far apart: a status tells the moment of its sender's start no better than it was on its way.
        booted: Duration::from_secs(1000 * (1 + u64::from(number))),
        deaf: false,
        lies: false,
        claims: false,
        counter: 0,
        given: Duration::ZERO,
        epoch: Epoch(0),
        flight: Vec::new(),
        renewed: None,
        claiming: None,
        ended: None,
        heard: false,
        caught: false,
        blocks: [false; 2],
        ran: [0; 2],
    }
}

fn name(who: usize) -> FlightComputer {
    FlightComputer(who as u8 + 1)
}

fn boot_id(who: usize, boot: u32) -> BootId {
    BootId(10 * (who as u32 + 1) + boot)
}

/// A capped age: beyond what any rule looks at, all are one.
fn age(now: Tick, then: Tick, cap: Duration) -> u64 {
    now.saturating_sub(then).min(cap).as_secs()
}

impl World {
    /// Both computers are connected; those that claim, and how many commands each was given.
    fn new(checks: Checks, (budget, room): (u8, usize), claims: [bool; 2], commands: u32) -> Self {
        let now = Duration::from_secs(10_000);
        let (mut charge, guard) = (InCharge::with(checks), Guard::with(checks));
        let mut computers = [computer(0), computer(1)];
        for (who, computer) in computers.iter_mut().enumerate() {
            charge.on(now, Event::Connected { computer: name(who), boot: boot_id(who, 0) });
            computer.up = true;
            computer.claims = claims[who];
            (computer.counter, computer.given) = (commands, now);
        }
        Self { now, budget, room, charge, guard, computers }
    }

    /// Everything that can happen next.
    fn steps(&self) -> Vec<Step> {
        let mut steps = vec![Step::Time];
        for (who, computer) in self.computers.iter().enumerate() {
            if self.budget > 0 {
                steps.push(if computer.up { Step::Disconnect(who) } else { Step::Connect(who) });
                steps.extend([Step::Claim(who), Step::Deafen(who)]);
                steps.extend((computer.boot == 0).then_some(Step::Reboot(who)));
                steps.extend((!computer.lies).then_some(Step::Lie(who)));
                steps.extend((computer.counter < COMMANDS).then_some(Step::Give(who)));
            }
            // A stand-by computer that was given nothing has nothing to say that would change anything.
            let speaks = computer.claims || computer.counter > 0 || self.charge.claims(name(who), self.now);
            let in_flight: usize = self.computers.iter().map(|computer| computer.flight.len()).sum();
            if computer.up && speaks && in_flight < self.room {
                steps.push(Step::Send(who));
            }
            for place in 0..computer.flight.len() {
                steps.push(Step::Lose(who, place));
                let ways = [How::Whole, How::Twice, How::Zeroed, How::HalfChanged, How::Forged, How::OtherBoot];
                steps.extend(ways.map(|how| Step::Deliver(who, place, how)));
            }
        }
        steps
    }

    fn take(&mut self, step: Step) -> Result<(), String> {
        let free = matches!(step, Step::Time | Step::Send(_) | Step::Deliver(..) | Step::Lose(..));
        self.budget -= u8::from(!free);
        match step {
            Step::Time => {
                // As the hub does: it is woken at each deadline on the way.
                let until = self.now + STEP;
                while let Some(deadline) = self.charge.deadline().filter(|deadline| *deadline <= until) {
                    self.now = deadline;
                    self.arbitrate(Event::Time)?;
                }
                self.now = until;
                for computer in &mut self.computers {
                    computer.flight.retain(|packet| until - packet.sent < HELD);
                }
            }
            Step::Connect(who) => {
                self.computers[who].up = true;
                let boot = boot_id(who, self.computers[who].boot);
                self.arbitrate(Event::Connected { computer: name(who), boot })?;
            }
            Step::Disconnect(who) => self.end_link(who)?,
            Step::Reboot(who) => {
                self.end_link(who)?;
                let now = self.now;
                let computer = &mut self.computers[who];
                (computer.boot, computer.booted, computer.counter) = (1, now, 0);
                (computer.lies, computer.caught, computer.claims) = (false, false, false);
                computer.heard = false;
            }
            Step::Deafen(who) => self.computers[who].deaf ^= true,
            Step::Lie(who) => self.computers[who].lies = true,
            Step::Claim(who) => self.computers[who].claims ^= true,
            Step::Give(who) => {
                self.computers[who].counter += 1;
                self.computers[who].given = self.now;
            }
            Step::Send(who) => self.send(who),
            Step::Lose(who, place) => drop(self.computers[who].flight.remove(place)),
            Step::Deliver(who, place, how) => {
                let packet = self.computers[who].flight[place];
                if how != How::Twice {
                    self.computers[who].flight.remove(place);
                }
                self.deliver(who, packet, how)?;
            }
        }
        self.check()
    }

    fn end_link(&mut self, who: usize) -> Result<(), String> {
        if self.computers[who].up {
            self.computers[who].up = false;
            self.computers[who].flight.clear();
            self.note_claim(who, false);
            self.arbitrate(Event::Disconnected(name(who)))?;
        }
        Ok(())
    }

    fn send(&mut self, who: usize) {
        let (now, lease) = (self.now, self.charge.lease());
        let computer = &mut self.computers[who];
        if !computer.deaf {
            computer.epoch = lease.map_or(Epoch(0), |lease| lease.epoch);
        }
        let uptime = if computer.lies { Duration::ZERO } else { now - computer.booted };
        computer.flight.push(Packet {
            claims: computer.claims,
            uptime,
            hears: !computer.deaf,
            boot: computer.boot,
            epoch: computer.epoch,
            counter: computer.counter,
            given: computer.given,
            sent: now,
            overtaken: false,
        });
    }

    /// What an honest listener would write down.
    fn note_claim(&mut self, who: usize, claims: bool) {
        let now = self.now;
        let computer = &mut self.computers[who];
        // A claim that was not renewed in time has ended then, whoever took note of it.
        if let Some(lapsed) = computer.renewed.map(|renewed| renewed + LEASE).filter(|lapsed| now >= *lapsed) {
            (computer.renewed, computer.claiming, computer.ended) = (None, None, Some(lapsed));
        }
        if !claims {
            if computer.claiming.take().is_some() {
                computer.ended = Some(now);
            }
            computer.renewed = None;
        } else {
            computer.renewed = Some(now);
            computer.claiming.get_or_insert(now);
        }
    }

    /// Delivers a packet: the status, then the block.
    fn deliver(&mut self, who: usize, packet: Packet, how: How) -> Result<(), String> {
        let computer = &mut self.computers[who];
        computer.caught |= packet.overtaken || packet.uptime.is_zero() && computer.heard;
        computer.heard |= !packet.uptime.is_zero();
        for other in computer.flight.iter_mut().filter(|other| other.sent < packet.sent) {
            other.overtaken = true;
        }
        if packet.hears || !packet.claims {
            self.note_claim(who, packet.claims);
        }
        let status =
            Event::Status { from: name(who), claims: packet.claims, uptime: Some(packet.uptime), hears_us: packet.hears };
        self.arbitrate(status)?;
        self.block(who, packet, how)
    }

    fn block(&mut self, who: usize, packet: Packet, how: How) -> Result<(), String> {
        let (now, lease) = (self.now, self.charge.lease());
        let computer = &self.computers[who];
        let boot = boot_id(who, packet.boot);
        let delay = if packet.hears { now - packet.sent } else { Duration::MAX };
        let age = packet.sent.saturating_sub(packet.given);
        let mut slot = Slot::new(&COMMAND, Act::Run, packet.counter, age.as_secs_f64());
        let mut sender = Sender {
            computer: name(who),
            boot: boot_id(who, computer.boot),
            block_boot: boot,
            under: Some((OURS, packet.epoch)),
            delay,
            authenticity: Authenticity::NotRequired,
        };
        match how {
            How::Whole | How::Twice => {}
            How::Zeroed => slot = Slot { counter: 0, values: [0.0; MAX_VALUES], seal: 0, ..slot },
            How::HalfChanged => slot.counter += 1,
            How::Forged => {
                sender.authenticity = Authenticity::Failed;
                slot = Slot::new(&COMMAND, Act::Run, packet.counter + 1, 0.0);
            }
            How::OtherBoot => sender.block_boot = boot_id(who, 1 - packet.boot),
        }
        let situation = Situation { lease, ours: OURS, window_s: WINDOW_S };
        let honest = matches!(how, How::Whole | How::Twice);
        for verdict in self.guard.on(&sender, &situation, &[slot]) {
            let Verdict::Run(order) = verdict else { continue };
            let computer = &mut self.computers[who];
            let ran = &mut computer.ran[packet.boot as usize];
            let bit = 1 << order.counter;
            let true_age = now - packet.given;
            let sins = [
                (lease.is_none_or(|lease| lease.computer != name(who)), "without the lease"),
                (lease.is_some_and(|lease| lease.epoch != packet.epoch), "under another lease than it was sent for"),
                (!honest, "out of a packet that was not whole"),
                (*ran & bit != 0, "twice"),
                (!computer.blocks[packet.boot as usize], "in the first block of a boot"),
                (true_age.as_secs_f64() > WINDOW_S, "too late"),
                (!packet.hears, "from a computer that does not hear us"),
            ];
            if let Some((_, sin)) = sins.into_iter().find(|(sinned, _)| *sinned) {
                return Err(format!("{COMMAND} ran {sin}: {how:?} {packet:?}"));
            }
            *ran |= bit;
        }
        if honest {
            self.computers[who].blocks[packet.boot as usize] = true;
        }
        Ok(())
    }

    /// An event of the arbitration; a lease that is granted by it must be due.
    fn arbitrate(&mut self, event: Event) -> Result<(), String> {
        let before = self.charge.lease();
        self.charge.on(self.now, event);
        let after = self.charge.lease();
        let Some(granted) = after.filter(|after| before.is_none_or(|before| before.epoch != after.epoch)) else { return Ok(()) };
        let computer = &self.computers[usize::from(granted.computer.0) - 1];
        let stood = computer.claiming.map_or(Duration::ZERO, |since| self.now - since);
        let rested = computer.ended.is_none_or(|ended| computer.claiming.is_some_and(|since| since - ended >= UNREST));
        if stood < LASTING && !rested {
            return Err(format!("a claim that comes and goes was followed: {granted:?}"));
        }
        Ok(())
    }

    /// What must hold in every state.
    fn check(&mut self) -> Result<(), String> {
        self.charge.on(self.now, Event::Time);
        let Some(lease) = self.charge.lease() else { return Ok(()) };
        let who = usize::from(lease.computer.0) - 1;
        let (holder, other) = (&self.computers[who], &self.computers[1 - who]);
        if holder.renewed.is_none_or(|renewed| self.now - renewed >= LEASE) {
            return Err(format!("a lease that nobody renewed: {lease:?}"));
        }
        let lasts = |computer: &Computer| {
            let renewed = computer.renewed.is_some_and(|renewed| self.now - renewed < LEASE);
            renewed && computer.claiming.is_some_and(|since| self.now - since >= LASTING)
        };
        // A liar that has not been caught is believed.
        let honest = |computer: &Computer| !computer.lies && !computer.caught;
        let better = honest(other) && (holder.caught || honest(holder) && other.booted < holder.booted);
        if lasts(holder) && lasts(other) && better {
            return Err(format!("of two lasting claims the worse one has the lease: {lease:?}"));
        }
        Ok(())
    }

    /// From here, whatever happened: one computer's link comes up, honest, and the other's claim ends. Within 4 s a command runs.
    fn recovers(&self, who: usize) -> Result<(), String> {
        let mut world = self.clone();
        let other = 1 - who;
        world.end_link(other)?;
        world.end_link(who)?;
        let computer = &mut world.computers[who];
        (computer.up, computer.claims, computer.deaf, computer.lies) = (true, true, false, false);
        let boot = boot_id(who, computer.boot);
        let connected = world.now;
        world.arbitrate(Event::Connected { computer: name(who), boot })?;
        while world.now < connected + Duration::from_secs(4) {
            let holds = world.charge.lease().is_some_and(|lease| lease.computer == name(who));
            if holds && world.computers[who].epoch == world.charge.lease().map(|lease| lease.epoch).unwrap_or_default() {
                let before = world.computers[who].ran;
                world.computers[who].counter += 1;
                world.computers[who].given = world.now;
                world.send(who);
                let packet = world.computers[who].flight.remove(0);
                world.deliver(who, packet, How::Whole)?;
                return if world.computers[who].ran == before { Err("an honest command was refused".to_owned()) } else { Ok(()) };
            }
            world.send(who);
            let packet = world.computers[who].flight.remove(0);
            world.deliver(who, packet, How::Whole)?;
            world.now += Duration::from_millis(500);
            world.arbitrate(Event::Time)?;
        }
        Err(format!("{:?} could not command within 4 s", name(who)))
    }

    /// What tells one state from another.
    fn essence(&self) -> u128 {
        let mut hasher = (DefaultHasher::new(), DefaultHasher::new());
        hasher.1.write_u8(1);
        let mut note = |value: u64| {
            hasher.0.write_u64(value);
            hasher.1.write_u64(value);
        };
        note(u64::from(self.budget));
        let epoch = self.charge.epochs;
        let since = |epoch_then: Epoch| u64::from(epoch.0.wrapping_sub(epoch_then.0).min(1)) + 2 * u64::from(epoch_then.0 == 0);
        note(self.charge.lease().map_or(0, |lease| u64::from(lease.computer.0)));
        note(u64::from(self.computers[0].booted < self.computers[1].booted));
        let connected =
            |number: usize| self.charge.peers.iter().find(|peer| peer.computer == name(number)).map(|peer| peer.connected);
        note(u64::from(connected(0) < connected(1)));
        let long = Duration::from_secs(4);
        for (who, computer) in self.computers.iter().enumerate() {
            let flags = [computer.up, computer.deaf, computer.lies, computer.claims, computer.caught];
            note(flags.iter().fold(0, |all, flag| all << 1 | u64::from(*flag)));
            note(u64::from(computer.boot) << 8 | u64::from(computer.counter));
            note(u64::from(computer.heard));
            note(age(self.now, computer.given, long) << 8 | since(computer.epoch));
            note(u64::from(computer.ran[0]) << 16 | u64::from(computer.ran[1]) << 8);
            note(u64::from(computer.blocks[0]) << 1 | u64::from(computer.blocks[1]));
            let optional = |moment: Option<Tick>, cap: Duration| moment.map_or(100, |then| age(self.now, then, cap));
            note(optional(computer.renewed, LEASE) << 16 | optional(computer.claiming, LASTING) << 8);
            note(if computer.claiming.is_some() {
                u64::from(computer.ended.is_none_or(|ended| computer.claiming.unwrap() - ended >= UNREST))
            } else {
                optional(computer.ended, UNREST)
            });
            // Any of them may arrive first.
            let class = |packet: &Packet| {
                let flags = [packet.claims, packet.hears, packet.uptime.is_zero(), packet.overtaken];
                let flags = flags.iter().fold(0, |all, flag| all << 1 | u64::from(*flag));
                let ages = age(self.now, packet.given, long) << 8 | age(self.now, packet.sent, long);
                flags << 40 | u64::from(packet.boot) << 32 | u64::from(packet.counter) << 24 | since(packet.epoch) << 16 | ages
            };
            let mut flight: Vec<u64> = computer.flight.iter().map(class).collect();
            flight.sort_unstable();
            flight.into_iter().for_each(&mut note);
            note(1000);
            if let Some(peer) = self.charge.peers.iter().find(|peer| peer.computer == name(who)) {
                note(match peer.uptime {
                    Uptime::Unsaid => 0,
                    Uptime::Said { .. } => 1,
                    Uptime::Disbelieved => 2,
                });
                match peer.claim {
                    Some(claim) => {
                        note(age(self.now, claim.renewed, LEASE) << 8 | age(self.now, claim.since, LASTING));
                        note(claim.counts_from.saturating_sub(self.now).as_secs());
                    }
                    None => note(2000 + optional(peer.unclaimed, UNREST)),
                }
            }
        }
        self.guard.hash(&mut hasher.0);
        self.guard.hash(&mut hasher.1);
        u128::from(hasher.0.finish()) << 64 | u128::from(hasher.1.finish())
    }
}

/// Visits every state; the numbers of states and steps, or the first history that breaks a rule.
fn explore(checks: Checks, size: (u8, usize), recovery: bool) -> Result<(usize, usize), String> {
    let starts = [([true, false], 0), ([true, false], 1)];
    let mut queue: VecDeque<World> =
        starts.into_iter().map(|(claims, commands)| World::new(checks, size, claims, commands)).collect();
    let mut seen: HashSet<u128> = queue.iter().map(World::essence).collect();
    let mut steps = 0;
    while let Some(world) = queue.pop_front() {
        if recovery {
            (0..2).try_for_each(|who| world.recovers(who)).map_err(|why| format!("{why}, from {world:?}"))?;
        }
        for step in world.steps() {
            let mut next = world.clone();
            next.take(step).map_err(|why| format!("{why}, after {step:?} in {world:?}"))?;
            steps += 1;
            if seen.insert(next.essence()) {
                queue.push_back(next);
            }
        }
    }
    Ok((seen.len(), steps))
}

#[test]
fn no_history_of_faults_breaks_a_rule_and_after_each_an_honest_computer_commands_within_4_s() {
    // Two packets on their way and nothing else that disturbs, and one packet and one disturbance; `scripts/prove model` goes further.
    let more = std::env::var("STARS_MODEL_BUDGET").ok().map_or(0, |text| text.parse().unwrap());
    let mut states = 0;
    for size in [(more, 2), (more + 1, 1)] {
        let (seen, steps) = explore(Checks::default(), size, true).unwrap();
        println!("{} disturbances, {} packets on their way: {seen} states, {steps} steps", size.0, size.1);
        states += seen;
    }
    assert!(states >= 10_000, "{states}");
}

#[test]
fn without_any_one_of_the_checks_a_rule_is_broken() {
    for check in Check::ALL {
        let broken = explore(Checks::all_but(check), (BUDGET_WITHOUT, 2), false);
        let why = broken.expect_err(&format!("nothing breaks without {check:?}"));
        println!("without {check:?}: {}", why.split(" in World").next().unwrap());
    }
}
