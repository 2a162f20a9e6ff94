//! The rendered camera's sensor: from light to ADU, with its noise and its flaws.
#![allow(clippy::indexing_slicing, reason = "image kernels: every index is cut to the frame just before")]

use super::random::Dice;
use crate::sky::{Kernel, with_vectors};

/// A sensor and its read-out, for the co-added frame as it is written.
#[derive(Debug, Clone)]
pub(super) struct Sensor {
    /// Electrons per ADU of the written frame.
    pub electrons_per_adu: f64,
    /// Read noise of the written frame, e⁻.
    pub read_noise_e: f64,
    /// Bias, ADU.
    pub bias_adu: f64,
    /// Highest value, ADU.
    pub full_scale_adu: u16,
    /// ADU of the written frame for one ADU of the mean of the exposures.
    pub sum_over_mean: f64,
    /// Exposures in the written frame.
    exposures: u8,
    /// Charge beyond the full scale runs along the column instead of being lost.
    pub overflows: bool,
}

/// Standard deviation of the pixels' sensitivities.
pub(super) const FIXED_PATTERN: f64 = 0.002;
/// Variance of rounding to whole ADU.
const ROUNDING_VARIANCE: f64 = 1.0 / 12.0;
/// Electrons per ADU, read noise, bias and full scale of one exposure of four.
const ELECTRONS_PER_ADU: f64 = 6.0;
const READ_NOISE_E: f64 = 15.0;
const BIAS_ADU: f64 = 100.0;
const FULL_SCALE_ADU: u16 = 16_383;
const EXPOSURES: u8 = 4;

/// How many of which flaw.
#[derive(Debug, Clone)]
pub(super) struct Flaws {
    pub hot_pixels: usize,
    /// Tracks of cosmic rays.
    pub tracks: usize,
    pub dead_column: Option<usize>,
}

impl Sensor {
    /// One exposure.
    pub fn single() -> Self {
        Self { electrons_per_adu: ELECTRONS_PER_ADU, read_noise_e: READ_NOISE_E, exposures: 1, ..Self::mean_of_four() }
    }

    /// The mean of four exposures.
    pub fn mean_of_four() -> Self {
        let n = f64::from(EXPOSURES);
        Self {
            electrons_per_adu: ELECTRONS_PER_ADU * n,
            read_noise_e: READ_NOISE_E * n.sqrt(),
            bias_adu: BIAS_ADU,
            full_scale_adu: FULL_SCALE_ADU,
            sum_over_mean: 1.0,
            exposures: EXPOSURES,
            overflows: false,
        }
    }

    /// The sum of four exposures, with clipped pixels at no more than 65532.
    pub fn sum_of_four() -> Self {
        let n = f64::from(EXPOSURES);
        Self {
            electrons_per_adu: ELECTRONS_PER_ADU,
            bias_adu: BIAS_ADU * n,
            full_scale_adu: FULL_SCALE_ADU.saturating_mul(u16::from(EXPOSURES)),
            sum_over_mean: n,
            ..Self::mean_of_four()
        }
    }

    /// The same with a gain on what is read out.
    pub fn with_gain(&self, gain: f64) -> Self {
        Self { electrons_per_adu: self.electrons_per_adu / gain, ..self.clone() }
    }

    /// Exposures in the written frame.
    pub fn exposures(&self) -> u8 {
        self.exposures
    }

    /// Light that just clips, ADU over bias.
    pub fn full_light_adu(&self) -> f64 {
        f64::from(self.full_scale_adu) - self.bias_adu
    }

    /// Noise of a pixel that gets `light_adu` over bias, fixed pattern and rounding included, ADU.
    pub fn noise_adu(&self, light_adu: f64) -> f64 {
        let light = light_adu.max(0.0);
        (self.temporal_variance(light) + (FIXED_PATTERN * light).powi(2) + ROUNDING_VARIANCE).sqrt()
    }

    /// Photon and read noise, ADU².
    fn temporal_variance(&self, light_adu: f64) -> f64 {
        light_adu / self.electrons_per_adu + (self.read_noise_e / self.electrons_per_adu).powi(2)
    }

    /// Lets charge beyond the full scale run up and down its column until the wells have room for it.
    pub fn overflow(&self, light: &mut [f32], width: usize) {
        let well = self.full_light_adu() as f32;
        let height = light.len() / width.max(1);
        let mut brimming: Vec<usize> = (0..light.len()).filter(|&at| light[at] > well).collect();
        for &at in &brimming {
            let (column, row, half) = (at % width, at / width, 0.5 * (light[at] - well));
            light[at] = well;
            // Half runs each way; what reaches the border is lost.
            spill((row + 1..height).map(|y| y * width + column), half, well, light);
            spill((0..row).rev().map(|y| y * width + column), half, well, light);
        }
        brimming.clear();
    }

    /// Reads out: photon and read noise, bias, rounding, clipping. `light` in ADU over bias.
    pub fn read_out(&self, light: &[f32], noise: &mut Dice) -> Vec<u16> {
        let mut pixels = vec![0; light.len()];
        let mut draws = [0.0f32; DRAWS];
        for (light, pixels) in light.chunks(DRAWS).zip(pixels.chunks_mut(DRAWS)) {
            draws.iter_mut().zip(light).for_each(|(draw, _)| *draw = noise.normal() as f32);
            with_vectors(ReadOut { sensor: self, light, draws: &draws, pixels });
        }
        pixels
    }
}

/// Pixels whose noise is drawn at a time.
const DRAWS: usize = 1024;

/// Reads pixels out whose noise is drawn.
struct ReadOut<'a> {
    sensor: &'a Sensor,
    light: &'a [f32],
    draws: &'a [f32; DRAWS],
    pixels: &'a mut [u16],
}

