//! Image files, read through the crate's public face.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use std::path::PathBuf;

use proptest::prelude::*;
use stars::image::{ExposedBy, Frame, ImageCounter, Problem, Stamp, TriggerCounter, read, write_fits, write_png};
use stars::sky::{ClockQuality, DEG, HOUR, Observer, RowOrder, Utc};

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

/// A FITS header of these cards, padded to a block.
fn header(cards: &[&str]) -> Vec<u8> {
    let mut bytes: Vec<u8> = cards.iter().chain(&["END"]).flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    bytes.resize(bytes.len().next_multiple_of(2880), b' ');
    bytes
}

/// A FITS file of 2 × 2 px with a `BITPIX`, further cards and its data.
fn fits(bitpix: &str, more: &[&str], data: &[u8]) -> Vec<u8> {
    let bitpix = format!("BITPIX  = {bitpix:>20}");
    let mut cards = vec!["SIMPLE  =                    T", &bitpix, "NAXIS   =                    2"];
    cards.extend(["NAXIS1  =                    2", "NAXIS2  =                    2"]);
    cards.extend(more);
    let mut bytes = header(&cards);
    bytes.extend(data);
    bytes
}

fn big_endian<const N: usize, const M: usize>(values: [[u8; N]; M]) -> Vec<u8> {
    values.concat()
}

#[test]
fn every_kind_of_fits_pixel_is_read() {
    let words = |values: [i16; 4]| big_endian(values.map(i16::to_be_bytes));
    let pixels = |bytes: &[u8]| read("t.fits", bytes).map(|frame| frame.pixels);
    assert_eq!(pixels(&fits("16", &[], &words([1, 2, 4095, 32_767]))).unwrap(), [1, 2, 4095, 32_767]);
    assert_eq!(pixels(&fits("16", &["BZERO   = 32768"], &words([-32_768, 0, 32_767, -1]))).unwrap(), [0, 32_768, 65_535, 32_767]);
    assert_eq!(pixels(&fits("16", &["BZERO   = 32768.0"], &words([-32_768, 0, 1, -1]))).unwrap(), [0, 32_768, 32_769, 32_767]);
    assert_eq!(pixels(&fits("16", &["BSCALE  = 2.0", "BZERO   = 10"], &words([0, 1, 2, 3]))).unwrap(), [10, 12, 14, 16]);
    assert_eq!(pixels(&fits("8", &[], &[0, 1, 128, 255])).unwrap(), [0, 1, 128, 255]);
    assert_eq!(
        pixels(&fits("32", &[], &big_endian([0_i32, 1, 4095, 65_535].map(i32::to_be_bytes)))).unwrap(),
        [0, 1, 4095, 65_535]
    );
    assert_eq!(
        pixels(&fits("-32", &[], &big_endian([0.4_f32, 1.6, 4095.0, 7.0].map(f32::to_be_bytes)))).unwrap(),
        [0, 2, 4095, 7]
    );
    assert_eq!(
        pixels(&fits("-64", &[], &big_endian([0.4_f64, 1.6, 4095.0, 7.0].map(f64::to_be_bytes)))).unwrap(),
        [0, 2, 4095, 7]
    );
    let frame = |bytes: &[u8]| read("t.fits", bytes).unwrap();
    assert_eq!(frame(&fits("8", &[], &[0; 4])).full_scale, Some(255));
    assert_eq!(frame(&fits("16", &[], &[0; 8])).full_scale, None);
    assert_eq!(frame(&fits("16", &["SATURATE= 4095"], &[0; 8])).full_scale, Some(4095));
    assert_eq!(frame(&fits("16", &["ROWORDER= 'TOP-DOWN'"], &[0; 8])).rows, RowOrder::TopFirst);
}

