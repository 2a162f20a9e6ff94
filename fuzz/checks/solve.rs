//! From pixels to outcome on small frames made to have stars, noise and every artefact that bytes can ask for.
use stars::catalog::Catalogue;
use stars::image::Frame;
use stars::settings::{Layers, Settings};
use stars::sky::RowOrder;
use stars::solve::{Prior, Reason, Report, Solver, Unwatched};
use std::cell::RefCell;
use std::sync::Arc;

/// As small as they may be with all kernels at work, those that look at the picture halved three times too.
const WIDTH: usize = 288;
const HEIGHT: usize = 256;
/// Stars of the catalogue that are kept.
const BRIGHTEST: usize = 4000;

fn settings() -> Settings {
    // A field of 9° × 8°, so that so few pixels see many stars.
    let layers = Layers::embedded()
        .set("solver.matching.platescale_min_arcsec_px=105")
        .set("solver.matching.platescale_max_arcsec_px=117")
        .set("camera.width_px=288")
        .set("camera.height_px=256");
    layers.load().expect("these settings are right").settings
}

thread_local! {
    static SOLVER: RefCell<Solver> = RefCell::new({
        let mut catalogue = Catalogue::embedded().expect("the catalogue in the program is whole");
        // The bright stars are all that such a frame shows, and the index of them is built at once.
        catalogue.stars.truncate(BRIGHTEST);
        catalogue.header.count = BRIGHTEST;
        let mut solver = Solver::new(Arc::new(catalogue), Arc::new(settings()));
        solver.prepare(WIDTH, HEIGHT);
        solver
    });
}

/// Background, noise and full scale from the first bytes, then five bytes a star, then single pixels.
fn frame(data: &[u8]) -> Option<Frame> {
    let [background, noise, scale, stars, rest @ ..] = data else { return None };
    let mut chance = u64::from(*noise) << 32 | 0x9E37_79B9;
    let mut pixels: Vec<f64> = (0..WIDTH * HEIGHT)
        .map(|_| {
            chance = chance.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            f64::from(*background) * 256.0 + f64::from(*noise) * ((chance >> 40) as f64 / f64::from(1 << 24) - 0.5)
        })
        .collect();
    let (drawn, raw) = rest.split_at(rest.len().min(5 * usize::from(*stars)));
    for star in drawn.chunks_exact(5) {
        let [x, y, flux, width, angle] = [0, 1, 2, 3, 4].map(|n| f64::from(star[n]));
        let (sigma, long) = (0.5 + width / 32.0, 1.0 + angle / 64.0);
        for (at, pixel) in pixels.iter_mut().enumerate() {
            let (dx, dy) = ((at % WIDTH) as f64 - x * WIDTH as f64 / 256.0, (at / WIDTH) as f64 - y * HEIGHT as f64 / 256.0);
            *pixel += flux * 100.0 * (-(dx * dx / long + dy * dy) / (2.0 * sigma * sigma)).exp();
        }
    }
    for pixel in raw.chunks_exact(4) {
        let at = (usize::from(pixel[0]) << 8 | usize::from(pixel[1])) % pixels.len();
        pixels[at] = f64::from(u16::from_le_bytes([pixel[2], pixel[3]]));
    }
    let full = f64::from(*scale) * 257.0;
    let pixels = pixels.iter().map(|pixel| pixel.clamp(0.0, full) as u16).collect();
    Frame::new(WIDTH, HEIGHT, pixels, RowOrder::BottomFirst)
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let Some(frame) = frame(data) else { return };
    SOLVER.with_borrow_mut(|solver| {
        let outcome = solver.solve(&frame, &Prior::default(), &Unwatched);
        assert_eq!(outcome.reason == Reason::Solved, outcome.solution.is_some());
        let report = Report::new(&outcome, solver.catalogue());
        let line = serde_json::to_string(&report).expect("a report serialises");
        if outcome.reason == Reason::Solved {
            assert!(report.pointing.ra_deg.is_some() && report.pointing.covariance_arcsec2.is_some(), "{line}");
        }
        let again = solver.solve(&frame, &Prior::default(), &Unwatched);
        assert_eq!(outcome, again, "the same frame, another outcome");
    });
}
