//! Records: entries as bytes of a file that may be torn anywhere.
//!
//! | bytes | what |
//! |---|---|
//! | 4 | `STJ1` |
//! | 4 | length of the entry, bytes, little-endian |
//! | 4 | CRC-32 (IEEE) of the entry, little-endian |
//! | length | the entry, postcard |

use super::entry::Entry;

/// What every record begins with.
const MARK: &[u8; 4] = b"STJ1";
/// Bytes before an entry.
const HEAD: usize = 12;
/// No run of the program takes longer, s: a century. What says so is no entry, and times beyond could not be added up.
const LONGEST_RUN_S: u64 = 100 * 366 * 86_400;
/// No entry is longer, bytes: settings are the longest, and have a limit of their own; a motion has some thousand samples.
const LONGEST: usize = 4 << 20;

/// Makes records.
#[derive(Debug, Default)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// Appends the record of an entry; one that cannot be written, which none is, leaves nothing.
    pub fn add(&mut self, entry: &Entry) {
        let Ok(body) = postcard::to_stdvec(entry) else { return };
        let Some(length) = u32::try_from(body.len()).ok().filter(|_| body.len() <= LONGEST) else { return };
        self.bytes.extend(MARK);
        self.bytes.extend(length.to_le_bytes());
        self.bytes.extend(crc32fast::hash(&body).to_le_bytes());
        self.bytes.extend(body);
    }

    /// The records made since they were last taken.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.bytes)
    }
}

/// Finds the entries of a journal; what is no whole record is skipped and counted.
#[derive(Debug)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    skipped: usize,
}

impl<'a> Reader<'a> {
    /// Of all bytes of a journal.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, skipped: 0 }
    }

    /// Bytes that belonged to no whole record, by now.
    pub fn skipped(&self) -> usize {
        self.skipped
    }

    /// The entry that the bytes begin with, and what it takes.
    fn first(&self) -> Option<(Entry, usize)> {
        let (head, rest) = self.bytes.split_at_checked(HEAD)?;
        let (mark, numbers) = head.split_at_checked(MARK.len())?;
        let (length, sum) = numbers.split_first_chunk::<4>()?;
        let body = rest.get(..u32::from_le_bytes(*length) as usize).filter(|body| body.len() <= LONGEST)?;
        let whole = mark == MARK && crc32fast::hash(body).to_le_bytes() == sum;
        let entry: Entry = if whole { postcard::from_bytes(body).ok()? } else { return None };
        (entry.at.as_secs() < LONGEST_RUN_S).then_some((entry, HEAD + body.len()))
    }

    fn skip(&mut self, count: usize) {
        self.skipped += count;
        self.bytes = self.bytes.get(count..).unwrap_or_default();
    }
}

impl Iterator for Reader<'_> {
    type Item = Entry;

    fn next(&mut self) -> Option<Entry> {
        while !self.bytes.is_empty() {
            if let Some((entry, length)) = self.first() {
                self.bytes = self.bytes.get(length..).unwrap_or_default();
                return Some(entry);
            }
            // On to the next place where one may begin.
            let next = self.bytes.windows(MARK.len()).skip(1).position(|bytes| bytes == MARK);
            self.skip(next.map_or(self.bytes.len(), |place| place + 1));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::What;
    use std::time::Duration;

    fn entries() -> Vec<Entry> {
        (1..6).map(|n| Entry { at: Duration::from_millis(u64::from(n)), what: What::Lost(n * 1000) }).collect()
    }

    fn written() -> Vec<u8> {
        let mut writer = Writer::default();
        entries().iter().for_each(|entry| writer.add(entry));
        writer.take()
    }

    #[test]
    fn a_journal_that_is_torn_anywhere_gives_every_whole_entry_and_counts_the_rest() {
        let bytes = written();
        for end in 0..=bytes.len() {
            let torn = &bytes[..end];
            let mut reader = Reader::new(torn);
            let read: Vec<Entry> = reader.by_ref().collect();
            assert_eq!(read, entries()[..read.len()]);
            let whole: usize = {
                let mut writer = Writer::default();
                read.iter().for_each(|entry| writer.add(entry));
                writer.take().len()
            };
            assert_eq!(reader.skipped(), end - whole, "{end}");
        }
        assert_eq!(Reader::new(&bytes).count(), 5);
    }

    #[test]
    fn a_byte_that_changed_costs_its_own_entry_alone() {
        let bytes = written();
        for place in 0..bytes.len() {
            let mut spoilt = bytes.clone();
            spoilt[place] ^= 0x20;
            let mut reader = Reader::new(&spoilt);
            let read: Vec<Entry> = reader.by_ref().collect();
            assert_eq!(read.len(), 4, "{place}");
            assert!(read.iter().all(|entry| entries().contains(entry)) && reader.skipped() > 0);
        }
    }

    #[test]
    fn what_lies_about_its_length_is_no_record() {
        let mut bytes = MARK.to_vec();
        bytes.extend(u32::MAX.to_le_bytes());
        bytes.extend([0; 20]);
        let mut reader = Reader::new(&bytes);
        assert_eq!((reader.next(), reader.skipped()), (None, 32 - 4));
    }
}
