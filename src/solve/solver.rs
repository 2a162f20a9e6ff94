//! The solver: one frame in, one outcome out.

use super::along::Along;
use super::diagnose::Seen;
use super::pattern::{MAX_SOURCES, PatternSearch, SearchEnd, SearchRules, SearchTally};
use super::requirements::{self, Circle};
use super::still::refuse_moved;
use super::track::Region;
use super::unseen::ln_of_unseen;
use super::verify::{FrameGeometry, Hypothesis, PatternSource};
use super::{Cause, Exposures, FoundBy, Outcome, Part, Prior, Reason, SearchMode, SourceReport, Statistics, Stop, Watch};
use crate::catalog::{Catalogue, Field, FieldKey};
use crate::image::{CellStatistics, Frame, LevelMeter, Mask};
use crate::settings::{Settings, SolverSettings};
use crate::sky::{CameraModel, DEG, HOUR, Observer, Vec3};
use crate::sources::{Finder, Look, SearchKernel, Source, Trailed};
use std::sync::Arc;

/// Solves frames. Holds the catalogue, the index for one field, and the memory that a frame needs. A clone shares catalogue and
/// index and has memory of its own.
#[derive(Debug, Clone)]
pub struct Solver {
    pub(super) catalogue: Arc<Catalogue>,
    settings: Arc<Settings>,
    field: Option<Arc<Field>>,
    pub(super) cells: Arc<CellStatistics>,
    pub(super) levels: LevelMeter,
    pub(super) finder: Finder,
    /// Surveys on a second thread, where there are two.
    pub(super) second: Finder,
    pub(super) found: Vec<Source>,
    /// What the searches of the present frame saw.
    pub(super) seen: Seen,
}

/// A frame with more of its pixels saturated has no sky left to look at.
const TOO_BRIGHT_FRACTION: f64 = 0.95;
/// Sources that a pattern and its check need at least.
const LEAST_SOURCES: usize = 4;
/// Wide kernels that a frame is searched with, of those in which most stands out. (Trials: of 53 frames of discs and trails of 30 px that
/// are solved 51 are with the first, two with the second.)
const WIDE_LISTS: usize = 2;
/// The sharp list of sources has one part in this many of the budget of candidates, each wide one this. (Trials: of 440 frames of the
/// hard kinds that are solved at all every one is solved with 750 candidates of its sharp list or 400 of a wide one.)
const SHARP_PART: u64 = 8;
const WIDE_PART: u64 = 15;
/// Along trails, which are searched where else nothing is found, so many times the budget.
const MOTION_TIMES: u64 = 2;
/// A candidate less unlikely than this to be chance is worth reporting as `undecided`, ln.
const UNDECIDED_FALSE_LN: f64 = 0.0;

/// What a search is about.
pub(super) struct Search<'a> {
    pub frame: &'a Frame,
    pub prior: &'a Prior,
    pub watch: &'a dyn Watch,
    mask: Option<Mask>,
    /// Its exposures, where it is the sum of several or its motion is known.
    exposures: Option<&'a Exposures>,
}

impl Search<'_> {
    /// Whether nothing is taken from a place, px.
    pub fn masked(&self) -> impl Fn(usize, usize) -> bool {
        |x, y| self.mask.as_ref().is_some_and(|mask| mask.is_masked(x, y))
    }

    /// Whether to go on.
    pub fn keep_on(&self) -> impl Fn() -> bool {
        || self.watch.stop().is_none()
    }
}

/// Everything about a frame that the stages after the search need.
#[derive(Clone)]
pub(super) struct Context<'a> {
    pub frame: &'a Frame,
    pub watch: &'a dyn Watch,
    pub field: &'a Field,
    pub geometry: FrameGeometry,
    pub camera: CameraModel,
    pub observer: Option<Observer>,
    /// Epoch of observation, where known, Julian year.
    pub year: Option<f64>,
    pub circles: Vec<Circle>,
    /// The attitudes that are expected, where frames are tracked and there is something to expect.
    pub region: Option<Region>,
    /// Scale that the sources were found at.
    pub scale: usize,
    /// The trails, where sources were found along them.
    pub along: Option<Along<'a>>,
}

