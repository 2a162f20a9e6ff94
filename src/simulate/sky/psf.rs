//! The image of a star: a Gaussian, or a disc blurred by it, integrated over each pixel and along the camera's path.

use std::f64::consts::{PI, SQRT_2};

/// Widths beyond which a Gaussian is nothing (2·10⁻⁹ of the flux lies outside).
const REACH_SIGMA: f64 = 6.0;
/// Widest strip of a disc, in σ: the blur hides finer steps.
const STRIP_SIGMA: f64 = 0.5;
/// Discs smaller than this are points, px.
const POINT_PX: f64 = 1e-3;

/// The point spread function.
#[derive(Debug, Clone)]
pub(super) struct Psf {
    /// Width of the Gaussian, px.
    sigma: f64,
    /// The disc as strips along x: offset in y, half length, weight; weights sum to one.
    strips: Vec<(f64, f64, f64)>,
}

/// A star's light on the pixels that it reaches: weights that sum to one over all pixels, on the sensor or not.
#[derive(Debug, Clone)]
pub(super) struct Stamp {
    /// First column and row on the sensor.
    pub x0: usize,
    pub y0: usize,
    /// Columns.
    pub width: usize,
    /// Row after row.
    pub weights: Vec<f32>,
}

impl Psf {
    /// A Gaussian of `sigma` px, blurring a disc of a `diameter` in px (0 in focus).
    pub fn new(sigma: f64, diameter: f64) -> Self {
        if diameter < POINT_PX {
            return Self { sigma, strips: vec![(0.0, 0.0, 1.0)] };
        }
        let radius = 0.5 * diameter;
        let count = (diameter / (STRIP_SIGMA * sigma)).ceil().max(8.0) as usize;
        let mut strips: Vec<_> = (0..count)
            .map(|i| {
                let y = radius * ((2 * i + 1) as f64 / count as f64 - 1.0);
                let half = (radius * radius - y * y).max(0.0).sqrt();
                (y, half, half)
            })
            .collect();
        let sum: f64 = strips.iter().map(|strip| strip.2).sum();
        strips.iter_mut().for_each(|strip| strip.2 /= sum);
        Self { sigma, strips }
    }

    /// The light of a star that goes through `path` (x, y, weight; weights sum to one), cut to a sensor of the given size.
    ///
    /// `None` where nothing of it falls on the sensor.
    pub fn stamp(&self, path: &[(f64, f64, f64)], width: usize, height: usize) -> Option<Stamp> {
        let reach = REACH_SIGMA * self.sigma + self.strips.iter().map(|strip| strip.1.max(strip.0.abs())).fold(0.0, f64::max);
        let (columns, x0) = span(path.iter().map(|step| step.0), reach, width)?;
        let (rows, y0) = span(path.iter().map(|step| step.1), reach, height)?;
        let mut stamp = Stamp { x0, y0, width: columns, weights: vec![0.0f32; columns * rows] };
        self.fill(path, &mut stamp);
        Some(stamp)
    }

    /// The light of a star that goes through `path`, on the pixels of a stamp.
    pub fn fill(&self, path: &[(f64, f64, f64)], stamp: &mut Stamp) {
        let (x0, y0, columns) = (stamp.x0, stamp.y0, stamp.width.max(1));
        let (mut along_x, mut along_y) = (vec![0.0; columns], vec![0.0; stamp.weights.len() / columns]);
        stamp.weights.fill(0.0);
        for &(x, y, step_weight) in path {
            for &(offset, half, strip_weight) in &self.strips {
                self.integrate(x - x0 as f64, half, step_weight * strip_weight, &mut along_x);
                self.integrate(y + offset - y0 as f64, 0.0, 1.0, &mut along_y);
                for (row, &in_y) in stamp.weights.chunks_exact_mut(columns).zip(&along_y) {
                    if in_y > 0.0 {
                        row.iter_mut().zip(&along_x).for_each(|(pixel, &in_x)| *pixel += (in_x * in_y) as f32);
                    }
                }
            }
        }
    }

    /// Light in each pixel of a line: a box of half length `half` (or a point) at `centre`, blurred, times `scale`.
    fn integrate(&self, centre: f64, half: f64, scale: f64, line: &mut [f64]) {
        let cumulative = |edge: f64| {
            if half < POINT_PX {
                return gauss_cdf(edge / self.sigma);
            }
            (self.gauss_cdf_integral(edge + half) - self.gauss_cdf_integral(edge - half)) / (2.0 * half)
        };
        let reach = half + REACH_SIGMA * self.sigma;
        let first = (centre - reach).round().max(0.0);
        let last = (centre + reach).round();
        line.fill(0.0);
        let mut before = cumulative(first - 0.5 - centre);
        for (i, pixel) in line.iter_mut().enumerate().skip(first as usize).take_while(|(i, _)| *i as f64 <= last) {
            let after = cumulative(i as f64 + 0.5 - centre);
            *pixel = scale * (after - before);
            before = after;
        }
    }

