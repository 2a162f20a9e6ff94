//! Layering: flight file < custom file < calibration < command line, and where each value came from.

use super::error::{Layer, Origin, Problem, SettingsError};
use super::near::nearest;
use super::ranges::{PER_CAMERA, RULES, Rule, first_of_section, rule};
use super::relations;
use super::schema::Settings;
use super::text::{quote, read};
use std::sync::OnceLock;
use toml::{Table, Value};

/// The flight file that is built into the program: every setting with its flight value.
pub const FLIGHT_TOML: &str = include_str!("../../config/flight.toml");
/// The name of the built-in flight file in errors.
const FLIGHT_NAME: &str = "config/flight.toml";
/// The "file" of a setting given on the command line.
const SET: &str = "--set";

/// The texts that settings are merged from. Reading files is the caller's: nothing here touches a disk.
#[derive(Debug, Clone)]
pub struct Layers {
    flight: (String, String),
    custom: Option<(String, String)>,
    calibration: Option<(String, String)>,
    set: Vec<String>,
}

/// One setting as merged.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// The dotted key.
    pub key: &'static str,
    /// The unit; empty for none.
    pub unit: &'static str,
    /// The value in force.
    pub value: Value,
    /// Where the value in force stands.
    pub origin: Origin,
    /// The value of the flight file.
    pub flight_value: Value,
    /// Where the custom file sets it, if it does; the command line may still override that.
    pub custom: Option<Origin>,
}

impl Setting {
    /// Whether it is one of the settings that a flight's custom file must set, because cameras differ in them.
    pub fn is_per_camera(&self) -> bool {
        PER_CAMERA.contains(&self.key)
    }

    /// Whether the value in force is not the flight file's own.
    pub fn is_overridden(&self) -> bool {
        self.origin.layer != Layer::Flight
    }
}

/// The merged settings, and where each came from.
#[derive(Debug, Clone, PartialEq)]
pub struct Loaded {
    /// The settings in force.
    pub settings: Settings,
    /// Every setting with its origin, in the order of the flight file.
    pub all: Vec<Setting>,
    /// The name of the custom file, if there is one.
    pub custom_file: Option<String>,
}

impl Layers {
    /// The built-in flight file.
    pub fn embedded() -> Self {
        Self::flight(FLIGHT_NAME, FLIGHT_TOML)
    }

    /// A flight file: its name, for errors, and its text.
    pub fn flight(name: impl Into<String>, text: impl Into<String>) -> Self {
        Self { flight: (name.into(), text.into()), custom: None, calibration: None, set: Vec::new() }
    }

    /// Adds the custom file of one camera: its name, for errors, and its text.
    #[must_use]
    pub fn custom(mut self, name: impl Into<String>, text: impl Into<String>) -> Self {
        self.custom = Some((name.into(), text.into()));
        self
    }

    /// Adds the calibration that is in force: its name, for errors, and its text.
    #[must_use]
    pub fn calibrated(mut self, name: impl Into<String>, text: impl Into<String>) -> Self {
        self.calibration = Some((name.into(), text.into()));
        self
    }

    /// Adds one `dotted.key=value` of the command line; of two for the same key the later counts.
    #[must_use]
    pub fn set(mut self, assignment: impl Into<String>) -> Self {
        self.set.push(assignment.into());
        self
    }

    /// Merges the layers and checks every value.
    ///
    /// # Errors
    /// The first mistake, layer by layer and line by line: TOML syntax, an unknown, missing or duplicate key, a wrong type,
    /// a value out of range (NaN and infinities always are), or settings that contradict each other.
    pub fn load(&self) -> Result<Loaded, SettingsError> {
        let (name, text) = &self.flight;
        let mut all = flight_layer(name, text)?;
        let files = [(Layer::Custom, &self.custom), (Layer::Calibration, &self.calibration)];
        for (layer, (name, text)) in files.into_iter().filter_map(|(layer, file)| Some((layer, file.as_ref()?))) {
            for (rule, value, origin) in read_layer(layer, name, text)? {
                replace(&mut all, rule, value, &origin);
            }
        }
        for (at, assignment) in self.set.iter().enumerate() {
            let origin = Origin { layer: Layer::CommandLine, line: at + 1, file: SET.into() };
            let (rule, value) =
                read_assignment(assignment).map_err(|problem| SettingsError { origin: origin.clone(), problem })?;
            replace(&mut all, rule, value, &origin);
        }
        let settings = typed(&all, name)?;
        relations::check(&settings, &all)?;
        Ok(Loaded { settings, all, custom_file: self.custom.as_ref().map(|(name, _)| name.clone()) })
    }
}

