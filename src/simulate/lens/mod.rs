//! A simulated lens controller: the language, the motor behind it, and what may be wrong with either.
//!
//! No clock and no port: bytes come in and go out with the time, and [`Controller::deadline`] says when it wants to be asked
//! again. It counts in its own way, from wherever it was switched on, as a real one does; what it has learned of the stops makes
//! positions of that. It does one word after the other, in the order in which they came.

mod fault;
mod mechanics;

pub use fault::{Fault, FaultKind, LATE, LOST_COUNTS, SLIP_COUNTS, parse_faults};

use crate::command::Tick;
use crate::settings::SimulatedLensSettings;
use mechanics::Mechanics;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::VecDeque;
use std::time::Duration;

/// What it says of its version.
const VERSION: &str = "s:simulated 1.0";
/// Its reply when the range is learned.
const LEARNED: &str = "DONE:LA";
/// Furthest position of the aperture: fully closed.
const APERTURE_RANGE: i32 = 22;
/// From a word to its reply, where nothing moves.
const LATENCY: Duration = Duration::from_millis(20);
/// From the end of a move to its reply.
const SETTLING: Duration = Duration::from_millis(100);
/// A move of the aperture takes this long.
const APERTURE_MOVE: Duration = Duration::from_millis(300);
/// After this long without turning, a motor that should turn is given up.
const STUCK_FOR: Duration = Duration::from_secs(1);
/// It starts up for this long after its power comes back.
const START_UP: Duration = Duration::from_millis(500);
/// Longest word that it takes, bytes; more is thrown away.
const LONGEST_WORD: usize = 64;
/// Most words that are remembered for [`Controller::received`].
const REMEMBERED: usize = 4096;
/// What the wires pick up while the power comes back.
const NOISE: &[u8] = b"\xfe\x00";

/// A word that came, and when.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Received {
    /// When its carriage return came.
    pub at: Tick,
    /// The word, without its carriage return.
    pub word: String,
}

/// Something that is done, to be answered at its end.
#[derive(Debug, Clone)]
struct Work {
    ends: Tick,
    reply: Vec<u8>,
    then: Then,
}

/// What happens at the end of what is done.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Then {
    Nothing,
    /// The count jumps.
    Jump,
    /// The near stop is reached: its count is noted, and on to the far one.
    NearStop,
    /// The far stop is reached: its count is noted, and the one of the near stop with it.
    FarStop(i32),
}

/// The controller and its lens.
#[derive(Debug, Clone)]
pub struct Controller {
    speedup: f64,
    mechanics: Mechanics,
    /// The controller's count is the motor's position plus this.
    offset: i32,
    /// The controller's counts at the near and the far stop.
    learned: Option<(i32, i32)>,
    aperture: i32,
    aperture_ready: bool,
    input: Vec<u8>,
    words: VecDeque<String>,
    work: Option<Work>,
    /// Replies on their way, in order.
    replies: VecDeque<(Tick, Vec<u8>)>,
    faults: Vec<Fault>,
    /// Faults that have begun.
    begun: Vec<Fault>,
    up_from: Tick,
    received: VecDeque<Received>,
    dice: ChaCha8Rng,
}

