//! `stars catalog`: what the star catalogue is, whether a file is a whole one, single stars of it, and the index of a camera.

use super::{ConfigArgs, NEGATIVE, print};
use crate::catalog::{Catalogue, Names};
use crate::service::{Clock, load_catalogue, prepare};
use crate::settings::Settings;
use crate::sky::{ARCSEC, DEG, ra_dec};
use crate::solve::Solver;
use anyhow::{Context, bail};
use std::process::ExitCode;
use std::sync::Arc;

/// Shows and checks the star catalogue.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  stars catalog                                what the catalogue in use is and holds
  stars catalog --check stars.bin              is this file whole and unaltered? exit code 2 and the reason where not
  stars catalog --star Vega                    place, motion and magnitude of a star
  stars catalog --star 91262                   the same, by Hipparcos number
  stars catalog --index --custom custom.toml   the index for that camera, from the cache or built, and how long that took")]
pub struct Args {
    /// Check this file instead of the catalogue in use
    #[arg(long, value_name = "FILE")]
    check: Option<String>,
    /// Show a star: proper name, Hipparcos number, or what solutions call it (`G1234`); exit code 1 where there is none
    #[arg(long, value_name = "NAME|HIP")]
    star: Option<String>,
    /// Make the index for the settings' camera ready, as `stars run` does, and show what it holds
    #[arg(long, conflicts_with = "star")]
    index: bool,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Runs the subcommand; answers negative where there is no such star.
    ///
    /// # Errors
    /// Settings that do not load, or a catalogue that is not whole.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let settings = self.config.load()?.settings;
        let file = self.check.as_ref().unwrap_or(&settings.catalog.file);
        if self.check.as_ref().is_some_and(String::is_empty) {
            bail!("--check: the name of the file is empty, expected a star catalogue");
        }
        let clock = Clock::start();
        let catalogue = load_catalogue(file).map_err(anyhow::Error::msg)?;
        if self.index {
            return print(&index(catalogue, settings, &clock)?).map(|()| ExitCode::SUCCESS);
        }
        let Some(name) = self.star else {
            let verdict = if self.check.is_some() { "whole and unaltered\n" } else { "" };
            return print(&format!("{verdict}{}", summary(file, &catalogue))).map(|()| ExitCode::SUCCESS);
        };
        match catalogue.find(&name) {
            Some(index) => print(&star(&catalogue, index, settings.catalog.epoch_yr)).map(|()| ExitCode::SUCCESS),
            None => print(&format!("no star is called {name:?}")).map(|()| ExitCode::from(NEGATIVE)),
        }
    }
}

/// What a catalogue says of itself and what it holds.
fn summary(file: &str, catalogue: &Catalogue) -> String {
    let header = &catalogue.header;
    let stars = &catalogue.stars;
    let numbered = stars.iter().filter(|star| star.hip != 0).count();
    let named = Names::embedded().as_ref().map_or(0, |names| stars.iter().filter(|star| names.of(star.hip).is_some()).count());
    let magnitude = |star: Option<&crate::catalog::Star>| star.map_or_else(String::new, |star| format!("{:.3}", star.mag));
    let (brightest, faintest) = (magnitude(stars.first()), magnitude(stars.last()));
    let file = if file.is_empty() { "built into the program" } else { file };
    [
        format!("file        {file}"),
        format!("origin      {}", header.origin),
        format!("format      {}", header.format),
        format!("checksum    {:08x} (CRC-32 of the stars)", header.checksum),
        format!("epoch       J{:.1}, ICRS", header.epoch_yr),
        format!("stars       {}", header.count),
        format!("magnitudes  {brightest} to {faintest}, Gaia RP"),
        format!("numbers     {numbered} stars have a Hipparcos number and a proper motion"),
        format!("names       {named} stars have a proper name"),
    ]
    .join("\n")
}

/// The index of the settings' camera; `clock` was started before the catalogue was read.
fn index(catalogue: Catalogue, settings: Settings, clock: &Clock) -> anyhow::Result<String> {
    let (width, height) = (settings.camera.width_px as usize, settings.camera.height_px as usize);
    let mut solver = Solver::new(Arc::new(catalogue), Arc::new(settings));
    let loaded = clock.uptime();
    let prepared = prepare(&mut solver, width, height);
    let ready = clock.uptime();
    let field = solver.field().context("the index is not there")?;
    let (stars, triangles) = field.triangles.counts();
    let key = &field.key;
    let density = key.density();
    let degrees = |px: usize| px as f64 * field.geometry.platescale / DEG;
    let mut lines = vec![
        format!("field       {:.2} × {:.2} deg, {width} × {height} px", degrees(width), degrees(height)),
        format!("stars       {stars}, {:.1} a field of {}", density.stars_per_field, key.wanted.stars_per_field),
        format!(
            "triangles   {triangles}, of sides up to {:.2} of the diagonal, of {}",
            density.longest_side, key.wanted.longest_side
        ),
        format!("memory      {:.1} MB", field.bytes() as f64 / 1e6),
        format!("catalogue   read in {:.3} s", loaded.as_secs_f64()),
        format!("index       {} in {:.3} s", prepared.word(), (ready - loaded).as_secs_f64()),
    ];
    lines.extend(prepared.complaints.into_iter().map(|complaint| format!("note        {complaint}")));
    Ok(lines.join("\n"))
}

/// One star: its place at the catalogue's epoch and at that of observation, Julian years.
fn star(catalogue: &Catalogue, index: usize, observed_yr: f64) -> String {
    let Some(star) = catalogue.stars.get(index) else { return String::new() };
    let place = |epoch_yr: f64| {
        let (ra, dec) = ra_dec(&star.direction_after(epoch_yr - catalogue.header.epoch_yr));
        format!("J{epoch_yr:<9.1} {:.6} {:+.6} deg", ra / DEG, dec / DEG)
    };
    let hip = if star.hip == 0 { "none".to_owned() } else { star.hip.to_string() };
    let mas_yr = |radians_yr: f64| 1000.0 * radians_yr / ARCSEC;
    let motion = match star.hip {
        0 => "unknown, taken as none".to_owned(),
        _ => {
            format!("{:+.0} {:+.0} mas/yr (right ascension times cos(dec), declination)", mas_yr(star.pm_ra), mas_yr(star.pm_dec))
        }
    };
    [
        catalogue.name(index),
        format!("Hipparcos  {hip}"),
        format!("rank       {} by brightness", index + 1),
        format!("magnitude  {:.3} Gaia RP", star.mag),
        place(catalogue.header.epoch_yr),
        place(observed_yr),
        format!("motion     {motion}"),
    ]
    .join("\n")
}
