//! Adaptive binary arithmetic coding of whole numbers that lie around nought, one packet at a time.
//!
//! The coder is the carryless binary one of Mahoney, *Data Compression Explained*, § 3.2; a number is coded as the length of its magnitude
//! in bits (one bit at a time, each with a probability of its own), its sign and the bits below the first. The probabilities begin as those
//! of a normal distribution whose width is given, so that a packet of some hundred numbers need not learn them, and follow what comes.

#![allow(clippy::indexing_slicing, reason = "a kernel; its indices are lengths of at most LONGEST, and depths of at most 2")]

/// Most bits that a magnitude may have: the differences of differences of 16-bit values have 17.
const LONGEST: usize = 17;
/// Greatest width of a distribution, in the steps of [`Width`]: 2¹⁷.
pub(super) const MOST_STEPS: u8 = 84;
/// A probability moves by one part in 2⁶ of what it was wrong by: slow enough to cost half a percent, fast enough to learn in a packet.
const RATE: u32 = 6;
/// Probabilities are 16-bit fractions; none is nearer to 0 or 1 than this, where [`RATE`] stops moving it.
const LEAST: u32 = 1 << RATE;
/// One half.
const EVEN: u16 = 1 << 15;

/// Two-sided tail of the normal distribution, in 2⁻¹⁶: how probable it is that a value is off by i/8 σ or more.
const TAIL: [u32; 33] = [
    65536, 59017, 52598, 46377, 40441, 34863, 29705, 25007, 20795, 17078, 13848, 11084, 8757, 6826, 5251, 3984, 2982, 2201, 1602,
    1150, 814, 568, 391, 265, 177, 117, 76, 48, 30, 19, 12, 7, 4,
];
/// Steps of [`TAIL`] are divided further into so many.
const PER_STEP: u64 = 32;
/// 2^(−i/4) in 2⁻¹⁶.
const QUARTERS: [u64; 4] = [65536, 55109, 46341, 38968];

/// How widely numbers lie around nought: σ = 2^(steps/4) / 16.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Width(pub u8);

impl Width {
    /// The step nearest to a σ.
    pub fn of_sigma(sigma: f64) -> Self {
        let steps = (4.0 * libm::log2(16.0 * sigma.max(1e-9))).round();
        Self(steps.clamp(0.0, f64::from(MOST_STEPS)) as u8)
    }

    /// (t − ½)/σ in 1/256: where the magnitudes from t on begin.
    fn place(self, t: u64) -> u64 {
        ((2 * t - 1) * 2048 * QUARTERS[usize::from(self.0 % 4)]) >> (16 + u32::from(self.0 / 4))
    }

    /// How probable a magnitude of t or more is, in 2⁻¹⁶.
    fn tail(self, t: u64) -> u32 {
        let place = if t == 0 { 0 } else { self.place(t) };
        let (step, part) = ((place / PER_STEP) as usize, (place % PER_STEP) as u32);
        match (TAIL.get(step), TAIL.get(step + 1)) {
            (Some(&near), Some(&far)) => (near * (PER_STEP as u32 - part) + far * part) / PER_STEP as u32,
            _ => TAIL[TAIL.len() - 1],
        }
    }

    /// How probable it is, among magnitudes from `low` and below `end`, that one is `middle` or more. Far out, where there are stars and
    /// defects and no normal distribution, one half.
    fn upper(self, low: u64, middle: u64, end: Option<u64>) -> u16 {
        let beyond = end.map_or(0, |end| self.tail(end));
        let all = self.tail(low).saturating_sub(beyond);
        let far = low > 0 && self.place(low) >= PER_STEP * (TAIL.len() as u64 - 1);
        if far || all == 0 {
            return EVEN;
        }
        let upper = u64::from(self.tail(middle).saturating_sub(beyond));
        ((upper << 16) / u64::from(all)).clamp(u64::from(LEAST), (1 << 16) - u64::from(LEAST)) as u16
    }
}

/// The probabilities of one kind of number.
#[derive(Debug, Clone)]
pub(super) struct Model {
    /// That a magnitude is longer than i bits, where it is that long.
    longer: [u16; LONGEST],
    /// That the first bit below the leading one is set, for each length; and the second, after a 0 and after a 1.
    below: [[u16; 3]; LONGEST + 1],
}

