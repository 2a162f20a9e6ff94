//! The frame's own point spread function, far out: the median picture of its stars.
//!
//! A star trailed in pieces (several exposures, a jerk of the gondola) is found piece by piece, and a pattern of equal pieces solves as
//! well as one of whole stars. Where the light of a whole star has its middle shows when the stars are laid on top of each other:
//! what is at the same place beside each of them belongs to them.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: bins are counted by the constants that size them")]

use crate::image::Frame;

/// Pixels along a bin, and bins from the middle to the border of the picture: trails of 30 px and more fit.
const BIN_PX: usize = 2;
const REACH: usize = 20;
const SIDE: usize = 2 * REACH + 1;
/// Fewest stars whose median is not one of them, and most that are worth the time.
const MIN_STARS: usize = 5;
const MAX_STARS: usize = 15;
/// A bin belongs to the stars where it stands this many times the scatter of the bins above them.
const SIGNIFICANCE: f32 = 5.0;

/// Light further from the middle than this is not that of one round star, px; below this share of all it is not worth a shift.
const FAR_PX: f64 = 6.0;
const LEAST_FAR: f64 = 0.2;

/// Where the light of the frame's stars lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// Too few stars to tell.
    Unknown,
    /// In one place, where the stars were found.
    Together,
    /// In several places: its middle is elsewhere.
    Apart {
        /// From the given places to the middle of the light, along x and y of the file, px.
        shift: (f64, f64),
        /// One σ of the shift per axis, px.
        sigma: f64,
        /// From the given places to the brightest of the light that is elsewhere, px: other sources should have been found there.
        elsewhere: (f64, f64),
    },
}

/// Lays the stars at some places (x, y in file order, px; brightest first) on top of each other.
pub fn light_of_stars(frame: &Frame, places: &[(f64, f64)]) -> Light {
    let margin = ((REACH + 1) * BIN_PX) as f64;
    let inside = |&&(x, y): &&(f64, f64)| {
        x >= margin && y >= margin && x < frame.width as f64 - margin && y < frame.height as f64 - margin
    };
    let pictures: Vec<Vec<f32>> = places.iter().filter(inside).take(MAX_STARS).filter_map(|p| picture(frame, *p)).collect();
    if pictures.len() < MIN_STARS {
        return Light::Unknown;
    }
    let mut column = Vec::with_capacity(pictures.len());
    let median: Vec<f32> = (0..SIDE * SIDE)
        .map(|bin| {
            column.clear();
            column.extend(pictures.iter().map(|p| p[bin]));
            median_of(&mut column)
        })
        .collect();
    let scatter = {
        let mut deviations: Vec<f32> = median.iter().map(|v| v.abs()).collect();
        /// σ of a normal distribution over its median absolute deviation.
        const SIGMA_PER_DEVIATION: f32 = 1.4826;
        (SIGMA_PER_DEVIATION * median_of(&mut deviations)).max(1e-9)
    };
    let (mut sum, mut far, mut sx, mut sy, mut spread) = (0f64, 0f64, 0f64, 0f64, 0f64);
    let mut elsewhere = (0f32, 0f64, 0f64);
    let bright = |bin: usize| median.get(bin).is_some_and(|v| *v > SIGNIFICANCE * scatter);
    // Light fills more than one bin; chance does not.
    let beside = |bin: usize| [bin + 1, bin.wrapping_sub(1), bin + SIDE, bin.wrapping_sub(SIDE)].into_iter().any(bright);
    for (bin, &value) in median.iter().enumerate().filter(|&(bin, _)| bright(bin) && beside(bin)) {
        let dx = ((bin % SIDE) as f64 - REACH as f64) * BIN_PX as f64;
        let dy = ((bin / SIDE) as f64 - REACH as f64) * BIN_PX as f64;
        sum += f64::from(value);
        if dx.hypot(dy) > FAR_PX {
            far += f64::from(value);
            if value > elsewhere.0 {
                elsewhere = (value, dx, dy);
            }
        }
        sx += f64::from(value) * dx;
        sy += f64::from(value) * dy;
        spread += 0.5 * (dx * dx + dy * dy);
    }
    if far <= LEAST_FAR * sum {
        return Light::Together;
    }
    Light::Apart {
        shift: (sx / sum, sy / sum),
        sigma: f64::from(scatter) * spread.sqrt() / sum,
        elsewhere: (elsewhere.1, elsewhere.2),
    }
}

