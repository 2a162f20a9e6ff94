//! The sky renderer, whole: same seed, same bytes; the truth beside a frame is what the frame shows.

#![allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "a test that fails here fails by its panic")]

use serde_json::Value;
use stars::catalog::{Catalogue, CatalogueHeader, Star};
use stars::image;
use stars::simulate::sky::{Kind, RenderSpec, Rendered, render};
use stars::sky::{ARCSEC, Attitude, CameraModel, DEG, RowOrder, Vec3, ra_dec, separation};
use stars::solve::Cause;
use std::path::Path;
use std::process::Command;

const WIDTH: usize = 320;
const HEIGHT: usize = 256;

/// A small picture, for tests that need few pixels.
fn small(kind: Kind, seed: u64, index: u64) -> RenderSpec {
    RenderSpec { width: WIDTH, height: HEIGHT, ..RenderSpec::new(kind, seed, index) }
}

fn attitude() -> Attitude {
    Attitude::from_angles(136.5 * DEG, -44.0 * DEG, 165.0 * DEG)
}

/// A catalogue of stars at places of the picture, offsets from its centre along right and up, px, of a plate scale of 9.5″.
fn catalogue(stars: &[(f64, f64, f32)]) -> Catalogue {
    let camera = CameraModel {
        width: WIDTH,
        height: HEIGHT,
        platescale: 9.5 * ARCSEC,
        k1: 0.0,
        rows: RowOrder::BottomFirst,
        mirrored: false,
    };
    let stars: Vec<Star> = stars
        .iter()
        .map(|&(right, up, mag)| {
            let (x, y) = camera.position(-right, up);
            let (ra, dec) = ra_dec(&attitude().to_sky(&camera.to_direction(x, y)));
            Star { ra, dec, pm_ra: 0.0, pm_dec: 0.0, mag, hip: 0 }
        })
        .collect();
    let header =
        CatalogueHeader { format: 1, epoch_yr: 2013.0, count: stars.len(), checksum: 0, origin: String::from("a test's own") };
    Catalogue { header, stars }
}

/// A night frame of known attitude and plate scale.
fn night_of(catalogue: &Catalogue, change: impl FnOnce(&mut RenderSpec)) -> Rendered {
    let mut spec =
        RenderSpec { attitude: Some(attitude()), platescale: (9.5 * ARCSEC, 9.5 * ARCSEC), ..small(Kind::Night, 11, 0) };
    change(&mut spec);
    render(&spec, catalogue).unwrap()
}

