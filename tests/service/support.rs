//! Stand-ins for the camera, the solver and the flight computers.

use futures_util::{SinkExt, StreamExt};
use stars::camera::{CameraError, Moment, Source};
use stars::image::{Frame, Series, Stamp};
use stars::service::{Codec, LinkError, MakeSolver, MakeSource, Parts, Running, Solve, start_with};
use stars::settings::{LensKind, Settings};
use stars::sky::RowOrder;
use stars::solve::{Outcome, Prior, Reason, Report, Watch};
use stars::wire::{Hello, Message, Refuse, Role, Status, Update};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, DuplexStream};
use tokio::net::{TcpListener, TcpStream};
use tokio::time::Instant;
use tokio_util::codec::Framed;

/// A test that has waited this long for something has failed. Machines may be busy: nothing is proved by its coming sooner.
pub const PATIENCE: Duration = Duration::from_secs(60);

/// The flight settings on a free port, a frame every 0.2 s from the start, no lens, nothing kept.
pub fn settings() -> Settings {
    let mut settings = Settings::flight().unwrap();
    settings.network.listen = "127.0.0.1:0".to_owned();
    settings.network.connections_per_s = 10_000;
    settings.camera.startup_delay_s = 0.0;
    settings.camera.period_s = 0.2;
    settings.catalog.cache_directory = String::new();
    settings.record.enabled = false;
    settings.record.images = false;
    settings.record.journal = false;
    settings.commands.ledger_directory = String::new();
    settings.lens.kind = LensKind::None;
    settings
}

/// A camera that gives small frames, or what `next` makes of the moment.
pub fn camera(next: impl Fn(&Moment) -> Result<Frame, CameraError> + Send + Sync + 'static) -> Option<MakeSource> {
    struct Camera<F>(Arc<F>);
    impl<F: Fn(&Moment) -> Result<Frame, CameraError> + Send + Sync> Source for Camera<F> {
        fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
            (self.0)(moment).map(Series::from)
        }
    }
    let next = Arc::new(next);
    Some(Arc::new(move || Ok(Box::new(Camera(Arc::clone(&next))) as Box<dyn Source>)))
}

/// A frame with nothing in it.
pub fn frame() -> Frame {
    Frame::new(16, 16, vec![100; 256], RowOrder::BottomFirst).unwrap()
}

/// A camera that always gives such a frame.
pub fn plain_camera() -> Option<MakeSource> {
    camera(|_| Ok(frame()))
}

/// A camera that gives as many frames as the number says by now.
pub fn camera_of(allowed: &Arc<AtomicU32>) -> Option<MakeSource> {
    let allowed = Arc::clone(allowed);
    camera(
        move |moment| {
            if moment.image.0 < allowed.load(Ordering::Relaxed) { Ok(frame()) } else { Err(CameraError::NothingNew) }
        },
    )
}

/// A solver that does what `solve` does.
pub fn solver(solve: impl Fn(&Frame, &Prior, &dyn Watch) -> Outcome + Send + Sync + 'static) -> MakeSolver {
    struct Fake<F>(Arc<F>);
    impl<F: Fn(&Frame, &Prior, &dyn Watch) -> Outcome + Send + Sync + 'static> Solve for Fake<F> {
        fn solve(&mut self, frame: &Frame, prior: &Prior, watch: &dyn Watch) -> Outcome {
            (self.0)(frame, prior, watch)
        }
        fn report(&self, outcome: &Outcome) -> Report {
            Report::without_stars(outcome)
        }
    }
    let solve = Arc::new(solve);
    Arc::new(move || Ok(Box::new(Fake(Arc::clone(&solve))) as Box<dyn Solve>))
}

/// The outcome of a solver that found nothing.
pub fn no_match(stamp: &Stamp) -> Outcome {
    Outcome::unsolved(stamp.clone(), Reason::NoMatch, "nothing")
}

/// A solver that never finds anything.
pub fn plain_solver() -> MakeSolver {
    solver(|frame, _, _| no_match(&frame.stamp))
}

