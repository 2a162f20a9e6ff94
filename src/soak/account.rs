//! The account: what was due and what came, from both sides, so that nothing can be lost or made up unseen.

use crate::command::{Command, Stage};
use crate::service::{Actor, Disk, ImageCounters, Shed, State};
use crate::simulate::Judged;
use crate::sky::Attitude;
use crate::solve::{Reason, SearchMode};
use crate::wire::{CommandReply, Refusal, Update};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::time::Instant;

/// Times that nobody may command: spoilt blocks carry solver timeouts from here on, s, and focus positions of these, counts.
pub const POISON_TIMEOUT_S: f64 = 500.0;
/// See [`POISON_TIMEOUT_S`]. Far from where commands send it, and from the furthest position, at which learning the range ends: there the
/// lens stays if all that was kept is lost meanwhile.
pub const POISON_COUNTS: Range<i32> = 1000..1150;
/// What the sensor shows whenever it shows anything, °C.
pub const SENSOR_C: f64 = 21.5;
/// Longest time between two updates on a link that stands.
const LATE: Duration = Duration::from_millis(600);
/// Truths that are remembered: many more than are ever under way.
const REMEMBERED: usize = 64;
/// Bounds of the histogram of the time between two updates, ms.
pub const GAPS_MS: [u64; 8] = [500, 510, 520, 550, 600, 700, 1000, u64::MAX];

/// What an image shows.
#[derive(Debug, Clone, Copy)]
pub struct Truth {
    /// When its capture began, uptime of the service.
    pub begun: Duration,
    /// Where the camera pointed, in the middle of the light of a series; `None` where there is nothing to solve.
    pub attitude: Option<Attitude>,
    /// And at its start.
    pub start: Option<Attitude>,
    /// Its exposures.
    pub exposures: u8,
}

/// Gyro rates that a computer sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rates {
    /// As they should be.
    Sound,
    /// Another motion's, and nothing shows it but the image.
    Wrong,
    /// They must be refused, and counted.
    Refused,
    /// They must be passed over: of a series of triggers that is none, or from the computer that is not in charge.
    Unheard,
    /// One of them is no number, so that the link must end with an answer.
    NotFinite,
}

