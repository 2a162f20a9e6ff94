//! What an update says of the series of exposures that an image is made of. From version 3 on.

use super::element::body;
use super::{Maybe, U32Le};
use crate::solve::{Report, SeriesStartReport};

body! {
    /// The series of exposures that the last image is made of.
    pub struct Series {
        /// Packets of the image that never came from the camera: where they belong its pixels are 0.
        missing_packets: U32Le => "";
        /// Images that the camera took before this one and that never came.
        missed_images: U32Le => "";
        /// The pointing at the start of the series, where the motion during it is known; that of the image is of the middle of its light.
        start: Maybe<SeriesStart> => "";
    }
}

body! {
    /// The pointing at the start of a series: the first exposure begins.
    pub struct SeriesStart {
        /// Right ascension of the boresight, ICRS.
        start_ra_deg: f64 => "deg" [0.0, 360.0];
        /// Declination of the boresight, ICRS.
        start_dec_deg: f64 => "deg" [-90.0, 90.0];
        /// Position angle of the image's up direction, from North through East.
        start_roll_deg: f64 => "deg" [-180.0, 180.0];
        /// One standard deviation towards East, on the sky.
        start_sigma_east_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// One standard deviation towards North.
        start_sigma_north_arcsec: f64 => "arcsec" [0.0, 1e7];
        /// From the start to the middle of the light.
        start_before_middle_s: f64 => "s" [0.0, 1e6];
    }
}

impl Series {
    /// What the report of an outcome says of its series.
    pub fn new(report: &Report) -> Self {
        let start = report.pointing.series_start.as_ref().and_then(SeriesStart::new);
        Self { missing_packets: report.missing_packets.into(), missed_images: report.missed_frames.into(), start: start.into() }
    }
}

impl SeriesStart {
    /// `None` where a number of it is none.
    fn new(start: &SeriesStartReport) -> Option<Self> {
        Some(Self {
            start_ra_deg: start.ra_deg?,
            start_dec_deg: start.dec_deg?,
            start_roll_deg: start.roll_deg?,
            start_sigma_east_arcsec: start.sigma_east_arcsec?,
            start_sigma_north_arcsec: start.sigma_north_arcsec?,
            start_before_middle_s: start.before_middle_s?,
        })
    }
}
