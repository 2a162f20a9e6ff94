//! Lists of bad pixels: any text is a list or an error, and any list can be applied to any image.
use stars::image::{BadPixels, Frame};
use stars::sky::RowOrder;

const WIDTH: usize = 24;
const HEIGHT: usize = 16;

/// Feeds one input; panics where what must hold does not.
pub fn check(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    if let Ok(list) = BadPixels::parse("fuzz", text) {
        for rows in [RowOrder::BottomFirst, RowOrder::TopFirst] {
            let frame = Frame::new(WIDTH, HEIGHT, (0..(WIDTH * HEIGHT) as u16).collect(), rows);
            assert!(frame.is_some_and(|mut frame| list.apply(&mut frame) <= list.len()));
        }
    }
}