/// All that is counted.
#[derive(Debug, Clone, Default)]
pub struct Book {
    /// Runs of the service.
    pub runs: usize,
    /// Each run that has ended.
    pub ended_runs: Vec<EndedRun>,
    /// Frames that the service took, and outcomes that it said it lost.
    pub frames: u32,
    /// See there.
    pub records_lost: u32,
    /// Frames that a newer one replaced before their turn.
    pub skipped: u32,
    /// Images kept on disk, not kept, and kept earlier and gone to make room.
    pub images: ImageCounters,
    /// Images that should be on disk and are not, in words.
    pub images_missing: Vec<String>,
    /// A disk has been dead or full, or images were shed, in this run.
    excused: bool,
    /// Images that could not be read, by run.
    unreadable: BTreeSet<u32>,
    /// Images seen in updates: solved, not solved, wrongly solved.
    pub solved: u32,
    /// See there.
    pub unsolved: u32,
    /// See there, in words.
    pub wrong: Vec<String>,
    /// Updates that came, and the times between them on a link that stood, by [`GAPS_MS`].
    pub updates: u64,
    /// See there.
    pub gaps: [u64; GAPS_MS.len()],
    /// The longest.
    pub longest_gap: Duration,
    /// Gaps of over 0.6 s on a link that stood, in words.
    pub late: Vec<String>,
    /// Honest commands given, and how they ended: stage, or that there was no answer.
    pub given: u32,
    /// See there.
    pub ended: BTreeMap<String, u32>,
    /// Commands that were not answered though the link stood and the lease was held, in words.
    pub lost: Vec<String>,
    /// Values that honest commands set, and how each ended.
    honest: BTreeMap<u64, Option<Stage>>,
    /// Values that took effect, oldest first.
    effects: Vec<u64>,
    /// What nobody commanded and happened, in words.
    pub spurious: Vec<String>,
    /// Restarts of actors by their name, summed over the runs of the service.
    pub restarts: BTreeMap<String, u32>,
    /// Refusals of commands by reason, summed over the runs.
    pub refused: BTreeMap<String, u32>,
    /// Updates that showed what the sensor gives, and values that it never gave, in words.
    pub sensor_shown: u64,
    /// See there.
    pub misread: Vec<String>,
    /// Series of several exposures, and those of this run: exposures by image.
    pub series: u32,
    /// See there.
    exposures: BTreeMap<u32, u8>,
    /// Images solved along the motion that gyros told.
    pub along: u32,
    /// Rates that were sent, by what they were, and how many blocks of them were refused.
    pub rates: BTreeMap<Rates, u32>,
    /// See there.
    pub rates_refused: u32,
    /// Refusals that there must be in this run.
    refusals_due: u32,
    /// Images of which rates were sent that may be used, by run.
    moved: BTreeSet<(usize, u32)>,
    /// What was done with rates that must not be, in words.
    pub rates_misused: Vec<String>,
    /// By run of the service and image.
    truths: BTreeMap<(usize, u32), Truth>,
    /// Images that were judged, by run and image.
    seen: BTreeSet<(usize, u32)>,
    /// The boots of the runs.
    boots: BTreeMap<u32, usize>,
    timeout: Option<u64>,
    /// States and frames that an open page got, and what it got that was wrong, in words.
    pub page_states: u64,
    /// See there.
    pub page_frames: u64,
    /// See there.
    pub page_wrong: Vec<String>,
    /// When a solution came last, or the flight began; and the longest time without one.
    solved_at: Option<Instant>,
    /// See there.
    pub longest_unsolved: Duration,
    /// When an update last told where the focus is, or the flight began.
    focus_known_at: Option<Instant>,
}

/// A run of the service that has ended.
#[derive(Debug, Clone)]
pub struct EndedRun {
    /// Its number, which is in the name of its file of outcomes.
    pub boot: u32,
    /// Frames that it took.
    pub frames: u32,
    /// Parts that did not end in time, because they were made to hang.
    pub late: Vec<&'static str>,
}

/// The account, shared by all that goes into it.
#[derive(Clone, Default)]
pub struct Account(Arc<Mutex<Book>>);

/// A float that can be looked up.
fn key(value: f64) -> u64 {
    value.to_bits()
}

impl Account {
    fn book(&self) -> MutexGuard<'_, Book> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// All that was counted by now.
    pub fn so_far(&self) -> Book {
        self.book().clone()
    }

    /// Runs of the service by now.
    pub fn runs(&self) -> usize {
        self.book().runs
    }

    /// The service is to start: images are numbered anew.
    pub fn begin_run(&self) {
        let mut book = self.book();
        book.runs += 1;
        book.solved_at.get_or_insert_with(Instant::now);
        book.focus_known_at.get_or_insert_with(Instant::now);
        book.unreadable.clear();
        book.exposures.clear();
        book.refusals_due = 0;
    }

    /// Time since the last solution, or since the flight began.
    pub fn unsolved_for(&self) -> Duration {
        self.book().solved_at.map_or(Duration::ZERO, |at| at.elapsed())
    }

    /// Time since an update last told where the focus is, or since the flight began.
    pub fn focus_unknown_for(&self) -> Duration {
        self.book().focus_known_at.map_or(Duration::ZERO, |at| at.elapsed())
    }

    /// The disk for images takes none for a while.
    pub fn disk_dies(&self) {
        self.book().excused = true;
    }

    /// An image cannot be read: there is nothing to keep.
    pub fn unreadable(&self, image: u32) {
        self.book().unreadable.insert(image);
    }

    /// It has started: its boot, and its settings as they are.
    pub fn begun_run(&self, boot: u32, timeout_s: f64) {
        let mut book = self.book();
        let run = book.runs;
        book.boots.insert(boot, run);
        book.timeout = Some(key(timeout_s));
    }

