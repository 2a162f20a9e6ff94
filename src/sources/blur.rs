//! How large the images of stars are where they are no points: the diameter of discs, the length of trails.
//!
//! Every star of a frame is the same figure, wherever its middle lies. The autocorrelation of a star's surroundings does not ask where that
//! is, and that of a disc or of a line has a known shape; so the size comes from it without a fit. Of the autocorrelations of the frame's
//! brightest figures the median counts: what only one of them has beside it is no part of the figure.

#![allow(
    clippy::indexing_slicing,
    reason = "a numeric kernel: windows are filled inside the picture, lags stay inside the window"
)]

use super::plane::Plane;
use crate::image::CellStatistics;
use crate::sky::{Kernel, with_vectors};
use std::sync::LazyLock;

/// Times that the picture is halved in which figures are searched, and pixels along a sample there.
pub(super) const SEARCH_SCALE: usize = 3;
const SEARCH_BIN: usize = 1 << SEARCH_SCALE;
/// Side of the tiles whose medians are the sky, samples of the search (128 px).
const TILE: usize = 16;
/// Half the side of the square whose mean must stand above the sky, samples of the search (40 px in all); by how many σ; how far figures
/// are from each other and from the border.
const BOX: usize = 2;
const LEAST_SNR: f32 = 5.0;
const APART: usize = 8;
const BORDER: usize = 3;
/// Figures that are measured: the brightest.
const MOST: usize = 12;
/// Half the side of the window that a figure is measured in, and the longest lag, samples: 224 and 96 px at scale 3.
const HALF: usize = 14;
const SIDE: usize = 2 * HALF;
const LAGS: usize = 12;
const COLUMNS: usize = 2 * LAGS + 1;
/// Lags are counted in whole vectors.
const LANES: usize = 8;
/// Directions over half a turn in which a figure's extent is looked at, and steps along them, samples.
const DIRECTIONS: usize = 36;
const STEP: f64 = 0.25;
const PROFILE_STEPS: usize = (LAGS as f64 / STEP) as usize;
/// A figure narrower than this is measured in a finer picture, samples.
const FINER_BELOW: f64 = 2.5;
/// Where an autocorrelation ends, of its height: the median of few figures, that of many, and what all of many but a share have, each
/// counting alike; and above its own noise, σ.
const END: f32 = 0.18;
const END_OF_MANY: f32 = 0.1;
const END_OF_ROW: f32 = 0.07;
const SHARED: f32 = 0.35;
const EQUAL: f32 = f32::MIN_POSITIVE;
const MANY: usize = 6;
const END_SIGMAS: f32 = 6.0;

/// The figure that the frame's stars have in common.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// Figures measured, and those among them that are like the rest.
    pub count: usize,
    /// As above.
    pub alike: usize,
    /// Signal over noise of the brightest, of the mean of 40 px square.
    pub snr: f64,
    /// Half the width of the autocorrelation at half its height, along the direction in which it is widest, and across, px.
    pub long_px: f64,
    /// As above.
    pub short_px: f64,
    /// Mean of that half width over all directions, px.
    pub mean_px: f64,
    /// Its long axis over its short one, by its second moments.
    pub elongation: f64,
    /// Lag at which it ends, where it is longest, px: the length of a trail with or without gaps.
    pub reach_px: f64,
    /// The same of what most of the figures share, where there are enough to tell: of a row of points, its length. Else nought.
    pub row_px: f64,
    /// Lag at which it ends first along the direction in which it is widest, px: of a disc, a part of the diameter.
    pub end_px: f64,
    /// The directions in which it is widest, in which it reaches furthest, and in which the row does, from x towards y, rad.
    pub long_angle: f64,
    /// As above.
    pub reach_angle: f64,
    /// As above.
    pub row_angle: f64,
    /// Noise of the autocorrelation, of its height.
    pub noise: f64,
    /// Side of the samples that its widths were measured in, px.
    pub bin_px: f64,
}

