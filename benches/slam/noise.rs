//! Random numbers of generated data, from a seed.

use core::f64::consts::TAU;
use nav::RandomNumbers;

/// Noise of a seed.
pub struct Noise(RandomNumbers);

impl Noise {
    /// Starts the noise of a seed.
    pub fn new(seed: u64) -> Self {
        Self(RandomNumbers::new(seed))
    }

    /// Uniform between two values.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// An index below a count.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.index_below(count)
    }

    /// Uniform in (0, 1].
    pub fn uniform(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) + 1) as f64 / (1_u64 << 53) as f64
    }

    /// Of standard deviation 1 (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}
