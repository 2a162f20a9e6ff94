//! `stars view`: a frame as packets for a thin link, and what a receiver makes of them.

use super::{ConfigArgs, NEGATIVE, print, within};
use crate::image::view::{Assembly, MOST_PIXELS, PACKET_BYTES, View, ViewSource, packets_in};
use crate::image::{self, Frame, auto_level, to_grey8, write_fits};
use crate::service::{load_bad_pixels, load_catalogue, prepare, read_file};
use crate::simulate::ThinLink;
use crate::solve::{Prior, Solver, Unwatched};
use ::image::codecs::png::PngEncoder;
use ::image::{ExtendedColorType, ImageEncoder};
use anyhow::Context;
use serde_json::{Map, Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

/// Longest file that is read, bytes.
const MAX_FILE_BYTES: usize = 1 << 30;
/// Ranges of missing packets that are listed.
const LISTED_GAPS: usize = 16;
/// Rounds of a simulated link, after which it is as good as dead.
const MOST_ROUNDS: usize = 10_000_000;
/// Greatest loss that is simulated.
const MOST_LOSS: f64 = 0.95;

/// Sends a raw frame over a thin link: packets with the stars first and every pixel in the end
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars view image.fits --packets image.packets           240 bytes each, one after the other
  stars view --decode got.packets --picture got.png       what of it has come; JSON says what is missing
  stars view image.fits --loss 0.3 --seed 1               over a link that loses 3 of 10
Exits 0 if the picture is exact or was encoded, 1 if some of it is missing, 2 if the call or a file is wrong.")]
pub struct Args {
    /// Image to send: FITS, TIFF, PNG or JPEG
    #[arg(value_name = "FILE", required_unless_present = "decode", conflicts_with = "decode")]
    file: Option<PathBuf>,
    /// Write the packets into this file, one after the other
    #[arg(long, value_name = "OUT", conflicts_with = "decode")]
    packets: Option<PathBuf>,
    /// Bytes of a packet, at most
    #[arg(long, value_name = "N", default_value_t = PACKET_BYTES)]
    bytes: usize,
    /// Read packets from this file, in any order and with anything between them
    #[arg(long, value_name = "PACKETS")]
    decode: Option<PathBuf>,
    /// Write the picture: levelled as PNG, or every value as FITS where the name ends in .fits
    #[arg(long, value_name = "OUT", requires = "decode")]
    picture: Option<PathBuf>,
    /// Write the thumbnail, levelled, as PNG
    #[arg(long, value_name = "OUT", requires = "decode")]
    thumbnail: Option<PathBuf>,
    /// Simulate a link that loses this part of the packets, and say what was there after the first 2 kB and in the end
    #[arg(long, value_name = "PART", conflicts_with = "decode", value_parser = |text: &str| within(text, 0.0, MOST_LOSS))]
    loss: Option<f64>,
    /// Seed of the losses
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Encodes or decodes.
    ///
    /// # Errors
    /// A file that can't be read or written, or settings that are wrong.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let answer = match (&self.decode, &self.file) {
            (Some(packets), _) => self.show(packets)?,
            (None, Some(file)) => self.send(file)?,
            (None, None) => anyhow::bail!("no image, expected one"),
        };
        print(&serde_json::to_string_pretty(&answer)?)?;
        let negative = answer.get("exact").is_some_and(|exact| exact == false);
        Ok(if negative { ExitCode::from(NEGATIVE) } else { ExitCode::SUCCESS })
    }

    /// Encodes an image, and sends it over a simulated link where one is asked for.
    fn send(&self, file: &Path) -> anyhow::Result<Value> {
        let bytes = read_file(file, MAX_FILE_BYTES, "an image (FITS, TIFF, PNG or JPEG)")?;
        let frame = image::read(&file.display().to_string(), &bytes)?;
        let view = View::new(&frame, &self.sources(&frame)?, self.bytes)?;
        if let Some(out) = &self.packets {
            write(out, view.bytes())?;
        }
        let mut answer = json!({
            "stream": format!("{:08x}", view.stream()),
            "packets": view.len(),
            "bytes": view.bytes().len(),
            "of_raw": view.bytes().len() as f64 / (2 * frame.pixels.len()) as f64,
        });
        if let (Some(loss), Some(answer)) = (self.loss, answer.as_object_mut()) {
            let mut assembly = Assembly::new(Some(view.stream()), MOST_PIXELS);
            let mut link = ThinLink::new(&view, loss, self.seed);
            let mut rounds = 0;
            let mut until = |reached: &dyn Fn(&Assembly) -> bool| {
                while !reached(&assembly) && rounds < MOST_ROUNDS {
                    link.round(&mut assembly);
                    rounds += 1;
                }
                let mut state = state(&assembly);
                state.insert("sent_packets".into(), link.packets.into());
                state.insert("sent_bytes".into(), link.bytes.into());
                Value::Object(state)
            };
            let first = view.first_packets() as u32;
            answer
                .insert("first_2_kb".into(), until(&|assembly| assembly.missing(1).first().is_none_or(|gap| gap.start >= first)));
            answer.insert("end".into(), until(&Assembly::is_exact));
            answer.insert("exact".into(), assembly.is_exact().into());
        }
        Ok(answer)
    }

    /// Its sources as `stars solve` finds them, brightest first. The bad pixels that are taken out for that are sent as they are.
    fn sources(&self, frame: &Frame) -> anyhow::Result<Vec<ViewSource>> {
        let settings = Arc::new(self.config.load()?.settings);
        let catalogue = Arc::new(load_catalogue(&settings.catalog.file).map_err(anyhow::Error::msg)?);
        let mut looked_at = frame.clone();
        load_bad_pixels(&settings)?.apply(&mut looked_at);
        let mut solver = Solver::new(catalogue, settings);
        prepare(&mut solver, frame.width, frame.height);
        let outcome = solver.solve(&looked_at, &Prior::default(), &Unwatched);
        Ok(outcome.sources.iter().map(|source| ViewSource { x: source.x, y: source.y, flux: source.flux }).collect())
    }

    /// Puts together the packets of a file, says what they are, and writes the pictures that are asked for.
    fn show(&self, packets: &Path) -> anyhow::Result<Value> {
        let bytes = read_file(packets, MAX_FILE_BYTES, "packets of a view")?;
        let mut assembly = Assembly::new(None, MOST_PIXELS);
        let mut refused = Vec::new();
        for packet in packets_in(&bytes) {
            if let Err(refusal) = assembly.take(packet) {
                refused.push(refusal.to_string());
            }
        }
        anyhow::ensure!(assembly.progress().0 > 0, "{}: no packet, expected packets of a view", packets.display());
        for (out, picture) in [(&self.picture, assembly.picture()), (&self.thumbnail, assembly.thumbnail())] {
            let Some(out) = out else { continue };
            let picture = picture.with_context(|| format!("{}: nothing to show before packet 0 has come", packets.display()))?;
            write_picture(out, &picture)?;
        }
        let mut state = state(&assembly);
        state.insert("refused".into(), refused.len().into());
        state.insert("first_refusals".into(), refused.into_iter().take(LISTED_GAPS).collect());
        Ok(Value::Object(state))
    }
}