/// A picture of larger samples widens an autocorrelation by this part of a sample; and a disc's falls to half at this part of its
/// diameter.
const WIDENED: f64 = 0.4;
const HALF_OF_DISC: f64 = 0.404;
/// A trail that reaches further than so many half widths has gaps, unless it reaches so far that its end is not seen, px; and a figure of
/// so small a half width is a point, px.
const BROKEN: f64 = 2.3;
const WIDEST_POINT_PX: f64 = 6.0;
const LONGEST_REACH_PX: f64 = 94.0;

impl Figure {
    /// Diameter, px, if it is a disc.
    pub fn disc_px(&self) -> f64 {
        (self.mean_px - WIDENED * self.bin_px) / HALF_OF_DISC
    }

    /// Length, px, and direction, if it is a trail: an unbroken one by its half width, one with gaps by its reach.
    pub fn trail(&self) -> (f64, f64) {
        let gaps_end = BROKEN * self.long_px..LONGEST_REACH_PX;
        if self.is_narrow() {
            (self.row_px, self.row_angle)
        } else if gaps_end.contains(&self.reach_px) {
            (self.reach_px, self.reach_angle)
        } else {
            (2.0 * self.long_px, self.long_angle)
        }
    }

    /// Whether it is, or consists of, points.
    pub fn is_narrow(&self) -> bool {
        self.long_px <= WIDEST_POINT_PX
    }
}

/// A figure's place, samples of the search, and its signal over noise.
#[derive(Debug, Clone, Copy)]
struct Place {
    x: usize,
    y: usize,
    snr: f32,
}

/// The figure that stars are at the places, px, with their signal over noise, brightest first; where none are given, at those that stand
/// out. `None` where there are none. `halved`: the pictures at scales 1, 2, 3.
pub(super) fn figure(halved: &[Plane], cells: &CellStatistics, given: &[(f64, f64, f64)]) -> Option<Figure> {
    let search = halved.get(SEARCH_SCALE - 1)?;
    let sky = Sky::of(search)?;
    let of_given = |&(x, y, snr): &(f64, f64, f64)| {
        let sample = |at: f64, size: usize| (at.max(0.0) as usize / SEARCH_BIN).min(size - 1);
        Place { x: sample(x, search.width), y: sample(y, search.height), snr: snr as f32 }
    };
    let peaks = if given.is_empty() { peaks(search, &sky, cells) } else { given.iter().map(of_given).collect() };
    let places = thinned(peaks);
    let mut figure: Option<Figure> = None;
    for scale in (1..=SEARCH_SCALE).rev() {
        let mut found = measure(halved.get(scale - 1)?, scale, &places, &sky, cells)?;
        let finer_below = FINER_BELOW * (2 << scale) as f64;
        // A row of points is narrow, and yet as long as the wider windows say.
        if let Some(wider) = figure {
            if wider.reach_px >= finer_below {
                (found.reach_px, found.reach_angle) = (wider.reach_px, wider.reach_angle);
            }
            if wider.row_px >= finer_below {
                (found.row_px, found.row_angle) = (wider.row_px, wider.row_angle);
            }
        }
        figure = Some(found);
        if found.long_px >= 0.5 * finer_below {
            break;
        }
    }
    figure
}

/// Where squares stand highest above the sky, brightest first.
fn peaks(plane: &Plane, sky: &Sky, cells: &CellStatistics) -> Vec<Place> {
    let (width, height) = (plane.width, plane.height);
    const SQUARE: usize = 2 * BOX + 1;
    let mut snrs = vec![0f32; width * height];
    let mut columns = vec![0f32; width];
    for y in BOX..height - BOX {
        columns.fill(0.0);
        for row in plane.pixels[(y - BOX) * width..].chunks_exact(width).take(SQUARE) {
            columns.iter_mut().zip(row).for_each(|(sum, sample)| *sum += sample);
        }
        let sky = sky.row(y);
        for (x, columns) in columns.windows(SQUARE).enumerate() {
            let (x, sum) = (x + BOX, columns.iter().sum::<f32>());
            let noise = cells.local_noise(x * SEARCH_BIN, y * SEARCH_BIN) / (SQUARE * SEARCH_BIN) as f32;
            snrs[y * width + x] = (sum / (SQUARE * SQUARE) as f32 - sky.at(x)) / noise.max(f32::MIN_POSITIVE);
        }
    }
    let mut peaks: Vec<Place> = Vec::new();
    for y in BORDER..height - BORDER {
        for x in BORDER..width - BORDER {
            let snr = snrs[y * width + x];
            if snr >= LEAST_SNR && (y - 1..=y + 1).all(|y| (x - 1..=x + 1).all(|x| snrs[y * width + x] <= snr)) {
                peaks.push(Place { x, y, snr });
            }
        }
    }
    peaks.sort_by(|a, b| b.snr.total_cmp(&a.snr));
    peaks
}

