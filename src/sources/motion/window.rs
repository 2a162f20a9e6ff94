//! What a fit along trails looks at: the light of a star in one exposure as a table, and the pixels around it.

use super::{Trail, centre, ends};
use crate::image::{CELL_PX, CellStatistics, Frame};
use crate::sky::{Kernel, with_vectors};

/// Width of a star without motion, px, as real frames have it.
const STAR_SIGMA_PX: f64 = 1.0;
/// Samples of a trail's table along a pixel.
const FINE: usize = 4;
/// Reach of a star's light beyond its way, px.
const LIGHT_PX: f64 = 4.5;
/// Reach of the sky that its level is told from, px: the wider, the less of a faint star's signal goes into the level, and the more of a
/// dust disc's edge.
const SKY_PX: f64 = 7.0;
/// A pixel this many times the noise above all its neighbours is clipped.
const SPIKE_SIGMAS: f32 = 3.0;
/// An exposure with what a search needs of it.
pub(super) struct Exposed<'a> {
    frame: &'a Frame,
    cells: &'a CellStatistics,
    pub(super) trail: &'a Trail,
    pub(super) table: Table,
    /// The mean of the trail's places.
    middle: (f64, f64),
}

impl<'a> Exposed<'a> {
    pub(super) fn new(frame: &'a Frame, cells: &'a CellStatistics, trail: &'a Trail) -> Self {
        Self { frame, cells, trail, table: Table::of(trail), middle: trail.middle() }
    }

    /// Where a star is in this exposure, that is at a place at the origin.
    fn star_at(&self, at: (f64, f64)) -> (f64, f64) {
        let centre = centre(self.frame.width, self.frame.height);
        let (x, y) = self.trail.spun(at, centre);
        let more = self.trail.stretch.of(self.middle, (at.0 - centre.0, at.1 - centre.1));
        (x + more.0, y + more.1)
    }
}

/// The light of a star on the picture of one exposure: a table of its density per px² around the star's way, and where its sky is.
pub(super) struct Table {
    /// Offset of the first sample from the star's origin, px.
    x0: f64,
    y0: f64,
    /// Columns and rows, px.
    width: usize,
    height: usize,
    /// [`FINE`] samples to the pixel, either way: those of one place within the pixel are together, pixel by pixel, one place after another.
    planes: Vec<f32>,
    /// Of each pixel 1 where it is near the way, and 0 elsewhere.
    near: Vec<f32>,
    pub(super) highest: f32,
}

impl Table {
    fn of(trail: &Trail) -> Self {
        let span = |part: fn(&(f64, f64)) -> f64| {
            let (low, high) = ends(trail.places.iter().map(part));
            (low - SKY_PX, (high - low + 2.0 * SKY_PX).ceil() as usize + 1)
        };
        let ((x0, width), (y0, height)) = (span(|p| p.0), span(|p| p.1));
        let mut table = Self { x0, y0, width, height, planes: Vec::new(), near: vec![0.0; width * height], highest: 0.0 };
        let fine = table.shine(trail);
        table.highest = fine.iter().copied().fold(0.0, f32::max);
        for (py, px) in (0..FINE).flat_map(|py| (0..FINE).map(move |px| (py, px))) {
            for row in fine.chunks_exact(width * FINE).skip(py).step_by(FINE) {
                table.planes.extend(row.iter().skip(px).step_by(FINE));
            }
        }
        for &(x, y) in &trail.places {
            let (column, row) = (x - x0 - 0.5, y - y0 - 0.5);
            let reach = |middle: f64, most: usize| {
                (middle - SKY_PX).ceil().max(0.0) as usize..((middle + SKY_PX).floor().max(0.0) as usize + 1).min(most)
            };
            for j in reach(row, height) {
                for i in reach(column, width) {
                    let distance_sq = (i as f64 - column).powi(2) + (j as f64 - row).powi(2);
                    if distance_sq <= SKY_PX * SKY_PX {
                        table.near[j * width + i] = 1.0;
                    }
                }
            }
        }
        table
    }

