//! Chance, seeded: the same seed gives the same draws on any machine.

use rand::RngCore;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// What a stream of chance is for. Each has its own, so that one more artefact does not change the others.
#[derive(Debug, Clone, Copy)]
pub(super) enum Purpose {
    Pointing = 1,
    Optics,
    Sky,
    Motion,
    Events,
    Flaws,
    HotPixels,
    Pattern,
    Noise,
    Star,
    Spoil,
    Specks,
}

/// One stream of chance.
#[derive(Debug, Clone)]
pub(super) struct Dice(ChaCha8Rng);

impl Dice {
    /// The stream of a purpose for a frame: `seed`, `group` (the kind of frame) and `index` tell frames apart.
    pub fn new(seed: u64, group: u64, index: u64, purpose: Purpose) -> Self {
        let words = [seed, group, index, purpose as u64];
        let mut key = [0u8; 32];
        for (slot, byte) in key.iter_mut().zip(words.iter().flat_map(|word| word.to_le_bytes())) {
            *slot = byte;
        }
        Self(ChaCha8Rng::from_seed(key))
    }

    /// Uniform in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        // The upper 53 bits fill a double's mantissa.
        let unit = (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        low + (high - low) * unit
    }

    /// Uniform in the logarithm, in [low, high), both above zero.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        low * libm::pow(high / low, self.uniform(0.0, 1.0))
    }

    /// Uniform whole number in low..=high.
    pub fn count(&mut self, low: usize, high: usize) -> usize {
        (self.uniform(low as f64, high as f64 + 1.0).floor() as usize).min(high)
    }

    /// True with a probability.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform(0.0, 1.0) < probability
    }

    /// An angle in [0, 2π), rad.
    pub fn angle(&mut self) -> f64 {
        self.uniform(0.0, TAU)
    }

    /// Standard normal (ziggurat).
    #[inline]
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}
