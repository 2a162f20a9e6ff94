//! The state as text: a page for a terminal, and ten lines for a link of 9600 baud.

use super::frame::FrameView;
use super::lamps::LampState;
use super::state::{Concern, Gauge, Snapshot};
use super::words::{dms, hms};
use crate::sky::DEG;
use crate::solve::Report;

/// Columns of both.
const COLUMNS: usize = 79;
/// Lines for the thin link: sent once a second, they take less than it carries.
const TEN: usize = 10;

/// A mark beside a value that needs a look.
fn mark(concern: Concern) -> &'static str {
    match concern {
        Concern::Good => "",
        Concern::Unknown => "?",
        Concern::Yellow => " YELLOW",
        Concern::Red => " RED",
    }
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "unknown".to_owned(), |value| format!("{value:.digits$}"))
}

fn whole<T: ToString>(value: Option<T>) -> String {
    value.map_or_else(|| "unknown".to_owned(), |value| value.to_string())
}

fn gauge(gauge: &Gauge) -> String {
    let name = gauge.name.replace('_', " ");
    match gauge.value {
        Some(value) => format!("{name} {value:.1} {}{}", gauge.unit, mark(gauge.concern)),
        None => format!("{name} unknown"),
    }
}

/// Whether anything is simulated, in a word.
fn simulated(snapshot: &Snapshot) -> &'static str {
    if snapshot.simulated.camera || snapshot.simulated.lens { "  SIMULATED" } else { "" }
}

/// The state as a page for a terminal of 80 columns.
pub fn text_page(snapshot: &Snapshot, view: Option<&FrameView>) -> String {
    let mut lines = vec![
        format!("{}  up {:.0} s  stars {}{}", snapshot.camera_name, snapshot.uptime_s, snapshot.version, simulated(snapshot)),
        format!(
            "time       {} {:?}{}",
            snapshot.time.utc.as_deref().unwrap_or("unknown"),
            snapshot.time.quality,
            mark(snapshot.time.concern)
        ),
        format!("solver     {}   camera {}{}", snapshot.solver, snapshot.camera.state, mark(snapshot.camera.concern)),
    ];
    lines.extend(view.map(|view| frame_lines(&view.report)).unwrap_or_else(|| vec!["frame      none yet".to_owned()]));
    lines.push(format!("solution   {}", gauge(&snapshot.solution_age)));
    if let Some(view) = view {
        lines.extend(lamp_lines(view));
    }
    let lens = &snapshot.lens;
    lines.push(format!(
        "lens       focus {} ({})  aperture {} ({})  errors {}{}",
        whole(lens.focus_counts),
        lens.focus,
        whole(lens.aperture_counts),
        lens.aperture,
        lens.errors,
        mark(lens.concern)
    ));
    lines.push(format!(
        "autofocus  {:?}  images {}  best {} +- {}",
        snapshot.focus.mode,
        snapshot.focus.images,
        number(snapshot.focus.best_counts, 1),
        number(snapshot.focus.sigma_best_counts, 1)
    ));
    lines.extend(snapshot.links.iter().map(|link| {
        format!(
            "computer {} {}  status {} s ago{}{}",
            link.computer,
            if link.connected { "connected" } else { "not connected" },
            number(link.status_age_s, 1),
            if link.in_charge { "  IN CHARGE" } else { "" },
            mark(link.concern)
        )
    }));
    lines.push(format!(
        "commands   {} accepted, {} refused, {} under way",
        snapshot.commands.accepted,
        snapshot.commands.refused.values().sum::<u32>(),
        snapshot.commands.under_way
    ));
    lines.extend(snapshot.commands.last.iter().take(4).map(|last| {
        format!("           {} #{} from {}: {:?} {}", last.name, last.counter, last.computer, last.stage, last.detail)
    }));
    lines.extend(snapshot.housekeeping.chunks(2).map(|pair| {
        format!("house      {}", pair.iter().map(|one| format!("{:<34}", gauge(one))).collect::<String>().trim_end())
    }));
    let counters = &snapshot.counters;
    lines.push(format!(
        "frames     {} taken, {} solved, {} skipped, {} unreadable; {} records lost, {} disk errors",
        counters.frames_taken,
        counters.frames_solved,
        counters.frames_skipped,
        counters.frames_unreadable,
        counters.records_lost,
        counters.disk_errors
    ));
    lines.extend(snapshot.restarts.iter().map(|restart| {
        format!("restarted  {:?} {} times: {}", restart.actor, restart.times, restart.why.as_deref().unwrap_or("?"))
    }));
    lines.push("This shows. Only flight computers command.".to_owned());
    lines.iter().map(|line| cut(line)).collect::<Vec<_>>().join("\n") + "\n"
}

