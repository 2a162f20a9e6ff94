//! The best focus from measured peaks: a fit of what physics says that a star's peak does while the lens goes through its focus.
//!
//! The image of a star is the disc of the defocus, of a diameter that grows linearly from the best focus, blurred by a Gaussian of the
//! optics. Its middle has A·g(z²), with g(u) = (1 − e⁻ᵘ)/u and z = (x − x₀)/w: A in focus, half of it at 1.26 w, and falling as the
//! disc's area grows beyond. Every star has its own A; all share the best focus x₀, how fast it drifts, the width w, and the floor: as
//! the highest pixel of something is told, noise alone has a peak too.

use nalgebra::{Matrix4, Vector4};

/// A residual of this many σ counts half: trails, clouds and mistaken stars must not pull.
const ROBUST_SIGMAS: f64 = 3.0;
/// What is known of the width beforehand, one σ of its logarithm: its half to its double.
const LN_WIDTH_SIGMA: f64 = 0.7;
/// The floor is nought within this many times the typical noise of a peak.
const FLOOR_SIGMAS: f64 = 3.0;
/// Widths that the search begins from, in those that are expected.
const WIDTHS: [f64; 5] = [0.5, 0.7, 1.0, 1.4, 2.0];
/// The search's steps of the best focus, and how far beyond the positions it goes, widths.
const SEARCH_STEP: f64 = 0.33;
const SEARCH_BEYOND: f64 = 2.0;
/// Most steps of the search.
const SEARCH_STEPS: f64 = 400.0;
const MAX_STEPS: usize = 40;
/// A step that betters the fit by less than this ends it, in units of χ².
const SETTLED: f64 = 1e-4;
/// Parameters that all stars share.
const SHARED: usize = 4;

/// One measured peak.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Point {
    /// Lens position, counts.
    pub x: f64,
    /// Time, min.
    pub t: f64,
    /// Peak, ADU.
    pub y: f64,
    /// One σ of it, ADU.
    pub sigma: f64,
}

/// What is known before the fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FitPrior {
    /// Width of the curve, counts.
    pub width: f64,
    /// One σ of the drift of the best focus, counts/min.
    pub drift_sigma: f64,
}

/// A fitted curve.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    shape: Shape,
    /// Covariance of (best focus, ln width, drift, floor).
    covariance: Matrix4<f64>,
    /// Time that the best focus refers to, min.
    t0: f64,
    /// Height in focus of each curve, ADU.
    pub amplitudes: Vec<f64>,
    /// By how much χ² is less than that of constant peaks, in units of the scatter.
    pub gain: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Shape {
    x0: f64,
    ln_width: f64,
    drift: f64,
    floor: f64,
}

/// What the points say of a shape.
struct Evaluation {
    /// Robust loss with what the prior adds, in units of χ².
    loss: f64,
    /// Sum of squared residuals with the robust weights.
    chi2: f64,
    amplitudes: Vec<f64>,
    normal: Matrix4<f64>,
    right: Vector4<f64>,
}

/// The peak of a disc of (in units of √8 of the Gaussian's σ) diameter √u, of one in focus, and its slope.
fn disc(u: f64) -> (f64, f64) {
    if u < 1e-3 {
        return (1.0 - u / 2.0 + u * u / 6.0, -0.5 + u / 3.0);
    }
    let e = (-u).exp();
    ((1.0 - e) / u, (e * (1.0 + u) - 1.0) / (u * u))
}

impl Shape {
    fn width(&self) -> f64 {
        self.ln_width.exp()
    }

    /// g and its slopes along best focus, ln width and drift.
    fn at(&self, point: &Point, t0: f64) -> (f64, [f64; 3]) {
        let dt = point.t - t0;
        let z = (point.x - self.x0 - self.drift * dt) / self.width();
        let (g, slope) = disc(z * z);
        let along = -2.0 * z * slope / self.width();
        (g, [along, -2.0 * z * z * slope, along * dt])
    }

