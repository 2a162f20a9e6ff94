//! Images for a flight computer of old: of each new image that is kept the exposures, whole, to the image server on that computer, as the
//! program that flew sent them.
//!
//! A connection for each image; for each exposure a head of 72 bytes and its pixels, the bottom row first; then the server says what it did
//! with it, or a second goes by without a word. The flown program sent them as fast as the link took them; here they keep to
//! `images.rate_bytes_s`.

use super::super::session::Shared;
use super::gallery::{Key, Refused};
use crate::image::{Frame, ImageCounter};
use crate::sky::RowOrder;
use crate::wire::ImageForm;
use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::{Instant, sleep, sleep_until, timeout};

/// What each exposure begins with.
const MAGIC: u32 = 0xCDED_BD15;
/// Bytes of its name, noughts at the end.
const NAME_BYTES: usize = 64;
/// Bytes before the pixels: magic, length and name.
const HEAD_BYTES: usize = 8 + NAME_BYTES;
/// Longest that the servers take, everything counted, bytes.
const MOST_BYTES: usize = 12_000_000;
/// An image is sent so long after it was seen: all of its exposures are on disk by then.
const BEFORE: Duration = Duration::from_secs(1);
/// The server's word is waited for so long.
const WORD_WITHIN: Duration = Duration::from_secs(1);
/// Bytes that go at a time.
const SLICE_BYTES: usize = 8192;

/// Sends images to one computer.
pub struct LegacyImages {
    /// Its image server.
    pub server: SocketAddr,
    /// What all sessions share.
    pub shared: Arc<Shared>,
}

impl LegacyImages {
    /// Sends each new image, for ever; the newest, where it is not done with one when others come.
    pub async fn run(self) {
        let mut state = self.shared.state.clone();
        let newest = |state: &super::super::state::State| state.newest_kept.map(|(image, _)| image);
        let mut last = newest(&state.borrow());
        loop {
            let new =
                state.wait_for(|state| state.settings.images.send && state.may_send_images() && newest(state) != last).await;
            let Ok(new) = new.map(|state| newest(&state)) else { return };
            last = new;
            sleep(BEFORE).await;
            let Some(image) = new else { continue };
            if let Err(error) = self.send(image).await {
                tracing::warn!(server = %self.server, image = image.0, %error, "image not sent");
            }
        }
    }

    async fn send(&self, image: ImageCounter) -> io::Result<()> {
        let silence = Duration::from_secs_f64(self.shared.settings.network.silence_s);
        let mut stream = timeout(silence, TcpStream::connect(self.server)).await.map_err(|_| io::ErrorKind::TimedOut)??;
        for exposure in 0..=u8::MAX {
            let Some(packet) = self.packet(image, exposure).await? else { break };
            write(&mut stream, &packet, self.shared.settings.images.rate_bytes_s, silence).await?;
            let word = word(&mut stream).await?;
            if word != Some(0) {
                tracing::warn!(server = %self.server, image = image.0, exposure, word = said(word), "image not stored");
            }
        }
        stream.shutdown().await
    }

    /// An exposure as it goes; `None` where there is no such one.
    async fn packet(&self, image: ImageCounter, exposure: u8) -> io::Result<Option<Vec<u8>>> {
        let gallery = Arc::clone(&self.shared.gallery);
        let leave = gallery.enter().map_err(refused)?;
        let boot_id = self.shared.clock.boot_id();
        let job = tokio::task::spawn_blocking(move || {
            let _leave = leave;
            let key = |exposure| Key { boot_id, image, exposure, form: ImageForm::Raw };
            if exposure > 0 && gallery.file(key(exposure)).is_none() {
                return Ok(None);
            }
            let (frame, path) = gallery.frame(key(exposure)).map_err(refused)?;
            // All are called by the time of the first.
            let base = base_of(&gallery.file(key(0)).unwrap_or(path));
            let name = match frame.stamp.part {
                Some(part) => format!("{base}_p{part}.raw"),
                None => format!("{base}.raw"),
            };
            pack(&frame, &name).map(Some)
        });
        job.await.map_err(io::Error::other)?
    }
}

fn refused((_, words): Refused) -> io::Error {
    io::Error::other(words)
}

/// What the flown program called an image, from the name of its file: its time, `2012-12-30--08-27-56--625`; or all of the name where it has
/// none.
fn base_of(path: &Path) -> String {
    const TIME: usize = "2012-12-30--08-27-56--625".len();
    let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = crate::image::series_stem(&name).map_or(name.as_str(), |(stem, _)| stem);
    let time = stem.get(..TIME).filter(|time| crate::image::time_in_name(time).is_some());
    time.unwrap_or(stem).to_owned()
}

