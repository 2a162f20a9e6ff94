//! The search for sources at one scale, from pixels to a ranked list.

#![allow(clippy::indexing_slicing, reason = "a candidate's patch is among the patches of the same search")]

use super::light::{KnownStar, Light, PlacedStar};
use super::lines;
use super::measure::{CoreTemplate, HALF, Patch, Shape, Standing, centroid, moments};
use super::peaks::{Peak, PeakFinder, PeakRules, Taps};
use super::plane::{Clipped, Picture, Plane, halve};
use crate::image::{CELL_PX, CellStatistics, Frame};
use crate::settings::SourceSettings;
use crate::sky::{Kernel, with_vectors};

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
    /// On a line across the picture.
    in_line: bool,
}

impl Candidate {
    /// Whether it has the shape of a star and is no part of a line.
    fn is_star_like(&self) -> bool {
        self.standing.is_star_like() && !self.in_line
    }
}

/// Peaks kept in a cell for each source that it may give, so that artefacts do not push stars out before they are recognised.
const PEAKS_PER_SOURCE: usize = 12;
/// Sources nearer to a better one than this are part of it, samples.
const SEPARATION: f32 = 4.0;
/// What a point spread function is taken to be until the frame shows it: σ, samples.
const FIRST_SIGMA: f32 = 1.0;
/// Stars that the frame's own shape is taken from, the signal they need, and how many make a median.
const SHAPE_STARS: usize = 20;
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
    /// How far a pixel may stand above its neighbours.
    excess: Vec<u16>,
    /// The picture at scales 1, 2, …
    halved: Vec<Plane>,
    /// Scales of `halved` that belong to the present frame.
    halved_ready: usize,
    finder: PeakFinder,
    peaks: Vec<Peak>,
    thresholds: Vec<f32>,
    patches: Vec<Patch>,
    candidates: Vec<Candidate>,
    kept: Vec<Peak>,
    /// σ of the frame's point spread function at the last search, px: long and short axis.
    pub psf_axes: Option<(f64, f64)>,
}

impl Finder {
    /// Takes up a frame: call once, before [`Self::find`] at any scale.
    pub fn begin(&mut self, frame: &Frame, cells: &CellStatistics) {
        Clipped::excess_of(frame, cells, &mut self.excess);
        self.halved_ready = 0;
        self.psf_axes = None;
    }

    /// Finds the sources of the frame; `false` where it was told not to keep on.
    pub fn find(&mut self, frame: &Frame, cells: &CellStatistics, look: &Look<'_>, sources: &mut Vec<Source>) -> bool {
        let &Look { settings, scale, masked, keep_on } = look;
        sources.clear();
        // Stars as sharp as the optics make them are found in the picture halved once, and measured in the picture itself.
        let (search_scale, taps, ring) = if scale == 0 { (1, Taps::SHARP, 1) } else { (scale, Taps::WIDE, 2) };
        self.prepare_scale(frame, search_scale);
        let Some(plane) = self.halved.get(search_scale - 1) else { return true };
        let search_bin = 1usize << search_scale;
        set_thresholds(
            cells,
            plane,
            search_bin,
            settings.snr_threshold as f32 * taps.noise() / Taps::WIDE.noise(),
            &mut self.thresholds,
        );
        let rules = PeakRules {
            taps,
            ring,
            border: (settings.border_px as usize / search_bin).max(HALF + 1),
            cell: rules_cell(settings, search_scale),
            per_cell: settings.max_per_cell as usize * PEAKS_PER_SOURCE,
            thresholds: &self.thresholds,
            threshold_columns: plane.width.div_ceil(CELL_PX),
            masked: &|x, y| masked(x * search_bin, y * search_bin),
        };
        if !self.finder.find(plane, &rules, keep_on, None, &mut self.peaks) {
            return false;
        }
        let bin = 1usize << scale;
        let noise = |x: usize, y: usize| cells.local_noise(x * bin, y * bin) / bin as f32;
        let lists = (&mut self.candidates, &mut self.patches);
        let (peaks, least) = (&self.peaks, settings.min_snr as f32);
        if scale == 0 {
            let picture = &Clipped::new(frame, &self.excess);
            with_vectors(MeasurePeaks { picture, finer: search_bin, peaks, noise: &noise, least, lists });
        } else {
            with_vectors(MeasurePeaks { picture: plane, finer: 1, peaks, noise: &noise, least, lists });
        }
        let saturation = cells.saturation.map_or(f32::INFINITY, |level| SATURATED_FROM * f32::from(level));
        for candidate in &mut self.candidates {
            candidate.saturated = self.patches[candidate.patch].highest() >= saturation;
        }
        self.mark_lines();
        self.rank(rules_cell(settings, scale), settings.max_per_cell as usize, settings.max_found as usize);
        with_vectors(MeasureSources { finder: self, cells, bin, sources });
        // Stars first; among equals the surest first. A stable sort, so that the same frame gives the same order.
        sources.sort_by(|a, b| b.star_like.cmp(&a.star_like).then(b.confidence.total_cmp(&a.confidence)));
        true
    }

