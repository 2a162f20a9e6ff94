//! Series of exposures of faint, trailed stars, and what gyros saw of them.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use stars::catalog::Catalogue;
use stars::image::{Frame, coadd};
use stars::simulate::measured;
use stars::simulate::sky::{Kind, Part, RenderSpec, render};
use stars::sky::{ARCSEC, Attitude, DEG, Vec3};
use stars::solve::Motion;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Length of one exposure and of the pause after it, s (the paper: 120 ms, 190 ms); samples a second, Hz.
const EXPOSURE_S: f64 = 0.12;
const GAP_S: f64 = 0.19;
const SAMPLE_HZ: f64 = 100.16;
/// Before the first exposure, s.
const LEAD_S: f64 = 0.05;
/// Length of a trail in one exposure, px.
const STREAK_PX: (f64, f64) = (5.0, 30.0);
/// Stars, and the signal over noise in a single exposure of the faintest and of the brightest.
const STARS: (usize, usize) = (8, 15);
const SNR: (f64, f64) = (3.0, 6.0);
/// Plate scale by which streaks are drawn, arcsec/px.
const PLATESCALE_ARCSEC: f64 = 9.44;

/// How much brighter stars are made than they are to see which are the brightest.
const PROBE: f64 = 10.0;

/// A series as it was, and as the gyros saw it.
pub struct Drawn {
    pub truth: Motion,
    pub measured: Motion,
    pub exposures: Vec<Arc<Frame>>,
    pub sum: Frame,
    /// Attitude in the middle of the series.
    pub middle: Attitude,
    /// Stars that stand above the noise of a single exposure as said.
    pub stars: usize,
}

/// One to four exposures, by the index; `gyro_noise`: arcsec/s/√Hz.
pub fn draw(catalogue: &Catalogue, seed: u64, index: u64, gyro_noise: f64) -> Drawn {
    let mut random = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(0x9e37_79b9).wrapping_add(index));
    let count = 1 + (index % 4) as usize;
    let uniform = |random: &mut ChaCha8Rng, (low, high): (f64, f64)| low + (high - low) * random.random::<f64>();
    let (streak, heading) = (uniform(&mut random, STREAK_PX), uniform(&mut random, (0.0, TAU)));
    let rate = streak * PLATESCALE_ARCSEC * ARCSEC / EXPOSURE_S;
    let (elevation, roll) = (uniform(&mut random, (20.0, 50.0)) * DEG, uniform(&mut random, (-3.0, 3.0)) * DEG);
    let length = LEAD_S + count as f64 * (EXPOSURE_S + GAP_S);
    let samples = (length * SAMPLE_HZ).ceil() as usize + 1;
    // The direction turns by up to a quarter of a turn a second.
    let bend = uniform(&mut random, (-0.25, 0.25)) * TAU;
    let rates: Vec<(f64, f64)> = (0..samples)
        .map(|i| {
            let heading = heading + bend * i as f64 / SAMPLE_HZ;
            (rate * heading.cos() / elevation.cos(), rate * heading.sin())
        })
        .collect();
    let exposures = (0..count).map(|k| (LEAD_S + k as f64 * (EXPOSURE_S + GAP_S), EXPOSURE_S)).collect();
    let truth = Motion { rates, sample_rate_hz: SAMPLE_HZ, exposures, elevation, roll, drift: gyro_noise * ARCSEC };
    let measured = measured(&truth, gyro_noise * ARCSEC, &mut random);
    let wanted = random.random_range(STARS.0..=STARS.1);
    let turns = |k: usize| -> Vec<Vec3> {
        let (start, length) = truth.exposures[k];
        let steps = (3.0 * streak).ceil() as usize;
        let track = truth.track();
        (0..steps).map(|i| track.turn_at(start + length * (i as f64 + 0.5) / steps as f64)).collect()
    };
    let spec = |place: usize, starlight: f64, most_flux_adu: f64| RenderSpec {
        photon_bound: false,
        part: Some(Part { place: place as u8, turns: turns(place), starlight, most_flux_adu }),
        ..RenderSpec::new(Kind::Motion, seed, index)
    };
    // How bright the stars are by themselves, and so how much they are dimmed.
    let probe = render(&spec(0, PROBE, f64::INFINITY), catalogue).unwrap().truth;
    let mut stars: Vec<(f64, f64)> = probe.stars.iter().map(|star| (star.snr, star.flux_adu)).collect();
    stars.sort_by(|a, b| b.0.total_cmp(&a.0));
    let faintest = stars[wanted.min(stars.len()) - 1];
    let (starlight, most) = (PROBE * SNR.0 / faintest.0, faintest.1 / faintest.0 * SNR.1);
    let frames: Vec<Frame> = (0..count).map(|place| render(&spec(place, starlight, most), catalogue).unwrap().frame).collect();
    let middle = probe.attitude.unwrap().turned(&truth.track().turn_to_middle());
    let sum = coadd(&frames).unwrap();
    let exposures = frames.into_iter().map(Arc::new).collect();
    Drawn { truth, measured, exposures, sum, middle, stars: wanted.min(stars.len()) }
}
