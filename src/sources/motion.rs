//! Stars that move while they are exposed, along a way that is known: the smoothing kernel of each exposure is the trail that a star
//! leaves in it, and all exposures share one origin, so that a star's light of the whole series is added up where it was at its start
//! (stars-paper, "Solving - Motion PSF").
//!
//! The sum over trails is the matched filter of a star in plain noise: its peaks are searched in the picture halved once, and each is
//! then fitted in the exposures as they are. So every source has a flux, and a σ that is the least there can be (Cramér-Rao).

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the picture's own size")]

use super::finder::{Finder, Look, Source, set_thresholds};
use super::kernel::SearchKernel;
use super::peaks::{Peak, PeakRules, Taps};
use super::plane::{Clipped, HalveScratch, MARGIN, Plane, halve};
use crate::image::{CELL_PX, CellStatistics, Frame};
use crate::sky::{Kernel, with_vectors};
use nalgebra::{Matrix3, Vector3};
use std::collections::BTreeMap;

/// Signal over noise of a peak that is worth a fit, and of a source.
const LEAST_SNR: f32 = 3.2;
/// Peaks of the sum that are looked at, and those of them whose place is fitted. Around dust the sum stands high: what is a star shows once
/// the sky beside each trail is told.
const MOST_PEAKS: usize = 400;
const MOST_FITTED: usize = 64;
/// Width of a star without motion, px, as real frames have it.
const STAR_SIGMA_PX: f64 = 1.0;
/// Samples of a trail's table along a pixel.
const FINE: f64 = 4.0;
/// Reach of a star's light beyond its way, px: its flanks tell the sky's level.
const LIGHT_PX: f64 = 4.5;
/// A pixel this many times the noise above all its neighbours is clipped.
const SPIKE_SIGMAS: f32 = 3.0;
/// Furthest that a fit may go from its peak, px.
const FURTHEST_PX: f64 = 4.0;
/// Steps of a fit.
const STEPS: usize = 4;
/// A source whose residuals are so many times the noise's, squared, is no star; what a bright star's shape adds is allowed for.
const MOST_CHI2: f64 = 1.5;
const CHI2_PER_SNR2: f64 = 0.01;
/// By how much places scatter more than the least that can be, times the square of signal over noise: the next order in the noise.
const FAINT_SCATTER: f64 = 4.0;
/// A peak beside a higher one must stand so far above what that one's light adds there, in parts of the threshold.
const ABOVE_NEIGHBOUR: f32 = 1.0;

/// The way of a star at rest in the sky over the picture during one exposure.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trail {
    /// Offsets from where the star is said to be, which all exposures share, px in file order (x, y), evenly spaced in time.
    pub places: Vec<(f64, f64)>,
    /// This exposure's part of the light of the series.
    pub share: f64,
    /// How far the picture has turned about its centre by the middle of this exposure, rad: what lay at (x, y) from there has moved by
    /// (y, −x) times it.
    pub spin: f64,
    /// One σ of where it lies against the trails of the other exposures, px per axis.
    pub sigma_px: f64,
}

impl Trail {
    /// From its first place to its last, px.
    fn length(&self) -> f64 {
        let ends = self.places.first().zip(self.places.last());
        ends.map_or(0.0, |(first, last)| (last.0 - first.0).hypot(last.1 - first.1))
    }

    /// Furthest offset from the origin along either axis, px.
    pub fn reach(&self) -> f64 {
        self.places.iter().map(|(x, y)| x.abs().max(y.abs())).fold(0.0, f64::max)
    }

    /// Where the picture's turn has moved what lay at a place of a picture with this centre.
    fn spun(&self, (x, y): (f64, f64), centre: (f64, f64)) -> (f64, f64) {
        (x + self.spin * (y - centre.1), y - self.spin * (x - centre.0))
    }

