//! A real camera, GigE Vision or USB3 Vision, through Aravis.
//!
//! The camera is opened when it is first asked for something, and again after it was lost. Each frame is received into memory of its
//! own, which for 10 to 16 bits becomes the frame's pixels as it is. That memory begins as zeros: what a lost packet held is 0, never
//! a part of an older image.

use super::{Ask, CameraError, Moment, Source};
use crate::image::{ExposedBy, Frame, Series, Stamp};
use crate::settings::{CameraSettings, PixelFormat, Trigger};
use crate::sky::RowOrder;
use aravis::glib::object::Cast;
use aravis::prelude::*;
use aravis::{
    AcquisitionMode, Auto, Buffer, BufferStatus, Camera, GvStream, GvStreamSocketBuffer, RangeCheckPolicy, Stream, glib,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;

/// A frame that has not come this long after its exposure does not come any more, s. More than the largest takes on a slow link.
const PATIENCE_S: f64 = 2.0;
/// Frames that may wait until they are asked for, where memory allows; beyond them the camera's next ones are missed, and counted.
const BUFFERS: usize = 16;
/// What all of them may take, bytes. At least three are there, or none could be received while one is looked at.
const BUFFERS_BYTES: usize = 256 << 20;
/// What is said of a camera that is away.
const LOST: &str = "was lost: it does not answer any more";
/// The highest number of a frame where a camera numbers with 16 bits, as GigE Vision did at first; after it comes 1.
const LAST_SHORT_ID: u64 = 0xffff;

/// The camera, open or not.
pub struct AravisCamera {
    settings: CameraSettings,
    /// The gain that it is to have, dB: also after it was away.
    gain_db: f64,
    open: Option<Connection>,
}

impl AravisCamera {
    /// The camera that the settings name. It need not be there yet.
    pub fn new(settings: &CameraSettings) -> Self {
        Self { settings: settings.clone(), gain_db: settings.gain_db, open: None }
    }

    /// The connection, made where there is none.
    fn opened(&mut self) -> Result<&mut Connection, CameraError> {
        if let Some(lost) = self.open.take_if(|connection| connection.is_lost()) {
            // Told once; the next call tries to open it.
            let why = lost.told(LOST);
            lost.close();
            return Err(CameraError::Unavailable(why));
        }
        match &mut self.open {
            Some(connection) => Ok(connection),
            none => {
                let connection = Connection::open(&self.settings, self.gain_db).map_err(|why| {
                    let device = &self.settings.device;
                    let name = if device.is_empty() { "the first camera" } else { device };
                    CameraError::Unavailable(format!("{name}: {why}"))
                })?;
                Ok(none.insert(connection))
            }
        }
    }
}

impl Source for AravisCamera {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let taken = self.opened()?.take(moment);
        if matches!(taken, Err(CameraError::Unavailable(_)))
            && let Some(connection) = self.open.take()
        {
            // Whatever it was: a camera that is opened anew begins anew, and a frame that was late is not taken for the next.
            connection.close();
        }
        taken.map(Series::from)
    }

    fn gain(&mut self) -> Result<f64, CameraError> {
        self.opened()?.gain()
    }

    fn set_gain(&mut self, gain_db: f64) -> Result<(), CameraError> {
        self.opened()?.set_gain(gain_db)?;
        self.gain_db = gain_db;
        Ok(())
    }

    fn exposure(&mut self) -> Result<f64, CameraError> {
        Ok(self.opened()?.exposure_s)
    }

    fn set_exposure(&mut self, exposure_s: f64) -> Result<(), CameraError> {
        self.opened()?.set_exposure(exposure_s)?;
        // Also after it was away.
        self.settings.exposure_s = exposure_s;
        Ok(())
    }

    fn temperature(&mut self) -> Option<f64> {
        let camera = &self.open.as_ref()?.camera;
        let offered = camera.is_feature_available("DeviceTemperature").unwrap_or(false);
        offered.then(|| camera.float("DeviceTemperature").ok()).flatten().filter(|celsius| celsius.is_finite())
    }
}

