//! Seeded noise. Each purpose has its own stream, so that switching one off leaves the others' numbers.

use msg::RobotId;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64Mcg;

/// What noise is drawn for.
#[derive(Clone, Copy)]
pub(crate) enum Purpose {
    Odometry = 1,
    Range = 2,
    Dropout = 3,
}

/// A stream of numbers that depends on seed, robot and purpose alone.
pub(crate) struct Noise(Pcg64Mcg);

impl Noise {
    pub(crate) fn new(seed: u64, robot: RobotId, purpose: Purpose) -> Self {
        let stream = (robot.number() as u64) << 8 | purpose as u64;
        Self(Pcg64Mcg::new(u128::from(mix(seed)) << 64 | u128::from(mix(seed ^ mix(stream)))))
    }

    /// Mean 0, standard deviation 1.
    pub(crate) fn gaussian(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// True with this probability.
    pub(crate) fn happens(&mut self, probability: f64) -> bool {
        let uniform: f64 = StandardUniform.sample(&mut self.0);
        uniform < probability
    }
}

/// SplitMix64's finaliser (Steele, Lea, Flood 2014): seeds that are neighbours give streams that are not.
fn mix(seed: u64) -> u64 {
    let z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
