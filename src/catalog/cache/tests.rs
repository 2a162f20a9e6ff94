use super::*;
use crate::catalog::{Catalogue, POINTS, Runs, TriangleQuery};
use crate::settings::Settings;
use proptest::prelude::*;
use std::sync::LazyLock;

/// A field of a few bright stars, seen by a wide and coarse camera, so that its file is short.
static FIELD: LazyLock<Field> = LazyLock::new(|| {
    let mut catalogue = Catalogue::embedded().unwrap();
    catalogue.stars.truncate(150);
    let mut settings = Settings::flight().unwrap();
    settings.solver.matching.platescale_min_arcsec_px = 900.0;
    settings.solver.matching.platescale_max_arcsec_px = 1000.0;
    Field::build(&catalogue, &FieldKey::new(&catalogue, &settings, 100, 80), &|| true).unwrap()
});

static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut bytes = Vec::new();
    FIELD.save(&mut bytes).unwrap();
    bytes
});

/// Bytes before the lists: what it begins with, and the checksum of that.
const OPENING: usize = 8 + 4 + 13 * 8 + 4;

fn load(bytes: &[u8]) -> Result<Field, FieldFileError> {
    Field::load(&mut &bytes[..], bytes.len() as u64, &FIELD.key)
}

/// With both checksums put right.
fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    for end in [OPENING, bytes.len()] {
        let checksum = crc32fast::hash(&bytes[..end - 4]);
        bytes[end - 4..end].copy_from_slice(&checksum.to_le_bytes());
    }
    bytes
}

#[test]
fn what_was_written_is_read_bit_for_bit() {
    let (stars, triangles) = FIELD.triangles.counts();
    assert!(stars > 50 && triangles > 50, "{stars} {triangles}");
    let mut again = Vec::new();
    let read = load(&WHOLE).unwrap();
    read.save(&mut again).unwrap();
    assert!(again == *WHOLE);
    assert_eq!((read.key, read.geometry, read.triangles.counts()), (FIELD.key, FIELD.geometry, FIELD.triangles.counts()));
    assert_eq!(sealed(WHOLE.clone()), *WHOLE);
}

#[test]
fn a_file_cut_or_with_something_after_its_end_is_refused() {
    for length in (0..OPENING + 64).chain(WHOLE.len() - 64..WHOLE.len()) {
        assert!(load(&WHOLE[..length]).is_err(), "cut at {length}");
    }
    let longer = [&WHOLE[..], &[0]].concat();
    assert!(matches!(load(&longer).unwrap_err(), FieldFileError::Length { missing: false, .. }));
    // Shorter than its length was found to be, as when it is cut while it is read.
    let error = Field::load(&mut &WHOLE[..WHOLE.len() - 1], WHOLE.len() as u64, &FIELD.key).unwrap_err();
    assert!(matches!(error, FieldFileError::Length { missing: true, .. }), "{error}");
}

#[test]
fn a_field_of_something_else_is_refused_by_what_it_is() {
    let refusal = |bytes: &[u8]| load(bytes).unwrap_err().to_string();
    assert_eq!(refusal(b"SIMPLE  =                    T"), "not an index of stars");
    let mut format = WHOLE.clone();
    format[8] += 1;
    assert_eq!(refusal(&format), "index format 3, expected 2");
    // Every number of the key counts.
    for number in 0..13 {
        let mut other = WHOLE[..OPENING].to_vec();
        other[12 + 8 * number] ^= 1;
        let checksum = crc32fast::hash(&other[..OPENING - 4]);
        other[OPENING - 4..].copy_from_slice(&checksum.to_le_bytes());
        assert_eq!(refusal(&other), "made for another catalogue, camera or setting", "{number}");
    }
    let names: std::collections::HashSet<String> =
        [100, 101].map(|width| FieldKey { size: (width, 80), ..FIELD.key }.file_name()).into();
    assert_eq!(names.len(), 2);
}

#[test]
fn a_list_is_given_no_memory_that_the_file_has_not() {
    let mut bytes = WHOLE.clone();
    bytes[OPENING..OPENING + 8].copy_from_slice(&u64::MAX.to_le_bytes());
    assert!(matches!(load(&sealed(bytes)).unwrap_err(), FieldFileError::Length { missing: true, .. }));
}

#[test]
fn a_build_that_nobody_wants_any_more_ends_within_a_few_questions() {
    let catalogue = Catalogue::embedded().unwrap();
    let key = FieldKey::new(&catalogue, &Settings::flight().unwrap(), 1536, 1024);
    for wanted in [0, 1, 100] {
        let asked = std::cell::Cell::new(0);
        let keep_on = || asked.replace(asked.get() + 1) < wanted;
        assert!(Field::build(&catalogue, &key, &keep_on).is_none());
        assert_eq!(asked.get(), wanted + 1);
    }
}

/// Asks everything that a solver asks of a field.
fn use_it(field: &Field) {
    let lengths = (0.0, 2.0);
    let queries = [(0.1, 0.1), (0.3, -0.5), (0.5, 0.8)].map(|(x, y)| TriangleQuery { x, y, tolerance: 0.5, length: lengths });
    let (mut runs, mut found) = (Runs::default(), Vec::new());
    field.triangles.find(&queries, &mut runs, &mut found);
    assert!(found.iter().all(|triangle| triangle.stars.iter().all(|&star| field.triangles.direction(star).norm() > 0.0)));
    for centre in [Vec3::x(), -Vec3::z(), Vec3::new(0.6, 0.0, 0.8)] {
        field.stars.near(&centre, 0.5, |_, star| assert!(star.mag.is_finite()));
        let cells = field.bitmap.cells(&[centre, Vec3::y(), Vec3::z()], &[0.1; POINTS], &[-3.0; POINTS], POINTS);
        field.bitmap.hits(&cells);
    }
}

proptest! {
    // Most of a file is the table of bins, megabytes however few the stars.
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_file_cut_anywhere_or_with_any_bit_flipped_is_refused(part in 0.0..1.0, bit in 0..8u8) {
        let at = (part * WHOLE.len() as f64) as usize;
        prop_assert!(load(&WHOLE[..at]).is_err(), "cut at {}", at);
        let mut bytes = WHOLE.clone();
        bytes[at] ^= 1u8 << bit;
        prop_assert!(load(&bytes).is_err(), "byte {}", at);
    }

    #[test]
    fn no_bytes_are_believed(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(load(&bytes).is_err());
        prop_assert!(load(&[&WHOLE[..OPENING], &bytes].concat()).is_err());
    }

    #[test]
    fn what_lies_under_right_checksums_is_refused_or_can_be_used(
        changes in proptest::collection::vec((OPENING..WHOLE.len() - 4, any::<u8>()), 1..6),
    ) {
        let mut bytes = WHOLE.clone();
        for (at, byte) in changes {
            bytes[at] = byte;
        }
        if let Ok(field) = load(&sealed(bytes)) {
            use_it(&field);
        }
    }
}
