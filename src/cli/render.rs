//! `stars render`: writes simulated frames with their truth.

use super::{ConfigArgs, within};
use crate::catalog::Catalogue;
use crate::image::TriggerCounter;
use crate::image::write_fits;
use crate::service::load_catalogue;
use crate::settings::{Loaded, Setting};
use crate::simulate::sky::{Kind, RenderSpec, render};
use crate::sky::{ARCSEC, Vec3};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use std::fs;
use std::io::{BufWriter, Write};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;

/// Writes simulated frames, `KIND-SEED-i.fits`, and beside each its truth, `KIND-SEED-i.truth.json`.
///
/// The same kind, seed and number give the same bytes on any machine.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  stars render --kind float --count 20 --seed 7 --out frames\n  \
    stars render --kind night --custom custom.toml --out frames     as that camera would see it\n\n\
    Kinds: night float gradient defocus defocus30 motion multiexp hotpix sparse dense saturated nostars blank faint,\n\
    and frames spoilt by one cause: cause-overexposed cause-saturated cause-no_contrast cause-out_of_focus cause-trailed\n\
    cause-clouds cause-too_few_stars cause-too_many_artefacts cause-wrong_platescale cause-mirrored cause-wrong_prior\n\
    cause-lens_covered")]
pub struct Args {
    /// Kind of frame
    #[arg(long)]
    kind: Kind,
    /// Number of frames
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(..=MAX_NUMBER))]
    count: u64,
    /// Number of the first frame
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=MAX_NUMBER))]
    first: u64,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory for the frames; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frames rendered at a time [default: one for each processor]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=64))]
    jobs: Option<u8>,
    /// Columns, px [default: the setting camera.width_px]
    #[arg(long, value_name = "PX")]
    width: Option<usize>,
    /// Rows, px [default: the setting camera.height_px]
    #[arg(long, value_name = "PX")]
    height: Option<usize>,
    /// Plate scale [default: drawn for each frame, from 9.25 to 9.60 or from the range that settings other than the flight
    /// file's give]
    #[arg(long, value_name = "ARCSEC_PX")]
    platescale: Option<f64>,
    /// Epoch that the stars are moved to, Julian year [default: the setting catalog.epoch_yr]
    #[arg(long, value_name = "YEAR", value_parser = |text: &str| within(text, 1950.0, 2100.0))]
    epoch: Option<f64>,
    /// Turn the picture over, left to right, as the setting camera.mirrored does
    #[arg(long)]
    mirrored: bool,
    /// Frames of one camera, by a seed of its own: its optics, dust and hot pixels are those of every frame, each frame has its
    /// number for the counter of triggers, and the truth has the hot pixels
    #[arg(long, value_name = "SEED")]
    camera: Option<u64>,
    /// Look where the frames of another seed look, as a second camera beside theirs does
    #[arg(long, value_name = "SEED")]
    beside: Option<u64>,
    /// Turned against them by so many arcsec about left, up and the boresight
    #[arg(long, value_name = "LEFT,UP,BORESIGHT", requires = "beside", value_parser = turn, allow_hyphen_values = true)]
    turned: Option<Vec3>,
    #[command(flatten)]
    config: ConfigArgs,
}

/// Three angles in arcsec, as rad.
fn turn(text: &str) -> Result<Vec3, String> {
    let angles: Result<Vec<f64>, _> = text.split(',').map(|angle| within(angle, -324_000.0, 324_000.0)).collect();
    match angles?.as_slice() {
        &[left, up, boresight] => Ok(Vec3::new(left, up, boresight) * ARCSEC),
        _ => Err(format!("'{text}' is not three angles, expected LEFT,UP,BORESIGHT in arcsec")),
    }
}

/// Greatest number of a frame, and of frames.
const MAX_NUMBER: u64 = u32::MAX as u64;

impl Args {
    /// The frame of a number; what the options leave open is the settings' camera's.
    fn spec(&self, index: u64, loaded: &Loaded) -> RenderSpec {
        let standard = RenderSpec::new(self.kind, self.seed, index);
        let (camera, matching) = (&loaded.settings.camera, &loaded.settings.solver.matching);
        let ranged = |setting: &Setting| setting.key.starts_with("solver.matching.platescale_") && setting.is_overridden();
        let (low, high) = match self.platescale {
            Some(scale) => (scale * ARCSEC, scale * ARCSEC),
            None if loaded.all.iter().any(ranged) => {
                (matching.platescale_min_arcsec_px * ARCSEC, matching.platescale_max_arcsec_px * ARCSEC)
            }
            None => standard.platescale,
        };
        let attitude = self.beside.map(|seed| {
            let theirs = RenderSpec { seed, ..standard.clone() }.drawn_attitude();
            self.turned.as_ref().map_or(theirs, |turn| theirs.turned(turn))
        });
        RenderSpec {
            camera: self.camera,
            attitude,
            width: self.width.unwrap_or(camera.width_px as usize),
            height: self.height.unwrap_or(camera.height_px as usize),
            platescale: (low, high),
            epoch_yr: self.epoch.unwrap_or(loaded.settings.catalog.epoch_yr),
            mirrored: self.mirrored || camera.mirrored,
            ..standard
        }
    }