impl Settings {
    /// These settings after assignments `dotted.key=value` of a command; each is checked as those of the command line are.
    ///
    /// # Errors
    /// As [`Layers::load`], with the command as the origin.
    pub fn commanded(&self, assignments: &[String]) -> Result<Self, SettingsError> {
        // It is the same each time, and most of the work.
        static BUILT_IN: OnceLock<Result<Vec<Setting>, SettingsError>> = OnceLock::new();
        let mut all = BUILT_IN.get_or_init(|| flight_layer(FLIGHT_NAME, FLIGHT_TOML)).clone()?;
        let before = Value::try_from(self).unwrap_or(Value::Boolean(false));
        for setting in &mut all {
            let find = |at: &Value, key: &str| at.get(key).cloned();
            if let Some(value) = setting.key.split('.').try_fold(before.clone(), |at, key| find(&at, key)) {
                setting.value = value;
            }
        }
        let origin = Origin { layer: Layer::Command, line: 0, file: "command".into() };
        for assignment in assignments {
            let (rule, value) =
                read_assignment(assignment).map_err(|problem| SettingsError { origin: origin.clone(), problem })?;
            replace(&mut all, rule, value, &origin);
        }
        let settings = typed(&all, FLIGHT_NAME)?;
        relations::check(&settings, &all)?;
        Ok(settings)
    }
}

/// Every setting of the flight file, in the order of the rules.
fn flight_layer(name: &str, text: &str) -> Result<Vec<Setting>, SettingsError> {
    let given = read_layer(Layer::Flight, name, text)?;
    let find = |rule: &'static Rule| {
        let (_, value, origin) = given.iter().find(|(other, ..)| other.key == rule.key).ok_or_else(|| SettingsError {
            origin: Origin { layer: Layer::Flight, line: 0, file: name.into() },
            problem: Problem::Missing { key: rule.key, expected: rule.expected() },
        })?;
        let (value, flight_value) = (value.clone(), value.clone());
        Ok(Setting { key: rule.key, unit: rule.unit, value, origin: origin.clone(), flight_value, custom: None })
    };
    RULES.iter().map(find).collect()
}

/// The settings of one file, each checked by its rule.
fn read_layer(layer: Layer, name: &str, text: &str) -> Result<Vec<(&'static Rule, Value, Origin)>, SettingsError> {
    let origin = |line| Origin { layer, line, file: name.into() };
    let given = read(text).map_err(|(line, problem)| SettingsError { origin: origin(line), problem })?;
    let checked = given.into_iter().map(|one| {
        let accepted = find_rule(&one.key).and_then(|rule| Ok((rule, accept(rule, one.value, &one.written)?)));
        match accepted {
            Ok((rule, value)) => Ok((rule, value, origin(one.line))),
            Err(problem) => Err(SettingsError { origin: origin(one.line), problem }),
        }
    });
    checked.collect()
}

/// Reads one `dotted.key=value`.
fn read_assignment(assignment: &str) -> Result<(&'static Rule, Value), Problem> {
    let (key, text) = assignment.split_once('=').ok_or_else(|| Problem::NotAnAssignment { given: quote(assignment) })?;
    let rule = find_rule(key.trim())?;
    let text = text.trim();
    Ok((rule, accept(rule, rule.read_bare(text), &quote(text))?))
}

fn find_rule(key: &str) -> Result<&'static Rule, Problem> {
    rule(key).ok_or_else(|| match first_of_section(key) {
        Some(example) => Problem::Section { key: key.into(), example: example.into() },
        None => Problem::Unknown { key: quote(key), near: nearest(&quote(key)).into() },
    })
}

fn accept(rule: &'static Rule, value: Value, written: &str) -> Result<Value, Problem> {
    rule.accept(value).ok_or_else(|| Problem::Value { key: rule.key, expected: rule.expected(), given: written.into() })
}

fn replace(all: &mut [Setting], rule: &Rule, value: Value, origin: &Origin) {
    if let Some(setting) = all.iter_mut().find(|setting| setting.key == rule.key) {
        setting.value = value;
        setting.origin = origin.clone();
        if origin.layer == Layer::Custom {
            setting.custom = Some(origin.clone());
        }
    }
}

/// The settings as the program uses them. Every value is checked by now, so an error means that schema and rules differ.
fn typed(all: &[Setting], flight_name: &str) -> Result<Settings, SettingsError> {
    let mut tree = Table::new();
    for setting in all {
        insert(&mut tree, setting.key, setting.value.clone());
    }
    serde_path_to_error::deserialize(Value::Table(tree)).map_err(|error| SettingsError {
        origin: Origin { layer: Layer::Flight, line: 0, file: flight_name.into() },
        problem: Problem::Contradiction(format!("'{}': {}", error.path(), quote(error.inner().message()))),
    })
}

fn insert(table: &mut Table, key: &str, value: Value) {
    match key.split_once('.') {
        None => {
            table.insert(key.into(), value);
        }
        Some((section, rest)) => {
            let below = table.entry(section).or_insert_with(|| Value::Table(Table::new()));
            if let Value::Table(below) = below {
                insert(below, rest, value);
            }
        }
    }
}