/// Means of the bins around a star, above their median, in units of the star's height there.
fn picture(frame: &Frame, (x, y): (f64, f64)) -> Option<Vec<f32>> {
    let corner = |c: f64| (c - BIN_PX as f64 * (REACH as f64 + 0.5) + 0.5).round().max(0.0) as usize;
    let (x0, y0) = (corner(x), corner(y));
    let mut bins = Vec::with_capacity(SIDE * SIDE);
    for j in 0..SIDE {
        for i in 0..SIDE {
            let mut sum = 0u32;
            for row in 0..BIN_PX {
                let first = (y0 + BIN_PX * j + row) * frame.width + x0 + BIN_PX * i;
                sum += frame.pixels.get(first..first + BIN_PX)?.iter().map(|&p| u32::from(p)).sum::<u32>();
            }
            bins.push(sum as f32 / (BIN_PX * BIN_PX) as f32);
        }
    }
    let base = median_of(&mut bins.clone());
    let middle = [(0, 0), (0, 1), (1, 0), (0, -1), (-1, 0)];
    let height: f32 = middle
        .iter()
        .map(|&(i, j): &(isize, isize)| {
            let bin = (REACH as isize + j) * SIDE as isize + REACH as isize + i;
            bins[bin as usize] - base
        })
        .sum();
    (height > 0.0).then(|| bins.iter().map(|b| (b - base) / height).collect())
}

fn median_of(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::RowOrder;

    /// Nine stars, each of pieces at the given offsets with the given weights, and one lone piece beside the first.
    fn frame(pieces: &[(f64, f64, f64)]) -> (Frame, Vec<(f64, f64)>) {
        let (w, h) = (600, 400);
        let places: Vec<(f64, f64)> =
            (0..9).map(|i| (90.3 + 200.0 * f64::from(i % 3), 70.7 + 120.0 * f64::from(i / 3))).collect();
        let mut pixels = vec![0u16; w * h];
        for (n, p) in pixels.iter_mut().enumerate() {
            let (x, y) = ((n % w) as f64, (n / w) as f64);
            let mut value = 500.0 + 3.0 * ((n * 7919 % 101) as f64 / 50.0 - 1.0);
            let mut add = |px: f64, py: f64, a: f64| value += a * (-0.5 * ((x - px).powi(2) + (y - py).powi(2)) / 1.5).exp();
            for place in &places {
                pieces.iter().for_each(|&(dx, dy, a)| add(place.0 + dx, place.1 + dy, a));
            }
            add(120.0, 70.0, 400.0);
            *p = value as u16;
        }
        (Frame::new(w, h, pixels, RowOrder::BottomFirst).unwrap(), places)
    }

    #[test]
    fn whole_stars_need_no_shift() {
        let (frame, places) = frame(&[(0.0, 0.0, 300.0)]);
        assert_eq!(light_of_stars(&frame, &places), Light::Together);
    }

    #[test]
    fn stars_in_two_pieces_have_their_light_between_them() {
        let (frame, places) = frame(&[(0.0, 0.0, 300.0), (12.0, -6.0, 300.0)]);
        let Light::Apart { shift, sigma, elsewhere } = light_of_stars(&frame, &places) else { panic!("taken for whole stars") };
        assert!((shift.0 - 6.0).abs() < 0.5 && (shift.1 + 3.0).abs() < 0.5 && sigma < 0.5, "{shift:?} ± {sigma}");
        assert!((elsewhere.0 - 12.0).abs() < 2.0 && (elsewhere.1 + 6.0).abs() < 2.0, "{elsewhere:?}");
    }

    #[test]
    fn few_stars_or_stars_at_the_border_say_nothing() {
        let (frame, places) = frame(&[(0.0, 0.0, 300.0)]);
        assert_eq!(light_of_stars(&frame, &places[..4]), Light::Unknown);
        assert_eq!(light_of_stars(&frame, &[(3.0, 3.0); 9]), Light::Unknown);
    }
}
