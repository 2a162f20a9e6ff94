//! Which flight computer is in charge: whose estimates of pointing and observer are taken.
//!
//! A computer claims the charge in its status. The rules, in this order:
//!
//! 1. a claim ends when its status withdraws it, when its connection ends, and [`CLAIM_LASTS`] after the last status;
//! 2. nobody claims: nobody is in charge;
//! 3. one claims: it is in charge;
//! 4. several claim: the one with the longer connection, and of two equally long ones that with the lower number.
//!
//! No clock and no sockets: the caller brings the time with each event, and asks again at [`InCharge::deadline`].

use std::time::Duration;

/// The number by which a flight computer calls itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
pub struct FlightComputer(pub u8);

/// Monotonic time since a fixed moment.
pub type Tick = Duration;

/// A claim stands for this long after the last status that made it: six statuses, as they come every 0.5 s.
pub const CLAIM_LASTS: Duration = Duration::from_secs(3);

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Event {
    /// A computer connected, for the first time or anew: what its earlier connection claimed is over.
    Connected(FlightComputer),
    /// Its connection ended.
    Disconnected(FlightComputer),
    /// It sent its status.
    Status {
        /// Who.
        from: FlightComputer,
        /// Whether it claims to be in charge.
        claims: bool,
    },
    /// Nothing but that time went by.
    Time,
}

/// Who is in charge, and since when.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Holder {
    /// Who.
    pub computer: FlightComputer,
    /// Since when without interruption.
    pub since: Tick,
}

/// What an event led to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Decision {
    /// All stays as it was.
    Unchanged,
    /// Nobody was in charge; now this one is.
    Granted(FlightComputer),
    /// The charge went over.
    Moved {
        /// Who had it.
        from: FlightComputer,
        /// Who has it.
        to: FlightComputer,
    },
    /// Nobody is in charge any more.
    Ended {
        /// Who had it.
        from: FlightComputer,
        /// Its claim lapsed for want of a status; otherwise it was withdrawn, or the connection ended.
        lapsed: bool,
    },
    /// A status from a computer that is not connected: ignored.
    Stranger(FlightComputer),
}

/// A connected computer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Peer {
    computer: FlightComputer,
    connected: Tick,
    /// When it last claimed, if its claim stands.
    claimed: Option<Tick>,
}

/// The arbitration. Small and hashable, so that every state can be visited.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Default)]
pub struct InCharge {
    /// At most one entry for each computer.
    peers: Vec<Peer>,
    holder: Option<Holder>,
}

impl InCharge {
    /// Takes note of an event at `now`, which never runs backwards.
    pub fn on(&mut self, now: Tick, event: Event) -> Decision {
        let lapsed = self.end_stale_claims(now);
        let known = match event {
            Event::Connected(computer) => {
                self.forget(computer);
                self.peers.push(Peer { computer, connected: now, claimed: None });
                true
            }
            Event::Disconnected(computer) => {
                self.forget(computer);
                true
            }
            Event::Status { from, claims } => self.note_status(now, from, claims),
            Event::Time => true,
        };
        match self.appoint(now, lapsed) {
            Decision::Unchanged => match event {
                Event::Status { from, .. } if !known => Decision::Stranger(from),
                _ => Decision::Unchanged,
            },
            change => change,
        }
    }

    /// When to call [`Self::on`] with [`Event::Time`], if nothing happens before: the first claim's end.
    pub fn deadline(&self) -> Option<Tick> {
        self.peers.iter().filter_map(|peer| peer.claimed).min().map(|claimed| claimed + CLAIM_LASTS)
    }

    /// Who is in charge.
    pub fn holder(&self) -> Option<Holder> {
        self.holder
    }

    /// Ends the claims that are too old; whether the holder's was one of them.
    fn end_stale_claims(&mut self, now: Tick) -> bool {
        let mut holder_lapsed = false;
        for peer in &mut self.peers {
            if peer.claimed.is_some_and(|claimed| now.saturating_sub(claimed) >= CLAIM_LASTS) {
                peer.claimed = None;
                holder_lapsed |= self.holder.is_some_and(|holder| holder.computer == peer.computer);
            }
        }
        holder_lapsed
    }

    fn forget(&mut self, computer: FlightComputer) {
        self.peers.retain(|peer| peer.computer != computer);
    }

    /// Whether the status came from a computer that is connected.
    fn note_status(&mut self, now: Tick, from: FlightComputer, claims: bool) -> bool {
        let peer = self.peers.iter_mut().find(|peer| peer.computer == from);
        let known = peer.is_some();
        if let Some(peer) = peer {
            peer.claimed = claims.then_some(now);
        }
        known
    }

