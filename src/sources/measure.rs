//! Measuring a peak: how far it stands above its surroundings, whether it has the shape of a star, and where its centre is.

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

fn inside<P: Picture>(picture: &P, x: usize, y: usize) -> bool {
    x >= MARGIN && y >= MARGIN && x + MARGIN < picture.width() && y + MARGIN < picture.height()
}

/// Where the highest nine samples lie together, from one sample before a place to `finer` after it; `None` at the border.
#[inline(always)]
pub fn summit<P: Picture>(picture: &P, x: usize, y: usize, finer: usize) -> Option<(usize, usize)> {
    if !inside(picture, x, y) {
        return None;
    }
    let samples = picture.cut_lines(x, y, HALF - 2..HALF + finer + 2);
    let mut best = (f32::MIN, x, y);
    for j in HALF - 1..=HALF + finer {
        for i in HALF - 1..=HALF + finer {
            let sum: f32 = samples[j - 1..=j + 1].iter().map(|row| row[i - 1] + row[i] + row[i + 1]).sum();
            if sum > best.0 {
                best = (sum, x + i - HALF, y + j - HALF);
            }
        }
    }
    Some((best.1, best.2))
}

/// The surroundings of a peak.
#[derive(Debug, Clone)]
pub struct Patch {
    samples: Samples,
}

