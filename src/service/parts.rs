//! The parts that the settings may exchange: which camera, and which solver.

use super::camera::MakeSource;
use super::clock::Clock;
use super::file::{FileError, read_file};
use super::index::prepare;
use super::lens::SimulatedLens;
use super::solver::{MakeSolver, Solve};
#[cfg(feature = "aravis")]
use crate::camera::AravisCamera;
use crate::camera::{Directory, SimulatedSky, Source};
use crate::catalog::{Catalogue, MAX_FILE_BYTES};
use crate::image::{BadPixels, BadPixelsError, Frame};
use crate::settings::{CameraKind, LensKind, NO_ARAVIS, Settings};
use crate::simulate::brighten;
use crate::solve::{Exposures, Outcome, Prior, Report, Solver, Watch};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// What the service is made of besides its actors.
#[derive(Clone)]
pub struct Parts {
    /// Makes the camera's source; `None` for no camera.
    pub camera: Option<MakeSource>,
    /// Makes solvers.
    pub solver: MakeSolver,
    /// The simulated lens, where the settings have one.
    pub lens: Option<SimulatedLens>,
}

/// Why the settings' parts cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum PartsError {
    /// A real camera, for a program that was built without.
    #[error("camera.kind {NO_ARAVIS}")]
    NoDriver,
    /// Not a list of faults.
    #[error("lens.simulated.faults: {0}")]
    Faults(String),
    /// The list of bad pixels cannot be read.
    #[error("solver.sources.bad_pixels_file: {0}")]
    List(#[from] FileError),
    /// A line of it is wrong.
    #[error("solver.sources.bad_pixels_file: {0}")]
    Line(#[from] BadPixelsError),
}

impl Parts {
    /// The parts that the settings name. Catalogue, index and images are read and built when an actor asks for them.
    ///
    /// # Errors
    /// Where the list of bad pixels is wrong.
    pub fn of(settings: &Arc<Settings>) -> Result<Self, PartsError> {
        Self::with_stars(settings, &Stars::of(settings))
    }

    /// As [`Self::of`], with a catalogue that others use too.
    ///
    /// # Errors
    /// As there.
    pub fn with_stars(settings: &Arc<Settings>, stars: &Stars) -> Result<Self, PartsError> {
        let lens = simulated_lens(settings)?;
        let camera = match settings.camera.kind {
            CameraKind::None => None,
            #[cfg(feature = "aravis")]
            CameraKind::Aravis => {
                let settings = Arc::clone(settings);
                Some(source(move || Ok(AravisCamera::new(&settings.camera))))
            }
            #[cfg(not(feature = "aravis"))]
            CameraKind::Aravis => return Err(PartsError::NoDriver),
            CameraKind::Directory => {
                let settings = Arc::clone(settings);
                Some(source(move || Ok(Directory::new(&settings.camera))))
            }
            CameraKind::Sky => {
                let (settings, stars, lens) = (Arc::clone(settings), stars.clone(), lens.clone());
                Some(source(move || simulated_sky(&settings, &stars, lens.as_ref())))
            }
        };
        Ok(Self { camera, solver: make_solver(settings, stars)?, lens })
    }
}

/// Makes solvers by the settings.
///
/// # Errors
/// Where the list of bad pixels is wrong.
pub fn make_solver(settings: &Arc<Settings>, stars: &Stars) -> Result<MakeSolver, PartsError> {
    let bad_pixels = Arc::new(load_bad_pixels(settings)?);
    Ok(retouched(solver(Arc::clone(settings), stars.clone()), Arc::clone(settings), bad_pixels))
}

/// The simulated lens, where the settings have one.
///
/// # Errors
/// Where its list of faults is none.
pub fn simulated_lens(settings: &Settings) -> Result<Option<SimulatedLens>, PartsError> {
    let simulated = settings.lens.kind == LensKind::Simulated;
    let lens = simulated.then(|| SimulatedLens::new(&settings.lens, settings.simulate.seed));
    lens.transpose().map_err(PartsError::Faults)
}

/// The simulated sky behind a simulated lens, where there is one.
///
/// # Errors
/// Where the catalogue cannot be had, or `simulate.kind` is no kind of frame.
pub fn simulated_sky(settings: &Settings, stars: &Stars, lens: Option<&SimulatedLens>) -> Result<SimulatedSky, String> {
    let sky = SimulatedSky::new(settings, stars.load()?).map_err(|error| error.to_string())?;
    Ok(match lens.cloned() {
        Some(lens) => sky.behind(settings, move || lens.true_focus()),
        None => sky,
    })
}

/// Makes sources of one kind.
fn source<S: Source + 'static>(make: impl Fn() -> Result<S, String> + Send + Sync + 'static) -> MakeSource {
    Arc::new(move || Ok(Box::new(make()?) as Box<dyn Source>))
}

/// A solver that sees frames with their bad pixels replaced, and under a brighter sky where that is to be pretended; they are kept as the
/// camera gave them.
struct Retouched {
    inner: Box<dyn Solve>,
    bad_pixels: Arc<BadPixels>,
    settings: Arc<Settings>,
    /// Where the pixels of earlier copies were, one for each frame and exposure at most.
    memory: Vec<Vec<u16>>,
}

