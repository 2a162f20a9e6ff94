//! Replay: a journal run again, on the machines of the core and a solver, with the images that were kept.
//!
//! With the settings of the flight everything must come out as it did, to the last bit: a frame that was stopped is stopped at the same
//! question. With other settings frames come out as they would have: each is given the time that the settings allow, commands to give one
//! up are not followed, and what is known beforehand comes from the outcomes of the replay itself. Blocking.

use super::file::read_file;
use super::parts::{PartsError, Stars, make_solver};
use super::solver::{MakeSolver, Solve};
use super::store;
use crate::command::Tick;
use crate::image::{Frame, ImageCounter, Series, read};
use crate::journal::{Entry, Exposure, Machine, Machines, OutcomeMark, Seen, Solved, Text, Tracking, What, pixel_sum};
use crate::settings::{Layers, Settings};
use crate::solve::{Exposures, Outcome, Prior, Rerun, Stop, Watch};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::Instant;

/// No image is longer, bytes: 60 megapixels of 16 bits with their header.
const LONGEST_IMAGE: usize = 160 << 20;

/// What is to be run again, and how.
#[derive(Debug, Clone, Default)]
pub struct Wishes {
    /// Settings other than those of the flight, `key=value`.
    pub set: Vec<String>,
    /// Where the images lie, if not where the settings of the flight say.
    pub images: Option<PathBuf>,
    /// The one image that is wanted.
    pub image: Option<ImageCounter>,
}

/// What became of a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Now {
    /// It was solved again; these parts of its outcome differ, and `None` is no difference.
    Again {
        /// How it ended now.
        outcome: Box<OutcomeMark>,
        /// The parts that differ.
        differs: Vec<&'static str>,
    },
    /// It could not be, and why.
    Not(String),
}

/// A frame that was run again.
#[derive(Debug, Clone, PartialEq)]
pub struct Again {
    /// When it was captured, since the start of its run.
    pub at: Tick,
    /// Its number.
    pub image: ImageCounter,
    /// Where it came from.
    pub origin: String,
    /// How it ended then.
    pub was: OutcomeMark,
    /// And now.
    pub now: Now,
}

impl Again {
    /// Whether it ended otherwise.
    pub fn differs(&self) -> bool {
        matches!(&self.now, Now::Again { differs, .. } if !differs.is_empty())
    }
}

/// What came out, how often.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Answers {
    /// As it did.
    pub same: u64,
    /// Otherwise.
    pub other: u64,
    /// Nothing can be said.
    pub unknown: u64,
}

/// What was counted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Tally {
    /// Runs of the service that began.
    pub runs: u32,
    /// Entries.
    pub entries: u64,
    /// Entries that are missing, as the journal says.
    pub lost: u64,
    /// The answers of each machine.
    pub machines: BTreeMap<Machine, Answers>,
    /// What was known of frames beforehand.
    pub priors: Answers,
    /// Frames; nothing can be said of those that could not be run.
    pub frames: Answers,
    /// How frames ended then, of those that were run.
    pub reasons: BTreeMap<String, u64>,
    /// Why frames could not be run.
    pub not_run: BTreeMap<String, u64>,
    /// The first difference of all, in words.
    pub first: Option<String>,
}

impl Tally {
    /// Whether anything came out otherwise.
    pub fn differs(&self) -> bool {
        self.first.is_some()
    }

    fn note(&mut self, words: impl FnOnce() -> String) {
        if self.first.is_none() {
            self.first = Some(words());
        }
    }
}

/// The directories that were looked through, and the files of their exposures by start, image and place in its series.
type Shelf = (Vec<PathBuf>, BTreeMap<(u32, u32, u8), PathBuf>);

/// A replay under way.
pub struct Replay {
    wishes: Wishes,
    stars: Option<Stars>,
    make: Option<MakeSolver>,
    solver: Option<Box<dyn Solve>>,
    /// Settings by the fingerprint of those of the flight, with what is wished otherwise.
    settings: BTreeMap<u64, Arc<Settings>>,
    machines: Machines,
    tracking: Tracking,
    /// What was known of the last frame beforehand.
    prior: Prior,
    shelf: Option<Shelf>,
    tally: Tally,
}

impl Replay {
    /// Of journals from their beginning, or from wherever they begin.
    pub fn new(wishes: Wishes) -> Self {
        Self {
            wishes,
            stars: None,
            make: None,
            solver: None,
            settings: BTreeMap::new(),
            machines: Machines::unknown(),
            tracking: Tracking::in_doubt(),
            prior: Prior::default(),
            shelf: None,
            tally: Tally::default(),
        }
    }

    /// The same with a solver that there is already.
    pub fn with_solver(wishes: Wishes, make: MakeSolver) -> Self {
        Self { make: Some(make), ..Self::new(wishes) }
    }

    /// What was counted by now.
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Whether other settings are wished than those of the flight.
    pub fn is_otherwise(&self) -> bool {
        !self.wishes.set.is_empty()
    }

