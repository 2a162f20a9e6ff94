//! The calibration in force, in the directory of what outlasts a restart: put there on command, where it passes the guard, with what was in
//! force before kept beside it and a line in its log.

use crate::calibrate::{guard, list_of, sealed, with_list};
use crate::cli::{ConfigArgs, NEGATIVE, print};
use crate::image::BadPixels;
use crate::service::{CALIBRATION, CALIBRATION_BEFORE, CALIBRATION_LOG, read_file, utc_now};
use crate::settings::{Loaded, MAX_TEXT_BYTES};
use anyhow::{Context, bail};
use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Longest list of bad pixels, bytes.
const LONGEST_LIST: usize = 16 << 20;
/// What stands in the place of the calibration before the first one.
const NONE: &str = "# none was in force\n";

/// The calibration in force: the name of its file and its text; `None` where there is none.
///
/// # Errors
/// Why it cannot be taken, by the name of its file: it is damaged, or the list that it names is.
pub fn in_force(directory: &str) -> Result<Option<(String, String)>, String> {
    let path = Path::new(directory).join(CALIBRATION);
    if directory.is_empty() || !path.exists() {
        return Ok(None);
    }
    let name = path.display().to_string();
    let text = text_of(&path).map_err(|error| format!("{error:#}"))?;
    sealed(&text).map_err(|error| format!("{name}: {error}"))?;
    if let Some(list) = list_of(&text) {
        let bytes = read_file(Path::new(&list), LONGEST_LIST, "a list of bad pixels").map_err(|error| error.to_string())?;
        if !list.ends_with(&list_name(&bytes)) {
            return Err(format!("{list}: was changed or torn since the calibration that names it was put in force"));
        }
    }
    Ok(Some((name, text)))
}

/// Puts a calibration in force.
///
/// # Errors
/// Where settings or files are wrong, or the disk refuses.
pub fn apply(file: &Path, config: &ConfigArgs) -> anyhow::Result<ExitCode> {
    let (files, before) = (config.load_files()?, config.load()?);
    let directory = directory_of(&files)?;
    let name = file.display();
    let text = text_of(file)?;
    let body = sealed(&text).with_context(|| format!("{name}"))?;
    let list = match list_of(body) {
        None => None,
        Some(list) => Some(read_file(Path::new(&list), LONGEST_LIST, "a list of bad pixels")?),
    };
    let bad_pixels = match &list {
        None => BadPixels::default(),
        Some(bytes) => BadPixels::parse(&name.to_string(), &String::from_utf8_lossy(bytes))?,
    };
    // The list goes with it, under a name that says what is in it.
    let kept_list = list.as_ref().map(|bytes| directory.join(list_name(bytes)));
    let text = kept_list.as_ref().map_or(text.clone(), |list| with_list(body, &list.display().to_string()));
    let after = config.load_with(&name.to_string(), &text)?;
    let there = in_force(&directory.display().to_string());
    let reference = there.as_ref().is_ok_and(Option::is_some).then_some(&before.settings);
    if let Err(refusal) = guard(&files.settings, reference, &after.settings, bad_pixels.len()) {
        print(&format!("refused: {name}: {refusal}"))?;
        return Ok(ExitCode::from(NEGATIVE));
    }
    fs::create_dir_all(&directory).with_context(|| format!("{}: cannot be made", directory.display()))?;
    if let (Some(bytes), Some(path)) = (&list, &kept_list) {
        put(path, bytes)?;
    }
    let current = directory.join(CALIBRATION);
    let old = match fs::read(&current) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => NONE.into(),
        Err(error) => return Err(error).with_context(|| format!("{}: cannot be read", current.display())),
    };
    put(&directory.join(CALIBRATION_BEFORE), &old)?;
    put(&current, text.as_bytes())?;
    tell(&directory, &format!("applied {name}"), &before, &after)
}

/// Takes the last one back.
///
/// # Errors
/// Where settings are wrong, or the disk refuses.
pub fn undo(config: &ConfigArgs) -> anyhow::Result<ExitCode> {
    let before = config.load()?;
    let directory = directory_of(&before)?;
    let (current, earlier) = (directory.join(CALIBRATION), directory.join(CALIBRATION_BEFORE));
    let old = match fs::read(&earlier) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == ErrorKind::NotFound => {
            print("refused: nothing to undo: no calibration was put in force, or the last one was taken back already")?;
            return Ok(ExitCode::from(NEGATIVE));
        }
        Err(error) => return Err(error).with_context(|| format!("{}: cannot be read", earlier.display())),
    };
    if old == NONE.as_bytes() {
        fs::remove_file(&current).with_context(|| format!("{}: cannot be removed", current.display()))?;
    } else {
        put(&current, &old)?;
    }
    fs::remove_file(&earlier).with_context(|| format!("{}: cannot be removed", earlier.display()))?;
    tell(&directory, "undone", &before, &config.load()?)
}

/// Writes a change into the log, and says it.
fn tell(directory: &Path, what: &str, before: &Loaded, after: &Loaded) -> anyhow::Result<ExitCode> {
    let mut words = Vec::new();
    for (old, new) in before.all.iter().zip(&after.all).filter(|(old, new)| old.value != new.value) {
        words.push(format!("{} = {} (was {})", new.key, new.value, old.value));
    }
    let time = utc_now().0.map_or_else(|| "unset".to_owned(), |utc| format!("{utc}Z"));
    let path = directory.join(CALIBRATION_LOG);
    let mut log = OpenOptions::new().create(true).append(true).open(&path).with_context(|| format!("{}", path.display()))?;
    log.write_all(format!("{time} {what}: {}\n", words.join(", ")).as_bytes())?;
    log.sync_data()?;
    words.insert(0, format!("{what}; the service takes it at its next start"));
    print(&words.join("\n  "))?;
    Ok(ExitCode::SUCCESS)
}

fn directory_of(loaded: &Loaded) -> anyhow::Result<PathBuf> {
    let directory = &loaded.settings.commands.ledger_directory;
    if directory.is_empty() {
        bail!("commands.ledger_directory is empty, expected a directory for the calibration in force");
    }
    Ok(directory.into())
}

fn text_of(path: &Path) -> anyhow::Result<String> {
    let bytes = read_file(path, MAX_TEXT_BYTES, "a calibration")?;
    String::from_utf8(bytes).map_err(|_| anyhow::anyhow!("{}: is not UTF-8 text, expected a calibration", path.display()))
}

fn list_name(bytes: &[u8]) -> String {
    format!("bad_pixels-{:08x}.txt", crc32fast::hash(bytes))
}

/// Writes a file, whole or not at all, down to the disk.
fn put(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let attempt = || -> std::io::Result<()> {
        let unfinished = path.with_extension("part");
        let mut file = File::create(&unfinished)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&unfinished, path)?;
        File::open(path.parent().unwrap_or(Path::new(".")))?.sync_all()
    };
    attempt().with_context(|| format!("{}: cannot be written", path.display()))
}
