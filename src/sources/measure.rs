//! Measuring a peak: how far it stands above its surroundings, whether it has the shape of a star, and where its centre is.

#![allow(clippy::needless_range_loop, reason = "the loop runs over places that several lists share")]
#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a patch has a fixed size and its place is checked when it is cut")]

use super::plane::{Plane, Sample};

/// Half the side of a patch, and its side, samples: three boxes of five by three boxes of five.
pub const HALF: usize = 7;
const SIDE: usize = 2 * HALF + 1;
/// Side of one of the nine boxes.
const BOX: usize = 5;
/// Half the side of the core that a point spread function is compared with.
const CORE: usize = 3;
const CORE_N: usize = (2 * CORE + 1) * (2 * CORE + 1);

/// The surroundings of a peak.
#[derive(Debug, Clone)]
pub struct Patch {
    samples: [[f32; SIDE]; SIDE],
}

impl Patch {
    /// Cuts the patch around a sample; `None` where it would reach over the border.
    pub fn cut<T: Sample>(plane: &Plane<T>, x: usize, y: usize) -> Option<Self> {
        if x < HALF || y < HALF || x + HALF >= plane.width || y + HALF >= plane.height {
            return None;
        }
        let mut samples = [[0f32; SIDE]; SIDE];
        for (j, row) in samples.iter_mut().enumerate() {
            for (out, sample) in row.iter_mut().zip(&plane.row(y + j - HALF)[x - HALF..=x + HALF]) {
                *out = sample.value();
            }
        }
        Some(Self { samples })
    }

    /// Puts back the true height of a star's core from the unclipped picture, and leaves out what is a lone hot sample.
    ///
    /// A star's four nearest neighbours stand above its four corners nearly half as much as it stands above them; a hot
    /// sample's do not.
    pub fn restore_core(&mut self, pixels: &[u16], width: usize, x: usize, y: usize) {
        const STAR_STEEPNESS: f32 = 3.0;
        for j in HALF - CORE..=HALF + CORE {
            for i in HALF - CORE..=HALF + CORE {
                let raw = f32::from(pixels[(y + j - HALF) * width + x + i - HALF]);
                if raw > self.samples[j][i] {
                    let s = &self.samples;
                    let sides = 0.25 * (s[j - 1][i] + s[j + 1][i] + s[j][i - 1] + s[j][i + 1]);
                    let corners = 0.25 * (s[j - 1][i - 1] + s[j - 1][i + 1] + s[j + 1][i - 1] + s[j + 1][i + 1]);
                    if raw - sides < STAR_STEEPNESS * (sides - corners) {
                        self.samples[j][i] = raw;
                    }
                }
            }
        }
    }

    /// Mean of each of the eight boxes around the middle one, sorted, lowest first.
    fn box_means(&self) -> [f32; 8] {
        let mut means = [0f32; 8];
        let mut n = 0;
        for box_y in 0..3 {
            for box_x in 0..3 {
                if (box_x, box_y) == (1, 1) {
                    continue;
                }
                let mut sum = 0f32;
                for row in &self.samples[box_y * BOX..box_y * BOX + BOX] {
                    sum += row[box_x * BOX..box_x * BOX + BOX].iter().sum::<f32>();
                }
                means[n] = sum / (BOX * BOX) as f32;
                n += 1;
            }
        }
        means.sort_unstable_by(f32::total_cmp);
        means
    }

    /// The highest sample of the core.
    pub fn highest(&self) -> f32 {
        self.core().fold(f32::MIN, f32::max)
    }

    fn core(&self) -> impl Iterator<Item = f32> + '_ {
        self.samples[HALF - CORE..=HALF + CORE].iter().flat_map(|row| row[HALF - CORE..=HALF + CORE].iter().copied())
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
    let t = x.clamp(LOWEST, 0.0) * std::f32::consts::LOG2_E;
    let n = (t - 0.5) as i32;
    let f = t - n as f32;
    // Taylor series of 2^f, |f| ≤ ½ and a little.
    let p = 1.0
        + f * (std::f32::consts::LN_2
            + f * (0.240_226_5 + f * (0.055_504_11 + f * (0.009_618_13 + f * (0.001_333_36 + f * 0.000_154_04)))));
    p * f32::from_bits(((n + 127) as u32) << 23)
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
            let (i, j) = (n % (2 * CORE + 1), n / (2 * CORE + 1));
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
}

