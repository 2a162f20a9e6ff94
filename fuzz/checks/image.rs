//! Image files: FITS, TIFF, PNG, JPEG. A frame has all its pixels, or there is an error.

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    match stars::image::read("fuzz", data) {
        Ok(frame) => assert_eq!(frame.pixels.len(), frame.width * frame.height),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
