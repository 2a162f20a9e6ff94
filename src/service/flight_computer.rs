//! A simulated flight computer at its end of a connection: it connects, and again after each end; shakes hands, sends its status
//! on a steady schedule, and hands on what it gets.

use super::clock::{Clock, utc_now};
use super::codec::{Codec, LinkError};
use crate::command::{Act, Command};
use crate::simulate::{FlightComputer, Given};
use crate::solve::Motion;
use crate::wire::{CommandReply, Hello, Message, Refusal, Refuse, Update};
use futures_util::{SinkExt, StreamExt};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadHalf, WriteHalf};
use tokio::net::TcpStream;
use tokio::sync::mpsc;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep_until, timeout};
use tokio_util::codec::{FramedRead, FramedWrite};

/// Time between statuses.
pub const STATUS_PERIOD: Duration = Duration::from_millis(500);
/// A camera that is silent, does not read or does not answer a connection for this long is given up.
const SILENCE: Duration = Duration::from_secs(5);

/// What a flight computer sees of its camera.
#[derive(Debug)]
pub enum Seen {
    /// The hellos fit together.
    Connected(Box<Hello>),
    /// An update.
    Update(Box<Update>),
    /// A stage that a command which it gave reached.
    Reply(Box<CommandReply>),
    /// A stage that another's command reached, or one that a computer of its number gave before this one's start.
    Overheard(Box<CommandReply>),
    /// A command that was never answered.
    Unanswered(Given),
    /// Every command that was given has had its last word.
    AllAnswered,
    /// A connection on which hellos were exchanged, or that was refused, ended.
    Closed {
        /// Why, in words.
        reason: String,
        /// What the camera said, where it refused.
        refusal: Option<Refusal>,
    },
    /// No connection could be made.
    Unreachable(String),
}

/// Something seen, and when.
#[derive(Debug)]
pub struct Sighting {
    /// When it came in.
    pub at: Instant,
    /// What it was.
    pub seen: Seen,
}

/// What comes to a flight computer besides what its camera sends.
#[derive(Debug)]
pub struct Inputs {
    /// Commands of the ground.
    pub ground: mpsc::Receiver<(Act, Command)>,
    /// How the gondola turned during a series that has just been exposed, as its gyros measured it.
    pub turns: mpsc::Receiver<Motion>,
}

/// Commands alone: no gyros.
impl From<mpsc::Receiver<(Act, Command)>> for Inputs {
    fn from(ground: mpsc::Receiver<(Act, Command)>) -> Self {
        Self { ground, turns: mpsc::channel(1).1 }
    }
}

/// Flies a simulated flight computer: connects to `address` (`host:port`), and again `retry` after each end, until nobody takes
/// the sightings any more. While they are not taken it does not read, as a slow computer would. It relays the commands of `ground`
/// one after the other, whenever it is in charge, and tells then how the gondola turned.
pub async fn fly(
    mut computer: FlightComputer,
    address: String,
    retry: Duration,
    inputs: impl Into<Inputs>,
    sightings: mpsc::Sender<Sighting>,
) {
    let (clock, mut inputs) = (Clock::start(), inputs.into());
    loop {
        let seen = match timeout(SILENCE, TcpStream::connect(&address)).await {
            Err(_) => Seen::Unreachable("no answer".to_owned()),
            Ok(Err(error)) => Seen::Unreachable(error.to_string()),
            Ok(Ok(stream)) => {
                // Without it a status may wait for the acknowledgement of the one before. Where it cannot be set, it waits.
                let _ = stream.set_nodelay(true);
                match Link::new(stream, &sightings).serve(&mut computer, &mut inputs, clock).await {
                    End::Gone => return,
                    End::Closed(reason) => Seen::Closed { reason, refusal: None },
                    End::Refused(refuse) => Seen::Closed { reason: refuse.detail.to_string(), refusal: refuse.refusal.get() },
                }
            }
        };
        let again = Instant::now() + retry;
        tokio::select! {
            sent = sightings.send(Sighting { at: Instant::now(), seen }) => if sent.is_err() { return },
            () = sightings.closed() => return,
        }
        tokio::select! {
            () = sleep_until(again) => {}
            () = sightings.closed() => return,
        }
    }
}