impl Standing {
    /// Measures a patch whose samples have the noise `sigma`, ADU.
    pub fn measure(patch: &Patch, template: &CoreTemplate, sigma: f32) -> Self {
        let means = patch.box_means();
        let base = 0.25 * (means[2] + means[3] + means[4] + means[5]);
        let brightest = 0.5 * (means[6] + means[7]);
        let sigma = sigma.max(1e-3);
        let (mut filtered, mut power) = (0f32, 0f32);
        for (sample, weight) in patch.core().zip(&template.weights) {
            let d = sample - base;
            filtered += d * weight;
            power += d * d;
        }
        let flux = filtered / template.sum_sq;
        // A constant step of the base changes the filtered sum by as much, because the weights sum to 1.
        let noise = sigma * template.sum_sq.sqrt();
        let explained = filtered * filtered / template.sum_sq;
        let unlike = (power - CORE_N as f32 * sigma * sigma - explained) / explained.max(1e-6);
        Self { base, flux, snr: filtered / noise, confidence: (filtered - (brightest - base).max(0.0)) / noise, unlike }
    }

    /// Whether the shape is that of a star as far as the noise lets it be seen.
    pub fn is_star_like(&self) -> bool {
        // One σ of `unlike` for a star: √(2n)/snr² from the noise alone, 2/snr from noise times signal; two of them, and 0.5 for a
        // point spread function that is not quite the template.
        let snr = self.snr.max(1.0);
        self.unlike < 0.5 + 2.0 * ((2.0 * CORE_N as f32).sqrt() / (snr * snr) + 2.0 / snr)
    }
}

/// Second moments of a bright peak by iterated matching of a Gaussian weight (Bernstein and Jarvis 2002, AJ 123, 583, §3.1).
///
/// `None` where they do not settle on something that a star could be.
pub fn moments(patch: &Patch, base: f32, start: Shape) -> Option<Shape> {
    const STEPS: usize = 12;
    const REACH: usize = 6;
    let (mut cx, mut cy, mut shape) = (0f32, 0f32, start);
    for _ in 0..STEPS {
        let inverse = shape.inverse();
        let (mut s, mut sx, mut sy, mut sxx, mut syy, mut sxy) = (0f32, 0f32, 0f32, 0f32, 0f32, 0f32);
        for j in HALF - REACH..=HALF + REACH {
            for i in HALF - REACH..=HALF + REACH {
                let (dx, dy) = (i as f32 - HALF as f32 - cx, j as f32 - HALF as f32 - cy);
                let w = Shape::value(inverse, dx, dy) * (patch.samples[j][i] - base);
                s += w;
                sx += w * dx;
                sy += w * dy;
                sxx += w * dx * dx;
                syy += w * dy * dy;
                sxy += w * dx * dy;
            }
        }
        if s <= 0.0 {
            return None;
        }
        cx += 2.0 * sx / s;
        cy += 2.0 * sy / s;
        // Moments about the weighted mean, and twice: a Gaussian under its own weight has half its width.
        let (mx, my) = (sx / s, sy / s);
        shape = Shape { xx: 2.0 * (sxx / s - mx * mx), yy: 2.0 * (syy / s - my * my), xy: 2.0 * (sxy / s - mx * my) };
        let reasonable = shape.xx > 0.1 && shape.yy > 0.1 && shape.xx < 30.0 && shape.yy < 30.0;
        if !reasonable || cx.abs() > 2.5 || cy.abs() > 2.5 {
            return None;
        }
    }
    Some(shape)
}

/// A star's model at one step of a fit.
struct StarModel {
    inverse: (f32, f32, f32),
    height: f32,
    base: f32,
    centre: (f32, f32),
}

/// A shape whose axes correlate by less than this is taken as upright: its centre is found as well, to a part in a thousand.
const UPRIGHT: f32 = 0.05;
/// The ten different products of the slopes of (height, base, x, y), then the four products with the residual.
const TERMS: usize = 14;

