//! `stars catalog` as an operator calls it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use std::path::Path;
use std::process::{Command, Output};

fn stars(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stars")).arg("catalog").args(arguments).output().unwrap()
}

/// Exit code, stdout and stderr.
fn answer(arguments: &[&str]) -> (i32, String, String) {
    let output = stars(arguments);
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (output.status.code().unwrap(), text(output.stdout), text(output.stderr))
}

fn shipped() -> Vec<u8> {
    std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/catalog/stars.bin")).unwrap()
}

/// Checks a file with these bytes: exit code, stderr, and the name that the file had.
fn check(bytes: &[u8]) -> (i32, String, String) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("some.bin");
    std::fs::write(&path, bytes).unwrap();
    let name = path.to_str().unwrap().to_owned();
    let (code, _, stderr) = answer(&["--check", &name]);
    (code, stderr, name)
}

#[test]
fn the_catalogue_in_use_is_described() {
    let (code, stdout, stderr) = answer(&[]);
    assert_eq!((code, stderr.as_str()), (0, ""));
    for line in
        ["file        built into the program", "origin      Gaia DR3 + Hipparcos-2", "format      1", "epoch       J2016.0, ICRS"]
    {
        assert!(stdout.lines().any(|found| found == line), "{line:?} is missing in\n{stdout}");
    }
    for start in ["checksum    ", "stars       48", "magnitudes  -", "names       "] {
        assert!(stdout.lines().any(|found| found.starts_with(start)), "{start:?} is missing in\n{stdout}");
    }
}

#[test]
fn a_whole_file_passes_and_is_read_when_the_settings_name_it() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("copy.bin");
    std::fs::write(&path, shipped()).unwrap();
    let name = path.to_str().unwrap();
    let (code, stdout, _) = answer(&["--check", name]);
    assert_eq!(code, 0);
    assert!(stdout.starts_with("whole and unaltered\n"), "{stdout}");
    let (code, stdout, _) = answer(&["--set", &format!("catalog.file={name}")]);
    assert_eq!(code, 0);
    assert!(stdout.contains(name), "{stdout}");
}

#[test]
fn a_cut_altered_foreign_or_missing_file_is_refused_in_one_line_that_names_it() {
    let whole = shipped();
    let mut altered = whole.clone();
    let middle = altered.len() / 2;
    altered[middle] ^= 1;
    let cases: [(&[u8], &str); 5] = [
        (&whole[..whole.len() - 1], "expected"),
        (&whole[..63], "63 bytes long, expected 64 for the header"),
        (&altered, "altered: checksum of the records"),
        (b"SIMPLE  =                    T", "not a star catalogue"),
        (b"", "0 bytes long, expected 64"),
    ];
    for (bytes, reason) in cases {
        let (code, stderr, name) = check(bytes);
        assert_eq!(code, 2, "{reason}");
        assert_eq!(stderr.lines().count(), 1, "{stderr}");
        assert!(stderr.contains(&name) && stderr.contains(reason), "{stderr}");
    }
    let (code, _, stderr) = answer(&["--check", "no/such/file.bin"]);
    assert_eq!(code, 2);
    assert!(stderr.contains("no/such/file.bin") && stderr.contains("expected a star catalogue"), "{stderr}");
}

#[test]
fn a_catalogue_named_in_the_settings_is_never_replaced_by_the_built_in_one() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cut.bin");
    std::fs::write(&path, &shipped()[..1000]).unwrap();
    let (code, stdout, stderr) = answer(&["--set", &format!("catalog.file={}", path.display())]);
    assert_eq!((code, stdout.as_str()), (2, ""));
    assert!(stderr.contains("cut.bin: 1000 bytes long, expected"), "{stderr}");
}

#[test]
fn a_star_is_found_by_name_by_number_and_by_what_solutions_call_it() {
    let (code, by_name, _) = answer(&["--star", "vega"]);
    assert_eq!(code, 0);
    assert!(by_name.starts_with("Vega\nHipparcos  91262\n"), "{by_name}");
    let rank: usize = by_name.lines().find_map(|line| line.strip_prefix("rank       ")?.split(' ').next()?.parse().ok()).unwrap();
    for other in ["91262", "HIP 91262", &format!("G{}", rank - 1)] {
        assert_eq!(answer(&["--star", other]), (0, by_name.clone(), String::new()), "{other}");
    }
    let (code, stdout, _) = answer(&["--star", "Nibiru"]);
    assert_eq!((code, stdout.as_str()), (1, "no star is called \"Nibiru\"\n"));
}

#[test]
fn a_star_without_a_hipparcos_number_is_said_to_have_no_known_motion() {
    let (code, stdout, _) = answer(&["--star", "G470000"]);
    assert_eq!(code, 0);
    assert!(stdout.contains("Hipparcos  none") && stdout.contains("motion     unknown"), "{stdout}");
}

#[test]
fn the_readme_beside_the_catalogue_tells_its_checksum_and_size() {
    let readme = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/catalog/README.md")).unwrap();
    let (_, stdout, _) = answer(&[]);
    let value = |key: &str| stdout.lines().find_map(|line| line.strip_prefix(key)?.split_whitespace().next()).unwrap();
    assert!(readme.contains(&format!("`{}`", value("checksum"))), "{stdout}");
    assert!(readme.replace(',', "").contains(&format!("{} stars", value("stars"))), "{stdout}");
    assert!(readme.contains(&format!("{} proper names", value("names"))), "{stdout}");
}

#[test]
fn all_catalogue_files_together_stay_under_ten_megabytes() {
    let directory = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/catalog")).unwrap();
    let bytes: u64 = directory.map(|entry| entry.unwrap().metadata().unwrap().len()).sum();
    assert!(bytes < 10_000_000, "{bytes}");
}

#[test]
fn the_index_of_a_camera_is_built_once_and_read_from_then_on() {
    let cache = tempfile::tempdir().unwrap();
    let directory = format!("catalog.cache_directory={}", cache.path().display());
    let wide = ["solver.matching.platescale_min_arcsec_px=48", "solver.matching.platescale_max_arcsec_px=50"];
    let arguments = ["--index", "--set", &directory, "--set", wide[0], "--set", wide[1]];
    for word in ["index       built in ", "index       read from the cache in "] {
        let (code, stdout, stderr) = answer(&arguments);
        assert_eq!((code, stderr.as_str()), (0, ""));
        assert!(stdout.starts_with("field       20.91 × 13.94 deg") && stdout.contains(word), "{stdout}");
        assert!(!stdout.contains("note"), "{stdout}");
    }
}

#[test]
fn its_help_has_an_example() {
    let (code, stdout, _) = answer(&["--help"]);
    assert_eq!(code, 0);
    assert!(stdout.contains("stars catalog --star Vega"), "{stdout}");
}
