//! The frame's own point spread function, whatever its shape, from stars whose places are known: trails, trails in pieces, discs.
//!
//! A trail of several exposures is found piece by piece, and a pattern of equal pieces solves as well as one of whole stars. Once a
//! pose says where the stars are, the pictures of all of them laid on top of each other show where the light of a star really lies; and with that picture as its template each star can be measured as well as its light allows.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: bins are counted by the constants that size them")]

use super::plane::Plane;
use crate::image::CellStatistics;
use nalgebra::{Matrix4, Vector4};

/// Pixels along a bin: the picture halved once. Bins from the middle to the border: trails and discs of 30 px and more fit.
pub const BIN_PX: usize = 2;
const REACH: usize = 18;
const SIDE: usize = 2 * REACH + 1;
const N: usize = SIDE * SIDE;
/// Bins at the border from which the sky under a star is taken.
const RIM: usize = 3;
/// Stars laid on top of each other: the brightest, which decide.
const MOST_STARS: usize = 40;
const LEAST_STARS: usize = 4;
/// A bin shows light where the mean of the nine around it stands this many σ above the sky; a piece of light that is not chance, and not
/// a neighbour that many stars happen to have.
const LIGHT_SIGMAS: f32 = 3.5;
const PIECE_SNR: f32 = 5.0;
const PIECE_SHARE: f32 = 0.15;
/// A star further from its place than this is another, bins.
const FURTHEST: f64 = 5.0;
/// Least signal to noise of a star that is measured.
const LEAST_SNR: f64 = 3.0;

/// A star that should be at a place, in file order, px, with a flux, ADU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownStar {
    /// Column, px.
    pub x: f64,
    /// Row, px.
    pub y: f64,
    /// Flux, ADU.
    pub flux: f64,
}

/// A star measured with the frame's own point spread function.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedStar {
    /// Middle of its light in file order, px.
    pub x: f64,
    /// As above.
    pub y: f64,
    /// Covariance of the middle: xx, yy, xy, px².
    pub covariance: (f64, f64, f64),
    /// Flux, ADU.
    pub flux: f64,
    /// Signal over noise.
    pub snr: f64,
}

/// Where the light of the frame's stars lies around their places.
#[derive(Debug, Clone)]
pub struct Light {
    /// Share of each bin, row after row; nought outside the light.
    shares: Vec<f32>,
    /// Bins that a star is measured in: those with light, and some around.
    window: Vec<usize>,
    /// From the given places to the middle of the light, px.
    pub middle: (f64, f64),
    /// One σ of it per axis, px.
    pub sigma: f64,
    /// Root mean square extent along the long and the short axis, px.
    pub axes: (f64, f64),
}

impl Light {
    /// The light of stars at known places; `None` where there are too few of them, or no light at their places.
    pub fn of(plane: &Plane, cells: &CellStatistics, stars: &[KnownStar]) -> Option<Self> {
        let mut seen: Vec<(KnownStar, f32, Vec<f32>)> = Vec::new();
        for star in stars {
            let noise = cells.local_noise(star.x.max(0.0) as usize, star.y.max(0.0) as usize) / BIN_PX as f32;
            if noise > 0.0
                && seen.len() < MOST_STARS
                && let Some(bins) = bins_around(plane, star.x, star.y)
            {
                seen.push((*star, noise, bins));
            }
        }
        if seen.len() < LEAST_STARS {
            return None;
        }
        // No star counts for more than the fourth brightest, so that what one of them has beside it is not taken for light of all.
        let weight_of = |star: &KnownStar, noise: f32| (star.flux as f32 / noise).powi(2);
        let mut weights: Vec<f32> = seen.iter().map(|(star, noise, _)| weight_of(star, *noise)).collect();
        let mut sorted = weights.clone();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let most = sorted.get(LEAST_STARS - 1).copied()?;
        weights.iter_mut().for_each(|weight| *weight = weight.min(most));
        // Noise of a weighted median of shares: a normal distribution's median has 1.25 times the error of its mean.
        const MEDIAN_OVER_MEAN: f32 = 1.253_3;
        let share_noise = |star: &KnownStar, noise: f32| noise / (star.flux as f32 / (BIN_PX * BIN_PX) as f32);
        let variance: f32 = seen.iter().zip(&weights).map(|((star, noise, _), w)| (w * share_noise(star, *noise)).powi(2)).sum();
        let sigma = MEDIAN_OVER_MEAN * variance.sqrt() / weights.iter().sum::<f32>();
        let mut light: Option<Self> = None;
        let mut column = Vec::with_capacity(seen.len());
        // The second time without the light of the neighbours.
        for _ in 0..2 {
            let neighbours: Vec<Option<Vec<f32>>> =
                seen.iter().map(|(star, _, _)| light.as_ref().map(|light| light.neighbours(star, stars))).collect();
            let stack: Vec<f32> = (0..N)
                .map(|n| {
                    column.clear();
                    column.extend(seen.iter().zip(&weights).zip(&neighbours).map(|(((star, _, bins), weight), others)| {
                        let other = others.as_ref().map_or(0.0, |list| list[n]);
                        // The sum over a star's bins is its flux over the pixels of a bin.
                        ((bins[n] - other) / (star.flux as f32 / (BIN_PX * BIN_PX) as f32), *weight)
                    }));
                    weighted_median(&mut column)
                })
                .collect();
            light = Some(Self::of_stack(&stack, sigma)?);
        }
        light
    }

