//! Stars that move while they are exposed, along a way that is known: the smoothing kernel of each exposure is the trail that a star
//! leaves in it, and all exposures share one origin, so that a star's light of the whole series is added up where it was there
//! (stars-paper, "Solving - Motion PSF").
//!
//! The sum over trails is the matched filter of a star in plain noise: its peaks are searched in the picture halved once (`sum`), and each
//! is then fitted in the exposures as they are (`fit`). So every source has a flux, and a σ that is the least there can be (Cramér-Rao);
//! and since it is known how many peaks noise alone makes, the probability that it is no more than that.

#![allow(clippy::indexing_slicing, reason = "a numeric kernel: rows are cut from the picture's own size")]

mod fit;
mod sum;
#[cfg(test)]
mod tests;
mod window;

use super::finder::{Finder, Look, Source};
use super::kernel::SearchKernel;
use super::peaks::{Peak, PeakRules};
use super::plane::{Clipped, HalveScratch, Plane, halve};
use crate::image::{CELL_PX, CellStatistics, Frame};
use sum::{HalvedTrail, Sum, apart, peaks_of};
use window::Exposed;

/// Signal over noise of a peak that is worth a fit, and of a source.
const LEAST_SNR: f32 = 3.2;
/// Peaks of the sum that are looked at, and those of them whose place is fitted. Around dust the sum stands high: what is a star shows once
/// the sky beside each trail is told.
const MOST_PEAKS: usize = 400;
const MOST_FITTED: usize = 64;
/// Sources for each step of one in their signal over noise, as stars make them: what noise is measured against. (Stars that a picture is
/// solved by are about ten, most of them over a range of three.)
const STARS_PER_SNR: f64 = 3.0;

/// The way of a star at rest in the sky over the picture during one exposure.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Trail {
    /// Offsets from where the star is said to be, which all exposures share, px in file order (x, y), evenly spaced in time.
    pub places: Vec<(f64, f64)>,
    /// This exposure's part of the light of the series.
    pub share: f64,
    /// How far the picture has turned about its centre by the middle of this exposure, rad: what lay at (x, y) from there has moved by
    /// (y, −x) times it.
    pub spin: f64,
    /// One σ of where it lies against the trails of the other exposures, px per axis.
    pub sigma_px: f64,
    /// How the way of a star away from the picture's centre differs from that of one there.
    pub stretch: Stretch,
}

/// What a flat picture of the sky and the lens's distortion make of a way at a distance r from the centre, px: it is longer by a·r² all round
/// and by (2a + b)·r² along r.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Stretch {
    /// a: radial distortion, px⁻².
    pub distortion: f64,
    /// b: square of the plate scale, px⁻².
    pub flatness: f64,
}

impl Stretch {
    /// By how much a way, px, is longer at a place from the centre, px.
    fn of(&self, way: (f64, f64), from_centre: (f64, f64)) -> (f64, f64) {
        let (x, y) = from_centre;
        let round = self.distortion * (x * x + y * y);
        let radial = (2.0 * self.distortion + self.flatness) * (x * way.0 + y * way.1);
        (round * way.0 + radial * x, round * way.1 + radial * y)
    }
}

impl Trail {
    /// From its first place to its last, px.
    fn length(&self) -> f64 {
        let ends = self.places.first().zip(self.places.last());
        ends.map_or(0.0, |(first, last)| (last.0 - first.0).hypot(last.1 - first.1))
    }

    /// The mean of its places.
    pub fn middle(&self) -> (f64, f64) {
        let n = self.places.len().max(1) as f64;
        let sum = self.places.iter().fold((0.0, 0.0), |sum, place| (sum.0 + place.0, sum.1 + place.1));
        (sum.0 / n, sum.1 / n)
    }

    /// Furthest offset from the origin along either axis, px.
    pub fn reach(&self) -> f64 {
        self.places.iter().map(|(x, y)| x.abs().max(y.abs())).fold(0.0, f64::max)
    }

    /// The longer side of the box that holds it, px.
    pub fn span(&self) -> f64 {
        let side = |part: fn(&(f64, f64)) -> f64| {
            let (low, high) = ends(self.places.iter().map(part));
            high - low
        };
        side(|place| place.0).max(side(|place| place.1))
    }

    /// Where the picture's turn has moved what lay at a place of a picture with this centre.
    fn spun(&self, (x, y): (f64, f64), centre: (f64, f64)) -> (f64, f64) {
        (x + self.spin * (y - centre.1), y - self.spin * (x - centre.0))
    }
}

/// What is known of a source that was found along its trails.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trailed {
    /// Covariance of its place: x-x, y-y, x-y, px². Along a trail, where its ends alone tell, it is much greater than across.
    pub covariance: (f64, f64, f64),
    /// Probability that noise alone made it.
    pub noise: f64,
}

/// Least and greatest of some numbers; nought where there are none.
fn ends(mut values: impl Iterator<Item = f64>) -> (f64, f64) {
    let first = values.next().unwrap_or(0.0);
    values.fold((first, first), |(low, high), value| (low.min(value), high.max(value)))
}

