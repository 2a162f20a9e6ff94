//! The camera room: where frames come from, behind one trait, [`Source`].
//!
//! A directory of image files ([`Directory`]), a simulated sky ([`SimulatedSky`]), and real cameras through Aravis where the program
//! is built with them (`AravisCamera`). A real camera has a line for others' triggers; [`SimulatedLine`] is its twin for the others, and
//! [`TriggerWatch`] says what is done when no trigger comes. A source is blocking and knows no schedule: the camera's actor asks it for each frame. Uses the rooms before it and the disk; no clock, no runtime: the
//! time comes in with each [`Moment`].

#[cfg(feature = "aravis")]
mod aravis;
mod auto_exposure;
mod directory;
mod gondola;
mod line;
mod sky;
mod triggers;

#[cfg(feature = "aravis")]
pub use aravis::AravisCamera;
pub use auto_exposure::{Light, Look, next_light};
pub use directory::Directory;
pub use gondola::Gondola;
pub use line::{LinePulses, SimulatedLine, TellPulses};
pub use sky::SimulatedSky;
pub use triggers::{TriggerDecision, TriggerEvent, TriggerWatch};

use crate::image::{ImageCounter, Series, Stamp};
use crate::sky::{ClockQuality, Utc};
use std::time::Duration;

/// How a source is asked for a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ask {
    /// To expose now, or to give the next frame where it exposes at a rate of its own. A camera that others trigger exposes by itself,
    /// unless what a trigger made waits already.
    Expose,
    /// To give what a trigger of others' makes, and to wait for it for so long at most; it is nothing new where none came.
    Triggered(Duration),
}

/// The moment at which a source is asked for a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    /// The number that the frame will have.
    pub image: ImageCounter,
    /// Time since the service's start, from a clock that never jumps.
    pub uptime: Duration,
    /// UTC, where there is a believable clock.
    pub utc: Option<Utc>,
    /// How far that clock can be believed.
    pub quality: ClockQuality,
    /// One σ of it, s, where it is known.
    pub sigma_s: Option<f64>,
    /// How it is asked.
    pub ask: Ask,
}

impl Moment {
    /// Stamps a frame with the middle of its exposure, so long after this moment, s.
    pub fn date(&self, since_s: f64, stamp: &mut Stamp) {
        let known = self.utc.filter(|_| self.quality != ClockQuality::Unset);
        stamp.captured = known.and_then(|utc| Some((Utc::from_unix(utc.unix_s() + since_s)?, self.quality)));
        stamp.captured_sigma_s = self.sigma_s.filter(|_| stamp.captured.is_some());
        stamp.uptime_s = Some(self.uptime.as_secs_f64() + since_s);
    }
}

/// Something that gives images, each a series of one or more exposures. May block for as long as one takes.
pub trait Source: Send {
    /// The exposures of the next image.
    ///
    /// # Errors
    ///
    /// See [`CameraError`]; after any of them the source may be asked again.
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError>;

    /// The gain that the camera has, dB.
    ///
    /// # Errors
    ///
    /// Where it has none that can be read.
    fn gain(&mut self) -> Result<f64, CameraError> {
        Err(CameraError::NoGain)
    }

    /// Sets the gain, dB; [`Self::gain`] tells what came of it.
    ///
    /// # Errors
    ///
    /// Where it has none that can be set, or refuses this one.
    fn set_gain(&mut self, gain_db: f64) -> Result<(), CameraError> {
        let _ = gain_db;
        Err(CameraError::NoGain)
    }

    /// The time of one exposure that the camera has, s.
    ///
    /// # Errors
    ///
    /// Where it has none that can be read.
    fn exposure(&mut self) -> Result<f64, CameraError> {
        Err(CameraError::NoExposure)
    }

    /// Sets the time of one exposure, s; [`Self::exposure`] tells what came of it.
    ///
    /// # Errors
    ///
    /// Where it has none that can be set, or refuses this one.
    fn set_exposure(&mut self, exposure_s: f64) -> Result<(), CameraError> {
        let _ = exposure_s;
        Err(CameraError::NoExposure)
    }

    /// The camera's own temperature, °C, where it is open and offers one.
    fn temperature(&mut self) -> Option<f64> {
        None
    }
}

/// Why there is no frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// There is nothing to show at the moment: all images were shown, and no new one came.
    #[error("no new image")]
    NothingNew,
    /// An image was there and could not be read; the next may be better.
    #[error("{origin}: {problem}")]
    Unreadable {
        /// The file or files.
        origin: String,
        /// What is wrong.
        problem: String,
    },
    /// The camera has no gain that can be read or set.
    #[error("this camera has no gain")]
    NoGain,
    /// The camera has no exposure that can be read or set.
    #[error("this camera has no exposure that can be set")]
    NoExposure,
    /// No image can be had for now.
    #[error("{0}")]
    Unavailable(String),
}
