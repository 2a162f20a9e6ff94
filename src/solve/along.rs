//! Solving a series of exposures whose motion is known: stars are found along the trails that they leave, at where they were at the
//! middle of the light.

use super::in_common::InCommon;
use super::motion::Motion;
use super::solver::{Context, Search, Solver, stopped};
use super::{Outcome, Prior, Reason, SearchMode, SeriesStart, Solution, SourceReport, Stop, Watch};
use crate::image::{CellStatistics, Frame};
use crate::sky::{Attitude, CameraModel, Vec3};
use crate::sources::{Look, Trail, shares_along};
use nalgebra::Matrix2;
use std::sync::Arc;

/// Trails whose ends lie so far from where they should are made anew, px.
const MISFIT_PX: f64 = 0.05;

/// Stars that shine in an exposure with less than this part of their light, beyond so many σ, are missing from it: it was not exposed when
/// the motion says, or did not move so.
const LEAST_SHARE: f64 = 0.5;
const MISSING_SIGMAS: f64 = 4.0;

/// The exposures of a frame, and their motion.
#[derive(Debug, Clone)]
pub struct Exposures {
    /// The exposures whose sum the frame is.
    pub exposures: Vec<Arc<Frame>>,
    /// How the gondola turned during them, where that is known.
    pub motion: Option<Arc<Motion>>,
}

impl Exposures {
    /// The statistics of each.
    pub(super) fn cells(&self) -> Vec<CellStatistics> {
        let mut cells = vec![CellStatistics::default(); self.exposures.len()];
        for (cells, exposure) in cells.iter_mut().zip(&self.exposures) {
            cells.measure(exposure, exposure.full_scale);
        }
        cells
    }

    /// How much of the light of a solution's stars is in each, by these trails: [`shares_along`].
    pub(super) fn shares(&self, cells: &[CellStatistics], trails: &[Trail], stars: &[(f64, f64, f64)]) -> Vec<(f64, f64)> {
        let exposures: Vec<&Frame> = self.exposures.iter().map(|exposure| &**exposure).collect();
        shares_along(&exposures, cells, trails, stars)
    }
}

/// Places, px, and fluxes of the stars that a frame is solved by; none where it is not.
pub(super) fn matched_stars(outcome: &Outcome) -> Vec<(f64, f64, f64)> {
    let star = |source: &SourceReport| (source.x, source.y, source.flux);
    let matches = outcome.solution.iter().flat_map(|solution| &solution.matches);
    matches.filter_map(|m| outcome.sources.get(m.source).map(star)).collect()
}

/// Trails along which sources were found.
#[derive(Debug, Clone, Copy)]
pub(super) struct Along<'a> {
    motion: &'a Motion,
    pub exposures: &'a [&'a Frame],
    /// The statistics of each exposure.
    pub cells: &'a [CellStatistics],
    pub trails: &'a [Trail],
    /// The plate scale that they were made for, rad/px.
    platescale: f64,
}

impl Along<'_> {
    /// Adds to a solution's errors what all its stars have in common, and says where the series began.
    pub fn add_errors(&self, context: &Context<'_>, solution: &mut Solution) {
        let track = self.motion.track();
        let mut start = SeriesStart {
            attitude: solution.attitude.turned(&-track.turn_to_middle()),
            before_middle_s: self.motion.start_to_middle_s(),
            variance: self.motion.variance_to_middle(),
        };
        if let Some(common) = InCommon::of(self.motion, self.trails) {
            let camera = &context.camera;
            let (middle, left, up) = (camera.position(0.0, 0.0), camera.position(1.0, 0.0), camera.position(0.0, 1.0));
            // From left and up to the file's x and y, which are the same but for their signs.
            let turned = Matrix2::new(left.0 - middle.0, up.0 - middle.0, left.1 - middle.1, up.1 - middle.1);
            let scale_sq = solution.platescale * solution.platescale;
            let walk = turned * self.motion.walk() * turned.transpose() / scale_sq;
            let start_s = self.motion.exposures.first().map_or(0.0, |exposure| exposure.0);
            let (of_middle, of_start) = common.of_walk(&walk, start_s);
            let misfit = solution.platescale / self.platescale - 1.0;
            let off = common.of_stretch(misfit.hypot(solution.sigma_platescale / solution.platescale));
            let of_middle = of_middle + off * off.transpose();
            let on_sky = on_sky(&solution.attitude) * turned.transpose();
            let more = on_sky * of_middle * on_sky.transpose() * scale_sq;
            let mut axes = solution.covariance.fixed_view_mut::<2, 2>(0, 0);
            axes += more;
            start.variance = (0.5 * (of_start.trace() - of_middle.trace()) * scale_sq).max(0.0);
        }
        solution.start = Some(start);
    }
}

