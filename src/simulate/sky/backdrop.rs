//! All light that is not stars, and what dims it on its way.
#![allow(clippy::indexing_slicing, reason = "image kernels: every index is cut to the frame just before")]

use std::f64::consts::TAU;

/// Grid on which smooth light is computed and between which it is interpolated, px.
const GRID_PX: usize = 4;

/// The light of the sky and the dimming of the optics.
#[derive(Debug, Clone, Default)]
pub(super) struct Backdrop {
    /// Sky at the picture's centre, ADU over bias.
    pub sky_adu: f64,
    /// Change of the sky across the picture's half diagonal, fraction of the sky.
    pub gradient: f64,
    /// Direction in which the sky brightens, from x towards y, rad.
    pub gradient_angle: f64,
    pub dimming: Dimming,
    pub glows: Vec<Glow>,
    pub clouds: Vec<Cloud>,
    pub slabs: Vec<Slab>,
    pub streaks: Vec<Streak>,
    pub glare: Option<Glare>,
}

/// What dims the light before it reaches the sensor.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Dimming {
    /// Light lost in the corners, fraction.
    pub vignetting: f64,
    pub spots: Vec<Spot>,
}

/// Light that falls off exponentially from a point.
#[derive(Debug, Clone)]
pub(super) struct Glow {
    pub x: f64,
    pub y: f64,
    pub radius_px: f64,
    pub level_adu: f64,
}

/// Filaments of mesospheric cloud: bent parallel waves that come and go.
#[derive(Debug, Clone)]
pub(super) struct Cloud {
    pub angle: f64,
    pub wavelength_px: f64,
    pub amplitude_adu: f64,
    pub phase: f64,
    /// Bending of the waves, rad of phase.
    pub warp: f64,
    pub warp_angle: f64,
    pub warp_wavelength_px: f64,
    pub patch_phase: f64,
}

/// A reflection: a rectangle with sharp edges.
#[derive(Debug, Clone)]
pub(super) struct Slab {
    pub x: f64,
    pub y: f64,
    pub angle: f64,
    pub half_length_px: f64,
    pub half_width_px: f64,
    pub level_adu: f64,
}

/// A satellite's trail from border to border.
#[derive(Debug, Clone)]
pub(super) struct Streak {
    pub x: f64,
    pub y: f64,
    pub angle: f64,
    pub sigma_px: f64,
    pub level_adu: f64,
}

/// A speck of dust.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spot {
    pub x: f64,
    pub y: f64,
    pub radius_px: f64,
    pub depth: f64,
}

/// Light from the Sun's side that clips a part of the frame.
#[derive(Debug, Clone)]
pub(super) struct Glare {
    /// Fraction of the frame that clips.
    pub fraction: f64,
    /// Direction of the brighter side, from x towards y, rad.
    pub angle: f64,
    /// Distance in which it falls by e, px.
    pub scale_px: f64,
}

impl Glare {
    /// Glare that clips a fraction of the frame.
    pub fn covering(fraction: f64, angle: f64, scale_px: f64) -> Self {
        Self { fraction, angle, scale_px }
    }

    /// Coordinate along the glare's direction beyond which the frame clips, px from the centre.
    fn edge(&self, width: usize, height: usize) -> f64 {
        const SAMPLES: usize = 64;
        let (cos, sin) = (libm::cos(self.angle), libm::sin(self.angle));
        let place = |i: usize, size: usize| (i as f64 / (SAMPLES - 1) as f64 - 0.5) * size as f64;
        let mut along: Vec<f64> =
            (0..SAMPLES * SAMPLES).map(|i| place(i % SAMPLES, width) * cos + place(i / SAMPLES, height) * sin).collect();
        along.sort_by(|a, b| b.total_cmp(a));
        let at = (self.fraction * along.len() as f64) as usize;
        // The whole frame clips with some light to spare.
        along.get(at).copied().unwrap_or_else(|| along.last().copied().unwrap_or(0.0) - self.scale_px)
    }
}

