//! The room as a whole: round trips, damage, hostile streams.

use super::layout::BodyError;
use super::*;
use crate::sky::ClockQuality;
use bytes::{BufMut, BytesMut};
use proptest::prelude::*;
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A body that its table allows, everything in it drawn at random: known and unknown, all codes, the ends of ranges.
fn random_body(table: &Table, random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut body = vec![0; table.size];
    for field in &table.fields {
        let step = field.size / field.count();
        for at in (field.offset..field.offset + field.size).step_by(step) {
            let bytes = random_element(field, random);
            body[at..at + step].copy_from_slice(&bytes);
        }
    }
    table.settle(&mut body);
    body
}

fn random_element(field: &Field, random: &mut ChaCha8Rng) -> Vec<u8> {
    let (low, high) = field.range.unwrap_or((-1e300, 1e300));
    let between = low + (high - low) * *[0.0, 1.0, random.random::<f64>()].get(random.random_range(0..3)).unwrap();
    match &field.form {
        Form::Rows(row) => random_body(row, random),
        Form::Code(names) => vec![random.random_range(1..=names.len() as u8)],
        Form::Text(size) => {
            let used = random.random_range(0..=*size);
            (0..*size).map(|place| if place < used { random.random_range(b' '..=b'~') } else { 0 }).collect()
        }
        Form::Scalar(Scalar::Bool) => vec![random.random_range(0..=1)],
        Form::Scalar(Scalar::F32) => (between.clamp(f64::from(f32::MIN), f64::from(f32::MAX)) as f32).to_le_bytes().to_vec(),
        Form::Scalar(Scalar::F64) => between.to_le_bytes().to_vec(),
        Form::Scalar(Scalar::U8) if field.range.is_some() => vec![between as u8],
        Form::Scalar(Scalar::U16) if field.range.is_some() => (between as u16).to_le_bytes().to_vec(),
        Form::Scalar(scalar) => {
            let mut bytes = vec![0; scalar.size()];
            random.fill_bytes(&mut bytes);
            bytes
        }
    }
}

fn random_message(kind: Kind, seed: u64) -> Message {
    let body = random_body(kind.table(), &mut ChaCha8Rng::seed_from_u64(seed));
    let (message, withheld) = Message::decode(kind as u8, PROTOCOL_CURRENT, &body).unwrap();
    assert_eq!(withheld, 0);
    message
}

fn frame(message: &Message) -> BytesMut {
    let mut out = BytesMut::new();
    message.encode(&mut out).unwrap();
    out
}

/// Bytes with a chosen body in an otherwise right frame.
fn frame_of(kind: u8, version: u8, body: &[u8]) -> BytesMut {
    let mut out = BytesMut::new();
    super::frame::put_frame(kind, version, body, &mut out).unwrap();
    out
}

fn set(kind: Kind, body: &mut [u8], name: &str, bytes: &[u8]) {
    let field = kind.table().fields.iter().find(|field| field.name == name).unwrap();
    body[field.offset..field.offset + bytes.len()].copy_from_slice(bytes);
}

