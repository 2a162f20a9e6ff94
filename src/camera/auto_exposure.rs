//! Exposure and gain by what the last frame shows of the sky and of sources: never by whether it was solved, for a frame that is black
//! and one that is not recognised look alike then.
//!
//! No state: each frame says what light it was taken with, and what light the next should be. Frames that were on their way meanwhile say
//! the same again.

use crate::settings::AutoExposureSettings;

/// The light that is let in: an exposure and the gain on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Light {
    /// One exposure, s.
    pub exposure_s: f64,
    /// Gain, dB.
    pub gain_db: f64,
}

/// What a frame shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Look {
    /// Mean of the frame, of its full scale.
    pub sky: f64,
    /// Saturated pixels, of all.
    pub saturated: f64,
    /// Sources found.
    pub sources: usize,
}

/// No step changes the light by more than this factor: a cap on the lens or a flash of light is soon over.
const LARGEST_STEP: f64 = 8.0;
/// What a step down is where the frame is full, and nobody knows by how much.
const FULL_STEP: f64 = 0.125;
/// Of its full scale, a frame whose mean is above this says nothing more of how bright the sky is.
const FULL: f64 = 0.9;
/// The step up where there are too few sources; the sky stays below its upper level.
const SOURCES_STEP: f64 = 1.5;
/// A change of the light by less than this factor is not worth making.
const LEAST_STEP: f64 = 1.02;
/// Decibels for a factor of e: 20 / ln 10.
const DB_PER_E: f64 = 20.0 / std::f64::consts::LN_10;

/// The light for the next frames, by a frame and the light that it was taken with; `None` where that is right, or as near as the bounds
/// allow. `gain_is_set`: the gain is by command, and stays.
pub fn next_light(rules: &AutoExposureSettings, look: Look, light: Light, gain_is_set: bool) -> Option<Light> {
    let factor = factor(rules, look)?;
    let gain = |gain_db: f64| (gain_db / DB_PER_E).exp();
    let (least_db, most_db) = if gain_is_set { (light.gain_db, light.gain_db) } else { (rules.gain_min_db, rules.gain_max_db) };
    let wanted = light.exposure_s * gain(light.gain_db) * factor;
    // As much by exposure as may be: gain adds no light, and takes from the range.
    let exposure_s = (wanted / gain(least_db)).clamp(rules.exposure_min_s, rules.exposure_max_s);
    let gain_db = (DB_PER_E * (wanted / exposure_s).ln()).clamp(least_db, most_db);
    let next = Light { exposure_s, gain_db };
    let change = next.exposure_s * gain(next.gain_db) / (light.exposure_s * gain(light.gain_db));
    (change.is_finite() && change.max(1.0 / change) >= LEAST_STEP).then_some(next)
}

