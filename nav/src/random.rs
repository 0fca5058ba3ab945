//! Random numbers from a seed.

use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// Sequence of random numbers: the same seed gives the same numbers on every platform.
#[derive(Clone, Debug)]
pub struct RandomNumbers(SplitMix64);

impl RandomNumbers {
    /// Starts the sequence of a seed; any seed is good.
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// Next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Next random index in 0..`count`; 0 if `count` is 0.
    ///
    /// The upper half of the product (Lemire 2019, without rejection): the bias is below `count` / 2^64.
    pub fn index_below(&mut self, count: usize) -> usize {
        ((u128::from(self.next_u64()) * count as u128) >> 64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sequence_of_a_seed_is_fixed() {
        // From the reference implementation of SplitMix64 (Vigna 2015).
        let mut random = RandomNumbers::new(1_234_567);
        let expected: [u64; 3] =
            [6_457_827_717_110_365_317, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423];
        assert_eq!([(); 3].map(|()| random.next_u64()), expected);
    }

    #[test]
    fn indices_are_below_the_count() {
        let mut random = RandomNumbers::new(7);
        assert_eq!(random.index_below(0), 0);
        let mut seen = [false; 5];
        (0..200).for_each(|_| seen[random.index_below(5)] = true);
        assert_eq!(seen, [true; 5]);
    }
}