impl Backdrop {
    /// Puts the light on each pixel before dimming, ADU over bias, into an image; `full_adu` is what just clips (for the glare).
    pub fn shine(&self, image: &mut Vec<f32>, width: usize, height: usize, full_adu: f64) {
        let glare =
            self.glare.as_ref().map(|glare| (glare, glare.edge(width, height), libm::cos(glare.angle), libm::sin(glare.angle)));
        let half_diagonal = 0.5 * (width as f64).hypot(height as f64);
        let (cos, sin) = (libm::cos(self.gradient_angle), libm::sin(self.gradient_angle));
        let (middle_x, middle_y) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        let clouds: Vec<_> = self.clouds.iter().map(Cloud::light).collect();
        smooth_field(image, width, height, |x, y| {
            let slope = ((x - middle_x) * cos + (y - middle_y) * sin) / half_diagonal;
            let mut light = self.sky_adu * (1.0 + self.gradient * slope);
            light += self.glows.iter().map(|glow| glow.at(x, y)).sum::<f64>();
            light += clouds.iter().map(|cloud| cloud(x, y)).sum::<f64>();
            if let Some((glare, edge, cos, sin)) = glare {
                let beyond = ((x - middle_x) * cos + (y - middle_y) * sin - edge) / glare.scale_px;
                // Far beyond the edge it only needs to stay clipped.
                light += full_adu * libm::exp(beyond.min(1.0));
            }
            light
        });
        self.slabs.iter().for_each(|slab| slab.paint(image, width));
        self.streaks.iter().for_each(|streak| streak.paint(image, width));
    }
}

