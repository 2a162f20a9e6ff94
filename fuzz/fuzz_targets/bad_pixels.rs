//! Lists of bad pixels: any text is a list or an error, and any list can be applied to any image.
#![no_main]

use libfuzzer_sys::fuzz_target;
use stars::image::BadPixels;

const WIDTH: usize = 24;
const HEIGHT: usize = 16;

fuzz_target!(|data: &[u8]| {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(list) = BadPixels::parse("fuzz", text) {
        let mut pixels: Vec<u16> = (0..(WIDTH * HEIGHT) as u16).collect();
        assert!(list.apply(&mut pixels, WIDTH, HEIGHT) <= list.len());
    }
});