/// How a connection ended.
enum End {
    /// Nobody takes the sightings.
    Gone,
    /// It broke, or was given up.
    Closed(String),
    /// The camera refused it.
    Refused(Box<Refuse>),
}

impl From<LinkError> for End {
    fn from(error: LinkError) -> Self {
        Self::Closed(error.to_string())
    }
}

/// One connection.
struct Link<'a, S> {
    from: FramedRead<ReadHalf<S>, Codec>,
    to: FramedWrite<WriteHalf<S>, Codec>,
    sightings: &'a mpsc::Sender<Sighting>,
    version: u8,
}

impl<'a, S: AsyncRead + AsyncWrite> Link<'a, S> {
    fn new(stream: S, sightings: &'a mpsc::Sender<Sighting>) -> Self {
        let (from, to) = tokio::io::split(stream);
        Self { from: FramedRead::new(from, Codec::default()), to: FramedWrite::new(to, Codec::default()), sightings, version: 1 }
    }

    async fn serve(mut self, computer: &mut FlightComputer, inputs: &mut Inputs, clock: Clock) -> End {
        let hello = computer.connect();
        match self.greet(hello).await {
            Err(end) => end,
            Ok(()) => match self.converse(computer, inputs, clock).await {
                Err(end) => end,
                Ok(never) => match never {},
            },
        }
    }

    /// Our hello, then the camera's.
    async fn greet(&mut self, ours: Hello) -> Result<(), End> {
        self.send(&Message::Hello(Box::new(ours))).await?;
        let silent = || End::Closed("the camera sent no hello".to_owned());
        let first = timeout(SILENCE, self.from.next()).await.map_err(|_| silent())?;
        match received(first)? {
            Message::Hello(theirs) => match ours.agree(&theirs) {
                Ok(version) => {
                    self.version = version;
                    self.to.encoder_mut().speak(version);
                    self.report(Seen::Connected(theirs)).await
                }
                Err(refuse) => {
                    let reason = refuse.detail.to_string();
                    self.send(&Message::Refuse(Box::new(refuse))).await?;
                    Err(End::Closed(reason))
                }
            },
            Message::Refuse(refuse) => Err(End::Refused(refuse)),
            other => Err(End::Closed(format!("{:?} before the camera's hello", other.kind()))),
        }
    }

    /// Statuses one way and updates the other, until the connection ends.
    async fn converse(
        &mut self,
        computer: &mut FlightComputer,
        inputs: &mut Inputs,
        clock: Clock,
    ) -> Result<std::convert::Infallible, End> {
        let mut schedule = interval(STATUS_PERIOD);
        schedule.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut heard = Instant::now();
        loop {
            tokio::select! {
                _ = schedule.tick() => {
                    let status = computer.status(clock.uptime(), utc_now());
                    self.send(&Message::Status(Box::new(status))).await?;
                    let before = computer.unanswered();
                    let (block, given_up) = computer.block(clock.uptime());
                    if self.version > 1 {
                        self.send(&Message::Commands(Box::new(block))).await?;
                    }
                    if let Some(given) = given_up {
                        self.report(Seen::Unanswered(given)).await?;
                    }
                    self.all_answered(before, computer).await?;
                }
                Some((act, command)) = inputs.ground.recv() => computer.relay(act, command),
                Some(measured) = inputs.turns.recv() => {
                    let lasted = Duration::try_from_secs_f64(measured.length_s()).unwrap_or_default();
                    let begun = clock.uptime().saturating_sub(lasted);
                    let gyro = computer.turned(&measured, begun).filter(|_| computer.holds_lease());
                    if let Some(gyro) = gyro {
                        self.send(&Message::Gyro(Box::new(gyro))).await?;
                    }
                }
                next = self.from.next() => {
                    heard = Instant::now();
                    match received(next)? {
                        Message::Update(update) => {
                            let (before, given) = (computer.unanswered(), computer.given().to_vec());
                            let replies = computer.on_update(&update);
                            self.report(Seen::Update(update)).await?;
                            for reply in replies {
                                let ours = reply.flight_computer == computer.id && given.iter().any(|given| given.is_answered_by(&reply));
                                let reply = Box::new(reply);
                                self.report(if ours { Seen::Reply(reply) } else { Seen::Overheard(reply) }).await?;
                            }
                            self.all_answered(before, computer).await?;
                        }
                        Message::Refuse(refuse) => return Err(End::Refused(refuse)),
                        other => return Err(End::Closed(format!("{:?} from the camera", other.kind()))),
                    }
                }
                () = sleep_until(heard + SILENCE) => return Err(End::Closed("the camera is silent".to_owned())),
                () = self.sightings.closed() => return Err(End::Gone),
            }
        }
    }

