//! Adding up the exposures of one series.

use super::Frame;
use crate::sky::{ClockQuality, Kernel, Utc, with_vectors};
use std::borrow::Borrow;

/// Most exposures of a series.
pub const MAX_PARTS: usize = 16;

/// Why exposures could not be added.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CoaddError {
    /// None or too many.
    #[error("{0} exposures, expected 1 to {MAX_PARTS}")]
    Number(usize),
    /// A part is not laid out as the first.
    #[error("part {part} differs from the first in width, height or order of rows")]
    Layout {
        /// Its place in the list, from 0.
        part: usize,
    },
}

/// Adds up to [`MAX_PARTS`] exposures of the same field.
///
/// A pixel that is saturated in any exposure is saturated in the sum, at the sum's full scale, because the light that it
/// lost would bend a centroid unseen: so the full scale of the parts should be set beforehand where the camera's is known
/// (where it is not, only the end of 16 bits counts as saturated). The sum's full scale is the sum of the parts'. A sum
/// that 16 bits may not hold (cameras of 15 and 16 bits) is divided by the least whole number that makes it fit.
/// The stamp is that of the first, with the exposures and all that was lost counted, at the middle of all their light.
///
/// # Errors
/// No part, too many, or parts of different layouts.
pub fn coadd<F: Borrow<Frame>>(parts: &[F]) -> Result<Frame, CoaddError> {
    let (first, others) = split(parts)?;
    let mut sum = Sum::of(first);
    others.iter().for_each(|part| sum.add(part.borrow()));
    Ok(sum.frame(first, others))
}

/// A running sum of exposures, so that each is added when it comes.
///
/// The picture is kept beside the sums from the first exposure on: its memory is new, and to have it takes longer than to fill it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Sum {
    /// The sum of each pixel, ADU; with [`SATURATED`] where it was saturated in any.
    totals: Vec<i32>,
    /// The highest of those that were not.
    highest: i32,
    /// The sum of the full scales, where each is known.
    full_scale: Option<u32>,
    /// The sums in 16 bits, as long as these hold them.
    pixels: Vec<u16>,
}

/// Added to the sum of a saturated pixel: so it is below zero, and no other is, for sixteen times 16 bits are 20.
const SATURATED: i32 = i32::MIN;

impl Sum {
    /// Of one exposure.
    pub fn of(first: &Frame) -> Self {
        let number = first.pixels.len();
        let mut sum = Self { totals: vec![0; number], highest: 0, full_scale: Some(0), pixels: vec![0; number] };
        sum.add(first);
        sum
    }

    /// Adds an exposure that is laid out like the first.
    pub fn add(&mut self, part: &Frame) {
        let add = |sum: u32| Some(sum + u32::from(part.full_scale?));
        self.full_scale = self.full_scale.and_then(add);
        let (_, top) = self.divisor_and_top();
        self.highest = with_vectors(Add { totals: &mut self.totals, pixels: &mut self.pixels, part, top });
    }

    /// What the sums have to be divided by to fit in 16 bits, and what a saturated pixel has then.
    fn divisor_and_top(&self) -> (u32, u16) {
        let highest = self.full_scale.unwrap_or_else(|| self.highest.unsigned_abs());
        let divisor = highest.div_ceil(u16::MAX.into()).max(1);
        (divisor, self.full_scale.map_or(u16::MAX, |sum| (sum / divisor) as u16))
    }

    /// The sum, which is that of these exposures.
    pub fn frame<F: Borrow<Frame>>(self, first: &Frame, others: &[F]) -> Frame {
        let parts = || std::iter::once(first).chain(others.iter().map(F::borrow));
        let mut stamp = first.stamp.clone();
        stamp.part = None;
        stamp.captured = middle_utc(parts().map(|part| part.stamp.captured));
        stamp.uptime_s = mean(parts().map(|part| part.stamp.uptime_s));
        let since_first = stamp.uptime_s.zip(first.stamp.uptime_s).map_or(0.0, |(middle, first)| middle - first);
        stamp.observer = stamp.observer.map(|observer| observer.after(since_first));
        stamp.exposures = parts().fold(0, |n: u8, part| n.saturating_add(part.stamp.exposures.max(1)));
        stamp.simulated = parts().any(|part| part.stamp.simulated);
        stamp.missing_packets = parts().fold(0, |n: u32, part| n.saturating_add(part.stamp.missing_packets));
        stamp.missed_frames = parts().fold(0, |n: u32, part| n.saturating_add(part.stamp.missed_frames));
        let (divisor, top) = self.divisor_and_top();
        let Self { totals, full_scale, mut pixels, .. } = self;
        if divisor > 1 {
            with_vectors(Scale { totals: &totals, pixels: &mut pixels, divisor, top });
        }
        Frame { pixels, full_scale: full_scale.map(|_| top), stamp, ..*first }
    }
}

