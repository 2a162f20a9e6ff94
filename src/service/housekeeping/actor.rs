//! The actor of the housekeeping: asks every sensor on the blocking pool, side by side, and tells the hub what was measured.

use super::trend::Trend;
use super::{Measurements, Quantity, Reading, Sensor, SensorError};
use crate::service::clock::Clock;
use crate::service::hub::{self, ToHub};
use crate::service::pulse::Pulse;
use crate::service::supervisor::{Ended, panic_message, panic_text};
use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::sync::CancellationToken;

/// Makes the sensors, each time that the actor is started.
pub type MakeSensors = Arc<dyn Fn() -> Vec<(Quantity, Box<dyn Sensor>)> + Send + Sync>;

/// The housekeeping's actor.
#[derive(Clone)]
pub struct Housekeeper {
    /// Makes the sensors.
    pub make: MakeSensors,
    /// Time between readings.
    pub period: Duration,
    /// Whom to tell.
    pub hub: hub::Handle,
    /// The service's clock.
    pub clock: Clock,
    /// When to end.
    pub stop: CancellationToken,
}

/// An answer, with the sensor that gave it.
struct Answer {
    quantity: Quantity,
    sensor: Box<dyn Sensor>,
    asked: Instant,
    result: Result<f64, SensorError>,
}

/// What the actor holds while it runs.
struct Desk {
    /// Sensors that may be asked; the others have not answered yet.
    idle: Vec<(Quantity, Box<dyn Sensor>)>,
    asked: JoinSet<Answer>,
    seen: Measurements,
    trend: Trend,
    /// What keeps a sensor from giving a value, so that it is logged once.
    problems: BTreeMap<Quantity, String>,
    /// Something has been measured that the hub has not been told.
    fresh: bool,
}

impl Housekeeper {
    /// Runs until stopped.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let mut desk = Desk {
            idle: (self.make)(),
            asked: JoinSet::new(),
            seen: Measurements::default(),
            trend: Trend::default(),
            problems: BTreeMap::new(),
            fresh: false,
        };
        let mut ticks = tokio::time::interval(self.period);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                () = self.stop.cancelled() => return Ok(()),
                Some(answer) = desk.asked.join_next() => {
                    desk.take(answer.map_err(|error| Ended(panic_message(error)))?, &self.clock);
                    // A sensor that does not answer holds up nobody: the hub is told at the next tick at the latest.
                    if desk.asked.is_empty() {
                        self.tell(&mut desk).await;
                    }
                }
                _ = ticks.tick() => {
                    self.tell(&mut desk).await;
                    desk.ask(&self.clock);
                }
                () = pulse.rest() => {}
            }
        }
    }

    async fn tell(&self, desk: &mut Desk) {
        if std::mem::take(&mut desk.fresh) {
            self.hub.tell(ToHub::Measured(Box::new(desk.seen.clone()))).await;
        }
    }
}

impl Desk {
    /// Asks all that have answered the last time.
    fn ask(&mut self, clock: &Clock) {
        let asked = Instant::now();
        let now = clock.tick(asked);
        for (quantity, mut sensor) in self.idle.drain(..) {
            self.asked.spawn_blocking(move || {
                let result = catch_unwind(AssertUnwindSafe(|| sensor.read(now)))
                    .unwrap_or_else(|payload| Err(SensorError::Broke(panic_text(payload.as_ref()).to_owned())));
                Answer { quantity, sensor, asked, result }
            });
        }
    }