/// A camera that is open and sends frames, or does so when it is triggered.
struct Connection {
    // Before the camera, so that it ends before it.
    stream: Stream,
    camera: Camera,
    /// Maker, model and serial number.
    name: String,
    trigger: Trigger,
    format: PixelFormat,
    width: usize,
    height: usize,
    full_scale: u16,
    /// Exposure as the camera has it, s.
    exposure_s: f64,
    /// Bytes that the camera sends for a frame.
    payload: usize,
    /// It stopped answering.
    lost: Arc<AtomicBool>,
    /// Where a buffer that ends puts its memory.
    give_back: SyncSender<Vec<u16>>,
    given_back: Receiver<Vec<u16>>,
    /// The camera's number of the last frame that had one.
    last_id: Option<u64>,
    /// Frames since then whose number never came.
    nameless: u64,
    /// Packets missing until now.
    missing_packets: u64,
}

impl Connection {
    /// Opens the camera, sets all that the settings say, and has it send.
    fn open(settings: &CameraSettings, gain_db: f64) -> Result<Self, String> {
        let device = (!settings.device.is_empty()).then_some(settings.device.as_str());
        let camera = Camera::new(device).map_err(doing("cannot be opened"))?;
        configure(&camera, settings, gain_db)?;
        let (width, height) = (settings.width_px as usize, settings.height_px as usize);
        let payload = camera.payload().map_err(doing("PayloadSize"))? as usize;
        check_layout(&camera, settings, payload)?;
        let stream = camera.create_stream().map_err(doing("no stream"))?;
        if let Some(stream) = stream.downcast_ref::<GvStream>() {
            // As much as a frame, as far as the system allows it (net.core.rmem_max).
            stream.set_socket_buffer(GvStreamSocketBuffer::Auto);
        }
        let lost = Arc::new(AtomicBool::new(false));
        if let Some(device) = camera.device() {
            let lost = Arc::clone(&lost);
            device.connect_control_lost(move |_| lost.store(true, Ordering::Relaxed));
        }
        let text = |text: Result<glib::GString, glib::Error>| text.map_or_else(|_| "?".to_owned(), String::from);
        let name = [text(camera.vendor_name()), text(camera.model_name()), text(camera.device_serial_number())].join(" ");
        let (give_back, given_back) = sync_channel(1);
        let connection = Self {
            stream,
            name,
            trigger: settings.trigger,
            format: settings.pixel_format,
            width,
            height,
            full_scale: match u16::try_from(settings.full_scale_adu) {
                Ok(adu) if adu > 0 => adu,
                _ => settings.pixel_format.full_scale_adu(),
            },
            exposure_s: camera.exposure_time().map_err(doing("ExposureTime"))? * 1e-6,
            payload,
            lost,
            give_back,
            given_back,
            last_id: None,
            nameless: 0,
            missing_packets: 0,
            camera,
        };
        for _ in 0..(BUFFERS_BYTES / payload.max(1)).clamp(3, BUFFERS) {
            connection.push_fresh();
        }
        connection.camera.start_acquisition().map_err(doing("AcquisitionStart"))?;
        tracing::info!(camera = connection.name, width, height, exposure_s = connection.exposure_s, "the camera is open");
        Ok(connection)
    }

    /// The next frame: triggered, where it is to be.
    fn take(&mut self, moment: &Moment) -> Result<Frame, CameraError> {
        let asked_us = glib::real_time();
        match (self.trigger, moment.ask) {
            (Trigger::Software, _) => self.command(moment, asked_us, ExposedBy::Asked),
            (Trigger::Free, _) => self.receive(moment, asked_us, None, self.patience(), ExposedBy::Asked),
            (_, Ask::Triggered(wait)) => self.receive(moment, asked_us, None, wait, ExposedBy::Trigger),
            (_, Ask::Expose) => match self.receive(moment, asked_us, None, Duration::ZERO, ExposedBy::Trigger) {
                Err(CameraError::NothingNew) => self.expose_by_itself(moment),
                triggered => triggered,
            },
        }
    }

    /// How long a frame can take to come.
    fn patience(&self) -> Duration {
        Duration::try_from_secs_f64(self.exposure_s + PATIENCE_S).unwrap_or(Duration::from_secs(2))
    }

    /// One frame of a camera that others trigger, without a trigger of theirs. It listens to its line again afterwards.
    fn expose_by_itself(&mut self, moment: &Moment) -> Result<Frame, CameraError> {
        self.listen_to(Trigger::Software)?;
        let frame = self.command(moment, glib::real_time(), ExposedBy::Itself);
        self.listen_to(self.trigger)?;
        frame
    }

