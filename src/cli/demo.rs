//! `stars demo`: the flight service with a simulated sky and two simulated flight computers, beside the truth.

use super::run::{end, runtime, start_logging, stop_signal, until};
use super::{ConfigArgs, NEGATIVE, print};
use crate::camera::{CameraError, Gondola, Moment, SimulatedSky, Source};
use crate::image::Series;
use crate::service::{
    Doors, Inputs, MakeSource, PageSocket, Parts, Running, Seen, Sighting, SimulatedLens, Stars, StartError, fly, simulated_sky,
    start_with,
};
use crate::settings::{CameraKind, Layer, LensKind, Loaded, Settings, parse_span};
use crate::simulate::{COVERED_SIGMA, FlightComputer, Judged, measured};
use crate::sky::{ARCSEC, Attitude};
use crate::solve::{Motion, Reason, SearchMode};
use crate::wire::{Equatorial, Image};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::mpsc;

/// The flight computers; the first claims to be in charge.
const COMPUTERS: [u8; 2] = [1, 2];
/// Sightings of a flight computer that may wait to be shown.
const QUEUE: usize = 64;
/// Images whose truth and receivers are remembered: many more than are ever under way.
const REMEMBERED: usize = 64;
/// One image in so many is a series of exposures, the one of this number, and the exposures of it.
const SERIES: (u32, u32) = (4, 3);
const EXPOSURES: u8 = 4;
/// Noise of the gyros, rad/s/√Hz.
const GYRO_NOISE: f64 = 4.0 * ARCSEC;
/// Time before a simulated flight computer connects again.
const RETRY: Duration = Duration::from_millis(200);

/// The flight service with a simulated sky and two flight computers: each solution served, beside the truth
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars demo --duration 30s
  stars demo --set lens.simulated.faults='5s power_cycle 2s, 20s vanished 5s'
  stars demo --set simulate.kind=dense --set simulate.seed=7 --set camera.period_s=1
Every fourth image is a series of four exposures during which the gondola scans on; it is solved along the trails of its stars, by the
rates that the flight computer in charge sends. Unless they are set, a frame comes every 2 s, any free port is taken, and nothing is kept
on disk. Exits 0 if solutions came, none was wrong, and both flight computers got each of them (which frames that come faster than updates can't); 1 if not.")]
pub struct Args {
    /// End by itself after this time, such as 30s
    #[arg(long, value_name = "TIME", value_parser = parse_span)]
    duration: Option<Duration>,
    /// End after so many images
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    images: Option<u32>,
    #[command(flatten)]
    config: ConfigArgs,
}

/// The true attitudes of the last images, by their numbers.
type Truths = Arc<Mutex<BTreeMap<u32, Attitude>>>;

impl Args {
    /// Runs the demonstration to its end.
    ///
    /// # Errors
    /// Where the settings are wrong or the address cannot be had.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let settings = Arc::new(demonstration(self.config.load()?));
        start_logging("warn");
        let runtime = runtime()?;
        let ended = runtime.block_on(demonstrate(settings, self.duration, self.images));
        runtime.shutdown_timeout(Duration::from_millis(100));
        ended
    }
}

/// The settings of a demonstration: everything simulated; what nobody set is quicker than in flight, and leaves nothing behind.
fn demonstration(loaded: Loaded) -> Settings {
    let untouched = |key: &str| loaded.all.iter().any(|setting| setting.key == key && setting.origin.layer == Layer::Flight);
    let mut settings = loaded.settings.clone();
    settings.camera.kind = CameraKind::Sky;
    settings.lens.kind = LensKind::Simulated;
    if untouched("camera.period_s") {
        settings.camera.period_s = 2.0;
    }
    if untouched("network.listen") {
        settings.network.listen = "127.0.0.1:0".to_owned();
    }
    if untouched("display.listen") && std::net::TcpListener::bind(&settings.display.listen).is_err() {
        // Another program has it, perhaps another demonstration: any free port will do.
        settings.display.listen = "127.0.0.1:0".to_owned();
    }
    if untouched("record.enabled") {
        settings.record.enabled = false;
    }
    if untouched("commands.ledger_directory") {
        settings.commands.ledger_directory = String::new();
    }
    settings
}