/// Head and pixels of an exposure.
fn pack(frame: &Frame, name: &str) -> io::Result<Vec<u8>> {
    let payload = 2 * frame.pixels.len();
    if payload + HEAD_BYTES > MOST_BYTES {
        return Err(io::Error::other(format!("{payload} bytes of pixels, the servers take {MOST_BYTES}")));
    }
    let mut packet = Vec::with_capacity(HEAD_BYTES + payload);
    packet.extend_from_slice(&MAGIC.to_le_bytes());
    packet.extend_from_slice(&(payload as u32).to_le_bytes());
    packet.extend(name.bytes().take(NAME_BYTES - 1));
    packet.resize(HEAD_BYTES, 0);
    let rows = frame.pixels.chunks(frame.width.max(1));
    let mut put = |row: &[u16]| row.iter().for_each(|pixel| packet.extend_from_slice(&pixel.to_le_bytes()));
    match frame.rows {
        RowOrder::BottomFirst => rows.for_each(&mut put),
        RowOrder::TopFirst => rows.rev().for_each(&mut put),
    }
    Ok(packet)
}

/// Writes in slices, so many bytes in a second.
async fn write(stream: &mut (impl AsyncWrite + Unpin), packet: &[u8], rate_bytes_s: f64, patience: Duration) -> io::Result<()> {
    let mut next = Instant::now();
    for slice in packet.chunks(SLICE_BYTES) {
        sleep_until(next).await;
        timeout(patience, stream.write_all(slice)).await.map_err(|_| io::ErrorKind::TimedOut)??;
        // From when it was due, so that timers which wake late do not add up; but after a link that stood never to catch up on more than one.
        let cost = Duration::from_secs_f64(slice.len() as f64 / rate_bytes_s);
        let now = Instant::now();
        next = next.max(now.checked_sub(cost).unwrap_or(now)) + cost;
    }
    Ok(())
}

/// What the server did with an exposure; `None` where it does not say.
async fn word(stream: &mut (impl AsyncRead + Unpin)) -> io::Result<Option<i32>> {
    let mut bytes = [0; 4];
    match timeout(WORD_WITHIN, stream.read_exact(&mut bytes)).await {
        Ok(read) => read.map(|_| Some(i32::from_le_bytes(bytes))),
        Err(_) => Ok(None),
    }
}

fn said(word: Option<i32>) -> &'static str {
    match word {
        Some(0) => "stored",
        Some(-1) => "incompressible",
        Some(-2) => "out of memory",
        Some(-3) => "disk error",
        Some(_) => "unknown",
        None => "no word",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exposure_goes_bottom_row_first_under_the_name_that_it_would_have_had() {
        let mut frame = Frame::new(2, 2, vec![1, 2, 3, 0x0405], RowOrder::TopFirst).unwrap();
        let packet = pack(&frame, "2012-12-30--08-27-56--625_p1.raw").unwrap();
        assert_eq!(packet[..8], [0x15, 0xBD, 0xED, 0xCD, 8, 0, 0, 0]);
        assert_eq!(&packet[8..8 + 33], b"2012-12-30--08-27-56--625_p1.raw\0");
        assert_eq!(packet[72..], [3, 0, 5, 4, 1, 0, 2, 0]);
        frame.rows = RowOrder::BottomFirst;
        assert_eq!(pack(&frame, &"x".repeat(80)).unwrap()[71..], [0, 1, 0, 2, 0, 3, 0, 5, 4]);
        let large = Frame::new(3000, 2000, vec![0; 6_000_000], RowOrder::BottomFirst).unwrap();
        assert!(pack(&large, "a").unwrap_err().to_string().contains("the servers take"));
    }

    #[test]
    fn the_base_of_a_name_is_its_time() {
        let base = |name: &str| base_of(Path::new(name));
        assert_eq!(base("a/2012-12-30--08-27-56--625-1f00c3a7-00001571.fits"), "2012-12-30--08-27-56--625");
        assert_eq!(base("2012-12-30--08-27-57--125-1f00c3a7-00001572_p0.fits"), "2012-12-30--08-27-57--125");
        assert_eq!(base("unset/unset-1f00c3a7-00001572_p3.fits"), "unset-1f00c3a7-00001572");
    }
}
