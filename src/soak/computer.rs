//! A flight computer of a soak: an honest one that fails, lies and is tampered with when the schedule says so.

use super::account::{Account, POISON_COUNTS, POISON_TIMEOUT_S};
use super::gyros::{Telling, Turned};
use super::schedule::{Class, Fault};
use crate::camera::Gondola;
use crate::command::{Act, Command, Slot};
use crate::service::{Codec, LinkError, SimulatedUtc, utc_now};
use crate::simulate::{FlightComputer, Given};
use crate::sky::{ClockQuality, Observer, Utc};
use crate::wire::{CommandReply, CommandSlot, Commands, EquatorialEstimate, List, Message, Refuse, SLOTS, Update};
use futures_util::{SinkExt, StreamExt};
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, VecDeque};
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until, timeout};
use tokio_util::codec::Framed;

/// A connection to the camera, whatever it is made of.
pub trait Line: AsyncRead + AsyncWrite + Send + Unpin {}
impl<T: AsyncRead + AsyncWrite + Send + Unpin> Line for T {}

/// Makes a connection; `None` while the camera cannot be reached.
pub type Connect = Arc<dyn Fn() -> Pin<Box<dyn Future<Output = Option<Box<dyn Line>>> + Send>> + Send + Sync>;

/// Time between statuses, and between attempts to connect.
pub const PERIOD: Duration = Duration::from_millis(500);
/// The camera is silent, and is given up.
const SILENCE: Duration = Duration::from_secs(5);
/// Time that a slow computer takes for each message.
const SLOW: Duration = Duration::from_millis(700);
/// More statuses at once than a computer can mean.
const FLOOD: usize = 400;
/// Blocks that are remembered, to come again.
const REMEMBERED: usize = 200;
/// A link that has stood for so long, and a lease, leave no excuse for a command that is not answered.
const EXCUSED_WITHIN: Duration = Duration::from_secs(20);

/// What others know and want of a computer.
#[derive(Clone)]
pub struct Handle(Arc<Mutex<Desk>>);

struct Desk {
    /// When it last was well: connected, and neither stalled nor silent.
    well: Option<Instant>,
    /// Which faults last until when.
    lasting: BTreeMap<Class, Instant>,
    /// Faults that strike once, with their seeds.
    striking: VecDeque<(Class, u64)>,
    /// What the ground has given.
    ground: VecDeque<(Act, Command)>,
    /// Whether it is the one that is meant to be in charge.
    in_charge: bool,
    /// Since when nothing stands in the way of a command.
    undisturbed: Instant,
}

impl Handle {
    pub fn new() -> Self {
        let now = Instant::now();
        let (lasting, striking, ground) = (BTreeMap::new(), VecDeque::new(), VecDeque::new());
        Self(Arc::new(Mutex::new(Desk { well: None, lasting, striking, ground, in_charge: false, undisturbed: now })))
    }

    fn desk(&self) -> MutexGuard<'_, Desk> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A fault of this computer.
    pub fn begin(&self, fault: &Fault, until: Instant) {
        let mut desk = self.desk();
        if fault.lasts.is_zero() || fault.class == Class::ComputerReboots || fault.class == Class::LinkCut {
            desk.striking.push_back((fault.class, fault.seed));
        }
        desk.lasting.insert(fault.class, until);
        desk.undisturbed = until;
    }

    /// A fault that strikes once, and disturbs no command.
    pub fn begin_quietly(&self, fault: &Fault) {
        self.desk().striking.push_back((fault.class, fault.seed));
    }

    /// Something else disturbs the commands of this computer until then.
    pub fn disturb(&self, until: Instant) {
        let mut desk = self.desk();
        desk.undisturbed = desk.undisturbed.max(until);
    }

    /// Whether it was well a moment ago.
    pub fn is_well(&self, within: Duration) -> bool {
        self.desk().well.is_some_and(|well| well.elapsed() <= within)
    }

    /// Whether it is the one that is meant to be in charge.
    pub fn is_in_charge(&self) -> bool {
        self.desk().in_charge
    }

    pub fn set_in_charge(&self, in_charge: bool) {
        let mut desk = self.desk();
        if desk.in_charge != in_charge {
            desk.in_charge = in_charge;
            desk.undisturbed = desk.undisturbed.max(Instant::now());
        }
    }

    /// The ground gives it a command, and says what to do with it.
    pub fn give(&self, act: Act, command: Command) {
        self.desk().ground.push_back((act, command));
    }

    fn lasts(&self, class: Class) -> bool {
        self.desk().lasting.get(&class).is_some_and(|until| Instant::now() < *until)
    }

