//! The receiver: takes packets as they come and shows what there is.

use super::coder::{Model, Unpacker};
use super::head::checksum;
use super::packet::{Packet, Part, Run, ViewRefusal};
use super::thumbnail;
use super::transform::{BLOCK_PX, MEAN, Order, inverse};
use super::{ViewHead, ViewSource};
use crate::image::Frame;
use std::collections::BTreeMap;
use std::ops::Range;

/// Bytes of packets that are kept until the head has come: more than a whole frame of the flight camera takes.
const MOST_WAITING_BYTES: usize = 4 << 20;
/// What each of them takes besides, bytes.
const WAITING_OVERHEAD: usize = 64;
/// A coefficient that has not come: no transform gives it.
const UNKNOWN: i32 = i32::MIN;

/// What became of a packet that belongs to the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// It was new.
    New,
    /// It was here already.
    Again,
}

/// One stream as far as it has come.
///
/// Holds at most some 10 bytes for each pixel of the largest picture that it takes, and 4 MiB of packets until the head has come.
#[derive(Debug)]
pub struct Assembly {
    stream: Option<u32>,
    most_pixels: usize,
    waiting: BTreeMap<u32, Vec<u8>>,
    waiting_bytes: usize,
    open: Option<Open>,
}

/// A stream whose head has come.
#[derive(Debug)]
struct Open {
    head: ViewHead,
    models: Vec<Model>,
    thumbnail_models: [Model; 1],
    order: Order,
    /// Which packets have come, and how many have not.
    come: Vec<bool>,
    left: usize,
    /// In place, as the transform leaves them.
    plane: Vec<i32>,
    cells: Vec<Option<u16>>,
    /// All has come, and the checksum of the pixels is right.
    exact: bool,
}

impl Assembly {
    /// An assembly of the stream with this name ([`super::View::stream`]), or of whichever comes first; a picture of more pixels is refused.
    pub fn new(stream: Option<u32>, most_pixels: usize) -> Self {
        Self { stream, most_pixels, waiting: BTreeMap::new(), waiting_bytes: 0, open: None }
    }

    /// Takes one packet.
    ///
    /// # Errors
    /// Where it is damaged, of another stream, or makes no sense; then nothing changes.
    pub fn take(&mut self, bytes: &[u8]) -> Result<Taken, ViewRefusal> {
        let packet = Packet::read(bytes)?;
        let wanted = self.stream.unwrap_or(packet.stream);
        if packet.stream != wanted {
            return Err(ViewRefusal::OtherStream { got: packet.stream, wanted });
        }
        let taken = match &mut self.open {
            Some(open) => open.take(packet.number, packet.payload)?,
            None if packet.number == 0 => self.begin(&packet)?,
            None => self.keep(&packet)?,
        };
        self.stream = Some(wanted);
        Ok(taken)
    }

    /// Keeps a packet until the head comes.
    fn keep(&mut self, packet: &Packet<'_>) -> Result<Taken, ViewRefusal> {
        let bytes = packet.payload.len() + WAITING_OVERHEAD;
        if self.waiting.contains_key(&packet.number) {
            return Ok(Taken::Again);
        }
        if self.waiting_bytes + bytes > MOST_WAITING_BYTES {
            return Err(ViewRefusal::NoRoom);
        }
        self.waiting_bytes += bytes;
        self.waiting.insert(packet.number, packet.payload.to_vec());
        Ok(Taken::New)
    }

    /// Takes the head, and all that waited for it.
    fn begin(&mut self, packet: &Packet<'_>) -> Result<Taken, ViewRefusal> {
        let head = ViewHead::read(packet.payload).filter(|_| crc32fast::hash(packet.payload) == packet.stream);
        let head = head.ok_or(ViewRefusal::Nonsense { number: 0 })?;
        let (pixels, most) = (head.width * head.height, self.most_pixels);
        if pixels > most {
            return Err(ViewRefusal::TooLarge { pixels, most });
        }
        let (across, down) = thumbnail::size(head.width, head.height);
        // Each packet but the head has a number at least.
        if head.packets as usize > 1 + pixels + across * down {
            return Err(ViewRefusal::Nonsense { number: 0 });
        }
        let mut open = Open {
            models: head.coefficient_models(),
            thumbnail_models: head.thumbnail_models(),
            order: Order::new(head.width, head.height, head.source_pixels()),
            come: vec![false; head.packets as usize],
            left: head.packets as usize - 1,
            plane: vec![UNKNOWN; pixels],
            cells: vec![None; across * down],
            exact: false,
            head,
        };
        open.come.iter_mut().take(1).for_each(|come| *come = true);
        for (number, payload) in std::mem::take(&mut self.waiting) {
            // One that makes no sense is missing still.
            let _ = open.take(number, &payload);
        }
        self.waiting_bytes = 0;
        self.open = Some(open);
        Ok(Taken::New)
    }

    /// What the first packet says, once it has come.
    pub fn head(&self) -> Option<&ViewHead> {
        self.open.as_ref().map(|open| &open.head)
    }

    /// The sources, brightest first; none before the head.
    pub fn sources(&self) -> &[ViewSource] {
        self.head().map_or(&[], |head| &head.sources)
    }

