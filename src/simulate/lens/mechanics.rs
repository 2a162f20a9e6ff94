//! The simulated lens itself: a motor between two stops, and optics that follow it with some play.

use crate::command::Tick;
use std::time::Duration;

/// Motor and optics. Positions are counts from the near stop; they are true, whatever a controller believes.
#[derive(Debug, Clone)]
pub(super) struct Mechanics {
    range: f64,
    /// counts/s.
    speed: f64,
    /// Half the play between motor and optics, counts.
    play: f64,
    from: f64,
    to: f64,
    began: Tick,
    /// Where the optics were when the motor began to move.
    optics: f64,
}

impl Mechanics {
    pub fn new(range: f64, at: f64, speed: f64, backlash: f64) -> Self {
        Self { range, speed, play: backlash / 2.0, from: at, to: at, began: Tick::ZERO, optics: at }
    }

    pub fn range(&self) -> f64 {
        self.range
    }

    /// Where the motor is.
    pub fn motor(&self, now: Tick) -> f64 {
        let gone = now.saturating_sub(self.began).as_secs_f64() * self.speed;
        if self.to >= self.from { (self.from + gone).min(self.to) } else { (self.from - gone).max(self.to) }
    }

    /// Where the optics are: within half the play of the motor, dragged along.
    pub fn optics(&self, now: Tick) -> f64 {
        let motor = self.motor(now);
        self.optics.clamp(motor - self.play, motor + self.play)
    }

    /// Drives to a position, as far as the stops let it; how long that takes.
    pub fn drive(&mut self, now: Tick, to: f64) -> Duration {
        self.halt(now);
        self.to = to.clamp(0.0, self.range);
        Duration::from_secs_f64((self.to - self.from).abs() / self.speed)
    }

    /// Stands still where it is.
    pub fn halt(&mut self, now: Tick) {
        self.optics = self.optics(now);
        self.from = self.motor(now);
        (self.to, self.began) = (self.from, now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motor_takes_its_time_and_ends_at_the_stops() {
        let mut lens = Mechanics::new(1000.0, 400.0, 100.0, 6.0);
        let second = Duration::from_secs;
        assert_eq!(lens.drive(second(10), 700.0), second(3));
        assert_eq!(lens.motor(second(11)), 500.0);
        assert_eq!(lens.motor(second(60)), 700.0);
        assert_eq!(lens.drive(second(60), -50.0), second(7));
        assert_eq!(lens.motor(second(99)), 0.0);
        lens.drive(second(100), 5000.0);
        lens.halt(second(102));
        assert_eq!(lens.motor(second(200)), 200.0);
    }

    #[test]
    fn the_optics_follow_with_half_the_play_either_way() {
        let mut lens = Mechanics::new(1000.0, 400.0, 100.0, 6.0);
        lens.drive(Tick::ZERO, 500.0);
        let later = Duration::from_secs(9);
        assert_eq!(lens.optics(later), 497.0);
        lens.drive(later, 496.0);
        assert_eq!(lens.optics(later * 2), 497.0, "within the play nothing drags them");
        lens.drive(later * 2, 450.0);
        assert_eq!(lens.optics(later * 3), 453.0);
    }
}
