//! What is known of each command, and commands as numbers and words: checked, read and written by their definitions.

use super::dictionary::{Command, all};
use super::guard::Act;
use super::value::Parameter;

/// Values that a command may have at most; the wire has room for so many.
pub const MAX_VALUES: usize = 8;

/// Whether a command must be armed before it is fired.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hazard {
    /// It runs when it is sent.
    None,
    /// It is armed first, and fired then.
    Always,
    /// It must be armed where it moves the focus further than `lens.large_move_counts`, or from an unknown position.
    LargeMove,
}

/// What is known of a command besides its values.
#[derive(Debug, Clone, PartialEq)]
pub struct Definition {
    /// Its number on the wire.
    pub code: u8,
    /// Its name, `actor.verb_object`.
    pub name: &'static str,
    /// What it does.
    pub meaning: &'static str,
    /// The ground command of the program that flew; empty where there was none.
    pub flown: &'static str,
    /// Whether it must be armed.
    pub hazard: Hazard,
    /// Its values, in the order of the wire.
    pub parameters: Vec<Parameter>,
}

/// Why numbers or words are no command.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CommandError {
    /// No command has this code.
    #[error("no command has the code {0}")]
    UnknownCode(u8),
    /// No command has this name.
    #[error("no command is called '{name}'{hint}")]
    UnknownName {
        /// As given.
        name: String,
        /// What may have been meant.
        hint: String,
    },
    /// Too few or too many values.
    #[error("{name} takes {wanted} values ({parameters}), {got} were given")]
    Count {
        /// The command.
        name: &'static str,
        /// How many it takes.
        wanted: usize,
        /// Their names.
        parameters: String,
        /// How many came.
        got: usize,
    },
    /// A value that may not be.
    #[error("{name}: {parameter} = {value}, expected {expected}")]
    OutOfRange {
        /// The command.
        name: &'static str,
        /// The value's name.
        parameter: &'static str,
        /// As given.
        value: String,
        /// What is allowed.
        expected: String,
    },
}

impl Definition {
    /// Every command, in the order of the codes.
    pub fn all() -> &'static [Self] {
        static ALL: std::sync::LazyLock<Vec<Definition>> = std::sync::LazyLock::new(all);
        &ALL
    }

    /// The one with a code.
    pub fn of_code(code: u8) -> Option<&'static Self> {
        Self::all().iter().find(|definition| definition.code == code)
    }

    /// The one with a name.
    pub fn of_name(name: &str) -> Option<&'static Self> {
        Self::all().iter().find(|definition| definition.name == name)
    }

    /// The command as it is written: its name and what it takes.
    pub fn usage(&self) -> String {
        let names = self.parameters.iter().map(|parameter| format!(" <{}>", parameter.name));
        std::iter::once(self.name.to_owned()).chain(names).collect()
    }

    /// The command for people who would write it: what it takes and does, a line for each value.
    pub fn help(&self) -> String {
        let armed = match self.hazard {
            Hazard::None => "",
            Hazard::Always => "  [arm, then fire]",
            Hazard::LargeMove => "  [arm, then fire, if the move is large]",
        };
        let values = self.parameters.iter().map(|parameter| {
            let unit = if parameter.unit.is_empty() { String::new() } else { format!(", {}", parameter.unit) };
            format!("\n      {}: {}{unit}. {}", parameter.name, parameter.expected(), parameter.meaning)
        });
        format!("{}{armed}\n    {}{}", self.usage(), self.meaning, values.collect::<String>())
    }

    fn count_error(&self, got: usize) -> CommandError {
        let parameters = self.parameters.iter().map(|parameter| parameter.name).collect::<Vec<_>>().join(", ");
        CommandError::Count { name: self.name, wanted: self.parameters.len(), parameters, got }
    }

    fn check(&self, numbers: &[f64]) -> Result<Command, CommandError> {
        for (parameter, number) in self.parameters.iter().zip(numbers) {
            if !parameter.allows(*number) {
                return Err(CommandError::OutOfRange {
                    name: self.name,
                    parameter: parameter.name,
                    value: number.to_string(),
                    expected: parameter.expected(),
                });
            }
        }
        Command::from_checked(self.code, numbers).ok_or(CommandError::UnknownCode(self.code))
    }
}

