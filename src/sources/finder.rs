//! The search for sources at one scale, from pixels to a ranked list.

#![allow(clippy::indexing_slicing, reason = "a candidate's patch is among the patches of the same search")]

use super::blur::{self, Figure};
use super::centroid::{centroid, moments};
use super::kernel::SearchKernel;
use super::light::{KnownStar, Light, PlacedStar};
use super::lines;
use super::measure::{CoreTemplate, Patch, Shape, Standing, summit};
use super::motion::Trailed;
use super::peaks::{Peak, PeakFinder, PeakRules, Taps};
use super::plane::{Clipped, HalveScratch, MARGIN, Picture, Plane, halve};
use super::survey::Survey;
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
    /// What else is known of one that was found along known trails.
    pub trailed: Option<Trailed>,
}

impl Look<'_> {
    /// Whether a sample of the picture halved `scale` times is masked, or at the border of a saturated area.
    pub(super) fn masked_at(&self, cells: &CellStatistics, scale: usize) -> impl Fn(usize, usize) -> bool {
        move |x, y| (self.masked)(x << scale, y << scale) || cells.is_beside_clipped(x << scale, y << scale)
    }

    /// The rules for a search in a plane.
    pub(super) fn rules<'r>(
        &self,
        kernel: SearchKernel,
        plane: &Plane,
        thresholds: &'r [f32],
        masked: &'r dyn Fn(usize, usize) -> bool,
    ) -> PeakRules<'r> {
        let scale = kernel.search_scale();
        PeakRules {
            taps: kernel.taps(),
            ring: kernel.ring(),
            border: (self.settings.border_px as usize >> scale).max(MARGIN),
            cell: rules_cell(self.settings, scale),
            per_cell: self.settings.max_per_cell as usize * if kernel == SearchKernel::Sharp { SHARP_PEAKS } else { WIDE_PEAKS },
            thresholds,
            threshold_columns: plane.width.div_ceil(CELL_PX),
            masked,
        }
    }
}

/// A peak on its way to a source.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    peak: Peak,
    /// Its place among the patches, which are large and stay where they are.
    patch: usize,
    sigma: f32,
    pub(super) standing: Standing,
    saturated: bool,
    /// On a line across the picture.
    in_line: bool,
}

impl Candidate {
    /// Whether it has the shape of a star and is no part of a line.
    pub(super) fn is_star_like(&self) -> bool {
        self.standing.is_star_like() && !self.in_line
    }
}

/// Where a candidate lies that was kept.
#[derive(Debug, Clone, Copy)]
struct Kept {
    x: f32,
    y: f32,
    cell: (usize, usize),
}

/// Peaks kept in a cell for each source that it may give, so that artefacts do not push stars out before they are recognised. (Trials:
/// with half as many sharp ones 3 of 220 frames with edges are lost.)
const SHARP_PEAKS: usize = 12;
const WIDE_PEAKS: usize = 6;
/// Sources nearer to a better one than this are part of it, samples.
const SEPARATION: f32 = 4.0;
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
    scratch: HalveScratch,
    /// Scales of `halved` that belong to the present frame.
    halved_ready: usize,
    pub(super) finder: PeakFinder,
    pub(super) peaks: Vec<Peak>,
    /// Peaks of the kernels that were surveyed, and how much stands out in each.
    pub(super) surveyed: Vec<Survey>,
    pub(super) thresholds: Vec<f32>,
    /// Of the candidates, as they were found; what is left of an earlier frame may follow.
    patches: Vec<Patch>,
    /// In the order of the sources, once these are measured.
    pub(super) candidates: Vec<Candidate>,
    /// Sources of the last search whose centres are fitted: the first ones.
    fitted: usize,
    optics: Optics,
    kept: Vec<Kept>,
    /// σ of the frame's point spread function at the last search, px: long and short axis.
    pub psf_axes: Option<(f64, f64)>,
}

impl Finder {
    /// Takes up a frame: call once, before [`Self::find`] at any scale.
    pub fn begin(&mut self, frame: &Frame, cells: &CellStatistics) {
        Clipped::excess_of(frame, cells, &mut self.excess);
        self.halved_ready = 0;
        self.psf_axes = None;
        self.surveyed.clear();
    }