/// From left and up of an attitude to east and north.
fn on_sky(attitude: &Attitude) -> Matrix2<f64> {
    let (left, up, boresight) = (attitude.left(), attitude.up(), attitude.boresight());
    // At a pole any direction is as good.
    let east = Vec3::z().cross(&boresight).try_normalize(f64::EPSILON).unwrap_or_else(Vec3::y);
    let north = boresight.cross(&east);
    Matrix2::new(left.dot(&east), up.dot(&east), left.dot(&north), up.dot(&north))
}

impl Solver {
    /// As [`Self::solve`], a frame that is the sum of these exposures. Where its motion is known stars are searched along their trails first;
    /// where that does not solve, or the motion cannot be used, as if it were not known, and then the stars have to stand still.
    pub fn solve_series(&mut self, frame: &Frame, exposures: &Exposures, prior: &Prior, watch: &dyn Watch) -> Outcome {
        self.solve_in(frame, prior, watch, (true, self.settings().solver.robust), Some(exposures))
    }

    /// The search along trails; `true` where the frame is done with. Once a solution has told the plate scale, long trails are made anew by
    /// it: the better they fit, the more of the light they gather.
    pub(super) fn search_along(&mut self, search: &Search<'_>, moved: &Exposures, outcome: &mut Outcome) -> bool {
        let (Some(field), Some(motion)) = (self.field().cloned(), &moved.motion) else { return false };
        let context = self.context(search.frame, search.prior, search.watch, &field);
        let cells = moved.cells();
        let trails = motion.check(moved.exposures.len()).and_then(|()| motion.trails(&context.camera));
        let mut trails = match trails {
            Ok(trails) => trails,
            Err(error) => {
                tracing::warn!(image = search.frame.stamp.image.0, %error, "the motion of this image is not used");
                return false;
            }
        };
        let before = outcome.clone();
        let mut done = self.search_trails(search, &context, (moved, motion, &cells, &trails), context.camera.platescale, outcome);
        // A fit that is too poor to serve tells the plate scale all the same.
        let lens =
            outcome.solution.as_ref().or(outcome.candidate.as_ref()).filter(|_| done || outcome.reason == Reason::Requirement);
        let lens = lens.map(|solution| (solution.platescale, solution.k1));
        let reach = trails.iter().map(Trail::reach).fold(0.0, f64::max);
        if let Some((platescale, k1)) = lens
            && reach * (platescale / context.camera.platescale - 1.0).abs() > MISFIT_PX
            && let Ok(anew) = motion.trails(&CameraModel { platescale, k1, ..context.camera })
        {
            let mut again = outcome.clone();
            if self.search_trails(search, &context, (moved, motion, &cells, &anew), platescale, &mut again)
                && again.reason == Reason::Solved
            {
                (trails, *outcome, done) = (anew, again, true);
            }
        }
        if !done {
            outcome.mode = SearchMode::Normal;
            return false;
        }
        if let Some(missing) = missing_from(moved, &cells, &trails, outcome) {
            tracing::warn!(
                image = search.frame.stamp.image.0,
                exposure = missing,
                "the motion of this image is not used: stars are not where it puts them"
            );
            *outcome = before;
            return false;
        }
        true
    }

    /// One search along trails; `true` where the frame is done with.
    fn search_trails(
        &mut self,
        search: &Search<'_>,
        context: &Context<'_>,
        (moved, motion, cells, trails): (&Exposures, &Motion, &[CellStatistics], &[Trail]),
        platescale: f64,
        outcome: &mut Outcome,
    ) -> bool {
        let exposures: Vec<&Frame> = moved.exposures.iter().map(|exposure| &**exposure).collect();
        let along = Along { motion, exposures: &exposures, cells, trails, platescale };
        let context = &Context { along: Some(along), ..context.clone() };
        let watch = search.watch;
        let started = watch.elapsed();
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

/// The first exposure from which the stars of a solution are missing.
fn missing_from(moved: &Exposures, cells: &[CellStatistics], trails: &[Trail], outcome: &Outcome) -> Option<usize> {
    outcome.solution.as_ref()?;
    let shares = moved.shares(cells, trails, &matched_stars(outcome));
    shares.iter().position(|(share, sigma)| *share < LEAST_SHARE && *share + MISSING_SIGMAS * sigma < 1.0)
}
