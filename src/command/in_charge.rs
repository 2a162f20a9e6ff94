//! Which flight computer may command: the camera grants a lease to the one that claims to be in charge.
//!
//! A flight computer claims the charge in its status. What it says of itself is not enough: computers have lied. The rules:
//!
//! 1. A claim **counts** while its computer is connected, for [`LEASE`] after the last status that made it. A status that shows
//!    that our updates do not arrive there does not make one: a computer that does not hear us cannot command.
//! 2. A computer whose claim ended, however it ended, less than [`UNREST`] before it claims again must claim for [`LASTING`]
//!    first. So a claim that comes and goes is not followed.
//! 3. Nobody's claim counts: there is no lease. One counts and there is no lease: it is granted, with a new epoch.
//! 4. The holder keeps its lease for as long as its claim counts, but for rule 5.
//! 5. Two claims that both last for [`LASTING`]: the computer that was rebooted less recently has it. Uptimes tell that; an
//!    uptime that ran backwards within one boot, or faster than our clock, is not believed, and then the other has it. Where a
//!    computer gives no uptime the one that is connected for longer has it, and of two equal ones that with the lower number.
//!
//! No clock and no sockets: the caller brings the time with each event, and asks again at [`InCharge::deadline`].

use super::checks::{Check, Checks};
use std::cmp::Ordering;
use std::time::Duration;

/// The number by which a flight computer calls itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
pub struct FlightComputer(pub u8);

/// Number that a program draws at random when it starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct BootId(pub u32);

/// Number of a lease: each new one has the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default, serde::Serialize, serde::Deserialize)]
pub struct Epoch(pub u32);

/// Monotonic time since a fixed moment.
pub type Tick = Duration;

/// A claim stands for this long after the last status that made it: six statuses, as they come every 0.5 s.
pub const LEASE: Duration = Duration::from_secs(3);
/// A claim that contests another's lease, or that came back, must have stood for this long: four statuses.
pub const LASTING: Duration = Duration::from_secs(2);
/// A claim that comes back within this time after its end came back too fast to be followed at once.
pub const UNREST: Duration = Duration::from_secs(10);
/// An uptime may run ahead of ours by this much and this fraction before it is not believed: twice the silence after which a
/// connection is closed, so that a status that was held up does not make the next one a lie, and the drift of two cheap
/// oscillators many times over.
const UPTIME_JITTER: Duration = Duration::from_secs(10);
const UPTIME_DRIFT: f64 = 1e-3;

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub enum Event {
    /// A computer connected, for the first time or anew: what its earlier connection claimed is over.
    Connected {
        /// Who.
        computer: FlightComputer,
        /// Which start of its program it is.
        boot: BootId,
    },
    /// Its connection ended.
    Disconnected(FlightComputer),
    /// It sent its status.
    Status {
        /// Who.
        from: FlightComputer,
        /// Whether it claims to be in charge.
        claims: bool,
        /// Time since its start, as it says.
        uptime: Option<Duration>,
        /// Whether our updates arrive there, as far as its status shows.
        hears_us: bool,
    },
    /// Nothing but that time went by.
    Time,
}

/// The right to command, granted to one computer at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
pub struct Lease {
    /// Who has it.
    pub computer: FlightComputer,
    /// Which one it is.
    pub epoch: Epoch,
    /// Since when without interruption.
    pub since: Tick,
}

/// What an event led to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Decision {
    /// All stays as it was.
    Unchanged,
    /// There was no lease; now there is.
    Granted(Lease),
    /// The lease of one ended and another was granted.
    Moved {
        /// Who had it.
        from: FlightComputer,
        /// The new one.
        to: Lease,
    },
    /// There is no lease any more.
    Ended {
        /// Who had it.
        from: FlightComputer,
        /// It lapsed for want of a status that renews it; otherwise the claim was withdrawn, or the connection ended.
        lapsed: bool,
    },
    /// A status from a computer that is not connected: ignored.
    Stranger(FlightComputer),
}

/// What a computer says of its uptime.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Uptime {
    /// Nothing.
    Unsaid,
    /// When it first said so and what, and its last word.
    Said { first: (Tick, Duration), last: Duration },
    /// Something that cannot be.
    Disbelieved,
}

