//! The command room: who may command, what may be asked, and what came of it.
//!
//! A command block goes through here in this order: [`InCharge`] says who holds the lease, [`Guard`] which commands of the block
//! are true ones, [`Desk`] hands them out and keeps the replies; [`Definition`] says what commands there are.
//!
//! [`legacy`] has the guard of the dialect that flew, in the place of [`Guard`].
//!
//! Plain state machines, to which time comes with each event. Uses the settings, which some commands change.

mod apply;
mod authentic;
mod checks;
mod definition;
mod desk;
mod dictionary;
mod errand;
mod guard;
mod in_charge;
pub mod legacy;
#[cfg(test)]
mod model;
mod reply;
#[cfg(test)]
mod tests;
mod value;

pub use apply::apply;
pub use authentic::{Key, KeyError, TAG_BYTES};
pub use definition::{CommandError, Definition, Hazard, MAX_VALUES, parse_order};
pub use desk::{CommandCounts, Desk, Focus, OrderNumber, Step, UNDER_WAY};
pub use dictionary::Command;
pub use errand::Errand;
pub use guard::{Act, Authenticity, Guard, Memory, Order, Sender, Situation, Slot, Verdict, admit};
pub use in_charge::{BootId, Decision, Epoch, Event, FlightComputer, InCharge, LASTING, LEASE, Lease, Tick};
pub use reply::{Answer, REPLIES, Refusal, Replies, Reply, Stage};
pub use value::{Parameter, Shape, ShowFocus, Value};
