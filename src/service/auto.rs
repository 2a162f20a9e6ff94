//! Exposure and gain that follow what frames show: from the newest outcome to what the camera is set to.

use super::camera::ToCamera;
use super::state::State;
use crate::camera::{Light, Look, Source, next_light};
use crate::image::{Frame, ImageCounter};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// What the camera's actor remembers of it.
#[derive(Debug, Default)]
pub struct Auto {
    /// The gain was set by command, and stays.
    gain_is_set: bool,
    /// Full scale of the last frame, ADU.
    full_scale: Option<u16>,
    /// The last image that was judged.
    judged: Option<ImageCounter>,
}

/// What a camera is to be set to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wanted {
    /// One exposure, s.
    pub exposure_s: f64,
    /// Gain, dB; `None` where it stays.
    pub gain_db: Option<f64>,
}

impl Auto {
    /// Notes what the camera is asked for: a gain that is commanded has precedence from now on.
    pub fn note_request(&mut self, request: &ToCamera) {
        self.gain_is_set |= matches!(request, ToCamera::SetGain(..));
    }

    /// Notes a frame on its way to the solver.
    pub fn note(&mut self, frame: &Frame) {
        self.full_scale = frame.full_scale.or(self.full_scale);
    }

    /// What exposure and gain are to be, where the newest outcome says that they are to change.
    pub fn next(&mut self, state: &State) -> Option<Wanted> {
        let rules = &state.settings.auto_exposure;
        let outcome = state.latest.as_ref().filter(|_| rules.enabled).map(|finished| &finished.outcome)?;
        if self.judged.replace(outcome.stamp.image) == Some(outcome.stamp.image) {
            return None;
        }
        let statistics = outcome.statistics.as_ref()?;
        let camera = &state.settings.camera;
        let of_one = if camera.full_scale_adu > 0 { camera.full_scale_adu } else { camera.pixel_format.full_scale_adu().into() };
        let of_all = f64::from(of_one) * f64::from(outcome.stamp.exposures.max(1));
        let full_scale = self.full_scale.map_or(of_all, f64::from);
        let look =
            Look { sky: statistics.mean / full_scale, saturated: statistics.saturated_fraction, sources: outcome.sources.len() };
        // A gain that nobody knows stays what it is, whatever that is.
        let (gain_db, stays) = outcome.stamp.gain_db.map_or((0.0, true), |gain_db| (gain_db, self.gain_is_set));
        let light = Light { exposure_s: outcome.stamp.exposure_s?, gain_db };
        let Light { exposure_s, gain_db } = next_light(rules, look, light, stays)?;
        let wanted = Wanted { exposure_s, gain_db: Some(gain_db).filter(|_| !stays) };
        tracing::info!(sky = look.sky, sources = look.sources, ?wanted, "other light");
        Some(wanted)
    }
}

/// Sets a camera to it, as far as the camera lets it; a driver that panics over it does as it did.
pub fn set(source: &mut dyn Source, wanted: Wanted) {
    let set = catch_unwind(AssertUnwindSafe(|| {
        source.set_exposure(wanted.exposure_s)?;
        wanted.gain_db.map_or(Ok(()), |gain_db| source.set_gain(gain_db))
    }));
    match set {
        Ok(Ok(())) => {}
        Ok(Err(error)) => tracing::warn!(%error, "exposure and gain stay as they are"),
        Err(_) => tracing::warn!("the camera panicked over its exposure"),
    }
}
