//! The display's part of the service: takes what is new from hub and solver, and serves it to browsers, read-only.
//!
//! `gather` turns the state into what the [display room](crate::display) shows, `history` keeps the last frames to look back at,
//! `site` holds both and what is ready to be sent, and `routes` answers, with `replay` for what other settings would have given. The actor here watches for what is new and takes connections.
//! Nobody waits for it: state and frames come over channels that hold the newest alone, and so does what goes to each browser.

mod gather;
mod history;
mod replay;
mod routes;
mod site;

pub use site::Site;

use super::hub::sleep_until;
use super::pulse::Pulse;
use super::supervisor::Ended;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use socket2::SockRef;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::Instant;
use tokio_util::task::TaskTracker;
use tracing::Instrument;

/// The head of a request is there within this time of its first byte, or of the answer before it; otherwise the connection is closed.
const HEAD_WITHIN: Duration = Duration::from_secs(10);
/// Bytes that the head of a request may have.
const HEAD_BYTES: usize = 16 * 1024;
/// A browser that takes nothing of what was sent for so long is closed.
const TAKES_WITHIN: Duration = Duration::from_secs(30);
/// Bytes that may wait in the kernel for a browser: what is older than a moment is of no use.
const SEND_BUFFER: usize = 512 * 1024;
/// An address that could not be had is tried again after this, and so is an error of `accept`.
const AGAIN_AFTER: Duration = Duration::from_secs(5);
/// What a connection for which there is no place is told.
const BUSY: &[u8] = b"HTTP/1.1 503 Service Unavailable\r\ncontent-length: 5\r\nretry-after: 5\r\nconnection: close\r\n\r\nbusy\n";

/// Where browsers connect. An address that cannot be had does not keep the service from flying: it is tried again.
#[derive(Debug, Clone, Default)]
pub struct PageSocket(Option<Arc<Opening>>);

#[derive(Debug)]
struct Opening {
    address: String,
    socket: Mutex<Option<Arc<TcpListener>>>,
}

impl PageSocket {
    /// On an address, within a runtime.
    pub fn open(address: &str) -> Self {
        let opening = Opening { address: address.to_owned(), socket: Mutex::default() };
        let socket = Self(Some(Arc::new(opening)));
        if let Err(error) = socket.listen() {
            tracing::error!(%error, "display.listen = {address:?}: there is no page until this address can be had");
        }
        socket
    }

    /// Where browsers connect; `None` where they can't.
    pub fn address(&self) -> Option<SocketAddr> {
        self.listening()?.local_addr().ok()
    }

    fn listening(&self) -> Option<Arc<TcpListener>> {
        self.0.as_ref()?.socket.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Listens, if it does not yet.
    fn listen(&self) -> io::Result<()> {
        let Some(opening) = &self.0 else { return Ok(()) };
        let mut socket = opening.socket.lock().unwrap_or_else(PoisonError::into_inner);
        if socket.is_none() {
            let bound = std::net::TcpListener::bind(&opening.address)?;
            bound.set_nonblocking(true)?;
            *socket = Some(Arc::new(TcpListener::from_std(bound)?));
        }
        Ok(())
    }

    /// Whether there is an address to listen on.
    fn is_wanted(&self) -> bool {
        self.0.is_some()
    }
}

/// The page: the display's actor, and a way in for browsers.
#[derive(Clone)]
pub struct Page {
    site: Arc<Site>,
    socket: PageSocket,
    tracker: TaskTracker,
}

/// When the next state is due for those who read.
struct Pace {
    due: Instant,
    /// There is something new.
    news: bool,
}

impl Page {
    /// A page of a site.
    pub fn new(site: Site, socket: PageSocket, tracker: TaskTracker) -> Self {
        Self { site: Arc::new(site), socket, tracker }
    }

    /// The address that browsers connect to, where they can.
    pub fn address(&self) -> Option<SocketAddr> {
        self.socket.address()
    }

    /// Runs until stopped.
    pub(super) async fn run(self, pulse: Pulse) -> Result<(), Ended> {
        let mut state = self.site.watch();
        let mut pace = Pace { due: Instant::now(), news: true };
        let mut socket = self.socket.listening();
        let mut again = Instant::now() + AGAIN_AFTER;
        self.site.look();
        loop {
            let readers = self.site.is_read();
            let retry = (socket.is_none() && self.socket.is_wanted()).then_some(again);
            tokio::select! {
                biased;
                () = self.site.stopped() => return Ok(()),
                changed = state.changed() => {
                    changed.map_err(|_| Ended("the hub is gone".to_owned()))?;
                    pace.news = true;
                    if self.site.look() {
                        pace.due = Instant::now();
                    }
                }
                () = sleep_until(Some(pace.due)), if readers && pace.news => {
                    self.site.publish();
                    pace = Pace { due: Instant::now() + self.site.period(), news: false };
                }
                connection = accept(socket.as_deref()) => match connection {
                    Ok((stream, _)) => {
                        if let Err(error) = tune(&stream) {
                            tracing::debug!(%error, "socket options of a browser");
                        }
                        self.open(stream);
                    }
                    Err(error) => {
                        tracing::warn!(%error, "no browser could be let in");
                        (socket, again) = (None, Instant::now() + AGAIN_AFTER);
                    }
                },
                () = sleep_until(retry), if retry.is_some() => {
                    again = Instant::now() + AGAIN_AFTER;
                    if self.socket.listen().is_ok() {
                        socket = self.socket.listening();
                    }
                }
                // Ages go on while nothing else happens.
                () = pulse.rest() => pace.news = true,
            }
        }
    }

    /// Serves a browser over a stream, if there is a place for it.
    pub fn open<S: AsyncRead + AsyncWrite + Unpin + Send + 'static>(&self, mut stream: S) {
        let Some(place) = self.site.place() else {
            let site = Arc::clone(&self.site);
            self.tracker.spawn(async move {
                tokio::select! {
                    biased;
                    () = site.stopped() => {}
                    // Whoever does not even take this is not waited for.
                    _ = tokio::time::timeout(HEAD_WITHIN, stream.write_all(BUSY)) => {}
                }
            });
            return;
        };
        let site = Arc::clone(&self.site);
        let service = TowerToHyperService::new(routes::routes(&site));
        let serve = async move {
            let mut server = http1::Builder::new();
            server.timer(TokioTimer::new()).header_read_timeout(HEAD_WITHIN).max_buf_size(HEAD_BYTES);
            let served = tokio::select! {
                biased;
                () = site.stopped() => Ok(()),
                served = server.serve_connection(TokioIo::new(stream), service) => served,
            };
            if let Err(error) = served {
                tracing::debug!(%error, "a browser's connection ended");
            }
            drop(place);
        };
        self.tracker.spawn(serve.in_current_span());
    }
}

/// The next connection; never where there is no socket.
async fn accept(socket: Option<&TcpListener>) -> io::Result<(TcpStream, SocketAddr)> {
    match socket {
        Some(socket) => socket.accept().await,
        None => std::future::pending().await,
    }
}

/// Small answers go at once, old ones do not pile up, and a browser that takes nothing frees its place.
fn tune(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    let socket = SockRef::from(stream);
    socket.set_send_buffer_size(SEND_BUFFER)?;
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(TAKES_WITHIN))?;
    Ok(())
}
