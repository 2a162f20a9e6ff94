//! `stars selftest`: before launch, in daylight: is everything there that the flight service needs?

use super::run::runtime;
use super::{ConfigArgs, NEGATIVE, print};
use crate::camera::{Ask, Directory, Moment, Source};
use crate::catalog::Catalogue;
use crate::command::FlightComputer;
use crate::image::{ImageCounter, Series};
use crate::service::{Clock, Keys, SensorError, Stars, is_simulated, load_bad_pixels, prepare, read_once, utc_now};
use crate::settings::{CameraKind, LensKind, Settings};
use crate::simulate::Judged;
use crate::simulate::sky::{Kind, RenderSpec, Rendered, render};
use crate::sky::{ARCSEC, ClockQuality};
use crate::solve::{Outcome, PointingReport, Prior, Reason, Solver, Unwatched};
use std::io::Write;
use std::net::TcpListener;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

/// Frames that are rendered and solved: what a flight sees, and what strains it.
const FRAMES: [Kind; 4] = [Kind::Night, Kind::Float, Kind::Dense, Kind::HotPix];
/// Seed of the rendered frames.
const SEED: u64 = 2017;
/// Frames of a kind that are rendered until one is found that must be solved.
const ATTEMPTS: u64 = 20;

/// Tests before launch, in daylight: says ready, or why not; moves nothing
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars selftest --custom custom.toml
  stars selftest --set camera.kind=directory --set camera.directory=images
Solves simulated frames of this camera's size, plate scale, mask and bad pixels; checks catalogue, address, disk and devices.
Exits 0 when ready, 1 when not, 2 if the call or a settings file is wrong.")]
pub struct Args {
    #[command(flatten)]
    config: ConfigArgs,
}

/// How a check ended: what was seen, worth a look or not, or what is wrong.
enum Verdict {
    Good(String),
    Note(String),
    Bad(String),
}

impl From<Result<String, String>> for Verdict {
    fn from(result: Result<String, String>) -> Self {
        result.map_or_else(Self::Bad, Self::Good)
    }
}

impl Args {
    /// Runs every check, whatever the others say.
    ///
    /// # Errors
    /// Where the settings are wrong or stdout cannot be written.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let settings = Arc::new(self.config.load()?.settings);
        let mut bad = 0;
        let mut say = |name: &str, verdict: Verdict| {
            let (word, text) = match verdict {
                Verdict::Good(text) => ("ok", text),
                Verdict::Note(text) => ("note", text),
                Verdict::Bad(text) => {
                    bad += 1;
                    ("BAD", text)
                }
            };
            print(&format!("{word:<4}  {name:<20}  {text}"))
        };
        let stars = Stars::of(&settings).load();
        say("catalogue", stars.as_ref().map(|stars| catalogue(stars)).map_err(Clone::clone).into())?;
        if let Ok(stars) = stars {
            for (name, verdict) in solve_frames(&settings, &stars) {
                say(name, verdict)?;
            }
        }
        say("camera", camera(&settings))?;
        say("lens", lens(&settings))?;
        say("bad pixels", load_bad_pixels(&settings).map(|_| list(&settings)).map_err(|error| error.to_string()).into())?;
        say("network", network(&settings).into())?;
        say("disk", disk(&settings))?;
        say("commands", commands(&settings))?;
        for (name, verdict) in sensors(&settings)? {
            say(name, verdict)?;
        }
        say("clock", clock())?;
        let simulated = [
            ("camera", settings.camera.kind == CameraKind::Sky),
            ("lens", settings.lens.kind == LensKind::Simulated),
            ("housekeeping", is_simulated(&settings)),
        ];
        let simulated: Vec<&str> = simulated.into_iter().filter(|(_, is)| *is).map(|(name, _)| name).collect();
        if !simulated.is_empty() {
            say("simulated", Verdict::Note(format!("{}: not for a flight", simulated.join(" and "))))?;
        }
        if bad > 0 {
            print(&format!("not ready: {bad} {} bad", if bad == 1 { "check is" } else { "checks are" }))?;
            return Ok(ExitCode::from(NEGATIVE));
        }
        print("ready")?;
        Ok(ExitCode::SUCCESS)
    }
}

fn catalogue(catalogue: &Catalogue) -> String {
    let header = &catalogue.header;
    format!("{} stars, epoch {}, checksum {:08x}", header.count, header.epoch_yr, header.checksum)
}