impl Patch {
    /// Cuts the patch around a sample; `None` where it would reach over the border.
    #[inline(always)]
    pub fn cut<P: Picture>(picture: &P, x: usize, y: usize) -> Option<Self> {
        inside(picture, x, y).then(|| Self { samples: picture.cut(x, y) })
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

    /// Takes off the slope of the surroundings, so that what is left is even on all sides of the peak.
    ///
    /// Along each axis it is the middle one of three, from the boxes on either side: a star in one box does not tilt the rest.
    #[inline(always)]
    pub fn level_out(&mut self) {
        let m = self.box_means();
        let across = (2 * BOX) as f32;
        let (gx, gy) = (
            middle_of_three(m[2] - m[0], m[5] - m[3], m[8] - m[6]) / across,
            middle_of_three(m[6] - m[0], m[7] - m[1], m[8] - m[2]) / across,
        );
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
    fn inverse(&self) -> (f32, f32, f32) {
        let (xx, yy) = (self.xx.max(0.05), self.yy.max(0.05));
        let limit = 0.95 * (xx * yy).sqrt();
        let xy = self.xy.clamp(-limit, limit);
        let det = xx * yy - xy * xy;
        (yy / det, xx / det, -xy / det)
    }

    /// Value at an offset from the centre, 1 at the centre.
    #[inline(always)]
    fn value(inverse: (f32, f32, f32), dx: f32, dy: f32) -> f32 {
        exp_of_negative(-0.5 * (inverse.0 * dx * dx + inverse.1 * dy * dy) - inverse.2 * dx * dy)
    }
}

/// e^x for x ≤ 0 to 2·10⁻⁶ of its value: 2^n by the exponent's bits, 2^f by a polynomial, so that loops over it vectorise.
#[inline(always)]
fn exp_of_negative(x: f32) -> f32 {
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
    weights: [f32; CORE_N],
    sum_sq: f32,
}

impl CoreTemplate {
    /// The template of a shape.
    pub fn new(shape: &Shape) -> Self {
        let inverse = shape.inverse();
        let mut weights = [0f32; CORE_N];
        for (n, w) in weights.iter_mut().enumerate() {
            let (i, j) = (n % CORE_SIDE, n / CORE_SIDE);
            *w = Shape::value(inverse, i as f32 - CORE as f32, j as f32 - CORE as f32);
        }
        let total: f32 = weights.iter().sum();
        weights.iter_mut().for_each(|w| *w /= total);
        Self { weights, sum_sq: weights.iter().map(|w| w * w).sum() }
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

impl Standing {
    /// Measures a patch, levelled out, whose samples have the noise `sigma`, ADU.
    #[inline(always)]
    pub fn measure(patch: &Patch, template: &CoreTemplate, sigma: f32) -> Self {
        let nine = patch.box_means();
        let mut means = [nine[0], nine[1], nine[2], nine[3], nine[5], nine[6], nine[7], nine[8]];
        sort_eight(&mut means);
        let base = 0.25 * (means[2] + means[3] + means[4] + means[5]);
        let brightest = 0.5 * (means[6] + means[7]);
        let sigma = sigma.max(1e-3);
        let (mut filtered, mut power) = (0f32, 0f32);
        for (row, weights) in patch.samples[HALF - CORE..=HALF + CORE].iter().zip(template.weights.chunks_exact(CORE_SIDE)) {
            for i in 0..CORE_SIDE {
                let d = row[HALF - CORE + i] - base;
                filtered += d * weights[i];
                power += d * d;
            }
        }
        let flux = filtered / template.sum_sq;
        // A constant step of the base changes the filtered sum by as much, because the weights sum to 1.
        let noise = sigma * template.sum_sq.sqrt();
        let explained = filtered * filtered / template.sum_sq;
        let unlike = (power - CORE_N as f32 * sigma * sigma - explained) / explained.max(1e-6);
        // Height of the peak as a mean over three by three, so that a lone pixel does not decide.
        let height =
            (HALF - 1..=HALF + 1).map(|j| patch.samples[j][HALF - 1..=HALF + 1].iter().sum::<f32>()).sum::<f32>() / 9.0 - base;
        let ridge_noise = sigma / (SPOKE_SAMPLES as f32).sqrt();
        let on_ridge = patch.ridge(base) > RIDGE_OF_PEAK * height + RIDGE_SIGMAS * ridge_noise;
        Self { base, flux, snr: filtered / noise, confidence: (filtered - (brightest - base).max(0.0)) / noise, unlike, on_ridge }
    }

    /// Whether the shape is that of a star as far as the noise lets it be seen.
    pub fn is_star_like(&self) -> bool {
        // One σ of `unlike` for a star: √(2n)/snr² from the noise alone, 2/snr from noise times signal; two of them, and 0.5 for a
        // point spread function that is not quite the template.
        let snr = self.snr.max(1.0);
        !self.on_ridge && self.unlike < 0.5 + 2.0 * ((2.0 * CORE_N as f32).sqrt() / (snr * snr) + 2.0 / snr)
    }
}

/// A Gaussian of a given shape about a centre, over a patch row by row; nought beyond `reach` of the middle.
struct Weights {
    inverse: (f32, f32, f32),
    centre: (f32, f32),
    dx: [f32; WIDTH],
    /// 1 inside, 0 outside.
    inside: [f32; WIDTH],
    /// The Gaussian along x alone, where the shape is upright: then a row is a multiple of it.
    along: Option<[f32; WIDTH]>,
}

/// A shape whose axes correlate by less than this is taken as upright: its centre is found as well, to a part in a thousand.
const UPRIGHT: f32 = 0.05;

impl Weights {
    #[inline(always)]
    fn new(shape: &Shape, centre: (f32, f32), reach: usize) -> Self {
        let inverse = shape.inverse();
        let (mut dx, mut inside) = ([0f32; WIDTH], [0f32; WIDTH]);
        for i in 0..WIDTH {
            dx[i] = i as f32 - HALF as f32 - centre.0;
            inside[i] = if i + reach >= HALF && i <= HALF + reach { 1.0 } else { 0.0 };
        }
        let upright = inverse.2.abs() < UPRIGHT * (inverse.0 * inverse.1).sqrt();
        let along = upright.then(|| {
            let mut along = [0f32; WIDTH];
            for i in 0..WIDTH {
                along[i] = inside[i] * exp_of_negative(-0.5 * inverse.0 * dx[i] * dx[i]);
            }
            along
        });
        Self { inverse, centre, dx, inside, along }
    }

    /// The offset of row `j` from the centre, and the Gaussian along it.
    #[inline(always)]
    fn row(&self, j: usize) -> (f32, [f32; WIDTH]) {
        let dy = j as f32 - HALF as f32 - self.centre.1;
        let mut values = [0f32; WIDTH];
        match &self.along {
            Some(along) => {
                let across = exp_of_negative(-0.5 * self.inverse.1 * dy * dy);
                for i in 0..WIDTH {
                    values[i] = along[i] * across;
                }
            }
            None => {
                for i in 0..WIDTH {
                    values[i] = self.inside[i] * Shape::value(self.inverse, self.dx[i], dy);
                }
            }
        }
        (dy, values)
    }
}

/// Second moments of a bright peak by iterated matching of a Gaussian weight (Bernstein and Jarvis 2002, AJ 123, 583, §3.1).
///
/// `None` where they do not settle on something that a star could be.
#[inline(always)]
pub fn moments(patch: &Patch, base: f32, start: Shape) -> Option<Shape> {
    const STEPS: usize = 12;
    const REACH: usize = 6;
    /// A change this small, of the shape's own size, ends it.
    const SETTLED: f32 = 0.003;
    let (mut centre, mut shape) = ((0f32, 0f32), start);
    for _ in 0..STEPS {
        let weights = Weights::new(&shape, centre, REACH);
        let mut sums = [[0f32; WIDTH]; 6];
        for j in HALF - REACH..=HALF + REACH {
            let (dy, values) = weights.row(j);
            for i in 0..WIDTH {
                let dx = weights.dx[i];
                let w = values[i] * (patch.samples[j][i] - base);
                sums[0][i] += w;
                sums[1][i] += w * dx;
                sums[2][i] += w * dy;
                sums[3][i] += w * dx * dx;
                sums[4][i] += w * dy * dy;
                sums[5][i] += w * dx * dy;
            }
        }
        let [s, sx, sy, sxx, syy, sxy] = sums.map(|lanes| total(&lanes));
        if s <= 0.0 {
            return None;
        }
        centre = (centre.0 + 2.0 * sx / s, centre.1 + 2.0 * sy / s);
        // Moments about the weighted mean, and twice: a Gaussian under its own weight has half its width.
        let (mx, my) = (sx / s, sy / s);
        let before = shape;
        shape = Shape { xx: 2.0 * (sxx / s - mx * mx), yy: 2.0 * (syy / s - my * my), xy: 2.0 * (sxy / s - mx * my) };
        let reasonable = shape.xx > 0.1 && shape.yy > 0.1 && shape.xx < 30.0 && shape.yy < 30.0;
        if !reasonable || centre.0.abs() > 2.5 || centre.1.abs() > 2.5 {
            return None;
        }
        let change = (shape.xx - before.xx).abs() + (shape.yy - before.yy).abs() + (shape.xy - before.xy).abs();
        if change < SETTLED * (shape.xx + shape.yy) {
            break;
        }
    }
    Some(shape)
}

/// The sum over the lanes, always in the same order.
#[inline(always)]
fn total(lanes: &[f32; WIDTH]) -> f32 {
    let mut eight = [0f32; WIDTH / 2];
    for k in 0..WIDTH / 2 {
        eight[k] = lanes[k] + lanes[k + WIDTH / 2];
    }
    ((eight[0] + eight[4]) + (eight[1] + eight[5])) + ((eight[2] + eight[6]) + (eight[3] + eight[7]))
}

/// A star's model at one step of a fit.
struct StarModel<'a> {
    shape: &'a Shape,
    height: f32,
    base: f32,
    centre: (f32, f32),
}

/// The ten different products of the slopes of (height, base, x, y); then the four products with the residual.
const PRODUCTS: usize = 10;
const SLOPES: usize = 4;

impl StarModel<'_> {
    /// Sums of the normal equations over the samples within `reach` of the middle, weighted by the noise of sky and star: products of
    /// the slopes (only where `matrix` is wanted), and slopes times residual.
    #[inline(always)]
    fn normal_equations(
        &self,
        patch: &Patch,
        reach: usize,
        sigma: f32,
        gain: f32,
        matrix: bool,
    ) -> ([f32; PRODUCTS], [f32; SLOPES]) {
        let weights = Weights::new(self.shape, self.centre, reach);
        let inverse = weights.inverse;
        let mut products = [[0f32; WIDTH]; PRODUCTS];
        let mut right = [[0f32; WIDTH]; SLOPES];
        for j in HALF - reach..=HALF + reach {
            let (dy, values) = weights.row(j);
            for i in 0..WIDTH {
                let (dx, p) = (weights.dx[i], values[i]);
                let model = self.height * p;
                let w = weights.inside[i] / (sigma * sigma + gain * model);
                let sx = model * (inverse.0 * dx + inverse.2 * dy);
                let sy = model * (inverse.1 * dy + inverse.2 * dx);
                let residual = patch.samples[j][i] - self.base - model;
                let (wp, wx, wy) = (w * p, w * sx, w * sy);
                if matrix {
                    let terms = [wp * p, wp, wp * sx, wp * sy, w, wx, wy, wx * sx, wx * sy, wy * sy];
                    for n in 0..PRODUCTS {
                        products[n][i] += terms[n];
                    }
                }
                let terms = [wp * residual, w * residual, wx * residual, wy * residual];
                for n in 0..SLOPES {
                    right[n][i] += terms[n];
                }
            }
        }
        (products.map(|lanes| total(&lanes)), right.map(|lanes| total(&lanes)))
    }
}

/// The inverse of the normal matrix.
#[inline(always)]
fn inverse_of(products: &[f32; PRODUCTS]) -> Option<nalgebra::Matrix4<f64>> {
    let t = products.map(f64::from);
    let matrix = nalgebra::Matrix4::new(
        t[0], t[1], t[2], t[3], //
        t[1], t[4], t[5], t[6], //
        t[2], t[5], t[7], t[8], //
        t[3], t[6], t[8], t[9],
    );
    Some(matrix.cholesky()?.inverse())
}

/// A fitted centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Centroid {
    /// Offset from the patch's middle, samples.
    pub x: f32,
    /// Offset from the patch's middle, samples.
    pub y: f32,
    /// One σ, mean of the axes, samples.
    pub sigma: f32,
    /// Flux, ADU.
    pub flux: f32,
    /// Surroundings, ADU.
    pub base: f32,
}

/// Least-squares fit of height, surroundings and centre of a star of known shape, weighted by the noise of sky and star.
///
/// With the right shape this reaches the Cramér-Rao bound (its σ is that of the normal equations). `sigma`: noise of the sky, ADU;
/// `gain`: ADU/e⁻ of a sample, for the star's own photons. `None` where the fit leaves the peak.
#[inline(always)]
pub fn centroid(patch: &Patch, standing: &Standing, shape: &Shape, sigma: f32, gain: f32) -> Option<Centroid> {
    const STEPS: usize = 8;
    /// Steps that measure the matrix anew; then the start is so near that the last one does.
    const FULL_STEPS: usize = 2;
    /// A step this small against the centre's σ ends the fit.
    const SETTLED: f32 = 0.02;
    let reach = ((3.0 * shape.axes().0).ceil() as usize + 1).clamp(3, HALF);
    let peak_of_flux = {
        let det = shape.xx * shape.yy - shape.xy * shape.xy;
        1.0 / (std::f32::consts::TAU * det.max(1e-3).sqrt())
    };
    let (mut height, mut base) = (standing.flux * peak_of_flux, standing.base);
    let (mut cx, mut cy) = (0f32, 0f32);
    let mut sigma_xy = f32::NAN;
    let mut inverse = nalgebra::Matrix4::identity();
    for number in 0..STEPS {
        let model = StarModel { shape, height, base, centre: (cx, cy) };
        let full = number < FULL_STEPS;
        let (products, right) = model.normal_equations(patch, reach, sigma, gain, full);
        if full {
            inverse = inverse_of(&products)?;
            sigma_xy = (0.5 * (inverse[(2, 2)] + inverse[(3, 3)])).sqrt() as f32;
        }
        let step = inverse * nalgebra::Vector4::from(right.map(f64::from));
        height += step[0] as f32;
        base += step[1] as f32;
        // No step further than a sample: far off, the linear step overshoots.
        let (step_x, step_y) = ((step[2] as f32).clamp(-1.0, 1.0), (step[3] as f32).clamp(-1.0, 1.0));
        cx += step_x;
        cy += step_y;
        if !(height > 0.0 && cx.abs() < 3.0 && cy.abs() < 3.0) {
            return None;
        }
        if step_x.abs() < SETTLED * sigma_xy && step_y.abs() < SETTLED * sigma_xy {
            break;
        }
    }
    sigma_xy.is_finite().then(|| Centroid { x: cx, y: cy, sigma: sigma_xy, flux: height / peak_of_flux, base })
}

#[cfg(test)]
mod tests {
    use super::super::plane::Plane;
    use super::*;
    use rand::{Rng, SeedableRng};

