//! Measuring a peak: how far it stands above its surroundings, and whether it has the shape of a star.

#![allow(clippy::needless_range_loop, reason = "the loop runs over places that several lists share")]
#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a patch has a fixed size and its place is checked when it is cut")]

use super::plane::{MARGIN, Picture};

/// Half the side of a patch, and its side, samples: three boxes of five by three boxes of five.
pub const HALF: usize = 7;
pub const SIDE: usize = 2 * HALF + 1;
/// Samples that a row of a patch has room for: two vectors of eight. The last is nought and counts for nothing.
pub const WIDTH: usize = 16;
/// The samples of a patch, ADU.
pub type Samples = [[f32; WIDTH]; SIDE];
/// Side of one of the nine boxes.
const BOX: usize = 5;
/// Half the side of the core that a point spread function is compared with.
const CORE: usize = 3;
const CORE_SIDE: usize = 2 * CORE + 1;
const CORE_N: usize = CORE_SIDE * CORE_SIDE;
/// A row of the core and one more sample, which counts for nothing.
const CORE_LANES: usize = CORE_SIDE + 1;

fn inside<P: Picture>(picture: &P, x: usize, y: usize) -> bool {
    x >= MARGIN && y >= MARGIN && x + MARGIN < picture.width() && y + MARGIN < picture.height()
}

/// Where the highest nine samples lie together, from one sample before a place to `finer` after it; `None` at the border.
#[inline(always)]
pub fn summit<P: Picture>(picture: &P, x: usize, y: usize, finer: usize) -> Option<(usize, usize)> {
    if !inside(picture, x, y) {
        return None;
    }
    let lines = HALF - 2..HALF + finer + 2;
    let mut samples = [[0f32; WIDTH]; SIDE];
    picture.cut_lines(x, y, lines.clone(), &mut samples);
    // Sums of three along each line, in vectors; each is needed by three.
    let mut threes = [[0f32; WIDTH]; SIDE];
    for (row, threes) in samples[lines.clone()].iter().zip(&mut threes[lines]) {
        for i in 1..WIDTH - 1 {
            threes[i] = row[i - 1] + row[i] + row[i + 1];
        }
    }
    let mut best = (f32::MIN, x, y);
    for j in HALF - 1..=HALF + finer {
        for i in HALF - 1..=HALF + finer {
            let sum = threes[j - 1][i] + threes[j][i] + threes[j + 1][i];
            if sum > best.0 {
                best = (sum, x + i - HALF, y + j - HALF);
            }
        }
    }
    Some((best.1, best.2))
}

/// The surroundings of a peak.
#[derive(Debug, Clone, Default)]
pub struct Patch {
    pub(super) samples: Samples,
}

impl Patch {
    /// Makes it the patch around a sample; `false`, and it stays as it is, where that would reach over the border.
    #[inline(always)]
    pub fn cut_at<P: Picture>(&mut self, picture: &P, x: usize, y: usize) -> bool {
        let inside = inside(picture, x, y);
        if inside {
            picture.cut(x, y, &mut self.samples);
        }
        inside
    }

    /// The patch around a sample.
    #[cfg(test)]
    pub fn cut<P: Picture>(picture: &P, x: usize, y: usize) -> Option<Self> {
        let mut patch = Self::default();
        patch.cut_at(picture, x, y).then_some(patch)
    }

    /// Means of the nine boxes, row after row.
    #[inline(always)]
    fn box_means(&self) -> [f32; 9] {
        let mut means = [0f32; 9];
        for box_y in 0..3 {
            let mut column = [0f32; WIDTH];
            for row in &self.samples[box_y * BOX..box_y * BOX + BOX] {
                for i in 0..WIDTH {
                    column[i] += row[i];
                }
            }
            for box_x in 0..3 {
                let c = &column[box_x * BOX..][..BOX];
                means[3 * box_y + box_x] = ((c[0] + c[1]) + (c[2] + c[3]) + c[4]) * (1.0 / (BOX * BOX) as f32);
            }
        }
        means
    }

    /// The slope of the surroundings, along x and y, ADU a sample; and the means of the nine boxes without it.
    ///
    /// Along each axis it is the middle one of three, from the boxes on either side: a star in one box does not tilt the rest.
    #[inline(always)]
    pub fn surroundings(&self) -> Surroundings {
        let m = self.box_means();
        let across = (2 * BOX) as f32;
        let (gx, gy) = (
            middle_of_three(m[2] - m[0], m[5] - m[3], m[8] - m[6]) / across,
            middle_of_three(m[6] - m[0], m[7] - m[1], m[8] - m[2]) / across,
        );
        // From box to box it is five samples.
        let level = |n: usize| BOX as f32 * (gx * ((n % 3) as f32 - 1.0) + gy * ((n / 3) as f32 - 1.0));
        Surroundings { slope: (gx, gy), boxes: std::array::from_fn(|n| m[n] - level(n)) }
    }