#[test]
fn pixels_below_zero_or_without_a_value_are_zero_unless_they_are_most() {
    let words = |values: [i16; 4]| big_endian(values.map(i16::to_be_bytes));
    assert_eq!(read("t", &fits("16", &[], &words([-1, -500, 3, 4]))).unwrap().pixels, [0, 0, 3, 4]);
    let most = read("t", &fits("16", &[], &words([-1, -500, -3, 4]))).unwrap_err().problem;
    assert_eq!(most, Problem::MostlyUnusable { unusable: 3, of: 4 });
    assert_eq!(read("t", &fits("16", &["BLANK   = 7"], &words([7, 8, 7, 9]))).unwrap().pixels, [0, 8, 0, 9]);
    let floats = |values: [f32; 4]| fits("-32", &[], &big_endian(values.map(f32::to_be_bytes)));
    assert_eq!(read("t", &floats([f32::NAN, f32::NEG_INFINITY, 3.0, 4.0])).unwrap().pixels, [0, 0, 3, 4]);
    assert!(matches!(read("t", &floats([f32::NAN; 4])).unwrap_err().problem, Problem::MostlyUnusable { unusable: 4, of: 4 }));
}

#[test]
fn values_that_16_bits_do_not_hold_are_refused_with_their_place() {
    let wide = fits("32", &[], &big_endian([1_i32, 2, 70_000, 4].map(i32::to_be_bytes)));
    assert_eq!(read("t", &wide).unwrap_err().problem, Problem::ValueTooLarge { value: 70_000.0, x: 0, y: 1 });
    let shifted = fits("16", &["BZERO   = 40000"], &big_endian([1_i16, 30_000, 3, 4].map(i16::to_be_bytes)));
    assert_eq!(read("t", &shifted).unwrap_err().problem, Problem::ValueTooLarge { value: 70_000.0, x: 1, y: 0 });
    let floats = |values: [f32; 4]| fits("-32", &[], &big_endian(values.map(f32::to_be_bytes)));
    assert!(matches!(
        read("t", &floats([1.0, f32::INFINITY, 0.0, 0.0])).unwrap_err().problem,
        Problem::ValueTooLarge { x: 1, y: 0, .. }
    ));
    assert_eq!(read("t", &floats([0.1, 0.2, 0.5, 0.25])).unwrap_err().problem, Problem::Normalised { highest: 0.5 });
    assert_eq!(read("t", &floats([0.0; 4])).unwrap().pixels, [0; 4]);
}

