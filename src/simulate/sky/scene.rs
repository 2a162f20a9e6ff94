//! What is drawn for a frame: every number that chance decides, before any pixel is made.

use super::backdrop::{Backdrop, Cloud, Glare, Glow, Slab, Spot, Streak};
use super::optics::Optics;
use super::psf::Psf;
use super::random::{Dice, Purpose};
use super::sensor::{Flaws, Sensor};
use super::{Kind, RenderSpec, spoil};
use crate::catalog::Catalogue;
use crate::sky::{Attitude, CameraModel, DEG, Mat3, Vec3, ra_dec};
use crate::solve::Cause;
use std::f64::consts::{PI, TAU};

/// A frame as it is to be rendered.
#[derive(Debug, Clone)]
pub(super) struct Scene {
    pub optics: Optics,
    /// Attitude of the picture's centre, mean over the exposure.
    pub attitude: Attitude,
    /// The camera's turns about (left, up, boresight) during the exposure, rad, with weights that sum to one.
    pub path: Vec<(Vec3, f64)>,
    pub psf: Psf,
    /// Width of the Gaussian of the point spread function, px.
    pub psf_sigma_px: f64,
    /// Whether stars are drawn.
    pub stars: bool,
    /// Stars that are left over the SNR that counts, the others dimmed below it with them.
    pub left_over: Option<usize>,
    /// A star (index in the catalogue) that is this many times brighter than it should, so that it overflows.
    pub overflowing: Option<(usize, f64)>,
    pub backdrop: Backdrop,
    pub sensor: Sensor,
    pub flaws: Flaws,
    /// The same value everywhere, ADU, instead of all of the above.
    pub blank: Option<u16>,
    /// Fraction of the stars' light that comes through.
    pub starlight: f64,
    /// Flux that no star exceeds, ADU.
    pub most_flux_adu: f64,
    /// Step to which values are rounded down, ADU.
    pub step_adu: u16,
    /// Diameter of the discs or length of the trails that stars are, px; nought where they are points.
    pub blur_px: f64,
}

/// Sky over bias on a dark sky, at float, and on the bright sky of `defocus30`, ADU.
const DARK_SKY_ADU: (f64, f64) = (15.0, 60.0);
const FLOAT_SKY_ADU: (f64, f64) = (1150.0, 1800.0);
const MEDIUM_SKY_ADU: (f64, f64) = (400.0, 900.0);
/// Width of the point spread function, px.
const PSF_SIGMA_PX: (f64, f64) = (0.85, 1.3);
/// Largest radial distortion at the half diagonal.
const K1_MAX: f64 = 1.2e-3;
/// Furthest that the lens's axis may be from the picture's centre, px.
const AXIS_OFFSET_PX: f64 = 25.0;
/// Time between the exposures of a series and length of one, s (the paper: 190 ms gaps, a series lasts 0.8 to 1.3 s).
const GAP_S: f64 = 0.19;
const EXPOSURE_S: (f64, f64) = (0.06, 0.18);
/// Stars that a thin veil leaves in a faint frame.
const LEFT_OVER: (usize, usize) = (3, 6);
/// Stars that may be made to overflow: the brightest of the catalogue (G < 2.2).
const BRIGHTEST: usize = 60;