    /// Takes a slope off, so that what is left is even on all sides of the peak.
    #[inline(always)]
    pub fn level_out(&mut self, (gx, gy): (f32, f32)) {
        for (j, row) in self.samples.iter_mut().enumerate() {
            let from_y = gy * (j as f32 - HALF as f32);
            for (i, sample) in row.iter_mut().enumerate() {
                *sample -= gx * (i as f32 - HALF as f32) + from_y;
            }
            row[WIDTH - 1] = 0.0;
        }
    }

    /// The highest sample of the core.
    pub fn highest(&self) -> f32 {
        self.core().fold(f32::MIN, f32::max)
    }

    fn core(&self) -> impl Iterator<Item = f32> + '_ {
        self.samples[HALF - CORE..=HALF + CORE].iter().flat_map(|row| row[HALF - CORE..=HALF + CORE].iter().copied())
    }

    /// How high a ridge runs through the peak, above `base`: the direction in which the lower one of the two sides is highest.
    ///
    /// A star has nothing on two opposite sides; a satellite's streak, a hot column, a trail have.
    #[inline(always)]
    fn ridge(&self, base: f32) -> f32 {
        let mut highest = f32::MIN;
        for direction in &SPOKES {
            let (mut one, mut other) = (0f32, 0f32);
            for &(dx, dy) in direction {
                let (dx, dy) = (isize::from(dx), isize::from(dy));
                one += self.samples[(HALF as isize + dy) as usize][(HALF as isize + dx) as usize];
                other += self.samples[(HALF as isize - dy) as usize][(HALF as isize - dx) as usize];
            }
            highest = highest.max(one.min(other));
        }
        highest / SPOKE_SAMPLES as f32 - base
    }
}

/// What lies around a peak.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings {
    /// Along x and y, ADU a sample.
    pub slope: (f32, f32),
    /// Means of the nine boxes without it, row after row, ADU.
    boxes: [f32; 9],
}

/// Sixteen directions over half a turn, each as the nearest samples 4, 5, 6 and 7 samples from the middle.
const SPOKE_SAMPLES: usize = 4;
const SPOKES: [[(i8, i8); SPOKE_SAMPLES]; 16] = [
    [(4, 0), (5, 0), (6, 0), (7, 0)],
    [(4, 1), (5, 1), (6, 1), (7, 1)],
    [(4, 2), (5, 2), (6, 2), (6, 3)],
    [(3, 2), (4, 3), (5, 3), (6, 4)],
    [(3, 3), (4, 4), (4, 4), (5, 5)],
    [(2, 3), (3, 4), (3, 5), (4, 6)],
    [(2, 4), (2, 5), (2, 6), (3, 6)],
    [(1, 4), (1, 5), (1, 6), (1, 7)],
    [(0, 4), (0, 5), (0, 6), (0, 7)],
    [(-1, 4), (-1, 5), (-1, 6), (-1, 7)],
    [(-2, 4), (-2, 5), (-2, 6), (-3, 6)],
    [(-2, 3), (-3, 4), (-3, 5), (-4, 6)],
    [(-3, 3), (-4, 4), (-4, 4), (-5, 5)],
    [(-3, 2), (-4, 3), (-5, 3), (-6, 4)],
    [(-4, 2), (-5, 2), (-6, 2), (-6, 3)],
    [(-4, 1), (-5, 1), (-6, 1), (-7, 1)],
];

#[inline(always)]
fn middle_of_three(a: f32, b: f32, c: f32) -> f32 {
    a.max(b).min(a.min(b).max(c))
}

/// Sorts eight numbers by the network of nineteen comparisons.
#[inline(always)]
fn sort_eight(v: &mut [f32; 8]) {
    const NETWORK: [(usize, usize); 19] = [
        (0, 2),
        (1, 3),
        (4, 6),
        (5, 7),
        (0, 4),
        (1, 5),
        (2, 6),
        (3, 7),
        (0, 1),
        (2, 3), //
        (4, 5),
        (6, 7),
        (2, 4),
        (3, 5),
        (1, 4),
        (3, 6),
        (1, 2),
        (3, 4),
        (5, 6),
    ];
    for (i, j) in NETWORK {
        (v[i], v[j]) = (v[i].min(v[j]), v[i].max(v[j]));
    }
}

