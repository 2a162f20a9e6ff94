//! The stream as a whole: exact at its end, recognisable at its beginning, whatever the link does.

use super::*;
use crate::image::{ImageCounter, TriggerCounter};
use crate::sky::{ClockQuality, RowOrder, Utc};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// A background with a slope and noise of some ADU, and stars on it.
fn sky(width: usize, height: usize, noise: f64, seed: u64) -> (Frame, Vec<ViewSource>) {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let normal = Normal::new(0.0, noise).unwrap();
    let stars: Vec<ViewSource> = (0..30)
        .map(|i| ViewSource {
            x: random.random_range(4.0..width as f64 - 5.0),
            y: random.random_range(4.0..height as f64 - 5.0),
            flux: 40_000.0 / (1.0 + f64::from(i)),
        })
        .collect();
    let mut values: Vec<f64> =
        (0..width * height).map(|i| 2000.0 + 0.1 * (i % width) as f64 + normal.sample(&mut random)).collect();
    for star in &stars {
        for y in star.y as usize - 3..star.y as usize + 5 {
            for x in star.x as usize - 3..star.x as usize + 5 {
                let square = (x as f64 - star.x).powi(2) + (y as f64 - star.y).powi(2);
                values[y * width + x] += star.flux / 10.0 * (-square / 3.2).exp();
            }
        }
    }
    let pixels = values.iter().map(|value| value.round().clamp(0.0, 65_535.0) as u16).collect();
    let mut frame = Frame::new(width, height, pixels, RowOrder::TopFirst).unwrap();
    frame.full_scale = Some(16_383);
    (frame, stars)
}

fn assembled(view: &View) -> Assembly {
    let mut assembly = Assembly::new(None, MOST_PIXELS);
    (0..view.len()).for_each(|n| assert_eq!(assembly.take(view.packet(n).unwrap()), Ok(Taken::New)));
    assembly
}

#[test]
fn the_flight_cameras_frame_is_small_and_exact() {
    let (frame, stars) = sky(1536, 1024, 9.0, 1);
    let view = View::new(&frame, &stars, PACKET_BYTES).unwrap();
    println!("{} packets, {} bytes", view.len(), view.bytes().len());
    assert!((0..view.len()).all(|n| view.packet(n).unwrap().len() <= PACKET_BYTES));
    // Noise of 9 ADU has 5.22 bits a pixel, 1.03 MB; packets take 9 % more.
    assert!(view.bytes().len() < 1_170_000);
    let assembly = assembled(&view);
    assert!(assembly.is_exact() && assembly.missing(9).is_empty());
    assert_eq!(assembly.picture().unwrap(), frame);
}

#[test]
fn the_first_2_kb_have_the_sources_and_a_thumbnail() {
    let (frame, stars) = sky(1536, 1024, 9.0, 2);
    for packet_bytes in [224, 240, 1024, 4096] {
        let view = View::new(&frame, &stars, packet_bytes).unwrap();
        let mut assembly = Assembly::new(Some(view.stream()), MOST_PIXELS);
        let mut bytes = 0;
        for packet in (0..view.len()).map_while(|n| view.packet(n)) {
            bytes += packet.len();
            if bytes > FIRST_BYTES {
                break;
            }
            assembly.take(packet).unwrap();
        }
        let sources = assembly.sources();
        assert_eq!(sources.len(), MOST_VIEW_SOURCES);
        for (got, star) in sources.iter().zip(&stars) {
            assert!((got.x - star.x).abs() <= 1.0 / 32.0 && (got.y - star.y).abs() <= 1.0 / 32.0);
            assert!((got.flux / star.flux - 1.0).abs() < 0.05);
        }
        let thumbnail = assembly.thumbnail().unwrap();
        assert_eq!((thumbnail.width, thumbnail.height), THUMBNAIL_PX);
        let scale = assembly.head().unwrap().thumbnail;
        println!("packets of {packet_bytes}: steps of {} / 16 ADU", scale.step);
        // Noise of a cell's mean is 0.56 ADU: the steps are about twice that.
        assert!(scale.step <= 19);
        let cell = |x: usize, y: usize| f64::from(scale.base + u32::from(thumbnail.pixels[y * 96 + x]) * scale.step) / 16.0;
        let mean = |cx: usize, cy: usize| {
            let pixels = (0..256).map(|i| f64::from(frame.pixels[(16 * cy + i / 16) * 1536 + 16 * cx + i % 16]));
            pixels.sum::<f64>() / 256.0
        };
        assert!((0..6144).all(|i| (cell(i % 96, i / 96) - mean(i % 96, i / 96)).abs() <= f64::from(scale.step) / 32.0 + 0.1));
        // The picture is whole, if coarse.
        assert_eq!(assembly.picture().unwrap().pixels.len(), frame.pixels.len());
        assert!(!assembly.is_exact());
    }
}