    fn moved(&self, step: &Vector4<f64>) -> Self {
        Self {
            x0: self.x0 + step.x,
            ln_width: self.ln_width + step.y.clamp(-1.0, 1.0),
            drift: self.drift + step.z,
            floor: self.floor + step.w,
        }
    }
}

/// Weight of a residual, against its σ alone: 1 of a small one, falling as its square where it is large.
fn trust(residual: f64, sigma: f64) -> f64 {
    1.0 / (1.0 + (residual / (ROBUST_SIGMAS * sigma)).powi(2))
}

/// What a fit works on.
struct Problem<'a> {
    curves: &'a [Vec<Point>],
    prior: &'a FitPrior,
    t0: f64,
    floor_sigma: f64,
}

/// Fits curves of peaks; `None` where they hold too little for a fit to settle.
pub(super) fn fit(curves: &[Vec<Point>], prior: &FitPrior) -> Option<Fit> {
    let points = || curves.iter().flatten();
    let count = points().count();
    if count < curves.len() + SHARED {
        return None;
    }
    let t0 = points().map(|p| p.t).sum::<f64>() / count as f64;
    let mut sigmas: Vec<f64> = points().map(|p| p.sigma).collect();
    sigmas.sort_by(f64::total_cmp);
    let floor_sigma = FLOOR_SIGMAS * sigmas.get(sigmas.len() / 2)?;
    let problem = Problem { curves, prior, t0, floor_sigma };
    let start = problem.search()?;
    let (shape, last) = problem.descend(start);
    let free = (count - curves.len()).saturating_sub(SHARED).max(1) as f64;
    // Errors that were told too small are made up for; too large ones are left.
    let scatter = (last.chi2 / free).max(1.0);
    let covariance = last.normal.try_inverse()? * scatter;
    let gain = (problem.flat() - last.chi2) / scatter;
    let sound = covariance.diagonal().iter().all(|v| v.is_finite() && *v > 0.0) && gain.is_finite();
    sound.then_some(Fit { shape, covariance, t0, amplitudes: last.amplitudes, gain })
}

impl Problem<'_> {
    /// The best start of a grid over best focus and width.
    fn search(&self) -> Option<Shape> {
        let xs = self.curves.iter().flatten().map(|p| p.x);
        let (low, high) = xs.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let beyond = SEARCH_BEYOND * self.prior.width;
        let (low, span) = (low - beyond, high - low + 2.0 * beyond);
        let mut best: Option<(f64, Shape)> = None;
        for factor in WIDTHS {
            let width = factor * self.prior.width;
            let steps = (span / (SEARCH_STEP * width)).ceil().clamp(1.0, SEARCH_STEPS);
            for i in 0..=steps as u32 {
                let shape = Shape { x0: low + span * f64::from(i) / steps, ln_width: width.ln(), drift: 0.0, floor: 0.0 };
                let loss = self.evaluate(&shape).loss;
                if best.as_ref().is_none_or(|(least, _)| loss < *least) {
                    best = Some((loss, shape));
                }
            }
        }
        best.map(|(_, shape)| shape)
    }

    /// Steps of Levenberg and Marquardt down from a start.
    fn descend(&self, start: Shape) -> (Shape, Evaluation) {
        let (mut shape, mut here) = (start, self.evaluate(&start));
        let mut damping = 1e-3;
        for _ in 0..MAX_STEPS {
            let mut damped = here.normal;
            for i in 0..SHARED {
                damped[(i, i)] *= 1.0 + damping;
            }
            let Some(step) = damped.cholesky().map(|c| c.solve(&here.right)) else { break };
            let next = shape.moved(&step);
            let there = self.evaluate(&next);
            if there.loss < here.loss {
                let better = here.loss - there.loss;
                (shape, here) = (next, there);
                damping = (damping * 0.3).max(1e-9);
                if better < SETTLED {
                    break;
                }
            } else {
                damping *= 8.0;
                if damping > 1e8 {
                    break;
                }
            }
        }
        (shape, here)
    }

    /// Loss and normal equations at a shape, every curve at its own best height (Golub and Pereyra 1973, with Kaufman's slopes).
    fn evaluate(&self, shape: &Shape) -> Evaluation {
        let prior = self.prior;
        let off = [0.0, shape.ln_width - prior.width.ln(), shape.drift, shape.floor];
        let weights =
            [0.0, LN_WIDTH_SIGMA, prior.drift_sigma, self.floor_sigma].map(|s| if s > 0.0 { 1.0 / (s * s) } else { 0.0 });
        let mut out = Evaluation {
            loss: off.iter().zip(weights).map(|(o, w)| w * o * o).sum(),
            chi2: 0.0,
            amplitudes: Vec::with_capacity(self.curves.len()),
            normal: Matrix4::from_diagonal(&Vector4::from(weights)),
            right: -Vector4::from(off).component_mul(&Vector4::from(weights)),
        };
        let mut models = Vec::new();
        for curve in self.curves {
            models.clear();
            models.extend(curve.iter().map(|point| (point, shape.at(point, self.t0))));
            out.add_curve(&models, shape.floor);
        }
        out
    }

    /// χ² of constant peaks, a level for each curve.
    fn flat(&self) -> f64 {
        let mut out = Evaluation::empty();
        for curve in self.curves {
            let models: Vec<_> = curve.iter().map(|point| (point, (1.0, [0.0; 3]))).collect();
            out.add_curve(&models, 0.0);
        }
        out.chi2
    }
}

