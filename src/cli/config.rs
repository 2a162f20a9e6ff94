//! The settings options that all subcommands share, and the reading of settings files.

use super::calibrate::kept;
use crate::service::read_file;
use crate::settings::{Layers, Loaded, MAX_TEXT_BYTES};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Where settings come from, in rising precedence.
#[derive(Debug, Clone, Default, clap::Args)]
#[command(next_help_heading = "Settings")]
pub struct ConfigArgs {
    /// Flight file with every setting [default: the one built into the program]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Custom file of this camera: overrides the flight file
    #[arg(long, value_name = "FILE")]
    pub custom: Option<PathBuf>,
    /// Override one setting for this call; may be given often
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl ConfigArgs {
    /// Reads the files and merges the layers, the calibration in force among them. One that is damaged, or that the files do not allow any
    /// more, is named on stderr and left out: it keeps nothing from starting.
    ///
    /// # Errors
    /// A file that can't be read, or the first mistake in a layer, with its place and what was expected.
    pub fn load(&self) -> anyhow::Result<Loaded> {
        let files = self.load_files()?;
        let calibrated = kept::in_force(&files.settings.commands.ledger_directory).and_then(|found| {
            found.map(|(name, text)| self.load_with(&name, &text).map_err(|error| format!("{error:#}"))).transpose()
        });
        Ok(calibrated
            .unwrap_or_else(|complaint| {
                // Nobody is left to tell where even stderr is closed.
                let _ = writeln!(std::io::stderr(), "stars: {complaint}; the calibration is left out");
                None
            })
            .unwrap_or(files))
    }

    /// The same without any calibration.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_files(&self) -> anyhow::Result<Loaded> {
        self.merge(self.files()?)
    }

    /// The same with a calibration, by its name and its text.
    ///
    /// # Errors
    /// As [`Self::load`], and where the calibration has a mistake.
    pub fn load_with(&self, name: &str, calibration: &str) -> anyhow::Result<Loaded> {
        self.merge(self.files()?.calibrated(name, calibration))
    }

    fn files(&self) -> anyhow::Result<Layers> {
        let mut layers = match &self.config {
            Some(path) => Layers::flight(path.display().to_string(), read(path)?),
            None => Layers::embedded(),
        };
        if let Some(path) = &self.custom {
            layers = layers.custom(path.display().to_string(), read(path)?);
        }
        Ok(layers)
    }

    fn merge(&self, layers: Layers) -> anyhow::Result<Loaded> {
        Ok(self.set.iter().fold(layers, |layers, assignment| layers.set(assignment)).load()?)
    }
}

/// Reads a settings file: text of a bounded size, so that naming the wrong file costs nothing.
fn read(path: &Path) -> anyhow::Result<String> {
    let name = path.display();
    let expected = "a settings file in TOML";
    let bytes = read_file(path, MAX_TEXT_BYTES, expected)?;
    String::from_utf8(bytes).map_err(|error| {
        let good = error.as_bytes().iter().take(error.utf8_error().valid_up_to());
        let line = good.filter(|byte| **byte == b'\n').count() + 1;
        anyhow::anyhow!("{name}:{line}: is not UTF-8 text, expected {expected}")
    })
}