    /// The part of a star's light on each sample of the picture halved once, as offsets (x, y) and weights that sum to the share.
    fn halved(&self) -> BTreeMap<(i32, i32), f32> {
        let mut weights = BTreeMap::new();
        let weight = (self.share / self.places.len().max(1) as f64) as f32;
        for &(x, y) in &self.places {
            let (x, y) = (x / 2.0, y / 2.0);
            let (left, top) = (x.floor(), y.floor());
            let (right, low) = ((x - left) as f32, (y - top) as f32);
            for (dx, across) in [(0, 1.0 - right), (1, right)] {
                for (dy, down) in [(0, 1.0 - low), (1, low)] {
                    *weights.entry((left as i32 + dx, top as i32 + dy)).or_insert(0.0) += weight * across * down;
                }
            }
        }
        weights.retain(|_, weight| *weight > 0.0);
        weights
    }
}

/// An exposure with what a search needs of it.
struct Exposed<'a> {
    frame: &'a Frame,
    cells: &'a CellStatistics,
    trail: &'a Trail,
    table: Table,
}

/// The middle of a picture, in its own samples.
fn centre(width: usize, height: usize) -> (f64, f64) {
    (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0))
}

/// The light of a star on the picture of one exposure: a table of its density per px² around the star's origin.
struct Table {
    /// Offsets of the first sample, px.
    x0: f64,
    y0: f64,
    width: usize,
    height: usize,
    samples: Vec<f32>,
}

impl Table {
    fn of(trail: &Trail) -> Self {
        let span = |part: fn(&(f64, f64)) -> f64| {
            let (low, high) = trail.places.iter().map(part).fold((0.0_f64, 0.0_f64), |(low, high), v| (low.min(v), high.max(v)));
            (low - LIGHT_PX, ((high - low + 2.0 * LIGHT_PX) * FINE).ceil() as usize + 1)
        };
        let ((x0, width), (y0, height)) = (span(|p| p.0), span(|p| p.1));
        // A pixel takes the light of its whole square.
        let variance = STAR_SIGMA_PX * STAR_SIGMA_PX + 1.0 / 12.0;
        let weight = trail.share / trail.places.len().max(1) as f64 / (std::f64::consts::TAU * variance);
        let mut samples = vec![0.0_f32; width * height];
        let falls = |place: f64, first: f64, count: usize| -> (usize, Vec<f64>) {
            let from = (((place - LIGHT_PX - first) * FINE).ceil().max(0.0) as usize).min(count);
            let to = (((place + LIGHT_PX - first) * FINE).floor().max(0.0) as usize + 1).min(count);
            let fall = |i: usize| libm::exp(-0.5 * (first + i as f64 / FINE - place).powi(2) / variance);
            (from, (from..to).map(fall).collect())
        };
        for &(x, y) in &trail.places {
            let ((column, across), (row, down)) = (falls(x, x0, width), falls(y, y0, height));
            for (j, down) in down.iter().enumerate() {
                let line = &mut samples[(row + j) * width + column..][..across.len()];
                line.iter_mut().zip(&across).for_each(|(sample, across)| *sample += (weight * down * across) as f32);
            }
        }
        Self { x0, y0, width, height, samples }
    }

    /// Density at an offset, and how it changes with the star's own place, per px.
    fn at(&self, x: f64, y: f64) -> [f64; 3] {
        let (u, v) = ((x - self.x0) * FINE, (y - self.y0) * FINE);
        if u < 0.0 || v < 0.0 {
            return [0.0; 3];
        }
        let (i, j) = (u as usize, v as usize);
        if i + 1 >= self.width || j + 1 >= self.height {
            return [0.0; 3];
        }
        let sample = |di: usize, dj: usize| f64::from(self.samples[(j + dj) * self.width + i + di]);
        let [a, b, c, d] = [sample(0, 0), sample(1, 0), sample(0, 1), sample(1, 1)];
        let (right, low) = (u - i as f64, v - j as f64);
        let (top, bottom) = (a + right * (b - a), c + right * (d - c));
        let along = (b - a) + low * ((d - c) - (b - a));
        [top + low * (bottom - top), -FINE * along, -FINE * (bottom - top)]
    }
}

/// What a fit gives.
struct Fitted {
    x: f64,
    y: f64,
    flux: f64,
    sigma_px: f64,
    snr: f64,
    chi2: f64,
    peak: f64,
    saturated: bool,
}