impl Command {
    /// What is known of it.
    ///
    /// # Errors
    /// Never for a command of this program: every code has its definition, which a test holds.
    pub fn definition(&self) -> Result<&'static Definition, CommandError> {
        Definition::of_code(self.code()).ok_or(CommandError::UnknownCode(self.code()))
    }

    /// Its name.
    pub fn name(&self) -> &'static str {
        self.definition().map_or("", |definition| definition.name)
    }

    /// Whether it only stops things: then it waits for nothing and runs whatever else is wrong. Done twice it does no harm, not done it
    /// may.
    pub fn only_stops(&self) -> bool {
        matches!(self, Self::StopLens {} | Self::KnownGood {} | Self::AbortSolver {} | Self::AbortFocus { use_result: false })
    }

    /// From the wire's code and values; values that the command does not have must be 0.
    ///
    /// # Errors
    /// See [`CommandError`].
    pub fn from_wire(code: u8, values: &[f64; MAX_VALUES]) -> Result<Self, CommandError> {
        let definition = Definition::of_code(code).ok_or(CommandError::UnknownCode(code))?;
        let (own, rest) = values.split_at_checked(definition.parameters.len()).unwrap_or((values, &[]));
        if let Some(past) = rest.iter().rposition(|value| *value != 0.0) {
            return Err(definition.count_error(own.len() + past + 1));
        }
        definition.check(own)
    }

    /// Its values as the wire has them, filled up with zeros.
    pub fn wire_values(&self) -> [f64; MAX_VALUES] {
        let mut values = [0.0; MAX_VALUES];
        values.iter_mut().zip(self.numbers()).for_each(|(place, number)| *place = number);
        values
    }

    /// Reads a command as people write it: its name and its values, with spaces between.
    ///
    /// # Errors
    /// See [`CommandError`].
    pub fn parse(text: &str) -> Result<Self, CommandError> {
        let mut words = text.split_whitespace();
        let name = words.next().unwrap_or_default();
        let definition = Definition::of_name(name).ok_or_else(|| unknown(name))?;
        let words: Vec<&str> = words.collect();
        if words.len() != definition.parameters.len() {
            return Err(definition.count_error(words.len()));
        }
        let mut numbers = Vec::with_capacity(words.len());
        for (parameter, word) in definition.parameters.iter().zip(words) {
            numbers.push(parameter.read(word).ok_or_else(|| CommandError::OutOfRange {
                name: definition.name,
                parameter: parameter.name,
                value: word.to_owned(),
                expected: parameter.expected(),
            })?);
        }
        definition.check(&numbers)
    }
}

/// Reads a command and what is to be done with it: `arm` or `fire` before a hazardous one.
///
/// # Errors
/// See [`CommandError`].
pub fn parse_order(text: &str) -> Result<(Act, Command), CommandError> {
    let text = text.trim();
    let (act, rest) = match text.split_once(char::is_whitespace) {
        Some(("arm", rest)) => (Act::Arm, rest),
        Some(("fire", rest)) => (Act::Fire, rest),
        _ => (Act::Run, text),
    };
    Command::parse(rest).map(|command| (act, command))
}

/// The command as people write it; [`Command::parse`] reads it back.
impl std::fmt::Display for Command {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())?;
        let parameters = self.definition().map_or(&[][..], |definition| &definition.parameters);
        parameters.iter().zip(self.numbers()).try_for_each(|(parameter, number)| write!(f, " {}", parameter.word(number)))
    }
}

