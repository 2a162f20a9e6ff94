//! Auto-levelling: the part of the scale in which an image lives, for showing it.

use super::Frame;
use crate::sky::RowOrder;

/// Every fourth pixel of every fourth row is counted.
const STEP: usize = 4;
/// One part in this many of the counted pixels is left out at either end, so that 98 % stay.
const TAIL: usize = 100;
/// Room beyond the boundaries, ADU.
const MARGIN_ADU: u16 = 2;

/// The values that are shown black and white, ADU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level {
    /// Shown black.
    pub low: u16,
    /// Shown white; above `low`.
    pub high: u16,
}

/// The middle 98 % of an image's values, by a histogram of one pixel in 16, with a margin of 2 ADU.
///
/// Where the ends cross, the full scale. (Paper, § Statistics; margins and fallback of the program that flew.)
pub fn auto_level(frame: &Frame) -> Level {
    let highest = frame.pixels.iter().copied().max().unwrap_or(0);
    LevelMeter::default().level(frame, highest)
}

/// Pixels that are counted side by side, each in a count of its own: neighbours often have the same value, and one count would have to
/// wait for the other.
const ABREAST: usize = 4;

/// Measures levels, in the memory of the last frame.
#[derive(Debug, Clone, Default)]
pub struct LevelMeter {
    counts: Vec<[u32; ABREAST]>,
}

impl LevelMeter {
    /// As [`auto_level`]. `highest`: the highest value of the image, or one that counts for all above it, ADU.
    pub fn level(&mut self, frame: &Frame, highest: u16) -> Level {
        let counts = &mut self.counts;
        counts.clear();
        counts.resize(usize::from(highest) + 1, [0; ABREAST]);
        let mut counted = 0;
        for row in frame.pixels.chunks(frame.width.max(1)).step_by(STEP) {
            let (several, rest) = row.as_chunks::<{ STEP * ABREAST }>();
            let mut count = |lane: usize, adu: u16| {
                if let Some(count) = counts.get_mut(usize::from(adu.min(highest))).and_then(|counts| counts.get_mut(lane)) {
                    *count += 1;
                }
            };
            for several in several {
                for (lane, &adu) in several.iter().step_by(STEP).enumerate() {
                    count(lane, adu);
                }
            }
            rest.iter().step_by(STEP).for_each(|&adu| count(0, adu));
            counted += row.len().div_ceil(STEP);
        }
        let low = end_of(counts.iter().enumerate(), counted).map(|adu| adu.saturating_sub(MARGIN_ADU));
        let high = end_of(counts.iter().enumerate().rev(), counted).map(|adu| adu.saturating_add(MARGIN_ADU));
        match (low, high) {
            (Some(low), Some(high)) if low < high => Level { low, high },
            _ => Level { low: 0, high: frame.full_scale.unwrap_or(u16::MAX).max(1) },
        }
    }

    /// Typical distance from each other of the values of the last frame within a level, ADU; nought where there are not two.
    pub fn step_adu(&self, level: (u16, u16)) -> f64 {
        let from_low = self.counts.iter().skip(level.0.into()).take(usize::from(level.1.saturating_sub(level.0)) + 1);
        let mut there = from_low.enumerate().filter(|(_, counts)| counts.iter().any(|&count| count > 0)).map(|(value, _)| value);
        let Some(first) = there.next() else { return 0.0 };
        let (steps, last) = there.fold((0, first), |(steps, _), value| (steps + 1, value));
        if steps > 0 { (last - first) as f64 / f64::from(steps) } else { 0.0 }
    }
}

/// The value at which the values passed, from one end of the histogram, become more than the tail.
fn end_of<'a>(mut histogram: impl Iterator<Item = (usize, &'a [u32; ABREAST])>, counted: usize) -> Option<u16> {
    let mut passed = 0;
    let (adu, _) = histogram.find(|(_, counts)| {
        passed += counts.iter().map(|&count| count as usize).sum::<usize>();
        passed * TAIL > counted
    })?;
    u16::try_from(adu).ok()
}

