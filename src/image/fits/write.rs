//! Writing a frame: a header of standard keywords and ours, and 16-bit pixels.

use std::io::Write;

use super::checksum::{self, Sum};
use super::header::{BLOCK, CARD};
use super::stamp;
use crate::image::write::WriteError;
use crate::image::{Frame, write};
use crate::sky::RowOrder;

/// A keyword that goes into a header beside those of the frame and its stamp.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyword {
    /// At most eight capitals, digits, `-` and `_`.
    pub name: String,
    /// Its value.
    pub value: KeywordValue,
    /// What it means, its unit in brackets first.
    pub comment: &'static str,
}

/// The value of a keyword.
#[derive(Debug, Clone, PartialEq)]
pub enum KeywordValue {
    /// A string; of one that does not fit in a card the end is kept.
    Text(String),
    /// A whole number.
    Integer(i64),
    /// A real number; left out where it is not finite.
    Real(f64),
    /// True or false.
    Logical(bool),
}

impl Keyword {
    /// A keyword of a name, a value and what it means.
    pub fn new(name: impl Into<String>, value: impl Into<KeywordValue>, comment: &'static str) -> Self {
        Self { name: name.into(), value: value.into(), comment }
    }
}

impl From<&str> for KeywordValue {
    fn from(value: &str) -> Self {
        Self::Text(value.to_owned())
    }
}

impl From<i64> for KeywordValue {
    fn from(value: i64) -> Self {
        Self::Integer(value)
    }
}

impl From<f64> for KeywordValue {
    fn from(value: f64) -> Self {
        Self::Real(value)
    }
}

impl From<bool> for KeywordValue {
    fn from(value: bool) -> Self {
        Self::Logical(value)
    }
}

/// Cards of a header in the making.
#[derive(Debug, Default)]
pub(super) struct Cards(Vec<u8>);

impl Cards {
    /// A whole number.
    pub fn integer(&mut self, keyword: &str, value: impl Into<i64>, comment: &str) {
        self.push(keyword, &format!("{:>20}", value.into()), comment);
    }

    /// A real number, in the fewest digits that read back as the same double; nothing where it is not finite.
    pub fn real(&mut self, keyword: &str, value: f64, comment: &str) {
        if value.is_finite() {
            self.push(keyword, &format!("{:>20}", format!("{value:?}").replace('e', "E")), comment);
        }
    }

    /// True or false.
    pub fn logical(&mut self, keyword: &str, value: bool, comment: &str) {
        self.push(keyword, &format!("{:>20}", if value { "T" } else { "F" }), comment);
    }

    /// A string, in printable ASCII; of one that does not fit in a card, the end.
    pub fn text(&mut self, keyword: &str, value: &str, comment: &str) {
        const ROOM: usize = CARD - 12; // keyword, equals sign, blank and two quotes
        let printable = |c: char| if c.is_ascii_graphic() || c == ' ' { c } else { '?' };
        let mut room = ROOM;
        let fits = |c: &char| {
            let takes = if *c == '\'' { 2 } else { 1 };
            room.checked_sub(takes).inspect(|&left| room = left).is_some()
        };
        let reversed: Vec<char> = value.chars().map(printable).rev().take_while(fits).collect();
        let kept: String = reversed.into_iter().rev().collect();
        let quoted = format!("'{:<8}'", kept.replace('\'', "''"));
        self.push(keyword, &format!("{quoted:<20}"), comment);
    }

    /// Any keyword.
    fn keyword(&mut self, Keyword { name, value, comment }: &Keyword) {
        match value {
            KeywordValue::Text(value) => self.text(name, value, comment),
            KeywordValue::Integer(value) => self.integer(name, *value, comment),
            KeywordValue::Real(value) => self.real(name, *value, comment),
            KeywordValue::Logical(value) => self.logical(name, *value, comment),
        }
    }

    fn push(&mut self, keyword: &str, value: &str, comment: &str) {
        // What does not fit in a card is cut off its comment.
        let mut card = format!("{keyword:<8}= {value} / {comment}").into_bytes();
        card.resize(CARD, b' ');
        self.0.extend(card);
    }

    /// The header, with the sums of itself and its data, its end, and padded to whole blocks.
    fn finish(mut self, mut sum: Sum) -> Vec<u8> {
        self.text("DATASUM", &sum.value().to_string(), "sum of the data");
        let start = self.0.len();
        self.text("CHECKSUM", checksum::UNSUMMED, "makes the sum of all come to -0");
        self.0.extend(b"END");
        self.0.resize(self.0.len().next_multiple_of(BLOCK), b' ');
        sum.add_bytes(&self.0);
        let letters = checksum::letters(sum.value());
        // Name, equals sign, blank and quote stand before them.
        self.0.iter_mut().skip(start + 11).zip(letters.bytes()).for_each(|(byte, letter)| *byte = letter);
        self.0
    }
}

/// A pixel as it is stored: less BZERO.
fn stored(adu: &u16) -> u16 {
    adu ^ 0x8000
}

/// Writes a frame as FITS, bottom row first; see [`write::write_fits`].
pub(in crate::image) fn write(frame: &Frame, keywords: &[Keyword], out: &mut impl Write) -> Result<(), WriteError> {
    let rows = || write::rows(frame, RowOrder::BottomFirst);
    let mut sum = Sum::default();
    rows()?.enumerate().for_each(|(row, values)| sum.add_values(values.iter().map(stored), row * frame.width % 2 == 1));
    let mut cards = Cards::default();
    cards.logical("SIMPLE", true, "conforms to FITS 4.0");
    cards.integer("BITPIX", 16, "bits per pixel");
    cards.integer("NAXIS", 2, "number of axes");
    cards.integer("NAXIS1", frame.width as i64, "[pixel] columns");
    cards.integer("NAXIS2", frame.height as i64, "[pixel] rows");
    cards.integer("BZERO", 32_768, "pixels are unsigned");
    cards.integer("BSCALE", 1, "pixels are not scaled");
    cards.text("BUNIT", "adu", "unit of the pixels");
    cards.text("ROWORDER", "BOTTOM-UP", "the first row is the bottom one");
    if let Some(full_scale) = frame.full_scale {
        cards.integer("SATURATE", full_scale, "[adu] highest value that a pixel can have");
    }
    cards.text("CREATOR", concat!("stars ", env!("CARGO_PKG_VERSION")), "program that wrote this file");
    stamp::to_cards(&frame.stamp, &mut cards);
    keywords.iter().for_each(|keyword| cards.keyword(keyword));
    out.write_all(&cards.finish(sum))?;

    let mut line = Vec::with_capacity(2 * frame.width);
    for row in rows()? {
        line.clear();
        line.extend(row.iter().flat_map(|adu| stored(adu).to_be_bytes()));
        out.write_all(&line)?;
    }
    let data = 2 * frame.pixels.len();
    out.write_all(&vec![0; data.next_multiple_of(BLOCK) - data])?;
    Ok(())
}