/// A name that is none; with those of the same actor as a hint.
fn unknown(name: &str) -> CommandError {
    let actor = name.split('.').next().unwrap_or_default();
    let near: Vec<&str> =
        Definition::all().iter().map(|known| known.name).filter(|known| known.split('.').next() == Some(actor)).collect();
    let hint = if near.is_empty() {
        let mut actors: Vec<&str> = Definition::all().iter().filter_map(|known| known.name.split('.').next()).collect();
        actors.dedup();
        format!("; names begin with one of {}", actors.join(", "))
    } else {
        format!("; there are {}", near.join(", "))
    };
    CommandError::UnknownName { name: name.to_owned(), hint }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::command::value::Shape;
    use std::collections::HashSet;

    /// The least and the greatest command of a definition.
    fn ends(definition: &Definition) -> [Command; 2] {
        [|p: &Parameter| p.low, |p: &Parameter| p.high].map(|end| {
            let mut values = [0.0; MAX_VALUES];
            values.iter_mut().zip(&definition.parameters).for_each(|(place, parameter)| *place = end(parameter));
            Command::from_wire(definition.code, &values).unwrap()
        })
    }

    #[test]
    fn codes_and_names_are_given_once_and_values_fit_the_wire() {
        let (mut codes, mut names) = (HashSet::new(), HashSet::new());
        for definition in Definition::all() {
            assert!(codes.insert(definition.code) && definition.code > 0 && names.insert(definition.name), "{}", definition.name);
            assert!(definition.parameters.len() <= MAX_VALUES && !definition.meaning.is_empty());
            for parameter in &definition.parameters {
                assert!(parameter.low < parameter.high, "{} {}", definition.name, parameter.name);
            }
        }
    }

    #[test]
    fn every_command_reads_back_from_its_numbers_and_from_its_words() {
        for definition in Definition::all() {
            for command in ends(definition) {
                assert_eq!(command.definition().unwrap().code, definition.code);
                assert_eq!(Command::from_wire(command.code(), &command.wire_values()), Ok(command));
                assert_eq!(Command::parse(&command.to_string()), Ok(command), "{command}");
            }
        }
    }

    #[test]
    fn every_value_is_refused_beyond_both_ends_of_its_range() {
        let mut refused = 0;
        for definition in Definition::all() {
            for (place, parameter) in definition.parameters.iter().enumerate() {
                let beyond = (parameter.high - parameter.low).max(1.0) * 1e-3;
                let beyond = if parameter.shape == Shape::Real { beyond } else { 1.0 };
                for wrong in [parameter.low - beyond, parameter.high + beyond, f64::NAN, f64::INFINITY] {
                    let mut values = ends(definition)[0].wire_values();
                    values[place] = wrong;
                    let error = Command::from_wire(definition.code, &values).unwrap_err();
                    assert!(matches!(&error, CommandError::OutOfRange { parameter: named, .. } if *named == parameter.name));
                    refused += 1;
                }
            }
        }
        assert!(refused > 150);
    }

    #[test]
    fn whole_numbers_are_whole_and_values_that_a_command_does_not_have_are_refused() {
        let mut values = [0.0; MAX_VALUES];
        values[0] = 3030.5;
        assert!(matches!(Command::from_wire(23, &values), Err(CommandError::OutOfRange { .. })));
        values = [3030.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        assert!(matches!(Command::from_wire(23, &values), Err(CommandError::Count { got: 3, wanted: 1, .. })));
        assert_eq!(Command::from_wire(200, &values), Err(CommandError::UnknownCode(200)));
    }

    #[test]
    fn what_people_mistype_is_answered_with_what_was_expected() {
        let cases = [
            ("lens.set_focus", "lens.set_focus takes 1 values (position_counts), 0 were given"),
            ("lens.set_focus x", "lens.set_focus: position_counts = x, expected a whole number from 0 to 65535"),
            ("lens.set_focus 70000", "lens.set_focus: position_counts = 70000, expected a whole number from 0 to 65535"),
            ("solver.abort now", "solver.abort takes 0 values (), 1 were given"),
            ("focus.set_display never", "focus.set_display: show = never, expected auto, on, off"),
        ];
        for (text, wanted) in cases {
            assert_eq!(Command::parse(text).unwrap_err().to_string(), wanted);
        }
        assert!(Command::parse("lens.focus 3").unwrap_err().to_string().contains("lens.set_focus"));
        assert!(Command::parse("lense").unwrap_err().to_string().contains("requirements"));
        assert_eq!(Command::parse(" solver.mask  on 1 2 3 ").unwrap().to_string(), "solver.mask 1 1 2 3");
        assert_eq!(parse_order(" arm  service.quit"), Ok((Act::Arm, Command::Quit {})));
        assert_eq!(parse_order("fire service.quit "), Ok((Act::Fire, Command::Quit {})));
        assert_eq!(parse_order("lens.stop"), Ok((Act::Run, Command::StopLens {})));
        assert!(parse_order("arm").is_err());
    }
}
