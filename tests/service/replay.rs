//! The promise to operators: what the running service saw last can be run again in it, as it was or with other settings, beside live frames.

use crate::support::*;
use stars::image::Frame;
use stars::journal::{Reader, What};
use stars::service::{Now, Parts, ReplayError, Running, journals};
use stars::settings::Settings;
use stars::solve::{Outcome, Reason, Stop};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Kept in a directory.
pub fn keeping(directory: &Path) -> Settings {
    let mut settings = settings();
    settings.record.enabled = true;
    settings.record.images = true;
    settings.record.journal = true;
    settings.record.directory = directory.display().to_string();
    settings.record.reserve_gib = 0.0;
    settings.camera.period_s = 0.05;
    settings
}

/// A solver whose every frame ends as its pixels and the settings say, after so many questions whether to go on; it takes its time over each
/// where `slow` says so.
pub fn patient(slow: &Arc<AtomicU32>) -> stars::service::MakeSolver {
    let slow = Arc::clone(slow);
    solver(move |frame: &Frame, prior, watch| {
        let mut outcome = no_match(&frame.stamp);
        outcome.prior = prior.clone();
        let steps = u32::from(frame.pixels[0]);
        for step in 0..steps {
            if let Some(stop) = watch.stop() {
                let reason = if stop == Stop::TimedOut { Reason::TimedOut } else { Reason::Aborted };
                return Outcome { reason, detail: format!("after {step} steps"), ..outcome };
            }
            std::thread::sleep(Duration::from_millis(u64::from(slow.load(Ordering::Relaxed))));
        }
        outcome.detail = format!("{steps} steps");
        outcome
    })
}

/// A camera that gives as many frames as the number says by now, of as many steps as is said.
pub fn camera_of_steps(allowed: &Arc<AtomicU32>, steps: u16) -> Option<stars::service::MakeSource> {
    let allowed = Arc::clone(allowed);
    camera(move |moment| {
        if moment.image.0 >= allowed.load(Ordering::Relaxed) {
            return Err(stars::camera::CameraError::NothingNew);
        }
        let mut frame = frame();
        frame.pixels[0] = steps + moment.image.0 as u16;
        Ok(frame)
    })
}