    /// Has it exposed by another trigger. It stops sending meanwhile: many cameras take none while they do, and number anew after it.
    fn listen_to(&mut self, trigger: Trigger) -> Result<(), CameraError> {
        let set = |source| {
            self.camera.stop_acquisition()?;
            self.camera.set_trigger(source)?;
            self.camera.start_acquisition()
        };
        let done = trigger.genicam().map_or(Ok(()), set);
        done.map_err(|error| self.failed("takes no other trigger", &error))?;
        self.last_id = None;
        Ok(())
    }

    /// A frame by a command of ours.
    fn command(&mut self, moment: &Moment, asked_us: i64, by: ExposedBy) -> Result<Frame, CameraError> {
        // What comes before the trigger is not its frame.
        while let Some(stale) = self.stream.try_pop_buffer() {
            tracing::warn!(camera = self.name, frame = stale.frame_id(), "a frame that nobody asked for is dropped");
            self.replace(stale);
        }
        self.camera.software_trigger().map_err(|error| self.failed("cannot be triggered", &error))?;
        self.receive(moment, asked_us, Some(glib::real_time()), self.patience(), by)
    }

    /// The next frame that comes, waited for so long at most. Times are those of the computer's clock, µs: when it was asked for, and when
    /// it was triggered by a command.
    fn receive(
        &mut self,
        moment: &Moment,
        asked_us: i64,
        triggered_us: Option<i64>,
        wait: Duration,
        by: ExposedBy,
    ) -> Result<Frame, CameraError> {
        loop {
            let wait_us = u64::try_from(wait.as_micros()).unwrap_or(u64::MAX);
            let Some(buffer) = self.stream.timeout_pop_buffer(wait_us) else { return Err(self.nothing_came(by)) };
            let (status, id) = (buffer.status(), buffer.frame_id());
            // From the camera's clock to UTC by way of the computer's, which must not have been set meanwhile to be believed.
            let came_us = i64::try_from(buffer.system_timestamp() / 1000).unwrap_or(asked_us);
            let memory = self.replace(buffer);
            let since_s = match triggered_us {
                Some(triggered_us) => (triggered_us - asked_us) as f64 * 1e-6 + self.exposure_s / 2.0,
                None => (came_us - asked_us) as f64 * 1e-6 - self.exposure_s / 2.0,
            };
            let mut stamp = Stamp { exposed_by: Some(by), ..self.stamp(moment, since_s) };
            let incomplete = match status {
                // A stream that ends, not a frame.
                BufferStatus::Aborted | BufferStatus::Cleared => continue,
                BufferStatus::MissingPackets | BufferStatus::Timeout | BufferStatus::WrongPacketId => true,
                _ => false,
            };
            self.count(id, incomplete, &mut stamp);
            let Some(memory) = memory.filter(|_| incomplete || status == BufferStatus::Success) else {
                return Err(CameraError::Unreadable { origin: stamp.origin, problem: format!("the driver calls it {status:?}") });
            };
            let (width, height) = (self.width, self.height);
            let pixels = pixels(memory, self.format, width * height);
            return Ok(Frame { width, height, pixels, rows: RowOrder::TopFirst, full_scale: Some(self.full_scale), stamp });
        }
    }

    /// What is known of a frame whose exposure had its middle at this time after the moment, s.
    fn stamp(&self, moment: &Moment, since_s: f64) -> Stamp {
        let mut stamp = Stamp { exposure_s: Some(self.exposure_s), exposures: 1, ..Stamp::default() };
        moment.date(since_s, &mut stamp);
        stamp
    }

    /// Names a frame, and counts what was lost before and in it: by the camera's number of it, and by the packets that the driver missed.
    fn count(&mut self, id: u64, incomplete: bool, stamp: &mut Stamp) {
        let short = self.camera.is_gv_device();
        let missed = if short && id == 0 {
            // The packet that has the number is among those that are missing; the next number tells what came before it.
            self.nameless += 1;
            stamp.origin = self.last_id.map_or_else(|| self.told("?"), |last| self.told(&format!("{last}+{}", self.nameless)));
            0
        } else {
            stamp.origin = self.told(&id.to_string());
            let between = self.last_id.replace(id).map_or(0, |last| missed_between(last, id, short));
            between.saturating_sub(std::mem::take(&mut self.nameless))
        };
        stamp.missed_frames = u32::try_from(missed).unwrap_or(u32::MAX);
        if incomplete {
            // Of USB3 Vision, without packets, one is said to be missing.
            let missing = if short { self.stream.info_uint64_by_name("n_missing_packets") } else { 0 };
            let more = missing.saturating_sub(self.missing_packets);
            self.missing_packets = missing;
            stamp.missing_packets = u32::try_from(more).unwrap_or(u32::MAX).max(1);
        }
        let Stamp { missing_packets, missed_frames, .. } = *stamp;
        if missing_packets > 0 || missed_frames > 0 {
            tracing::warn!(camera = self.name, frame = id, missing_packets, missed_frames, "not all came that the camera sent");
        }
    }

