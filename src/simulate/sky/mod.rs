//! The sky renderer: frames of a daytime star camera, with their truth.
//!
//! [`render`] draws the stars of the catalogue through a lens with an off-centre axis and radial distortion onto a sensor
//! with photon and read noise, fixed pattern, dust, hot pixels and whatever else its [`Kind`] brings. It is calibrated on
//! real flight frames: 24 e⁻/ADU, 30 e⁻ of read noise, 100 ADU of bias, star flux 10^(0.4 (13.4 − RP)) ADU.
//!
//! The same specification gives the same bytes on any machine: chance comes from ChaCha8, and all that pixels depend on is
//! computed in arithmetic that does not vary (the attitude's sines and cosines are the platform's own; the last bit of
//! theirs moves a star by 10⁻¹² px).

mod backdrop;
mod bound;
mod kind;
mod optics;
mod psf;
mod random;
mod scene;
mod sensor;
mod specks;
mod spoil;
mod stars;
mod truth;

pub use bound::PhotonBound;
pub use kind::{Kind, UnknownKind};
pub use truth::{TrueStar, Truth};

use crate::catalog::Catalogue;
use crate::image::Frame;
use crate::sky::{ARCSEC, Attitude, RowOrder, Vec3};
use backdrop::Dimming;
use random::{Dice, Purpose};
use scene::Scene;
use sensor::FIXED_PATTERN;

/// What to render.
#[derive(Debug, Clone, PartialEq)]
pub struct RenderSpec {
    /// What is in the frame.
    pub kind: Kind,
    /// Seed of everything random.
    pub seed: u64,
    /// Number of the frame: another number is another draw.
    pub index: u64,
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Range that the plate scale is drawn from, rad/px.
    pub platescale: (f64, f64),
    /// Epoch that the stars are moved to, Julian year.
    pub epoch_yr: f64,
    /// Which end of the picture the first row is.
    pub rows: RowOrder,
    /// Optics turn the picture over.
    pub mirrored: bool,
    /// Attitude of the picture's centre in the middle of the exposure; drawn as the kind says where `None`.
    pub attitude: Option<Attitude>,
    /// Turn of the camera during the exposure, rotation vector about (left, up, boresight), rad; as the kind says where `None`.
    pub sweep: Option<Vec3>,
    /// Diameter of the discs that the stars are out of focus, px; as the kind says where `None`.
    pub disc_px: Option<f64>,
    /// Seed of what stays with a camera from frame to frame: optics, dust, hot pixels, fixed pattern. Where `None`, every
    /// frame comes from a camera of its own.
    pub camera: Option<u64>,
    /// Whether the truth tells what the photons allow, which takes as long as a good part of the frame itself.
    pub photon_bound: bool,
    /// One exposure of a series whose motion is given.
    pub part: Option<Part>,
    /// By what all light is multiplied before it is read out, as by another time of exposure.
    pub light: f64,
    /// By what the camera multiplies what it reads out.
    pub gain: f64,
}

/// One exposure of a series: instead of the mean of four exposures, and of the motion and the brightness that the kind draws.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Its place in the series, from 0: each has a noise of its own.
    pub place: u8,
    /// The camera's turns about (left, up, boresight) from the attitude, evenly over the exposure, rad; at least one.
    pub turns: Vec<Vec3>,
    /// Fraction of the stars' light that comes through.
    pub starlight: f64,
    /// Flux that no star exceeds, ADU.
    pub most_flux_adu: f64,
}

/// A frame and what it shows.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendered {
    /// The frame, stamped as simulated.
    pub frame: Frame,
    /// What it shows.
    pub truth: Truth,
}

