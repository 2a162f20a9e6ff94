//! `stars export` as an analyst sees it: the tables have what the records have, under the names that the Python package gives it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing, reason = "this is a test")]

use serde_json::Value;
use stars::catalog::Catalogue;
use stars::image::write_fits;
use stars::simulate::sky::{Kind, RenderSpec, render};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use tempfile::TempDir;

fn stars(arguments: &[&str]) -> Output {
    // Its index is kept with what the build makes, not in the user's home.
    Command::new(env!("CARGO_BIN_EXE_stars")).env("HOME", env!("CARGO_TARGET_TMPDIR")).args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> &str {
    std::str::from_utf8(bytes).unwrap()
}

/// A directory with two records of one solved image and one unsolved each, the last line of the second torn; and the outcomes.
fn records() -> (TempDir, Vec<Value>) {
    let directory = TempDir::new().unwrap();
    let image = |kind: Kind| {
        let path = directory.path().join(format!("{}.fits", kind.name()));
        let rendered = render(&RenderSpec::new(kind, 2_000, 0), &Catalogue::embedded().unwrap()).unwrap();
        write_fits(&rendered.frame, &[], &mut fs::File::create(&path).unwrap()).unwrap();
        path.display().to_string()
    };
    let solved = stars(&["solve", "--json", &image(Kind::Night), &image(Kind::NoStars)]);
    let lines = text(&solved.stdout);
    let outcomes: Vec<Value> = lines.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(outcomes.iter().filter(|outcome| outcome["solved"] == true).count(), 1, "{lines}");
    fs::write(directory.path().join("outcomes-2013-01-01T00-00-00Z-00000001.jsonl"), lines).unwrap();
    let torn = format!("{lines}\n{}", &lines[..lines.find('\n').unwrap() / 2]);
    fs::write(directory.path().join("outcomes-2013-01-02T00-00-00Z-00000002.jsonl"), torn).unwrap();
    fs::write(directory.path().join("other.jsonl"), "no record").unwrap();
    (directory, outcomes)
}

/// Rows of a table by the names of its columns.
fn rows(csv: &[u8]) -> Vec<BTreeMap<String, String>> {
    csv::Reader::from_reader(csv).deserialize().map(Result::unwrap).collect()
}

fn path_of(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn a_row_for_each_image_has_all_that_its_record_has_and_a_torn_line_is_named() {
    let (directory, outcomes) = records();
    let output = stars(&["export", path_of(directory.path())]);
    let complaint = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{complaint}");
    assert!(complaint.contains("00000002.jsonl:4: no outcome") && complaint.lines().count() == 1, "{complaint}");
    let table = rows(&output.stdout);
    assert_eq!(table.len(), 4);
    for (row, outcome) in table.iter().zip(outcomes.iter().chain(&outcomes)) {
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned).replace("null", "");
        for key in ["image", "solved", "reason", "detail", "ra_deg", "sigma_roll_arcsec", "chi2_per_dof", "matched"] {
            assert_eq!(row[key], text(&outcome[key]), "{key}");
        }
        assert_eq!(row["stats_mean"], text(&outcome["stats"]["mean"]));
        assert_eq!(row["stats_level_high"], text(&outcome["stats"]["level"][1]));
        assert_eq!(row["time_ms_total"], text(&outcome["time_ms"]["total"]));
        assert_eq!(row["covariance_arcsec2_east_roll"], text(&outcome["covariance_arcsec2"][0][2]));
        assert_eq!(row["triangles"], outcome["triangles"].as_array().unwrap().len().to_string());
    }
    assert!(table[3]["log"].ends_with("00000002.jsonl") && table[3]["line"] == "2", "{:?}", table[3]);
}

#[test]
fn a_row_for_each_source_has_its_image_and_its_star() {
    let (directory, outcomes) = records();
    let (record, out) = (directory.path().join("outcomes-2013-01-01T00-00-00Z-00000001.jsonl"), directory.path().join("out.csv"));
    let output = stars(&["export", "--sources", path_of(&record), "--out", path_of(&out)]);
    assert_eq!((output.status.code(), text(&output.stderr), output.stdout.len()), (Some(0), "", 0));
    let table = rows(&fs::read(&out).unwrap());
    let sources: Vec<(&Value, &Value)> = outcomes
        .iter()
        .flat_map(|outcome| outcome["sources"].as_array().unwrap().iter().map(move |source| (&outcome["image"], source)))
        .collect();
    assert_eq!(table.len(), sources.len());
    for (row, (image, source)) in table.iter().zip(sources) {
        assert_eq!(row["image"], image.as_str().unwrap());
        assert_eq!((&row["x"], &row["snr"]), (&source["x"].to_string(), &source["snr"].to_string()));
    }
}

#[test]
fn the_columns_are_those_of_the_python_package() {
    let (directory, _) = records();
    let python = "import sys; sys.path.insert(0, 'scripts')\n\
        from starslog.tables import frame_types, flat_types\nfrom starslog.outcome import Source\n\
        print(*frame_types()); print(*flat_types(Source))";
    let output = Command::new("python3").current_dir(env!("CARGO_MANIFEST_DIR")).args(["-c", python]).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let known: Vec<Vec<&str>> = text(&output.stdout).lines().map(|line| line.split(' ').collect()).collect();
    for (arguments, known) in [(vec![], &known[0]), (vec!["--sources"], &known[1])] {
        let output = stars(&[&["export", path_of(directory.path())], &arguments[..]].concat());
        let header = text(&output.stdout).lines().next().unwrap();
        let origin = ["log", "line", "captured_utc", "image", "image_counter"];
        let strangers: Vec<&str> =
            header.split(',').filter(|column| !known.contains(column) && !origin.contains(column)).collect();
        assert!(strangers.is_empty() && header.split(',').count() > 5, "{strangers:?} in {header}");
    }
}

#[test]
fn what_is_no_record_is_refused_by_its_name() {
    let directory = TempDir::new().unwrap();
    let record = directory.path().join("outcomes-2013-01-01T00-00-00Z-00000001.jsonl");
    fs::write(&record, "{}\n").unwrap();
    let output = stars(&["export", path_of(directory.path()), "--out", path_of(&record)]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("is one of the records"), "{}", text(&output.stderr));
    assert_eq!(fs::read(&record).unwrap(), b"{}\n");
    fs::remove_file(&record).unwrap();
    for (path, wanted) in
        [(directory.path().to_owned(), "has no record"), (directory.path().join("gone.jsonl"), "cannot be opened")]
    {
        let output = stars(&["export", path_of(&path)]);
        let complaint = text(&output.stderr);
        assert_eq!((output.status.code(), output.stdout.len()), (Some(2), 0), "{complaint}");
        assert!(complaint.contains(wanted) && complaint.contains(path_of(&path)), "{complaint}");
    }
}