fn any_kind() -> impl Strategy<Value = Kind> {
    proptest::sample::select(Kind::ALL.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_message_comes_back_as_it_was_sent(kind in any_kind(), seed: u64) {
        let message = random_message(kind, seed);
        prop_assert_eq!(decode_all(&frame(&message)), vec![Ok(message)]);
    }

    #[test]
    fn what_postcard_writes_is_the_packed_struct_that_the_table_describes(kind in any_kind(), seed: u64) {
        let body = random_body(kind.table(), &mut ChaCha8Rng::seed_from_u64(seed));
        let (message, _) = Message::decode(kind as u8, PROTOCOL_CURRENT, &body).unwrap();
        prop_assert_eq!(message.body().unwrap(), body);
    }

    #[test]
    fn a_flipped_bit_is_never_believed(kind in any_kind(), seed: u64, place: prop::sample::Index) {
        let whole = frame(&random_message(kind, seed));
        let bit = place.index((whole.len() - 8) * 8);
        let mut bytes = whole.clone();
        bytes[8 + bit / 8] ^= 1 << (bit % 8);
        let first = decode_all(&bytes).remove(0);
        prop_assert!(matches!(first, Err(WireError::BadChecksum { .. })), "{:?}", first.map(|m| m.kind()));
    }

    #[test]
    fn garbage_before_a_frame_is_skipped(garbage in prop::collection::vec(any::<u8>(), 0..300), seed: u64) {
        let message = random_message(Kind::Status, seed);
        let mut stream = BytesMut::from(&garbage[..]);
        stream.put_slice(&frame(&message));
        stream.put_slice(&frame(&message));
        let read = decode_all(&stream);
        prop_assert_eq!(read.last(), Some(&Ok(message)));
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..4000)) {
        decode_all(&bytes);
        for kind in 0..8 {
            let _ = Message::decode(kind, 1, &bytes);
        }
    }

    #[test]
    fn no_body_of_the_right_length_makes_it_panic(kind in any_kind(), seed: u64) {
        let mut body = vec![0; kind.table().size];
        ChaCha8Rng::seed_from_u64(seed).fill_bytes(&mut body);
        let _ = Message::decode(kind as u8, 1, &body);
        kind.table().settle(&mut body);
        kind.table().json(&body);
    }

    #[test]
    fn a_stream_gives_the_same_messages_however_it_is_cut(seed: u64, step in 1usize..700) {
        let stream: Vec<u8> = Kind::ALL.iter().flat_map(|kind| frame(&random_message(*kind, seed)).to_vec()).collect();
        let (mut reader, mut buffer, mut read) = (Reader::default(), BytesMut::new(), Vec::new());
        for piece in stream.chunks(step) {
            buffer.put_slice(piece);
            while let Some(message) = reader.next(&mut buffer).unwrap() {
                read.push(Ok(message));
            }
        }
        prop_assert_eq!(read, decode_all(&stream));
        prop_assert_eq!(buffer.len(), 0);
    }
}

#[test]
fn a_frame_cut_at_any_byte_waits_for_the_rest() {
    for kind in Kind::ALL {
        let whole = frame(&random_message(kind, 1));
        for end in 0..whole.len() {
            assert!(decode_all(&whole[..end]).is_empty(), "{kind:?} cut at {end}");
        }
    }
}

#[test]
fn a_body_cut_at_any_byte_or_too_long_is_refused() {
    for kind in Kind::ALL {
        let body = random_message(kind, 2).body().unwrap();
        for end in 0..body.len() {
            let error = Message::decode(kind as u8, PROTOCOL_CURRENT, &body[..end]).unwrap_err();
            assert!(matches!(error, WireError::BadBody(BodyError::Length { .. })), "{error}");
        }
        let longer = [&body[..], &[0]].concat();
        assert!(matches!(
            Message::decode(kind as u8, PROTOCOL_CURRENT, &longer),
            Err(WireError::BadBody(BodyError::Length { .. }))
        ));
    }
}

#[test]
fn of_a_later_version_the_part_that_is_known_is_read() {
    for kind in Kind::ALL {
        let message = random_message(kind, 3);
        let longer = [&message.body().unwrap()[..], &[0xFF; 17]].concat();
        assert_eq!(Message::decode(kind as u8, PROTOCOL_CURRENT + 1, &longer), Ok((message.clone(), 0)));
        let shorter = &longer[..kind.table().size - 1];
        assert!(Message::decode(kind as u8, PROTOCOL_CURRENT + 1, shorter).is_err());
    }
}

#[test]
fn each_kind_of_damage_has_its_own_error() {
    let status = random_message(Kind::Status, 4).body().unwrap();
    assert_eq!(decode_all(&frame_of(3, 0, &status)), [Err(WireError::BadVersion(0))]);
    assert_eq!(decode_all(&frame_of(77, 1, &status)), [Err(WireError::UnknownKind(77))]);
    assert_eq!(decode_all(&frame_of(0, 1, &status)), [Err(WireError::UnknownKind(0))]);
    let mut short = BytesMut::from(&SYNC[..]);
    short.put_u32_le(5);
    assert_eq!(decode_all(&short), [Err(WireError::TooShort { length: 5 })]);
}

#[test]
fn a_hostile_length_is_refused_from_the_header_alone_and_allocates_nothing() {
    for length in [65_529u32, 1 << 20, u32::MAX] {
        let mut buffer = BytesMut::from(&SYNC[..]);
        buffer.put_u32_le(length);
        let before = buffer.capacity();
        let error = Reader::default().next(&mut buffer).unwrap_err();
        assert!(matches!(error, WireError::TooLong { .. }), "{error}");
        assert!(buffer.capacity() <= before);
    }
}