/// Why nothing was rendered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum RenderError {
    /// No such picture.
    #[error("a picture of {width} × {height} px can't be rendered; expected 16 to {MAX_SIDE_PX} px a side")]
    Size {
        /// Columns asked for.
        width: usize,
        /// Rows asked for.
        height: usize,
    },
    /// No such lens.
    #[error(
        "a plate scale of {low_arcsec_px} to {high_arcsec_px} arcsec/px can't be rendered; expected 0 < low ≤ high, a field under 90°"
    )]
    PlateScale {
        /// Lower end, arcsec/px.
        low_arcsec_px: f64,
        /// Upper end, arcsec/px.
        high_arcsec_px: f64,
    },
}

/// Largest side of a rendered picture, px.
const MAX_SIDE_PX: usize = 8192;
/// Smallest side, px.
const MIN_SIDE_PX: usize = 16;

impl RenderSpec {
    /// A frame of the EBEX star camera: 1536×1024 px of 9.25 to 9.60″, rows from the bottom as in FITS, epoch 2013.0.
    pub fn new(kind: Kind, seed: u64, index: u64) -> Self {
        Self {
            kind,
            seed,
            index,
            width: 1536,
            height: 1024,
            platescale: (9.25 * ARCSEC, 9.60 * ARCSEC),
            epoch_yr: 2013.0,
            rows: RowOrder::BottomFirst,
            mirrored: false,
            attitude: None,
            sweep: None,
            disc_px: None,
            camera: None,
            photon_bound: true,
            part: None,
            light: 1.0,
            gain: 1.0,
        }
    }

    /// The attitude that is drawn for this frame where none is given.
    pub fn drawn_attitude(&self) -> Attitude {
        scene::draw_attitude(self.kind, &mut self.dice(Purpose::Pointing))
    }

    /// Chance that is new with every frame.
    fn dice(&self, purpose: Purpose) -> Dice {
        Dice::new(self.seed, self.kind.number(), self.index, purpose)
    }

    /// Chance that is new with every exposure.
    fn exposure_dice(&self, purpose: Purpose) -> Dice {
        // Beyond the index of any frame.
        const PLACE_BITS: u32 = 56;
        let place = self.part.as_ref().map_or(0, |part| 1 + u64::from(part.place));
        Dice::new(self.seed, self.kind.number(), self.index ^ (place << PLACE_BITS), purpose)
    }

    /// Chance that stays with the camera.
    fn camera_dice(&self, purpose: Purpose) -> Dice {
        /// Groups and indices of frames never get this high, so that a camera's stream is none of theirs.
        const CAMERA: u64 = u64::MAX;
        match self.camera {
            Some(seed) => Dice::new(seed, CAMERA, CAMERA, purpose),
            None => Dice::new(self.seed, self.kind.number() + (CAMERA >> 1), self.index, purpose),
        }
    }

    fn check(&self) -> Result<(), RenderError> {
        let sides = MIN_SIDE_PX..=MAX_SIDE_PX;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(RenderError::Size { width: self.width, height: self.height });
        }
        let (low, high) = self.platescale;
        let half_field = 0.5 * (self.width as f64).hypot(self.height as f64) * high;
        if !(low > 0.0 && low <= high && half_field < std::f64::consts::FRAC_PI_4) {
            return Err(RenderError::PlateScale { low_arcsec_px: low / ARCSEC, high_arcsec_px: high / ARCSEC });
        }
        Ok(())
    }
}

/// What a camera holds from frame to frame: the light that falls on each pixel, and what dims it on its way: optics, dust, and the
/// sensitivities of the pixels. Most of that stays, so that whoever keeps this need not have it made for each frame.
#[derive(Debug, Clone, Default)]
pub struct Exposure {
    /// Light on each pixel, ADU over bias: the room for it.
    light: Vec<f32>,

    /// What the sensitivities were drawn for: the camera, columns, rows.
    of: Option<(u64, usize, usize)>,
    /// Sensitivity of each pixel, 1 on average.
    sensitivities: Vec<f32>,
    /// The dimming that the transmission is of, columns and rows.
    by: Option<(Dimming, usize, usize)>,
    /// Fraction of the light that the optics let through to each pixel.
    transmission: Vec<f32>,
}

