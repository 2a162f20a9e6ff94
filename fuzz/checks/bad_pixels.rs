//! Lists of bad pixels: any text is a list or an error, and any list can be applied to any image.
use stars::image::BadPixels;

const WIDTH: usize = 24;
const HEIGHT: usize = 16;

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(list) = BadPixels::parse("fuzz", text) {
        let mut pixels: Vec<u16> = (0..(WIDTH * HEIGHT) as u16).collect();
        assert!(list.apply(&mut pixels, WIDTH, HEIGHT) <= list.len());
    }
}
