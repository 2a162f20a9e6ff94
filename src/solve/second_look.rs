//! A second look at sources that fit no pattern: whether they would, were the settings other ones.
//!
//! Only to say what is wrong: nothing found here is ever served. Each look is at few sources and few candidates, a millisecond or two, and
//! a watch that says to stop is obeyed in between.

use super::pattern::{PatternSearch, SearchEnd, SearchRules};
use super::verify::{FrameGeometry, PatternSource};
use super::{Cause, Watch};
use crate::catalog::Field;
use crate::settings::SolverSettings;
use crate::sky::{ARCSEC, DEG, Vec3, separation};

/// Sources and candidates of one look.
const SOURCES: usize = 12;
const CANDIDATES: u64 = 4_000;
/// How far outside its range the plate scale is looked for, fraction.
const FURTHEST_PLATESCALE: f64 = 0.36;

/// What a second look has to work with.
pub struct SecondLook<'a> {
    /// The camera's index.
    pub field: &'a Field,
    /// The sources, brightest first.
    pub sources: &'a [PatternSource],
    /// The frame's geometry.
    pub geometry: &'a FrameGeometry,
    /// Settings of the search before.
    pub settings: &'a SolverSettings,
    /// Where a prior lets the boresight be: the middle of the circle; only where nothing else was searched.
    pub only_near: Option<Vec3>,
    /// Whether to stop.
    pub watch: &'a dyn Watch,
}

impl SecondLook<'_> {
    /// The setting that keeps the sources from fitting a pattern, and how that was seen; `None` where none does.
    pub fn cause(&self) -> Option<(Cause, String)> {
        self.wrong_prior().or_else(|| self.mirrored()).or_else(|| self.wrong_platescale())
    }

    /// The whole sky, where only a part was searched.
    fn wrong_prior(&self) -> Option<(Cause, String)> {
        let centre = self.only_near?;
        let pose = self.search(self.sources, self.geometry)?;
        let distance = separation(&centre, &pose.boresight) / DEG;
        Some((Cause::WrongPrior, format!("the stars are those {distance:.1}° from where the prior wants them")))
    }

    fn mirrored(&self) -> Option<(Cause, String)> {
        let sources = self.rebuilt(|source| (-source.left, source.up), 1.0);
        self.search(&sources, self.geometry)?;
        Some((Cause::Mirrored, "the stars fit a pattern where left and right are exchanged: see camera.mirrored".into()))
    }

    /// Plate scales beyond either end of the range, in steps as wide as it: a picture of another plate scale is one of this, enlarged.
    fn wrong_platescale(&self) -> Option<(Cause, String)> {
        let (low, high) = self.field.platescale_range;
        let step = (high / low).max(1.0 + 1e-3);
        let steps = ((1.0 + FURTHEST_PLATESCALE).ln() / step.ln()).ceil().clamp(1.0, 40.0) as i32;
        let nearest_first = (1..=steps).flat_map(|n| [n, -n]);
        for n in nearest_first {
            let scale = step.powi(n);
            let sources = self.rebuilt(|source| (source.left * scale, source.up * scale), scale);
            let geometry = FrameGeometry {
                size: (self.geometry.size.0 * scale, self.geometry.size.1 * scale),
                half_diagonal: self.geometry.half_diagonal * scale,
                ..*self.geometry
            };
            if let Some(found) = self.search(&sources, &geometry) {
                return Some((
                    Cause::WrongPlatescale,
                    format!(
                        "the stars fit a pattern at {:.2}″/px, which is outside {:.2} to {:.2}″/px",
                        found.platescale * scale / ARCSEC,
                        low / ARCSEC,
                        high / ARCSEC
                    ),
                ));
            }
            if self.watch.stop().is_some() {
                return None;
            }
        }
        None
    }

    /// The brightest sources at other offsets.
    fn rebuilt(&self, offsets: impl Fn(&PatternSource) -> (f64, f64), scale: f64) -> Vec<PatternSource> {
        let moved = |source: &PatternSource| {
            let (left, up) = offsets(source);
            let platescale = self.field.geometry.platescale;
            let direction = Vec3::new(left * platescale, up * platescale, 1.0).normalize();
            PatternSource { left, up, sigma: source.sigma * scale, direction, ..*source }
        };
        self.sources.iter().take(SOURCES).map(moved).collect()
    }

    fn search(&self, sources: &[PatternSource], geometry: &FrameGeometry) -> Option<Found> {
        let rules = SearchRules {
            min_matched: self.settings.matching.min_matched as usize,
            max_false_ln: self.settings.matching.max_false_probability_log10 * std::f64::consts::LN_10,
            budget: CANDIDATES,
            region: None,
            region_only: false,
            stop: &|| self.watch.stop(),
        };
        match PatternSearch::new(self.field, sources.get(..SOURCES).unwrap_or(sources), geometry, &rules).run().0 {
            SearchEnd::Found(found) => {
                Some(Found { boresight: found.pose.attitude.boresight(), platescale: found.pose.platescale })
            }
            _ => None,
        }
    }
}

/// A pattern that the sources fit.
struct Found {
    boresight: Vec3,
    platescale: f64,
}
