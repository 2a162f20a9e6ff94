//! From the state to what the display shows of it.

use crate::command::{Definition, FlightComputer, Reply};
use crate::display::{
    CameraPart, ChargePart, CommandPart, CommandsPart, Concern, CountersPart, DiskPart, FocusPart, FocusPoint, FrameMark, Gauge,
    LensPart, Limits, LinkPart, LookPart, RestartPart, SimulatedPart, Snapshot, TimePart,
};
use crate::lens::Known;
use crate::lens::autofocus::{Curve, Mode};
use crate::service::clock::Clock;
use crate::service::housekeeping::gauges;
use crate::service::state::{CameraState, Disk, Peer, Readiness, State};
use crate::settings::{DisplaySettings, FocusPanel};
use crate::sky::{ClockQuality, ClockReading, DEG, HOUR};
use crate::solve::Reason;
use std::collections::BTreeMap;
use std::time::Duration;
use tokio::time::Instant;

/// The display of the program that flew, px: what the ground's zoom refers to.
const CANVAS_PX: (f64, f64) = (640.0, 480.0);
/// Replies that are shown.
const REPLIES_SHOWN: usize = 8;
/// Shares of `network.silence_s` after which a computer's silence is yellow and red.
const SILENT: (f64, f64) = (0.5, 1.0);

/// What the display shows; `pixels`: whether the last frame's can be had.
pub fn snapshot(state: &State, clock: &Clock, pixels: bool) -> Snapshot {
    let now = Instant::now();
    let age = |at: Instant| now.saturating_duration_since(at).as_secs_f64();
    let ClockReading { utc, quality, .. } = state.time(clock.uptime(), clock.time());
    let display = &state.settings.display;
    let solution_age = Limits::below(display.solution_age_yellow_s, display.solution_age_red_s);
    Snapshot {
        camera_name: state.settings.camera.name.clone(),
        version: env!("CARGO_PKG_VERSION"),
        boot_id: clock.boot_id(),
        uptime_s: clock.uptime().as_secs_f64(),
        simulated: SimulatedPart {
            camera: state.simulated.camera,
            lens: state.simulated.lens,
            housekeeping: state.simulated.housekeeping,
        },
        time: TimePart {
            utc: utc.map(|utc| utc.to_string()),
            quality,
            concern: if quality == ClockQuality::Unset { Concern::Yellow } else { Concern::Good },
        },
        solver: match &state.readiness {
            Readiness::Starting => "starting".to_owned(),
            Readiness::Ready => "ready".to_owned(),
            Readiness::Broken(why) => why.clone(),
        },
        camera: camera(state),
        housekeeping: gauges(state, now),
        disks: disks(state),
        lens: lens(state),
        focus: focus(state),
        links: links(state, clock, now),
        charge: charge(state, clock),
        commands: commands(state, clock),
        frame: state.latest.as_ref().map(|finished| FrameMark {
            image: finished.report.image_counter,
            reason: finished.report.reason,
            solved: finished.report.reason == Reason::Solved,
            age_s: age(finished.captured),
            pixels,
        }),
        solution_age: Gauge::new("solution_age", "s", state.last_solved.map(age), solution_age),
        counters: counters(state),
        restarts: restarts(state, now),
        run_number: state.run.number,
        last_end: state.run.last_end,
        kept_at_start: state.found,
        counters_kept: state.counters_kept,
        settings_hash: state.settings_hash,
        settings_commanded: state.settings_commanded,
        shed: state.strain.shed(),
        look: look(display),
    }
}

fn camera(state: &State) -> CameraPart {
    let (words, concern) = match &state.camera {
        CameraState::Idle => ("idle".to_owned(), Concern::Unknown),
        CameraState::Working => ("working".to_owned(), Concern::Good),
        CameraState::Waiting => ("waits for a trigger".to_owned(), Concern::Good),
        CameraState::Unavailable(why) => (why.clone(), Concern::Red),
    };
    CameraPart {
        state: words,
        concern,
        gain_db: state.camera_gain,
        next_image: state.counters.next_image.0,
        solving: state.solving.map(|image| image.0),
        exposure_s: state.latest.as_ref().and_then(|finished| finished.report.exposure_s),
    }
}

