//! Solving a series of exposures whose motion is known: stars are found along the trails that they leave, at where they were at the
//! middle of the light.

use super::motion::Motion;
use super::solver::{Context, Search, Solver, stopped};
use super::{Outcome, Prior, Reason, SearchMode, Stop, Watch};
use crate::image::{CellStatistics, Frame};
use crate::sky::CameraModel;
use crate::sources::{Look, Trail};
use std::sync::Arc;

/// Trails whose ends lie so far from where they should are made anew, px.
const MISFIT_PX: f64 = 0.25;

/// The exposures of a frame, and how the gondola turned during them.
#[derive(Debug, Clone)]
pub struct Moved {
    /// The exposures whose sum the frame is.
    pub exposures: Vec<Arc<Frame>>,
    /// The motion.
    pub motion: Arc<Motion>,
}

impl Solver {
    /// As [`Self::solve`], a frame whose motion is known: the sum of these exposures. Stars are searched along their trails first; where
    /// that does not solve, or the motion cannot be used, as if it were not known.
    pub fn solve_moved(&mut self, frame: &Frame, moved: &Moved, prior: &Prior, watch: &dyn Watch) -> Outcome {
        self.solve_in(frame, prior, watch, (true, self.settings().solver.robust), Some(moved))
    }

    /// The search along trails; `true` where the frame is done with. Once a solution has told the plate scale, long trails are made anew by
    /// it: the better they fit, the more of the light they gather.
    pub(super) fn search_along(&mut self, search: &Search<'_>, moved: &Moved, outcome: &mut Outcome) -> bool {
        let Some(field) = self.field().cloned() else { return false };
        let context = self.context(search.frame, search.prior, search.watch, &field);
        let context = Context { motion: Some(&moved.motion), ..context };
        let mut cells = vec![CellStatistics::default(); moved.exposures.len()];
        for (cells, exposure) in cells.iter_mut().zip(&moved.exposures) {
            cells.measure(exposure, exposure.full_scale);
        }
        let trails = moved.motion.check(moved.exposures.len()).and_then(|()| moved.motion.trails(&context.camera));
        let trails = match trails {
            Ok(trails) => trails,
            Err(error) => {
                tracing::warn!(image = search.frame.stamp.image.0, %error, "the motion of this image is not used");
                return false;
            }
        };
        if !self.search_trails(search, &context, (moved, &cells, &trails), outcome) {
            outcome.mode = SearchMode::Normal;
            return false;
        }
        let platescale = outcome.solution.as_ref().map_or(context.camera.platescale, |solution| solution.platescale);
        let reach = trails.iter().map(Trail::reach).fold(0.0, f64::max);
        if reach * (platescale / context.camera.platescale - 1.0).abs() > MISFIT_PX
            && let Ok(trails) = moved.motion.trails(&CameraModel { platescale, ..context.camera })
        {
            let mut again = outcome.clone();
            if self.search_trails(search, &context, (moved, &cells, &trails), &mut again) && again.reason == Reason::Solved {
                *outcome = again;
            }
        }
        true
    }

    /// One search along trails; `true` where the frame is done with.
    fn search_trails(
        &mut self,
        search: &Search<'_>,
        context: &Context<'_>,
        (moved, cells, trails): (&Moved, &[CellStatistics], &[Trail]),
        outcome: &mut Outcome,
    ) -> bool {
        let watch = search.watch;
        let started = watch.elapsed();
        let exposures: Vec<&Frame> = moved.exposures.iter().map(|exposure| &**exposure).collect();
        let settings = self.settings().clone();
        let (masked, keep_on) = (search.masked(), search.keep_on());
        let look = Look { settings: &settings.solver.sources, masked: &masked, keep_on: &keep_on };
        let finished = self.finder.find_along(&exposures, cells, trails, &look, &mut self.found);
        outcome.times.find += watch.elapsed() - started;
        if !finished {
            return stopped(outcome, watch.stop().unwrap_or(Stop::Aborted));
        }
        outcome.mode = SearchMode::Motion;
        self.report_sources(outcome);
        settings.solver.matching.enabled && self.match_found(context, &look, outcome)
    }
}
