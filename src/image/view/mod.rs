//! The thin-link view: one frame as a stream of small packets for a link of some kbit/s, recognisable in its first 2 kB and exact at its
//! end.
//!
//! [`View`] makes the packets. The first has the sources and what is known of the frame; those up to [`FIRST_BYTES`] a thumbnail; then
//! come the blocks around the sources, exactly, the means of all other blocks, and their detail from coarse to fine. Each packet has its
//! own checksum and is read without any other but the first, so that a lost one leaves a gap and no more. [`Assembly`] puts them together
//! in any order, says which are missing, and shows at any time what there is. `proto/view.md` is the specification.
//!
//! Pure: no clock, no link. Sources come in as plain numbers, since those who find them come after this room.

mod assembly;
mod coder;
mod head;
mod packet;
#[cfg(test)]
mod tests;
mod thumbnail;
mod transform;

pub use assembly::{Assembly, Taken};
pub use head::{MOST_VIEW_SOURCES, ThumbnailScale, ViewHead};
pub use packet::{ViewRefusal, packets_in};
pub use thumbnail::THUMBNAIL_PX;

use super::{Frame, auto_level};
use coder::{Model, Width, pack};
use packet::{MOST_IN_RUN, MOST_PACKETS, OVERHEAD, Packet, Part, Run, run_overhead};
use std::ops::RangeInclusive;
use thumbnail::Thumbnail;
use transform::{CLASSES, MEAN, Order, forward};

/// The bytes, all counted, in which a stream has the sources and the thumbnail.
pub const FIRST_BYTES: usize = 2000;
/// Bytes of a packet, all counted: fits the 256 of an AX.25 frame (version 2.2, § 6.7.2.3) with 16 for whoever carries it, and takes a
/// quarter of a second at 9600 baud, so that what is lost with one is little and nothing waits long behind it.
pub const PACKET_BYTES: usize = 240;
/// What may be asked for: the first has room for the head, and a payload's length has two bytes.
pub const PACKET_BYTES_RANGE: RangeInclusive<usize> = 224..=4096;
/// Most pixels of a frame: the largest sensors have 60 megapixels.
pub const MOST_PIXELS: usize = 1 << 26;
/// Fewer bytes of thumbnail than this are not worth a packet.
const LEAST_THUMBNAIL_ROOM: usize = 48;

const _: () = assert!(OVERHEAD + head::FIXED_BYTES + MOST_VIEW_SOURCES * head::SOURCE_BYTES <= *PACKET_BYTES_RANGE.start());

/// A source as the view sends it.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ViewSource {
    /// Position in file order, px.
    pub x: f64,
    /// Position in file order, px.
    pub y: f64,
    /// Flux above the surroundings, ADU; sent to 5 %.
    pub flux: f64,
}

/// Why a frame can't be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum ViewError {
    /// The packets would be too short or too long.
    #[error("packets of {0} bytes, expected {min} to {max}", min = PACKET_BYTES_RANGE.start(), max = PACKET_BYTES_RANGE.end())]
    PacketBytes(usize),
    /// It has too many pixels, columns or rows, or not as many pixels as its size says.
    #[error("a frame of {width} × {height} px, expected at most 65535 columns and rows and {MOST_PIXELS} px")]
    Size {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// It needs more packets than there are numbers.
    #[error("it takes {0} packets, at most {MOST_PACKETS} have numbers")]
    TooManyPackets(usize),
}

/// One frame as packets, the most important first. The same frame and sources give the same bytes.
#[derive(Debug, Clone)]
pub struct View {
    bytes: Vec<u8>,
    /// Where each packet ends.
    ends: Vec<usize>,
    stream: u32,
}

impl View {
    /// Encodes a frame. Of the sources, the brightest first, [`MOST_VIEW_SOURCES`] are sent. No packet is longer than `packet_bytes`.
    ///
    /// # Errors
    /// Where the packets are too short, or the frame too large.
    pub fn new(frame: &Frame, sources: &[ViewSource], packet_bytes: usize) -> Result<Self, ViewError> {
        let (width, height) = (frame.width, frame.height);
        if !PACKET_BYTES_RANGE.contains(&packet_bytes) {
            return Err(ViewError::PacketBytes(packet_bytes));
        }
        let pixels =
            width.checked_mul(height).filter(|&pixels| (1..=MOST_PIXELS).contains(&pixels) && pixels == frame.pixels.len());
        if pixels.is_none() || width.max(height) > usize::from(u16::MAX) {
            return Err(ViewError::Size { width, height });
        }
        let sources = head::keep(sources, width, height);
        let head_bytes = OVERHEAD + head::FIXED_BYTES + sources.len() * head::SOURCE_BYTES;
        let thumbnail = Thumbnail::new(frame, &rooms(FIRST_BYTES - head_bytes, packet_bytes));
        let mut head = ViewHead {
            width,
            height,
            rows: frame.rows,
            full_scale: frame.full_scale,
            stamp: frame.stamp.clone(),
            level: auto_level(frame),
            sources,
            thumbnail: thumbnail.scale,
            packets: 0,
            checksum: head::checksum(&frame.pixels),
            widths: [thumbnail.width; CLASSES + 1],
        };
        let payloads = picture(frame, &mut head, packet_bytes - OVERHEAD);
        let packets = 1 + thumbnail.payloads.len() + payloads.len();
        if packets > MOST_PACKETS {
            return Err(ViewError::TooManyPackets(packets));
        }
        head.packets = packets as u32;
        let first = head.payload();
        let mut view = Self { bytes: Vec::new(), ends: Vec::with_capacity(packets), stream: crc32fast::hash(&first) };
        std::iter::once(&first).chain(&thumbnail.payloads).chain(&payloads).for_each(|payload| view.push(payload));
        Ok(view)
    }

