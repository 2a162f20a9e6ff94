//! What can be wrong with settings, said so that the operator finds the place.

use std::fmt;

/// Which layer a value comes from, in rising precedence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Layer {
    /// The flight file, which has every setting.
    Flight,
    /// The custom file of one camera.
    Custom,
    /// The calibration that was put in force.
    Calibration,
    /// `--set` on the command line.
    CommandLine,
    /// A command from the ground.
    Command,
}

/// Where a value, or a mistake, stands.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Origin {
    /// The layer.
    pub layer: Layer,
    /// Line in the file, or which `--set` of the call; both count from 1. 0: the file as a whole.
    pub line: usize,
    /// The file as it was named; `--set` for the command line.
    pub file: String,
}

impl Origin {
    /// The place as an operator reads it in a list: `flight file`, `custom.toml:12`, `--set #1`.
    pub fn label(&self) -> String {
        if self.layer == Layer::Flight { "flight file".into() } else { self.to_string() }
    }
}

/// `custom.toml:12`, `--set #1`, or the file's name alone.
impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.layer, self.line) {
            (_, 0) => write!(f, "{}", self.file),
            (Layer::CommandLine, ordinal) => write!(f, "{} #{ordinal}", self.file),
            (_, line) => write!(f, "{}:{line}", self.file),
        }
    }
}

/// A mistake in the settings and its place. Nothing starts with one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{origin}: {problem}")]
pub struct SettingsError {
    /// Where it stands.
    pub origin: Origin,
    /// What is wrong there, and what was expected.
    pub problem: Problem,
}

/// What is wrong with a setting.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Problem {
    /// The text is no TOML.
    #[error("{message}{}", quoted(" in ", .line, ""))]
    Syntax {
        /// What the parser says.
        message: String,
        /// The line that it says it of.
        line: String,
    },
    /// The text is too long for a settings file.
    #[error("{bytes} bytes are too many for settings, expected at most {limit}")]
    TooLong {
        /// Bytes that were given.
        bytes: usize,
        /// Bytes that are allowed.
        limit: usize,
    },
    /// A `--set` without key or equals sign.
    #[error("'{given}' is not of the form dotted.key=value, such as camera.period_s=5")]
    NotAnAssignment {
        /// What was given.
        given: String,
    },
    /// A key that does not exist.
    #[error("unknown setting '{key}'{}", quoted("; did you mean ", .near, "?"))]
    Unknown {
        /// The key as given.
        key: String,
        /// The existing key that is most like it; may be empty.
        near: String,
    },
    /// A key that names a group of settings.
    #[error("'{key}' is a section, expected a setting in it, such as '{example}'")]
    Section {
        /// The key as given.
        key: String,
        /// One of the section's settings.
        example: String,
    },
    /// A wrong type, or out of range.
    #[error("'{key}' must be {expected}, not {given}")]
    Value {
        /// The setting.
        key: &'static str,
        /// What is allowed, with the unit.
        expected: String,
        /// The value as it was written.
        given: String,
    },
    /// A key that the flight file lacks, though it must have all.
    #[error("missing setting '{key}', expected {expected}")]
    Missing {
        /// The setting.
        key: &'static str,
        /// What is allowed, with the unit.
        expected: String,
    },
    /// Settings that contradict each other.
    #[error("{0}")]
    Contradiction(String),
}

/// The text in quotes between two others; nothing where the text is empty.
fn quoted(before: &str, text: &str, after: &str) -> String {
    if text.is_empty() { String::new() } else { format!("{before}'{text}'{after}") }
}