    /// The service has ended: its boot, what it counted, which images of this run are on disk and how many of its newest must be, and which
    /// parts of it did not end in time.
    pub fn end_run(&self, boot: u32, state: &State, on_disk: &(BTreeMap<u32, u8>, u32), late: Vec<&'static str>) {
        let mut book = self.book();
        book.end_images(state, on_disk);
        book.end_rates(state);
        book.note_time_unsolved();
        book.ended_runs.push(EndedRun { boot, frames: state.counters.frames_taken, late });
        book.frames += state.counters.frames_taken;
        book.records_lost += state.counters.records_lost;
        book.skipped += state.counters.frames_skipped;
        for (actor, count) in &state.counters.restarts {
            *book.restarts.entry(format!("{actor:?}").to_lowercase()).or_default() += count;
        }
        for (why, count) in &state.desk.counts.refused {
            *book.refused.entry(format!("{why:?}")).or_default() += count;
        }
    }

    /// What an image shows: an attitude, or nothing to solve. A capture that its camera's actor left behind may come to its end after the
    /// next one under its number; the last that was begun is the image.
    pub fn truth(&self, image: u32, truth: Truth) {
        let mut book = self.book();
        let run = book.runs;
        if truth.exposures > 1 {
            book.series += 1;
            book.exposures.insert(image, truth.exposures);
        }
        let known = book.truths.entry((run, image)).or_insert(truth);
        if truth.begun >= known.begun {
            *known = truth;
        }
        while book.truths.len() > REMEMBERED {
            book.truths.pop_first();
        }
    }

    /// An update came; `before`: when the one before it came, where nothing but the camera could hold it up since.
    pub fn update(&self, computer: usize, update: &Update, before: Option<Instant>) {
        let mut book = self.book();
        book.updates += 1;
        if let Some(before) = before {
            let gap = before.elapsed();
            let place = GAPS_MS.iter().position(|bound| gap.as_millis() <= u128::from(*bound)).unwrap_or(0);
            if let Some(count) = book.gaps.get_mut(place) {
                *count += 1;
            }
            book.longest_gap = book.longest_gap.max(gap);
            if gap > LATE {
                let text = format!("computer {computer}: {gap:?} at uptime {:.1} s", update.link.uptime_s);
                book.late.push(text);
            }
        }
        if update.camera.focus_counts.get().is_some() {
            book.focus_known_at = Some(Instant::now());
        }
        match update.housekeeping.temperature_lens_c.get() {
            Some(value) if *value == SENSOR_C => book.sensor_shown += 1,
            Some(value) => book.misread.push(format!("{value} °C at uptime {:.1} s", update.link.uptime_s)),
            None => {}
        }
        let Some(image) = update.image.get() else { return };
        let number = image.image_counter.get();
        let run = book.boots.get(&update.link.boot_id.get()).copied().unwrap_or_default();
        if !book.seen.insert((run, number)) {
            return;
        }
        while book.seen.len() > REMEMBERED {
            book.seen.pop_first();
        }
        let Some(pointing) = image.equatorial.get().filter(|_| image.reason.get() == Some(Reason::Solved)) else {
            book.unsolved += 1;
            return;
        };
        book.solved += 1;
        book.note_time_unsolved();
        book.solved_at = Some(Instant::now());
        let truth = book.truths.get(&(run, number)).copied();
        book.judge(&format!("run {run}, image {number}"), truth.and_then(|t| Judged::served(pointing, &t.attitude?)));
        let start = update.series.get().and_then(|series| series.start.get());
        if image.mode.get() == Some(SearchMode::Motion) {
            book.along += 1;
            let judged = start.zip(truth).and_then(|(start, t)| Judged::start(start, pointing, &t.start?));
            book.judge(&format!("run {run}, start of series {number}"), judged);
            if !book.moved.contains(&(run, number)) {
                book.rates_misused.push(format!("run {run}, image {number}: solved along a motion that nobody in charge told"));
            }
        }
    }

