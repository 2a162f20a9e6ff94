//! Frames: sync word · length · kind · version · body · CRC-32.

use super::WireError;
use bytes::{Buf, BufMut, Bytes, BytesMut};

/// The bytes that every frame begins with: the attached sync marker of CCSDS 131.0-B, chosen there for its low chance
/// of turning up in data or shifted against itself.
pub const SYNC: [u8; 4] = [0x1A, 0xCF, 0xFC, 0x1D];
/// Longest frame, everything counted, bytes.
pub const MAX_FRAME: usize = 64 * 1024;
/// Bytes of a frame that are not body: sync word, length, kind, version and checksum.
pub const OVERHEAD: usize = HEAD + 2 + CHECKSUM;

/// Sync word and length.
const HEAD: usize = SYNC.len() + 4;
/// Bytes of the CRC-32.
const CHECKSUM: usize = 4;
/// What the length counts is at least kind, version and checksum.
const LEAST_LENGTH: usize = 2 + CHECKSUM;

/// A frame whose checksum is right; what it carries is not looked at yet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct RawFrame {
    pub kind: u8,
    pub version: u8,
    pub body: Bytes,
}

/// CRC-32 of some bytes: IEEE 802.3, as zlib and Python's `binascii.crc32` compute it.
pub(super) fn crc32(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

/// Appends a frame.
pub(super) fn put_frame(kind: u8, version: u8, body: &[u8], out: &mut BytesMut) -> Result<(), WireError> {
    let total = body.len() + OVERHEAD;
    if total > MAX_FRAME {
        return Err(WireError::TooLong { bytes: total });
    }
    let length = u32::try_from(total - HEAD).map_err(|_| WireError::TooLong { bytes: total })?;
    let mut digest = crc32fast::Hasher::new();
    digest.update(&[kind, version]);
    digest.update(body);
    out.reserve(total);
    out.put_slice(&SYNC);
    out.put_u32_le(length);
    out.put_u8(kind);
    out.put_u8(version);
    out.put_slice(body);
    out.put_u32_le(digest.finalize());
    Ok(())
}

/// Throws away what stands before the next sync word, and says how much. Up to three bytes that may be the beginning of
/// one are kept.
pub(super) fn skip_to_sync(buffer: &mut BytesMut) -> usize {
    let whole = buffer.windows(SYNC.len()).position(|window| window == SYNC);
    let skip = whole.unwrap_or_else(|| {
        let kept = (1..SYNC.len()).rev().find(|kept| SYNC.get(..*kept).is_some_and(|head| buffer.ends_with(head)));
        buffer.len() - kept.unwrap_or(0)
    });
    buffer.advance(skip);
    skip
}

/// Takes the frame that the buffer begins with; `None` where more bytes are needed. After an error the sync word is gone,
/// so that a caller who goes on looks for the next one.
pub(super) fn take_frame(buffer: &mut BytesMut) -> Result<Option<RawFrame>, WireError> {
    let Some(length) = buffer.get(SYNC.len()..).and_then(|rest| rest.first_chunk::<4>()) else { return Ok(None) };
    let length = u32::from_le_bytes(*length) as usize;
    if length > MAX_FRAME - HEAD {
        buffer.advance(SYNC.len());
        return Err(WireError::TooLong { bytes: length.saturating_add(HEAD) });
    }
    if length < LEAST_LENGTH {
        buffer.advance(SYNC.len());
        return Err(WireError::TooShort { length });
    }
    let Some(covered) = buffer.get(HEAD..HEAD + length - CHECKSUM) else { return Ok(None) };
    let Some(said) = buffer.get(HEAD + length - CHECKSUM..).and_then(|rest| rest.first_chunk::<CHECKSUM>()) else {
        return Ok(None);
    };
    let (computed, said) = (crc32(covered), u32::from_le_bytes(*said));
    if computed != said {
        buffer.advance(SYNC.len());
        return Err(WireError::BadChecksum { computed, said });
    }
    let mut frame = buffer.split_to(HEAD + length).freeze();
    frame.advance(HEAD);
    frame.truncate(length - CHECKSUM);
    let (kind, version) = (frame.get_u8(), frame.get_u8());
    Ok(Some(RawFrame { kind, version, body: frame }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_zlib() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn half_a_sync_word_at_the_end_is_kept() {
        let mut buffer = BytesMut::from(&[9, 9, 0x1A, 0xCF, 0xFC][..]);
        assert_eq!(skip_to_sync(&mut buffer), 2);
        assert_eq!(&buffer[..], &SYNC[..3]);
        let mut buffer = BytesMut::from(&[9, 0x1A, 0xCF, 7][..]);
        assert_eq!(skip_to_sync(&mut buffer), 4);
    }

    #[test]
    fn the_longest_frame_passes_and_one_byte_more_does_not() {
        let mut out = BytesMut::new();
        put_frame(9, 1, &vec![0; MAX_FRAME - OVERHEAD], &mut out).unwrap();
        assert_eq!(out.len(), MAX_FRAME);
        assert_eq!(take_frame(&mut out).unwrap().unwrap().body.len(), MAX_FRAME - OVERHEAD);
        assert_eq!(
            put_frame(9, 1, &vec![0; MAX_FRAME - OVERHEAD + 1], &mut out),
            Err(WireError::TooLong { bytes: MAX_FRAME + 1 })
        );
        let mut long = BytesMut::from(&SYNC[..]);
        long.put_u32_le((MAX_FRAME - HEAD + 1) as u32);
        assert_eq!(take_frame(&mut long), Err(WireError::TooLong { bytes: MAX_FRAME + 1 }));
    }
}
