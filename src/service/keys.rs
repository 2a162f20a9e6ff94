//! The keys of flight computers, from files that their owner alone may read.

use super::file::read_file;
use crate::command::{Authenticity, FlightComputer, Key};
use crate::settings::CommandSettings;
use crate::wire::Commands;
use std::collections::BTreeMap;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Longest key file, bytes: the digits and some white space.
const LONGEST: usize = 1024;
/// What nobody but the owner may do with a key file.
const OTHERS: u32 = 0o077;

/// The keys, and whether they are required.
#[derive(Debug, Default)]
pub struct Keys {
    keys: BTreeMap<FlightComputer, Key>,
    required: bool,
}

impl Keys {
    /// Reads the files that the settings name.
    ///
    /// # Errors
    /// In words, with the setting and the file: where one cannot be read, may be read by others, or holds no key; and where keys are
    /// required and there is none.
    pub fn read(settings: &CommandSettings) -> Result<Self, String> {
        let mut keys = BTreeMap::new();
        for (number, name) in [(1, &settings.key_file_1), (2, &settings.key_file_2)] {
            if !name.is_empty() {
                let key =
                    read(Path::new(name)).map_err(|problem| format!("commands.key_file_{number} = \"{name}\": {problem}"))?;
                keys.insert(FlightComputer(number), key);
            }
        }
        if settings.require_authentication && keys.is_empty() {
            return Err("commands.require_authentication: neither commands.key_file_1 nor commands.key_file_2 is set".to_owned());
        }
        Ok(Self { keys, required: settings.require_authentication })
    }

    /// Whether nothing runs without a key.
    pub fn required(&self) -> bool {
        self.required
    }

    /// Whether a computer has a key.
    pub fn has(&self, computer: FlightComputer) -> bool {
        self.keys.contains_key(&computer)
    }

    /// Whether a block shows the key of its sender. A wrong code is refused even where none is required.
    pub fn judge(&self, computer: FlightComputer, block: &Commands) -> Authenticity {
        match (self.keys.get(&computer), block.tag()) {
            (Some(key), Some(tag)) if key.verifies(&block.tagged_bytes(), &tag) => Authenticity::Shown,
            (Some(_), Some(_)) => Authenticity::Failed,
            _ if self.required => Authenticity::Failed,
            _ => Authenticity::NotRequired,
        }
    }
}

fn read(path: &Path) -> Result<Key, String> {
    let mode = std::fs::metadata(path).map_err(|error| error.to_string())?.permissions().mode();
    if mode & OTHERS != 0 {
        return Err(format!("others than its owner may use it (mode {:04o}), expected 0600", mode & 0o7777));
    }
    let bytes = read_file(path, LONGEST, "a key").map_err(|error| error.to_string())?;
    Key::parse(&String::from_utf8_lossy(&bytes)).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn settings(key_file_1: &Path, require_authentication: bool) -> CommandSettings {
        let flight = crate::settings::Settings::flight().unwrap().commands;
        CommandSettings { key_file_1: key_file_1.to_string_lossy().into_owned(), require_authentication, ..flight }
    }

    #[test]
    fn a_key_is_taken_from_a_file_that_its_owner_alone_may_read() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("key");
        fs::write(&path, "5a".repeat(32)).unwrap();
        for (mode, taken) in [(0o600, true), (0o400, true), (0o640, false), (0o604, false), (0o666, false)] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            let keys = Keys::read(&settings(&path, true));
            assert_eq!(keys.is_ok(), taken, "{mode:o}");
            if let Err(problem) = keys {
                assert!(problem.contains("commands.key_file_1") && problem.contains("0600"), "{problem}");
            }
        }
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).unwrap();
        fs::write(&path, "secret").unwrap();
        assert!(Keys::read(&settings(&path, false)).unwrap_err().contains("64 hexadecimal digits"));
        assert!(Keys::read(&settings(Path::new(""), true)).unwrap_err().contains("require_authentication"));
    }

    #[test]
    fn a_block_is_judged_by_the_key_of_its_sender() {
        let (one, two) = (Key::parse(&"11".repeat(32)).unwrap(), Key::parse(&"22".repeat(32)).unwrap());
        let block = Commands { sequence: 5.into(), ..Commands::default() };
        let keys = |required| Keys { keys: BTreeMap::from([(FlightComputer(1), one.clone())]), required };
        let fc = FlightComputer;
        assert_eq!(keys(true).judge(fc(1), &block.signed(&one)), Authenticity::Shown);
        assert_eq!(keys(true).judge(fc(1), &block.signed(&two)), Authenticity::Failed);
        assert_eq!(keys(true).judge(fc(1), &block), Authenticity::Failed);
        assert_eq!(keys(true).judge(fc(2), &block.signed(&two)), Authenticity::Failed);
        assert_eq!(keys(false).judge(fc(1), &block), Authenticity::NotRequired);
        assert_eq!(keys(false).judge(fc(1), &block.signed(&two)), Authenticity::Failed);
    }
}
