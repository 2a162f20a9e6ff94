//! What the process holds of the machine: memory, threads and files, over a flight. None may grow.

use std::time::Duration;

/// What is held at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Held {
    /// Time flown.
    pub at: Duration,
    /// Resident memory, KiB.
    pub resident_kib: u64,
    /// Threads.
    pub threads: u64,
    /// Open descriptors.
    pub descriptors: u64,
}

/// Most by which the end of a flight may hold more than the time after its beginning.
const GROWTH: f64 = 0.05;
/// The beginning, in which memory is taken for good, and then as long a time over and over: a day of a flight on a clock that jumps, and a
/// quarter of an hour in real time.
const WINDOW: Duration = Duration::from_secs(86_400);
/// See [`WINDOW`].
const REAL_WINDOW: Duration = Duration::from_secs(900);
/// The floor of a window: a tenth of the time less was held. What a fault makes the service hold (images while their disk is dead, a
/// solver that hangs and was given up) it lets go when the fault ends, and holds for half of a window now and then; what leaks lifts
/// the floor. Floors differ by a tenth by chance (what the allocator gives back, and when), so all windows tell how they grow. What is held at
/// most may grow no more than the floor.
const FLOOR: f64 = 0.1;

const THREADS: &str = "threads";

impl Held {
    /// What this process holds now; `None` where the system does not say.
    pub fn now(at: Duration) -> Option<Self> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let value = |name: &str| {
            let line = status.lines().find_map(|line| line.strip_prefix(name))?;
            line.trim_start_matches(':').split_whitespace().next()?.parse().ok()
        };
        // One of them is that of the directory itself.
        let descriptors = (std::fs::read_dir("/proc/self/fd").ok()?.count() as u64).saturating_sub(1);
        Some(Self { at, resident_kib: value("VmRSS")?, threads: value("Threads")?, descriptors })
    }
}

/// One quantity over a flight.
struct Course {
    name: &'static str,
    unit: &'static str,
    /// The floor in the window after the beginning and in the last one, as all windows between tell them.
    early: f64,
    late: f64,
    /// Before the end, and over all.
    most_before: f64,
    most: f64,
    /// A step of the quantity itself, which is no growth.
    step: f64,
}

/// The courses of a flight, in words, and what has grown; no words where a flight is too short for them.
pub fn judge(samples: &[Held], real: bool) -> (Vec<String>, Vec<String>) {
    let Some(flown) = samples.last().map(|last| last.at) else { return (Vec::new(), Vec::new()) };
    let window = if real { REAL_WINDOW } else { WINDOW };
    if flown < window * 3 {
        return (Vec::new(), Vec::new());
    }
    let within = |from: Duration, to: Duration| samples.iter().filter(move |held| held.at > from && held.at <= to);
    let windows = (flown.as_secs() / window.as_secs()) as u32;
    let course = |name, unit, step, of: fn(&Held) -> f64| {
        let floors = (1..windows).map(|i| quantile(within(window * i, window * (i + 1)).map(of).collect(), FLOOR));
        let (early, late) = ends(&floors.collect::<Vec<_>>());
        let most_before = within(Duration::ZERO, flown - window).map(of).fold(0.0, f64::max);
        Course { name, unit, early, late, most_before, most: samples.iter().map(of).fold(0.0, f64::max), step }
    };
    let courses = [
        course("resident memory", " MiB", 0.0, |held| held.resident_kib as f64 / 1024.0),
        course(THREADS, "", 1.0, |held| held.threads as f64),
        course("descriptors", "", 1.0, |held| held.descriptors as f64),
    ];
    let hours = window.as_secs_f64() / 3600.0;
    let words = |course: &Course| {
        let Course { name, unit, early, late, most, .. } = course;
        format!(
            "{name}: a floor of {early:.0}{unit} in the second {hours:.1} h, {late:.0}{unit} in the last, {most:.0}{unit} at most"
        )
    };
    let exceeds = |course: &Course, now: f64, then: f64| now > (then * (1.0 + GROWTH)).max(then + course.step);
    // How many threads faults need at a time is chance.
    let most_counts = |course: &Course| course.name != THREADS;
    let grown = |course: &&Course| {
        exceeds(course, course.late, course.early) || (most_counts(course) && exceeds(course, course.most, course.most_before))
    };
    (courses.iter().map(words).collect(), courses.iter().filter(grown).map(words).collect())
}

