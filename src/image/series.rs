//! A series: the exposures of one image, read out one by one.

use super::{CoaddError, Frame, MAX_PARTS, Stamp, coadd};

/// The exposures of one image, in the order in which they were read out: one to [`MAX_PARTS`], all laid out alike.
#[derive(Debug, Clone, PartialEq)]
pub struct Series(Vec<Frame>);

impl Series {
    /// A series of exposures; where there are several, each is marked with its place among them.
    ///
    /// # Errors
    /// None, too many, or exposures of different layouts.
    pub fn new(mut exposures: Vec<Frame>) -> Result<Self, CoaddError> {
        super::coadd::check(&exposures)?;
        if exposures.len() > 1 {
            let places = 0..=u8::MAX;
            exposures.iter_mut().zip(places).for_each(|(exposure, place)| exposure.stamp.part = Some(place));
        }
        Ok(Self(exposures))
    }

    /// Changes the stamp of every exposure.
    pub fn stamp(&mut self, change: impl Fn(&mut Stamp)) {
        self.0.iter_mut().for_each(|exposure| change(&mut exposure.stamp));
    }

    /// All exposures added up, as [`coadd()`] does; `None` for one that stands alone and is its own sum.
    pub fn sum(&self) -> Option<Frame> {
        if self.0.len() < 2 { None } else { coadd(&self.0).ok() }
    }

    /// The exposures.
    pub fn exposures(&self) -> &[Frame] {
        &self.0
    }

    /// The exposures, one after another.
    pub fn into_exposures(self) -> Vec<Frame> {
        self.0
    }
}

impl From<Frame> for Series {
    fn from(frame: Frame) -> Self {
        Self(vec![frame])
    }
}

const _: () = assert!(MAX_PARTS <= u8::MAX as usize);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::RowOrder;

    fn exposure(adu: u16) -> Frame {
        Frame::new(2, 2, vec![adu; 4], RowOrder::BottomFirst).unwrap()
    }

    #[test]
    fn the_exposures_of_a_series_have_their_places_and_their_sum_has_none() {
        let mut series = Series::new((1..=16).map(exposure).collect()).unwrap();
        series.stamp(|stamp| stamp.gain_db = Some(3.0));
        let sum = series.sum().unwrap();
        assert_eq!((sum.pixels[0], sum.stamp.exposures, sum.stamp.part), (136, 16, None));
        let parts: Vec<_> = series.exposures().iter().map(|exposure| exposure.stamp.part).collect();
        assert_eq!(parts, (0..16).map(Some).collect::<Vec<_>>());
        assert!(series.exposures().iter().all(|exposure| exposure.stamp.gain_db == Some(3.0)));
    }

    #[test]
    fn one_exposure_is_an_image_that_stands_alone() {
        let series = Series::new(vec![exposure(7)]).unwrap();
        assert_eq!((series.sum(), series.exposures()[0].stamp.part), (None, None));
        assert_eq!(Series::from(exposure(7)), series);
        assert_eq!(Series::new(Vec::new()), Err(CoaddError::Number(0)));
        assert_eq!(Series::new(vec![exposure(1); 17]), Err(CoaddError::Number(17)));
    }
}