    fn take(&mut self, answer: Answer, clock: &Clock) {
        let Answer { quantity, sensor, asked, result } = answer;
        self.idle.push((quantity, sensor));
        let name = quantity.name();
        match result {
            Ok(value) => {
                if self.problems.remove(&quantity).is_some() {
                    tracing::info!(sensor = name, value, "measured again");
                }
                self.seen.readings.insert(quantity, Reading { value, at: asked });
                self.fresh = true;
                if quantity == Quantity::DiskFree {
                    self.trend.note(clock.tick(asked), value);
                    self.seen.disk_days_left = self.trend.days_left();
                }
            }
            Err(error) => {
                let problem = error.to_string();
                if self.problems.get(&quantity) != Some(&problem) {
                    tracing::warn!(sensor = name, problem, "not measured");
                    self.problems.insert(quantity, problem);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::inbox::{self, Inbox};
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicU32, Ordering};
    use std::sync::mpsc::{Receiver, sync_channel};

    struct Fake<F>(F);

    impl<F: FnMut(Duration) -> Result<f64, SensorError> + Send> Sensor for Fake<F> {
        fn read(&mut self, now: Duration) -> Result<f64, SensorError> {
            (self.0)(now)
        }
    }

    fn fake(read: impl FnMut(Duration) -> Result<f64, SensorError> + Send + 'static) -> Box<dyn Sensor> {
        Box::new(Fake(read))
    }

    /// Starts an actor with these sensors.
    fn start(sensors: Vec<(Quantity, Box<dyn Sensor>)>) -> (Inbox<ToHub>, CancellationToken) {
        let (sender, inbox) = inbox::channel(64);
        let stop = CancellationToken::new();
        let sensors = Mutex::new(Some(sensors));
        let actor = Housekeeper {
            make: Arc::new(move || sensors.lock().unwrap().take().unwrap()),
            period: Duration::from_millis(20),
            hub: hub::Handle::new(sender),
            clock: Clock::start(),
            stop: stop.clone(),
        };
        tokio::spawn(actor.run(Pulse::new()));
        (inbox, stop)
    }

    /// What is told next that is as wanted.
    async fn told(inbox: &Inbox<ToHub>, wanted: impl Fn(&Measurements) -> bool) -> Measurements {
        let mut inbox = inbox.open().await;
        let seen = async {
            loop {
                match inbox.recv().await {
                    Some(ToHub::Measured(seen)) if wanted(&seen) => return *seen,
                    Some(_) => {}
                    None => panic!("it has ended"),
                }
            }
        };
        tokio::time::timeout(Duration::from_secs(60), seen).await.expect("it is never told")
    }

    fn value(seen: &Measurements, quantity: Quantity) -> Option<f64> {
        seen.readings.get(&quantity).map(|reading| reading.value)
    }

    #[tokio::test]
    async fn a_sensor_that_hangs_holds_up_no_other_and_is_not_asked_twice() {
        let (release, held): (_, Receiver<()>) = sync_channel(1);
        let asked = Arc::new(AtomicU32::new(0));
        let count = Arc::clone(&asked);
        let mut n = 0.0;
        let (inbox, stop) = start(vec![
            (
                Quantity::TemperatureLens,
                fake(move |_| {
                    count.fetch_add(1, Ordering::Relaxed);
                    let _ = held.recv();
                    Ok(1.0)
                }),
            ),
            (
                Quantity::Pressure,
                fake(move |_| {
                    n += 1.0;
                    Ok(n)
                }),
            ),
        ]);
        let seen = told(&inbox, |seen| value(seen, Quantity::Pressure) >= Some(5.0)).await;
        assert_eq!(value(&seen, Quantity::TemperatureLens), None);
        assert_eq!(asked.load(Ordering::Relaxed), 1);
        drop(release);
        told(&inbox, |seen| value(seen, Quantity::TemperatureLens) == Some(1.0)).await;
        stop.cancel();
    }

    #[tokio::test]
    async fn a_sensor_that_fails_or_panics_keeps_its_last_value_with_its_old_time_and_comes_back() {
        let mut n = 0;
        let failing = move |_| {
            n += 1;
            match n {
                1 => Ok(10.0),
                2..4 => Err(SensorError::NoNumber("?".to_owned())),
                4..6 => panic!("a sensor that breaks"),
                _ => Ok(f64::from(n)),
            }
        };
        let mut m = 0.0;
        let counting = move |_| {
            m += 1.0;
            Ok(m)
        };
        let (inbox, stop) = start(vec![(Quantity::TemperatureLens, fake(failing)), (Quantity::Pressure, fake(counting))]);
        let first = told(&inbox, |seen| value(seen, Quantity::Pressure) == Some(1.0)).await;
        let later = told(&inbox, |seen| value(seen, Quantity::Pressure) == Some(5.0)).await;
        let lens = |seen: &Measurements| seen.readings.get(&Quantity::TemperatureLens).copied();
        assert_eq!(lens(&first).unwrap().value, 10.0);
        assert_eq!(lens(&later), lens(&first));
        let back = told(&inbox, |seen| value(seen, Quantity::TemperatureLens) != Some(10.0)).await;
        assert_eq!(value(&back, Quantity::TemperatureLens), Some(6.0));
        stop.cancel();
    }

    #[tokio::test]
    async fn the_free_space_comes_with_the_days_that_are_left() {
        let mut free = 100.0;
        let filling = move |_| {
            free -= 0.001;
            Ok(free)
        };
        let (inbox, stop) = start(vec![(Quantity::DiskFree, fake(filling))]);
        let seen = told(&inbox, |_| true).await;
        assert!(value(&seen, Quantity::DiskFree).is_some() && seen.disk_days_left.is_none());
        stop.cancel();
    }
}