    /// The light in a stack whose bins have the noise `sigma`.
    fn of_stack(stack: &[f32], sigma: f32) -> Option<Self> {
        let pieces = pieces_of(stack, sigma);
        let brightest = pieces.iter().map(|p| p.flux).fold(0.0, f32::max);
        let mut lit = vec![false; N];
        for piece in pieces.iter().filter(|p| p.snr >= PIECE_SNR && p.flux >= PIECE_SHARE * brightest) {
            piece.bins.iter().for_each(|&bin| lit[bin] = true);
        }
        let lit = grown(&lit, 1);
        let total: f32 = (0..N).filter(|&n| lit[n]).map(|n| stack[n]).sum();
        // A place without light of its own says that the pose, or the stars, are others.
        if total <= 0.0 || !(0..N).any(|n| lit[n] && place(n).0.hypot(place(n).1) <= FURTHEST) {
            return None;
        }
        let mut shares = vec![0f32; N];
        let (mut mx, mut my, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for n in (0..N).filter(|&n| lit[n]) {
            shares[n] = stack[n] / total;
            let ((dx, dy), share) = (place(n), f64::from(shares[n]));
            mx += share * dx;
            my += share * dy;
            xx += share * dx * dx;
            yy += share * dy * dy;
            xy += share * dx * dy;
        }
        (xx, yy, xy) = (xx - mx * mx, yy - my * my, xy - mx * my);
        let about_middle = |n: usize| (place(n).0 - mx).powi(2) + (place(n).1 - my).powi(2);
        let spread: f64 = (0..N).filter(|&n| lit[n]).map(about_middle).sum();
        let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        let bin = BIN_PX as f64;
        let window = grown(&lit, 2);
        Some(Self {
            shares,
            window: (0..N).filter(|&n| window[n] && is_inner(n)).collect(),
            middle: (bin * mx, bin * my),
            sigma: bin * f64::from(sigma / total) * (0.5 * spread).sqrt(),
            axes: (bin * (mean + half).max(0.0).sqrt(), bin * (mean - half).max(0.0).sqrt()),
        })
    }

    /// The light of all other stars around a star's place, bin by bin.
    fn neighbours(&self, star: &KnownStar, stars: &[KnownStar]) -> Vec<f32> {
        let mut bins = vec![0f32; N];
        for other in stars {
            let (dx, dy) = ((other.x - star.x) / BIN_PX as f64, (other.y - star.y) / BIN_PX as f64);
            let reach = 2.0 * REACH as f64;
            if (dx, dy) == (0.0, 0.0) || dx.abs() > reach || dy.abs() > reach {
                continue;
            }
            let (dx, dy) = (dx.round() as isize, dy.round() as isize);
            let flux = (other.flux / (BIN_PX * BIN_PX) as f64) as f32;
            for (n, bin) in bins.iter_mut().enumerate() {
                let (x, y) = ((n % SIDE) as isize - dx, (n / SIDE) as isize - dy);
                if (0..SIDE as isize).contains(&x) && (0..SIDE as isize).contains(&y) {
                    *bin += flux * self.shares[y as usize * SIDE + x as usize];
                }
            }
        }
        bins
    }

    /// Measures a star near its place: flux, sky and middle by weighted least squares with this light as the template.
    ///
    /// `None` where it is too faint, too far from its place, or too near the border.
    pub fn place(&self, plane: &Plane, cells: &CellStatistics, star: &KnownStar) -> Option<PlacedStar> {
        const STEPS: usize = 4;
        /// A step this small, of a bin, ends the fit.
        const SETTLED: f64 = 0.01;
        let noise = f64::from(cells.local_noise(star.x.max(0.0) as usize, star.y.max(0.0) as usize)) / BIN_PX as f64;
        let (mut dx, mut dy) = (0.0, 0.0);
        for step in 0..STEPS {
            let bins = bins_around(plane, star.x + BIN_PX as f64 * dx, star.y + BIN_PX as f64 * dy)?;
            let (mut normal, mut right) = (Matrix4::<f64>::zeros(), Vector4::<f64>::zeros());
            for &n in &self.window {
                let at = |m: usize| f64::from(self.shares[m]);
                let slopes = Vector4::new(at(n), 1.0, 0.5 * (at(n - 1) - at(n + 1)), 0.5 * (at(n - SIDE) - at(n + SIDE)));
                normal += slopes * slopes.transpose();
                right += slopes * f64::from(bins[n]);
            }
            let inverse = normal.cholesky()?.inverse();
            let found = inverse * right;
            let amplitude = found[0];
            let snr = amplitude / (noise * inverse[(0, 0)].sqrt());
            if !(snr >= LEAST_SNR) {
                return None;
            }
            let (step_x, step_y) = ((found[2] / amplitude).clamp(-2.0, 2.0), (found[3] / amplitude).clamp(-2.0, 2.0));
            (dx, dy) = (dx + step_x, dy + step_y);
            if !(dx.hypot(dy) <= FURTHEST) {
                return None;
            }
            if (step_x.abs() < SETTLED && step_y.abs() < SETTLED) || step + 1 == STEPS {
                let scale = (BIN_PX as f64 * noise / amplitude).powi(2);
                return Some(PlacedStar {
                    x: star.x + self.middle.0 + BIN_PX as f64 * dx,
                    y: star.y + self.middle.1 + BIN_PX as f64 * dy,
                    covariance: (scale * inverse[(2, 2)], scale * inverse[(3, 3)], scale * inverse[(2, 3)]),
                    flux: amplitude * (BIN_PX * BIN_PX) as f64,
                    snr,
                });
            }
        }
        None
    }
}

/// A connected piece of light.
struct Piece {
    bins: Vec<usize>,
    flux: f32,
    snr: f32,
}

/// The connected pieces of a stack that stand above its noise.
fn pieces_of(stack: &[f32], sigma: f32) -> Vec<Piece> {
    let mean_of_nine = |n: usize| around(n).map(|m| stack[m]).sum::<f32>() / 9.0;
    let mut open: Vec<bool> = (0..N).map(|n| is_inner(n) && mean_of_nine(n) > LIGHT_SIGMAS * sigma / 3.0).collect();
    let mut pieces = Vec::new();
    for first in 0..N {
        if !open[first] {
            continue;
        }
        open[first] = false;
        let mut bins = vec![first];
        let mut next = 0;
        while let Some(&bin) = bins.get(next) {
            next += 1;
            for neighbour in around(bin).filter(|&m| is_inner(m)) {
                if std::mem::take(&mut open[neighbour]) {
                    bins.push(neighbour);
                }
            }
        }
        let flux: f32 = bins.iter().map(|&bin| stack[bin]).sum();
        pieces.push(Piece { flux, snr: flux / (sigma * (bins.len() as f32).sqrt()), bins });
    }
    pieces
}

/// The value below and above which half of the weight lies; values come with their weights.
fn weighted_median(values: &mut [(f32, f32)]) -> f32 {
    values.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * values.iter().map(|v| v.1).sum::<f32>();
    let mut below = 0.0;
    for &(value, weight) in values.iter() {
        below += weight;
        if below >= half {
            return value;
        }
    }
    0.0
}

/// A bin with all its neighbours inside.
fn is_inner(n: usize) -> bool {
    let (x, y) = (n % SIDE, n / SIDE);
    x > 0 && y > 0 && x + 1 < SIDE && y + 1 < SIDE
}

/// An inner bin and its eight neighbours.
fn around(n: usize) -> impl Iterator<Item = usize> {
    (0..9).map(move |k| n + k % 3 + k / 3 * SIDE - 1 - SIDE)
}

/// A set of bins and, `times` over, their neighbours.
fn grown(set: &[bool], times: usize) -> Vec<bool> {
    let mut set = set.to_vec();
    for _ in 0..times {
        set = (0..N).map(|n| if is_inner(n) { around(n).any(|m| set[m]) } else { set[n] }).collect();
    }
    set
}

/// Offset of a bin from the middle, bins.
fn place(n: usize) -> (f64, f64) {
    ((n % SIDE) as f64 - REACH as f64, (n / SIDE) as f64 - REACH as f64)
}

/// The bins around a place, px, the middle of the middle one there, above the sky at their rim; `None` where they reach over the border.
fn bins_around(plane: &Plane, x: f64, y: f64) -> Option<Vec<f32>> {
    // The middle of bin i is at 2 i + ½ px.
    let corner = |c: f64| (c - 0.5 * (BIN_PX as f64 - 1.0)) / BIN_PX as f64 - REACH as f64;
    let (cx, cy) = (corner(x), corner(y));
    if !(cx >= 0.0 && cy >= 0.0 && cx + SIDE as f64 + 1.0 < plane.width as f64 && cy + SIDE as f64 + 1.0 < plane.height as f64) {
        return None;
    }
    let (x0, y0) = (cx as usize, cy as usize);
    let (fx, fy) = ((cx - x0 as f64) as f32, (cy - y0 as f64) as f32);
    let mut bins = Vec::with_capacity(N);
    for j in 0..SIDE {
        let (top, bottom) = (&plane.row(y0 + j)[x0..=x0 + SIDE], &plane.row(y0 + j + 1)[x0..=x0 + SIDE]);
        for i in 0..SIDE {
            let upper = top[i] + fx * (top[i + 1] - top[i]);
            let lower = bottom[i] + fx * (bottom[i + 1] - bottom[i]);
            bins.push(upper + fy * (lower - upper));
        }
    }
    take_off_sky(&mut bins);
    Some(bins)
}

/// Takes off the sky and its slope, as the medians of the four sides of the rim tell them.
fn take_off_sky(bins: &mut [f32]) {
    let side = |is_in: &dyn Fn(usize, usize) -> bool| {
        let mut side: Vec<f32> =
            bins.iter().enumerate().filter(|(n, _)| is_in(n % SIDE, n / SIDE)).map(|(_, bin)| *bin).collect();
        let middle = side.len() / 2;
        *side.select_nth_unstable_by(middle, f32::total_cmp).1
    };
    let (left, right) = (side(&|x, _| x < RIM), side(&|x, _| x + RIM >= SIDE));
    let (top, bottom) = (side(&|_, y| y < RIM), side(&|_, y| y + RIM >= SIDE));
    let apart = (SIDE - RIM) as f32;
    let (gx, gy, base) = ((right - left) / apart, (bottom - top) / apart, 0.25 * ((left + right) + (top + bottom)));
    for (n, bin) in bins.iter_mut().enumerate() {
        let (x, y) = place(n);
        *bin -= base + gx * x as f32 + gy * y as f32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Frame;
    use crate::sky::RowOrder;
    use rand::{Rng, SeedableRng};

    /// Stars, each of pieces at the given offsets with the given weights, on a noisy sky: the picture halved once, its statistics, and
    /// the stars at their places.
    fn picture(pieces: &[(f64, f64, f64)], flux: f64) -> (Plane, CellStatistics, Vec<KnownStar>) {
        let (w, h) = (800, 600);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut light = vec![0f64; w * h];
        let stars: Vec<KnownStar> = (0..12)
            .map(|_| KnownStar {
                x: 60.0 + 680.0 * random.random::<f64>(),
                y: 60.0 + 480.0 * random.random::<f64>(),
                flux: flux * (1.0 + random.random::<f64>()),
            })
            .collect();
        for star in &stars {
            for &(dx, dy, share) in pieces {
                let (px, py) = (star.x + dx, star.y + dy);
                for y in (py as usize - 8)..(py as usize + 9) {
                    for x in (px as usize - 8)..(px as usize + 9) {
                        let r2 = (x as f64 - px).powi(2) + (y as f64 - py).powi(2);
                        light[y * w + x] += star.flux * share * (-0.5 * r2).exp() / std::f64::consts::TAU;
                    }
                }
            }
        }
        let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        let pixels = light.iter().map(|l| (500.0 + l + 8.0 * normal()).round() as u16).collect();
        let frame = Frame::new(w, h, pixels, RowOrder::BottomFirst).unwrap();
        let mut cells = CellStatistics::default();
        cells.measure(&frame, None);
        let raw = Plane { width: w, height: h, pixels: frame.pixels.iter().map(|&p| f32::from(p)).collect() };
        let mut plane = Plane::default();
        super::super::plane::halve(&raw, &mut plane);
        (plane, cells, stars)
    }

    #[test]
    fn round_stars_have_their_light_at_their_places() {
        let (plane, cells, stars) = picture(&[(0.0, 0.0, 1.0)], 800.0);
        let light = Light::of(&plane, &cells, &stars).unwrap();
        assert!(
            light.middle.0.hypot(light.middle.1) < 4.0 * light.sigma && light.sigma < 0.1,
            "{:?} ± {}",
            light.middle,
            light.sigma
        );
        assert!(light.axes.0 < 2.0);
    }

    #[test]
    fn stars_in_two_pieces_have_their_light_between_them() {
        let (plane, cells, stars) = picture(&[(0.0, 0.0, 0.5), (16.0, -8.0, 0.5)], 800.0);
        let light = Light::of(&plane, &cells, &stars).unwrap();
        assert!((light.middle.0 - 8.0).hypot(light.middle.1 + 4.0) < 4.0 * light.sigma, "{:?} ± {}", light.middle, light.sigma);
        assert!(light.sigma < 0.5);
    }

    #[test]
    fn stars_are_measured_with_the_light_of_all_and_their_covariance_is_right() {
        let trail: Vec<(f64, f64, f64)> = (0..11).map(|i| (f64::from(i) - 5.0, 0.0, 1.0 / 11.0)).collect();
        let (plane, cells, stars) = picture(&trail, 900.0);
        let light = Light::of(&plane, &cells, &stars).unwrap();
        let (mut along, mut across, mut count) = (0.0, 0.0, 0.0);
        for star in &stars {
            let moved = KnownStar { x: star.x + 1.2, y: star.y - 0.7, ..*star };
            let Some(placed) = light.place(&plane, &cells, &moved) else { continue };
            along += (placed.x - star.x).powi(2) / placed.covariance.0;
            across += (placed.y - star.y).powi(2) / placed.covariance.1;
            count += 1.0;
            assert!(placed.covariance.0 > 3.0 * placed.covariance.1, "{placed:?}");
        }
        assert!(count >= 10.0);
        // Of a dozen squares of normal numbers the mean is between these in 99 of 100 cases.
        assert!((0.2..2.5).contains(&(along / count)) && (0.2..2.5).contains(&(across / count)), "{along} {across} {count}");
    }

    #[test]
    fn no_light_at_the_places_or_too_few_places_say_nothing() {
        let (plane, cells, stars) = picture(&[(0.0, 0.0, 1.0)], 800.0);
        assert!(Light::of(&plane, &cells, &stars[..3]).is_none());
        let elsewhere: Vec<KnownStar> = stars.iter().map(|s| KnownStar { x: s.y + 30.0, y: s.x.min(540.0), ..*s }).collect();
        assert!(Light::of(&plane, &cells, &elsewhere).is_none());
    }
}
