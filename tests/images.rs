//! Image files, read through the crate's public face.

use std::path::PathBuf;

use stars::image::{Frame, ImageCounter, TriggerCounter, read};
use stars::sky::{ClockQuality, DEG, HOUR, RowOrder};

/// The directory of the real flight and night images: `STARS_REAL_IMAGES`, or beside the crate.
///
/// They are not the project's to publish, so they may be missing: the caller then says `SKIPPED` and ends.
fn real_images() -> Option<PathBuf> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let directory = std::env::var_os("STARS_REAL_IMAGES").map_or_else(beside, PathBuf::from);
    if directory.is_dir() {
        return Some(directory);
    }
    println!("SKIPPED: real images not found at {}", directory.display());
    None
}

fn read_real(directory: &std::path::Path, name: &str) -> Frame {
    let path = directory.join(name);
    let bytes = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    read(name, &bytes).unwrap()
}

fn min_mean_max(frame: &Frame) -> (u16, f64, u16) {
    let sum: u64 = frame.pixels.iter().map(|&v| u64::from(v)).sum();
    let (min, max) = (frame.pixels.iter().min().unwrap(), frame.pixels.iter().max().unwrap());
    (*min, sum as f64 / frame.pixels.len() as f64, *max)
}

#[test]
fn real_images_of_the_flight_have_their_pixels_and_stamp() {
    let Some(directory) = real_images() else { return };
    type Expected = (&'static str, u32, u32, (f64, f64), Option<i32>, Option<i32>, (u16, f64, u16), &'static str);
    let cases: [Expected; 2] = [
        (
            "flight/2012-12-30--08-27-56--625_p1.fits",
            1571,
            1600,
            (-76.9389955, 12.2452777777778),
            Some(3030),
            Some(6),
            (1193, 1591.4, 3386),
            "2012-12-30T08:27:56.625",
        ),
        (
            "flight/2013-01-01--06-11-24--859_p0.fits",
            38,
            292,
            (-77.4288695, 8.01361111111111),
            None,
            None,
            (1027, 1351.3, 1914),
            "2013-01-01T06:11:24.859",
        ),
    ];
    for (name, image, trigger, (latitude, sidereal_time), focus, aperture, (min, mean, max), captured) in cases {
        let frame = read_real(&directory, name);
        assert_eq!((frame.width, frame.height, frame.rows), (1536, 1024, RowOrder::BottomFirst));
        assert_eq!(frame.full_scale, None);
        let stamp = &frame.stamp;
        assert_eq!((stamp.image, stamp.trigger), (ImageCounter(image), Some(TriggerCounter(trigger))));
        let observer = stamp.observer.unwrap();
        assert!((observer.latitude - latitude * DEG).abs() < 1e-12);
        assert!((observer.sidereal_time - sidereal_time * HOUR).abs() < 1e-12);
        assert_eq!((stamp.focus_counts, stamp.aperture_counts, stamp.gain_db), (focus, aperture, Some(0.0)));
        let (time, quality) = stamp.captured.unwrap();
        assert_eq!((time.to_string().as_str(), quality), (captured, ClockQuality::FreeRunning));
        assert_eq!((stamp.origin.as_str(), stamp.exposures, stamp.simulated), (name, 1, false));
        let seen = min_mean_max(&frame);
        assert!(seen.0 == min && (seen.1 - mean).abs() < 0.05 && seen.2 == max, "{name}: {seen:?}");
    }
}

#[test]
fn real_images_of_the_night_sky_are_read_from_tiff() {
    let Some(directory) = real_images() else { return };
    for name in ["esa/2019-07-29T204726_Alt40_Azi-135_Try1.tiff", "esa/2019-07-29T204726_Alt60_Azi45_Try1.tiff"] {
        let frame = read_real(&directory, name);
        assert_eq!((frame.width, frame.height, frame.rows), (1024, 768, RowOrder::TopFirst));
        assert_eq!(frame.full_scale, None);
        assert_eq!(frame.stamp.captured.unwrap().0.to_string(), "2019-07-29T20:47:26.000");
        // Written in one uncompressed little-endian strip, 320 bytes into the file.
        let bytes = std::fs::read(directory.join(name)).unwrap();
        let strip = bytes[320..].as_chunks::<2>().0.iter().map(|&pair| u16::from_le_bytes(pair));
        assert!(frame.pixels.iter().copied().eq(strip));
    }
}