    /// Until when it neither reads nor sends.
    fn stalled_until(&self) -> Option<Instant> {
        self.desk().lasting.get(&Class::ComputerStalls).copied().filter(|until| Instant::now() < *until)
    }

    /// Whether nothing has stood in the way of a command for a while.
    pub fn is_undisturbed(&self) -> bool {
        self.desk().undisturbed.elapsed() > EXCUSED_WITHIN
    }
}

/// A connection on which hellos are exchanged.
pub type Wire = Framed<Box<dyn Line>, Codec>;

/// Why a connection ended here.
pub enum Over {
    /// It broke, or is cut: again after a while.
    Again(Duration),
    /// The camera said why it ends it.
    Refused(Box<Refuse>),
    /// The computer dies.
    Dies,
}

/// The computer itself.
pub struct Computer {
    pub place: usize,
    pub handle: Handle,
    pub account: Account,
    pub connect: Connect,
    /// `None`: the machine's.
    pub utc: Option<&'static SimulatedUtc>,
    /// The gondola, when its flight began, and what its gyros saw of the last series.
    pub gondola: Gondola,
    pub flight_began: Instant,
    pub gyros: watch::Receiver<Option<Turned>>,
    pub seed: u64,
}

/// What it holds from one start to the next.
pub struct Life {
    pub machine: FlightComputer,
    pub began: Instant,
    pub random: ChaCha8Rng,
    /// What it knows of series.
    pub telling: Telling,
    /// Blocks that it sent.
    sent: VecDeque<Commands>,
    /// Commands of the ground under way.
    under_way: Vec<(Act, Command)>,
}

impl Computer {
    /// Flies until it is dropped.
    pub async fn fly(self) {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        loop {
            let mut machine = FlightComputer::new(self.place as u8 + 1, random.next_u32());
            machine.trigger = Some(random.next_u32());
            let (random, began) = (ChaCha8Rng::seed_from_u64(random.random()), Instant::now());
            let telling = Telling::default();
            let mut life = Life { machine, began, random, telling, sent: VecDeque::new(), under_way: Vec::new() };
            loop {
                let pause = match (self.connect)().await {
                    None => PERIOD,
                    Some(line) => match self.serve(line, &mut life).await {
                        Ok(never) => match never {},
                        Err(Over::Refused(refuse)) => {
                            self.note_end(&mut life, Some(&refuse));
                            PERIOD
                        }
                        Err(Over::Again(pause)) => pause,
                        Err(Over::Dies) => break,
                    },
                };
                self.note_end(&mut life, None);
                self.handle.desk().well = None;
                self.handle.disturb(Instant::now());
                sleep(pause).await;
            }
            // What it had from the ground dies with it.
            life.under_way.iter().for_each(|(_, command)| self.account.end(command, None, true));
            self.handle.desk().well = None;
            let until = self.handle.desk().lasting.get(&Class::ComputerReboots).copied().unwrap_or_else(Instant::now);
            sleep_until(until).await;
        }
    }

    /// One connection.
    async fn serve(&self, line: Box<dyn Line>, life: &mut Life) -> Result<std::convert::Infallible, Over> {
        let mut link = Framed::new(line, Codec::default());
        let mut hello = life.machine.connect();
        if self.struck(&[Class::WrongVersion]).is_some() {
            (hello.version_min, hello.version_current) = (9, 9);
        }
        self.send(&mut link, &Message::Hello(Box::new(hello))).await?;
        match timeout(SILENCE, link.next()).await {
            Ok(Some(Ok(Message::Hello(theirs)))) if hello.version_current != 9 => {
                link.codec_mut().speak(hello.agree(&theirs).map_err(|_| Over::Again(PERIOD))?);
            }
            _ => return Err(Over::Again(PERIOD)),
        }
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        let mut heard = Instant::now();
        let mut before = None;
        let mut gyros = self.gyros.clone();
        gyros.mark_unchanged();
        loop {
            if let Some(until) = self.handle.stalled_until() {
                before = None;
                sleep_until(until).await;
                heard = Instant::now();
            }
            tokio::select! {
                biased;
                next = link.next() => {
                    let Some(Ok(message)) = next else { return Err(Over::Again(PERIOD)) };
                    heard = Instant::now();
                    match message {
                        Message::Update(update) => {
                            self.take(life, &update, before);
                            before = Some(heard);
                        }
                        Message::Refuse(refuse) => return Err(Over::Refused(refuse)),
                        _ => return Err(Over::Again(PERIOD)),
                    }
                    if self.handle.lasts(Class::LinkSlow) {
                        before = None;
                        sleep(SLOW).await;
                    }
                }
                Ok(()) = gyros.changed() => {
                    gyros.borrow_and_update().iter().for_each(|turned| Self::note_turn(life, turned));
                    if !self.handle.lasts(Class::ComputerSilent) {
                        self.tell_turn(&mut link, life).await?;
                    }
                }
                _ = ticks.tick() => {
                    self.strike(&mut link, life).await?;
                    if !self.handle.lasts(Class::ComputerSilent) {
                        self.speak(&mut link, life).await?;
                        self.tell_turn(&mut link, life).await?;
                        self.handle.desk().well = Some(Instant::now());
                    }
                }
                () = sleep_until(heard + SILENCE) => return Err(Over::Again(PERIOD)),
            }
        }
    }

