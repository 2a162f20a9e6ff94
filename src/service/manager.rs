//! The service manager, systemd: it is told that the service is ready and alive, and keeps open sockets over a restart.
//!
//! It keeps a copy of each connection under a name that says whose it is (sd_notify(3), `FDSTORE`). A program that is killed leaves the
//! copies open; the one that is started in its place gets them (sd_listen_fds(3)) and goes on where the other stopped. Outside of
//! systemd nothing is told and nothing kept.

use crate::command::{BootId, FlightComputer};
use listenfd::ListenFd;
use sd_notify::NotifyState;
use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, OwnedFd};
use std::str::FromStr;
use std::time::Duration;
use tokio::sync::mpsc;

/// Notices that may wait for the manager: beyond, they are dropped, and a connection is not kept.
const QUEUE: usize = 64;
/// The name of the socket that flight computers connect to.
const DOOR: &str = "door";
/// The name of the one for the legacy dialect.
const LEGACY_DOOR: &str = "legacy_door";
/// What the names of connections begin with.
const LINK: &str = "link";
/// The watchdog is told this many times in its period.
const TOLD_IN_PERIOD: u32 = 3;

/// What the manager is told.
enum Notice {
    Ready,
    Alive,
    Stopping,
    Keep(String, OwnedFd),
    Forget(String),
}

/// Tells the service manager things; nobody waits for it.
#[derive(Clone, Default)]
pub struct Manager(Option<mpsc::Sender<Notice>>);

/// A connection, as its name in the store says it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkName {
    /// Whose it is.
    pub computer: FlightComputer,
    /// The start of its program.
    pub boot: BootId,
    /// The version that is spoken.
    pub version: u8,
    /// The number of the connection.
    pub connection: u64,
}

impl std::fmt::Display for LinkName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{LINK}-{}-{}-{}-{}", self.computer.0, self.boot.0, self.version, self.connection)
    }
}

impl FromStr for LinkName {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let mut parts = text.split('-');
        if parts.next() != Some(LINK) {
            return Err(());
        }
        let mut number = || parts.next().and_then(|part| part.parse::<u64>().ok()).ok_or(());
        let (computer, boot, version, connection) = (number()?, number()?, number()?, number()?);
        let name = Self {
            computer: FlightComputer(computer.try_into().map_err(drop)?),
            boot: BootId(boot.try_into().map_err(drop)?),
            version: version.try_into().map_err(drop)?,
            connection,
        };
        if parts.next().is_some() { Err(()) } else { Ok(name) }
    }
}

/// What an earlier run left open.
#[derive(Debug, Default)]
pub struct Inherited {
    /// The socket that flight computers connect to.
    pub door: Option<TcpListener>,
    /// The one for the legacy dialect.
    pub legacy_door: Option<TcpListener>,
    /// The connections.
    pub links: Vec<(LinkName, TcpStream)>,
}

impl Inherited {
    /// What the manager hands over; nothing outside of systemd.
    pub fn take() -> Self {
        let names = std::env::var("LISTEN_FDNAMES").unwrap_or_default();
        let (mut inherited, mut sockets) = (Self::default(), ListenFd::from_env());
        for (place, name) in names.split(':').enumerate() {
            let Ok(Some(socket)) = sockets.take_tcp_listener(place) else { continue };
            if let Err(error) = inherited.add(name, socket) {
                tracing::warn!(name, %error, "a socket of an earlier run is not used");
            }
        }
        inherited
    }

    /// Takes a socket by its name; what it is, the name says.
    fn add(&mut self, name: &str, socket: TcpListener) -> io::Result<()> {
        socket.set_nonblocking(true)?;
        match name {
            DOOR => self.door = Some(socket),
            LEGACY_DOOR => self.legacy_door = Some(socket),
            _ => match name.parse() {
                Ok(link) => self.links.push((link, TcpStream::from(OwnedFd::from(socket)))),
                Err(()) => return Err(io::Error::other("no name of ours")),
            },
        }
        Ok(())
    }
}

/// A socket of an earlier run, if it listens where the settings want it.
pub fn fitting(socket: Option<TcpListener>, address: &str) -> Option<TcpListener> {
    let wanted: Option<SocketAddr> = address.parse().ok();
    socket.filter(|socket| wanted.is_some() && socket.local_addr().ok() == wanted)
}