/// An elliptical Gaussian: second moments along x and y and across, samples².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// ⟨x²⟩.
    pub xx: f32,
    /// ⟨y²⟩.
    pub yy: f32,
    /// ⟨xy⟩.
    pub xy: f32,
}

impl Shape {
    /// A round one of a given σ, samples.
    pub fn round(sigma: f32) -> Self {
        Self { xx: sigma * sigma, yy: sigma * sigma, xy: 0.0 }
    }

    /// σ along the long and the short axis, samples.
    pub fn axes(&self) -> (f32, f32) {
        let mean = 0.5 * (self.xx + self.yy);
        let half = (0.25 * (self.xx - self.yy).powi(2) + self.xy * self.xy).sqrt();
        ((mean + half).max(0.0).sqrt(), (mean - half).max(0.0).sqrt())
    }

    /// The inverse matrix (xx, yy, xy); a degenerate shape is widened first.
    pub(super) fn inverse(&self) -> (f32, f32, f32) {
        let (xx, yy) = (self.xx.max(0.05), self.yy.max(0.05));
        let limit = 0.95 * (xx * yy).sqrt();
        let xy = self.xy.clamp(-limit, limit);
        let det = xx * yy - xy * xy;
        (yy / det, xx / det, -xy / det)
    }

    /// Value at an offset from the centre, 1 at the centre.
    #[inline(always)]
    pub(super) fn value(inverse: (f32, f32, f32), dx: f32, dy: f32) -> f32 {
        exp_of_negative(-0.5 * (inverse.0 * dx * dx + inverse.1 * dy * dy) - inverse.2 * dx * dy)
    }
}

/// e^x for x ≤ 0 to 2·10⁻⁶ of its value: 2^n by the exponent's bits, 2^f by a polynomial, so that loops over it vectorise.
#[inline(always)]
pub(super) fn exp_of_negative(x: f32) -> f32 {
    // Below, the result is less than any sample's noise; and 2^n stays a normal number.
    const LOWEST: f32 = -80.0;
    /// Added to a number of moderate size, it leaves the nearest whole number in the last bits.
    const ROUND: f32 = 12_582_912.0;
    let t = x.clamp(LOWEST, 0.0) * std::f32::consts::LOG2_E;
    let rounded = t + ROUND;
    let f = t - (rounded - ROUND);
    // Taylor series of 2^f, |f| ≤ ½.
    let p = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5 + f * (0.055_504_11 + f * (0.009_618_13 + f * (0.001_333_36 + f * 0.000_154_04)))));
    // No check of overflow, which would keep it from being done in vectors: what is shifted out at the top is ROUND's.
    p * f32::from_bits(rounded.to_bits().wrapping_add(127) << 23)
}

/// The point spread function over a core, normalised to a sum of 1.
#[derive(Debug, Clone)]
pub struct CoreTemplate {
    /// Row after row, each with room for a whole vector.
    weights: [[f32; CORE_LANES]; CORE_SIDE],
    sum_sq: f32,
}

impl CoreTemplate {
    /// The template of a shape.
    pub fn new(shape: &Shape) -> Self {
        let inverse = shape.inverse();
        let mut weights = [[0f32; CORE_LANES]; CORE_SIDE];
        for (j, row) in weights.iter_mut().enumerate() {
            for (i, w) in row.iter_mut().enumerate().take(CORE_SIDE) {
                *w = Shape::value(inverse, i as f32 - CORE as f32, j as f32 - CORE as f32);
            }
        }
        let total: f32 = weights.as_flattened().iter().sum();
        weights.as_flattened_mut().iter_mut().for_each(|w| *w /= total);
        Self { weights, sum_sq: weights.as_flattened().iter().map(|w| w * w).sum() }
    }
}

/// How a peak stands against its surroundings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Standing {
    /// Surroundings, ADU: the mean of the middle four of the eight boxes around.
    pub base: f32,
    /// Matched-filter flux above the surroundings, ADU.
    pub flux: f32,
    /// Matched-filter signal over noise.
    pub snr: f32,
    /// The same against the mean of the two brightest boxes: what an edge or a cloud does not have (stars-paper, "Source Finding").
    pub confidence: f32,
    /// Power that the shape does not explain over the power that it does; stars have little.
    pub unlike: f32,
    /// Whether a ridge runs through it.
    pub on_ridge: bool,
}