async fn demonstrate(settings: Arc<Settings>, duration: Option<Duration>, images: Option<u32>) -> anyhow::Result<ExitCode> {
    let stop = stop_signal()?;
    let truths = Truths::default();
    let stars = Stars::of(&settings);
    let parts = Parts::with_stars(&settings, &stars)?;
    let [(gyros_1, turns_1), (gyros_2, turns_2)] = COMPUTERS.map(|_| mpsc::channel(1));
    let noting = Noting { truths: Arc::clone(&truths), gyros: [gyros_1, gyros_2] };
    let parts = Parts { camera: Some(sky(&settings, &stars, parts.lens.as_ref(), noting)), ..parts };
    let address = settings.network.listen.clone();
    let socket = TcpListener::bind(&address).await.map_err(|error| StartError::Listen { address, error })?;
    let doors = Doors { page: PageSocket::open(&settings.display.listen), ..Doors::from(socket) };
    let running = start_with(Arc::clone(&settings), parts, doors)?;
    print(&format!("serving at {}, simulated: frames of kind {}", running.address, settings.simulate.kind))?;
    match running.page.address() {
        Some(page) => print(&format!("the page: http://{page}/"))?,
        None => print(&format!("there is no page: {} cannot be had", settings.display.listen))?,
    }
    let gondola = Gondola::new(&settings.simulate);
    let one = board_computer(COMPUTERS[0], &running, &gondola, turns_1);
    let two = board_computer(COMPUTERS[1], &running, &gondola, turns_2);
    let mut board = Board::new(truths, settings.camera.period_s > settings.network.update_period_s);
    let why = tokio::select! {
        why = until(stop, duration) => why,
        shown = show(&mut board, images, one, two) => shown?,
    };
    print(&format!("{why}: {}", board.summary()))?;
    print(&lens_summary(&running))?;
    let ended = end(running).await;
    Ok(if board.is_good() { ended } else { ExitCode::from(NEGATIVE) })
}

/// Where the lens is, and where it truly is.
fn lens_summary(running: &Running) -> String {
    let lens = Arc::clone(&running.state.borrow().lens);
    let truth = running.simulated_lens.as_ref().map_or(f64::NAN, SimulatedLens::true_motor);
    let errors: u32 = lens.errors.values().sum();
    let last = lens.last_error.as_deref().map_or(String::new(), |words| format!(", the last: {words}"));
    format!("lens: focus {:?}, truly {truth:.0}; aperture {:?}; {errors} errors{last}", lens.focus, lens.aperture)
}

/// Starts a flight computer that knows where it is, and connects it.
fn board_computer(id: u8, running: &Running, gondola: &Gondola, turns: mpsc::Receiver<Motion>) -> mpsc::Receiver<Sighting> {
    let (sender, sightings) = mpsc::channel(QUEUE);
    let mut computer = FlightComputer::new(id, running.clock.boot_id().wrapping_add(u32::from(id)));
    computer.claims_charge = id == COMPUTERS[0];
    computer.observer = Some(gondola.observer(running.clock.uptime()));
    computer.trigger = Some(1);
    // Nobody on the ground commands it.
    let (_, ground) = mpsc::channel(1);
    tokio::spawn(fly(computer, running.address.to_string(), RETRY, Inputs { ground, turns }, sender));
    sightings
}

/// Shows what the flight computers get until enough images came, for as long as they are there; says why it ended.
async fn show(
    board: &mut Board,
    images: Option<u32>,
    mut one: mpsc::Receiver<Sighting>,
    mut two: mpsc::Receiver<Sighting>,
) -> anyhow::Result<&'static str> {
    while images.is_none_or(|images| board.shown < images) {
        let (place, id, sighting) = tokio::select! {
            Some(sighting) = one.recv() => (0, COMPUTERS[0], sighting),
            Some(sighting) = two.recv() => (1, COMPUTERS[1], sighting),
            else => return Ok("the flight computers are gone"),
        };
        let lines = match sighting.seen {
            Seen::Update(update) => update.image.get().map_or_else(Vec::new, |image| board.take(place, image)),
            Seen::Connected(_) => vec![format!("flight computer {id} connected")],
            Seen::Closed { reason, .. } => vec![format!("flight computer {id}: closed: {reason}")],
            Seen::Unreachable(reason) => vec![format!("flight computer {id}: no connection: {reason}")],
            Seen::Reply(_) | Seen::Overheard(_) | Seen::Unanswered(_) | Seen::AllAnswered => Vec::new(),
        };
        lines.iter().try_for_each(|line| print(line))?;
    }
    Ok("enough images")
}

/// Where it is noted what the camera saw.
#[derive(Clone)]
struct Noting {
    truths: Truths,
    /// To the flight computers: how the gondola turned during a series.
    gyros: [mpsc::Sender<Motion>; COMPUTERS.len()],
}

