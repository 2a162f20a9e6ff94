//! The promise of the disk: what was told as kept is there and whole, and the log is complete, while the disk fills, fails and returns.
//!
//! `scripts/prove disk` runs it on ten thousand frames and a small disk of its own, which `STARS_DISK` names; elsewhere the disk is not
//! filled, but what is there has no room by its own rules.

use crate::support::*;
use stars::image::{checksum_holds, read};
use stars::service::{Disk, ImageCounters, Parts, Running, State};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Frames from one change of the disk to the next, at least.
const PHASE: u32 = 40;
/// Longest that the whole may take.
const WHOLE: Duration = Duration::from_secs(900);

fn counts(state: &State) -> ImageCounters {
    state.counters.images.get(&Disk::Images).copied().unwrap_or_default()
}

async fn until(running: &Running, wanted: impl FnMut(&Arc<State>) -> bool) -> Arc<State> {
    let mut state = running.state.clone();
    let seen = tokio::time::timeout(WHOLE, state.wait_for(wanted)).await.expect("it never came").unwrap();
    Arc::clone(&seen)
}

/// Takes all the room that there is.
fn fill(ballast: &Path) {
    let mut file = File::create(ballast).unwrap();
    // In smaller and smaller pieces, to the last byte.
    for piece in [1 << 20, 1 << 12, 1] {
        while file.write_all(&vec![0; piece]).is_ok() {}
    }
}

/// Puts each of two in the place of the other, at once.
fn exchange(one: &Path, other: &Path) {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE).unwrap();
}

/// The numbers of the images in a directory of days, each file whole.
fn whole_images(directory: &Path) -> BTreeSet<u32> {
    let entries =
        |directory: &Path| -> Vec<PathBuf> { fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path()).collect() };
    let mut numbers = BTreeSet::new();
    for file in entries(directory).iter().filter(|day| day.is_dir()).flat_map(|day| entries(day)) {
        // What was under way when the disk went is no file of ours, and nobody was told of it.
        if file.extension().is_none_or(|ending| ending != "fits") {
            continue;
        }
        let (name, bytes) = (file.display().to_string(), fs::read(&file).unwrap());
        assert_eq!(checksum_holds(&bytes), Some(true), "{name}");
        let image = read(&name, &bytes).unwrap();
        assert_eq!(image.pixels, frame().pixels, "{name}");
        assert!(numbers.insert(image.stamp.image.0), "kept twice: {name}");
    }
    numbers
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_frame_told_as_kept_is_whole_and_the_log_complete_while_the_disk_fills_fails_and_returns() {
    let frames: u32 = std::env::var("STARS_FRAMES").map_or(600, |number| number.parse().unwrap());
    let own = tempfile::tempdir().unwrap();
    let small_disk = std::env::var_os("STARS_DISK").map(PathBuf::from);
    let disk = small_disk.clone().unwrap_or_else(|| own.path().to_owned());
    let (record, gone, ballast) = (disk.join("record"), disk.join("gone"), disk.join("ballast"));
    let mut settings = settings();
    settings.camera.period_s = 0.002;
    settings.service.restart_delay_s = 0.01;
    settings.service.restart_delay_max_s = 0.05;
    (settings.record.enabled, settings.record.images) = (true, true);
    // Room for some ninety images: fewer than even a slow disk keeps of them.
    (settings.record.reserve_gib, settings.record.images_limit_gib) = (0.0005, 0.0005);
    (settings.record.queue_frames, settings.record.queue_images) = (4096, 64);
    settings.record.directory = record.display().to_string();
    let allowed = Arc::new(AtomicU32::new(0));
    fs::write(&gone, "").unwrap();
    let running = start(settings, Parts { camera: camera_of(&allowed), solver: plain_solver(), lens: None }).await;
    let mut taken = 0;
    let mut advance = async |more: u32| {
        taken = (taken + more).min(frames);
        allowed.store(taken, Ordering::Relaxed);
        until(&running, |state| state.counters.frames_taken >= taken).await;
        taken
    };
    let (mut filled, mut failed) = (0, 0);
    // What a disk in order had to keep is kept before it fails, so that what is lost is lost to a fault.
    while advance(PHASE).await < frames {
        if small_disk.is_some() {
            fill(&ballast);
            filled += 1;
            advance(2 * PHASE).await;
            fs::remove_file(&ballast).unwrap();
            advance(PHASE).await;
        }
        // A disk that is gone: nothing can be written where it was.
        exchange(&record, &gone);
        failed += 1;
        advance(2 * PHASE).await;
        exchange(&record, &gone);
        advance(PHASE).await;
    }
    let every = |state: &Arc<State>| state.counters.records_written + state.counters.records_lost >= frames;
    until(&running, |state| every(state) && counts(state).kept + counts(state).lost >= frames).await;
    let state = running.state.clone();
    assert!(running.stop().await.is_empty());
    let counters = state.borrow().counters.clone();
    let images = counts(&state.borrow());
    assert_eq!((counters.frames_taken, counters.records_lost), (frames, 0));
    assert!(images.disk_errors > 0 && images.lost > 0 && images.thinned > 0, "the disk was never in need: {images:?}");

    let logs: Vec<PathBuf> =
        fs::read_dir(&record).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file()).collect();
    let text: String = logs.iter().map(|log| fs::read_to_string(log).unwrap()).collect();
    let mut logged: Vec<u64> = text
        .lines()
        .filter(|line| !line.is_empty())
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["image_counter"].as_u64().unwrap())
        .collect();
    logged.sort_unstable();
    assert_eq!(logged, (0..u64::from(frames)).collect::<Vec<_>>(), "each frame has its line, and one alone");

    let whole = whole_images(&record.join("images"));
    // One that was whole when the disk went, before anybody was told, may be there besides.
    let told = images.kept - images.thinned;
    assert!((told..=told + images.disk_errors).contains(&(whole.len() as u32)), "{} on disk, {images:?}", whole.len());
    println!(
        "{frames} frames, the disk filled {filled} times, gone {failed} times: {} lines, {} images kept, {} thinned since, {} whole on \
         disk, {} lost and counted, {} errors of the disk told",
        logged.len(),
        images.kept,
        images.thinned,
        whole.len(),
        images.lost,
        images.disk_errors
    );
}