/// The middle of some times, which are believed as far as the least; `None` where one is not known.
fn middle_utc(times: impl Iterator<Item = Option<(Utc, ClockQuality)>> + Clone) -> Option<(Utc, ClockQuality)> {
    let quality = times.clone().flatten().map(|(_, quality)| quality).min()?;
    Some((Utc::from_unix(mean(times.map(|time| Some(time?.0.unix_s())))?)?, quality))
}

/// The mean of some values, where each is known.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values = values.collect::<Option<Vec<f64>>>().filter(|values| !values.is_empty())?;
    Some(values.iter().sum::<f64>() / values.len() as f64)
}

/// Adds an exposure to the sums, and shows them in the picture; gives the highest that is not saturated.
struct Add<'a> {
    totals: &'a mut [i32],
    pixels: &'a mut [u16],
    part: &'a Frame,
    top: u16,
}

impl Kernel for Add<'_> {
    type Output = i32;

    #[inline(always)]
    fn run(self) -> i32 {
        let full_scale = self.part.full_scale.unwrap_or(u16::MAX);
        let mut highest = 0;
        for ((total, pixel), &adu) in self.totals.iter_mut().zip(self.pixels).zip(&self.part.pixels) {
            let saturated = if adu >= full_scale { SATURATED } else { 0 };
            // It has room for all: to look whether it overflows would keep vectors from being used.
            *total = total.wrapping_add(i32::from(adu)) | saturated;
            highest = highest.max(*total);
            *pixel = if *total < 0 { self.top } else { *total as u16 };
        }
        highest
    }
}

/// Brings sums to 16 bits that do not hold them.
struct Scale<'a> {
    totals: &'a [i32],
    pixels: &'a mut [u16],
    divisor: u32,
    top: u16,
}

impl Kernel for Scale<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (pixel, &total) in self.pixels.iter_mut().zip(self.totals) {
            // As whole numbers would be divided, for both are of few bits; but this is done in vectors.
            *pixel = if total < 0 { self.top } else { (total as f32 / self.divisor as f32) as u16 };
        }
    }
}

/// The first exposure and the others, where they can be added.
fn split<F: Borrow<Frame>>(parts: &[F]) -> Result<(&Frame, &[F]), CoaddError> {
    let Some((first, others)) = parts.split_first().filter(|_| parts.len() <= MAX_PARTS) else {
        return Err(CoaddError::Number(parts.len()));
    };
    let first = first.borrow();
    match others.iter().position(|part| !alike(first, part.borrow())) {
        Some(i) => Err(CoaddError::Layout { part: i + 1 }),
        None => Ok((first, others)),
    }
}

