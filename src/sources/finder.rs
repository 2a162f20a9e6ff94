//! The search for sources at one scale, from pixels to a ranked list.

#![allow(clippy::indexing_slicing, reason = "a candidate's patch is among the patches of the same search")]

use super::measure::{CoreTemplate, HALF, Patch, Shape, Standing, centroid, moments};
use super::peaks::{Peak, PeakFinder, PeakRules};
use super::plane::{Plane, clip_spikes, halve};
use crate::image::{CELL_PX, CellStatistics, Frame};
use crate::settings::SourceSettings;

/// A source, brightest first in a list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Source {
    /// Position in file order, px.
    pub x: f64,
    /// Position in file order, px.
    pub y: f64,
    /// One σ of the position per axis, px.
    pub sigma: f64,
    /// Flux above the surroundings, ADU.
    pub flux: f64,
    /// Matched-filter signal over noise.
    pub snr: f64,
    /// Signal over noise against the brighter surroundings: what sources are ranked by.
    pub confidence: f64,
    /// Highest pixel above the surroundings, ADU.
    pub peak: f64,
    /// Whether a pixel of it is saturated.
    pub saturated: bool,
    /// Whether it has the shape of a star; those that do not are ranked last.
    pub star_like: bool,
}

/// A peak on its way to a source.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    peak: Peak,
    /// Its place among the patches, which are large and stay where they are.
    patch: usize,
    sigma: f32,
    standing: Standing,
    saturated: bool,
}

/// Peaks kept in a cell for each source that it may give, so that artefacts do not push stars out before they are recognised.
const PEAKS_PER_SOURCE: usize = 4;
/// A pixel this many times the noise above all its neighbours is clipped for the search.
const SPIKE_SIGMAS: f64 = 3.0;
/// Sources nearer to a better one than this are part of it, samples.
const SEPARATION: f32 = 4.0;
/// What a point spread function is taken to be until the frame shows it: σ, samples.
const FIRST_SIGMA: f32 = 1.0;
/// Stars that the frame's own shape is taken from, the signal they need, and how many make a median.
const SHAPE_STARS: usize = 30;
const SHAPE_SNR: f32 = 10.0;
const SHAPE_MIN_STARS: usize = 3;
/// Gain where the frame does not show its own, ADU/e⁻: that of the cameras that flew.
const USUAL_GAIN: f64 = 0.041;

/// How to look for sources.
pub struct Look<'a> {
    /// Thresholds and limits.
    pub settings: &'a SourceSettings,
    /// 0 is the picture itself, each further scale halves it.
    pub scale: usize,
    /// Whether a place, px, is left out.
    pub masked: &'a dyn Fn(usize, usize) -> bool,
    /// Asked every few rows.
    pub keep_on: &'a dyn Fn() -> bool,
}

/// Finds sources, in the memory of the last frame.
#[derive(Debug, Clone, Default)]
pub struct Finder {
    clipped: Plane<u16>,
    /// The picture at scales 1, 2, …
    halved: Vec<Plane<f32>>,
    /// Scales of `halved` that belong to the present frame.
    halved_ready: usize,
    finder: PeakFinder,
    peaks: Vec<Peak>,
    thresholds: Vec<f32>,
    patches: Vec<Patch>,
    candidates: Vec<Candidate>,
    /// σ of the frame's point spread function at the last search, px: long and short axis.
    pub psf_axes: Option<(f64, f64)>,
}

impl Finder {
    /// Takes up a frame: call once, before [`Self::find`] at any scale.
    pub fn begin(&mut self, frame: &Frame, cells: &CellStatistics) {
        let excess = (SPIKE_SIGMAS * cells.image_noise).ceil().clamp(1.0, f64::from(u16::MAX)) as u16;
        clip_spikes(&frame.pixels, frame.width, frame.height, excess, &mut self.clipped);
        self.halved_ready = 0;
        self.psf_axes = None;
    }

