//! The picture of a frame: what `/frame.png` and `stars solve --overlay` give, and the page draws by itself.
//!
//! Sources are squares: blue and turned where they are no star, red and upright where they are one, yellow and named where it is the
//! brightest, orange where a refused candidate would have a star there. The last triangle tried is green, masked blocks are shaded.

use super::font;
use super::frame::{Fate, FrameView, SourceFate};
use super::words::{dms, hms};
use crate::image::{Frame, Level, auto_level, to_grey8};
use crate::sky::DEG;
use crate::solve::Report;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError, Rgb, RgbImage};
use std::path::Path;

const BRIGHTEST: Rgb<u8> = Rgb([255, 220, 60]);
const MATCHED: Rgb<u8> = Rgb([255, 90, 80]);
const CANDIDATE: Rgb<u8> = Rgb([255, 165, 50]);
const UNMATCHED: Rgb<u8> = Rgb([110, 180, 255]);
const TRIANGLE: Rgb<u8> = Rgb([70, 220, 110]);
const BORESIGHT: Rgb<u8> = Rgb([150, 210, 230]);
const WRITING: Rgb<u8> = Rgb([235, 235, 235]);
const BACKGROUND: Rgb<u8> = Rgb([16, 16, 24]);

/// A picture is drawn with lines one pixel thicker, and letters one size larger, for every so many columns.
const COLUMNS_PER_SIZE: usize = 800;
/// Half the length of the arms of the boresight's cross, px of size 1.
const CROSS: f64 = 14.0;
/// Half the side of the square around a source, px of size 1.
const SQUARE: f64 = 9.0;
/// Length of the arrows to North and East, px of size 1.
const ARROW: f64 = 26.0;
/// Rows of one line of the caption, px of size 1.
const LINE: usize = font::HEIGHT + 5;

/// Draws a frame, auto-levelled, with its up direction on top, and what is shown of it.
pub fn draw(frame: &Frame, view: &FrameView) -> RgbImage {
    let size = 1 + frame.width / COLUMNS_PER_SIZE;
    let mut caption = caption(&view.report);
    let columns = (frame.width / size / font::ADVANCE).saturating_sub(2).max(1);
    caption.iter_mut().for_each(|line| *line = line.chars().take(columns).collect());
    let mut canvas = Canvas { picture: levelled(frame, &view.report, caption.len() * LINE * size), size };

    shade(&mut canvas, frame, view);
    triangle(&mut canvas, view);
    for source in &view.sources {
        square(&mut canvas, source);
    }
    label(&mut canvas, frame, &view.sources);
    let centre = ((frame.width as f64 - 1.0) / 2.0, (frame.height as f64 - 1.0) / 2.0);
    canvas.line((centre.0 - CROSS * size as f64, centre.1), (centre.0 + CROSS * size as f64, centre.1), BORESIGHT);
    canvas.line((centre.0, centre.1 - CROSS * size as f64), (centre.0, centre.1 + CROSS * size as f64), BORESIGHT);
    if let Some(compass) = &view.compass {
        arrows(&mut canvas, frame, compass);
    }
    for (line, text) in caption.iter().enumerate() {
        let y = frame.height + (line * LINE + (LINE - font::HEIGHT) / 2) * size;
        canvas.text((font::ADVANCE * size) as f64, y as f64, text, WRITING);
    }
    canvas.picture
}

/// The picture as the bytes of a PNG file.
///
/// # Errors
/// Where the encoder has no room.
pub fn encode(picture: &RgbImage) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Adaptive);
    encoder.write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

fn colour(fate: Fate) -> Rgb<u8> {
    match fate {
        Fate::Brightest => BRIGHTEST,
        Fate::Matched => MATCHED,
        Fate::Candidate => CANDIDATE,
        Fate::Unmatched | Fate::Untried => UNMATCHED,
    }
}

/// The square around a source: upright where it is a star, or would be; turned where it is none.
fn square(canvas: &mut Canvas, source: &SourceFate) {
    let half = SQUARE * canvas.size as f64;
    let turned = matches!(source.fate, Fate::Unmatched | Fate::Untried);
    let corners = if turned {
        [(0.0, -half), (half, 0.0), (0.0, half), (-half, 0.0)]
    } else {
        [(-half, -half), (half, -half), (half, half), (-half, half)]
    };
    canvas.polygon(&corners.map(|(dx, dy)| (source.x + dx, source.y + dy)), colour(source.fate));
}

