//! Sessions with flight computers that speak the legacy dialect, on a port of their own.
//!
//! Who is who comes from the address. A session writes the newest state 250 ms after the connection was taken and then every
//! 500 ms, on a schedule that stands still, and reads blocks of commands in whatever pieces they come. A computer on stand-by
//! never sends: a session ends when its peer takes nothing more, goes, sends what is no block, or connects anew.

mod answer;
mod orders;

use super::hub::ToHub;
use super::images::LegacyImages;
use super::listener::{keep_session, next_connection};
use super::session::{Closed, Shared};
use super::supervisor::{Ended, panic_message};
use crate::command::FlightComputer;
use crate::service::pulse::Pulse;
use crate::settings::LegacySettings;
use crate::wire::legacy::{BLOCK_BYTES, Block};
use answer::Teller;
use std::io;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::net::TcpListener;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::task::TaskTracker;

/// Time from a connection to the first answer, and from one answer to the next, as they flew.
const FIRST_ANSWER: Duration = Duration::from_millis(250);
const PERIOD: Duration = Duration::from_millis(500);
/// Blocks that may come between two answers: one does, and half a minute's after a link was down.
const FLOOD: u32 = 64;
/// Connections at a time: each of two computers with the one that replaces its old one, and as many again in passing.
const PLACES: usize = 8;

/// The listener of the dialect.
#[derive(Clone)]
pub struct LegacyListener {
    socket: Arc<TcpListener>,
    peers: Arc<[IpAddr]>,
    places: Arc<Semaphore>,
    /// The number of the next connection, of either port.
    next: Arc<AtomicU64>,
    shared: Arc<Shared>,
    tracker: TaskTracker,
}

/// The dialect's own socket, where it is spoken.
///
/// # Errors
/// Where the address cannot be had.
pub fn bind(settings: &LegacySettings, inherited: Option<std::net::TcpListener>) -> io::Result<Option<TcpListener>> {
    if !settings.enabled {
        return Ok(None);
    }
    let socket = inherited.map_or_else(|| std::net::TcpListener::bind(&settings.listen), Ok)?;
    socket.set_nonblocking(true)?;
    TcpListener::from_std(socket).map(Some)
}

impl LegacyListener {
    /// On a bound socket; `next` numbers the connections of both ports.
    pub fn new(socket: TcpListener, next: Arc<AtomicU64>, shared: Arc<Shared>, tracker: TaskTracker) -> Self {
        // The settings room has let only addresses through.
        let peers = shared.settings.legacy.peers.iter().filter_map(|text| text.parse().ok());
        let peers = peers.map(|ip: IpAddr| ip.to_canonical()).collect();
        Self { socket: Arc::new(socket), peers, places: Arc::new(Semaphore::new(PLACES)), next, shared, tracker }
    }

    /// Where it listens.
    pub fn address(&self) -> Option<SocketAddr> {
        self.socket.local_addr().ok()
    }

    /// Takes connections until stopped, and meanwhile sends each computer the images that it is to have.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        tracing::info!(address = ?self.address(), "serving the legacy dialect");
        let settings = &self.shared.settings.legacy;
        let mut images = JoinSet::new();
        for peer in self.peers.iter().filter(|_| settings.images) {
            let server = SocketAddr::new(*peer, settings.images_port);
            images.spawn(LegacyImages { server, shared: Arc::clone(&self.shared) }.run());
        }
        loop {
            tokio::select! {
                biased;
                Some(Err(error)) = images.join_next() => return Err(Ended(panic_message(error))),
                next = next_connection(&self.socket, &self.shared, &pulse) => match next {
                    Some((stream, address)) => self.take(stream, address).await,
                    None => return Ok(()),
                },
            }
        }
    }

    /// Which flight computer has an address.
    fn computer(&self, address: &SocketAddr) -> Option<FlightComputer> {
        let place = self.peers.iter().position(|peer| *peer == address.ip().to_canonical())?;
        u8::try_from(place + 1).ok().map(FlightComputer)
    }

    /// Gives a connection its session, or turns it away by closing it.
    pub async fn take<S: AsyncRead + AsyncWrite + Send + 'static>(&self, stream: S, address: SocketAddr) {
        let connection = self.next.fetch_add(1, Ordering::Relaxed);
        let who = self.computer(&address).ok_or(Closed::AddressNotAllowed);
        let taken = who.and_then(|computer| {
            let place = Arc::clone(&self.places).try_acquire_owned();
            place.map(|place| (computer, place)).map_err(|_| Closed::TooMany)
        });
        let (computer, place) = match taken {
            Ok(taken) => taken,
            Err(why) => {
                tracing::warn!(%address, ?why, "connection turned away");
                self.shared.hub.tell(ToHub::Closed { connection, why }).await;
                return;
            }
        };
        let session = Session { computer, connection, accepted: Instant::now(), shared: Arc::clone(&self.shared) };
        let span = tracing::info_span!("legacy", connection, %address);
        keep_session(&self.tracker, &self.shared, connection, session.run(stream), place, span);
    }
}

