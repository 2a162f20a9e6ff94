//! `stars bundle`: what somebody needs who is to find out what went wrong, in one file that fits through a thin link. No key is in it.

use super::export::records_in;
use super::{ConfigArgs, print, settings};
use crate::catalog::Catalogue;
use crate::service::{free_bytes, journals, read_file, state_files, utc_now};
use crate::settings::{Loaded, Settings};
use crate::wire;
use anyhow::Context;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::SystemTime;

/// Of a record the end is taken, bytes: some hundred images with all their sources. Of each of so many records, the newest.
const RECORD_TAIL: u64 = 4 << 20;
const RECORDS: usize = 4;
/// Of the newest of so many journals the end too, bytes: some hours. Who reads it skips the entry that it begins within.
const JOURNALS: usize = 2;
const JOURNAL_TAIL: u64 = 8 << 20;
/// Longest file of the state, bytes: they are small.
const LONGEST_STATE: usize = 1 << 20;
/// Lines of the system's journal.
const JOURNAL_LINES: &str = "5000";
/// What Linux says of the machine.
const MACHINE: [&str; 4] = ["/proc/version", "/proc/uptime", "/proc/loadavg", "/proc/meminfo"];

/// Packs settings, ends of records, state, newest images and the state of the machine into one file
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  stars bundle --custom custom.toml                    stars-bundle-<time>.tar.gz in this directory
  stars bundle --images 0 --out /tmp/small.tar.gz      without images, for a thin link
Give it the settings files that the service runs with. What could not be read is named, there and in missing.txt. Keys of
commands are never in it. Exits 0 if it was written, 2 if the call or a file is wrong.")]
pub struct Args {
    /// Write it here; nothing that is there already is overwritten
    #[arg(long, value_name = "OUT")]
    out: Option<PathBuf>,
    /// Newest images that go in
    #[arg(long, value_name = "N", default_value_t = 2)]
    images: usize,
    #[command(flatten)]
    config: ConfigArgs,
}

impl Args {
    /// Writes the bundle, and says where it is.
    ///
    /// # Errors
    /// Wrong settings, or a bundle that cannot be written.
    pub fn run(self) -> anyhow::Result<ExitCode> {
        let loaded = self.config.load()?;
        let time = utc_now().0.map_or_else(|| "unset".to_owned(), |utc| utc.to_string().replace(':', "-"));
        let root = format!("stars-bundle-{time}");
        let path = self.out.unwrap_or_else(|| format!("{root}.tar.gz").into());
        let name = path.display().to_string();
        let file = File::create_new(&path).with_context(|| format!("{name} cannot be written"))?;
        let mut bundle =
            Bundle { tar: tar::Builder::new(GzEncoder::new(file, Compression::default())), root, missing: Vec::new() };
        let written = bundle.fill(&loaded, self.images).and_then(|()| bundle.tar.into_inner()?.finish()?.sync_all());
        if let Err(error) = written {
            // Half a bundle helps nobody; that it cannot go either is told by what stays.
            let _ = fs::remove_file(&path);
            return Err(error).context(format!("{name} cannot be written"));
        }
        let bytes = fs::metadata(&path).map_or(0, |meta| meta.len());
        let mut lines = vec![format!("{name}: {:.1} MB", bytes as f64 / 1e6)];
        lines.extend(bundle.missing.iter().map(|missing| format!("not in it: {missing}")));
        print(&lines.join("\n"))?;
        Ok(ExitCode::SUCCESS)
    }
}

/// A bundle that is being written.
struct Bundle {
    tar: tar::Builder<GzEncoder<File>>,
    /// The directory that all of it unpacks into.
    root: String,
    /// What could not be read, and why.
    missing: Vec<String>,
}

impl Bundle {
    /// Everything, one after the other; an error is the bundle's own.
    fn fill(&mut self, loaded: &Loaded, images: usize) -> io::Result<()> {
        let settings = &loaded.settings;
        self.put("about.txt", about(settings).as_bytes())?;
        self.put("settings.txt", settings::table(loaded, false).as_bytes())?;
        let machine = self.machine(settings);
        self.put("machine.txt", machine.as_bytes())?;
        self.journal()?;
        self.state(settings)?;
        self.records(settings)?;
        self.images(settings, images)?;
        let missing = self.missing.join("\n");
        self.put("missing.txt", missing.as_bytes())
    }

    fn put(&mut self, name: &str, content: &[u8]) -> io::Result<()> {
        let mut header = tar::Header::new_gnu();
        header.set_size(content.len() as u64);
        header.set_mode(0o644);
        header.set_mtime(utc_now().0.map_or(0, |utc| utc.unix_s() as u64));
        self.tar.append_data(&mut header, format!("{}/{name}", self.root), content)
    }

    /// Puts what was read, or says why there is nothing.
    fn put_read(&mut self, name: &str, read: Result<Vec<u8>, String>) -> io::Result<()> {
        match read {
            Ok(content) => self.put(name, &content),
            Err(why) => {
                self.missing.push(format!("{name}: {why}"));
                Ok(())
            }
        }
    }

    fn machine(&mut self, settings: &Settings) -> String {
        let mut text = String::new();
        for file in MACHINE {
            match fs::read_to_string(file) {
                Ok(content) => _ = write!(text, "== {file}\n{content}"),
                Err(error) => self.missing.push(format!("{file}: {error}")),
            }
        }
        let mut directories: Vec<PathBuf> =
            vec![(&settings.record.directory).into(), (&settings.commands.ledger_directory).into()];
        directories.extend(settings.record.image_directories().into_iter().map(|(_, directory)| directory));
        for directory in directories.iter().filter(|directory| !directory.as_os_str().is_empty()) {
            match free_bytes(directory) {
                Ok(free) => _ = writeln!(text, "== {}: {:.3} GB free", directory.display(), free as f64 / 1e9),
                Err(error) => self.missing.push(format!("{}: {error}", directory.display())),
            }
        }
        text
    }

