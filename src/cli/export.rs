//! `stars export`: the service's records as CSV, a row for each image or for each source.
//!
//! The columns have the names that the Python package gives them. A flight's records do not fit into a small computer's memory: they are
//! read twice, once for the columns and once for the rows.

use super::NEGATIVE;
use anyhow::{Context, bail};
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// What the names of records begin and end with; those begun before the clock was set come last.
const PREFIX: &str = "outcomes-";
const SUFFIX: &str = ".jsonl";
const UNSET: &str = "outcomes-unset-";
/// Longest line that is read, bytes: hundreds of times that of an image with all its sources.
const LONGEST_LINE: u64 = 64 << 20;
/// Columns that come first, where they are there; the others follow in the order of their names.
const FIRST: [&str; 12] =
    ["captured_utc", "image", "image_counter", "x", "y", "solved", "reason", "cause", "ra_deg", "dec_deg", "roll_deg", "detail"];
/// What has columns for its parts, and may be null as a whole: then nothing is known of any of them.
const PARTED: [&str; 8] =
    ["candidate", "covariance_arcsec2", "observer", "prior_attitude", "prior_observer", "series_start", "star", "stats_level"];
/// Axes of the covariance.
const AXES: [&str; 3] = ["east", "north", "roll"];

/// Writes the outcomes that the service recorded as CSV, a row for each image
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars export record > images.csv                    every record of a directory
  stars export record --sources --out sources.csv     a row for each source of each image
Columns have the names of the Python package's tables, and what is not known is empty. A line that cannot be read (a power
cut tears the last one) is named on stderr and left out.
Exits 0 if every line was written, 1 if one could not be read, 2 if the call or a file is wrong.")]
pub struct Args {
    /// Records (outcomes-*.jsonl), or directories of them
    #[arg(value_name = "PATH", required = true)]
    paths: Vec<PathBuf>,
    /// A row for each source instead
    #[arg(long)]
    sources: bool,
    /// Write into this file instead of stdout
    #[arg(long, value_name = "OUT")]
    out: Option<PathBuf>,
}

/// Names of columns and what is in them.
type Row = BTreeMap<String, Value>;

impl Args {
    /// Writes the table.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let files = files_of(&self.paths)?;
        if let Some(out) = &self.out
            && let Ok(there) = fs::canonicalize(out)
            && files.iter().any(|file| fs::canonicalize(file).is_ok_and(|file| file == there))
        {
            bail!("--out {} is one of the records, expected another file", out.display());
        }
        let mut columns = BTreeSet::new();
        let rows = if self.sources { source_rows } else { image_rows };
        each_line(&files, |outcome| columns.extend(rows(outcome).into_iter().flat_map(Row::into_keys)), |_| {})?;
        let (columns, name) = (sorted(&columns), self.out.as_ref().map_or("stdout".into(), |path| path.display().to_string()));
        let out: Box<dyn Write> = match &self.out {
            Some(path) => Box::new(File::create(path).with_context(|| format!("{name} cannot be written"))?),
            None => Box::new(io::stdout().lock()),
        };
        let mut table = csv::Writer::from_writer(out);
        let mut written = table.write_record(&columns);
        let mut damaged = 0usize;
        let write_rows = |outcome: &Line<'_>| {
            for row in rows(outcome) {
                if written.is_ok() {
                    written = table.write_record(columns.iter().map(|column| text_of(row.get(column))));
                }
            }
        };
        each_line(&files, write_rows, |complaint| {
            damaged += 1;
            // Nobody is left to tell where even stderr is closed.
            let _ = writeln!(io::stderr(), "stars: {complaint}");
        })?;
        let written = written.map_err(io::Error::from).and_then(|()| table.flush());
        match written {
            // A reader that has seen enough.
            Err(error) if error.kind() != io::ErrorKind::BrokenPipe => Err(error).context(format!("{name} cannot be written")),
            _ => Ok(if damaged > 0 { ExitCode::from(NEGATIVE) } else { ExitCode::SUCCESS }),
        }
    }
}

/// The records named, and those of the directories named.
fn files_of(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() { files.extend(records_in(path)?) } else { files.push(path.clone()) }
    }
    Ok(files)
}

/// The records of a directory, in the order of the times in their names.
///
/// # Errors
/// Where the directory cannot be read, or has none.
pub(super) fn records_in(directory: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let listed = fs::read_dir(directory).with_context(|| format!("{} cannot be read", directory.display()))?;
    let names = listed.filter_map(Result::ok).map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX)).collect();
    if names.is_empty() {
        bail!("{} has no record, expected {PREFIX}*{SUFFIX}", directory.display());
    }
    names.sort_by_key(|name| (name.starts_with(UNSET), name.clone()));
    Ok(names.iter().map(|name| directory.join(name)).collect())
}

