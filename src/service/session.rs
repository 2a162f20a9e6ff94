//! A session: one connection of a flight computer.
//!
//! After the hellos it does three things that do not wait for each other: it sends the newest state every
//! `network.update_period_s` on a steady schedule, reads statuses and blocks of commands, and answers requests for images, one chunk at a
//! time and only when no update is due. Whatever goes wrong ends this session alone, with a
//! reason that is counted and logged, and with a last message that says it where the peer still listens.

use super::clock::Clock;
use super::codec::{Codec, LinkError};
use super::hub::{self, ToHub, sleep_until};
use super::images::{self, Gallery, Requests};
use super::keys::Keys;
use super::manager::{LinkName, Manager};
use super::state::State;
use super::strain::LATE;
use super::update::{self, LinkRecord};
use super::visitors::Visitors;
use crate::command::{BootId, FlightComputer, LEASE};
use crate::settings::Settings;
use crate::wire::{Hello, Message, Refusal, Refuse};
use futures_util::{SinkExt, StreamExt};
use std::collections::{BTreeMap, VecDeque};
use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt, ReadHalf, WriteHalf};
use tokio::sync::{mpsc, watch};
use tokio::time::{Instant, MissedTickBehavior};
use tokio_util::codec::{FramedRead, FramedWrite};
use tokio_util::sync::CancellationToken;

/// Why a connection ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Closed {
    /// The peer closed it, or the link broke.
    ByPeer,
    /// Nothing came for `network.silence_s`.
    Silent,
    /// What we sent was not taken for `network.silence_s`.
    NotReading,
    /// What came is no message.
    BadMessage,
    /// More messages came than a flight computer can mean.
    Flood,
    /// The hellos do not fit together: a stranger, or a version that is not spoken.
    Refused,
    /// A newer connection of the same flight computer took its place.
    Replaced,
    /// All places were taken; or they were when a newer one came, and this one had not said who it is.
    TooMany,
    /// Its address connects too often.
    TooOften,
    /// Its address is not one that may connect.
    AddressNotAllowed,
    /// The service stops.
    Stopping,
    /// The session itself broke.
    Broke,
}

/// What all sessions share.
pub struct Shared {
    /// The settings in force.
    pub settings: Arc<Settings>,
    /// Our hello.
    pub hello: Hello,
    /// The service's clock.
    pub clock: Clock,
    /// The newest state.
    pub state: watch::Receiver<Arc<State>>,
    /// Whom to tell what peers say.
    pub hub: hub::Handle,
    /// The images that are kept.
    pub gallery: Arc<Gallery>,
    /// The keys of flight computers.
    pub keys: Keys,
    /// Keeps connections open over a restart.
    pub manager: Manager,
    /// How often each address connects.
    pub visitors: Visitors,
    /// Who has not said hello yet.
    pub strangers: Strangers,
    /// When to end.
    pub stop: CancellationToken,
}

/// Connections that have not said who they are yet. Where all places are taken the one that has been silent for longest gives way,
/// so that strangers who hold places cannot keep a flight computer out.
#[derive(Debug, Default)]
pub struct Strangers(Mutex<BTreeMap<u64, CancellationToken>>);

impl Strangers {
    /// A connection is new; the token says when it must give way.
    pub fn enter(&self, connection: u64) -> CancellationToken {
        let give_way = CancellationToken::new();
        self.lock().insert(connection, give_way.clone());
        give_way
    }

    /// A connection has said who it is, or has ended.
    fn leave(&self, connection: u64) {
        self.lock().remove(&connection);
    }