    /// Measures the peaks with the first guess of a kernel's shape. `sources_follow`: whether the patches are measured further.
    pub(super) fn measure_peaks(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        kernel: SearchKernel,
        sources_follow: bool,
    ) {
        let scale = kernel.scale();
        let bin = 1usize << scale;
        let noise = |x: usize, y: usize| cells.local_noise(x * bin, y * bin) / bin as f32;
        let lists = (&mut self.candidates, &mut self.patches);
        let (peaks, least) = (&self.peaks, look.settings.min_snr as f32);
        // A trail is a ridge.
        let ridges = !matches!(kernel, SearchKernel::Trail { .. });
        let (shape, level_out) = (kernel.shape(), ridges || sources_follow);
        match self.halved.get(scale.wrapping_sub(1)) {
            Some(picture) => {
                with_vectors(MeasurePeaks { picture, finer: 1, shape, ridges, level_out, peaks, noise: &noise, least, lists })
            }
            None => {
                let (picture, finer) = (&Clipped::new(frame, &self.excess), 1 << kernel.search_scale());
                with_vectors(MeasurePeaks { picture, finer, shape, ridges, level_out, peaks, noise: &noise, least, lists });
            }
        }
    }

    /// Finds the sources of the frame; `false` where it was told not to keep on.
    pub fn find(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        kernel: SearchKernel,
        sources: &mut Vec<Source>,
    ) -> bool {
        sources.clear();
        let mut peaks = std::mem::take(&mut self.peaks);
        let finished = match self.surveyed.iter_mut().find(|survey| survey.kernel == kernel) {
            Some(survey) => {
                std::mem::swap(&mut peaks, &mut survey.peaks);
                true
            }
            None => self.find_peaks(frame, cells, look, kernel, &mut peaks),
        };
        self.peaks = peaks;
        if !finished {
            return false;
        }
        self.measure(frame, cells, look, kernel, sources);
        true
    }

    /// Finds sharp sources next to places, px, alone: where stars are known to be. All centres are fitted.
    pub fn find_at(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        places: impl Iterator<Item = (f64, f64)>,
        sources: &mut Vec<Source>,
    ) {
        sources.clear();
        let kernel = SearchKernel::Sharp;
        let bin = 1usize << kernel.search_scale();
        let masked = look.masked_at(cells, kernel.search_scale());
        self.peaks.clear();
        self.peaks.extend(places.filter(|(x, y)| *x >= 0.0 && *y >= 0.0).map(|(x, y)| {
            let sample = |c: f64| (c + 0.5) as usize / bin;
            Peak { x: sample(x), y: sample(y), height: 0.0, cell: 0 }
        }));
        self.peaks.retain(|peak| !masked(peak.x, peak.y));
        self.measure(frame, cells, look, kernel, sources);
        self.complete(sources);
    }

    /// From the peaks of a search to its sources.
    fn measure(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        kernel: SearchKernel,
        sources: &mut Vec<Source>,
    ) {
        let settings = look.settings;
        let scale = kernel.scale();
        let bin = 1usize << scale;
        self.measure_peaks(frame, cells, look, kernel, true);
        let saturation = cells.saturation.map_or(f32::INFINITY, |level| SATURATED_FROM * f32::from(level));
        for candidate in &mut self.candidates {
            candidate.saturated = self.patches[candidate.patch].highest() >= saturation;
        }
        self.mark_lines(kernel);
        self.rank(rules_cell(settings, scale), settings.max_per_cell as usize, settings.max_found as usize);
        with_vectors(MeasureSources {
            finder: self,
            cells,
            bin,
            first: kernel.shape(),
            enough: settings.max_sources as usize,
            sources,
        });
    }

    /// Fits the centres of the sources of the last search that were not worth it before a pattern was found. The first ones, which
    /// patterns are made of, stay as they are; a second time nothing is left to do.
    pub fn complete(&mut self, sources: &mut [Source]) {
        with_vectors(FitTheRest { finder: self, sources });
        self.fitted = usize::MAX;
    }

    /// The peaks of a round kernel; `false` where it was told not to keep on.
    pub(super) fn find_peaks(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        kernel: SearchKernel,
        peaks: &mut Vec<Peak>,
    ) -> bool {
        let scale = kernel.search_scale();
        self.prepare_scale(frame, scale);
        let Some(plane) = self.halved.get(scale - 1) else { return true };
        let snr = look.settings.snr_threshold as f32 * kernel.taps().noise() / Taps::WIDE.noise();
        set_thresholds(cells, plane, 1 << scale, snr, &mut self.thresholds);
        let masked = look.masked_at(cells, scale);
        let rules = look.rules(kernel, plane, &self.thresholds, &masked);
        self.finder.find(plane, &rules, look.keep_on, kernel != SearchKernel::Sharp, peaks)
    }

    /// Where the light of stars at known places lies, brightest first; `None` where it cannot be told.
    pub fn light(&self, cells: &CellStatistics, stars: &[KnownStar]) -> Option<Light> {
        Light::of(self.halved.first()?, cells, stars)
    }

