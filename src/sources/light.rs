//! The frame's own point spread function, whatever its shape, from stars whose places are known: trails, trails in pieces, discs.
//!
//! A trail of several exposures is found piece by piece, and a pattern of equal pieces solves as well as one of whole stars. Once a
//! pose says where the stars are, the pictures of all of them laid on top of each other show where the light of a star really lies; and
//! with that picture as its template each star can be measured as well as its light allows.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: bins are counted by the constants that size them")]

use super::plane::Plane;
use crate::image::CellStatistics;
use crate::sky::{Kernel, with_vectors};
use nalgebra::{Matrix4, Vector4};

/// Pixels along a bin: the picture halved once. Bins from the middle to the border: trails and discs of 30 px and more fit.
pub const BIN_PX: usize = 2;
const REACH: usize = 18;
/// The same, px.
pub const REACH_PX: f64 = (REACH * BIN_PX) as f64;
const SIDE: usize = 2 * REACH + 1;
const N: usize = SIDE * SIDE;
/// Bins at the border from which the sky under a star is taken.
const RIM: usize = 3;
/// Stars laid on top of each other: the brightest, which decide.
const MOST_STARS: usize = 20;
const LEAST_STARS: usize = 4;
/// A bin shows light where the mean of the nine around it stands this many σ above the sky; and a piece of light is not chance above this.
const LIGHT_SIGMAS: f32 = 3.5;
const PIECE_SNR: f32 = 5.0;
/// Exposures of a series are equally long: a piece has not less of the light than this, of the brightest one (which may be two that touch).
pub const PIECE_SHARE: f32 = 0.35;
/// Bins further than this from a place are not the light of one round star there.
const NEAR: f64 = 3.0;
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
    /// One σ of it per axis, px. The stars' own places, measured with this light, err by no more on the mean: they make it.
    pub sigma: f64,
    /// Root mean square extent along the long and the short axis, px.
    pub axes: (f64, f64),
    /// Too few stars are bright enough to tell whether all of this light is theirs.
    pub doubtful: bool,
    /// It comes near the border of what is looked at, and may go on beyond: the middle may be anywhere within [`REACH_PX`].
    pub cut: bool,
    /// It is so faint that another piece as bright as one of them may be hidden in the noise.
    pub faint: bool,
    /// Most that a star counted for, what all of them did together, and how far the template's bins move with those of one that counts
    /// for all.
    most: f32,
    all: f32,
    pull: f32,
}

/// What a star counts for where several are laid on top of each other: the inverse of its variance.
fn weight_of(star: &KnownStar, noise: f32) -> f32 {
    (star.flux as f32 / noise).powi(2)
}

impl Light {
    /// The light of stars at known places; `None` where there are too few of them, or no light at their places.
    pub fn of(plane: &Plane, cells: &CellStatistics, stars: &[KnownStar]) -> Option<Self> {
        let mut seen: Vec<Seen> = Vec::new();
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
        let all: f32 = weights.iter().sum();
        // Half over the density of the stars' values at the median.
        let density: f32 = seen.iter().zip(&weights).map(|((star, noise, _), w)| w / share_noise(star, *noise)).sum();
        let pull = MEDIAN_OVER_MEAN * all / density;
        let mut light: Option<Self> = None;
        let mut rows = vec![[0f32; N]; seen.len()];
        let mut stack = [0f32; N];
        // The second time without the light of the neighbours.
        for _ in 0..2 {
            for ((star, _, bins), row) in seen.iter().zip(&mut rows) {
                row.copy_from_slice(bins);
                if let Some(light) = &light {
                    light.take_neighbours(star, stars, row);
                }
                // The sum over a star's bins is its flux over the pixels of a bin.
                let share = (BIN_PX * BIN_PX) as f32 / star.flux as f32;
                row.iter_mut().for_each(|bin| *bin *= share);
            }
            with_vectors(WeightedMedians { rows: &rows, weights: &weights, medians: &mut stack });
            light = Some(Self { most, all, pull, ..Self::of_stack(&stack, sigma, &seen)? });
        }
        light
    }