/// Waits until so many frames are in the journal and their images on disk.
pub async fn written(running: &Running, frames: usize) {
    let began = tokio::time::Instant::now();
    while began.elapsed() < PATIENCE {
        let kept = running.state.borrow().counters.images.values().map(|images| images.kept).sum::<u32>();
        if running.replayer().recent() >= frames && kept as usize >= frames {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    panic!("{frames} frames were not written down");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_last_frames_come_out_the_same_and_a_stop_strikes_where_it_struck() {
    let directory = tempfile::tempdir().unwrap();
    let (allowed, slow) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
    let mut settings = keeping(directory.path());
    settings.solver.timeout_s = 5.0;
    let parts = Parts { camera: camera_of_steps(&allowed, 100), solver: patient(&slow), lens: None };
    let running = start(settings, parts).await;
    assert_eq!(running.replayer().run(20, Vec::new()).await, Err(ReplayError::Nothing));
    // Two whole ones, and then one that grows too old in the middle of its steps.
    for (number, ms) in [(1, 0), (2, 0), (3, 100)] {
        slow.store(ms, Ordering::Relaxed);
        allowed.store(number, Ordering::Relaxed);
        written(&running, number as usize).await;
    }
    slow.store(0, Ordering::Relaxed);
    let again = running.replayer().run(20, Vec::new()).await.unwrap();
    let ended: Vec<(u32, Reason)> = again.iter().map(|again| (again.image.0, again.was.reason)).collect();
    assert_eq!(ended, [(0, Reason::NoMatch), (1, Reason::NoMatch), (2, Reason::TimedOut)]);
    assert!(again.iter().all(|again| matches!(&again.now, Now::Again { differs, .. } if differs.is_empty())), "{again:?}");
    // With other settings it has its time anew, and this time it is enough.
    let again = running.replayer().run(1, vec!["solver.timeout_s=30".to_owned()]).await.unwrap();
    let [last] = &again[..] else { panic!("{again:?}") };
    assert!(matches!(&last.now, Now::Again { outcome, .. } if outcome.reason == Reason::NoMatch), "{last:?}");
    let refused = running.replayer().run(1, vec!["solver.no_such=1".to_owned()]).await;
    assert!(matches!(&refused, Err(ReplayError::Refused(why)) if why.contains("solver.no_such")), "{refused:?}");
    running.stop().await;
    // The journal of the run that is over tells all of it, and begins with its settings.
    let journals = journals(directory.path()).unwrap();
    let bytes: Vec<u8> = journals.iter().flat_map(|(path, _)| std::fs::read(path).unwrap()).collect();
    let mut reader = Reader::new(&bytes);
    let entries: Vec<_> = reader.by_ref().collect();
    assert!(matches!(&entries[0].what, What::Begin(begin) if begin.settings.toml.contains("timeout_s = 5.0")));
    assert_eq!(entries.iter().filter(|entry| matches!(entry.what, What::Solved(_))).count(), 3);
    assert_eq!(reader.skipped(), 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_replay_gives_way_to_each_live_frame_and_still_ends() {
    let directory = tempfile::tempdir().unwrap();
    let (allowed, slow) = (Arc::new(AtomicU32::new(2)), Arc::new(AtomicU32::new(0)));
    let mut settings = keeping(directory.path());
    settings.solver.timeout_s = 50.0;
    let parts = Parts { camera: camera_of_steps(&allowed, 10), solver: patient(&slow), lens: None };
    let running = start(settings, parts).await;
    written(&running, 2).await;
    slow.store(40, Ordering::Relaxed);
    let replayer = running.replayer();
    // Live frames come while it is at work: none is skipped or ends otherwise for it.
    let live = async {
        for image in 3..6 {
            allowed.store(image, Ordering::Relaxed);
            written(&running, image as usize).await;
        }
        slow.store(0, Ordering::Relaxed);
    };
    let (first, second, ()) = tokio::join!(replayer.run(2, Vec::new()), replayer.run(2, Vec::new()), live);
    assert_eq!(second, Err(ReplayError::Busy), "one at a time");
    let again = first.unwrap();
    assert_eq!(again.iter().map(|again| again.image.0).collect::<Vec<_>>(), [0, 1]);
    assert!(again.iter().all(|again| !again.differs()), "{again:?}");
    let counters = running.state.borrow().counters.clone();
    assert_eq!((counters.frames_taken, counters.frames_skipped), (5, 0));
    running.stop().await;
}

#[tokio::test]
async fn a_replay_that_live_frames_leave_no_time_is_given_up() {
    let directory = tempfile::tempdir().unwrap();
    let allowed = Arc::new(AtomicU32::new(2));
    let (go_on, wait) = std::sync::mpsc::channel::<()>();
    let wait = std::sync::Mutex::new(wait);
    // The third frame takes as long as it is let.
    let solver = solver(move |frame: &Frame, _, _| {
        if frame.stamp.image.0 == 2 {
            let _ = wait.lock().unwrap().recv();
        }
        no_match(&frame.stamp)
    });
    let running = start(keeping(directory.path()), Parts { camera: camera_of_steps(&allowed, 1), solver, lens: None }).await;
    written(&running, 2).await;
    allowed.store(3, Ordering::Relaxed);
    running.state.clone().wait_for(|state| state.solving.is_some()).await.unwrap();
    let replayer = running.replayer();
    let given_up = tokio::spawn(async move { replayer.run(2, Vec::new()).await });
    // It begins, and waits. Then all its time goes by at once: whatever else that wakes, none is left for it.
    tokio::task::yield_now().await;
    tokio::time::pause();
    tokio::time::advance(Duration::from_secs(301)).await;
    assert_eq!(given_up.await.unwrap(), Err(ReplayError::NoTime));
    drop(go_on);
}