/// An image in 8 bits between two levels, its top row first whatever its own row order.
pub fn to_grey8(frame: &Frame, level: Level) -> Vec<u8> {
    let range = u32::from(level.high.saturating_sub(level.low)).max(1);
    let shade_of = |adu: u16| ((u32::from(adu.saturating_sub(level.low)) * 255 + range / 2) / range).min(255) as u8;
    // Looked up, because a division for each pixel takes ten times as long.
    let shades: Vec<u8> = (0..=u16::MAX).map(shade_of).collect();
    let shade = |&adu: &u16| shades.get(usize::from(adu)).copied().unwrap_or(u8::MAX);
    let mut grey = Vec::with_capacity(frame.pixels.len());
    let show = |row: &[u16]| grey.extend(row.iter().map(shade));
    let rows = frame.pixels.chunks(frame.width.max(1));
    match frame.rows {
        RowOrder::TopFirst => rows.for_each(show),
        RowOrder::BottomFirst => rows.rev().for_each(show),
    }
    grey
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_step_of_values_is_that_of_the_sensor_whatever_lies_beyond_the_level() {
        // Values in steps of 16 from 800 on, and one far above.
        let pixels = (0..200 * 200).map(|n| 800 + 16 * (n % 37)).collect();
        let mut frame = Frame::new(200, 200, pixels, RowOrder::TopFirst).unwrap();
        frame.pixels[0] = 9000;
        let mut meter = LevelMeter::default();
        let level = meter.level(&frame, 9000);
        assert_eq!(meter.step_adu((level.low, level.high)), 16.0, "{level:?}");
        let flat = Frame::new(200, 200, vec![800; 200 * 200], RowOrder::TopFirst).unwrap();
        meter.level(&flat, 800);
        assert_eq!(meter.step_adu((700, 900)), 0.0);
    }

    #[test]
    fn the_outer_hundredths_are_left_out() {
        // 200 × 200 px give 2500 counted ones: 30 dark and 30 bright, the rest from 1000 to 1099.
        let mut frame = Frame::new(200, 200, vec![0; 40_000], RowOrder::TopFirst).unwrap();
        let mut n = 0;
        for y in (0..200).step_by(4) {
            for x in (0..200).step_by(4) {
                frame.pixels[y * 200 + x] = if n < 20 {
                    5
                } else if n < 40 {
                    60_000
                } else {
                    1000 + (n % 100) as u16
                };
                n += 1;
            }
        }
        let level = auto_level(&frame);
        // 1 % are 25: 20 extremes and 5 more, 24 or 25 values being at each ADU.
        assert_eq!(level, Level { low: 998, high: 1101 });
        let grey = to_grey8(&frame, level);
        assert!(grey.contains(&0) && grey.contains(&255));
    }

    #[test]
    fn a_flat_image_has_levels_around_its_value() {
        let frame = Frame::new(8, 8, vec![700; 64], RowOrder::TopFirst).unwrap();
        assert_eq!(auto_level(&frame), Level { low: 698, high: 702 });
        let full = Frame::new(1, 1, vec![65_535], RowOrder::TopFirst).unwrap();
        assert_eq!(auto_level(&full), Level { low: 65_533, high: 65_535 });
    }

    #[test]
    fn two_values_of_half_each_keep_both() {
        let pixels = (0..6400).map(|i| if i % 80 < 40 { 100 } else { 4000 }).collect();
        let frame = Frame::new(80, 80, pixels, RowOrder::TopFirst).unwrap();
        assert_eq!(auto_level(&frame), Level { low: 98, high: 4002 });
    }

    #[test]
    fn up_is_shown_on_top() {
        let level = Level { low: 100, high: 200 };
        let mut frame = Frame::new(2, 2, vec![0, 100, 150, 300], RowOrder::TopFirst).unwrap();
        assert_eq!(to_grey8(&frame, level), [0, 0, 128, 255]);
        frame.rows = RowOrder::BottomFirst;
        assert_eq!(to_grey8(&frame, level), [128, 255, 0, 0]);
        assert_eq!(to_grey8(&frame, Level { low: 9, high: 9 }), [255, 255, 0, 255]);
    }
}
