//! The light of all exposures along their trails, added up in the picture halved once, and its peaks.

use super::super::finder::{Look, set_thresholds};
use super::super::kernel::SearchKernel;
use super::super::peaks::{Peak, Taps};
use super::super::plane::{MARGIN, Plane};
use super::{LEAST_SNR, MOST_PEAKS, Trail, centre};
use crate::image::{CELL_PX, CellStatistics};
use crate::sky::{Kernel, with_vectors};
use std::collections::BTreeMap;

/// A peak beside a higher one must stand so far above what that one's light adds there, in parts of the threshold.
const ABOVE_NEIGHBOUR: f32 = 1.0;
/// Samples that are added up at a time, and shifted together where the picture turns: over so few the turn moves nothing by a sample.
const BLOCK: usize = 32;
/// Rows that are shifted together.
const BLOCK_ROWS: usize = 64;

/// The part of a star's light on one sample of the picture halved once.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tap {
    /// Offset of the sample from the star.
    x: i32,
    y: i32,
    weight: f32,
}

/// A trail on the picture halved once.
pub(super) struct HalvedTrail {
    /// Row by row; the weights sum to the share.
    taps: Vec<Tap>,
    /// The same smoothed as the search smooths it, twice over: what a tap has in common with the others.
    twice: Patch,
}

/// A small picture around a place.
struct Patch {
    /// Offset of its first sample.
    x: i32,
    y: i32,
    width: usize,
    samples: Vec<f32>,
}

impl Patch {
    /// The place of a sample in it.
    fn place(&self, x: i32, y: i32) -> Option<usize> {
        let (column, row) = (usize::try_from(x - self.x).ok()?, usize::try_from(y - self.y).ok()?);
        (column < self.width).then_some(row * self.width + column)
    }

    fn at(&self, x: i32, y: i32) -> f32 {
        self.place(x, y).and_then(|place| self.samples.get(place)).copied().unwrap_or(0.0)
    }
}

impl HalvedTrail {
    pub(super) fn of(trail: &Trail) -> Self {
        let mut weights = BTreeMap::new();
        let weight = (trail.share / trail.places.len().max(1) as f64) as f32;
        for &(x, y) in &trail.places {
            let (x, y) = (x / 2.0, y / 2.0);
            let (left, top) = (x.floor(), y.floor());
            let (right, low) = ((x - left) as f32, (y - top) as f32);
            for (dx, across) in [(0, 1.0 - right), (1, right)] {
                for (dy, down) in [(0, 1.0 - low), (1, low)] {
                    *weights.entry((top as i32 + dy, left as i32 + dx)).or_insert(0.0) += weight * across * down;
                }
            }
        }
        weights.retain(|_, weight| *weight > 0.0);
        let taps: Vec<Tap> = weights.into_iter().map(|((y, x), weight)| Tap { x, y, weight }).collect();
        Self { twice: smoothed_twice(&taps), taps }
    }

    /// Furthest offset along either axis, samples.
    fn reach(&self) -> usize {
        self.taps.iter().map(|tap| tap.x.unsigned_abs().max(tap.y.unsigned_abs())).max().unwrap_or(0) as usize
    }

    /// Σ of the smoothed trail times itself, shifted.
    fn overlap(&self, (dx, dy): (i32, i32)) -> f32 {
        self.taps.iter().map(|tap| tap.weight * self.twice.at(tap.x - dx, tap.y - dy)).sum()
    }
}

