//! Four descriptions of the wire, checked against each other: the program's own tables, the C header, the Python client and the
//! golden bytes. Everything in `proto/` that is made from the tables is compared with what they make now, and
//! `STARS_BLESS=1 cargo test --test proto` writes it anew.
//!
//! Needs `gcc` and `python3`. The bytes in `proto/golden/v1` and `v2` are those of versions that are spoken: where a test says that
//! they no longer come out, do not change the bytes but give the new layout a new version. Those of the current version are in
//! the folder with its number.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod c;
mod dictionary;
mod icd;
mod live;
mod samples;

use bytes::BytesMut;
use serde_json::Value;
use stars::wire::{Kind, Message, PROTOCOL_CURRENT, decode_all, tables};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Once;

fn proto(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("proto").join(name)
}

fn golden(name: &str, extension: &str) -> PathBuf {
    proto(&format!("golden/v{PROTOCOL_CURRENT}")).join(format!("{name}.{extension}"))
}

/// Every file that is made from the tables, with what should be in it.
fn made() -> Vec<(PathBuf, String)> {
    let mut files = vec![
        (proto("ICD.md"), document()),
        (proto("stars_icd.h"), c::header()),
        (proto("check.c"), c::checker()),
        (proto("schema.json"), pretty(&icd::schema())),
        (proto("stars.xtce.xml"), dictionary::xtce()),
    ];
    for (name, message) in samples::all() {
        files.push((golden(name, "hex"), to_hex(&frame(&message))));
        files.push((golden(name, "json"), pretty(&Value::Object(message.json().unwrap()))));
    }
    files
}

fn pretty(value: &Value) -> String {
    serde_json::to_string_pretty(value).unwrap() + "\n"
}

/// Writes all of it when blessing, once and before any test looks.
fn bless() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        if std::env::var_os("STARS_BLESS").is_some_and(|set| set == "1") {
            made().iter().for_each(|(path, wanted)| std::fs::write(path, wanted).unwrap());
        }
    });
}

/// Runs a program that must be there and must succeed.
fn run(program: &str, arguments: &[&str]) -> String {
    let output = Command::new(program).args(arguments).output();
    let output = output.unwrap_or_else(|error| panic!("{program} is needed to check proto/ and does not start: {error}"));
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{program} {arguments:?}: {errors}");
    String::from_utf8(output.stdout).unwrap()
}

fn frame(message: &Message) -> Vec<u8> {
    let mut out = BytesMut::new();
    message.encode(&mut out).unwrap();
    out.to_vec()
}

fn to_hex(bytes: &[u8]) -> String {
    let line = |bytes: &[u8]| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>() + "\n";
    bytes.chunks(32).map(line).collect()
}

fn golden_bytes(name: &str) -> Vec<u8> {
    from_hex(&golden(name, "hex"))
}

fn from_hex(path: &Path) -> Vec<u8> {
    let digits: Vec<u8> = std::fs::read(path).unwrap().into_iter().filter(u8::is_ascii_hexdigit).collect();
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    digits.chunks(2).map(byte).collect()
}

fn golden_json(name: &str) -> Value {
    serde_json::from_str(&std::fs::read_to_string(golden(name, "json")).unwrap()).unwrap()
}

/// Equal but for the last digit of a float: `serde_json` reads decimals to within one unit of it.
fn same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            (a - b).abs() <= 2.0 * f64::EPSILON * a.abs()
        }
        (Value::Array(a), Value::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| same(a, b)),
        (Value::Object(a), Value::Object(b)) => {
            a.len() == b.len() && a.iter().all(|(name, a)| b.get(name).is_some_and(|b| same(a, b)))
        }
        _ => a == b,
    }
}

fn assert_says_the_same(who: &str, name: &str, said: &str) {
    let said: Value = serde_json::from_str(said).unwrap_or_else(|error| panic!("{who}, {name}: {error}: {said}"));
    let wanted = golden_json(name);
    for (field, value) in wanted.as_object().unwrap() {
        assert!(
            said.get(field).is_some_and(|said| same(said, value)),
            "{who}, {name}.{field}: {:?}, not {value}",
            said.get(field)
        );
    }
    assert!(same(&said, &wanted), "{who}, {name}: fields that are not in the golden file");
}

/// The document with what stands between its marks made anew.
fn document() -> String {
    let mut text = std::fs::read_to_string(proto("ICD.md")).unwrap();
    let parts = tables().map(|(kind, table)| (table.name, icd::section(kind, table)));
    for (name, part) in parts.chain([("framing", icd::framing()), ("the commands", dictionary::command_table())]) {
        let (begin, end) = (format!("<!-- made from the tables: {name} -->\n"), format!("<!-- end of {name} -->\n"));
        let from = text.find(&begin).unwrap_or_else(|| panic!("ICD.md has no {begin}")) + begin.len();
        let to = text.find(&end).unwrap_or_else(|| panic!("ICD.md has no {end}"));
        text.replace_range(from..to, &part);
    }
    text
}

#[test]
fn everything_in_proto_that_is_made_from_the_tables_is_what_they_make_now() {
    bless();
    for (path, wanted) in made() {
        let found = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(found == wanted, "{} is not what the tables make: STARS_BLESS=1 cargo test --test proto", path.display());
    }
}

