//! Going to a position so that the gears' backlash is taken up: the last way is always upwards.

use crate::lens::FocusCounts;

/// Where the lens may go, and what is known of where it is.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub(super) struct Carriage {
    low: i32,
    high: i32,
    backlash: i32,
    /// Verified position, where known.
    here: Option<i32>,
    /// Way upwards since the lens last turned round, counts.
    upwards: i32,
    /// Where to go on to after a move downwards.
    then: Option<i32>,
}

impl Carriage {
    /// A lens that may go from `low` to `high`.
    pub fn new(low: i32, high: i32, backlash: i32, here: Option<FocusCounts>) -> Self {
        Self { low, high: high.max(low), backlash, here: here.map(|at| at.0), upwards: 0, then: None }
    }

    /// The first order on the way to a position.
    pub fn go(&mut self, to: i32) -> FocusCounts {
        let to = to.clamp(self.low, self.high);
        let taken_up = self.here.is_some_and(|here| to >= here && self.upwards.saturating_add(to - here) >= self.backlash);
        let below = to.saturating_sub(self.backlash).max(self.low);
        self.then = (!taken_up && below < to).then_some(to);
        FocusCounts(self.then.map_or(to, |_| below))
    }

    /// The lens is there; where it is to go on to.
    pub fn arrived(&mut self, at: FocusCounts) -> Option<FocusCounts> {
        match self.here {
            Some(here) if at.0 >= here => self.upwards = self.upwards.saturating_add(at.0.saturating_sub(here)),
            _ => self.upwards = 0,
        }
        self.here = Some(at.0);
        self.then.take().map(FocusCounts)
    }

    /// Forgets where it was to go on to.
    pub fn halt(&mut self) {
        self.then = None;
    }

    /// Where the lens is, where known.
    pub fn here(&self) -> Option<i32> {
        self.here
    }

    /// Whether the last way was upwards for long enough.
    pub fn is_taken_up(&self) -> bool {
        self.upwards >= self.backlash
    }

    /// The lowest position that can be approached from below.
    pub fn lowest(&self) -> i32 {
        self.low.saturating_add(self.backlash)
    }

    /// The highest position.
    pub fn highest(&self) -> i32 {
        self.high
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goes somewhere with a lens that obeys; all positions on the way.
    fn way(carriage: &mut Carriage, to: i32) -> Vec<i32> {
        let mut positions = vec![carriage.go(to)];
        while let Some(next) = carriage.arrived(positions[positions.len() - 1]) {
            positions.push(next);
        }
        positions.into_iter().map(|at| at.0).collect()
    }

    #[test]
    fn the_last_way_is_always_upwards() {
        let mut carriage = Carriage::new(100, 200, 10, Some(FocusCounts(150)));
        assert_eq!(way(&mut carriage, 155), [145, 155]);
        assert_eq!(way(&mut carriage, 156), [156]);
        assert_eq!(way(&mut carriage, 130), [120, 130]);
        assert!(carriage.is_taken_up());
        let mut unknown = Carriage::new(100, 200, 10, None);
        assert_eq!(way(&mut unknown, 180), [170, 180]);
    }

    #[test]
    fn the_range_is_not_left() {
        let mut carriage = Carriage::new(100, 200, 10, None);
        assert_eq!(way(&mut carriage, 105), [100, 105]);
        assert!(!carriage.is_taken_up());
        assert_eq!(way(&mut carriage, 5000), [200]);
        assert_eq!(way(&mut carriage, -5000), [100]);
    }
}
