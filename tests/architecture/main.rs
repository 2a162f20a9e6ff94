//! The order of the rooms, kept by a test: who may use whom, and what the pure core may not touch.
//!
//! The sources are read as text. `source` takes comments, strings and tests out of a file and lists the paths that it names;
//! here are the rules and the checks of the checker: each rule must find a violation that is planted for it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

mod source;

use source::Source;
use std::fs;
use std::path::{Path, PathBuf};

/// The rooms in the order of use: a room may use those before it.
const ROOMS: [&str; 17] = [
    "settings",
    "sky",
    "catalog",
    "image",
    "sources",
    "solve",
    "calibrate",
    "command",
    "lens",
    "journal",
    "wire",
    "simulate",
    "display",
    "camera",
    "service",
    "soak",
    "cli",
];
/// The first room that may have a runtime, a clock, a disk, a socket or a thread. All before it are the core.
const FIRST_OF_SHELL: &str = "camera";
/// Lines of code that one file may have, tests, comments and blank lines aside. Past about 400 it usually holds two ideas.
const MAX_CODE_LINES: usize = 500;
/// A room's `mod.rs` says at least this much about it, characters.
const MIN_ROOM_DOC: usize = 60;

/// What the core may not name: a path that begins so is refused.
const NOT_IN_CORE: [(&str, &str); 13] = [
    ("tokio", "the core has no runtime"),
    ("tokio_util", "the core has no runtime"),
    ("socket2", "the core has no sockets"),
    ("std::net", "the core has no sockets"),
    ("std::fs", "the core reads what its caller opened"),
    ("std::os", "the core is portable"),
    ("std::process", "the core does not know its process"),
    ("std::env", "what the core needs comes in as an argument"),
    ("std::thread", "the core has no threads"),
    ("std::io::stdin", "the core reads what its caller opened"),
    ("rand::rng", "randomness comes in as a seeded generator"),
    ("clap", "the command line is the cli room's"),
    ("anyhow", "the core's errors have types"),
];
/// Names that the core may not have in any path, however they were imported.
const NAMES_NOT_IN_CORE: [(&str, &str); 8] = [
    ("Instant", "time comes in as an argument"),
    ("SystemTime", "time comes in as an argument"),
    ("File", "the core reads what its caller opened"),
    ("OpenOptions", "the core reads what its caller opened"),
    ("TcpStream", "the core has no sockets"),
    ("println", "the core does not print"),
    ("eprintln", "the core does not print"),
    ("dbg", "the core does not print"),
];
/// Names that no room may have.
const NAMES_NOWHERE: [(&str, &str); 6] = [
    ("unsafe", "nothing here gains enough by it to be worth it"),
    ("partial_cmp", "not a total order on floats, so sorting by it may panic; total_cmp is"),
    ("unbounded_channel", "every channel is bounded and says what happens when it is full"),
    ("UnboundedSender", "every channel is bounded and says what happens when it is full"),
    ("todo", "nothing is half there"),
    ("unimplemented", "nothing is half there"),
];

/// Honest exceptions: file, the path it may name, and why. One that is not needed any more fails the test.
const EXCEPTIONS: [(&str, &str, &str); 5] = [
    ("cli/memory.rs", "unsafe", "the C library has no safe way to be told to give memory back"),
    ("catalog/pages.rs", "unsafe", "the system has no safe way to be asked for large pages"),
    ("sky/vectors.rs", "unsafe", "the same code compiled for wider vectors is called where the processor has them"),
    (
        "image/statistics.rs",
        "unsafe",
        "sums of products that only AVX2's own instructions have, called where the processor has it",
    ),
    ("solve/abreast.rs", "std::thread", "two threads work on one frame, and have ended before its outcome is there"),
];

/// A broken rule: where, what, why.
#[derive(Debug, PartialEq, Clone)]
struct Violation {
    file: String,
    path: String,
    why: String,
}

