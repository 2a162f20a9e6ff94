//! Hot pixels: those that stand above their neighbours in frame after frame, wherever the camera looks.
//!
//! What a pixel has above the median of its neighbours, in σ of the frame, is averaged over all frames. In each it counts up to a limit,
//! so that a star that passes is one frame of many; and sensitivities that differ a little from pixel to pixel, which average to something
//! too, are told from hot pixels by how far all pixels scatter.

use crate::image::Frame;
use crate::sky::{Attitude, RowOrder, separation};

/// What a single frame counts at most, σ.
const MOST_SIGMAS: f64 = 5.0;
/// A pixel is hot whose mean lies above this many times the scatter of all pixels' means: of a million normal ones one in a thousand
/// times.
const HOT_SCATTERS: f64 = 6.0;
/// It has to be above this in any case, σ of a frame: what is less costs no frame a star.
const LEAST_MEAN: f64 = 0.5;
/// A frame's σ comes from one pixel in this many.
const SAMPLE: usize = 17;
/// Half the width of a normal distribution's middle half, σ: from the median of absolute values to σ.
const MAD_TO_SIGMA: f64 = 1.482_6;
/// Frames whose boresights are nearer to each other, px, may have the same star on the same pixels.
const SAME_PLACE_PX: f64 = 30.0;
/// The largest share of all frames that may look at the same place.
const MOST_AT_A_PLACE: f64 = 0.25;

/// What pixels have above their neighbours, summed over frames of one size.
#[derive(Debug, Clone, PartialEq)]
pub struct HotPixels {
    width: usize,
    height: usize,
    /// σ, each frame's limited; the picture's bottom row first.
    sums: Vec<f32>,
    frames: usize,
    /// What the present frame has above the neighbours, ADU.
    excess: Vec<i32>,
}

impl HotPixels {
    /// Of frames of this size, px.
    pub fn new(width: usize, height: usize) -> Self {
        let excess = vec![0; width * height];
        Self { width, height, sums: vec![0.0; width * height], frames: 0, excess }
    }

    /// Takes a frame in; `false` for one of another size, or without any noise, of which nothing is taken.
    pub fn add(&mut self, frame: &Frame) -> bool {
        if (frame.width, frame.height) != (self.width, self.height) || frame.pixels.len() != self.excess.len() {
            return false;
        }
        self.compare(&frame.pixels);
        let mut sample: Vec<i32> = self.excess.iter().step_by(SAMPLE).map(|excess| excess.abs()).collect();
        let sigma = MAD_TO_SIGMA * f64::from(median(&mut sample));
        if !(sigma > 0.0) {
            return false;
        }
        let (mut bottom_first, mut top_first);
        let rows: &mut dyn Iterator<Item = &[i32]> = match frame.rows {
            RowOrder::BottomFirst => {
                bottom_first = self.excess.chunks_exact(self.width);
                &mut bottom_first
            }
            RowOrder::TopFirst => {
                top_first = self.excess.chunks_exact(self.width).rev();
                &mut top_first
            }
        };
        for (sum, &excess) in self.sums.iter_mut().zip(rows.flatten()) {
            *sum += (f64::from(excess) / sigma).clamp(-MOST_SIGMAS, MOST_SIGMAS) as f32;
        }
        self.frames += 1;
        true
    }

    /// Adds what another one has summed up over frames of the same size.
    pub fn merge(&mut self, other: &Self) {
        if (other.width, other.height) == (self.width, self.height) {
            self.sums.iter_mut().zip(&other.sums).for_each(|(sum, more)| *sum += more);
            self.frames += other.frames;
        }
    }

    /// Frames taken in.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The hot ones: column, and row from the bottom of the picture, row after row.
    pub fn found(&self) -> Vec<(usize, usize)> {
        if self.frames == 0 {
            return Vec::new();
        }
        let of_frames = 1.0 / self.frames as f32;
        let mut sample: Vec<i32> = self.sums.iter().step_by(SAMPLE).map(|sum| (1e3 * sum * of_frames).abs() as i32).collect();
        let scatter = 1e-3 * MAD_TO_SIGMA * f64::from(median(&mut sample));
        let least = (HOT_SCATTERS * scatter).max(LEAST_MEAN) as f32;
        let hot = self.sums.iter().enumerate().filter(|(_, sum)| **sum * of_frames > least);
        hot.map(|(at, _)| (at % self.width, at / self.width)).collect()
    }

    /// Compares each pixel with its neighbours, those beyond the border left out.
    fn compare(&mut self, pixels: &[u16]) {
        let (width, height) = (self.width, self.height);
        for (y, out) in self.excess.chunks_exact_mut(width).enumerate() {
            let rows = y.saturating_sub(1)..(y + 2).min(height);
            for (x, out) in out.iter_mut().enumerate() {
                let columns = x.saturating_sub(1)..(x + 2).min(width);
                let (mut around, mut count) = ([u16::MAX; 9], 0);
                let mut own = 0;
                for v in rows.clone() {
                    let row = pixels.get(v * width + columns.start..v * width + columns.end).unwrap_or_default();
                    for (u, &pixel) in columns.clone().zip(row) {
                        if (u, v) == (x, y) {
                            own = pixel;
                        } else if let Some(place) = around.get_mut(count) {
                            *place = pixel;
                            count += 1;
                        }
                    }
                }
                // What was not filled is the greatest there is, and comes last.
                around.sort_unstable();
                let at = |place: usize| around.get(place).copied().unwrap_or(0);
                *out = i32::from(own) - i32::from(at(count / 2).midpoint(at(count.saturating_sub(1) / 2)));
            }
        }
    }
}