/// The simulated sky as the camera.
struct Noted {
    sky: SimulatedSky,
    noting: Noting,
    random: ChaCha8Rng,
}

impl Noted {
    /// A series: it takes its time, and then each computer has what its gyros measured.
    fn series(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let (series, motion) = self.sky.series(moment, EXPOSURES)?;
        std::thread::sleep(Duration::from_secs_f64(motion.length_s()));
        for computer in &self.noting.gyros {
            // One that is not connected has no use for it.
            let _ = computer.try_send(measured(&motion, GYRO_NOISE, &mut self.random));
        }
        Ok(series)
    }
}

impl Source for Noted {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let image = moment.image.0;
        let series = if image % SERIES.0 == SERIES.1 { self.series(moment)? } else { self.sky.next(moment)? };
        let mut truths = self.noting.truths.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(attitude) = self.sky.truth().and_then(|truth| truth.attitude) {
            truths.insert(image, attitude);
        }
        while truths.len() > REMEMBERED {
            truths.pop_first();
        }
        Ok(series)
    }
}

fn sky(settings: &Arc<Settings>, stars: &Stars, lens: Option<&SimulatedLens>, noting: Noting) -> MakeSource {
    let (settings, stars, lens) = (Arc::clone(settings), stars.clone(), lens.cloned());
    Arc::new(move || {
        let sky = simulated_sky(&settings, &stars, lens.as_ref())?;
        let random = ChaCha8Rng::seed_from_u64(settings.simulate.seed);
        Ok(Box::new(Noted { sky, noting: noting.clone(), random }) as Box<dyn Source>)
    })
}

/// Who got which image, and how good the solutions were.
#[derive(Default)]
struct Board {
    truths: Truths,
    /// Frames come no faster than updates, so that each computer must get every one of them.
    complete: bool,
    /// Images that not every computer has got yet: the line to show, and who has.
    open: BTreeMap<u32, (String, [bool; COMPUTERS.len()])>,
    /// The last image that each computer got.
    last: [Option<u32>; COMPUTERS.len()],
    /// Images closed: shown, with who got them.
    shown: u32,
    solved: u32,
    unsolved: u32,
    missed: u32,
    wrong: u32,
    covered: u32,
    worst_arcsec: f64,
}

impl Board {
    fn new(truths: Truths, complete: bool) -> Self {
        Self { truths, complete, ..Self::default() }
    }

    /// Takes an image that a computer got with an update; gives back the lines to show: one when the last computer has it.
    fn take(&mut self, place: usize, image: &Image) -> Vec<String> {
        let number = image.image_counter.get();
        if self.last.get(place).is_none_or(|last| last.is_some_and(|last| last >= number)) {
            return Vec::new();
        }
        if !self.open.contains_key(&number) && !self.last.iter().flatten().any(|last| *last >= number) {
            let line = self.line(number, image);
            self.open.insert(number, (line, Default::default()));
        }
        if let Some(last) = self.last.get_mut(place) {
            *last = Some(number);
        }
        if let Some(got) = self.open.get_mut(&number).and_then(|(_, got)| got.get_mut(place)) {
            *got = true;
        }
        self.close()
    }

    /// Closes the images that every computer has got, or has gone past.
    fn close(&mut self) -> Vec<String> {
        let passed = self.last.iter().copied().min().flatten();
        let mut lines = Vec::new();
        while let Some(entry) = self.open.first_entry().filter(|entry| passed.is_some_and(|passed| *entry.key() <= passed)) {
            let (line, got) = entry.remove();
            let missing = COMPUTERS.iter().zip(got).filter(|(_, got)| !got).map(|(id, _)| format!("; MISSED by {id}"));
            let missing: String = missing.collect();
            self.shown += 1;
            self.missed += u32::from(!missing.is_empty());
            lines.push(line + &missing);
        }
        lines
    }

