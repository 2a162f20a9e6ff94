//! `stars settings` and the settings options, by running the program: what it prints, where values come from, what it refuses.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

/// What a run of the program gave.
struct Answer {
    code: i32,
    out: String,
    err: String,
}

/// Runs `stars settings` in a directory.
fn settings_in(dir: &Path, args: &[&str]) -> Answer {
    stars_in(dir, &[&["settings"], args].concat())
}

fn stars_in(dir: &Path, args: &[&str]) -> Answer {
    let run = Command::new(env!("CARGO_BIN_EXE_stars")).args(args).current_dir(dir).stdin(Stdio::null()).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    Answer { code: run.status.code().unwrap(), out: text(run.stdout), err: text(run.stderr) }
}

/// A directory with a `custom.toml`.
fn with_custom(text: impl AsRef<[u8]>) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("custom.toml"), text).unwrap();
    dir
}

/// The line of a setting, its columns squeezed.
fn line_of(answer: &Answer, key: &str) -> String {
    let line = answer.out.lines().find(|line| line.trim_start().starts_with(&format!("{key} ")));
    line.unwrap_or_else(|| panic!("no {key} in {}", answer.out)).split_whitespace().collect::<Vec<_>>().join(" ")
}

fn refused(answer: &Answer, wanted: &str) {
    assert_eq!((answer.code, answer.out.as_str()), (2, ""), "{}", answer.err);
    assert_eq!(answer.err, format!("stars: {wanted}\n"));
}

/// The beginning alone, where the rest is the system's own words.
fn refused_with(answer: &Answer, beginning: &str) {
    assert_eq!((answer.code, answer.err.lines().count()), (2, 1), "{}", answer.err);
    assert!(answer.err.starts_with(&format!("stars: {beginning}")), "{}", answer.err);
}

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(name)
}

#[test]
fn every_setting_is_printed_with_value_unit_and_origin_and_their_number_ends_the_list() {
    let dir = with_custom("[camera]\nname = \"x0\"\n\n[solver]\ntimeout_s = \"7s\"\n");
    let shipped = settings_in(dir.path(), &[]);
    assert_eq!((shipped.code, shipped.err.as_str()), (0, ""));
    let number = shipped.out.lines().count() - 1;
    assert_eq!(shipped.out.lines().last().unwrap(), format!("{number} settings"));
    assert_eq!(line_of(&shipped, "solver.timeout_s"), "solver.timeout_s 20.0 s flight file");

    let changed = settings_in(dir.path(), &["--custom", "custom.toml", "--set", "camera.period_s=5", "--set", "lens.kind=none"]);
    assert_eq!(line_of(&changed, "camera.name"), "camera.name \"x0\" custom.toml:2");
    assert_eq!(line_of(&changed, "solver.timeout_s"), "solver.timeout_s 7.0 s custom.toml:5");
    assert_eq!(line_of(&changed, "camera.period_s"), "camera.period_s 5.0 s --set #1");
    assert_eq!(line_of(&changed, "lens.kind"), "lens.kind \"none\" --set #2");
    assert_eq!(changed.out.lines().last().unwrap(), format!("{number} settings, 2 from custom.toml, 2 from --set"));
}

#[test]
fn diff_prints_the_overrides_alone_beside_the_value_of_the_flight_file() {
    let dir = with_custom("camera.name = 'x0'");
    let answer = settings_in(dir.path(), &["--custom", "custom.toml", "--set", "camera.period_s=5", "--diff"]);
    assert_eq!(answer.out.lines().count(), 3);
    assert_eq!(line_of(&answer, "camera.name"), "camera.name \"x0\" custom.toml:1 (flight file: \"stars\")");
    assert_eq!(line_of(&answer, "camera.period_s"), "camera.period_s 5.0 s --set #1 (flight file: 20.0)");
}

#[test]
fn the_command_line_beats_the_custom_file_which_beats_the_flight_file() {
    let dir = with_custom("camera.period_s = 3\ncamera.width_px = 800");
    let flight = fs::read_to_string(shipped("flight.toml")).unwrap().replace("height_px = 1024", "height_px = 600");
    fs::write(dir.path().join("my.toml"), flight).unwrap();
    let args = ["--config", "my.toml", "--custom", "custom.toml", "--set", "camera.period_s=4"];
    let answer = settings_in(dir.path(), &args);
    assert_eq!(line_of(&answer, "camera.period_s"), "camera.period_s 4.0 s --set #1");
    assert_eq!(line_of(&answer, "camera.width_px"), "camera.width_px 800 px custom.toml:2");
    assert_eq!(line_of(&answer, "camera.height_px"), "camera.height_px 600 px flight file");
}