    /// The light in a stack whose bins have the noise `sigma`.
    fn of_stack(stack: &[f32], sigma: f32, seen: &[Seen]) -> Option<Self> {
        /// Bins interpolated at any phase have this part of the noise of those of the picture; and that of neighbours, which is alike, is
        /// so no more where each bin's median is another star's.
        const INTERPOLATED: f64 = 2.0 / 3.0;
        let pieces = pieces_of(stack, sigma);
        let brightest = pieces.iter().map(|p| p.flux).fold(0.0, f32::max);
        // The faintest piece that counts is seen where, two σ below its signal, it is still no chance.
        const CHANCE: f32 = 2.0;
        let surest = pieces.iter().map(|p| p.snr).fold(0.0, f32::max);
        let faint = PIECE_SHARE * surest < PIECE_SNR + CHANCE;
        let mut lit = vec![false; N];
        let mut doubtful = false;
        for piece in pieces.iter().filter(|p| p.snr >= PIECE_SNR && p.flux >= PIECE_SHARE * brightest) {
            // What reaches out of the middle must belong to the stars for itself.
            let (near, far): (Vec<usize>, Vec<usize>) = piece.bins.iter().partition(|&&n| place(n).0.hypot(place(n).1) <= NEAR);
            for part in [near, far].into_iter().filter(|part| !part.is_empty()) {
                let belongs = belongs_to_stars(&part, stack, seen);
                if belongs != Some(false) {
                    part.iter().for_each(|&bin| lit[bin] = true);
                    doubtful |= belongs.is_none();
                }
            }
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
            sigma: bin * INTERPOLATED * f64::from(sigma / total) * (0.5 * spread).sqrt(),
            axes: (bin * (mean + half).max(0.0).sqrt(), bin * (mean - half).max(0.0).sqrt()),
            doubtful,
            cut: (0..N).any(|n| lit[n] && !is_clear_of_rim(n)),
            faint,
            most: 0.0,
            all: f32::INFINITY,
            pull: 0.0,
        })
    }

    /// Takes the light of all other stars off the bins around a star's place.
    fn take_neighbours(&self, star: &KnownStar, stars: &[KnownStar], bins: &mut [f32; N]) {
        for other in stars {
            let (dx, dy) = ((other.x - star.x) / BIN_PX as f64, (other.y - star.y) / BIN_PX as f64);
            let reach = 2.0 * REACH as f64;
            if (dx, dy) == (0.0, 0.0) || dx.abs() > reach || dy.abs() > reach {
                continue;
            }
            let (dx, dy) = (dx.round() as isize, dy.round() as isize);
            let flux = (other.flux / (BIN_PX * BIN_PX) as f64) as f32;
            // Where the two squares lie over each other: bins here, and the same in the other's square.
            let over = |d: isize| {
                let first = d.max(0) as usize;
                (first, first.wrapping_add_signed(-d), SIDE - d.unsigned_abs())
            };
            let ((x, from_x, width), (y, from_y, height)) = (over(dx), over(dy));
            for row in 0..height {
                let shares = &self.shares[(from_y + row) * SIDE + from_x..][..width];
                let bins = &mut bins[(y + row) * SIDE + x..][..width];
                bins.iter_mut().zip(shares).for_each(|(bin, share)| *bin -= flux * share);
            }
        }
    }

    /// The template as it would be without a star, in whose own noise it would find itself again where it was thought to be.
    ///
    /// To first order in what the star counts for: the influence of one value on a median is the same however far off it is.
    fn without(&self, plane: &Plane, star: &KnownStar, noise: f32) -> Option<Vec<f32>> {
        let own = weight_of(star, noise).min(self.most) / self.all;
        let bins = bins_around(plane, star.x, star.y)?;
        let flux = star.flux as f32 / (BIN_PX * BIN_PX) as f32;
        let without = |(&share, bin): (&f32, f32)| {
            let is_lit = share != 0.0;
            if is_lit { share - own * self.pull * (bin / flux - share).signum() } else { 0.0 }
        };
        Some(self.shares.iter().zip(bins).map(without).collect())
    }

    /// Measures a star near its place: flux, sky and middle by weighted least squares with this light as the template, the light that its
    /// neighbours among `stars` have there taken off.
    ///
    /// `None` where it is too faint, too far from its place, or too near the border.
    pub fn place(&self, plane: &Plane, cells: &CellStatistics, star: &KnownStar, stars: &[KnownStar]) -> Option<PlacedStar> {
        const STEPS: usize = 4;
        /// A step this small, of a bin, ends the fit.
        const SETTLED: f64 = 0.01;
        let noise = f64::from(cells.local_noise(star.x.max(0.0) as usize, star.y.max(0.0) as usize)) / BIN_PX as f64;
        let (gx, gy) = sky_slope(plane, star)?;
        let template = self.without(plane, star, noise as f32)?;
        // The template stands still and the picture is taken where the star is thought to be: one matrix does for all steps.
        let slopes = |n: usize| {
            let at = |m: usize| f64::from(template[m]);
            Vector4::new(at(n), 1.0, 0.5 * (at(n - 1) - at(n + 1)), 0.5 * (at(n - SIDE) - at(n + SIDE)))
        };
        let mut normal = Matrix4::<f64>::zeros();
        for &n in &self.window {
            let slopes = slopes(n);
            normal += slopes * slopes.transpose();
        }
        let inverse = normal.cholesky()?.inverse();
        let mut less_neighbours = [0f32; N];
        self.take_neighbours(star, stars, &mut less_neighbours);
        let (mut dx, mut dy) = (0.0, 0.0);
        for step in 0..STEPS {
            let corner = corner_of(plane, star.x + BIN_PX as f64 * dx, star.y + BIN_PX as f64 * dy)?;
            let (mut right, mut squares) = (Vector4::<f64>::zeros(), 0.0);
            for &n in &self.window {
                let (x, y) = place(n);
                let light = f64::from(corner.bin(plane, n) + less_neighbours[n]) - gx * x - gy * y;
                right += slopes(n) * light;
                squares += light * light;
            }
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
                // What fits worse than noise explains is as much less well known.
                let misfit = (squares - right.dot(&found)) / (noise * noise * (self.window.len() as f64 - 4.0).max(1.0));
                let scale = (BIN_PX as f64 * noise / amplitude).powi(2) * misfit.max(1.0);
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

/// A star, the noise of a bin there, and the bins around it.
type Seen = (KnownStar, f32, Vec<f32>);

/// A connected piece of light.
struct Piece {
    bins: Vec<usize>,
    /// Share of a star's light.
    flux: f32,
    snr: f32,
}

/// Whether the light in some bins belongs to the stars: those bright enough to tell have it, each in proportion to its own light. What
/// clouds look like under some of them does not grow with them. `None` where hardly a star can tell.
fn belongs_to_stars(bins: &[usize], stack: &[f32], seen: &[Seen]) -> Option<bool> {
    const TELLING_SIGMAS: f32 = 3.0;
    const LEAST_TELLING: usize = 3;
    const LEAST_OF_SHARE: f32 = 0.4;
    const MOST_OF_SHARE: f32 = 2.0;
    const LEAST_HAVE: f32 = 0.7;
    let share: f32 = bins.iter().map(|&n| stack[n]).sum();
    let (mut telling, mut have) = (0, 0);
    for (star, noise, around) in seen {
        let flux = (star.flux / (BIN_PX * BIN_PX) as f64) as f32;
        let margin = TELLING_SIGMAS * noise * (bins.len() as f32).sqrt();
        if share * flux >= margin {
            telling += 1;
            let light: f32 = bins.iter().map(|&n| around[n]).sum();
            have += usize::from(light >= LEAST_OF_SHARE * share * flux && light <= MOST_OF_SHARE * share * flux + margin);
        }
    }
    (telling >= LEAST_TELLING).then_some(have as f32 >= LEAST_HAVE * telling as f32)
}

/// The connected pieces of a stack that stand above its noise: that of its bins, `sigma`, or that which it shows itself (clouds under the
/// stars are no noise of single bins).
fn pieces_of(stack: &[f32], sigma: f32) -> Vec<Piece> {
    /// σ of a normal distribution over its median absolute deviation.
    const SIGMA_PER_DEVIATION: f32 = 1.482_6;
    let smooth: Vec<f32> =
        (0..N).map(|n| if is_inner(n) { around(n).map(|m| stack[m]).sum::<f32>() / 9.0 } else { 0.0 }).collect();
    let mut deviations: Vec<f32> = (0..N).filter(|&n| is_inner(n)).map(|n| smooth[n].abs()).collect();
    let middle = deviations.len() / 2;
    let shown = SIGMA_PER_DEVIATION * *deviations.select_nth_unstable_by(middle, f32::total_cmp).1;
    // Of nine bins each.
    let sigma_of_nine = shown.max(sigma / 3.0);
    let mut open: Vec<bool> = smooth.iter().map(|light| *light > LIGHT_SIGMAS * sigma_of_nine).collect();
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
        // As many nines as there are in the bins are independent.
        let noise = sigma_of_nine * 3.0 * (bins.len() as f32).sqrt();
        pieces.push(Piece { flux, snr: flux / noise, bins });
    }
    pieces
}

/// For each bin the value below and above which half of the weight of the rows lies.
struct WeightedMedians<'a> {
    rows: &'a [[f32; N]],
    weights: &'a [f32],
    medians: &'a mut [f32; N],
}

