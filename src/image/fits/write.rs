//! Writing a frame: a header of standard keywords and ours, and 16-bit pixels.

use std::io::Write;

use super::header::{BLOCK, CARD};
use super::stamp;
use crate::image::write::WriteError;
use crate::image::{Frame, write};

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

    fn push(&mut self, keyword: &str, value: &str, comment: &str) {
        let mut card = format!("{keyword:<8}= {value} / {comment}").into_bytes();
        card.resize(CARD, b' ');
        self.0.extend(card);
    }

    /// The header, with its end and padded to whole blocks.
    fn finish(mut self) -> Vec<u8> {
        self.0.extend(b"END");
        self.0.resize(self.0.len().next_multiple_of(BLOCK), b' ');
        self.0
    }
}

/// Writes a frame as FITS, bottom row first; see [`write::write_fits`].
pub(in crate::image) fn write(frame: &Frame, out: &mut impl Write) -> Result<(), WriteError> {
    let rows = write::rows(frame, crate::sky::RowOrder::BottomFirst)?;
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
    out.write_all(&cards.finish())?;

    let mut line = Vec::with_capacity(2 * frame.width);
    for row in rows {
        line.clear();
        line.extend(row.iter().flat_map(|&adu| (adu ^ 0x8000).to_be_bytes()));
        out.write_all(&line)?;
    }
    let data = 2 * frame.pixels.len();
    out.write_all(&vec![0; data.next_multiple_of(BLOCK) - data])?;
    Ok(())
}
