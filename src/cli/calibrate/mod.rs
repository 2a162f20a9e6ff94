//! `stars calibrate`: plate scale, distortion, hot pixels and the offset of a second camera, from the frames of a night or a flight.
//!
//! What is measured is only written down. Another call puts it in force, and a third one takes it back: see [`kept`].

mod gather;
pub(super) mod kept;

use super::{ConfigArgs, NEGATIVE, print};
use crate::calibrate::{self, Calibration, HotPixels, Lens, Offset, OffsetError, Refusal, SkyStands};
use crate::service::utc_now;
use crate::settings::Settings;
use crate::sky::{ARCSEC, Attitude, Mat3};
use anyhow::{Context, bail};
use gather::{Gathered, Shot};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// Frames in which hot pixels are looked for, at least.
const LEAST_FRAMES_FOR_HOT: usize = 20;
/// Frames of two cameras whose middles are nearer than this were taken together, s, where no trigger says so.
const TOGETHER_S: f64 = 0.01;

/// Measures plate scale, distortion, hot pixels and a second camera's offset; puts such a calibration in force, or takes it back
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars calibrate records --out calibration.toml          from kept images and records; writes, and changes nothing
  stars calibrate records --other second/records          and how the second camera is turned against the first
  stars calibrate --custom custom.toml --apply calibration.toml
  stars calibrate --custom custom.toml --undo
A directory with records (outcomes-*.jsonl) gives the stars of its solved images; without, its images are solved. Hot pixels
come from its images (*.fits, in directories below it too), up to a thousand of them.
What is in force lies in the directory of commands.ledger_directory, above the custom file and below --set; the service takes
it at its next start.
Exits 0 if it was done, 1 if the frames or the change are refused, 2 if the call or a file is wrong.")]
pub struct Args {
    /// Records, kept images, or both
    #[arg(value_name = "DIR", required_unless_present_any = ["apply", "undo"])]
    directory: Option<PathBuf>,
    /// The same of a second camera, exposed together with the first
    #[arg(long, value_name = "DIR", requires = "directory")]
    other: Option<PathBuf>,
    /// Write the settings into this file, and the list of hot pixels beside it
    #[arg(long, value_name = "FILE", requires = "directory")]
    out: Option<PathBuf>,
    /// Print one JSON object
    #[arg(long, requires = "directory")]
    json: bool,
    /// Images read at a time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=64))]
    jobs: u8,
    /// Put a calibration that --out wrote in force, where it passes the guard
    #[arg(long, value_name = "FILE", conflicts_with_all = ["directory", "undo"])]
    apply: Option<PathBuf>,
    /// Take the last calibration back: the one before it is in force again, or none
    #[arg(long, conflicts_with = "directory")]
    undo: bool,
    #[command(flatten)]
    config: ConfigArgs,
}

/// What was measured.
struct Measured {
    calibration: Calibration,
    hot_pixels: Vec<(usize, usize)>,
}

/// Frames that say nothing, or contradict themselves.
#[derive(Debug, thiserror::Error)]
enum Refused {
    #[error("{0}: {1}")]
    Lens(String, Refusal),
    #[error("{0}")]
    Offset(OffsetError),
}

impl Args {
    /// Measures, applies or undoes.
    ///
    /// # Errors
    /// Settings, directories or files that are wrong.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        if let Some(file) = &self.apply {
            return kept::apply(file, &self.config);
        }
        if self.undo {
            return kept::undo(&self.config);
        }
        let Some(directory) = &self.directory else { bail!("no directory, expected one of records or images") };
        // Without the calibration in force: each one stands by itself.
        let settings = Arc::new(self.config.load_files()?.settings);
        let first = gather::gather(directory, &settings, true, usize::from(self.jobs))?;
        let second = match &self.other {
            Some(other) => Some(gather::gather(other, &settings, false, usize::from(self.jobs))?),
            None => None,
        };
        match measure(first, second, &settings) {
            Ok(mut measured) => {
                if let Some(out) = &self.out {
                    write(&mut measured, out)?;
                }
                let calibration = &measured.calibration;
                print(&if self.json { as_json(&measured).to_string() } else { calibration.words().join("\n") })?;
                Ok(ExitCode::SUCCESS)
            }
            Err(refused) => {
                print(&format!("refused: {refused}"))?;
                Ok(ExitCode::from(NEGATIVE))
            }
        }
    }
}

