//! The refocus: one bounded step, and back where the stars did not get better by it.

use super::curves::{Sample, Samples};
use super::run::{End, Goal, Next};
use super::{AutofocusRules, Ending, FocusImage, Metric, Refusal, StarId};
use crate::lens::FocusCounts;

/// Images with stars before the step and after it, and images taken for them at most.
const WITH_STARS: usize = 3;
const AT_MOST: u32 = 9;

/// A refocus under way.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Refocus {
    start: i32,
    target: i32,
    /// Whether the step is made.
    stepped: bool,
    images: u32,
    samples: Samples,
}

impl Refocus {
    /// A refocus by some counts, which the settings must allow. On the way down the backlash goes off what is allowed, for the lens must
    /// come back up.
    pub fn new(rules: &AutofocusRules, by: i32, from: FocusCounts) -> Result<Self, Refusal> {
        let target = from.0.checked_add(by).ok_or(Refusal::StepOutOfRange)?;
        if by == 0 || by > rules.refocus || by < rules.backlash.saturating_sub(rules.refocus) || target < rules.backlash {
            return Err(Refusal::StepOutOfRange);
        }
        Ok(Self { start: from.0, target, stepped: false, images: 0, samples: Samples::default() })
    }

    /// Takes an image that counts.
    pub fn take(&mut self, position: i32, image: &FocusImage) {
        self.samples.add(position, image);
    }

    /// What is next, after an image or where none came.
    pub fn next(&mut self) -> Next {
        self.images += 1;
        let here = if self.stepped { self.target } else { self.start };
        let with_stars = self.at(here).filter(|sample| !sample.stars.is_empty() || sample.width_px.is_some()).count();
        if with_stars < WITH_STARS && self.images < AT_MOST {
            return Next::Stay;
        }
        if with_stars == 0 {
            return Next::End(End::empty(Ending::TooFew));
        }
        if !self.stepped {
            (self.stepped, self.images) = (true, 0);
            return Next::Go(self.target);
        }
        let (before, after): (Vec<&Sample>, Vec<&Sample>) = (self.at(self.start).collect(), self.at(self.target).collect());
        Next::End(match ln_ratio(&before, &after) {
            None => End::empty(Ending::TooFew),
            Some(ratio) if ratio.value > 0.0 => {
                End { ending: Ending::Better(ratio), best: None, confirmed: None, to: Goal::Best(self.target) }
            }
            Some(ratio) => End::empty(Ending::Worse(ratio)),
        })
    }

    fn at(&self, position: i32) -> impl Iterator<Item = &Sample> {
        // The lens need not stand exactly where it was sent.
        let other = if position == self.start { self.target } else { self.start };
        self.samples.iter().filter(move |sample| sample.position.abs_diff(position) < sample.position.abs_diff(other))
    }

    pub fn samples(&self) -> &Samples {
        &self.samples
    }
}

/// Weighted mean, and its σ.
fn mean(values: impl Iterator<Item = Metric>) -> Option<Metric> {
    let (sum, weights) = values.fold((0.0, 0.0), |(sum, weights), metric| {
        let weight = (metric.sigma * metric.sigma).recip();
        (sum + weight * metric.value, weights + weight)
    });
    (weights > 0.0).then(|| Metric { value: sum / weights, sigma: weights.sqrt().recip() })
}

fn ln_ratio_of(before: Metric, after: Metric) -> Option<Metric> {
    let sigma = (before.sigma / before.value).hypot(after.sigma / after.value);
    (before.value > 0.0 && after.value > 0.0).then(|| Metric { value: (after.value / before.value).ln(), sigma })
}

/// By how much the stars' peaks grew: of the stars seen before and after, or, where the field has none in common, by their widths.
fn ln_ratio(before: &[&Sample], after: &[&Sample]) -> Option<Metric> {
    let peak = |samples: &[&Sample], id: StarId| {
        mean(samples.iter().flat_map(|sample| &sample.stars).filter(|(star, _)| *star == id).map(|(_, peak)| *peak))
    };
    let mut stars: Vec<StarId> = before.iter().flat_map(|sample| sample.stars.iter().map(|(id, _)| *id)).collect();
    stars.sort_unstable();
    stars.dedup();
    let of_stars = mean(stars.into_iter().filter_map(|id| ln_ratio_of(peak(before, id)?, peak(after, id)?)));
    of_stars.or_else(|| {
        let width = |samples: &[&Sample]| mean(samples.iter().filter_map(|sample| sample.width_px));
        // A peak falls as the square of the width.
        let ratio = ln_ratio_of(width(after)?, width(before)?)?;
        Some(Metric { value: 2.0 * ratio.value, sigma: 2.0 * ratio.sigma })
    })
}