    /// Finds the sources of the frame; `false` where it was told not to keep on.
    pub fn find(&mut self, frame: &Frame, cells: &CellStatistics, look: &Look<'_>, sources: &mut Vec<Source>) -> bool {
        let &Look { settings, scale, masked, keep_on } = look;
        sources.clear();
        self.candidates.clear();
        self.patches.clear();
        let bin = 1usize << scale;
        self.prepare_scale(scale);
        let (width, height) = (frame.width >> scale, frame.height >> scale);
        self.set_thresholds(cells, width, height, scale, settings.snr_threshold as f32);
        let rules = PeakRules {
            border: (settings.border_px as usize >> scale).max(HALF),
            cell: (settings.cell_px as usize >> scale).max(CELL_PX),
            per_cell: settings.max_per_cell as usize * PEAKS_PER_SOURCE,
            thresholds: &self.thresholds,
            threshold_columns: width.div_ceil(CELL_PX),
            masked: &|x, y| masked(x * bin, y * bin),
        };
        let finished = match self.halved.get(scale.wrapping_sub(1)) {
            Some(plane) => self.finder.find(plane, &rules, keep_on, &mut self.peaks),
            None => self.finder.find(&self.clipped, &rules, keep_on, &mut self.peaks),
        };
        if !finished {
            return false;
        }
        self.measure_candidates(frame, cells, scale, settings.min_snr as f32);
        self.rank(rules_cell(settings, scale), settings.max_per_cell as usize, settings.max_found as usize);
        let shape = self.frame_shape();
        self.psf_axes = shape.map(|s| s.axes()).map(|(a, b)| (f64::from(a) * bin as f64, f64::from(b) * bin as f64));
        let shape = shape.unwrap_or(Shape::round(FIRST_SIGMA));
        // The gain of a mean of bin² pixels.
        let gain = (cells.gain.unwrap_or(USUAL_GAIN) / (bin * bin) as f64) as f32;
        let template = CoreTemplate::new(&shape);
        for candidate in &mut self.candidates {
            let patch = &self.patches[candidate.patch];
            candidate.standing = Standing::measure(patch, &template, candidate.sigma);
            sources.push(source_of(candidate, patch, &shape, gain, bin));
        }
        // Stars first; among equals the surest first. A stable sort, so that the same frame gives the same order.
        sources.sort_by(|a, b| b.star_like.cmp(&a.star_like).then(b.confidence.total_cmp(&a.confidence)));
        true
    }

    /// Makes the halved pictures up to a scale.
    fn prepare_scale(&mut self, scale: usize) {
        self.halved.resize_with(self.halved.len().max(scale), Plane::default);
        while self.halved_ready < scale {
            let (done, rest) = self.halved.split_at_mut(self.halved_ready);
            if let Some(out) = rest.first_mut() {
                match done.last() {
                    Some(from) => halve(from, out),
                    None => halve(&self.clipped, out),
                }
            }
            self.halved_ready += 1;
        }
    }

    /// Thresholds of the blocks of a scale: the noise of a mean of pixels falls with their number.
    fn set_thresholds(&mut self, cells: &CellStatistics, width: usize, height: usize, scale: usize, snr: f32) {
        let bin = 1usize << scale;
        self.thresholds.clear();
        for y in 0..height.div_ceil(CELL_PX) {
            for x in 0..width.div_ceil(CELL_PX) {
                let noise = cells.local_noise((x * CELL_PX + CELL_PX / 2) * bin, (y * CELL_PX + CELL_PX / 2) * bin);
                self.thresholds.push((snr * noise / bin as f32).max(f32::MIN_POSITIVE));
            }
        }
    }

