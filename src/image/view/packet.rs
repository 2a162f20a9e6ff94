//! What surrounds the payload of each packet: magic, version, number, stream, length and checksum.

use bytes::{Buf, BufMut};

/// What a packet begins with: "sV", and the version of the format.
const MAGIC: [u8; 3] = [b's', b'V', 1];
/// Bytes before the payload: magic, number (three bytes), stream (four), length of the payload (two).
const HEAD: usize = MAGIC.len() + 3 + 4 + 2;
/// Bytes of a packet that are not payload.
pub(super) const OVERHEAD: usize = HEAD + 4;
/// Numbers have three bytes.
pub(super) const MOST_PACKETS: usize = 1 << 24;
/// Bytes of a number of variable length: 28 bits in groups of seven.
const LONGEST_NUMBER: usize = 4;

/// Why a packet was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ViewRefusal {
    /// It does not begin as a packet, or ends too soon.
    #[error("not a packet of a view")]
    NotAPacket,
    /// Its length is not the one that it says.
    #[error("the packet has {got} bytes and says {said}")]
    Length {
        /// Bytes of it.
        got: usize,
        /// Bytes that it should have.
        said: usize,
    },
    /// It was damaged.
    #[error("the packet's checksum is wrong")]
    Checksum,
    /// It belongs to another picture.
    #[error("the packet is of stream {got:08x}, wanted {wanted:08x}")]
    OtherStream {
        /// Its stream.
        got: u32,
        /// The one that is put together.
        wanted: u32,
    },
    /// Its checksum is right and it makes no sense: no encoder made it.
    #[error("packet {number} contradicts itself or the head")]
    Nonsense {
        /// Its number.
        number: u32,
    },
    /// The picture has more pixels than the receiver allows.
    #[error("the picture has {pixels} px, at most {most} are taken")]
    TooLarge {
        /// Pixels that the head says.
        pixels: usize,
        /// Most that are taken.
        most: usize,
    },
    /// Too much came before the head, packet 0, without which it cannot be read.
    #[error("no room for more packets before packet 0 has come")]
    NoRoom,
}

/// A packet whose checksum is right; its payload is not looked at yet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Packet<'a> {
    pub number: u32,
    pub stream: u32,
    pub payload: &'a [u8],
}

impl<'a> Packet<'a> {
    /// Reads one packet of exactly these bytes.
    pub fn read(bytes: &'a [u8]) -> Result<Self, ViewRefusal> {
        let (mut rest, end) = bytes
            .strip_prefix(&MAGIC)
            .filter(|rest| rest.len() >= OVERHEAD - MAGIC.len())
            .and_then(|rest| Some((rest, bytes.last_chunk::<4>()?)))
            .ok_or(ViewRefusal::NotAPacket)?;
        let (number, stream) = (rest.get_uint_le(3) as u32, rest.get_u32_le());
        let said = OVERHEAD + usize::from(rest.get_u16_le());
        if said != bytes.len() {
            return Err(ViewRefusal::Length { got: bytes.len(), said });
        }
        let covered = bytes.get(..bytes.len() - end.len()).unwrap_or_default();
        if crc32fast::hash(covered) != u32::from_le_bytes(*end) {
            return Err(ViewRefusal::Checksum);
        }
        Ok(Self { number, stream, payload: covered.get(HEAD..).unwrap_or_default() })
    }

    /// Appends the packet. Its number is below [`MOST_PACKETS`] and its payload shorter than 64 KiB.
    pub fn write(&self, out: &mut Vec<u8>) {
        let start = out.len();
        out.put_slice(&MAGIC);
        out.put_uint_le(u64::from(self.number), 3);
        out.put_u32_le(self.stream);
        out.put_u16_le(self.payload.len() as u16);
        out.put_slice(self.payload);
        let checksum = crc32fast::hash(out.get(start..).unwrap_or_default());
        out.put_u32_le(checksum);
    }
}

/// The packets of a file or a recording of a link, one after the other; what stands between them is passed over.
pub fn packets_in(bytes: &[u8]) -> impl Iterator<Item = &[u8]> {
    let mut rest = bytes;
    std::iter::from_fn(move || {
        loop {
            let start = rest.windows(MAGIC.len()).position(|window| window == MAGIC)?;
            rest = rest.get(start..)?;
            let length = rest.get(HEAD - 2..HEAD).and_then(|field| field.first_chunk::<2>());
            let length = OVERHEAD + usize::from(u16::from_le_bytes(*length?));
            if let Some(packet) = rest.get(..length).filter(|packet| Packet::read(packet).is_ok()) {
                rest = rest.get(length..)?;
                return Some(packet);
            }
            rest = rest.get(1..)?;
        }
    })
}

/// What a payload begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// The head of the stream.
    Head,
    /// Cells of the thumbnail.
    Thumbnail,
    /// Coefficients of the picture.
    Picture,
}

impl Part {
    /// The byte that says it.
    pub fn code(self) -> u8 {
        match self {
            Self::Head => 0,
            Self::Thumbnail => 1,
            Self::Picture => 2,
        }
    }
}

/// A run of numbers: which part they are of, the index of the first, how many, and their coded bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run<'a> {
    pub part: Part,
    pub first: usize,
    pub count: usize,
    pub coded: &'a [u8],
}

/// Most bytes of a run that are not coded numbers, where it begins at this index.
pub(super) fn run_overhead(first: usize) -> usize {
    // How many there will be is not known yet; four million and more need four bytes.
    1 + number_bytes(first) + 3
}

/// Most numbers that a run may have, so that its length needs no more bytes than [`run_overhead`] says.
pub(super) const MOST_IN_RUN: usize = (1 << 21) - 1;

fn number_bytes(number: usize) -> usize {
    let bits = usize::BITS - number.leading_zeros();
    (bits.div_ceil(7) as usize).max(1)
}

impl<'a> Run<'a> {
    /// Reads a payload; `None` where it is no run.
    pub fn read(payload: &'a [u8]) -> Option<Self> {
        let (part, mut coded) = payload.split_first()?;
        let part = [Part::Thumbnail, Part::Picture].into_iter().find(|wanted| wanted.code() == *part)?;
        let (first, count) = (take_number(&mut coded)?, take_number(&mut coded)?);
        Some(Self { part, first, count, coded })
    }

    /// The payload of this run.
    pub fn payload(&self) -> Vec<u8> {
        let mut payload = vec![self.part.code()];
        for mut number in [self.first, self.count] {
            while number >= 0x80 {
                payload.push(number as u8 | 0x80);
                number >>= 7;
            }
            payload.push(number as u8);
        }
        payload.extend_from_slice(self.coded);
        payload
    }
}

/// A number in groups of seven bits, lowest first, all but the last with their top bit set (LEB128).
fn take_number(bytes: &mut &[u8]) -> Option<usize> {
    let mut number = 0;
    for group in 0..LONGEST_NUMBER {
        let (first, rest) = bytes.split_first()?;
        *bytes = rest;
        number |= usize::from(first & 0x7F) << (7 * group);
        if first & 0x80 == 0 {
            return Some(number);
        }
    }
    None
}