    /// Takes the memory of a buffer, and puts a fresh one in its place.
    fn replace(&self, buffer: Buffer) -> Option<Vec<u16>> {
        let (data, _) = buffer.data();
        drop(buffer);
        self.push_fresh();
        self.given_back.try_iter().find(|memory| memory.as_ptr().cast() == data.cast_const())
    }

    /// Gives the stream a buffer of zeros. Its memory is kept by what is done when the buffer ends, and so lives as long as it.
    fn push_fresh(&self) {
        let mut memory = vec![0_u16; self.payload.div_ceil(2)];
        let give_back = self.give_back.clone();
        let data = memory.as_mut_ptr().cast();
        self.stream.push_buffer(Buffer::new_preallocated_owned(data, self.payload, move || drop(give_back.try_send(memory))));
    }

    /// Why no frame came in time.
    fn nothing_came(&self, by: ExposedBy) -> CameraError {
        if self.is_lost() {
            return CameraError::Unavailable(self.told(LOST));
        }
        if by == ExposedBy::Trigger {
            // Who waits for others' triggers knows nothing of their times.
            return CameraError::NothingNew;
        }
        CameraError::Unavailable(self.told(&format!("gave no frame within {:.1} s", self.exposure_s + PATIENCE_S)))
    }

    fn gain(&self) -> Result<f64, CameraError> {
        if !self.camera.is_gain_available().unwrap_or(false) {
            return Err(CameraError::NoGain);
        }
        self.camera.gain().map_err(|error| self.refused("does not tell its gain", &error))
    }

    fn set_gain(&self, gain_db: f64) -> Result<(), CameraError> {
        self.gain()?;
        self.camera.set_gain(gain_db).map_err(|error| self.refused(&format!("does not take a gain of {gain_db} dB"), &error))
    }

    fn set_exposure(&mut self, exposure_s: f64) -> Result<(), CameraError> {
        let refused = |error| self.refused(&format!("does not take an exposure of {exposure_s} s"), &error);
        self.camera.set_exposure_time(exposure_s * 1e6).map_err(refused)?;
        self.exposure_s = self.camera.exposure_time().map_err(refused)? * 1e-6;
        Ok(())
    }

    /// Ends it beside everything else: a camera that is away is waited for at each step of it, for seconds.
    fn close(self) {
        let ended = std::thread::Builder::new().name("camera-close".to_owned()).spawn(move || drop(self));
        if let Err(error) = ended {
            tracing::warn!(%error, "no thread to close the camera in");
        }
    }

    fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// The error of a camera that is given up: it need not be told that it is to stop.
    fn failed(&self, what: &str, error: &glib::Error) -> CameraError {
        self.lost.store(true, Ordering::Relaxed);
        self.refused(what, error)
    }

    fn refused(&self, what: &str, error: &glib::Error) -> CameraError {
        CameraError::Unavailable(format!("{}: {error}", self.told(what)))
    }

    fn told(&self, what: &str) -> String {
        format!("{} {what}", self.name)
    }
}

impl Drop for Connection {
    /// A camera that is left goes on sending otherwise.
    fn drop(&mut self) {
        if !self.is_lost()
            && let Err(error) = self.camera.stop_acquisition()
        {
            tracing::warn!(camera = self.name, %error, "not stopped");
        }
    }
}

/// Words before what the driver says.
fn doing(what: &'static str) -> impl Fn(glib::Error) -> String {
    move |error| format!("{what}: {error}")
}