    fn push(&mut self, payload: &[u8]) {
        let number = self.ends.len() as u32;
        Packet { number, stream: self.stream, payload }.write(&mut self.bytes);
        self.ends.push(self.bytes.len());
    }

    /// The stream's name: the checksum of its head.
    pub fn stream(&self) -> u32 {
        self.stream
    }

    /// How many packets there are.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there are no packets; never so.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The packet of a number.
    pub fn packet(&self, number: usize) -> Option<&[u8]> {
        let start = number.checked_sub(1).map_or(Some(0), |before| self.ends.get(before).copied())?;
        self.bytes.get(start..*self.ends.get(number)?)
    }

    /// How many packets the first [`FIRST_BYTES`] are: those with the sources and the thumbnail, and what of the picture fits.
    pub fn first_packets(&self) -> usize {
        self.ends.partition_point(|&end| end <= FIRST_BYTES)
    }

    /// All packets, one after the other.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }
}

/// The rooms for payloads of packets that have so many bytes in all.
fn rooms(mut bytes: usize, packet_bytes: usize) -> Vec<usize> {
    let mut rooms = Vec::new();
    while bytes > OVERHEAD + LEAST_THUMBNAIL_ROOM {
        let packet = bytes.min(packet_bytes);
        rooms.push(packet - OVERHEAD);
        bytes -= packet;
    }
    rooms
}

/// The width of numbers whose magnitudes these are, without the few that are far out.
fn width_of(magnitudes: impl Iterator<Item = f64> + Clone) -> Width {
    /// σ of normally distributed numbers over the mean of their magnitudes, √(π/2).
    const SIGMA_OF_MEAN: f64 = 1.253_314;
    /// Magnitudes of more than so many times the mean are stars and defects.
    const FAR: f64 = 4.0;
    let mean_below = |limit: f64| {
        let (mut sum, mut count) = (0.0, 0.0);
        magnitudes
            .clone()
            .filter(|magnitude| *magnitude <= limit)
            .for_each(|magnitude| (sum, count) = (sum + magnitude, count + 1.0));
        if count > 0.0 { sum / count } else { 0.0 }
    };
    let all = mean_below(f64::INFINITY);
    Width::of_sigma(SIGMA_OF_MEAN * mean_below(FAR * all))
}

/// The payloads of the picture itself; the head learns how widely its coefficients lie.
fn picture(frame: &Frame, head: &mut ViewHead, room: usize) -> Vec<Vec<u8>> {
    let mut plane: Vec<i32> = frame.pixels.iter().map(|&adu| i32::from(adu)).collect();
    forward(&mut plane, frame.width);
    let order = Order::new(frame.width, frame.height, head.source_pixels());
    let numbers: Vec<i32> = order.places.iter().map(|&place| plane.get(place as usize).copied().unwrap_or(0)).collect();
    widths(&order.classes, &numbers, &mut head.widths);
    let models: Vec<Model> = head.coefficient_models();
    let (mut classes, mut numbers) = (order.classes.as_slice(), numbers.as_slice());
    let mut payloads = Vec::new();
    let mut first = 0;
    while !numbers.is_empty() {
        let mut before = i32::from(head.level.low);
        let steps = classes.iter().zip(numbers).take(MOST_IN_RUN).map(|(&class, &number)| {
            // The mean of a block is sent as what it differs from the one before it in the same packet.
            if class == MEAN { (class, number - std::mem::replace(&mut before, number)) } else { (class, number) }
        });
        let (count, coded) = pack(steps, &models, room - run_overhead(first));
        payloads.push(Run { part: Part::Picture, first, count, coded: &coded }.payload());
        (classes, numbers) = (classes.get(count..).unwrap_or_default(), numbers.get(count..).unwrap_or_default());
        first += count;
    }
    payloads
}

/// How widely the coefficients of each class lie; of means, their differences.
fn widths(classes: &[u8], numbers: &[i32], widths: &mut [Width; CLASSES + 1]) {
    let mut of_class: [Vec<f64>; CLASSES] = Default::default();
    let mut before = None;
    for (&class, &number) in classes.iter().zip(numbers) {
        let number = if class == MEAN { number - before.replace(number).unwrap_or(number) } else { number };
        if let Some(of_class) = of_class.get_mut(usize::from(class)) {
            of_class.push(f64::from(number.unsigned_abs()));
        }
    }
    widths.iter_mut().zip(&of_class).for_each(|(width, magnitudes)| *width = width_of(magnitudes.iter().copied()));
}
