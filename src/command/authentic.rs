//! Authentication of command blocks: HMAC-SHA-256 (RFC 2104, FIPS 198-1) with a key for each flight computer.

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// Bytes of a key: as many as the digest has (FIPS 198-1 §3).
pub const KEY_BYTES: usize = 32;
/// Bytes of a code of authentication.
pub const TAG_BYTES: usize = 32;

/// A key that a flight computer and the camera share.
#[derive(Clone)]
pub struct Key(Hmac<Sha256>);

/// Why a text is no key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// Other than as many hexadecimal digits as a key has.
    #[error("a key is {n} hexadecimal digits", n = 2 * KEY_BYTES)]
    NotHex,
}

/// Never the key itself: this goes into logs.
impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Key")
    }
}

impl Key {
    /// A key from the text of its file: 64 hexadecimal digits, white space around them ignored.
    ///
    /// # Errors
    /// See [`KeyError`].
    pub fn parse(text: &str) -> Result<Self, KeyError> {
        let digits: Option<Vec<u32>> = text.trim().chars().map(|digit| digit.to_digit(16)).collect();
        let digits = digits.filter(|digits| digits.len() == 2 * KEY_BYTES).ok_or(KeyError::NotHex)?;
        let bytes: Vec<u8> =
            digits.chunks_exact(2).map(|pair| pair.iter().fold(0, |byte, digit| byte << 4 | *digit as u8)).collect();
        Hmac::new_from_slice(&bytes).map(Self).map_err(|_| KeyError::NotHex)
    }

    /// The code of a message.
    pub fn tag(&self, message: &[u8]) -> [u8; TAG_BYTES] {
        self.0.clone().chain_update(message).finalize().into_bytes().into()
    }

    /// Whether a code is that of a message; takes as long for a wrong one as for the right one.
    pub fn verifies(&self, message: &[u8], tag: &[u8; TAG_BYTES]) -> bool {
        self.0.clone().chain_update(message).verify(tag.into()).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hex(bytes: &[u8]) -> String {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }

    #[test]
    fn a_code_is_that_of_the_standard_s_own_example() {
        // NIST's example for HMAC-SHA-256 with a key shorter than a block is of 32 bytes: 00 01 … 1f.
        let key: String = (0..32u8).map(|byte| format!("{byte:02x}")).collect();
        let tag = Key::parse(&format!(" {key}\n")).unwrap().tag(b"Sample message for keylen<blocklen");
        assert_eq!(hex(&tag), "a28cf43130ee696a98f14a37678b56bcfcbdd9e5cf69717fecf5480f0ebdf790");
    }

    #[test]
    fn any_other_bit_of_message_key_or_code_is_refused() {
        let key = Key::parse(&"5a".repeat(32)).unwrap();
        let other = Key::parse(&format!("5b{}", "5a".repeat(31))).unwrap();
        let tag = key.tag(b"block");
        assert!(key.verifies(b"block", &tag) && !other.verifies(b"block", &tag) && !key.verifies(b"blocl", &tag));
        for bit in 0..256 {
            let mut wrong = tag;
            wrong[bit / 8] ^= 1 << (bit % 8);
            assert!(!key.verifies(b"block", &wrong));
        }
    }

    #[test]
    fn what_is_no_key_is_refused_and_a_key_is_never_shown() {
        for text in ["", "00", &"0".repeat(63), &"0".repeat(66), &"g".repeat(64)] {
            assert!(matches!(Key::parse(text), Err(KeyError::NotHex)), "{text}");
        }
        assert_eq!(format!("{:?}", Key::parse(&"ab".repeat(32)).unwrap()), "Key");
    }
}