/// The last triangle tried.
fn triangle(canvas: &mut Canvas, view: &FrameView) {
    let Some(ids) = view.report.triangles.last() else { return };
    let corners: Option<Vec<_>> =
        ids.iter().map(|&id| view.sources.get(usize::from(id)).map(|source| (source.x, source.y))).collect();
    if let Some(corners) = corners {
        canvas.polygon(&corners, TRIANGLE);
    }
}

/// Masked blocks are half as bright.
fn shade(canvas: &mut Canvas, frame: &Frame, view: &FrameView) {
    let Some(mask) = view.mask.as_ref().filter(|mask| mask.enabled) else { return };
    for [column, row] in &mask.masked {
        let bottom = frame.height.saturating_sub(row * mask.block_px);
        let columns = column * mask.block_px..(column + 1) * mask.block_px;
        for y in bottom.saturating_sub(mask.block_px)..bottom {
            for x in columns.clone() {
                if let Some(Rgb(shades)) = canvas.picture.get_pixel_mut_checked(x as u32, y as u32) {
                    shades.iter_mut().for_each(|shade| *shade /= 2);
                }
            }
        }
    }
}

/// Writes names beside their sources, brightest first, where they hide no other name. One that finds no free place is left out.
fn label(canvas: &mut Canvas, frame: &Frame, sources: &[SourceFate]) {
    let size = canvas.size as f64;
    let (width, height) = (frame.width as f64, frame.height as f64);
    let corner = 3.2 * ARROW * size;
    let mut taken = vec![Area { left: width - corner, top: height - corner, right: width, bottom: height }];
    for (source, name) in sources.iter().filter_map(|source| Some((source, source.name.as_ref()?))) {
        let (x, y) = (source.x, source.y);
        let (wide, high) = ((name.chars().count() * font::ADVANCE) as f64 * size, font::HEIGHT as f64 * size);
        let (beside, above) = ((SQUARE + 2.0) * size, (SQUARE + 1.0) * size);
        let corners = [
            (x + beside, y - above),
            (x + beside, y + above - high),
            (x - beside - wide, y - above),
            (x - beside - wide, y + above - high),
            (x - wide / 2.0, y - above - high),
            (x - wide / 2.0, y + above),
        ];
        let areas = corners.map(|(left, top)| Area { left, top, right: left + wide, bottom: top + high });
        let inside = |area: &Area| area.left >= 0.0 && area.top >= 0.0 && area.right < width && area.bottom < height;
        if let Some(area) = areas.into_iter().find(|area| inside(area) && !taken.iter().any(|other| other.overlaps(area))) {
            canvas.text(area.left, area.top, name, colour(source.fate));
            taken.push(area);
        }
    }
}

