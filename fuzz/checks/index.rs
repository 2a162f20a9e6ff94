//! Files of an index: as they are, and a whole one with bytes altered and its checksums put right, so that what lies behind those is
//! reached too.
use stars::catalog::{Catalogue, Field, FieldKey, POINTS, Runs, TriangleQuery};
use stars::settings::{Layers, Settings};
use stars::sky::Vec3;
use std::sync::LazyLock;

/// Stars of the catalogue that are kept, so that the index is small.
const BRIGHTEST: usize = 150;
/// Bytes before the lists, a checksum last.
const OPENING: usize = 8 + 4 + 13 * 8 + 4;
/// An input that begins with this byte is a list of changes, five bytes each: where, and to what.
const CHANGES: u8 = 0xFF;

static FIELD: LazyLock<Field> = LazyLock::new(|| {
    let mut catalogue = Catalogue::embedded().expect("the catalogue in the program is whole");
    catalogue.stars.truncate(BRIGHTEST);
    let mut settings: Settings = Layers::embedded().load().expect("the flight file is right").settings;
    settings.solver.matching.platescale_min_arcsec_px = 900.0;
    settings.solver.matching.platescale_max_arcsec_px = 1000.0;
    let key = FieldKey::new(&catalogue, &settings, 100, 80);
    Field::build(&catalogue, &key, &|| true).expect("nobody ends it")
});

static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let mut bytes = Vec::new();
    FIELD.save(&mut bytes).expect("memory takes it");
    bytes
});

/// Reads it, and asks of it what a solver does.
fn examine(bytes: &[u8]) {
    let Ok(field) = Field::load(&mut &bytes[..], bytes.len() as u64, &FIELD.key) else { return };
    let queries = [(0.1, 0.1), (0.3, -0.5), (0.5, 0.8)].map(|(x, y)| TriangleQuery { x, y, tolerance: 0.5, length: (0.0, 2.0) });
    let (mut runs, mut found) = (Runs::default(), Vec::new());
    field.triangles.find(&queries, &mut runs, &mut found);
    for triangle in &found {
        assert!(triangle.stars.iter().all(|&star| field.triangles.direction(star).norm() > 0.0));
    }
    for centre in [Vec3::x(), -Vec3::z(), Vec3::new(0.6, 0.0, 0.8)] {
        field.stars.near(&centre, 0.5, |_, star| assert!(star.mag.is_finite()));
        let cells = field.bitmap.cells(&[centre, Vec3::y(), Vec3::z()], &[0.1; POINTS], &[-3.0; POINTS], POINTS);
        field.bitmap.hits(&cells);
    }
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    match data {
        [CHANGES, changes @ ..] => {
            let mut bytes = WHOLE.clone();
            let end = bytes.len() - 4;
            for change in changes.chunks_exact(5).take(16) {
                let at = u32::from_le_bytes([change[0], change[1], change[2], change[3]]) as usize;
                bytes[OPENING + at % (end - OPENING)] = change[4];
            }
            let checksum = crc32fast::hash(&bytes[..end]);
            bytes[end..].copy_from_slice(&checksum.to_le_bytes());
            examine(&bytes);
        }
        _ => {
            examine(data);
            examine(&[&WHOLE[..OPENING], data].concat());
        }
    }
}