/// Taps with the search's smoothing twice over: five each way.
fn smoothed_twice(taps: &[Tap]) -> Patch {
    let Taps { side } = SearchKernel::Sharp.taps();
    let middle = 1.0 - 2.0 * side;
    let twice = [side * side, 2.0 * side * middle, 2.0 * side * side + middle * middle, 2.0 * side * middle, side * side];
    let span = |part: fn(&Tap) -> i32| {
        let (low, high) = (taps.iter().map(part).min().unwrap_or(0), taps.iter().map(part).max().unwrap_or(0));
        (low - 2, (high - low + 5) as usize)
    };
    let ((x, width), (y, height)) = (span(|tap| tap.x), span(|tap| tap.y));
    let mut patch = Patch { x, y, width, samples: vec![0.0; width * height] };
    for tap in taps {
        for (i, across) in (-2..).zip(twice) {
            for (j, down) in (-2..).zip(twice) {
                if let Some(place) = patch.place(tap.x + i, tap.y + j) {
                    patch.samples[place] += tap.weight * across * down;
                }
            }
        }
    }
    patch
}

/// The sum along trails.
#[derive(Default)]
pub(super) struct Sum {
    pub plane: Plane,
    /// An exposure with nought around it.
    padded: Plane,
}

impl Sum {
    /// Adds an exposure that is smoothed and above its level, shifted along its trail. Beyond the picture's border there is nothing above
    /// the level.
    pub(super) fn add(&mut self, from: &Plane, halved: &HalvedTrail, trail: &Trail) {
        if self.plane.pixels.is_empty() {
            self.plane = Plane { width: from.width, height: from.height, pixels: vec![0.0; from.pixels.len()] };
        }
        let corner = trail.spun((0.0, 0.0), centre(from.width, from.height));
        let margin = halved.reach() + corner.0.abs().max(corner.1.abs()).ceil() as usize + BLOCK;
        let padded = &mut self.padded;
        (padded.width, padded.height) = (from.width + 2 * margin, from.height + 2 * margin);
        padded.pixels.clear();
        padded.pixels.resize(padded.width * padded.height, 0.0);
        for y in 0..from.height {
            padded.pixels[(y + margin) * padded.width + margin..][..from.width].copy_from_slice(from.row(y));
        }
        with_vectors(AddAlong { padded, margin, taps: &halved.taps, trail, out: &mut self.plane });
    }
}

/// Adds a picture to a sum, shifted along a trail.
struct AddAlong<'a> {
    padded: &'a Plane,
    margin: usize,
    taps: &'a [Tap],
    trail: &'a Trail,
    out: &'a mut Plane,
}

impl Kernel for AddAlong<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let AddAlong { padded, margin, taps, trail, out } = self;
        let middle = centre(out.width, out.height);
        let stride = padded.width as isize;
        let taps: Vec<(isize, f32)> = taps.iter().map(|tap| (tap.y as isize * stride + tap.x as isize, tap.weight)).collect();
        for (y, row) in out.pixels.chunks_exact_mut(out.width).enumerate() {
            for (block, row) in row.chunks_mut(BLOCK).enumerate() {
                let here = ((block * BLOCK + BLOCK / 2) as f64, (y / BLOCK_ROWS * BLOCK_ROWS + BLOCK_ROWS / 2) as f64);
                let there = trail.spun(here, middle);
                let shift = (there.1 - here.1).round() as isize * stride + (there.0 - here.0).round() as isize;
                let first = ((y + margin) * padded.width + block * BLOCK + margin) as isize + shift;
                let mut sums = [0.0_f32; BLOCK];
                for &(offset, weight) in &taps {
                    let from = &padded.pixels[(first + offset) as usize..][..BLOCK];
                    for (sum, value) in sums.iter_mut().zip(from) {
                        *sum += weight * value;
                    }
                }
                row.iter_mut().zip(&sums).for_each(|(total, sum)| *total += sum);
            }
        }
    }
}

