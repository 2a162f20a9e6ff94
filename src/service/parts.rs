//! The parts that the settings may exchange: which camera, and which solver.

use super::camera::MakeSource;
use super::solver::{MakeSolver, Solve};
use crate::camera::{Directory, SimulatedSky, Source};
use crate::catalog::{Catalogue, MAX_FILE_BYTES};
use crate::image::Frame;
use crate::settings::{CameraKind, Settings};
use crate::solve::{Outcome, Prior, Report, Solver, Watch};
use std::fs::File;
use std::io::Read;
use std::sync::{Arc, Mutex, PoisonError};

/// What the service is made of besides its actors.
#[derive(Clone)]
pub struct Parts {
    /// Makes the camera's source; `None` for no camera.
    pub camera: Option<MakeSource>,
    /// Makes solvers.
    pub solver: MakeSolver,
}

impl Parts {
    /// The parts that the settings name. Nothing is read or built before an actor asks for it.
    pub fn of(settings: &Arc<Settings>) -> Self {
        let stars = Stars::of(settings);
        let camera: Option<MakeSource> = match settings.camera.kind {
            CameraKind::None => None,
            CameraKind::Directory => {
                let settings = Arc::clone(settings);
                Some(Arc::new(move || Ok(Box::new(Directory::new(&settings.camera)) as Box<dyn Source>)))
            }
            CameraKind::Sky => {
                let (settings, stars) = (Arc::clone(settings), stars.clone());
                Some(Arc::new(move || {
                    let sky = SimulatedSky::new(&settings, stars.load()?).map_err(|error| error.to_string())?;
                    Ok(Box::new(sky) as Box<dyn Source>)
                }))
            }
        };
        Self { camera, solver: solver(Arc::clone(settings), stars) }
    }
}

/// Makes solvers that share one catalogue and one index, which the first of them builds.
fn solver(settings: Arc<Settings>, stars: Stars) -> MakeSolver {
    let first: Mutex<Option<Solver>> = Mutex::new(None);
    Arc::new(move || {
        let mut first = first.lock().unwrap_or_else(PoisonError::into_inner);
        let ready = match &*first {
            Some(solver) => solver.clone(),
            None => {
                let mut solver = Solver::new(stars.load()?, Arc::clone(&settings));
                solver.prepare(settings.camera.width_px as usize, settings.camera.height_px as usize);
                first.insert(solver).clone()
            }
        };
        Ok(Box::new(ready) as Box<dyn Solve>)
    })
}

impl Solve for Solver {
    fn solve(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome {
        Self::solve(self, frame, prior, watch)
    }

    fn report(&self, outcome: &Outcome) -> Report {
        Report::new(outcome, self.catalogue())
    }
}

/// The catalogue that the settings name, read once and shared by all who ask.
#[derive(Clone)]
pub struct Stars {
    settings: Arc<Settings>,
    loaded: Arc<Mutex<Option<Arc<Catalogue>>>>,
}

impl Stars {
    /// The catalogue of the settings, not read yet.
    pub fn of(settings: &Arc<Settings>) -> Self {
        Self { settings: Arc::clone(settings), loaded: Arc::default() }
    }

    /// The catalogue; blocking when it is asked for the first time. A file that is refused is tried again the next time.
    ///
    /// # Errors
    /// Why there is none, in words that name the file.
    pub fn load(&self) -> Result<Arc<Catalogue>, String> {
        let mut loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(catalogue) = &*loaded {
            return Ok(Arc::clone(catalogue));
        }
        let catalogue = Arc::new(read_catalogue(&self.settings.catalog.file)?);
        Ok(Arc::clone(loaded.insert(catalogue)))
    }
}

fn read_catalogue(file: &str) -> Result<Catalogue, String> {
    if file.is_empty() {
        return Catalogue::embedded().map_err(|error| format!("the built-in catalogue: {error}"));
    }
    let wrong = |error: std::io::Error| format!("catalog.file \"{file}\": {error}");
    let mut bytes = Vec::new();
    File::open(file).and_then(|opened| opened.take(MAX_FILE_BYTES as u64 + 1).read_to_end(&mut bytes)).map_err(wrong)?;
    Catalogue::from_bytes(&bytes).map_err(|error| format!("catalog.file \"{file}\": {error}"))
}