    /// A computer sends rates, of the image of that number of the run with that boot.
    pub fn rates(&self, boot: u32, image: u32, rates: Rates) {
        let mut book = self.book();
        *book.rates.entry(rates).or_default() += 1;
        if matches!(rates, Rates::Sound | Rates::Wrong)
            && let Some(run) = book.boots.get(&boot).copied()
        {
            book.moved.insert((run, image));
            while book.moved.len() > REMEMBERED {
                book.moved.pop_first();
            }
        }
    }

    /// So many blocks of rates must have been refused by the run with that boot.
    pub fn refusals_due(&self, boot: u32, count: u32) {
        let mut book = self.book();
        if book.boots.get(&boot) == Some(&book.runs) {
            book.refusals_due += count;
        }
    }

    /// Rates that were no numbers were answered, by that last word.
    pub fn answered(&self, word: Option<Refusal>) {
        if word != Some(Refusal::BadMessage) {
            self.book().rates_misused.push(format!("rates that are no numbers were answered with {word:?}"));
        }
    }

    /// The ground gives a command, with a value that no other has where it sets one.
    pub fn give(&self, command: &Command) {
        let mut book = self.book();
        book.given += 1;
        if let Command::ConfigureSolver { timeout_s, .. } = command {
            book.honest.insert(key(*timeout_s), None);
        }
    }

    /// A command had its last word; `None`: there was none, and `excused` says whether something stood in its way.
    pub fn end(&self, command: &Command, last: Option<&CommandReply>, excused: bool) {
        let mut book = self.book();
        let stage = last.and_then(|reply| reply.stage.get());
        let name = match stage {
            Some(Stage::Completed) => "completed",
            Some(Stage::Failed) => "failed",
            Some(Stage::Rejected) => "rejected",
            _ => "not answered",
        };
        let why = last.and_then(|reply| reply.why.value()).map_or_else(String::new, |why| format!(" {why:?}"));
        *book.ended.entry(format!("{name}{why}")).or_default() += 1;
        if stage.is_none() && !excused {
            book.lost.push(command.to_string());
        }
        if let Command::ConfigureSolver { timeout_s, .. } = command {
            book.honest.insert(key(*timeout_s), stage);
        }
    }

    /// A state of the service: what took effect.
    pub fn state(&self, state: &State) {
        let timeout_s = state.settings.solver.timeout_s;
        let mut book = self.book();
        book.excused |= state.strain.shed() >= Shed::Images;
        if book.timeout.replace(key(timeout_s)) == Some(key(timeout_s)) {
            return;
        }
        if timeout_s >= POISON_TIMEOUT_S {
            book.spurious.push(format!("solver.configure {timeout_s}"));
        } else if book.honest.contains_key(&key(timeout_s)) {
            book.effects.push(key(timeout_s));
        }
    }

    /// A page got a state.
    pub fn page_state(&self) {
        self.book().page_states += 1;
    }

    /// A page got a frame, whole.
    pub fn page_frame(&self) {
        self.book().page_frames += 1;
    }

    /// A page got something that is wrong.
    pub fn page_wrong(&self, what: String) {
        self.book().page_wrong.push(what);
    }

    /// A word of the lens moved it where nobody commanded.
    pub fn lens_moved(&self, word: &str) {
        self.book().spurious.push(format!("lens: {word}"));
    }
}

impl Book {
    /// Takes note of how a pointing compares with the truth; of `None` there was none.
    fn judge(&mut self, what: &str, judged: Option<Judged>) {
        match judged {
            Some(judged) if !judged.is_wrong() => {}
            Some(judged) => self.wrong.push(format!("{what}: off by {:.1}″, σ {:.2}″", judged.error, judged.sigma)),
            None => self.wrong.push(format!("{what}: solved, and there was nothing to solve")),
        }
    }

    /// The rates of a run that has ended: those were refused that had to be.
    fn end_rates(&mut self, state: &State) {
        let (refused, due) = (state.motions.refused, self.refusals_due);
        self.rates_refused += refused;
        if refused < due {
            let number = self.runs;
            self.rates_misused.push(format!("run {number}: {refused} blocks of rates refused, of {due} that had to be"));
        }
    }