#[test]
fn a_fits_header_that_lies_is_refused_by_name() {
    let size = |bitpix: &str, naxis: &str, width: &str, height: &str| {
        let card = |keyword: &str, value: &str| format!("{keyword:<8}= {value:>20}");
        let cards = [card("BITPIX", bitpix), card("NAXIS", naxis), card("NAXIS1", width), card("NAXIS2", height)];
        let mut all = vec!["SIMPLE  =                    T"];
        all.extend(cards.iter().map(String::as_str));
        let mut bytes = header(&all);
        bytes.extend([0; 2880]);
        bytes
    };
    for (bytes, expected) in [
        (size("7", "2", "2", "2"), "BITPIX is \"7\", expected 8, 16, 32, -32 or -64"),
        (size("NaN", "2", "2", "2"), "BITPIX is \"NaN\", expected a whole number"),
        (size("16", "-1", "2", "2"), "NAXIS is \"-1\", expected 2"),
        (size("16", "1000000000000", "2", "2"), "NAXIS is \"1000000000000\", expected 2"),
        (size("16", "0", "2", "2"), "NAXIS is 0, expected an image in the first header"),
        (size("16", "3", "2", "2"), "NAXIS3 is missing"),
        (size("16", "2", "-2", "2"), "claims -2 × 2 px"),
        (size("16", "2", "2", "0"), "no pixels"),
        (size("16", "2", "9223372036854775807", "2"), "NAXIS1 is \"9223372036854775807\", expected a whole number"),
        (size("16", "2", "9007199254740992", "9007199254740992"), "claims 9007199254740992 × 9007199254740992 px"),
        (size("16", "2", "30000", "30000"), "claims 30000 × 30000 px"),
        (size("16", "2", "10000", "10000"), "cut short: pixels need 200000000 bytes, the file has 2880"),
        (size("16", "2", "1.5", "2"), "NAXIS1 is \"1.5\", expected a whole number"),
        (header(&["SIMPLE  =                    T"]), "BITPIX is missing"),
        (fits("16", &["BSCALE  = NaN"], &[0; 8]), "BSCALE is \"NaN\", expected a number"),
        (fits("16", &["BSCALE  = 0"], &[0; 8]), "BSCALE is \"0\", expected a number other than 0"),
        (fits("16", &["BZERO   = 'x'"], &[0; 8]), "BZERO is \"x\", expected a number"),
        (fits("16", &[], &[0; 7]), "cut short: pixels need 8 bytes, the file has 7"),
        (b"SIMPLE  =                    T".to_vec(), "no END card in the first 0 bytes"),
        (vec![], "begins with \"\", expected a FITS, TIFF, PNG or JPEG file"),
        (b"\x1f\x8b\x08more".to_vec(), "begins with \"\\x1f\\x8b\\x08more\", expected"),
    ] {
        let error = read("lying.fits", &bytes).unwrap_err().to_string();
        assert!(error.starts_with("lying.fits: ") && error.contains(expected), "{error}");
    }
    // Without its end, however long.
    let mut endless = size("16", "2", "2", "2");
    let end = endless.chunks(80).position(|card| card.starts_with(b"END ")).unwrap() * 80;
    endless[end..end + 3].copy_from_slice(b"REM");
    endless.extend(std::iter::repeat_n(b' ', 4_000_000));
    assert_eq!(read("t", &endless).unwrap_err().problem, Problem::NoEnd { searched: 36_000 * 80 });
}

#[test]
fn values_that_the_flight_did_not_know_are_unknown_and_broken_ones_cost_no_image() {
    let stamp = |cards: &[&str]| read("t", &fits("16", cards, &[0; 8])).unwrap().stamp;
    let flight = stamp(&[
        "FOCUS   =                   -1 / UNKNOWN",
        "APERTURE=                   -1",
        "GAIN    =                   -1 / UNKNOWN",
        "HIERARCH APPROX_LAT = -1 / UNKNOWN",
        "HIERARCH APPROX_LST = -1 / UNKNOWN",
    ]);
    assert_eq!((flight.focus_counts, flight.aperture_counts, flight.gain_db, flight.observer), (None, None, None, None));
    let known = stamp(&["FOCUS   = -1 / ADU", "GAIN    = -1.0 / DB", "LAT     = -6.0 / hours", "LST     = 23.5"]);
    assert_eq!((known.focus_counts, known.gain_db), (Some(-1), Some(-1.0)));
    assert_eq!(known.observer, Some(Observer { latitude: -6.0 * HOUR, sidereal_time: 23.5 * HOUR }));
    let broken = stamp(&[
        "FOCUS   = NaN / ADU",
        "GAIN    = 139 / sensor gain",
        "LAT     = 95.0",
        "LST     = 25.0",
        "IMGCTR  = -3",
        "EXPTIME = -0.1",
        "NEXP    = 0",
        "DATE-OBS= '2013-02-30T00:00:00'",
    ]);
    assert_eq!(broken, Stamp { origin: "t".to_owned(), exposures: 1, ..Stamp::default() });
}

