//! The gondola's gyros in a soak: what they saw of a series, and how a flight computer tells it, in order or in disorder.

use super::account::Rates;
use super::computer::{Computer, Life, Over, PERIOD, Wire};
use super::schedule::Class;
use crate::simulate::measured;
use crate::sky::ARCSEC;
use crate::solve::Motion;
use crate::wire::{self, Gyro, Image, Kind, List, Message, Refuse, Update};
use bytes::BytesMut;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::io::AsyncWriteExt;
use tokio::time::{Instant, timeout};

/// Noise of the gyros, rad/s/√Hz: as `solver.motion.gyro_drift_arcsec` expects it.
const NOISE: f64 = 4.0 * ARCSEC;
/// Counters that are somebody else's are off by this.
const FAR: u32 = 1_000_000;
/// What wrong rates may be off by, deg/s.
const WRONG_DEG_S: f32 = 3.0;

/// A series that has been exposed: when it began, and how the gyros saw the gondola turn.
#[derive(Debug, Clone)]
pub struct Turned {
    /// When its first exposure began.
    pub begun: Instant,
    /// The turn, without noise.
    pub motion: Motion,
}

/// What a computer knows of series, and holds of their rates.
#[derive(Default)]
pub struct Telling {
    /// The rates of the last series, until they are told.
    ready: Option<Gyro>,
    /// Rates that are sent when their image has ended.
    late: Option<Gyro>,
    camera_boot: u32,
    /// The last image that ended, and its series of triggers.
    ended: Option<(u32, Option<u32>)>,
    /// Whether the camera owes an answer to rates that are no numbers; nothing stood in the way of one.
    answer_due: bool,
    /// Rates that must have been refused by the next update.
    refusals_due: u32,
}

impl Computer {
    /// Takes note of an update: by then the camera has refused what it had to refuse before.
    pub fn note_images(&self, life: &mut Life, update: &Update) {
        let telling = &mut life.telling;
        let boot = update.link.boot_id.get();
        let due = std::mem::take(&mut telling.refusals_due);
        if std::mem::replace(&mut telling.camera_boot, boot) == boot {
            self.account.refusals_due(boot, due);
        } else {
            telling.late = None;
        }
        let trigger = |image: &Image| image.image_trigger_counter.get().map(|trigger| trigger.get());
        telling.ended = update.image.get().map(|image| (image.image_counter.get(), trigger(image)));
    }

    /// The link has ended, with a last word or without one.
    pub fn note_end(&self, life: &mut Life, last_word: Option<&Refuse>) {
        (life.telling.ready, life.telling.refusals_due) = (None, 0);
        if std::mem::take(&mut life.telling.answer_due) {
            self.account.answered(last_word.and_then(|refuse| refuse.refusal.get()));
        }
    }

    /// A series has been exposed.
    pub fn note_turn(life: &mut Life, turned: &Turned) {
        let motion = measured(&turned.motion, NOISE, &mut life.random);
        life.telling.ready = life.machine.turned(&motion, turned.begun.saturating_duration_since(life.began));
    }

    /// Tells how the gondola turned during the last series, once, where it is in charge; or does what a computer in disorder does.
    pub async fn tell_turn(&self, link: &mut Wire, life: &mut Life) -> Result<(), Over> {
        let (telling, in_charge) = (&mut life.telling, life.machine.holds_lease());
        let ended = telling.ended;
        let has_ended = |gyro: &mut Gyro| ended.is_some_and(|(ended, _)| ended >= gyro.image_counter.get());
        if let Some(gyro) = telling.late.take_if(has_ended).filter(|_| in_charge) {
            self.tell(link, life, gyro, Rates::Refused).await?;
        }
        let Some(mut gyro) = life.telling.ready.take() else { return Ok(()) };
        if !in_charge {
            // With the counters of the one that is: nothing is wrong with it but who it comes from. Where the charge may just have gone over it
            // waits for the next series.
            let trigger = ended.and_then(|(_, trigger)| trigger).filter(|_| self.handle.is_undisturbed());
            let Some(trigger) = trigger.filter(|_| self.struck(&[Class::StandByGyro]).is_some()) else { return Ok(()) };
            gyro.trigger_counter = trigger.into();
            return self.tell(link, life, gyro, Rates::Unheard).await;
        }
        let Some((class, seed)) = self.struck(&Class::GYRO) else { return self.tell(link, life, gyro, Rates::Sound).await };
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        match class {
            Class::GyroLate => life.telling.late = Some(gyro),
            Class::GyroOfAnother if random.random() => {
                gyro.image_counter = gyro.image_counter.get().wrapping_add(FAR).into();
                return self.tell(link, life, gyro, Rates::Refused).await;
            }
            Class::GyroOfAnother => {
                gyro.trigger_counter = gyro.trigger_counter.get().wrapping_add(FAR).into();
                return self.tell(link, life, gyro, Rates::Unheard).await;
            }
            Class::GyroWrong => return self.tell(link, life, wrong(gyro, &mut random), Rates::Wrong).await,
            Class::GyroNotFinite => {
                self.account.rates(life.telling.camera_boot, gyro.image_counter.get(), Rates::NotFinite);
                life.telling.answer_due = self.handle.is_undisturbed();
                // The answer says whether it came.
                let _ = timeout(PERIOD, link.get_mut().write_all(&no_number(gyro, &mut random))).await;
            }
            // None comes.
            _ => {}
        }
        Ok(())
    }

