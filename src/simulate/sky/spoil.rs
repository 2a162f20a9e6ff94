//! Frames spoilt by one cause: what makes each of them so that it is mostly not solved, and for that reason alone.

use super::backdrop::{Cloud, Glare, Streak};
use super::random::{Dice, Purpose};
use super::scene::Scene;
use super::sensor::Flaws;
use super::{Kind, RenderSpec};
use crate::solve::Cause;
use std::f64::consts::PI;

/// Discs too large, and trails too long, to be solved in most frames, px.
pub(super) const DISC_PX: (f64, f64) = (34.0, 64.0);
pub(super) const TRAIL_PX: (f64, f64) = (45.0, 90.0);
/// Most discs have a dark sky, and the others one on which some of so large figures are still seen, ADU over bias.
pub(super) const DUSK_SKY_ADU: (f64, f64) = (60.0, 100.0);
/// Most that a long trail turns by: the gondola turns steadily.
pub(super) const BEND_RAD: f64 = 0.5;
/// A plate scale that was set wrong: a lens, or a binning, that is another one, as a part of what it should be.
const PLATESCALE_TOO_SMALL: (f64, f64) = (0.75, 0.93);
const PLATESCALE_TOO_LARGE: (f64, f64) = (1.08, 1.32);
/// Starlight that comes through thick cloud, and that a far too short exposure collects, fractions.
const THROUGH_CLOUD: (f64, f64) = (0.005, 0.05);
const SHORT_EXPOSURE: (f64, f64) = (0.01, 0.05);
/// Of a thick cloud: wavelengths, px, and brightness of a wave, fraction of the sky.
const CLOUD_WAVELENGTH_PX: (f64, f64) = (50.0, 500.0);
const CLOUD_AMPLITUDE: (f64, f64) = (0.03, 0.25);

/// Exposures that a trail is of: mostly one, because rows of points are solved more often than not.
pub(super) fn draw_exposures(dice: &mut Dice) -> usize {
    if dice.chance(0.8) { 1 } else { dice.count(2, 4) }
}

/// What the plate scale of a frame is multiplied with.
pub(super) fn platescale_factor(spec: &RenderSpec) -> f64 {
    if spec.kind != Kind::Spoilt(Cause::WrongPlatescale) {
        return 1.0;
    }
    let mut dice = spec.camera_dice(Purpose::Spoil);
    let (low, high) = if dice.chance(0.5) { PLATESCALE_TOO_SMALL } else { PLATESCALE_TOO_LARGE };
    dice.uniform(low, high)
}

impl Scene {
    /// Spoils a scene of the daytime sky. What the optics and the motion do to it is drawn with them.
    pub(super) fn spoil(&mut self, cause: Cause, spec: &RenderSpec, dice: &mut Dice) {
        let full_adu = self.sensor.full_light_adu();
        match cause {
            Cause::Overexposed => self.backdrop.sky_adu = full_adu * dice.uniform(1.1, 3.0),
            Cause::Saturated => {
                self.backdrop.glare = Some(Glare::covering(dice.uniform(0.6, 0.93), dice.angle(), dice.log_uniform(60.0, 600.0)));
            }
            Cause::NoContrast => self.flatten(spec.index, dice),
            Cause::Clouds => {
                self.starlight = dice.log_uniform(THROUGH_CLOUD.0, THROUGH_CLOUD.1);
                for _ in 0..dice.count(4, 8) {
                    self.backdrop.clouds.push(draw_cloud(self.backdrop.sky_adu, dice));
                }
            }
            Cause::TooFewStars => {
                self.starlight = dice.log_uniform(SHORT_EXPOSURE.0, SHORT_EXPOSURE.1);
                self.backdrop.sky_adu *= dice.log_uniform(0.1, 1.0);
            }
            Cause::TooManyArtefacts => self.clutter(spec, dice),
            Cause::LensCovered => {
                self.backdrop.sky_adu = 0.0;
                self.flaws.hot_pixels = dice.count(40, 1500);
            }
            Cause::OutOfFocus | Cause::Trailed | Cause::WrongPlatescale | Cause::Mirrored | Cause::WrongPrior => (),
        }
    }

    /// A picture without contrast: one value everywhere, or few values far apart, on a bright or a dark sky.
    fn flatten(&mut self, index: u64, dice: &mut Dice) {
        match index % 3 {
            0 => self.blank = Some(dice.uniform(self.sensor.bias_adu, 0.9 * f64::from(self.sensor.full_scale_adu)) as u16),
            1 => self.step_adu = dice.log_uniform(64.0, 512.0) as u16,
            _ => {
                self.backdrop.sky_adu = dice.uniform(15.0, 60.0);
                self.step_adu = dice.log_uniform(16.0, 64.0) as u16;
            }
        }
    }

    /// Hot pixels, tracks of cosmic rays and streaks in such numbers that the few stars left drown in them.
    fn clutter(&mut self, spec: &RenderSpec, dice: &mut Dice) {
        self.starlight = dice.log_uniform(0.01, 0.05);
        let (hot_pixels, tracks) = (dice.count(1500, 5000), dice.count(150, 500));
        self.flaws = Flaws { hot_pixels, tracks, dead_column: None };
        for _ in 0..dice.count(2, 6) {
            self.backdrop.streaks.push(Streak {
                x: dice.uniform(0.1, 0.9) * spec.width as f64,
                y: dice.uniform(0.1, 0.9) * spec.height as f64,
                angle: dice.uniform(0.0, PI),
                sigma_px: dice.uniform(0.9, 2.0),
                level_adu: dice.log_uniform(20.0, 400.0),
            });
        }
    }
}

/// Waves of a thick cloud.
fn draw_cloud(sky_adu: f64, dice: &mut Dice) -> Cloud {
    let wavelength_px = dice.log_uniform(CLOUD_WAVELENGTH_PX.0, CLOUD_WAVELENGTH_PX.1);
    Cloud {
        angle: dice.angle(),
        wavelength_px,
        amplitude_adu: sky_adu * dice.log_uniform(CLOUD_AMPLITUDE.0, CLOUD_AMPLITUDE.1),
        phase: dice.angle(),
        warp: dice.uniform(0.5, 3.0),
        warp_angle: dice.angle(),
        warp_wavelength_px: wavelength_px * dice.uniform(1.5, 4.0),
        patch_phase: dice.angle(),
    }
}