    /// Puts the rightful computer in charge.
    fn appoint(&mut self, now: Tick, lapsed: bool) -> Decision {
        let claimants = self.peers.iter().filter(|peer| peer.claimed.is_some());
        let rightful = claimants.min_by_key(|peer| (peer.connected, peer.computer)).map(|peer| peer.computer);
        let before = self.holder.map(|holder| holder.computer);
        if rightful != before {
            self.holder = rightful.map(|computer| Holder { computer, since: now });
        }
        match (before, rightful) {
            (None, Some(to)) => Decision::Granted(to),
            (Some(from), Some(to)) if from != to => Decision::Moved { from, to },
            (Some(from), None) => Decision::Ended { from, lapsed },
            _ => Decision::Unchanged,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::{HashSet, VecDeque};

    const A: FlightComputer = FlightComputer(1);
    const B: FlightComputer = FlightComputer(2);

    fn at(seconds: f64) -> Tick {
        Duration::from_secs_f64(seconds)
    }

    fn claim(from: FlightComputer) -> Event {
        Event::Status { from, claims: true }
    }

    fn stand_by(from: FlightComputer) -> Event {
        Event::Status { from, claims: false }
    }

    #[test]
    fn the_one_that_claims_is_in_charge_until_it_withdraws() {
        let mut machine = InCharge::default();
        assert_eq!(machine.on(at(0.0), Event::Connected(A)), Decision::Unchanged);
        assert_eq!(machine.on(at(0.0), Event::Connected(B)), Decision::Unchanged);
        assert_eq!(machine.on(at(0.5), stand_by(A)), Decision::Unchanged);
        assert_eq!(machine.on(at(0.5), claim(B)), Decision::Granted(B));
        assert_eq!(machine.on(at(1.0), claim(B)), Decision::Unchanged);
        assert_eq!(machine.holder(), Some(Holder { computer: B, since: at(0.5) }));
        assert_eq!(machine.on(at(1.5), stand_by(B)), Decision::Ended { from: B, lapsed: false });
    }

    #[test]
    fn of_two_that_claim_the_longer_connected_has_it() {
        let mut machine = InCharge::default();
        machine.on(at(0.0), Event::Connected(B));
        machine.on(at(1.0), Event::Connected(A));
        assert_eq!(machine.on(at(1.1), claim(A)), Decision::Granted(A));
        assert_eq!(machine.on(at(1.2), claim(B)), Decision::Moved { from: A, to: B });
        assert_eq!(machine.on(at(1.3), claim(A)), Decision::Unchanged);
        assert_eq!(machine.on(at(1.4), Event::Disconnected(B)), Decision::Moved { from: B, to: A });
    }

    #[test]
    fn a_claim_lapses_three_seconds_after_the_last_status() {
        let mut machine = InCharge::default();
        machine.on(at(0.0), Event::Connected(A));
        machine.on(at(1.0), claim(A));
        assert_eq!(machine.deadline(), Some(at(4.0)));
        assert_eq!(machine.on(at(3.999), Event::Time), Decision::Unchanged);
        assert_eq!(machine.on(at(4.0), Event::Time), Decision::Ended { from: A, lapsed: true });
        assert_eq!(machine.deadline(), None);
    }

    #[test]
    fn a_new_connection_of_the_same_computer_begins_without_a_claim() {
        let mut machine = InCharge::default();
        machine.on(at(0.0), Event::Connected(A));
        machine.on(at(0.5), claim(A));
        assert_eq!(machine.on(at(0.6), Event::Connected(A)), Decision::Ended { from: A, lapsed: false });
    }

    #[test]
    fn a_status_from_nowhere_is_ignored() {
        let mut machine = InCharge::default();
        assert_eq!(machine.on(at(0.0), claim(A)), Decision::Stranger(A));
        assert_eq!(machine.holder(), None);
    }

    /// What matters of a state: the ages of claims in whole seconds, and the order of the connections.
    fn essence(machine: &InCharge, now: Tick) -> impl Eq + std::hash::Hash + use<> {
        let mut starts: Vec<Tick> = machine.peers.iter().map(|peer| peer.connected).collect();
        starts.sort_unstable();
        starts.dedup();
        let mut peers: Vec<_> = machine
            .peers
            .iter()
            .map(|peer| {
                let rank = starts.iter().position(|start| *start == peer.connected).unwrap() as u64;
                (peer.computer.0, rank, peer.claimed.map(|claimed| (now - claimed).as_secs()))
            })
            .collect();
        peers.sort_unstable();
        (peers, machine.holder.map(|holder| holder.computer.0))
    }

    /// A second, differently written account of the rules: one record for each computer, checked against the machine.
    fn rightful(machine: &InCharge, now: Tick) -> Option<FlightComputer> {
        let claims =
            |who| machine.peers.iter().find(|peer| peer.computer == who).filter(|p| p.claimed.is_some_and(|t| now < t + at(3.0)));
        match (claims(A), claims(B)) {
            (None, None) => None,
            (Some(_), None) => Some(A),
            (None, Some(_)) => Some(B),
            (Some(a), Some(b)) => Some(if b.connected < a.connected { B } else { A }),
        }
    }

    #[test]
    fn every_state_that_two_computers_can_reach_obeys_the_rules() {
        let mut events = vec![Event::Time];
        for who in [A, B] {
            events.extend([Event::Connected(who), Event::Disconnected(who), claim(who), stand_by(who)]);
        }
        let mut seen = HashSet::new();
        let mut queue = VecDeque::from([(InCharge::default(), Tick::ZERO)]);
        let mut transitions = 0;
        while let Some((machine, then)) = queue.pop_front() {
            for pause in 0..=3 {
                let now = then + Duration::from_secs(pause);
                for event in &events {
                    let mut next = machine.clone();
                    let before = next.holder();
                    let decision = next.on(now, *event);
                    transitions += 1;
                    let holder = next.holder().map(|holder| holder.computer);
                    assert_eq!(holder, rightful(&next, now), "{machine:?} {event:?}");
                    assert!(next.peers.len() <= 2);
                    assert!(next.deadline().is_none_or(|deadline| deadline > now), "asked again at once: {next:?}");
                    assert_eq!(next.deadline().is_some(), holder.is_some());
                    let changed = before.map(|holder| holder.computer) != holder;
                    assert_eq!(changed, !matches!(decision, Decision::Unchanged | Decision::Stranger(_)), "{decision:?}");
                    if !changed {
                        assert_eq!(before, next.holder(), "the charge began anew without a change");
                    }
                    if seen.insert(essence(&next, now)) {
                        queue.push_back((next, now));
                    }
                }
            }
        }
        println!("{} states, {transitions} transitions", seen.len());
        assert!(seen.len() > 50 && seen.len() < 1000, "{}", seen.len());
    }
}
