//! What a rendered frame shows, for those who judge a solution.

use crate::sky::{ARCSEC, Attitude, DEG};
use crate::solve::Cause;
use serde::Serialize;

use super::{Kind, PhotonBound};

/// The truth of one rendered frame. Serialised with angles in degrees and arcseconds.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Kind of frame.
    pub kind: Kind,
    /// Seed that it was drawn with.
    pub seed: u64,
    /// Number of the frame within its seed and kind.
    pub index: u64,
    /// Epoch of the stars' positions, Julian year.
    pub epoch_yr: f64,
    /// Columns and rows, px.
    pub size: (usize, usize),
    /// Attitude at the picture's centre, mean over the exposure; `None` where there is no star, so that no solution is right.
    pub attitude: Option<Attitude>,
    /// Plate scale at the picture's centre, rad/px.
    pub platescale: f64,
    /// Radial distortion at the half diagonal, about the lens's axis.
    pub k1: f64,
    /// A solver must solve it: six or more stars over SNR 5 and less than 60 % clipped.
    pub must: bool,
    /// Stars of matched-filter SNR over 5 that touch no clipped pixel.
    pub stars_over_snr5: usize,
    /// What the light of its stars lets be known of the attitude at best; `None` where they are too few.
    pub photon_bound: Option<PhotonBound>,
    /// Clipped pixels, fraction of the frame.
    pub clipped_fraction: f64,
    /// What spoils the frame, where one thing does.
    pub cause: Option<Cause>,
    /// Diameter of the discs or length of the trails that stars are, px; nought where they are points.
    pub blur_px: f64,
    /// Width of the point spread function, px.
    pub psf_sigma_px: f64,
    /// Sky at the picture's centre before dimming, ADU over bias.
    pub sky_adu: f64,
    /// Noise of a pixel with that sky, ADU.
    pub noise_adu: f64,
    /// Column and row, in file order, of the hot pixels of a camera that many frames come from; none of one that a single frame has.
    pub hot_pixels: Vec<(usize, usize)>,
    /// Stars of SNR over 3, brightest first.
    pub stars: Vec<TrueStar>,
}

/// A star of a rendered frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TrueStar {
    /// Index in the catalogue.
    pub star: usize,
    /// Flux-weighted mean position in file order, px.
    pub x: f64,
    /// As above.
    pub y: f64,
    /// Catalogue magnitude (RP).
    pub mag: f32,
    /// Flux in the frame, ADU.
    pub flux_adu: f64,
    /// Matched-filter signal to noise: flux · √Σpsf² over the noise of a pixel of the sky there.
    pub snr: f64,
    /// A pixel at its middle is clipped.
    pub clipped: bool,
}

/// Stars needed for a frame that must be solved, at which SNR, and the clipped fraction from which on it need not.
pub(super) const MUST_STARS: usize = 6;
pub(super) const MUST_SNR: f64 = 5.0;
pub(super) const MUST_CLIPPED_BELOW: f64 = 0.6;

impl Serialize for Truth {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        /// The edge's names and units.
        #[derive(Serialize)]
        struct Edge<'a> {
            kind: &'a str,
            seed: u64,
            index: u64,
            must: bool,
            ra_deg: Option<f64>,
            dec_deg: Option<f64>,
            roll_deg: Option<f64>,
            platescale_arcsec_px: f64,
            k1: f64,
            epoch: f64,
            width: usize,
            height: usize,
            stars_over_snr5: usize,
            bound_axis_arcsec: Option<f64>,
            bound_roll_arcsec: Option<f64>,
            clipped_fraction: f64,
            cause: Option<Cause>,
            blur_px: f64,
            psf_sigma_px: f64,
            sky_adu: f64,
            noise_adu: f64,
            #[serde(skip_serializing_if = "<[_]>::is_empty")]
            hot_pixels: &'a [(usize, usize)],
            stars: &'a [TrueStar],
        }
        let angles = self.attitude.map(|attitude| attitude.angles());
        Edge {
            kind: self.kind.name(),
            seed: self.seed,
            index: self.index,
            must: self.must,
            ra_deg: angles.map(|a| a.0 / DEG),
            dec_deg: angles.map(|a| a.1 / DEG),
            roll_deg: angles.map(|a| a.2 / DEG),
            platescale_arcsec_px: self.platescale / ARCSEC,
            k1: self.k1,
            epoch: self.epoch_yr,
            width: self.size.0,
            height: self.size.1,
            stars_over_snr5: self.stars_over_snr5,
            bound_axis_arcsec: self.photon_bound.map(|bound| bound.axis / ARCSEC),
            bound_roll_arcsec: self.photon_bound.map(|bound| bound.roll / ARCSEC),
            clipped_fraction: self.clipped_fraction,
            cause: self.cause,
            blur_px: self.blur_px,
            psf_sigma_px: self.psf_sigma_px,
            sky_adu: self.sky_adu,
            noise_adu: self.noise_adu,
            hot_pixels: &self.hot_pixels,
            stars: &self.stars,
        }
        .serialize(serializer)
    }
}