/// By what the light is to be multiplied; `None` where it is right.
fn factor(rules: &AutoExposureSettings, look: Look) -> Option<f64> {
    let Look { sky, saturated, sources } = look;
    // In the middle between both levels, as factors go.
    let middle = (rules.sky_low * rules.sky_high).sqrt();
    let few = sources < rules.enough_sources as usize;
    if !sky.is_finite() {
        None
    } else if sky > FULL {
        Some(FULL_STEP)
    } else if sky > rules.sky_high || saturated > rules.saturated_max {
        Some((middle / sky).clamp(1.0 / LARGEST_STEP, 1.0 / SOURCES_STEP))
    } else if sky < rules.sky_low && few {
        Some((middle / sky.max(f64::MIN_POSITIVE)).min(LARGEST_STEP))
    } else if few {
        let room = rules.sky_high / sky;
        (room > SOURCES_STEP).then_some(SOURCES_STEP)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;

    fn rules() -> AutoExposureSettings {
        AutoExposureSettings { enabled: true, ..Settings::flight().unwrap().auto_exposure }
    }

    /// The frame that a sky of so many full scales a second gives.
    fn look(sky_s: f64, light: Light, sources: usize) -> Look {
        let sky = (sky_s * light.exposure_s * 10_f64.powf(light.gain_db / 20.0)).min(1.0);
        Look { sky, saturated: if sky >= 1.0 { 1.0 } else { 0.0 }, sources }
    }

    /// The light after some frames of such a sky, and what the last shows.
    fn settled(rules: &AutoExposureSettings, sky_s: f64, mut light: Light, sources: usize, gain_is_set: bool) -> (Light, f64) {
        for _ in 0..12 {
            let next = next_light(rules, look(sky_s, light, sources), light, gain_is_set);
            assert!(next.is_none_or(|next| (rules.exposure_min_s..=rules.exposure_max_s).contains(&next.exposure_s)));
            assert!(next.is_none_or(|next| gain_is_set || (rules.gain_min_db..=rules.gain_max_db).contains(&next.gain_db)));
            light = next.unwrap_or(light);
        }
        assert_eq!(next_light(rules, look(sky_s, light, sources), light, gain_is_set), None, "it comes to rest: {light:?}");
        (light, look(sky_s, light, sources).sky)
    }

    #[test]
    fn the_sky_is_brought_between_its_levels_wherever_it_begins() {
        let rules = rules();
        for sky_s in [0.3, 1.0, 3.0, 10.0, 30.0] {
            for begin in [Light { exposure_s: 0.12, gain_db: 0.0 }, Light { exposure_s: 0.4, gain_db: 20.0 }] {
                let (light, sky) = settled(&rules, sky_s, begin, 5, false);
                assert!((rules.sky_low..=rules.sky_high).contains(&sky), "{sky} of full scale with {light:?} under {sky_s}/s");
            }
        }
    }

    #[test]
    fn a_dark_sky_with_enough_sources_is_let_alone_and_with_few_gets_all_that_is_allowed() {
        let rules = rules();
        let light = Light { exposure_s: 0.12, gain_db: 0.0 };
        assert_eq!(next_light(&rules, look(1e-3, light, rules.enough_sources as usize), light, false), None);
        let (most, _) = settled(&rules, 1e-4, light, 0, false);
        assert!(
            (most.exposure_s - rules.exposure_max_s).abs() < 1e-9 && (most.gain_db - rules.gain_max_db).abs() < 1e-9,
            "{most:?}"
        );
        let Light { exposure_s, gain_db } = settled(&rules, 1e6, light, 0, false).0;
        assert!(
            (exposure_s - rules.exposure_min_s).abs() < 1e-9 && (gain_db - rules.gain_min_db).abs() < 1e-9,
            "as little as is allowed"
        );
    }

    #[test]
    fn few_sources_under_a_sky_that_is_right_get_more_light_while_there_is_room() {
        let rules = rules();
        let light = Light { exposure_s: 0.05, gain_db: 0.0 };
        let low = rules.sky_low * 1.1 / light.exposure_s;
        let (more, sky) = settled(&rules, low, light, 3, false);
        assert!(more.exposure_s > 1.4 * light.exposure_s && sky <= rules.sky_high, "{more:?}, {sky}");
        assert_eq!(next_light(&rules, look(low, light, rules.enough_sources as usize), light, false), None);
    }

    #[test]
    fn exposure_goes_before_gain_and_a_gain_that_was_commanded_stays() {
        let rules = rules();
        let light = Light { exposure_s: 0.1, gain_db: 12.0 };
        let (free, _) = settled(&rules, 3.0, light, 5, false);
        assert!(free.exposure_s >= rules.exposure_max_s || free.gain_db <= rules.gain_min_db + 1e-9, "{free:?}");
        let (set, sky) = settled(&rules, 3.0, light, 5, true);
        assert!((set.gain_db - 12.0).abs() < 1e-9 && (rules.sky_low..=rules.sky_high).contains(&sky), "{set:?}: {sky}");
    }

    #[test]
    fn frames_that_were_on_their_way_say_the_same_and_nonsense_says_nothing() {
        let rules = rules();
        let light = Light { exposure_s: 0.12, gain_db: 6.0 };
        let next = next_light(&rules, look(20.0, light, 5), light, false);
        assert_eq!(next, next_light(&rules, look(20.0, light, 5), light, false));
        for sky in [f64::NAN, f64::INFINITY] {
            assert_eq!(next_light(&rules, Look { sky, saturated: 0.0, sources: 0 }, light, false), None);
        }
        let dead = Light { exposure_s: 0.0, gain_db: 0.0 };
        assert_eq!(next_light(&rules, Look { sky: 0.5, saturated: 0.0, sources: 500 }, dead, false), None);
    }
}
