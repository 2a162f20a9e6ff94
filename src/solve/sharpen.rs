//! Sharp stars that a wide kernel found: measured again in the picture itself.
//!
//! Beside clouds and glow a wide kernel finds stars whose shape is none of its own. Once a pose says where they are, and their light laid
//! on top of each other is narrow, each is measured as the sharp search would have: sooner and better than in a halved picture.

use super::light::{SHARP_SIGMA_PX, WHOLE_LIGHT_PX, known_stars};
use super::solver::{Context, Solver};
use super::verify::{Hypothesis, assign, project_stars};
use crate::sources::{Look, Source};

/// A sharp source belongs to a star within this distance, px: the error of a pose from a picture halved once or twice.
const NEAR_PX: f64 = 2.0;
/// Of the matches so many must be there as sharp stars.
const LEAST_PART: f64 = 0.75;
const LEAST_STARS: usize = 5;

impl Solver {
    /// Measures the stars of a pattern that a wide kernel found as sharp ones. Where they are, they replace the sources of the last search,
    /// and the pattern's matches point to them; else both are as they were.
    pub(super) fn sharpen(&mut self, context: &Context<'_>, look: &Look<'_>, found: &Hypothesis) -> Option<Hypothesis> {
        let stars = known_stars(context, &found.pose, &found.matches, &self.pattern_sources(context));
        let light = self.finder.light(&self.cells, &stars.iter().map(|(_, star)| *star).collect::<Vec<_>>())?;
        let (dx, dy) = light.middle;
        if light.axes.0 >= WHOLE_LIGHT_PX || dx.hypot(dy) > NEAR_PX {
            return None;
        }
        let places = stars.iter().map(|(_, star)| (star.x + dx, star.y + dy)).take(look.settings.max_found as usize);
        let mut sharp: Vec<Source> = Vec::new();
        let (fitted, axes) = (found.matches.len(), self.finder.psf_axes);
        self.finder.find_at(context.frame, &self.cells, look, places, &mut sharp);
        let wide = std::mem::replace(&mut self.found, sharp);
        let mut projected = Vec::new();
        project_stars(context.field, &found.pose, &context.geometry, u8::MAX, &mut projected);
        let mut matches = Vec::new();
        assign(&self.pattern_sources(context), &projected, |_| NEAR_PX, &mut matches);
        let whole = matches.iter().filter(|m| self.found.get(m.source).is_some_and(|source| source.star_like)).count();
        let sharp = self.finder.psf_axes.is_some_and(|(long, _)| long <= SHARP_SIGMA_PX);
        if !sharp || whole < LEAST_STARS || (whole as f64) < LEAST_PART * fitted as f64 {
            (self.found, self.finder.psf_axes) = (wide, axes);
            return None;
        }
        Some(Hypothesis { matches, ..found.clone() })
    }
}
