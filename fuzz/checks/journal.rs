//! A journal: the bytes of a file, and an entry behind a right length and checksum. What is read of it is read again as it was, and every byte
//! is either of an entry or counted as skipped.

use stars::journal::{Entry, Reader, Writer};

fn read(bytes: &[u8]) -> Vec<Entry> {
    let mut reader = Reader::new(bytes);
    let entries: Vec<Entry> = reader.by_ref().collect();
    assert!(reader.skipped() <= bytes.len());
    assert!(!entries.is_empty() || reader.skipped() == bytes.len());
    entries
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let mut framed = b"STJ1".to_vec();
    framed.extend((data.len() as u32).to_le_bytes());
    framed.extend(crc32fast::hash(data).to_le_bytes());
    framed.extend(data);
    for bytes in [data, &framed] {
        let entries = read(bytes);
        let mut writer = Writer::default();
        entries.iter().for_each(|entry| writer.add(entry));
        let again = writer.take();
        // As text: what is no number is not like itself.
        assert_eq!(format!("{:?}", read_all(&again)), format!("{entries:?}"));
    }
}

fn read_all(bytes: &[u8]) -> Vec<Entry> {
    Reader::new(bytes).collect()
}
