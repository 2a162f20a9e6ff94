//! Promises of the images for flight computers: they arrive as they are kept, go on after a break, and no update waits for them.

use crate::commands::Ground;
use crate::support::*;
use futures_util::StreamExt;
use stars::command::Stage;
use stars::image::Frame;
use stars::image::view::{Assembly, MOST_PIXELS, packets_in};
use stars::service::{Closed, Parts, Running, State};
use stars::settings::Settings;
use stars::sky::RowOrder;
use stars::wire::{CHUNK_BYTES, ImageChunk, ImageForm, ImageRefusal, ImageRequest, Message, NoImage, Status, Update, Wanted};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::time::Instant;

/// As fast as the settings allow.
const FAST: u32 = u32::MAX;

/// A picture of some 200 kB, another for each image: noise, and some spots.
fn picture(image: u32) -> Frame {
    let (width, height) = (400usize, 256usize);
    let noise = |place: usize| (place as u32).wrapping_mul(2_654_435_761).wrapping_add(image.wrapping_mul(97)) >> 26;
    let mut pixels: Vec<u16> = (0..width * height).map(|place| 1000 + noise(place) as u16).collect();
    for spot in 0..6 {
        let (x, y) = (40 + 60 * spot, 30 + 35 * spot);
        for (dx, dy, light) in [(0, 0, 3000), (1, 0, 1500), (0, 1, 1500), (1, 1, 800), (2, 0, 300), (0, 2, 300)] {
            pixels[(y + dy) * width + x + dx] += light;
        }
    }
    Frame::new(width, height, pixels, RowOrder::BottomFirst).unwrap()
}

/// Keeps images, as many as the number says by now, and sends them quickly.
async fn keeping(directory: &Path, allowed: &Arc<AtomicU32>) -> Running {
    keeping_with(directory, allowed, |_| ()).await
}

async fn keeping_with(directory: &Path, allowed: &Arc<AtomicU32>, change: impl FnOnce(&mut Settings)) -> Running {
    let mut settings = settings();
    settings.camera.period_s = 0.05;
    settings.record.enabled = true;
    settings.record.images = true;
    settings.record.reserve_gib = 0.0;
    settings.record.directory = directory.display().to_string();
    settings.images.rate_bytes_s = 1e6;
    change(&mut settings);
    let allowed = Arc::clone(allowed);
    let camera = camera(move |moment| match moment.image.0 {
        image if image < allowed.load(Ordering::Relaxed) => Ok(picture(image)),
        _ => Err(stars::camera::CameraError::NothingNew),
    });
    start(settings, Parts { camera, solver: plain_solver(), lens: None }).await
}

async fn until(running: &Running, wanted: impl FnMut(&Arc<State>) -> bool) {
    let mut state = running.state.clone();
    tokio::time::timeout(PATIENCE, state.wait_for(wanted)).await.expect("it never came").unwrap();
}

async fn kept(running: &Running, image: u32) {
    until(running, |state| state.newest_kept.is_some_and(|(newest, _)| newest.0 >= image)).await;
}

/// The file of an image.
fn file(directory: &Path, image: u32) -> PathBuf {
    let days = std::fs::read_dir(directory.join("images")).unwrap();
    let mut files = days.flat_map(|day| std::fs::read_dir(day.unwrap().path()).unwrap()).map(|file| file.unwrap().path());
    files.find(|path| path.to_string_lossy().ends_with(&format!("{image:08}.fits"))).expect("it is not kept")
}

fn request(image: u32, form: ImageForm, offset: usize) -> ImageRequest {
    ImageRequest {
        request: (offset as u32 ^ 0x5A).into(),
        wanted: Wanted::Image.into(),
        image_counter: Some(image).into(),
        form: form.into(),
        offset: (offset as u32).into(),
        rate_bytes_s: FAST.into(),
        ..ImageRequest::default()
    }
}

/// A flight computer that fetches, sends its status meanwhile, and notes when updates come.
struct Fetcher {
    peer: Peer<TcpStream>,
    next_status: Instant,
    updates: Vec<(Instant, Box<Update>)>,
}

impl Fetcher {
    async fn connect(running: &Running, id: u8) -> Self {
        let peer = Peer::connect(running.address).await.greet(id).await;
        Self { peer, next_status: Instant::now(), updates: Vec::new() }
    }

    /// The answer to a request.
    async fn ask(&mut self, request: ImageRequest) -> Result<Box<ImageChunk>, Box<ImageRefusal>> {
        self.peer.send(Message::ImageRequest(Box::new(request))).await;
        let answer = self.answer().await;
        let number = answer.as_ref().map_or_else(|refusal| refusal.request, |chunk| chunk.request);
        assert_eq!(number, request.request, "the answer to another request");
        answer
    }

