//! A frame and its stamp.

use crate::sky::{ClockQuality, Observer, RowOrder, Utc};

/// The camera's own running number of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct ImageCounter(pub u32);

/// The flight computer's number of the series of triggers that an image belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct TriggerCounter(pub u32);

/// What made a camera expose.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ExposedBy {
    /// The program asked for it, or the camera has a rate of its own: nobody else triggers it.
    #[default]
    Asked,
    /// A trigger of others'.
    Trigger,
    /// The camera by itself, because no trigger had come for `camera.trigger_timeout_s`.
    Itself,
}

/// What is known of a frame besides its pixels.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Stamp {
    /// The image's number.
    pub image: ImageCounter,
    /// The series of triggers it belongs to, where known.
    pub trigger: Option<TriggerCounter>,
    /// Where it came from: a file's name, or what the camera calls it.
    pub origin: String,
    /// When it was captured (middle of the exposure), and how far that can be believed.
    pub captured: Option<(Utc, ClockQuality)>,
    /// One σ of that time, s, where it is known.
    pub captured_sigma_s: Option<f64>,
    /// The same middle on a clock that never jumps, s since the start of the program that took it.
    pub uptime_s: Option<f64>,
    /// What made the camera expose, where that is known.
    pub exposed_by: Option<ExposedBy>,
    /// Exposure time of one exposure, s.
    pub exposure_s: Option<f64>,
    /// Exposures co-added into it; 0 counts as 1.
    pub exposures: u8,
    /// Its place among the exposures of its series, from 0; `None` for a sum of them, and for an image that stands alone.
    pub part: Option<u8>,
    /// Gain, dB.
    pub gain_db: Option<f64>,
    /// Focus position, encoder counts.
    pub focus_counts: Option<i32>,
    /// Aperture position, 0 is fully open.
    pub aperture_counts: Option<i32>,
    /// Temperature of the camera, as it tells it itself, °C.
    pub temperature_camera_c: Option<f64>,
    /// Temperature of the lens, as the housekeeping has it, °C.
    pub temperature_lens_c: Option<f64>,
    /// The observer at capture, where the file says.
    pub observer: Option<Observer>,
    /// Rendered, or taken by a simulated camera or lens.
    pub simulated: bool,
    /// Packets of it that never came, as the camera's driver counts them: where they belong its pixels are 0. 0: it is whole.
    pub missing_packets: u32,
    /// Frames that the camera took since the last one, and that never came.
    pub missed_frames: u32,
}

/// One image: 16-bit pixels in file order, and its stamp.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// `width × height` values, ADU, row after row in file order.
    pub pixels: Vec<u16>,
    /// Which end of the picture the first row is.
    pub rows: RowOrder,
    /// Highest value that a pixel can have, ADU, where the camera or the file says.
    pub full_scale: Option<u16>,
    /// What else is known of it.
    pub stamp: Stamp,
}

impl Frame {
    /// A frame of the given size; `None` where the number of pixels does not fit.
    pub fn new(width: usize, height: usize, pixels: Vec<u16>, rows: RowOrder) -> Option<Self> {
        (width > 0 && height > 0 && width.checked_mul(height) == Some(pixels.len())).then(|| Self {
            width,
            height,
            pixels,
            rows,
            full_scale: None,
            stamp: Stamp::default(),
        })
    }

    /// A copy whose pixels lie in memory that is there already: to have new memory can take ten times as long as to copy.
    pub fn copy_in(&self, mut memory: Vec<u16>) -> Self {
        memory.clone_from(&self.pixels);
        Self { pixels: memory, stamp: self.stamp.clone(), ..*self }
    }
}
