//! Pixels that cannot be believed, replaced by their neighbours.

use super::Frame;
use std::collections::BTreeSet;

/// Furthest that a good neighbour is looked for, px.
const MAX_REACH: usize = 4;

/// Column, and row from the bottom of the picture.
type Place = (usize, usize);

/// The bad pixels of one detector.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct BadPixels {
    pixels: BTreeSet<Place>,
    /// Row by row, as frames are laid out: each with the good ones of the 8 around it.
    in_order: Vec<(Place, Vec<Place>)>,
}

/// A line of a list of bad pixels that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name}, line {line}: \"{text}\", expected column and row of a pixel: two whole numbers from 0, as in `12 34`")]
pub struct BadPixelsError {
    /// The list's name, as given.
    pub name: String,
    /// The line, from 1.
    pub line: usize,
    /// What stands there (its beginning).
    pub text: String,
}

impl BadPixels {
    /// Reads a list: `x y` a line, 0-based, rows counted from the bottom of the picture, whichever end a frame begins with; `#` begins
    /// a comment. `name` is for errors.
    pub fn parse(name: &str, list: &str) -> Result<Self, BadPixelsError> {
        let mut pixels = BTreeSet::new();
        for (i, line) in list.lines().enumerate() {
            let entry = line.split('#').next().unwrap_or_default();
            let mut words = entry.split_whitespace();
            match (words.next(), words.next(), words.next()) {
                (None, ..) => {}
                (Some(x), Some(y), None) if let (Some(x), Some(y)) = (whole(x), whole(y)) => {
                    pixels.insert((x, y));
                }
                _ => {
                    let text = entry.trim().chars().take(40).collect();
                    return Err(BadPixelsError { name: name.to_owned(), line: i + 1, text });
                }
            }
        }
        let ring = |place| ring(place, 1).filter(|near| !pixels.contains(near)).collect();
        let mut in_order: Vec<_> = pixels.iter().map(|&place| (place, ring(place))).collect();
        in_order.sort_unstable_by_key(|((x, y), _)| (*y, *x));
        Ok(Self { pixels, in_order })
    }

    /// Bad pixels listed.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// None is listed.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// Replaces each bad pixel of a frame by the median of its good neighbours: the 8 around it or, where they are bad
    /// too, the nearest square ring within 4 px that has a good one. Returns how many were replaced; a listed pixel
    /// outside the image, or without a good one near it, is left alone.
    pub fn apply(&self, frame: &mut Frame) -> usize {
        let mut replaced = 0;
        for (place, around) in &self.in_order {
            let further = |reach| median(frame, ring(*place, reach).filter(|near| !self.pixels.contains(near)));
            let median = median(frame, around.iter().copied()).or_else(|| (2..=MAX_REACH).find_map(further));
            let at = place_of(frame, *place);
            if let (Some(median), Some(pixel)) = (median, at.and_then(|at| frame.pixels.get_mut(at))) {
                *pixel = median;
                replaced += 1;
            }
        }
        replaced
    }
}

/// The places at a Chebyshev distance from one.
fn ring((x, y): Place, reach: usize) -> impl Iterator<Item = Place> {
    let across = move |centre: usize| centre.saturating_sub(reach)..=centre.saturating_add(reach);
    let square = across(y).flat_map(move |v| across(x).map(move |u| (u, v)));
    square.filter(move |(u, v)| u.abs_diff(x).max(v.abs_diff(y)) == reach)
}

/// Median of a frame's pixels at some places, no more than a ring has; of an even number, the mean of the middle two.
fn median(frame: &Frame, places: impl Iterator<Item = Place>) -> Option<u16> {
    let mut values = [0; 8 * MAX_REACH];
    let there = places.filter_map(|place| frame.pixels.get(place_of(frame, place)?));
    let count = values.iter_mut().zip(there).map(|(value, adu)| *value = *adu).count();
    let values = values.get_mut(..count)?;
    values.sort_unstable();
    let upper = *values.get(count / 2)?;
    let lower = *values.get(count.checked_sub(1)? / 2)?;
    Some(upper.midpoint(lower))
}

