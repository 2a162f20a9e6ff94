//! `stars render`: writes simulated frames with their truth.

use crate::catalog::Catalogue;
use crate::image::write_fits;
use crate::simulate::sky::{Kind, RenderSpec, render};
use crate::sky::ARCSEC;
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
#[command(after_help = "Example:\n  stars render --kind float --count 20 --seed 7 --out frames\n\n\
    Kinds: night float gradient defocus defocus30 motion multiexp hotpix sparse dense saturated nostars blank")]
pub struct Args {
    /// Kind of frame
    #[arg(long)]
    kind: Kind,
    /// Number of frames
    #[arg(long, default_value_t = 1)]
    count: u64,
    /// Number of the first frame
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// Seed of everything random
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Directory for the frames; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Frames rendered at a time [default: one for each processor]
    #[arg(long, value_name = "N")]
    jobs: Option<NonZeroUsize>,
    /// Columns, px
    #[arg(long, value_name = "PX", default_value_t = 1536)]
    width: usize,
    /// Rows, px
    #[arg(long, value_name = "PX", default_value_t = 1024)]
    height: usize,
    /// Plate scale [default: drawn from 9.25 to 9.60 for each frame]
    #[arg(long, value_name = "ARCSEC_PX")]
    platescale: Option<f64>,
    /// Epoch that the stars are moved to, Julian year
    #[arg(long, value_name = "YEAR", default_value_t = 2013.0)]
    epoch: f64,
    /// Turn the picture over, left to right
    #[arg(long)]
    mirrored: bool,
}

impl Args {
    fn spec(&self, index: u64) -> RenderSpec {
        let standard = RenderSpec::new(self.kind, self.seed, index);
        RenderSpec {
            width: self.width,
            height: self.height,
            platescale: self.platescale.map_or(standard.platescale, |scale| (scale * ARCSEC, scale * ARCSEC)),
            epoch_yr: self.epoch,
            mirrored: self.mirrored,
            ..standard
        }
    }

    /// Renders and writes all frames.
    ///
    /// # Errors
    ///
    /// A size that can't be rendered, or a directory that can't be written to.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let catalogue = Catalogue::embedded().context("the built-in catalogue")?;
        fs::create_dir_all(&self.out).with_context(|| format!("{}: can't be made", self.out.display()))?;
        let jobs = self.jobs.or_else(|| thread::available_parallelism().ok()).map_or(1, NonZeroUsize::get);
        let progress =
            ProgressBar::new(self.count).with_style(ProgressStyle::with_template("{bar:40} {pos}/{len} frames, {eta} left")?);
        let (next, failed) = (AtomicU64::new(0), AtomicBool::new(false));
        let work = || -> anyhow::Result<()> {
            while !failed.load(Ordering::Relaxed) {
                let nth = next.fetch_add(1, Ordering::Relaxed);
                if nth >= self.count {
                    break;
                }
                let written = write_one(&self, self.first + nth, &catalogue);
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

fn write_one(args: &Args, index: u64, catalogue: &Catalogue) -> anyhow::Result<()> {
    let rendered = render(&args.spec(index), catalogue)?;
    let path = |ending: &str| args.out.join(format!("{}{ending}", rendered.frame.stamp.origin));
    write(&path(".fits"), |file| Ok(write_fits(&rendered.frame, file)?))?;
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