    /// Lets the oldest give way; false where there is none.
    pub fn oldest_gives_way(&self) -> bool {
        self.lock().pop_first().map(|(_, give_way)| give_way.cancel()).is_some()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<u64, CancellationToken>> {
        // Nothing can break between two steps of a change to it.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Messages that a peer may send between two updates: a flight computer sends two or three.
const FLOOD: u32 = 256;
/// No chunk of an image goes when an update is due within this time: enough for one on a link of 1 Mbit/s; on a quick schedule, within an eighth of
/// its period.
const KEPT_FREE: Duration = Duration::from_millis(20);
/// The first version in which images may be asked for.
const IMAGES_SINCE: u8 = 3;
/// A last word that is not taken within this time is not said.
const LAST_WORD: Duration = Duration::from_millis(100);

/// One connection.
pub struct Session<S> {
    from: FramedRead<ReadHalf<S>, Codec>,
    to: FramedWrite<WriteHalf<S>, Codec>,
    connection: u64,
    shared: Arc<Shared>,
    /// A copy of the socket, for the service manager, until it is known whose it is.
    socket: Option<OwnedFd>,
}

impl<S: AsyncRead + AsyncWrite> Session<S> {
    /// A session on a stream, with the number of the connection, and a copy of its socket where it is to be kept over a restart.
    pub fn new(stream: S, connection: u64, socket: Option<OwnedFd>, shared: Arc<Shared>) -> Self {
        let (from, to) = tokio::io::split(stream);
        let (from, to) = (FramedRead::new(from, Codec::default()), FramedWrite::new(to, Codec::default()));
        Self { from, to, connection, shared, socket }
    }

    /// Runs until the connection ends for whatever reason, and tells the hub of its peer and of its end.
    pub async fn run(mut self, give_way: CancellationToken) -> Closed {
        let stop = self.shared.stop.clone();
        let greeted = tokio::select! {
            biased;
            () = stop.cancelled() => Err(Closed::Stopping),
            () = give_way.cancelled() => Err(Closed::TooMany),
            greeted = self.greet() => greeted,
        };
        self.shared.strangers.leave(self.connection);
        match greeted {
            Err(why) => self.end(why).await,
            Ok(link) => {
                if let Some(socket) = self.socket.take() {
                    self.shared.manager.keep_link(link, &socket);
                }
                self.go_on(link).await
            }
        }
    }

    /// Goes on with a connection that an earlier run of the program left open: its peer has said who it is, and sees by the boot in the
    /// next update that we were started again. What was cut off when that run ended stands before the next message, and is skipped.
    pub async fn resume(self, link: LinkName) -> Closed {
        let LinkName { computer, boot, version, connection } = link;
        tracing::info!(computer = computer.0, connection, version, "flight computer still connected");
        self.shared.hub.tell(ToHub::Connected { computer, connection, boot }).await;
        self.go_on(link).await
    }

    async fn go_on(mut self, link: LinkName) -> Closed {
        self.to.encoder_mut().speak(link.version);
        let why = self.converse(link).await;
        self.shared.manager.forget_link(link);
        self.end(why).await
    }

    async fn end(mut self, why: Closed) -> Closed {
        self.say_why(why).await;
        // The service manager may still have a copy of the socket, which would keep it open.
        let _ = tokio::time::timeout(LAST_WORD, self.to.get_mut().shutdown()).await;
        self.shared.hub.tell(ToHub::Closed { connection: self.connection, why }).await;
        why
    }

    /// The hellos: ours at once, then theirs. Who it is, where both fit together.
    async fn greet(&mut self) -> Result<LinkName, Closed> {
        let silence = self.shared.silence();
        let hello = Message::Hello(Box::new(self.shared.hello));
        send(&mut self.to, &hello, silence).await?;
        let theirs = match tokio::time::timeout(silence, self.from.next()).await {
            Err(_) => return Err(Closed::Silent),
            Ok(first) => received(first)?,
        };
        let agreed = match &theirs {
            Message::Hello(theirs) => {
                let who = (FlightComputer(theirs.id), BootId(theirs.boot_id.get()));
                self.shared.hello.agree(theirs).map(|version| (who, version))
            }
            _ => Err(Refuse::new(Refusal::NotAHello, "the first message must be a hello")),
        };
        match agreed {
            Ok(((computer, boot), version)) => {
                let connection = self.connection;
                tracing::info!(computer = computer.0, connection, version, "flight computer connected");
                self.shared.hub.tell(ToHub::Connected { computer, connection, boot }).await;
                Ok(LinkName { computer, boot, version, connection })
            }
            Err(refuse) => {
                tracing::warn!(connection = self.connection, why = %refuse.detail, "refused");
                let _ = send(&mut self.to, &Message::Refuse(Box::new(refuse)), LAST_WORD).await;
                Err(Closed::Refused)
            }
        }
    }

    /// Updates one way and statuses the other, until either ends or a newer connection takes this one's place.
    async fn converse(&mut self, link: LinkName) -> Closed {
        let computer = link.computer;
        let (record, seen) = watch::channel(LinkRecord::default());
        let sent = Sent::default();
        let mut state = self.shared.state.clone();
        let connection = self.connection;
        let requests = Requests::default();
        let asked = (link.version >= IMAGES_SINCE).then_some(&requests);
        let (answers, answered) = mpsc::channel(1);
        let writer = Writer { computer, shared: &self.shared, record: seen, sent: &sent, answers: answered };
        let reader = Reader { computer, connection, shared: &self.shared, record, sent: &sent, asked };
        tokio::select! {
            biased;
            () = self.shared.stop.cancelled() => Closed::Stopping,
            _ = state.wait_for(|state| state.has_replaced(computer, connection)) => Closed::Replaced,
            why = writer.run(&mut self.to) => why,
            why = reader.run(&mut self.from) => why,
            () = images::serve(&self.shared, &requests, answers) => Closed::Broke,
        }
    }

    /// Tells the peer why, if there is a word for it and the peer still takes one.
    async fn say_why(&mut self, why: Closed) {
        let (refusal, detail) = match why {
            Closed::Silent => (Refusal::Silent, "nothing came for too long"),
            Closed::BadMessage => (Refusal::BadMessage, "what came is no message"),
            Closed::Flood => (Refusal::BadMessage, "more messages than a flight computer can mean"),
            Closed::Replaced => (Refusal::Replaced, "a newer connection of the same flight computer"),
            Closed::Stopping => (Refusal::ShuttingDown, "the service stops"),
            _ => return,
        };
        let _ = send(&mut self.to, &Message::Refuse(Box::new(Refuse::new(refusal, detail))), LAST_WORD).await;
    }
}

impl Shared {
    fn silence(&self) -> Duration {
        Duration::from_secs_f64(self.settings.network.silence_s)
    }

    fn period(&self) -> Duration {
        Duration::from_secs_f64(self.settings.network.update_period_s)
    }
}

/// The one way: updates, and between them answers to requests for images.
struct Writer<'a> {
    computer: FlightComputer,
    shared: &'a Shared,
    record: watch::Receiver<LinkRecord>,
    sent: &'a Sent,
    answers: mpsc::Receiver<Message>,
}

impl Writer<'_> {
    /// Sends the newest state on a steady schedule: not a period after the last one was sent, and a tick that was missed stays so.
    async fn run<W: AsyncWrite>(mut self, to: &mut FramedWrite<WriteHalf<W>, Codec>) -> Closed {
        let shared = self.shared;
        let mut schedule = tokio::time::interval(shared.period());
        schedule.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let kept_free = KEPT_FREE.min(shared.period() / 8);
        let mut sequence: u32 = 0;
        // Other messages may go until then.
        let mut until = None;
        loop {
            let ready = Instant::now();
            let due = tokio::select! {
                biased;
                due = schedule.tick() => due,
                () = sleep_until(until), if until.is_some() => {
                    until = None;
                    continue;
                }
                Some(answer) = self.answers.recv(), if until.is_some() => {
                    if let Err(why) = send(to, &answer, shared.silence()).await {
                        return why;
                    }
                    continue;
                }
            };
            if due.max(ready).elapsed() > LATE {
                shared.hub.try_tell(ToHub::Late);
            }
            let state = Arc::clone(&shared.state.borrow());
            let update = update::compose(&state, shared, self.computer, sequence, *self.record.borrow());
            self.sent.note(sequence, Instant::now());
            if let Err(why) = send(to, &Message::Update(Box::new(update)), shared.silence()).await {
                return why;
            }
            sequence = sequence.wrapping_add(1);
            until = Some(due + shared.period() - kept_free);
        }
    }
}

/// When the last updates of a connection were sent: what a peer says of them shows whether it hears us, and how old what it says
/// can be.
#[derive(Debug, Default)]
struct Sent(Mutex<VecDeque<(u32, Instant)>>);

/// Updates that are remembered: of half a minute.
const SENT: usize = 64;

impl Sent {
    fn note(&self, sequence: u32, now: Instant) {
        let mut sent = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if sent.len() >= SENT {
            sent.pop_front();
        }
        sent.push_back((sequence, now));
    }