    /// Measures one of the stars near its place by the light of all.
    pub fn place(&self, cells: &CellStatistics, light: &Light, star: &KnownStar, stars: &[KnownStar]) -> Option<PlacedStar> {
        light.place(self.halved.first()?, cells, star, stars)
    }

    /// The figure that stars are: points, discs, trails. At places, px, with their signal over noise, brightest first; where none are
    /// given, at those that stand out widely.
    pub fn figure(&mut self, frame: &Frame, cells: &CellStatistics, places: &[(f64, f64, f64)]) -> Option<Figure> {
        self.prepare_scale(frame, blur::SEARCH_SCALE);
        blur::figure(&self.halved, cells, places)
    }

    /// Makes the halved pictures up to a scale.
    fn prepare_scale(&mut self, frame: &Frame, scale: usize) {
        self.halved.resize_with(self.halved.len().max(scale), Plane::default);
        while self.halved_ready < scale {
            let (done, rest) = self.halved.split_at_mut(self.halved_ready);
            if let Some(out) = rest.first_mut() {
                match done.last() {
                    Some(from) => halve(from, &mut self.scratch, out),
                    None => halve(&Clipped::new(frame, &self.excess), &mut self.scratch, out),
                }
            }
            self.halved_ready += 1;
        }
    }

    /// Marks what lies on the lines that several ridges make, or several trails along themselves.
    pub(super) fn mark_lines(&mut self, kernel: SearchKernel) {
        let place = |c: &Candidate| (c.peak.x as f32, c.peak.y as f32);
        let along = kernel.along();
        let mut ridges: Vec<&Candidate> =
            self.candidates.iter().filter(|c| c.standing.on_ridge || (along.is_some() && c.is_star_like())).collect();
        ridges.sort_by(|a, b| b.standing.snr.total_cmp(&a.standing.snr));
        let lines = lines::find(ridges.into_iter().map(place).collect(), along);
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
            let (x, y, here) = (c.peak.x as f32, c.peak.y as f32, c.peak.cell_of(cell));
            let is_apart = |k: &Kept| (k.x - x).powi(2) + (k.y - y).powi(2) >= SEPARATION * SEPARATION;
            let keep =
                kept.len() < most && kept.iter().all(is_apart) && kept.iter().filter(|k| k.cell == here).count() < per_cell;
            if keep {
                kept.push(Kept { x, y, cell: here });
            }
            keep
        });
    }

    /// The median shape of the better stars, where there are enough.
    #[inline(always)]
    fn frame_shape(&self, first: Shape) -> Option<Shape> {
        let good = |c: &&Candidate| c.is_star_like() && c.standing.snr >= SHAPE_SNR && !c.saturated;
        let mut shapes = [first; SHAPE_STARS];
        let mut count = 0;
        for candidate in self.candidates.iter().filter(good).take(SHAPE_STARS) {
            let patch = &self.patches[candidate.patch];
            if let Some(shape) = moments(patch, candidate.standing.base, first) {
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
pub(super) fn set_thresholds(cells: &CellStatistics, plane: &Plane, bin: usize, snr: f32, thresholds: &mut Vec<f32>) {
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
/// A clipped star's charge runs along its column: its middle is not known better than this, samples, however bright it is.
const SATURATED_SIGMA: f32 = 2.0;

/// Cuts and measures every peak with a first guess of the shape; keeps those that stand out.
struct MeasurePeaks<'a, P> {
    picture: &'a P,
    /// Samples of the picture along one sample of the plane that the peaks were found in.
    finer: usize,
    /// What stars are taken to look like.
    shape: Shape,
    /// Whether ridges are looked for, for which patches have to be levelled out.
    ridges: bool,
    /// Whether patches are levelled out.
    level_out: bool,
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
        let MeasurePeaks { picture, finer, shape, ridges, level_out, peaks, noise, least, lists: (candidates, patches) } = self;
        candidates.clear();
        let template = CoreTemplate::new(&shape);
        for &peak in peaks {
            let mut peak = Peak { x: peak.x * finer, y: peak.y * finer, ..peak };
            if finer > 1 {
                let Some((x, y)) = summit(picture, peak.x, peak.y, finer) else { continue };
                (peak.x, peak.y) = (x, y);
            }
            // Patches are large: each is cut where it stays if it is worth it, and else the next one takes its place.
            let place = candidates.len();
            if place == patches.len() {
                patches.push(Patch::default());
            }
            let patch = &mut patches[place];
            if !patch.cut_at(picture, peak.x, peak.y) {
                continue;
            }
            let around = patch.surroundings();
            let sigma = noise(peak.x, peak.y);
            let mut standing = Standing::measure_in(patch, &around, &template, sigma);
            if standing.confidence >= least {
                if level_out {
                    patch.level_out(around.slope);
                }
                if ridges {
                    standing.look_for_ridge(patch, sigma);
                }
                candidates.push(Candidate { peak, patch: place, sigma, standing, saturated: false, in_line: false });
            }
        }
    }
}

/// What a star is taken to look like in the picture of a search.
#[derive(Debug, Clone, Copy)]
struct Optics {
    shape: Shape,
    /// ADU/e⁻ of a sample.
    gain: f32,
    /// Pixels along a sample.
    bin: usize,
}

impl Default for Optics {
    fn default() -> Self {
        Self { shape: Shape::round(1.0), gain: USUAL_GAIN as f32, bin: 1 }
    }
}

/// Measures what is left again with the frame's own shape, and fits the centres of the best.
struct MeasureSources<'a> {
    finder: &'a mut Finder,
    cells: &'a CellStatistics,
    bin: usize,
    /// What a star is taken for until the frame shows it.
    first: Shape,
    /// Stars whose centres are fitted at once.
    enough: usize,
    sources: &'a mut Vec<Source>,
}

impl Kernel for MeasureSources<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let MeasureSources { finder, cells, bin, first, enough, sources } = self;
        let shape = finder.frame_shape(first);
        finder.psf_axes = shape.map(|s| s.axes()).map(|(a, b)| (f64::from(a) * bin as f64, f64::from(b) * bin as f64));
        let shape = shape.unwrap_or(first);
        // The gain of a mean of bin² pixels.
        let gain = (cells.gain.unwrap_or(USUAL_GAIN) / (bin * bin) as f64) as f32;
        finder.optics = Optics { shape, gain, bin };
        let template = CoreTemplate::new(&shape);
        for candidate in &mut finder.candidates {
            let on_ridge = candidate.standing.on_ridge;
            let patch = &finder.patches[candidate.patch];
            candidate.standing = Standing { on_ridge, ..Standing::measure(patch, &template, candidate.sigma) };
        }
        // Stars first; among equals the surest first. A stable sort, so that the same frame gives the same order.
        let is_whole = |c: &Candidate| c.is_star_like() && !c.saturated;
        finder
            .candidates
            .sort_by(|a, b| is_whole(b).cmp(&is_whole(a)).then(b.standing.confidence.total_cmp(&a.standing.confidence)));
        // The best whose centres can be fitted come first, those where that fails last.
        let mut failed = Vec::new();
        let mut rest = finder.candidates.drain(..).collect::<Vec<_>>().into_iter();
        while sources.len() < enough
            && let Some(candidate) = rest.next()
        {
            let source = source_of(&candidate, &finder.patches[candidate.patch], &finder.optics, true);
            if source.star_like || !is_whole(&candidate) {
                sources.push(source);
                finder.candidates.push(candidate);
            } else {
                failed.push((source, candidate));
            }
        }
        finder.fitted = sources.len();
        for candidate in rest {
            sources.push(source_of(&candidate, &finder.patches[candidate.patch], &finder.optics, false));
            finder.candidates.push(candidate);
        }
        for (source, candidate) in failed {
            sources.push(source);
            finder.candidates.push(candidate);
        }
    }
}