/// A ridge stands this high, of the peak and above this many times its own noise.
const RIDGE_OF_PEAK: f32 = 0.35;
const RIDGE_SIGMAS: f32 = 2.0;
/// No sample is taken to have less noise, ADU.
const LEAST_NOISE: f32 = 1e-3;

impl Standing {
    /// Measures a patch, levelled out, whose samples have the noise `sigma`, ADU; whether a ridge runs through it is left open.
    #[inline(always)]
    pub fn measure(patch: &Patch, template: &CoreTemplate, sigma: f32) -> Self {
        let around = Surroundings { slope: (0.0, 0.0), boxes: patch.box_means() };
        Self::measure_in(patch, &around, template, sigma)
    }

    /// As [`Self::measure`], of a patch that is not levelled out yet, in its surroundings.
    #[inline(always)]
    pub fn measure_in(patch: &Patch, around: &Surroundings, template: &CoreTemplate, sigma: f32) -> Self {
        let nine = around.boxes;
        let mut means = [nine[0], nine[1], nine[2], nine[3], nine[5], nine[6], nine[7], nine[8]];
        sort_eight(&mut means);
        let base = 0.25 * (means[2] + means[3] + means[4] + means[5]);
        let brightest = 0.5 * (means[6] + means[7]);
        let sigma = sigma.max(LEAST_NOISE);
        let (gx, gy) = around.slope;
        let (mut filtered, mut power) = ([0f32; CORE_LANES], [0f32; CORE_LANES]);
        for (j, weights) in template.weights.iter().enumerate() {
            let row = patch.samples[HALF - CORE + j][HALF - CORE..].first_chunk().unwrap_or(&[0f32; CORE_LANES]);
            let level = base + gy * (j as f32 - CORE as f32);
            for i in 0..CORE_LANES {
                let d = row[i] - (level + gx * (i as f32 - CORE as f32));
                filtered[i] += d * weights[i];
                power[i] += d * d;
            }
        }
        power[CORE_SIDE] = 0.0;
        let [filtered, power] = [filtered, power].map(|v| ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7])));
        let flux = filtered / template.sum_sq;
        // A constant step of the base changes the filtered sum by as much, because the weights sum to 1.
        let noise = sigma * template.sum_sq.sqrt();
        let explained = filtered * filtered / template.sum_sq;
        let unlike = (power - CORE_N as f32 * sigma * sigma - explained) / explained.max(1e-6);
        let confidence = (filtered - (brightest - base).max(0.0)) / noise;
        Self { base, flux, snr: filtered / noise, confidence, unlike, on_ridge: false }
    }

    /// Looks for a ridge through the peak: most peaks are not worth the look.
    #[inline(always)]
    pub fn look_for_ridge(&mut self, patch: &Patch, sigma: f32) {
        // Height of the peak as a mean over three by three, so that a lone pixel does not decide.
        let height = (HALF - 1..=HALF + 1).map(|j| patch.samples[j][HALF - 1..=HALF + 1].iter().sum::<f32>()).sum::<f32>() / 9.0
            - self.base;
        let ridge_noise = sigma.max(LEAST_NOISE) / (SPOKE_SAMPLES as f32).sqrt();
        self.on_ridge = patch.ridge(self.base) > RIDGE_OF_PEAK * height + RIDGE_SIGMAS * ridge_noise;
    }

    /// Whether the shape is that of a star as far as the noise lets it be seen.
    pub fn is_star_like(&self) -> bool {
        // One σ of `unlike` for a star: √(2n)/snr² from the noise alone, 2/snr from noise times signal; two of them, and 0.5 for a
        // point spread function that is not quite the template.
        let snr = self.snr.max(1.0);
        !self.on_ridge && self.unlike < 0.5 + 2.0 * ((2.0 * CORE_N as f32).sqrt() / (snr * snr) + 2.0 / snr)
    }
}

/// A plane with one Gaussian star of a flux at a place, on 500 ADU.
#[cfg(test)]
pub(super) fn plane(flux: f32, x: f32, y: f32, shape: &Shape) -> super::plane::Plane {
    let inverse = shape.inverse();
    let peak = flux / (std::f32::consts::TAU * (shape.xx * shape.yy - shape.xy * shape.xy).sqrt());
    let pixels = (0..31 * 31).map(|n| 500.0 + peak * Shape::value(inverse, (n % 31) as f32 - x, (n / 31) as f32 - y)).collect();
    super::plane::Plane { width: 31, height: 31, pixels }
}

