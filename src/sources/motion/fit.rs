//! The fit of a star along its trails, in the exposures as they are.

use super::super::finder::Source;
use super::super::peaks::Peak;
use super::window::{Exposed, Window};
use super::{LEAST_SNR, Trailed};
use nalgebra::{Matrix2, Matrix3, Vector3};

/// Furthest that a fit may go from its peak, px.
const FURTHEST_PX: f64 = 4.0;
/// Steps of a fit.
const STEPS: usize = 4;
/// A source whose residuals are so many times the noise's, squared, is no star; what a bright star's shape adds is allowed for.
const MOST_CHI2: f64 = 1.5;
const CHI2_PER_SNR2: f64 = 0.01;
/// What a fit gives.
struct Fitted {
    x: f64,
    y: f64,
    flux: f64,
    /// Of the place, px².
    covariance: Matrix2<f64>,
    snr: f64,
    chi2: f64,
    peak: f64,
    saturated: bool,
}

impl Fitted {
    /// Nothing yet, at a place.
    fn at(x: f64, y: f64) -> Self {
        Self { x, y, flux: 0.0, covariance: Matrix2::zeros(), snr: 0.0, chi2: 0.0, peak: 0.0, saturated: false }
    }
}

/// The centre of a peak's sample of the halved picture, px.
fn place(peak: &Peak) -> (f64, f64) {
    (2.0 * peak.x as f64 + 0.5, 2.0 * peak.y as f64 + 0.5)
}

/// Signal over noise of a star at a peak, against the sky beside its trails.
pub(super) fn contrast(exposed: &[Exposed<'_>], peak: &Peak) -> f32 {
    let (x, y) = place(peak);
    let (light, information) = light_at(exposed, x, y);
    (light / information.max(f64::MIN_POSITIVE).sqrt()) as f32
}

/// The light of a star at a place at the origin, px, and the information of it.
pub(super) fn light_at(exposed: &[Exposed<'_>], x: f64, y: f64) -> (f64, f64) {
    let windows = exposed.iter().filter_map(|exposed| Window::around(exposed, x, y));
    windows.map(|window| window.flux_at(x, y)).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1))
}

/// How bright these stars are in each exposure, as a part of how bright all exposures together say that they are, with its σ: each at its
/// place at the origin, px, with its flux. Nought with an infinite σ where none of them is on the picture.
pub(super) fn shares(exposed: &[Exposed<'_>], stars: &[(f64, f64, f64)]) -> Vec<(f64, f64)> {
    let share = |exposed: &Exposed<'_>| {
        let (mut data, mut squares) = (0.0, 0.0);
        for &(x, y, flux) in stars {
            if let Some(window) = Window::around(exposed, x, y) {
                let (with_data, information) = window.flux_at(x, y);
                data += flux * with_data;
                squares += flux * flux * information;
            }
        }
        if squares > 0.0 { (data / squares, 1.0 / squares.sqrt()) } else { (0.0, f64::INFINITY) }
    };
    exposed.iter().map(share).collect()
}