/// Fits the centres that were left.
struct FitTheRest<'a> {
    finder: &'a Finder,
    sources: &'a mut [Source],
}

impl Kernel for FitTheRest<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let FitTheRest { finder, sources } = self;
        for (source, candidate) in sources.iter_mut().zip(&finder.candidates).skip(finder.fitted) {
            *source = source_of(candidate, &finder.patches[candidate.patch], &finder.optics, true);
        }
        let first = finder.fitted.min(sources.len());
        sources[first..].sort_by_key(|source| !source.star_like);
    }
}

/// Side of the cells that limit crowding, samples of a scale.
pub(super) fn rules_cell(settings: &SourceSettings, scale: usize) -> usize {
    (settings.cell_px as usize >> scale).max(CELL_PX)
}

/// The source of a candidate: its centre where it is to be fitted and the fit finds one, else its peak with an error of half a sample.
#[inline(always)]
fn source_of(candidate: &Candidate, patch: &Patch, optics: &Optics, fit: bool) -> Source {
    let &Optics { shape, gain, bin } = optics;
    let fitted = if fit { centroid(patch, &candidate.standing, &shape, candidate.sigma, gain) } else { None };
    let (dx, dy, sigma, flux) = match fitted {
        Some(c) => (c.x, c.y, c.sigma, c.flux),
        None => (0.0, 0.0, 0.5, candidate.standing.flux),
    };
    let sigma = if candidate.saturated { sigma.max(SATURATED_SIGMA) } else { sigma };
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
        star_like: candidate.is_star_like() && !candidate.saturated && (fitted.is_some() || !fit),
        trailed: None,
    }
}