    /// Reports that the last command had its last word.
    async fn all_answered(&mut self, before: usize, computer: &FlightComputer) -> Result<(), End> {
        if before > 0 && computer.unanswered() == 0 { self.report(Seen::AllAnswered).await } else { Ok(()) }
    }

    async fn send(&mut self, message: &Message) -> Result<(), End> {
        timeout(SILENCE, self.to.send(message)).await.map_err(|_| End::Closed("the camera does not read".to_owned()))??;
        Ok(())
    }

    async fn report(&self, seen: Seen) -> Result<(), End> {
        self.sightings.send(Sighting { at: Instant::now(), seen }).await.map_err(|_| End::Gone)
    }
}

fn received(next: Option<Result<Message, LinkError>>) -> Result<Message, End> {
    match next {
        None => Err(End::Closed("the camera closed the connection".to_owned())),
        Some(message) => Ok(message?),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{Kind, Role};
    use tokio::io::DuplexStream;

    /// A camera at the other end of a pipe, on a paused clock.
    struct Camera {
        from: FramedRead<ReadHalf<DuplexStream>, Codec>,
        to: FramedWrite<WriteHalf<DuplexStream>, Codec>,
    }

    impl Camera {
        async fn send(&mut self, message: Message) {
            self.to.send(&message).await.unwrap();
        }

        async fn receive(&mut self) -> Message {
            self.from.next().await.unwrap().unwrap()
        }

        async fn shake_hands(&mut self) {
            assert_eq!(self.receive().await.kind(), Kind::Hello);
            self.send(Message::Hello(Box::new(Hello::new(Role::Camera, 1, "xsc0", 3, None)))).await;
        }
    }

    /// Runs one connection against what `camera` does; how it ended, and what was seen.
    async fn connection<F: Future<Output = Camera>>(camera: impl FnOnce(Camera) -> F) -> (End, Vec<Seen>) {
        let (near, far) = tokio::io::duplex(1 << 16);
        let (from, to) = tokio::io::split(far);
        let camera = camera(Camera { from: FramedRead::new(from, Codec::default()), to: FramedWrite::new(to, Codec::default()) });
        let ((sightings, mut seen), (_, ground)) = (mpsc::channel(64), mpsc::channel(1));
        let mut inputs = Inputs::from(ground);
        let mut computer = FlightComputer::new(1, 7);
        let (end, _camera) = tokio::join!(Link::new(near, &sightings).serve(&mut computer, &mut inputs, Clock::start()), camera);
        drop(sightings);
        let mut all = Vec::new();
        while let Some(sighting) = seen.recv().await {
            all.push(sighting.seen);
        }
        (end, all)
    }

    fn reason(end: End) -> String {
        match end {
            End::Gone => "gone".to_owned(),
            End::Closed(reason) => reason,
            End::Refused(refuse) => refuse.detail.to_string(),
        }
    }

    #[tokio::test(start_paused = true)]
    async fn it_sends_its_status_every_half_second_on_a_schedule_that_stands_still() {
        let (end, seen) = connection(|mut camera| async move {
            camera.shake_hands().await;
            let start = Instant::now();
            for count in 0..8u32 {
                let Message::Status(status) = camera.receive().await else { panic!("no status") };
                assert_eq!(camera.receive().await.kind(), Kind::Commands);
                assert_eq!(start.elapsed().as_millis(), u128::from(count) * 500);
                assert_eq!((status.sequence.get(), status.updates_received.get()), (count, count));
                // Late by 200 ms, which moves nothing.
                tokio::time::sleep(Duration::from_millis(200)).await;
                camera.send(Message::Update(Box::default())).await;
            }
            camera.to.close().await.unwrap();
            camera
        })
        .await;
        assert_eq!(reason(end), "the camera closed the connection");
        assert_eq!(seen.iter().filter(|seen| matches!(seen, Seen::Update(_))).count(), 8);
        assert!(matches!(seen.first(), Some(Seen::Connected(hello)) if hello.boot_id.get() == 3));
    }

    #[tokio::test(start_paused = true)]
    async fn a_camera_that_falls_silent_is_given_up_after_five_seconds() {
        let start = Instant::now();
        let (end, _) = connection(|mut camera| async move {
            camera.shake_hands().await;
            camera
        })
        .await;
        assert_eq!(reason(end), "the camera is silent");
        assert_eq!(start.elapsed(), SILENCE);
    }

    #[tokio::test(start_paused = true)]
    async fn a_camera_without_a_hello_is_given_up() {
        let (end, seen) = connection(|camera| async move { camera }).await;
        assert_eq!(reason(end), "the camera sent no hello");
        assert!(seen.is_empty());
        let (end, _) = connection(|mut camera| async move {
            camera.send(Message::Update(Box::default())).await;
            camera
        })
        .await;
        assert_eq!(reason(end), "Update before the camera's hello");
    }

    #[tokio::test(start_paused = true)]
    async fn a_refusal_is_handed_on() {
        let (end, _) = connection(|mut camera| async move {
            camera.shake_hands().await;
            camera.send(Message::Refuse(Box::new(Refuse::new(Refusal::Replaced, "a newer connection")))).await;
            camera
        })
        .await;
        assert!(matches!(&end, End::Refused(refuse) if refuse.refusal.get() == Some(Refusal::Replaced)));
    }

    #[tokio::test(start_paused = true)]
    async fn another_flight_computer_is_no_camera() {
        let (end, _) = connection(|mut camera| async move {
            camera.send(Message::Hello(Box::new(Hello::new(Role::FlightComputer, 2, "fc2", 3, None)))).await;
            camera.receive().await;
            let Message::Refuse(refuse) = camera.receive().await else { panic!("no refusal") };
            assert_eq!(refuse.refusal.get(), Some(Refusal::WrongRole));
            camera
        })
        .await;
        assert_eq!(reason(end), "a camera talks to flight computers alone");
    }

    #[tokio::test]
    async fn it_connects_again_after_each_end_and_says_when_it_cannot() {
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap().to_string();
        let (sightings, mut seen) = mpsc::channel(8);
        let flight =
            tokio::spawn(fly(FlightComputer::new(1, 7), address, Duration::from_millis(10), mpsc::channel(1).1, sightings));
        for _ in 0..2 {
            let (stream, _) = listener.accept().await.unwrap();
            drop(stream);
            assert!(matches!(seen.recv().await.unwrap().seen, Seen::Closed { .. }));
        }
        drop(listener);
        loop {
            // A connection that was waiting to be accepted may still end first.
            if let Seen::Unreachable(_) = seen.recv().await.unwrap().seen {
                break;
            }
        }
        drop(seen);
        flight.await.unwrap();
    }
}
