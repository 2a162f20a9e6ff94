//! Proper names of stars, by Hipparcos number.

use std::collections::HashMap;
use std::sync::LazyLock;

/// The names that are built into the program.
const EMBEDDED: &str = include_str!("../../config/catalog/names.csv");

/// First line of a file of names.
const HEADING: &str = "hip,name";

/// Why a file of names was refused.
#[derive(Debug, Clone, thiserror::Error, PartialEq)]
pub enum NamesError {
    /// The first line is another.
    #[error("line 1 is {found:?}, expected {HEADING:?}")]
    Heading {
        /// What it is.
        found: String,
    },
    /// A line that is not a number, a comma and a name.
    #[error("line {line} is {found:?}, expected a Hipparcos number, a comma and a name")]
    Line {
        /// Counted from 1.
        line: usize,
        /// What it is.
        found: String,
    },
    /// A star named twice, or a name given twice.
    #[error("line {line}: {found:?} is there already, expected each star and each name once")]
    Again {
        /// Counted from 1.
        line: usize,
        /// The line.
        found: String,
    },
}

/// Proper names by Hipparcos number, and the other way round.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Names {
    by_hip: HashMap<u32, String>,
    by_name: HashMap<String, u32>,
}

impl Names {
    /// The names that are built into the program (`config/catalog/names.csv`).
    pub fn embedded() -> &'static Result<Self, NamesError> {
        static NAMES: LazyLock<Result<Names, NamesError>> = LazyLock::new(|| Names::parse(EMBEDDED));
        &NAMES
    }

    /// Reads lines of `hip,name` below the heading.
    pub fn parse(text: &str) -> Result<Self, NamesError> {
        let mut lines = text.lines();
        let heading = lines.next().unwrap_or_default();
        if heading != HEADING {
            return Err(NamesError::Heading { found: heading.to_owned() });
        }
        let mut names = Self::default();
        for (line, found) in (2..).zip(lines) {
            let (hip, name) = pair(found).ok_or_else(|| NamesError::Line { line, found: found.to_owned() })?;
            let hip_again = names.by_hip.insert(hip, name.to_owned()).is_some();
            let name_again = names.by_name.insert(key(name), hip).is_some();
            if hip_again || name_again {
                return Err(NamesError::Again { line, found: found.to_owned() });
            }
        }
        Ok(names)
    }

    /// The proper name of a star, by its Hipparcos number.
    pub fn of(&self, hip: u32) -> Option<&str> {
        self.by_hip.get(&hip).map(String::as_str)
    }

    /// The Hipparcos number of a star, by its proper name in any case of letters.
    pub fn hip(&self, name: &str) -> Option<u32> {
        self.by_name.get(&key(name)).copied()
    }

    /// How many stars have a name.
    pub fn len(&self) -> usize {
        self.by_hip.len()
    }

    /// Whether no star has a name.
    pub fn is_empty(&self) -> bool {
        self.by_hip.is_empty()
    }
}

/// A name as it is looked up.
fn key(name: &str) -> String {
    name.trim().to_lowercase()
}

/// The number and the name of one line.
fn pair(line: &str) -> Option<(u32, &str)> {
    let (hip, name) = line.split_once(',')?;
    let hip: u32 = hip.parse().ok()?;
    let whole = hip > 0 && !name.is_empty() && name.trim() == name && !name.contains(',');
    whole.then_some((hip, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_found_from_the_number_and_the_number_from_the_name_in_any_case() {
        let names = Names::parse("hip,name\n32349,Sirius\n91262,Vega\n").unwrap();
        assert_eq!(names.of(91262), Some("Vega"));
        assert_eq!(names.of(1), None);
        assert_eq!(names.hip(" sIRIUS"), Some(32349));
        assert_eq!(names.hip("Deneb"), None);
        assert_eq!(names.len(), 2);
    }

    #[test]
    fn a_bad_line_is_refused_with_its_number() {
        for bad in ["Vega", "x,Vega", "0,Vega", "-1,Vega", "91262,", "91262,Vega,", "91262, Vega", "4294967296,Vega", ""] {
            let text = format!("hip,name\n32349,Sirius\n{bad}\n");
            assert_eq!(Names::parse(&text), Err(NamesError::Line { line: 3, found: bad.to_owned() }), "{bad:?}");
        }
        assert_eq!(Names::parse(""), Err(NamesError::Heading { found: String::new() }));
        assert_eq!(Names::parse("32349,Sirius\n"), Err(NamesError::Heading { found: "32349,Sirius".to_owned() }));
    }

    #[test]
    fn a_star_or_a_name_given_twice_is_refused() {
        for bad in ["32349,Canicula", "1,SIRIUS"] {
            let text = format!("hip,name\n32349,Sirius\n{bad}\n");
            assert_eq!(Names::parse(&text), Err(NamesError::Again { line: 3, found: bad.to_owned() }));
        }
    }

    #[test]
    fn at_least_three_hundred_names_are_built_in() {
        assert!(Names::embedded().as_ref().unwrap().len() >= 300);
    }
}
