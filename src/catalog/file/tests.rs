use super::*;
use crate::sky::{DEG, separation};
use proptest::prelude::*;

/// One star as it stands in the file: ra, dec, pm_ra, pm_dec, mag, hip.
type Record = (u32, i32, i16, i16, i16, u32);

const SIRIUS: Record = (1_208_317_000, -199_500_000, -546, -1223, -1094, 32349);
const FAINT: Record = (4_294_967_295, 1_073_741_824, 0, 0, 10_241, 0);

fn header(count: u32, epoch_yr: f64, checksum: u32, origin: &str) -> Vec<u8> {
    let mut out = MAGIC.to_vec();
    out.extend(FORMAT.to_le_bytes());
    out.extend((RECORD_BYTES as u16).to_le_bytes());
    out.extend(count.to_le_bytes());
    out.extend(epoch_yr.to_le_bytes());
    out.extend(checksum.to_le_bytes());
    out.extend(origin.bytes());
    out.resize(60, 0);
    sealed(out)
}

/// The header with the checksum of its first 60 bytes.
fn sealed(mut header: Vec<u8>) -> Vec<u8> {
    header.truncate(60);
    header.extend(CRC.checksum(&header).to_le_bytes());
    header
}

fn file(records: &[Record]) -> Vec<u8> {
    let mut body = Vec::new();
    for (ra, dec, pm_ra, pm_dec, mag, hip) in records {
        body.extend(ra.to_le_bytes());
        body.extend(dec.to_le_bytes());
        body.extend(pm_ra.to_le_bytes());
        body.extend(pm_dec.to_le_bytes());
        body.extend(mag.to_le_bytes());
        body.extend(&hip.to_le_bytes()[..3]);
    }
    let mut out = header(records.len() as u32, 2016.0, CRC.checksum(&body), "two surveys");
    out.extend(body);
    out
}

fn refusal(bytes: &[u8]) -> String {
    Catalogue::from_bytes(bytes).unwrap_err().to_string()
}

#[test]
fn what_was_written_is_read() {
    let read = Catalogue::from_bytes(&file(&[SIRIUS, FAINT])).unwrap();
    let header = &read.header;
    assert_eq!((header.format, header.epoch_yr, header.count, header.origin.as_str()), (1, 2016.0, 2, "two surveys"));
    let [sirius, faint] = read.stars[..] else { panic!("two stars") };
    assert!((sirius.ra - 1_208_317_000.0 / 4_294_967_296.0 * TAU).abs() < 1e-14);
    assert!((sirius.pm_dec / MOTION_UNIT + 1223.0).abs() < 1e-9);
    assert!((sirius.pm_ra / MOTION_UNIT + 546.0).abs() < 1e-9);
    assert_eq!((sirius.mag, sirius.hip), (-1.094, 32349));
    assert!(faint.ra < TAU && (faint.dec / DEG - 90.0).abs() < 1e-12);
    assert_eq!((faint.mag, faint.hip), (10.241, 0));
}

#[test]
fn a_file_cut_anywhere_or_longer_than_it_says_is_refused() {
    let whole = file(&[SIRIUS, FAINT]);
    for length in 0..whole.len() {
        let error = Catalogue::from_bytes(&whole[..length]).unwrap_err();
        assert!(matches!(error, CatalogueError::Length { found, .. } if found == length), "{length}: {error}");
    }
    assert_eq!(refusal(&whole[..97]), "97 bytes long, expected 98 for 2 stars");
    assert_eq!(refusal(&[]), "0 bytes long, expected 64 for the header");
    let longer = [whole, vec![0]].concat();
    assert_eq!(refusal(&longer), "99 bytes long, expected 98 for 2 stars");
}

#[test]
fn a_file_with_any_bit_flipped_is_refused() {
    let whole = file(&[SIRIUS, FAINT]);
    for bit in 0..whole.len() * 8 {
        let mut bytes = whole.clone();
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert!(Catalogue::from_bytes(&bytes).is_err(), "bit {bit} flipped was believed");
    }
}

#[test]
fn a_foreign_file_is_named_as_one() {
    assert_eq!(refusal(b"SIMPLE  =   T"), "not a star catalogue: it begins with \"SIMPLE  \", expected \"STARSCAT\"");
    assert_eq!(refusal(b"hi"), "not a star catalogue: it begins with \"hi\", expected \"STARSCAT\"");
}

#[test]
fn another_layout_is_refused_before_anything_else_is_believed() {
    let mut bytes = file(&[SIRIUS]);
    bytes[8] = 2;
    assert_eq!(refusal(&bytes), "catalogue format 2, expected 1");
    bytes[8] = 1;
    bytes[10] = 18;
    assert_eq!(refusal(&bytes), "records of 18 bytes, expected 17");
}