/// One connection.
struct Session {
    computer: FlightComputer,
    connection: u64,
    accepted: Instant,
    shared: Arc<Shared>,
}

impl Session {
    /// Runs until the connection ends for whatever reason, and tells the hub of its peer and of its end.
    async fn run<S: AsyncRead + AsyncWrite>(self, stream: S) -> Closed {
        let (computer, connection, hub) = (self.computer, self.connection, &self.shared.hub);
        tracing::info!(computer = computer.0, connection, "flight computer connected");
        hub.tell(ToHub::LegacyConnected { computer, connection }).await;
        let (from, to) = tokio::io::split(stream);
        let mut state = self.shared.state.clone();
        let why = tokio::select! {
            biased;
            () = self.shared.stop.cancelled() => Closed::Stopping,
            _ = state.wait_for(|state| state.has_replaced(computer, connection)) => Closed::Replaced,
            why = self.write(to) => why,
            why = self.read(from) => why,
        };
        hub.tell(ToHub::Closed { connection, why }).await;
        why
    }

    /// Tells the newest state.
    async fn write<W: AsyncWrite>(&self, mut to: WriteHalf<W>) -> Closed {
        let silence = Duration::from_secs_f64(self.shared.settings.network.silence_s);
        let mut schedule = tokio::time::interval_at(self.accepted + FIRST_ANSWER, PERIOD);
        schedule.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut teller = Teller::default();
        loop {
            schedule.tick().await;
            let state = Arc::clone(&self.shared.state.borrow());
            let answer = teller.answer(&state, self.shared.clock.uptime());
            match tokio::time::timeout(silence, to.write_all(&answer)).await {
                Ok(Ok(())) => {}
                Ok(Err(error)) => {
                    tracing::info!(%error, "connection broke");
                    return Closed::ByPeer;
                }
                Err(_) => return Closed::NotReading,
            }
        }
    }

    /// Reads blocks and hands them to the hub. Between blocks a peer may be silent for as long as it likes, within one it may not.
    async fn read<R: AsyncRead>(&self, mut from: ReadHalf<R>) -> Closed {
        let silence = Duration::from_secs_f64(self.shared.settings.network.silence_s);
        let (mut since, mut blocks) = (Instant::now(), 0u32);
        let mut bytes = [0; BLOCK_BYTES];
        loop {
            let began = match from.read(&mut bytes).await {
                Ok(0) => return Closed::ByPeer,
                Ok(count) => count,
                Err(error) => return broke(&error),
            };
            let rest = bytes.get_mut(began..).unwrap_or_default();
            match tokio::time::timeout(silence, from.read_exact(rest)).await {
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return broke(&error),
                Err(_) => {
                    tracing::warn!(began, "a block was not finished");
                    return Closed::Silent;
                }
            }
            let at = Instant::now();
            if at.duration_since(since) > PERIOD {
                (since, blocks) = (at, 0);
            }
            blocks += 1;
            if blocks > FLOOD {
                return Closed::Flood;
            }
            match Block::unpack(&bytes) {
                Ok(block) => {
                    let (computer, connection, block) = (self.computer, self.connection, Box::new(block));
                    self.shared.hub.tell(ToHub::LegacyBlock { computer, connection, block, at }).await;
                }
                Err(error) => {
                    tracing::warn!(%error, "bad block");
                    return Closed::BadMessage;
                }
            }
        }
    }
}

fn broke(error: &io::Error) -> Closed {
    tracing::info!(%error, "connection broke");
    Closed::ByPeer
}