fn disks(state: &State) -> Vec<DiskPart> {
    let part = |(disk, count): (&Disk, &crate::service::state::ImageCounters)| DiskPart {
        name: match disk {
            Disk::Images => "images",
            Disk::Copies => "copies",
        },
        images_kept: count.kept,
        images_lost: count.lost,
        images_thinned: count.thinned,
        errors: count.disk_errors,
        concern: if count.lost > 0 {
            Concern::Red
        } else if count.disk_errors > 0 {
            Concern::Yellow
        } else {
            Concern::Good
        },
    };
    state.counters.images.iter().map(part).collect()
}

/// `known`, `moving`, or why it is not known.
fn words<T: Copy>(value: Known<T>, asked: bool) -> String {
    match value {
        Known::Known(_) if asked => "requested".to_owned(),
        Known::Known(_) => "known".to_owned(),
        Known::Moving => "moving".to_owned(),
        Known::Unknown(doubt) => doubt.label().to_owned(),
    }
}

fn lens(state: &State) -> LensPart {
    let lens = &state.lens;
    let (focus, aperture) = (state.focus_known(), state.aperture_known());
    let is_well = focus.is_some() && aperture.is_some();
    LensPart {
        port: lens.port.clone(),
        connected: lens.connected,
        focus_counts: focus.map(|focus| focus.0),
        focus: words(lens.focus, focus.is_none()),
        focus_range_counts: lens.range.map(|(near, far)| (near.0, far.0)),
        aperture_counts: aperture.map(|aperture| aperture.0),
        aperture: words(lens.aperture, aperture.is_none()),
        stopped: lens.stopped,
        busy: lens.busy.map(|command| format!("{command:?}")),
        waiting: lens.waiting,
        errors: lens.errors.values().sum(),
        last_error: lens.last_error.clone(),
        concern: match (lens.connected, is_well) {
            (false, _) => Concern::Red,
            (true, false) => Concern::Yellow,
            (true, true) => Concern::Good,
        },
    }
}

fn focus(state: &State) -> FocusPart {
    let status = &state.autofocus;
    let points = state.focus_curves.iter().map(|point| FocusPoint {
        star: match point.curve {
            Curve::Star(star) => Some(star.0),
            _ => None,
        },
        counts: point.position.0,
        peak_adu: point.peak.value,
        sigma_adu: point.peak.sigma,
    });
    let shown = match state.settings.display.focus_panel {
        FocusPanel::Auto => status.mode != Mode::NotRunning,
        FocusPanel::On => true,
        FocusPanel::Off => false,
    };
    let seconds = |time: Option<Duration>| time.map(|time| time.as_secs_f64());
    FocusPart {
        mode: status.mode,
        shown,
        requested_counts: status.requested.map(|counts| counts.0),
        run_age_s: seconds(status.run_age),
        time_left_s: seconds(status.time_left),
        images: status.images,
        best_counts: status.best.map(|best| best.counts.value),
        sigma_best_counts: status.best.map(|best| best.counts.sigma),
        width_counts: status.best.map(|best| best.width_counts),
        drift_counts_per_min: status.best.map(|best| best.drift_per_min.value),
        from: status.best.map(|best| best.curve),
        last: status.last.as_ref().map(|finding| format!("{:?}", finding.ending)),
        search_counts: (state.settings.focus.search_min_counts, state.settings.focus.search_max_counts),
        // Without curves on show there is nothing to draw.
        points: if shown { points.collect() } else { Vec::new() },
        distance_counts: status.estimate.as_ref().map(|estimate| estimate.distance_counts.value),
        sigma_distance_counts: status.estimate.as_ref().map(|estimate| estimate.distance_counts.sigma),
    }
}

/// Both flight computers, connected or not, and any other that is.
fn links(state: &State, clock: &Clock, now: Instant) -> Vec<LinkPart> {
    let absent = |id: u8| LinkPart {
        computer: id,
        connected: false,
        legacy: false,
        connected_for_s: None,
        status_age_s: None,
        statuses: None,
        updates_received: None,
        claims_charge: false,
        in_charge: false,
        clock_offset_s: None,
        sigma_clock_s: None,
        concern: Concern::Yellow,
    };
    let mut links: BTreeMap<u8, LinkPart> = [1, 2].map(|id| (id, absent(id))).into();
    for peer in &state.peers {
        links.insert(peer.computer.0, link(state, peer, clock, now));
    }
    links.into_values().collect()
}