    async fn tell(&self, link: &mut Wire, life: &mut Life, gyro: Gyro, rates: Rates) -> Result<(), Over> {
        let certain = rates == Rates::Refused && self.handle.is_undisturbed();
        life.telling.refusals_due += u32::from(certain);
        self.account.rates(life.telling.camera_boot, gyro.image_counter.get(), rates);
        self.send(link, &Message::Gyro(Box::new(gyro))).await
    }
}

/// Rates that are another motion's: to the other side, at another pace, or all over the place.
fn wrong(gyro: Gyro, random: &mut ChaCha8Rng) -> Gyro {
    let (times, az_off, el_off) = match random.random_range(0..3) {
        0 => (-1.0, 0.0, 0.0),
        1 => (random.random_range(3.0..100.0), 0.0, 0.0),
        _ => (1.0, random.random_range(-WRONG_DEG_S..WRONG_DEG_S), random.random_range(-WRONG_DEG_S..WRONG_DEG_S)),
    };
    let changed = |rates: &wire::Rates| {
        let wire::Rates { az_rate_deg_s, el_rate_deg_s } = rates;
        wire::Rates { az_rate_deg_s: times * az_rate_deg_s + az_off, el_rate_deg_s: times * el_rate_deg_s + el_off }
    };
    let samples: Vec<wire::Rates> = gyro.samples.as_slice().iter().map(changed).collect();
    Gyro { samples: List::from_slice(&samples), ..gyro }
}

/// A message in which one rate is no number, behind a right checksum.
fn no_number(gyro: Gyro, random: &mut ChaCha8Rng) -> BytesMut {
    let mut bytes = BytesMut::new();
    let _ = Message::Gyro(Box::new(gyro)).encode(&mut bytes);
    let table = Kind::Gyro.table();
    let samples = table.fields.iter().find(|field| field.name == "samples").map_or(0, |field| field.offset);
    // Kind and version are covered by the checksum, which ends the frame.
    let (kind_at, sum_at) = (bytes.len().saturating_sub(table.size + 6), bytes.len().saturating_sub(4));
    let value = if random.random() { f32::NAN } else { f32::INFINITY };
    let at = kind_at + 2 + samples + 4 * random.random_range(0..100_usize);
    if let Some(rate) = bytes.get_mut(at..at + 4) {
        rate.copy_from_slice(&value.to_le_bytes());
    }
    let sum = crc32fast::hash(bytes.get(kind_at..sum_at).unwrap_or_default());
    if let Some(place) = bytes.get_mut(sum_at..) {
        place.copy_from_slice(&sum.to_le_bytes());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Reader, WireError};

    #[test]
    fn rates_that_are_no_numbers_come_in_a_whole_frame() {
        let motion = Motion { rates: vec![(0.1, 0.2); 110], sample_rate_hz: 100.0, ..Motion::default() };
        for seed in 0..20 {
            let mut bytes = no_number(Gyro::new(&motion, (1, 2), 3.0), &mut ChaCha8Rng::seed_from_u64(seed));
            let error = Reader::default().next(&mut bytes).unwrap_err();
            assert!(matches!(error, WireError::BadBody(_)) && error.to_string().contains("not finite"), "{error}");
        }
    }
}
