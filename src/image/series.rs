//! A series: the exposures of one image, read out one by one.

use super::coadd::{Sum, alike};
use super::{CoaddError, Frame, MAX_PARTS, Stamp};
use std::sync::Arc;

/// The exposures of one image, in the order in which they were read out: one to [`MAX_PARTS`], all laid out alike.
///
/// Each is added to a running sum when it comes, so that when the last has come little is left to be done before it is solved.
/// The sum begins with the second, or with the first where more are [known](Self::expect_more) to come.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    exposures: Vec<Arc<Frame>>,
    /// Of all exposures, where there are several or more are to come.
    sum: Option<Sum>,
}

impl Series {
    /// A series of exposures; where there are several, each is marked with its place among them.
    ///
    /// # Errors
    /// None, too many, or exposures of different layouts.
    pub fn new(exposures: Vec<Frame>) -> Result<Self, CoaddError> {
        let number = exposures.len();
        let mut exposures = exposures.into_iter();
        let mut series = Self::from(exposures.next().filter(|_| number <= MAX_PARTS).ok_or(CoaddError::Number(number))?);
        exposures.try_for_each(|exposure| series.push(exposure))?;
        Ok(series)
    }

    /// Puts the next exposure to it, which others may have already: they see no change of it.
    ///
    /// # Errors
    /// One too many, or one that is laid out differently; the series is as it was.
    pub fn push(&mut self, exposure: impl Into<Arc<Frame>>) -> Result<(), CoaddError> {
        let mut exposure = exposure.into();
        let place = self.exposures.len();
        let first = self.exposures.first_mut().filter(|_| place < MAX_PARTS).ok_or(CoaddError::Number(place + 1))?;
        if !alike(first, &exposure) {
            return Err(CoaddError::Layout { part: place });
        }
        mark(first, 0);
        mark(&mut exposure, place);
        self.sum.get_or_insert_with(|| Sum::of(first)).add(&exposure);
        self.exposures.push(exposure);
        Ok(())
    }

    /// Begins the sum, while there is time.
    pub fn expect_more(&mut self) {
        if let Some(first) = self.exposures.first() {
            self.sum.get_or_insert_with(|| Sum::of(first));
        }
    }

    /// Whether an exposure can be put to it.
    pub fn takes(&self, exposure: &Frame) -> bool {
        self.exposures.len() < MAX_PARTS && self.exposures.first().is_some_and(|first| alike(first, exposure))
    }

    /// Changes the stamp of every exposure.
    pub fn stamp(&mut self, change: impl Fn(&mut Stamp)) {
        self.exposures.iter_mut().for_each(|exposure| change(&mut Arc::make_mut(exposure).stamp));
    }

    /// The exposures.
    pub fn exposures(&self) -> &[Arc<Frame>] {
        &self.exposures
    }

    /// All exposures added up, as [`coadd()`](super::coadd()) does, and one after another; no sum for one that stands alone and is its own.
    pub fn into_sum(self) -> (Option<Frame>, Vec<Arc<Frame>>) {
        let Self { exposures, sum } = self;
        let several = exposures.split_first().filter(|(_, others)| !others.is_empty());
        let frame = several.and_then(|(first, others)| Some(sum?.frame(first, others)));
        (frame, exposures)
    }

    /// The exposures, one after another.
    pub fn into_exposures(self) -> Vec<Arc<Frame>> {
        self.exposures
    }
}

impl From<Frame> for Series {
    fn from(frame: Frame) -> Self {
        Self { exposures: vec![Arc::new(frame)], sum: None }
    }
}

/// Marks an exposure with its place in the series, where it is not yet: one that others have too is copied for that.
fn mark(exposure: &mut Arc<Frame>, place: usize) {
    let part = u8::try_from(place).ok();
    if exposure.stamp.part != part {
        Arc::make_mut(exposure).stamp.part = part;
    }
}

const _: () = assert!(MAX_PARTS <= u8::MAX as usize);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::coadd;
    use crate::sky::RowOrder;

    fn exposure(adu: u16) -> Frame {
        Frame::new(2, 2, vec![adu; 4], RowOrder::BottomFirst).unwrap()
    }

    #[test]
    fn the_exposures_of_a_series_have_their_places_and_their_sum_has_none() {
        let mut series = Series::new((1..=16).map(exposure).collect()).unwrap();
        series.stamp(|stamp| stamp.gain_db = Some(3.0));
        assert!(!series.takes(&exposure(1)), "it is full");
        let parts: Vec<_> = series.exposures().iter().map(|exposure| exposure.stamp.part).collect();
        assert_eq!(parts, (0..16).map(Some).collect::<Vec<_>>());
        assert!(series.exposures().iter().all(|exposure| exposure.stamp.gain_db == Some(3.0)));
        let (sum, exposures) = series.into_sum();
        let sum = sum.unwrap();
        assert_eq!(exposures.len(), 16);
        assert_eq!((sum.pixels[0], sum.stamp.exposures, sum.stamp.part), (136, 16, None));
    }

    #[test]
    fn a_series_that_comes_one_by_one_is_that_which_comes_whole() {
        let mut exposures: Vec<Frame> = [100, 4000, 4095, 7].map(exposure).into();
        exposures.iter_mut().for_each(|exposure| exposure.full_scale = Some(4095));
        let mut series = Series::from(exposures[0].clone());
        series.expect_more();
        assert_eq!(series.clone().into_sum().0, None, "one of several is its own sum, while it is alone");
        for (i, exposure) in exposures.iter().enumerate().skip(1) {
            series.push(exposure.clone()).unwrap();
            assert_eq!(series, Series::new(exposures[..=i].to_vec()).unwrap());
            let (sum, whole) = (series.clone().into_sum().0.unwrap(), coadd(series.exposures()).unwrap());
            assert_eq!(sum, whole);
            assert_eq!(sum.pixels[0], [100, 4100, 8190 + 4095, 4 * 4095][i], "saturated from the third on");
        }
        let wide = Frame::new(4, 1, vec![0; 4], RowOrder::BottomFirst).unwrap();
        let before = series.clone();
        assert!(series.takes(&exposure(1)) && !series.takes(&wide));
        assert_eq!(series.push(wide), Err(CoaddError::Layout { part: 4 }));
        assert_eq!(series, before, "what does not belong to it changes nothing");
    }

    #[test]
    fn one_exposure_is_an_image_that_stands_alone() {
        let series = Series::new(vec![exposure(7)]).unwrap();
        assert_eq!(Series::from(exposure(7)), series);
        assert_eq!(series.exposures()[0].stamp.part, None);
        assert_eq!(series.into_sum().0, None);
        assert_eq!(Series::new(Vec::new()), Err(CoaddError::Number(0)));
        assert_eq!(Series::new(vec![exposure(1); 17]), Err(CoaddError::Number(17)));
    }
}
