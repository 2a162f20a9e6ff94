//! A long build that can be ended: it asks now and then whether anybody still wants it.

/// Steps between questions. A step is what is done for one star, or for one neighbour of a star, at most a microsecond; asking
/// costs about fifty nanoseconds.
const ASK_EVERY: usize = 2048;

/// Counts steps, and asks after every few thousand whether to go on.
pub struct Pace<'a> {
    keep_on: &'a dyn Fn() -> bool,
    steps: usize,
}

impl<'a> Pace<'a> {
    /// Goes on for as long as `keep_on` says so.
    pub fn new(keep_on: &'a dyn Fn() -> bool) -> Self {
        Self { keep_on, steps: 0 }
    }

    /// After `steps` more steps; `None` where the build is to end.
    #[inline]
    pub fn step(&mut self, steps: usize) -> Option<()> {
        self.steps += steps;
        if self.steps < ASK_EVERY {
            return Some(());
        }
        self.steps = 0;
        (self.keep_on)().then_some(())
    }
}
