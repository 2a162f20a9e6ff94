//! What the tests of the solver share.

use stars::catalog::Catalogue;
use stars::settings::Settings;
use stars::solve::Solver;
use std::sync::{Arc, OnceLock};

/// A solver with the shipped settings, some changed. All of a program's share one index, which takes a second to build.
pub fn solver_with(change: impl FnOnce(&mut Settings)) -> Solver {
    static SOLVER: OnceLock<Solver> = OnceLock::new();
    let shared = SOLVER.get_or_init(|| {
        let mut solver = Solver::new(Arc::new(Catalogue::embedded().unwrap()), Arc::new(Settings::flight().unwrap()));
        solver.prepare(1536, 1024);
        solver
    });
    let (mut solver, mut settings) = (shared.clone(), Settings::clone(shared.settings()));
    change(&mut settings);
    solver.set_settings(Arc::new(settings));
    solver
}