impl Kernel for WeightedMedians<'_> {
    type Output = ();

    /// The least value that has half of the weight up to it: counted for each, which vectors do sooner than they sort.
    #[inline(always)]
    fn run(self) {
        let half = 0.5 * self.weights.iter().sum::<f32>();
        self.medians.fill(f32::INFINITY);
        for here in self.rows {
            let mut below = [0f32; N];
            for (there, weight) in self.rows.iter().zip(self.weights) {
                let weight = weight.to_bits();
                for n in 0..N {
                    // All bits of the weight or none: a choice would be compiled as a branch.
                    below[n] += f32::from_bits(weight & u32::from(there[n] <= here[n]).wrapping_neg());
                }
            }
            for n in 0..N {
                let value = if below[n] >= half { here[n] } else { f32::INFINITY };
                self.medians[n] = if value < self.medians[n] { value } else { self.medians[n] };
            }
        }
    }
}

/// A bin with all its neighbours inside.
fn is_inner(n: usize) -> bool {
    let (x, y) = (n % SIDE, n / SIDE);
    x > 0 && y > 0 && x + 1 < SIDE && y + 1 < SIDE
}

/// A bin further in than those from which the sky is taken.
fn is_clear_of_rim(n: usize) -> bool {
    let (x, y) = (n % SIDE, n / SIDE);
    let inside = RIM + 1..SIDE - RIM - 1;
    inside.contains(&x) && inside.contains(&y)
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

/// The corner of a square of bins, between those of the plane.
struct Corner {
    x: usize,
    y: usize,
    /// Part of a bin beyond it.
    fx: f32,
    fy: f32,
}

impl Corner {
    /// A bin of the square, interpolated.
    #[inline]
    fn bin(&self, plane: &Plane, n: usize) -> f32 {
        let at = (self.y + n / SIDE) * plane.width + self.x + n % SIDE;
        let (top, bottom) = (&plane.pixels[at..at + 2], &plane.pixels[at + plane.width..at + plane.width + 2]);
        let upper = top[0] + self.fx * (top[1] - top[0]);
        let lower = bottom[0] + self.fx * (bottom[1] - bottom[0]);
        upper + self.fy * (lower - upper)
    }
}

/// The corner of the bins whose middle one has its middle at a place, px; `None` where they reach over the border.
fn corner_of(plane: &Plane, x: f64, y: f64) -> Option<Corner> {
    // The middle of bin i is at 2 i + ½ px.
    let corner = |c: f64| (c - 0.5 * (BIN_PX as f64 - 1.0)) / BIN_PX as f64 - REACH as f64;
    let (cx, cy) = (corner(x), corner(y));
    let inside =
        cx >= 0.0 && cy >= 0.0 && cx + SIDE as f64 + 1.0 < plane.width as f64 && cy + SIDE as f64 + 1.0 < plane.height as f64;
    inside.then(|| {
        let (x, y) = (cx as usize, cy as usize);
        Corner { x, y, fx: (cx - x as f64) as f32, fy: (cy - y as f64) as f32 }
    })
}

/// The bins around a place, px, above the sky and its slope.
fn bins_around(plane: &Plane, x: f64, y: f64) -> Option<Vec<f32>> {
    let corner = corner_of(plane, x, y)?;
    let mut bins: Vec<f32> = (0..N).map(|n| corner.bin(plane, n)).collect();
    let (base, gx, gy) = sky_of(&|n| bins[n]);
    for (n, bin) in bins.iter_mut().enumerate() {
        let (x, y) = place(n);
        *bin -= base + gx * x as f32 + gy * y as f32;
    }
    Some(bins)
}

/// Slope of the sky under a star, ADU a bin.
fn sky_slope(plane: &Plane, star: &KnownStar) -> Option<(f64, f64)> {
    let corner = corner_of(plane, star.x, star.y)?;
    let (_, gx, gy) = sky_of(&|n| corner.bin(plane, n));
    Some((f64::from(gx), f64::from(gy)))
}

/// The sky at the middle and its slopes, as the medians of the four sides of the rim tell them.
fn sky_of(bin: &dyn Fn(usize) -> f32) -> (f32, f32, f32) {
    let side = |is_in: &dyn Fn(usize, usize) -> bool| {
        let mut side = [0f32; RIM * SIDE];
        let inside = (0..N).filter(|n| is_in(n % SIDE, n / SIDE));
        side.iter_mut().zip(inside).for_each(|(out, n)| *out = bin(n));
        *side.select_nth_unstable_by(RIM * SIDE / 2, f32::total_cmp).1
    };
    let (left, right) = (side(&|x, _| x < RIM), side(&|x, _| x + RIM >= SIDE));
    let (top, bottom) = (side(&|_, y| y < RIM), side(&|_, y| y + RIM >= SIDE));
    let apart = (SIDE - RIM) as f32;
    (0.25 * ((left + right) + (top + bottom)), (right - left) / apart, (bottom - top) / apart)
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
        picture_of(5, pieces, flux)
    }

    fn picture_of(seed: u64, pieces: &[(f64, f64, f64)], flux: f64) -> (Plane, CellStatistics, Vec<KnownStar>) {
        let (w, h) = (800, 600);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
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
        super::super::plane::halve(&raw, &mut Default::default(), &mut plane);
        (plane, cells, stars)
    }

    #[test]
    fn round_stars_have_their_light_at_their_places() {
        let (plane, cells, stars) = picture(&[(0.0, 0.0, 1.0)], 800.0);
        let light = Light::of(&plane, &cells, &stars).unwrap();
        assert!(
            light.middle.0.hypot(light.middle.1) < 4.0 * light.sigma && light.sigma < 0.2,
            "{:?} ± {}",
            light.middle,
            light.sigma
        );
        assert!(light.axes.0 < 2.0);
    }

    #[test]
    fn the_middle_errs_by_its_sigma() {
        let trail: Vec<(f64, f64, f64)> = (0..11).map(|i| (f64::from(i) - 5.0, 0.0, 1.0 / 11.0)).collect();
        let (mut squares, mut count) = (0.0, 0.0);
        for seed in 0..24 {
            let (plane, cells, stars) = picture_of(seed, &trail, 700.0);
            let Some(light) = Light::of(&plane, &cells, &stars) else { continue };
            squares += (light.middle.0.powi(2) + light.middle.1.powi(2)) / (light.sigma * light.sigma);
            count += 2.0;
        }
        // Of 48 squares of normal numbers the mean is 1 ± 0.2.
        assert!(count > 40.0 && (0.55..1.6).contains(&(squares / count)), "{} of {count}", squares / count);
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
            let Some(placed) = light.place(&plane, &cells, &moved, &[]) else { continue };
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