/// Frames of each kind as this camera would see them, solved as in flight, except that where they point was nobody's choice:
/// the requirements on where the camera looks are left out.
fn solve_frames(settings: &Settings, stars: &Arc<Catalogue>) -> Vec<(&'static str, Verdict)> {
    let mut settings = settings.clone();
    let requirements = &mut settings.solver.requirements;
    requirements.horizontal_location.enabled = false;
    requirements.horizontal_roll.enabled = false;
    requirements.elevation.enabled = false;
    requirements.equatorial_location.enabled = false;
    requirements.equatorial_roll.enabled = false;
    let settings = Arc::new(settings);
    let mut solver = Solver::new(Arc::clone(stars), Arc::clone(&settings));
    let clock = Clock::start();
    let prepared = prepare(&mut solver, settings.camera.width_px as usize, settings.camera.height_px as usize);
    let text = format!("{} in {:.2} s", prepared.word(), clock.uptime().as_secs_f64());
    let mut verdicts = vec![("index", Verdict::Good(text))];
    verdicts.extend(prepared.complaints.into_iter().map(|complaint| ("index", Verdict::Note(complaint))));
    for kind in FRAMES {
        let verdict = match frame(&settings, stars, kind) {
            Err(why) => Verdict::Bad(why),
            Ok(rendered) => {
                let clock = Clock::start();
                let outcome = solver.solve(&rendered.frame, &Prior::default(), &Unwatched);
                judge(&outcome, &rendered, clock.uptime())
            }
        };
        verdicts.push((kind.name(), verdict));
    }
    verdicts
}

/// A frame of this camera that must be solved.
fn frame(settings: &Settings, stars: &Catalogue, kind: Kind) -> Result<Rendered, String> {
    let matching = &settings.solver.matching;
    for index in 0..ATTEMPTS {
        let spec = RenderSpec {
            width: settings.camera.width_px as usize,
            height: settings.camera.height_px as usize,
            platescale: (matching.platescale_min_arcsec_px * ARCSEC, matching.platescale_max_arcsec_px * ARCSEC),
            epoch_yr: settings.catalog.epoch_yr,
            mirrored: settings.camera.mirrored,
            ..RenderSpec::new(kind, SEED, index)
        };
        let rendered = render(&spec, stars).map_err(|error| error.to_string())?;
        if rendered.truth.must {
            return Ok(rendered);
        }
    }
    Err(format!("none of {ATTEMPTS} simulated frames of this camera shows stars enough: is its field too small?"))
}

fn judge(outcome: &Outcome, rendered: &Rendered, took: Duration) -> Verdict {
    let (Some(solution), Some(truth)) = (&outcome.solution, &rendered.truth.attitude) else {
        return Verdict::Bad(format!("simulated frame not solved: {} ({})", outcome.reason, outcome.detail));
    };
    let Some(judged) = Judged::new(&PointingReport::new(solution), truth).filter(|_| outcome.reason == Reason::Solved) else {
        return Verdict::Bad(format!("simulated frame without a pointing: {}", outcome.reason));
    };
    let text = format!(
        "{:.2}″ from the truth (σ {:.2}″), {} matched, {:.0} ms",
        judged.error,
        judged.sigma,
        solution.matches.len(),
        took.as_secs_f64() * 1e3
    );
    if judged.is_wrong() { Verdict::Bad(format!("WRONG: {text}")) } else { Verdict::Good(text) }
}

/// Whether the camera gives a frame of the size that the settings say.
fn camera(settings: &Settings) -> Verdict {
    let moment = Moment {
        image: ImageCounter(0),
        uptime: Duration::ZERO,
        utc: None,
        quality: ClockQuality::Unset,
        sigma_s: None,
        ask: Ask::Expose,
    };
    match settings.camera.kind {
        CameraKind::None => Verdict::Bad("camera.kind = \"none\": no image will ever be taken".to_owned()),
        #[cfg(not(feature = "aravis"))]
        CameraKind::Aravis => Verdict::Bad(format!("camera.kind {}", crate::settings::NO_ARAVIS)),
        #[cfg(feature = "aravis")]
        CameraKind::Aravis => match crate::camera::AravisCamera::new(&settings.camera).next(&moment) {
            Err(error) => Verdict::Bad(format!("camera.device = \"{}\": {error}", settings.camera.device)),
            Ok(series) => size(settings, &series),
        },
        CameraKind::Sky => Verdict::Good("a simulated sky".to_owned()),
        CameraKind::Directory => match Directory::new(&settings.camera).next(&moment) {
            Err(error) => Verdict::Bad(format!("camera.directory = \"{}\": {error}", settings.camera.directory)),
            Ok(series) => size(settings, &series),
        },
    }
}

/// Whether exposures have the size that the settings say.
fn size(settings: &Settings, series: &Series) -> Verdict {
    let Some(frame) = series.exposures().first() else { return Verdict::Bad("no exposure".to_owned()) };
    let (width, height) = (settings.camera.width_px as usize, settings.camera.height_px as usize);
    let text = format!("{}: {} × {} px", frame.stamp.origin, frame.width, frame.height);
    if (frame.width, frame.height) == (width, height) {
        Verdict::Good(text)
    } else {
        Verdict::Bad(format!("{text}, camera.width_px and camera.height_px say {width} × {height}"))
    }
}

