//! Points of light that are no stars, and look like them: in clusters and along lines, where chance would not put them.

use super::psf::Stamp;
use super::random::Purpose;
use super::scene::Scene;
use super::{Kind, RenderSpec};
use std::f64::consts::{PI, TAU};

/// Brightest and faintest peak of a speck, ADU over the sky: from hardly seen to a bright star's.
const PEAK_ADU: (f64, f64) = (20.0, 2000.0);
/// Specks of a cluster, and of a line.
const IN_CLUSTER: (usize, usize) = (4, 20);
const IN_LINE: (usize, usize) = (5, 16);
/// Spread of a cluster about its middle, one σ, px: ice on a window, glitter in the beam.
const CLUSTER_PX: (f64, f64) = (15.0, 120.0);
/// Distance of neighbours on a line, px: flashes of what tumbles by, specks along a scratch.
const STEP_PX: (f64, f64) = (15.0, 120.0);
/// Error of a place on an uneven line along it, of a step.
const UNEVEN: f64 = 0.4;

/// A speck's light, and how much of it there is, ADU.
pub(super) struct Speck {
    stamp: Stamp,
    flux_adu: f64,
}

impl Speck {
    /// Adds its light, ADU, to an image of `width` columns.
    pub fn paint(&self, light: &mut [f32], width: usize) {
        self.stamp.paint(self.flux_adu, light, width);
    }
}

/// The specks of a frame; none but in the kinds that are about them.
pub(super) fn draw(spec: &RenderSpec, scene: &Scene) -> Vec<Speck> {
    let (width, height) = (spec.width as f64, spec.height as f64);
    let mut dice = spec.dice(Purpose::Specks);
    let mut places = Vec::new();
    match spec.kind {
        Kind::Clustered => {
            for _ in 0..dice.count(1, 4) {
                let (x, y) = (dice.uniform(0.0, width), dice.uniform(0.0, height));
                let spread = dice.log_uniform(CLUSTER_PX.0, CLUSTER_PX.1);
                for _ in 0..dice.count(IN_CLUSTER.0, IN_CLUSTER.1) {
                    places.push((x + spread * dice.normal(), y + spread * dice.normal()));
                }
            }
        }
        Kind::Linear => {
            for _ in 0..dice.count(1, 4) {
                let (x, y) = (dice.uniform(0.2, 0.8) * width, dice.uniform(0.2, 0.8) * height);
                // Columns and rows are as likely as all other directions together.
                let angle = if dice.chance(0.5) { 0.5 * PI * dice.count(0, 1) as f64 } else { dice.angle() };
                let (step, even) = (dice.log_uniform(STEP_PX.0, STEP_PX.1), dice.chance(0.5));
                let count = dice.count(IN_LINE.0, IN_LINE.1);
                for i in 0..count {
                    let off = if even { 0.0 } else { UNEVEN * dice.normal() };
                    let along = step * (i as f64 - 0.5 * count as f64 + off);
                    places.push((x + along * libm::cos(angle), y + along * libm::sin(angle)));
                }
            }
        }
        _ => {}
    }
    let to_flux = TAU * scene.psf_sigma_px * scene.psf_sigma_px;
    places
        .into_iter()
        .filter_map(|(x, y)| {
            let flux_adu = to_flux * dice.log_uniform(PEAK_ADU.0, PEAK_ADU.1);
            Some(Speck { stamp: scene.psf.stamp(&[(x, y, 1.0)], spec.width, spec.height)?, flux_adu })
        })
        .collect()
}
