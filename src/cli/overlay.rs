//! The picture that `stars solve --overlay` writes: the frame with its sources, the stars that they are, and the pointing.

use super::font;
use super::text::{dms, hms, reason};
use crate::catalog::Catalogue;
use crate::image::{Frame, Level, auto_level, to_grey8};
use crate::sky::{ARCSEC, CameraModel, DEG, RowOrder, Vec3};
use crate::solve::{Outcome, Solution};
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError, Rgb, RgbImage};
use std::path::Path;

const MATCHED: Rgb<u8> = Rgb([90, 255, 120]);
const UNMATCHED: Rgb<u8> = Rgb([255, 170, 40]);
const BORESIGHT: Rgb<u8> = Rgb([90, 200, 255]);
const WRITING: Rgb<u8> = Rgb([235, 235, 235]);
const BACKGROUND: Rgb<u8> = Rgb([16, 16, 24]);

/// A picture is drawn with lines one pixel thicker, and letters one size larger, for every so many columns.
const COLUMNS_PER_SIZE: usize = 800;
/// Half the length of the arms of the boresight's cross, px of size 1.
const CROSS: f64 = 14.0;
/// Radius of the circle around a source, px of size 1.
const CIRCLE: f64 = 9.0;
/// Length of the arrows to North and East, px of size 1.
const ARROW: f64 = 26.0;
/// Rows of one line of the caption, px of size 1.
const LINE: usize = font::HEIGHT + 5;

/// Draws the frame, auto-levelled, with its up direction on top, and what the outcome says of it.
pub fn draw(frame: &Frame, outcome: &Outcome, catalogue: &Catalogue, mirrored: bool) -> RgbImage {
    let camera =
        CameraModel { width: frame.width, height: frame.height, platescale: ARCSEC, k1: 0.0, rows: frame.rows, mirrored };
    let size = 1 + frame.width / COLUMNS_PER_SIZE;
    let mut caption = caption(outcome);
    let columns = (frame.width / size / font::ADVANCE).saturating_sub(2).max(1);
    caption.iter_mut().for_each(|line| *line = line.chars().take(columns).collect());
    let mut canvas = Canvas { picture: levelled(frame, outcome, caption.len() * LINE * size), size };

    let solution = outcome.solution.as_ref();
    let mut names = Vec::new();
    for (index, source) in outcome.sources.iter().enumerate() {
        let star = solution.and_then(|s| s.matches.iter().find(|pair| pair.source == index));
        let (x, y) = (source.x, on_picture(frame, source.y));
        canvas.circle(x, y, CIRCLE, if star.is_some() { MATCHED } else { UNMATCHED });
        names.extend(star.map(|pair| (x, y, catalogue.name(pair.star))));
    }
    label(&mut canvas, frame, &names);
    let centre = ((frame.width as f64 - 1.0) / 2.0, (frame.height as f64 - 1.0) / 2.0);
    canvas.line((centre.0 - CROSS * size as f64, centre.1), (centre.0 + CROSS * size as f64, centre.1), BORESIGHT);
    canvas.line((centre.0, centre.1 - CROSS * size as f64), (centre.0, centre.1 + CROSS * size as f64), BORESIGHT);
    if let Some(solution) = solution {
        compass(&mut canvas, frame, &camera, solution);
    }
    for (line, text) in caption.iter().enumerate() {
        let y = frame.height + (line * LINE + (LINE - font::HEIGHT) / 2) * size;
        canvas.text((font::ADVANCE * size) as f64, y as f64, text, WRITING);
    }
    canvas.picture
}

/// The picture as the bytes of a PNG file.
pub fn encode(picture: &RgbImage) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let encoder = PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive);
    encoder.write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::Rgb8)?;
    Ok(bytes)
}

