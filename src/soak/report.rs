//! The report of a flight: what was wanted, what was got, and the seed that flies it again.

use super::account::{Book, EndedRun, GAPS_MS, Rates};
use super::flight::Plan;
use super::images;
use super::resources::{Held, judge};
use super::schedule::Class;
use crate::service::ImageCounters;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Duration;

/// Faults of the lens and of the sky may cost solutions for so long, and no longer: a proof that solves nothing proves little.
const LONGEST_UNSOLVED: Duration = Duration::from_secs(6 * 3600);
/// Of so many series with sound rates one at least is solved along them: the first of a run is not, since nobody waits for them yet.
const SERIES_ENOUGH: u32 = 10;
/// Examples that are printed of what went wrong.
const EXAMPLES: usize = 5;

/// What came of a flight.
#[derive(Debug, Clone)]
pub struct Report {
    /// The lines, for people.
    pub text: String,
    /// Nothing was lost or wrong.
    pub good: bool,
}

impl Report {
    /// Closes the books of a flight.
    pub fn new(plan: &Plan, flown: Duration, book: &Book, faults: &BTreeMap<Class, u32>, held: &[Held]) -> Self {
        let mut report = Self { text: String::new(), good: true };
        report.tell_faults(plan, flown, faults);
        report.tell_counts(plan, book);
        report.judge_counts(plan, book);
        let (words, grown) = judge(held, plan.real);
        words.iter().for_each(|words| report.line(words));
        if !words.is_empty() {
            report.want("memory, threads and descriptors at the end within 5 % of what they were after the beginning", &grown);
        }
        let kind = if plan.real { " --real" } else { "" };
        report.line(&format!(
            "again: stars soak{kind} --seed {} --duration {}s --every {}s",
            plan.seed,
            plan.duration.as_secs(),
            plan.every.as_secs()
        ));
        report
    }

    /// The flight, and what went wrong in it as the schedule wanted.
    fn tell_faults(&mut self, plan: &Plan, flown: Duration, faults: &BTreeMap<Class, u32>) {
        let (total, least) = (faults.values().sum::<u32>(), faults.values().min().copied().unwrap_or(0));
        self.line(&format!(
            "seed {}: {:.2} days flown, {total} faults of {} classes, each {least} times or more",
            plan.seed,
            flown.as_secs_f64() / 86_400.0,
            faults.len()
        ));
        for (class, count) in faults {
            self.line(&format!("  {count:5} {}", class.name()));
        }
    }

    /// What was counted.
    fn tell_counts(&mut self, plan: &Plan, book: &Book) {
        self.line(&format!(
            "{} frames in {} runs of the service, {} skipped; of those that updates showed {} solved and {} not",
            book.frames, book.runs, book.skipped, book.solved, book.unsolved
        ));
        let gaps: Vec<String> = GAPS_MS
            .iter()
            .zip(book.gaps)
            .map(|(bound, count)| if *bound == u64::MAX { format!("over: {count}") } else { format!("≤ {bound} ms: {count}") })
            .collect();
        let clock = if plan.real { "in real time" } else { "on the soak's clock, to which the solver's CPU time is charged" };
        self.line(&format!("{} updates; time between two on a link that stood, {clock}: {}", book.updates, gaps.join(", ")));
        self.line(&format!("commands given {}: {:?}; refused blocks and slots {:?}", book.given, book.ended, book.refused));
        let [never, once, more] = book.times_run();
        self.line(&format!("of those whose doing shows {once} were done once, {never} never, {more} more often"));
        self.line(&format!("an open page got {} states and {} frames, whole", book.page_states, book.page_frames));
        self.line(&format!(
            "{} series of several exposures, {} solved along the motion that gyros told; blocks of rates sent {:?}, refused {}",
            book.series, book.along, book.rates, book.rates_refused
        ));
        self.line(&format!("restarts of actors: {:?}", book.restarts));
    }

