//! From the state to the update that a flight computer is sent.

use super::housekeeping;
use super::session::{Closed, Shared};
use super::state::{Actor, Counters, Peer, State, Triggers};
use crate::command::{FlightComputer, Refusal};
use crate::sky::{ClockOffset, ClockReading};
use crate::wire::{self, Authority, Camera, Clock, Code, CommandReply, Control, Image, Link, List, Maybe, Status, Update};
use tokio::time::Instant;

/// What one connection knows of itself.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LinkRecord {
    statuses: u32,
    last: Option<(u32, Instant)>,
    withheld: u32,
}

impl LinkRecord {
    /// Notes a status that came at `at`; `withheld`: values on this connection that were out of range.
    pub fn note(&mut self, status: &Status, at: Instant, withheld: u32) {
        *self = Self { statuses: self.statuses.saturating_add(1), last: Some((status.sequence.get(), at)), withheld };
    }
}

/// The update number `sequence` of a connection with `computer`.
pub fn compose(state: &State, shared: &Shared, computer: FlightComputer, sequence: u32, record: LinkRecord) -> Update {
    let now = Instant::now();
    Update {
        link: link(state, shared, sequence, record, now),
        authority: authority(state, computer),
        counters: counters(&state.counters, state.solving.is_some()),
        housekeeping: housekeeping::housekeeping(state, now),
        camera: camera(state),
        image: image(state, shared, now).into(),
        control: control(state, shared, computer),
        lens: wire::Lens::new(&state.lens, state.lens_requests.len()),
        focus: wire::Focus::new(&state.autofocus),
        health: housekeeping::health(state, now),
        series: state.latest.as_ref().map(|finished| wire::Series::new(&finished.report)).into(),
        clocks: clocks(state, shared),
        triggers: triggers(state, now),
        times: times(state, shared),
    }
}

fn link(state: &State, shared: &Shared, sequence: u32, record: LinkRecord, now: Instant) -> Link {
    let ClockReading { utc, quality, .. } = time(state, shared);
    Link {
        sequence: sequence.into(),
        boot_id: shared.clock.boot_id().into(),
        uptime_s: shared.clock.uptime().as_secs_f64(),
        clock: Clock::new(utc, quality),
        settings_hash: state.settings_hash.into(),
        simulated_camera: state.simulated.camera,
        simulated_lens: state.simulated.lens,
        statuses_received: record.statuses.into(),
        last_status_sequence: record.last.map(|(sequence, _)| sequence).into(),
        last_status_age_s: record.last.map(|(_, at)| now.saturating_duration_since(at).as_secs_f64()).into(),
        status_values_withheld: record.withheld.into(),
    }
}

fn authority(state: &State, computer: FlightComputer) -> Authority {
    let lease = state.in_charge();
    let claims = state.peers.iter().filter_map(|peer| peer.status.as_ref()).filter(|(status, _)| status.claims_charge).count();
    let counts = &state.desk.counts;
    Authority {
        in_charge_id: lease.map(|lease| lease.computer.0).into(),
        in_charge_since_s: lease.map(|lease| lease.since.as_secs_f64()).into(),
        you_are_in_charge: lease.is_some_and(|lease| lease.computer == computer),
        claims: u8::try_from(claims).unwrap_or(u8::MAX),
        commands_accepted: counts.accepted.into(),
        commands_refused: counts.refused.values().fold(0, |sum: u32, count| sum.saturating_add(*count)).into(),
        last_refusal: counts.last.into(),
    }
}

/// What became of commands, for a computer.
fn control(state: &State, shared: &Shared, computer: FlightComputer) -> Control {
    let now = shared.clock.uptime();
    let counts = &state.desk.counts.refused;
    let armed = state.desk.armed(now);
    let replies: Vec<CommandReply> = state.desk.replies.due(computer).map(|reply| CommandReply::new(reply, now)).collect();
    let refused: Vec<_> = Refusal::ALL.iter().map(|why| counts.get(why).copied().unwrap_or_default().into()).collect();
    Control {
        lease_epoch: state.in_charge().map(|lease| lease.epoch.0).into(),
        armed_command: armed.map(|(_, command, _)| command.code()).into(),
        armed_for_s: armed.map_or(0.0, |(.., until)| until.saturating_sub(now).as_secs_f64()),
        commands_under_way: u8::try_from(state.desk.under_way().count()).unwrap_or(u8::MAX),
        authentication_required: shared.keys.required(),
        authentication_key: shared.keys.has(computer),
        counters_kept: state.counters_kept,
        refused: List::from_slice(&refused),
        settings_commanded: state.settings_commanded.into(),
        ..Control::default()
    }
    .with_replies(&replies)
}