    fn note_time_unsolved(&mut self) {
        let since = self.solved_at.map_or(Duration::ZERO, |at| at.elapsed());
        self.longest_unsolved = self.longest_unsolved.max(since);
    }

    /// The images of a run that has ended: none may be missing, but for a disk that was dead or full, or a computer that was too slow.
    fn end_images(&mut self, state: &State, (on_disk, newest): &(BTreeMap<u32, u8>, u32)) {
        let run = state.counters.images.get(&Disk::Images).copied().unwrap_or_default();
        let taken = state.counters.frames_taken;
        if !std::mem::take(&mut self.excused) {
            let newest = taken.saturating_sub(*newest)..taken;
            let is_missing = |image: &u32| {
                let (wanted, got) = (self.exposures.get(image).unwrap_or(&1), on_disk.get(image).unwrap_or(&0));
                wanted != got && !self.unreadable.contains(image)
            };
            let missing: Vec<u32> = newest.filter(is_missing).collect();
            if run.lost > 0 || !missing.is_empty() {
                let number = self.runs;
                self.images_missing.push(format!("run {number}: of {taken} frames {} were lost, missing {missing:?}", run.lost));
            }
        }
        // However it went with the disk, each was kept or is known to be lost. An archive that is started anew while it
        // writes one does not say what became of that.
        let read = (0..taken).filter(|image| !self.unreadable.contains(image));
        let exposures: u32 = read.map(|image| self.exposures.get(&image).copied().map_or(1, u32::from)).sum();
        let forgotten = state.counters.restarts.get(&Actor::Archive).copied().unwrap_or_default();
        let told = run.kept + run.lost;
        if !(exposures.saturating_sub(forgotten)..=exposures).contains(&told) {
            let (number, kept, lost) = (self.runs, run.kept, run.lost);
            self.images_missing.push(format!("run {number}: of {exposures} exposures {kept} were kept and {lost} lost"));
        }
        let sum = &mut self.images;
        sum.kept += run.kept;
        sum.lost += run.lost;
        sum.thinned += run.thinned;
        sum.disk_errors += run.disk_errors;
    }

    /// Honest commands whose doing shows, by how often they were done: never, once, more often.
    pub fn times_run(&self) -> [usize; 3] {
        let times = self.times();
        let mut counts = [0; 3];
        for value in self.honest.keys() {
            let place = times.get(value).copied().unwrap_or_default().min(2);
            if let Some(count) = counts.get_mut(place) {
                *count += 1;
            }
        }
        counts
    }

    fn times(&self) -> BTreeMap<u64, usize> {
        let mut times = BTreeMap::new();
        self.effects.iter().for_each(|value| *times.entry(*value).or_default() += 1);
        times
    }