#[test]
fn the_capture_time_comes_from_the_header_or_else_from_the_name() {
    let captured = |name: &str, cards: &[&str]| {
        let stamp = read(name, &fits("16", cards, &[0; 8])).unwrap().stamp;
        stamp.captured.map(|(time, quality)| (time.to_string(), quality))
    };
    let named = "2012-12-30--08-27-56--625_p1.fits";
    let is = |time: &str| Some((time.to_owned(), ClockQuality::FreeRunning));
    assert_eq!(captured(named, &[]), is("2012-12-30T08:27:56.625"));
    assert_eq!(captured(named, &["DATE-OBS= '2013-01-01'"]), is("2012-12-30T08:27:56.625"));
    assert_eq!(captured(named, &["DATE-OBS= '2013-01-01T00:00:01.5Z'"]), is("2013-01-01T00:00:01.500"));
    assert_eq!(captured("t", &["DATE-OBS= '2013-01-01T00:00:01.5'", "EXPTIME = 0.5"]), is("2013-01-01T00:00:01.750"));
    assert_eq!(captured("t", &["DATE-AVG= '2013-01-01T00:00:01.5'", "EXPTIME = 0.5"]), is("2013-01-01T00:00:01.500"));
    assert_eq!(captured("t", &[]), None);
}

/// A picture with some structure.
fn pattern(width: usize, height: usize) -> Vec<u16> {
    (0..width * height).map(|i| ((i * 2_654_435_761) >> 7) as u16).collect()
}

/// Valid small files of every kind, each with its name.
fn valid_files() -> Vec<(&'static str, Vec<u8>)> {
    use image::{DynamicImage, ImageBuffer, ImageFormat, Luma};
    let grey16 = ImageBuffer::<Luma<u16>, _>::from_raw(40, 30, pattern(40, 30)).unwrap();
    let encode = |image: &DynamicImage, format| {
        let mut file = std::io::Cursor::new(Vec::new());
        image.write_to(&mut file, format).unwrap();
        file.into_inner()
    };
    let grey16 = DynamicImage::ImageLuma16(grey16);
    let grey8 = DynamicImage::ImageLuma8(grey16.to_luma8());
    let rgb8 = DynamicImage::ImageRgb8(grey16.to_rgb8());
    let frame = Frame::new(40, 30, pattern(40, 30), RowOrder::BottomFirst).unwrap();
    let mut own = Vec::new();
    write_fits(&frame, &[], &mut own).unwrap();
    vec![
        ("fits", own),
        ("grey16.tiff", encode(&grey16, ImageFormat::Tiff)),
        ("rgb8.tiff", encode(&rgb8, ImageFormat::Tiff)),
        ("grey16.png", encode(&grey16, ImageFormat::Png)),
        ("rgb8.png", encode(&rgb8, ImageFormat::Png)),
        ("grey8.jpeg", encode(&grey8, ImageFormat::Jpeg)),
        ("rgb8.jpeg", encode(&rgb8, ImageFormat::Jpeg)),
    ]
}

#[test]
fn every_format_gives_its_pixels_top_row_first() {
    for (name, bytes) in valid_files() {
        let frame = read(name, &bytes).unwrap();
        assert_eq!((frame.width, frame.height, frame.stamp.exposures), (40, 30, 1), "{name}");
        assert_eq!(frame.rows, if name == "fits" { RowOrder::BottomFirst } else { RowOrder::TopFirst }, "{name}");
        assert_eq!(frame.full_scale, name.contains('8').then_some(255), "{name}");
        if name.contains("16") || name == "fits" {
            assert_eq!(frame.pixels, pattern(40, 30), "{name}");
        } else if !name.ends_with("jpeg") {
            // Grey in three colours: the luminance is the grey.
            let eight_bits: Vec<u16> = pattern(40, 30).iter().map(|&v| ((u32::from(v) + 128) / 257) as u16).collect();
            assert_eq!(frame.pixels, eight_bits, "{name}");
        }
    }
}

#[test]
fn colour_becomes_luminance() {
    use image::{DynamicImage, ImageBuffer, ImageFormat, Rgb};
    let samples = vec![65_535_u16, 0, 0, 0, 65_535, 0, 0, 0, 65_535, 65_535, 65_535, 65_535];
    let image = DynamicImage::ImageRgb16(ImageBuffer::<Rgb<u16>, _>::from_raw(4, 1, samples).unwrap());
    let mut file = std::io::Cursor::new(Vec::new());
    image.write_to(&mut file, ImageFormat::Png).unwrap();
    assert_eq!(read("rgb.png", &file.into_inner()).unwrap().pixels, [13_933, 46_871, 4_732, 65_535]);
}

