//! Trails: where a picture stands above its surroundings along a short straight line.
//!
//! A gondola that moves draws every star as the same trail. Along its direction the mean of a few samples collects the light that a
//! round kernel leaves out. The direction is not known: all are tried on the smoothed picture.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the plane's own size")]

use super::measure::Shape;
use super::peaks::{Peak, PeakRules};
use super::plane::Plane;

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

/// The best peaks of each cell along a direction, looked for beside its highest round peaks alone: a line that stands out has some of
/// them on it. `round`: peaks of the smoothed picture, cell after cell, the highest of each first.
pub fn find(smooth: &Plane, rules: &PeakRules<'_>, round: &[Peak], direction: usize, peaks: &mut Vec<Peak>) {
    peaks.clear();
    let border = rules.border.max(BESIDE + REACH);
    if smooth.width <= 2 * border || smooth.height <= 2 * border || rules.cell == 0 {
        return;
    }
    let (columns, rows) = (border..smooth.width - border, border..smooth.height - border);
    for of_cell in round.chunk_by(|a, b| a.cell(rules.cell) == b.cell(rules.cell)) {
        let first = peaks.len();
        for start in of_cell.iter().take(ROUND_PER_CELL).filter(|p| columns.contains(&p.x) && rows.contains(&p.y)) {
            let peak = highest_beside(smooth, start, direction);
            let known = peaks[first..].iter().any(|p| (p.x, p.y) == (peak.x, peak.y));
            if peak.height > rules.threshold_at(peak.x, peak.y) && !known && !(rules.masked)(peak.x, peak.y) {
                peaks.push(peak);
            }
        }
        peaks[first..].sort_by(|a, b| b.height.total_cmp(&a.height));
        peaks.truncate(first + rules.per_cell);
    }
}

/// Where the mean along a direction is highest, from [`BESIDE`] samples before a place to as many after it both ways.
fn highest_beside(smooth: &Plane, start: &Peak, direction: usize) -> Peak {
    let (dx, dy) = ARMS[direction % DIRECTIONS];
    let arm = dy as isize * smooth.width as isize + dx;
    let mut best = Peak { height: f32::MIN, ..*start };
    for y in start.y - BESIDE..=start.y + BESIDE {
        for x in start.x - BESIDE..=start.x + BESIDE {
            let at = y * smooth.width + x;
            let (one, other) = (at.wrapping_add_signed(-arm), at.wrapping_add_signed(arm));
            let height = (smooth.pixels[one] + smooth.pixels[at] + smooth.pixels[other]) * (1.0 / 3.0);
            if height > best.height {
                best = Peak { x, y, height };
            }
        }
    }
    best
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
            let (mut smooth, mut round) = (Plane::default(), Vec::new());
            assert!(PeakFinder::default().find(&trail(direction), &rules, &|| true, Some(&mut smooth), &mut round));
            let height = |d: usize| {
                let mut peaks = Vec::new();
                find(&smooth, &rules, &round, d, &mut peaks);
                let highest = peaks.iter().max_by(|a, b| a.height.total_cmp(&b.height)).unwrap();
                assert!(highest.x.abs_diff(60) <= 1 && highest.y.abs_diff(50) <= 1, "{highest:?}");
                highest.height
            };
            let own = height(direction);
            let across = height((direction + DIRECTIONS / 2) % DIRECTIONS);
            assert!(own > 1.5 * across, "{direction}: {own} against {across}");
        }
    }
}