impl Fitted {
    /// Nothing yet, at a place.
    fn at(x: f64, y: f64) -> Self {
        Self { x, y, flux: 0.0, sigma_px: 0.0, snr: 0.0, chi2: 0.0, peak: 0.0, saturated: false }
    }
}

impl Finder {
    /// Finds stars by the light of all exposures of a series, each along its own trail; positions are those at the origin of the trails, the
    /// surest first. `cells`: the statistics of each exposure. `false` where it was told not to keep on.
    pub fn find_along(
        &mut self,
        exposures: &[&Frame],
        cells: &[CellStatistics],
        trails: &[Trail],
        look: &Look<'_>,
        sources: &mut Vec<Source>,
    ) -> bool {
        sources.clear();
        let kernels: Vec<_> = trails.iter().map(Trail::halved).collect();
        let mut sum = Plane::default();
        for (((frame, cells), kernel), trail) in exposures.iter().zip(cells).zip(&kernels).zip(trails) {
            if !self.smooth_above_level(frame, cells, trail, look) {
                return false;
            }
            let smooth = self.finder.smooth();
            if sum.pixels.is_empty() {
                sum = Plane { width: smooth.width, height: smooth.height, pixels: vec![0.0; smooth.pixels.len()] };
            }
            with_vectors(AddAlong { from: smooth, kernel, trail, out: &mut sum });
        }
        let Some(first) = cells.first() else { return true };
        let peaks = peaks_of(&sum, first, noise_of(&kernels, cells), look);
        let exposed: Vec<Exposed<'_>> = (exposures.iter().zip(cells).zip(trails))
            .map(|((frame, cells), trail)| Exposed { frame, cells, trail, table: Table::of(trail) })
            .collect();
        let mut peaks: Vec<(Peak, f32)> = peaks.into_iter().map(|peak| (peak, contrast(&exposed, &peak))).collect();
        peaks.retain(|(_, snr)| *snr >= LEAST_SNR);
        peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
        peaks.truncate(MOST_FITTED);
        sources.extend(apart(peaks, &kernels, LEAST_SNR).iter().filter_map(|(peak, _)| source_at(&exposed, peak)));
        sources.sort_by(|a, b| b.star_like.cmp(&a.star_like).then(b.snr.total_cmp(&a.snr)));
        sources.truncate(look.settings.max_found as usize);
        self.psf_axes = None;
        true
    }

    /// An exposure halved and smoothed, above its level; `false` where it was told not to keep on.
    fn smooth_above_level(&mut self, frame: &Frame, cells: &CellStatistics, trail: &Trail, look: &Look<'_>) -> bool {
        let (mut excess, mut half) = (Vec::new(), Plane::default());
        Clipped::excess_of(frame, cells, &mut excess);
        halve(&Clipped::new(frame, &excess), &mut HalveScratch::default(), &mut half);
        // Coarse cells, of 8 px: the level is told from beyond the light of the trail.
        let ring = 2 + (trail.length() / 8.0).ceil() as usize;
        let no_peaks = PeakRules {
            taps: SearchKernel::Sharp.taps(),
            ring,
            border: half.width,
            cell: CELL_PX,
            per_cell: 1,
            thresholds: &[f32::INFINITY],
            threshold_columns: 1,
            masked: &|_, _| true,
        };
        self.finder.find(&half, &no_peaks, look.keep_on, true, &mut Vec::new())
    }
}

/// Local maxima of the sum along trails, highest over the noise first.
fn peaks_of(sum: &Plane, cells: &CellStatistics, noise: f32, look: &Look<'_>) -> Vec<Peak> {
    let mut sigmas = Vec::new();
    set_thresholds(cells, sum, 2, noise, &mut sigmas);
    let (columns, masked) = (sum.width.div_ceil(CELL_PX), look.masked_at(cells, 1));
    let border = (look.settings.border_px as usize / 2).max(MARGIN);
    let mut peaks = Vec::new();
    for y in border..sum.height.saturating_sub(border) {
        let rows = [sum.row(y - 1), sum.row(y), sum.row(y + 1)];
        for x in border..sum.width.saturating_sub(border) {
            let height = rows[1][x];
            let sigma = sigmas[y / CELL_PX * columns + x / CELL_PX];
            let around = || rows.iter().flat_map(|row| &row[x - 1..=x + 1]).all(|other| *other <= height);
            if height >= LEAST_SNR * sigma && around() && !masked(x, y) {
                peaks.push((Peak { x, y, height, cell: 0 }, height / sigma));
            }
        }
    }
    peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
    peaks.into_iter().take(MOST_PEAKS).map(|(peak, _)| peak).collect()
}