    async fn answer(&mut self) -> Result<Box<ImageChunk>, Box<ImageRefusal>> {
        let began = Instant::now();
        while began.elapsed() < PATIENCE {
            tokio::select! {
                () = tokio::time::sleep_until(self.next_status) => {
                    self.peer.status(Status::default()).await;
                    self.next_status = Instant::now() + Duration::from_millis(400);
                }
                next = self.peer.link.next() => match next.expect("the connection ended").unwrap() {
                    Message::ImageChunk(chunk) => return Ok(chunk),
                    Message::ImageRefusal(refusal) => return Err(refusal),
                    Message::Update(update) => self.updates.push((Instant::now(), update)),
                    other => panic!("{other:?}"),
                },
            }
        }
        panic!("no answer");
    }

    /// Why there is none.
    async fn refused(&mut self, request: ImageRequest) -> (NoImage, String) {
        let refusal = self.ask(request).await.expect_err("an image came");
        (refusal.no_image.get().unwrap(), refusal.words.to_string())
    }

    /// An image from a byte on.
    async fn fetch(&mut self, image: u32, form: ImageForm, from: &[u8]) -> Vec<u8> {
        let mut bytes = from.to_vec();
        loop {
            let chunk = self.ask(request(image, form, bytes.len())).await.unwrap();
            assert_eq!((chunk.image_counter.get(), chunk.offset.get() as usize), (image, bytes.len()));
            bytes.extend_from_slice(chunk.bytes());
            if bytes.len() >= chunk.total_bytes.get() as usize {
                assert_eq!(crc32fast::hash(&bytes), chunk.file_crc32.get());
                return bytes;
            }
            assert_eq!(chunk.bytes().len(), CHUNK_BYTES);
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_raw_image_arrives_byte_for_byte_and_goes_on_after_a_break() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(2)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 1).await;
    let wanted = std::fs::read(file(directory.path(), 1)).unwrap();
    let mut fetcher = Fetcher::connect(&running, 1).await;
    assert_eq!(fetcher.fetch(1, ImageForm::Raw, &[]).await, wanted);
    // Broken in the middle: a request is under way.
    let mut bytes = Vec::new();
    let (mut crc32, mut boot) = (0, 0);
    while bytes.len() < wanted.len() / 2 {
        let chunk = fetcher.ask(request(1, ImageForm::Raw, bytes.len())).await.unwrap();
        (crc32, boot) = (chunk.file_crc32.get(), chunk.camera_boot_id.get());
        bytes.extend_from_slice(chunk.bytes());
    }
    fetcher.peer.send(Message::ImageRequest(Box::new(request(1, ImageForm::Raw, bytes.len())))).await;
    drop(fetcher);
    let mut fetcher = Fetcher::connect(&running, 1).await;
    let resumed = |offset| ImageRequest {
        camera_boot_id: Some(boot).into(),
        begun_crc32: Some(crc32).into(),
        ..request(1, ImageForm::Raw, offset)
    };
    while bytes.len() < wanted.len() {
        bytes.extend_from_slice(fetcher.ask(resumed(bytes.len())).await.unwrap().bytes());
    }
    assert_eq!(bytes, wanted);
    // Another file under its name.
    let (why, words) = fetcher.refused(ImageRequest { begun_crc32: Some(crc32 ^ 1).into(), ..resumed(0) }).await;
    assert_eq!(why, NoImage::Changed, "{words}");
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_view_has_stars_in_its_first_chunk_and_is_exact_at_its_end() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(1)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 0).await;
    let mut fetcher = Fetcher::connect(&running, 2).await;
    let newest = ImageRequest { wanted: Wanted::Newest.into(), ..request(0, ImageForm::View, 0) };
    let first = fetcher.ask(newest).await.unwrap();
    let mut assembly = Assembly::new(None, MOST_PIXELS);
    packets_in(first.bytes()).for_each(|packet| assert!(assembly.take(packet).is_ok()));
    let sources = assembly.sources();
    for spot in 0..6 {
        let (x, y) = (40.0 + 60.0 * f64::from(spot), 30.0 + 35.0 * f64::from(spot));
        assert!(sources.iter().any(|source| (source.x - x).hypot(source.y - y) < 2.0), "{spot}: {sources:?}");
    }
    assert!(assembly.thumbnail().is_some());
    let bytes = fetcher.fetch(0, ImageForm::View, &[]).await;
    assert!(bytes.starts_with(first.bytes()));
    packets_in(&bytes).for_each(|packet| assert!(assembly.take(packet).is_ok()));
    assert!(assembly.is_exact());
    assert_eq!(assembly.picture().unwrap().pixels, picture(0).pixels);
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn requests_that_cannot_be_met_are_refused_in_words_and_the_next_one_is_met() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(0)));
    let running = keeping(directory.path(), &allowed).await;
    let mut fetcher = Fetcher::connect(&running, 1).await;
    let raw = |image, offset| request(image, ImageForm::Raw, offset);
    let newest = ImageRequest { wanted: Wanted::Newest.into(), ..raw(0, 0) };
    assert_eq!(fetcher.refused(newest).await, (NoImage::NeverWas, "no image has been kept yet".to_owned()));
    allowed.store(3, Ordering::Relaxed);
    kept(&running, 2).await;
    let length = std::fs::metadata(file(directory.path(), 2)).unwrap().len() as usize;
    let thinned = file(directory.path(), 0);
    std::fs::remove_file(thinned).unwrap();
    let cases = [
        (raw(3, 0), NoImage::NeverWas, "there is no image 3 yet, the next is 3"),
        (raw(u32::MAX, 0), NoImage::NeverWas, "there is no image 4294967295 yet"),
        (raw(0, 0), NoImage::NotKept, "image 0 is not on disk: it went to make room"),
        (ImageRequest { exposure: 3, ..raw(2, 0) }, NoImage::NotKept, "image 2 has 1 exposures on disk, none with number 3"),
        (ImageRequest { camera_boot_id: Some(5_u32).into(), ..raw(2, 0) }, NoImage::NotKept, "not on disk"),
        (raw(2, length), NoImage::Offset, "of image 2, which has"),
        (raw(2, u32::MAX as usize), NoImage::Offset, "byte 4294967295 of image 2"),
        (ImageRequest { rate_bytes_s: 0.into(), ..raw(2, 0) }, NoImage::Rate, "would never end"),
        (
            ImageRequest { image_counter: None::<u32>.into(), ..raw(2, 0) },
            NoImage::NoNumber,
            "the number of the image is missing",
        ),
        (ImageRequest { begun_crc32: Some(7_u32).into(), ..raw(2, 0) }, NoImage::Changed, "another file now"),
    ];
    for (request, why, words) in cases {
        let (refused, said) = fetcher.refused(request).await;
        assert_eq!(refused, why, "{said}");
        assert!(said.contains(words), "{said}");
    }
    let last = fetcher.ask(raw(2, length - 1)).await.unwrap();
    assert_eq!(last.bytes().len(), 1);
    // What is open may go meanwhile: it is sent to its end all the same, and then not again.
    let wanted = std::fs::read(file(directory.path(), 2)).unwrap();
    std::fs::remove_file(file(directory.path(), 2)).unwrap();
    assert_eq!(fetcher.fetch(2, ImageForm::Raw, &wanted[..1000]).await, wanted);
    fetcher.ask(raw(1, 0)).await.unwrap();
    assert_eq!(fetcher.refused(raw(2, 0)).await.0, NoImage::NotKept);
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_asks_again_and_again_without_waiting_floods_and_an_old_version_has_no_images() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(1)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 0).await;
    let mut flood = Peer::connect(running.address).await.greet(1).await;
    for _ in 0..2000 {
        if futures_util::SinkExt::send(&mut flood.link, &Message::ImageRequest(Box::new(request(0, ImageForm::Raw, 0))))
            .await
            .is_err()
        {
            break;
        }
    }
    until(&running, |state| state.counters.closed.contains_key(&Closed::Flood)).await;
    let mut old = Peer::connect(running.address).await;
    let hello = stars::wire::Hello { version_current: 2, ..hello(2) };
    old.send(Message::Hello(Box::new(hello))).await;
    assert!(matches!(old.see().await, Seen::Hello(_)));
    old.send(Message::ImageRequest(Box::new(request(0, ImageForm::Raw, 0)))).await;
    until(&running, |state| state.counters.closed.contains_key(&Closed::BadMessage)).await;
    assert!(running.stop().await.is_empty());
}

