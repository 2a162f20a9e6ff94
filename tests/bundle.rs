//! `stars bundle` as an operator sees it: what was there is in it, whole; what was not is named; keys are nowhere.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use flate2::read::GzDecoder;
use std::collections::BTreeMap;
use std::fs::{self, File, Permissions};
use std::io::Read;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

const KEY: &str = "00112233445566778899aabbccddeeff00112233445566778899aabbccddeeff";

/// A flight's directories: three records, two files of state with a key beside them, images.
fn flight(root: &Path) -> Vec<String> {
    let write = |name: &str, content: &[u8]| {
        let path = root.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, content).unwrap();
        path
    };
    write("record/outcomes-2013-01-01T00-00-00.000-00000001.jsonl", b"{\"image\":\"old\"}\n");
    let long: String = (0..200_000).map(|n| format!("{{\"image\":\"{n:032}\"}}\n")).collect();
    write("record/outcomes-2013-01-02T00-00-00.000-00000002.jsonl", long.as_bytes());
    write("record/journal-2013-01-02T00-00-00.000-00000002-0000.journal", &vec![7; 9 << 20]);
    write("state/kept.0", b"first copy");
    write("state/kept.1", b"second copy");
    write("state/key.bak", KEY.as_bytes());
    fs::set_permissions(write("state/key", KEY.as_bytes()), Permissions::from_mode(0o600)).unwrap();
    for number in 0..3 {
        let path = write(&format!("record/images/2013-01-0{}/{number}.fits", 1 + number / 2), &[number; 2880]);
        File::options()
            .write(true)
            .open(path)
            .unwrap()
            .set_modified(std::time::UNIX_EPOCH + std::time::Duration::from_secs(u64::from(number)))
            .unwrap();
    }
    let set = |key: &str, path: &str| format!("{key}={}", root.join(path).display());
    [set("record.directory", "record"), set("commands.ledger_directory", "state"), set("commands.key_file_1", "state/key")]
        .into_iter()
        .flat_map(|assignment| ["--set".to_owned(), assignment])
        .collect()
}

fn stars(root: &Path, arguments: &[String]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_stars")).current_dir(root).arg("bundle").args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// Files of a bundle by their names below its directory.
fn unpacked(path: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut archive = tar::Archive::new(GzDecoder::new(File::open(path).unwrap()));
    archive
        .entries()
        .unwrap()
        .map(|entry| {
            let mut entry = entry.unwrap();
            let name = entry.path().unwrap().iter().skip(1).collect::<std::path::PathBuf>().display().to_string();
            let mut content = Vec::new();
            entry.read_to_end(&mut content).unwrap();
            (name, content)
        })
        .collect()
}

#[test]
fn it_has_settings_state_ends_of_records_and_newest_images_and_no_key() {
    let directory = TempDir::new().unwrap();
    let root = directory.path();
    let mut arguments = flight(root);
    arguments.extend(["--out".to_owned(), "bundle.tar.gz".to_owned(), "--images".to_owned(), "1".to_owned()]);
    let output = stars(root, &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(text(&output.stdout).starts_with("bundle.tar.gz: "), "{}", text(&output.stdout));
    let files = unpacked(&root.join("bundle.tar.gz"));
    assert_eq!((&files["state/kept.0"][..], &files["state/kept.1"][..]), (&b"first copy"[..], &b"second copy"[..]));
    assert!(text(&files["settings.txt"]).contains("commands.ledger_directory"), "{files:?}");
    assert!(text(&files["about.txt"]).contains("protocol") && text(&files["machine.txt"]).contains("GB free"));
    assert_eq!(text(&files["records/outcomes-2013-01-01T00-00-00.000-00000001.jsonl"]), "{\"image\":\"old\"}\n");
    let long = text(&files["records/outcomes-2013-01-02T00-00-00.000-00000002.jsonl"]);
    assert!((4_000_000..4 << 20).contains(&long.len()) && long.ends_with(&format!("{{\"image\":\"{:032}\"}}\n", 199_999)));
    assert!(long.lines().all(|line| line.starts_with("{\"image\"") && line.ends_with('}')), "a line is torn");
    assert_eq!(files["records/journal-2013-01-02T00-00-00.000-00000002-0000.journal"], vec![7; 8 << 20]);
    let images: Vec<&String> = files.keys().filter(|name| name.starts_with("images/")).collect();
    assert_eq!(images, ["images/2.fits"]);
    assert_eq!(text(&files["images.txt"]).lines().count(), 3);
    assert!(files.values().all(|content| !content.windows(KEY.len()).any(|window| window == KEY.as_bytes())), "a key is in it");
    assert!(text(&output.stdout).contains("not in it: state/runs.0: "), "{}", text(&output.stdout));
}

#[test]
fn what_is_not_there_is_named_and_what_is_there_is_not_overwritten() {
    let directory = TempDir::new().unwrap();
    let root = directory.path();
    let set = ["--set", "record.directory=gone", "--set", "commands.ledger_directory=nowhere", "--out", "bundle.tar.gz"];
    let arguments = set.map(str::to_owned);
    let output = stars(root, &arguments);
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(said.contains("not in it: state/kept.0: ") && said.contains("not in it: records: gone"), "{said}");
    assert!(text(&unpacked(&root.join("bundle.tar.gz"))["missing.txt"]).contains("nowhere"));
    let output = stars(root, &arguments);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).starts_with("stars: bundle.tar.gz cannot be written"), "{}", text(&output.stderr));
}