/// The source of a peak, where a star can be fitted there.
pub(super) fn source_at(exposed: &[Exposed<'_>], peak: &Peak) -> Option<Source> {
    let (x, y) = place(peak);
    let fitted = fit(exposed, x, y)?;
    let star_like = fitted.chi2 < MOST_CHI2 + CHI2_PER_SNR2 * fitted.snr * fitted.snr && !fitted.saturated;
    let of_place = fitted.covariance;
    (fitted.snr >= f64::from(LEAST_SNR)).then_some(Source {
        x: fitted.x,
        y: fitted.y,
        sigma: (0.5 * of_place.trace()).sqrt(),
        flux: fitted.flux,
        snr: fitted.snr,
        confidence: fitted.snr,
        peak: fitted.peak,
        saturated: fitted.saturated,
        star_like,
        trailed: Some(Trailed { covariance: (of_place.m11, of_place.m22, of_place.m12), noise: 0.0 }),
    })
}

/// The sums of a fit.
struct Equations {
    products: Matrix3<f64>,
    data: Vector3<f64>,
    chi2: f64,
    values: f64,
}

/// Adds to the normal equations of (flux, x, y); the sky's level is of its own in each exposure, and taken out.
fn add_to(equations: &mut Equations, window: &Window<'_>, at: &Fitted) {
    let sums = window.sums((at.x, at.y), true);
    let [ll, lx, ly, xx, xy, yy] = sums.products;
    let scale = Vector3::new(1.0, at.flux, at.flux);
    let means = Vector3::from(sums.light).component_mul(&scale);
    let products = Matrix3::new(ll, lx, ly, lx, xx, xy, ly, xy, yy).component_mul(&(scale * scale.transpose()));
    let with_left = Vector3::from(sums.with_values).component_mul(&scale) - products.column(0) * at.flux;
    // The values have no mean, so that of what is left is the light's.
    let left = -at.flux * means.x;
    equations.products += (products - means * means.transpose() / window.near) * window.weight;
    equations.data += (with_left - means * (left / window.near)) * window.weight;
    let squares = window.squares - at.flux * (2.0 * sums.with_values[0] - at.flux * ll);
    equations.chi2 += (squares - left * left / window.near) * window.weight;
    equations.values += window.near;
}

fn equations(windows: &[Window<'_>], at: &Fitted) -> Equations {
    let mut sums = Equations { products: Matrix3::zeros(), data: Vector3::zeros(), chi2: 0.0, values: 0.0 };
    windows.iter().for_each(|window| add_to(&mut sums, window, at));
    sums
}

/// How well a star at a place explains the light, with the flux that does it best: ln of the likelihood ratio, and that flux.
fn likelihood(windows: &[Window<'_>], x: f64, y: f64) -> (f64, f64) {
    let (data, information) = windows.iter().map(|window| window.flux_at(x, y)).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
    if data > 0.0 && information > 0.0 { (0.5 * data * data / information, data / information) } else { (0.0, 0.0) }
}

/// Fits a star's place and flux by Gauss-Newton steps from a place; `None` where none is found near it.
fn fit(exposed: &[Exposed<'_>], x: f64, y: f64) -> Option<Fitted> {
    let mut windows = Vec::with_capacity(exposed.len());
    let mut star = Fitted::at(x, y);
    for exposed in exposed {
        // An exposure in which the star has left the picture tells nothing of it.
        let Some(window) = Window::around(exposed, x, y) else { continue };
        star.saturated |= window.saturated;
        windows.push(window);
    }
    star.flux = likelihood(&windows, x, y).1;
    for _ in 0..STEPS {
        let sums = equations(&windows, &star);
        let step = sums.products.cholesky()?.solve(&sums.data);
        star.flux += step.x;
        star.x += step.y.clamp(-1.0, 1.0);
        star.y += step.z.clamp(-1.0, 1.0);
        if !(star.flux > 0.0 && (star.x - x).abs() <= FURTHEST_PX && (star.y - y).abs() <= FURTHEST_PX) {
            return None;
        }
    }
    let sums = equations(&windows, &star);
    let covariance = sums.products.cholesky()?.inverse();
    star.snr = star.flux / covariance.m11.sqrt();
    star.chi2 = sums.chi2 / (sums.values - (3 + windows.len()) as f64).max(1.0);
    star.peak = star.flux * f64::from(exposed.iter().map(|e| e.table.highest).fold(0.0, f32::max));
    // Without some of the exposures what the trails of the others lie off shows in full.
    let apart = if windows.len() < exposed.len() { exposed.iter().map(|e| e.trail.sigma_px).fold(0.0, f64::max) } else { 0.0 };
    let of_place = Matrix2::new(covariance.m22, covariance.m23, covariance.m23, covariance.m33);
    star.covariance = spread(&windows, &mut star, &of_place) + Matrix2::identity() * (apart * apart);
    (star.snr.is_finite() && star.covariance.iter().all(|variance| variance.is_finite())).then_some(star)
}

/// Moves a star that is fitted to the mean of where it may be along its trail, and gives the covariance of its place, px².
///
/// What tells where a faint star is along a long trail is the trail's ends alone, which noise hides: there the likelihood is no parabola, and
/// its peak may be far off. So it is looked at as a whole, along the axis on which the place is known worst.
fn spread(windows: &[Window<'_>], star: &mut Fitted, of_place: &Matrix2<f64>) -> Matrix2<f64> {
    /// How far and how closely it is looked at, px.
    const REACH_PX: f64 = 6.0;
    const STEP_PX: f64 = 0.5;
    /// A place that is known so well is at the peak, px.
    const SURE_PX: f64 = 0.25;
    let axes = of_place.symmetric_eigen();
    let long = axes.eigenvalues.max();
    if long.sqrt() < SURE_PX {
        return *of_place;
    }
    let axis = axes.eigenvectors.column(axes.eigenvalues.imax());
    let steps = (REACH_PX / STEP_PX) as i32;
    let places = (-steps..=steps).map(|i| f64::from(i) * STEP_PX);
    let heights: Vec<(f64, f64)> =
        places.map(|way| (way, likelihood(windows, star.x + way * axis.x, star.y + way * axis.y).0)).collect();
    let highest = heights.iter().map(|(_, height)| *height).fold(f64::MIN, f64::max);
    let (mut total, mut mean, mut square) = (0.0, 0.0, 0.0);
    for (way, height) in heights {
        let part = libm::exp(height - highest);
        (total, mean, square) = (total + part, mean + part * way, square + part * way * way);
    }
    let (mean, square) = (mean / total, square / total);
    star.x += mean * axis.x;
    star.y += mean * axis.y;
    // A sum of steps makes no peak narrower than one of them.
    let variance = (square - mean * mean).max(long.min(STEP_PX * STEP_PX));
    of_place + axis * axis.transpose() * (variance - long)
}