    /// A plane with one Gaussian star of a flux at a place, on 500 ADU.
    fn plane(flux: f32, x: f32, y: f32, shape: &Shape) -> Plane {
        let inverse = shape.inverse();
        let peak = flux / (std::f32::consts::TAU * (shape.xx * shape.yy - shape.xy * shape.xy).sqrt());
        let pixels =
            (0..31 * 31).map(|n| 500.0 + peak * Shape::value(inverse, (n % 31) as f32 - x, (n / 31) as f32 - y)).collect();
        Plane { width: 31, height: 31, pixels }
    }

    #[test]
    fn the_fast_exponential_is_that_of_the_library() {
        for i in 0..8000 {
            let x = -0.01 * i as f32;
            assert!((exp_of_negative(x) / x.exp() - 1.0).abs() < 5e-6, "{x}");
        }
        assert!(exp_of_negative(f32::NEG_INFINITY) < 1e-30);
    }

    #[test]
    fn a_centre_has_no_bias_at_any_phase_of_the_pixel() {
        for shape in [Shape::round(0.9), Shape { xx: 2.0, yy: 1.2, xy: 0.6 }] {
            for phase in 0..10 {
                let (x, y) = (15.0 + 0.1 * phase as f32 - 0.5, 15.0 - 0.07 * phase as f32);
                let patch = Patch::cut(&plane(2000.0, x, y, &shape), 15, 15).unwrap();
                let standing = Standing::measure(&patch, &CoreTemplate::new(&shape), 8.0);
                let found = centroid(&patch, &standing, &shape, 8.0, 0.04).unwrap();
                assert!((found.x - (x - 15.0)).abs() < 2e-3 && (found.y - (y - 15.0)).abs() < 2e-3, "{found:?}");
                assert!((found.flux / 2000.0 - 1.0).abs() < 1e-2);
            }
        }
    }