/// Writes names beside their sources, brightest first, where they hide no other name. One that finds no free place is left out.
fn label(canvas: &mut Canvas, frame: &Frame, names: &[(f64, f64, String)]) {
    let size = canvas.size as f64;
    let (width, height) = (frame.width as f64, frame.height as f64);
    let corner = 3.2 * ARROW * size;
    let mut taken = vec![Area { left: width - corner, top: height - corner, right: width, bottom: height }];
    for (x, y, name) in names {
        let (wide, high) = ((name.chars().count() * font::ADVANCE) as f64 * size, font::HEIGHT as f64 * size);
        let (beside, above) = ((CIRCLE + 2.0) * size, (CIRCLE + 1.0) * size);
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
            canvas.text(area.left, area.top, name, MATCHED);
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
fn caption(outcome: &Outcome) -> Vec<String> {
    let found = outcome.sources.len();
    let image = Path::new(&outcome.stamp.origin).file_name().unwrap_or_default().to_string_lossy();
    let Some(solution) = &outcome.solution else {
        return vec![format!("NOT SOLVED: {}", reason(outcome)), outcome.detail.clone(), format!("{found} sources   {image}")];
    };
    let (ra, dec, roll) = solution.served_attitude().angles();
    let sigmas = solution.sigmas() / ARCSEC;
    vec![
        format!("RA {:.5}° = {}   Dec {:+.5}° = {}", ra / DEG, hms(ra), dec / DEG, dms(dec)),
        format!(
            "roll {:.4}°   σ {:.2}″ {:.2}″ roll {:.1}″   {:.4}″/px",
            roll / DEG,
            sigmas.x,
            sigmas.y,
            sigmas.z,
            solution.platescale / ARCSEC
        ),
        format!("{} of {found} sources matched   rms {:.2} px   {image}", solution.matches.len(), solution.rms_px),
    ]
}

/// The row of the picture that a row of the file is.
fn on_picture(frame: &Frame, y: f64) -> f64 {
    if frame.rows == RowOrder::BottomFirst { frame.height as f64 - 1.0 - y } else { y }
}

/// The frame in 8 bits, with `below` empty rows for the caption.
fn levelled(frame: &Frame, outcome: &Outcome, below: usize) -> RgbImage {
    let level = outcome.statistics.as_ref().map(|statistics| statistics.level);
    let grey = to_grey8(frame, level.map_or_else(|| auto_level(frame), |(low, high)| Level { low, high }));
    RgbImage::from_fn(frame.width as u32, (frame.height + below) as u32, |x, y| {
        // Below the frame there is no grey.
        grey.get(y as usize * frame.width + x as usize).map_or(BACKGROUND, |grey| Rgb([*grey; 3]))
    })
}

/// Arrows to North and East in the lower right corner.
fn compass(canvas: &mut Canvas, frame: &Frame, camera: &CameraModel, solution: &Solution) {
    let size = canvas.size as f64;
    let margin = 1.6 * ARROW * size;
    let centre = (frame.width as f64 - margin, frame.height as f64 - margin);
    let boresight = solution.attitude.boresight();
    let east = Vec3::z().cross(&boresight);
    for (towards, name) in [(boresight.cross(&east), "N"), (east, "E")] {
        let seen = solution.attitude.to_camera(&towards);
        let length = seen.x.hypot(seen.y);
        if length > 0.0 {
            let step = ARROW * size / length;
            let (x, y) = camera.position(seen.x * step, seen.y * step);
            let (x0, y0) = camera.position(0.0, 0.0);
            let (dx, dy) = (x - x0, on_picture(frame, y) - on_picture(frame, y0));
            canvas.line(centre, (centre.0 + dx, centre.1 + dy), BORESIGHT);
            let beyond = (centre.0 + 1.3 * dx - 2.0 * size, centre.1 + 1.3 * dy - 3.0 * size);
            canvas.text(beyond.0, beyond.1, name, BORESIGHT);
        }
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

    /// `radius` in px of size 1.
    fn circle(&mut self, x: f64, y: f64, radius: f64, colour: Rgb<u8>) {
        let radius = radius * self.size as f64;
        let steps = (8.0 * radius).ceil() as u32;
        for step in 0..steps {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(step) / f64::from(steps)).sin_cos();
            self.dot(x + radius * cos, y + radius * sin, colour);
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
    use super::*;
    use crate::catalog::{CatalogueHeader, Star};
    use crate::image::Stamp;
    use crate::sky::{Attitude, Mat3};
    use crate::solve::{Match, Reason, SourceReport, Statistics};

    fn frame(rows: RowOrder) -> Frame {
        let mut pixels = vec![100; 200 * 100];
        pixels[0] = 300; // the first pixel of the first row
        Frame::new(200, 100, pixels, rows).unwrap()
    }

    fn outcome(solved: bool) -> Outcome {
        let source = |x, y| SourceReport { x, y, sigma_px: 0.1, flux: 1.0, snr: 9.0, peak: 1.0, saturated: false };
        let solution = Solution {
            attitude: Attitude::from_angles(1.0, 0.5, 0.0),
            platescale: 9.5 * ARCSEC,
            k1: 0.0,
            axis: (0.0, 0.0),
            covariance: Mat3::identity(),
            sigma_platescale: 0.0,
            rms_px: 0.1,
            chi2_per_dof: 1.0,
            matches: vec![Match { source: 0, star: 0, residual_px: (0.0, 0.0) }],
            false_probability_log10: -9.0,
            horizontal: None,
            epoch_yr: None,
            start: None,
            served: None,
        };
        Outcome {
            sources: vec![source(50.0, 30.0), source(150.0, 60.0), source(-1e9, f64::NAN)],
            solution: solved.then_some(solution),
            statistics: Some(Statistics { level: (100, 300), ..Statistics::default() }),
            ..Outcome::unsolved(Stamp::default(), if solved { Reason::Solved } else { Reason::NoMatch }, "no pattern fits")
        }
    }

    fn catalogue() -> Catalogue {
        let star = Star { ra: 1.0, dec: 0.5, pm_ra: 0.0, pm_dec: 0.0, mag: 1.0, hip: 0 };
        Catalogue {
            header: CatalogueHeader { format: 1, epoch_yr: 2016.0, count: 1, checksum: 0, origin: String::new() },
            stars: vec![star],
        }
    }

    fn count(picture: &RgbImage, colour: Rgb<u8>) -> usize {
        picture.pixels().filter(|pixel| **pixel == colour).count()
    }

    #[test]
    fn up_is_on_top_whatever_the_order_of_rows() {
        let white = Rgb([255, 255, 255]);
        let of = |rows| draw(&frame(rows), &outcome(false), &catalogue(), false);
        assert_eq!(*of(RowOrder::BottomFirst).get_pixel(0, 99), white);
        assert_eq!(*of(RowOrder::TopFirst).get_pixel(0, 0), white);
    }

    #[test]
    fn sources_are_circled_where_they_are_seen_and_in_the_colour_of_their_fate() {
        let picture = draw(&frame(RowOrder::BottomFirst), &outcome(true), &catalogue(), false);
        assert_eq!(*picture.get_pixel(50 + 9, 99 - 30), MATCHED);
        assert_eq!(*picture.get_pixel(150 + 9, 99 - 60), UNMATCHED);
        let unsolved = draw(&frame(RowOrder::BottomFirst), &outcome(false), &catalogue(), false);
        assert_eq!(count(&unsolved, MATCHED), 0);
        assert!(count(&picture, MATCHED) > count(&picture, UNMATCHED), "the name of the star is missing");
    }

    #[test]
    fn east_is_left_of_north_and_mirrors_turn_it_over() {
        // At roll 0 the arrow to East lies left of the arrows' root, or right of it behind a mirror.
        let root = 200.0 - 1.6 * ARROW;
        let left = |mirrored| {
            let picture = draw(&frame(RowOrder::TopFirst), &outcome(true), &catalogue(), mirrored);
            let row = (100.0 - 1.6 * ARROW).round() as u32;
            let lit = |range: std::ops::Range<u32>| range.filter(|x| *picture.get_pixel(*x, row) == BORESIGHT).count();
            (lit(root as u32 - 20..root as u32), lit(root as u32 + 2..root as u32 + 22))
        };
        let (plain, turned) = (left(false), left(true));
        assert!(plain.0 > 15 && plain.1 < 5 && turned.0 < 5 && turned.1 > 15, "{plain:?} {turned:?}");
    }

    #[test]
    fn the_caption_stands_below_and_the_file_is_a_png() {
        let picture = draw(&frame(RowOrder::TopFirst), &outcome(false), &catalogue(), false);
        assert!(picture.height() > 100 && count(&picture, WRITING) > 50);
        let bytes = encode(&picture).unwrap();
        let back = image::load_from_memory(&bytes).unwrap().to_rgb8();
        assert_eq!(back, picture);
    }
}