#[test]
fn a_file_cut_anywhere_is_refused_unless_its_pixels_are_whole() {
    for (name, bytes) in valid_files() {
        let whole = read(name, &bytes).unwrap();
        let mut refused = 0;
        for end in (0..bytes.len()).step_by(97) {
            match read(name, &bytes[..end]) {
                Ok(frame) => assert_eq!(frame, whole, "{name} cut at {end}"),
                Err(_) => refused += 1,
            }
        }
        assert!(refused > 0);
    }
}

#[test]
fn a_small_file_that_claims_a_huge_image_is_refused() {
    // The size of a PNG stands in its first chunk, under a checksum that must be made right.
    let png = |width: u32, height: u32| {
        let mut bytes = valid_files().swap_remove(3).1;
        bytes[16..20].copy_from_slice(&width.to_be_bytes());
        bytes[20..24].copy_from_slice(&height.to_be_bytes());
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes[12..29]);
        bytes[29..33].copy_from_slice(&crc.to_be_bytes());
        read("bomb.png", &bytes).unwrap_err().problem
    };
    assert!(matches!(png(9_000, 9_000), Problem::Bomb { claimed: 162_000_000, .. }), "{:?}", png(9_000, 9_000));
    assert!(matches!(png(20_000, 20_000), Problem::TooLarge { width: 20_000, height: 20_000 }));
    assert!(matches!(png(40_000, 2), Problem::TooLarge { .. }));
    // Eight bits a pixel in the file are sixteen in the frame. A JPEG's rows and columns stand in its frame header.
    let mut jpeg = valid_files().into_iter().find(|(name, _)| *name == "grey8.jpeg").unwrap().1;
    let header = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
    jpeg[header + 5..header + 7].copy_from_slice(&16_384_u16.to_be_bytes());
    jpeg[header + 7..header + 9].copy_from_slice(&3_072_u16.to_be_bytes());
    let problem = read("bomb.jpg", &jpeg).unwrap_err().problem;
    assert!(matches!(problem, Problem::Bomb { claimed: 100_663_296, .. }), "{problem:?}");
}

/// One stamp of any kind that can be written.
fn stamps() -> impl Strategy<Value = Stamp> {
    let counters = (any::<u32>(), proptest::option::of(any::<u32>()), "[ -~]{0,60}", any::<bool>());
    use ClockQuality::{Chrony, FlightComputer, FreeRunning, Ptp, Synchronised, Unset};
    let quality = proptest::sample::select(vec![Unset, FreeRunning, Synchronised, FlightComputer, Chrony, Ptp]);
    let time = proptest::option::of((631_152_000.0..3_786_911_999.0, quality));
    let exposure = (proptest::option::of(0.0..1e6_f64), 1..=u8::MAX, proptest::option::of(any::<u8>()));
    let lens = (proptest::option::of(-100.0..100.0_f64), proptest::option::of(any::<i32>()), proptest::option::of(any::<i32>()));
    let observer = proptest::option::of((-90.0..90.0_f64, 0.0..24.0_f64));
    let by = prop_oneof![Just(None), Just(Some(ExposedBy::Asked)), Just(Some(ExposedBy::Trigger)), Just(Some(ExposedBy::Itself))];
    let lost = (any::<u32>(), any::<u32>());
    let celsius = (proptest::option::of(-100.0..100.0_f64), proptest::option::of(-100.0..100.0_f64));
    (counters, time, by, exposure, lens, celsius, observer, lost).prop_map(
        |(counters, time, exposed_by, exposure, lens, celsius, observer, lost)| Stamp {
            image: ImageCounter(counters.0),
            trigger: counters.1.map(TriggerCounter),
            origin: counters.2,
            captured: time.map(|(unix_s, quality)| (Utc::from_unix(unix_s).unwrap(), quality)),
            // Of a time that is not there nothing is written.
            captured_sigma_s: time.map(|(unix_s, _)| unix_s.fract()),
            uptime_s: time.map(|(unix_s, _)| unix_s * 1e-3),
            exposed_by,
            exposure_s: exposure.0,
            exposures: exposure.1,
            part: exposure.2,
            gain_db: lens.0,
            focus_counts: lens.1,
            aperture_counts: lens.2,
            temperature_camera_c: celsius.0,
            temperature_lens_c: celsius.1,
            observer: observer.map(|(lat, lst)| Observer { latitude: lat * DEG, sidereal_time: lst * HOUR }),
            simulated: counters.3,
            missing_packets: lost.0,
            missed_frames: lost.1,
        },
    )
}