#[test]
fn a_stream_without_frames_is_given_up() {
    let (mut reader, mut buffer) = (Reader::default(), BytesMut::new());
    for _ in 0..MAX_GARBAGE / 1024 {
        buffer.put_slice(&[0x55; 1024]);
        assert_eq!(reader.next(&mut buffer), Ok(None));
    }
    buffer.put_slice(&[0x55; 1024]);
    assert_eq!(reader.next(&mut buffer), Err(WireError::NoSync(MAX_GARBAGE + 1024)));
}

#[test]
fn after_a_damaged_frame_the_next_whole_one_is_found() {
    let (first, second) = (random_message(Kind::Update, 5), random_message(Kind::Status, 6));
    let mut stream = frame(&first);
    stream[100] ^= 4;
    stream.put_slice(&frame(&second));
    let read = decode_all(&stream);
    assert!(matches!(read.first(), Some(Err(WireError::BadChecksum { .. }))));
    assert_eq!(read.last(), Some(&Ok(second)));
}

#[test]
fn nan_wrong_flags_and_wrong_codes_are_refused_with_the_name_of_the_field() {
    let cases: [(Kind, &str, &[u8]); 6] = [
        (Kind::Status, "uptime_s", &f64::NAN.to_le_bytes()),
        (Kind::Status, "latitude_deg", &f64::INFINITY.to_le_bytes()),
        (Kind::Status, "claims_charge", &[2]),
        (Kind::Status, "observer_known", &[255]),
        (Kind::Status, "clock_quality", &[0]),
        (Kind::Hello, "name", b"a\0b"),
    ];
    for (kind, name, bytes) in cases {
        let mut body = random_message(kind, 7).body().unwrap();
        set(kind, &mut body, name, bytes);
        match Message::decode(kind as u8, 1, &body) {
            Err(WireError::BadBody(BodyError::Field { field, .. })) => assert_eq!(field, name),
            other => panic!("{name}: {other:?}"),
        }
    }
    let mut gyro = random_message(Kind::Gyro, 8).body().unwrap();
    set(Kind::Gyro, &mut gyro, "samples", &f32::NAN.to_le_bytes());
    let error = Message::decode(Kind::Gyro as u8, 1, &gyro).unwrap_err();
    assert_eq!(error.to_string(), "bad body: Gyro.samples[0].az_rate_deg_s: NaN is not finite");
}

#[test]
fn a_flagged_value_out_of_range_is_taken_as_not_known_and_counted() {
    let observer = ObserverPart { latitude_deg: -77.0, sidereal_time_h: 8.0 };
    let status = Message::Status(Box::new(Status { observer: Some(observer).into(), ..Status::default() }));
    let mut body = status.body().unwrap();
    set(Kind::Status, &mut body, "sidereal_time_h", &25.0f64.to_le_bytes());
    let mut reader = Reader::default();
    let read = reader.next(&mut frame_of(Kind::Status as u8, 1, &body)).unwrap().unwrap();
    let Message::Status(read) = read else { panic!("not a status") };
    assert_eq!(read.observer(), None);
    assert_eq!(reader.values_withheld, 1);
}

#[test]
fn a_number_that_broke_inside_is_withheld_and_the_rest_still_goes_out() {
    let pointing = Equatorial { ra_deg: f64::NAN, dec_deg: 12.0, ..Equatorial::default() };
    let image = Image {
        image_counter: 9.into(),
        equatorial: Some(pointing).into(),
        solve_time_ms: Some(f64::INFINITY).into(),
        focus_metric_adu: Some(f64::NAN).into(),
        ..Image::default()
    };
    let sent = Message::Update(Box::new(Update { image: Some(image).into(), ..Update::default() }));
    let read = decode_all(&frame(&sent));
    let Some(Ok(Message::Update(update))) = read.first() else { panic!("{read:?}") };
    let image = update.image.get().unwrap();
    assert_eq!(image.image_counter.get(), 9);
    assert_eq!(image.equatorial.get(), None);
    assert_eq!(image.focus_metric_adu.get(), None);
    assert_eq!(image.solve_time_ms.get(), None);
}