    /// Where the light of stars at known places lies, brightest first; `None` where it cannot be told.
    pub fn light(&self, cells: &CellStatistics, stars: &[KnownStar]) -> Option<Light> {
        Light::of(self.halved.first()?, cells, stars)
    }

    /// Measures a star near its place by the light of all.
    pub fn place(&self, cells: &CellStatistics, light: &Light, star: &KnownStar) -> Option<PlacedStar> {
        light.place(self.halved.first()?, cells, star)
    }

    /// Makes the halved pictures up to a scale.
    fn prepare_scale(&mut self, frame: &Frame, scale: usize) {
        self.halved.resize_with(self.halved.len().max(scale), Plane::default);
        while self.halved_ready < scale {
            let (done, rest) = self.halved.split_at_mut(self.halved_ready);
            if let Some(out) = rest.first_mut() {
                match done.last() {
                    Some(from) => halve(from, out),
                    None => halve(&Clipped::new(frame, &self.excess), out),
                }
            }
            self.halved_ready += 1;
        }
    }

    /// Marks what lies on the lines that several ridges make.
    fn mark_lines(&mut self) {
        let place = |c: &Candidate| (c.peak.x as f32, c.peak.y as f32);
        let mut ridges: Vec<&Candidate> = self.candidates.iter().filter(|c| c.standing.on_ridge).collect();
        ridges.sort_by(|a, b| b.standing.snr.total_cmp(&a.standing.snr));
        let lines = lines::find(ridges.into_iter().map(place).collect());
        for candidate in self.candidates.iter_mut().filter(|_| !lines.is_empty()) {
            candidate.in_line = lines.iter().any(|line| line.passes(place(candidate)));
        }
    }

    /// Sorts the candidates (stars first, surest first), leaves out parts of better ones and what a cell has too many of.
    fn rank(&mut self, cell: usize, per_cell: usize, most: usize) {
        self.candidates.sort_by(|a, b| {
            let stars_first = b.is_star_like().cmp(&a.is_star_like());
            stars_first.then(b.standing.confidence.total_cmp(&a.standing.confidence))
        });
        let kept = &mut self.kept;
        kept.clear();
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
    #[inline(always)]
    fn frame_shape(&self) -> Option<Shape> {
        let good = |c: &&Candidate| c.is_star_like() && c.standing.snr >= SHAPE_SNR && !c.saturated;
        let mut shapes = [Shape::round(FIRST_SIGMA); SHAPE_STARS];
        let mut count = 0;
        for candidate in self.candidates.iter().filter(good).take(SHAPE_STARS) {
            let patch = &self.patches[candidate.patch];
            if let Some(shape) = moments(patch, candidate.standing.base, Shape::round(FIRST_SIGMA)) {
                shapes[count] = shape;
                count += 1;
            }
        }
        let shapes = &shapes[..count];
        if count < SHAPE_MIN_STARS {
            return None;
        }
        let median = |part: fn(&Shape) -> f32| {
            let mut values = [f32::INFINITY; SHAPE_STARS];
            shapes.iter().zip(&mut values).for_each(|(shape, value)| *value = part(shape));
            values[..count].sort_unstable_by(f32::total_cmp);
            values[count / 2]
        };
        Some(Shape { xx: median(|s| s.xx), yy: median(|s| s.yy), xy: median(|s| s.xy) })
    }
}

/// Thresholds of the blocks of a plane of which a sample is the mean of `bin`² pixels: the noise of a mean falls with their number.
fn set_thresholds(cells: &CellStatistics, plane: &Plane, bin: usize, snr: f32, thresholds: &mut Vec<f32>) {
    thresholds.clear();
    for y in 0..plane.height.div_ceil(CELL_PX) {
        for x in 0..plane.width.div_ceil(CELL_PX) {
            let noise = cells.local_noise((x * CELL_PX + CELL_PX / 2) * bin, (y * CELL_PX + CELL_PX / 2) * bin);
            thresholds.push((snr * noise / bin as f32).max(f32::MIN_POSITIVE));
        }
    }
}

/// A sample this close to the saturation level is saturated: the clipping and averaging of the search take a little off.
const SATURATED_FROM: f32 = 0.98;

/// Cuts and measures every peak with a first guess of the shape; keeps those that stand out.
struct MeasurePeaks<'a, P> {
    picture: &'a P,
    /// Samples of the picture along one sample of the plane that the peaks were found in.
    finer: usize,
    peaks: &'a [Peak],
    noise: &'a dyn Fn(usize, usize) -> f32,
    /// Least signal to noise.
    least: f32,
    lists: (&'a mut Vec<Candidate>, &'a mut Vec<Patch>),
}

