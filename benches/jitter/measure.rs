//! Jitter computed from pairs of stamp and receive time.

use mr_slam::time_slice;
use serde::Serialize;
use std::collections::BTreeMap;

/// The calling thread has a short time slice until this is dropped, as punctual processes of a fleet have: a headset has cores of its
/// own, and what is measured is not how long its stand-in waits for one of the fleet's.
pub struct Punctual(());

impl Punctual {
    /// Asks for the slice; without it the measurement goes on, as a fleet does.
    pub fn begin() -> Self {
        if let Err(why) = time_slice::request(time_slice::SLICE_MIN) {
            eprintln!("the client has no short time slice: {why}");
        }
        Self(())
    }
}

impl Drop for Punctual {
    /// What the thread starts later does not inherit it.
    fn drop(&mut self) {
        time_slice::request_default();
    }
}

/// Percentiles of |(receive - stamp) - mean|, with the rate and the losses.
#[derive(Clone, Debug, Serialize)]
pub struct Spread {
    /// Median, milliseconds.
    pub p50_ms: f64,
    /// 95th percentile, milliseconds.
    pub p95_ms: f64,
    /// 99th percentile, milliseconds.
    pub p99_ms: f64,
    /// Largest value, milliseconds.
    pub max_ms: f64,
    /// Rate of the slowest stream, Hz.
    pub hz: f64,
    /// Number of stamps that a stream skipped or received twice.
    pub lost: u64,
    /// Number of values.
    pub count: usize,
}

/// Jitter of all streams of a fleet.
#[derive(Clone, Debug)]
pub struct Figures {
    /// Jitter of /tf, each link as a stream.
    pub tf: Spread,
    /// Jitter of /clock.
    pub clock: Spread,
    /// Jitter of the scans, each robot as a stream.
    pub scans: Spread,
}

/// Stamps and receive times of streams with the same period.
pub struct Streams {
    period_ns: i64,
    delays_ns: BTreeMap<String, Vec<(i64, i64)>>,
}

impl Streams {
    /// Creates streams whose stamps are `period_ns` apart.
    pub fn new(period_ns: i64) -> Self {
        Self { period_ns, delays_ns: BTreeMap::new() }
    }

    /// Records a message of a stream. The clocks of stamp and receive time need not agree.
    pub fn record(&mut self, stream: &str, stamp_ns: i64, received_ns: u64) {
        let delay = received_ns as i64 - stamp_ns;
        match self.delays_ns.get_mut(stream) {
            Some(delays) => delays.push((stamp_ns, delay)),
            None => drop(self.delays_ns.insert(stream.into(), vec![(stamp_ns, delay)])),
        }
    }

    /// Computes the jitter of all streams together.
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