/// Camera and lens as they are now.
pub fn camera(state: &State) -> Camera {
    Camera {
        next_image_counter: state.counters.next_image.0.into(),
        gain_db: state.camera_gain.into(),
        focus_counts: state.focus_known().map(|focus| focus.0).into(),
        aperture_counts: state.aperture_known().map(|aperture| aperture.0).into(),
    }
}

fn counters(counters: &Counters, solving: bool) -> wire::Counters {
    let restarts = |actor| counters.restarts.get(&actor).copied().unwrap_or_default();
    let closed = |why| counters.closed.get(&why).copied().unwrap_or_default();
    let of_the_peer =
        [Closed::BadMessage, Closed::Flood, Closed::Refused, Closed::TooMany, Closed::TooOften, Closed::AddressNotAllowed];
    wire::Counters {
        frames_taken: counters.frames_taken.into(),
        frames_solved: counters.frames_solved.into(),
        frames_skipped: counters.frames_skipped.into(),
        frames_lost: counters.records_lost.into(),
        restarts_camera: restarts(Actor::Camera).into(),
        restarts_solver: restarts(Actor::Solver).into(),
        restarts_hub: restarts(Actor::Hub).into(),
        restarts_recorder: restarts(Actor::Recorder).into(),
        restarts_server: [restarts(Actor::Listener), restarts(Actor::LegacyListener), closed(Closed::Broke)]
            .into_iter()
            .fold(0, u32::saturating_add)
            .into(),
        links_refused: of_the_peer.into_iter().map(closed).fold(0, u32::saturating_add).into(),
        solving,
    }
}

/// UTC now.
fn time(state: &State, shared: &Shared) -> ClockReading {
    state.time(shared.clock.uptime(), shared.clock.time())
}

/// The flight computers' clocks, against our own.
fn clocks(state: &State, shared: &Shared) -> wire::Clocks {
    let (now, ours) = (shared.clock.uptime(), shared.clock.time().utc);
    let ahead_s = ours.map(|utc| utc.unix_s() - now.as_secs_f64());
    let offset = |peer: &Peer| {
        let offset = peer.clock.offset(now)?;
        Some((peer.computer.0, ClockOffset { offset_s: offset.offset_s - ahead_s?, ..offset }))
    };
    wire::Clocks::new(state.peers.iter().filter_map(offset))
}

/// How well the times are known.
fn times(state: &State, shared: &Shared) -> wire::Times {
    let stamp = state.latest.as_ref().map(|finished| &finished.outcome.stamp);
    wire::Times {
        clock_sigma_s: time(state, shared).sigma_s.into(),
        captured_sigma_s: stamp.and_then(|stamp| stamp.captured_sigma_s).into(),
        captured_uptime_s: stamp.and_then(|stamp| stamp.uptime_s).into(),
    }
}

/// What makes the camera expose.
fn triggers(state: &State, now: Instant) -> wire::Triggers {
    let Triggers { exposing, last, stayed_away } = state.triggers;
    wire::Triggers {
        exposing: exposing.into(),
        last_triggered_age_s: last.map(|at| now.saturating_duration_since(at).as_secs_f64()).into(),
        triggers_stayed_away: stayed_away.into(),
        image_exposed_by: state
            .latest
            .as_ref()
            .and_then(|finished| finished.outcome.stamp.exposed_by)
            .map(wire::Coded::from)
            .into(),
    }
}

fn image(state: &State, shared: &Shared, now: Instant) -> Option<Image> {
    let finished = state.latest.as_ref()?;
    let ideal_gain = shared.settings.camera.ideal_gain_adu_per_e;
    let age_s = now.saturating_duration_since(finished.captured).as_secs_f64();
    let image = Image::new(&finished.outcome, &finished.report, ideal_gain);
    Some(Image { image_age_s: Maybe::from(Some(age_s)), ..image })
}