/// The middle of a picture, in its own samples.
fn centre(width: usize, height: usize) -> (f64, f64) {
    (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0))
}

impl Finder {
    /// Finds stars by the light of all exposures of a series, each along its own trail; positions are those at the origin of the trails, the
    /// surest first. `cells`: the statistics of each exposure. `false` where it was told not to keep on.
    pub fn find_along(
        &mut self,
        exposures: &[&Frame],
        cells: &[CellStatistics],
        trails: &[Trail],
        look: &Look<'_>,
        sources: &mut Vec<Source>,
    ) -> bool {
        sources.clear();
        let halved: Vec<_> = trails.iter().map(HalvedTrail::of).collect();
        let mut sum = Sum::default();
        for (((frame, cells), halved), trail) in exposures.iter().zip(cells).zip(&halved).zip(trails) {
            if !self.smooth_above_level(frame, cells, trail, look) {
                return false;
            }
            sum.add(self.finder.smooth(), halved, trail);
        }
        let Some(first) = cells.first() else { return true };
        let peaks = peaks_of(&sum.plane, first, sum::noise_of(&halved, cells), look);
        let exposed: Vec<Exposed<'_>> =
            exposures.iter().zip(cells).zip(trails).map(|((frame, cells), trail)| Exposed::new(frame, cells, trail)).collect();
        let mut peaks: Vec<(Peak, f32)> = peaks.into_iter().map(|peak| (peak, fit::contrast(&exposed, &peak))).collect();
        peaks.retain(|(_, snr)| *snr >= LEAST_SNR);
        peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
        peaks.truncate(MOST_FITTED);
        sources.extend(apart(peaks, &halved, LEAST_SNR).iter().filter_map(|(peak, _)| fit::source_at(&exposed, peak)));
        sources.sort_by(|a, b| b.star_like.cmp(&a.star_like).then(b.snr.total_cmp(&a.snr)));
        sources.truncate(look.settings.max_found as usize);
        let independent = sum.plane.pixels.len() as f64 * sum::peaks_per_sample(&halved, cells);
        for source in sources.iter_mut() {
            if let Some(trailed) = &mut source.trailed {
                trailed.noise = noise_share(independent, source.snr);
            }
        }
        self.psf_axes = None;
        true
    }

    /// An exposure halved and smoothed, above its level; `false` where it was told not to keep on.
    fn smooth_above_level(&mut self, frame: &Frame, cells: &CellStatistics, trail: &Trail, look: &Look<'_>) -> bool {
        let (mut excess, mut half) = (Vec::new(), Plane::default());
        Clipped::excess_of(frame, cells, &mut excess);
        halve(&Clipped::new(frame, &excess), &mut HalveScratch::default(), &mut half);
        // Coarse cells, of 8 px: the level is told from beyond the light of the trail.
        let ring = 2 + (trail.length() / 8.0).ceil() as usize;
        let no_peaks = PeakRules {
            taps: SearchKernel::Sharp.taps(),
            ring,
            border: half.width,
            cell: CELL_PX,
            per_cell: 1,
            thresholds: &[f32::INFINITY],
            threshold_columns: 1,
            masked: &|_, _| true,
        };
        self.finder.find(&half, &no_peaks, look.keep_on, true, &mut Vec::new())
    }
}

/// How bright stars are in each exposure of a series, as a part of how bright all together say that they are, with its σ: each star at its
/// place at the origin of the trails, px, with its flux in all of them. Nought with an infinite σ where none of them is on the picture.
pub fn shares_along(
    exposures: &[&Frame],
    cells: &[CellStatistics],
    trails: &[Trail],
    stars: &[(f64, f64, f64)],
) -> Vec<(f64, f64)> {
    let exposed = exposures.iter().zip(cells).zip(trails).map(|((frame, cells), trail)| Exposed::new(frame, cells, trail));
    fit::shares(&exposed.collect::<Vec<_>>(), stars)
}

/// What the exposures say of a star at each of some places at the origin of the trails, px: its light as the matched filter of its trails
/// gathers it, and the information of that; the first over the second is its flux, whose σ is one over the root of the second. Nought where
/// it is not on the picture.
pub fn light_along(
    exposures: &[&Frame],
    cells: &[CellStatistics],
    trails: &[Trail],
    places: impl Iterator<Item = (f64, f64)>,
) -> Vec<(f64, f64)> {
    let exposed = exposures.iter().zip(cells).zip(trails).map(|((frame, cells), trail)| Exposed::new(frame, cells, trail));
    let exposed: Vec<Exposed<'_>> = exposed.collect();
    places.map(|(x, y)| fit::light_at(&exposed, x, y)).collect()
}

/// The part of the sources of a signal over noise that noise makes. It makes `peaks` · s exp(−s²/2) peaks higher than s, as the maxima of a
/// smooth Gaussian field are counted (Adler, The Geometry of Random Fields, 1981, chapter 6), where s is high; here they are counted by
/// the step of s.
fn noise_share(peaks: f64, snr: f64) -> f64 {
    let of_noise = peaks * snr * snr * libm::exp(-0.5 * snr * snr);
    of_noise / (of_noise + STARS_PER_SNR)
}