impl Solver {
    /// A solver for the given settings; the index is built with the first frame, or by [`Self::prepare`].
    pub fn new(catalogue: Arc<Catalogue>, settings: Arc<Settings>) -> Self {
        Self {
            catalogue,
            settings,
            field: None,
            cells: Arc::default(),
            levels: LevelMeter::default(),
            finder: Finder::default(),
            second: Finder::default(),
            found: Vec::new(),
            seen: Seen::default(),
        }
    }

    /// Builds the index for frames of a size, px, unless it is there (under 2 s).
    pub fn prepare(&mut self, width: usize, height: usize) {
        self.prepare_while(width, height, &|| true);
    }

    /// As [`Self::prepare`], for as long as `keep_on` says so; whether the index is there.
    fn prepare_while(&mut self, width: usize, height: usize, keep_on: &dyn Fn() -> bool) -> bool {
        let key = self.field_key(width, height);
        if self.field.as_ref().is_none_or(|field| field.key != key) {
            let Some(field) = Field::build(&self.catalogue, &key, keep_on) else { return false };
            self.field = Some(Arc::new(field));
        }
        true
    }

    /// The key of the index that frames of a size, px, need.
    pub fn field_key(&self, width: usize, height: usize) -> FieldKey {
        FieldKey::new(&self.catalogue, &self.settings, width, height)
    }

    /// The index that is there.
    pub fn field(&self) -> Option<&Arc<Field>> {
        self.field.as_ref()
    }

    /// Adopts an index that was kept, so that [`Self::prepare`] has none to build for the frames that it is for.
    pub fn set_field(&mut self, field: Arc<Field>) {
        self.field = Some(field);
    }

    /// The catalogue whose stars the matches point into.
    pub fn catalogue(&self) -> &Arc<Catalogue> {
        &self.catalogue
    }

    /// The settings in force.
    pub fn settings(&self) -> &Arc<Settings> {
        &self.settings
    }

    /// Adopts other settings from the next frame on.
    pub fn set_settings(&mut self, settings: Arc<Settings>) {
        self.settings = settings;
    }