impl Controller {
    /// A controller that has learned its range and stands where the settings say.
    pub fn new(settings: &SimulatedLensSettings, seed: u64) -> Self {
        let range = f64::from(settings.range_counts);
        let at = f64::from(settings.start_counts);
        let speed = settings.speed_counts_s * settings.speedup;
        // Where the count begins is of no meaning; that it is not at the stop shows that readings are taken from there.
        let offset = -137;
        Self {
            speedup: settings.speedup,
            mechanics: Mechanics::new(range, at, speed, settings.backlash_counts),
            offset,
            learned: Some((offset, settings.range_counts + offset)),
            aperture: 0,
            aperture_ready: true,
            input: Vec::new(),
            words: VecDeque::new(),
            work: None,
            replies: VecDeque::new(),
            faults: Vec::new(),
            begun: Vec::new(),
            up_from: Tick::ZERO,
            received: VecDeque::new(),
            dice: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// Adds a fault.
    pub fn inject(&mut self, fault: Fault) {
        self.faults.push(fault);
    }

    /// Where the optics truly are, counts from the near stop: what the sharpness of an image depends on.
    pub fn true_focus(&self, now: Tick) -> f64 {
        self.mechanics.optics(now)
    }

    /// Where the motor truly is, counts from the near stop: what a right reading says.
    pub fn true_motor(&self, now: Tick) -> f64 {
        self.mechanics.motor(now)
    }

    /// Where the aperture truly is.
    pub fn true_aperture(&self) -> i32 {
        self.aperture
    }

    /// The words that came, oldest first.
    pub fn received(&self) -> impl Iterator<Item = &Received> {
        self.received.iter()
    }

    /// Whether its port is there.
    pub fn has_port(&self, now: Tick) -> bool {
        !self.has(FaultKind::Vanished, now)
    }

    /// Takes the bytes that came, if any; gives those that it sends now.
    pub fn on(&mut self, now: Tick, bytes: &[u8]) -> Vec<u8> {
        self.note_faults(now);
        let deaf = now < self.up_from || self.has(FaultKind::Silent, now) || self.has(FaultKind::PowerCycle, now);
        for byte in bytes.iter().filter(|_| !deaf) {
            self.take_byte(now, *byte);
        }
        self.go_on(now);
        let mut out = Vec::new();
        while let Some((_, reply)) = self.replies.pop_front_if(|(at, _)| *at <= now) {
            if !deaf && self.has_port(now) {
                out.extend(reply);
            }
        }
        out
    }

    /// When to ask again, if nothing comes before.
    pub fn deadline(&self) -> Option<Tick> {
        let stalled = self.begun.iter().filter(|fault| fault.kind == FaultKind::Stall).map(|fault| fault.until).max();
        let work = self.work.as_ref().map(|work| work.ends.max(stalled.unwrap_or_default()));
        let reply = self.replies.front().map(|(at, _)| *at);
        let waiting = stalled.filter(|_| !self.words.is_empty());
        let faults = self.faults.iter().map(|fault| fault.from);
        let ends = self.begun.iter().map(|fault| fault.until);
        [work, reply, waiting].into_iter().flatten().chain(faults).chain(ends).min()
    }

    fn scaled(&self, time: Duration) -> Duration {
        time.div_f64(self.speedup)
    }

    fn has(&self, kind: FaultKind, now: Tick) -> bool {
        self.begun.iter().any(|fault| fault.kind == kind && now < fault.until)
    }

    /// Begins and ends faults.
    fn note_faults(&mut self, now: Tick) {
        let (begin, wait): (Vec<Fault>, Vec<Fault>) = self.faults.drain(..).partition(|fault| fault.from <= now);
        self.faults = wait;
        for fault in begin {
            match fault.kind {
                FaultKind::PowerCycle => self.lose_power(now, fault.until),
                FaultKind::CountsLost => self.offset -= LOST_COUNTS,
                _ => {}
            }
            self.begun.push(fault);
        }
        self.begun.retain(|fault| now < fault.until);
    }

    fn lose_power(&mut self, now: Tick, until: Tick) {
        self.mechanics.halt(now);
        self.offset = -(libm::round(self.mechanics.motor(now)) as i32);
        (self.learned, self.aperture_ready, self.work) = (None, false, None);
        self.input.clear();
        self.words.clear();
        self.replies.clear();
        self.up_from = until + self.scaled(START_UP);
        self.replies.push_back((self.up_from, NOISE.to_vec()));
    }

    fn take_byte(&mut self, now: Tick, byte: u8) {
        if byte != b'\r' {
            if self.input.len() < LONGEST_WORD {
                self.input.push(byte);
            }
            return;
        }
        let word = String::from_utf8_lossy(&std::mem::take(&mut self.input)).into_owned();
        if self.received.len() == REMEMBERED {
            self.received.pop_front();
        }
        self.received.push_back(Received { at: now, word: word.clone() });
        self.words.push_back(word);
    }

    /// Ends what has ended, and begins with what waits.
    fn go_on(&mut self, now: Tick) {
        while !self.has(FaultKind::Stall, now) {
            if let Some(work) = self.work.take_if(|work| work.ends <= now) {
                self.end(now, work);
                continue;
            }
            if self.work.is_some() {
                return;
            }
            let Some(word) = self.words.pop_front() else { return };
            self.begin(now, &word);
        }
    }

    fn end(&mut self, now: Tick, work: Work) {
        match work.then {
            Then::Nothing => {}
            Then::Jump => self.offset -= LOST_COUNTS,
            Then::NearStop => {
                let takes = self.mechanics.drive(now, self.mechanics.range()) + self.scaled(SETTLING);
                self.work = Some(Work { ends: now + takes, then: Then::FarStop(self.count(now)), ..work });
                return;
            }
            Then::FarStop(near) => self.learned = Some((near, self.count(now))),
        }
        self.reply(now, work.reply);
    }

    fn reply(&mut self, now: Tick, mut text: Vec<u8>) {
        if text.is_empty() {
            return;
        }
        text.push(b'\r');
        if self.has(FaultKind::Garbled, now) {
            self.garble(&mut text);
        }
        let late = if self.has(FaultKind::Late, now) { self.scaled(LATE) } else { Duration::ZERO };
        // The line keeps the order.
        let at = (now + late).max(self.replies.back().map_or(Tick::ZERO, |(at, _)| *at));
        self.replies.push_back((at, text));
    }

    fn garble(&mut self, text: &mut Vec<u8>) {
        let place = self.dice.random_range(0..text.len());
        match self.dice.random_range(0..3) {
            0 => drop(text.remove(place)),
            1 => text.insert(place, self.dice.random()),
            _ => text.iter_mut().skip(place).take(1).for_each(|byte| *byte = self.dice.random()),
        }
    }

    /// Begins with a word.
    fn begin(&mut self, now: Tick, word: &str) {
        if word.is_empty() {
            return; // A bare carriage return.
        }
        let (verb, number) = word.split_at_checked(2).unwrap_or((word, ""));
        let refused = (self.scaled(LATENCY), "ERR1".to_owned());
        let number = if number.is_empty() { Some(None) } else { number.parse::<i32>().ok().map(Some) };
        let (takes, reply) = match (verb, number) {
            _ if self.has(FaultKind::Error, now) => (self.scaled(LATENCY), "ERR9".to_owned()),
            ("vs", Some(None)) => (self.scaled(LATENCY), VERSION.to_owned()),
            ("fp", Some(None)) => (self.scaled(LATENCY), self.read_focus(now)),
            ("la", Some(None)) => self.learn(now),
            ("fa", Some(Some(to))) => self.move_focus(now, |near, _| i64::from(near) + i64::from(to)),
            ("mf", Some(Some(by))) => self.move_focus(now, |_, at| i64::from(at) + i64::from(by)),
            ("in", Some(None)) => {
                self.aperture_ready = true;
                self.aperture = 0;
                (self.scaled(APERTURE_MOVE), "DONE".to_owned())
            }
            ("pa", Some(None)) if self.aperture_ready => (self.scaled(LATENCY), format!("{},f{}", self.aperture, self.aperture)),
            ("ma", Some(Some(to))) if self.aperture_ready && (0..=APERTURE_RANGE).contains(&to) => {
                self.aperture = to;
                (self.scaled(APERTURE_MOVE), format!("DONE{to},f{to}"))
            }
            _ => refused,
        };
        let then = match verb {
            "fa" | "mf" if self.has(FaultKind::CountsLostMoving, now) => Then::Jump,
            "la" if reply == LEARNED => Then::NearStop,
            _ => Then::Nothing,
        };
        self.work = Some(Work { ends: now + takes, reply: reply.into_bytes(), then });
    }

    /// The controller's own count.
    fn count(&self, now: Tick) -> i32 {
        (libm::round(self.mechanics.motor(now)) as i32).saturating_add(self.offset)
    }

    fn read_focus(&self, now: Tick) -> String {
        let (near, far) = self.learned.unwrap_or((0, 0));
        format!("fmin:{near}  fmax:{far}  current:{}", self.count(now))
    }

    /// Drives to both stops, first to the near one, and stays at the far one.
    fn learn(&mut self, now: Tick) -> (Duration, String) {
        if self.has(FaultKind::StuckMotor, now) {
            return (self.scaled(STUCK_FOR), "ERR5".to_owned());
        }
        self.learned = None;
        (self.mechanics.drive(now, 0.0), LEARNED.to_owned())
    }

    /// Moves to where `target` says, of the count at the near stop and of the count now.
    fn move_focus(&mut self, now: Tick, target: impl Fn(i32, i32) -> i64) -> (Duration, String) {
        let Some((near, _)) = self.learned else { return (self.scaled(LATENCY), "ERR2".to_owned()) };
        let at = self.count(now);
        if self.has(FaultKind::StuckMotor, now) {
            return (self.scaled(STUCK_FOR), format!("DONE{},1", at.saturating_sub(near)));
        }
        let way = (target(near, at) - i64::from(at)) as f64;
        let short = if self.has(FaultKind::Slip, now) { f64::from(SLIP_COUNTS).min(way.abs()).copysign(way) } else { 0.0 };
        let goal = self.mechanics.motor(now) + way - short;
        let takes = self.mechanics.drive(now, goal);
        let reached = libm::round(goal.clamp(0.0, self.mechanics.range())) as i32 + self.offset - near;
        let stopped = i32::from(goal <= 0.0 || goal >= self.mechanics.range());
        (takes + self.scaled(SETTLING), format!("DONE{reached},{stopped}"))
    }
}

#[cfg(test)]
mod tests;