    #[test]
    fn the_sigma_of_a_centre_is_that_of_repeated_trials() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let shape = Shape::round(1.0);
        let clean = plane(600.0, 15.2, 14.9, &shape);
        const TRIALS: usize = 800;
        let (mut square, mut claimed) = (0.0, 0.0);
        for _ in 0..TRIALS {
            let mut noisy = clean.clone();
            for p in &mut noisy.pixels {
                *p += 8.0 * ((0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0);
            }
            let patch = Patch::cut(&noisy, 15, 15).unwrap();
            let standing = Standing::measure(&patch, &CoreTemplate::new(&shape), 8.0);
            let found = centroid(&patch, &standing, &shape, 8.0, 0.0).unwrap();
            square += ((found.x - 0.2).powi(2) + (found.y + 0.1).powi(2)) / (2 * TRIALS) as f32;
            claimed += found.sigma.powi(2) / TRIALS as f32;
        }
        assert!((square / claimed - 1.0).abs() < 0.2, "{square} against {claimed}");
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
            let standing = Standing::measure(&Patch::cut(&picture, 15, 15).unwrap(), &template, 8.0);
            assert!(standing.on_ridge, "{step}: {standing:?}");
            let mut pair = plane(2000.0, 15.0, 15.0, &Shape::round(1.0));
            let other = plane(2000.0, 15.0 + 6.0 * cos, 15.0 + 6.0 * sin, &Shape::round(1.0));
            pair.pixels.iter_mut().zip(&other.pixels).for_each(|(p, o)| *p += o - 500.0);
            let standing = Standing::measure(&Patch::cut(&pair, 15, 15).unwrap(), &template, 8.0);
            assert!(!standing.on_ridge, "{step}: {standing:?}");
        }
    }