/// Whether keys, ledger and programs are as the settings say. Nothing is written or run.
fn commands(settings: &Settings) -> Verdict {
    let commands = &settings.commands;
    let keys = match Keys::read(commands) {
        Err(problem) => return Verdict::Bad(problem),
        Ok(keys) => keys,
    };
    let programs = [
        ("shut_down_program", &commands.shut_down_program),
        ("restart_program", &commands.restart_program),
        ("network_reset_program", &commands.network_reset_program),
    ];
    for (name, program) in programs {
        if !program.is_empty() && !std::path::Path::new(program).is_file() {
            return Verdict::Bad(format!("commands.{name} = \"{program}\": no such file"));
        }
    }
    let named = [1, 2].into_iter().filter(|id| keys.has(FlightComputer(*id))).count();
    let keys = format!("{named} keys, authentication {}", if keys.required() { "required" } else { "not required" });
    if commands.ledger_directory.is_empty() {
        return Verdict::Note(format!("{keys}; nothing outlasts a restart (commands.ledger_directory is empty)"));
    }
    let taken = takes_files("commands.ledger_directory", Path::new(&commands.ledger_directory));
    taken.map(|words| format!("{keys}; what outlasts a restart: {words}")).into()
}

/// Whether the lens's port is there. Nothing is sent.
fn lens(settings: &Settings) -> Verdict {
    let port = &settings.lens.port;
    match settings.lens.kind {
        LensKind::None => Verdict::Note("no lens control".to_owned()),
        LensKind::Simulated => Verdict::Good("a simulated controller".to_owned()),
        LensKind::Serial if port == "auto" => Verdict::Note("the lens's port is looked for when the service runs".to_owned()),
        LensKind::Serial => match std::fs::metadata(port) {
            Err(error) => Verdict::Bad(format!("lens.port = \"{port}\": {error}")),
            Ok(meta) if !meta.file_type().is_char_device() => Verdict::Bad(format!("lens.port = \"{port}\": not a serial port")),
            Ok(_) => Verdict::Good(format!("{port} is there")),
        },
    }
}

fn list(settings: &Settings) -> String {
    let name = &settings.solver.sources.bad_pixels_file;
    if name.is_empty() { "none listed".to_owned() } else { format!("{name} is read") }
}

/// Whether the addresses can be listened on, both at once.
fn network(settings: &Settings) -> Result<String, String> {
    let legacy = settings.legacy.enabled.then_some(("legacy.listen", &settings.legacy.listen));
    let bind = |(setting, address): (&str, &String)| {
        let bound = TcpListener::bind(address).map_err(|error| format!("{setting} = \"{address}\": {error}"))?;
        let found = bound.local_addr().map_err(|error| error.to_string())?;
        Ok((bound, format!("{found} can be listened on")))
    };
    let ours = [("network.listen", &settings.network.listen), ("display.listen", &settings.display.listen)];
    let addresses = ours.into_iter().chain(legacy);
    let bound = addresses.map(bind).collect::<Result<Vec<_>, String>>()?;
    Ok(bound.into_iter().map(|(_, words)| words).collect::<Vec<_>>().join(", "))
}

/// Whether the disk takes a file.
fn disk(settings: &Settings) -> Verdict {
    if !settings.record.enabled {
        return Verdict::Note("record.enabled = false: outcomes are not kept".to_owned());
    }
    let log = ("record.directory", PathBuf::from(&settings.record.directory));
    let directories = std::iter::once(log).chain(settings.record.image_directories());
    let taken: Result<Vec<String>, String> = directories.map(|(setting, directory)| takes_files(setting, &directory)).collect();
    taken.map(|words| words.join(", ")).into()
}

/// Whether a directory takes a file; it is made if it is not there.
fn takes_files(setting: &str, directory: &Path) -> Result<String, String> {
    let name = directory.display();
    let probe = directory.join(format!(".selftest-{}", std::process::id()));
    let written = std::fs::create_dir_all(directory).and_then(|()| {
        let mut file = std::fs::File::create(&probe)?;
        file.write_all(&[0x55; 4096])?;
        file.sync_all()
    });
    let removed = written.and_then(|()| std::fs::remove_file(&probe));
    removed.map(|()| format!("{name} takes files")).map_err(|error| format!("{setting} = \"{name}\": {error}"))
}

/// Whether each sensor gives a value.
fn sensors(settings: &Settings) -> anyhow::Result<Vec<(&'static str, Verdict)>> {
    let runtime = runtime()?;
    let _within = runtime.enter();
    let verdict = |read: Result<String, SensorError>| read.map_err(|error| error.to_string()).into();
    Ok(read_once(settings).into_iter().map(|(name, read)| (name, verdict(read))).collect())
}

fn clock() -> Verdict {
    match utc_now() {
        (Some(utc), ClockQuality::Synchronised) => Verdict::Good(format!("{utc} UTC, synchronised")),
        (Some(utc), _) => Verdict::Note(format!("{utc} UTC, free-running")),
        (None, _) => Verdict::Note("not set: frames will have no time, and solutions no date".to_owned()),
    }
}
