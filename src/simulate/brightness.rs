//! The brightness simulator: the light of day added to frames of the night.

use crate::image::Frame;
use crate::settings::BrightnessSettings;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Poisson};

/// Electrons of a thousand.
const KILO: f64 = 1000.0;
/// Amplitudes change tenfold in so many decibels.
const DECIBELS: f64 = 20.0;

/// Makes a frame what the camera would have given under a brighter sky and with another exposure, photon noise included: as the program
/// that flew did. `gain_adu_per_e`: the camera's at 0 dB; the same seed adds the same light.
///
/// Each pixel is scaled to the exposure to pretend; what the frame's mean then lacks of the sky to pretend comes in electrons of a Poisson
/// distribution, times the gain; the sum is cut to whole ADU and to the full scale. A frame that is brighter already gets no more. It is
/// marked as simulated.
pub fn brighten(frame: &mut Frame, rules: &BrightnessSettings, gain_adu_per_e: f64, seed: u64) {
    let scale = rules.simulated_exposure_s / rules.actual_exposure_s;
    let gain = gain_adu_per_e * 10f64.powf(rules.gain_db / DECIBELS);
    let mean = frame.pixels.iter().map(|&pixel| f64::from(pixel)).sum::<f64>() / frame.pixels.len().max(1) as f64;
    let missing_e = rules.level_ke_s_px * KILO * rules.simulated_exposure_s - mean * scale / gain;
    let light = Poisson::new(missing_e).ok();
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    let full_scale = f64::from(frame.full_scale.unwrap_or(u16::MAX));
    for pixel in &mut frame.pixels {
        let added_e = light.as_ref().map_or(0.0, |light| light.sample(&mut chance));
        *pixel = (f64::from(*pixel) * scale + added_e * gain).min(full_scale) as u16;
    }
    frame.stamp.simulated = true;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::RowOrder;

    /// The camera that flew.
    const GAIN: f64 = 0.040_96;

    fn rules(level_ke_s_px: f64) -> BrightnessSettings {
        BrightnessSettings {
            allowed: true,
            enabled: true,
            level_ke_s_px,
            gain_db: 0.0,
            actual_exposure_s: 0.12,
            simulated_exposure_s: 0.12,
        }
    }

    /// A frame of 700 × 500 pixels with a mean of 100.5 ADU.
    fn night() -> Frame {
        let pixels = (0..700 * 500).map(|i| 98 + (i % 6) as u16).collect();
        Frame { full_scale: Some(4095), ..Frame::new(700, 500, pixels, RowOrder::BottomFirst).unwrap() }
    }

    fn moments(frame: &Frame) -> (f64, f64) {
        let n = frame.pixels.len() as f64;
        let mean = frame.pixels.iter().map(|&pixel| f64::from(pixel)).sum::<f64>() / n;
        (mean, frame.pixels.iter().map(|&pixel| (f64::from(pixel) - mean).powi(2)).sum::<f64>() / n)
    }

    #[test]
    fn mean_and_variance_are_those_of_photons_at_five_levels() {
        let (night_mean, night_variance) = moments(&night());
        for level in [50.0, 100.0, 200.0, 400.0, 700.0] {
            for (gain_db, simulated_exposure_s) in [(0.0, 0.12), (-3.0, 0.06)] {
                let rules = BrightnessSettings { gain_db, simulated_exposure_s, ..rules(level) };
                let mut frame = night();
                brighten(&mut frame, &rules, GAIN, 7);
                let (scale, gain) = (simulated_exposure_s / 0.12, GAIN * 10f64.powf(gain_db / 20.0));
                let photons = level * 1000.0 * simulated_exposure_s - night_mean * scale / gain;
                // Cutting to whole numbers takes half of one away, and adds a twelfth.
                let wanted = (
                    night_mean * scale + photons * gain - 0.5,
                    night_variance * scale * scale + photons * gain * gain + 1.0 / 12.0,
                );
                let got = moments(&frame);
                println!(
                    "brightness: {level} ke/s/px at {gain_db} dB, {simulated_exposure_s} s: mean {:+.4} %, variance {:+.3} % off",
                    100.0 * (got.0 / wanted.0 - 1.0),
                    100.0 * (got.1 / wanted.1 - 1.0)
                );
                assert!((got.0 / wanted.0 - 1.0).abs() < 0.005, "{level} at {gain_db} dB: {got:?} against {wanted:?}");
                assert!((got.1 / wanted.1 - 1.0).abs() < 0.02, "{level} at {gain_db} dB: {got:?} against {wanted:?}");
                assert!(frame.stamp.simulated);
            }
        }
    }

    #[test]
    fn the_same_seed_adds_the_same_light_and_another_seed_other_light() {
        let brightened = |seed| {
            let mut frame = night();
            brighten(&mut frame, &rules(300.0), GAIN, seed);
            frame
        };
        assert_eq!(brightened(1), brightened(1));
        assert_ne!(brightened(1), brightened(2));
    }

    #[test]
    fn a_sky_that_is_bright_enough_gets_nothing_and_one_beyond_the_full_scale_clips() {
        let mut frame = night();
        brighten(&mut frame, &rules(1.0), GAIN, 1);
        assert_eq!(frame.pixels, night().pixels);
        brighten(&mut frame, &rules(10_000.0), GAIN, 1);
        assert!(frame.pixels.iter().all(|&pixel| pixel == 4095));
    }
}