    /// The line of an image; counts it.
    fn line(&mut self, number: u32, image: &Image) -> String {
        let pointing = image.equatorial.get().filter(|_| image.reason.get() == Some(Reason::Solved));
        let Some(pointing) = pointing else {
            self.unsolved += 1;
            let reason = image.reason.get().map_or_else(String::new, |reason| reason.to_string());
            return format!("image {number:<4} {reason}: {}", image.detail);
        };
        self.solved += 1;
        let Equatorial { ra_deg, dec_deg, roll_deg, .. } = pointing;
        let how = if image.mode.get() == Some(SearchMode::Motion) { "a series, along its trails: " } else { "" };
        let served = format!("image {number:<4} {how}ra {ra_deg:.5}° dec {dec_deg:+.5}° roll {roll_deg:+.4}°");
        let truth = self.truths.lock().unwrap_or_else(PoisonError::into_inner).get(&number).copied();
        let Some((truth, judged)) = truth.and_then(|truth| Some((truth, Judged::served(pointing, &truth)?))) else {
            self.wrong += 1;
            return format!("{served}  WRONG: there was nothing to solve");
        };
        self.covered += u32::from(judged.is_covered());
        self.wrong += u32::from(judged.is_wrong());
        self.worst_arcsec = self.worst_arcsec.max(judged.error);
        let (ra, dec, roll) = truth.angles();
        let verdict = match (judged.is_wrong(), judged.is_covered()) {
            (true, _) => "WRONG",
            (false, true) => "covered",
            (false, false) => "not covered",
        };
        format!(
            "{served}  truth {:.5}° {:+.5}° {:+.4}°  off {:.2}″ (σ {:.2}″, {verdict}), roll {:+.1}″ (σ {:.1}″)",
            ra.to_degrees(),
            dec.to_degrees(),
            roll.to_degrees(),
            judged.error,
            judged.sigma,
            judged.roll_error,
            judged.roll_sigma,
        )
    }

    /// Whether there were solutions, each at every computer, and none was wrong.
    fn is_good(&self) -> bool {
        self.solved > 0 && self.wrong == 0 && !(self.complete && self.missed > 0)
    }

    fn summary(&self) -> String {
        let Self { solved, unsolved, missed, wrong, covered, worst_arcsec, .. } = self;
        format!(
            "{} images, {solved} solved, {wrong} wrong, {covered} within {COVERED_SIGMA} σ, worst {worst_arcsec:.2}″; \
             {missed} missed by a flight computer",
            solved + unsolved
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::DEG;

    fn board(truths: &[(u32, f64)]) -> Board {
        let attitudes = truths.iter().map(|(number, dec)| (*number, Attitude::from_angles(1.0, dec * DEG, 0.0)));
        Board::new(Arc::new(Mutex::new(attitudes.collect())), true)
    }

    fn solved(number: u32, dec_deg: f64) -> Image {
        let pointing = Equatorial {
            ra_deg: 1.0 / DEG,
            dec_deg,
            sigma_east_arcsec: 0.5,
            sigma_north_arcsec: 0.5,
            platescale_arcsec_px: 9.5,
            ..Equatorial::default()
        };
        let equatorial = Some(pointing).into();
        Image { image_counter: number.into(), reason: Reason::Solved.into(), equatorial, ..Image::default() }
    }

    #[test]
    fn an_image_is_shown_once_when_both_computers_have_it() {
        let mut board = board(&[(3, 20.0)]);
        let image = solved(3, 20.0 + ARCSEC / DEG);
        assert!(board.take(0, &image).is_empty() && board.take(0, &image).is_empty());
        let lines = board.take(1, &image);
        assert_eq!(lines.len(), 1);
        assert!(lines[0].contains("off 1.00″") && lines[0].contains("covered"), "{}", lines[0]);
        assert!(board.take(1, &image).is_empty());
        assert!(board.is_good());
    }

    #[test]
    fn an_image_that_one_computer_never_got_makes_the_end_negative() {
        let mut board = board(&[(3, 20.0), (4, 20.0)]);
        board.take(0, &solved(3, 20.0));
        board.take(0, &solved(4, 20.0));
        let lines = board.take(1, &solved(4, 20.0));
        assert_eq!(lines.len(), 2);
        assert!(lines[0].contains("MISSED by 2") && !lines[1].contains("MISSED"), "{lines:?}");
        assert!(!board.is_good());
    }

    #[test]
    fn a_solution_far_from_the_truth_or_of_nothing_is_wrong() {
        for (truths, dec_deg) in [(vec![(3, 20.0)], 20.1), (vec![], 20.0)] {
            let mut board = board(&truths);
            board.take(0, &solved(3, dec_deg));
            assert!(board.take(1, &solved(3, dec_deg))[0].contains("WRONG"));
            assert!(!board.is_good());
        }
    }

    #[test]
    fn without_a_solution_the_end_is_negative() {
        let mut board = board(&[]);
        let image = Image { reason: Reason::NoMatch.into(), ..Image::default() };
        board.take(0, &image);
        board.take(1, &image);
        assert!(!board.is_good() && board.summary().starts_with("1 images, 0 solved"));
    }
}
