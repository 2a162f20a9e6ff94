//! Exposure and gain that follow the sky, and that stay as they are where they are not to.

use crate::commands::Ground;
use crate::support::*;
use stars::camera::{CameraError, Moment, Source};
use stars::command::Stage;
use stars::image::{Frame, Series};
use stars::service::{MakeSource, Parts, Running};
use stars::settings::Settings;
use stars::sky::RowOrder;
use stars::solve::{Outcome, Statistics};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

const FULL_SCALE: u16 = 4095;

/// A camera under a sky of so many ADU a second at 0 dB.
struct UnderSky {
    adu_s: Arc<AtomicU32>,
    exposure_s: f64,
    gain_db: f64,
}

impl Source for UnderSky {
    fn next(&mut self, _moment: &Moment) -> Result<Series, CameraError> {
        let light = f64::from(self.adu_s.load(Ordering::Relaxed)) * self.exposure_s * 10_f64.powf(self.gain_db / 20.0);
        let adu = light.min(f64::from(FULL_SCALE)) as u16;
        let mut frame = Frame::new(16, 16, vec![adu; 256], RowOrder::BottomFirst).unwrap();
        frame.full_scale = Some(FULL_SCALE);
        frame.stamp.exposure_s = Some(self.exposure_s);
        Ok(frame.into())
    }

    fn gain(&mut self) -> Result<f64, CameraError> {
        Ok(self.gain_db)
    }

    fn set_gain(&mut self, gain_db: f64) -> Result<(), CameraError> {
        self.gain_db = gain_db;
        Ok(())
    }

    fn exposure(&mut self) -> Result<f64, CameraError> {
        Ok(self.exposure_s)
    }

    fn set_exposure(&mut self, exposure_s: f64) -> Result<(), CameraError> {
        self.exposure_s = exposure_s;
        Ok(())
    }
}

/// A service under that sky, whose solver looks at frames and never finds anything.
async fn under(adu_s: &Arc<AtomicU32>, settings: Settings) -> Running {
    let adu_s = Arc::clone(adu_s);
    let make: MakeSource =
        Arc::new(move || Ok(Box::new(UnderSky { adu_s: Arc::clone(&adu_s), exposure_s: 0.12, gain_db: 0.0 }) as Box<dyn Source>));
    let looks = solver(|frame, _, _| {
        let mean = frame.pixels.iter().map(|pixel| f64::from(*pixel)).sum::<f64>() / frame.pixels.len() as f64;
        let saturated = frame.pixels.iter().filter(|pixel| **pixel >= FULL_SCALE).count();
        let statistics = Statistics {
            mean,
            saturated_px: saturated,
            saturated_fraction: saturated as f64 / frame.pixels.len() as f64,
            ..Statistics::default()
        };
        Outcome { statistics: Some(statistics), ..no_match(&frame.stamp) }
    });
    start(settings, Parts { camera: Some(make), solver: looks, lens: None }).await
}

/// Exposure, gain and level, of full scale, of the newest frame, some time later.
async fn later(running: &Running) -> (f64, Option<f64>, f64) {
    tokio::time::sleep(Duration::from_secs(5)).await;
    shown(running)
}

fn shown(running: &Running) -> (f64, Option<f64>, f64) {
    let state = Arc::clone(&running.state.borrow());
    let outcome = &state.latest.as_ref().unwrap().outcome;
    let level = outcome.statistics.as_ref().unwrap().mean / f64::from(FULL_SCALE);
    (outcome.stamp.exposure_s.unwrap(), outcome.stamp.gain_db, level)
}

#[tokio::test(start_paused = true)]
async fn a_sky_that_brightens_tenfold_is_kept_between_its_levels() {
    let mut settings = settings();
    settings.auto_exposure.enabled = true;
    let (low, high) = (settings.auto_exposure.sky_low, settings.auto_exposure.sky_high);
    let (shortest_s, longest_s) = (settings.auto_exposure.exposure_min_s, settings.auto_exposure.exposure_max_s);
    let adu_s = Arc::new(AtomicU32::new(8_000));
    let running = under(&adu_s, settings).await;
    let mut exposures = Vec::new();
    for sky in [8_000, 80_000, 8_000, 800] {
        adu_s.store(sky, Ordering::Relaxed);
        let (exposure_s, gain_db, level) = later(&running).await;
        assert!((low..=high).contains(&level), "{level} of full scale under {sky} ADU/s, with {exposure_s} s, {gain_db:?} dB");
        assert!((shortest_s..=longest_s).contains(&exposure_s));
        exposures.push(exposure_s);
    }
    assert!(exposures[1] < exposures[0] / 3.0, "{exposures:?}");
    let state = running.state.borrow().clone();
    assert!(state.camera_gain.is_some_and(|gain_db| gain_db > 1.0), "the longest exposure is too short for the last");
}

#[tokio::test(start_paused = true)]
async fn where_it_is_off_nothing_is_changed() {
    let adu_s = Arc::new(AtomicU32::new(8_000));
    let running = under(&adu_s, settings()).await;
    adu_s.store(80_000, Ordering::Relaxed);
    assert_eq!(later(&running).await, (0.12, Some(0.0), 1.0), "saturated, and let alone");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_gain_that_is_commanded_stays_and_the_exposure_follows_alone() {
    let mut settings = settings();
    settings.auto_exposure.enabled = true;
    settings.camera.period_s = 0.02;
    let (low, high) = (settings.auto_exposure.sky_low, settings.auto_exposure.sky_high);
    let adu_s = Arc::new(AtomicU32::new(8_000));
    let running = under(&adu_s, settings).await;
    let mut ground = Ground::of(&running, 1, true);
    assert_eq!(ground.run("camera.set_gain 12").await.0.last(), Some(&Stage::Completed));
    for sky in [80_000, 8_000, 800] {
        adu_s.store(sky, Ordering::Relaxed);
        let mut state = running.state.clone();
        let taken = state.borrow().counters.frames_taken;
        // More than it takes from any light to any other.
        let then = state.wait_for(|state| state.counters.frames_taken >= taken + 40);
        drop(tokio::time::timeout(PATIENCE, then).await.expect("no frames").unwrap());
        let (exposure_s, gain_db, level) = shown(&running);
        assert_eq!(gain_db, Some(12.0), "under {sky} ADU/s");
        let (least, most) = if sky == 800 { (0.0, high) } else { (low, high) };
        assert!((least..=most).contains(&level), "{level} of full scale under {sky} ADU/s, with {exposure_s} s");
    }
}