    /// Honest commands that took effect more often, or less often, than their last words say, in words.
    pub fn contradictions(&self) -> Vec<String> {
        let times = self.times();
        let mut found = Vec::new();
        for (value, stage) in &self.honest {
            let times = times.get(value).copied().unwrap_or_default();
            let allowed = match stage {
                Some(Stage::Completed) => 1..=1,
                Some(Stage::Rejected) => 0..=0,
                _ => 0..=1,
            };
            if !allowed.contains(&times) {
                found.push(format!("solver.configure {}: {stage:?}, and took effect {times} times", f64::from_bits(*value)));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::Guard;
    use crate::settings::Settings;
    use crate::sky::DEG;
    use crate::wire::{Equatorial, Image, Link};

    fn configured(account: &Account, timeout_s: f64) {
        let mut settings = Settings::flight().unwrap();
        settings.solver.timeout_s = timeout_s;
        account.state(&State::new(Arc::new(settings), Guard::default()));
    }

    fn begun() -> Account {
        let account = Account::default();
        account.begin_run();
        account.begun_run(7, 10.0);
        account
    }

    fn reply(stage: Stage) -> CommandReply {
        CommandReply { stage: stage.into(), ..CommandReply::default() }
    }

    #[tokio::test]
    async fn what_nobody_commanded_and_what_ran_twice_or_not_at_all_is_found() {
        let account = begun();
        let give = |timeout_s| {
            let command = Command::ConfigureSolver { enabled: true, timeout_s };
            account.give(&command);
            command
        };
        let [once, twice, never, refused] = [5.0, 6.0, 7.0, 8.0].map(give);
        for timeout_s in [5.0, 5.0, 6.0, 5.5, 6.0, 8.0] {
            configured(&account, timeout_s);
        }
        for command in [once, twice, never] {
            account.end(&command, Some(&reply(Stage::Completed)), false);
        }
        account.end(&refused, Some(&reply(Stage::Rejected)), false);
        let book = account.so_far();
        assert_eq!((book.spurious.len(), book.lost.len()), (0, 0));
        let found = book.contradictions();
        assert_eq!(found.len(), 3, "{found:?}");
        assert_eq!(book.times_run(), [1, 2, 1]);
        configured(&account, POISON_TIMEOUT_S + 1.0);
        account.end(&give(9.0), None, true);
        assert_eq!((account.so_far().spurious.len(), account.so_far().lost.len()), (1, 0));
        account.end(&give(9.5), None, false);
        assert_eq!(account.so_far().lost, ["solver.configure 1 9.5"]);
    }

    #[tokio::test(start_paused = true)]
    async fn a_wrong_solution_a_late_update_and_a_value_that_no_sensor_gave_are_found() {
        let account = begun();
        let shows = |attitude| Truth { begun: Duration::from_secs(20), attitude, start: None, exposures: 1 };
        account.truth(1, shows(Some(Attitude::from_angles(1.0, 20.0 * DEG, 0.0))));
        account.truth(2, shows(None));
        // Left behind, and late.
        account.truth(1, Truth { begun: Duration::from_secs(10), attitude: None, start: None, exposures: 1 });
        let update = |image: u32, dec_deg: f64| {
            let pointing = Equatorial {
                ra_deg: 1.0 / DEG,
                dec_deg,
                sigma_east_arcsec: 0.5,
                sigma_north_arcsec: 0.5,
                platescale_arcsec_px: 9.5,
                ..Equatorial::default()
            };
            let image = Image {
                image_counter: image.into(),
                reason: Reason::Solved.into(),
                equatorial: Some(pointing).into(),
                ..Image::default()
            };
            let link = Link { boot_id: 7_u32.into(), ..Link::default() };
            Update { image: Some(image).into(), link, ..Update::default() }
        };
        let before = Instant::now();
        tokio::time::advance(Duration::from_millis(500)).await;
        account.update(1, &update(1, 20.0), Some(before));
        assert!(account.so_far().wrong.is_empty() && account.so_far().late.is_empty());
        tokio::time::advance(Duration::from_millis(101)).await;
        account.update(1, &update(2, 20.0), Some(before));
        let book = account.so_far();
        assert_eq!((book.wrong.len(), book.late.len(), book.solved), (1, 1, 2), "{:?}", book.wrong);
        account.truth(3, shows(Some(Attitude::from_angles(1.0, 20.0 * DEG, 0.0))));
        tokio::time::advance(Duration::from_secs(7 * 3600)).await;
        account.update(2, &update(3, 20.01), None);
        let book = account.so_far();
        assert_eq!((book.wrong.len(), book.longest_unsolved), (2, Duration::from_secs(7 * 3600)));

        let shown = |celsius: Option<f64>| {
            let mut update = Update::default();
            update.housekeeping.temperature_lens_c = celsius.into();
            account.update(1, &update, None);
            let book = account.so_far();
            (book.sensor_shown, book.misread.len())
        };
        assert_eq!([None, Some(SENSOR_C), Some(2.0)].map(shown), [(0, 0), (1, 0), (1, 1)]);
    }
}
