//! The arbitration and the guard, tried against every history of two computers.

mod tests;