impl Exposure {
    fn prepare(&mut self, spec: &RenderSpec, dimming: &Dimming) {
        let of = spec.camera.map(|camera| (camera, spec.width, spec.height));
        if of.is_none() || self.of != of {
            let mut dice = spec.camera_dice(Purpose::Pattern);
            self.sensitivities.clear();
            self.sensitivities.extend((0..spec.width * spec.height).map(|_| 1.0 + (FIXED_PATTERN * dice.normal()) as f32));
            self.of = of;
        }
        let by = Some((dimming.clone(), spec.width, spec.height));
        if self.by != by {
            dimming.transmission(&mut self.transmission, spec.width, spec.height);
            self.by = by;
        }
    }

    fn dim(&mut self) {
        for ((pixel, transmission), sensitivity) in self.light.iter_mut().zip(&self.transmission).zip(&self.sensitivities) {
            *pixel *= transmission * sensitivity;
        }
    }
}

/// Renders a frame.
///
/// # Errors
///
/// A size or a plate scale that no picture has.
pub fn render(spec: &RenderSpec, catalogue: &Catalogue) -> Result<Rendered, RenderError> {
    render_with(spec, catalogue, &mut Exposure::default())
}

/// The same, for one frame after the other.
///
/// # Errors
///
/// As [`render`].
pub fn render_with(spec: &RenderSpec, catalogue: &Catalogue, exposure: &mut Exposure) -> Result<Rendered, RenderError> {
    spec.check()?;
    let (width, height) = (spec.width, spec.height);
    let mut scene = Scene::draw(spec, catalogue);
    let mut images = if scene.stars { stars::expose(spec, &mut scene, catalogue) } else { Vec::new() };
    let sensor = &scene.sensor;
    let pixels = match scene.blank {
        Some(value) => vec![value; width * height],
        None => {
            scene.backdrop.shine(&mut exposure.light, width, height, sensor.full_light_adu());
            exposure.prepare(spec, &scene.backdrop.dimming);
            images.iter_mut().for_each(|star| star.measure_sky(&exposure.light, &exposure.transmission, width));
            if let Some(count) = scene.left_over {
                stars::dim_to(count, &mut images, sensor);
            }
            images.iter().for_each(|star| star.paint(&mut exposure.light, width));
            specks::draw(spec, &scene).iter().for_each(|speck| speck.paint(&mut exposure.light, width));
            exposure.dim();
            let light = &mut exposure.light;
            scene.flaws.paint_lasting(light, width, sensor.sum_over_mean, &mut spec.camera_dice(Purpose::HotPixels));
            scene.flaws.paint_tracks(light, width, sensor.sum_over_mean, &mut spec.exposure_dice(Purpose::Events));
            let sensor = sensor.with_gain(spec.gain);
            let adu = (spec.light * spec.gain) as f32;
            light.iter_mut().for_each(|light| *light *= adu);
            if sensor.overflows {
                sensor.overflow(light, width);
            }
            let mut pixels = sensor.read_out(light, &mut spec.exposure_dice(Purpose::Noise));
            if scene.step_adu > 1 {
                pixels.iter_mut().for_each(|pixel| *pixel -= *pixel % scene.step_adu);
            }
            pixels
        }
    };
    let mut truth = stars::judge(spec, &scene, catalogue, &images, &pixels);
    if spec.camera.is_some() && scene.blank.is_none() {
        let hot = scene.flaws.hot_pixels(width * height, &mut spec.camera_dice(Purpose::HotPixels));
        truth.hot_pixels = hot.into_iter().map(|(at, _)| (at % width, at / width)).collect();
    }
    let mut frame = Frame::new(width, height, pixels, spec.rows).ok_or(RenderError::Size { width, height })?;
    frame.full_scale = Some(sensor.full_scale_adu);
    frame.stamp.origin = format!("{}-{}-{}", spec.kind, spec.seed, spec.index);
    frame.stamp.exposures = sensor.exposures();
    frame.stamp.simulated = true;
    Ok(Rendered { frame, truth })
}