/// The value below which this part of some are.
fn quantile(mut values: Vec<f64>, part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get((part * values.len() as f64) as usize).copied().unwrap_or_default()
}

/// Both ends of a straight line through some values, of which a third may be off by anything: its slope is the middle one of those of all
/// pairs (Sen, J. Am. Stat. Assoc. 63, 1379, 1968).
fn ends(values: &[f64]) -> (f64, f64) {
    let at = || values.iter().enumerate().map(|(i, value)| (i as f64, *value));
    let slopes = at().flat_map(|(i, a)| at().filter(move |(j, _)| *j > i).map(move |(j, b)| (b - a) / (j - i)));
    let slope = quantile(slopes.collect(), 0.5);
    let begin = quantile(at().map(|(i, value)| value - slope * i).collect(), 0.5);
    (begin, begin + slope * values.len().saturating_sub(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flight(hours: u64, resident_kib: impl Fn(u64) -> u64) -> Vec<Held> {
        let hour = |hour| Held {
            at: Duration::from_secs(3600 * hour),
            resident_kib: resident_kib(hour),
            // A thread more or less is chance.
            threads: 5 + hour / 200,
            descriptors: 12,
        };
        (1..=hours).map(hour).collect()
    }

    #[test]
    fn what_this_process_holds_can_be_read() {
        let held = Held::now(Duration::ZERO).unwrap();
        assert!(held.resident_kib > 1000 && held.threads >= 1 && held.descriptors >= 3, "{held:?}");
    }

    #[test]
    fn growth_after_the_first_day_is_found_and_what_is_taken_in_it_is_none() {
        let (words, grown) = judge(&flight(264, |hour| if hour < 20 { 50_000 } else { 250_000 + 100 * (hour % 7) }), false);
        assert_eq!((words.len(), grown.len()), (3, 0), "{words:?} {grown:?}");
        assert!(words[0].starts_with("resident memory: a floor of 244 MiB in the second 24.0 h"), "{words:?}");
        let (_, grown) = judge(&flight(264, |hour| 250_000 + 60 * hour), false);
        assert_eq!(grown.len(), 1, "{grown:?}");
    }

    #[test]
    fn what_a_fault_holds_for_half_of_the_last_day_is_no_growth() {
        let held = |hour: u64| if hour.is_multiple_of(100) || (246..258).contains(&hour) { 350_000 } else { 250_000 };
        let (words, grown) = judge(&flight(264, held), false);
        assert!(grown.is_empty() && words[0].ends_with("342 MiB at most"), "{words:?} {grown:?}");
        // More than was ever held before is.
        let (_, grown) = judge(&flight(264, |hour| if hour > 252 { 450_000 } else { held(hour) }), false);
        assert_eq!(grown.len(), 1, "{grown:?}");
    }

    #[test]
    fn what_an_allocator_gives_back_now_and_then_is_no_growth_and_does_not_hide_one() {
        // What it held on eleven days, by the tenth of each that it held least, MiB.
        let floors = [193, 185, 200, 198, 185, 177, 200, 197, 200, 198, 198];
        let held = |hour: u64| 1024 * floors[(hour as usize - 1) / 24 % floors.len()];
        let (words, grown) = judge(&flight(264, held), false);
        assert!(grown.is_empty(), "{words:?}");
        let (words, grown) = judge(&flight(264, |hour| held(hour) + 60 * hour), false);
        assert_eq!(grown.len(), 1, "{words:?}");
    }

    #[test]
    fn a_flight_too_short_to_tell_is_not_judged() {
        assert_eq!(judge(&flight(20, |hour| 1000 * hour), false), (Vec::new(), Vec::new()));
    }
}