fn frames() -> impl Strategy<Value = Frame> {
    let rows = prop_oneof![Just(RowOrder::BottomFirst), Just(RowOrder::TopFirst)];
    (1..50_usize, 1..50_usize, rows, proptest::option::of(1..=u16::MAX), stamps()).prop_flat_map(
        |(width, height, rows, full_scale, stamp)| {
            proptest::collection::vec(any::<u16>(), width * height).prop_map(move |pixels| Frame {
                width,
                height,
                pixels,
                rows,
                full_scale,
                stamp: stamp.clone(),
            })
        },
    )
}

fn flipped(frame: &Frame) -> Vec<u16> {
    frame.pixels.chunks(frame.width).rev().flatten().copied().collect()
}

proptest! {
    #[test]
    fn a_frame_written_as_fits_is_read_the_same(frame in frames()) {
        let mut file = Vec::new();
        write_fits(&frame, &[], &mut file).unwrap();
        prop_assert_eq!(file.len() % 2880, 0);
        let seen = read(&frame.stamp.origin, &file).unwrap();
        prop_assert_eq!(seen.rows, RowOrder::BottomFirst);
        let pixels = if frame.rows == RowOrder::BottomFirst { frame.pixels.clone() } else { flipped(&frame) };
        prop_assert_eq!((seen.width, seen.height, &seen.pixels), (frame.width, frame.height, &pixels));
        prop_assert_eq!(seen.full_scale, frame.full_scale);
        // Times are kept to a microsecond, angles to the last digits of a degree.
        let (mut seen, mut stamp) = (seen.stamp, frame.stamp);
        match (seen.captured.take(), stamp.captured.take()) {
            (Some((a, a_quality)), Some((b, b_quality))) => {
                prop_assert!((a.unix_s() - b.unix_s()).abs() < 1e-6, "{} {}", a, b);
                prop_assert_eq!(a_quality, b_quality);
            }
            (a, b) => prop_assert_eq!(a, b),
        }
        match (seen.observer.take(), stamp.observer.take()) {
            (Some(a), Some(b)) => {
                prop_assert!((a.latitude - b.latitude).abs() < 1e-14);
                prop_assert!((a.sidereal_time - b.sidereal_time).abs() < 1e-14);
            }
            (a, b) => prop_assert_eq!(a, b),
        }
        prop_assert_eq!(seen, stamp);
    }

    #[test]
    fn a_frame_written_as_png_is_read_the_same_up_on_top(frame in frames()) {
        let mut file = Vec::new();
        write_png(&frame, &mut file).unwrap();
        let seen = read("t.png", &file).unwrap();
        let pixels = if frame.rows == RowOrder::TopFirst { frame.pixels.clone() } else { flipped(&frame) };
        prop_assert_eq!((seen.width, seen.height, seen.rows), (frame.width, frame.height, RowOrder::TopFirst));
        prop_assert_eq!(seen.pixels, pixels);
    }

    #[test]
    fn random_bytes_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..5000), first in 0..6_usize) {
        // With nothing, or what makes them look like a file of each kind, before them.
        let first: &[u8] = [&b""[..], b"SIMPLE  =", b"II\x2a\0", b"MM\0\x2a", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"][first];
        prop_assert!(read("noise", &[first, &bytes].concat()).is_err());
    }

    #[test]
    fn a_file_with_a_few_bytes_changed_is_read_or_refused(
        kind in 0..7_usize,
        changes in proptest::collection::vec((any::<proptest::sample::Index>(), any::<u8>(), any::<bool>()), 1..6),
    ) {
        let (name, mut bytes) = valid_files().swap_remove(kind);
        for (at, value, early) in changes {
            // Half of them where the headers are.
            let within = if early { bytes.len().min(400) } else { bytes.len() };
            bytes[at.index(within)] = value;
        }
        if let Ok(frame) = read(name, &bytes) {
            prop_assert_eq!(frame.pixels.len(), frame.width * frame.height);
        }
    }

    #[test]
    fn a_fits_header_of_any_cards_is_read_or_refused(
        cards in proptest::collection::vec(("(BITPIX|NAXIS|NAXIS1|NAXIS2|NAXIS3|BZERO|BSCALE|BLANK|LAT|FOCUS|END|HIERARCH X)", "[ -~]{0,25}"), 0..12),
        data in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let cards: Vec<String> = cards.into_iter().map(|(keyword, value)| format!("{keyword:<8}= {value}")).collect();
        let mut all = vec!["SIMPLE  =                    T"];
        all.extend(cards.iter().map(String::as_str));
        let mut bytes = header(&all);
        bytes.extend(data);
        if let Ok(frame) = read("t", &bytes) {
            prop_assert_eq!(frame.pixels.len(), frame.width * frame.height);
        }
    }
}