    /// Takes an update, and the replies in it.
    fn take(&self, life: &mut Life, update: &Update, before: Option<Instant>) {
        self.account.update(self.place + 1, update, before);
        self.note_images(life, update);
        let given = life.machine.given().to_vec();
        for reply in life.machine.on_update(update) {
            let is_last = reply.stage.get().is_some_and(crate::command::Stage::is_last);
            if reply.flight_computer == life.machine.id && is_last {
                given.iter().filter(|given| given.is_answered_by(&reply)).for_each(|given| self.end(life, given, Some(&reply)));
            }
        }
    }

    /// A command had its last word; counted where the ground gave it.
    fn end(&self, life: &mut Life, given: &Given, last: Option<&CommandReply>) {
        if let Some(place) = life.under_way.iter().position(|order| *order == (given.act, given.command)) {
            let (_, command) = life.under_way.remove(place);
            self.account.end(&command, last, last.is_some() || !self.handle.is_undisturbed());
        }
    }

    /// Its status and its block of commands, with what it lies.
    async fn speak(&self, link: &mut Wire, life: &mut Life) -> Result<(), Over> {
        let handle = &self.handle;
        let uptime = life.began.elapsed();
        let meant = handle.desk().in_charge;
        let claims = match () {
            () if handle.lasts(Class::BothClaim) => true,
            () if handle.lasts(Class::NeitherClaims) => false,
            () if handle.lasts(Class::ClaimFlickers) => life.random.random(),
            () => meant,
        };
        life.machine.claims_charge = claims;
        let observer = self.gondola.observer(life.began.saturating_duration_since(self.flight_began));
        life.machine.observer = (!handle.lasts(Class::NoPointing)).then_some(observer);
        life.machine.equatorial = None;
        if handle.lasts(Class::WrongPointing) {
            life.machine.observer = Some(Observer { latitude: 0.3, sidereal_time: 1.0 });
            let (ra_deg, dec_deg) = (life.random.random_range(0.0..360.0), life.random.random_range(-90.0..90.0));
            life.machine.equatorial = Some(EquatorialEstimate { ra_deg, dec_deg });
        }
        let utc = match self.utc {
            _ if handle.lasts(Class::ComputerClock) => Utc::from_unix(0.0),
            Some(simulated) => simulated.unix_s().and_then(Utc::from_unix),
            None => utc_now().0,
        };
        let mut status = life.machine.status(uptime, (utc, ClockQuality::FreeRunning));
        if handle.lasts(Class::UptimeBackwards) || self.struck(&[Class::UptimeBackwards]).is_some() {
            status.uptime_s = life.random.random_range(0.0..uptime.as_secs_f64().max(0.1));
        }
        self.send(link, &Message::Status(Box::new(status))).await?;
        // One after the other, so that what a reply belongs to is plain.
        if life.under_way.is_empty()
            && let Some((act, command)) = handle.desk().ground.pop_front()
        {
            life.machine.relay(act, command);
            life.under_way.push((act, command));
        }
        let (mut block, given_up) = life.machine.block(uptime);
        // Only where it is sure that it stands by: what the holder of a lease says is a command.
        if !claims && !life.machine.holds_lease() && self.struck(&[Class::StandByCommands]).is_some() {
            let command = poison(&mut life.random);
            let counter = life.machine.use_up_counter(command.code(), 1);
            let slot = CommandSlot::new(&Slot::new(&command, Act::Run, counter, 0.0));
            (block.slots_count, block.slots) = (1, List::from_slice(&[slot]));
        }
        if let Some(given) = given_up {
            self.end(life, &given, None);
        }
        self.send(link, &Message::Commands(Box::new(block))).await?;
        if life.sent.len() >= REMEMBERED {
            life.sent.pop_front();
        }
        life.sent.push_back(block);
        Ok(())
    }

