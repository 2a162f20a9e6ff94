//! The simulated lens controller where there are no pseudo-terminals: it can't be had, and says so.

use super::port::Ports;
use crate::settings::LensSettings;
use tokio_util::sync::CancellationToken;

/// A lens that can't be made here.
#[derive(Clone)]
pub enum SimulatedLens {}

impl SimulatedLens {
    /// Always the error: there are no pseudo-terminals.
    ///
    /// # Errors
    /// Always.
    pub fn new(_: &LensSettings, _: u64) -> Result<Self, String> {
        Err("a simulated lens needs pseudo-terminals, which only Unix has: set lens.kind to \"none\"".to_owned())
    }

    /// Where the motor truly is now, counts from the near stop.
    pub fn true_motor(&self) -> f64 {
        match *self {}
    }

    /// Its port.
    pub fn ports(&self) -> Ports {
        match *self {}
    }

    /// Is the controller until stopped.
    pub async fn run(self, _: CancellationToken) {
        match self {}
    }
}