/// The first of those that are nearer to each other than figures may be, as many as are measured.
fn thinned(peaks: Vec<Place>) -> Vec<Place> {
    let mut kept: Vec<Place> = Vec::new();
    for peak in peaks {
        if kept.len() < MOST && kept.iter().all(|k| k.x.abs_diff(peak.x).max(k.y.abs_diff(peak.y)) >= APART) {
            kept.push(peak);
        }
    }
    kept
}

/// The sky: medians of tiles, and between their middles what is in proportion.
struct Sky {
    columns: usize,
    rows: usize,
    medians: Vec<f32>,
}

impl Sky {
    /// `None` where there are less than two tiles either way.
    fn of(plane: &Plane) -> Option<Self> {
        let (columns, rows) = (plane.width / TILE, plane.height / TILE);
        let mut tile = Vec::with_capacity(TILE * TILE);
        let medians = (0..columns * rows)
            .map(|n| {
                let (x, y) = (n % columns * TILE, n / columns * TILE);
                tile.clear();
                (y..y + TILE).for_each(|y| tile.extend_from_slice(&plane.pixels[y * plane.width + x..][..TILE]));
                median(&mut tile)
            })
            .collect();
        (columns > 1 && rows > 1).then_some(Self { columns, rows, medians })
    }

    /// Change along x and y at a sample of the search, ADU a sample of a picture that has `finer` of them for one of the search.
    fn slope(&self, x: usize, y: usize, finer: usize) -> (f32, f32) {
        let (left, below) = (x.saturating_sub(HALF / 2), y.saturating_sub(HALF / 2));
        let (right, above) = (x + HALF / 2, y + HALF / 2);
        let over = |n: usize| (n * finer.max(1)) as f32;
        (
            (self.at(right, y) - self.at(left, y)) / over(right - left),
            (self.at(x, above) - self.at(x, below)) / over(above - below),
        )
    }

    fn at(&self, x: usize, y: usize) -> f32 {
        self.row(y).at(x)
    }

    /// The two rows of tiles around a sample's row, and how far it lies between them.
    fn row(&self, y: usize) -> SkyRow<'_> {
        let (j, part) = between_tiles(y, self.rows);
        let row = |j: usize| &self.medians[j * self.columns..][..self.columns];
        SkyRow { above: row(j), below: row(j + 1), part }
    }
}

/// The sky along a row of samples.
struct SkyRow<'a> {
    above: &'a [f32],
    below: &'a [f32],
    part: f32,
}

impl SkyRow<'_> {
    fn at(&self, x: usize) -> f32 {
        let (i, part) = between_tiles(x, self.above.len());
        let of = |row: &[f32]| row[i] * (1.0 - part) + row[i + 1] * part;
        of(self.above) * (1.0 - self.part) + of(self.below) * self.part
    }
}

/// The tile whose middle is the last before a sample, and how far on the sample lies to the next; beyond the middles of the outer tiles the
/// slope goes on.
fn between_tiles(at: usize, tiles: usize) -> (usize, f32) {
    let t = (at as f32 + 0.5) / TILE as f32 - 0.5;
    let first = (t.max(0.0) as usize).min(tiles - 2);
    (first, t - first as f32)
}

fn median(values: &mut [f32]) -> f32 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f32::total_cmp).1
}

