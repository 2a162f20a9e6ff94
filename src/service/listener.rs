//! The listener: takes connections and gives each a session of its own.

use super::hub::ToHub;
use super::manager::LinkName;
use super::pulse::Pulse;
use super::session::{Closed, Session, Shared};
use super::supervisor::{Ended, panic_message};
use socket2::{SockRef, TcpKeepalive};
use std::io;
use std::net::{IpAddr, Shutdown, SocketAddr};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::Instant;
use tokio_util::task::TaskTracker;
use tracing::{Instrument, Span};

/// Pauses after an error of `accept`, such as too many open files: from the first to the longest.
const PAUSES: (Duration, Duration) = (Duration::from_millis(10), Duration::from_secs(1));
/// Bytes that may wait in the kernel for a peer that does not read: a handful of updates, as older ones are of no use.
const SEND_BUFFER: usize = 32 * 1024;
/// A stranger that is to give way does so at once; the longest that other connections may wait for that.
const GIVES_WAY_WITHIN: Duration = Duration::from_millis(100);
/// Keepalive probes, for a link that broke without a word: first after 2 s, then every second, lost after three.
const KEEPALIVE: (Duration, Duration, u32) = (Duration::from_secs(2), Duration::from_secs(1), 3);

/// The listener's actor.
#[derive(Clone)]
pub struct Listener {
    /// The bound socket.
    pub socket: Arc<TcpListener>,
    /// Addresses that may connect; empty for any.
    pub allowed: Arc<[IpAddr]>,
    /// Places for connections.
    pub places: Arc<Semaphore>,
    /// The number of the next connection.
    pub next: Arc<AtomicU64>,
    /// What the sessions share.
    pub shared: Arc<Shared>,
    /// Where sessions run.
    pub tracker: TaskTracker,
}

impl Listener {
    /// Takes connections until stopped.
    pub async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        while let Some((stream, address)) = next_connection(&self.socket, &self.shared, &pulse).await {
            let socket = stream.as_fd().try_clone_to_owned().ok();
            self.take(stream, address, socket).await;
        }
        Ok(())
    }

    /// Goes on with a connection that an earlier run of the program left open.
    pub fn resume(&self, link: LinkName, stream: std::net::TcpStream) {
        let resumed = stream.peer_addr().and_then(|address| Ok((address, TcpStream::from_std(stream)?)));
        let place = Arc::clone(&self.places).try_acquire_owned();
        let ((address, stream), place) = match (resumed, place) {
            (Ok(resumed), Ok(place)) => (resumed, place),
            (Err(error), _) => {
                tracing::info!(%link, %error, "a connection of an earlier run has ended");
                return self.shared.manager.forget_link(link);
            }
            (Ok((_, stream)), Err(_)) => {
                tracing::warn!(%link, "there is no place for a connection of an earlier run");
                // The service manager's copy would keep it open.
                let _ = SockRef::from(&stream).shutdown(Shutdown::Both);
                return self.shared.manager.forget_link(link);
            }
        };
        let session = Session::new(stream, link.connection, None, Arc::clone(&self.shared));
        let span = tracing::info_span!("session", connection = link.connection, %address);
        keep_session(&self.tracker, &self.shared, link.connection, session.resume(link), place, span);
    }

    /// Gives a connection its session, or turns it away by closing it; `socket`: a copy of its socket, where it is one.
    pub async fn take<S: AsyncRead + AsyncWrite + Send + 'static>(
        &self,
        stream: S,
        address: SocketAddr,
        socket: Option<OwnedFd>,
    ) {
        let connection = self.next.fetch_add(1, Ordering::Relaxed);
        let allowed = self.allowed.is_empty() || self.allowed.contains(&address.ip().to_canonical());
        let place = if allowed { self.place().await.ok_or(Closed::TooMany) } else { Err(Closed::AddressNotAllowed) };
        let place = match place {
            Ok(place) => place,
            Err(why) => {
                tracing::warn!(%address, ?why, "connection turned away");
                self.shared.hub.tell(ToHub::Closed { connection, why }).await;
                return;
            }
        };
        let session = Session::new(stream, connection, socket, Arc::clone(&self.shared));
        let give_way = self.shared.strangers.enter(connection);
        let span = tracing::info_span!("session", connection, %address);
        keep_session(&self.tracker, &self.shared, connection, session.run(give_way), place, span);
    }

    /// A place for a connection: a free one, or that of a stranger.
    async fn place(&self) -> Option<OwnedSemaphorePermit> {
        if let Ok(place) = Arc::clone(&self.places).try_acquire_owned() {
            return Some(place);
        }
        if !self.shared.strangers.oldest_gives_way() {
            return None;
        }
        tokio::time::timeout(GIVES_WAY_WITHIN, Arc::clone(&self.places).acquire_owned()).await.ok()?.ok()
    }
}

/// The next connection of a socket; `None` once the service stops. Where none can be taken it is tried again, with a pause that grows.
pub async fn next_connection(socket: &TcpListener, shared: &Shared, pulse: &Pulse) -> Option<(TcpStream, SocketAddr)> {
    let mut pause = PAUSES.0;
    loop {
        let accepted = tokio::select! {
            biased;
            () = shared.stop.cancelled() => return None,
            accepted = socket.accept() => accepted,
            () = pulse.rest() => continue,
        };
        match accepted {
            Ok((stream, address)) => {
                let too_often = shared.visitors.enter(address.ip(), Instant::now());
                if too_often > 0 {
                    turn_away_visitor(shared, address, too_often);
                    continue;
                }
                if let Err(error) = tune(&stream, shared.settings.network.silence_s) {
                    tracing::warn!(%address, %error, "socket options");
                }
                return Some((stream, address));
            }
            Err(error) => {
                tracing::warn!(%error, "no connection could be taken");
                let _ = shared.stop.run_until_cancelled(tokio::time::sleep(pause)).await;
                pause = (pause * 2).min(PAUSES.1);
            }
        }
    }
}

/// Closes a connection of an address that comes too often; the log says so once a second.
fn turn_away_visitor(shared: &Shared, address: SocketAddr, too_often: u32) {
    if too_often == 1 {
        tracing::warn!(%address, "connects too often: turned away for the rest of this second");
    }
    // It has no number, and a flood of them must not fill the hub's inbox.
    shared.hub.try_tell(ToHub::Closed { connection: 0, why: Closed::TooOften });
}

/// Lets a session run to its end, and tells the hub where it broke. Its place is free from then on.
pub fn keep_session(
    tracker: &TaskTracker,
    shared: &Shared,
    connection: u64,
    session: impl Future<Output = Closed> + Send + 'static,
    place: OwnedSemaphorePermit,
    span: Span,
) {
    let hub = shared.hub.clone();
    let watched = async move {
        match tokio::spawn(session.in_current_span()).await {
            Ok(why) => tracing::info!(?why, "connection closed"),
            Err(error) => {
                tracing::error!(why = panic_message(error), "session broke");
                hub.tell(ToHub::Closed { connection, why: Closed::Broke }).await;
            }
        }
        drop(place);
    };
    tracker.spawn(watched.instrument(span));
}

/// Small writes go at once, a dead link is noticed, and old updates do not pile up.
fn tune(stream: &TcpStream, silence_s: f64) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    let (first, then, lost_after) = KEEPALIVE;
    socket.set_tcp_keepalive(&TcpKeepalive::new().with_time(first).with_interval(then).with_retries(lost_after))?;
    socket.set_send_buffer_size(SEND_BUFFER)?;
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(Duration::from_secs_f64(silence_s)))?;
    Ok(())
}
