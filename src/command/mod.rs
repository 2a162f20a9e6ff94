//! The command room: who may command, and what was asked.
//!
//! Uses nothing of the other rooms. Its public face is the arbitration [`InCharge`]: a plain state machine, to which time
//! comes with each event.

mod in_charge;

pub use in_charge::{Decision, Event, FlightComputer, Holder, InCharge, Tick};
