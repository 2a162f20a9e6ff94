//! Tests of the search along trails: trails that are drawn, and found again.

use super::*;
use crate::settings::Settings;
use crate::sky::RowOrder;

const SKY_ADU: f64 = 1300.0;
const NOISE_ADU: f64 = 8.0;

/// Noise by the sum of twelve uniform numbers of a plain generator.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// A trail on a straight way from one offset to another.
fn trail(from: (f64, f64), to: (f64, f64), share: f64, spin: f64) -> Trail {
    let place = |i: u32| {
        let part = (f64::from(i) + 0.5) / 60.0;
        (from.0 + part * (to.0 - from.0), from.1 + part * (to.1 - from.1))
    };
    Trail { places: (0..60).map(place).collect(), share, spin, sigma_px: 0.3, stretch: Stretch::default() }
}

/// Exposures of stars at places, of a flux in all of them together.
fn expose(trails: &[Trail], stars: &[(f64, f64, f64)]) -> Vec<Frame> {
    let (width, height) = (320, 256);
    let mut noise = Noise(7);
    let expose = |trail: &Trail| {
        let mut light = vec![0.0; width * height];
        for (x, y, flux) in stars {
            let star = trail.spun((*x, *y), centre(width, height));
            for (dx, dy) in &trail.places {
                let (sx, sy) = (star.0 + dx, star.1 + dy);
                for j in (sy - 6.0).max(0.0) as usize..((sy + 6.0) as usize).min(height) {
                    for i in (sx - 6.0).max(0.0) as usize..((sx + 6.0) as usize).min(width) {
                        let r2 = (i as f64 - sx).powi(2) + (j as f64 - sy).powi(2);
                        let share = trail.share / trail.places.len() as f64;
                        light[j * width + i] += flux * share * (-0.5 * r2 / 1.083).exp() / (std::f64::consts::TAU * 1.083);
                    }
                }
            }
        }
        let pixels = light.iter().map(|light| (SKY_ADU + light + NOISE_ADU * noise.next()).round() as u16).collect();
        Frame::new(width, height, pixels, RowOrder::BottomFirst).unwrap()
    };
    trails.iter().map(expose).collect()
}

fn find(trails: &[Trail], frames: &[Frame]) -> Vec<Source> {
    let settings = Settings::flight().unwrap();
    let look = Look { settings: &settings.solver.sources, masked: &|_, _| false, keep_on: &|| true };
    let mut cells = vec![CellStatistics::default(); frames.len()];
    cells.iter_mut().zip(frames).for_each(|(cells, frame)| cells.measure(frame, None));
    let mut sources = Vec::new();
    assert!(Finder::default().find_along(&frames.iter().collect::<Vec<_>>(), &cells, trails, &look, &mut sources));
    sources
}

#[test]
fn stars_are_found_where_they_were_at_the_start_whichever_way_they_go() {
    let stars = [(90.3, 100.6, 900.0), (200.0, 150.0, 700.0), (150.8, 70.2, 800.0)];
    let mut chi2 = 0.0;
    for (dx, dy) in [(12.0, 5.0), (-12.0, 5.0), (12.0, -9.0), (-3.0, -14.0), (0.0, 18.0), (-16.0, 0.0)] {
        let trails = [trail((0.0, 0.0), (dx, dy), 0.5, 0.0), trail((1.5 * dx, 1.5 * dy), (2.5 * dx, 2.5 * dy), 0.5, 0.004)];
        let sources = find(&trails, &expose(&trails, &stars));
        for (x, y, flux) in stars {
            let near = sources.iter().take(6).find(|source| (source.x - x).hypot(source.y - y) < 3.0);
            let near = near.unwrap_or_else(|| panic!("{dx} {dy}: none at {x} {y} of {sources:?}"));
            assert!((near.flux / flux - 1.0).abs() < 4.0 / near.snr, "{dx} {dy}: flux {} for {flux}", near.flux);
            assert!(near.star_like && near.snr > 4.5, "{near:?}");
            chi2 += ((near.x - x).powi(2) + (near.y - y).powi(2)) / near.sigma.powi(2) / 36.0;
        }
    }
    assert!((0.5..1.8).contains(&chi2), "{chi2}");
}

#[test]
fn the_signal_of_several_exposures_grows_with_their_root() {
    let stars = [(150.0, 120.0, 2400.0)];
    let snr = |count: u32| {
        let share = 1.0 / f64::from(count);
        let trails: Vec<Trail> = (0..count).map(|_| trail((0.0, 0.0), (10.0, 4.0), share, 0.0)).collect();
        // As much light in each exposure.
        let stars = stars.map(|(x, y, flux)| (x, y, flux * f64::from(count) / 4.0));
        find(&trails, &expose(&trails, &stars))[0].snr
    };
    let gain = snr(4) / snr(1);
    assert!((gain / 2.0 - 1.0).abs() < 0.1, "{gain}");
}

#[test]
fn the_light_of_stars_too_faint_to_be_found_is_where_they_are_and_elsewhere_is_noise_as_it_is_said_to_be() {
    const FLUX: f64 = 150.0;
    let places: Vec<(f64, f64)> = (0..20).map(|i| (50.0 + 50.0 * f64::from(i % 5), 45.0 + 50.0 * f64::from(i / 5))).collect();
    let stars: Vec<(f64, f64, f64)> = places.iter().map(|(x, y)| (*x, *y, FLUX)).collect();
    let trails = [trail((0.0, 0.0), (12.0, 5.0), 0.5, 0.0), trail((16.0, 7.0), (26.0, 10.0), 0.5, 0.002)];
    let frames = expose(&trails, &stars);
    let mut cells = vec![CellStatistics::default(); frames.len()];
    cells.iter_mut().zip(&frames).for_each(|(cells, frame)| cells.measure(frame, None));
    let exposures: Vec<&Frame> = frames.iter().collect();
    let tell = |dx: f64, dy: f64| light_along(&exposures, &cells, &trails, places.iter().map(move |(x, y)| (x + dx, y + dy)));
    let mean = |light: &[(f64, f64)]| {
        let (data, information) = light.iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        (data / information, 1.0 / information.sqrt())
    };
    let (flux, sigma) = mean(&tell(0.0, 0.0));
    assert!(FLUX / sigma < 2.5 * (places.len() as f64).sqrt(), "each alone is too faint to be found");
    assert!((flux - FLUX).abs() < 3.0 * sigma, "{flux} ± {sigma}");
    let beside: Vec<(f64, f64)> = [(-4.0, 24.0), (6.0, -22.0), (2.0, 26.0)].iter().flat_map(|(dx, dy)| tell(*dx, *dy)).collect();
    let (flux, sigma) = mean(&beside);
    assert!(flux.abs() < 3.0 * sigma, "{flux} ± {sigma}");
    let chi2 = beside.iter().map(|(light, information)| light * light / information).sum::<f64>() / beside.len() as f64;
    assert!((0.6..1.5).contains(&chi2), "{chi2}");
    let outside = light_along(&exposures, &cells, &trails, [(-500.0, 90.0)].into_iter());
    assert_eq!(outside, [(0.0, 0.0)]);
}