    /// What must not be.
    fn judge_counts(&mut self, plan: &Plan, book: &Book) {
        self.want("no wrong solution", &book.wrong);
        self.want("rates refused that must be, and none used but of the computer in charge for its image", &book.rates_misused);
        self.want("no update late by over 0.1 s on a link that stood", &book.late);
        self.want("nothing done that nobody commanded", &book.spurious);
        self.want("no value shown that the sensor did not give", &book.misread);
        self.want("no command lost", &book.lost);
        self.want("nothing wrong on an open page", &book.page_wrong);
        self.want("each command done once where it was said to be done, never twice", &book.contradictions());
        let kept = records(&plan.directory.join("record"));
        let differing = book.ended_runs.iter().filter_map(|EndedRun { boot, frames, late }| {
            let kept = kept.get(boot).copied().unwrap_or_default();
            let text = || format!("run {boot:08x}: {frames} frames, {kept} outcomes; not ended in time: {late:?}");
            (kept != u64::from(*frames)).then(text)
        });
        let mut lost: Vec<String> = differing.collect();
        if book.records_lost > 0 {
            lost.push(format!("{} said to be lost", book.records_lost));
        }
        self.want("an outcome kept of every frame", &lost);
        let (files, bytes, broken) = images::judge(&plan.directory.join("record").join("images"));
        let ImageCounters { kept, lost, thinned, disk_errors } = book.images;
        self.line(&format!(
            "images: {kept} kept, {lost} not, their disk dead or full ({disk_errors} errors) or the computer too slow, {thinned} gone to make room; \
             {files} files of {:.2} GB at the end",
            bytes as f64 / 1e9
        ));
        self.want(
            "every exposure kept while its disk took any, or told as lost, the newest of each run there",
            &book.images_missing,
        );
        self.want("every image on disk whole, under its checksum", &broken);
        let sound = book.rates.get(&Rates::Sound).copied().unwrap_or_default();
        let some = |what: &str, count: u64| (count == 0).then(|| format!("no {what}"));
        let nothing: Vec<String> = [
            some("frame", book.frames.into()),
            some("solution", book.solved.into()),
            some("update", book.updates),
            some("series solved along its motion", if sound < SERIES_ENOUGH { 1 } else { book.along.into() }),
            some("value of the sensor", book.sensor_shown),
            some("state on the page", book.page_states),
            some("frame on the page", book.page_frames),
        ]
        .into_iter()
        .flatten()
        .collect();
        self.want("frames, solutions, updates, values of the sensor, states and frames on the page", &nothing);
        let unsolved = book.longest_unsolved;
        let long = (unsolved > LONGEST_UNSOLVED).then(|| format!("{:.1} h without one", unsolved.as_secs_f64() / 3600.0));
        self.want("a solution at least every six hours", &long.into_iter().collect::<Vec<_>>());
    }

    fn line(&mut self, line: &str) {
        let _ = writeln!(self.text, "{line}");
    }

    fn want(&mut self, wanted: &str, problems: &[String]) {
        let verdict = if problems.is_empty() { "PASS" } else { "FAIL" };
        self.good &= problems.is_empty();
        self.line(&format!("wanted: {wanted}  got: {} problems  {verdict}", problems.len()));
        problems.iter().take(EXAMPLES).for_each(|problem| self.line(&format!("  {problem}")));
    }
}

/// Whole lines in the files of records, by the boot of the run that wrote them.
fn records(directory: &Path) -> BTreeMap<u32, u64> {
    let files = std::fs::read_dir(directory).into_iter().flatten().flatten();
    let lines = |file: std::fs::DirEntry| {
        let path = Some(file.path()).filter(|path| path.extension().is_some_and(|ending| ending == "jsonl"))?;
        let boot = u32::from_str_radix(path.file_stem()?.to_str()?.rsplit('-').next()?, 16).ok()?;
        Some((boot, std::fs::read(path).ok()?.split(|byte| *byte == b'\n').count() as u64 - 1))
    };
    files.filter_map(lines).collect()
}