#[test]
fn the_golden_bytes_are_read_back_as_the_messages_that_they_came_from() {
    bless();
    for (name, message) in samples::all() {
        assert!(decode_all(&golden_bytes(name)) == [Ok(message)], "{name}");
    }
    let kinds: Vec<_> = samples::all().iter().map(|(_, message)| message.kind()).collect();
    assert!(Kind::ALL.iter().all(|kind| kinds.contains(kind)), "every kind of message has golden bytes");
}

/// What an earlier version says is read as it was meant, and can be said again in that version, byte for byte.
#[test]
fn the_golden_bytes_of_earlier_versions_are_still_read_and_written() {
    for (version, messages) in [(1, 9), (2, 11)] {
        assert_eq!(read_again(version), messages, "version {version}");
    }
}

/// Reads and writes all golden messages of a version; how many there are.
fn read_again(version: u8) -> usize {
    let mut read = 0;
    for entry in std::fs::read_dir(proto(&format!("golden/v{version}"))).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "hex") {
            continue;
        }
        let bytes = from_hex(&path);
        let message = decode_all(&bytes).remove(0).unwrap();
        let (said, mut again) = (message.json().unwrap(), BytesMut::new());
        let wanted: Value = serde_json::from_str(&std::fs::read_to_string(path.with_extension("json")).unwrap()).unwrap();
        for (field, value) in wanted.as_object().unwrap() {
            assert!(same(&said[field], value), "{}: {field}: {}, not {value}", path.display(), said[field]);
        }
        message.encode_in(version, &mut again).unwrap();
        assert!(again == bytes, "{} is not written as it was", path.display());
        read += 1;
    }
    read
}

#[test]
fn a_c_program_reads_the_golden_bytes_through_the_header() {
    bless();
    let room = tempfile::tempdir().unwrap();
    let program = room.path().join("check");
    let program = program.to_str().unwrap();
    let source = proto("check.c");
    run("gcc", &["-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-o", program, source.to_str().unwrap()]);
    for (name, _) in samples::all() {
        assert_says_the_same("C", name, &run(program, &[golden(name, "hex").to_str().unwrap()]));
    }
}

#[test]
fn the_python_client_reads_the_golden_bytes_and_writes_them_again() {
    bless();
    let client = proto("stars_client.py");
    for (name, _) in samples::all() {
        let file = golden(name, "hex");
        let arguments = [client.to_str().unwrap(), "--decode", file.to_str().unwrap()];
        assert_says_the_same("Python", name, &run("python3", &arguments));
        let arguments = [client.to_str().unwrap(), "--encode-again", file.to_str().unwrap()];
        assert_eq!(run("python3", &arguments), to_hex(&golden_bytes(name)), "{name}");
    }
}

/// Flattened as the dictionary has it: `sources_3_x_px`.
fn flatten(value: &Value, name: &str, flat: &mut Vec<(String, Value)>) {
    let below = |inner: &str| if name.is_empty() { inner.to_owned() } else { format!("{name}_{inner}") };
    match value {
        Value::Object(fields) => fields.iter().for_each(|(inner, value)| flatten(value, &below(inner), flat)),
        // A matrix counts through.
        Value::Array(rows) if !rows.is_empty() && rows.iter().all(Value::is_array) => {
            let all: Vec<Value> = rows.iter().flat_map(|row| row.as_array().unwrap().clone()).collect();
            flatten(&Value::Array(all), name, flat);
        }
        Value::Array(values) => values.iter().enumerate().for_each(|(n, value)| flatten(value, &below(&n.to_string()), flat)),
        value => flat.push((name.to_owned(), value.clone())),
    }
}

#[test]
fn the_xtce_dictionary_reads_the_golden_bytes() {
    bless();
    let reader = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/proto/xtce.py");
    for name in ["update_solved", "update_unsolved", "update_no_image"] {
        let (dictionary, file) = (proto("stars.xtce.xml"), golden(name, "hex"));
        let arguments = [reader.to_str().unwrap(), dictionary.to_str().unwrap(), "Update", file.to_str().unwrap()];
        let said: Value = serde_json::from_str(&run("python3", &arguments)).unwrap();
        let mut wanted = Vec::new();
        flatten(&golden_json(name), "", &mut wanted);
        assert!(wanted.len() > 100);
        for (field, value) in wanted.iter().filter(|(_, value)| !value.is_null()) {
            assert!(same(&said[field], value), "{name}.{field}: {}, not {value}", said[field]);
        }
    }
}

#[test]
fn each_of_the_44_variables_that_flew_has_its_place_in_the_update() {
    let guide = std::fs::read_to_string(proto("README.md")).unwrap();
    let fields = &Kind::Update.table().fields;
    let mut next = 0;
    for line in guide.lines() {
        let cells: Vec<_> = line.split('|').map(str::trim).collect();
        let [_, number, _, ours, ..] = cells.as_slice() else { continue };
        let Ok(number) = number.parse::<usize>() else { continue };
        assert_eq!(number, next, "the variables stand in their order");
        let name = ours.trim_matches('`');
        assert!(fields.iter().any(|field| field.name == name), "variable {number}: the update has no {name}");
        next += 1;
    }
    assert_eq!(next, 44);
}
