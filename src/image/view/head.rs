//! The head of a stream: the frame's size and stamp, the sources, and what the other packets are read with.

use super::coder::{MOST_STEPS, Model, Width};
use super::transform::CLASSES;
use super::{MOST_PIXELS, ViewSource};
use crate::image::{Frame, ImageCounter, Level, Stamp, TriggerCounter};
use crate::sky::{ClockQuality, RowOrder, Utc};
use bytes::{Buf, BufMut};

/// Sources that a head has room for: what a solver's patterns are made of, and some more.
pub const MOST_VIEW_SOURCES: usize = 24;
/// A position is given to 2⁻⁵ px, finer than any centroid of a star by day, or where the picture has more than 2048 columns or rows as
/// finely as 16 bits have room for.
const MOST_FRACTION_BITS: u32 = 5;
/// Steps of a flux for a factor of two: 9 % each.
const FLUX_STEPS: f64 = 8.0;
/// Bytes of a head, its sources aside, and of each source.
pub(super) const FIXED_BYTES: usize = 70;
pub(super) const SOURCE_BYTES: usize = 5;

/// Flags of what is known.
const BOTTOM_FIRST: u16 = 1;
const SIMULATED: u16 = 1 << 1;
const TRIGGER_KNOWN: u16 = 1 << 2;
const EXPOSURE_KNOWN: u16 = 1 << 3;
const GAIN_KNOWN: u16 = 1 << 4;
const FOCUS_KNOWN: u16 = 1 << 5;
const FULL_SCALE_KNOWN: u16 = 1 << 6;
/// The quality of the clock plus one, nought where the time is not known, stands in two bits from here on.
const QUALITY_SHIFT: u32 = 7;

/// How the values of the thumbnail are meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ThumbnailScale {
    /// The darkest cell's mean, in sixteenths of an ADU.
    pub base: u32,
    /// What one unit of a value is, in sixteenths of an ADU.
    pub step: u32,
}

/// What the first packet of a view says.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewHead {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Which end of the picture the first row is.
    pub rows: RowOrder,
    /// Highest value that a pixel can have, ADU, where known.
    pub full_scale: Option<u16>,
    /// Image and trigger counter, time, exposure, gain, focus; the origin is left empty.
    pub stamp: Stamp,
    /// Levels at which the picture is well shown.
    pub level: Level,
    /// The most important sources, as the sender put them: brightest first.
    pub sources: Vec<ViewSource>,
    /// How the values of the thumbnail are meant.
    pub thumbnail: ThumbnailScale,
    /// Packets of the stream, this one too.
    pub packets: u32,
    /// CRC-32 of all pixels in file order, lowest byte first.
    pub checksum: u32,
    /// How widely the numbers of each kind lie: coefficients by class, then the thumbnail's.
    pub(super) widths: [Width; CLASSES + 1],
}

/// CRC-32 of pixels, lowest byte first.
pub(super) fn checksum(pixels: &[u16]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    let mut bytes = [0; 4096];
    for some in pixels.chunks(bytes.len() / 2) {
        bytes.chunks_exact_mut(2).zip(some).for_each(|(bytes, adu)| bytes.copy_from_slice(&adu.to_le_bytes()));
        hasher.update(bytes.get(..2 * some.len()).unwrap_or_default());
    }
    hasher.finalize()
}

/// Bits behind the point that positions on a picture of this size have room for.
fn fraction_bits(width: usize, height: usize) -> u32 {
    (0..=MOST_FRACTION_BITS).rev().find(|bits| width.max(height) << bits <= 1 << 16).unwrap_or(0)
}

/// Sources as a head keeps them: the first of those that lie on the picture, their numbers rounded.
pub(super) fn keep(sources: &[ViewSource], width: usize, height: usize) -> Vec<ViewSource> {
    let on_picture = |at: f64, size: usize| at >= -0.5 && at <= size as f64 - 0.5;
    let good = |s: &&ViewSource| on_picture(s.x, width) && on_picture(s.y, height) && s.flux > 0.0 && s.flux.is_finite();
    let bits = fraction_bits(width, height);
    sources.iter().filter(good).take(MOST_VIEW_SOURCES).map(|source| unpack_source(pack_source(source, bits), bits)).collect()
}