/// The state in ten lines of plain ASCII.
pub fn ten_lines(snapshot: &Snapshot, view: Option<&FrameView>) -> String {
    let report = view.map(|view| &view.report);
    let pointing = report.map(|report| &report.pointing);
    let number_of = |of: fn(&crate::solve::PointingReport) -> Option<f64>, digits| number(pointing.and_then(of), digits);
    let failing = view.map_or_else(String::new, failing);
    let reason = report.map_or_else(|| "no frame".to_owned(), |report| report.reason.to_string());
    let concerned = snapshot.housekeeping.iter().filter(|gauge| gauge.concern > Concern::Good).map(gauge);
    let concerned = concerned.collect::<Vec<_>>().join(", ");
    let lines: [String; TEN] = [
        format!(
            "{}{} {} {:?}",
            snapshot.camera_name,
            simulated(snapshot),
            snapshot.time.utc.as_deref().unwrap_or("time unknown"),
            snapshot.time.quality
        ),
        format!(
            "IMAGE {} {reason} age {} s{failing}",
            whole(report.map(|report| report.image_counter)),
            number(snapshot.frame.as_ref().map(|frame| frame.age_s), 1)
        ),
        report.map_or_else(String::new, |report| report.detail.clone()),
        format!(
            "RA {} DEC {} ROLL {} AZ {} EL {}",
            number_of(|p| p.ra_deg, 4),
            number_of(|p| p.dec_deg, 4),
            number_of(|p| p.roll_deg, 3),
            number_of(|p| p.az_deg, 3),
            number_of(|p| p.el_deg, 3)
        ),
        format!(
            "SIGMA {} {} {} arcsec  MATCHED {} of {}  FALSE 1e{}  SOLUTION AGE {} s{}",
            number_of(|p| p.sigma_east_arcsec, 2),
            number_of(|p| p.sigma_north_arcsec, 2),
            number_of(|p| p.sigma_roll_arcsec, 1),
            whole(report.map(|report| report.matched)),
            whole(report.map(|report| report.sources_found)),
            number_of(|p| p.false_probability_log10, 0),
            number(snapshot.solution_age.value, 0),
            mark(snapshot.solution_age.concern)
        ),
        format!(
            "MEAN {} NOISE {} SAT {} FWHM {}  EXP {} s GAIN {} dB",
            number(report.and_then(|report| report.stats.mean), 0),
            number(report.and_then(|report| report.stats.noise), 1),
            whole(report.and_then(|report| report.stats.saturated_px)),
            number(report.and_then(|report| report.stats.fwhm_px), 2),
            number(report.and_then(|report| report.exposure_s), 3),
            number(report.and_then(|report| report.gain_db).or(snapshot.camera.gain_db), 1)
        ),
        format!(
            "LENS {} ({}) APERTURE {}  AF {:?} BEST {}",
            whole(snapshot.lens.focus_counts),
            snapshot.lens.focus,
            whole(snapshot.lens.aperture_counts),
            snapshot.focus.mode,
            number(snapshot.focus.best_counts, 1)
        ),
        links_line(snapshot),
        format!("HOUSE {}", if concerned.is_empty() { "all within limits".to_owned() } else { concerned }),
        format!(
            "FRAMES {} solved {} skipped {}  LOST {}  RESTARTS {}  SHED {:?}",
            snapshot.counters.frames_taken,
            snapshot.counters.frames_solved,
            snapshot.counters.frames_skipped,
            snapshot.counters.records_lost,
            snapshot.restarts.iter().map(|restart| restart.times).sum::<u32>(),
            snapshot.shed
        ),
    ];
    lines.map(|line| cut(&plain(&line))).join("\n") + "\n"
}

/// The requirements that fail, by name.
fn failing(view: &FrameView) -> String {
    let fails = view.lamps.iter().filter(|lamp| lamp.state == LampState::Fails);
    let names: Vec<&str> = fails.map(|lamp| lamp.name).collect();
    if names.is_empty() { String::new() } else { format!(" FAILS {}", names.join(",")) }
}

/// Both links, the one in charge with a star, and the last command.
fn links_line(snapshot: &Snapshot) -> String {
    let links = snapshot.links.iter().map(|link| {
        let state = if link.connected { number(link.status_age_s, 1) } else { "off".to_owned() };
        format!("FC{} {state}{}", link.computer, if link.in_charge { "*" } else { "" })
    });
    let last = snapshot
        .commands
        .last
        .first()
        .map_or_else(|| "none".to_owned(), |last| format!("{} #{} {:?} {}", last.name, last.counter, last.stage, last.detail));
    format!("{}  CMD {last}", links.collect::<Vec<_>>().join("  "))
}

