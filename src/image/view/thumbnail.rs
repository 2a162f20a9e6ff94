//! The thumbnail: means of cells, rounded as coarsely as the first bytes of a stream ask, each coded as its difference from its neighbours.

use super::ThumbnailScale;
use super::coder::{Model, Unpacker, Width, pack};
use super::packet::{MOST_IN_RUN, Part, Run, run_overhead};
use crate::image::Frame;

/// Columns and rows of a thumbnail, fewer where the picture has fewer: a sixteenth of 1536 × 1024 px.
pub const THUMBNAIL_PX: (usize, usize) = (96, 64);
/// Parts of an ADU that means are kept to.
const PARTS: u64 = 16;

/// Columns and rows of the thumbnail of a picture of this size.
pub(super) fn size(width: usize, height: usize) -> (usize, usize) {
    (width.min(THUMBNAIL_PX.0), height.min(THUMBNAIL_PX.1))
}

/// The cell of the thumbnail that a pixel is in, along one axis.
pub(super) fn cell_of(at: usize, pixels: usize, cells: usize) -> usize {
    // Cell i begins at pixel i · pixels / cells, rounded down.
    ((at + 1) * cells).div_ceil(pixels).saturating_sub(1).min(cells - 1)
}

/// Means of the cells, in sixteenths of an ADU.
fn means(frame: &Frame) -> Vec<u32> {
    let (across, down) = size(frame.width, frame.height);
    let columns: Vec<usize> = (0..frame.width).map(|x| cell_of(x, frame.width, across)).collect();
    let mut sums = vec![(0u64, 0u64); across * down];
    for (y, row) in frame.pixels.chunks(frame.width).enumerate() {
        let first = cell_of(y, frame.height, down) * across;
        let Some(sums) = sums.get_mut(first..first + across) else { continue };
        let mut rest = row;
        for (cell, sum) in sums.iter_mut().enumerate() {
            let begun = frame.width - rest.len();
            let length = columns.get(begun..).map_or(0, |of| of.iter().take_while(|&&of| of == cell).count());
            let (mine, after) = rest.split_at(length);
            *sum = (sum.0 + mine.iter().map(|&adu| u64::from(adu)).sum::<u64>(), sum.1 + mine.len() as u64);
            rest = after;
        }
    }
    sums.iter().map(|&(sum, count)| ((sum * PARTS + count / 2) / count.max(1)) as u32).collect()
}

/// A thumbnail as it is sent.
#[derive(Debug)]
pub(super) struct Thumbnail {
    pub scale: ThumbnailScale,
    pub width: Width,
    /// The payloads of its packets.
    pub payloads: Vec<Vec<u8>>,
}

impl Thumbnail {
    /// The finest one of a frame whose payloads fit into these rooms, bytes.
    pub fn new(frame: &Frame, rooms: &[usize]) -> Self {
        let across = size(frame.width, frame.height).0;
        let means = means(frame);
        let (base, highest) = means.iter().fold((u32::MAX, 0), |(low, high), &mean| (low.min(mean), high.max(mean)));
        // Values have 16 bits.
        let mut step = (highest - base) / u32::from(u16::MAX) + 1;
        loop {
            let values: Vec<u16> = means.iter().map(|mean| ((mean - base + step / 2) / step) as u16).collect();
            let width = width_of(&values, across);
            if let Some(payloads) = payloads(&values, across, width, rooms) {
                return Self { scale: ThumbnailScale { base, step }, width, payloads };
            }
            if values.iter().all(|&value| value == 0) {
                // Not even nothing fits: there is no thumbnail.
                return Self { scale: ThumbnailScale { base, step }, width, payloads: Vec::new() };
            }
            step += step / 8 + 1;
        }
    }
}

fn width_of(values: &[u16], across: usize) -> Width {
    let errors = (1..values.len()).map(|at| f64::from(difference(values, 0, at, across).unsigned_abs()));
    super::width_of(errors.collect::<Vec<_>>().into_iter())
}

/// A value minus what is expected from those that were sent before it in the same packet.
fn difference(values: &[u16], first: usize, at: usize, across: usize) -> i32 {
    let value = values.get(at).copied().unwrap_or(0);
    i32::from(value) - expected(|at| values.get(at).copied(), first, at, across)
}

/// What is expected of a value by its neighbours before, and above at the left, in the middle and at the right, as far as they are in the
/// same packet: the mean of the two middle ones where there are four, so that one star does not spoil it; else the mean of all.
fn expected(value: impl Fn(usize) -> Option<u16>, first: usize, at: usize, across: usize) -> i32 {
    let x = at % across;
    let neighbours = [
        (x > 0).then(|| at.checked_sub(1)),
        (x > 0).then(|| at.checked_sub(across + 1)),
        Some(at.checked_sub(across)),
        (x + 1 < across).then(|| (at + 1).checked_sub(across)),
    ];
    let (mut sum, mut count, mut least, mut most) = (0, 0, i32::MAX, 0);
    for neighbour in neighbours.into_iter().flatten().flatten().filter(|&neighbour| neighbour >= first && neighbour < at) {
        let value = i32::from(value(neighbour).unwrap_or(0));
        (sum, count, least, most) = (sum + value, count + 1, least.min(value), most.max(value));
    }
    match count {
        0 => 0,
        4 => (sum - least - most + 1) / 2,
        _ => (sum + count / 2) / count,
    }
}

fn payloads(values: &[u16], across: usize, width: Width, rooms: &[usize]) -> Option<Vec<Vec<u8>>> {
    let models = [Model::new(width)];
    let mut first = 0;
    let mut payloads = Vec::new();
    for room in rooms {
        if first == values.len() {
            break;
        }
        let numbers = (first..values.len()).take(MOST_IN_RUN).map(|at| (0, difference(values, first, at, across)));
        let (count, coded) = pack(numbers, &models, room.saturating_sub(run_overhead(first)));
        payloads.push(Run { part: Part::Thumbnail, first, count, coded: &coded }.payload());
        first += count;
    }
    (first == values.len()).then_some(payloads)
}

/// Reads a packet's cells into the thumbnail.
pub(super) fn read(run: &Run<'_>, models: &[Model], cells: &mut [Option<u16>], across: usize) {
    let mut unpacker = Unpacker::new(run.coded, models);
    for at in run.first..run.first + run.count {
        let expected = expected(|at| cells.get(at).copied().flatten(), run.first, at, across);
        let value = expected + unpacker.number(0);
        if let Some(cell) = cells.get_mut(at) {
            *cell = Some(value.clamp(0, i32::from(u16::MAX)) as u16);
        }
    }
}