impl Scene {
    /// Draws the frame that the specification describes.
    pub fn draw(spec: &RenderSpec, catalogue: &Catalogue) -> Self {
        let mut motion = spec.dice(Purpose::Motion);
        let mut sky = spec.dice(Purpose::Sky);
        let optics = draw_optics(spec);
        let mut camera = spec.camera_dice(Purpose::Optics);
        let psf_sigma_px = camera.uniform(PSF_SIGMA_PX.0, PSF_SIGMA_PX.1);
        let diameter = match (spec.disc_px, spec.kind) {
            (Some(diameter), _) => diameter,
            (None, Kind::Defocus) => motion.uniform(2.0, 12.0),
            (None, Kind::Defocus30) => motion.uniform(26.0, 33.0),
            (None, Kind::Spoilt(Cause::OutOfFocus)) => motion.log_uniform(spoil::DISC_PX.0, spoil::DISC_PX.1),
            _ => 0.0,
        };
        let mut sensor = match (&spec.part, spec.kind) {
            (Some(_), _) => Sensor::single(),
            (None, Kind::MultiExp) => Sensor::sum_of_four(),
            (None, _) => Sensor::mean_of_four(),
        };
        let mut backdrop = draw_backdrop(spec, &mut sky, &sensor);
        let mut pointing = spec.dice(Purpose::Pointing);
        let mut attitude = spec.attitude.unwrap_or_else(|| draw_attitude(spec.kind, &mut pointing));
        let mut overflowing = None;
        if spec.kind == Kind::Saturated {
            if sky.chance(0.4) && !catalogue.stars.is_empty() {
                let bright = sky.count(0, BRIGHTEST.min(catalogue.stars.len()) - 1);
                overflowing = Some((bright, sky.log_uniform(10.0, 100.0)));
                sensor.overflows = true;
                if spec.attitude.is_none() {
                    attitude = attitude_near(catalogue, bright, &optics, &mut pointing).unwrap_or(attitude);
                }
            } else {
                backdrop.glare = Some(Glare::covering(sky.uniform(0.2, 1.0), sky.angle(), sky.log_uniform(60.0, 600.0)));
            }
        }
        let path = match &spec.part {
            Some(part) => part.turns.iter().map(|turn| (*turn, 1.0 / part.turns.len() as f64)).collect(),
            None => draw_path(spec, &mut motion),
        };
        let mut scene = Self {
            blur_px: diameter.max(length_px(&path, &optics)),
            path,
            optics,
            attitude,
            psf: Psf::new(psf_sigma_px, diameter),
            psf_sigma_px,
            stars: spec.kind.has_stars(),
            left_over: (spec.kind == Kind::Faint).then(|| motion.count(LEFT_OVER.0, LEFT_OVER.1)),
            overflowing,
            backdrop,
            flaws: draw_flaws(spec),
            blank: (spec.kind == Kind::Blank).then(|| draw_blank(spec, &mut sky, &sensor)),
            sensor,
            starlight: spec.part.as_ref().map_or(1.0, |part| part.starlight),
            most_flux_adu: spec.part.as_ref().map_or(f64::INFINITY, |part| part.most_flux_adu),
            step_adu: 1,
        };
        if let Kind::Spoilt(cause) = spec.kind {
            scene.spoil(cause, spec, &mut sky);
        }
        scene
    }
}

/// Length of a path on the picture, px.
fn length_px(path: &[(Vec3, f64)], optics: &Optics) -> f64 {
    let turns = path.windows(2).map(|pair| pair.iter().map(|step| step.0).reduce(|a, b| b - a).map_or(0.0, |turn| turn.norm()));
    turns.sum::<f64>() / optics.lens().platescale
}

fn draw_optics(spec: &RenderSpec) -> Optics {
    let mut dice = spec.camera_dice(Purpose::Optics);
    // The width of the point spread function comes first in this stream: see `Scene::draw`.
    dice.uniform(0.0, 1.0);
    let lens = CameraModel {
        width: spec.width,
        height: spec.height,
        platescale: dice.uniform(spec.platescale.0, spec.platescale.1) * spoil::platescale_factor(spec),
        k1: dice.uniform(-K1_MAX, K1_MAX),
        rows: spec.rows,
        mirrored: spec.mirrored != (spec.kind == Kind::Spoilt(Cause::Mirrored)),
    };
    let (distance, angle) = (AXIS_OFFSET_PX * dice.uniform(0.0, 1.0).sqrt(), dice.angle());
    Optics::new(lens, (distance * libm::cos(angle), distance * libm::sin(angle)))
}