/// An outcome, and where it stands.
pub(super) struct Line<'a> {
    file: &'a Path,
    /// From 1.
    number: usize,
    /// It.
    pub(super) outcome: Map<String, Value>,
}

/// Gives every outcome to one and a complaint about every line that holds none to the other; a line without anything in it is passed over.
///
/// # Errors
/// Where a file cannot be read, or is no record.
pub(super) fn each_line(
    files: &[PathBuf],
    mut take: impl FnMut(&Line<'_>),
    mut complain: impl FnMut(String),
) -> anyhow::Result<()> {
    for file in files {
        let name = file.display();
        let mut reader = BufReader::new(File::open(file).with_context(|| format!("{name} cannot be opened"))?);
        let mut bytes = Vec::new();
        for number in 1.. {
            bytes.clear();
            let length = (&mut reader).take(LONGEST_LINE).read_until(b'\n', &mut bytes).with_context(|| format!("{name}"))?;
            if length == 0 {
                break;
            }
            if length as u64 == LONGEST_LINE && bytes.last() != Some(&b'\n') {
                bail!("{name}:{number}: longer than {LONGEST_LINE} bytes: this is no record");
            }
            if bytes.trim_ascii().is_empty() {
                continue;
            }
            match serde_json::from_slice(&bytes) {
                Ok(outcome) => take(&Line { file, number, outcome }),
                Err(error) => complain(format!("{name}:{number}: no outcome: {error}")),
            }
        }
    }
    Ok(())
}

/// The one row of an image.
fn image_rows(line: &Line<'_>) -> Vec<Row> {
    let mut row = Row::new();
    for (key, value) in &line.outcome {
        match (key.as_str(), value) {
            ("sources", _) => {}
            ("triangles", Value::Array(all)) => add(&mut row, key, &all.len().into()),
            ("corrections", Value::Array(all)) => {
                let names: Vec<&str> = all.iter().filter_map(Value::as_str).collect();
                add(&mut row, key, &names.join(" ").into());
            }
            _ => add(&mut row, key, value),
        }
    }
    vec![with_origin(row, line)]
}

/// A row for each source of an image.
fn source_rows(line: &Line<'_>) -> Vec<Row> {
    let sources = line.outcome.get("sources").and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
    let row_of = |source: &Value| {
        let mut row = Row::new();
        for (key, value) in source.as_object().into_iter().flatten() {
            add(&mut row, key, value);
        }
        for key in ["captured_utc", "image", "image_counter"] {
            row.insert(key.into(), line.outcome.get(key).cloned().unwrap_or_default());
        }
        with_origin(row, line)
    };
    sources.iter().map(row_of).collect()
}

fn with_origin(mut row: Row, line: &Line<'_>) -> Row {
    row.insert("log".into(), line.file.display().to_string().into());
    row.insert("line".into(), line.number.into());
    row
}

/// Adds a value: an object's fields with its name in front, the parts of the covariance and of a level by theirs, other lists as JSON.
fn add(row: &mut Row, key: &str, value: &Value) {
    match value {
        Value::Object(fields) => fields.iter().for_each(|(field, value)| add(row, &format!("{key}_{field}"), value)),
        Value::Array(rows) if key == "covariance_arcsec2" => {
            for (i, one) in AXES.iter().enumerate() {
                for (j, other) in AXES.iter().enumerate().skip(i) {
                    let part = rows.get(i).and_then(|row| row.get(j)).cloned().unwrap_or_default();
                    row.insert(format!("{key}_{one}_{other}"), part);
                }
            }
        }
        Value::Array(ends) if key == "stats_level" => {
            for (name, end) in ["low", "high"].iter().zip(ends) {
                row.insert(format!("{key}_{name}"), end.clone());
            }
        }
        Value::Null if PARTED.contains(&key) => {}
        Value::Array(_) => {
            row.insert(key.into(), value.to_string().into());
        }
        _ => {
            row.insert(key.into(), value.clone());
        }
    }
}

/// The columns that any row has, in their order.
fn sorted(columns: &BTreeSet<String>) -> Vec<String> {
    let first = FIRST.iter().filter(|name| columns.contains(**name)).map(|name| (*name).to_owned());
    let others = columns.iter().filter(|name| !FIRST.contains(&name.as_str())).cloned();
    first.chain(others).collect()
}

/// A value as it stands in the table.
fn text_of(value: Option<&Value>) -> String {
    match value {
        None | Some(Value::Null) => String::new(),
        Some(Value::String(text)) => text.clone(),
        Some(value) => value.to_string(),
    }
}
