//! Image files: FITS, TIFF, PNG, JPEG. A frame has all its pixels, or there is an error.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    match stars::image::read("fuzz", data) {
        Ok(frame) => assert_eq!(frame.pixels.len(), frame.width * frame.height),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
});