impl<P: Picture> Kernel for MeasurePeaks<'_, P> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let MeasurePeaks { picture, finer, peaks, noise, least, lists: (candidates, patches) } = self;
        candidates.clear();
        patches.clear();
        let template = CoreTemplate::new(&Shape::round(FIRST_SIGMA));
        for &peak in peaks {
            let mut peak = Peak { x: peak.x * finer, y: peak.y * finer, ..peak };
            let Some(mut patch) = Patch::cut(picture, peak.x, peak.y) else { continue };
            if finer > 1 {
                let (dx, dy) = patch.summit(finer);
                if (dx, dy) != (0, 0) {
                    (peak.x, peak.y) = (peak.x.wrapping_add_signed(dx), peak.y.wrapping_add_signed(dy));
                    let Some(centred) = Patch::cut(picture, peak.x, peak.y) else { continue };
                    patch = centred;
                }
            }
            patch.level_out();
            let sigma = noise(peak.x, peak.y);
            let standing = Standing::measure(&patch, &template, sigma);
            if standing.confidence >= least {
                candidates.push(Candidate { peak, patch: patches.len(), sigma, standing, saturated: false, in_line: false });
                patches.push(patch);
            }
        }
    }
}

/// Measures what is left again with the frame's own shape, and fits the centres.
struct MeasureSources<'a> {
    finder: &'a mut Finder,
    cells: &'a CellStatistics,
    bin: usize,
    sources: &'a mut Vec<Source>,
}

impl Kernel for MeasureSources<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let MeasureSources { finder, cells, bin, sources } = self;
        let shape = finder.frame_shape();
        finder.psf_axes = shape.map(|s| s.axes()).map(|(a, b)| (f64::from(a) * bin as f64, f64::from(b) * bin as f64));
        let shape = shape.unwrap_or(Shape::round(FIRST_SIGMA));
        // The gain of a mean of bin² pixels.
        let gain = (cells.gain.unwrap_or(USUAL_GAIN) / (bin * bin) as f64) as f32;
        let template = CoreTemplate::new(&shape);
        for candidate in &mut finder.candidates {
            let patch = &finder.patches[candidate.patch];
            candidate.standing = Standing::measure(patch, &template, candidate.sigma);
            sources.push(source_of(candidate, patch, &shape, gain, bin));
        }
    }
}

/// Side of the cells that limit crowding, samples of a scale.
fn rules_cell(settings: &SourceSettings, scale: usize) -> usize {
    (settings.cell_px as usize >> scale).max(CELL_PX)
}

/// The source of a candidate: its centre where the fit finds one, else its peak with an error of half a sample.
#[inline(always)]
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
        star_like: candidate.is_star_like() && fitted.is_some() && !candidate.saturated,
    }
}
