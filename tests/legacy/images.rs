//! The image server on a flight computer of old gets each new image, as the program that flew sent them.

use crate::settings;
use crate::support::{PATIENCE, frame, plain_solver, start};
use stars::camera::{CameraError, Moment, Source};
use stars::image::{Frame, Series};
use stars::service::{MakeSource, Parts};
use stars::sky::{ClockQuality, Utc};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::timeout;

/// Image n is a series of n + 1 exposures, or stands alone for n = 0; as many images as the number says by now.
struct Camera(Arc<AtomicU32>);

impl Source for Camera {
    fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
        let image = moment.image.0;
        if image >= self.0.load(Ordering::Relaxed) {
            return Err(CameraError::NothingNew);
        }
        Ok(Series::new((0..=image).map(|exposure| picture(image, exposure)).collect()).unwrap())
    }
}

fn picture(image: u32, exposure: u32) -> Frame {
    let mut picture = frame();
    picture
        .pixels
        .iter_mut()
        .enumerate()
        .for_each(|(place, pixel)| *pixel = (1000 * image + 100 * exposure) as u16 + place as u16);
    let captured = Utc::from_calendar(2012, 12, 30, 8, 27, 56.625 + f64::from(exposure)).unwrap();
    picture.stamp.captured = Some((captured, ClockQuality::FreeRunning));
    picture
}

/// An exposure as it comes: its name and its pixels.
async fn receive(stream: &mut TcpStream) -> Option<(String, Vec<u16>)> {
    let mut head = [0; 72];
    if timeout(PATIENCE, stream.read_exact(&mut head)).await.expect("no exposure came").is_err() {
        return None;
    }
    assert_eq!(head[..4], 0xCDED_BD15_u32.to_le_bytes());
    let mut bytes = vec![0; u32::from_le_bytes(head[4..8].try_into().unwrap()) as usize];
    stream.read_exact(&mut bytes).await.unwrap();
    let name = head[8..].iter().take_while(|byte| **byte != 0).map(|byte| char::from(*byte)).collect();
    Some((name, bytes.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect()))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn its_image_server_gets_each_exposure_of_each_new_image_while_the_other_computer_has_none() {
    let directory = tempfile::tempdir().unwrap();
    let server = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let mut settings = settings();
    settings.record.enabled = true;
    settings.record.images = true;
    settings.record.reserve_gib = 0.0;
    settings.record.directory = directory.path().display().to_string();
    settings.legacy.images = true;
    settings.legacy.images_port = server.local_addr().unwrap().port();
    let allowed = Arc::new(AtomicU32::new(0));
    let counted = Arc::clone(&allowed);
    let camera: MakeSource = Arc::new(move || Ok(Box::new(Camera(Arc::clone(&counted))) as Box<dyn Source>));
    let running = start(settings, Parts { camera: Some(camera), solver: plain_solver(), lens: None }).await;
    let names = [
        vec!["2012-12-30--08-27-56--625.raw"],
        vec!["2012-12-30--08-27-56--625_p0.raw", "2012-12-30--08-27-56--625_p1.raw"],
        vec!["2012-12-30--08-27-56--625_p0.raw", "2012-12-30--08-27-56--625_p1.raw", "2012-12-30--08-27-56--625_p2.raw"],
    ];
    for (image, names) in (0..3).zip(names) {
        allowed.store(image + 1, Ordering::Relaxed);
        let (mut stream, _) = timeout(PATIENCE, server.accept()).await.expect("it does not connect").unwrap();
        for (exposure, name) in (0..).zip(names) {
            let (said, pixels) = receive(&mut stream).await.expect("an exposure is missing");
            assert_eq!((said.as_str(), &pixels), (name, &picture(image, exposure).pixels), "image {image}");
            // Stored, nothing at all, a full disk: the next one comes all the same.
            let answer = [Some(0_i32), None, Some(-3)][exposure as usize];
            if let Some(answer) = answer {
                stream.write_all(&answer.to_le_bytes()).await.unwrap();
            }
        }
        assert!(receive(&mut stream).await.is_none(), "it goes on");
    }
    assert!(running.stop().await.is_empty());
}
