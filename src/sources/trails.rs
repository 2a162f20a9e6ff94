//! Trails: where a picture stands above its surroundings along a short straight line.
//!
//! A gondola that moves draws every star as the same trail. Along its direction the mean of a few samples collects the light that a
//! round kernel leaves out. The direction is not known: all are tried on the smoothed picture.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the plane's own size")]

use super::measure::Shape;
use super::peaks::{Peak, PeakRules};
use super::plane::Plane;
use crate::sky::{Kernel, with_vectors};

/// Directions over half a turn.
pub const DIRECTIONS: usize = 8;
/// Of the smoothed picture a trail takes the sample in the middle and one to either side, this far along x and y; the smoothing joins
/// what lies between.
const ARMS: [(isize, usize); DIRECTIONS] = [(2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (-1, 2), (-2, 2), (-2, 1)];

/// Furthest sample of an arm from the middle, along either axis.
const REACH: usize = 2;
/// Round peaks of a cell beside which a trail is looked for, and how far beside them, samples.
const ROUND_PER_CELL: usize = 8;
const BESIDE: usize = 1;

/// Noise of the mean of three samples over that of the smoothed picture, whose samples are correlated.
pub fn noise(direction: usize) -> f32 {
    /// Correlation of three taps of a Gaussian of σ 1 with themselves 0 to 4 samples on.
    const CORRELATION: [f32; 5] = [1.0, 0.700, 0.212, 0.0, 0.0];
    let (dx, dy) = ARMS[direction % DIRECTIONS];
    let at = |times: usize| {
        let of = |d: usize| CORRELATION.get(times * d).copied().unwrap_or(0.0);
        of(dx.unsigned_abs()) * of(dy)
    };
    ((3.0 + 4.0 * at(1) + 2.0 * at(2)) / 9.0).sqrt()
}

/// A direction, as an arm of it.
pub fn along(direction: usize) -> (f32, f32) {
    let (dx, dy) = ARMS[direction % DIRECTIONS];
    (dx as f32, dy as f32)
}

/// The shape of a trail as long as the kernel, samples².
pub fn shape_of(direction: usize) -> Shape {
    let (dx, dy) = along(direction);
    // A line of length L has the variance L²/12 along itself; across it is as wide as a round star. The three samples stand for a line
    // three times as long as an arm.
    const LENGTHS_SQ: f32 = 9.0 / 12.0;
    Shape { xx: LENGTHS_SQ * dx * dx + 1.0, yy: LENGTHS_SQ * dy * dy + 1.0, xy: LENGTHS_SQ * dx * dy }
}

/// Side of the square around a place that all directions need, samples; and of the lanes that its rows are counted in.
const SIDE: usize = 2 * (BESIDE + REACH) + 1;
const TRIED: usize = 2 * BESIDE + 1;
const LANES: usize = 4;

/// The best peaks of each cell along every direction, looked for beside its highest round peaks alone: a line that stands out has some of
/// them on it. `round`: peaks of the smoothed picture, cell after cell, the highest of each first.
pub fn find(smooth: &Plane, rules: &PeakRules<'_>, round: &[Peak]) -> [Vec<Peak>; DIRECTIONS] {
    let mut found: [Vec<Peak>; DIRECTIONS] = Default::default();
    let border = rules.border.max(BESIDE + REACH);
    if smooth.width <= 2 * border || smooth.height <= 2 * border || rules.cell == 0 {
        return found;
    }
    let noise: [f32; DIRECTIONS] = std::array::from_fn(noise);
    let (columns, rows) = (border..smooth.width - border, border..smooth.height - border);
    for of_cell in round.chunk_by(|a, b| a.cell == b.cell) {
        let first = found.each_ref().map(Vec::len);
        for start in of_cell.iter().take(ROUND_PER_CELL).filter(|p| columns.contains(&p.x) && rows.contains(&p.y)) {
            let highest = with_vectors(HighestBeside { smooth, start });
            for (direction, (peak, peaks)) in highest.into_iter().zip(&mut found).enumerate() {
                let known = peaks[first[direction]..].iter().any(|p| (p.x, p.y) == (peak.x, peak.y));
                let stands_out = peak.height > noise[direction] * rules.threshold_at(peak.x, peak.y);
                if stands_out && !known && !(rules.masked)(peak.x, peak.y) {
                    peaks.push(peak);
                }
            }
        }
        for (peaks, first) in found.iter_mut().zip(first) {
            peaks[first..].sort_by(|a, b| b.height.total_cmp(&a.height));
            peaks.truncate(first + rules.per_cell);
        }
    }
    found
}

/// Where the mean along each direction is highest, from [`BESIDE`] samples before a place to as many after it both ways.
struct HighestBeside<'a> {
    smooth: &'a Plane,
    start: &'a Peak,
}

