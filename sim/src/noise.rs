//! Seeded random numbers. Each purpose has a stream of its own, so that switching one off does not change
//! the numbers of the others.

use msg::RobotId;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64Mcg;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// What a stream of random numbers is for.
#[derive(Clone, Copy)]
pub(crate) enum NoiseStream {
    Odometry = 1,
    Range = 2,
    Dropout = 3,
}

/// A stream of random numbers that depends only on seed, robot and purpose.
pub(crate) struct Noise(Pcg64Mcg);

impl Noise {
    pub(crate) fn new(seed: u64, robot: RobotId, purpose: NoiseStream) -> Self {
        let stream = (robot.number() as u64) << 8 | purpose as u64;
        Self(Pcg64Mcg::new(u128::from(mix(seed)) << 64 | u128::from(mix(seed ^ mix(stream)))))
    }

    /// Draws from the Gaussian with mean 0 and standard deviation 1.
    pub(crate) fn gaussian(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Draws true with this probability.
    pub(crate) fn bernoulli(&mut self, probability: f64) -> bool {
        let uniform: f64 = StandardUniform.sample(&mut self.0);
        uniform < probability
    }
}

/// Numbers of one object that moves in the room: they depend only on the seed and the object.
pub(crate) struct Draws(Pcg64Mcg);

impl Draws {
    /// `stream` tells objects apart, and what a process that was started again draws from what the one before drew.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        // Streams of robots are below 2^16.
        let stream = 1 << 32 | stream;
        Self(Pcg64Mcg::new(u128::from(mix(seed)) << 64 | u128::from(mix(seed ^ mix(stream)))))
    }

    /// Draws evenly between two numbers.
    pub(crate) fn between(&mut self, [low, high]: [f64; 2]) -> f64 {
        let uniform: f64 = StandardUniform.sample(&mut self.0);
        low + uniform * (high - low)
    }

    /// Draws a whole number below `count`; 0 if there is none.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        (self.between([0.0, count as f64]) as usize).min(count.saturating_sub(1))
    }
}

/// Mixes the bits of a seed (SplitMix64's first output), so that consecutive seeds give unrelated streams.
fn mix(seed: u64) -> u64 {
    SplitMix64::seed_from_u64(seed).next_u64()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_mixed_as_in_earlier_versions() {
        // From the reference implementation of SplitMix64 (Vigna 2015).
        assert_eq!(mix(0), 0xe220_a839_7b1d_cdaf);
        assert_eq!(mix(1_234_567), 6_457_827_717_110_365_317);
    }
}