fn pack_source(source: &ViewSource, bits: u32) -> (u16, u16, u8) {
    let place = |at: f64| (at * f64::from(1 << bits)).round().clamp(0.0, f64::from(u16::MAX)) as u16;
    let flux = (FLUX_STEPS * libm::log2(source.flux)).round().clamp(0.0, f64::from(u8::MAX)) as u8;
    (place(source.x), place(source.y), flux)
}

fn unpack_source((x, y, flux): (u16, u16, u8), bits: u32) -> ViewSource {
    let place = |at: u16| f64::from(at) / f64::from(1 << bits);
    ViewSource { x: place(x), y: place(y), flux: libm::exp2(f64::from(flux) / FLUX_STEPS) }
}

impl ViewHead {
    /// The models of coefficients, by class.
    pub(super) fn coefficient_models(&self) -> Vec<Model> {
        self.widths.iter().take(CLASSES).copied().map(Model::new).collect()
    }

    /// The model of the thumbnail's numbers.
    pub(super) fn thumbnail_models(&self) -> [Model; 1] {
        let [.., width] = self.widths;
        [Model::new(width)]
    }

    /// The pixels that the sources lie on.
    pub(super) fn source_pixels(&self) -> impl Iterator<Item = (usize, usize)> {
        self.sources.iter().map(|s| ((s.x as usize).min(self.width - 1), (s.y as usize).min(self.height - 1)))
    }

    /// A frame of these pixels with what the head says of it.
    pub(super) fn frame(&self, pixels: Vec<u16>) -> Option<Frame> {
        let mut frame = Frame::new(self.width, self.height, pixels, self.rows)?;
        frame.full_scale = self.full_scale;
        frame.stamp = self.stamp.clone();
        Some(frame)
    }

    /// The payload of packet 0.
    pub(super) fn payload(&self) -> Vec<u8> {
        let stamp = &self.stamp;
        let mut flags = 0;
        let mut known = |flag: u16, is: bool| flags |= if is { flag } else { 0 };
        known(BOTTOM_FIRST, self.rows == RowOrder::BottomFirst);
        known(SIMULATED, stamp.simulated);
        known(TRIGGER_KNOWN, stamp.trigger.is_some());
        known(EXPOSURE_KNOWN, stamp.exposure_s.is_some());
        known(GAIN_KNOWN, stamp.gain_db.is_some());
        known(FOCUS_KNOWN, stamp.focus_counts.is_some());
        known(FULL_SCALE_KNOWN, self.full_scale.is_some());
        let quality = stamp.captured.map_or(0, |(_, quality)| match quality {
            ClockQuality::Unset => 1,
            ClockQuality::FreeRunning => 2,
            // Two bits have no word for what it follows.
            _ => 3,
        });
        let mut out = vec![super::packet::Part::Head.code()];
        out.put_u16_le(flags | quality << QUALITY_SHIFT);
        out.put_u16_le(self.width as u16);
        out.put_u16_le(self.height as u16);
        out.put_u32_le(self.packets);
        out.put_u32_le(self.checksum);
        out.put_u32_le(stamp.image.0);
        out.put_u32_le(stamp.trigger.unwrap_or_default().0);
        out.put_i64_le(stamp.captured.map_or(0, |(utc, _)| (utc.unix_s() * 1e6).round() as i64));
        out.put_f32_le(stamp.exposure_s.unwrap_or(0.0) as f32);
        out.put_f32_le(stamp.gain_db.unwrap_or(0.0) as f32);
        out.put_i32_le(stamp.focus_counts.unwrap_or(0));
        out.put_u8(stamp.exposures);
        out.put_u16_le(self.full_scale.unwrap_or(0));
        out.put_u16_le(self.level.low);
        out.put_u16_le(self.level.high);
        out.put_u32_le(self.thumbnail.base);
        out.put_u32_le(self.thumbnail.step);
        self.widths.iter().for_each(|width| out.put_u8(width.0));
        let bits = fraction_bits(self.width, self.height);
        out.put_u8(bits as u8);
        out.put_u8(self.sources.len() as u8);
        for source in &self.sources {
            let (x, y, flux) = pack_source(source, bits);
            out.put_u16_le(x);
            out.put_u16_le(y);
            out.put_u8(flux);
        }
        out
    }

