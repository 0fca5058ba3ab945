//! Histogram of durations in fixed memory, for quantiles.

use msg::Distribution;

/// Buckets per doubling of the value. A bucket is 1/64 wide, so that a quantile, the middle of its bucket, is off by at
/// most 0.8 %.
const BUCKETS_PER_OCTAVE: usize = 64;
const OCTAVE_BITS: u32 = BUCKETS_PER_OCTAVE.ilog2();
/// Larger values fall into the last bucket: 2^42 ns is 73 minutes.
const BITS_MAX: u32 = 42;
const BUCKETS: usize = (BITS_MAX - OCTAVE_BITS + 1) as usize * BUCKETS_PER_OCTAVE;

/// Counts durations in buckets whose width grows with the value, as HdrHistogram (Tene 2012) does, in 19 kB.
///
/// ```
/// let mut histogram = telemetry::Histogram::default();
/// (1..=1000_u64).for_each(|ms| histogram.add(ms * 1_000_000));
/// assert!((histogram.distribution_ms().p95 - 950.0).abs() < 0.008 * 950.0);
/// assert_eq!(histogram.distribution_ms().max, 1000.0);
/// ```
#[derive(Clone, Debug)]
pub struct Histogram {
    counts: Box<[u64; BUCKETS]>,
    count: u64,
    max_ns: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: Box::new([0; BUCKETS]), count: 0, max_ns: 0 }
    }
}

impl Histogram {
    /// Adds a duration, nanoseconds.
    pub fn add(&mut self, ns: u64) {
        self.counts[bucket(ns)] += 1;
        self.count += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// Quantile in nanoseconds, within 0.8 %: `share` (0 to 1) of the durations do not exceed it. 0 before the first.
    pub fn quantile_ns(&self, share: f64) -> u64 {
        let rank = ((share * self.count as f64).ceil() as u64).clamp(1, self.count.max(1));
        let mut below = 0;
        for (index, count) in self.counts.iter().enumerate() {
            below += count;
            if below >= rank {
                return middle_ns(index).min(self.max_ns);
            }
        }
        0
    }

    /// Count, median, tail and maximum, milliseconds. The maximum is exact.
    pub fn distribution_ms(&self) -> Distribution {
        let ms = |ns: u64| (ns as f64 * 1e-6) as f32;
        let quantile = |share| ms(self.quantile_ns(share));
        Distribution {
            count: self.count,
            p50: quantile(0.50),
            p95: quantile(0.95),
            p99: quantile(0.99),
            max: ms(self.max_ns),
        }
    }
}

/// Index of a value's bucket. Values below `BUCKETS_PER_OCTAVE` have a bucket each.
fn bucket(ns: u64) -> usize {
    let ns = ns.min((1 << BITS_MAX) - 1);
    let shift = (u64::BITS - ns.leading_zeros()).saturating_sub(OCTAVE_BITS + 1);
    shift as usize * BUCKETS_PER_OCTAVE + (ns >> shift) as usize
}

/// Middle of a bucket, nanoseconds.
fn middle_ns(bucket: usize) -> u64 {
    let shift = (bucket / BUCKETS_PER_OCTAVE).saturating_sub(1);
    let top = (bucket - shift * BUCKETS_PER_OCTAVE) as u64;
    (top << shift) + ((1_u64 << shift) >> 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_middle_of_a_bucket_falls_into_it() {
        for index in 0..BUCKETS {
            assert_eq!(bucket(middle_ns(index)), index);
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn an_empty_histogram_gives_zeros() {
        assert_eq!(Histogram::default().distribution_ms(), Distribution::default());
    }

    proptest! {
        #[test]
        fn quantiles_are_within_a_percent(
            mut values in proptest::collection::vec(0_u64..4_000_000_000, 1..300), share in 0.0..1.0_f64,
        ) {
            let mut histogram = Histogram::default();
            values.iter().for_each(|value| histogram.add(*value));
            values.sort_unstable();
            let rank = ((share * values.len() as f64).ceil() as usize).max(1);
            let (exact, found) = (values[rank - 1] as f64, histogram.quantile_ns(share) as f64);
            prop_assert!((found - exact).abs() <= 0.008 * exact + 0.5, "{found} for {exact}");
            prop_assert_eq!(histogram.distribution_ms().max, (values[values.len() - 1] as f64 * 1e-6) as f32);
        }
    }
}
