//! What the hub does with a block of the legacy dialect: its claim, its commands, and the rest of what it says.

use super::super::hub::Hub;
use super::super::motion;
use super::super::state::State;
use crate::command::legacy::{FLOWN, Finding, Meaning, Values, meanings};
use crate::command::{Authenticity, BootId, Command, FlightComputer, Refusal, Sender, Situation, Tick, Verdict, admit};
use crate::journal::{What, mark};
use crate::wire::legacy::Block;
use std::time::Duration;
use tokio::time::Instant;

/// Whether a verdict lets the command through that has gyro rates used: they stand beside it in its block.
fn uses_motion(verdict: &Verdict) -> bool {
    matches!(verdict, Verdict::Run(order) if matches!(order.command, Command::UseMotion { enabled: true }))
}

/// The dialect has no number of a boot.
const NO_BOOT: BootId = BootId(0);

impl Hub {
    /// A flight computer of old connected.
    pub(in super::super) fn take_legacy_connection(&self, state: &mut State, computer: FlightComputer, connection: u64) {
        self.take_connection(state, computer, connection, NO_BOOT);
        if state.is_current(computer, connection) {
            state.legacy.entry(computer).or_default().connected();
            self.journal.note(self.clock.uptime(), What::LegacyConnected(computer));
        }
    }

    /// A block: what it says of itself goes where a status goes, and the guard of the dialect judges its commands.
    pub(in super::super) fn take_legacy_block(&self, state: &mut State, computer: FlightComputer, block: &Block, at: Instant) {
        // It can't say what it hears: it is believed to hear.
        self.take_status(state, computer, Box::new(block.status()), at, None, true);
        let now = self.clock.tick(at);
        let sender = Sender {
            computer,
            boot: NO_BOOT,
            block_boot: NO_BOOT,
            under: None,
            delay: Duration::ZERO,
            authenticity: if state.settings.commands.require_authentication {
                Authenticity::Failed
            } else {
                Authenticity::NotRequired
            },
        };
        let findings = state.legacy.entry(computer).or_default().on(now, &block.commands);
        let (commands, led_to) = (block.commands.to_vec(), mark(&findings));
        self.journal.note(now, What::LegacyBlock { computer, commands, led_to });
        for finding in findings {
            let verdicts = match finding {
                Finding::True { index, counter, values } => self.read_legacy(state, &sender, index, counter, &values),
                Finding::Refused { index, counter, why, detail } => {
                    let code = index.and_then(|index| FLOWN.get(index)).map_or(0, |flown| flown.code);
                    vec![Verdict::Refused { code, counter: counter.cast_unsigned(), why, detail }]
                }
            };
            if verdicts.iter().any(uses_motion) {
                let judged = motion::judge_legacy(block.motion.as_ref(), state);
                state.motions.take(judged, Instant::now());
            }
            verdicts.into_iter().for_each(|verdict| self.take_legacy_verdict(state, now, computer, verdict));
        }
    }

    /// A true command as ours: one, or two.
    fn read_legacy(&self, state: &State, sender: &Sender, index: usize, counter: i32, values: &Values) -> Vec<Verdict> {
        let situation = Situation {
            lease: state.in_charge(),
            ours: BootId(self.clock.boot_id()),
            window_s: state.settings.commands.window_s,
        };
        let counter = counter.cast_unsigned();
        let verdict = |meaning| match meaning {
            Meaning::Ours { code, values } => admit(sender, &situation, code, counter, &values),
            Meaning::Nothing(why) => {
                let code = FLOWN.get(index).map_or(0, |flown| flown.code);
                Verdict::Refused { code, counter, why: Refusal::Dialect, detail: why.to_owned() }
            }
        };
        meanings(index, values).into_iter().map(verdict).collect()
    }

    /// A verdict goes to the desk, as a native one does. Its ground cannot be told what was refused, but the log is.
    fn take_legacy_verdict(&self, state: &mut State, now: Tick, computer: FlightComputer, mut verdict: Verdict) {
        if let Verdict::Run(order) = &mut verdict {
            order.act = state.desk.act(now, computer, &order.command, state.focus());
        }
        self.take_verdict(state, now, computer, verdict);
    }
}
