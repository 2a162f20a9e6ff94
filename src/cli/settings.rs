//! `stars settings`: what the settings are, where each came from, and whether they may fly.

use super::{ConfigArgs, NEGATIVE, print};
use crate::settings::{Layer, Loaded, Setting, review};
use serde_json::{Value, json};
use std::process::ExitCode;

/// Prints every setting with its value, unit and where it came from.
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  stars settings                                        every setting with its value, unit and origin
  stars settings --custom custom.toml --diff            what custom.toml changes
  stars settings --custom custom.toml --check           may it fly? exit code 1 and a list where not
  stars settings --set solver.timeout_s=5 --json        for programs")]
pub struct Args {
    /// Only the settings that differ in origin from the flight file, with the flight file's value
    #[arg(long, conflicts_with = "check")]
    diff: bool,
    /// Pre-flight review: are camera, lens, address and the per-camera settings set?
    #[arg(long)]
    check: bool,
    /// One JSON object for programs
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Runs the subcommand; `--check` answers negative where something must still be set.
    ///
    /// # Errors
    /// Settings that do not load.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let loaded = self.config.load()?;
        match (self.check, self.json) {
            (true, json) => check(&loaded, json),
            (false, true) => print(&as_json(&loaded, self.diff).to_string()).map(|()| ExitCode::SUCCESS),
            (false, false) => print(&table(&loaded, self.diff)).map(|()| ExitCode::SUCCESS),
        }
    }
}

fn shown(loaded: &Loaded, diff: bool) -> Vec<&Setting> {
    loaded.all.iter().filter(|setting| !diff || setting.is_overridden()).collect()
}

/// One line a setting, and their number at the end.
pub(super) fn table(loaded: &Loaded, diff: bool) -> String {
    let settings = shown(loaded, diff);
    let mut lines = rows(&settings, diff);
    lines.push(count(loaded));
    lines.join("\n")
}

/// Columns: key, value, unit, origin, and with `flight` the flight file's value.
fn rows(settings: &[&Setting], flight: bool) -> Vec<String> {
    let values: Vec<String> = settings.iter().map(|setting| setting.value.to_string()).collect();
    let key_width = settings.iter().map(|setting| setting.key.len()).max().unwrap_or(0);
    let value_width = values.iter().map(|value| value.chars().count()).max().unwrap_or(0).min(40);
    let unit_width = settings.iter().map(|setting| setting.unit.chars().count()).max().unwrap_or(0);
    let row = |(setting, value): (&&Setting, &String)| {
        let was = if flight { format!("  (flight file: {})", setting.flight_value) } else { String::new() };
        let (key, unit, origin) = (setting.key, setting.unit, setting.origin.label());
        format!("{key:key_width$}  {value:value_width$}  {unit:unit_width$}  {origin}{was}")
    };
    settings.iter().zip(&values).map(row).collect()
}

/// Like "87 settings, 3 from custom.toml, 1 from --set".
fn count(loaded: &Loaded) -> String {
    let from = |layer| loaded.all.iter().filter(|setting| setting.origin.layer == layer).count();
    let mut line = format!("{} settings", loaded.all.len());
    if let Some(file) = &loaded.custom_file {
        line += &format!(", {} from {file}", from(Layer::Custom));
    }
    if from(Layer::Calibration) > 0 {
        line += &format!(", {} from a calibration", from(Layer::Calibration));
    }
    match from(Layer::CommandLine) {
        0 => line,
        n => line + &format!(", {n} from --set"),
    }
}

fn as_json(loaded: &Loaded, diff: bool) -> Value {
    let settings: Vec<Value> = shown(loaded, diff).into_iter().map(setting_json).collect();
    let overridden = loaded.all.iter().filter(|setting| setting.is_overridden()).count();
    json!({
        "count": loaded.all.len(),
        "overridden": overridden,
        "fingerprint": format!("{:016x}", loaded.settings.fingerprint()),
        "settings": settings,
    })
}

fn setting_json(setting: &Setting) -> Value {
    json!({
        "key": setting.key,
        "value": setting.value,
        "unit": setting.unit,
        "origin": setting.origin.label(),
        "file": setting.origin.file,
        "line": setting.origin.line,
        "flight_value": setting.flight_value,
        "per_camera": setting.is_per_camera(),
    })
}

/// The pre-flight review: what is missing, the per-camera settings to read over, and whatever else is not the flight file's.
fn check(loaded: &Loaded, json: bool) -> anyhow::Result<ExitCode> {
    let review = review(loaded);
    let ready = review.findings.is_empty();
    let code = if ready { ExitCode::SUCCESS } else { ExitCode::from(NEGATIVE) };
    if json {
        let findings: Vec<Value> = review.findings.iter().map(|one| json!({"key": one.key, "why": one.why})).collect();
        let list = |settings: &[&Setting]| settings.iter().map(|setting| setting_json(setting)).collect::<Vec<_>>();
        let (per_camera, others) = (list(&review.per_camera), list(&review.other_overrides));
        let document = json!({"ready": ready, "findings": findings, "per_camera": per_camera, "other_overrides": others});
        return print(&document.to_string()).map(|()| code);
    }
    let mut lines = vec!["The settings that differ between cameras:".to_owned()];
    lines.extend(indented(rows(&review.per_camera, false)));
    lines.push(match review.other_overrides.len() {
        0 => "Nothing else differs from the flight file.".into(),
        n => format!("Also not the flight file's own ({n}): is each meant for flight?"),
    });
    lines.extend(indented(rows(&review.other_overrides, true)));
    let findings = &review.findings;
    if !ready {
        let width = findings.iter().map(|one| one.key.len()).max().unwrap_or(0);
        lines.push(format!("To be set before flight ({}):", findings.len()));
        lines.extend(indented(findings.iter().map(|one| format!("{:width$}  {}", one.key, one.why)).collect()));
    }
    lines.push(if ready { "READY".into() } else { format!("NOT READY: {} settings to be set", findings.len()) });
    print(&lines.join("\n")).map(|()| code)
}

fn indented(lines: Vec<String>) -> impl Iterator<Item = String> {
    lines.into_iter().map(|line| format!("  {line}"))
}
