//! The existing key that a misspelt one most likely means.

use super::ranges::RULES;

/// Least likeness of the last part, and of the whole key, for a suggestion; below it a suggestion would be a guess.
const LEAST_LIKENESS: f64 = 0.5;

/// The setting whose name is most like the given key, if any is like it; empty where none is.
pub(super) fn nearest(key: &str) -> &'static str {
    let mut best = (0.0, "");
    for rule in RULES {
        let last = likeness(last_part(key), last_part(rule.key));
        // The whole key decides between settings of the same name, such as the many called `enabled`.
        let whole = likeness(key, rule.key);
        if last >= LEAST_LIKENESS && whole >= LEAST_LIKENESS && last + whole > best.0 {
            best = (last + whole, rule.key);
        }
    }
    best.1
}

fn last_part(key: &str) -> &str {
    key.rsplit('.').next().unwrap_or(key)
}

/// Dice's coefficient of the pairs of neighbouring letters, the ends counted as letters: 1 for the same word, 0 for nothing in
/// common. (L. R. Dice, Ecology 26, 297, 1945.)
fn likeness(a: &str, b: &str) -> f64 {
    let (a, b) = (format!("^{a}$"), format!("^{b}$"));
    let mut rest: Vec<_> = b.as_bytes().windows(2).collect();
    let total = a.len() - 1 + rest.len();
    let mut common = 0;
    for pair in a.as_bytes().windows(2) {
        if let Some(at) = rest.iter().position(|other| *other == pair) {
            rest.swap_remove(at);
            common += 1;
        }
    }
    2.0 * f64::from(common) / total as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_misspelt_key_finds_the_one_that_was_meant() {
        for (given, meant) in [
            ("solver.platescale_arsec", "solver.matching.platescale_min_arcsec_px"),
            ("camera.perod_s", "camera.period_s"),
            ("camera.period", "camera.period_s"),
            ("camera.nme", "camera.name"),
            ("camra.name", "camera.name"),
            ("min_matched", "solver.matching.min_matched"),
            ("solver.requirements.elevation.enable", "solver.requirements.elevation.enabled"),
            ("network.port", ""),
            ("camera.foo", ""),
            ("", ""),
            ("é", ""),
        ] {
            assert_eq!(nearest(given), meant, "{given}");
        }
    }
}
