//! Jitter from pairs of stamp and receive time.

use serde::Serialize;
use std::collections::BTreeMap;

/// Median and tail of |(receive - stamp) - mean|, and what did not come.
#[derive(Clone, Debug, Serialize)]
pub struct Spread {
    /// Milliseconds.
    pub p50_ms: f64,
    /// Milliseconds.
    pub p95_ms: f64,
    /// Milliseconds.
    pub p99_ms: f64,
    /// Milliseconds.
    pub max_ms: f64,
    /// Messages of one stream, a second: the slowest stream's.
    pub hz: f64,
    /// Stamps that a stream skipped, or that came twice.
    pub lost: u64,
    /// Values.
    pub count: usize,
}

/// A fleet's.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Each link a stream.
    pub tf: Spread,
    /// One stream.
    pub clock: Spread,
    /// Each robot a stream.
    pub scans: Spread,
}

/// Collects (stamp, receive) of streams that have one period.
pub struct Streams {
    period_ns: i64,
    delays_ns: BTreeMap<String, Vec<(i64, i64)>>,
}

impl Streams {
    /// Streams whose stamps are `period_ns` apart.
    pub fn new(period_ns: i64) -> Self {
        Self { period_ns, delays_ns: BTreeMap::new() }
    }

    /// A message of a stream. The two clocks need not agree.
    pub fn note(&mut self, stream: &str, stamp_ns: i64, received_ns: u64) {
        let delay = received_ns as i64 - stamp_ns;
        match self.delays_ns.get_mut(stream) {
            Some(delays) => delays.push((stamp_ns, delay)),
            None => drop(self.delays_ns.insert(stream.into(), vec![(stamp_ns, delay)])),
        }
    }

    /// Pools the streams.
    pub fn spread(&self) -> Spread {
        let mut deviations_ms = Vec::new();
        let (mut lost, mut hz) = (0, f64::INFINITY);
        for delays in self.delays_ns.values() {
            let mean = delays.iter().map(|(_, delay)| *delay as f64).sum::<f64>() / delays.len() as f64;
            deviations_ms.extend(delays.iter().map(|(_, delay)| (*delay as f64 - mean).abs() * 1e-6));
            let steps = delays.windows(2).map(|pair| pair[1].0 - pair[0].0);
            lost += steps
                .map(|step| (step as f64 / self.period_ns as f64 - 1.0).round().abs() as u64)
                .sum::<u64>();
            let (first, last) = (delays[0], delays[delays.len() - 1]);
            let received_s = ((last.0 + last.1) - (first.0 + first.1)) as f64 * 1e-9;
            hz = hz.min((delays.len() - 1) as f64 / received_s.max(1e-9));
        }
        deviations_ms.sort_by(f64::total_cmp);
        let at = |part: f64| {
            let index = (part * deviations_ms.len() as f64) as usize;
            deviations_ms.get(index.min(deviations_ms.len().saturating_sub(1))).copied().unwrap_or(f64::NAN)
        };
        let hz = if hz.is_finite() { hz } else { 0.0 };
        let count = deviations_ms.len();
        Spread { p50_ms: at(0.50), p95_ms: at(0.95), p99_ms: at(0.99), max_ms: at(1.0), hz, lost, count }
    }
}