fn median(values: &mut [i32]) -> i32 {
    let middle = values.len() / 2;
    if values.is_empty() { 0 } else { *values.select_nth_unstable(middle).1 }
}

/// The sky stood still.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("{share:.0} % of the frames look at one place: a star there would pass for a hot pixel; expected at most {:.0} %", 100.0 * MOST_AT_A_PLACE)]
pub struct SkyStands {
    /// Percent of the frames at the place that most look at.
    pub share: f64,
}

/// Whether the camera looked at many places, so that no star stays on its pixels. `platescale`, rad/px.
///
/// # Errors
/// Where too many frames look at one place; or there is none.
pub fn has_moved(attitudes: &[Attitude], platescale: f64) -> Result<(), SkyStands> {
    let mut places: Vec<(Attitude, usize)> = Vec::new();
    for attitude in attitudes {
        let near = |(place, _): &&mut (Attitude, usize)| {
            separation(&place.boresight(), &attitude.boresight()) < SAME_PLACE_PX * platescale
        };
        match places.iter_mut().find(near) {
            Some((_, count)) => *count += 1,
            None => places.push((*attitude, 1)),
        }
    }
    let most = places.iter().map(|place| place.1).max().unwrap_or(1);
    let share = most as f64 / attitudes.len().max(1) as f64;
    if share <= MOST_AT_A_PLACE { Ok(()) } else { Err(SkyStands { share: 100.0 * share }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::ARCSEC;
    use rand::{Rng, SeedableRng};

    const WIDTH: usize = 64;
    const HEIGHT: usize = 48;

    /// A frame of noise of σ = 8 on a sky of 1000, with pixels 30 above and a star of 400 at a place.
    fn frame(index: usize, hot: &[(usize, usize)], star: (usize, usize)) -> Frame {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(index as u64);
        let mut pixels: Vec<u16> = (0..WIDTH * HEIGHT)
            .map(|_| (1000.0 + 8.0 * ((0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0)) as u16)
            .collect();
        hot.iter().for_each(|&(x, y)| pixels[y * WIDTH + x] += 30);
        pixels[star.1 * WIDTH + star.0] += 400;
        Frame::new(WIDTH, HEIGHT, pixels, RowOrder::BottomFirst).unwrap()
    }

    #[test]
    fn those_that_stand_out_in_all_frames_are_found_and_stars_that_pass_are_not() {
        // In a corner, at a border, beside each other, and by itself.
        let hot = [(0, 0), (20, 0), (30, 20), (31, 20), (63, 47), (5, 40)];
        let (mut one, mut other) = (HotPixels::new(WIDTH, HEIGHT), HotPixels::new(WIDTH, HEIGHT));
        for index in 0..60 {
            let half = if index % 2 == 0 { &mut one } else { &mut other };
            // A star stays for six frames.
            let mut frame = frame(index, &hot, (10 + index / 6, 10));
            // Kept images begin with the bottom row, and others with the top one: their pixels are the same.
            if index % 3 == 0 {
                frame.pixels = frame.pixels.chunks(WIDTH).rev().flatten().copied().collect();
                frame.rows = RowOrder::TopFirst;
            }
            assert!(half.add(&frame));
        }
        one.merge(&other);
        assert_eq!(one.frames(), 60);
        let mut wanted = hot.to_vec();
        wanted.sort_by_key(|&(x, y)| (y, x));
        assert_eq!(one.found(), wanted);
    }

    #[test]
    fn other_sizes_and_frames_without_noise_are_not_taken() {
        let mut pixels = HotPixels::new(WIDTH, HEIGHT);
        assert!(!pixels.add(&Frame::new(HEIGHT, WIDTH, frame(0, &[], (1, 1)).pixels, RowOrder::BottomFirst).unwrap()));
        assert!(!pixels.add(&Frame::new(WIDTH, HEIGHT, vec![7; WIDTH * HEIGHT], RowOrder::BottomFirst).unwrap()));
        assert_eq!((pixels.frames(), pixels.found().len()), (0, 0));
    }

    #[test]
    fn a_sky_that_stands_still_is_told() {
        let at = |i: usize, step: f64| Attitude::from_angles(1.0 + step * i as f64, 0.1, 0.0);
        let moving: Vec<Attitude> = (0..20).map(|i| at(i, 400.0 * ARCSEC)).collect();
        assert!(has_moved(&moving, 9.5 * ARCSEC).is_ok());
        let standing: Vec<Attitude> = (0..20).map(|i| at(i, 5.0 * ARCSEC)).collect();
        assert_eq!(has_moved(&standing, 9.5 * ARCSEC), Err(SkyStands { share: 100.0 }));
        assert!(has_moved(&[], 9.5 * ARCSEC).is_err());
    }
}
