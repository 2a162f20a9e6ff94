//! Two threads for one frame: the only place in the core that has them, and they have ended before it returns.

use super::solver::{Search, Solver, stopped};
use super::{Outcome, Part, SearchMode, Stop};
use crate::sources::{Look, SearchKernel};
use std::sync::atomic::{AtomicBool, Ordering};

impl Solver {
    /// The normal search, while a second thread makes the survey that the robust one begins with: the outcome is that of one after the
    /// other, and a frame that needs both has it sooner.
    pub(super) fn search_abreast(&mut self, search: &Search<'_>, outcome: &mut Outcome) {
        let (mut second, cells, settings) = (std::mem::take(&mut self.second), self.cells.clone(), self.settings().clone());
        let solved = AtomicBool::new(false);
        let survey = || {
            let keep_on = || !solved.load(Ordering::Relaxed) && search.watch.stop_at(Part::Survey).is_none();
            let look = Look { settings: &settings.solver.sources, masked: &search.masked(), keep_on: &keep_on };
            second.begin(search.frame, &cells);
            second.survey(search.frame, &cells, &look)
        };
        let kernels = std::thread::scope(|scope| {
            // Where no thread is to be had the survey is made by the robust search itself.
            let thread = std::thread::Builder::new().name("survey".into()).spawn_scoped(scope, survey).ok();
            let done = self.search_with(search, SearchKernel::Sharp, outcome);
            solved.store(done, Ordering::Relaxed);
            let started = search.watch.elapsed();
            let kernels = thread.map(|thread| thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
            outcome.times.find += search.watch.elapsed() - started;
            (!done).then_some(kernels)
        });
        self.second = second;
        let Some(kernels) = kernels else { return };
        outcome.mode = SearchMode::Robust;
        match kernels {
            Some(Some(kernels)) => {
                std::mem::swap(&mut self.finder, &mut self.second);
                self.search_lists(search, kernels, outcome);
            }
            Some(None) => _ = stopped(outcome, search.watch.stop().unwrap_or(Stop::Aborted)),
            None => self.search_widely(search, outcome),
        }
    }
}