impl Dimming {
    /// Puts the fraction of the light that each pixel gets into an image: vignetting and dust.
    pub fn transmission(&self, image: &mut Vec<f32>, width: usize, height: usize) {
        let (middle_x, middle_y) = (0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        let corner_sq = middle_x * middle_x + middle_y * middle_y;
        smooth_field(image, width, height, |x, y| {
            let relative_sq = ((x - middle_x).powi(2) + (y - middle_y).powi(2)) / corner_sq.max(1.0);
            1.0 - self.vignetting * relative_sq
        });
        self.spots.iter().for_each(|spot| spot.paint(image, width, height));
    }
}

impl Glow {
    fn at(&self, x: f64, y: f64) -> f64 {
        self.level_adu * libm::exp(-((x - self.x).powi(2) + (y - self.y).powi(2)).sqrt() / self.radius_px)
    }
}

impl Cloud {
    /// Its light as a function of (x, y), ADU.
    fn light(&self) -> impl Fn(f64, f64) -> f64 {
        let wave = |angle: f64, wavelength_px: f64| {
            let (kx, ky) = (TAU * libm::cos(angle) / wavelength_px, TAU * libm::sin(angle) / wavelength_px);
            move |x: f64, y: f64| kx * x + ky * y
        };
        let ripple = wave(self.angle, self.wavelength_px);
        let bend = wave(self.warp_angle, self.warp_wavelength_px);
        let patch = wave(self.warp_angle + 1.0, 1.6 * self.warp_wavelength_px);
        let (amplitude, warp, phase, patch_phase) = (self.amplitude_adu, self.warp, self.phase, self.patch_phase);
        move |x, y| {
            // Only the crests shine, and steeply: thin bright filaments with dark between them.
            let crest = libm::sin(ripple(x, y) + warp * libm::sin(bend(x, y)) + phase).max(0.0);
            amplitude * (0.5 + 0.5 * libm::sin(patch(x, y) + patch_phase)) * crest * crest
        }
    }
}

impl Slab {
    fn paint(&self, image: &mut [f32], width: usize) {
        let (cos, sin) = (libm::cos(self.angle), libm::sin(self.angle));
        // An edge is as wide as one pixel.
        let inside = |distance: f64, half: f64| (half - distance.abs() + 0.5).clamp(0.0, 1.0) as f32;
        for (y, row) in image.chunks_exact_mut(width).enumerate() {
            for (x, pixel) in row.iter_mut().enumerate() {
                let (dx, dy) = (x as f64 - self.x, y as f64 - self.y);
                let cover = inside(dx * cos + dy * sin, self.half_length_px) * inside(dy * cos - dx * sin, self.half_width_px);
                *pixel += self.level_adu as f32 * cover;
            }
        }
    }
}

impl Streak {
    fn paint(&self, image: &mut [f32], width: usize) {
        const REACH_SIGMA: f64 = 5.0;
        let (cos, sin) = (libm::cos(self.angle), libm::sin(self.angle));
        let reach = REACH_SIGMA * self.sigma_px;
        for (y, row) in image.chunks_exact_mut(width).enumerate() {
            // Distance from the line: (x − x₀) sin − (y − y₀) cos. Only the columns within reach are looked at.
            let dy = (y as f64 - self.y) * cos;
            let (a, b) = ((dy - reach) / sin + self.x, (dy + reach) / sin + self.x);
            let first = a.min(b).clamp(0.0, width as f64) as usize;
            let last = a.max(b).clamp(0.0, width as f64 - 1.0) as usize;
            for (x, pixel) in row.iter_mut().enumerate().take(last + 1).skip(first) {
                let z = ((x as f64 - self.x) * sin - dy) / self.sigma_px;
                if z.abs() <= REACH_SIGMA {
                    *pixel += (self.level_adu * libm::exp(-0.5 * z * z)) as f32;
                }
            }
        }
    }
}

impl Spot {
    fn paint(&self, image: &mut [f32], width: usize, height: usize) {
        /// Softness of a speck's edge, px.
        const EDGE_PX: f64 = 2.0;
        let reach = self.radius_px + EDGE_PX;
        let cut = |value: f64, size: usize| value.clamp(0.0, size as f64) as usize;
        for y in cut(self.y - reach, height)..cut(self.y + reach + 1.0, height) {
            for x in cut(self.x - reach, width)..cut(self.x + reach + 1.0, width) {
                let distance = ((x as f64 - self.x).powi(2) + (y as f64 - self.y).powi(2)).sqrt();
                let cover = ((self.radius_px - distance) / EDGE_PX + 0.5).clamp(0.0, 1.0);
                image[y * width + x] *= (1.0 - self.depth * cover) as f32;
            }
        }
    }
}

/// Makes an image that of a smooth function of (x, y), computed on a coarse grid and interpolated linearly.
fn smooth_field(image: &mut Vec<f32>, width: usize, height: usize, value: impl Fn(f64, f64) -> f64) {
    let columns = width.div_ceil(GRID_PX) + 1;
    let grid_row = |row: usize| -> Vec<f32> {
        (0..columns).map(|column| value((column * GRID_PX) as f64, (row * GRID_PX) as f64) as f32).collect()
    };
    // Every pixel is set below.
    image.resize(width * height, 0.0);
    let (mut lower, mut upper) = (grid_row(0), grid_row(1));
    let mut between = lower.clone();
    for (y, row) in image.chunks_exact_mut(width).enumerate() {
        if y > 0 && y % GRID_PX == 0 {
            lower = std::mem::replace(&mut upper, grid_row(y / GRID_PX + 1));
        }
        let fy = (y % GRID_PX) as f32 / GRID_PX as f32;
        for (between, (lower, upper)) in between.iter_mut().zip(lower.iter().zip(&upper)) {
            *between = lower + fy * (upper - lower);
        }
        let right = between.iter().skip(1);
        // The length is fixed, so that a whole run of pixels is one vector.
        let (whole, rest) = row.as_chunks_mut::<GRID_PX>();
        let last = (rest, between.get(whole.len()..whole.len() + 2));
        for (pixels, (left, right)) in whole.iter_mut().zip(between.iter().zip(right)) {
            interpolate(pixels, *left, *right);
        }
        if let (rest, Some(&[left, right])) = last {
            interpolate(rest, left, right);
        }
    }
}

/// Fills pixels from one point of the grid towards the next.
#[inline]
fn interpolate(pixels: &mut [f32], left: f32, right: f32) {
    for (i, pixel) in pixels.iter_mut().enumerate() {
        *pixel = left + (right - left) * (i as f32 / GRID_PX as f32);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smooth_light_is_interpolated_without_seams() {
        let mut image = vec![f32::NAN; 37 * 20];
        smooth_field(&mut image, 37, 21, |x, y| 3.0 * x - 2.0 * y + 7.0);
        for (i, &value) in image.iter().enumerate() {
            let expected = 3.0 * (i % 37) as f32 - 2.0 * (i / 37) as f32 + 7.0;
            assert!((value - expected).abs() < 1e-3);
        }
    }

    #[test]
    fn glare_clips_the_fraction_asked_for() {
        for fraction in [0.2, 0.5, 0.9, 1.0] {
            let glare = Some(Glare::covering(fraction, 0.7, 100.0));
            let mut light = Vec::new();
            Backdrop { sky_adu: 1500.0, glare, ..Backdrop::default() }.shine(&mut light, 300, 200, 16_283.0);
            let clipped = light.iter().filter(|&&light| light >= 16_283.0).count() as f64 / light.len() as f64;
            assert!((clipped - fraction).abs() < 0.05, "{clipped} of {fraction}");
        }
    }

    #[test]
    fn dust_and_vignetting_only_dim() {
        let spots = vec![Spot { x: 50.0, y: 40.0, radius_px: 10.0, depth: 0.04 }];
        let mut image = Vec::new();
        Dimming { vignetting: 0.3, spots }.transmission(&mut image, 200, 100);
        assert!(image.iter().all(|&t| (0.69..=1.0).contains(&t)));
        assert!((image[0] - 0.7).abs() < 1e-3);
        assert!(image[40 * 200 + 50] < 0.965 * image[40 * 200 + 70]);
    }
}