#[test]
fn json_has_every_setting_with_type_unit_and_origin() {
    let dir = with_custom("camera.name = 'x0'");
    let answer = settings_in(dir.path(), &["--custom", "custom.toml", "--json"]);
    assert_eq!(answer.out.lines().count(), 1);
    let json: serde_json::Value = serde_json::from_str(&answer.out).unwrap();
    let settings = json["settings"].as_array().unwrap();
    assert_eq!((json["count"].as_u64().unwrap(), json["overridden"].as_u64().unwrap()), (settings.len() as u64, 1));
    let one = |key: &str| settings.iter().find(|setting| setting["key"] == key).unwrap();
    assert_eq!((&one("camera.name")["value"], &one("camera.name")["origin"]), (&"x0".into(), &"custom.toml:1".into()));
    assert_eq!((&one("solver.timeout_s")["value"], &one("solver.timeout_s")["unit"]), (&20.0.into(), &"s".into()));
    assert_eq!(one("camera.name")["per_camera"], true);

    let fingerprint = |args: &[&str]| {
        let answer = settings_in(dir.path(), &[args, &["--json"]].concat());
        serde_json::from_str::<serde_json::Value>(&answer.out).unwrap()["fingerprint"].as_str().unwrap().to_owned()
    };
    assert_eq!(fingerprint(&["--set", "camera.name=x0"]), json["fingerprint"].as_str().unwrap());
    assert_ne!(fingerprint(&[]), json["fingerprint"].as_str().unwrap());
}

#[test]
fn the_built_in_flight_file_is_the_shipped_one() {
    let dir = tempfile::tempdir().unwrap();
    let path = shipped("flight.toml");
    assert_eq!(settings_in(dir.path(), &["--config", path.to_str().unwrap()]).out, settings_in(dir.path(), &[]).out);
}

#[test]
fn the_review_fails_on_the_shipped_settings_and_lists_all_that_is_missing() {
    let answer = settings_in(&shipped(""), &["--check"]);
    assert_eq!((answer.code, answer.err.as_str()), (1, ""));
    let todo = answer.out.split("To be set before flight (11):").nth(1).unwrap();
    for key in [
        "camera.kind",
        "lens.kind",
        "network.listen",
        "camera.name",
        "focus.search_min_counts",
        "focus.search_max_counts",
        "solver.matching.platescale_min_arcsec_px",
        "solver.matching.platescale_max_arcsec_px",
        "solver.requirements.horizontal_roll.enabled",
        "solver.requirements.horizontal_roll.min_deg",
        "solver.requirements.horizontal_roll.max_deg",
    ] {
        assert!(todo.contains(key), "{key} is not in: {todo}");
    }
    assert_eq!(answer.out.lines().last().unwrap(), "NOT READY: 11 settings to be set");
}

#[test]
fn the_review_passes_the_example_and_lists_whatever_else_it_changes() {
    let mut text = fs::read_to_string(shipped("custom.example.toml")).unwrap();
    text += "\n[solver]\ntimeout_s = 5\n";
    let dir = with_custom(text);
    let answer = settings_in(dir.path(), &["--custom", "custom.toml", "--check", "--set", "record.queue_frames=3"]);
    assert_eq!((answer.code, answer.err.as_str()), (0, ""), "{}", answer.out);
    assert_eq!(answer.out.lines().last().unwrap(), "READY");
    let others = answer.out.split("flight file's own (8)").nth(1).unwrap();
    for key in
        ["camera.kind", "camera.directory", "lens.kind", "lens.port", "network.listen", "solver.timeout_s", "record.queue_frames"]
    {
        assert!(others.contains(key), "{key} is not in: {others}");
    }
}

#[test]
fn the_review_does_not_take_the_settings_of_a_camera_from_the_command_line() {
    let text = fs::read_to_string(shipped("custom.example.toml")).unwrap().replace("name = \"x0\"\n", "");
    let dir = with_custom(text);
    let answer = settings_in(dir.path(), &["--custom", "custom.toml", "--set", "camera.name=x0", "--check", "--json"]);
    assert_eq!(answer.code, 1);
    let json: serde_json::Value = serde_json::from_str(&answer.out).unwrap();
    assert_eq!(json["ready"], false);
    assert_eq!(json["findings"].as_array().unwrap().len(), 1);
    assert_eq!(json["findings"][0]["key"], "camera.name");
}