    /// The packets that are missing, as at most so many ranges of numbers, the most important first. Before the head has come the end
    /// is not known, and they are those before the last one that has.
    pub fn missing(&self, most: usize) -> Vec<Range<u32>> {
        let mut gaps: Vec<Range<u32>> = Vec::new();
        let Some(open) = &self.open else {
            let mut next = 0;
            for &number in self.waiting.keys() {
                if number > next {
                    gaps.push(next..number);
                }
                next = number + 1;
            }
            if gaps.is_empty() {
                gaps.push(0..1);
            }
            gaps.truncate(most);
            return gaps;
        };
        for (number, _) in (0..).zip(&open.come).filter(|(_, come)| !**come) {
            let full = gaps.len() == most;
            match gaps.last_mut() {
                Some(gap) if gap.end == number => gap.end += 1,
                _ if full => break,
                _ => gaps.push(number..number + 1),
            }
        }
        gaps
    }

    /// Packets that have come, and all there are where that is known.
    pub fn progress(&self) -> (usize, Option<usize>) {
        match &self.open {
            Some(open) => (open.come.len() - open.left, Some(open.come.len())),
            None => (self.waiting.len(), None),
        }
    }

    /// Whether the picture is the one that was sent, pixel for pixel: all has come, and the checksum of all pixels is right.
    pub fn is_exact(&self) -> bool {
        self.open.as_ref().is_some_and(|open| open.exact)
    }

    /// The thumbnail, once a part of it has come. Its values count [`super::ThumbnailScale::step`] from the darkest cell on, and are to be
    /// levelled; a cell that has not come has the mean of the others.
    pub fn thumbnail(&self) -> Option<Frame> {
        let open = self.open.as_ref()?;
        let (across, down) = thumbnail::size(open.head.width, open.head.height);
        let mean = open.mean_cell()?;
        Frame::new(across, down, open.cells.iter().map(|cell| cell.unwrap_or(mean)).collect(), open.head.rows)
    }

    /// The best picture that can be made of what has come, in full size; exact where [`Assembly::is_exact`]. `None` before the head.
    pub fn picture(&self) -> Option<Frame> {
        let open = self.open.as_ref()?;
        open.head.frame(open.pixels())
    }
}

impl Open {
    fn take(&mut self, number: u32, payload: &[u8]) -> Result<Taken, ViewRefusal> {
        let nonsense = ViewRefusal::Nonsense { number };
        if *self.come.get(number as usize).ok_or(nonsense)? {
            return Ok(Taken::Again);
        }
        let run = Run::read(payload).ok_or(nonsense)?;
        let end = run.first.checked_add(run.count).ok_or(nonsense)?;
        match run.part {
            Part::Thumbnail if end <= self.cells.len() => {
                let across = thumbnail::size(self.head.width, self.head.height).0;
                thumbnail::read(&run, &self.thumbnail_models, &mut self.cells, across);
            }
            Part::Picture if end <= self.plane.len() => self.coefficients(&run),
            _ => return Err(nonsense),
        }
        self.come.iter_mut().skip(number as usize).take(1).for_each(|come| *come = true);
        self.left -= 1;
        self.exact = self.left == 0 && checksum(&self.pixels()) == self.head.checksum;
        Ok(Taken::New)
    }

    fn coefficients(&mut self, run: &Run<'_>) {
        let mut unpacker = Unpacker::new(run.coded, &self.models);
        let mut before = i32::from(self.head.level.low);
        let places = self.order.places.iter().zip(&self.order.classes);
        for (&place, &class) in places.skip(run.first).take(run.count) {
            let mut number = unpacker.number(class);
            if class == MEAN {
                number = (before + number).clamp(0, i32::from(u16::MAX));
                before = number;
            }
            if let Some(coefficient) = self.plane.get_mut(place as usize) {
                *coefficient = number;
            }
        }
    }

    /// The mean of the cells that have come.
    fn mean_cell(&self) -> Option<u16> {
        let (sum, count) = self.cells.iter().flatten().fold((0, 0), |(sum, count), &cell| (sum + u64::from(cell), count + 1));
        (count > 0).then(|| (sum / count.max(1)) as u16)
    }

    /// What the thumbnail says of the mean of a block, ADU; in the middle of the levels without one.
    fn guess(&self, left: usize, top: usize) -> i32 {
        let (width, height) = (self.head.width, self.head.height);
        let (across, down) = thumbnail::size(width, height);
        let middle = |at: usize, end: usize| (at + BLOCK_PX / 2).min(end - 1);
        let column = thumbnail::cell_of(middle(left, width), width, across);
        let row = thumbnail::cell_of(middle(top, height), height, down);
        let level = self.head.level;
        match self.cells.get(row * across + column).copied().flatten() {
            Some(cell) => {
                let parts = u64::from(self.head.thumbnail.base) + u64::from(cell) * u64::from(self.head.thumbnail.step);
                (parts / 16).min(u64::from(u16::MAX)) as i32
            }
            None => (i32::from(level.low) + i32::from(level.high)) / 2,
        }
    }

    /// The picture of what has come: a mean that has not is taken from the thumbnail, a difference that has not is nought.
    fn pixels(&self) -> Vec<u16> {
        let mut plane = self.plane.clone();
        for (y, row) in plane.chunks_mut(self.head.width).enumerate() {
            for (x, coefficient) in row.iter_mut().enumerate().filter(|(_, coefficient)| **coefficient == UNKNOWN) {
                let is_mean = x % BLOCK_PX == 0 && y % BLOCK_PX == 0;
                *coefficient = if is_mean { self.guess(x, y) } else { 0 };
            }
        }
        inverse(&mut plane, self.head.width);
        plane.iter().map(|&adu| adu.clamp(0, i32::from(u16::MAX)) as u16).collect()
    }
}