/// What a receiver has.
fn state(assembly: &Assembly) -> Map<String, Value> {
    let (come, of) = assembly.progress();
    let gaps: Vec<[u32; 2]> = assembly.missing(LISTED_GAPS).iter().map(|gap| [gap.start, gap.end - 1]).collect();
    let head = assembly.head();
    let entries = [
        ("packets_come", json!(come)),
        ("packets", json!(of)),
        ("missing", json!(gaps)),
        ("exact", json!(assembly.is_exact())),
        ("size_px", json!(head.map(|head| [head.width, head.height]))),
        ("thumbnail_px", json!(assembly.thumbnail().map(|thumbnail| [thumbnail.width, thumbnail.height]))),
        ("image_counter", json!(head.map(|head| head.stamp.image))),
        ("utc", json!(head.and_then(|head| head.stamp.captured).map(|(utc, _)| utc.to_string()))),
        ("exposure_s", json!(head.and_then(|head| head.stamp.exposure_s))),
        ("levels_adu", json!(head.map(|head| [head.level.low, head.level.high]))),
        ("simulated", json!(head.map(|head| head.stamp.simulated))),
        ("sources", json!(assembly.sources())),
    ];
    entries.map(|(key, value)| (key.to_owned(), value)).into_iter().collect()
}

/// Every value as FITS, or levelled to eight bits as PNG.
fn write_picture(out: &Path, picture: &Frame) -> anyhow::Result<()> {
    let mut bytes = Vec::new();
    if out.extension().is_some_and(|extension| extension == "fits") {
        write_fits(picture, &[], &mut bytes)?;
    } else {
        let grey = to_grey8(picture, auto_level(picture));
        let (width, height) = (u32::try_from(picture.width)?, u32::try_from(picture.height)?);
        PngEncoder::new(&mut bytes).write_image(&grey, width, height, ExtendedColorType::L8)?;
    }
    write(out, &bytes)
}

fn write(out: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    fs::write(out, bytes).with_context(|| format!("{}: can't be written", out.display()))
}
