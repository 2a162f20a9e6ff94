//! Marks: numbers by which two answers are told apart to the last bit.

use crate::image::Frame;
use crate::solve::{Outcome, Reason};
use serde::{Deserialize, Serialize};
use std::fmt::{self, Debug, Write};

/// CRC-32 (IEEE) over all of a value as its debug format shows it, where a float has every digit that tells it from its neighbours.
pub fn mark(value: &impl Debug) -> u32 {
    struct Sum(crc32fast::Hasher);
    impl Write for Sum {
        fn write_str(&mut self, text: &str) -> fmt::Result {
            self.0.update(text.as_bytes());
            Ok(())
        }
    }
    let mut sum = Sum(crc32fast::Hasher::new());
    // It never refuses; and a value whose format does would do so each time.
    let _ = write!(sum, "{value:?}");
    sum.0.finalize()
}

/// CRC-32 (IEEE) over the pixels of a frame, little-endian, in file order.
pub fn pixel_sum(frame: &Frame) -> u32 {
    /// Pixels that are turned into bytes at a time.
    const AT_A_TIME: usize = 4096;
    let mut sum = crc32fast::Hasher::new();
    let mut bytes = Vec::with_capacity(2 * AT_A_TIME);
    for pixels in frame.pixels.chunks(AT_A_TIME) {
        bytes.clear();
        bytes.extend(pixels.iter().flat_map(|pixel| pixel.to_le_bytes()));
        sum.update(&bytes);
    }
    sum.finalize()
}

/// The parts of an outcome that have a mark each.
const PARTS: [&str; 7] = ["stamp", "reason", "statistics", "sources", "solution", "candidates", "prior"];

/// What is kept of an outcome: what people ask for first, and a mark of each of its parts. The time that it took is none of them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutcomeMark {
    /// How the frame ended.
    pub reason: Reason,
    /// In words.
    pub detail: String,
    /// Right ascension, declination and roll as served, rad, where it is solved.
    pub pointing: Option<(f64, f64, f64)>,
    /// Sources matched.
    pub matched: u32,
    /// One σ east, north and in roll as served, rad, where it is solved. For operators alone: it is not in a journal, and so unknown of
    /// what was read from one.
    #[serde(skip)]
    pub sigmas: Option<[f64; 3]>,
    marks: [u32; PARTS.len()],
}

impl OutcomeMark {
    /// Of an outcome.
    pub fn of(outcome: &Outcome) -> Self {
        // Whoever adds to an outcome decides here where it belongs.
        let Outcome {
            stamp,
            rows,
            reason,
            cause,
            blur,
            detail,
            statistics,
            mode,
            found_by,
            sources,
            sources_tried,
            solution,
            candidate,
            triangles,
            candidates_tried,
            prior,
            prior_disagreement,
            times: _,
        } = outcome;
        let marks = [
            mark(&(stamp, rows)),
            mark(&(reason, cause, blur, detail)),
            mark(statistics),
            mark(&(mode, sources, sources_tried)),
            mark(&(found_by, solution)),
            mark(&(candidate, triangles, candidates_tried)),
            mark(&(prior, prior_disagreement)),
        ];
        Self {
            reason: *reason,
            detail: detail.clone(),
            pointing: solution.as_ref().map(|solution| solution.served_attitude().angles()),
            matched: solution.as_ref().map_or(0, |solution| u32::try_from(solution.matches.len()).unwrap_or(u32::MAX)),
            sigmas: solution.as_ref().map(|solution| solution.sigmas().into()),
            marks,
        }
    }

    /// The names of the parts in which another differs from it.
    pub fn differences(&self, other: &Self) -> Vec<&'static str> {
        PARTS.iter().zip(self.marks.iter().zip(&other.marks)).filter(|(_, (a, b))| a != b).map(|(name, _)| *name).collect()
    }
}

impl fmt::Display for OutcomeMark {
    /// The reason, and the pointing in degrees or the words.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.pointing {
            Some((ra, dec, roll)) => {
                let [ra, dec, roll] = [ra, dec, roll].map(f64::to_degrees);
                write!(f, "{} RA {ra:.5} Dec {dec:.5} roll {roll:.4}, {} matched", self.reason, self.matched)
            }
            None => write!(f, "{} ({})", self.reason, self.detail),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Stamp;
    use crate::sky::RowOrder;
    use crate::solve::Statistics;

    #[test]
    fn a_mark_tells_the_neighbour_of_a_float_and_the_sign_of_nought() {
        let value = 0.1 + 0.2;
        assert_ne!(mark(&value), mark(&f64::from_bits(f64::to_bits(value) + 1)));
        assert_ne!(mark(&0.0), mark(&-0.0));
        assert_eq!(mark(&(1, "a")), mark(&(1, "a")));
    }

    #[test]
    fn outcomes_differ_in_the_parts_that_differ_and_not_in_their_times() {
        let outcome = Outcome::unsolved(Stamp::default(), Reason::NoMatch, "12 sources");
        let mut other = outcome.clone();
        other.times.total = std::time::Duration::from_secs(1);
        assert!(OutcomeMark::of(&outcome).differences(&OutcomeMark::of(&other)).is_empty());
        other.statistics = Some(Statistics { mean: 1.0, ..Statistics::default() });
        other.prior_disagreement = Some(0.1);
        assert_eq!(OutcomeMark::of(&outcome).differences(&OutcomeMark::of(&other)), ["statistics", "prior"]);
    }

    #[test]
    fn the_sum_of_pixels_is_that_of_their_bytes() {
        let frame = Frame::new(100, 77, (0..7700).collect(), RowOrder::BottomFirst).unwrap();
        let bytes: Vec<u8> = frame.pixels.iter().flat_map(|pixel| pixel.to_le_bytes()).collect();
        assert_eq!(pixel_sum(&frame), crc32fast::hash(&bytes));
    }
}