#[test]
fn a_header_that_lies_under_a_right_checksum_is_refused_and_allocates_nothing() {
    assert!(refusal(&header(0, 2016.0, 0, "")).starts_with("header: number of stars is 0"));
    assert!(refusal(&header(u32::MAX, 2016.0, 0, "")).starts_with("header: number of stars is 4294967295"));
    assert_eq!(refusal(&header(MAX_COUNT, 2016.0, 0, "")), "64 bytes long, expected 25500064 for 1500000 stars");
    for epoch in [f64::NAN, f64::INFINITY, 0.0, 1899.9] {
        assert!(refusal(&header(1, epoch, 0, "")).starts_with("header: epoch is"), "{epoch}");
    }
    assert!(refusal(&header(1, 2016.0, 0, "a\tb")).starts_with("header: origin is"));
}

#[test]
fn a_star_out_of_range_is_refused_by_number_and_field() {
    let with = |change: fn(&mut Record)| {
        let mut star = FAINT;
        change(&mut star);
        refusal(&file(&[SIRIUS, star]))
    };
    assert!(with(|star| star.1 = POLE + 1).starts_with("star 1: declination"));
    assert!(with(|star| star.1 = i32::MIN).starts_with("star 1: declination"));
    assert!(with(|star| star.2 = 11_001).starts_with("star 1: proper motion in right ascension"));
    assert!(with(|star| star.3 = -11_001).starts_with("star 1: proper motion in declination"));
    assert!(with(|star| star.4 = 20_001).starts_with("star 1: magnitude"));
    assert!(with(|star| star.4 = -1095).starts_with("star 1: magnitude"), "not brightest first");
    assert!(with(|star| star.5 = HIGHEST_HIP + 1).starts_with("star 1: Hipparcos number"));
    assert_eq!(with(|star| star.5 = 32349), "star 1: Hipparcos number is 32349, expected each number once");
    Catalogue::from_bytes(&file(&[SIRIUS, FAINT, FAINT])).expect("many stars without a number");
}

proptest! {
    #[test]
    fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        prop_assert!(Catalogue::from_bytes(&bytes).is_err());
    }

    #[test]
    fn no_header_under_right_checksums_makes_it_panic(
        count in any::<u32>(), epoch in any::<f64>(), origin in proptest::collection::vec(any::<u8>(), 32),
        body in proptest::collection::vec(any::<u8>(), 0..200),
    ) {
        let mut bytes = header(count, epoch, CRC.checksum(&body), "");
        bytes.splice(28..60, origin);
        let mut bytes = sealed(bytes);
        bytes.extend(&body);
        if let Ok(read) = Catalogue::from_bytes(&bytes) {
            prop_assert_eq!(read.stars.len() * RECORD_BYTES, body.len());
        }
        let fitting = header((body.len() / RECORD_BYTES) as u32, 2016.0, CRC.checksum(&body), "");
        let _ = Catalogue::from_bytes(&[fitting, body].concat());
    }

    #[test]
    fn stars_in_range_are_read_as_written(
        mut records in proptest::collection::vec(
            (any::<u32>(), -POLE..=POLE, -FASTEST..=FASTEST, -FASTEST..=FASTEST, MAGNITUDES, Just(0u32)), 1..20),
    ) {
        records.sort_by_key(|record| record.4);
        let read = Catalogue::from_bytes(&file(&records)).unwrap();
        for (star, record) in read.stars.iter().zip(&records) {
            prop_assert_eq!((star.ra / POSITION_UNIT).round(), f64::from(record.0));
            prop_assert_eq!((star.dec / POSITION_UNIT).round(), f64::from(record.1));
            prop_assert_eq!((star.pm_ra / MOTION_UNIT).round(), f64::from(record.2));
            prop_assert_eq!((star.pm_dec / MOTION_UNIT).round(), f64::from(record.3));
            prop_assert_eq!((star.mag * 1000.0).round(), f32::from(record.4));
        }
    }
}

fn star(catalogue: &Catalogue, name: &str) -> Star {
    catalogue.stars[catalogue.find(name).unwrap_or_else(|| panic!("no {name}"))]
}

#[test]
fn the_embedded_catalogue_holds_the_sky() {
    let catalogue = Catalogue::embedded().unwrap();
    assert_eq!(catalogue.header.count, catalogue.stars.len());
    assert_eq!(catalogue.header.epoch_yr, 2016.0);
    assert!((480_000..490_000).contains(&catalogue.stars.len()));
    let numbered = catalogue.stars.iter().filter(|star| star.hip != 0).count();
    assert!(numbered > 109_000, "{numbered}");
    // Uniform enough that no hemisphere is missing.
    let south = catalogue.stars.iter().filter(|star| star.dec < 0.0).count();
    assert!((0.4..0.6).contains(&(south as f64 / catalogue.stars.len() as f64)));
}