    /// Something of the journal is missing here, torn or thinned.
    pub fn doubt(&mut self) {
        self.machines.doubt();
        self.tracking.doubt();
    }

    /// A frame is passed over: what was known of the next ones is not sure.
    pub fn pass_over(&mut self) {
        self.tracking.doubt();
    }

    /// What a frame that is given up must leave as it was.
    pub fn checkpoint(&self) -> Tracking {
        self.tracking.clone()
    }

    /// Forgets a frame that was given up.
    pub fn go_back(&mut self, tracking: Tracking) {
        self.tracking = tracking;
    }

    /// Takes one entry; a frame, if it is one and wanted. `cancelled` ends the work on a frame early, whose outcome means nothing then.
    ///
    /// # Errors
    /// Settings that are no settings of this program, or that what is wished cannot be joined with; a solver that cannot be had.
    pub fn take(&mut self, entry: Entry, cancelled: &(dyn Fn() -> bool + Sync)) -> Result<Option<Again>, String> {
        self.tally.entries += 1;
        let at = entry.at;
        match entry.what {
            What::Begin(begin) => {
                self.tally.runs += 1;
                let settings = self.introduce(&begin.settings)?;
                self.machines = Machines::begin(&begin, &settings);
                self.make = None;
                self.solver = None;
            }
            What::Settings(text) => _ = self.introduce(&text)?,
            What::Lost(count) => {
                self.tally.lost += u64::from(count);
                self.doubt();
            }
            What::SolverBegins => self.tracking = Tracking::default(),
            What::Solved(solved) => return self.frame(at, &solved, cancelled),
            // What they would have been told with other settings nobody knows.
            _ if self.is_otherwise() => {}
            what => match self.machines.take(Entry { at, what }) {
                Seen::Same(machine) => self.tally.machines.entry(machine).or_default().same += 1,
                Seen::Unknown(machine) => self.tally.machines.entry(machine).or_default().unknown += 1,
                Seen::Differs { machine, now } => {
                    self.tally.machines.entry(machine).or_default().other += 1;
                    self.tally.note(|| format!("{} at {:.3} s: now {now}", machine.name(), at.as_secs_f64()));
                }
                Seen::Other => {}
            },
        }
        Ok(None)
    }

    /// Settings of the flight, with what is wished otherwise.
    fn introduce(&mut self, text: &Text) -> Result<Arc<Settings>, String> {
        if let Some(known) = self.settings.get(&text.fingerprint) {
            return Ok(Arc::clone(known));
        }
        let layers = Layers::flight("the journal", text.toml.as_str());
        let layers = self.wishes.set.iter().fold(layers, |layers, assignment| layers.set(assignment));
        let settings = Arc::new(layers.load().map_err(|error| error.to_string())?.settings);
        self.settings.insert(text.fingerprint, Arc::clone(&settings));
        Ok(settings)
    }

    /// A frame that the solver was given.
    fn frame(&mut self, at: Tick, solved: &Solved, cancelled: &(dyn Fn() -> bool + Sync)) -> Result<Option<Again>, String> {
        let image = solved.stamp.image;
        if self.wishes.image.is_some_and(|wanted| wanted != image) {
            self.pass_over();
            return Ok(None);
        }
        let Some(settings) = self.settings.get(&solved.settings).cloned() else {
            return Ok(Some(self.not_run(at, solved, "its settings are missing")));
        };
        if solved.window.is_before_search() && !self.is_otherwise() {
            return Ok(Some(self.not_run(at, solved, "it was stopped while the index was made")));
        }
        self.prior = self.prior_of(at, solved, &settings);
        let (frame, exposures) = match self.pixels(solved, &settings) {
            Ok(pixels) => pixels,
            Err(why) => return Ok(Some(self.not_run(at, solved, &why))),
        };
        let outcome = self.solve(solved, (&frame, exposures), &settings, cancelled)?;
        self.tracking.learn(solved, &outcome, &settings.solver.tracking);
        let now = OutcomeMark::of(&outcome);
        let differs = solved.outcome.differences(&now);
        *self.tally.reasons.entry(solved.outcome.reason.to_string()).or_default() += 1;
        if differs.is_empty() {
            self.tally.frames.same += 1;
        } else {
            self.tally.frames.other += 1;
            let was = &solved.outcome;
            let words = format!("image {} at {:.3} s: {}: {was}; now {now}", image.0, at.as_secs_f64(), differs.join(", "));
            self.tally.note(|| words);
        }
        let now = Now::Again { outcome: Box::new(now), differs };
        Ok(Some(Again { at, image, origin: solved.stamp.origin.clone(), was: solved.outcome.clone(), now }))
    }

    fn not_run(&mut self, at: Tick, solved: &Solved, why: &str) -> Again {
        self.tracking.doubt();
        self.tally.frames.unknown += 1;
        *self.tally.not_run.entry(why.to_owned()).or_default() += 1;
        let (image, origin, was) = (solved.stamp.image, solved.stamp.origin.clone(), solved.outcome.clone());
        Again { at, image, origin, was, now: Now::Not(why.to_owned()) }
    }