/// Local maxima of the sum along trails, highest over the noise first. `noise`: of the sum, over that of a sample.
pub(super) fn peaks_of(sum: &Plane, cells: &CellStatistics, noise: f32, look: &Look<'_>) -> Vec<Peak> {
    let mut sigmas = Vec::new();
    set_thresholds(cells, sum, 2, noise, &mut sigmas);
    let (columns, masked) = (sum.width.div_ceil(CELL_PX), look.masked_at(cells, 1));
    let border = (look.settings.border_px as usize / 2).max(MARGIN);
    let mut peaks = Vec::new();
    for y in border..sum.height.saturating_sub(border) {
        let rows = [sum.row(y - 1), sum.row(y), sum.row(y + 1)];
        let sigmas = &sigmas[y / CELL_PX * columns..][..columns];
        for x in border..sum.width.saturating_sub(border) {
            let (height, sigma) = (rows[1][x], sigmas[x / CELL_PX]);
            let around = || rows.iter().flat_map(|row| &row[x - 1..=x + 1]).all(|other| *other <= height);
            if height >= LEAST_SNR * sigma && around() && !masked(x, y) {
                peaks.push((Peak { x, y, height, cell: 0 }, height / sigma));
            }
        }
    }
    peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
    peaks.into_iter().take(MOST_PEAKS).map(|(peak, _)| peak).collect()
}

/// What the noises of two places of the sum have in common, the second shifted from the first, over the variance of a sample of the first
/// exposure.
fn in_common(halved: &[HalvedTrail], cells: &[CellStatistics], shift: (i32, i32)) -> f64 {
    let first = cells.first().map_or(1.0, |cells| cells.image_noise).max(f64::MIN_POSITIVE);
    let of_exposure =
        |(halved, cells): (&HalvedTrail, &CellStatistics)| f64::from(halved.overlap(shift)) * (cells.image_noise / first).powi(2);
    halved.iter().zip(cells).map(of_exposure).sum()
}

/// Noise of the sum along trails, smoothed as the search smooths it, over that of a sample of the first exposure.
pub(super) fn noise_of(halved: &[HalvedTrail], cells: &[CellStatistics]) -> f32 {
    in_common(halved, cells, (0, 0)).sqrt() as f32
}

/// Peaks that noise makes in a sample of the sum for each s exp(−s²/2): by how fast its correlation falls with distance.
pub(super) fn peaks_per_sample(halved: &[HalvedTrail], cells: &[CellStatistics]) -> f64 {
    let whole = in_common(halved, cells, (0, 0)).max(f64::MIN_POSITIVE);
    let at = |shift| in_common(halved, cells, shift) / whole;
    let (across, down) = (2.0 - at((1, 0)) - at((-1, 0)), 2.0 - at((0, 1)) - at((0, -1)));
    let both = 0.25 * (at((1, 1)) + at((-1, -1)) - at((1, -1)) - at((-1, 1)));
    (across * down - both * both).max(0.0).sqrt() * std::f64::consts::TAU.powf(-1.5)
}

/// The peaks, highest first, without those that are the flanks of higher ones.
pub(super) fn apart(peaks: Vec<(Peak, f32)>, halved: &[HalvedTrail], least: f32) -> Vec<(Peak, f32)> {
    let all = |shift: (i32, i32)| halved.iter().map(|halved| halved.overlap(shift)).sum::<f32>();
    let whole = all((0, 0));
    // Exposures have their light in common with themselves alone.
    let span = |side: fn(&Patch) -> usize| halved.iter().map(|halved| side(&halved.twice)).max().unwrap_or(0) as i32;
    let (wide, high) = (span(|patch| patch.width), span(|patch| patch.samples.len() / patch.width.max(1)));
    let mut kept: Vec<(Peak, f32)> = Vec::new();
    for (peak, height) in peaks {
        let flank = |(other, above): &(Peak, f32)| {
            let shift = (peak.x as i32 - other.x as i32, peak.y as i32 - other.y as i32);
            if shift.0.abs() > wide || shift.1.abs() > high { 0.0 } else { above * all(shift) / whole }
        };
        let light: f32 = kept.iter().map(flank).sum();
        if height - light >= ABOVE_NEIGHBOUR * least {
            kept.push((peak, height));
        }
    }
    kept
}