    /// Integral of the Gaussian's cumulative distribution up to t, px.
    fn gauss_cdf_integral(&self, t: f64) -> f64 {
        let z = t / self.sigma;
        t * gauss_cdf(z) + self.sigma / (2.0 * PI).sqrt() * libm::exp(-0.5 * z * z)
    }
}

/// Cumulative distribution of the standard normal.
fn gauss_cdf(z: f64) -> f64 {
    0.5 * libm::erfc(-z / SQRT_2)
}

/// Number of pixels and the first one that positions ± reach cover on a line of `length` pixels.
fn span(positions: impl Iterator<Item = f64>, reach: f64, length: usize) -> Option<(usize, usize)> {
    let (low, high) = positions.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let first = (low - reach).round().max(0.0);
    let last = (high + reach).round().min(length as f64 - 1.0);
    (first <= last).then(|| ((last - first) as usize + 1, first as usize))
}

impl Stamp {
    /// Square root of the sum of the squared weights: flux times this over the pixel noise is the matched filter's signal to noise.
    pub fn sharpness(&self) -> f64 {
        self.weights.iter().map(|&w| f64::from(w) * f64::from(w)).sum::<f64>().sqrt()
    }

    /// Adds a light of this flux, ADU, to an image of `columns` columns.
    pub fn paint(&self, flux_adu: f64, light: &mut [f32], columns: usize) {
        let flux = flux_adu as f32;
        for (at, weight) in self.pixels(columns) {
            if let Some(pixel) = light.get_mut(at) {
                *pixel += flux * weight;
            }
        }
    }

    /// Index in an image of `columns` columns, and weight, of each pixel.
    pub fn pixels(&self, columns: usize) -> impl Iterator<Item = (usize, f32)> {
        self.weights.chunks(self.width.max(1)).enumerate().flat_map(move |(row, weights)| {
            let start = (self.y0 + row) * columns + self.x0;
            weights.iter().enumerate().map(move |(column, &weight)| (start + column, weight))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn moments(stamp: &Stamp, columns: usize) -> (f64, f64, f64, f64) {
        let mut sums = [0.0; 4];
        for (at, weight) in stamp.pixels(columns) {
            let (x, y, w) = ((at % columns) as f64, (at / columns) as f64, f64::from(weight));
            for (sum, term) in sums.iter_mut().zip([w, w * x, w * y, w * x * x]) {
                *sum += term;
            }
        }
        let [flux, x, y, xx] = sums;
        (flux, x / flux, y / flux, xx / flux - (x / flux) * (x / flux))
    }

    #[test]
    fn all_light_lands_where_the_star_is() {
        for diameter in [0.0, 3.0, 12.0, 30.0] {
            let stamp = Psf::new(0.9, diameter).stamp(&[(50.3, 60.8, 1.0)], 100, 120).unwrap();
            let (flux, x, y, variance) = moments(&stamp, 100);
            assert!((flux - 1.0).abs() < 1e-4, "{flux}");
            assert!((x - 50.3).abs() < 2e-4 && (y - 60.8).abs() < 2e-4, "{x} {y}");
            // A disc's variance along one axis is a sixteenth of its squared diameter; a pixel's is a twelfth.
            let expected = 0.81 + diameter * diameter / 16.0 + 1.0 / 12.0;
            assert!((variance / expected - 1.0).abs() < 0.01, "{diameter}: {variance} against {expected}");
        }
    }

    #[test]
    fn a_trail_is_as_bright_as_the_star_and_less_sharp() {
        let path: Vec<_> = (0..40).map(|i| (30.0 + 0.5 * f64::from(i), 40.0, 1.0 / 40.0)).collect();
        let psf = Psf::new(1.0, 0.0);
        let (trail, point) = (psf.stamp(&path, 100, 100).unwrap(), psf.stamp(&[(40.0, 40.0, 1.0)], 100, 100).unwrap());
        assert!((moments(&trail, 100).0 - 1.0).abs() < 1e-5);
        assert!((point.sharpness() * (4.0 * PI).sqrt() - 1.0).abs() < 0.1);
        assert!(trail.sharpness() < 0.5 * point.sharpness());
    }

    #[test]
    fn light_beyond_the_edge_is_lost() {
        let psf = Psf::new(1.0, 0.0);
        let stamp = psf.stamp(&[(-0.5, 10.0, 1.0)], 20, 20).unwrap();
        assert!((moments(&stamp, 20).0 - 0.5).abs() < 1e-6);
        assert!(psf.stamp(&[(-10.0, 10.0, 1.0)], 20, 20).is_none());
    }
}