/// Adds a halved picture to a sum, shifted along a trail.
struct AddAlong<'a> {
    from: &'a Plane,
    kernel: &'a BTreeMap<(i32, i32), f32>,
    trail: &'a Trail,
    out: &'a mut Plane,
}

/// Columns and rows that are shifted together where the picture turns: over so few the turn moves nothing by a sample.
const BLOCK: usize = 64;

impl Kernel for AddAlong<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let AddAlong { from, kernel, trail, out } = self;
        let middle = centre(from.width, from.height);
        for (y, row) in out.pixels.chunks_exact_mut(from.width).enumerate() {
            for (block, row) in row.chunks_mut(BLOCK).enumerate() {
                let first = block * BLOCK;
                let here = ((first + BLOCK / 2) as f64, (y / BLOCK * BLOCK + BLOCK / 2) as f64);
                let there = trail.spun(here, middle);
                let (shift_x, shift_y) = ((there.0 - here.0).round() as i32, (there.1 - here.1).round() as i32);
                for (&(dx, dy), &weight) in kernel {
                    // Beyond the picture's border there is nothing above the level.
                    let (left, line) = (first as i32 + dx + shift_x, y as i32 + dy + shift_y);
                    let Some(line) = usize::try_from(line).ok().filter(|line| *line < from.height) else { continue };
                    let skipped = (-left).max(0) as usize;
                    let end = (from.width as i32 - left).clamp(0, row.len() as i32) as usize;
                    if skipped >= end {
                        continue;
                    }
                    let source = &from.row(line)[(left + skipped as i32) as usize..][..end - skipped];
                    for (sum, value) in row[skipped..end].iter_mut().zip(source) {
                        *sum += weight * value;
                    }
                }
            }
        }
    }
}

/// Noise of the sum along trails, smoothed as the search smooths it, over that of a sample of the first exposure.
fn noise_of(kernels: &[BTreeMap<(i32, i32), f32>], cells: &[CellStatistics]) -> f32 {
    let first = cells.first().map_or(1.0, |cells| cells.image_noise).max(f64::MIN_POSITIVE);
    let squares = kernels.iter().zip(cells).map(|(kernel, cells)| {
        let of_first = (cells.image_noise / first) as f32;
        overlap(kernel, (0, 0)) * of_first * of_first
    });
    squares.sum::<f32>().sqrt()
}

/// Σ of a smoothed kernel times itself, shifted.
fn overlap(kernel: &BTreeMap<(i32, i32), f32>, (dx, dy): (i32, i32)) -> f32 {
    // The smoothing twice over: five taps each way.
    let Taps { side } = SearchKernel::Sharp.taps();
    let middle = 1.0 - 2.0 * side;
    let twice = [side * side, 2.0 * side * middle, 2.0 * side * side + middle * middle, 2.0 * side * middle, side * side];
    let mut sum = 0.0;
    for (&(x, y), weight) in kernel {
        for (i, across) in (-2..).zip(twice) {
            for (j, down) in (-2..).zip(twice) {
                if let Some(other) = kernel.get(&(x - dx + i, y - dy + j)) {
                    sum += weight * other * across * down;
                }
            }
        }
    }
    sum
}

