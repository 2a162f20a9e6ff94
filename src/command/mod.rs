//! The command room: who may command, and what was asked.
