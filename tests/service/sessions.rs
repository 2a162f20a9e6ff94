//! Promises of the connections: each peer is alone with the camera.

use crate::support::*;
use futures_util::SinkExt;
use stars::service::{Closed, Running, utc_now};
use stars::sky::{ClockQuality, Utc};
use stars::wire::{Clock, Message, PROTOCOL_CURRENT, Refusal, Status};
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::time::Instant;

/// Room for many updates.
const WIDE: usize = 1 << 20;
/// Room for a part of one update.
const NARROW: usize = 64;

async fn closed(running: &Running, why: Closed) -> u32 {
    let mut state = running.state.clone();
    let counted = |state: &stars::service::State| state.counters.closed.get(&why).copied();
    let wanted = state.wait_for(|state| counted(state).is_some());
    let state = tokio::time::timeout(PATIENCE, wanted).await.expect("not counted").unwrap();
    counted(&state).unwrap()
}

#[tokio::test(start_paused = true)]
async fn updates_come_every_half_second_on_a_steady_schedule() {
    let running = start_without_camera(settings()).await;
    let mut peer = Peer::attach(&running, WIDE).await.greet(1).await;
    let first = peer.update().await;
    let began = Instant::now();
    assert_eq!(first.link.sequence.get(), 0);
    for n in 1..=100_u32 {
        peer.status(Status::default()).await;
        // A peer that looks late sees what was sent in time.
        tokio::time::sleep(Duration::from_millis(u64::from(n % 7) * 60)).await;
        let update = peer.update().await;
        assert_eq!(update.link.sequence.get(), n);
        let uptime = Duration::from_secs_f64(update.link.uptime_s - first.link.uptime_s);
        assert_eq!(uptime, Duration::from_millis(500) * n);
    }
    assert!(began.elapsed() < Duration::from_millis(50_500));
}

#[tokio::test(start_paused = true)]
async fn a_silent_peer_is_closed_after_five_seconds_and_the_other_is_served_on() {
    let running = start_without_camera(settings()).await;
    let mut silent = Peer::attach(&running, WIDE).await.greet(1).await;
    let mut other = Peer::attach(&running, WIDE).await.greet(2).await;
    let began = Instant::now();
    let watching = tokio::spawn(async move {
        let word = silent.last_word().await.expect("no last word");
        (word.refusal.get(), began.elapsed())
    });
    let mut last = other.update().await.link.sequence.get();
    for _ in 0..24 {
        other.status(Status::default()).await;
        let update = other.update().await;
        assert_eq!(update.link.sequence.get(), last + 1);
        last += 1;
    }
    let (reason, after) = watching.await.unwrap();
    assert_eq!(reason, Some(Refusal::Silent));
    assert_eq!(after, Duration::from_secs(5));
    assert_eq!(closed(&running, Closed::Silent).await, 1);
}

#[tokio::test(start_paused = true)]
async fn a_peer_that_says_nothing_at_all_is_closed_too() {
    let running = start_without_camera(settings()).await;
    let mut mute = Peer::attach(&running, WIDE).await;
    let began = Instant::now();
    assert_eq!(mute.last_word().await.unwrap().refusal.get(), Some(Refusal::Silent));
    assert_eq!(began.elapsed(), Duration::from_secs(5));
}