impl Model {
    /// That of normally distributed numbers.
    pub fn new(width: Width) -> Self {
        let mut model = Self { longer: [EVEN; LONGEST], below: [[EVEN; 3]; LONGEST + 1] };
        for (bits, p) in model.longer.iter_mut().enumerate() {
            *p = width.upper((1 << bits) >> 1, 1 << bits, None);
        }
        for (bits, p) in model.below.iter_mut().enumerate().skip(2) {
            let (low, end) = (1u64 << (bits - 1), 1u64 << bits);
            let middle = (low + end) / 2;
            p[0] = width.upper(low, middle, Some(end));
            if bits > 2 {
                p[1] = width.upper(low, (low + middle) / 2, Some(middle));
                p[2] = width.upper(middle, (middle + end) / 2, Some(end));
            }
        }
        model
    }
}

/// Moves a probability towards a bit that came.
fn follow(p: &mut u16, bit: bool) {
    if bit {
        *p += (((1 << 16) - u32::from(*p)) >> RATE) as u16;
    } else {
        *p -= *p >> RATE;
    }
}

/// Where the coder's interval is cut: values up to it mean a 1.
fn cut(low: u32, high: u32, p: u16) -> u32 {
    low + ((u64::from(high - low) * u64::from(p)) >> 16) as u32
}

/// Writes numbers.
#[derive(Debug)]
struct Writer {
    low: u32,
    high: u32,
    out: Vec<u8>,
}

impl Writer {
    fn put(&mut self, bit: bool, p: u16) {
        let cut = cut(self.low, self.high, p);
        if bit {
            self.high = cut;
        } else {
            self.low = cut + 1;
        }
        while (self.low ^ self.high) >> 24 == 0 {
            self.out.push((self.high >> 24) as u8);
            self.low <<= 8;
            self.high = self.high << 8 | 0xFF;
        }
    }

    fn put_and_follow(&mut self, bit: bool, p: &mut u16) {
        self.put(bit, *p);
        follow(p, bit);
    }

    fn number(&mut self, model: &mut Model, number: i32) {
        let magnitude = number.unsigned_abs();
        let bits = (u32::BITS - magnitude.leading_zeros()) as usize;
        debug_assert!(bits <= LONGEST);
        for longer in &mut model.longer[..bits] {
            self.put_and_follow(true, longer);
        }
        if bits < LONGEST {
            self.put_and_follow(false, &mut model.longer[bits]);
        }
        if bits == 0 {
            return;
        }
        self.put(number < 0, EVEN);
        let mut context = 0;
        for (depth, place) in (0..bits - 1).rev().enumerate() {
            let bit = magnitude >> place & 1 == 1;
            if depth < 2 {
                self.put_and_follow(bit, &mut model.below[bits][context]);
                context = 1 + usize::from(bit);
            } else {
                self.put(bit, EVEN);
            }
        }
    }

    /// One byte more puts the value inside the interval whatever follows; a reader takes noughts behind the end, so that those at the end
    /// need not be sent.
    fn end(mut self) -> Vec<u8> {
        if self.low > 0 {
            self.out.push((self.low >> 24) as u8 + 1);
        }
        while self.out.last() == Some(&0) {
            self.out.pop();
        }
        self.out
    }
}

/// Codes as many numbers, each with the index of its model, as fit into so many bytes: how many, and the bytes.
pub(super) fn pack(numbers: impl Iterator<Item = (u8, i32)>, models: &[Model], room: usize) -> (usize, Vec<u8>) {
    let mut models = models.to_vec();
    let mut writer = Writer { low: 0, high: u32::MAX, out: Vec::with_capacity(room + 8) };
    let mut count = 0;
    for (model, number) in numbers {
        let before = (writer.low, writer.high, writer.out.len());
        writer.number(&mut models[usize::from(model)], number);
        if writer.out.len() + 1 > room {
            (writer.low, writer.high) = (before.0, before.1);
            writer.out.truncate(before.2);
            break;
        }
        count += 1;
    }
    (count, writer.end())
}

