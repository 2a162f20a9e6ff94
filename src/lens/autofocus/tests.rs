//! The machine's rules.
