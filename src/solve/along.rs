//! Solving a series of exposures whose motion is known: stars are found along the trails that they leave, at where they were at the
//! middle of the light.

use super::motion::Motion;
use super::solver::{Search, Solver, stopped};
use super::{Outcome, Prior, SearchMode, Stop, Watch};
use crate::image::{CellStatistics, Frame};
use crate::sources::Look;
use std::sync::Arc;

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

    /// The search along trails; `true` where the frame is done with.
    pub(super) fn search_along(&mut self, search: &Search<'_>, moved: &Moved, outcome: &mut Outcome) -> bool {
        let &Search { frame, prior, watch, .. } = search;
        let started = watch.elapsed();
        let Some(field) = self.field().cloned() else { return false };
        let context = self.context(frame, prior, watch, &field);
        let trails = moved.motion.check(moved.exposures.len()).and_then(|()| moved.motion.trails(&context.camera));
        let trails = match trails {
            Ok(trails) => trails,
            Err(error) => {
                tracing::warn!(image = frame.stamp.image.0, %error, "the motion of this image is not used");
                return false;
            }
        };
        let context =
            super::solver::Context { turn: Some((moved.motion.turn_to_middle(), moved.motion.variance_of_middle())), ..context };
        let exposures: Vec<&Frame> = moved.exposures.iter().map(|exposure| &**exposure).collect();
        let mut cells = vec![CellStatistics::default(); exposures.len()];
        for (cells, exposure) in cells.iter_mut().zip(&exposures) {
            cells.measure(exposure, exposure.full_scale);
        }
        let settings = self.settings().clone();
        let (masked, keep_on) = (search.masked(), search.keep_on());
        let look = Look { settings: &settings.solver.sources, masked: &masked, keep_on: &keep_on };
        let finished = self.finder.find_along(&exposures, &cells, &trails, &look, &mut self.found);
        outcome.times.find += watch.elapsed() - started;
        if !finished {
            return stopped(outcome, watch.stop().unwrap_or(Stop::Aborted));
        }
        outcome.mode = SearchMode::Motion;
        self.report_sources(outcome);
        let done = settings.solver.matching.enabled && self.match_found(&context, &look, outcome);
        if !done {
            outcome.mode = SearchMode::Normal;
        }
        done
    }
}