/// A part of the picture, px.
struct Area {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

impl Area {
    fn overlaps(&self, other: &Self) -> bool {
        self.left < other.right && other.left < self.right && self.top < other.bottom && other.top < self.bottom
    }
}

/// What stands below the picture.
fn caption(report: &Report) -> Vec<String> {
    let image = Path::new(&report.image).file_name().unwrap_or_default().to_string_lossy();
    let found = report.sources_found;
    let pointing = &report.pointing;
    let number = |value: Option<f64>, digits: usize| value.map_or_else(|| "?".to_owned(), |value| format!("{value:.digits$}"));
    let (Some(ra_deg), Some(dec_deg)) = (pointing.ra_deg, pointing.dec_deg) else {
        let reason = report.cause.map_or_else(|| report.reason.to_string(), |cause| format!("{} ({cause})", report.reason));
        return vec![format!("NOT SOLVED: {reason}"), report.detail.clone(), format!("{found} sources   {image}")];
    };
    vec![
        format!("RA {ra_deg:.5}° = {}   Dec {dec_deg:+.5}° = {}", hms(ra_deg * DEG), dms(dec_deg * DEG)),
        format!(
            "roll {}°   σ {}″ {}″ roll {}″   {}″/px",
            number(pointing.roll_deg, 4),
            number(pointing.sigma_east_arcsec, 2),
            number(pointing.sigma_north_arcsec, 2),
            number(pointing.sigma_roll_arcsec, 1),
            number(pointing.platescale_arcsec_px, 4)
        ),
        format!("{} of {found} sources matched   rms {} px   {image}", report.matched, number(pointing.rms_px, 2)),
    ]
}

/// The frame in 8 bits, with `below` empty rows for the caption.
fn levelled(frame: &Frame, report: &Report, below: usize) -> RgbImage {
    let grey = to_grey8(frame, report.stats.level.map_or_else(|| auto_level(frame), |(low, high)| Level { low, high }));
    RgbImage::from_fn(frame.width as u32, (frame.height + below) as u32, |x, y| {
        // Below the frame there is no grey.
        grey.get(y as usize * frame.width + x as usize).map_or(BACKGROUND, |grey| Rgb([*grey; 3]))
    })
}

/// Arrows to North and East in the lower right corner.
fn arrows(canvas: &mut Canvas, frame: &Frame, [north, east]: &[[f64; 2]; 2]) {
    let size = canvas.size as f64;
    let margin = 1.6 * ARROW * size;
    let centre = (frame.width as f64 - margin, frame.height as f64 - margin);
    for ([dx, dy], name) in [(north, "N"), (east, "E")] {
        let (dx, dy) = (dx * ARROW * size, dy * ARROW * size);
        canvas.line(centre, (centre.0 + dx, centre.1 + dy), BORESIGHT);
        let beyond = (centre.0 + 1.3 * dx - 2.0 * size, centre.1 + 1.3 * dy - 3.0 * size);
        canvas.text(beyond.0, beyond.1, name, BORESIGHT);
    }
}

/// A picture to draw on: what falls outside is left out.
struct Canvas {
    picture: RgbImage,
    /// Thickness of lines and of a letter's dots, px.
    size: usize,
}

impl Canvas {
    /// A dot of the canvas' size, its upper left corner at a position.
    fn dot(&mut self, x: f64, y: f64, colour: Rgb<u8>) {
        for step in 0..self.size * self.size {
            let (dx, dy) = ((step % self.size) as f64, (step / self.size) as f64);
            let (x, y) = ((x + dx).round(), (y + dy).round());
            // A cast saturates: what is below 0 or not a number must not land on the border.
            if x >= 0.0
                && y >= 0.0
                && let Some(pixel) = self.picture.get_pixel_mut_checked(x as u32, y as u32)
            {
                *pixel = colour;
            }
        }
    }

    fn line(&mut self, from: (f64, f64), to: (f64, f64), colour: Rgb<u8>) {
        let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs()).ceil().clamp(1.0, 1e5) as u32;
        for step in 0..=steps {
            let part = f64::from(step) / f64::from(steps);
            self.dot(from.0 + (to.0 - from.0) * part, from.1 + (to.1 - from.1) * part, colour);
        }
    }

    /// The outline through these corners, closed.
    fn polygon(&mut self, corners: &[(f64, f64)], colour: Rgb<u8>) {
        let next = corners.iter().cycle().skip(1);
        for (from, to) in corners.iter().zip(next) {
            if [from.0, from.1, to.0, to.1].iter().all(|at| at.is_finite()) {
                self.line(*from, *to, colour);
            }
        }
    }

