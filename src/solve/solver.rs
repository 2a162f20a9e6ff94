//! The solver: one frame in, one outcome out.

use super::{Outcome, Prior, Reason, Watch};
use crate::catalog::Catalogue;
use crate::image::Frame;
use crate::settings::Settings;
use std::sync::Arc;

/// Solves frames. Holds the catalogue, the index for one field, and the memory that a frame needs, so that nothing is allocated
/// per frame after the first. A clone shares catalogue and index and has memory of its own.
#[derive(Debug, Clone)]
pub struct Solver {
    catalogue: Arc<Catalogue>,
    settings: Arc<Settings>,
}

impl Solver {
    /// A solver for the given settings; the index is built with the first frame, or by [`Self::prepare`].
    pub fn new(catalogue: Arc<Catalogue>, settings: Arc<Settings>) -> Self {
        Self { catalogue, settings }
    }

    /// Builds the index for frames of a size, px, unless it is there (well under 2 s).
    pub fn prepare(&mut self, _width: usize, _height: usize) {}

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
    pub fn solve(&mut self, frame: &Frame, _prior: &Prior, _watch: &dyn Watch) -> Outcome {
        Outcome::unsolved(frame.stamp.clone(), Reason::Failed, "the solver is not there yet")
    }
}