impl Kernel for ReadOut<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { sensor, light, draws, pixels } = self;
        let (bias, full) = (sensor.bias_adu as f32, f32::from(sensor.full_scale_adu));
        let per_adu = (1.0 / sensor.electrons_per_adu) as f32;
        let read = ((sensor.read_noise_e / sensor.electrons_per_adu).powi(2)) as f32;
        for ((pixel, &light), &draw) in pixels.iter_mut().zip(light).zip(draws) {
            let sigma = (light.max(0.0) * per_adu + read).sqrt();
            *pixel = round((light + bias + sigma * draw).clamp(0.0, full));
        }
    }
}

/// A value of 0 to 65535, rounded as [`f32::round`] does it, which is a call for every pixel.
#[inline(always)]
fn round(value: f32) -> u16 {
    /// From here to twice that an `f32` has whole numbers alone: adding it rounds, halves to even, and leaves the number in the low bits.
    const WHOLE: f32 = 8_388_608.0;
    let sum = value + WHOLE;
    // A half that went down to an even number goes up.
    (sum.to_bits() as u16).wrapping_add(u16::from(value - (sum - WHOLE) >= 0.5))
}

/// Fills wells along a way with charge.
fn spill(way: impl Iterator<Item = usize>, mut charge: f32, well: f32, light: &mut [f32]) {
    for at in way {
        if charge <= 0.0 {
            return;
        }
        let taken = (well - light[at]).clamp(0.0, charge);
        light[at] += taken;
        charge -= taken;
    }
}

impl Flaws {
    /// The hot pixels of a sensor of so many pixels: place, and what each has more than the light that falls on it, ADU.
    pub fn hot_pixels(&self, pixels: usize, dice: &mut Dice) -> Vec<(usize, f64)> {
        // From just above the noise at float to well beyond any star.
        let one = |_| (dice.count(0, pixels.saturating_sub(1)), dice.log_uniform(30.0, 4000.0));
        (0..self.hot_pixels).map(one).collect()
    }

    /// Hot pixels and the dead column, which stay with the camera.
    pub fn paint_lasting(&self, light: &mut [f32], width: usize, scale: f64, dice: &mut Dice) {
        for (at, adu) in self.hot_pixels(light.len(), dice) {
            light[at] += (scale * adu) as f32;
        }
        if let Some(column) = self.dead_column {
            light.iter_mut().skip(column).step_by(width.max(1)).for_each(|pixel| *pixel = 0.0);
        }
    }

    /// Tracks of cosmic rays: thin, unblurred, uneven.
    pub fn paint_tracks(&self, light: &mut [f32], width: usize, scale: f64, dice: &mut Dice) {
        const STEP_PX: f64 = 0.5;
        let height = light.len() / width.max(1);
        for _ in 0..self.tracks {
            let (mut x, mut y) = (dice.uniform(0.0, width as f64), dice.uniform(0.0, height as f64));
            let (angle, length) = (dice.angle(), dice.log_uniform(1.0, 30.0));
            let charge_per_px = scale * dice.log_uniform(40.0, 3000.0);
            for _ in 0..(length / STEP_PX).ceil() as usize {
                let uneven = (1.0 + 0.4 * dice.normal()).max(0.1);
                if x >= 0.0 && y >= 0.0 && (x as usize) < width && (y as usize) < height {
                    light[y as usize * width + x as usize] += (charge_per_px * STEP_PX * uneven) as f32;
                }
                x += STEP_PX * libm::cos(angle);
                y += STEP_PX * libm::sin(angle);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::random::Purpose;
    use super::*;

    #[test]
    fn noise_is_that_of_the_camera() {
        let sensor = Sensor::mean_of_four();
        for light in [40.0, 1500.0] {
            let pixels = sensor.read_out(&vec![light as f32; 200_000], &mut Dice::new(1, 2, 3, Purpose::Noise));
            let n = pixels.len() as f64;
            let mean = pixels.iter().map(|&p| f64::from(p)).sum::<f64>() / n;
            let variance = pixels.iter().map(|&p| (f64::from(p) - mean).powi(2)).sum::<f64>() / n;
            // 24 e⁻/ADU, 30 e⁻, and rounding.
            let expected = light / 24.0 + (30.0f64 / 24.0).powi(2) + 1.0 / 12.0;
            assert!((mean - light - 100.0).abs() < 0.1, "{mean}");
            assert!((variance / expected - 1.0).abs() < 0.02, "{variance} against {expected}");
        }
    }

    #[test]
    fn values_are_rounded_as_everywhere() {
        let (near, at_half) = (0.5f32.next_down(), [0.5f32, 1.5, 2.5, 16_382.5, 65_534.5]);
        for value in at_half.into_iter().flat_map(|half| [half.next_down(), half, half.next_up()]).chain([0.0, near, 65_535.0]) {
            assert_eq!(round(value), value.round() as u16, "{value}");
        }
    }

    #[test]
    fn overflowing_charge_is_kept_and_stays_in_its_column() {
        let sensor = Sensor::mean_of_four();
        let (width, well) = (9, sensor.full_light_adu() as f32);
        let mut light = vec![100.0f32; width * 101];
        light[50 * width + 4] = 20.0 * well;
        let before: f64 = light.iter().map(|&l| f64::from(l)).sum();
        sensor.overflow(&mut light, width);
        let after: f64 = light.iter().map(|&l| f64::from(l)).sum();
        assert!((after / before - 1.0).abs() < 1e-5);
        assert!(light.iter().enumerate().all(|(i, &l)| l <= well && (l == 100.0 || i % width == 4)));
    }
}