    /// Reads the payload of packet 0; `None` where it contradicts itself.
    pub(super) fn read(payload: &[u8]) -> Option<Self> {
        let (fixed, mut sources) = payload.split_at_checked(FIXED_BYTES)?;
        let mut fixed = fixed.strip_prefix(&[super::packet::Part::Head.code()])?;
        let flags = fixed.get_u16_le();
        let known = |flag: u16| flags & flag != 0;
        let (width, height) = (usize::from(fixed.get_u16_le()), usize::from(fixed.get_u16_le()));
        let (packets, checksum, image, trigger) =
            (fixed.get_u32_le(), fixed.get_u32_le(), fixed.get_u32_le(), fixed.get_u32_le());
        let utc = Utc::from_unix(fixed.get_i64_le() as f64 / 1e6);
        let quality = match flags >> QUALITY_SHIFT & 3 {
            0 => None,
            1 => Some(ClockQuality::Unset),
            2 => Some(ClockQuality::FreeRunning),
            _ => Some(ClockQuality::Synchronised),
        };
        let (exposure_s, gain_db, focus) = (fixed.get_f32_le(), fixed.get_f32_le(), fixed.get_i32_le());
        let number = |value: f32, flag: u16| Some(f64::from(value)).filter(|value| known(flag) && value.is_finite());
        let stamp = Stamp {
            image: ImageCounter(image),
            trigger: known(TRIGGER_KNOWN).then_some(TriggerCounter(trigger)),
            captured: utc.zip(quality),
            exposure_s: number(exposure_s, EXPOSURE_KNOWN),
            gain_db: number(gain_db, GAIN_KNOWN),
            focus_counts: known(FOCUS_KNOWN).then_some(focus),
            exposures: fixed.get_u8(),
            simulated: known(SIMULATED),
            ..Stamp::default()
        };
        let full_scale = Some(fixed.get_u16_le()).filter(|_| known(FULL_SCALE_KNOWN));
        let level = Level { low: fixed.get_u16_le(), high: fixed.get_u16_le() };
        let thumbnail = ThumbnailScale { base: fixed.get_u32_le(), step: fixed.get_u32_le() };
        let mut widths = [Width(0); CLASSES + 1];
        widths.iter_mut().for_each(|width| *width = Width(fixed.get_u8()));
        let (bits, count) = (u32::from(fixed.get_u8()), usize::from(fixed.get_u8()));
        let pixels = width.saturating_mul(height);
        let sound = pixels > 0
            && pixels <= MOST_PIXELS
            && (1..=super::packet::MOST_PACKETS).contains(&(packets as usize))
            && level.low < level.high
            && thumbnail.step > 0
            && widths.iter().all(|width| width.0 <= MOST_STEPS)
            && bits == fraction_bits(width, height)
            && count <= MOST_VIEW_SOURCES
            && sources.len() == count * SOURCE_BYTES;
        if !sound {
            return None;
        }
        let mut source = || unpack_source((sources.get_u16_le(), sources.get_u16_le(), sources.get_u8()), bits);
        let sources = (0..count).map(|_| source()).collect();
        let rows = if known(BOTTOM_FIRST) { RowOrder::BottomFirst } else { RowOrder::TopFirst };
        Some(Self { width, height, rows, full_scale, stamp, level, sources, thumbnail, packets, checksum, widths })
    }
}