/// What a frame ended in.
fn frame_lines(report: &Report) -> Vec<String> {
    let pointing = &report.pointing;
    let exposure = format!(
        "exposure {} s  mean {} ADU  noise {} ADU  saturated {}  fwhm {} px",
        number(report.exposure_s, 3),
        number(report.stats.mean, 0),
        number(report.stats.noise, 1),
        whole(report.stats.saturated_px),
        number(report.stats.fwhm_px, 2)
    );
    let cause = report.cause.map_or_else(String::new, |cause| format!(" ({cause})"));
    let mut lines = vec![
        format!(
            "image {:<5}{}{cause}  {} sources, {} matched",
            report.image_counter, report.reason, report.sources_found, report.matched
        ),
        format!("           {exposure}"),
    ];
    if !report.detail.is_empty() {
        lines.push(format!("           {}", report.detail));
    }
    if let (Some(ra), Some(dec)) = (pointing.ra_deg, pointing.dec_deg) {
        lines.push(format!("           RA {ra:.5} deg = {}  Dec {dec:+.5} deg = {}", hms(ra * DEG), dms(dec * DEG)));
        lines.push(format!(
            "           roll {} deg  sigma {} {} {} arcsec  false 1e{}",
            number(pointing.roll_deg, 4),
            number(pointing.sigma_east_arcsec, 2),
            number(pointing.sigma_north_arcsec, 2),
            number(pointing.sigma_roll_arcsec, 1),
            number(pointing.false_probability_log10, 0)
        ));
        lines.push(format!(
            "           az {} el {} horizontal roll {} deg  {} arcsec/px  rms {} px",
            number(pointing.az_deg, 3),
            number(pointing.el_deg, 3),
            number(pointing.horizontal_roll_deg, 3),
            number(pointing.platescale_arcsec_px, 4),
            number(pointing.rms_px, 2)
        ));
    }
    lines
}

/// The requirements that are in force.
fn lamp_lines(view: &FrameView) -> Vec<String> {
    let shown = view.lamps.iter().filter(|lamp| lamp.state != LampState::Off).map(|lamp| {
        let state = match lamp.state {
            LampState::Holds => "ok",
            LampState::Fails => "FAILS",
            LampState::Waiting | LampState::Off => "-",
        };
        let value = lamp.value.map_or_else(String::new, |value| format!(" {value:.2}"));
        format!("{} {state}{value}", lamp.name)
    });
    let shown: Vec<String> = shown.collect();
    shown.chunks(3).map(|three| format!("require    {}", three.join("  "))).collect()
}

fn cut(line: &str) -> String {
    line.chars().take(COLUMNS).collect()
}

/// Signs that every terminal has: what is not ASCII is written so, or left out.
fn plain(text: &str) -> String {
    let signs = text.chars().filter_map(|sign| match sign {
        '°' => Some("deg".to_owned()),
        '″' => Some("\"".to_owned()),
        '′' => Some("'".to_owned()),
        sign if sign.is_ascii_graphic() || sign == ' ' => Some(sign.to_string()),
        _ => None,
    });
    signs.collect()
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::view;
    use super::super::state::tests::snapshot;
    use super::*;
    use crate::sky::RowOrder;
    use crate::solve::Reason;

    #[test]
    fn ten_lines_are_ten_plain_and_small_enough_for_9600_baud() {
        for reason in [Reason::Solved, Reason::Requirement, Reason::NoMatch] {
            let text = ten_lines(&snapshot(), Some(&view(reason, RowOrder::TopFirst, false)));
            assert_eq!(text.lines().count(), TEN);
            assert!(text.lines().all(|line| line.len() <= COLUMNS) && text.is_ascii(), "{text}");
            // Eight bits, a start and a stop bit: 960 bytes a second.
            assert!(text.len() < 960, "{}", text.len());
        }
    }

    #[test]
    fn both_say_what_is_wrong_and_what_is_unknown() {
        let refused = view(Reason::Requirement, RowOrder::TopFirst, false);
        let (page, ten) = (text_page(&snapshot(), Some(&refused)), ten_lines(&snapshot(), Some(&refused)));
        for text in [&page, &ten] {
            assert!(text.contains("SIMULATED") && text.contains("requirement") && text.contains("70"), "{text}");
            assert!(text.contains("YELLOW") && text.contains("min_matched") && text.contains("timed_out"), "{text}");
        }
        assert!(page.contains("min_matched FAILS 1.00") && page.contains("aperture unknown"), "{page}");
        assert!(ten.contains("FAILS min_matched") && ten.contains("70deg is outside"), "{ten}");
    }

    #[test]
    fn before_the_first_frame_both_say_so() {
        assert!(text_page(&snapshot(), None).contains("none yet"));
        assert!(ten_lines(&snapshot(), None).contains("no frame"));
    }
}
