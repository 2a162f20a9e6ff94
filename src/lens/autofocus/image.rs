//! What an outcome says of the focus.

use super::{FocusImage, Metric, StarId};
use crate::command::Tick;
use crate::lens::FocusCounts;
use crate::solve::{Outcome, Statistics};

/// Where a star's middle falls on a pixel makes its highest pixel vary by this part, one σ (a Gaussian of σ 0.85 to 1.3 px).
const PHASE_PART: f64 = 0.08;
/// ADU per electron where the frame does not show it: a camera of 24 e⁻/ADU.
const USUAL_GAIN_ADU_PER_E: f64 = 0.04;
/// One σ of a measured width, as a part of it.
const WIDTH_PART: f64 = 0.05;

impl FocusImage {
    /// The metrics of an outcome. `captured`: middle of the exposure; `position`: where the lens stood during the whole of it, `None`
    /// where that is not known or it moved.
    pub fn new(outcome: &Outcome, captured: Tick, position: Option<FocusCounts>, temperature_c: Option<f64>) -> Self {
        let statistics = outcome.statistics.unwrap_or_default();
        let peak_of = |source: usize| {
            let source = outcome.sources.get(source).filter(|source| !source.saturated)?;
            (source.peak > 0.0).then(|| Metric { value: source.peak, sigma: sigma_of(source.peak, &statistics) })
        };
        let brightest = (0..outcome.sources.len()).filter_map(peak_of).max_by(|a, b| a.value.total_cmp(&b.value));
        let matches = outcome.solution.iter().flat_map(|solution| &solution.matches);
        let stars = matches.filter_map(|pair| Some((StarId(u32::try_from(pair.star).ok()?), peak_of(pair.source)?))).collect();
        let width_px = statistics.fwhm_px.map(|value| Metric { value, sigma: WIDTH_PART * value });
        Self { counter: outcome.stamp.image, captured, position, brightest, stars, width_px, temperature_c }
    }
}

/// One σ of a peak: of the sky, of its own light, and of where it lies on the pixels, ADU.
fn sigma_of(peak: f64, statistics: &Statistics) -> f64 {
    let gain = statistics.gain.filter(|gain| gain.is_finite() && *gain > 0.0).unwrap_or(USUAL_GAIN_ADU_PER_E);
    (statistics.noise.powi(2) + gain * peak + (PHASE_PART * peak).powi(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{ImageCounter, Stamp};
    use crate::solve::{Reason, SourceReport};
    use std::time::Duration;

    #[test]
    fn the_brightest_is_not_saturated_and_an_unsolved_frame_has_no_stars() {
        let source = |peak, saturated| SourceReport { x: 0.0, y: 0.0, sigma_px: 0.1, flux: 1.0, snr: 9.0, peak, saturated };
        let stamp = Stamp { image: ImageCounter(7), ..Stamp::default() };
        let mut outcome = Outcome::unsolved(stamp, Reason::NoMatch, "");
        outcome.statistics = Some(Statistics { noise: 8.0, gain: Some(0.04), fwhm_px: Some(2.2), ..Statistics::default() });
        outcome.sources = vec![source(4000.0, true), source(100.0, false), source(300.0, false)];
        let image = FocusImage::new(&outcome, Duration::from_secs(3), Some(FocusCounts(2500)), None);
        let brightest = image.brightest.unwrap();
        assert_eq!((brightest.value, image.counter, image.stars.len()), (300.0, ImageCounter(7), 0));
        assert!((brightest.sigma - (64.0f64 + 12.0 + 576.0).sqrt()).abs() < 1e-9);
        assert!(image.width_px.is_some());
    }
}