/// A claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Claim {
    pub(super) since: Tick,
    pub(super) renewed: Tick,
    /// From when on it counts.
    pub(super) counts_from: Tick,
}

/// A computer that is or was connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct Peer {
    pub(super) computer: FlightComputer,
    boot: BootId,
    pub(super) connected: Option<Tick>,
    pub(super) claim: Option<Claim>,
    /// When its last claim ended.
    pub(super) unclaimed: Option<Tick>,
    pub(super) uptime: Uptime,
}

/// The arbitration. Small and hashable, so that every state can be visited.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct InCharge {
    /// At most one entry for each computer; one that has left is remembered, so that leaving launders nothing.
    pub(super) peers: Vec<Peer>,
    lease: Option<Lease>,
    pub(super) epochs: Epoch,
    /// The moment of the last event.
    last: Tick,
    checks: Checks,
}

impl InCharge {
    /// An arbitration that makes these checks alone.
    #[cfg(test)]
    pub(super) fn with(checks: Checks) -> Self {
        Self { checks, ..Self::default() }
    }

    /// An arbitration whose leases are numbered on after those of an earlier run.
    pub fn after(epochs: Epoch) -> Self {
        Self { epochs, ..Self::default() }
    }

    /// The number of the last lease that was granted.
    pub fn last_epoch(&self) -> Epoch {
        self.epochs
    }

    /// Takes note of an event at `now`, which never runs backwards.
    pub fn on(&mut self, now: Tick, event: Event) -> Decision {
        self.last = now;
        let lapsed = self.end_stale_claims(now);
        let mut known = true;
        match event {
            Event::Connected { computer, boot } => self.connect(now, computer, boot),
            Event::Disconnected(computer) => self.peer(computer).into_iter().for_each(|peer| {
                peer.connected = None;
                peer.end_claim(now);
            }),
            Event::Status { from, claims, uptime, hears_us } => {
                let hears_us = hears_us || !self.checks.has(Check::Hearing);
                known = self.peer(from).filter(|peer| peer.connected.is_some()).is_some_and(|peer| {
                    peer.note(now, claims, uptime, hears_us);
                    true
                });
            }
            Event::Time => {}
        }
        match (self.appoint(now, lapsed), event) {
            (Decision::Unchanged, Event::Status { from, .. }) if !known => Decision::Stranger(from),
            (decision, _) => decision,
        }
    }

    /// When to call [`Self::on`] with [`Event::Time`], if nothing happens before; always later than the last event.
    pub fn deadline(&self) -> Option<Tick> {
        let claims = self.peers.iter().filter_map(|peer| peer.claim);
        claims
            .flat_map(|claim| [claim.renewed + LEASE, claim.counts_from, claim.since + LASTING])
            .filter(|moment| *moment > self.last)
            .min()
    }

    /// Who may command.
    pub fn lease(&self) -> Option<Lease> {
        self.lease
    }

    /// Whether a computer's claim counts.
    pub fn claims(&self, computer: FlightComputer, now: Tick) -> bool {
        self.peers.iter().any(|peer| peer.computer == computer && peer.counts(now))
    }

    fn peer(&mut self, computer: FlightComputer) -> Option<&mut Peer> {
        self.peers.iter_mut().find(|peer| peer.computer == computer)
    }

    fn connect(&mut self, now: Tick, computer: FlightComputer, boot: BootId) {
        match self.peer(computer) {
            Some(peer) => {
                peer.end_claim(now);
                peer.connected = Some(now);
                if peer.boot != boot {
                    (peer.boot, peer.uptime) = (boot, Uptime::Unsaid);
                }
            }
            None => {
                let connected = Some(now);
                self.peers.push(Peer { computer, boot, connected, claim: None, unclaimed: None, uptime: Uptime::Unsaid });
            }
        }
    }