fn link(state: &State, peer: &Peer, clock: &Clock, now: Instant) -> LinkPart {
    let Peer { computer, connected, status, clock: theirs, .. } = peer;
    let age = |at: Instant| now.saturating_duration_since(at).as_secs_f64();
    let status_age_s = status.as_ref().map(|(_, at)| age(*at));
    let offset = theirs.offset(clock.uptime());
    let silence_s = state.settings.network.silence_s;
    LinkPart {
        computer: computer.0,
        connected: true,
        legacy: state.legacy.contains_key(computer),
        connected_for_s: Some(age(*connected)),
        status_age_s,
        statuses: status.as_ref().map(|(status, _)| status.sequence.get().saturating_add(1)),
        updates_received: status.as_ref().map(|(status, _)| status.updates_received.get()),
        claims_charge: status.as_ref().is_some_and(|(status, _)| status.claims_charge),
        in_charge: state.in_charge().is_some_and(|lease| lease.computer == *computer),
        clock_offset_s: offset.map(|offset| offset.offset_s),
        sigma_clock_s: offset.map(|offset| offset.sigma_s),
        concern: Limits::below(SILENT.0 * silence_s, SILENT.1 * silence_s).judge(status_age_s),
    }
}

fn charge(state: &State, clock: &Clock) -> ChargePart {
    let lease = state.in_charge();
    let observer = state.prior(Instant::now(), &state.settings.observer).observer;
    ChargePart {
        computer: lease.map(|lease| lease.computer.0),
        lease: lease.map(|lease| lease.epoch.0),
        for_s: lease.map(|lease| clock.uptime().saturating_sub(lease.since).as_secs_f64()),
        latitude_deg: observer.map(|observer| observer.latitude / DEG),
        sidereal_time_h: observer.map(|observer| observer.sidereal_time / HOUR),
        concern: if lease.is_some() { Concern::Good } else { Concern::Yellow },
    }
}

fn commands(state: &State, clock: &Clock) -> CommandsPart {
    let (desk, now) = (&state.desk, clock.uptime());
    let part = |reply: &Reply| {
        let FlightComputer(computer) = reply.to;
        CommandPart {
            computer,
            name: Definition::of_code(reply.code).map_or_else(|| format!("code {}", reply.code), |known| known.name.to_owned()),
            counter: reply.counter,
            stage: reply.stage,
            why: reply.why,
            detail: reply.detail.clone(),
            age_s: now.saturating_sub(reply.at).as_secs_f64(),
        }
    };
    CommandsPart {
        accepted: desk.counts.accepted,
        refused: desk.counts.refused.iter().map(|(why, count)| (format!("{why:?}"), *count)).collect(),
        under_way: desk.under_way().count(),
        armed: desk.armed(now).map(|(_, command, _)| command.to_string()),
        last: desk.replies.newest().take(REPLIES_SHOWN).map(part).collect(),
    }
}

fn counters(state: &State) -> CountersPart {
    let counters = &state.counters;
    CountersPart {
        frames_taken: counters.frames_taken,
        frames_solved: counters.frames_solved,
        frames_skipped: counters.frames_skipped,
        frames_unreadable: counters.frames_unreadable,
        records_written: counters.records_written,
        records_lost: counters.records_lost,
        disk_errors: counters.disk_errors,
        network_resets: state.network_resets,
        links_closed: counters.closed.iter().map(|(why, count)| (format!("{why:?}"), *count)).collect(),
    }
}

fn restarts(state: &State, now: Instant) -> Vec<RestartPart> {
    let part = |(actor, times): (&crate::wire::Actor, &u32)| {
        let last = state.restarts.get(actor);
        RestartPart {
            actor: *actor,
            times: *times,
            why: last.map(|restart| restart.why.to_string()),
            age_s: last.map(|restart| now.saturating_duration_since(restart.at).as_secs_f64()),
        }
    };
    state.counters.restarts.iter().map(part).collect()
}

/// How the ground wants the page to look.
fn look(display: &DisplaySettings) -> LookPart {
    let focus = match display.focus_panel {
        FocusPanel::Auto => "auto",
        FocusPanel::On => "on",
        FocusPanel::Off => "off",
    };
    // The display that flew counted from its lower left corner.
    let part = |px: u32, of: f64| (f64::from(px) / of).clamp(0.0, 1.0);
    LookPart {
        rate_hz: display.rate_hz,
        full_screen: display.full_screen,
        image_only: display.image_only,
        requirements: display.show_requirements,
        brightness: display.brightness,
        zoom_at: [part(display.zoom_x_px, CANVAS_PX.0), 1.0 - part(display.zoom_y_px, CANVAS_PX.1)],
        zoom: display.zoom,
        focus: focus.to_owned(),
    }
}