    /// What the service said, where systemd keeps it.
    fn journal(&mut self) -> io::Result<()> {
        let asked = Command::new("journalctl")
            .args(["--unit", "stars", "--no-pager", "--output", "short-iso", "--lines", JOURNAL_LINES])
            .output();
        let read = match asked {
            Ok(output) if output.status.success() => Ok(output.stdout),
            Ok(output) => Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()),
            Err(error) => Err(format!("journalctl: {error}")),
        };
        self.put_read("journal.txt", read)
    }

    /// What outlasts a restart, file by file: keys that somebody put beside it stay there.
    fn state(&mut self, settings: &Settings) -> io::Result<()> {
        let directory = &settings.commands.ledger_directory;
        let files = if directory.is_empty() { Vec::new() } else { state_files(Path::new(directory)) };
        for path in files {
            let read = read_file(&path, LONGEST_STATE, "a file of the state").map_err(|error| error.to_string());
            self.put_read(&format!("state/{}", file_name(&path)), read)?;
        }
        Ok(())
    }

    /// The ends of the newest records, whole lines alone, and of the newest journals.
    fn records(&mut self, settings: &Settings) -> io::Result<()> {
        if !settings.record.enabled {
            return Ok(());
        }
        match records_in(Path::new(&settings.record.directory)) {
            Ok(records) => {
                for path in records.iter().rev().take(RECORDS) {
                    self.put_read(&format!("records/{}", file_name(path)), end_of(path).map_err(|error| error.to_string()))?;
                }
            }
            Err(error) => self.missing.push(format!("records: {error:#}")),
        }
        match journals(Path::new(&settings.record.directory)) {
            Ok(journals) => {
                for (path, _) in journals.iter().rev().take(JOURNALS) {
                    let tail = tail_of(path, JOURNAL_TAIL).map(|(_, bytes)| bytes);
                    self.put_read(&format!("records/{}", file_name(path)), tail.map_err(|error| error.to_string()))?;
                }
            }
            Err(error) => self.missing.push(format!("journals: {}: {error}", settings.record.directory)),
        }
        Ok(())
    }

    /// A list of all images on disk, and the newest of them.
    fn images(&mut self, settings: &Settings, newest: usize) -> io::Result<()> {
        let mut list = String::new();
        for (number, (_, directory)) in settings.record.image_directories().into_iter().enumerate() {
            let mut images: Vec<(SystemTime, PathBuf, u64)> = Vec::new();
            for path in self.files_in(&directory) {
                let inside = if path.is_dir() { self.files_in(&path) } else { vec![path] };
                images.extend(inside.into_iter().filter_map(|path| {
                    let meta = fs::metadata(&path).ok().filter(fs::Metadata::is_file)?;
                    Some((meta.modified().unwrap_or(SystemTime::UNIX_EPOCH), path, meta.len()))
                }));
            }
            images.sort();
            for (_, path, bytes) in &images {
                let _ = writeln!(list, "{bytes:>10}  {}", path.display());
            }
            // A second disk has the same ones.
            for (_, path, bytes) in images.iter().rev().take(if number == 0 { newest } else { 0 }) {
                let read = read_file(path, *bytes as usize, "an image").map_err(|error| error.to_string());
                self.put_read(&format!("images/{}", file_name(path)), read)?;
            }
        }
        self.put("images.txt", list.as_bytes())
    }

    /// What a directory holds, in the order of the names.
    fn files_in(&mut self, directory: &Path) -> Vec<PathBuf> {
        match fs::read_dir(directory) {
            Ok(listed) => {
                let mut paths: Vec<PathBuf> = listed.filter_map(|entry| Some(entry.ok()?.path())).collect();
                paths.sort();
                paths
            }
            Err(error) => {
                self.missing.push(format!("{}: {error}", directory.display()));
                Vec::new()
            }
        }
    }
}

/// Which program this is.
fn about(settings: &Settings) -> String {
    let catalogue = Catalogue::embedded()
        .map_or_else(|error| error.to_string(), |catalogue| format!("{:08x}, the one built in", catalogue.header.checksum));
    let built = if cfg!(debug_assertions) { "for tests" } else { "for flight" };
    format!(
        "stars {}, built {built}, {} {}\nprotocol {} to {}, layout {:08x}\ncatalogue {catalogue}\nsettings {:016x}\n",
        env!("CARGO_PKG_VERSION"),
        std::env::consts::OS,
        std::env::consts::ARCH,
        wire::PROTOCOL_MIN,
        wire::PROTOCOL_CURRENT,
        wire::schema_hash(),
        settings.fingerprint(),
    )
}

/// The end of a file, of so many bytes, and whether that is all of it.
fn tail_of(path: &Path, most: u64) -> io::Result<(bool, Vec<u8>)> {
    let mut file = File::open(path)?;
    let first = file.metadata()?.len().saturating_sub(most);
    file.seek(SeekFrom::Start(first))?;
    let mut bytes = Vec::new();
    file.take(most).read_to_end(&mut bytes)?;
    Ok((first == 0, bytes))
}

/// The last lines of a record.
fn end_of(path: &Path) -> io::Result<Vec<u8>> {
    let (is_whole, mut bytes) = tail_of(path, RECORD_TAIL)?;
    if !is_whole {
        let line = bytes.iter().position(|byte| *byte == b'\n').map_or(bytes.len(), |end| end + 1);
        bytes.drain(..line);
    }
    Ok(bytes)
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