impl Retouched {
    /// A copy without bad pixels.
    fn mended(&mut self, frame: &Frame) -> Frame {
        let mut copy = frame.copy_in(self.memory.pop().unwrap_or_default());
        self.bad_pixels.apply(&mut copy);
        copy
    }
}

impl Solve for Retouched {
    fn solve(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome {
        let settings = Arc::clone(&self.settings);
        let Settings { brightness, camera, simulate, .. } = &*settings;
        if self.bad_pixels.is_empty() && !brightness.enabled {
            return self.inner.solve(frame, prior, watch);
        }
        let mut retouched = self.mended(frame);
        if brightness.enabled {
            // Another image, other photons.
            let seed = simulate.seed.wrapping_add(u64::from(frame.stamp.image.0));
            brighten(&mut retouched, brightness, camera.ideal_gain_adu_per_e, seed);
        }
        let outcome = self.inner.solve(&retouched, prior, watch);
        self.memory.push(retouched.pixels);
        outcome
    }

    fn solve_series(&mut self, frame: &Frame, series: &Exposures, prior: &Prior, watch: &dyn Watch) -> Outcome {
        // Under a sky that is pretended the exposures are not what is seen.
        if self.settings.brightness.enabled {
            return self.solve(frame, prior, watch);
        }
        if self.bad_pixels.is_empty() {
            return self.inner.solve_series(frame, series, prior, watch);
        }
        let frame = self.mended(frame);
        let exposures = series.exposures.iter().map(|exposure| Arc::new(self.mended(exposure))).collect();
        let series = Exposures { exposures, motion: series.motion.clone() };
        let outcome = self.inner.solve_series(&frame, &series, prior, watch);
        let exposures = series.exposures.into_iter().filter_map(|exposure| Arc::try_unwrap(exposure).ok());
        self.memory.extend(exposures.chain([frame]).map(|frame| frame.pixels));
        outcome
    }

    fn report(&self, outcome: &Outcome) -> Report {
        self.inner.report(outcome)
    }

    fn adopt(&mut self, settings: &Arc<Settings>) {
        self.settings = Arc::clone(settings);
        self.inner.adopt(settings);
    }
}

/// Makes solvers that see frames retouched: what `make` makes, behind the camera's bad pixels and the brightness simulator.
pub fn retouched(make: MakeSolver, settings: Arc<Settings>, bad_pixels: Arc<BadPixels>) -> MakeSolver {
    Arc::new(move || {
        let (inner, bad_pixels, settings) = (make()?, Arc::clone(&bad_pixels), Arc::clone(&settings));
        Ok(Box::new(Retouched { inner, bad_pixels, settings, memory: Vec::new() }) as Box<dyn Solve>)
    })
}

/// The camera's bad pixels, by the file that the settings name; none where there is no such file.
///
/// # Errors
/// Where the file cannot be read, or a line of it is wrong.
pub fn load_bad_pixels(settings: &Settings) -> Result<BadPixels, PartsError> {
    /// Longer than the list of any detector that is worth flying, bytes: more than a million pixels.
    const LONGEST: usize = 16 << 20;
    let name = &settings.solver.sources.bad_pixels_file;
    if name.is_empty() {
        return Ok(BadPixels::default());
    }
    let bytes = read_file(Path::new(name), LONGEST, "bad pixels, \"x y\" a line")?;
    // What is not text is refused with its line, as anything else that is not two numbers.
    Ok(BadPixels::parse(name, &String::from_utf8_lossy(&bytes))?)
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
                let clock = Clock::start();
                let prepared = prepare(&mut solver, settings.camera.width_px as usize, settings.camera.height_px as usize);
                prepared.complaints.iter().for_each(|complaint| tracing::warn!("{complaint}"));
                tracing::info!(seconds = clock.uptime().as_secs_f64(), "the index is {}", prepared.word());
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

    fn solve_series(&mut self, frame: &Frame, series: &Exposures, prior: &Prior, watch: &dyn Watch) -> Outcome {
        Self::solve_series(self, frame, series, prior, watch)
    }

    fn report(&self, outcome: &Outcome) -> Report {
        Report::new(outcome, self.catalogue())
    }

    fn adopt(&mut self, settings: &Arc<Settings>) {
        if !Arc::ptr_eq(self.settings(), settings) {
            self.set_settings(Arc::clone(settings));
        }
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
        let catalogue = Arc::new(load_catalogue(&self.settings.catalog.file)?);
        Ok(Arc::clone(loaded.insert(catalogue)))
    }
}

/// Reads a star catalogue: the built-in one where the name is empty, as the setting `catalog.file` has it.
///
/// # Errors
/// Why the file can't be read, or is not a whole and unaltered catalogue, in words that name it.
pub fn load_catalogue(name: &str) -> Result<Catalogue, String> {
    if name.is_empty() {
        return Catalogue::embedded().map_err(|error| format!("the built-in star catalogue: {error}"));
    }
    let bytes = read_file(Path::new(name), MAX_FILE_BYTES, "a star catalogue").map_err(|error| error.to_string())?;
    Catalogue::from_bytes(&bytes).map_err(|error| format!("{name}: {error}"))
}
