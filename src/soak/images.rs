//! What is on the disk for images: what must be there, and whether all of it is whole.

use crate::image::{checksum_holds, read, series_stem};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The newest images, which no rule of thinning takes where the disk has room for twice as many: some fewer than are spared.
const NEWEST: usize = 40;

/// The files under a directory of days.
fn files(directory: &Path) -> Vec<PathBuf> {
    let within = |directory: &Path| std::fs::read_dir(directory).into_iter().flatten().flatten().map(|entry| entry.path());
    within(directory).filter(|day| day.is_dir()).flat_map(|day| within(&day).collect::<Vec<_>>()).collect()
}

/// How many exposures are there of each image of a run of the service, by the number of its start, which is part of their names; and how many
/// of its newest images must be among them.
pub fn of_run(directory: &Path, boot: u32) -> (BTreeMap<u32, u8>, u32) {
    let (boot, files) = (format!("{boot:08x}"), files(directory));
    let number = |file: &PathBuf| {
        let name = file.file_stem()?.to_str()?;
        let mut parts = series_stem(name).map_or(name, |(stem, _)| stem).rsplit('-');
        let number: u32 = parts.next()?.parse().ok()?;
        (parts.next()? == boot).then_some(number)
    };
    let mut exposures = BTreeMap::new();
    files.iter().filter_map(number).for_each(|image| *exposures.entry(image).or_default() += 1);
    // A small disk has room for fewer than are spared elsewhere, and keeps some of earlier runs besides.
    (exposures, NEWEST.min(files.len() / 2) as u32)
}

/// How many files there are, what they take, bytes, and which of them are not whole images, in words.
pub fn judge(directory: &Path) -> (usize, u64, Vec<String>) {
    let (files, mut bytes, mut broken) = (files(directory), 0, Vec::new());
    for file in &files {
        let name = file.display();
        match std::fs::read(file) {
            Err(error) => broken.push(format!("{name}: {error}")),
            Ok(content) => {
                bytes += content.len() as u64;
                if checksum_holds(&content) != Some(true) {
                    broken.push(format!("{name}: its checksum does not hold"));
                } else if let Err(error) = read(&name.to_string(), &content) {
                    broken.push(error.to_string());
                }
            }
        }
    }
    (files.len(), bytes, broken)
}