/// The peaks, highest first, without those that are the flanks of higher ones.
fn apart(peaks: Vec<(Peak, f32)>, kernels: &[BTreeMap<(i32, i32), f32>], least: f32) -> Vec<(Peak, f32)> {
    let all = |shift: (i32, i32)| kernels.iter().map(|kernel| overlap(kernel, shift)).sum::<f32>();
    let (whole, mut seen) = (all((0, 0)), BTreeMap::new());
    let cells = || kernels.iter().flat_map(BTreeMap::keys);
    let span = |part: fn(&(i32, i32)) -> i32| cells().map(part).max().unwrap_or(0) - cells().map(part).min().unwrap_or(0);
    let (wide, high) = (span(|cell| cell.0) + 4, span(|cell| cell.1) + 4);
    let mut kept: Vec<(Peak, f32)> = Vec::new();
    for (peak, height) in peaks {
        let flank = |(other, above): &(Peak, f32)| {
            let shift = (peak.x as i32 - other.x as i32, peak.y as i32 - other.y as i32);
            if shift.0.abs() > wide || shift.1.abs() > high {
                return 0.0;
            }
            above * *seen.entry(shift).or_insert_with(|| all(shift) / whole)
        };
        let light: f32 = kept.iter().map(flank).sum();
        if height - light >= ABOVE_NEIGHBOUR * least {
            kept.push((peak, height));
        }
    }
    kept
}

/// The centre of a peak's sample of the halved picture, px.
fn place(peak: &Peak) -> (f64, f64) {
    (2.0 * peak.x as f64 + 0.5, 2.0 * peak.y as f64 + 0.5)
}

