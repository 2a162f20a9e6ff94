//! What the hub is told, and by what handle.

use super::housekeeping::Measurements;
use super::session::Closed;
use super::state::{Actor, CameraState, Disk, Finished, ImageNews, Readiness, Triggers};
use crate::command::{Authenticity, BootId, FlightComputer, OrderNumber};
use crate::image::ImageCounter;
use crate::lens::{LensResult, LensState, RequestCounter};
use crate::wire::{Commands, Gyro, Status, legacy};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// What the hub is told.
#[derive(Debug)]
pub enum ToHub {
    /// The camera gave a frame, or an image that could not be read; the next will have this number.
    Captured {
        /// Number of the next image.
        next: ImageCounter,
    },
    /// What the camera does now.
    Camera(CameraState),
    /// What makes it expose now.
    Triggers(Triggers),
    /// Whether frames can be solved.
    Readiness(Readiness),
    /// The frame that is being solved.
    Solving(Option<ImageCounter>),
    /// A frame ended in its outcome.
    Finished(Box<Finished>),
    /// A flight computer connected.
    Connected {
        /// Who.
        computer: FlightComputer,
        /// The number of the connection.
        connection: u64,
        /// The boot that its hello names.
        boot: BootId,
    },
    /// A flight computer sent its status.
    Status {
        /// Who.
        computer: FlightComputer,
        /// The number of the connection.
        connection: u64,
        /// What it says.
        status: Box<Status>,
        /// When it came.
        at: Instant,
        /// Whether it shows that our updates arrive there.
        hears_us: bool,
    },
    /// A flight computer sent how the gondola turned during an image.
    Gyro {
        /// Who.
        computer: FlightComputer,
        /// The number of the connection.
        connection: u64,
        /// What it says.
        gyro: Box<Gyro>,
    },
    /// A flight computer sent a block of commands.
    Commands {
        /// Who.
        computer: FlightComputer,
        /// The number of the connection.
        connection: u64,
        /// What it says.
        block: Box<Commands>,
        /// How long it can have been on its way.
        delay: Duration,
        /// Whether it shows the key.
        authenticity: Authenticity,
    },
    /// A flight computer that speaks the legacy dialect connected.
    LegacyConnected {
        /// Who.
        computer: FlightComputer,
        /// The number of the connection.
        connection: u64,
    },
    /// It sent a block.
    LegacyBlock {
        /// Who.
        computer: FlightComputer,
        /// The number of the connection.
        connection: u64,
        /// What it says.
        block: Box<legacy::Block>,
        /// When it came.
        at: Instant,
    },
    /// What is kept, the counter of an order in it, is on disk, or could not be brought there.
    Kept {
        /// The order, where one waited for it.
        number: Option<OrderNumber>,
        /// The number of the record.
        record: u64,
        /// The problem, where there was one.
        kept: Result<(), String>,
    },
    /// A program that an order ran has ended.
    Program {
        /// The order.
        number: OrderNumber,
        /// The problem, where there was one.
        result: Result<(), String>,
    },
    /// What came of a request for the camera's gain, dB.
    Gain {
        /// The order.
        number: OrderNumber,
        /// The gain, or why it is not known.
        result: Result<f64, String>,
    },
    /// A connection ended.
    Closed {
        /// The number of the connection.
        connection: u64,
        /// Why.
        why: Closed,
    },
    /// An outcome is on disk.
    Recorded,
    /// An outcome could not be kept.
    RecordLost,
    /// The disk refused.
    DiskError,
    /// What became of an image on a disk.
    Image(Disk, ImageNews),
    /// An update went out late, though its peer was ready for it.
    Late,
    /// What is known of the lens now.
    Lens(Box<LensState>),
    /// How far a request to the lens has come.
    LensResult {
        /// The number of the request.
        counter: RequestCounter,
        /// How far.
        result: LensResult,
    },
    /// What was measured last.
    Measured(Box<Measurements>),
    /// An actor was started again.
    Restarted {
        /// Which.
        actor: Actor,
        /// Why it had ended.
        why: String,
    },
}

/// Tells the hub things.
#[derive(Debug, Clone)]
pub struct Handle(mpsc::Sender<ToHub>);

impl Handle {
    /// A handle on the sending end of the hub's inbox.
    pub fn new(sender: mpsc::Sender<ToHub>) -> Self {
        Self(sender)
    }

    /// Tells the hub, waiting for room. Without a hub, which is only at the very end, nobody is left to be told.
    pub async fn tell(&self, message: ToHub) {
        let _ = self.0.send(message).await;
    }

    /// Tells the hub if there is room.
    pub fn try_tell(&self, message: ToHub) {
        if let Err(error) = self.0.try_send(message) {
            tracing::warn!(%error, "the hub was not told");
        }
    }
}