/// The figure at the places, as the picture at a scale shows it.
fn measure(plane: &Plane, scale: usize, places: &[Place], sky: &Sky, cells: &CellStatistics) -> Option<Figure> {
    let finer = SEARCH_SCALE - scale;
    let mut all: Vec<(Autocorrelation, f32)> = Vec::new();
    for place in places {
        let (x, y) = ((place.x << finer) + (1 << finer) / 2, (place.y << finer) + (1 << finer) / 2);
        let noise = cells.local_noise(x << scale, y << scale) / (1 << scale) as f32;
        let slope = sky.slope(place.x, place.y, SEARCH_BIN >> scale);
        let window = window(plane, x, y, slope, noise);
        let correlation = with_vectors(Correlate { window: &window, noise });
        all.extend(correlation.normalised().map(|correlation| (correlation, place.snr * place.snr)));
    }
    // None counts for more than the third brightest.
    const THIRD: usize = 2;
    let most = all.get(THIRD.min(all.len().wrapping_sub(1)))?.1;
    let common = Autocorrelation::quantile_of(&all, 0.5, most).normalised()?;
    let alike = all.iter().filter(|(one, _)| one.is_like(&common)).count();
    let many = all.len() >= MANY;
    let Extents { long, short, mean, elongation, end, reach, long_angle, reach_angle } =
        common.extents(if many { END_OF_MANY } else { END });
    // Of many, what most of them have.
    let row = if many { Autocorrelation::quantile_of(&all, SHARED, EQUAL).extents(END_OF_ROW) } else { Extents::default() };
    let bin = (1 << scale) as f64;
    Some(Figure {
        count: all.len(),
        alike,
        snr: places.first().map_or(0.0, |place| f64::from(place.snr)),
        long_px: bin * long,
        short_px: bin * short,
        mean_px: bin * mean,
        elongation,
        end_px: bin * end,
        reach_px: bin * reach,
        row_px: bin * row.reach,
        long_angle,
        reach_angle,
        row_angle: row.reach_angle,
        noise: f64::from(common.noise()),
        bin_px: bin,
    })
}

/// The surroundings of a sample above the median of their rim, row after row; what lies beyond the border is sky.
fn window(plane: &Plane, x: usize, y: usize, slope: (f32, f32), noise: f32) -> Vec<f32> {
    /// What is darker than the sky by more than this is dust, σ.
    const DARKEST: f32 = 2.0;
    /// Samples at the rim.
    const RIM: usize = 3;
    let at = |n: usize| {
        let (x, y) = ((x + n % SIDE).checked_sub(HALF)?, (y + n / SIDE).checked_sub(HALF)?);
        let tilt = slope.0 * ((n % SIDE) as f32 - HALF as f32) + slope.1 * ((n / SIDE) as f32 - HALF as f32);
        (x < plane.width && y < plane.height).then(|| plane.pixels[y * plane.width + x] - tilt)
    };
    let at_rim = |n: usize| [n % SIDE, n / SIDE].iter().any(|&i| !(RIM..SIDE - RIM).contains(&i));
    let mut rim: Vec<f32> = (0..SIDE * SIDE).filter(|&n| at_rim(n)).filter_map(at).collect();
    let sky = if rim.is_empty() { 0.0 } else { median(&mut rim) };
    (0..SIDE * SIDE).map(|n| at(n).map_or(0.0, |sample| (sample - sky).max(-DARKEST * noise))).collect()
}

/// Extents of an autocorrelation as in [`Figure`], samples.
#[derive(Default)]
struct Extents {
    long: f64,
    short: f64,
    mean: f64,
    elongation: f64,
    end: f64,
    reach: f64,
    long_angle: f64,
    reach_angle: f64,
}

/// Autocorrelation of a window: lags of x from −[`LAGS`], row after row of lags of y from 0.
#[derive(Clone)]
struct Autocorrelation(Vec<f32>);

struct Correlate<'a> {
    window: &'a [f32],
    noise: f32,
}