/// Centroid, px, of what stands above the median within `reach` of a place.
fn centroid(rendered: &Rendered, x: f64, y: f64, reach: usize) -> (f64, f64) {
    let frame = &rendered.frame;
    let (column, row) = (x.round() as usize, y.round() as usize);
    let places = || {
        (row - reach..=row + reach)
            .flat_map(|y| (column - reach..=column + reach).map(move |x| (x, y)))
            .map(|(x, y)| (x as f64, y as f64, f64::from(frame.pixels[y * frame.width + x])))
    };
    let mut values: Vec<f64> = places().map(|place| place.2).collect();
    values.sort_by(f64::total_cmp);
    let sky = values[values.len() / 2];
    // Five ADU is three σ of a night's noise.
    let above = || places().filter(|place| place.2 > sky + 5.0);
    let sum: f64 = above().map(|place| place.2 - sky).sum();
    let mean = |of: fn(&(f64, f64, f64)) -> f64| above().map(|place| of(&place) * (place.2 - sky)).sum::<f64>() / sum;
    (mean(|place| place.0), mean(|place| place.1))
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_another_gives_others() {
    let catalogue = Catalogue::embedded().unwrap();
    for kind in Kind::ALL {
        let first = render(&small(kind, 5, 0), &catalogue).unwrap();
        assert_eq!(first, render(&small(kind, 5, 0), &catalogue).unwrap(), "{kind}");
        // What is clipped everywhere, or one value, looks alike.
        if ![Kind::Blank, Kind::Spoilt(Cause::Overexposed)].contains(&kind) {
            assert_ne!(first.frame.pixels, render(&small(kind, 5, 1), &catalogue).unwrap().frame.pixels, "{kind}");
            assert_ne!(first.frame.pixels, render(&small(kind, 6, 0), &catalogue).unwrap().frame.pixels, "{kind}");
        }
    }
}

#[test]
fn a_seed_names_the_same_frame_on_any_machine() {
    // Sums over the pixels, as first rendered on x86-64: they change with the renderer alone, which is then said in its commit.
    let stars = catalogue(&[(0.0, 0.0, 5.0), (60.0, -40.0, 7.0)]);
    let sums: Vec<u64> = [Kind::Float, Kind::NoStars, Kind::Motion]
        .iter()
        .map(|&kind| {
            let spec = RenderSpec { attitude: Some(attitude()), ..small(kind, 5, 0) };
            let pixels = render(&spec, &stars).unwrap().frame.pixels;
            pixels.iter().zip(1u64..).fold(0u64, |sum, (&pixel, place)| sum.wrapping_add(place.wrapping_mul(u64::from(pixel))))
        })
        .collect();
    assert_eq!(sums, [4_758_902_365_164, 6_180_922_382_344, 4_983_107_791_659]);
}

#[test]
fn a_star_is_where_the_truth_puts_it() {
    let places = [(0.0, 0.0), (110.0, 70.0), (-130.0, 20.0), (40.0, -95.0)];
    let stars = catalogue(&places.map(|(right, up)| (right, up, 4.0)));
    for rows in [RowOrder::BottomFirst, RowOrder::TopFirst] {
        for mirrored in [false, true] {
            let rendered = night_of(&stars, |spec| (spec.rows, spec.mirrored) = (rows, mirrored));
            let truth = &rendered.truth;
            let camera = CameraModel {
                width: WIDTH,
                height: HEIGHT,
                platescale: truth.platescale,
                // About an axis up to 25 px from the centre: on so small a picture it moves nothing by a twentieth of a pixel.
                k1: 0.0,
                rows,
                mirrored,
            };
            for star in &stars.stars {
                let direction = truth.attitude.unwrap().to_camera(&star.direction_after(0.0));
                let (x, y) = camera.to_pixel(&direction).unwrap();
                let (seen_x, seen_y) = centroid(&rendered, x, y, 5);
                assert!((seen_x - x).abs() < 0.05 && (seen_y - y).abs() < 0.05, "{seen_x} {seen_y} for {x} {y}");
            }
            for star in &truth.stars {
                let (seen_x, seen_y) = centroid(&rendered, star.x, star.y, 5);
                assert!((seen_x - star.x).abs() < 0.05 && (seen_y - star.y).abs() < 0.05);
            }
        }
    }
}

#[test]
fn north_is_up_and_east_is_left_at_roll_zero_in_a_fits_picture() {
    let mut stars = catalogue(&[]);
    for (east, north) in [(0.2, 0.0), (0.0, 0.2)] {
        stars.stars.push(Star { ra: east * DEG, dec: north * DEG, pm_ra: 0.0, pm_dec: 0.0, mag: 5.0, hip: 0 });
    }
    let rendered = night_of(&stars, |spec| spec.attitude = Some(Attitude::from_angles(0.0, 0.0, 0.0)));
    let (centre_x, centre_y) = ((WIDTH as f64 - 1.0) / 2.0, (HEIGHT as f64 - 1.0) / 2.0);
    let offset_px = 0.2 * DEG / (9.5 * ARCSEC);
    let place = |star: usize| rendered.truth.stars.iter().find(|seen| seen.star == star).map(|seen| (seen.x, seen.y)).unwrap();
    let (east, north) = (place(0), place(1));
    assert!((east.0 - (centre_x - offset_px)).abs() < 0.1 && (east.1 - centre_y).abs() < 0.1);
    assert!((north.1 - (centre_y + offset_px)).abs() < 0.1 && (north.0 - centre_x).abs() < 0.1);
}

#[test]
fn proper_motion_moves_stars_to_the_epoch() {
    let mut stars = catalogue(&[(0.0, 0.0, 4.0)]);
    // A pixel in ten years, northwards.
    stars.stars[0].pm_dec = 0.95 * ARCSEC;
    let then = night_of(&stars, |spec| spec.epoch_yr = 2023.0);
    let star = then.truth.stars[0];
    let shift = (star.x - (WIDTH as f64 - 1.0) / 2.0).hypot(star.y - (HEIGHT as f64 - 1.0) / 2.0);
    assert!((shift - 1.0).abs() < 1e-3, "{shift}");
}

#[test]
fn a_sweep_draws_trails_whose_middle_is_the_truth() {
    let stars = catalogue(&[(0.0, 0.0, 3.0)]);
    // Twelve pixels to the right in the picture.
    let turn = Vec3::new(0.0, 12.0 * 9.5 * ARCSEC, 0.0);
    let swept = night_of(&stars, |spec| spec.sweep = Some(turn));
    let still = night_of(&stars, |_| ());
    let (x, y) = ((WIDTH as f64 - 1.0) / 2.0, (HEIGHT as f64 - 1.0) / 2.0);
    let (seen_x, seen_y) = centroid(&swept, x, y, 12);
    assert!((seen_x - x).abs() < 0.1 && (seen_y - y).abs() < 0.1, "{seen_x} {seen_y}");
    let bright = |rendered: &Rendered, dx: f64| rendered.frame.pixels[y.round() as usize * WIDTH + (x + dx).round() as usize];
    assert!([5.0, -5.0].iter().all(|&dx| bright(&swept, dx) > 2 * bright(&still, dx)));
    assert!(swept.truth.stars[0].snr < still.truth.stars[0].snr);
}

#[test]
fn the_noise_of_night_and_float_is_that_of_the_camera() {
    let empty = catalogue(&[]);
    for (kind, sky) in [(Kind::Night, 15.0..60.0), (Kind::Float, 1150.0..1800.0)] {
        for index in 0..3 {
            let rendered = render(&RenderSpec { attitude: Some(attitude()), ..small(kind, 8, index) }, &empty).unwrap();
            // Differences of neighbours know nothing of gradients; their median nothing of hot pixels.
            let pixels = &rendered.frame.pixels;
            let mut differences: Vec<f64> =
                pixels.windows(2).map(|pair| (f64::from(pair[0]) - f64::from(pair[1])).abs()).collect();
            differences.sort_by(f64::total_cmp);

            let median = differences[differences.len() / 2];
            assert!(sky.contains(&rendered.truth.sky_adu), "{kind}: {}", rendered.truth.sky_adu);
            // Half of all normal differences are under 0.6745 √2 σ; whole ADU are coarse for a night's.
            let slack = if kind == Kind::Night { 0.6 } else { 0.6 / 8.0 };
            let measured = median / (0.6745 * std::f64::consts::SQRT_2);
            assert!((measured / rendered.truth.noise_adu - 1.0).abs() < slack, "{kind}: {measured}");
            let mean = pixels.iter().map(|&pixel| f64::from(pixel)).sum::<f64>() / pixels.len() as f64;
            assert!((mean - 100.0 - rendered.truth.sky_adu).abs() < 0.1 * rendered.truth.sky_adu + 5.0, "{kind}: {mean}");
        }
    }
}

#[test]
fn each_kind_shows_about_as_many_stars_as_it_should() {
    let catalogue = Catalogue::embedded().unwrap();
    // Least and most of twenty frames of a renderer that was calibrated on real flight frames, with a margin of two.
    let expected = [
        (Kind::Night, 18, 560),
        (Kind::Float, 6, 120),
        (Kind::Gradient, 3, 190),
        (Kind::Defocus, 3, 100),
        (Kind::Defocus30, 1, 130),
        (Kind::Motion, 2, 80),
        (Kind::MultiExp, 3, 200),
        (Kind::HotPix, 4, 110),
        (Kind::Sparse, 3, 50),
        (Kind::Dense, 11, 280),
        (Kind::Saturated, 0, 170),
        (Kind::Faint, 3, 6),
    ];
    for (kind, least, most) in expected {
        for index in 0..2 {
            let truth = render(&RenderSpec::new(kind, 4, index), &catalogue).unwrap().truth;
            assert!((least..=most).contains(&truth.stars_over_snr5), "{kind}: {} stars", truth.stars_over_snr5);
            assert_eq!(truth.must, truth.stars_over_snr5 >= 6 && truth.clipped_fraction < 0.6);
        }
    }
}

#[test]
fn a_frame_looks_where_its_kind_says() {
    let empty = catalogue(&[]);
    let pole = stars::sky::direction(192.859_48 * DEG, 27.128_25 * DEG);
    for index in 0..40 {
        let latitude = |kind| {
            let truth = render(&RenderSpec { width: 16, height: 16, ..RenderSpec::new(kind, 9, index) }, &empty).unwrap().truth;
            90.0 - separation(&truth.attitude.unwrap().boresight(), &pole) / DEG
        };
        assert!(latitude(Kind::Sparse).abs() > 69.99);
        assert!(latitude(Kind::Dense).abs() < 4.01);
        assert!(latitude(Kind::Motion).abs() < 30.01);
    }
}

#[test]
fn frames_without_stars_have_no_truth_to_find() {
    let catalogue = Catalogue::embedded().unwrap();
    for kind in [Kind::NoStars, Kind::Blank, Kind::Clustered, Kind::Linear] {
        let truth = render(&small(kind, 1, 0), &catalogue).unwrap().truth;
        assert!(truth.attitude.is_none() && !truth.must && truth.stars.is_empty() && truth.stars_over_snr5 == 0);
    }
    let blank = |index| {
        let pixels = render(&small(Kind::Blank, 1, index), &catalogue).unwrap().frame.pixels;
        assert!(pixels.iter().all(|&pixel| pixel == pixels[0]));
        pixels[0]
    };
    assert!((100..2000).contains(&blank(0)) && blank(1) == 0 && blank(2) == 16_383);
}

#[test]
fn a_camera_keeps_its_hot_pixels_and_its_optics_but_not_its_noise() {
    let empty = catalogue(&[]);
    let frame = |camera, index| {
        render(&RenderSpec { camera, attitude: Some(attitude()), ..small(Kind::Night, 2, index) }, &empty).unwrap()
    };
    let hot = |rendered: &Rendered| -> Vec<usize> {
        (0..rendered.frame.pixels.len()).filter(|&at| rendered.frame.pixels[at] > 600).collect()
    };
    let (first, second) = (frame(Some(7), 0), frame(Some(7), 1));
    assert!(hot(&first).len() > 5);
    assert_eq!(hot(&first), hot(&second));
    assert_eq!(first.truth.platescale, second.truth.platescale);
    assert_ne!(first.frame.pixels, second.frame.pixels);
    assert_ne!(hot(&first), hot(&frame(Some(8), 0)));
    assert_ne!(hot(&frame(None, 0)), hot(&frame(None, 1)));
}

#[test]
fn impossible_pictures_are_refused() {
    let empty = catalogue(&[]);
    for (width, height) in [(0, 1024), (1536, 8), (100_000, 1024), (usize::MAX, usize::MAX)] {
        assert!(render(&RenderSpec { width, height, ..RenderSpec::new(Kind::Night, 1, 0) }, &empty).is_err());
    }
    for platescale in [(0.0, 1e-5), (2e-5, 1e-5), (f64::NAN, 1e-5), (1e-5, f64::INFINITY), (1e-3, 1e-3)] {
        assert!(render(&RenderSpec { platescale, ..RenderSpec::new(Kind::Night, 1, 0) }, &empty).is_err());
    }
}

fn stars_render(directory: &Path, arguments: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_stars")).arg("render").arg("--out").arg(directory).args(arguments).output().unwrap()
}

#[test]
fn the_command_writes_frames_that_can_be_read_and_their_truth() {
    let directory = tempfile::tempdir().unwrap();
    let output = stars_render(
        &directory.path().join("new"),
        &["--kind", "float", "--count", "2", "--first", "3", "--seed", "12", "--width", "320", "--height", "256", "--jobs", "2"],
    );
    assert!(output.status.success(), "{output:?}");
    let catalogue = Catalogue::embedded().unwrap();
    for index in [3, 4] {
        let name = directory.path().join(format!("new/float-12-{index}"));
        let frame = image::read("frame.fits", &std::fs::read(name.with_extension("fits")).unwrap()).unwrap();
        let expected = render(&small(Kind::Float, 12, index), &catalogue).unwrap();
        assert_eq!((frame.width, frame.height, frame.rows), (WIDTH, HEIGHT, RowOrder::BottomFirst));
        assert_eq!(frame.pixels, expected.frame.pixels);
        let truth: Value = serde_json::from_slice(&std::fs::read(name.with_extension("truth.json")).unwrap()).unwrap();
        let (ra, dec, roll) = expected.truth.attitude.unwrap().angles();
        for (key, value) in [("ra_deg", ra / DEG), ("dec_deg", dec / DEG), ("roll_deg", roll / DEG), ("epoch", 2013.0)] {
            assert!((truth[key].as_f64().unwrap() - value).abs() < 1e-12, "{key}");
        }
        assert_eq!(truth["must"], expected.truth.must);
        assert_eq!(truth["stars"].as_array().unwrap().len(), expected.truth.stars.len());
    }
    assert_eq!(std::fs::read_dir(directory.path().join("new")).unwrap().count(), 4);
}

#[test]
fn a_wrong_call_names_what_is_expected_and_writes_nothing() {
    let directory = tempfile::tempdir().unwrap();
    for arguments in [&["--kind", "sunny"][..], &["--kind", "night", "--width", "3"], &["--kind", "night", "--platescale", "0"]] {
        let output = stars_render(directory.path(), arguments);
        assert_eq!(output.status.code(), Some(2));
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(message.contains("expected"), "{message}");
    }
    assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 0);
}
