//! What a flight computer of old sends.

use super::bytes::{f64_at, i32_at, put, u8_at, u32_at};
use super::motion::Recorded;
use super::{BLOCK_BYTES, VERSION};
use crate::command::MAX_VALUES;
use crate::command::legacy::{COMMANDS, Entry, Values};
use crate::sky::{DEG, HOUR, Observer, wrap_two_pi};
use crate::wire::{EquatorialEstimate, HorizontalEstimate, ObserverPart, Status};
use std::f64::consts::FRAC_PI_2;

/// Offsets of what is no command.
const IN_CHARGE: usize = 0;
const COUNTER_FCP: usize = 4;
const HORIZONTAL_WANTED: usize = 260;
const HORIZONTAL: usize = 272;
const EQUATORIAL_WANTED: usize = 328;
const EQUATORIAL: usize = 340;
const OBSERVER: usize = 2284;
const LATITUDE: usize = 2288;
const SIDEREAL_TIME: usize = 2296;
const ADMINS: usize = 2304;
const ADMIN_BYTES: usize = 8;
const VERSION_AT: usize = 2576;

/// How a value stands in the struct.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Form {
    /// A C `bool`. One that is neither 0 nor 1 comes as the number that it is, which no flag allows.
    Bool,
    I32,
    U32,
    F64,
}

use Form::{Bool, F64, I32, U32};

/// A value of a command: form and offset.
type Place = (Form, usize);

/// Where the values of each command are, in the order of the wire and of
/// [`crate::command::legacy::FLOWN`]. The gyro rates of `motion_psf` are no values that the ground gives: see [`Recorded`].
const PLACES: [&[Place]; COMMANDS] = [
    &[],
    &[(Bool, 16), (Bool, 17)],
    &[(Bool, 20), (Bool, 21), (F64, 24)],
    &[(F64, 36), (Bool, 44), (Bool, 45), (Bool, 46), (F64, 48)],
    &[(I32, 56), (I32, 60), (F64, 64)],
    &[(Bool, 72)],
    &[(F64, 76)],
    &[(Bool, 376), (F64, 388), (F64, 404)],
    &[],
    &[],
    &[],
    &[(I32, 84)],
    &[(I32, 88)],
    &[],
    &[(I32, 92), (I32, 96), (I32, 100)],
    &[(Bool, 104)],
    &[(I32, 108)],
    &[],
    &[],
    &[(I32, 112)],
    &[],
    &[(F64, 116)],
    &[(Bool, 128), (F64, 132), (F64, 140), (F64, 148), (F64, 156)],
    &[(Bool, 164), (F64, 168)],
    &[],
    &[(Bool, 176), (U32, 180), (U32, 184), (U32, 188)],
    &[(F64, 192), (I32, 200), (Bool, 204), (I32, 208)],
    &[(U32, 212), (U32, 216)],
    &[(Bool, 220), (Bool, 221), (F64, 224), (F64, 232), (F64, 240), (Bool, 248), (F64, 252)],
    &[(Bool, 260), (F64, 264)],
    &[(Bool, 288), (F64, 292), (F64, 300)],
    &[(Bool, 308), (F64, 312), (F64, 320)],
    &[(Bool, 328), (F64, 332)],
    &[(F64, 356), (F64, 364), (U32, 372)],
];

/// Why bytes are no block.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum BlockError {
    /// Another version: the struct is another one.
    #[error("the block is of version {0}, only {VERSION} is spoken")]
    Version(u32),
}

/// What a flight computer of old says. Angles are in radians; what is not finite or cannot be is not known.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// It claims to be in charge.
    pub in_charge: bool,
    /// Number of the series of triggers that images belong to from now on; negative before the first.
    pub counter_fcp: i32,
    /// Where the gondola is and how far the sky has turned.
    pub observer: Option<Observer>,
    /// Estimated azimuth and elevation, sent where the limit around it is enabled.
    pub horizontal: Option<(f64, f64)>,
    /// Estimated right ascension and declination, the same.
    pub equatorial: Option<(f64, f64)>,
    /// How the gondola turned during a series of exposures: told by the command `motion_psf`.
    pub motion: Option<Recorded>,
    /// The commands.
    pub commands: [Entry; COMMANDS],
}