fn measure(first: Gathered, second: Option<Gathered>, settings: &Settings) -> Result<Measured, Refused> {
    let lens = lens_of(&first, settings)?;
    let (found, remark) = match &first.hot {
        None => (None, None),
        Some(hot) => match hot_pixels(hot, &lens) {
            Ok(found) => (Some(found), None),
            Err(why) => (None, Some(why)),
        },
    };
    let other = match second {
        None => None,
        Some(second) => {
            let other = lens_of(&second, settings)?;
            Some((second.directory.clone(), offset(&first.shots, &lens, &second.shots, &other).map_err(Refused::Offset)?))
        }
    };
    let frames = first.hot.as_ref().map_or(0, HotPixels::frames);
    let calibration = Calibration {
        camera: settings.camera.name.clone(),
        made: utc_now().0.map_or_else(|| "at an unknown time".to_owned(), |utc| format!("{utc}Z")),
        source: first.source(),
        lens,
        half_diagonal_px: first.half_diagonal_px,
        hot_pixels: found.as_ref().map(|found| (found.len(), frames, String::new())),
        remark,
        other,
    };
    Ok(Measured { calibration, hot_pixels: found.unwrap_or_default() })
}

fn lens_of(gathered: &Gathered, settings: &Settings) -> Result<Lens, Refused> {
    let solved: Vec<_> = gathered.shots.iter().map(|shot| shot.solved.clone()).collect();
    calibrate::lens(&solved, gathered.half_diagonal_px, settings.solver.fit.axis_sigma_px)
        .map_err(|refusal| Refused::Lens(gathered.directory.clone(), refusal))
}

/// The hot pixels; or why there are none to be told.
fn hot_pixels(hot: &HotPixels, lens: &Lens) -> Result<Vec<(usize, usize)>, String> {
    let frames = hot.frames();
    if frames < LEAST_FRAMES_FOR_HOT {
        return Err(format!("{frames} images, expected at least {LEAST_FRAMES_FOR_HOT}"));
    }
    let attitudes: Vec<Attitude> = lens.attitudes.iter().flatten().map(|(attitude, _)| *attitude).collect();
    calibrate::has_moved(&attitudes, lens.platescale).map_err(|stands: SkyStands| stands.to_string())?;
    Ok(hot.found())
}

/// How the second camera is turned, from the frames that were taken together.
fn offset(first: &[Shot], of_first: &Lens, second: &[Shot], of_second: &Lens) -> Result<Offset, OffsetError> {
    type Known<'a> = (&'a Shot, (Attitude, Mat3));
    fn known<'a>(shots: &'a [Shot], lens: &'a Lens) -> impl Iterator<Item = Known<'a>> {
        shots.iter().zip(&lens.attitudes).filter_map(|(shot, attitude)| Some((shot, (*attitude)?)))
    }
    let mut others: Vec<Known<'_>> = known(second, of_second).collect();
    let pairs: Vec<_> = known(first, of_first)
        .filter_map(|(shot, attitude)| {
            let place = others.iter().position(|(other, _)| shot.is_together_with(other, TOGETHER_S))?;
            Some([attitude, others.swap_remove(place).1])
        })
        .collect();
    calibrate::offset(&pairs)
}

/// Writes the settings, and the list of hot pixels beside them.
fn write(measured: &mut Measured, out: &Path) -> anyhow::Result<()> {
    let calibration = &mut measured.calibration;
    if let Some((_, _, list)) = &mut calibration.hot_pixels {
        let path = out.with_extension("bad_pixels.txt");
        *list = path.display().to_string();
        let header = format!("hot pixels of the camera \"{}\", from {}", calibration.camera, calibration.source);
        put(&path, &calibrate::list_text(&header, &measured.hot_pixels))?;
    }
    put(out, &calibration.text())
}

fn put(path: &Path, text: &str) -> anyhow::Result<()> {
    fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
}

fn as_json(measured: &Measured) -> serde_json::Value {
    let Calibration { lens, other, source, hot_pixels, remark, .. } = &measured.calibration;
    let offset = other.as_ref().map(|(directory, offset)| {
        json!({
            "other": directory, "pairs": offset.pairs, "clipped": offset.clipped, "chi2_per_dof": offset.chi2_per_dof,
            "left_arcsec": offset.left / ARCSEC, "up_arcsec": offset.up / ARCSEC, "roll_arcsec": offset.roll / ARCSEC,
            "sigma_left_arcsec": offset.sigmas.y / ARCSEC, "sigma_up_arcsec": offset.sigmas.x / ARCSEC,
            "sigma_roll_arcsec": offset.sigmas.z / ARCSEC,
        })
    });
    json!({
        "source": source, "frames": lens.frames, "stars": lens.stars, "clipped": lens.clipped, "chi2_per_dof": lens.chi2_per_dof,
        "platescale_arcsec_px": lens.platescale / ARCSEC, "sigma_platescale_arcsec_px": lens.sigma_platescale / ARCSEC,
        "scatter": lens.scatter, "distortion_warranted": lens.warranted, "distortion_k1": lens.k1_found,
        "sigma_distortion_k1": lens.sigma_k1, "axis_left_px": lens.axis.0, "axis_up_px": lens.axis.1,
        "hot_pixels": hot_pixels.as_ref().map(|_| &measured.hot_pixels), "hot_pixels_remark": remark, "offset": offset,
    })
}