    #[test]
    fn a_star_on_a_steep_slope_is_where_and_as_bright_as_on_flat_sky() {
        let shape = Shape::round(1.1);
        let mut picture = plane(900.0, 15.3, 14.8, &shape);
        picture.pixels.iter_mut().enumerate().for_each(|(n, p)| *p += 20.0 * (n % 31) as f32 - 9.0 * (n / 31) as f32);
        let mut patch = Patch::cut(&picture, 15, 15).unwrap();
        patch.level_out();
        let standing = Standing::measure(&patch, &CoreTemplate::new(&shape), 8.0);
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
        let star = Standing::measure(&star, &template, 8.0);
        assert!(star.is_star_like() && star.snr > 50.0, "{star:?}");
        let mut hot = Plane { width: 31, height: 31, pixels: vec![500f32; 31 * 31] };
        hot.pixels[15 * 31 + 15] = 900.0;
        assert!(!Standing::measure(&Patch::cut(&hot, 15, 15).unwrap(), &template, 8.0).is_star_like());
        let edge =
            Plane { width: 31, height: 31, pixels: (0..31 * 31).map(|n| if n % 31 < 15 { 500f32 } else { 540.0 }).collect() };
        let edge = Standing::measure(&Patch::cut(&edge, 16, 15).unwrap(), &template, 8.0);
        assert!(edge.confidence < 3.0, "{edge:?}");
    }
}
