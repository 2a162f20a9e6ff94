//! Where the centre of a star is, and what shape it has: fits of a Gaussian to the patch around a peak.

#![allow(clippy::needless_range_loop, reason = "the loop runs over places that several lists share")]
#![allow(clippy::indexing_slicing, reason = "a numeric kernel: a patch has a fixed size and its place is checked when it is cut")]

use super::measure::{HALF, Patch, Shape, Standing, WIDTH, exp_of_negative};

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

/// The ten different products of the slopes of (height, base, x, y); then the four products with the residual, and its square.
const PRODUCTS: usize = 10;
const SLOPES: usize = 4;
const RESIDUALS: usize = SLOPES + 1;

impl StarModel<'_> {
    /// Sums of the normal equations over the samples within `reach` of the middle, weighted by the noise of sky and star: products of
    /// the slopes (only where `matrix` is wanted), and slopes times residual, then the residual's square.
    #[inline(always)]
    fn normal_equations(
        &self,
        patch: &Patch,
        reach: usize,
        sigma: f32,
        gain: f32,
        matrix: bool,
    ) -> ([f32; PRODUCTS], [f32; RESIDUALS]) {
        let weights = Weights::new(self.shape, self.centre, reach);
        let inverse = weights.inverse;
        let mut products = [[0f32; WIDTH]; PRODUCTS];
        let mut right = [[0f32; WIDTH]; RESIDUALS];
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
                let terms = [wp * residual, w * residual, wx * residual, wy * residual, w * residual * residual];
                for n in 0..RESIDUALS {
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
    /// A step this small against the centre's σ ends the fit: what is left is a tenth of it.
    const SETTLED: f32 = 0.1;
    /// What the variance of a faint star's centre is larger by than the normal equations say, over its noise in height squared. There are
    /// more faint stars than bright ones, and the fit ends where noise has made one highest: found at a height, a star is fainter than
    /// that (from trials with numbers that go as 1/flux, see the test).
    const FAINTER: f32 = 6.0;
    let reach = ((3.0 * shape.axes().0).ceil() as usize + 1).clamp(3, HALF);
    let peak_of_flux = {
        let det = shape.xx * shape.yy - shape.xy * shape.xy;
        1.0 / (std::f32::consts::TAU * det.max(1e-3).sqrt())
    };
    let (mut height, mut base) = (standing.flux * peak_of_flux, standing.base);
    let (mut cx, mut cy) = (0f32, 0f32);
    let mut sigma_xy = f32::NAN;
    let (mut height_sigma, mut chi2) = (f32::NAN, 0f32);
    let mut inverse = nalgebra::Matrix4::identity();
    for number in 0..STEPS {
        let model = StarModel { shape, height, base, centre: (cx, cy) };
        let full = number < FULL_STEPS;
        let (products, right) = model.normal_equations(patch, reach, sigma, gain, full);
        if full {
            inverse = inverse_of(&products)?;
            sigma_xy = (0.5 * (inverse[(2, 2)] + inverse[(3, 3)])).sqrt() as f32;
            height_sigma = inverse[(0, 0)].sqrt() as f32;
        }
        let [of_height, of_base, of_x, of_y, square] = right;
        chi2 = square;
        let step = inverse * nalgebra::Vector4::from([of_height, of_base, of_x, of_y].map(f64::from));
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
    let dof = ((2 * reach + 1) * (2 * reach + 1) - SLOPES) as f32;
    // A star that is not quite of the shape, or has something beside it, is as much less well known as it fits worse than chance has it.
    let misfit = ((chi2 - (2.0 * dof).sqrt()) / dof).max(1.0);
    let sigma = sigma_xy * (misfit * (1.0 + FAINTER * (height_sigma / height).powi(2))).sqrt();
    sigma.is_finite().then(|| Centroid { x: cx, y: cy, sigma, flux: height / peak_of_flux, base })
}

#[cfg(test)]
mod tests {
    use super::super::measure::{CoreTemplate, plane};
    use super::*;
    use rand::{Rng, SeedableRng};

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
    fn pixels_that_sum_what_falls_on_them_do_not_move_a_centre() {
        // The sharpest stars that are rendered. A pixel widens them by a twelfth.
        const SIGMA: f32 = 0.85;
        let shape = Shape::round((SIGMA * SIGMA + 1.0 / 12.0).sqrt());
        let error = |phase: f32| {
            let cdf = |edge: f32| 0.5 * libm::erfcf(-edge / (SIGMA * std::f32::consts::SQRT_2));
            let share = |i: usize, centre: f32| cdf(i as f32 + 0.5 - centre) - cdf(i as f32 - 0.5 - centre);
            let light = |n: usize| 500.0 + 5000.0 * share(n % 31, 15.0 + phase) * share(n / 31, 15.0);
            let picture = super::super::plane::Plane { width: 31, height: 31, pixels: (0..31 * 31).map(light).collect() };
            let patch = Patch::cut(&picture, 15, 15).unwrap();
            let standing = Standing::measure(&patch, &CoreTemplate::new(&shape), 8.0);
            centroid(&patch, &standing, &shape, 8.0, 0.04).unwrap().x - phase
        };
        for tenths in -5..=5 {
            let phase = 0.1 * tenths as f32;
            assert!(error(phase).abs() < 3e-3, "{phase}: {}", error(phase));
        }
    }

    #[test]
    fn a_hot_pixel_in_a_star_makes_its_sigma_as_much_larger() {
        let shape = Shape::round(1.0);
        let mut picture = plane(4000.0, 15.0, 15.0, &shape);
        let of = |picture: &super::super::plane::Plane| {
            let patch = Patch::cut(picture, 15, 15).unwrap();
            centroid(&patch, &Standing::measure(&patch, &CoreTemplate::new(&shape), 8.0), &shape, 8.0, 0.04).unwrap()
        };
        let clean = of(&picture);
        picture.pixels[15 * 31 + 17] += 1000.0;
        let spoilt = of(&picture);
        let error = spoilt.x - clean.x;
        assert!(error > 10.0 * clean.sigma && error < 5.0 * spoilt.sigma, "{error} {} {}", clean.sigma, spoilt.sigma);
    }

    #[test]
    fn the_sigma_of_a_faint_star_s_centre_knows_that_it_is_fainter_than_it_seems() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let shape = Shape::round(1.0);
        const NOISE: f32 = 8.0;
        // Signal to noise of one ADU: over the noise times the square root of 4π.
        let snr_of = |flux: f32| flux / (NOISE * (4.0 * std::f32::consts::PI).sqrt());
        let (mut squares, mut count) = (0.0, 0.0);
        for _ in 0..6000 {
            // Numbers above a flux go as its inverse.
            let flux = 3.0 / snr_of(1.0) / (1.0 - random.random::<f32>());
            let (dx, dy) = (random.random::<f32>() - 0.5, random.random::<f32>() - 0.5);
            let mut noisy = plane(flux, 15.0 + dx, 15.0 + dy, &shape);
            for p in &mut noisy.pixels {
                *p += NOISE * ((0..12).map(|_| random.random::<f32>()).sum::<f32>() - 6.0);
            }
            let patch = Patch::cut(&noisy, 15, 15).unwrap();
            let standing = Standing::measure(&patch, &CoreTemplate::new(&shape), NOISE);
            if let Some(found) = centroid(&patch, &standing, &shape, NOISE, 0.0)
                && (5.0..8.0).contains(&snr_of(found.flux))
            {
                squares += ((found.x - dx).powi(2) + (found.y - dy).powi(2)) / (2.0 * found.sigma.powi(2));
                count += 1.0;
            }
        }
        assert!(count > 500.0 && (squares / count - 1.0).abs() < 0.2, "{} of {count}", squares / count);
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
}