/// Reads numbers that [`pack`] wrote. Any bytes give numbers: the checksum of a packet says whether they are right.
#[derive(Debug)]
pub(super) struct Unpacker<'a> {
    low: u32,
    high: u32,
    code: u32,
    rest: &'a [u8],
    models: Vec<Model>,
}

impl<'a> Unpacker<'a> {
    /// A reader of a packet's bytes, with the models as they were before the first number.
    pub fn new(bytes: &'a [u8], models: &[Model]) -> Self {
        let mut unpacker = Self { low: 0, high: u32::MAX, code: 0, rest: bytes, models: models.to_vec() };
        (0..4).for_each(|_| unpacker.shift());
        unpacker
    }

    fn shift(&mut self) {
        let (first, rest) = self.rest.split_first().map_or((0, self.rest), |(first, rest)| (*first, rest));
        self.rest = rest;
        self.code = self.code << 8 | u32::from(first);
    }

    fn bit(&mut self, p: u16) -> bool {
        let cut = cut(self.low, self.high, p);
        let bit = self.code <= cut;
        if bit {
            self.high = cut;
        } else {
            self.low = cut + 1;
        }
        while (self.low ^ self.high) >> 24 == 0 {
            self.low <<= 8;
            self.high = self.high << 8 | 0xFF;
            self.shift();
        }
        bit
    }

    fn bit_and_follow(&mut self, model: u8, p: impl Fn(&mut Model) -> &mut u16) -> bool {
        let now = *p(&mut self.models[usize::from(model)]);
        let bit = self.bit(now);
        follow(p(&mut self.models[usize::from(model)]), bit);
        bit
    }

    /// The next number, by the model of this index.
    pub fn number(&mut self, model: u8) -> i32 {
        let mut bits = 0;
        while bits < LONGEST && self.bit_and_follow(model, |m| &mut m.longer[bits]) {
            bits += 1;
        }
        if bits == 0 {
            return 0;
        }
        let negative = self.bit(EVEN);
        let mut magnitude = 1;
        let mut context = 0;
        for depth in 0..bits - 1 {
            let bit = if depth < 2 { self.bit_and_follow(model, |m| &mut m.below[bits][context]) } else { self.bit(EVEN) };
            context = 1 + usize::from(bit);
            magnitude = magnitude << 1 | i32::from(bit);
        }
        if negative { -magnitude } else { magnitude }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_packed_is_read_again(
            numbers in prop::collection::vec((0u8..2, prop_oneof![-9i32..9, -131_070i32..131_071]), 0..400),
            steps in 0u8..=MOST_STEPS,
            room in 16usize..300,
        ) {
            let models = [Model::new(Width(steps)), Model::new(Width(20))];
            let mut rest = numbers.as_slice();
            while !rest.is_empty() {
                let (count, bytes) = pack(rest.iter().copied(), &models, room);
                prop_assert!(count > 0 && bytes.len() <= room);
                let mut unpacker = Unpacker::new(&bytes, &models);
                for &(model, number) in &rest[..count] {
                    prop_assert_eq!(unpacker.number(model), number);
                }
                rest = &rest[count..];
            }
        }
    }

    #[test]
    fn normal_numbers_take_what_they_must() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, Normal};
        for sigma in [0.6, 2.0, 9.0, 300.0] {
            let normal = Normal::new(0.0, sigma).unwrap();
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
            let numbers: Vec<(u8, i32)> = (0..20_000).map(|_| (0, f64::round(normal.sample(&mut random)) as i32)).collect();
            let models = [Model::new(Width::of_sigma(sigma))];
            let (mut rest, mut bytes) = (numbers.as_slice(), 0);
            while !rest.is_empty() {
                let (count, packed) = pack(rest.iter().copied(), &models, 219);
                (rest, bytes) = (&rest[count..], bytes + packed.len());
            }
            let bits = 8.0 * bytes as f64 / numbers.len() as f64;
            // Entropy of a normal distribution that is rounded, near enough from σ = ½ on.
            let least = 0.5 * (std::f64::consts::TAU * std::f64::consts::E * (sigma * sigma + 1.0 / 12.0)).log2();
            println!("σ {sigma}: {bits:.3} bits, {least:.3} at least");
            assert!(bits < 1.02 * least + 0.04, "σ {sigma}: {bits} bits, {least} at least");
        }
    }
}