#[test]
fn a_frame_that_contradicts_itself_is_not_written() {
    let mut frame = Frame::new(2, 2, vec![0; 4], RowOrder::BottomFirst).unwrap();
    frame.pixels.pop();
    assert!(write_fits(&frame, &[], &mut Vec::new()).is_err() && write_png(&frame, &mut Vec::new()).is_err());
}

/// Writes frames into the directory `STARS_FITS_OUT`, for `fitsverify` to judge.
#[test]
#[ignore = "scripts/check-fits runs it"]
fn frames_are_written_for_fitsverify() {
    let directory = PathBuf::from(std::env::var_os("STARS_FITS_OUT").expect("STARS_FITS_OUT names a directory"));
    let bare = Frame::new(40, 30, pattern(40, 30), RowOrder::TopFirst).unwrap();
    let mut full = Frame::new(1536, 1024, pattern(1536, 1024), RowOrder::BottomFirst).unwrap();
    full.full_scale = Some(4095);
    full.stamp = Stamp {
        image: ImageCounter(u32::MAX),
        trigger: Some(TriggerCounter(1600)),
        origin: format!("it's a long name: {}", "x".repeat(100)),
        captured: Utc::from_calendar(2012, 12, 31, 23, 59, 59.999_999_9).map(|time| (time, ClockQuality::FlightComputer)),
        captured_sigma_s: Some(2.5e-4),
        uptime_s: Some(86_400.125),
        exposed_by: Some(ExposedBy::Itself),
        exposure_s: Some(1e-7),
        exposures: 4,
        part: Some(3),
        gain_db: Some(-1.25e-300),
        focus_counts: Some(-1),
        aperture_counts: Some(6),
        temperature_camera_c: Some(21.5),
        temperature_lens_c: Some(-40.25),
        observer: Some(Observer { latitude: -77.4288695 * DEG, sidereal_time: 8.01361111111111 * HOUR }),
        simulated: true,
        missing_packets: u32::MAX,
        missed_frames: 1,
    };
    for (name, frame) in [("bare.fits", bare), ("full.fits", full)] {
        let mut file = Vec::new();
        write_fits(&frame, &[], &mut file).unwrap();
        std::fs::write(directory.join(name), file).unwrap();
    }
}