impl Evaluation {
    fn empty() -> Self {
        Self { loss: 0.0, chi2: 0.0, amplitudes: Vec::new(), normal: Matrix4::zeros(), right: Vector4::zeros() }
    }

    fn add_curve(&mut self, models: &[(&Point, (f64, [f64; 3]))], floor: f64) {
        const ROUNDS: usize = 3;
        let (mut height, mut begun) = (0.0f64, false);
        let weight = |point: &Point, g: f64, height: f64, begun: bool| {
            let trusted = if begun { trust(point.y - floor - height * g, point.sigma) } else { 1.0 };
            trusted / (point.sigma * point.sigma)
        };
        let mut norm = f64::MIN_POSITIVE;
        for _ in 0..ROUNDS {
            let (mut over, mut under) = (0.0, f64::MIN_POSITIVE);
            for (point, (g, _)) in models {
                let w = weight(point, *g, height, begun);
                over += w * g * (point.y - floor);
                under += w * g * g;
            }
            (height, norm, begun) = ((over / under).max(0.0), under, true);
        }
        // Slopes of the model along the four shared parameters, less what the height takes up.
        let slopes = |(g, along): &(f64, [f64; 3])| {
            let [x0, width, drift] = along.map(|a| height * a);
            (*g, Vector4::new(x0, width, drift, 1.0))
        };
        let mut taken = Vector4::zeros();
        for (point, model) in models {
            let (g, slope) = slopes(model);
            taken += slope * (weight(point, g, height, true) * g / norm);
        }
        for (point, model) in models {
            let (g, slope) = slopes(model);
            let (slope, residual) = (slope - taken * g, point.y - floor - height * g);
            let w = weight(point, g, height, true);
            self.normal += slope * slope.transpose() * w;
            self.right += slope * (w * residual);
            self.chi2 += w * residual * residual;
            let c2 = ROBUST_SIGMAS * ROBUST_SIGMAS;
            self.loss += c2 * ((residual / point.sigma).powi(2) / c2).ln_1p();
        }
        self.amplitudes.push(height);
    }
}

impl Fit {
    /// The best focus at a time in min, counts, and one σ of it.
    pub fn best_at(&self, t: f64) -> (f64, f64) {
        let dt = t - self.t0;
        let c = &self.covariance;
        let variance = c[(0, 0)] + 2.0 * dt * c[(0, 2)] + dt * dt * c[(2, 2)];
        (self.shape.x0 + self.shape.drift * dt, variance.max(0.0).sqrt())
    }

    /// Mean time of the points, min.
    pub fn mean_time(&self) -> f64 {
        self.t0
    }

    /// Width of the curve, counts.
    pub fn width(&self) -> f64 {
        self.shape.width()
    }