#[test]
fn a_mistake_ends_the_program_with_one_line_that_names_file_line_key_and_what_was_expected() {
    for (text, wanted) in [
        (
            "[solver]\nrobust = false\nplatescale_arsec = 9.5\n",
            "custom.toml:3: unknown setting 'solver.platescale_arsec'; did you mean 'solver.matching.platescale_min_arcsec_px'?",
        ),
        (
            "[camera]\n\nperiod_s = \"two\"",
            "custom.toml:3: 'camera.period_s' must be a number from 0.001 to 86400 (s), not \"two\"",
        ),
        ("camera.period_s = 1e9", "custom.toml:1: 'camera.period_s' must be a number from 0.001 to 86400 (s), not 1e9"),
        ("\ncamera.period_s = nan", "custom.toml:2: 'camera.period_s' must be a number from 0.001 to 86400 (s), not nan"),
        ("[camera]\nname = 'x'\nname = 'y'", "custom.toml:3: duplicate key 'name' in 'name = 'y''"),
        ("[camera]\nname = ", "custom.toml:2: not TOML: string values must be quoted, expected literal string in 'name ='"),
        (
            "focus.search_min_counts = 5000",
            "custom.toml:1: 'focus.search_min_counts' = 5000 must be below 'focus.search_max_counts' = 3300 (flight file)",
        ),
    ] {
        let dir = with_custom(text);
        refused(&settings_in(dir.path(), &["--custom", "custom.toml"]), wanted);
        refused(&settings_in(dir.path(), &["--custom", "custom.toml", "--check"]), wanted);
    }
    let dir = with_custom("camera.name = 'x'");
    refused(
        &settings_in(dir.path(), &["--config", "custom.toml"]),
        "custom.toml: missing setting 'camera.kind', expected one of \"directory\", \"sky\", \"aravis\", \"none\"",
    );
    refused(
        &settings_in(dir.path(), &["--set", "camera.name=y", "--set", "camera.nam=y"]),
        "--set #2: unknown setting 'camera.nam'; did you mean 'camera.name'?",
    );
}

#[test]
fn what_is_no_settings_file_is_refused_by_its_name() {
    let dir = with_custom(b"camera.name = 'x'\n\xff\xfe");
    let expected = "expected a settings file in TOML";
    refused(&settings_in(dir.path(), &["--custom", "custom.toml"]), &format!("custom.toml:2: is not UTF-8 text, {expected}"));
    refused(&settings_in(dir.path(), &["--custom", "."]), &format!(".: is a directory, {expected}"));
    refused_with(
        &settings_in(dir.path(), &["--config", "none.toml"]),
        &format!("none.toml: cannot be opened, {expected}: No such"),
    );
    refused_with(&settings_in(dir.path(), &["--config", ""]), "");

    let large = fs::File::create(dir.path().join("large")).unwrap();
    large.set_len(100 << 20).unwrap();
    refused(&settings_in(dir.path(), &["--custom", "large"]), &format!("large: is longer than 262144 bytes, {expected}"));
    #[cfg(target_os = "linux")]
    refused(&settings_in(dir.path(), &["--custom", "/dev/zero"]), &format!("/dev/zero: is longer than 262144 bytes, {expected}"));
}

#[cfg(target_os = "linux")]
#[test]
fn a_file_that_cannot_be_read_is_refused_by_its_name() {
    // Opens, and then fails to read even for the superuser, whom no permission stops.
    let answer = settings_in(Path::new("/"), &["--custom", "/proc/self/mem"]);
    refused_with(&answer, "/proc/self/mem: cannot be read, expected a settings file in TOML: ");
}

#[test]
fn a_wrong_call_ends_with_one_line_and_exit_code_2() {
    let dir = tempfile::tempdir().unwrap();
    for (args, beginning) in [
        (vec![], "no subcommand, expected one of: "),
        (vec!["setings"], "unrecognized subcommand 'setings'"),
        (vec!["settings", "--frob"], "unexpected argument '--frob' found"),
        (vec!["settings", "--set"], "a value is required for '--set <KEY=VALUE>'"),
        (vec!["settings", "--set", "camera.name"], "--set #1: 'camera.name' is not of the form dotted.key=value"),
        (vec!["settings", "--diff", "--check"], "the argument '--diff' cannot be used with '--check'"),
    ] {
        refused_with(&stars_in(dir.path(), &args), beginning);
    }
}

#[test]
fn help_shows_an_example_and_is_no_mistake() {
    let dir = tempfile::tempdir().unwrap();
    let help = settings_in(dir.path(), &["--help"]);
    assert_eq!((help.code, help.err.as_str()), (0, ""));
    assert!(help.out.contains("stars settings --custom custom.toml --check"));
    assert_eq!(stars_in(dir.path(), &["--help"]).code, 0);
    assert_eq!(stars_in(dir.path(), &["--version"]).out, format!("stars {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn a_reader_that_has_seen_enough_is_no_mistake() {
    let mut child =
        Command::new(env!("CARGO_BIN_EXE_stars")).arg("settings").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    let run = child.wait_with_output().unwrap();
    assert_eq!((run.status.code(), String::from_utf8(run.stderr).unwrap()), (Some(0), String::new()));
}
