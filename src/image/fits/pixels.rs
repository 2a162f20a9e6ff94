//! The data unit: how a header says that its pixels are laid out, and reading them.

use super::header::Header;
use crate::image::read::{Problem, check_size};

/// How the pixels of an image are stored.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    bits: Bits,
    /// Physical value = zero + scale × stored value.
    scale: f64,
    zero: f64,
    /// Stored value of a pixel without a value (whole numbers only).
    blank: Option<i64>,
}

/// `BITPIX`: whole numbers, or floating point where negative.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Bits {
    U8,
    I16,
    I32,
    F32,
    F64,
}

impl Layout {
    /// Reads the mandatory keywords and the scaling; says which keyword is wrong.
    pub fn of(header: &Header) -> Result<Self, Problem> {
        let bits = match header.required("BITPIX")? {
            8 => Bits::U8,
            16 => Bits::I16,
            32 => Bits::I32,
            -32 => Bits::F32,
            -64 => Bits::F64,
            other => return Err(bad("BITPIX", other, "8, 16, 32, -32 or -64")),
        };
        match header.required("NAXIS")? {
            2 => {}
            3 if header.required("NAXIS3")? == 1 => {}
            0 => return Err(Problem::NoImage),
            other => return Err(bad("NAXIS", other, "2 (a grey image)")),
        }
        let (width, height) = check_size(header.required("NAXIS1")?, header.required("NAXIS2")?)?;
        let scaling = |keyword, default| match header.card(keyword) {
            None => Ok(default),
            Some(card) => {
                let number = card.number();
                number.ok_or(Problem::BadKeyword { keyword, value: card.value, expected: "a number" })
            }
        };
        let (scale, zero) = (scaling("BSCALE", 1.0)?, scaling("BZERO", 0.0)?);
        if scale == 0.0 {
            return Err(bad("BSCALE", 0, "a number other than 0"));
        }
        Ok(Self { width, height, bits, scale, zero, blank: header.integer("BLANK") })
    }

    /// Highest value that the type can hold, where that is also the end of the camera's scale.
    pub fn full_scale(&self) -> Option<u16> {
        (self.bits == Bits::U8 && self.is_plain() && self.zero == 0.0).then_some(255)
    }

    /// Reads the pixels, rounded to whole ADU.
    ///
    /// Values below 0 and pixels without a value become 0, which is an error where most are so. Values above 65535, and
    /// floating-point images that never exceed 1, would lose their contents in 16 bits and are errors.
    pub fn decode(&self, data: &[u8]) -> Result<Vec<u16>, Problem> {
        let pixels = self.width * self.height;
        let need = pixels * self.bits.bytes();
        let data = data.get(..need).ok_or(Problem::Cut { what: "pixels", need, got: data.len() })?;
        match self.bits {
            Bits::U8 if self.is_plain() => self.whole(data.iter().map(|&b| i32::from(b))),
            Bits::I16 if self.is_plain() => self.whole(words(data).map(|w| i32::from(i16::from_be_bytes(w)))),
            Bits::U8 => self.scaled(data.iter().map(|&b| self.unless_blank(b.into()))),
            Bits::I16 => self.scaled(words(data).map(|w| self.unless_blank(i16::from_be_bytes(w).into()))),
            Bits::I32 => self.scaled(words(data).map(|w| self.unless_blank(i32::from_be_bytes(w).into()))),
            Bits::F32 => self.scaled(words(data).map(|w| f32::from_be_bytes(w).into())),
            Bits::F64 => self.scaled(words(data).map(f64::from_be_bytes)),
        }
    }

    /// Stored whole numbers that need no more than a whole number added: what cameras write.
    fn is_plain(&self) -> bool {
        self.scale == 1.0 && self.zero.fract() == 0.0 && self.zero.abs() <= 65_536.0 && self.blank.is_none()
    }

    /// The plain case, in simple passes that become vector instructions.
    fn whole(&self, stored: impl Iterator<Item = i32> + Clone) -> Result<Vec<u16>, Problem> {
        let zero = self.zero as i32;
        // Neither number has more than 17 bits, so that nothing wraps; a checked sum would cost the vectors.
        let adu = stored.clone().map(|value| value.wrapping_add(zero));
        let (lowest, highest) = adu.clone().fold((i32::MAX, i32::MIN), |(low, high), v| (low.min(v), high.max(v)));
        if highest > i32::from(u16::MAX) {
            return self.scaled(stored.map(f64::from)); // which finds the pixel
        }
        if lowest < 0 {
            self.refuse_if_most(adu.clone().filter(|&v| v < 0).count())?;
        }
        Ok(adu.map(|v| v.max(0) as u16).collect())
    }

    /// Any type and scaling; a pixel without a value is NaN.
    fn scaled(&self, stored: impl Iterator<Item = f64>) -> Result<Vec<u16>, Problem> {
        let mut pixels = Vec::with_capacity(self.width * self.height);
        let (mut unusable, mut highest) = (0, 0.0_f64);
        for (i, value) in stored.enumerate() {
            let adu = (self.zero + self.scale * value).round();
            if adu > 65_535.0 {
                return Err(Problem::ValueTooLarge { value: adu, x: i % self.width, y: i / self.width });
            }
            unusable += usize::from(adu.is_nan() || adu < 0.0);
            highest = highest.max(self.zero + self.scale * value);
            pixels.push(adu.max(0.0) as u16); // `max` takes 0 for a NaN
        }
        self.refuse_if_most(unusable)?;
        if matches!(self.bits, Bits::F32 | Bits::F64) && highest > 0.0 && highest <= 1.0 {
            return Err(Problem::Normalised { highest });
        }
        Ok(pixels)
    }

    fn unless_blank(&self, stored: i64) -> f64 {
        if self.blank == Some(stored) { f64::NAN } else { stored as f64 }
    }

    fn refuse_if_most(&self, unusable: usize) -> Result<(), Problem> {
        let of = self.width * self.height;
        if unusable * 2 > of { Err(Problem::MostlyUnusable { unusable, of }) } else { Ok(()) }
    }
}

impl Bits {
    fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::I16 => 2,
            Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// The data as words of `N` bytes.
fn words<const N: usize>(data: &[u8]) -> impl Iterator<Item = [u8; N]> + Clone {
    data.as_chunks::<N>().0.iter().copied()
}

fn bad(keyword: &'static str, value: i64, expected: &'static str) -> Problem {
    Problem::BadKeyword { keyword, value: value.to_string(), expected }
}