    /// Drift of the best focus, counts/min, and one σ of it.
    pub fn drift(&self) -> (f64, f64) {
        (self.shape.drift, self.covariance[(2, 2)].sqrt())
    }

    /// Peak that a curve of this height in focus has at a position and time, ADU.
    pub fn peak(&self, amplitude: f64, x: f64, t: f64) -> f64 {
        let point = Point { x, t, y: 0.0, sigma: 1.0 };
        self.shape.floor + amplitude * self.shape.at(&point, self.t0).0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const PRIOR: FitPrior = FitPrior { width: 60.0, drift_sigma: 3.0 };

    /// Three stars seen at 15 positions twice, the best focus 3030 in the middle of the time and drifting.
    fn sweep(seed: u64, outliers: bool) -> Vec<Vec<Point>> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut curves = Vec::new();
        for height in [400.0, 150.0, 60.0] {
            let mut curve = Vec::new();
            for pass in 0..2 {
                for i in 0..15 {
                    let (x, t) = (2750.0 + 40.0 * f64::from(i), f64::from(pass * 15 + i) * 0.5);
                    let z = (x - 3030.0 - 2.0 * (t - 7.25)) / 50.0;
                    let (noise, normal): (f64, f64) = (8.0, StandardNormal.sample(&mut random));
                    let outlier = if outliers && i % 5 == 2 { 300.0 } else { 0.0 };
                    curve.push(Point { x, t, y: 5.0 + height * disc(z * z).0 + noise * normal + outlier, sigma: noise });
                }
            }
            curves.push(curve);
        }
        curves
    }

    #[test]
    fn the_best_focus_errs_by_its_sigma_and_the_drift_is_found() {
        let (mut squares, mut drifts) = (0.0, 0.0);
        const RUNS: u64 = 60;
        for seed in 0..RUNS {
            let fit = fit(&sweep(seed, false), &PRIOR).unwrap();
            let (best, sigma) = fit.best_at(7.25);
            assert!((0.2..4.0).contains(&sigma), "{sigma}");
            squares += ((best - 3030.0) / sigma).powi(2) / RUNS as f64;
            drifts += ((fit.drift().0 - 2.0) / fit.drift().1).powi(2) / RUNS as f64;
            assert!((fit.width() - 50.0).abs() < 6.0, "{}", fit.width());
            assert!(fit.gain > 150.0, "{}", fit.gain);
        }
        // Of 60 squares of normal numbers the mean is 1 ± 0.18.
        assert!((0.4..1.7).contains(&squares), "{squares}");
        assert!((0.4..1.7).contains(&drifts), "{drifts}");
    }

    #[test]
    fn outliers_do_not_pull() {
        for seed in 0..10 {
            let best = fit(&sweep(seed, true), &PRIOR).unwrap().best_at(7.25).0;
            assert!((best - 3030.0).abs() < 8.0, "{best}");
        }
    }

    #[test]
    fn slopes_are_those_of_the_curve() {
        let shape = Shape { x0: 3000.0, ln_width: 50f64.ln(), drift: 1.5, floor: 0.0 };
        for x in [2700.0, 2990.0, 3001.0, 3070.0] {
            let point = Point { x, t: 3.0, y: 0.0, sigma: 1.0 };
            let (_, slopes) = shape.at(&point, 1.0);
            for (i, slope) in slopes.iter().enumerate() {
                const STEP: f64 = 1e-5;
                let mut step = Vector4::zeros();
                step[i] = STEP;
                let ahead = shape.moved(&step).at(&point, 1.0).0;
                let behind = shape.moved(&-step).at(&point, 1.0).0;
                assert!((slope - (ahead - behind) / (2.0 * STEP)).abs() < 1e-6, "{x} {i}");
            }
        }
    }

    #[test]
    fn constant_peaks_gain_nothing() {
        let curves: Vec<Vec<Point>> =
            sweep(3, false).into_iter().map(|c| c.into_iter().map(|p| Point { y: 100.0 + p.x % 7.0, ..p }).collect()).collect();
        assert!(fit(&curves, &PRIOR).is_none_or(|fit| fit.gain < 10.0));
    }
}
