//! The wire room: what goes over TCP to a flight computer: framing, checksums, message bodies of fixed layout.