#[cfg(test)]
mod tests {
    use super::super::centroid::centroid;
    use super::super::plane::Plane;
    use super::*;

    #[test]
    fn the_fast_exponential_is_that_of_the_library() {
        for i in 0..8000 {
            let x = -0.01 * i as f32;
            assert!((exp_of_negative(x) / x.exp() - 1.0).abs() < 5e-6, "{x}");
        }
        assert!(exp_of_negative(f32::NEG_INFINITY) < 1e-30);
    }

    /// A standing with its ridge, for noise of 8 ADU.
    fn whole(patch: &Patch, template: &CoreTemplate) -> Standing {
        let mut standing = Standing::measure(patch, template, 8.0);
        standing.look_for_ridge(patch, 8.0);
        standing
    }

    #[test]
    fn a_ridge_is_not_like_a_star_in_any_direction_and_two_stars_are() {
        let template = CoreTemplate::new(&Shape::round(1.0));
        for step in 0..24 {
            let (sin, cos) = (step as f32 * std::f32::consts::PI / 24.0).sin_cos();
            let ridge = |n: usize| {
                let across = (n % 31) as f32 * sin - (n / 31) as f32 * cos - 15.0 * (sin - cos);
                500.0 + 200.0 * (-0.5 * across * across / 1.5).exp()
            };
            let picture = Plane { width: 31, height: 31, pixels: (0..31 * 31).map(ridge).collect() };
            let standing = whole(&Patch::cut(&picture, 15, 15).unwrap(), &template);
            assert!(standing.on_ridge, "{step}: {standing:?}");
            let mut pair = plane(2000.0, 15.0, 15.0, &Shape::round(1.0));
            let other = plane(2000.0, 15.0 + 6.0 * cos, 15.0 + 6.0 * sin, &Shape::round(1.0));
            pair.pixels.iter_mut().zip(&other.pixels).for_each(|(p, o)| *p += o - 500.0);
            let standing = whole(&Patch::cut(&pair, 15, 15).unwrap(), &template);
            assert!(!standing.on_ridge, "{step}: {standing:?}");
        }
    }

    #[test]
    fn a_star_on_a_steep_slope_is_where_and_as_bright_as_on_flat_sky() {
        let shape = Shape::round(1.1);
        let mut picture = plane(900.0, 15.3, 14.8, &shape);
        picture.pixels.iter_mut().enumerate().for_each(|(n, p)| *p += 20.0 * (n % 31) as f32 - 9.0 * (n / 31) as f32);
        let mut patch = Patch::cut(&picture, 15, 15).unwrap();
        patch.level_out(patch.surroundings().slope);
        let standing = whole(&patch, &CoreTemplate::new(&shape));
        assert!(standing.is_star_like() && standing.confidence > 0.9 * standing.snr, "{standing:?}");
        let found = centroid(&patch, &standing, &shape, 8.0, 0.0).unwrap();
        assert!(
            (found.x - 0.3).abs() < 0.02 && (found.y + 0.2).abs() < 0.02 && (found.flux / 900.0 - 1.0).abs() < 0.02,
            "{found:?}"
        );
    }

    #[test]
    fn eight_numbers_are_sorted() {
        let mut v = [3.0, -1.0, 7.0, 0.5, 2.0, 9.0, -4.0, 1.0];
        sort_eight(&mut v);
        assert_eq!(v, [-4.0, -1.0, 0.5, 1.0, 2.0, 3.0, 7.0, 9.0]);
    }

    #[test]
    fn a_hot_pixel_and_an_edge_are_not_like_a_star() {
        let template = CoreTemplate::new(&Shape::round(1.0));
        let star = Patch::cut(&plane(2000.0, 15.0, 15.0, &Shape::round(1.0)), 15, 15).unwrap();
        let star = whole(&star, &template);
        assert!(star.is_star_like() && star.snr > 50.0, "{star:?}");
        let mut hot = Plane { width: 31, height: 31, pixels: vec![500f32; 31 * 31] };
        hot.pixels[15 * 31 + 15] = 900.0;
        assert!(!whole(&Patch::cut(&hot, 15, 15).unwrap(), &template).is_star_like());
        let edge =
            Plane { width: 31, height: 31, pixels: (0..31 * 31).map(|n| if n % 31 < 15 { 500f32 } else { 540.0 }).collect() };
        let edge = Standing::measure(&Patch::cut(&edge, 16, 15).unwrap(), &template, 8.0);
        assert!(edge.confidence < 3.0, "{edge:?}");
    }
}
