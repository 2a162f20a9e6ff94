//! Catalogue files: as they are, and with their checksums put right, so that what lies behind those is reached too.
use crc::{CRC_32_ISO_HDLC, Crc};
use stars::catalog::Catalogue;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// Bytes of the header, and where in it the checksums of records and header stand.
const HEADER: usize = 64;
const RECORDS_AT: usize = 24;
const HEADER_AT: usize = 60;

fn examine(bytes: &[u8]) {
    if let Ok(catalogue) = Catalogue::from_bytes(bytes) {
        assert_eq!(catalogue.header.count, catalogue.stars.len());
        for (index, star) in catalogue.stars.iter().enumerate() {
            assert!(star.direction_after(10.0).iter().all(|c| c.is_finite()));
            assert!(!catalogue.name(index).is_empty());
        }
    }
}

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    examine(data);
    if data.len() >= HEADER {
        let mut bytes = data.to_vec();
        let records = CRC.checksum(&bytes[HEADER..]);
        bytes[RECORDS_AT..RECORDS_AT + 4].copy_from_slice(&records.to_le_bytes());
        let header = CRC.checksum(&bytes[..HEADER_AT]);
        bytes[HEADER_AT..HEADER].copy_from_slice(&header.to_le_bytes());
        examine(&bytes);
    }
}