/// Sets what the settings say.
fn configure(camera: &Camera, settings: &CameraSettings, gain_db: f64) -> Result<(), String> {
    camera.set_range_check_policy(RangeCheckPolicy::Enable);
    camera.set_acquisition_mode(AcquisitionMode::Continuous).map_err(doing("AcquisitionMode"))?;
    camera.set_pixel_format_from_string(settings.pixel_format.genicam()).map_err(doing("PixelFormat"))?;
    let (width, height) = (i32::try_from(settings.width_px), i32::try_from(settings.height_px));
    // Its offsets stay as the camera, or camera.features, has them.
    camera.set_region(-1, -1, width.unwrap_or(i32::MAX), height.unwrap_or(i32::MAX)).map_err(doing("Width and Height"))?;
    if camera.is_exposure_auto_available().unwrap_or(false) {
        camera.set_exposure_time_auto(Auto::Off).map_err(doing("ExposureAuto"))?;
    }
    camera.set_exposure_time(settings.exposure_s * 1e6).map_err(doing("ExposureTime"))?;
    if camera.is_gain_available().unwrap_or(false) {
        if camera.is_gain_auto_available().unwrap_or(false) {
            camera.set_gain_auto(Auto::Off).map_err(doing("GainAuto"))?;
        }
        camera.set_gain(gain_db).map_err(doing("Gain"))?;
    }
    match settings.trigger.genicam() {
        Some(source) => camera.set_trigger(source).map_err(doing("TriggerSource"))?,
        None if camera.is_feature_available("TriggerSelector").unwrap_or(false) => {
            camera.clear_triggers().map_err(doing("TriggerMode"))?;
        }
        None => (),
    }
    match camera.device() {
        Some(device) if !settings.features.is_empty() => {
            device.set_features_from_string(&settings.features).map_err(doing("camera.features"))
        }
        _ => Ok(()),
    }
}

/// Refuses a camera that would send something else than the settings say.
fn check_layout(camera: &Camera, settings: &CameraSettings, payload: usize) -> Result<(), String> {
    let (_, _, width, height) = camera.region().map_err(doing("Width and Height"))?;
    let format = camera.pixel_format_as_string().map_err(doing("PixelFormat"))?;
    let wanted = settings.pixel_format.genicam();
    let sent = |n: i32, wanted: u32| u32::try_from(n) == Ok(wanted);
    let bytes = settings.width_px as usize * settings.height_px as usize * settings.pixel_format.bytes();
    if !sent(width, settings.width_px) || !sent(height, settings.height_px) || format != wanted || payload < bytes {
        return Err(format!(
            "it sends {width} × {height} px as {format}, {payload} bytes, and is to send {} × {} px as {wanted}",
            settings.width_px, settings.height_px
        ));
    }
    Ok(())
}

/// A frame's pixels of the bytes that were received.
fn pixels(mut memory: Vec<u16>, format: PixelFormat, number: usize) -> Vec<u16> {
    if format.bytes() == 1 {
        let bytes: &[u8] = bytemuck::cast_slice(&memory);
        return bytes.iter().take(number).map(|byte| u16::from(*byte)).collect();
    }
    memory.truncate(number);
    if cfg!(target_endian = "big") {
        // Cameras send the low byte first.
        memory.iter_mut().for_each(|pixel| *pixel = u16::from_le(*pixel));
    }
    memory
}

/// How many frames a camera took between two that came, by its numbers of them.
fn missed_between(last: u64, id: u64, short: bool) -> u64 {
    if id > last {
        id - last - 1
    } else if short && last <= LAST_SHORT_ID && last - id > LAST_SHORT_ID / 2 {
        // From the highest number to 1; 0 is none.
        (LAST_SHORT_ID - last) + id.saturating_sub(1)
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_never_came_are_counted_by_the_cameras_numbers() {
        for (last, id, short, missed) in [
            (7, 8, true, 0),
            (7, 10, true, 2),
            (65_535, 1, true, 0),
            (65_533, 2, true, 3),
            (65_536, 65_540, true, 3),
            (65_535, 65_536, false, 0),
            (900, 1, true, 0),
            (65_535, 1, false, 0),
        ] {
            assert_eq!(missed_between(last, id, short), missed, "from {last} to {id}");
        }
    }

    #[test]
    fn bytes_become_pixels_and_words_stay_where_they_are() {
        let memory = vec![0x0201_u16.to_le(), 0x0403_u16.to_le(), 0xffff];
        let place = memory.as_ptr();
        assert_eq!(pixels(memory.clone(), PixelFormat::Mono8, 5), [1, 2, 3, 4, 255]);
        let kept = pixels(memory, PixelFormat::Mono12, 2);
        assert_eq!((kept.as_slice(), kept.as_ptr()), ([0x0201, 0x0403].as_slice(), place));
    }
}