    /// Solves one frame: every frame ends in one outcome with its reason; nothing here fails otherwise.
    ///
    /// The normal search first, and where it does not solve and `solver.robust` is set, the robust one.
    pub fn solve(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome {
        self.solve_in(frame, prior, watch, (true, self.settings.solver.robust), None)
    }

    /// As [`Self::solve`], with the robust search alone: what a bench measures.
    pub fn solve_robust(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome {
        self.solve_in(frame, prior, watch, (false, true), None)
    }

    /// `normal`, `robust`: the searches that are to be made.
    pub(super) fn solve_in(
        &mut self,
        frame: &Frame,
        prior: &Prior,
        watch: &dyn Watch,
        (normal, robust): (bool, bool),
        exposures: Option<&Exposures>,
    ) -> Outcome {
        let started = watch.elapsed();
        let mut outcome = Outcome::unsolved(frame.stamp.clone(), Reason::NoMatch, "");
        outcome.prior = prior.clone();
        if let Err((reason, detail)) = self.may_solve(frame, &mut outcome, watch) {
            (outcome.reason, outcome.detail) = (reason, detail);
        } else {
            match self.mask(frame) {
                Ok(mask) => {
                    if self.prepare_while(frame.width, frame.height, &|| watch.stop_at(Part::Index).is_none()) {
                        self.search(&Search { frame, prior, watch, mask, exposures }, normal, robust, &mut outcome);
                    } else {
                        stopped(&mut outcome, watch.stop_at(Part::Index).unwrap_or(Stop::Aborted));
                    }
                }
                Err(error) => (outcome.reason, outcome.detail) = (Reason::Failed, error),
            }
        }
        outcome.times.total = watch.elapsed() - started;
        outcome
    }

    /// Searches in the ways that are wanted; a frame that is not solved gets its cause.
    fn search(&mut self, search: &Search<'_>, normal: bool, robust: bool, outcome: &mut Outcome) {
        self.finder.begin(search.frame, &self.cells);
        self.seen = Seen::default();
        let along = search.exposures.is_some_and(|exposures| self.search_along(search, exposures, outcome));
        if along {
            // The motion told where to look.
        } else if normal && robust && self.settings.solver.threads > 1 {
            self.search_abreast(search, outcome);
        } else {
            let done = normal && self.search_with(search, SearchKernel::Sharp, outcome);
            if robust && !done {
                outcome.mode = SearchMode::Robust;
                self.search_widely(search, outcome);
            }
        }
        if let Some(exposures) = search.exposures.filter(|_| !along) {
            refuse_moved(exposures, outcome);
        }
        self.diagnose(search, outcome);
    }

    /// Statistics, and whether the frame is worth a search at all.
    fn may_solve(&mut self, frame: &Frame, outcome: &mut Outcome, watch: &dyn Watch) -> Result<(), (Reason, String)> {
        let started = watch.elapsed();
        if !self.settings.solver.enabled {
            return Err((Reason::Disabled, "solver.enabled is false".into()));
        }
        if frame.width.checked_mul(frame.height) != Some(frame.pixels.len()) {
            return Err((Reason::Failed, "the frame's size does not fit its pixels".into()));
        }
        let hint = self.settings.camera.full_scale_adu * u32::from(frame.stamp.exposures.max(1));
        let full_scale = frame.full_scale.or((hint > 0).then(|| hint.min(u32::from(u16::MAX)) as u16));
        let cells = Arc::make_mut(&mut self.cells);
        cells.measure(frame, full_scale);
        let fraction = cells.saturated_px as f64 / frame.pixels.len().max(1) as f64;
        // Beyond the last whole cell a pixel may be higher; it counts as the highest.
        let level = self.levels.level(frame, cells.max.iter().copied().max().unwrap_or(u16::MAX));
        outcome.rows = Some(frame.rows);
        outcome.statistics = Some(Statistics {
            mean: cells.image_mean,
            noise: cells.image_noise,
            gain: cells.gain,
            saturated_px: cells.saturated_px,
            saturated_fraction: fraction,
            fwhm_px: None,
            level: (level.low, level.high),
        });
        outcome.times.statistics = watch.elapsed() - started;
        let limit = self.settings.solver.saturation_limit_fraction;
        if cells.image_noise <= 0.0 && fraction < TOO_BRIGHT_FRACTION {
            outcome.cause = Some(Cause::NoContrast);
            return Err((Reason::NoContrast, "half of the frame has no noise at all".into()));
        }
        if cells.saturation.is_some() && fraction >= TOO_BRIGHT_FRACTION {
            let flat = fraction >= 1.0 && cells.saturation.is_none_or(|s| s < full_scale.unwrap_or(u16::MAX));
            if flat {
                outcome.cause = Some(Cause::NoContrast);
                return Err((Reason::NoContrast, "every pixel has the same value".into()));
            }
            outcome.cause = Some(Cause::Overexposed);
            return Err((Reason::TooBright, format!("{:.1} % of the pixels are at full scale", 100.0 * fraction)));
        }
        if fraction > limit {
            outcome.cause = Some(Cause::Saturated);
            return Err((
                Reason::Saturated,
                format!("{:.1} % of the pixels are saturated, the limit is {:.1} %", 100.0 * fraction, 100.0 * limit),
            ));
        }
        Ok(())
    }

    /// The mask for frames of this size, where one is set.
    fn mask(&self, frame: &Frame) -> Result<Option<Mask>, String> {
        let settings = &self.settings.solver.mask;
        if !settings.enabled || settings.fields.iter().all(|&f| f == 0) {
            return Ok(None);
        }
        Mask::new(settings, frame.width, frame.height, frame.rows).map(Some).map_err(|e| e.to_string())
    }

    /// Searches with the wide kernels, the one in which most stands out first, until the frame is done with.
    pub(super) fn search_widely(&mut self, search: &Search<'_>, outcome: &mut Outcome) {
        let started = search.watch.elapsed();
        let settings = self.settings.clone();
        let (masked, keep_on) = (search.masked(), search.keep_on());
        let look = Look { settings: &settings.solver.sources, masked: &masked, keep_on: &keep_on };
        let kernels = self.finder.survey(search.frame, &self.cells, &look);
        outcome.times.find += search.watch.elapsed() - started;
        let Some(kernels) = kernels else {
            stopped(outcome, search.watch.stop().unwrap_or(Stop::Aborted));
            return;
        };
        self.search_lists(search, kernels, outcome);
    }

    /// Searches with wide kernels that were surveyed, until the frame is done with.
    pub(super) fn search_lists(&mut self, search: &Search<'_>, kernels: Vec<SearchKernel>, outcome: &mut Outcome) {
        for kernel in kernels.into_iter().take(WIDE_LISTS) {
            if self.search_with(search, kernel, outcome) {
                break;
            }
        }
    }

    /// Finds and matches with one kernel; `true` where the frame is done with.
    pub(super) fn search_with(&mut self, search: &Search<'_>, kernel: SearchKernel, outcome: &mut Outcome) -> bool {
        let &Search { frame, prior, watch, .. } = search;
        let started = watch.elapsed();
        let settings = self.settings.clone();
        let (masked, keep_on) = (search.masked(), search.keep_on());
        let look = Look { settings: &settings.solver.sources, masked: &masked, keep_on: &keep_on };
        let finished = self.finder.find(frame, &self.cells, &look, kernel, &mut self.found);
        outcome.times.find += watch.elapsed() - started;
        if !finished {
            return stopped(outcome, watch.stop().unwrap_or(Stop::Aborted));
        }
        if kernel == SearchKernel::Sharp {
            self.seen = Seen::of(&self.found);
        }
        // What is reported of an unsolved frame is the search that found most.
        if kernel == SearchKernel::Sharp || self.found.len() > outcome.sources.len() {
            self.report_sources(outcome);
        }
        if !settings.solver.matching.enabled {
            outcome.reason = Reason::Disabled;
            outcome.detail = "solver.matching.enabled is false".into();
            return true;
        }
        let Some(field) = self.field.clone() else {
            outcome.reason = Reason::Failed;
            outcome.detail = "the index is not there".into();
            return true;
        };
        let context = Context { scale: kernel.scale(), ..self.context(frame, prior, watch, &field) };
        self.match_found(&context, &look, outcome)
    }

    /// Matches the sources of the last search; `true` where the frame is done with.
    pub(super) fn match_found(&mut self, context: &Context<'_>, look: &Look<'_>, outcome: &mut Outcome) -> bool {
        let (settings, frame, field) = (self.settings.clone(), context.frame, context.field);
        if self.match_near(context, outcome) {
            return true;
        }
        if self.found.len() < LEAST_SOURCES {
            if outcome.reason == Reason::NoMatch && outcome.sources.len() < LEAST_SOURCES {
                outcome.reason = Reason::TooFewSources;
                outcome.cause = Some(Cause::TooFewStars);
                outcome.detail = format!("{} sources found, a pattern needs {LEAST_SOURCES}", outcome.sources.len());
            }
            return false;
        }
        // With the plate scale that is known, and then as if it were not: the lens may have been moved.
        let unknown = FrameGeometry::new(&settings.solver, field, frame.width, frame.height);
        let narrowed = context.geometry.platescale_range != unknown.platescale_range;
        (narrowed && self.match_sources(context, look, outcome))
            || self.match_sources(&Context { geometry: unknown, ..context.clone() }, look, outcome)
    }

    /// Puts the sources of the last search into the outcome.
    pub(super) fn report_sources(&self, outcome: &mut Outcome) {
        outcome.sources = self.found.iter().map(report).collect();
        outcome.sources_tried = self.found.len().min(if outcome.mode == SearchMode::Motion {
            MAX_SOURCES
        } else {
            self.settings.solver.sources.max_sources as usize
        });
        if let (Some(statistics), Some((long, short))) = (&mut outcome.statistics, self.finder.psf_axes) {
            /// Full width at half maximum of a Gaussian, in σ.
            const FWHM_PER_SIGMA: f64 = 2.354_820_045;
            statistics.fwhm_px = Some(FWHM_PER_SIGMA * (long * short).sqrt());
        }
    }

    /// What the stages after the search need to know of the frame.
    pub(super) fn context<'a>(&self, frame: &'a Frame, prior: &'a Prior, watch: &'a dyn Watch, field: &'a Field) -> Context<'a> {
        let settings = &self.settings;
        let camera = CameraModel {
            width: frame.width,
            height: frame.height,
            platescale: field.geometry.platescale,
            k1: 0.0,
            rows: frame.rows,
            mirrored: settings.camera.mirrored,
        };
        let lens = prior.lens.filter(|_| settings.solver.tracking.enabled);
        let unknown = FrameGeometry::new(&settings.solver, field, frame.width, frame.height);
        let geometry = lens.map_or(unknown, |lens| unknown.with_lens(&lens));
        let year = frame.stamp.captured.map(|(utc, _)| utc.julian_year());
        let observer = self.observer(frame, prior);
        let circles = requirements::expected_circles(&settings.solver.requirements, prior, observer.as_ref(), year);
        let region = Region::of(prior, &circles).filter(|_| settings.solver.tracking.enabled);
        Context { frame, watch, field, geometry, camera, observer, year, circles, region, scale: 0, along: None }
    }

    /// The observer by the settings' order of preference.
    fn observer(&self, frame: &Frame, prior: &Prior) -> Option<Observer> {
        let settings = &self.settings.observer;
        let fixed = Observer { latitude: settings.latitude_deg * DEG, sidereal_time: settings.sidereal_time_h * HOUR };
        prior
            .observer
            .filter(|_| settings.from_flight_computer)
            .or(settings.from_settings.then_some(fixed))
            .or(frame.stamp.observer.filter(|_| settings.from_image))
    }

    /// Matches the sources of the last search anywhere on the sky; `true` where the frame is done with.
    fn match_sources(&mut self, context: &Context<'_>, look: &Look<'_>, outcome: &mut Outcome) -> bool {
        let started = context.watch.elapsed();
        let settings = self.settings.clone();
        let settings = &settings.solver;
        let all = self.pattern_sources(context);
        let tried = all.get(..all.len().min(most_tried(settings, context))).unwrap_or(&all);
        let inside = |d: &Vec3| context.circles.iter().all(|c| c.contains(d));
        let fraction = context.circles.iter().map(Circle::sky_fraction).fold(1.0, f64::min);
        let rules = SearchRules {
            min_matched: settings.matching.min_matched as usize,
            max_false_ln: settings.matching.max_false_probability_log10 * std::f64::consts::LN_10,
            budget: budget(settings, context),
            region: (!context.circles.is_empty()).then_some((fraction, &inside)),
            region_only: settings.prior_veto && !context.circles.is_empty(),
            stop: &|| context.watch.stop(),
        };
        let (mut end, tally) = PatternSearch::new(context.field, tried, &context.geometry, &rules).run();
        outcome.times.match_ += context.watch.elapsed() - started;
        note_tally(outcome, tally);
        // What sources leave in doubt the light of the other stars decides.
        if let (Some(along), SearchEnd::Exhausted(Some(best)) | SearchEnd::Budget(Some(best))) = (&context.along, &mut end) {
            best.false_ln -= ln_of_unseen(context, along, tried, best);
            if rules.are_met_by(best) {
                end = SearchEnd::Found(best.clone());
            }
        }
        match end {
            SearchEnd::Found(hypothesis) => {
                let started = context.watch.elapsed();
                if context.along.is_none() {
                    self.finder.complete(&mut self.found);
                }
                let sharp = if context.scale > 0 { self.sharpen(context, look, &hypothesis) } else { None };
                let scale = if sharp.is_some() { 0 } else { context.scale };
                let (context, hypothesis) = (&Context { scale, ..context.clone() }, sharp.unwrap_or(hypothesis));
                self.report_sources(outcome);
                let done = self.conclude(context, &self.pattern_sources(context), &hypothesis, FoundBy::LostInSpace, outcome);
                outcome.times.fit += context.watch.elapsed() - started;
                done
            }
            SearchEnd::Stopped(stop) => stopped(outcome, stop),
            SearchEnd::Exhausted(best) => self.leave_open(context, &all, best, outcome, "every pattern was tried"),
            SearchEnd::Budget(best) => self.leave_open(context, &all, best, outcome, "the budget of candidates was used up"),
        }
    }

    /// The sources of the last search as the matcher sees them.
    pub(super) fn pattern_sources(&self, context: &Context<'_>) -> Vec<PatternSource> {
        self.found.iter().map(|source| pattern_source(source, &context.camera)).collect()
    }

    /// No pattern beyond doubt: says what there was; `false`, so that a wider search may follow.
    fn leave_open(
        &self,
        context: &Context<'_>,
        all: &[PatternSource],
        best: Option<Hypothesis>,
        outcome: &mut Outcome,
        how: &str,
    ) -> bool {
        let tried = outcome.sources_tried;
        let threshold = self.settings.solver.matching.max_false_probability_log10;
        if outcome.reason == Reason::Requirement {
            // An earlier search of this frame found the stars, if not well enough: that says more.
            return false;
        }
        match best.filter(|b| b.false_ln < UNDECIDED_FALSE_LN) {
            Some(best) => {
                outcome.reason = Reason::Undecided;
                outcome.detail = format!(
                    "{how}; the best candidate matches {} of {tried} sources and is chance with a probability of up to 10^{:.1}; served below 10^{threshold}",
                    best.matches.len(),
                    best.false_ln / std::f64::consts::LN_10,
                );
                // The sources reported may be another search's, and what is not served measures nothing anew.
                outcome.candidate = self.solution(context, all, &best, &mut []);
            }
            None if outcome.reason != Reason::Undecided => {
                outcome.reason = Reason::NoMatch;
                outcome.detail = format!("{how}: {tried} sources fit no pattern of stars");
            }
            None => {}
        }
        false
    }
}

/// Sources that patterns are made of, at most. Where noise is known for what it is, more of them cost nothing but time.
pub(super) fn most_tried(settings: &SolverSettings, context: &Context<'_>) -> usize {
    if context.along.is_some() { MAX_SOURCES } else { settings.sources.max_sources as usize }
}

/// Candidates that may be screened with one list of sources.
fn budget(settings: &SolverSettings, context: &Context<'_>) -> u64 {
    let all = u64::from(settings.matching.candidate_budget);
    match (context.along, context.scale) {
        (Some(_), _) => all * MOTION_TIMES,
        (None, 0) => all.div_ceil(SHARP_PART),
        (None, _) => all.div_ceil(WIDE_PART),
    }
}

/// Ends an outcome because the watch said so.
pub(super) fn stopped(outcome: &mut Outcome, stop: Stop) -> bool {
    (outcome.reason, outcome.detail) = match stop {
        Stop::TimedOut => (Reason::TimedOut, format!("too old, after {} candidates", outcome.candidates_tried)),
        Stop::Aborted => (Reason::Aborted, format!("given up by command, after {} candidates", outcome.candidates_tried)),
    };
    outcome.candidate = None;
    true
}

pub(super) fn note_tally(outcome: &mut Outcome, tally: SearchTally) {
    outcome.candidates_tried += tally.candidates;
    outcome.triangles = tally.triangles;
}

fn report(source: &Source) -> SourceReport {
    SourceReport {
        x: source.x,
        y: source.y,
        sigma_px: source.sigma,
        flux: source.flux,
        snr: source.snr,
        peak: source.peak,
        saturated: source.saturated,
    }
}

pub(super) fn pattern_source(source: &Source, camera: &CameraModel) -> PatternSource {
    let (left, up) = camera.offsets(source.x, source.y);
    let plain = PatternSource::new(left, up, source.sigma, source.flux, camera.platescale);
    let Some(Trailed { covariance: (xx, yy, xy), noise }) = source.trailed else { return plain };
    // Left and up run along the file's axes, or against them.
    let (from, to) = (camera.offsets(0.0, 0.0), camera.offsets(1.0, 1.0));
    plain.trailed((xx, yy, xy * (to.0 - from.0) * (to.1 - from.1)), noise)
}