    /// Renders and writes all frames.
    ///
    /// # Errors
    ///
    /// Settings that are wrong, a size that can't be rendered, or a directory that can't be written to.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let loaded = self.config.load()?;
        let catalogue = load_catalogue(&loaded.settings.catalog.file).map_err(anyhow::Error::msg)?;
        fs::create_dir_all(&self.out).with_context(|| format!("{}: can't be made", self.out.display()))?;
        let processors = || thread::available_parallelism().map_or(1, NonZeroUsize::get);
        let jobs = self.jobs.map_or_else(processors, usize::from);
        let progress =
            ProgressBar::new(self.count).with_style(ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {eta} left")?);
        let (next, failed) = (AtomicU64::new(0), AtomicBool::new(false));
        let work = || -> anyhow::Result<()> {
            while !failed.load(Ordering::Relaxed) {
                let nth = next.fetch_add(1, Ordering::Relaxed);
                if nth >= self.count {
                    break;
                }
                let written = write_one(&self.out, &self.spec(self.first + nth, &loaded), &catalogue);
                failed.fetch_or(written.is_err(), Ordering::Relaxed);
                written?;
                progress.inc(1);
            }
            Ok(())
        };
        thread::scope(|scope| {
            let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(work)).collect();
            workers
                .into_iter()
                .try_for_each(|worker| worker.join().unwrap_or_else(|_| anyhow::bail!("a frame broke the renderer")))
        })?;
        progress.finish_and_clear();
        Ok(ExitCode::SUCCESS)
    }
}

fn write_one(out: &Path, spec: &RenderSpec, catalogue: &Catalogue) -> anyhow::Result<()> {
    let mut rendered = render(spec, catalogue)?;
    if spec.camera.is_some() {
        rendered.frame.stamp.trigger = u32::try_from(spec.index).ok().map(TriggerCounter);
    }
    let path = |ending: &str| out.join(format!("{}{ending}", rendered.frame.stamp.origin));
    write(&path(".fits"), |file| Ok(write_fits(&rendered.frame, &[], file)?))?;
    write(&path(".truth.json"), |file| {
        serde_json::to_writer_pretty(&mut *file, &rendered.truth)?;
        Ok(file.write_all(b"\n")?)
    })
}

/// Writes a file with `content`; errors name it.
fn write(path: &Path, content: impl FnOnce(&mut BufWriter<fs::File>) -> anyhow::Result<()>) -> anyhow::Result<()> {
    let attempt = || -> anyhow::Result<()> {
        let mut file = BufWriter::new(fs::File::create(path)?);
        content(&mut file)?;
        Ok(file.flush()?)
    };
    attempt().with_context(|| format!("{}: can't be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        args: Args,
    }

    fn spec(words: &[&str]) -> RenderSpec {
        let args = Cli::parse_from([&["render", "--kind", "night", "--out", "x"], words].concat()).args;
        args.spec(0, &args.config.load().unwrap())
    }

    #[test]
    fn a_frame_is_the_standard_one_unless_settings_or_options_describe_another_camera() {
        assert_eq!(spec(&[]), RenderSpec::new(Kind::Night, 1, 0));
        let range =
            ["--set", "solver.matching.platescale_min_arcsec_px=38", "--set", "solver.matching.platescale_max_arcsec_px=42"];
        let other = [&range[..], &["--set", "camera.width_px=640", "--set", "camera.mirrored=true"]].concat();
        let camera = spec(&other);
        assert_eq!((camera.width, camera.height, camera.mirrored), (640, 1024, true));
        assert_eq!(camera.platescale, (38.0 * ARCSEC, 42.0 * ARCSEC));
        let both = spec(&[&other[..], &["--platescale", "40", "--width", "800"]].concat());
        assert_eq!((both.width, both.platescale), (800, (40.0 * ARCSEC, 40.0 * ARCSEC)));
    }
}