#[test]
fn a_version_is_told_nothing_that_it_has_no_code_for() {
    use crate::solve::SearchMode;
    let captured_quality = Some(Coded::from(ClockQuality::Ptp)).into();
    let image = Image { mode: SearchMode::Motion.into(), captured_quality, ..Image::default() };
    let mut update = Update { image: Some(image).into(), ..Update::default() };
    update.link.clock.clock_quality = ClockQuality::FlightComputer.into();
    let later = crate::command::Refusal::ALL.iter().copied().last();
    update.authority.last_refusal = later.into();
    let message = Message::Update(Box::new(update));
    for (version, mode, refused) in [(1, SearchMode::Robust, false), (2, SearchMode::Robust, true), (3, SearchMode::Motion, true)]
    {
        let mut bytes = BytesMut::new();
        message.encode_in(version, &mut bytes).unwrap();
        let read = decode_all(&bytes);
        let Some(Ok(Message::Update(update))) = read.first() else { panic!("{read:?}") };
        assert_eq!(update.image.get().and_then(|image| image.mode.get()), Some(mode), "{version}");
        assert_eq!(update.authority.last_refusal.get().is_some(), refused, "{version}");
        let clocks = (update.link.clock.clock_quality.get(), update.image.get().and_then(|image| image.captured_quality.value()));
        let synchronised = ClockQuality::Synchronised;
        let told = if version < 3 { (synchronised, synchronised) } else { (ClockQuality::FlightComputer, ClockQuality::Ptp) };
        assert_eq!(clocks, (Some(told.0), Some(told.1)), "{version}");
    }
}

#[test]
fn every_default_message_can_be_read() {
    let messages = [
        Message::Hello(Box::new(Hello::new(Role::Camera, 1, "north", 1, None))),
        Message::Refuse(Box::new(Refuse::new(Refusal::Silent, ""))),
        Message::Status(Box::default()),
        Message::Update(Box::default()),
        Message::Gyro(Box::default()),
        Message::ImageRequest(Box::default()),
        Message::ImageChunk(Box::default()),
        Message::ImageRefusal(Box::default()),
    ];
    for message in messages {
        let mut read = decode_all(&frame(&message));
        assert_eq!(read.remove(0).unwrap().kind(), message.kind());
    }
}

#[test]
fn earlier_versions_have_no_images() {
    for message in
        [Message::ImageRequest(Box::default()), Message::ImageChunk(Box::default()), Message::ImageRefusal(Box::default())]
    {
        let body = message.body().unwrap();
        for version in [1, 2] {
            let wrong = WireError::BadVersion(version);
            assert_eq!(message.encode_in(version, &mut BytesMut::new()), Err(wrong.clone()));
            assert_eq!(Message::decode(message.kind() as u8, version, &body), Err(wrong));
        }
    }
}

#[test]
fn tables_have_no_gaps_and_no_name_twice() {
    fn check(table: &Table) {
        let mut next = 0;
        let mut names = std::collections::HashSet::new();
        for field in &table.fields {
            assert_eq!(field.offset, next, "{}.{}", table.name, field.name);
            assert!(field.size > 0 && field.count() > 0, "{}.{}", table.name, field.name);
            assert!(names.insert(field.name.clone()), "{}.{} twice", table.name, field.name);
            assert!(!field.meaning.is_empty() && !["kind", "t_s", "interval_s"].contains(&field.name.as_str()));
            next += field.size;
            if let Form::Rows(row) = &field.form {
                assert_eq!(row.size * field.count(), field.size);
                check(row);
            }
        }
        assert_eq!(next, table.size);
    }
    for (kind, table) in tables() {
        check(table);
        assert!(table.size + OVERHEAD <= MAX_FRAME, "{kind:?}");
    }
}

#[test]
fn json_has_null_for_what_is_not_known_and_only_the_rows_that_count() {
    let image = Image { sources_count: 1, reason: crate::solve::Reason::NoMatch.into(), ..Image::default() };
    let update = Update { image: Some(image).into(), ..Update::default() };
    let json = Message::Update(Box::new(update)).json().unwrap();
    assert_eq!(json["reason"], "no_match");
    assert_eq!(json["ra_deg"], serde_json::Value::Null);
    assert_eq!(json["equatorial_known"], false);
    assert_eq!(json["sources"].as_array().unwrap().len(), 1);
    assert_eq!(json["sources"][0]["x_px"], 0.0);
    assert_eq!(json["image_counter"], 0);
}

#[test]
fn json_of_an_update_without_an_image_has_every_flag_in_it_unset() {
    let json = Message::Update(Box::default()).json().unwrap();
    assert_eq!(
        (&json["image_known"], &json["equatorial_known"], &json["epoch_yr_known"]),
        (&false.into(), &false.into(), &false.into())
    );
    assert!(json["corrected_refraction"].is_null() && json["sources"].is_null());
    assert!(json.iter().all(|(name, value)| !name.ends_with("_known") || value.is_boolean()));
}
