//! A second copy of the sky in one frame: stars that a series of exposures drew in pieces further apart than their light is looked at.
//!
//! The pattern of one piece of every star solves as well as one of whole stars, and points where the camera did during that piece
//! alone. What gives it away is that the same stars are there again, all moved by the same way.

use super::verify::{Assigned, PatternSource};

/// Copies are looked for up to this distance, px: a gondola that moves faster leaves nothing to be found.
const FURTHEST_PX: f64 = 200.0;
/// Ways that differ by less are the same, px; or by less than so many σ of the other sources, whose middles are not fitted.
const SAME_PX: f64 = 3.0;
const SAME_SIGMAS: f64 = 2.0;
/// Stars that must be there again: this part of those matched, and no fewer than this.
const SHARE: f64 = 0.3;
const LEAST: usize = 4;
/// One fewer will do where so many are the same by chance in fewer frames than this part of all: in those with few sources.
const RARE: f64 = 1.0 / 500.0;
/// Matched stars and other sources that are compared, the best of each: more make it no surer, and take the square of the time twice over.
const MOST: usize = 50;

/// How far the nearest copy of the matched stars lies, px, beyond `nearest_px`; `None` where there is none.
pub fn nearest_copy(sources: &[PatternSource], matches: &[Assigned], nearest_px: f64) -> Option<f64> {
    let is_matched = |index: usize| matches.iter().any(|m| m.source == index);
    let others = sources.iter().enumerate().filter(|&(i, _)| !is_matched(i)).map(|(_, other)| other);
    let others: Vec<&PatternSource> = others.take(MOST).collect();
    let stars = matches.iter().filter_map(|m| sources.get(m.source)).take(MOST);
    let way = |star: &PatternSource, other: &PatternSource| (other.left - star.left, other.up - star.up);
    let ways: Vec<(f64, f64)> = stars
        .flat_map(|star| others.iter().map(move |other| way(star, other)))
        .filter(|w| (nearest_px * nearest_px..FURTHEST_PX * FURTHEST_PX).contains(&(w.0 * w.0 + w.1 * w.1)))
        .collect();
    let mut sigmas: Vec<f64> = others.iter().map(|other| other.sigma).collect();
    sigmas.sort_by(f64::total_cmp);
    let same_px = SAME_PX.max(SAME_SIGMAS * sigmas.get(sigmas.len() / 2).copied().unwrap_or(0.0));
    // Ways that have two others within their reach, of ways strewn evenly.
    let by_chance = (ways.len() as f64).powi(3) / 2.0 * (same_px / FURTHEST_PX).powi(4);
    let least = if by_chance < RARE { LEAST - 1 } else { LEAST };
    let least = ((SHARE * matches.len().min(MOST) as f64).ceil() as usize).max(least);
    let is_same = |v: &(f64, f64), w: &(f64, f64)| (v.0 - w.0).powi(2) + (v.1 - w.1).powi(2) < same_px * same_px;
    // No check of overflow, which would keep it from being done in vectors.
    let count = |w: &(f64, f64)| ways.iter().fold(0usize, |sum, v| sum.wrapping_add(usize::from(is_same(v, w))));
    let shared = |w: &&(f64, f64)| count(w) >= least;
    ways.iter().filter(shared).map(|w| w.0.hypot(w.1)).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};

    /// Places all over a picture, px.
    fn places(seed: u64, count: usize) -> Vec<(f64, f64)> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| (1536.0 * random.random::<f64>() - 768.0, 1024.0 * random.random::<f64>() - 512.0)).collect()
    }

    fn sources(places: &[(f64, f64)]) -> Vec<PatternSource> {
        places.iter().map(|&(left, up)| PatternSource::new(left, up, 0.2, 100.0, 4.6e-5)).collect()
    }

    fn matches(count: usize) -> Vec<Assigned> {
        (0..count).map(|source| Assigned { source, star: source }).collect()
    }

    #[test]
    fn stars_that_are_there_again_are_seen_and_how_far() {
        let stars = places(1, 12);
        let again = stars.iter().step_by(2).map(|&(left, up)| (left + 40.0, up - 30.0));
        let all: Vec<_> = stars.iter().copied().chain(again).chain(places(2, 30)).collect();
        let found = nearest_copy(&sources(&all), &matches(12), 28.0).unwrap();
        assert!((found - 50.0).abs() < 1e-6, "{found}");
        assert_eq!(nearest_copy(&sources(&all), &matches(12), 60.0), None, "nearer ones are somebody else's to look at");
    }

    #[test]
    fn a_copy_whose_places_are_coarse_is_seen_as_well() {
        let stars = places(3, 20);
        // Middles of samples of four pixels, as a search of a picture halved twice leaves those that no pattern needed.
        let coarse = |c: f64| (c / 4.0).round() * 4.0;
        let again = stars.iter().step_by(2).map(|&(left, up)| (coarse(left + 40.3), coarse(up + 41.1)));
        let mut all = sources(&stars);
        all.extend(
            sources(&again.chain(places(4, 20)).collect::<Vec<_>>()).into_iter().map(|s| PatternSource { sigma: 2.0, ..s }),
        );
        let found = nearest_copy(&all, &matches(20), 28.0);
        assert!(found.is_some_and(|px| (50.0..65.0).contains(&px)), "{found:?}");
    }

    #[test]
    fn of_five_stars_three_that_are_there_again_are_seen() {
        // The last but one piece of a series of four, in which the faint stars were found once.
        let stars = [(-186.0, 69.0), (-667.0, -473.0), (-202.0, 394.0), (-220.0, -36.0), (-11.0, -271.0)];
        let again = [(-649.0, -473.5), (-185.3, 394.5), (-203.0, -35.8)];
        let others =
            [(637.0, 264.0), (98.0, 27.0), (-77.0, 485.0), (84.0, -258.0), (-613.0, 483.0), (-727.0, -75.0), (545.0, 36.0)];
        let all: Vec<_> = stars.iter().chain(&again).chain(&others).copied().collect();
        let found = nearest_copy(&sources(&all), &matches(5), 0.0).unwrap();
        assert!((16.0..19.0).contains(&found), "{found}");
    }

    #[test]
    fn a_copy_is_seen_among_a_thousand_sources_crowded_together() {
        // As many as may be found, all within reach of each other: were all compared, it would take minutes.
        let crowded = |seed, count| places(seed, count).into_iter().map(|(left, up)| (0.1 * left, 0.1 * up));
        let stars: Vec<_> = crowded(3, 500).collect();
        let again = stars.iter().map(|&(left, up)| (left + 60.0, up));
        let all: Vec<_> = stars.iter().copied().chain(again).collect();
        assert!(nearest_copy(&sources(&all), &matches(500), 28.0).is_some());
    }

    #[test]
    fn other_sources_make_no_copy_by_chance() {
        for seed in 0..200 {
            let all = places(1000 + seed, 100);
            assert_eq!(nearest_copy(&sources(&all), &matches(20), 28.0), None, "{seed}");
        }
    }
}