/// What one file breaks. `file` is relative to `src`, as in `solve/fit.rs`.
fn violations(file: &str, text: &str) -> Vec<Violation> {
    let source = Source::new(text);
    let modules: Vec<&str> = file.trim_end_matches(".rs").split('/').filter(|part| *part != "mod").collect();
    let Some(position) = ROOMS.iter().position(|room| *room == modules[0]) else {
        return vec![violation(file, modules[0], "not a room; main.rs and lib.rs alone stand beside the rooms")];
    };
    let first_of_shell = ROOMS.iter().position(|room| *room == FIRST_OF_SHELL).unwrap();
    let mut found = Vec::new();
    for path in source.paths(modules.len()) {
        if let Some(used) = path.strip_prefix("crate::").and_then(|rest| rest.split("::").next())
            && let Some(other) = ROOMS.iter().position(|room| *room == used)
            && other > position
        {
            found.push(violation(file, &path, &format!("`{}` comes before `{used}` and may not use it", ROOMS[position])));
        }
        let begins = |prefix: &str| path == prefix || path.strip_prefix(prefix).is_some_and(|rest| rest.starts_with("::"));
        let names = |name: &str| path.split("::").any(|segment| segment == name);
        if position < first_of_shell {
            found.extend(NOT_IN_CORE.iter().filter(|(prefix, _)| begins(prefix)).map(|(_, why)| violation(file, &path, why)));
            found.extend(NAMES_NOT_IN_CORE.iter().filter(|(n, _)| names(n)).map(|(_, why)| violation(file, &path, why)));
        }
        found.extend(NAMES_NOWHERE.iter().filter(|(name, _)| names(name)).map(|(_, why)| violation(file, &path, why)));
    }
    if source.code_lines() > MAX_CODE_LINES {
        let why = format!("{} lines of code, at most {MAX_CODE_LINES} are wanted", source.code_lines());
        found.push(violation(file, "", &why));
    }
    let doc = source.opening_doc();
    if doc.is_empty() {
        found.push(violation(file, "", "does not begin by saying what it is for (`//!`)"));
    } else if file.ends_with("/mod.rs") && doc.len() < MIN_ROOM_DOC {
        found.push(violation(file, "", "a room's mod.rs says in a paragraph what it is for"));
    }
    found
}

fn violation(file: &str, path: &str, why: &str) -> Violation {
    Violation { file: file.into(), path: path.into(), why: why.into() }
}

/// All Rust files below `directory`, but for files of tests.
fn rust_files(directory: &Path, into: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, into);
        } else if path.extension().is_some_and(|e| e == "rs") && path.file_name().is_some_and(|name| name != "tests.rs") {
            into.push(path);
        }
    }
}

/// Every file of `src`, its name relative to it, and its text.
fn sources() -> Vec<(String, String)> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&src, &mut files);
    files.sort();
    let name = |path: &Path| path.strip_prefix(&src).unwrap().to_str().unwrap().to_owned();
    files.iter().map(|path| (name(path), fs::read_to_string(path).unwrap())).collect()
}

#[test]
fn rooms_use_only_those_before_them_and_the_core_is_pure() {
    let sources = sources();
    assert!(sources.len() > 20, "only {} files found", sources.len());
    let mut found: Vec<Violation> = Vec::new();
    for (file, text) in sources.iter().filter(|(file, _)| !["main.rs", "lib.rs"].contains(&file.as_str())) {
        found.extend(violations(file, text));
    }
    for (file, path, _) in EXCEPTIONS {
        let before = found.len();
        found.retain(|v| !(v.file == file && v.path.starts_with(path)));
        assert!(found.len() < before, "the exception of {file} for {path} is not needed any more");
    }
    let list: Vec<String> = found.iter().map(|v| format!("src/{}: {} {}", v.file, v.path, v.why)).collect();
    assert!(list.is_empty(), "\n{}", list.join("\n"));
}

#[test]
fn every_room_is_declared_in_the_library() {
    let sources = sources();
    let library = &sources.iter().find(|(file, _)| file == "lib.rs").unwrap().1;
    for room in ROOMS {
        let exists = sources.iter().any(|(file, _)| file.starts_with(&format!("{room}/")));
        assert_eq!(exists, library.contains(&format!("pub mod {room};")), "{room}");
    }
}

#[test]
fn every_dependency_is_used_and_the_readme_says_what_for() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manifest = fs::read_to_string(root.join("Cargo.toml")).unwrap();
    let readme = fs::read_to_string(root.join("README.md")).unwrap();
    let code: String = sources().into_iter().map(|(_, text)| text).collect();
    let sections = manifest.split("\n[").filter_map(|section| section.split_once("]\n"));
    let mut seen = 0;
    for (section, lines) in sections.filter(|(name, _)| ["dependencies", "dev-dependencies"].contains(name)) {
        for name in lines.lines().filter_map(|line| line.split_once(" = ")).map(|(name, _)| name) {
            assert!(readme.contains(&format!("`{name}`")), "README.md does not say what `{name}` is for");
            let used = code.contains(&format!("{}::", name.replace('-', "_")));
            assert!(used || section == "dev-dependencies", "nothing in src uses `{name}`");
            seen += 1;
        }
    }
    assert!(seen > 10, "only {seen} dependencies found");
}