/// Starts the service on a free port.
pub async fn start(settings: Settings, parts: Parts) -> Running {
    let socket = TcpListener::bind("127.0.0.1:0").await.unwrap();
    start_with(Arc::new(settings), parts, socket).unwrap()
}

/// A service without a camera, for tests of connections.
pub async fn start_without_camera(settings: Settings) -> Running {
    start(settings, Parts { camera: None, solver: plain_solver(), lens: None }).await
}

/// A flight computer's end of a connection.
pub struct Peer<S> {
    pub link: Framed<S, Codec>,
    sequence: u32,
}

/// What a peer sees next.
#[derive(Debug)]
pub enum Seen {
    Update(Box<Update>),
    Refuse(Box<Refuse>),
    Hello(#[allow(dead_code, reason = "shown where a test fails")] Box<Hello>),
    /// The camera closed the connection, by an end or a reset.
    End,
}

impl Peer<TcpStream> {
    /// Connects by TCP, without a word yet.
    pub async fn connect(address: SocketAddr) -> Self {
        Self::over(TcpStream::connect(address).await.unwrap())
    }

    /// Over a connection that is made already.
    pub fn over(stream: TcpStream) -> Self {
        Self::new(stream)
    }
}

impl Peer<DuplexStream> {
    /// Connects within the process, so that time may be paused; at most `buffer` bytes wait in either direction.
    pub async fn attach(running: &Running, buffer: usize) -> Self {
        let (near, far) = tokio::io::duplex(buffer);
        running.serve(far, "127.0.0.1:9".parse().unwrap()).await;
        Self::new(near)
    }
}

impl<S: AsyncRead + AsyncWrite + Unpin> Peer<S> {
    fn new(stream: S) -> Self {
        Self { link: Framed::new(stream, Codec::default()), sequence: 0 }
    }

    /// Says who it is, and waits for the camera to do so.
    pub async fn greet(mut self, id: u8) -> Self {
        self.send(Message::Hello(Box::new(hello(id)))).await;
        assert!(matches!(self.see().await, Seen::Hello(_)));
        self
    }

    pub async fn send(&mut self, message: Message) {
        self.link.send(&message).await.unwrap();
    }

    /// Sends a status with its number.
    pub async fn status(&mut self, status: Status) {
        self.send(Message::Status(Box::new(Status { sequence: self.sequence.into(), ..status }))).await;
        self.sequence += 1;
    }

    /// The next message.
    pub async fn see(&mut self) -> Seen {
        match tokio::time::timeout(PATIENCE, self.link.next()).await.expect("nothing came") {
            None | Some(Err(LinkError::Io(_))) => Seen::End,
            Some(Ok(Message::Update(update))) => Seen::Update(update),
            Some(Ok(Message::Refuse(refuse))) => Seen::Refuse(refuse),
            Some(Ok(Message::Hello(hello))) => Seen::Hello(hello),
            Some(other) => panic!("{other:?}"),
        }
    }

    /// The next update.
    pub async fn update(&mut self) -> Update {
        match self.see().await {
            Seen::Update(update) => *update,
            other => panic!("{other:?} instead of an update"),
        }
    }

    /// Takes updates until one is as wanted; statuses go out in between as a live flight computer's do.
    pub async fn update_where(&mut self, wanted: impl Fn(&Update) -> bool) -> Update {
        let began = Instant::now();
        while began.elapsed() < PATIENCE {
            self.status(Status::default()).await;
            let update = self.update().await;
            if wanted(&update) {
                return update;
            }
        }
        panic!("no such update came");
    }

    /// Takes what still comes, and says the last word before the end, if there was one.
    pub async fn last_word(&mut self) -> Option<Box<Refuse>> {
        let mut word = None;
        loop {
            match self.see().await {
                Seen::End => return word,
                Seen::Refuse(refuse) => word = Some(refuse),
                Seen::Update(_) | Seen::Hello(_) => {}
            }
        }
    }
}

pub fn hello(id: u8) -> Hello {
    Hello::new(Role::FlightComputer, id, "test", 7, None)
}

/// A status that claims to be in charge.
pub fn claim() -> Status {
    Status { claims_charge: true, ..Status::default() }
}