    /// Cuts and measures every peak with a first guess of the shape; keeps those that stand out.
    fn measure_candidates(&mut self, frame: &Frame, cells: &CellStatistics, scale: usize, min_snr: f32) {
        let bin = 1usize << scale;
        let template = CoreTemplate::new(&Shape::round(FIRST_SIGMA));
        for &peak in &self.peaks {
            let patch = match self.halved.get(scale.wrapping_sub(1)) {
                Some(plane) => Patch::cut(plane, peak.x, peak.y),
                None => Patch::cut(&self.clipped, peak.x, peak.y).map(|mut patch| {
                    patch.restore_core(&frame.pixels, frame.width, peak.x, peak.y);
                    patch
                }),
            };
            let Some(patch) = patch else { continue };
            let sigma = cells.local_noise(peak.x * bin, peak.y * bin) / bin as f32;
            let standing = Standing::measure(&patch, &template, sigma);
            if standing.confidence >= min_snr {
                let saturated = cells.saturation.is_some_and(|level| patch.highest() >= 0.98 * f32::from(level));
                self.candidates.push(Candidate { peak, patch: self.patches.len(), sigma, standing, saturated });
                self.patches.push(patch);
            }
        }
    }

    /// Sorts the candidates (stars first, surest first), leaves out parts of better ones and what a cell has too many of.
    fn rank(&mut self, cell: usize, per_cell: usize, most: usize) {
        self.candidates.sort_by(|a, b| {
            let stars_first = b.standing.is_star_like().cmp(&a.standing.is_star_like());
            stars_first.then(b.standing.confidence.total_cmp(&a.standing.confidence))
        });
        let mut kept: Vec<Peak> = Vec::with_capacity(most);
        self.candidates.retain(|c| {
            let of_cell = |p: &&Peak| p.x / cell == c.peak.x / cell && p.y / cell == c.peak.y / cell;
            let distance_sq = |p: &Peak| (p.x as f32 - c.peak.x as f32).powi(2) + (p.y as f32 - c.peak.y as f32).powi(2);
            let keep = kept.len() < most
                && kept.iter().filter(of_cell).count() < per_cell
                && kept.iter().all(|p| distance_sq(p) >= SEPARATION * SEPARATION);
            if keep {
                kept.push(c.peak);
            }
            keep
        });
    }

    /// The median shape of the better stars, where there are enough.
    fn frame_shape(&self) -> Option<Shape> {
        let good = |c: &&Candidate| c.standing.is_star_like() && c.standing.snr >= SHAPE_SNR && !c.saturated;
        let shapes: Vec<Shape> = self
            .candidates
            .iter()
            .filter(good)
            .take(SHAPE_STARS)
            .filter_map(|c| moments(&self.patches[c.patch], c.standing.base, Shape::round(FIRST_SIGMA)))
            .collect();
        if shapes.len() < SHAPE_MIN_STARS {
            return None;
        }
        let median = |part: fn(&Shape) -> f32| {
            let mut values: Vec<f32> = shapes.iter().map(part).collect();
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied()
        };
        Some(Shape { xx: median(|s| s.xx)?, yy: median(|s| s.yy)?, xy: median(|s| s.xy)? })
    }
}

/// Side of the cells that limit crowding, samples of a scale.
fn rules_cell(settings: &SourceSettings, scale: usize) -> usize {
    (settings.cell_px as usize >> scale).max(CELL_PX)
}

/// The source of a candidate: its centre where the fit finds one, else its peak with an error of half a sample.
fn source_of(candidate: &Candidate, patch: &Patch, shape: &Shape, gain: f32, bin: usize) -> Source {
    let fitted = centroid(patch, &candidate.standing, shape, candidate.sigma, gain);
    let (dx, dy, sigma, flux) = match fitted {
        Some(c) => (c.x, c.y, c.sigma, c.flux),
        None => (0.0, 0.0, 0.5, candidate.standing.flux),
    };
    let bin = bin as f64;
    // The centre of sample i of a halved picture is at bin·(i + ½) − ½ of the picture.
    let place = |i: usize, d: f32| bin * (i as f64 + f64::from(d) + 0.5) - 0.5;
    Source {
        x: place(candidate.peak.x, dx),
        y: place(candidate.peak.y, dy),
        sigma: bin * f64::from(sigma),
        flux: f64::from(flux) * bin * bin,
        snr: f64::from(candidate.standing.snr),
        confidence: f64::from(candidate.standing.confidence),
        peak: f64::from(patch.highest() - candidate.standing.base),
        saturated: candidate.saturated,
        star_like: candidate.standing.is_star_like() && fitted.is_some() && !candidate.saturated,
    }
}