/// A boresight uniform over the part of the sky that the kind looks at, and any roll.
pub(super) fn draw_attitude(kind: Kind, dice: &mut Dice) -> Attitude {
    let (low, high) = match kind {
        Kind::Defocus | Kind::Motion => (0.0, 30.0),
        Kind::Defocus30 => (0.0, 20.0),
        Kind::Spoilt(Cause::OutOfFocus) => (0.0, 10.0),
        // Trails are solved where there are many.
        Kind::Spoilt(Cause::Trailed) => (10.0, 30.0),
        Kind::Sparse | Kind::Spoilt(Cause::TooFewStars) => (70.0, 90.0),
        Kind::Dense => (0.0, 4.0),
        _ => (0.0, 90.0),
    };
    let sin_b = dice.uniform(libm::sin(low * DEG), libm::sin(high * DEG)) * if dice.chance(0.5) { 1.0 } else { -1.0 };
    let (l, cos_b) = (dice.angle(), (1.0 - sin_b * sin_b).max(0.0).sqrt());
    let (ra, dec) = ra_dec(&(galactic_to_icrs() * Vec3::new(cos_b * libm::cos(l), cos_b * libm::sin(l), sin_b)));
    Attitude::from_angles(ra, dec, dice.uniform(-PI, PI))
}

/// Rotation from galactic coordinates to ICRS (The Hipparcos and Tycho Catalogues, ESA SP-1200, vol. 1, eq. 1.5.11).
fn galactic_to_icrs() -> Mat3 {
    Mat3::new(
        -0.054_875_560_4,
        0.494_109_427_9,
        -0.867_666_149_0,
        -0.873_437_090_2,
        -0.444_829_630_0,
        -0.198_076_373_4,
        -0.483_835_015_5,
        0.746_982_244_5,
        0.455_983_776_2,
    )
}

/// An attitude that has a star at a random place of the picture's inner part.
fn attitude_near(catalogue: &Catalogue, star: usize, optics: &Optics, dice: &mut Dice) -> Option<Attitude> {
    let star = catalogue.stars.get(star)?;
    let lens = optics.lens();
    let place = optics.to_direction(lens.width as f64 * dice.uniform(0.1, 0.9), lens.height as f64 * dice.uniform(0.1, 0.9));
    // The boresight as seen from a camera that looks at the star: opposite to where the star is to appear.
    let at_star = Attitude::from_angles(star.ra, star.dec, dice.uniform(-PI, PI));
    let boresight = at_star.to_sky(&Vec3::new(-place.x, -place.y, place.z));
    Attitude::from_boresight_up(&boresight, &at_star.up())
}

/// The camera's path during the exposure, its weighted mean at zero.
fn draw_path(spec: &RenderSpec, dice: &mut Dice) -> Vec<(Vec3, f64)> {
    let scale = 0.5 * (spec.platescale.0 + spec.platescale.1);
    if let Some(sweep) = spec.sweep {
        let half_diagonal = 0.5 * (spec.width as f64).hypot(spec.height as f64);
        let length_px = (sweep.x.hypot(sweep.y) + sweep.z.abs() * scale * half_diagonal) / scale;
        return centred((0..steps(length_px)).map(|i| sweep * ((i as f64 + 0.5) / steps(length_px) as f64)).collect());
    }
    let (length_px, exposures) = match spec.kind {
        Kind::Motion if dice.chance(0.5) => (dice.uniform(5.0, 30.0), 1),
        Kind::Motion => (dice.uniform(5.0, 30.0), dice.count(2, 4)),
        Kind::MultiExp => (dice.uniform(0.5, 6.0), 4),
        Kind::Spoilt(Cause::Trailed) => (dice.uniform(spoil::TRAIL_PX.0, spoil::TRAIL_PX.1), spoil::draw_exposures(dice)),
        _ => return vec![(Vec3::zeros(), 1.0)],
    };
    let heading = dice.angle();
    // Half of the paths are straight, the others turn by up to 100° in all; long trails by less.
    let most = if spec.kind == Kind::Spoilt(Cause::Trailed) { spoil::BEND_RAD } else { 1.75 };
    let bend = if dice.chance(0.5) { 0.0 } else { dice.uniform(-most, most) };
    let exposure_s = dice.uniform(EXPOSURE_S.0, EXPOSURE_S.1);
    let whole_s = exposures as f64 * exposure_s + (exposures - 1) as f64 * GAP_S;
    let per_exposure = steps(length_px * exposure_s / whole_s);
    let mut turns = Vec::with_capacity(exposures * per_exposure);
    for exposure in 0..exposures {
        for step in 0..per_exposure {
            let time_s = exposure as f64 * (exposure_s + GAP_S) + (step as f64 + 0.5) / per_exposure as f64 * exposure_s;
            let (left, up) = on_arc(heading, bend, time_s / whole_s);
            // Turning about the up axis moves the boresight to the left, about the left axis downwards.
            turns.push(Vec3::new(-up, left, 0.0) * (length_px * scale));
        }
    }
    centred(turns)
}