    /// The light of all places, row by row of fine samples.
    fn shine(&self, trail: &Trail) -> Vec<f32> {
        let fine = FINE as f64;
        // A pixel takes the light of its whole square.
        let variance = STAR_SIGMA_PX * STAR_SIGMA_PX + 1.0 / 12.0;
        let weight = trail.share / trail.places.len().max(1) as f64 / (std::f64::consts::TAU * variance);
        let falls = |place: f64, first: f64, count: usize| -> (usize, Vec<f64>) {
            let from = (((place - LIGHT_PX - first) * fine).ceil().max(0.0) as usize).min(count);
            let to = (((place + LIGHT_PX - first) * fine).floor().max(0.0) as usize + 1).min(count);
            let fall = |i: usize| libm::exp(-0.5 * (first + i as f64 / fine - place).powi(2) / variance);
            (from, (from..to).map(fall).collect())
        };
        let (columns, rows) = (self.width * FINE, self.height * FINE);
        let mut samples = vec![0.0; columns * rows];
        for &(x, y) in &trail.places {
            let ((column, across), (row, down)) = (falls(x, self.x0, columns), falls(y, self.y0, rows));
            for (j, down) in down.iter().enumerate() {
                let line = &mut samples[(row + j) * columns + column..][..across.len()];
                line.iter_mut().zip(&across).for_each(|(sample, across)| *sample += (weight * down * across) as f32);
            }
        }
        samples
    }

    /// Where fine sample `at` lies: the plane's place within the pixel, and the pixel.
    fn phase(at: isize) -> (usize, isize) {
        (at.rem_euclid(FINE as isize) as usize, at.div_euclid(FINE as isize))
    }

    /// A row of a plane.
    fn row(&self, (py, px): (usize, usize), row: usize) -> &[f32] {
        &self.planes[((py * FINE + px) * self.height + row) * self.width..][..self.width]
    }
}

/// The pixels that a star lights in one exposure, and the sky beside them, in a box around its way.
pub(super) struct Window<'a> {
    exposed: &'a Exposed<'a>,
    /// Column and row of the first pixel.
    left: usize,
    top: usize,
    width: usize,
    /// Values over the mean of the star's surroundings with lone hot pixels clipped, ADU; nought further off.
    values: Vec<f32>,
    /// Pixels that are near, and the sum of their squares.
    pub(super) near: f64,
    pub(super) squares: f64,
    /// 1/σ² of a value.
    pub(super) weight: f64,
    pub(super) saturated: bool,
}

impl<'a> Window<'a> {
    /// Around a star's place at the origin; `None` where the star leaves the picture.
    pub(super) fn around(exposed: &'a Exposed<'_>, x: f64, y: f64) -> Option<Self> {
        let Exposed { frame, cells, table, .. } = exposed;
        let star = exposed.star_at((x, y));
        let (left, top) = ((star.0 + table.x0).floor(), (star.1 + table.y0).floor());
        let (width, height) = (table.width + 1, table.height + 1);
        if left < 1.0 || top < 1.0 || left as usize + width + 1 > frame.width || top as usize + height + 1 > frame.height {
            return None;
        }
        let (left, top) = (left as usize, top as usize);
        let noise = cells.local_noise(x.max(0.0) as usize, y.max(0.0) as usize);
        let (limit, saturation) = (SPIKE_SIGMAS * noise, cells.saturation.unwrap_or(u16::MAX));
        let slope = slope_at(cells, star);
        let mut values = vec![0.0; width * height];
        let mut saturated = false;
        // By how many pixels the table lies from the window, none or one.
        let offset = |window: usize, star: f64, first: f64| usize::from((window as f64) < star + first);
        let (skip_x, skip_y) = (offset(left, star.0, table.x0), offset(top, star.1, table.y0));
        for (row, near) in table.near.chunks_exact(table.width).enumerate() {
            let row = row + skip_y;
            let lines =
                [0, 1, 2].map(|i| &frame.pixels[(top + row + i - 1) * frame.width + left + skip_x - 1..][..table.width + 2]);
            let values = &mut values[row * width + skip_x..][..table.width];
            let sky = (slope.0, slope.1 * row as f32);
            saturated |= with_vectors(CutRow { lines, near, limit, sky, saturation, values });
        }
        let near = table.near.iter().copied().sum::<f32>();
        let mean = (sum(&values) / f64::from(near).max(1.0)) as f32;
        for (row, near) in table.near.chunks_exact(table.width).enumerate() {
            let values = &mut values[(row + skip_y) * width + skip_x..][..table.width];
            values.iter_mut().zip(near).for_each(|(value, near)| *value -= mean * near);
        }
        let (near, squares) = (f64::from(near), dot(&values, &values));
        let weight = 1.0 / f64::from(noise * noise).max(f64::MIN_POSITIVE);
        Some(Self { exposed, left, top, width, values, near, squares, weight, saturated })
    }

