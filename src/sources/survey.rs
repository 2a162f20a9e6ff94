//! The survey of the wide kernels: in which of them most stands out.

use super::finder::{Finder, Look};
use super::kernel::SearchKernel;
use super::peaks::{Peak, PeakRules};
use super::trails;
use crate::image::{CellStatistics, Frame};

/// What a kernel found.
#[derive(Debug, Clone)]
pub(super) struct Survey {
    pub kernel: SearchKernel,
    pub peaks: Vec<Peak>,
    /// Sum of the squares of how far the best sources are above what a source must be.
    score: f32,
}

/// Scales that are surveyed round, and those that are surveyed for trails: kernels of 2, 4 and 8 px; trails of 12 and 24 px.
const ROUND_SCALES: std::ops::RangeInclusive<usize> = 1..=3;
const TRAIL_SCALES: std::ops::RangeInclusive<usize> = 1..=2;
/// Sources whose confidence decides what a kernel is worth: about as many as there are stars. None of them counts for more than this,
/// so that one bright star does not decide for all.
const DECIDING: usize = 12;
const MOST_OF_ONE: f32 = 8.0;
/// A kernel that is worth less finds no pattern. (Trials: of 53 frames of discs and trails of 30 px that are solved all have 66 or more; of
/// 60 of smaller discs two have between this and 40.)
const LEAST_SCORE: f32 = 15.0;
/// Peaks of a cell by which a kernel is judged: enough to have a dozen stars among them.
const JUDGED_PER_CELL: usize = 1;
/// Peaks that a cell gives along a direction.
const TRAILS_PER_CELL: usize = 4;
/// Directions that are judged, of those in which the highest peaks of the cells stand furthest above their thresholds; none counts for
/// more than this many thresholds. (Trials: of 160 frames with trails 136 are solved; with four directions and two peaks of a cell 137.)
const JUDGED_DIRECTIONS: usize = 2;
const MOST_PROMISE: f32 = 2.0;

/// Peaks along a direction, and how far the highest of them stand out.
struct Trails {
    kernel: SearchKernel,
    peaks: Vec<Peak>,
    promise: f32,
}

impl Finder {
    /// Looks with every wide kernel, and tells which are worth a search: the one in which most stands out first; `None` where it was
    /// told not to keep on.
    ///
    /// Of the directions of a trail only the best is told.
    pub fn survey(&mut self, frame: &Frame, cells: &CellStatistics, look: &Look<'_>) -> Option<Vec<SearchKernel>> {
        self.surveyed.clear();
        for scale in ROUND_SCALES {
            let kernel = SearchKernel::Round { scale };
            let mut peaks = Vec::new();
            if !self.find_peaks(frame, cells, look, kernel, &mut peaks) {
                return None;
            }
            let round = self.judged(frame, cells, look, kernel, peaks);
            let trails = TRAIL_SCALES.contains(&scale);
            let trail = if trails { Some(self.survey_trails(frame, cells, look, scale, &round.peaks)?) } else { None };
            self.surveyed.push(round);
            self.surveyed.extend(trail);
        }
        self.surveyed.sort_by(|a, b| b.score.total_cmp(&a.score));
        Some(self.surveyed.iter().filter(|survey| survey.score >= LEAST_SCORE).map(|survey| survey.kernel).collect())
    }

    /// The direction in which most stands out in the picture halved `scale` times, and its peaks, which lie beside those of the round
    /// kernel; `None` where it was told not to keep on.
    fn survey_trails(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        scale: usize,
        round: &[Peak],
    ) -> Option<Survey> {
        let mut found = self.find_trails(cells, look, scale, round);
        found.sort_by(|a, b| b.promise.total_cmp(&a.promise));
        let mut best: Option<Survey> = None;
        for Trails { kernel, peaks, .. } in found.into_iter().take(JUDGED_DIRECTIONS) {
            let mut trail = self.judged(frame, cells, look, kernel, peaks);
            let is_best = |trail: &Survey| best.as_ref().is_none_or(|best| trail.score > best.score);
            if is_best(&trail) {
                // A streak across the picture is a row of trails, which count for nothing.
                self.mark_lines(kernel);
                trail.score = self.score(look);
                if is_best(&trail) {
                    best = Some(trail);
                }
            }
            if !(look.keep_on)() {
                return None;
            }
        }
        best
    }

    /// What a kernel's peaks are worth: how confident the best of those are that have its shape.
    fn judged(
        &mut self,
        frame: &Frame,
        cells: &CellStatistics,
        look: &Look<'_>,
        kernel: SearchKernel,
        peaks: Vec<Peak>,
    ) -> Survey {
        // Those of a cell come one after the other, the highest first.
        self.peaks.clear();
        for of_cell in peaks.chunk_by(|a, b| a.cell == b.cell) {
            self.peaks.extend(of_cell.iter().take(JUDGED_PER_CELL));
        }
        self.measure_peaks(frame, cells, look, kernel, false);
        Survey { kernel, peaks, score: self.score(look) }
    }

    /// What the candidates are worth that have the shape of stars.
    fn score(&self, look: &Look<'_>) -> f32 {
        let stars = self.candidates.iter().filter(|c| c.is_star_like());
        let mut confidences: Vec<f32> = stars.map(|c| c.standing.confidence.min(MOST_OF_ONE)).collect();
        confidences.sort_unstable_by(|a, b| b.total_cmp(a));
        // What any noise has counts for nothing.
        confidences.iter().take(DECIDING).map(|c| (c - look.settings.min_snr as f32).max(0.0).powi(2)).sum()
    }

    /// The peaks along every direction, in the smoothed picture of the round kernel just searched with.
    fn find_trails(&self, cells: &CellStatistics, look: &Look<'_>, scale: usize, round: &[Peak]) -> Vec<Trails> {
        let kernel = |direction: usize| SearchKernel::Trail { scale, direction };
        let (masked, smooth) = (look.masked_at(cells, scale), self.finder.smooth());
        let rules = PeakRules { per_cell: TRAILS_PER_CELL, ..look.rules(kernel(0), smooth, &self.thresholds, &masked) };
        let found = trails::find(smooth, &rules, round);
        let trails_of = |(direction, peaks): (usize, Vec<Peak>)| {
            let highest = peaks.chunk_by(|a, b| a.cell == b.cell).filter_map(<[Peak]>::first);
            let noise = trails::noise(direction);
            let mut heights: Vec<f32> = highest
                .map(|peak| (peak.height / (noise * rules.threshold_at(peak.x, peak.y)) - 1.0).min(MOST_PROMISE))
                .collect();
            heights.sort_unstable_by(|a, b| b.total_cmp(a));
            let promise = heights.iter().take(DECIDING).map(|height| height * height).sum();
            Trails { kernel: kernel(direction), peaks, promise }
        };
        found.into_iter().enumerate().map(trails_of).collect()
    }
}
