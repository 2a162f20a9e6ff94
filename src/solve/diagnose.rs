//! From a frame that was not solved to the cause: collects the evidence that [`super::cause`] weighs.

use super::cause::{Diagnosis, Evidence, SkyEvidence};
use super::second_look::SecondLook;
use super::solver::{Search, Solver, pattern_source};
use super::verify::PatternSource;
use super::{Cause, Outcome, Reason};
use crate::sources::{Figure, Source};

/// A source of a star's shape and of this confidence is worth a look; surely one, unless it is an artefact of that shape; and one that
/// hardly any artefact of that shape is.
const PLAUSIBLE: f64 = 4.0;
const SURE: f64 = 5.0;
const BRIGHT: f64 = 10.0;
/// Stars at which the figure is looked at where none stands out widely.
const LEAST_FOR_FIGURE: usize = 3;
/// A figure with less noise than this needs no other, of its height.
const CLEAR_NOISE: f64 = 0.06;

/// The sharp sources of a frame that may be stars, the surest first.
#[derive(Debug, Clone, Default)]
pub(super) struct Seen {
    stars: Vec<Source>,
}

impl Seen {
    /// Those among the sources found.
    pub fn of(found: &[Source]) -> Self {
        Self { stars: found.iter().filter(|source| source.star_like && source.confidence >= PLAUSIBLE).copied().collect() }
    }

    /// How many have a confidence.
    fn count(&self, confidence: f64) -> usize {
        self.stars.iter().filter(|star| star.confidence >= confidence).count()
    }
}

impl Solver {
    /// Names the cause of a frame that was searched and not solved.
    pub(super) fn diagnose(&mut self, search: &Search<'_>, outcome: &mut Outcome) {
        let open = matches!(outcome.reason, Reason::NoMatch | Reason::TooFewSources | Reason::Undecided | Reason::Requirement);
        if !open || outcome.cause == Some(Cause::WrongPrior) || search.watch.stop().is_some() {
            return;
        }
        let mut evidence = Evidence {
            saturated_fraction: outcome.statistics.map_or(0.0, |statistics| statistics.saturated_fraction),
            step_adu: outcome.statistics.map_or(0.0, |statistics| self.levels.step_adu(statistics.level)),
            sky: SkyEvidence::of(&self.cells),
            stars: self.seen.count(SURE),
            ..Evidence::default()
        };
        if outcome.reason != Reason::Requirement && evidence.is_starry(self.seen.count(BRIGHT)) {
            evidence.setting = self.second_look(search);
        }
        if evidence.setting.is_none() && !evidence.sky.is_clouded() {
            evidence.figure = self.figure(search);
        }
        let diagnosis = evidence.weigh();
        // A requirement that refused says enough, but for what makes a pointing poor.
        let diagnosis = diagnosis.filter(|diagnosis| outcome.reason != Reason::Requirement || diagnosis.blur.is_some());
        outcome.cause = diagnosis.as_ref().map(|diagnosis| diagnosis.cause);
        if let Some(Diagnosis { detail, blur, .. }) = diagnosis {
            outcome.blur = blur;
            outcome.detail = format!("{}; {detail}", outcome.detail);
        }
    }

    /// The figure that stars are: where something stands out widely, or where the sharp sources are.
    fn figure(&mut self, search: &Search<'_>) -> Option<Figure> {
        let wide = self.finder.figure(search.frame, &self.cells, &[]);
        if self.seen.stars.len() < LEAST_FOR_FIGURE
            || wide.is_some_and(|figure| figure.noise <= CLEAR_NOISE && !figure.is_narrow())
        {
            return wide;
        }
        let places: Vec<(f64, f64, f64)> = self.seen.stars.iter().map(|star| (star.x, star.y, star.snr)).collect();
        let sharp = self.finder.figure(search.frame, &self.cells, &places);
        match (wide, sharp) {
            // Whether points are in rows, more of them tell better.
            (Some(wide), Some(sharp)) if wide.is_narrow() && sharp.count <= wide.count => Some(wide),
            (Some(wide), Some(sharp)) if !wide.is_narrow() && wide.noise <= sharp.noise => Some(wide),
            (wide, sharp) => sharp.or(wide),
        }
    }

    /// Whether the stars would fit a pattern, were the settings other ones.
    fn second_look(&self, search: &Search<'_>) -> Option<(Cause, String)> {
        let field = self.field()?;
        let context = self.context(search.frame, search.prior, search.watch, field);
        let sources: Vec<PatternSource> = self.seen.stars.iter().map(|star| pattern_source(star, &context.camera)).collect();
        let settings = &self.settings().solver;
        let only_near = context.circles.first().filter(|_| settings.prior_veto).map(|circle| circle.centre);
        SecondLook { field, sources: &sources, geometry: &context.geometry, settings, only_near, watch: search.watch }.cause()
    }
}