impl Block {
    /// Reads a block.
    ///
    /// # Errors
    /// See [`BlockError`].
    pub fn unpack(bytes: &[u8; BLOCK_BYTES]) -> Result<Self, BlockError> {
        let version = u32_at(bytes, VERSION_AT);
        if version != VERSION {
            return Err(BlockError::Version(version));
        }
        let flag = |offset| u8_at(bytes, offset) == 1;
        let observer = Observer { latitude: f64_at(bytes, LATITUDE), sidereal_time: f64_at(bytes, SIDEREAL_TIME) };
        let sane = is_latitude(observer.latitude) && observer.sidereal_time.is_finite();
        let mut commands = [Entry::default(); COMMANDS];
        for (index, (entry, places)) in commands.iter_mut().zip(PLACES).enumerate() {
            let admin = ADMINS + index * ADMIN_BYTES;
            *entry = Entry { countdown: u32_at(bytes, admin), counter: i32_at(bytes, admin + 4), values: values(bytes, places) };
        }
        Ok(Self {
            in_charge: flag(IN_CHARGE),
            counter_fcp: i32_at(bytes, COUNTER_FCP),
            observer: (flag(OBSERVER) && sane).then_some(observer),
            horizontal: flag(HORIZONTAL_WANTED).then(|| position(bytes, HORIZONTAL)).flatten(),
            equatorial: flag(EQUATORIAL_WANTED).then(|| position(bytes, EQUATORIAL)).flatten(),
            motion: Recorded::unpack(bytes),
            commands,
        })
    }

    /// As a flight computer sends it. The limits around estimates are commands: an estimate goes out whether its limit does or not.
    pub fn pack(&self) -> [u8; BLOCK_BYTES] {
        let mut bytes = [0; BLOCK_BYTES];
        for (index, (entry, places)) in self.commands.iter().zip(PLACES).enumerate() {
            let admin = ADMINS + index * ADMIN_BYTES;
            put(&mut bytes, admin, entry.countdown.to_le_bytes());
            put(&mut bytes, admin + 4, entry.counter.to_le_bytes());
            places.iter().zip(entry.values.0).for_each(|((form, offset), value)| put_value(&mut bytes, *form, *offset, value));
        }
        put(&mut bytes, IN_CHARGE, [u8::from(self.in_charge)]);
        put(&mut bytes, COUNTER_FCP, self.counter_fcp.to_le_bytes());
        let pairs = [(HORIZONTAL, self.horizontal), (EQUATORIAL, self.equatorial)];
        for (offset, (longitude, latitude)) in pairs.into_iter().filter_map(|(offset, pair)| Some((offset, pair?))) {
            put(&mut bytes, offset, longitude.to_le_bytes());
            put(&mut bytes, offset + 8, latitude.to_le_bytes());
        }
        if let Some(motion) = &self.motion {
            motion.pack(&mut bytes);
        }
        if let Some(observer) = self.observer {
            put(&mut bytes, OBSERVER, [1]);
            put(&mut bytes, LATITUDE, observer.latitude.to_le_bytes());
            put(&mut bytes, SIDEREAL_TIME, observer.sidereal_time.to_le_bytes());
        }
        put(&mut bytes, VERSION_AT, VERSION.to_le_bytes());
        bytes
    }

    /// What it says besides commands, as a status of ours.
    pub fn status(&self) -> Status {
        let horizontal = self.horizontal.map(|(az, el)| HorizontalEstimate { az_deg: wrap_two_pi(az) / DEG, el_deg: el / DEG });
        let equatorial =
            self.equatorial.map(|(ra, dec)| EquatorialEstimate { ra_deg: wrap_two_pi(ra) / DEG, dec_deg: dec / DEG });
        let observer = self.observer.map(|observer| ObserverPart {
            latitude_deg: observer.latitude / DEG,
            sidereal_time_h: wrap_two_pi(observer.sidereal_time) / HOUR,
        });
        Status {
            claims_charge: self.in_charge,
            observer: observer.into(),
            horizontal_estimate: horizontal.into(),
            equatorial_estimate: equatorial.into(),
            trigger_counter: u32::try_from(self.counter_fcp).ok().into(),
            ..Status::default()
        }
    }
}

fn is_latitude(angle: f64) -> bool {
    angle.abs() <= FRAC_PI_2
}

/// A longitude and a latitude, where they can be.
fn position(bytes: &[u8], offset: usize) -> Option<(f64, f64)> {
    let (longitude, latitude) = (f64_at(bytes, offset), f64_at(bytes, offset + 8));
    (longitude.is_finite() && is_latitude(latitude)).then_some((longitude, latitude))
}

