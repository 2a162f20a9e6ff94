//! Planted look-alikes: parts of a true pattern of stars among sources that are no stars, or among the stars of another field.

#![allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "this is a test")]

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use stars::catalog::{Catalogue, Field, FieldKey};
use stars::settings::Settings;
use stars::sky::{Attitude, separation};
use stars::solve::{FrameGeometry, PatternSearch, PatternSource, Pose, SearchEnd, SearchRules};
use std::f64::consts::{LN_10, PI, TAU};

const SIZE: (usize, usize) = (1536, 1024);
/// Error of a place per axis, px.
const SIGMA_PX: f64 = 0.5;

/// A source: offsets, px, and brightness, mag.
type Spot = (f64, f64, f64);

struct Sky {
    field: Field,
    geometry: FrameGeometry,
    settings: Settings,
    random: ChaCha8Rng,
}

impl Sky {
    fn new() -> Self {
        let settings = Settings::flight().unwrap();
        let catalogue = Catalogue::embedded().unwrap();
        let field = Field::build(&catalogue, &FieldKey::new(&catalogue, &settings, SIZE.0, SIZE.1), &|| true).unwrap();
        let geometry = FrameGeometry::new(&settings.solver, &field, SIZE.0, SIZE.1);
        Self { field, geometry, settings, random: ChaCha8Rng::seed_from_u64(11) }
    }

    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.random.random::<f64>()
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    fn pose(&mut self) -> Pose {
        let attitude = Attitude::from_angles(self.uniform(0.0, TAU), self.uniform(-1.0, 1.0).asin(), self.uniform(-PI, PI));
        Pose::undistorted(attitude, self.field.geometry.platescale)
    }

    /// The brightest stars of a pose, as they look.
    fn stars(&mut self, pose: &Pose, count: usize) -> Vec<Spot> {
        let (w, h) = (0.5 * self.geometry.size.0, 0.5 * self.geometry.size.1);
        let half_diagonal = self.geometry.half_diagonal;
        let mut seen = Vec::new();
        self.field.stars.near(&pose.attitude.boresight(), (1.1 * half_diagonal * pose.platescale).atan(), |_, star| {
            if let Some((left, up)) = pose.project(&star.direction, half_diagonal).filter(|(x, y)| x.abs() < w && y.abs() < h) {
                seen.push((left, up, f64::from(star.mag)));
            }
        });
        seen.sort_by(|a, b| a.2.total_cmp(&b.2));
        seen.truncate(count);
        for spot in &mut seen {
            *spot = (spot.0 + SIGMA_PX * self.normal(), spot.1 + SIGMA_PX * self.normal(), spot.2 + 0.3 * self.normal());
        }
        seen
    }

    /// Sources that are no stars.
    fn false_ones(&mut self, count: usize) -> Vec<Spot> {
        let (w, h) = (0.5 * self.geometry.size.0, 0.5 * self.geometry.size.1);
        (0..count).map(|_| (self.uniform(-w, w), self.uniform(-h, h), self.uniform(4.0, 9.0))).collect()
    }

    fn search(&self, mut spots: Vec<Spot>) -> SearchEnd {
        spots.sort_by(|a, b| a.2.total_cmp(&b.2));
        let scale = self.field.geometry.platescale;
        let sources: Vec<PatternSource> =
            spots.iter().map(|&(left, up, mag)| PatternSource::new(left, up, SIGMA_PX, 10f64.powf(-0.4 * mag), scale)).collect();
        let matching = &self.settings.solver.matching;
        let rules = SearchRules {
            min_matched: matching.min_matched as usize,
            max_false_ln: matching.max_false_probability_log10 * LN_10,
            budget: u64::from(matching.candidate_budget),
            region: None,
            region_only: false,
            stop: &|| None,
        };
        PatternSearch::new(&self.field, &sources, &self.geometry, &rules).run().0
    }
}

#[test]
fn four_stars_of_a_pattern_among_false_sources_are_not_served() {
    let mut sky = Sky::new();
    for trial in 0..400 {
        let pose = sky.pose();
        let mut spots = sky.stars(&pose, 4);
        spots.extend(sky.false_ones(12));
        assert!(!matches!(sky.search(spots), SearchEnd::Found(_)), "{trial}");
    }
}

#[test]
fn stars_of_another_field_among_the_true_ones_do_not_lead_astray() {
    let mut sky = Sky::new();
    let mut right = 0;
    for trial in 0..400 {
        let (here, elsewhere) = (sky.pose(), sky.pose());
        let mut spots = sky.stars(&here, 9);
        // The look-alike's stars are the brighter ones.
        spots.extend(sky.stars(&elsewhere, 4).into_iter().map(|(x, y, mag)| (x, y, mag - 3.0)));
        if let SearchEnd::Found(found) = sky.search(spots) {
            let off = separation(&found.pose.attitude.boresight(), &here.attitude.boresight());
            assert!(off < 3.0 * here.platescale, "{trial}: {off} rad");
            right += 1;
        }
    }
    assert!(right >= 390, "{right}");
}
