//! From a pattern beyond doubt to what is served: the final fit, its horizontal coordinates, and the requirements.

use super::copies::nearest_copy;
use super::light::{LightFit, SEEN_PX, fit_by_light};
use super::refine::{moved, refine, solution_of};
use super::requirements::{self, Refusal};
use super::served::{horizontal, served};
use super::solver::{Context, Solver, most_tried};
use super::verify::{Hypothesis, PatternSource};
use super::{Cause, FoundBy, Outcome, Reason, Solution, SourceReport};
use crate::sky::{DEG, Mat3, RowOrder, Vec3};

/// Whole stars lie no further than this from the fit, rms per axis, samples of the picture that they were measured in.
const WORST_RMS_PX: f64 = 1.5;

impl Solver {
    /// The final fit of a pattern beyond doubt, its horizontal coordinates, and the requirements. Whether the frame is done with: where
    /// the fit is poor, the sources of another search may make a better one.
    pub(super) fn conclude(
        &self,
        context: &Context<'_>,
        all: &[PatternSource],
        found: &Hypothesis,
        found_by: FoundBy,
        outcome: &mut Outcome,
    ) -> bool {
        // What an earlier search of this frame was short of is no longer so.
        (outcome.cause, outcome.candidate, outcome.found_by) = (None, None, Some(found_by));
        outcome.detail.clear();
        let Some(mut solution) = self.solution(context, all, found, &mut outcome.sources) else {
            outcome.reason = Reason::Failed;
            outcome.detail = "the final fit of a verified pattern did not settle".into();
            return true;
        };
        solution.horizontal = horizontal(context, &solution, &self.settings().solver.fit);
        solution.served = served(context, &solution, &self.settings().solver.fit);
        let boresight = solution.attitude.boresight();
        if let Some(circle) = context.circles.iter().find(|c| !c.contains(&boresight)) {
            let distance = crate::sky::separation(&circle.centre, &boresight);
            outcome.prior_disagreement = Some(distance);
            outcome.cause = Some(Cause::WrongPrior);
            outcome.detail =
                format!("{}: {:.3}° from the prior, the radius is {:.3}°", circle.name, distance / DEG, circle.radius / DEG);
            if self.settings().solver.prior_veto {
                outcome.reason = Reason::Requirement;
                outcome.candidate = Some(solution);
                return true;
            }
        }
        let min_matched = match found_by {
            FoundBy::Tracked => self.settings().solver.tracking.min_matched,
            FoundBy::LostInSpace => self.settings().solver.matching.min_matched,
        };
        let (detail, done) = match requirements::check(&solution, min_matched as usize, self.settings()) {
            Ok(()) => {
                outcome.reason = Reason::Solved;
                outcome.solution = Some(solution);
                return true;
            }
            Err(Refusal::Pose(detail)) => (detail, true),
            Err(Refusal::Fit(detail)) => (detail, false),
        };
        (outcome.reason, outcome.detail, outcome.candidate) = (Reason::Requirement, detail, Some(solution));
        done
    }

    /// The solution of a hypothesis by the final fit: by the sources as they were found or, where they may not be whole stars, by the
    /// light of all of them. Sources measured anew go into `sources`.
    pub(super) fn solution(
        &self,
        context: &Context<'_>,
        all: &[PatternSource],
        found: &Hypothesis,
        sources: &mut [SourceReport],
    ) -> Option<Solution> {
        let apply = self.settings().solver.fit.proper_motion;
        let epoch = context.year.unwrap_or(context.field.stars.epoch_yr);
        let years = if apply { epoch - context.field.stars.epoch_yr } else { 0.0 };
        let (field, geometry) = (context.field, &context.geometry);
        let (mut fit, mut matches) = refine(all, &found.pose, &found.matches, field, &self.catalogue, geometry, years)?;
        let mut all = all.to_vec();
        let tried = all.len().min(most_tried(&self.settings().solver, context));
        // Light that was seen to be in pieces has those within its reach in it already; what was taken for whole stars has none.
        let copy_px = nearest_copy(&all, &matches, 0.0);
        let far_copy_px = copy_px.and_then(|_| nearest_copy(&all, &matches, SEEN_PX));
        // What is in the fit's own covariance already: the light's middle is of the same photons as the places of its stars.
        let mut counted = 0.0;
        // Stars that are there again, moved: which of the pieces is the middle one nobody knows.
        // Along their trails stars are whole.
        let light = match context.along {
            Some(_) => LightFit::AsFound { doubt_px: 0.0 },
            None => fit_by_light(self, context, &fit, &matches, &mut all, tried, years),
        };
        let common_px = match light {
            LightFit::AsFound { doubt_px } => doubt_px.max(copy_px.unwrap_or(0.0)),
            LightFit::Anew(anew) => {
                (fit, matches) = (anew.fit, anew.matches);
                for (source, star) in anew.placed {
                    if let Some(report) = sources.get_mut(source) {
                        (report.x, report.y, report.flux, report.snr) = (star.x, star.y, star.flux, star.snr);
                        report.sigma_px = (0.5 * (star.covariance.0 + star.covariance.1)).sqrt();
                    }
                }
                counted = 1.0;
                anew.sigma_px.max(far_copy_px.unwrap_or(0.0))
            }
        };
        let mirror = (
            if context.camera.mirrored { 1.0 } else { -1.0 },
            if context.frame.rows == RowOrder::BottomFirst { 1.0 } else { -1.0 },
        );
        let star_at = |place: usize| {
            let star = field.stars.stars.get(place)?;
            Some((star.star as usize, moved(star, field, &self.catalogue, years)))
        };
        let mut solution = solution_of(&fit, &matches, &all, star_at, geometry, mirror, found.false_ln);
        solution.epoch_yr = apply.then_some(epoch);
        // Matches that lie so far off are of several kinds of pieces: where the stars are is not known better than that. Along trails they
        // are of one kind, and lie as far off as their σ say.
        let in_pieces = context.along.is_none() && solution.rms_px > WORST_RMS_PX * (1 << context.scale) as f64;
        let common_px = if in_pieces { common_px.max(solution.rms_px) } else { common_px };
        // What all sources have in common moves the boresight alone.
        let variance = (common_px * solution.platescale).powi(2);
        let known = solution.covariance.diagonal() * counted;
        let more = Vec3::new(variance - known.x, variance - known.y, 0.0).map(|v| v.max(0.0));
        solution.covariance += Mat3::from_diagonal(&more);
        if let Some(along) = &context.along {
            along.add_errors(context, &mut solution);
        }
        Some(solution)
    }
}
