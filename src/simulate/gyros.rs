//! Simulated gyros: rates as they measure them, with their noise.

use crate::solve::Motion;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// A motion as gyros with this noise measure it, rad/s/√Hz.
pub fn measured(motion: &Motion, noise: f64, random: &mut impl Rng) -> Motion {
    let sigma = noise * motion.sample_rate_hz.max(0.0).sqrt();
    let mut measured = |rate: f64| {
        let off: f64 = StandardNormal.sample(random);
        rate + sigma * off
    };
    Motion { rates: motion.rates.iter().map(|(az, el)| (measured(*az), measured(*el))).collect(), ..motion.clone() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn the_noise_of_all_samples_of_a_second_is_that_of_a_second() {
        let still = Motion { rates: vec![(0.1, 0.0); 100], sample_rate_hz: 100.0, ..Motion::default() };
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let angle = |motion: &Motion| motion.rates.iter().map(|(az, _)| (az - 0.1) / 100.0).sum::<f64>();
        let seconds: Vec<f64> = (0..400).map(|_| angle(&measured(&still, 2e-5, &mut random))).collect();
        let sigma = (seconds.iter().map(|angle| angle * angle).sum::<f64>() / 400.0).sqrt();
        assert!((sigma / 2e-5 - 1.0).abs() < 0.15, "{sigma}");
    }
}