impl Kernel for HighestBeside<'_> {
    type Output = [Peak; DIRECTIONS];

    #[inline(always)]
    fn run(self) -> [Peak; DIRECTIONS] {
        let Self { smooth, start } = self;
        // Cut once for all directions, each row with room for the last lanes.
        let mut square = [[0f32; SIDE + LANES]; SIDE];
        for (j, row) in square.iter_mut().enumerate() {
            let from = (start.y + j - BESIDE - REACH) * smooth.width + start.x - BESIDE - REACH;
            row[..SIDE].copy_from_slice(&smooth.pixels[from..from + SIDE]);
        }
        let row = |j: usize, i: usize| square[j][i..].first_chunk::<LANES>().copied().unwrap_or([0.0; LANES]);
        let mut highest = [Peak { x: 0, y: 0, height: 0.0, cell: start.cell }; DIRECTIONS];
        for (peak, (dx, dy)) in highest.iter_mut().zip(ARMS) {
            // The highest of each column, chosen without a branch, and then the highest of these.
            let (mut heights, mut rows) = ([f32::MIN; LANES], [0; LANES]);
            for j in 0..TRIED {
                let here = row(REACH + j, REACH);
                let one = row(REACH + j - dy, REACH.wrapping_add_signed(-dx));
                let other = row(REACH + j + dy, REACH.wrapping_add_signed(dx));
                for i in 0..LANES {
                    let height = (one[i] + here[i] + other[i]) * (1.0 / 3.0);
                    let is_higher = height > heights[i];
                    heights[i] = if is_higher { height } else { heights[i] };
                    rows[i] = if is_higher { j } else { rows[i] };
                }
            }
            let mut best = 0;
            for i in 1..TRIED {
                best = if heights[i] > heights[best] { i } else { best };
            }
            (peak.x, peak.y, peak.height) = (start.x + best - BESIDE, start.y + rows[best] - BESIDE, heights[best]);
        }
        highest
    }
}

#[cfg(test)]
mod tests {
    use super::super::peaks::{PeakFinder, Taps};
    use super::*;

    /// A picture with one faint trail of six samples at (60, 50) in a direction.
    fn trail(direction: usize) -> Plane {
        let (dx, dy) = (ARMS[direction].0 as f32, ARMS[direction].1 as f32);
        let (sin, cos) = (dy / dx.hypot(dy), dx / dx.hypot(dy));
        let light = |n: usize| {
            let (x, y) = ((n % 128) as f32 - 60.0, (n / 128) as f32 - 50.0);
            (0..7)
                .map(|i| {
                    let t = i as f32 - 3.0;
                    (-0.5 * ((x - t * cos).powi(2) + (y - t * sin).powi(2))).exp()
                })
                .sum::<f32>()
        };
        Plane { width: 128, height: 96, pixels: (0..128 * 96).map(|n| 10.0 * light(n)).collect() }
    }

    #[test]
    fn a_trail_stands_out_most_in_its_own_direction() {
        let thresholds = vec![0.5; 8 * 6];
        let rules = PeakRules {
            taps: Taps::WIDE,
            ring: 2,
            border: 10,
            cell: 64,
            per_cell: 4,
            thresholds: &thresholds,
            threshold_columns: 8,
            masked: &|_, _| false,
        };
        for direction in 0..DIRECTIONS {
            let (mut finder, mut round) = (PeakFinder::default(), Vec::new());
            assert!(finder.find(&trail(direction), &rules, &|| true, true, &mut round));
            let found = find(finder.smooth(), &rules, &round);
            let height = |d: usize| {
                let highest = found[d].iter().max_by(|a, b| a.height.total_cmp(&b.height)).unwrap();
                assert!(highest.x.abs_diff(60) <= 1 && highest.y.abs_diff(50) <= 1, "{highest:?}");
                highest.height
            };
            let own = height(direction);
            let across = height((direction + DIRECTIONS / 2) % DIRECTIONS);
            assert!(own > 1.5 * across, "{direction}: {own} against {across}");
        }
    }
}