impl Kernel for Correlate<'_> {
    type Output = Autocorrelation;

    #[inline(always)]
    fn run(self) -> Autocorrelation {
        // All lags of x of one sample at once. Noughts on either side, so that all samples are alike.
        const LAG_LANES: usize = COLUMNS.next_multiple_of(LANES);
        let mut rows = [[0f32; SIDE + LAG_LANES]; SIDE];
        for (row, samples) in rows.iter_mut().zip(self.window.chunks_exact(SIDE)) {
            row[LAGS..LAGS + SIDE].copy_from_slice(samples);
        }
        let mut sums = Vec::with_capacity(COLUMNS * (LAGS + 1));
        for dy in 0..=LAGS {
            let mut lanes = [0f32; LAG_LANES];
            for (one, other) in rows.iter().zip(&rows[dy..]) {
                for x in 0..SIDE {
                    let (sample, others) = (one[LAGS + x], &other[x..x + LAG_LANES]);
                    for i in 0..LAG_LANES {
                        lanes[i] += sample * others[i];
                    }
                }
            }
            sums.extend_from_slice(&lanes[..COLUMNS]);
        }
        sums[LAGS] -= self.noise * self.noise * (SIDE * SIDE) as f32;
        Autocorrelation(sums)
    }
}

impl Autocorrelation {
    /// Over its height; `None` where it has none.
    fn normalised(mut self) -> Option<Self> {
        // What noise leaves of the value at no lag is uncertain, but it is never less than the next.
        let next = [LAGS - 1, LAGS + 1, COLUMNS + LAGS].iter().map(|&n| self.0[n]).sum::<f32>() / 3.0;
        let height = self.0[LAGS].max(next);
        self.0[LAGS] = height;
        (height > 0.0).then(|| Self(self.0.iter().map(|value| value / height).collect()))
    }

    /// Lag by lag the value below which lies a share of the weights, each with its weight, or `most` where that is less.
    fn quantile_of(all: &[(Self, f32)], share: f32, most: f32) -> Self {
        let whole: f32 = all.iter().map(|(_, weight)| weight.min(most)).sum();
        let mut column: Vec<(f32, f32)> = Vec::with_capacity(all.len());
        Self(
            (0..COLUMNS * (LAGS + 1))
                .map(|n| {
                    column.clear();
                    column.extend(all.iter().map(|(one, weight)| (one.0[n], weight.min(most))));
                    column.sort_by(|a, b| a.0.total_cmp(&b.0));
                    let mut passed = 0.0;
                    let middle = column.iter().find(|(_, weight)| {
                        passed += weight;
                        passed >= share * whole
                    });
                    middle.map_or(0.0, |(value, _)| *value)
                })
                .collect(),
        )
    }

    /// Whether it is that of the same figure, as far as noise lets it be seen.
    fn is_like(&self, other: &Self) -> bool {
        const LIKE: f32 = 0.5;
        let product = |a: &Self, b: &Self| a.0.iter().zip(&b.0).map(|(a, b)| a * b).sum::<f32>();
        product(self, other) > LIKE * (product(self, self) * product(other, other)).sqrt()
    }

    /// Its value at a lag, interpolated.
    #[inline(always)]
    fn at(&self, lag: &Lag) -> f32 {
        let &Lag { first, fx, fy } = lag;
        let row = |n: usize| self.0[n] * (1.0 - fx) + self.0[n + 1] * fx;
        row(first) * (1.0 - fy) + row(first + COLUMNS) * fy
    }

    /// Its own noise: of most lags the figure has nothing.
    fn noise(&self) -> f32 {
        /// σ of a normal distribution over its median absolute deviation.
        const SIGMA_PER_DEVIATION: f32 = 1.482_6;
        let mut deviations: Vec<f32> = self.0.iter().map(|value| value.abs()).collect();
        SIGMA_PER_DEVIATION * median(&mut deviations)
    }

    /// Long axis over short one of what lies within twice a half width, by second moments.
    fn elongation(&self, half: f64) -> f64 {
        let (mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0);
        for (n, &value) in self.0.iter().enumerate() {
            let (dx, dy) = ((n % COLUMNS) as f64 - LAGS as f64, (n / COLUMNS) as f64);
            let weight = f64::from((value - END).max(0.0));
            // Lags of y = 0 are there on both sides, the others on one.
            let weight = if n < COLUMNS { 0.5 * weight } else { weight };
            if dx.hypot(dy) <= 2.0 * half {
                xx += weight * dx * dx;
                yy += weight * dy * dy;
                xy += weight * dx * dy;
            }
        }
        let (mean, difference) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        ((mean + difference) / (mean - difference).max(f64::MIN_POSITIVE)).sqrt()
    }