/// Time is paused, so that each update is due at an instant: with chunks between them none comes a moment later.
#[tokio::test(start_paused = true)]
async fn chunks_between_updates_keep_to_their_rate_and_delay_none_of_them() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(1)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 0).await;
    let mut peer = Peer::attach(&running, 1 << 16).await.greet(1).await;
    let first = peer.update().await.link.uptime_s;
    let (rate, mut got, mut updates, began) = (20_000_u32, 0usize, 0u32, Instant::now());
    let slow = |offset| {
        Message::ImageRequest(Box::new(ImageRequest { rate_bytes_s: rate.into(), ..request(0, ImageForm::Raw, offset) }))
    };
    peer.send(slow(0)).await;
    while updates < 8 {
        match peer.link.next().await.unwrap().unwrap() {
            Message::Update(update) => {
                updates += 1;
                let due = 0.5 * f64::from(updates);
                assert!((update.link.uptime_s - first - due).abs() < 0.002, "{} instead of {due}", update.link.uptime_s - first);
                peer.status(Status::default()).await;
            }
            Message::ImageChunk(chunk) => {
                let since_due = began.elapsed().as_millis() % 500;
                assert!(since_due < 485, "a chunk {since_due} ms after the last update was due");
                got += chunk.bytes().len();
                peer.send(slow(got)).await;
            }
            other => panic!("{other:?}"),
        }
    }
    let most = f64::from(rate) * began.elapsed().as_secs_f64() + 2.0 * CHUNK_BYTES as f64;
    assert!(got as f64 <= most && got as f64 > 0.7 * most, "{got} bytes, at most {most}");
}