/// Place at a fraction of the way along an arc of length one that starts in a direction and turns by `bend` rad in all.
fn on_arc(heading: f64, bend: f64, fraction: f64) -> (f64, f64) {
    const STRAIGHT: f64 = 1e-6;
    let (cos, sin) = (libm::cos(heading), libm::sin(heading));
    if bend.abs() < STRAIGHT {
        return (cos * fraction, sin * fraction);
    }
    let end = heading + bend * fraction;
    ((libm::sin(end) - sin) / bend, (cos - libm::cos(end)) / bend)
}

/// Steps of a path: a third of a pixel is far below the point spread function's width.
fn steps(length_px: f64) -> usize {
    const STEP_PX: f64 = 1.0 / 3.0;
    const MOST: f64 = 3000.0;
    (length_px / STEP_PX).ceil().clamp(1.0, MOST) as usize
}

/// Equal weights, mean zero.
fn centred(turns: Vec<Vec3>) -> Vec<(Vec3, f64)> {
    let weight = 1.0 / turns.len().max(1) as f64;
    let mean = turns.iter().sum::<Vec3>() * weight;
    turns.into_iter().map(|turn| (turn - mean, weight)).collect()
}

/// Range of the sky over bias, in the mean of the exposures, ADU.
fn sky_range_adu(kind: Kind, dice: &mut Dice) -> (f64, f64) {
    let dark = match kind {
        Kind::Night | Kind::Spoilt(Cause::LensCovered | Cause::Trailed) => true,
        Kind::Spoilt(Cause::OutOfFocus) => dice.chance(0.7),
        Kind::Defocus30 => dice.chance(0.5),
        Kind::NoStars => dice.chance(0.3),
        Kind::Saturated => dice.chance(0.1),
        _ => false,
    };
    match kind {
        _ if dark => DARK_SKY_ADU,
        Kind::Defocus30 => MEDIUM_SKY_ADU,
        Kind::Spoilt(Cause::OutOfFocus) => spoil::DUSK_SKY_ADU,
        _ => FLOAT_SKY_ADU,
    }
}

