//! What a flight computer sees, printed as it comes.

use super::ATTEMPTS;
use crate::cli::print;
use crate::command::{Definition, Stage};
use crate::service::{STATUS_PERIOD, Seen, Sighting};
use crate::wire::{CommandReply, Equatorial, Hello, Image, Message, Update};
use serde::Serialize;
use serde_json::{Map, Value};
use std::io::{Write, stderr};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio::time::Instant;

/// Why the watching ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum End {
    /// As many updates as wanted came.
    Enough,
    /// There is no camera.
    Unreachable,
    /// The duration is over.
    Duration,
    /// A signal.
    Signal,
    /// Every command was answered.
    Answered,
}

/// One line of JSON.
#[derive(Serialize)]
struct Line<'a> {
    t_s: f64,
    kind: &'a str,
    #[serde(flatten)]
    fields: Map<String, Value>,
}

/// What was seen so far, printed as it comes.
pub struct Log {
    started: Instant,
    json: bool,
    wanted: Option<u64>,
    updates: u64,
    failures: u32,
    connected: bool,
    last_update: Option<Instant>,
    longest: Duration,
    /// End when every command has had its last reply.
    until_answered: bool,
    /// Commands of this computer that were rejected, failed or never answered.
    pub refused: u32,
}

impl Log {
    pub fn new(json: bool, wanted: Option<u64>) -> Self {
        Self {
            started: Instant::now(),
            json,
            wanted,
            updates: 0,
            failures: 0,
            connected: false,
            last_update: None,
            longest: Duration::ZERO,
            until_answered: false,
            refused: 0,
        }
    }

    /// A log that ends when all commands are answered, if `until_answered`.
    pub fn ending(self, until_answered: bool) -> Self {
        Self { until_answered, ..self }
    }

    /// Prints what is seen until it is enough.
    pub async fn read(&mut self, sightings: &mut mpsc::Receiver<Sighting>) -> anyhow::Result<End> {
        while let Some(sighting) = sightings.recv().await {
            if let Some(end) = self.take(&sighting)? {
                return Ok(end);
            }
        }
        anyhow::bail!("the simulated flight computer broke")
    }

    /// Prints one sighting; says whether it was the last that is wanted.
    fn take(&mut self, sighting: &Sighting) -> anyhow::Result<Option<End>> {
        match &sighting.seen {
            Seen::Connected(hello) => {
                self.connected = true;
                self.failures = 0;
                self.last_update = None;
                let fields = Message::Hello(hello.clone()).json()?;
                self.line(sighting.at, "connected", fields, || hello_line(hello))?;
            }
            Seen::Update(update) => {
                let interval = self.last_update.replace(sighting.at).map(|last| sighting.at.duration_since(last));
                self.longest = self.longest.max(interval.unwrap_or_default());
                self.updates += 1;
                let mut fields = Message::Update(update.clone()).json()?;
                fields.insert("interval_s".to_owned(), interval.map_or(Value::Null, |time| time.as_secs_f64().into()));
                self.line(sighting.at, "update", fields, || update_line(update))?;
                if self.wanted.is_some_and(|wanted| self.updates >= wanted) {
                    return Ok(Some(End::Enough));
                }
            }
            Seen::Reply(reply) | Seen::Overheard(reply) => {
                let ours = matches!(sighting.seen, Seen::Reply(_));
                let last_and_bad = matches!(reply.stage.get(), Some(Stage::Rejected | Stage::Failed));
                self.refused += u32::from(last_and_bad && ours);
                self.line(sighting.at, "command", reply_fields(reply)?, || reply_line(reply))?;
            }
            Seen::Unanswered(given) => {
                self.refused += 1;
                let fields = serde_json::json!({
                    "name": given.command.name(), "command": given.command.to_string(), "counter": given.counter, "stage": null,
                    "reason": "not answered",
                });
                let fields = fields.as_object().cloned().unwrap_or_default();
                self.line(sighting.at, "command", fields, || format!("command {}: not answered", given.command))?;
            }
            Seen::AllAnswered if self.until_answered => return Ok(Some(End::Answered)),
            Seen::AllAnswered => {}
            Seen::Closed { reason, refusal } => {
                let mut fields = self.summary(reason);
                fields.insert("refusal".to_owned(), serde_json::to_value(refusal)?);
                self.line(sighting.at, "closed", fields, || format!("closed: {reason}"))?;
            }
            Seen::Unreachable(reason) => {
                self.failures += 1;
                // Nobody is left to tell where even stderr is closed.
                let _ = writeln!(stderr(), "stars: no connection: {reason}");
                let hopeless = self.until_answered || self.wanted.is_some() && !self.connected;
                if hopeless && self.failures >= ATTEMPTS {
                    return Ok(Some(End::Unreachable));
                }
            }
        }
        Ok(None)
    }

    /// The last line, where there was ever a connection.
    pub fn farewell(&self, end: End) -> anyhow::Result<()> {
        let why = match end {
            End::Enough => "enough updates",
            End::Duration => "end of the duration",
            End::Signal => "interrupted",
            End::Unreachable => "no camera",
            End::Answered => "all commands answered",
        };
        if !self.connected {
            return Ok(());
        }
        let words = || format!("closed: {why}; {} updates, at most {:.3} s apart", self.updates, self.longest.as_secs_f64());
        self.line(Instant::now(), "closed", self.summary(why), words)
    }

