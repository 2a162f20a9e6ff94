//! Gyro rates of the flight computer in charge reach the solver with the exposures of their image; without them it is solved as ever.

use super::support::*;
use stars::camera::{CameraError, Moment, Source};
use stars::image::{Frame, Series};
use stars::service::{MakeSource, Parts, Solve};
use stars::solve::{Exposures, Outcome, Prior, Reason, Report, SearchMode, Watch};
use stars::wire::{Exposure, Gyro, List, Message, Rates, Status, Update};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

const TRIGGER: u32 = 77;

/// A camera that gives series of three exposures, as many as the number says by now.
fn series(allowed: &Arc<AtomicU32>) -> Option<MakeSource> {
    struct Camera(Arc<AtomicU32>);
    impl Source for Camera {
        fn next(&mut self, moment: &Moment) -> Result<Series, CameraError> {
            if moment.image.0 >= self.0.load(Ordering::Relaxed) {
                return Err(CameraError::NothingNew);
            }
            Ok(Series::new(vec![frame(); 3]).unwrap())
        }
    }
    let allowed = Arc::clone(allowed);
    Some(Arc::new(move || Ok(Box::new(Camera(Arc::clone(&allowed))) as Box<dyn Source>)))
}

/// A solver that finds nothing, and by the motion nothing either, but says so.
struct Says;

impl Solve for Says {
    fn solve(&mut self, frame: &Frame, _: &Prior, _: &dyn Watch) -> Outcome {
        no_match(&frame.stamp)
    }
    fn solve_series(&mut self, frame: &Frame, series: &Exposures, _: &Prior, _: &dyn Watch) -> Outcome {
        if series.motion.is_none() {
            return no_match(&frame.stamp);
        }
        let detail = format!("{} exposures of {}", series.exposures.len(), frame.stamp.exposures);
        let mut outcome = Outcome::unsolved(frame.stamp.clone(), Reason::NoMatch, detail);
        outcome.mode = SearchMode::Motion;
        outcome
    }
    fn report(&self, outcome: &Outcome) -> Report {
        Report::without_stars(outcome)
    }
}

fn gyro(image: u32) -> Message {
    let exposure = |k: u32| Exposure { start_s: 0.1 + 0.3 * k as f32, duration_s: 0.1 };
    Message::Gyro(Box::new(Gyro {
        trigger_counter: TRIGGER.into(),
        image_counter: image.into(),
        sample_rate_hz: 100.0,
        elevation_deg: Some(40.0).into(),
        exposures_count: 3,
        exposures: List::from_slice(&[0, 1, 2].map(exposure)),
        samples_count: 100.into(),
        samples: List::from_slice(&[Rates { az_rate_deg_s: 0.05, el_rate_deg_s: 0.0 }; 100]),
        ..Gyro::default()
    }))
}

fn ended(update: &Update) -> Option<(u32, SearchMode, String)> {
    let image = update.image.get()?;
    Some((image.image_counter.get(), image.mode.get()?, image.detail.to_string()))
}

#[tokio::test]
async fn an_image_that_is_not_solved_waits_for_its_motion_and_not_for_ever() {
    let allowed = Arc::new(AtomicU32::new(0));
    let mut settings = settings();
    settings.solver.motion.wait_s = 2.0;
    let solver: stars::service::MakeSolver = Arc::new(|| Ok(Box::new(Says) as Box<dyn Solve>));
    let running = start(settings, Parts { camera: series(&allowed), solver, lens: None }).await;
    let mut computer = Peer::connect(running.address).await.greet(1).await;
    let said = || Status { trigger_counter: Some(TRIGGER).into(), ..claim() };
    loop {
        computer.status(said()).await;
        if computer.update().await.authority.you_are_in_charge {
            break;
        }
    }
    // One that comes before its image, with which the solver begins.
    computer.send(gyro(0)).await;
    tokio::time::sleep(std::time::Duration::from_millis(200)).await;
    let mut images = Vec::new();
    for (image, late) in [(0, false), (1, true), (2, false)] {
        allowed.store(image + 1, Ordering::Relaxed);
        // The second one's comes once it has been found unsolved, the third one's never.
        if late {
            tokio::time::sleep(std::time::Duration::from_millis(700)).await;
            computer.send(gyro(image)).await;
        }
        loop {
            computer.status(said()).await;
            if let Some(ended) = ended(&computer.update().await).filter(|ended| ended.0 == image) {
                images.push(ended);
                break;
            }
        }
    }
    let with = "3 exposures of 3".to_owned();
    assert_eq!(images[0], (0, SearchMode::Motion, with.clone()));
    assert_eq!(images[1], (1, SearchMode::Motion, with));
    assert_eq!(images[2], (2, SearchMode::Normal, "nothing".to_owned()));
    running.stop().await;
}