    /// Writes from an upper left corner on, on a dark ground so that it reads on any sky.
    fn text(&mut self, x: f64, y: f64, text: &str, colour: Rgb<u8>) {
        let size = self.size as f64;
        for (shift, colour) in [(size, BACKGROUND), (0.0, colour)] {
            for (place, letter) in text.chars().enumerate() {
                for (column, row) in font::pixels(letter) {
                    let along = (place * font::ADVANCE + column) as f64;
                    self.dot(x + along * size + shift, y + row as f64 * size + shift, colour);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::frame::tests::view;
    use super::*;
    use crate::settings::MaskSettings;
    use crate::sky::RowOrder;
    use crate::solve::Reason;

    fn frame(rows: RowOrder) -> Frame {
        let mut pixels = vec![100; 200 * 100];
        pixels[0] = 300; // the first pixel of the first row
        Frame::new(200, 100, pixels, rows).unwrap()
    }

    fn drawn(reason: Reason, rows: RowOrder) -> RgbImage {
        draw(&frame(rows), &view(reason, rows, false))
    }

    fn count(picture: &RgbImage, colour: Rgb<u8>) -> usize {
        picture.pixels().filter(|pixel| **pixel == colour).count()
    }

    #[test]
    fn up_is_on_top_whatever_the_order_of_rows() {
        let white = Rgb([255, 255, 255]);
        assert_eq!(*drawn(Reason::NoMatch, RowOrder::BottomFirst).get_pixel(0, 99), white);
        assert_eq!(*drawn(Reason::NoMatch, RowOrder::TopFirst).get_pixel(0, 0), white);
    }

    #[test]
    fn sources_are_squares_where_they_are_seen_in_colour_and_shape_of_their_fate() {
        let picture = drawn(Reason::Solved, RowOrder::BottomFirst);
        // A star's square is upright: its corner is lit. Another's is turned: its tip is, and the corner is not.
        assert_eq!(*picture.get_pixel(50 - 9, 99 - 30 - 9), BRIGHTEST);
        assert_eq!(*picture.get_pixel(150 + 9, 99 - 60), UNMATCHED);
        assert_ne!(*picture.get_pixel(150 + 9, 99 - 60 + 9), UNMATCHED);
        assert!(count(&picture, BRIGHTEST) > 4 * 18, "the name of the star is missing");
        let unsolved = drawn(Reason::NoMatch, RowOrder::BottomFirst);
        assert_eq!((count(&unsolved, BRIGHTEST), count(&unsolved, MATCHED)), (0, 0));
        let refused = drawn(Reason::Requirement, RowOrder::TopFirst);
        assert_eq!(*refused.get_pixel(50 - 9, 30 - 9), CANDIDATE);
        assert!(count(&refused, TRIANGLE) > 100);
    }

    #[test]
    fn masked_blocks_are_half_as_bright() {
        let mut view = view(Reason::NoMatch, RowOrder::TopFirst, false);
        let mask = MaskSettings { enabled: true, block_px: 50, fields: vec![1 << 4] };
        view.mask = view.geometry.map(|geometry| super::super::frame::MaskView::new(&mask, &geometry));
        view.report.stats.level = Some((0, 200));
        view.report.triangles.clear();
        view.sources.clear();
        let picture = draw(&frame(RowOrder::TopFirst), &view);
        // Block 4 is the first of the second row from the bottom: the upper left one here.
        let shade = |x, y| picture.get_pixel(x, y).0[0];
        assert_eq!([shade(49, 49), shade(50, 49), shade(49, 50)], [64, 128, 128]);
    }

    #[test]
    fn east_is_left_of_north_and_mirrors_turn_it_over() {
        // At roll 0 the arrow to East lies left of the arrows' root, or right of it behind a mirror.
        let root = 200.0 - 1.6 * ARROW;
        let left = |mirrored| {
            let picture = draw(&frame(RowOrder::TopFirst), &view(Reason::Solved, RowOrder::TopFirst, mirrored));
            let row = (100.0 - 1.6 * ARROW).round() as u32;
            let lit = |range: std::ops::Range<u32>| range.filter(|x| *picture.get_pixel(*x, row) == BORESIGHT).count();
            (lit(root as u32 - 20..root as u32), lit(root as u32 + 2..root as u32 + 22))
        };
        let (plain, turned) = (left(false), left(true));
        assert!(plain.0 > 15 && plain.1 < 5 && turned.0 < 5 && turned.1 > 15, "{plain:?} {turned:?}");
    }

    #[test]
    fn the_caption_stands_below_and_the_file_is_a_png() {
        let picture = drawn(Reason::Requirement, RowOrder::TopFirst);
        assert!(picture.height() > 100 && count(&picture, WRITING) > 50);
        let bytes = encode(&picture).unwrap();
        let back = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(back, picture);
    }
}