#[tokio::test(start_paused = true)]
async fn a_peer_that_does_not_read_is_closed_and_the_other_is_served_on() {
    let running = start_without_camera(settings()).await;
    // It goes on to send its statuses, and never reads.
    let mut deaf = Peer::attach(&running, NARROW).await;
    let talking = tokio::spawn(async move {
        let began = Instant::now();
        let _ = deaf.link.send(&Message::Hello(Box::new(hello(1)))).await;
        while deaf.link.send(&Message::Status(Box::default())).await.is_ok() {
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
        began.elapsed()
    });
    let mut other = Peer::attach(&running, WIDE).await.greet(2).await;
    let mut last = other.update().await.link.sequence.get();
    for _ in 0..24 {
        other.status(Status::default()).await;
        assert_eq!(other.update().await.link.sequence.get(), last + 1);
        last += 1;
    }
    assert_eq!(closed(&running, Closed::NotReading).await, 1);
    assert!(talking.await.unwrap() < Duration::from_secs(7));
}

#[tokio::test(start_paused = true)]
async fn garbage_closes_its_own_connection_alone() {
    let running = start_without_camera(settings()).await;
    let mut bad = Peer::attach(&running, WIDE).await.greet(1).await;
    let mut good = Peer::attach(&running, WIDE).await.greet(2).await;
    let mut frame = bytes::BytesMut::new();
    Message::Status(Box::default()).encode(&mut frame).unwrap();
    let last = frame.len() - 1;
    frame[last] ^= 1;
    bad.link.get_mut().write_all(&frame).await.unwrap();
    assert_eq!(bad.last_word().await.unwrap().refusal.get(), Some(Refusal::BadMessage));
    assert_eq!(closed(&running, Closed::BadMessage).await, 1);
    let update = good.update_where(|update| update.counters.links_refused.get() == 1).await;
    assert!(update.link.sequence.get() < 5);
}

#[tokio::test(start_paused = true)]
async fn endless_noise_is_no_connection() {
    let running = start_without_camera(settings()).await;
    let mut noise = Peer::attach(&running, WIDE).await;
    for _ in 0..20 {
        let _ = noise.link.get_mut().write_all(&[0x55; 4096]).await;
    }
    assert_eq!(closed(&running, Closed::BadMessage).await, 1);
}

#[tokio::test(start_paused = true)]
async fn a_flood_of_good_messages_closes_its_own_connection_alone() {
    let running = start_without_camera(settings()).await;
    let mut flood = Peer::attach(&running, WIDE).await.greet(1).await;
    let mut good = Peer::attach(&running, WIDE).await.greet(2).await;
    for _ in 0..400 {
        let _ = flood.link.send(&Message::Status(Box::default())).await;
    }
    assert_eq!(closed(&running, Closed::Flood).await, 1);
    assert!(good.update().await.link.sequence.get() < 5);
}

#[tokio::test(start_paused = true)]
async fn a_second_connection_of_the_same_computer_replaces_the_first() {
    let running = start_without_camera(settings()).await;
    let mut first = Peer::attach(&running, WIDE).await.greet(1).await;
    first.update().await;
    let mut second = Peer::attach(&running, WIDE).await.greet(1).await;
    assert_eq!(first.last_word().await.unwrap().refusal.get(), Some(Refusal::Replaced));
    assert_eq!(closed(&running, Closed::Replaced).await, 1);
    for _ in 0..4 {
        second.status(Status::default()).await;
        second.update().await;
    }
    let state = running.state.borrow().clone();
    assert_eq!(state.peers.len(), 1, "{:?}", state.peers);
    assert!(state.peers[0].status.is_some());
}

#[tokio::test]
async fn another_version_is_refused_with_the_versions_that_are_spoken() {
    let running = start_without_camera(settings()).await;
    let mut peer = Peer::connect(running.address).await;
    let later = PROTOCOL_CURRENT + 1;
    let theirs = stars::wire::Hello { version_min: later, version_current: later, ..hello(1) };
    peer.send(Message::Hello(Box::new(theirs))).await;
    let refuse = peer.last_word().await.expect("no refusal");
    assert_eq!(refuse.refusal.get(), Some(Refusal::NoCommonVersion));
    assert_eq!(refuse.version_current, PROTOCOL_CURRENT);
    assert_eq!(closed(&running, Closed::Refused).await, 1);
}

#[tokio::test]
async fn every_computer_is_told_how_its_clock_and_the_others_stand_against_the_cameras() {
    let running = start_without_camera(settings()).await;
    let mut ahead = Peer::connect(running.address).await.greet(1).await;
    let mut behind = Peer::connect(running.address).await.greet(2).await;
    // One is set a year wrong; nothing but its offset is to change.
    let year = 365.25 * 86_400.0;
    let says = |offset_s: f64| {
        let unix_s = utc_now().0.unwrap().unix_s() + offset_s;
        Status { clock: Clock::new(Utc::from_unix(unix_s), ClockQuality::FreeRunning), ..claim() }
    };
    for _ in 0..4 {
        ahead.status(says(5.5)).await;
        behind.status(says(-year)).await;
        ahead.update().await;
        behind.update().await;
    }
    for (peer, offset_s) in [(&mut ahead, 5.5), (&mut behind, -year)] {
        peer.status(says(offset_s)).await;
        let clocks = peer.update().await.clocks;
        let told: Vec<_> = clocks.clocks.as_slice().iter().take(clocks.clocks_count.into()).collect();
        assert_eq!(told.iter().map(|clock| clock.flight_computer).collect::<Vec<_>>(), [1, 2]);
        assert!((told[0].offset_s - 5.5).abs() < 0.3 && (told[1].offset_s + year).abs() < 0.3, "{told:?}");
        assert!(told.iter().all(|clock| clock.sigma_s < 0.3 && clock.age_s < 5.0), "{told:?}");
    }
}

#[tokio::test]
async fn a_link_that_breaks_without_a_word_is_replaced_by_the_computers_next_connection() {
    let running = start_without_camera(settings()).await;
    let mut half_open = Peer::connect(running.address).await.greet(1).await;
    half_open.update().await;
    // The computer is reset: its end of the link is silent, and it connects anew.
    let mut again = Peer::connect(running.address).await.greet(1).await;
    again.update().await;
    assert_eq!(half_open.last_word().await.unwrap().refusal.get(), Some(Refusal::Replaced));
    again.update().await;
}

#[tokio::test]
async fn peers_may_vanish_at_any_byte_and_places_are_given_back() {
    let mut settings = settings();
    settings.network.max_connections = 2;
    let running = start_without_camera(settings).await;
    let mut frame = bytes::BytesMut::new();
    Message::Hello(Box::new(hello(1))).encode(&mut frame).unwrap();
    Message::Status(Box::default()).encode(&mut frame).unwrap();
    for length in (0..frame.len()).step_by(7) {
        let mut stream = tokio::net::TcpStream::connect(running.address).await.unwrap();
        let _ = stream.write_all(&frame[..length]).await;
        drop(stream);
        let wanted = (length / 7 + 1) as u32;
        let mut state = running.state.clone();
        let all = state.wait_for(|state| state.counters.closed.values().sum::<u32>() >= wanted);
        drop(tokio::time::timeout(PATIENCE, all).await.expect("an end was not noticed").unwrap());
    }
    assert_eq!(running.state.borrow().counters.closed.get(&Closed::TooMany), None);
    Peer::connect(running.address).await.greet(1).await.update().await;
}

#[tokio::test(start_paused = true)]
async fn more_connections_than_places_are_turned_away() {
    let mut settings = settings();
    settings.network.max_connections = 2;
    let running = start_without_camera(settings).await;
    let mut one = Peer::attach(&running, WIDE).await.greet(1).await;
    let mut two = Peer::attach(&running, WIDE).await.greet(2).await;
    let mut three = Peer::attach(&running, WIDE).await;
    assert!(three.last_word().await.is_none());
    assert_eq!(closed(&running, Closed::TooMany).await, 1);
    one.update().await;
    two.update().await;
}

#[tokio::test(start_paused = true)]
async fn strangers_that_hold_all_places_give_way_to_a_flight_computer() {
    let mut settings = settings();
    settings.network.max_connections = 4;
    let running = start_without_camera(settings).await;
    let mut first = Peer::attach(&running, WIDE).await.greet(1).await;
    let mut strangers = Vec::new();
    for _ in 0..10 {
        strangers.push(Peer::attach(&running, WIDE).await);
    }
    let mut second = Peer::attach(&running, WIDE).await.greet(2).await;
    second.update().await;
    first.update().await;
    // Ten strangers had three places, and one of those went to the computer.
    assert_eq!(closed(&running, Closed::TooMany).await, 8);
    assert!(strangers[0].last_word().await.is_none());
}

#[tokio::test]
async fn an_address_that_connects_again_and_again_is_turned_away_and_no_other_is() {
    let mut settings = settings();
    settings.network.connections_per_s = 5;
    let running = start_without_camera(settings).await;
    let mut first = Peer::connect(running.address).await.greet(1).await;
    for _ in 0..200 {
        drop(tokio::net::TcpStream::connect(running.address).await);
    }
    assert!(closed(&running, Closed::TooOften).await >= 1);
    // Another computer, from an address of its own.
    let socket = tokio::net::TcpSocket::new_v4().unwrap();
    socket.bind("127.0.0.2:0".parse().unwrap()).unwrap();
    let mut second = Peer::over(socket.connect(running.address).await.unwrap()).greet(2).await;
    second.update().await;
    first.update().await;
    tokio::time::sleep(Duration::from_millis(1100)).await;
    Peer::connect(running.address).await.greet(3).await.update().await;
}

#[tokio::test]
async fn an_address_that_may_not_connect_is_turned_away() {
    let mut settings = settings();
    settings.network.peers = vec!["192.0.2.7".to_owned()];
    let running = start_without_camera(settings).await;
    let mut peer = Peer::connect(running.address).await;
    assert!(peer.last_word().await.is_none());
    assert_eq!(closed(&running, Closed::AddressNotAllowed).await, 1);
}

#[tokio::test(start_paused = true)]
async fn the_computer_that_claims_is_in_charge_for_three_seconds_after_its_last_claim() {
    let running = start_without_camera(settings()).await;
    let mut one = Peer::attach(&running, WIDE).await.greet(1).await;
    let mut two = Peer::attach(&running, WIDE).await.greet(2).await;
    two.status(claim()).await;
    let claimed = Instant::now();
    let seen = one.update_where(|update| update.authority.in_charge_id.get().is_some()).await;
    assert_eq!(seen.authority.in_charge_id.get(), Some(&2));
    assert!(!seen.authority.you_are_in_charge);
    two.update().await;
    assert!(two.update().await.authority.you_are_in_charge);
    one.update_where(|update| update.authority.in_charge_id.get().is_none()).await;
    let lapsed = claimed.elapsed();
    assert!(lapsed >= Duration::from_secs(3) && lapsed <= Duration::from_millis(3500), "{lapsed:?}");
}
