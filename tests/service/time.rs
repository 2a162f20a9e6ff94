//! Times: a clock that is set changes nothing but how far the time can be believed, and the best clock at hand stamps the frames.

use crate::support::*;
use stars::service::{Doors, Parts, SimulatedUtc, start_with};
use stars::settings::Settings;
use stars::sky::{ClockQuality, Utc};
use stars::wire::{Clock, Status, Update};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::time::Instant;

const BEGAN_S: f64 = 1_356_998_400.0;
const YEAR_S: f64 = 365.25 * 86_400.0;

/// A service on a clock that can be set, with a camera that dates its frames.
async fn started(settings: Settings) -> (stars::service::Running, &'static SimulatedUtc, Instant) {
    let door = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let utc = SimulatedUtc::begin(BEGAN_S);
    let doors = Doors { utc: Some(utc), ..Doors::from(door) };
    let dated = camera(|moment| {
        let mut frame = frame();
        moment.date(0.0, &mut frame.stamp);
        Ok(frame)
    });
    let parts = Parts { camera: dated, solver: plain_solver(), lens: None };
    (start_with(Arc::new(settings), parts, doors).unwrap(), utc, Instant::now())
}

/// The next update whose image was captured from now on.
async fn next_image<S>(peer: &mut Peer<S>, status: Status) -> Update
where
    S: tokio::io::AsyncRead + tokio::io::AsyncWrite + Unpin,
{
    let began = Instant::now();
    while began.elapsed() < PATIENCE {
        peer.status(status).await;
        let update = peer.update().await;
        let age_s = update.image.get().and_then(|image| image.image_age_s.get().copied());
        if age_s.is_some_and(|age_s| age_s < began.elapsed().as_secs_f64()) {
            return update;
        }
    }
    panic!("no image came");
}

/// How far the image's time is from the truth, s, what it says of itself, and its σ.
fn told(update: &Update, began: Instant) -> (f64, Option<ClockQuality>, Option<f64>) {
    let image = update.image.get().unwrap();
    let captured = began.elapsed().as_secs_f64() - image.image_age_s.get().unwrap();
    let uptime_s = update.times.captured_uptime_s.get().unwrap();
    assert!((uptime_s - captured).abs() < 0.1, "{uptime_s} s by the clock that never jumps, {captured} s are true");
    let off_s = image.captured_unix_s.get().unwrap() - BEGAN_S - captured;
    (off_s, image.captured_quality.value(), update.times.captured_sigma_s.get().copied())
}

#[tokio::test(start_paused = true)]
async fn a_clock_that_jumps_changes_nothing_but_the_quality() {
    let (running, utc, began) = started(settings()).await;
    let mut peer = Peer::attach(&running, 1 << 16).await.greet(1).await;
    utc.follow(ClockQuality::Chrony, Some(1e-3));
    let before = next_image(&mut peer, claim()).await;
    let (off_s, quality, sigma_s) = told(&before, began);
    assert!(off_s.abs() < 0.05, "{off_s} s off");
    assert_eq!((quality, sigma_s), (Some(ClockQuality::Chrony), Some(1e-3)));
    let (mut frames, mut sequence) = (before.counters.frames_taken.get(), before.link.sequence.get());
    for jump_s in [3.0 * YEAR_S, -20.0 * YEAR_S, -0.5, 60.0 * YEAR_S] {
        utc.set(utc.unix_s().map(|unix_s| unix_s + jump_s));
        let since = Instant::now();
        while since.elapsed() < Duration::from_secs(20) {
            peer.status(claim()).await;
            peer.update().await;
        }
        let update = next_image(&mut peer, claim()).await;
        let (off_s, quality, sigma_s) = told(&update, began);
        assert!(off_s.abs() < 0.05, "{off_s} s off after a jump by {jump_s} s");
        assert_eq!(quality, Some(ClockQuality::FreeRunning));
        assert!(sigma_s.is_some_and(|sigma_s| (1e-3..0.01).contains(&sigma_s)), "σ {sigma_s:?}");
        let now = update.counters.frames_taken.get();
        assert!((now - frames) >= 99, "{} frames in 20 s after a jump by {jump_s} s", now - frames);
        assert_eq!(update.counters.frames_skipped.get(), before.counters.frames_skipped.get());
        assert!(update.authority.you_are_in_charge);
        assert!((40..=45).contains(&(update.link.sequence.get() - sequence)), "updates are missing");
        (frames, sequence) = (now, update.link.sequence.get());
    }
    // Right again, and by its reference: as good as before.
    utc.set(Some(BEGAN_S + began.elapsed().as_secs_f64()));
    utc.follow(ClockQuality::Ptp, Some(1e-6));
    let (off_s, quality, sigma_s) = told(&next_image(&mut peer, claim()).await, began);
    assert!(off_s.abs() < 0.05, "{off_s} s off");
    assert_eq!((quality, sigma_s), (Some(ClockQuality::Ptp), Some(1e-6)));
}

#[tokio::test(start_paused = true)]
async fn where_the_computers_own_clock_follows_nothing_a_flight_computers_does_that_is_better() {
    let (running, utc, began) = started(settings()).await;
    let mut peer = Peer::attach(&running, 1 << 16).await.greet(1).await;
    utc.set(None);
    let mut image = None;
    for _ in 0..20 {
        let theirs = Utc::from_unix(BEGAN_S + began.elapsed().as_secs_f64());
        peer.status(Status { clock: Clock::new(theirs, ClockQuality::Synchronised), ..claim() }).await;
        image = Some(peer.update().await);
    }
    let image = image.unwrap();
    let (off_s, quality, sigma_s) = told(&image, began);
    assert!(off_s.abs() < 0.05, "{off_s} s off");
    assert_eq!(quality, Some(ClockQuality::FlightComputer));
    assert!(sigma_s.is_some_and(|sigma_s| sigma_s > 0.0 && sigma_s < 0.1), "σ {sigma_s:?}");
    assert_eq!(image.link.clock.clock_quality.get(), Some(ClockQuality::FlightComputer));
    // One that follows nothing is not taken for it.
    let nobody = Status { clock: Clock::new(Utc::from_unix(BEGAN_S), ClockQuality::FreeRunning), ..claim() };
    let (_, quality, _) = told(&next_image(&mut peer, nobody).await, began);
    assert_ne!(quality, Some(ClockQuality::FlightComputer));
}
