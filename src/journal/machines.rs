//! The machines without pixels, run again: arbitration, guards, desk, lens and autofocus.

use super::entry::{Begin, Entry, What};
use super::outcome::mark;
use crate::command::{Desk, FlightComputer, Guard, InCharge, legacy::LegacyGuard};
use crate::lens::Control;
use crate::lens::autofocus::{Autofocus, AutofocusRules};
use crate::settings::Settings;
use std::collections::BTreeMap;
use std::fmt::Debug;

/// A machine that is run again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Machine {
    /// Who may command.
    Charge,
    /// Which commands are true ones.
    Guard,
    /// The same for the legacy dialect.
    LegacyGuard,
    /// What becomes of orders.
    Desk,
    /// The autofocus.
    Autofocus,
    /// The lens's controller.
    Lens,
}

impl Machine {
    /// Its name in a report.
    pub fn name(self) -> &'static str {
        match self {
            Self::Charge => "in charge",
            Self::Guard => "guard",
            Self::LegacyGuard => "legacy guard",
            Self::Desk => "desk",
            Self::Autofocus => "autofocus",
            Self::Lens => "lens",
        }
    }
}

/// What running an entry again has shown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Seen {
    /// The machine answered as it did.
    Same(Machine),
    /// It did not.
    Differs {
        /// Which.
        machine: Machine,
        /// What it answers now, in words.
        now: String,
    },
    /// Nothing can be said: entries before it are missing.
    Unknown(Machine),
    /// It is no entry of these machines.
    Other,
}

/// The machines of one run of the service.
#[derive(Debug)]
pub struct Machines {
    charge: InCharge,
    guard: Guard,
    legacy: BTreeMap<FlightComputer, LegacyGuard>,
    desk: Desk,
    autofocus: Option<Autofocus>,
    control: Option<Control>,
    /// All was seen that they were told since the run began; the lens since its machine was made.
    whole: bool,
    lens_whole: bool,
}

impl Machines {
    /// Those of a journal whose beginning is not there: nothing is known of them until they begin.
    pub fn unknown() -> Self {
        Self {
            charge: InCharge::default(),
            guard: Guard::default(),
            legacy: BTreeMap::new(),
            desk: Desk::default(),
            autofocus: None,
            control: None,
            whole: false,
            lens_whole: false,
        }
    }

    /// Those of a run that begins, by its settings.
    pub fn begin(begin: &Begin, settings: &Settings) -> Self {
        Self {
            charge: InCharge::after(begin.epoch),
            guard: Guard::new(begin.counters.clone()),
            desk: Desk::after(begin.answers.clone()),
            autofocus: Some(Autofocus::knowing(AutofocusRules::new(&settings.focus), &begin.learned)),
            whole: true,
            ..Self::unknown()
        }
    }

    /// Entries are missing: whatever these machines say from here on proves nothing.
    pub fn doubt(&mut self) {
        (self.whole, self.lens_whole) = (false, false);
    }

    /// Runs one entry again.
    pub fn take(&mut self, entry: Entry) -> Seen {
        let Entry { at, what } = entry;
        match what {
            What::Charge { event, led_to } => {
                let decision = self.charge.on(at, event);
                seen(Machine::Charge, self.whole, &decision, led_to)
            }
            What::Block { sender, situation, slots, led_to } => {
                let verdicts = self.guard.on(&sender, &situation, &slots);
                seen(Machine::Guard, self.whole, &verdicts, led_to)
            }
            What::LegacyConnected(computer) => {
                self.legacy.entry(computer).or_default().connected();
                Seen::Other
            }
            What::LegacyBlock { computer, commands, led_to } => {
                let Ok(commands) = commands.try_into() else { return Seen::Unknown(Machine::LegacyGuard) };
                let findings = self.legacy.entry(computer).or_default().on(at, &commands);
                seen(Machine::LegacyGuard, self.whole, &findings, led_to)
            }
            What::Desk { errand, led_to } => {
                let step = self.desk.on(at, errand);
                seen(Machine::Desk, self.whole, &(step, self.desk.replies.last()), led_to)
            }
            What::Focus { event, led_to } => {
                let Some(autofocus) = &mut self.autofocus else { return Seen::Unknown(Machine::Autofocus) };
                seen(Machine::Autofocus, self.whole, &autofocus.on(at, event), led_to)
            }
            What::LensBegins { rules, before } => {
                self.control = Some(Control::resuming(rules, before));
                self.lens_whole = true;
                Seen::Other
            }
            What::Lens { event, led_to } => {
                let Some(control) = &mut self.control else { return Seen::Unknown(Machine::Lens) };
                seen(Machine::Lens, self.lens_whole, &control.on(at, event), led_to)
            }
            What::Begin(_) | What::Settings(_) | What::Lost(_) | What::SolverBegins | What::Solved(_) | What::Ended { .. } => {
                Seen::Other
            }
        }
    }
}

fn seen(machine: Machine, is_whole: bool, answer: &impl Debug, led_to: u32) -> Seen {
    if !is_whole {
        Seen::Unknown(machine)
    } else if mark(answer) == led_to {
        Seen::Same(machine)
    } else {
        Seen::Differs { machine, now: format!("{answer:?}") }
    }
}