/// Whether two exposures are laid out alike.
pub(super) fn alike(a: &Frame, b: &Frame) -> bool {
    let layout = |frame: &Frame| (frame.width, frame.height, frame.rows, frame.pixels.len());
    layout(a) == layout(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::{Observer, RowOrder};

    fn part(pixels: [u16; 4], full_scale: Option<u16>) -> Frame {
        let mut frame = Frame::new(2, 2, pixels.to_vec(), RowOrder::BottomFirst).unwrap();
        frame.full_scale = full_scale;
        frame
    }

    #[test]
    fn a_pixel_saturated_in_one_exposure_is_saturated_in_the_sum() {
        let sum = coadd(&[part([10, 4095, 4095, 4094], Some(4095)), part([20, 4095, 100, 4095], Some(4095))]).unwrap();
        assert_eq!(sum.pixels, [30, 8190, 8190, 8190]);
        assert_eq!(sum.full_scale, Some(8190));
    }

    #[test]
    fn parts_of_an_unknown_full_scale_are_added_as_they_are() {
        let sum = coadd(&[part([10, 4095, 0, 65_535], None), part([20, 4095, 100, 3], None)]).unwrap();
        assert_eq!(sum.pixels, [30, 8190, 100, 65_535]);
        assert_eq!(sum.full_scale, None);
    }

    #[test]
    fn sums_beyond_16_bits_are_divided_and_not_clipped() {
        let sum = coadd(&[part([40_000, 65_535, 65_534, 0], Some(65_535)), part([50_000, 1, 65_534, 3], Some(65_535))]).unwrap();
        assert_eq!((sum.pixels.as_slice(), sum.full_scale), ([45_000, 65_535, 65_534, 1].as_slice(), Some(65_535)));
        let sum = coadd(&[part([40_000, 65_535, 0, 8], None), part([50_000, 1, 0, 2], None)]).unwrap();
        assert_eq!((sum.pixels.as_slice(), sum.full_scale), ([45_000, 65_535, 0, 5].as_slice(), None));
    }

    #[test]
    fn every_sum_is_divided_as_a_whole_number() {
        for divisor in 2..=16_u32 {
            let highest = divisor * u32::from(u16::MAX);
            let totals: Vec<i32> = (0..=highest as i32).collect();
            let mut pixels = vec![0; totals.len()];
            with_vectors(Scale { totals: &totals, pixels: &mut pixels, divisor, top: 1 });
            let whole = |total: i32| (total.unsigned_abs() / divisor) as u16;
            assert!(pixels.iter().zip(totals).all(|(pixel, total)| *pixel == whole(total)), "by {divisor}");
        }
    }

    #[test]
    fn the_stamp_is_the_first_with_the_exposures_counted() {
        let mut parts = vec![part([0; 4], None); 3];
        parts[0].stamp.origin = "first".to_owned();
        parts[1].stamp.exposures = 2;
        parts[2].stamp.simulated = true;
        parts[0].stamp.observer = Some(Observer { latitude: -1.3, sidereal_time: 1.0 });
        let times = [10.0, 10.5, 12.5].map(|unix_s| Utc::from_unix(1e9 + unix_s).unwrap());
        let qualities = [ClockQuality::Chrony, ClockQuality::FreeRunning, ClockQuality::Chrony];
        for ((part, utc), quality) in parts.iter_mut().zip(times).zip(qualities) {
            (part.stamp.captured, part.stamp.uptime_s) = (Some((utc, quality)), Some(utc.unix_s() - 1e9));
        }
        let stamp = coadd(&parts).unwrap().stamp;
        assert_eq!((stamp.origin.as_str(), stamp.exposures, stamp.simulated), ("first", 4, true));
        assert_eq!(stamp.captured, Some((Utc::from_unix(1e9 + 11.0).unwrap(), ClockQuality::FreeRunning)));
        assert_eq!(stamp.uptime_s, Some(11.0));
        assert_eq!(stamp.observer, parts[0].stamp.observer.map(|observer| observer.after(1.0)), "the sky has turned on");
        parts[1].stamp.captured = None;
        assert_eq!(coadd(&parts).unwrap().stamp.captured, None, "half a time is none");
    }

    #[test]
    fn parts_that_do_not_belong_together_are_refused() {
        let first = part([0; 4], None);
        assert_eq!(coadd::<Frame>(&[]), Err(CoaddError::Number(0)));
        assert_eq!(coadd(&vec![first.clone(); 17]), Err(CoaddError::Number(17)));
        let mut turned = first.clone();
        turned.rows = RowOrder::TopFirst;
        assert_eq!(coadd(&[first.clone(), first.clone(), turned]), Err(CoaddError::Layout { part: 2 }));
        let wide = Frame::new(4, 1, vec![0; 4], RowOrder::BottomFirst).unwrap();
        assert_eq!(coadd(&[first, wide]), Err(CoaddError::Layout { part: 1 }));
    }
}