impl Manager {
    /// The manager of this process, if it has one; must be called within a runtime.
    pub fn of_this_process() -> Self {
        if std::env::var_os("NOTIFY_SOCKET").is_none() {
            return Self(None);
        }
        let (sender, mut notices) = mpsc::channel(QUEUE);
        tokio::spawn(async move {
            while let Some(notice) = notices.recv().await {
                // One that does not take a datagram holds up this task alone.
                let told = tokio::task::spawn_blocking(move || tell(&notice)).await;
                if let Ok(Err(error)) = told {
                    tracing::warn!(%error, "the service manager was not told");
                }
            }
        });
        Self(Some(sender))
    }

    /// How often the watchdog wants to be told that all is well; `None` where there is none.
    pub fn watchdog_period(&self) -> Option<Duration> {
        self.0.as_ref().and_then(|_| sd_notify::watchdog_enabled()).map(|period| period / TOLD_IN_PERIOD)
    }

    /// The service takes connections.
    pub fn ready(&self) {
        self.tell(Notice::Ready);
    }

    /// Every part of the service answers.
    pub fn alive(&self) {
        self.tell(Notice::Alive);
    }

    /// The service ends as it was asked to.
    pub fn stopping(&self) {
        self.tell(Notice::Stopping);
    }

    /// Keeps the socket that flight computers connect to, and the one for the legacy dialect.
    pub fn keep_doors(&self, door: &impl AsFd, legacy_door: Option<&impl AsFd>) {
        self.keep(DOOR.to_owned(), door);
        if let Some(door) = legacy_door {
            self.keep(LEGACY_DOOR.to_owned(), door);
        }
    }

    /// Keeps a connection.
    pub fn keep_link(&self, link: LinkName, socket: &impl AsFd) {
        self.keep(link.to_string(), socket);
    }

    /// A connection has ended.
    pub fn forget_link(&self, link: LinkName) {
        self.tell(Notice::Forget(link.to_string()));
    }

    fn keep(&self, name: String, socket: &impl AsFd) {
        if self.0.is_none() {
            return;
        }
        match socket.as_fd().try_clone_to_owned() {
            Ok(copy) => self.tell(Notice::Keep(name, copy)),
            Err(error) => tracing::warn!(name, %error, "a socket is not kept over a restart"),
        }
    }

    fn tell(&self, notice: Notice) {
        if let Some(sender) = &self.0
            && sender.try_send(notice).is_err()
        {
            tracing::warn!("the service manager does not listen");
        }
    }
}

fn tell(notice: &Notice) -> io::Result<()> {
    match notice {
        Notice::Ready => sd_notify::notify(&[NotifyState::Ready]),
        Notice::Alive => sd_notify::notify(&[NotifyState::Watchdog]),
        Notice::Stopping => sd_notify::notify(&[NotifyState::Stopping]),
        Notice::Keep(name, socket) => {
            sd_notify::notify_with_fds(&[NotifyState::FdStore, NotifyState::FdName(name)], &[socket.as_fd()])
        }
        Notice::Forget(name) => sd_notify::notify(&[NotifyState::FdStoreRemove, NotifyState::FdName(name)]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_connection_says_whose_it_is_and_no_other_name_does() {
        let link = LinkName { computer: FlightComputer(2), boot: BootId(0xDEAD_BEEF), version: 2, connection: 17 };
        assert_eq!(link.to_string().parse(), Ok(link));
        for name in ["", "link", "link-2-1-2", "link-2-1-2-17-1", "link-300-1-2-17", "door-1-1-1-1", "link-a-1-2-17", "unknown"] {
            assert_eq!(name.parse::<LinkName>(), Err(()), "{name}");
        }
    }

    #[test]
    fn a_socket_is_used_again_where_the_settings_want_the_same_address() {
        let socket = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = socket.local_addr().unwrap();
        assert!(fitting(Some(socket.try_clone().unwrap()), &address.to_string()).is_some());
        for other in ["127.0.0.1:0", "0.0.0.0:2017", "nonsense"] {
            assert!(fitting(Some(socket.try_clone().unwrap()), other).is_none(), "{other}");
        }
    }

    #[test]
    fn what_is_handed_over_is_told_apart_by_its_name() {
        let door = TcpListener::bind("127.0.0.1:0").unwrap();
        let near = TcpStream::connect(door.local_addr().unwrap()).unwrap();
        let mut inherited = Inherited::default();
        inherited.add("link-1-7-2-3", TcpListener::from(OwnedFd::from(near.try_clone().unwrap()))).unwrap();
        inherited.add(DOOR, door).unwrap();
        assert!(inherited.add("stranger", TcpListener::bind("127.0.0.1:0").unwrap()).is_err());
        assert_eq!(inherited.links[0].1.local_addr().unwrap(), near.local_addr().unwrap());
        assert!(inherited.door.is_some() && inherited.legacy_door.is_none());
    }
}