    /// Ends the claims that are too old; whether the holder's was one of them.
    fn end_stale_claims(&mut self, now: Tick) -> bool {
        if !self.checks.has(Check::Lapse) {
            return false;
        }
        let holder = self.lease.map(|lease| lease.computer);
        let stale = |peer: &&mut Peer| peer.claim.is_some_and(|claim| now.saturating_sub(claim.renewed) >= LEASE);
        let mut holder_lapsed = false;
        for peer in self.peers.iter_mut().filter(stale) {
            peer.end_claim(now);
            holder_lapsed |= holder == Some(peer.computer);
        }
        holder_lapsed
    }

    /// Gives the lease to whom it belongs.
    fn appoint(&mut self, now: Tick, lapsed: bool) -> Decision {
        let before = self.lease.map(|lease| lease.computer);
        let counting =
            || self.peers.iter().filter(|peer| peer.counts(now) || !self.checks.has(Check::Unrest) && peer.claim.is_some());
        let holder = counting().find(|peer| Some(peer.computer) == before);
        let rightful = match holder {
            None => counting().min_by(|a, b| a.rank(b)),
            Some(holder) => {
                let lasting = counting().filter(|peer| peer.lasts(now) && holder.lasts(now));
                lasting.min_by(|a, b| a.rank(b)).filter(|_| self.checks.has(Check::Contest)).or(Some(holder))
            }
        };
        let rightful = rightful.map(|peer| peer.computer);
        if rightful == before {
            return Decision::Unchanged;
        }
        self.lease = rightful.map(|computer| {
            self.epochs = Epoch(self.epochs.0.wrapping_add(1));
            Lease { computer, epoch: self.epochs, since: now }
        });
        match (before, self.lease) {
            (None, Some(to)) => Decision::Granted(to),
            (Some(from), Some(to)) => Decision::Moved { from, to },
            (Some(from), None) => Decision::Ended { from, lapsed },
            (None, None) => Decision::Unchanged,
        }
    }
}

impl Peer {
    fn counts(&self, now: Tick) -> bool {
        self.claim.is_some_and(|claim| now >= claim.counts_from)
    }

    fn lasts(&self, now: Tick) -> bool {
        self.claim.is_some_and(|claim| now >= claim.since + LASTING)
    }

    fn end_claim(&mut self, now: Tick) {
        if self.claim.take().is_some() {
            self.unclaimed = Some(now);
        }
    }

    fn note(&mut self, now: Tick, claims: bool, uptime: Option<Duration>, hears_us: bool) {
        if let Some(uptime) = uptime {
            self.uptime = self.uptime.then(now, uptime);
        }
        match &mut self.claim {
            _ if !claims => self.end_claim(now),
            _ if !hears_us => {}
            Some(claim) => claim.renewed = now,
            None => {
                let restless = self.unclaimed.is_some_and(|ended| now.saturating_sub(ended) < UNREST);
                let counts_from = if restless { now + LASTING } else { now };
                self.claim = Some(Claim { since: now, renewed: now, counts_from });
            }
        }
    }

    /// The one that comes first has the better right.
    fn rank(&self, other: &Self) -> Ordering {
        let by_uptime = match (self.uptime, other.uptime) {
            (Uptime::Disbelieved, Uptime::Disbelieved) => Ordering::Equal,
            (Uptime::Disbelieved, _) => Ordering::Greater,
            (_, Uptime::Disbelieved) => Ordering::Less,
            (Uptime::Said { first, .. }, Uptime::Said { first: theirs, .. }) => {
                // Started at (when it said so) − (what it said): the earlier one, without negative times.
                (first.0 + theirs.1).cmp(&(theirs.0 + first.1))
            }
            _ => Ordering::Equal,
        };
        by_uptime.then(self.connected.cmp(&other.connected)).then(self.computer.cmp(&other.computer))
    }
}

impl Uptime {
    /// After the next word.
    fn then(self, now: Tick, uptime: Duration) -> Self {
        match self {
            Self::Unsaid => Self::Said { first: (now, uptime), last: uptime },
            Self::Disbelieved => Self::Disbelieved,
            Self::Said { first, last } => {
                let ours = now.saturating_sub(first.0);
                let most = first.1 + ours + UPTIME_JITTER + ours.mul_f64(UPTIME_DRIFT);
                if uptime < last || uptime > most { Self::Disbelieved } else { Self::Said { first, last: uptime } }
            }
        }
    }
}