fn draw_backdrop(spec: &RenderSpec, dice: &mut Dice, sensor: &Sensor) -> Backdrop {
    let (low, high) = sky_range_adu(spec.kind, dice);
    let sky_adu = dice.uniform(low, high) * sensor.sum_over_mean;
    let (width, height) = (spec.width as f64, spec.height as f64);
    let wild = matches!(spec.kind, Kind::Gradient | Kind::NoStars | Kind::Spoilt(Cause::TooManyArtefacts));
    let gradient = if wild { dice.uniform(0.25, 0.8) } else { dice.uniform(0.01, 0.08) };
    let mut backdrop = Backdrop { sky_adu, gradient, gradient_angle: dice.angle(), ..Backdrop::default() };
    backdrop.dimming.spots = draw_spots(7, &mut spec.camera_dice(Purpose::Sky), width, height);
    if !wild {
        return backdrop;
    }
    backdrop.dimming.spots.extend(draw_spots(6, dice, width, height));
    backdrop.dimming.vignetting = dice.uniform(0.1, 0.4);
    for _ in 0..dice.count(1, 2) {
        backdrop.glows.push(draw_glow(dice, sky_adu, width, height));
    }
    for _ in 0..dice.count(2, 4) {
        backdrop.clouds.push(Cloud {
            angle: dice.angle(),
            wavelength_px: dice.log_uniform(80.0, 400.0),
            amplitude_adu: sky_adu * dice.uniform(0.01, 0.05),
            phase: dice.angle(),
            warp: dice.uniform(0.5, 3.0),
            warp_angle: dice.angle(),
            warp_wavelength_px: dice.log_uniform(300.0, 1500.0),
            patch_phase: dice.angle(),
        });
    }
    for _ in 0..dice.count(1, 2) {
        backdrop.slabs.push(Slab {
            x: dice.uniform(0.0, width),
            y: dice.uniform(0.0, height),
            angle: dice.angle(),
            half_length_px: width * dice.uniform(0.12, 0.5),
            half_width_px: width * dice.uniform(0.03, 0.16),
            level_adu: sky_adu * dice.uniform(0.02, 0.08),
        });
    }
    let mut events = spec.dice(Purpose::Events);
    let streaks = if spec.kind == Kind::NoStars { events.count(0, 3) } else { events.count(1, 2) };
    for _ in 0..streaks {
        backdrop.streaks.push(Streak {
            x: events.uniform(0.1, 0.9) * width,
            y: events.uniform(0.1, 0.9) * height,
            angle: events.uniform(0.0, PI),
            sigma_px: events.uniform(0.9, 2.0),
            // Of the peak: from hardly seen to blinding.
            level_adu: sensor.sum_over_mean * events.log_uniform(8.0, 200.0),
        });
    }
    backdrop
}

/// A glow that has its middle near the border: stray light, or the amplifier's own.
fn draw_glow(dice: &mut Dice, sky_adu: f64, width: f64, height: f64) -> Glow {
    let along = dice.uniform(0.0, TAU);
    Glow {
        x: width * (0.5 + 0.6 * libm::cos(along)),
        y: height * (0.5 + 0.6 * libm::sin(along)),
        radius_px: width * dice.uniform(0.05, 0.3),
        level_adu: sky_adu * dice.uniform(0.1, 0.5),
    }
}

/// Dust on the sensor's window: discs that are 3 to 4 % darker.
fn draw_spots(count: usize, dice: &mut Dice, width: f64, height: f64) -> Vec<Spot> {
    (0..count)
        .map(|_| Spot {
            x: dice.uniform(0.0, width),
            y: dice.uniform(0.0, height),
            radius_px: dice.uniform(6.0, 22.0),
            depth: dice.uniform(0.03, 0.04),
        })
        .collect()
}

fn draw_flaws(spec: &RenderSpec) -> Flaws {
    let (mut camera, mut events) = (spec.camera_dice(Purpose::Flaws), spec.dice(Purpose::Flaws));
    let harsh = matches!(spec.kind, Kind::HotPix | Kind::NoStars);
    let hot_pixels = if harsh { camera.count(300, 1500) } else { 40 };
    let tracks = if harsh { events.count(20, 80) } else { 0 };
    let dead_column = (harsh && spec.width > 0).then(|| camera.count(0, spec.width - 1));
    Flaws { hot_pixels, tracks, dead_column }
}

/// Flat, zero or full scale, in turn.
fn draw_blank(spec: &RenderSpec, dice: &mut Dice, sensor: &Sensor) -> u16 {
    match spec.index % 3 {
        0 => (sensor.bias_adu + dice.uniform(DARK_SKY_ADU.0, FLOAT_SKY_ADU.1)) as u16,
        1 => 0,
        _ => sensor.full_scale_adu,
    }
}