    /// Time since an update was sent; as long as can be where that was too long ago, or never.
    fn age(&self, sequence: Option<u32>, now: Instant) -> Duration {
        let sent = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let at = sent.iter().find(|(number, _)| Some(*number) == sequence).map(|(_, at)| *at);
        at.map_or(Duration::MAX, |at| now.saturating_duration_since(at))
    }
}

/// The other way: what the peer says.
struct Reader<'a> {
    computer: FlightComputer,
    connection: u64,
    shared: &'a Shared,
    record: watch::Sender<LinkRecord>,
    sent: &'a Sent,
    /// Where requests for images go; `None` in a version that has none.
    asked: Option<&'a Requests>,
}

impl Reader<'_> {
    /// Reads messages and hands them on.
    async fn run<R: AsyncRead>(self, from: &mut FramedRead<ReadHalf<R>, Codec>) -> Closed {
        let mut since = Instant::now();
        let mut messages: u32 = 0;
        loop {
            let message = match tokio::time::timeout(self.shared.silence(), from.next()).await {
                Err(_) => return Closed::Silent,
                Ok(next) => match received(next) {
                    Ok(message) => message,
                    Err(why) => return why,
                },
            };
            let at = Instant::now();
            if at.duration_since(since) > self.shared.period() {
                (since, messages) = (at, 0);
            }
            match self.take(message, at, from.decoder().values_withheld()).await {
                Ok(count) => messages += count,
                Err(why) => return why,
            }
            if messages > FLOOD {
                return Closed::Flood;
            }
        }
    }

    /// Hands a message on; how many it counts for in a flood.
    async fn take(&self, message: Message, at: Instant, withheld: u32) -> Result<u32, Closed> {
        let &Self { computer, connection, shared, sent, .. } = self;
        match message {
            Message::Status(status) => {
                self.record.send_modify(|record| record.note(&status, at, withheld));
                let heard = status.last_update_sequence.get().map(|sequence| sequence.get());
                // One that does not say what it hears is believed to hear.
                let hears_us = heard.is_none() || sent.age(heard, at) <= LEASE;
                shared.hub.tell(ToHub::Status { computer, connection, status, at, hears_us }).await;
            }
            Message::Commands(block) => {
                let delay = sent.age(block.last_update_sequence.get().map(|sequence| sequence.get()), at);
                let authenticity = shared.keys.judge(computer, &block);
                shared.hub.tell(ToHub::Commands { computer, connection, block, delay, authenticity }).await;
            }
            Message::Gyro(gyro) => shared.hub.tell(ToHub::Gyro { computer, connection, gyro }).await,
            // The pace of the answers is the pace of those who wait for them; who does not wait counts.
            Message::ImageRequest(request) => {
                return self.asked.map(|asked| u32::from(asked.take(*request))).ok_or(Closed::BadMessage);
            }
            Message::Refuse(refuse) => {
                tracing::warn!(computer = computer.0, why = %refuse.detail, "the flight computer refuses us");
                return Err(Closed::ByPeer);
            }
            Message::Hello(_) | Message::Update(_) | Message::ImageChunk(_) | Message::ImageRefusal(_) => {
                return Err(Closed::BadMessage);
            }
        }
        Ok(1)
    }
}

