//! Promises of the page: it shows what is true, commands nothing, and holds nobody up, whatever a browser does.

use crate::commands::Ground;
use crate::replay::{camera_of_steps, keeping, patient, written};
use crate::support::*;
use serde_json::Value;
use stars::camera::CameraError;
use stars::catalog::Catalogue;
use stars::image::ImageCounter;
use stars::service::{Actor, Doors, PageSocket, Parts, Running, Shed, Upset, start_with};
use stars::settings::Settings;
use stars::simulate::sky::{Kind, RenderSpec, render};
use stars::wire::Status;
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, DuplexStream};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::{sleep, timeout};

/// Room for a few events.
const EVENTS: usize = 32 * 1024;

/// An answer: status, head, body.
struct Answer {
    status: u16,
    head: BTreeMap<String, String>,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_slice(&self.body).unwrap()
    }

    fn text(&self) -> String {
        String::from_utf8(self.body.clone()).unwrap()
    }
}

async fn with_page(settings: Settings, parts: Parts) -> Running {
    let socket = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let doors = Doors { page: PageSocket::open("127.0.0.1:0"), ..Doors::from(socket) };
    start_with(Arc::new(settings), parts, doors).unwrap()
}

fn plain() -> Parts {
    Parts { camera: plain_camera(), solver: plain_solver(), lens: None }
}

/// Sends bytes, and reads until the other end has no more to say.
async fn ask<S: AsyncRead + AsyncWrite + Unpin>(mut stream: S, request: &[u8]) -> Option<Answer> {
    // Whoever is refused early does not read it all.
    let _ = stream.write_all(request).await;
    let mut bytes = Vec::new();
    let read = timeout(PATIENCE, stream.read_to_end(&mut bytes)).await.expect("no end of the answer");
    if read.is_err() && bytes.is_empty() {
        return None;
    }
    let end = bytes.windows(4).position(|window| window == b"\r\n\r\n")?;
    let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
    let mut lines = head.lines();
    let status = lines.next()?.split(' ').nth(1)?.parse().ok()?;
    let pairs = lines.filter_map(|line| line.split_once(": ")).map(|(name, value)| (name.to_lowercase(), value.to_owned()));
    Some(Answer { status, head: pairs.collect(), body: bytes[end + 4..].to_vec() })
}

async fn get(address: SocketAddr, path: &str) -> Answer {
    let request = format!("GET {path} HTTP/1.1\r\nhost: {address}\r\nconnection: close\r\n\r\n");
    ask(TcpStream::connect(address).await.unwrap(), request.as_bytes()).await.expect("no answer")
}

/// The state, once something holds of it.
async fn state_where(address: SocketAddr, holds: impl Fn(&Value) -> bool) -> Value {
    let look = async {
        loop {
            let state = get(address, "/state").await.json();
            if holds(&state) {
                return state;
            }
            sleep(Duration::from_millis(20)).await;
        }
    };
    timeout(PATIENCE, look).await.expect("it never came to that")
}

/// The images of the events that have come by now, or until `enough` did.
async fn images(stream: &mut DuplexStream, enough: usize) -> Vec<u64> {
    let (mut text, mut images) = (Vec::new(), Vec::new());
    let mut bytes = vec![0; 4096];
    while images.len() < enough {
        let Ok(Ok(count @ 1..)) = timeout(Duration::from_secs(5), stream.read(&mut bytes)).await else { break };
        text.extend_from_slice(&bytes[..count]);
        while let Some(end) = text.windows(2).position(|window| window == b"\n\n") {
            let event = String::from_utf8(text.drain(..end + 2).collect()).unwrap();
            let json = event.lines().find_map(|line| line.strip_prefix("data: "));
            let state: Value = serde_json::from_str(json.expect("an event without a state")).unwrap();
            images.extend(state["frame"]["image"].as_u64());
        }
    }
    images
}

