//! The state machine and the simulated controller on one line, in made-up time: hours of it in a moment.

use stars::lens::{Action, Control, Event, FocusKept, Known, LensCommand, LensResult, LensState, RequestCounter, Rules};
use stars::settings::{LensSettings, Settings};
use stars::simulate::lens::{Controller, Fault, FaultKind};
use std::collections::BTreeMap;
use std::time::Duration;

pub type Tick = Duration;

/// The flight's own settings.
pub fn settings() -> LensSettings {
    Settings::flight().unwrap().lens
}

pub fn second(seconds: f64) -> Tick {
    Duration::from_secs_f64(seconds)
}

/// Whether a word moves something.
pub fn moves(word: &str) -> bool {
    ["la", "fa", "mf", "in", "ma"].iter().any(|verb| word.starts_with(verb))
}

pub struct World {
    pub now: Tick,
    pub control: Control,
    pub controller: Controller,
    rules: Rules,
    open: bool,
    line: Vec<u8>,
    next: u32,
    /// When each open request was made; and how each ended.
    pending: BTreeMap<u32, (Tick, LensCommand)>,
    pub ended: BTreeMap<u32, LensResult>,
    /// Until when there are faults.
    troubled: Tick,
    /// A stop stands.
    stopped: bool,
}

impl World {
    pub fn new(settings: &LensSettings, seed: u64) -> Self {
        let rules = Rules::of(settings);
        Self {
            now: Tick::ZERO,
            control: Control::new(rules.clone()),
            controller: Controller::new(&settings.simulated, seed),
            rules,
            open: false,
            line: Vec::new(),
            next: 0,
            pending: BTreeMap::new(),
            ended: BTreeMap::new(),
            troubled: Tick::ZERO,
            stopped: false,
        }
    }

    /// One whose lens is known.
    pub fn known(settings: &LensSettings, seed: u64) -> Self {
        let mut world = Self::new(settings, seed);
        world.run_until(second(5.0));
        let state = world.control.state();
        assert_eq!(state.focus, Known::Known(stars::lens::FocusCounts(settings.simulated.start_counts)), "{state:?}");
        assert_eq!(state.aperture, Known::Known(stars::lens::AperturePosition(0)));
        world
    }

    pub fn state(&self) -> LensState {
        self.control.state()
    }

    /// The program is started again, with what it kept of the focus.
    pub fn restart(&mut self, kept: FocusKept) {
        self.control = Control::resuming(self.rules.clone(), kept);
        self.open = false;
        self.line.clear();
        self.exchange(&[]);
    }

    /// Whether no fault is about, and the lens known and at rest.
    pub fn is_calm(&self) -> bool {
        let state = self.control.state();
        self.now >= self.troubled && state.focus.value().is_some() && state.busy.is_none() && state.waiting == 0
    }

    pub fn inject(&mut self, kind: FaultKind, lasts: f64) {
        let until = self.now + second(lasts);
        self.controller.inject(Fault { kind, from: self.now, until });
        self.troubled = self.troubled.max(until);
        self.exchange(&[]);
    }

    pub fn ask(&mut self, command: LensCommand) -> u32 {
        self.next += 1;
        self.pending.insert(self.next, (self.now, command));
        if command == LensCommand::Stop {
            self.stopped = true;
        } else if command.moves() {
            self.stopped = false;
        }
        self.tell(Event::Requests(vec![(RequestCounter(self.next), command)]));
        self.next
    }

    /// Lets time pass until then.
    pub fn run_until(&mut self, until: Tick) {
        let mut steps = 0;
        loop {
            let next = [self.control.deadline(), self.controller.deadline()].into_iter().flatten().min();
            let Some(next) = next.filter(|next| *next <= until) else { break };
            steps = if next <= self.now { steps + 1 } else { 0 };
            assert!(steps < 1000, "asked again and again at {:?}: {:?}", self.now, self.control);
            self.now = self.now.max(next);
            self.exchange(&[]);
            if self.control.deadline().is_some_and(|deadline| deadline <= self.now) {
                self.tell(Event::Time);
            }
        }
        self.now = self.now.max(until);
        self.exchange(&[]);
    }

    /// Lets time pass until the request has ended; how.
    pub fn end_of(&mut self, counter: u32) -> LensResult {
        let limit = self.now + second(3600.0);
        while !self.ended.contains_key(&counter) {
            assert!(self.now < limit, "it never ended: {:?}", self.control);
            self.run_until(self.now + second(0.1));
        }
        self.ended[&counter].clone()
    }

    /// The requests that have not ended, and how long they have taken.
    pub fn overdue(&self) -> Vec<(LensCommand, Duration)> {
        self.pending.values().map(|(since, command)| (*command, self.now - *since)).collect()
    }

    fn exchange(&mut self, bytes: &[u8]) {
        let out = self.controller.on(self.now, bytes);
        if self.open && !self.controller.has_port(self.now) {
            self.open = false;
            self.line.clear();
            self.tell(Event::Lost { why: "gone".to_owned() });
        }
        if !self.open {
            return;
        }
        for byte in out {
            if byte == b'\r' {
                let line = std::mem::take(&mut self.line);
                if !line.is_empty() {
                    self.tell(Event::Line(line));
                }
            } else {
                self.line.push(byte);
            }
        }
    }

    fn tell(&mut self, event: Event) {
        for action in self.control.on(self.now, event) {
            match action {
                Action::Open { nth: 0 } if self.controller.has_port(self.now) => {
                    self.open = true;
                    self.tell(Event::Opened { port: "simulated".to_owned() });
                }
                Action::Open { nth: 0 } => self.tell(Event::NotOpened { why: "not there".to_owned() }),
                Action::Open { .. } => self.tell(Event::NoMorePorts),
                Action::Close => {
                    self.open = false;
                    self.line.clear();
                }
                Action::Send(bytes) => {
                    let word = String::from_utf8(bytes.clone()).unwrap();
                    assert!(!(self.stopped && moves(&word)), "{word:?} after a stop");
                    self.line.clear();
                    self.exchange(&bytes);
                }
                Action::Answer { counter, result } => self.take_answer(counter.0, result),
            }
        }
        self.check();
    }

    fn take_answer(&mut self, counter: u32, result: LensResult) {
        assert!(!self.ended.contains_key(&counter), "request {counter} ended twice");
        if result != LensResult::Started {
            self.pending.remove(&counter).expect("an answer that nobody asked for");
            self.ended.insert(counter, result);
        }
    }

    /// What must hold at any moment.
    fn check(&self) {
        let state = self.control.state();
        if let Known::Known(focus) = state.focus {
            let truth = self.controller.true_motor(self.now);
            let off = (f64::from(focus.0) - truth).abs();
            assert!(off <= f64::from(self.rules.tolerance), "known to be at {focus}, is at {truth}: {:?}", self.control);
        }
        if let Known::Known(aperture) = state.aperture {
            assert_eq!(aperture.0, self.controller.true_aperture(), "{:?}", self.control);
        }
    }
}