    /// What strikes once.
    async fn strike(&self, link: &mut Wire, life: &mut Life) -> Result<(), Over> {
        let Some((class, seed)) = self.handle.desk().striking.pop_front() else { return Ok(()) };
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        match class {
            Class::ComputerReboots => return Err(Over::Dies),
            Class::LinkCut => {
                let until = self.handle.desk().lasting.get(&class).copied().unwrap_or_else(Instant::now);
                return Err(Over::Again(until.saturating_duration_since(Instant::now())));
            }
            Class::WrongVersion => {
                self.handle.desk().striking.push_front((class, seed));
                return Err(Over::Again(PERIOD));
            }
            Class::TornMessage => {
                let mut bytes = bytes::BytesMut::new();
                let status = life.machine.status(life.began.elapsed(), (None, ClockQuality::Unset));
                let _ = Message::Status(Box::new(status)).encode(&mut bytes);
                bytes.truncate(random.random_range(1..bytes.len().max(2)));
                let _ = link.get_mut().write_all(&bytes).await;
                return Err(Over::Again(PERIOD));
            }
            Class::Garbage => {
                let mut bytes = vec![0; random.random_range(1..4096)];
                random.fill_bytes(&mut bytes);
                let _ = timeout(PERIOD, link.get_mut().write_all(&bytes)).await;
            }
            Class::Flood => {
                for _ in 0..FLOOD {
                    let status = life.machine.status(life.began.elapsed(), (None, ClockQuality::Unset));
                    self.send(link, &Message::Status(Box::new(status))).await?;
                }
            }
            // They wait for their moment.
            class if class == Class::StandByCommands || class == Class::UptimeBackwards || Class::GYRO.contains(&class) => {
                self.handle.desk().striking.push_back((class, seed));
            }
            _ => {
                if let Some(block) = spoilt(class, life, &mut random) {
                    self.send(link, &Message::Commands(Box::new(block))).await?;
                }
            }
        }
        Ok(())
    }

    /// Takes the first fault of some that strike once, and its seed.
    pub fn struck(&self, classes: &[Class]) -> Option<(Class, u64)> {
        let mut desk = self.handle.desk();
        let place = desk.striking.iter().position(|(waits, _)| classes.contains(waits))?;
        desk.striking.remove(place)
    }

    /// Sends a message.
    pub async fn send(&self, link: &mut Wire, message: &Message) -> Result<(), Over> {
        let sent: Result<Result<(), LinkError>, _> = timeout(SILENCE, link.send(message)).await;
        sent.ok().and_then(Result::ok).ok_or(Over::Again(PERIOD))
    }
}

/// A command that nobody may give: what it would do shows that it ran.
fn poison(random: &mut ChaCha8Rng) -> Command {
    if random.random() {
        Command::ConfigureSolver {
            enabled: true,
            timeout_s: POISON_TIMEOUT_S + f64::from(random.random_range(0..90_000)) / 1000.0,
        }
    } else {
        Command::SetFocus { position_counts: random.random_range(POISON_COUNTS) }
    }
}

/// A block that breaks one rule at least, as a computer in disorder might send it.
fn spoilt(class: Class, life: &mut Life, random: &mut ChaCha8Rng) -> Option<Commands> {
    let last = *life.sent.back()?;
    let fill = |slots: Vec<CommandSlot>| Commands { slots_count: slots.len() as u8, slots: List::from_slice(&slots), ..last };
    // Where the counter is believed it is one that the computer has used up itself.
    let mut slot = |random: &mut ChaCha8Rng, age_s: f64, by: u32| {
        let command = poison(random);
        let counter = life.machine.use_up_counter(command.code(), by);
        CommandSlot::new(&Slot::new(&command, Act::Run, counter, age_s))
    };
    Some(match class {
        Class::ZeroedBlock => fill(vec![CommandSlot::default(); SLOTS]),
        // Their countdowns are over.
        Class::CountersJumped => fill((0..SLOTS).map(|_| slot(random, 1e5, 1000)).collect()),
        Class::StaleCommand => {
            let age_s = random.random_range(16.0..1000.0);
            fill(vec![slot(random, age_s, 1)])
        }
        Class::HalfChanged => {
            let (mut changed, other) = (slot(random, 0.0, 1), slot(random, 0.0, 1));
            changed.seal = other.seal;
            fill(vec![changed])
        }
        Class::CounterAlone => {
            let mut changed = slot(random, 0.0, 1);
            // The reply to it must not be taken for one to the ground's next command.
            changed.counter = life.machine.use_up_counter(changed.command, 1).into();
            fill(vec![changed])
        }
        Class::BlockReplayed => *life.sent.get(random.random_range(0..life.sent.len()))?,
        _ => return None,
    })
}