    /// The sums over the pixels of a star's light at a place, and where `slopes` is set of how it changes with the place.
    pub(super) fn sums(&self, at: (f64, f64), slopes: bool) -> Sums {
        with_vectors(SumUp { window: self, star: self.exposed.star_at(at), slopes })
    }

    /// What the pixels say of the flux of a star at a place: the data's part in the equation of the flux, and its information. The sky's
    /// level is taken out.
    pub(super) fn flux_at(&self, x: f64, y: f64) -> (f64, f64) {
        let sums = self.sums((x, y), false);
        (sums.with_values[0] * self.weight, (sums.products[0] - sums.light[0] * sums.light[0] / self.near) * self.weight)
    }
}

/// Cuts one row out of a picture: what is near a star, over a sloping sky, with lone hot pixels clipped. Whether a pixel is saturated.
struct CutRow<'a> {
    /// The row above, the row and the one below, each longer by a pixel at either end.
    lines: [&'a [u16]; 3],
    near: &'a [f32],
    /// How far a pixel may stand above its neighbours, ADU.
    limit: f32,
    /// The sky's rise along the row, ADU/px, and what it has at its beginning.
    sky: (f32, f32),
    saturation: u16,
    values: &'a mut [f32],
}

impl Kernel for CutRow<'_> {
    type Output = bool;

    #[inline(always)]
    fn run(self) -> bool {
        let Self { lines: [above, here, below], near, limit, sky, saturation, values } = self;
        let n = values.len().min(near.len());
        let [above, here, below] = [above, here, below].map(|line| [0, 1, 2].map(|i| &line[i..][..n]));
        let (near, values) = (&near[..n], &mut values[..n]);
        let mut highest = 0;
        for i in 0..n {
            let upper = above[0][i].max(above[1][i]).max(above[2][i]);
            let lower = below[0][i].max(below[1][i]).max(below[2][i]);
            let beside = upper.max(lower).max(here[0][i]).max(here[2][i]);
            let value = f32::from(here[1][i]).min(f32::from(beside) + limit);
            values[i] = near[i] * (value - sky.0 * i as f32 - sky.1);
            highest = highest.max(if near[i] > 0.0 { here[1][i] } else { 0 });
        }
        highest >= saturation
    }
}

/// How the sky rises around a place along x and y, ADU/px, by the cells all around: a slope looks like a star that is moved, and all stars
/// of a picture alike, while in the star's own surroundings it hardly shows.
fn slope_at(cells: &CellStatistics, (x, y): (f64, f64)) -> (f32, f32) {
    /// Cells that are looked at to either side.
    const REACH: usize = 4;
    let range = |at: f64, count: usize| {
        let cell = ((at.max(0.0) as usize) / CELL_PX).min(count.saturating_sub(1));
        cell.saturating_sub(REACH)..(cell + REACH + 1).min(count)
    };
    let (columns, rows) = (range(x, cells.columns), range(y, cells.rows));
    let middle = |range: &std::ops::Range<usize>| 0.5 * (range.start + range.end) as f32 - 0.5;
    let (middle_x, middle_y) = (middle(&columns), middle(&rows));
    let (mut along_x, mut along_y, mut squares) = (0.0, 0.0, (0.0, 0.0));
    for row in rows {
        for column in columns.clone() {
            let (dx, dy) = (column as f32 - middle_x, row as f32 - middle_y);
            let mean = cells.mean.get(row * cells.columns + column).copied().unwrap_or(0.0);
            (along_x, along_y) = (along_x + dx * mean, along_y + dy * mean);
            squares = (squares.0 + dx * dx, squares.1 + dy * dy);
        }
    }
    let per_px = |along: f32, squares: f32| if squares > 0.0 { along / squares / CELL_PX as f32 } else { 0.0 };
    (per_px(along_x, squares.0), per_px(along_y, squares.1))
}

