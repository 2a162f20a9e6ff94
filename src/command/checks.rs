//! The single checks that stand between a claim or a command block and its effect, so that a test can leave out each one and see
//! that it is missed.

/// One check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Check {
    /// A claim that is not renewed lapses.
    Lapse,
    /// A computer that does not hear us makes no claim.
    Hearing,
    /// A claim that comes and goes is not followed.
    Unrest,
    /// Of two lasting claims that of the computer rebooted less recently wins.
    Contest,
    /// The block comes from the holder of the lease.
    Holder,
    /// It was made under this lease of this run of ours.
    Epoch,
    /// It comes from the boot that said hello.
    Boot,
    /// The first block of a boot runs nothing.
    First,
    /// The values carry the seal that they were given together with the counter.
    Seal,
    /// The counter is new.
    Counter,
    /// The ground command is young enough.
    Age,
    /// The block was not long on its way.
    Delay,
    /// The sender has the key.
    Key,
}

impl Check {
    /// Every check.
    #[cfg(test)]
    pub const ALL: [Self; 13] = [
        Self::Lapse,
        Self::Hearing,
        Self::Unrest,
        Self::Contest,
        Self::Holder,
        Self::Epoch,
        Self::Boot,
        Self::First,
        Self::Seal,
        Self::Counter,
        Self::Age,
        Self::Delay,
        Self::Key,
    ];
}

/// The checks that are made: all of them, but in a test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Checks(u16);

impl Default for Checks {
    fn default() -> Self {
        Self(u16::MAX)
    }
}

impl Checks {
    /// Whether a check is made.
    pub fn has(self, check: Check) -> bool {
        self.0 & (1 << check as u16) != 0
    }

    /// All but one.
    #[cfg(test)]
    pub fn all_but(check: Check) -> Self {
        Self(!(1 << check as u16))
    }
}