    /// Its values along a direction, step by step, of the one at no lag. Means of some lags across: a narrow ridge that runs between the
    /// samples is not lower for it.
    fn profile(&self, lags: &[[Lag; ACROSS.len()]]) -> Vec<f32> {
        /// The step at a lag of one sample.
        const ONE: usize = (1.0 / STEP) as usize;
        let mut sums: Vec<f32> = lags.iter().map(|across| across.iter().map(|lag| self.at(lag)).sum()).collect();
        // At no lag there is what is left of the noise, or too little.
        let height = sums[0].max(sums[ONE]).max(f32::MIN_POSITIVE);
        sums.iter_mut().for_each(|sum| *sum /= height);
        sums
    }

    /// How far it reaches; the furthest that counts is as high as `last`.
    fn extents(&self, last: f32) -> Extents {
        let profiles: Vec<Vec<f32>> = PROFILE_LAGS.chunks_exact(PROFILE_STEPS + 1).map(|lags| self.profile(lags)).collect();
        let least = last.max(END_SIGMAS * self.noise());
        let halves: Vec<f64> = profiles.iter().map(|profile| first_below(profile, 0.5)).collect();
        let reach_of = |profile: &Vec<f32>| STEP * profile.iter().rposition(|&value| value >= least).unwrap_or(0) as f64;
        let reaches: Vec<f64> = profiles.iter().map(reach_of).collect();
        let ((widest, long), (longest, reach)) = (greatest(&halves), greatest(&reaches));
        let mean = halves.iter().sum::<f64>() / DIRECTIONS as f64;
        Extents {
            long,
            short: halves[(widest + DIRECTIONS / 2) % DIRECTIONS],
            mean,
            elongation: self.elongation(mean),
            end: first_below(&profiles[widest], END),
            reach,
            long_angle: angle_of(widest),
            reach_angle: angle_of(longest),
        }
    }
}

/// A lag between those that are measured: the one below it both ways, and how far it lies towards the next along x and y.
#[derive(Debug, Clone, Copy)]
struct Lag {
    first: usize,
    fx: f32,
    fy: f32,
}

impl Lag {
    /// At a distance, samples.
    fn of(dx: f64, dy: f64) -> Self {
        // A lag and its opposite are the same.
        let (dx, dy) = if dy < 0.0 { (-dx, -dy) } else { (dx, dy) };
        let (x, y) = (dx + LAGS as f64, dy);
        let (i, j) = ((x as usize).min(COLUMNS - 2), (y as usize).min(LAGS - 1));
        Self { first: j * COLUMNS + i, fx: (x - i as f64) as f32, fy: (y - j as f64) as f32 }
    }
}

/// Distances to either side of a direction of which the mean is taken, samples.
const ACROSS: [f64; 5] = [-1.0, -0.5, 0.0, 0.5, 1.0];

/// The lags of all steps along all directions, and across: always the same ones.
static PROFILE_LAGS: LazyLock<Vec<[Lag; ACROSS.len()]>> = LazyLock::new(|| {
    let steps = (0..DIRECTIONS).flat_map(|direction| (0..=PROFILE_STEPS).map(move |step| (direction, step as f64 * STEP)));
    let across = |(direction, r): (usize, f64)| {
        let (sin, cos) = angle_of(direction).sin_cos();
        ACROSS.map(|t| Lag::of(r * cos - t * sin, r * sin + t * cos))
    };
    steps.map(across).collect()
});

fn angle_of(direction: usize) -> f64 {
    direction as f64 * std::f64::consts::PI / DIRECTIONS as f64
}

