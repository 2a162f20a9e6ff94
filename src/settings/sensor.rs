//! Where a sensor's value comes from, as people write it: `file:/path *0.001 +2`, `command:/path argument`, `simulated`.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Where a sensor's value comes from.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum SensorSource {
    /// There is no such sensor.
    #[default]
    None,
    /// Simulated while the camera is, otherwise none.
    Auto,
    /// A made-up value, and whatever shows it says so.
    Simulated,
    /// The first number in a file, times `scale`, plus `offset`.
    Path {
        /// The file: absolute.
        path: String,
        /// What the number is multiplied by.
        scale: f64,
        /// What is added then.
        offset: f64,
    },
    /// The first number that a program prints.
    Command {
        /// The program: an absolute path without spaces.
        program: String,
        /// Its arguments, taken apart at spaces; there is no shell.
        arguments: Vec<String>,
    },
}

impl SensorSource {
    /// Reads a source.
    ///
    /// # Errors
    /// What was expected, where the text is none.
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "'{text}' is no sensor, expected \"file:/path\" with *scale and +offset or without, \"command:/path arguments\", \
                 \"simulated\", \"auto\" or \"\""
            )
        };
        if text.chars().any(char::is_control) {
            return Err(wrong());
        }
        let source = match (text, text.split_once(':')) {
            ("", _) => Self::None,
            ("auto", _) => Self::Auto,
            ("simulated", _) => Self::Simulated,
            (_, Some(("file", rest))) => file(rest).ok_or_else(wrong)?,
            (_, Some(("command", rest))) => {
                let mut words = rest.split_whitespace().map(str::to_owned);
                Self::Command { program: words.next().ok_or_else(wrong)?, arguments: words.collect() }
            }
            _ => return Err(wrong()),
        };
        match &source {
            Self::Path { path, .. } | Self::Command { program: path, .. } if !path.starts_with('/') => Err(wrong()),
            _ => Ok(source),
        }
    }
}

/// A path that may have spaces; behind it ` *scale` and ` +offset` or ` -offset`, in this order, where they are wanted.
fn file(text: &str) -> Option<SensorSource> {
    let last = |text: &str| text.trim_end().rsplit_once(' ').map(|(rest, word)| (rest.trim_end().to_owned(), word.to_owned()));
    let number = |text: &str| text.parse().ok().filter(|number: &f64| number.is_finite());
    let (mut path, mut scale, mut offset) = (text.trim_end().to_owned(), 1.0, 0.0);
    if let Some((rest, word)) = last(&path)
        && word.starts_with(['+', '-'])
    {
        (path, offset) = (rest, number(&word)?);
    }
    if let Some((rest, word)) = last(&path)
        && let Some(factor) = word.strip_prefix('*')
    {
        (path, scale) = (rest, number(factor).filter(|factor| *factor != 0.0)?);
    }
    Some(SensorSource::Path { path, scale, offset })
}

impl fmt::Display for SensorSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => Ok(()),
            Self::Auto => f.write_str("auto"),
            Self::Simulated => f.write_str("simulated"),
            Self::Path { path, scale, offset } => {
                write!(f, "file:{path}")?;
                if *scale != 1.0 {
                    write!(f, " *{scale}")?;
                }
                if *offset != 0.0 { write!(f, " {offset:+}") } else { Ok(()) }
            }
            Self::Command { program, arguments } => {
                write!(f, "command:{program}")?;
                arguments.iter().try_for_each(|argument| write!(f, " {argument}"))
            }
        }
    }
}

impl TryFrom<String> for SensorSource {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        Self::parse(&text)
    }
}

impl From<SensorSource> for String {
    fn from(source: SensorSource) -> Self {
        source.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(path: &str, scale: f64, offset: f64) -> SensorSource {
        SensorSource::Path { path: path.to_owned(), scale, offset }
    }

    #[test]
    fn sources_read_like_people_write_them_and_come_back_the_same() {
        let command = |program: &str, arguments: &[&str]| SensorSource::Command {
            program: program.to_owned(),
            arguments: arguments.iter().map(|one| (*one).to_owned()).collect(),
        };
        for (text, wanted) in [
            ("", SensorSource::None),
            ("auto", SensorSource::Auto),
            ("simulated", SensorSource::Simulated),
            ("file:/t", file("/t", 1.0, 0.0)),
            ("file:/sys/class/thermal/thermal_zone0/temp *0.001", file("/sys/class/thermal/thermal_zone0/temp", 0.001, 0.0)),
            ("file:/t *0.001 -2.5", file("/t", 0.001, -2.5)),
            ("file:/t *-1 +273.15", file("/t", -1.0, 273.15)),
            ("file:/two words/t +1", file("/two words/t", 1.0, 1.0)),
            ("file:/t*2", file("/t*2", 1.0, 0.0)),
            ("command:/bin/t", command("/bin/t", &[])),
            ("command:/bin/t -n 3 lens", command("/bin/t", &["-n", "3", "lens"])),
        ] {
            let read = SensorSource::parse(text).unwrap();
            assert_eq!(read, wanted, "{text}");
            assert_eq!(SensorSource::parse(&read.to_string()), Ok(wanted), "{text}");
        }
    }

    #[test]
    fn anything_else_is_refused_with_what_was_expected() {
        for text in [
            "t",
            "file:",
            "file:t",
            "file: /t",
            "file:/t *x",
            "file:/t *0",
            "file:/t *nan",
            "file:/t +",
            "file:/t -inf",
            "command:",
            "command:t",
            "command: ",
            "serial:/dev/t",
            "file:/t\n",
            "Simulated",
            " ",
        ] {
            let error = SensorSource::parse(text).unwrap_err();
            assert!(error.contains("expected \"file:/path\""), "{text}: {error}");
        }
    }
}