/// Signal over noise of a star at a peak, against the sky beside its trails.
fn contrast(exposed: &[Exposed<'_>], peak: &Peak) -> f32 {
    let (x, y) = place(peak);
    let star = Fitted::at(x, y);
    let windows: Vec<Window<'_>> = exposed.iter().filter_map(|exposed| Window::around(exposed, x, y)).collect();
    let sums = equations(&windows, &star);
    (sums.data.x / sums.products.m11.max(f64::MIN_POSITIVE).sqrt()) as f32
}

/// The source of a peak, where a star can be fitted there.
fn source_at(exposed: &[Exposed<'_>], peak: &Peak) -> Option<Source> {
    let (x, y) = place(peak);
    let fitted = fit(exposed, x, y)?;
    let star_like = fitted.chi2 < MOST_CHI2 + CHI2_PER_SNR2 * fitted.snr * fitted.snr && !fitted.saturated;
    (fitted.snr >= f64::from(LEAST_SNR)).then_some(Source {
        x: fitted.x,
        y: fitted.y,
        sigma: fitted.sigma_px,
        flux: fitted.flux,
        snr: fitted.snr,
        confidence: fitted.snr,
        peak: fitted.peak,
        saturated: fitted.saturated,
        star_like,
    })
}

/// The pixels that a star lights in one exposure.
struct Window<'a> {
    exposed: &'a Exposed<'a>,
    centre: (f64, f64),
    /// Column, row, and value with lone hot pixels clipped, ADU.
    pixels: Vec<(f64, f64, f64)>,
    /// 1/σ² of a value.
    weight: f64,
    saturated: bool,
}

impl<'a> Window<'a> {
    /// Around a star's place at the origin; `None` where the star leaves the picture.
    fn around(exposed: &'a Exposed<'_>, x: f64, y: f64) -> Option<Self> {
        let Exposed { frame, cells, trail, table } = exposed;
        let centre = centre(frame.width, frame.height);
        let star = trail.spun((x, y), centre);
        let (left, top) = ((star.0 + table.x0).floor(), (star.1 + table.y0).floor());
        let (width, height) = ((table.width as f64 / FINE).ceil() as usize + 1, (table.height as f64 / FINE).ceil() as usize + 1);
        if left < 1.0 || top < 1.0 || left as usize + width + 1 > frame.width || top as usize + height + 1 > frame.height {
            return None;
        }
        let (x0, y0) = (left as usize, top as usize);
        let noise = cells.local_noise(x.max(0.0) as usize, y.max(0.0) as usize);
        let (limit, saturation) = (SPIKE_SIGMAS * noise, cells.saturation.unwrap_or(u16::MAX));
        let mut window = Self {
            exposed,
            centre,
            pixels: Vec::with_capacity(width * height),
            weight: 1.0 / f64::from(noise * noise).max(f64::MIN_POSITIVE),
            saturated: false,
        };
        for row in y0..y0 + height {
            let lines = [row - 1, row, row + 1].map(|y| &frame.pixels[y * frame.width + x0 - 1..][..width + 2]);
            for i in 0..width {
                let (column, line) = ((x0 + i) as f64, row as f64);
                if table.at(column - star.0, line - star.1)[0] <= 0.0 {
                    continue;
                }
                let [above, here, below] = lines.map(|line| [line[i], line[i + 1], line[i + 2]]);
                let highest = above.into_iter().chain(below).chain([here[0], here[2]]).max().unwrap_or(here[1]);
                window.saturated |= here[1] >= saturation;
                window.pixels.push((column, line, f64::from(f32::from(here[1]).min(f32::from(highest) + limit))));
            }
        }
        Some(window)
    }

    /// Adds to the normal equations of (flux, x, y); the sky's level is of its own in each exposure, and taken out.
    fn add(&self, at: &Fitted, equations: &mut Equations) {
        let n = self.pixels.len().max(1) as f64;
        let star = self.exposed.trail.spun((at.x, at.y), self.centre);
        let (mut means, mut products, mut with_data) = (Vector3::zeros(), Matrix3::zeros(), Vector3::zeros());
        let (mut data, mut squares) = (0.0, 0.0);
        for (x, y, value) in &self.pixels {
            let [light, along_x, along_y] = self.exposed.table.at(x - star.0, y - star.1);
            let left = value - at.flux * light;
            let row = Vector3::new(light, at.flux * along_x, at.flux * along_y);
            data += left;
            squares += left * left;
            means += row;
            products += row * row.transpose();
            with_data += row * left;
        }
        equations.products += (products - means * means.transpose() / n) * self.weight;
        equations.data += (with_data - means * (data / n)) * self.weight;
        equations.chi2 += (squares - data * data / n) * self.weight;
        equations.values += self.pixels.len();
    }
}

/// The sums of a fit.
struct Equations {
    products: Matrix3<f64>,
    data: Vector3<f64>,
    chi2: f64,
    values: usize,
}

fn equations(windows: &[Window<'_>], at: &Fitted) -> Equations {
    let mut sums = Equations { products: Matrix3::zeros(), data: Vector3::zeros(), chi2: 0.0, values: 0 };
    windows.iter().for_each(|window| window.add(at, &mut sums));
    sums
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
    let first = equations(&windows, &star);
    star.flux = first.data.x / first.products.m11;
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
    // Without some of the exposures what the trails of the others lie off shows in full.
    let apart = if windows.len() < exposed.len() { exposed.iter().map(|e| e.trail.sigma_px).fold(0.0, f64::max) } else { 0.0 };
    star.snr = star.flux / covariance.m11.sqrt();
    // The bound is reached where the signal is strong alone.
    let faint = 1.0 + FAINT_SCATTER / (star.snr * star.snr);
    star.sigma_px = (0.5 * (covariance.m22 + covariance.m33) * faint * faint + apart * apart).sqrt();
    star.chi2 = sums.chi2 / sums.values.saturating_sub(3 + windows.len()).max(1) as f64;
    star.peak = star.flux * f64::from(exposed.iter().flat_map(|e| &e.table.samples).copied().fold(0.0, f32::max));
    star.snr.is_finite().then_some(star)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use crate::sky::RowOrder;

    const SKY_ADU: f64 = 1300.0;
    const NOISE_ADU: f64 = 8.0;

    /// Noise by the sum of twelve uniform numbers of a plain generator.
    struct Noise(u64);

    impl Noise {
        fn next(&mut self) -> f64 {
            let mut uniform = || {
                self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (self.0 >> 11) as f64 / (1u64 << 53) as f64
            };
            (0..12).map(|_| uniform()).sum::<f64>() - 6.0
        }
    }

    /// A trail on a straight way from one offset to another.
    fn trail(from: (f64, f64), to: (f64, f64), share: f64, spin: f64) -> Trail {
        let place = |i: u32| {
            let part = (f64::from(i) + 0.5) / 60.0;
            (from.0 + part * (to.0 - from.0), from.1 + part * (to.1 - from.1))
        };
        Trail { places: (0..60).map(place).collect(), share, spin, sigma_px: 0.3 }
    }

    /// Exposures of stars at places, of a flux in all of them together.
    fn expose(trails: &[Trail], stars: &[(f64, f64, f64)]) -> Vec<Frame> {
        let (width, height) = (320, 256);
        let mut noise = Noise(7);
        let expose = |trail: &Trail| {
            let mut light = vec![0.0; width * height];
            for (x, y, flux) in stars {
                let star = trail.spun((*x, *y), centre(width, height));
                for (dx, dy) in &trail.places {
                    let (sx, sy) = (star.0 + dx, star.1 + dy);
                    for j in (sy - 6.0).max(0.0) as usize..((sy + 6.0) as usize).min(height) {
                        for i in (sx - 6.0).max(0.0) as usize..((sx + 6.0) as usize).min(width) {
                            let r2 = (i as f64 - sx).powi(2) + (j as f64 - sy).powi(2);
                            let share = trail.share / trail.places.len() as f64;
                            light[j * width + i] += flux * share * (-0.5 * r2 / 1.083).exp() / (std::f64::consts::TAU * 1.083);
                        }
                    }
                }
            }
            let pixels = light.iter().map(|light| (SKY_ADU + light + NOISE_ADU * noise.next()).round() as u16).collect();
            Frame::new(width, height, pixels, RowOrder::BottomFirst).unwrap()
        };
        trails.iter().map(expose).collect()
    }

    fn find(trails: &[Trail], frames: &[Frame]) -> Vec<Source> {
        let settings = Settings::flight().unwrap();
        let look = Look { settings: &settings.solver.sources, masked: &|_, _| false, keep_on: &|| true };
        let mut cells = vec![CellStatistics::default(); frames.len()];
        cells.iter_mut().zip(frames).for_each(|(cells, frame)| cells.measure(frame, None));
        let mut sources = Vec::new();
        assert!(Finder::default().find_along(&frames.iter().collect::<Vec<_>>(), &cells, trails, &look, &mut sources));
        sources
    }

    #[test]
    fn stars_are_found_where_they_were_at_the_start_whichever_way_they_go() {
        let stars = [(90.3, 100.6, 900.0), (200.0, 150.0, 700.0), (150.8, 70.2, 800.0)];
        let mut chi2 = 0.0;
        for (dx, dy) in [(12.0, 5.0), (-12.0, 5.0), (12.0, -9.0), (-3.0, -14.0), (0.0, 18.0), (-16.0, 0.0)] {
            let trails = [trail((0.0, 0.0), (dx, dy), 0.5, 0.0), trail((1.5 * dx, 1.5 * dy), (2.5 * dx, 2.5 * dy), 0.5, 0.004)];
            let sources = find(&trails, &expose(&trails, &stars));
            for (x, y, flux) in stars {
                let near = sources.iter().take(6).find(|source| (source.x - x).hypot(source.y - y) < 3.0);
                let near = near.unwrap_or_else(|| panic!("{dx} {dy}: none at {x} {y} of {sources:?}"));
                assert!((near.flux / flux - 1.0).abs() < 4.0 / near.snr, "{dx} {dy}: flux {} for {flux}", near.flux);
                assert!(near.star_like && near.snr > 4.5, "{near:?}");
                chi2 += ((near.x - x).powi(2) + (near.y - y).powi(2)) / near.sigma.powi(2) / 36.0;
            }
        }
        assert!((0.5..1.8).contains(&chi2), "{chi2}");
    }

    #[test]
    fn the_signal_of_several_exposures_grows_with_their_root() {
        let stars = [(150.0, 120.0, 2400.0)];
        let snr = |count: u32| {
            let share = 1.0 / f64::from(count);
            let trails: Vec<Trail> = (0..count).map(|_| trail((0.0, 0.0), (10.0, 4.0), share, 0.0)).collect();
            // As much light in each exposure.
            let stars = stars.map(|(x, y, flux)| (x, y, flux * f64::from(count) / 4.0));
            find(&trails, &expose(&trails, &stars))[0].snr
        };
        let gain = snr(4) / snr(1);
        assert!((gain / 2.0 - 1.0).abs() < 0.1, "{gain}");
    }
}