impl StarModel {
    /// Sums of the normal equations over the samples within `reach` of the middle, weighted by the noise of sky and star.
    fn normal_equations(&self, patch: &Patch, reach: usize, sigma: f32, gain: f32) -> [f32; TERMS] {
        let mut sums = [0f32; TERMS];
        // The Gaussian along each axis once; what turns it is left for each sample, and is little.
        let offset = |i: usize, centre: f32| i as f32 - HALF as f32 - centre;
        let (mut along, mut across) = ([0f32; SIDE], [0f32; SIDE]);
        for i in HALF - reach..=HALF + reach {
            along[i] = exp_of_negative(-0.5 * self.inverse.0 * offset(i, self.centre.0).powi(2));
            across[i] = exp_of_negative(-0.5 * self.inverse.1 * offset(i, self.centre.1).powi(2));
        }
        let upright = self.inverse.2.abs() < UPRIGHT * (self.inverse.0 * self.inverse.1).sqrt();
        for j in HALF - reach..=HALF + reach {
            let dy = offset(j, self.centre.1);
            for i in HALF - reach..=HALF + reach {
                let dx = offset(i, self.centre.0);
                let p = if upright { along[i] * across[j] } else { Shape::value(self.inverse, dx, dy) };
                let model = self.height * p;
                let w = 1.0 / (sigma * sigma + gain * model.max(0.0));
                let sx = model * (self.inverse.0 * dx + self.inverse.2 * dy);
                let sy = model * (self.inverse.1 * dy + self.inverse.2 * dx);
                let residual = patch.samples[j][i] - self.base - model;
                let (wp, wx, wy) = (w * p, w * sx, w * sy);
                let terms = [
                    wp * p,
                    wp,
                    wp * sx,
                    wp * sy,
                    w,
                    wx,
                    wy,
                    wx * sx,
                    wx * sy,
                    wy * sy,
                    wp * residual,
                    w * residual,
                    wx * residual,
                    wy * residual,
                ];
                for (sum, term) in sums.iter_mut().zip(terms) {
                    *sum += term;
                }
            }
        }
        sums
    }
}

/// The normal matrix and its right side.
fn unpack(t: &[f32; TERMS]) -> (nalgebra::Matrix4<f64>, nalgebra::Vector4<f64>) {
    let t = t.map(f64::from);
    (
        nalgebra::Matrix4::new(
            t[0], t[1], t[2], t[3], //
            t[1], t[4], t[5], t[6], //
            t[2], t[5], t[7], t[8], //
            t[3], t[6], t[8], t[9],
        ),
        nalgebra::Vector4::new(t[10], t[11], t[12], t[13]),
    )
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
pub fn centroid(patch: &Patch, standing: &Standing, shape: &Shape, sigma: f32, gain: f32) -> Option<Centroid> {
    const STEPS: usize = 6;
    /// A step this small against the centre's σ ends the fit.
    const SETTLED: f32 = 0.02;
    let reach = ((3.0 * shape.axes().0).ceil() as usize + 1).clamp(3, HALF);
    let inverse = shape.inverse();
    let peak_of_flux = {
        let det = shape.xx * shape.yy - shape.xy * shape.xy;
        1.0 / (std::f32::consts::TAU * det.max(1e-3).sqrt())
    };
    let (mut height, mut base) = (standing.flux * peak_of_flux, standing.base);
    let (mut cx, mut cy) = (0f32, 0f32);
    let mut sigma_xy = f32::NAN;
    for _ in 0..STEPS {
        let model = StarModel { inverse, height, base, centre: (cx, cy) };
        let terms = model.normal_equations(patch, reach, sigma, gain);
        let (matrix, right) = unpack(&terms);
        let inverse_matrix = matrix.cholesky()?.inverse();
        let step = inverse_matrix * right;
        height += step[0] as f32;
        base += step[1] as f32;
        // No step further than a sample: far off, the linear step overshoots.
        let (step_x, step_y) = ((step[2] as f32).clamp(-1.0, 1.0), (step[3] as f32).clamp(-1.0, 1.0));
        cx += step_x;
        cy += step_y;
        sigma_xy = (0.5 * (inverse_matrix[(2, 2)] + inverse_matrix[(3, 3)])).sqrt() as f32;
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
    use super::*;
    use rand::{Rng, SeedableRng};

    /// A plane with one Gaussian star of a flux at a place, on 500 ADU.
    fn plane(flux: f32, x: f32, y: f32, shape: &Shape) -> Plane<f32> {
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
