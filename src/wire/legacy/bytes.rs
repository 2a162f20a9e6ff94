//! Numbers by their offset in a struct. Beyond its end there is nothing: reading gives zero, writing does nothing; tests hold
//! every offset to lie within.

/// The bytes of a number at an offset.
fn at<const N: usize>(bytes: &[u8], offset: usize) -> [u8; N] {
    bytes.get(offset..).and_then(|rest| rest.first_chunk()).copied().unwrap_or([0; N])
}

/// A whole number with a sign.
pub fn i32_at(bytes: &[u8], offset: usize) -> i32 {
    i32::from_le_bytes(at(bytes, offset))
}

/// A whole number.
pub fn u32_at(bytes: &[u8], offset: usize) -> u32 {
    u32::from_le_bytes(at(bytes, offset))
}

/// A number of 32 bits.
pub fn f32_at(bytes: &[u8], offset: usize) -> f32 {
    f32::from_le_bytes(at(bytes, offset))
}

/// A number.
pub fn f64_at(bytes: &[u8], offset: usize) -> f64 {
    f64::from_le_bytes(at(bytes, offset))
}

/// A byte.
pub fn u8_at(bytes: &[u8], offset: usize) -> u8 {
    u8::from_le_bytes(at(bytes, offset))
}

/// Writes a number, least byte first.
pub fn put<const N: usize>(bytes: &mut [u8], offset: usize, number: [u8; N]) {
    if let Some(place) = bytes.get_mut(offset..).and_then(|rest| rest.first_chunk_mut()) {
        *place = number;
    }
}
