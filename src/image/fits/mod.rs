//! FITS files, the few that a star camera meets: one two-dimensional image in the first header and data unit.
//!
//! Standard: FITS 4.0 (IAU FITS Working Group, 2018). Our own small reader stands here instead of a library because a
//! replayed file may be cut or lie: every size that a header claims is compared with the bytes there are before anything
//! is allocated. Long keywords (`HIERARCH`) are read, for the flight's files, and never written.

mod checksum;
mod header;
mod pixels;
mod stamp;
mod write;

use header::Header;
pub(super) use write::write;
pub use write::{Keyword, KeywordValue};

use super::Frame;
use super::read::Problem;
use crate::sky::RowOrder;

/// The first bytes of every FITS file.
pub(super) const MAGIC: &[u8] = b"SIMPLE  =";

/// Reads the image of a FITS file; the stamp is what the header says, with no origin.
pub(super) fn read(bytes: &[u8]) -> Result<Frame, Problem> {
    let (header, data) = Header::parse(bytes)?;
    let layout = pixels::Layout::of(&header)?;
    let pixels = layout.decode(data)?;
    // `ROWORDER` is the convention of amateur cameras; without it, FITS counts rows from the bottom.
    let rows = match header.text("ROWORDER").as_deref() {
        Some("TOP-DOWN") => RowOrder::TopFirst,
        _ => RowOrder::BottomFirst,
    };
    let full_scale = header.integer("SATURATE").and_then(|v| u16::try_from(v).ok()).filter(|&v| v > 0);
    let mut frame = Frame::new(layout.width, layout.height, pixels, rows).ok_or(Problem::Empty)?;
    frame.full_scale = full_scale.or(layout.full_scale());
    frame.stamp = stamp::from_header(&header);
    Ok(frame)
}

/// Whether the checksums of a file of one header and data hold; `None` where it has none.
pub fn checksum_holds(bytes: &[u8]) -> Option<bool> {
    let (header, _) = Header::parse(bytes).ok()?;
    header.text("CHECKSUM")?;
    Some(checksum::hold(bytes))
}