fn values(bytes: &[u8], places: &[Place]) -> Values {
    let mut values = [0.0; MAX_VALUES];
    for (value, (form, offset)) in values.iter_mut().zip(places) {
        *value = match form {
            Bool => f64::from(u8_at(bytes, *offset)),
            I32 => f64::from(i32_at(bytes, *offset)),
            U32 => f64::from(u32_at(bytes, *offset)),
            F64 => f64_at(bytes, *offset),
        };
    }
    Values(values)
}

fn put_value(bytes: &mut [u8], form: Form, offset: usize, value: f64) {
    match form {
        Bool => put(bytes, offset, [value as u8]),
        I32 => put(bytes, offset, (value as i32).to_le_bytes()),
        U32 => put(bytes, offset, (value as u32).to_le_bytes()),
        F64 => put(bytes, offset, value.to_le_bytes()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Step;
    use super::*;
    use crate::command::legacy::FLOWN;

    /// A block with another number in every place.
    fn block() -> Block {
        let entry = |index: usize| {
            let mut entry = Entry { countdown: 1000 + index as u32, counter: 7 - index as i32, values: Values::default() };
            for (place, (value, (form, _))) in entry.values.0.iter_mut().zip(PLACES[index]).enumerate() {
                let number = (index * 8 + place) as f64;
                *value = match form {
                    Bool => f64::from(number as u8 % 2),
                    I32 => -number,
                    U32 => 4e9 + number,
                    F64 => number + 0.25,
                };
            }
            entry
        };
        let mut commands = std::array::from_fn(entry);
        // The limits that the estimates are sent for.
        (commands[29].values.0[0], commands[32].values.0[0]) = (1.0, 1.0);
        Block {
            in_charge: true,
            counter_fcp: 41,
            observer: Some(Observer { latitude: -1.3, sidereal_time: 7.0 }),
            horizontal: Some((-0.5, 0.7)),
            equatorial: Some((2.0, -0.8)),
            motion: Some(Recorded {
                counter_fcp: 40,
                counter_stars: 39,
                elevation: 0.5,
                steps: vec![Step { exposure: 0, az: 1e-3, el: -1e-3 }; 9],
            }),
            commands,
        }
    }

    #[test]
    fn a_block_comes_back_from_its_bytes_and_every_value_has_a_place_of_its_own() {
        assert_eq!(Block::unpack(&block().pack()), Ok(block()));
        let mut taken = [false; BLOCK_BYTES];
        for (places, flown) in PLACES.iter().zip(FLOWN) {
            assert_eq!(places.len(), flown.values, "{}", flown.name);
            for (form, offset) in *places {
                let size = match form {
                    Bool => 1,
                    I32 | U32 => 4,
                    F64 => 8,
                };
                assert!(*form == Bool || offset % 4 == 0, "{}", flown.name);
                taken[*offset..offset + size].iter_mut().for_each(|byte| assert!(!std::mem::replace(byte, true), "{offset}"));
            }
        }
        assert!(!taken[412..].iter().any(|taken| *taken));
    }

    #[test]
    fn what_it_says_besides_commands_is_a_status() {
        let status = block().status();
        assert!(status.claims_charge);
        assert_eq!(status.trigger_counter.get().map(|counter| counter.get()), Some(41));
        let prior = status.prior();
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        close(prior.horizontal.unwrap().0, std::f64::consts::TAU - 0.5);
        close(prior.equatorial.unwrap().1, -0.8);
        close(status.observer().unwrap().sidereal_time, 7.0 - std::f64::consts::TAU);
        assert_eq!(Block { counter_fcp: -1, ..block() }.status().trigger(), None);
    }

    #[test]
    fn what_cannot_be_is_not_known_and_another_version_is_no_block() {
        let mut bytes = block().pack();
        put(&mut bytes, LATITUDE, f64::NAN.to_le_bytes());
        put(&mut bytes, HORIZONTAL, f64::INFINITY.to_le_bytes());
        put(&mut bytes, EQUATORIAL + 8, 1.6f64.to_le_bytes());
        put(&mut bytes, IN_CHARGE, [3]);
        let read = Block::unpack(&bytes).unwrap();
        assert_eq!((read.observer, read.horizontal, read.equatorial, read.in_charge), (None, None, None, false));
        put(&mut bytes, EQUATORIAL_WANTED, [0]);
        assert_eq!(Block::unpack(&bytes).unwrap().equatorial, None);
        put(&mut bytes, VERSION_AT, 4u32.to_le_bytes());
        assert_eq!(Block::unpack(&bytes), Err(BlockError::Version(4)));
    }
}