    fn summary(&self, reason: &str) -> Map<String, Value> {
        Map::from_iter([
            ("reason".to_owned(), reason.into()),
            ("updates".to_owned(), self.updates.into()),
            ("longest_interval_s".to_owned(), self.longest.as_secs_f64().into()),
            ("expected_interval_s".to_owned(), STATUS_PERIOD.as_secs_f64().into()),
        ])
    }

    fn line(&self, at: Instant, kind: &str, fields: Map<String, Value>, words: impl FnOnce() -> String) -> anyhow::Result<()> {
        let t_s = at.duration_since(self.started).as_secs_f64();
        if self.json {
            print(&serde_json::to_string(&Line { t_s, kind, fields })?)
        } else {
            print(&format!("{t_s:9.3}  {}", words()))
        }
    }
}

/// A stage of a command, as `stars fcp --json` prints it.
fn reply_fields(reply: &CommandReply) -> anyhow::Result<Map<String, Value>> {
    let name = Definition::of_code(reply.command).map(|definition| definition.name);
    let fields = serde_json::json!({
        "serial": reply.serial.get(),
        "flight_computer": reply.flight_computer,
        "name": name,
        "counter": reply.counter.get(),
        "stage": serde_json::to_value(reply.stage.get())?,
        "reason": serde_json::to_value(reply.why.value())?,
        "words": reply.words.to_string(),
        "age_s": reply.reply_age_s,
    });
    Ok(fields.as_object().cloned().unwrap_or_default())
}

fn reply_line(reply: &CommandReply) -> String {
    let name = Definition::of_code(reply.command).map_or("block", |definition| definition.name);
    let stage = reply.stage.get().map_or_else(String::new, |stage| format!("{stage:?}").to_lowercase());
    let why = reply.why.value().map_or_else(String::new, |why| format!(" ({why:?})"));
    format!("command {name} #{} of {}: {stage}{why} {}", reply.counter.get(), reply.flight_computer, reply.words)
}

fn hello_line(hello: &Hello) -> String {
    format!("connected to {} (camera {}, build {}, boot {:08x})", hello.name, hello.id, hello.build, hello.boot_id.get())
}

fn update_line(update: &Update) -> String {
    let simulated = if update.link.simulated_camera { "  simulated" } else { "" };
    let charge = if update.authority.you_are_in_charge { "  in charge" } else { "" };
    let image = update.image.get().map_or_else(|| "no image yet".to_owned(), image_words);
    format!("#{}  {image}{charge}{simulated}", update.link.sequence.get())
}

fn image_words(image: &Image) -> String {
    let reason = image.reason.get().map_or_else(String::new, |reason| reason.to_string());
    let head = format!("image {} {reason}", image.image_counter.get());
    match image.equatorial.get() {
        None => format!("{head}: {}", image.detail),
        Some(pointing) => {
            let horizontal = image.horizontal.get();
            let horizontal = horizontal.map_or_else(String::new, |h| format!("  az {:.4}° el {:.4}°", h.az_deg, h.el_deg));
            format!("{head}  {}{horizontal}  {} matched", pointing_words(pointing), image.sources_matched.get())
        }
    }
}

fn pointing_words(pointing: &Equatorial) -> String {
    let Equatorial { ra_deg, dec_deg, roll_deg, sigma_pointing_arcsec, .. } = pointing;
    format!("ra {ra_deg:.5}° dec {dec_deg:+.5}° roll {roll_deg:.4}° ±{sigma_pointing_arcsec:.2}″")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sighting(log: &Log, after_ms: u64, seen: Seen) -> Sighting {
        Sighting { at: log.started + Duration::from_millis(after_ms), seen }
    }

    fn update() -> Seen {
        Seen::Update(Box::default())
    }

    #[tokio::test(start_paused = true)]
    async fn it_ends_after_the_updates_that_were_wanted_and_knows_the_longest_wait() {
        let mut log = Log::new(true, Some(3));
        let hello = Hello::new(crate::wire::Role::Camera, 1, "xsc0", 1, None);
        assert_eq!(log.take(&sighting(&log, 0, Seen::Connected(Box::new(hello)))).unwrap(), None);
        assert_eq!(log.take(&sighting(&log, 10, update())).unwrap(), None);
        assert_eq!(log.take(&sighting(&log, 540, update())).unwrap(), None);
        assert_eq!(log.take(&sighting(&log, 1010, update())).unwrap(), Some(End::Enough));
        assert_eq!(log.longest, Duration::from_millis(530));
    }

    #[tokio::test(start_paused = true)]
    async fn a_camera_that_was_never_there_is_given_up_only_where_updates_are_counted() {
        let mut counting = Log::new(true, Some(1));
        let mut patient = Log::new(true, None);
        for attempt in 1..=ATTEMPTS {
            let end = counting.take(&sighting(&counting, 0, Seen::Unreachable("refused".to_owned()))).unwrap();
            assert_eq!(end.is_some(), attempt == ATTEMPTS);
            assert_eq!(patient.take(&sighting(&patient, 0, Seen::Unreachable("refused".to_owned()))).unwrap(), None);
        }
    }

    #[test]
    fn a_pointing_reads_in_degrees_and_arcseconds() {
        let pointing = Equatorial {
            ra_deg: 136.5646,
            dec_deg: -43.9678,
            roll_deg: 165.25,
            sigma_pointing_arcsec: 1.5,
            ..Equatorial::default()
        };
        let image =
            Image { image_counter: 7.into(), equatorial: Some(pointing).into(), sources_matched: 13.into(), ..Image::default() };
        assert_eq!(image_words(&image), "image 7 solved  ra 136.56460° dec -43.96780° roll 165.2500° ±1.50″  13 matched");
    }
}