/// What planting `code` in `file` is found to break.
fn planted(file: &str, code: &str) -> Vec<String> {
    let doc = "//! A file that is here only to break a rule, and this is enough of a paragraph.\n";
    violations(file, &format!("{doc}{code}")).into_iter().map(|v| v.path).collect()
}

#[test]
fn a_planted_edge_against_the_order_is_found() {
    assert_eq!(planted("sky/angle.rs", "use crate::solve::Outcome;"), ["crate::solve::Outcome"]);
    assert_eq!(planted("sky/angle.rs", "use crate::{sky::Vec3, wire::{Hello, Frame}};").len(), 2);
    assert_eq!(planted("sky/mod.rs", "fn f() { super::cli::main(); }"), ["crate::cli::main"]);
    assert_eq!(planted("solve/fit/step.rs", "use super::super::super::service::start;"), ["crate::service::start"]);
    assert_eq!(planted("image/fits.rs", "pub(in crate::camera) fn f() {}"), ["crate::camera"]);
    assert!(planted("solve/fit.rs", "use crate::sky::Vec3; use super::Outcome; use image::Luma;").is_empty());
    assert_eq!(planted("helpers/mod.rs", ""), ["helpers"]);
}

#[test]
fn a_planted_clock_file_socket_thread_or_runtime_in_the_core_is_found() {
    for code in [
        "use std::time::{Duration, Instant};",
        "use std::time; fn f() { time::Instant::now(); }",
        "fn f() { let t = std::time::SystemTime::now(); }",
        "use std::{fs, io::Read};",
        "use std::fs::File;",
        "use std::net::TcpStream;",
        "fn f() { std::thread::sleep(d); }",
        "use tokio::sync::mpsc;",
        "fn f() { println!(\"{}\", 1); }",
        "use rand::rng;",
    ] {
        assert!(!planted("solve/fit.rs", code).is_empty(), "{code}");
        assert!(planted("camera/directory.rs", code).is_empty(), "{code}");
    }
    assert!(planted("solve/fit.rs", "use std::time::Duration; use std::io::Read; let profile = x.instant;").is_empty());
}

#[test]
fn comments_strings_and_tests_break_nothing() {
    for code in [
        "// use std::fs;\n/* use tokio; /* nested */ std::net */\n/// See `std::fs`.\nfn f() {}",
        "fn f() -> &'static str { \"std::fs::read \\\" tokio::spawn\" }",
        "fn f() -> &'static str { r#\"std::fs \" tokio\"# }",
        "fn f<'a>(c: char, s: &'a str) -> bool { c == '\"' || c == '\\'' }",
        "#[cfg(test)]\nmod tests {\n    use std::fs;\n    fn f() { if true { tokio::run() } }\n}",
        "#[cfg(test)]\nuse std::fs;",
    ] {
        assert!(planted("solve/fit.rs", code).is_empty(), "{code}");
    }
    let after = "#[cfg(test)]\nmod tests { fn f() {} }\nuse std::fs;";
    assert_eq!(planted("solve/fit.rs", after), ["std::fs"]);
}

#[test]
fn long_files_missing_docs_and_names_refused_everywhere_are_found() {
    let lines = "fn f() {}\n".repeat(MAX_CODE_LINES + 1);
    assert_eq!(planted("solve/fit.rs", &lines), [""]);
    assert!(planted("solve/fit.rs", &format!("#[cfg(test)]\nmod tests {{\n{lines}}}")).is_empty());
    assert!(planted("solve/fit.rs", &"// a comment\n\n".repeat(MAX_CODE_LINES)).is_empty());
    assert_eq!(violations("solve/fit.rs", "use crate::sky::Vec3;").len(), 1);
    assert_eq!(violations("solve/mod.rs", "//! Solves.").len(), 1);
    assert_eq!(planted("service/hub.rs", "let (a, b) = mpsc::unbounded_channel();").len(), 1);
    assert_eq!(planted("solve/fit.rs", "v.sort_by(|a, b| a.partial_cmp(b).unwrap());"), ["partial_cmp"]);
}