/// Sums over a window's pixels of a star's light and its two slopes.
#[derive(Default)]
pub(super) struct Sums {
    pub(super) light: [f64; 3],
    pub(super) with_values: [f64; 3],
    /// Light², light with the slopes along x and y, and the slopes with each other.
    pub(super) products: [f64; 6],
}

/// Sums up a window, as a kernel.
struct SumUp<'a> {
    window: &'a Window<'a>,
    star: (f64, f64),
    slopes: bool,
}

impl Kernel for SumUp<'_> {
    type Output = Sums;

    #[inline(always)]
    fn run(self) -> Sums {
        let SumUp { window, star, slopes } = self;
        let (table, fine) = (&window.exposed.table, FINE as f64);
        let u = (window.left as f64 - star.0 - table.x0) * fine;
        let v = (window.top as f64 - star.1 - table.y0) * fine;
        let (right, low) = ((u - u.floor()) as f32, (v - v.floor()) as f32);
        let [(px, column), (px_next, column_next)] = [0, 1].map(|next| Table::phase(u.floor() as isize + next));
        let [(py, row), (py_next, row_next)] = [0, 1].map(|next| Table::phase(v.floor() as isize + next));
        // Beyond the table there is no light.
        let from = (-column).max(0) as usize;
        let to = (table.width as isize - column_next).clamp(0, window.width as isize) as usize;
        let count = to.saturating_sub(from);
        let mut light = vec![0.0_f32; count];
        let (mut along_x, mut along_y) = (light.clone(), light.clone());
        let mut sums = Sums::default();
        for (j, values) in window.values.chunks_exact(window.width).enumerate() {
            let (upper, lower) = (row + j as isize, row_next + j as isize);
            if upper < 0 || lower >= table.height as isize || count == 0 {
                continue;
            }
            let line = |py, px, row: isize, column: isize| {
                &table.row((py, px), row as usize)[(column + from as isize) as usize..][..count]
            };
            let (a, b) = (line(py, px, upper, column), line(py, px_next, upper, column_next));
            let (c, d) = (line(py_next, px, lower, column), line(py_next, px_next, lower, column_next));
            let values = &values[from..to];
            for i in 0..count {
                let (top, bottom) = (a[i] + right * (b[i] - a[i]), c[i] + right * (d[i] - c[i]));
                light[i] = top + low * (bottom - top);
            }
            sums.light[0] += sum(&light);
            sums.with_values[0] += dot(&light, values);
            sums.products[0] += dot(&light, &light);
            if !slopes {
                continue;
            }
            for i in 0..count {
                let (top, bottom) = (a[i] + right * (b[i] - a[i]), c[i] + right * (d[i] - c[i]));
                along_x[i] = -(FINE as f32) * ((b[i] - a[i]) + low * ((d[i] - c[i]) - (b[i] - a[i])));
                along_y[i] = -(FINE as f32) * (bottom - top);
            }
            for (which, slope) in [(1, &along_x), (2, &along_y)] {
                sums.light[which] += sum(slope);
                sums.with_values[which] += dot(slope, values);
                sums.products[which] += dot(&light, slope);
            }
            sums.products[3] += dot(&along_x, &along_x);
            sums.products[4] += dot(&along_x, &along_y);
            sums.products[5] += dot(&along_y, &along_y);
        }
        sums
    }
}

/// Numbers that are added up side by side.
const LANES: usize = 8;

#[inline(always)]
fn sum(values: &[f32]) -> f64 {
    let (chunks, rest) = values.as_chunks::<LANES>();
    let mut lanes = [0.0_f32; LANES];
    for chunk in chunks {
        lanes.iter_mut().zip(chunk).for_each(|(lane, value)| *lane += value);
    }
    f64::from(lanes.iter().sum::<f32>() + rest.iter().sum::<f32>())
}

#[inline(always)]
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut lanes = [0.0_f32; LANES];
    for (a, b) in a.iter().zip(b) {
        for i in 0..LANES {
            lanes[i] += a[i] * b[i];
        }
    }
    f64::from(lanes.iter().sum::<f32>() + rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum::<f32>())
}
