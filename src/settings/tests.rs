//! Tests of the room as a whole: schema, flight file and ranges agree; layers; every kind of mistake; hostile text.

use super::ranges::{PER_CAMERA, RULES};
use super::*;
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

fn custom(text: &str) -> Result<Loaded, SettingsError> {
    Layers::embedded().custom("custom.toml", text).load()
}

fn set(assignment: &str) -> Result<Loaded, SettingsError> {
    Layers::embedded().set(assignment).load()
}

fn setting<'a>(loaded: &'a Loaded, key: &str) -> &'a Setting {
    loaded.all.iter().find(|setting| setting.key == key).unwrap()
}

fn leaves(prefix: &str, value: &serde_json::Value, keys: &mut BTreeSet<String>) {
    match value {
        serde_json::Value::Object(below) => {
            for (name, value) in below {
                leaves(&if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") }, value, keys);
            }
        }
        _ => {
            keys.insert(prefix.to_owned());
        }
    }
}

/// The comment lines right above every key of the flight file.
fn comments() -> BTreeMap<String, String> {
    let (mut section, mut comment, mut found) = (String::new(), String::new(), BTreeMap::new());
    for line in FLIGHT_TOML.lines() {
        if let Some(words) = line.strip_prefix("# ") {
            comment += words;
            comment.push(' ');
        } else if let Some(name) = line.strip_prefix('[') {
            section = name.trim_end_matches(']').to_owned();
            comment.clear();
        } else if let Some((key, _)) = line.split_once(" = ") {
            found.insert(format!("{section}.{key}"), std::mem::take(&mut comment));
        }
    }
    found
}

#[test]
fn flight_file_schema_and_ranges_have_the_same_keys_in_the_same_order() {
    let rules: Vec<_> = RULES.iter().map(|rule| rule.key.to_owned()).collect();
    let file: Vec<_> = text::read(FLIGHT_TOML).unwrap().into_iter().map(|given| given.key).collect();
    assert_eq!(file, rules);

    let mut schema = BTreeSet::new();
    leaves("", &serde_json::to_value(Settings::flight().unwrap()).unwrap(), &mut schema);
    assert_eq!(schema, rules.into_iter().collect());
    assert!(PER_CAMERA.iter().all(|key| schema.contains(*key)));
}

#[test]
fn every_comment_of_the_flight_file_gives_unit_and_range_as_they_are_checked() {
    let comments = comments();
    assert_eq!(comments.len(), RULES.len());
    for rule in RULES {
        let comment = comments.get(rule.key).unwrap_or_else(|| panic!("{} has no comment", rule.key)).trim();
        let (words, range) = comment.rsplit_once(" [").unwrap_or_else(|| panic!("{}: no range in '{comment}'", rule.key));
        let range = range.trim_end_matches(']');
        let stated = range.split(';').next().unwrap();
        assert_eq!(stated, rule.range(), "{}", rule.key);
        assert!(words.to_lowercase().contains(&rule.unit.to_lowercase()), "{}: '{words}' lacks unit '{}'", rule.key, rule.unit);
        assert_eq!(comment.contains("Per camera."), PER_CAMERA.contains(&rule.key), "{}", rule.key);
    }
}

#[test]
fn the_settings_that_scripts_rely_on_are_there_with_the_values_that_they_name() {
    let shipped = Layers::embedded().load().unwrap();
    let value = |key: &str| setting(&shipped, key).value.to_string();
    assert_eq!(value("network.listen"), "\"127.0.0.1:2017\"");
    assert_eq!(value("display.listen"), "\"127.0.0.1:8080\"");
    for key in [
        "camera.directory",
        "camera.period_s",
        "camera.width_px",
        "camera.height_px",
        "camera.mirrored",
        "lens.port",
        "solver.timeout_s",
        "solver.robust",
        "solver.matching.platescale_min_arcsec_px",
        "solver.matching.platescale_max_arcsec_px",
        "solver.matching.min_matched",
        "solver.requirements.elevation.enabled",
        "record.directory",
    ] {
        assert!(!value(key).is_empty(), "{key}");
    }
    for kind in ["directory", "sky", "aravis", "none"] {
        assert!(set(&format!("camera.kind={kind}")).is_ok(), "{kind}");
    }
    for kind in ["serial", "simulated", "none"] {
        assert!(set(&format!("lens.kind={kind}")).is_ok(), "{kind}");
    }
}

#[test]
fn the_flight_values_are_those_of_the_flight_that_are_relied_on() {
    let settings = Settings::flight().unwrap();
    assert_eq!(settings.solver.matching.min_matched, 5);
    assert_eq!(settings.solver.sources.max_sources, 20);
    assert!(settings.solver.robust && settings.solver.mask.fields.is_empty());
    assert!(!settings.solver.requirements.elevation.enabled);
    assert_eq!(settings.camera.kind, CameraKind::Sky);
    assert_eq!(settings.lens.kind, LensKind::Simulated);
    assert_eq!(settings.network.listen, "127.0.0.1:2017");
}

#[test]
fn the_command_line_beats_the_custom_file_which_beats_the_flight_file() {
    let text = "[camera]\nperiod_s = 3\nwidth_px = 800\n";
    let layers = Layers::embedded().custom("custom.toml", text).set("camera.period_s=4").set("camera.period_s=5");
    let loaded = layers.load().unwrap();
    assert_eq!(loaded.settings.camera.period_s, 5.0);
    assert_eq!(loaded.settings.camera.width_px, 800);
    assert_eq!(loaded.settings.camera.height_px, 1024);

    let period = setting(&loaded, "camera.period_s");
    assert_eq!(period.origin.label(), "--set #2");
    assert_eq!(period.custom.as_ref().unwrap().to_string(), "custom.toml:2");
    assert_eq!(period.flight_value.as_float(), Some(20.0));
    assert_eq!(setting(&loaded, "camera.width_px").origin.label(), "custom.toml:3");
    let height = setting(&loaded, "camera.height_px");
    assert_eq!(height.origin.label(), "flight file");
    let line = height.origin.line;
    assert_eq!(FLIGHT_TOML.lines().nth(line - 1), Some("height_px = 1024"));
}

#[test]
fn the_command_line_takes_toml_values_bare_words_and_spans_of_time() {
    let name = |text: &str| set(&format!("camera.name={text}")).unwrap().settings.camera.name;
    assert_eq!(name("x1"), "x1");
    assert_eq!(name("\"x 1\""), "x 1");
    assert_eq!(name("12"), "12");
    assert_eq!(name("true"), "true");
    assert_eq!(name("a=b"), "a=b");
    assert_eq!(set("camera.kind=none").unwrap().settings.camera.kind, CameraKind::None);
    assert_eq!(set("network.listen=[::1]:2017").unwrap().settings.network.listen, "[::1]:2017");
    assert_eq!(set("network.peers=[\"10.0.0.3\"]").unwrap().settings.network.peers, ["10.0.0.3"]);
    assert_eq!(set("solver.mask.fields=[1, 0x80000000, 0]").unwrap().settings.solver.mask.fields, [1, 0x8000_0000, 0]);
    assert_eq!(set("catalog.file=").unwrap().settings.catalog.file, "");
    assert!(!set(" solver.robust = false ").unwrap().settings.solver.robust);
    for (text, seconds) in [("7", 7.0), ("7.5", 7.5), ("250ms", 0.25), ("\"40s\"", 40.0), ("2m", 120.0), ("1_000", 1000.0)] {
        assert_eq!(set(&format!("solver.timeout_s={text}")).unwrap().settings.solver.timeout_s, seconds, "{text}");
    }
}

#[test]
fn every_mistake_in_a_file_is_named_with_file_line_key_and_what_was_expected() {
    let number = "must be a number from 0.001 to 86400 (s)";
    for (text, wanted) in [
        (
            "\n[solver]\nplatescale_arsec = 9.5",
            "custom.toml:3: unknown setting 'solver.platescale_arsec'; did you mean 'solver.matching.platescale_min_arcsec_px'?",
        ),
        ("zebra = 1", "custom.toml:1: unknown setting 'zebra'"),
        ("\"camera.name\" = 'x'", "custom.toml:1: unknown setting '\"camera.name\"'; did you mean 'camera.name'?"),
        ("camera.name.first = 'x'", "custom.toml:1: unknown setting 'camera.name.first'"),
        ("camera = 3", "custom.toml:1: 'camera' is a section, expected a setting in it, such as 'camera.name'"),
        ("[[camera]]\nname = 'x'", "custom.toml:1: 'camera' is a section, expected a setting in it, such as 'camera.name'"),
        ("[camera]\nperiod_s = \"two\"", &format!("custom.toml:2: 'camera.period_s' {number}, not \"two\"")),
        ("[camera]\nperiod_s = true", &format!("custom.toml:2: 'camera.period_s' {number}, not true")),
        ("[camera]\nperiod_s = 2013-01-01", &format!("custom.toml:2: 'camera.period_s' {number}, not 2013-01-01")),
        ("camera.period_s = 0", &format!("custom.toml:1: 'camera.period_s' {number}, not 0")),
        ("camera.period_s = nan", &format!("custom.toml:1: 'camera.period_s' {number}, not nan")),
        ("camera.period_s = -inf", &format!("custom.toml:1: 'camera.period_s' {number}, not -inf")),
        ("camera.period_s = 1e999", &format!("custom.toml:1: 'camera.period_s' {number}, not 1e999")),
        ("camera.width_px = 800.0", "custom.toml:1: 'camera.width_px' must be a whole number from 64 to 16384 (px), not 800.0"),
        (
            "camera.width_px = 99999999999999999999",
            "custom.toml:1: 'camera.width_px' must be a whole number from 64 to 16384 (px), not 99999999999999999999",
        ),
        (
            "camera.kind = 'skyy'",
            "custom.toml:1: 'camera.kind' must be one of \"directory\", \"sky\", \"aravis\", \"none\", not 'skyy'",
        ),
        ("camera.mirrored = 1", "custom.toml:1: 'camera.mirrored' must be true or false, not 1"),
        ("camera.name = ''", "custom.toml:1: 'camera.name' must be text of 1 to 16 printable ASCII characters, not ''"),
        (
            "camera.name = 'seventeen letters'",
            "custom.toml:1: 'camera.name' must be text of 1 to 16 printable ASCII characters, not 'seventeen letters'",
        ),
        ("camera.name = 'é'", "custom.toml:1: 'camera.name' must be text of 1 to 16 printable ASCII characters, not 'é'"),
        (
            "housekeeping.pressure.source = 'file:p'",
            "custom.toml:1: 'housekeeping.pressure.source' must be text, a sensor such as \"file:/path *0.001 +2\", \"command:/path\", \"simulated\", \"auto\" or \"\", not 'file:p'",
        ),
        ("lens.port = ''", "custom.toml:1: 'lens.port' must be text, a path of at most 4096 bytes, not ''"),
        (
            "network.listen = 'localhost'",
            "custom.toml:1: 'network.listen' must be text, an IP address and port such as \"10.0.0.2:2017\" or \"[::1]:2017\", not 'localhost'",
        ),
        (
            "network.peers = ['10.0.0']",
            "custom.toml:1: 'network.peers' must be a list of IP addresses, at most 64, such as [\"10.0.0.3\"], not ['10.0.0']",
        ),
        (
            "solver.mask.fields = [-1]",
            "custom.toml:1: 'solver.mask.fields' must be a list of words of 32 bits, at most 4096, such as [1, 0x1000], not [-1]",
        ),
        ("[camera]\nname = 'x'\nname = 'y'", "custom.toml:3: duplicate key 'name' in 'name = 'y''"),
        ("[camera]\n[camera]", "custom.toml:2: duplicate key 'camera' in '[camera]'"),
        ("[camera\nname = 1", "custom.toml:1: not TOML: unclosed table, expected `]` in '[camera'"),
        ("a = 1\nb = x", "custom.toml:2: not TOML: string values must be quoted, expected literal string in 'b = x'"),
    ] {
        assert_eq!(custom(text).unwrap_err().to_string(), wanted);
    }
}

#[test]
fn a_flight_file_that_lacks_a_setting_is_refused_by_its_name() {
    let text = FLIGHT_TOML.replace("mirrored = false\n", "");
    let error = Layers::flight("my.toml", text).load().unwrap_err();
    assert_eq!(error.to_string(), "my.toml: missing setting 'camera.mirrored', expected true or false");
    assert!(Layers::flight("my.toml", "").load().unwrap_err().to_string().starts_with("my.toml: missing setting 'camera.name'"));
}

#[test]
fn a_wrong_assignment_on_the_command_line_is_named_by_its_place_in_the_call() {
    let layers = Layers::embedded().set("camera.name=x");
    for (assignment, wanted) in [
        ("camera.name", "--set #2: 'camera.name' is not of the form dotted.key=value, such as camera.period_s=5"),
        ("=1", "--set #2: unknown setting ''"),
        ("camera=1", "--set #2: 'camera' is a section, expected a setting in it, such as 'camera.name'"),
        ("camera.nme=1", "--set #2: unknown setting 'camera.nme'; did you mean 'camera.name'?"),
        ("camera.period_s=", "--set #2: 'camera.period_s' must be a number from 0.001 to 86400 (s), not "),
        (
            "camera.period_s=1\ncamera.name='y'",
            "--set #2: 'camera.period_s' must be a number from 0.001 to 86400 (s), not 1 camera.name='y'",
        ),
        ("solver.timeout_s=nan", "--set #2: 'solver.timeout_s' must be a number from 0.001 to 3600 (s), not nan"),
        ("solver.timeout_s=2h", "--set #2: 'solver.timeout_s' must be a number from 0.001 to 3600 (s), not 2h"),
    ] {
        assert_eq!(layers.clone().set(assignment).load().unwrap_err().to_string(), wanted);
    }
}

#[test]
fn settings_that_contradict_each_other_are_refused_where_the_last_word_was_spoken() {
    for (text, assignment, wanted) in [
        (
            "focus.search_min_counts = 3400",
            "camera.name=x",
            "custom.toml:1: 'focus.search_min_counts' = 3400 must be below 'focus.search_max_counts' = 3300 (flight file)",
        ),
        (
            "\nfocus.search_min_counts = 3200",
            "focus.search_max_counts=3200",
            "--set #1: 'focus.search_max_counts' = 3200 must be above 'focus.search_min_counts' = 3200 (custom.toml:2)",
        ),
        (
            "solver.sources.max_found = 10",
            "camera.name=x",
            "custom.toml:1: 'solver.sources.max_found' = 10 must be at least 'solver.sources.max_sources' = 20 (flight file)",
        ),
        (
            "",
            "network.update_period_s=6s",
            "--set #1: 'network.update_period_s' = 6.0 must be below 'network.silence_s' = 5.0 (flight file)",
        ),
        (
            "[housekeeping.temperature_lens]\nlow_c = 41",
            "camera.name=x",
            "custom.toml:2: 'housekeeping.temperature_lens.low_c' = 41.0 must be below 'housekeeping.temperature_lens.high_c' = 40.0 (flight file)",
        ),
        (
            "camera.height_px = 64",
            "solver.sources.border_px=32",
            "--set #1: 'solver.sources.border_px' = 32 must leave something of a frame of 1536 × 64 px",
        ),
        (
            "solver.mask.fields = [1, 2]",
            "camera.name=x",
            "custom.toml:1: 'solver.mask.fields' must have 3 words for 12 × 8 blocks of 128 px, or none, not 2",
        ),
        (
            "solver.mask.fields = [1, 2, 3]",
            "solver.mask.block_px=64",
            "--set #1: 'solver.mask.fields' must have 12 words for 24 × 16 blocks of 64 px, or none, not 3",
        ),
        (
            "[legacy]\nenabled = true",
            "legacy.peers=[]",
            "--set #1: 'legacy.peers' must name the flight computers where 'legacy.enabled' is true",
        ),
        (
            "legacy.peers = ['10.0.0.3', '::ffff:10.0.0.3']",
            "camera.name=x",
            "custom.toml:1: 'legacy.peers' names 10.0.0.3 and ::ffff:10.0.0.3 twice",
        ),
        (
            "legacy.enabled = true\nrecord.images = false",
            "legacy.images=true",
            "--set #1: 'legacy.images' needs 'legacy.enabled', 'record.enabled' and 'record.images'",
        ),
    ] {
        let error = Layers::embedded().custom("custom.toml", text).set(assignment).load().unwrap_err();
        assert_eq!(error.to_string(), wanted);
    }
}

#[test]
fn a_range_of_roll_may_wrap() {
    let text = "[solver.requirements.horizontal_roll]\nenabled = true\nmin_deg = 170\nmax_deg = -170";
    assert!(custom(text).is_ok());
}

#[test]
fn the_fingerprint_tells_values_apart_and_nothing_else() {
    let flight = Settings::flight().unwrap().fingerprint();
    assert_eq!(custom("# only a comment\ncamera.period_s = 20").unwrap().settings.fingerprint(), flight);
    assert_ne!(set("camera.period_s=20.000000001").unwrap().settings.fingerprint(), flight);
    assert_ne!(set("camera.name=other").unwrap().settings.fingerprint(), flight);
}

#[test]
fn the_review_wants_real_hardware_and_the_eight_settings_of_a_camera() {
    let shipped = Layers::embedded().load().unwrap();
    let keys: BTreeSet<_> = review(&shipped).findings.into_iter().map(|one| one.key).collect();
    let mut wanted = BTreeSet::from(["camera.kind", "lens.kind", "network.listen"]);
    wanted.extend(PER_CAMERA);
    assert_eq!(keys, wanted);

    let example = custom(include_str!("../../config/custom.example.toml")).unwrap();
    let ready = review(&example);
    assert_eq!(ready.findings, []);
    let others: Vec<_> = ready.other_overrides.iter().map(|setting| setting.key).collect();
    let wanted = ["camera.kind", "camera.directory", "lens.kind", "lens.port", "network.listen"];
    assert_eq!(others, [&wanted[..], &["housekeeping.temperature_computer.source"]].concat());
}

#[test]
fn the_review_counts_neither_the_command_line_nor_the_flight_file_for_the_settings_of_a_camera() {
    let example = include_str!("../../config/custom.example.toml").replace("name = \"x0\"\n", "");
    let loaded =
        Layers::embedded().custom("custom.toml", example).set("camera.name=x0").set("solver.robust=false").load().unwrap();
    let review = review(&loaded);
    assert_eq!(review.findings.iter().map(|one| one.key).collect::<Vec<_>>(), ["camera.name"]);
    assert!(review.other_overrides.iter().any(|setting| setting.key == "solver.robust"));
}

#[test]
fn the_review_sees_through_every_way_to_write_loopback_or_none() {
    for (assignment, ready) in [
        ("network.listen=127.8.8.8:1", false),
        ("network.listen=[::1]:2017", false),
        ("network.listen=[::ffff:127.0.0.1]:2017", false),
        ("network.listen=0.0.0.0:2017", true),
        ("network.listen=[fd00::2]:2017", true),
        ("legacy.enabled=true", false),
        ("camera.kind=none", false),
        ("camera.kind=aravis", cfg!(feature = "aravis")),
        ("lens.kind=none", false),
        ("housekeeping.pressure.source=simulated", false),
        ("housekeeping.pressure.source=auto", true),
        ("housekeeping.pressure.source=", true),
    ] {
        let example = include_str!("../../config/custom.example.toml");
        let loaded = Layers::embedded().custom("custom.toml", example).set(assignment).load().unwrap();
        assert_eq!(review(&loaded).findings.is_empty(), ready, "{assignment}");
    }
}

/// A flight file with one stretch of it replaced.
fn mutated() -> impl Strategy<Value = String> {
    let scrap = prop_oneof![
        Just(String::new()),
        "[ \\[\\]{}\"'=.,#a-z0-9_\\n\\\\-]{1,12}",
        prop::sample::select(vec![
            "nan",
            "inf",
            "-1",
            "1e999",
            "[",
            "]",
            "\"",
            "'''",
            "=",
            "\n",
            "\0",
            "0x",
            "é",
            "[camera]\n",
            "true"
        ])
        .prop_map(str::to_owned),
        any::<char>().prop_map(String::from),
    ];
    (any::<prop::sample::Index>(), 0usize..40, scrap).prop_map(|(at, length, scrap)| {
        let letters: Vec<char> = FLIGHT_TOML.chars().collect();
        let start = at.index(letters.len());
        let end = (start + length).min(letters.len());
        letters[..start].iter().chain(scrap.chars().collect::<Vec<_>>().iter()).chain(&letters[end..]).collect()
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn a_mutated_flight_file_loads_or_names_the_line_or_the_missing_setting(text in mutated()) {
        match Layers::flight("flight.toml", text.as_str()).load() {
            Ok(loaded) => prop_assert_eq!(loaded.all.len(), RULES.len()),
            Err(error) => match error.problem {
                Problem::Missing { key, .. } => prop_assert!(error.to_string().contains(key)),
                _ => prop_assert!((1..=text.lines().count()).contains(&error.origin.line), "{}", error),
            },
        }
    }

    #[test]
    fn random_text_in_any_layer_never_breaks_the_loader(text in "(?s).{0,200}", assignment in "[a-z_.]{0,20}=?(?s).{0,40}") {
        let _ = Layers::flight("f", text.as_str()).load();
        let _ = custom(&text);
        let loaded = Layers::embedded().custom("c", text).set(assignment).load();
        if let Err(error) = loaded {
            prop_assert!(!error.to_string().contains('\n'), "{error}");
        }
    }

    #[test]
    fn no_value_of_any_setting_gets_past_its_range(at in 0..RULES.len(), value in any::<f64>()) {
        let rule = RULES[at];
        if let Ok(loaded) = set(&format!("{}={value:?}", rule.key).to_lowercase()) {
            let json = serde_json::to_string(&loaded.settings).unwrap();
            prop_assert!(!json.contains("null"), "a number that is not finite got in: {}", json);
        }
    }
}
