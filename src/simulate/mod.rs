//! The simulate room: simulated twins of the outside: the sky renderer and the flight computer.