#[test]
fn sirius_is_where_its_proper_motion_takes_it() {
    // Hipparcos-2 (van Leeuwen 2007): J2000 place in degrees and proper motion in arcsec/yr.
    let (ra, dec, pm_ra, pm_dec) = (101.287_155_33_f64, -16.716_115_86_f64, -0.546_01, -1.223_07);
    let at = |years: f64| {
        let dec_now = dec + pm_dec * years / 3600.0;
        direction((ra + pm_ra * years / 3600.0 / (dec * DEG).cos()) * DEG, dec_now * DEG)
    };
    let sirius = star(&Catalogue::embedded().unwrap(), "HIP 32349");
    assert!(separation(&sirius.direction_after(0.0), &at(16.0)) < 0.01 * ARCSEC);
    assert!(separation(&sirius.direction_after(-16.0), &at(0.0)) < 0.02 * ARCSEC);
    assert!((sirius.pm_ra / ARCSEC - pm_ra).abs() < 0.001 && (sirius.pm_dec / ARCSEC - pm_dec).abs() < 0.001);
}

#[test]
fn fast_stars_move_as_gaia_measured_years_later() {
    // Gaia DR3, mas/yr; the catalogue has the mean motion since 1991, within 20 mas/yr where perspective changes it.
    let catalogue = Catalogue::embedded().unwrap();
    for (name, pm_ra, pm_dec) in [
        ("Barnard's Star", -801.551, 10_362.394),
        ("Kapteyn's Star", 6491.223, -5708.614),
        ("Groombridge 1830", 4002.567, -5817.800),
        ("HIP 114046", 6765.995, 1330.285),
    ] {
        let star = star(&catalogue, name);
        let off = (star.pm_ra / MOTION_UNIT - pm_ra).hypot(star.pm_dec / MOTION_UNIT - pm_dec);
        assert!(off < 20.0, "{name} is off by {off} mas/yr");
    }
}

#[test]
fn well_known_stars_have_their_names_at_their_places() {
    let catalogue = Catalogue::embedded().unwrap();
    // Right ascension and declination, J2000, to a tenth of a degree.
    for (name, ra_deg, dec_deg) in [
        ("Betelgeuse", 88.8, 7.4),
        ("Antares", 247.4, -26.4),
        ("Arcturus", 213.9, 19.2),
        ("Vega", 279.2, 38.8),
        ("Rigel", 78.6, -8.2),
        ("Polaris", 38.0, 89.3),
        ("Canopus", 96.0, -52.7),
        ("Rigil Kentaurus", 219.9, -60.8),
        ("Fomalhaut", 344.4, -29.6),
        ("Alcyone", 56.9, 24.1),
        ("Rasalgethi", 258.7, 14.4),
    ] {
        let index = catalogue.find(&name.to_uppercase()).unwrap();
        assert_eq!(catalogue.name(index), name);
        let there = direction(ra_deg * DEG, dec_deg * DEG);
        assert!(separation(&catalogue.stars[index].direction_after(-16.0), &there) < 0.1 * DEG, "{name}");
    }
}

#[test]
fn every_name_belongs_to_a_star_and_every_star_can_be_called() {
    let catalogue = Catalogue::embedded().unwrap();
    let named = catalogue.stars.iter().filter(|star| proper_name(star.hip).is_some()).count();
    assert_eq!(named, Names::embedded().as_ref().unwrap().len());
    for wanted in [|star: &Star| star.hip == 0, |star: &Star| star.hip != 0 && proper_name(star.hip).is_none()] {
        let index = catalogue.stars.iter().position(wanted).unwrap();
        assert_eq!(catalogue.find(&catalogue.name(index)), Some(index));
    }
    assert_eq!(catalogue.find("no such star"), None);
    assert_eq!(catalogue.find("HIP 0"), None);
    assert_eq!(catalogue.find("G999999999"), None);
    assert_eq!(catalogue.name(usize::MAX), format!("G{}", usize::MAX));
}

#[test]
fn no_bright_star_is_there_twice() {
    let catalogue = Catalogue::embedded().unwrap();
    let bright: Vec<Vec3> = catalogue.stars.iter().take(300).map(|star| star.direction_after(0.0)).collect();
    for (i, a) in bright.iter().enumerate() {
        for (j, b) in bright.iter().enumerate().skip(i + 1) {
            assert!(separation(a, b) > ARCSEC, "{} and {}", catalogue.name(i), catalogue.name(j));
        }
    }
}