#[tokio::test(start_paused = true)]
async fn a_request_that_comes_right_behind_the_hello_is_answered() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(1)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 0).await;
    let mut peer = Peer::attach(&running, 1 << 16).await;
    peer.send(Message::Hello(Box::new(hello(1)))).await;
    peer.send(Message::ImageRequest(Box::new(request(0, ImageForm::Raw, 0)))).await;
    loop {
        match peer.link.next().await.expect("it was closed").unwrap() {
            Message::ImageChunk(chunk) => break assert_eq!(chunk.bytes().len(), CHUNK_BYTES),
            Message::Hello(_) | Message::Update(_) => {}
            other => panic!("{other:?}"),
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_reader_that_is_slow_has_one_chunk_under_way_and_neither_its_updates_nor_the_others_wait() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(1)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 0).await;
    let mut slow = Fetcher::connect(&running, 1).await;
    let mut quick = Fetcher::connect(&running, 2).await;
    let quickly = tokio::spawn(async move {
        while quick.updates.len() < 8 {
            quick.fetch(0, ImageForm::Raw, &[]).await;
        }
        quick.updates
    });
    // It takes a quarter of a second over each piece, and has no more than that waiting: what it then finds is as new as it can be.
    let mut offset = 0;
    for _ in 0..16 {
        let chunk = slow.ask(request(0, ImageForm::Raw, offset)).await.unwrap();
        offset += chunk.bytes().len();
        tokio::time::sleep(Duration::from_millis(250)).await;
    }
    let sequences =
        |updates: &[(Instant, Box<Update>)]| updates.iter().map(|(_, update)| update.link.sequence.get()).collect::<Vec<_>>();
    let in_order = |count: usize| (0..count as u32).collect::<Vec<_>>();
    assert_eq!(sequences(&slow.updates), in_order(slow.updates.len()));
    assert!(slow.updates.len() >= 7, "{} updates in four seconds", slow.updates.len());
    let others = quickly.await.unwrap();
    assert_eq!(sequences(&others), in_order(others.len()));
    assert_eq!(running.state.borrow().counters.closed.get(&Closed::NotReading), None);
    assert!(running.stop().await.is_empty());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn each_new_image_goes_to_who_waits_for_the_next_unless_the_ground_has_it_off() {
    let (directory, allowed) = (tempfile::tempdir().unwrap(), Arc::new(AtomicU32::new(1)));
    let running = keeping(directory.path(), &allowed).await;
    kept(&running, 0).await;
    let mut ground = Ground::of(&running, 1, true);
    let mut fetcher = Fetcher::connect(&running, 2).await;
    let next = |after: Option<u32>| ImageRequest {
        wanted: Wanted::Next.into(),
        image_counter: after.into(),
        ..request(0, ImageForm::Raw, 0)
    };
    // What is there already is not new.
    fetcher.peer.send(Message::ImageRequest(Box::new(next(None)))).await;
    until(&running, |state| state.peers.len() == 2).await;
    allowed.store(2, Ordering::Relaxed);
    assert_eq!(fetcher.answer().await.unwrap().image_counter.get(), 1);
    let (stages, reply) = ground.run("images.send 0").await;
    assert_eq!(stages.last(), Some(&Stage::Completed), "{reply:?}");
    fetcher.peer.send(Message::ImageRequest(Box::new(next(Some(1))))).await;
    allowed.store(3, Ordering::Relaxed);
    kept(&running, 2).await;
    // An answer to it would come first, and is that to another request.
    assert_eq!(fetcher.ask(request(2, ImageForm::Raw, 2048)).await.unwrap().image_counter.get(), 2);
    fetcher.peer.send(Message::ImageRequest(Box::new(next(Some(1))))).await;
    ground.run("images.send 1").await;
    assert_eq!(fetcher.answer().await.unwrap().image_counter.get(), 2);
    // To who knows the images of an earlier start all of this one are new.
    let of_before = ImageRequest { camera_boot_id: Some(1_u32).into(), ..next(Some(900)) };
    assert_eq!(fetcher.ask(of_before).await.unwrap().image_counter.get(), 2);
    assert!(running.stop().await.is_empty());
}