/// Where a pixel of the list is among a frame's; `None` where it is outside.
fn place_of(frame: &Frame, (x, y): Place) -> Option<usize> {
    let row = frame.rows.from_bottom(y, frame.height)?;
    (x < frame.width).then_some(row * frame.width + x)
}

/// A whole number of digits alone.
fn whole(word: &str) -> Option<usize> {
    word.bytes().all(|c| c.is_ascii_digit()).then(|| word.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::RowOrder;

    #[test]
    fn a_bad_pixel_takes_the_median_of_its_good_neighbours() {
        let bad = BadPixels::parse("bad.txt", "# column row\n1 1\n\n 2   1 # hot\n99 99\n").unwrap();
        assert_eq!(bad.len(), 3);
        #[rustfmt::skip]
        let pixels = vec![
            10,    20,    30, 0,
            40, 60000, 60000, 0,
            70,    80,    90, 0,
        ];
        let mut frame = Frame::new(4, 3, pixels, RowOrder::BottomFirst).unwrap();
        assert_eq!(bad.apply(&mut frame), 2, "the third is outside");
        // Around (1, 1): 10 20 30 40 70 80 90, its right neighbour being bad; around (2, 1): 0 0 0 20 30 80 90.
        assert_eq!((frame.pixels[5], frame.pixels[6]), (40, 20));
    }

    #[test]
    fn one_list_holds_for_frames_that_begin_with_either_end() {
        let bad = BadPixels::parse("bad.txt", "0 0\n3 1\n2 3").unwrap();
        let rows: [[u16; 4]; 4] = [[9, 1, 2, 3], [4, 5, 6, 9], [7, 8, 10, 11], [12, 13, 9, 14]];
        let frame = |rows: Vec<[u16; 4]>, order| Frame::new(4, 4, rows.concat(), order).unwrap();
        let mut bottom = frame(rows.to_vec(), RowOrder::BottomFirst);
        let mut top = frame(rows.iter().rev().copied().collect(), RowOrder::TopFirst);
        assert_eq!((bad.apply(&mut bottom), bad.apply(&mut top)), (3, 3));
        let turned: Vec<u16> = top.pixels.chunks(4).rev().flatten().copied().collect();
        assert_eq!(turned, bottom.pixels);
        assert_ne!((bottom.pixels[0], bottom.pixels[7], bottom.pixels[14]), (9, 9, 9));
    }

    #[test]
    fn a_pixel_among_bad_ones_takes_the_nearest_good_ring_and_a_hopeless_one_stays() {
        let block: String = (0..3).flat_map(|y| (0..3).map(move |x| format!("{x} {y}\n"))).collect();
        let bad = BadPixels::parse("bad.txt", &block).unwrap();
        let mut frame = Frame::new(5, 5, vec![7; 25], RowOrder::BottomFirst).unwrap();
        frame.pixels[0] = 500;
        assert_eq!(bad.apply(&mut frame), 9);
        assert_eq!(frame.pixels[0], 7);
        let mut nothing_else = Frame::new(3, 3, vec![500; 9], RowOrder::BottomFirst).unwrap();
        assert_eq!(bad.apply(&mut nothing_else), 0);
    }

    #[test]
    fn a_line_that_is_no_pixel_is_named() {
        for (list, line, text) in [
            ("1 2\n3", 2, "3"),
            ("1 2 3", 1, "1 2 3"),
            ("# ok\n\n-1 2", 3, "-1 2"),
            ("1.5 2", 1, "1.5 2"),
            ("+1 2", 1, "+1 2"),
            ("99999999999999999999999 0", 1, "99999999999999999999999 0"),
        ] {
            let error = BadPixels::parse("bad.txt", list).unwrap_err();
            assert_eq!(error, BadPixelsError { name: "bad.txt".to_owned(), line, text: text.to_owned() });
            assert!(error.to_string().starts_with(&format!("bad.txt, line {line}: ")), "{error}");
        }
    }
}