#[test]
fn the_brightest_stars_are_exact_soon_after() {
    let (frame, stars) = sky(1536, 1024, 9.0, 3);
    let view = View::new(&frame, &stars, PACKET_BYTES).unwrap();
    let mut assembly = Assembly::new(None, MOST_PIXELS);
    (0..18_000 / PACKET_BYTES).for_each(|n| _ = assembly.take(view.packet(n).unwrap()).unwrap());
    let picture = assembly.picture().unwrap();
    for source in assembly.sources() {
        for (x, y) in (0..49).map(|i| (source.x as usize + i % 7 - 3, source.y as usize + i / 7 - 3)) {
            assert_eq!(picture.pixels[y * 1536 + x], frame.pixels[y * 1536 + x]);
        }
    }
}

#[test]
fn a_lossy_link_ends_exact_with_short_lists_of_what_is_missing() {
    let (frame, stars) = sky(301, 203, 9.0, 4);
    let view = View::new(&frame, &stars, PACKET_BYTES).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut assembly = Assembly::new(None, MOST_PIXELS);
    let mut wanted: Vec<usize> = (0..view.len()).rev().collect();
    let mut rounds = 0;
    while !assembly.is_exact() {
        for &n in &wanted {
            if random.random::<f64>() > 0.3 {
                assembly.take(view.packet(n).unwrap()).unwrap();
            }
        }
        let gaps = assembly.missing(8);
        assert!(gaps.len() <= 8);
        wanted = gaps.into_iter().flatten().map(|n| n as usize).collect();
        rounds += 1;
        assert!(rounds < 200);
    }
    assert_eq!(assembly.picture().unwrap(), frame);
    assert_eq!(assembly.take(view.packet(3).unwrap()), Ok(Taken::Again));
}

#[test]
fn a_packet_with_a_flipped_bit_is_refused() {
    let (frame, stars) = sky(64, 64, 9.0, 6);
    let view = View::new(&frame, &stars, PACKET_BYTES).unwrap();
    for number in [0, 1, view.len() - 1] {
        let packet = view.packet(number).unwrap();
        for bit in 0..8 * packet.len() {
            let mut damaged = packet.to_vec();
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Assembly::new(None, MOST_PIXELS).take(&damaged).is_err(), "packet {number}, bit {bit}");
        }
        for length in 0..packet.len() {
            assert!(Assembly::new(None, MOST_PIXELS).take(&packet[..length]).is_err());
        }
    }
}