/// A message that was taken from the stream, or why there is none.
fn received(next: Option<Result<Message, LinkError>>) -> Result<Message, Closed> {
    match next {
        None => Err(Closed::ByPeer),
        Some(Ok(message)) => Ok(message),
        Some(Err(LinkError::Io(error))) => {
            tracing::info!(%error, "connection broke");
            Err(Closed::ByPeer)
        }
        Some(Err(LinkError::Wire(error))) => {
            tracing::warn!(%error, "bad message");
            Err(Closed::BadMessage)
        }
    }
}

/// Sends a message, or gives the connection up: what was cut off stays queued, so nothing else may follow it.
async fn send<W: AsyncWrite>(
    to: &mut FramedWrite<WriteHalf<W>, Codec>,
    message: &Message,
    patience: Duration,
) -> Result<(), Closed> {
    match tokio::time::timeout(patience, to.send(message)).await {
        Ok(Ok(())) => Ok(()),
        Ok(Err(LinkError::Io(error))) => {
            tracing::info!(%error, "connection broke");
            Err(Closed::ByPeer)
        }
        Ok(Err(LinkError::Wire(error))) => {
            tracing::error!(%error, "a message of ours cannot be encoded");
            Err(Closed::Broke)
        }
        Err(_) => Err(Closed::NotReading),
    }
}
