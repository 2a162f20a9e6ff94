//! A look at a TIFF's tags before they are decoded: the decoder makes room for as many values as a tag claims, up to 256 MB,
//! before it looks whether the file has them.

use super::read::Problem;

/// Most values that one tag may have: offsets of the strips of a very large image, and more.
const MAX_VALUES: u64 = 1 << 20;
/// Most tags that are looked at; the standard has under two hundred.
const MAX_TAGS: u64 = 4096;

/// Refuses a file in which a tag of the first image claims more values than the file can hold.
pub(super) fn check_tags(bytes: &[u8]) -> Result<(), Problem> {
    let cut = |need: u64| Problem::Cut { what: "the TIFF's tags", need: need as usize, got: bytes.len() };
    let order = if bytes.starts_with(b"MM") { Order::Big } else { Order::Little };
    let number = |at: u64, length: u64| order.read(bytes, at, length).ok_or_else(|| cut(at.saturating_add(length)));
    // BigTIFF (43) has 64-bit offsets and counts where TIFF (42) has 32 and 16.
    let big = number(2, 2)? == 43;
    let (directory, count_length, entry_length) = if big { (number(8, 8)?, 8, 20) } else { (number(4, 4)?, 2, 12) };
    let tags = number(directory, count_length)?;
    if tags > MAX_TAGS {
        return Err(refused(format!("{tags} tags, at most {MAX_TAGS} are read")));
    }
    for index in 0..tags {
        let entry = directory.saturating_add(count_length + index * entry_length);
        let (tag, kind) = (number(entry, 2)?, number(entry.saturating_add(2), 2)?);
        let values = number(entry.saturating_add(4), if big { 8 } else { 4 })?;
        let need = values.saturating_mul(value_length(kind));
        if values > MAX_VALUES || need > bytes.len() as u64 {
            return Err(refused(format!("tag {tag} claims {values} values in a file of {} bytes", bytes.len())));
        }
    }
    Ok(())
}

fn refused(message: String) -> Problem {
    Problem::Decoder { format: "TIFF", message }
}

/// Bytes of one value of a type (TIFF 6.0, section 2; BigTIFF's 16 to 18); at least one for a type that is not known.
fn value_length(kind: u64) -> u64 {
    match kind {
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 | 16..=18 => 8,
        _ => 1,
    }
}

#[derive(Clone, Copy)]
enum Order {
    Little,
    Big,
}

impl Order {
    /// An unsigned number of `length` bytes, at most 8.
    fn read(self, bytes: &[u8], at: u64, length: u64) -> Option<u64> {
        let start = usize::try_from(at).ok()?;
        let digits = bytes.get(start..start.checked_add(length as usize)?)?;
        let join = |number: u64, byte: &u8| number << 8 | u64::from(*byte);
        Some(match self {
            Self::Little => digits.iter().rev().fold(0, join),
            Self::Big => digits.iter().fold(0, join),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file with one tag: its type and the number of values that it claims.
    fn classic(kind: u16, values: u32) -> Vec<u8> {
        let mut bytes = b"II\x2a\0\x08\0\0\0\x01\0\0\x01".to_vec();
        bytes.extend(kind.to_le_bytes());
        bytes.extend(values.to_le_bytes());
        bytes.extend([0; 8]);
        bytes
    }

    fn big(values: u64) -> Vec<u8> {
        let mut bytes = b"MM\0\x2b\0\x08\0\0".to_vec();
        bytes.extend(16_u64.to_be_bytes());
        bytes.extend(1_u64.to_be_bytes());
        bytes.extend([1, 0, 0, 16]);
        bytes.extend(values.to_be_bytes());
        bytes.extend([0; 8]);
        bytes
    }

    #[test]
    fn honest_tags_pass() {
        assert_eq!(check_tags(&classic(3, 1)), Ok(()));
        assert_eq!(check_tags(&big(1)), Ok(()));
    }

    #[test]
    fn a_tag_that_claims_more_values_than_the_file_has_is_refused() {
        for bytes in [classic(3, 3_276_842), classic(4, 8), big(u64::MAX), big(6)] {
            assert!(matches!(check_tags(&bytes), Err(Problem::Decoder { .. })), "{bytes:?}");
        }
    }

    #[test]
    fn a_file_cut_anywhere_in_its_tags_is_refused() {
        for whole in [classic(3, 1), big(1)] {
            let tags_end = whole.len() - 8;
            for length in 0..tags_end {
                assert!(matches!(check_tags(&whole[..length]), Err(Problem::Cut { .. })), "{length}");
            }
        }
    }
}