/// The lag at which a profile first falls below a height, samples.
fn first_below(profile: &[f32], height: f32) -> f64 {
    let beyond = profile.iter().position(|&value| value < height).unwrap_or(PROFILE_STEPS);
    let (high, low) = (profile[beyond.saturating_sub(1)], profile[beyond]);
    let back = if low < height { (height - low) / (high - low).max(f32::MIN_POSITIVE) } else { 0.0 };
    STEP * (beyond as f64 - f64::from(back.clamp(0.0, 1.0)))
}

/// The first of the greatest numbers, and its place.
fn greatest(values: &[f64]) -> (usize, f64) {
    values.iter().copied().enumerate().reduce(|a, b| if b.1 > a.1 { b } else { a }).unwrap_or((0, 0.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Frame;
    use crate::sky::RowOrder;
    use rand::{Rng, SeedableRng};

    /// The figure of a frame with the same shape at some places on a noisy sky; `shape`: its light at an offset from its middle, ADU.
    fn figure_of(shape: impl Fn(f64, f64) -> f64) -> Option<Figure> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let (width, height) = (768, 512);
        let places =
            [(120.0, 110.0), (400.0, 130.0), (610.0, 380.0), (260.0, 350.0), (480.0, 290.0), (650.0, 120.0), (120.0, 430.0)];
        let mut pixels = vec![0; width * height];
        for (n, pixel) in pixels.iter_mut().enumerate() {
            let (x, y) = ((n % width) as f64, (n / width) as f64);
            let light: f64 = places.iter().map(|&(px, py)| shape(x - px, y - py)).sum();
            let noise = 4.0 * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0);
            *pixel = (500.0 + 0.02 * x + light + noise) as u16;
        }
        let frame = Frame::new(width, height, pixels, RowOrder::BottomFirst).unwrap();
        let mut cells = CellStatistics::default();
        cells.measure(&frame, None);
        let mut finder = super::super::Finder::default();
        finder.begin(&frame, &cells);
        finder.figure(&frame, &cells, &[])
    }

    #[test]
    fn the_diameter_of_discs_is_measured() {
        for diameter in [24.0, 40.0, 64.0] {
            let figure = figure_of(|x, y| if x.hypot(y) < 0.5 * diameter { 12.0 } else { 0.0 }).unwrap();
            assert!((figure.disc_px() / diameter - 1.0).abs() < 0.1, "{diameter}: {} {figure:?}", figure.disc_px());
            assert!(figure.elongation < 1.3 && figure.alike == 7, "{figure:?}");
        }
    }

    #[test]
    fn the_length_and_direction_of_trails_are_measured() {
        for (length, angle) in [(30.0, 0.6f64), (60.0, 2.0), (85.0, 0.0)] {
            let (sin, cos) = angle.sin_cos();
            let figure = figure_of(|x, y| {
                let (along, across) = (x * cos + y * sin, y * cos - x * sin);
                if along.abs() < 0.5 * length { 60.0 * (-0.5 * across * across).exp() } else { 0.0 }
            })
            .unwrap();
            let (found, direction) = figure.trail();
            let turn =
                (direction - angle + std::f64::consts::FRAC_PI_2).rem_euclid(std::f64::consts::PI) - std::f64::consts::FRAC_PI_2;
            assert!((found / length - 1.0).abs() < 0.15 && turn.abs() < 0.12, "{length} {angle}: {found} {direction} {figure:?}");
        }
    }

    #[test]
    fn a_row_of_points_is_as_long_as_it_reaches_and_a_point_is_no_row() {
        let point = |x: f64, y: f64| 900.0 * (-0.5 * (x * x + y * y)).exp();
        let row = figure_of(|x, y| [-24.0, 0.0, 24.0].iter().map(|at| point(x - at, y)).sum()).unwrap();
        assert!((row.trail().0 / 48.0 - 1.0).abs() < 0.2 && row.long_px < 5.0, "{row:?}");
        let points = figure_of(point).unwrap();
        assert!(points.reach_px < 8.0 && points.long_px < 3.0, "{points:?}");
    }

    #[test]
    fn an_empty_sky_has_no_figure() {
        assert_eq!(figure_of(|_, _| 0.0), None);
    }
}