#[tokio::test(flavor = "multi_thread")]
async fn every_route_gives_what_is_true_of_the_last_frame() {
    let running = with_page(settings(), plain()).await;
    let address = running.page.address().unwrap();
    let state = state_where(address, |state| state["frame"]["image"].as_u64() >= Some(2)).await;
    assert_eq!(state["frame"]["reason"], "no_match");
    assert!(state["counters"]["frames_taken"].as_u64() >= Some(3) && state["frame"]["pixels"] == true, "{state}");
    assert_eq!((state["lens"]["focus_counts"].clone(), state["lens"]["focus"].clone()), (Value::Null, "no_lens".into()));
    assert_eq!(state["links"].as_array().unwrap().len(), 2);

    let strip = get(address, "/history.json").await.json();
    let last = strip["frames"].as_array().unwrap().last().unwrap()["image"].as_u64().unwrap();
    let view = get(address, &format!("/frame.json?image={last}")).await.json();
    assert_eq!((view["report"]["image_counter"].as_u64(), view["geometry"]["width"].as_u64()), (Some(last), Some(16)));
    assert!(view["lamps"].as_array().unwrap().iter().any(|lamp| lamp["name"] == "min_matched" && lamp["state"] == "waiting"));

    let raw = get(address, &format!("/frame.raw?image={last}")).await;
    let pixels: Vec<u16> = raw.body.chunks(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
    assert_eq!(pixels, vec![100; 256]);
    assert_eq!((&*raw.head["x-stars-image"], &*raw.head["x-stars-first-row"]), (&*last.to_string(), "bottom"));
    let thin = get(address, &format!("/frame.raw?image={last}&step=5")).await;
    assert_eq!((&*thin.head["x-stars-width"], thin.body.len()), ("4", 4 * 4 * 2));
    let png = get(address, "/frame.png").await;
    assert_eq!(image_size(&png.body).0, 16);

    assert!(get(address, "/text").await.text().contains("no_match"));
    assert_eq!(get(address, "/text?ten=1").await.text().lines().count(), 10);
    assert_eq!(get(address, "/healthz").await.text(), "ok\n");
    for path in ["/", "/mask.html"] {
        let page = get(address, path).await;
        assert!(page.text().starts_with("<!doctype html>"), "{path}");
        assert!(page.head["content-security-policy"].starts_with("default-src 'none'"), "{path}");
    }
}

/// Columns and rows that a PNG file says it has.
fn image_size(bytes: &[u8]) -> (u32, u32) {
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    let word = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
    (word(16), word(20))
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_asked_wrongly_is_refused_and_nothing_is_commanded_through_the_page() {
    let running = with_page(settings(), plain()).await;
    let address = running.page.address().unwrap();
    state_where(address, |state| !state["frame"].is_null()).await;
    for (path, status) in [
        ("/nothing", 404),
        ("/frame.raw?image=4000000000", 404),
        ("/frame.json?image=-1", 400),
        ("/frame.raw?image=99999999999", 400),
        ("/frame.raw?step=x", 400),
        ("/../etc/passwd", 404),
        ("/state/../state", 404),
    ] {
        assert_eq!(get(address, path).await.status, status, "{path}");
    }
    // A step that is none, or wider than the image, gives what there is.
    assert_eq!(get(address, "/frame.raw?step=0").await.body.len(), 512);
    assert_eq!(get(address, "/frame.raw?step=18446744073709551615").await.body.len(), 2);
    let before = Arc::clone(&running.state.borrow());
    for method in ["POST", "PUT", "DELETE", "PATCH"] {
        let request = format!("{method} /state HTTP/1.1\r\nhost: x\r\nconnection: close\r\ncontent-length: 2\r\n\r\n{{}}");
        let answer = ask(TcpStream::connect(address).await.unwrap(), request.as_bytes()).await.unwrap();
        assert_eq!(answer.status, 405, "{method}");
    }
    let mut long = b"GET /state HTTP/1.1\r\nx: ".to_vec();
    long.extend(vec![b'a'; 1 << 20]);
    for nonsense in [&b"\x16\x03\x01\x02\x00\x01\x00"[..], b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", &long] {
        let answer = ask(TcpStream::connect(address).await.unwrap(), nonsense).await;
        assert!(answer.is_none_or(|answer| (400..=505).contains(&answer.status)));
    }
    assert_eq!(get(address, "/healthz").await.status, 200);
    let after = Arc::clone(&running.state.borrow());
    assert_eq!((before.settings_hash, &before.desk.counts), (after.settings_hash, &after.desk.counts));
}

#[tokio::test(start_paused = true)]
async fn a_browser_that_does_not_read_skips_to_the_newest_and_one_that_does_gets_every_frame() {
    let running = start(settings(), plain()).await;
    let open = || {
        let (near, far) = tokio::io::duplex(EVENTS);
        running.page.open(far);
        near
    };
    let (mut slow, mut quick) = (open(), open());
    for stream in [&mut slow, &mut quick] {
        stream.write_all(b"GET /events HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    }
    let reader = tokio::spawn(async move { images(&mut quick, 3000).await });
    sleep(Duration::from_secs(120)).await;
    let newest = u64::from(running.state.borrow().counters.next_image.0);
    assert!(newest > 500, "{newest}");
    // What was in the buffers is old; then comes the newest.
    let seen = images(&mut slow, 60).await;
    let gap = seen.windows(2).map(|pair| pair[1].saturating_sub(pair[0])).max().unwrap();
    assert!(gap > 400 && seen.last() >= Some(&newest), "gap {gap}, {seen:?} of {newest}");
    let seen = reader.await.unwrap();
    let distinct: std::collections::BTreeSet<u64> = seen.into_iter().collect();
    let (first, last) = (*distinct.first().unwrap(), *distinct.last().unwrap());
    assert_eq!(distinct.len() as u64, last - first + 1, "a frame that ended was not told");
}

#[tokio::test(start_paused = true)]
async fn requests_that_are_never_finished_free_their_places_and_updates_stay_on_their_schedule() {
    let mut settings = settings();
    settings.display.max_clients = 4;
    let running = start(settings, plain()).await;
    let mut peer = Peer::attach(&running, 1 << 20).await.greet(1).await;
    let first = peer.update().await;
    let mut idle = Vec::new();
    for _ in 0..50 {
        let (mut near, far) = tokio::io::duplex(EVENTS);
        running.page.open(far);
        // The first four have a place; the others are told that there is none.
        let _ = near.write_all(b"GET /state HTTP/1.1\r\nhost:").await;
        idle.push(near);
    }
    let attempt = || async {
        let (near, far) = tokio::io::duplex(EVENTS);
        running.page.open(far);
        ask(near, b"GET /healthz HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n").await.unwrap().status
    };
    assert_eq!(attempt().await, 503);
    for n in 1..=40_u32 {
        peer.status(Status::default()).await;
        let update = peer.update().await;
        let uptime = Duration::from_secs_f64(update.link.uptime_s - first.link.uptime_s);
        assert_eq!((update.link.sequence.get(), uptime), (n, Duration::from_millis(500) * n));
    }
    assert_eq!(attempt().await, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn the_grounds_display_commands_are_in_the_state_that_the_page_obeys() {
    let running = with_page(settings(), plain()).await;
    let address = running.page.address().unwrap();
    let mut ground = Ground::of(&running, 1, true);
    ground.run("display.set_zoom 160 120 2.5").await;
    ground.run("display.configure 5 1 1 0 2").await;
    ground.run("focus.set_display on").await;
    let state = get(address, "/state").await.json();
    let look = &state["look"];
    assert_eq!((look["zoom"].as_f64(), &look["zoom_at"]), (Some(2.5), &serde_json::json!([0.25, 0.75])));
    assert_eq!((look["rate_hz"].as_f64(), look["brightness"].as_f64()), (Some(5.0), Some(2.0)));
    assert_eq!((&look["full_screen"], &look["image_only"], &look["requirements"]), (&true.into(), &true.into(), &false.into()));
    assert_eq!((&look["focus"], &state["focus"]["shown"]), (&"on".into(), &true.into()));
    let last = &state["commands"]["last"][0];
    assert_eq!(
        (&last["name"], &last["stage"], last["computer"].as_u64()),
        (&"focus.set_display".into(), &"completed".into(), Some(1))
    );
    assert_eq!(state["charge"]["computer"].as_u64(), Some(1));
    ground.run("service.known_good").await;
    assert_eq!(get(address, "/state").await.json()["look"]["zoom"].as_f64(), Some(1.0));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_display_that_breaks_is_started_again_and_nothing_else_notices() {
    let running = with_page(settings(), plain()).await;
    let address = running.page.address().unwrap();
    state_where(address, |state| !state["frame"].is_null()).await;
    running.upset(Actor::Display, Upset::Panics);
    let state = state_where(address, |state| !state["restarts"].as_array().unwrap().is_empty()).await;
    assert_eq!((&state["restarts"][0]["actor"], state["restarts"].as_array().unwrap().len()), (&"display".into(), 1));
    let image = state["frame"]["image"].as_u64();
    state_where(address, |state| state["frame"]["image"].as_u64() > image).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_that_another_program_has_is_taken_once_it_is_free_and_the_service_flies_meanwhile() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap();
    let socket = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let doors = Doors { page: PageSocket::open(&address.to_string()), ..Doors::from(socket) };
    let running = start_with(Arc::new(settings()), plain(), doors).unwrap();
    assert_eq!(running.page.address(), None);
    let mut state = running.state.clone();
    timeout(PATIENCE, state.wait_for(|state| state.counters.next_image > ImageCounter(2))).await.unwrap().unwrap();
    drop(taken);
    let appears = async {
        while running.page.address().is_none() {
            sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, appears).await.expect("it is not taken");
    assert_eq!(get(address, "/healthz").await.status, 200);
    assert!(running.state.borrow().restarts.is_empty());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_terminal_shows_the_state_as_a_page_or_as_ten_lines_and_says_where_nobody_answers() {
    let running = with_page(settings(), plain()).await;
    let address = running.page.address().unwrap();
    state_where(address, |state| !state["frame"].is_null()).await;
    let watch = |arguments: Vec<String>| async {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_stars"));
        command.args(["watch", "--once"]).args(arguments);
        tokio::task::spawn_blocking(move || command.output().unwrap()).await.unwrap()
    };
    let page = watch(vec!["--connect".to_owned(), address.to_string()]).await;
    let said = String::from_utf8(page.stdout).unwrap();
    assert!(page.status.success() && said.contains("no_match") && said.contains("Only flight computers command"), "{said}");
    let ten = watch(vec!["--ten".to_owned(), "--connect".to_owned(), address.to_string()]).await;
    assert_eq!(String::from_utf8(ten.stdout).unwrap().lines().count(), 10);
    running.stop().await;
    let nobody = watch(vec!["--connect".to_owned(), address.to_string()]).await;
    let said = String::from_utf8(nobody.stderr).unwrap();
    assert!(nobody.status.code() == Some(1) && said.contains("no service answers there"), "{said}");
}

/// A service that keeps what it does, after two rendered frames.
async fn after_two_frames(directory: &std::path::Path) -> Running {
    let catalogue = Catalogue::embedded().unwrap();
    let frames: Vec<_> = (0..2).map(|seed| render(&RenderSpec::new(Kind::Float, 5, seed), &catalogue).unwrap().frame).collect();
    let allowed = Arc::new(AtomicU32::new(0));
    let next = Arc::clone(&allowed);
    let camera = camera(move |moment| match frames.get(moment.image.0 as usize) {
        Some(frame) if moment.image.0 < next.load(Ordering::Relaxed) => Ok(frame.clone()),
        _ => Err(CameraError::NothingNew),
    });
    let settings = keeping(directory);
    let parts = Parts { camera, ..Parts::of(&Arc::new(settings.clone())).unwrap() };
    let running = with_page(settings, parts).await;
    // None takes the place of another.
    state_where(running.page.address().unwrap(), |state| state["solver"] == "ready").await;
    for count in 1..=2 {
        allowed.store(count, Ordering::Relaxed);
        written(&running, count as usize).await;
    }
    running
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_page_is_told_what_other_settings_would_have_given_and_what_is_wrong_with_a_wish() {
    let directory = tempfile::tempdir().unwrap();
    let running = after_two_frames(directory.path()).await;
    let address = running.page.address().unwrap();
    let before = running.state.borrow().settings_hash;

    let same = get(address, "/replay?image=1").await;
    assert_eq!((same.status, same.text().contains("no difference")), (200, true), "{}", same.text());
    let all = get(address, "/replay").await.text();
    assert!(all.contains("image 0  solved") && all.contains("image 1  solved"), "{all}");
    assert!(all.contains("2 frames: 0 differ, 2 do not, 0 could not be solved again; 2 were solved then and 2 now"), "{all}");

    let fewer = get(address, "/replay?image=1&set=solver.sources.snr_threshold%3D3").await;
    let said = fewer.text();
    for words in ["with solver.sources.snr_threshold=3", "then     solved", "now      ", "σ ", "in boresight", "differs  in "] {
        assert!(fewer.status == 200 && said.contains(words), "{words}: {said}");
    }
    let none = get(address, "/replay?set=solver.sources.snr_threshold%3D100").await.text();
    assert!(none.contains("too_few_sources: ") && none.contains("2 were solved then and 0 now"), "{none}");

    let long = format!("/replay?set=a%3D{}", "1".repeat(2000));
    let many = format!("/replay?{}", "set=solver.robust%3Dfalse&".repeat(40));
    for (path, status, words) in [
        ("/replay?image=1&set=solver.sources.snr_treshold%3D4", 400, "solver.sources.snr_treshold"),
        ("/replay?image=1&set=solver.sources.snr_threshold%3D-4", 400, "solver.sources.snr_threshold"),
        ("/replay?image=1&set=", 400, "not of the form"),
        ("/replay?image=7", 404, "image 7 is not written down"),
        ("/replay?image=seven", 400, "seven"),
        ("/replay?image=4294967296", 400, "4294967296"),
        ("/replay?picture=1", 400, "picture"),
        (&long, 400, "bytes"),
        (&many, 400, "at most"),
    ] {
        let answer = get(address, path).await;
        assert_eq!((answer.status, answer.text().contains(words)), (status, true), "{path}: {}", answer.text());
        assert_eq!(answer.head["content-type"], "text/plain; charset=utf-8", "{path}");
    }
    std::fs::remove_dir_all(directory.path().join("images")).unwrap();
    let gone = get(address, "/replay?image=1").await;
    assert_eq!((gone.status, gone.text().contains("its image is not there")), (404, true), "{}", gone.text());
    assert_eq!(running.state.borrow().settings_hash, before, "what flies is as it was");
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_asks_at_a_time_and_whoever_goes_away_leaves_nothing_behind() {
    let directory = tempfile::tempdir().unwrap();
    let (allowed, slow) = (Arc::new(AtomicU32::new(1)), Arc::new(AtomicU32::new(0)));
    let parts = Parts { camera: camera_of_steps(&allowed, 1000), solver: patient(&slow), lens: None };
    let running = with_page(keeping(directory.path()), parts).await;
    let address = running.page.address().unwrap();
    assert_eq!(get(address, "/replay").await.status, 404, "before the first frame is written down");
    written(&running, 1).await;
    // A minute and a half, if it were let.
    slow.store(90, Ordering::Relaxed);
    let mut first = TcpStream::connect(address).await.unwrap();
    first.write_all(b"GET /replay HTTP/1.1\r\nhost: x\r\n\r\n").await.unwrap();
    sleep(Duration::from_millis(500)).await;
    let second = get(address, "/replay").await;
    assert_eq!((second.status, second.head.contains_key("retry-after")), (503, true), "{}", second.text());
    slow.store(1, Ordering::Relaxed);
    drop(first);
    let taken = async {
        while get(address, "/replay").await.status != 200 {
            sleep(Duration::from_millis(50)).await;
        }
    };
    timeout(PATIENCE, taken).await.expect("the first one's place is never free");
    running.stop().await;
}

#[tokio::test]
async fn a_computer_without_time_for_all_of_its_work_does_no_replay_and_says_when_to_ask_again() {
    let directory = tempfile::tempdir().unwrap();
    let parts = Parts { camera: camera_of_steps(&Arc::new(AtomicU32::new(2)), 1), solver: patient(&Arc::default()), lens: None };
    let mut settings = keeping(directory.path());
    settings.network.update_period_s = 0.1;
    let running = with_page(settings, parts).await;
    let address = running.page.address().unwrap();
    written(&running, 2).await;
    assert_eq!(get(address, "/replay").await.status, 200);
    let mut peer = Peer::attach(&running, 1 << 16).await.greet(1).await;
    // All that runs here shares one thread, which is held up until updates are late.
    while running.state.borrow().strain.shed() < Shed::Display {
        std::thread::sleep(Duration::from_millis(150));
        peer.status(Status::default()).await;
        peer.update().await;
    }
    let refused = get(address, "/replay").await;
    let words = refused.text();
    assert_eq!((refused.status, refused.head["retry-after"].as_str()), (503, "5"), "{words}");
    assert!(words.contains("too slow for all of its work"), "{words}");
    running.stop().await;
}
