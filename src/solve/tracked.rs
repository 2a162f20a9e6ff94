//! The solver's first stage where something is known beforehand: the sources of a search near where they are expected.

use super::near::{NearRules, NearSearch};
use super::pattern::SearchEnd;
use super::solver::{Context, Solver, most_tried, note_tally, stopped};
use super::verify::{Hypothesis, PatternSource};
use super::{FoundBy, Outcome, Reason};

/// Sources of at least this SNR are more than noise: one in seven frames has a peak of noise so high (half a million independent places).
const SURE_SNR: f64 = 5.0;

/// As many stars more are wanted where plate scale and distortion are not known: of three stars these leave so little to spare that one
/// which noise has moved far goes unseen.
const STARS_FOR_THE_LENS: usize = 1;

impl Solver {
    /// Matches the sources of the last search near where they are expected; `true` where the frame is done with, `false` where it must
    /// be searched lost in space.
    pub(super) fn match_near(&mut self, context: &Context<'_>, outcome: &mut Outcome) -> bool {
        let Some(region) = &context.region else { return false };
        let settings = self.settings().clone();
        let settings = &settings.solver;
        let all = self.pattern_sources(context);
        let spare = if context.geometry.knows_lens() { 0 } else { STARS_FOR_THE_LENS };
        let rules = NearRules {
            min_matched: settings.tracking.min_matched as usize + spare,
            max_false_ln: settings.matching.max_false_probability_log10 * std::f64::consts::LN_10,
            stop: &|| context.watch.stop(),
        };
        // Those that no noise explains by themselves, and then all: what is mostly noise hides three stars.
        let brightest = self.found.iter().take(most_tried(settings, context)).enumerate();
        let tried: Vec<usize> = brightest.clone().map(|(i, _)| i).collect();
        let sure: Vec<usize> = brightest.filter(|(_, source)| source.snr >= SURE_SNR).map(|(i, _)| i).collect();
        for list in [Some(&sure), Some(&tried).filter(|tried| tried.len() > sure.len())].into_iter().flatten() {
            let started = context.watch.elapsed();
            let sources: Vec<PatternSource> = list.iter().filter_map(|&i| all.get(i).copied()).collect();
            let Some(search) = NearSearch::new(context.field, &sources, &context.geometry, region, &rules) else { continue };
            let (end, tally) = search.run();
            outcome.times.match_ += context.watch.elapsed() - started;
            note_tally(outcome, tally);
            let done = match end {
                SearchEnd::Found(mut hypothesis) => {
                    for m in &mut hypothesis.matches {
                        m.source = list.get(m.source).copied().unwrap_or(m.source);
                    }
                    self.conclude_near(context, &hypothesis, outcome)
                }
                SearchEnd::Stopped(stop) => stopped(outcome, stop),
                SearchEnd::Exhausted(_) | SearchEnd::Budget(_) => false,
            };
            if done {
                return true;
            }
        }
        false
    }

    /// Concludes a pattern that was found near where it was expected; one that the final fit or a requirement does not bear out leaves
    /// the outcome as it was, for it may still be found otherwise. Whether the frame is solved.
    fn conclude_near(&mut self, context: &Context<'_>, found: &Hypothesis, outcome: &mut Outcome) -> bool {
        let (started, before) = (context.watch.elapsed(), outcome.clone());
        if context.along.is_none() {
            self.finder.complete(&mut self.found);
        }
        self.report_sources(outcome);
        self.conclude(context, &self.pattern_sources(context), found, FoundBy::Tracked, outcome);
        let done = outcome.reason == Reason::Solved;
        if !done {
            *outcome = before;
        }
        outcome.times.fit += context.watch.elapsed() - started;
        done
    }
}