#[test]
fn what_does_not_belong_is_refused_by_name() {
    let (frame, stars) = sky(64, 64, 9.0, 6);
    let view = View::new(&frame, &stars, PACKET_BYTES).unwrap();
    let other = View::new(&frame, &stars[..3], PACKET_BYTES).unwrap();
    let mut assembly = Assembly::new(None, 4096);
    assembly.take(view.packet(1).unwrap()).unwrap();
    let foreign = ViewRefusal::OtherStream { got: other.stream(), wanted: view.stream() };
    assert_eq!(assembly.take(other.packet(0).unwrap()), Err(foreign));
    assert_eq!(assembly.take(b"something else that is long enough"), Err(ViewRefusal::NotAPacket));
    let small = Assembly::new(None, 4095).take(view.packet(0).unwrap());
    assert_eq!(small, Err(ViewRefusal::TooLarge { pixels: 4096, most: 4095 }));
    let mut nonsense = Vec::new();
    Packet { number: 0, stream: view.stream(), payload: &[0; 80] }.write(&mut nonsense);
    assert_eq!(assembly.take(&nonsense), Err(ViewRefusal::Nonsense { number: 0 }));
    assert_eq!(assembly.missing(4).first(), Some(&(0..1)));
}

#[test]
fn before_the_head_packets_wait_up_to_a_limit() {
    let mut assembly = Assembly::new(None, MOST_PIXELS);
    let mut refused = 0;
    for number in 1..2000 {
        let mut packet = Vec::new();
        Packet { number, stream: 7, payload: &[1; 4000] }.write(&mut packet);
        refused += u32::from(assembly.take(&packet) == Err(ViewRefusal::NoRoom));
    }
    assert!(refused > 900);
    assert_eq!((assembly.progress().1, assembly.picture(), assembly.sources().len()), (None, None, 0));
}

#[test]
fn frames_that_cannot_be_sent_are_refused() {
    let (mut frame, _) = sky(64, 64, 9.0, 6);
    assert_eq!(View::new(&frame, &[], 100).unwrap_err(), ViewError::PacketBytes(100));
    frame.width = 65;
    assert_eq!(View::new(&frame, &[], 240).unwrap_err(), ViewError::Size { width: 65, height: 64 });
    let long = Frame::new(70_000, 1, vec![0; 70_000], RowOrder::TopFirst).unwrap();
    assert_eq!(View::new(&long, &[], 240).unwrap_err(), ViewError::Size { width: 70_000, height: 1 });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_frame_comes_back_with_its_stamp(
        width in 1usize..150,
        height in 1usize..90,
        range in prop_oneof![Just(1u16), Just(20), Just(u16::MAX)],
        seed in any::<u64>(),
        packet_bytes in 224usize..600,
        bottom_first in any::<bool>(),
        known in any::<bool>(),
        sources in prop::collection::vec((-5.0f64..155.0, -5.0f64..95.0, prop_oneof![Just(f64::NAN), -1.0f64..1e9]), 0..40),
    ) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let pixels = (0..width * height).map(|_| random.random_range(0..=range)).collect();
        let rows = if bottom_first { RowOrder::BottomFirst } else { RowOrder::TopFirst };
        let mut frame = Frame::new(width, height, pixels, rows).unwrap();
        if known {
            frame.full_scale = Some(range);
            frame.stamp.image = ImageCounter(77);
            frame.stamp.trigger = Some(TriggerCounter(8));
            frame.stamp.captured = Utc::from_unix(1_600_000_000.25).map(|utc| (utc, ClockQuality::FreeRunning));
            frame.stamp.exposure_s = Some(0.125);
            frame.stamp.gain_db = Some(-1.5);
            frame.stamp.focus_counts = Some(-3);
            frame.stamp.exposures = 3;
            frame.stamp.simulated = true;
        }
        let sources: Vec<ViewSource> = sources.into_iter().map(|(x, y, flux)| ViewSource { x, y, flux }).collect();
        let view = View::new(&frame, &sources, packet_bytes).unwrap();
        let again = View::new(&frame, &sources, packet_bytes).unwrap();
        prop_assert_eq!(view.bytes(), again.bytes());
        let assembly = assembled(&view);
        prop_assert!(assembly.is_exact());
        prop_assert_eq!(assembly.picture().unwrap(), frame);
        prop_assert!(assembly.sources().len() <= MOST_VIEW_SOURCES);
    }
}