    /// What is known of a frame beforehand: by the replay's own outcomes where other settings are wished, and otherwise as it was, which
    /// the replay's own outcomes must lead to as well.
    fn prior_of(&mut self, at: Tick, solved: &Solved, settings: &Settings) -> Prior {
        let own = if solved.again { self.prior.clone() } else { self.tracking.prior(solved, &settings.solver.tracking) };
        match (self.is_otherwise(), self.tracking.is_sure()) {
            (true, true) => return own,
            (true, false) => {}
            (false, false) => self.tally.priors.unknown += 1,
            (false, true) if solved.prior == own => self.tally.priors.same += 1,
            (false, true) => {
                self.tally.priors.other += 1;
                let image = solved.stamp.image.0;
                self.tally.note(|| format!("image {image} at {:.3} s: another prior", at.as_secs_f64()));
            }
        }
        solved.prior.clone()
    }

    fn solve(
        &mut self,
        solved: &Solved,
        (frame, exposures): (&Frame, Vec<Arc<Frame>>),
        settings: &Arc<Settings>,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Outcome, String> {
        let solver = match &mut self.solver {
            Some(solver) => solver,
            none => {
                let make = match &self.make {
                    Some(make) => Arc::clone(make),
                    None => {
                        let stars = self.stars.get_or_insert_with(|| Stars::of(settings));
                        make_solver(settings, stars).map_err(|error: PartsError| error.to_string())?
                    }
                };
                none.insert(make()?)
            }
        };
        solver.adopt(settings);
        let limit = Duration::from_secs_f64(settings.solver.timeout_s);
        let watch: &dyn Watch = match self.wishes.set.is_empty() {
            true => &Rerun::new(solved.window, cancelled),
            false => &InTime { began: Instant::now(), limit, cancelled },
        };
        let motion = solved.motion.clone().filter(|_| settings.solver.motion.enabled).map(Arc::new);
        Ok(if motion.is_some() || exposures.len() > 1 {
            solver.solve_series(frame, &Exposures { exposures, motion }, &self.prior, watch)
        } else {
            solver.solve(frame, &self.prior, watch)
        })
    }

    /// The pixels of a frame and of its exposures, from the files that they were kept in.
    fn pixels(&mut self, solved: &Solved, settings: &Settings) -> Result<(Frame, Vec<Arc<Frame>>), String> {
        let directories = match &self.wishes.images {
            Some(images) => vec![images.clone()],
            None => settings.record.image_directories().into_iter().map(|(_, directory)| directory).collect(),
        };
        if self.shelf.as_ref().is_none_or(|(of, _)| *of != directories) {
            let files = store::all_files(&directories);
            self.shelf = Some((directories, files));
        }
        let files = self.shelf.as_ref().map(|(_, files)| files);
        let exposure = |exposure: &Exposure| {
            let key = (solved.boot.0, solved.stamp.image.0, exposure.part.unwrap_or(0));
            let path = files.and_then(|files| files.get(&key)).ok_or("its image is not there")?;
            kept(path, solved, exposure)
        };
        let exposures: Vec<Frame> = solved.exposures.iter().map(exposure).collect::<Result<_, String>>()?;
        let series = Series::new(exposures).map_err(|error| error.to_string())?;
        let (sum, exposures) = series.into_sum();
        let mut frame = sum.or_else(|| exposures.first().map(|first| Frame::clone(first))).ok_or("it has no exposure")?;
        (frame.stamp, frame.full_scale) = (solved.stamp.clone(), solved.full_scale);
        Ok((frame, exposures))
    }
}

/// Reads an exposure that was kept.
fn kept(path: &std::path::Path, solved: &Solved, exposure: &Exposure) -> Result<Frame, String> {
    let bytes = read_file(path, LONGEST_IMAGE, "an image").map_err(|error| error.to_string())?;
    let mut frame = read(&path.display().to_string(), &bytes).map_err(|error| error.to_string())?;
    let (width, height) = solved.size_px;
    let is_laid_out = frame.width == width as usize && frame.height == height as usize && frame.rows == solved.rows;
    if !is_laid_out || exposure.checksum.is_some_and(|checksum| checksum != pixel_sum(&frame)) {
        return Err("its image is not the one that was solved".to_owned());
    }
    frame.full_scale = exposure.full_scale;
    frame.stamp.part = exposure.part;
    Ok(frame)
}

/// Gives a frame the time that the settings allow.
struct InTime<'a> {
    began: Instant,
    limit: Duration,
    cancelled: &'a (dyn Fn() -> bool + Sync),
}

impl Watch for InTime<'_> {
    fn elapsed(&self) -> Duration {
        self.began.elapsed()
    }

    fn stop(&self) -> Option<Stop> {
        if (self.cancelled)() {
            return Some(Stop::Aborted);
        }
        (self.began.elapsed() >= self.limit).then_some(Stop::TimedOut)
    }
}
