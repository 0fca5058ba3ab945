//! A robot's scans on their way to a base: no more than somebody looks at.

use crate::peer::RateLimit;
use crate::scan::{DecimatedScan, ScanRate};
use msg::{Monotonic, Scan};

/// A robot's scans while its base asks for some: the newest that is due.
#[derive(Debug)]
pub struct ScanThrottle {
    /// What the robot sends at most.
    limit: ScanRate,
    /// What the base asks for; `None`: nobody looks.
    asked: Option<ScanRate>,
    rate: RateLimit,
    newest: Option<Box<DecimatedScan>>,
}

impl ScanThrottle {
    /// Creates a throttle that sends nothing until it is asked to.
    pub fn new(limit: ScanRate) -> Self {
        Self { limit, asked: None, rate: RateLimit::default(), newest: None }
    }

    /// Sets what the base asks for.
    pub fn set_asked(&mut self, asked: Option<ScanRate>) {
        self.asked = asked;
        if asked.is_none() {
            self.newest = None;
        }
    }

    /// Returns whether the next scan is wanted.
    pub fn is_asked(&self) -> bool {
        self.asked.is_some()
    }

    /// Takes a new scan; it is sent only if one is due.
    pub fn put(&mut self, scan: &Scan, now: Monotonic) {
        let Some(rate) = self.asked.map(|asked| asked.at_most(self.limit)) else { return };
        if self.rate.admits(now, rate.period()) {
            self.newest = Some(Box::new(DecimatedScan::new(scan, rate.beams.into())));
        }
    }

    /// Takes the scan that is to be sent now.
    pub fn take(&mut self) -> Option<Box<DecimatedScan>> {
        self.newest.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::scan;

    #[test]
    fn scans_are_sent_on_demand_and_no_faster_than_asked() {
        let mut throttle = ScanThrottle::new(ScanRate::new(4.0, 100));
        let at = |ms: u64| Monotonic(ms * 1_000_000);
        // A sensor of 10 Hz whose scans arrive 7 ms early or late.
        let arrivals = |from_ms: u64| (0..100).map(move |i| from_ms + 100 * i + (i % 3) * 7);
        let sent = |throttle: &mut ScanThrottle, from_ms: u64| {
            let scan = scan(&[1.0; 360]);
            let due = arrivals(from_ms).filter_map(|ms| {
                throttle.put(&scan, at(ms));
                throttle.take()
            });
            due.map(|scan| scan.ranges_m.len()).collect::<Vec<_>>()
        };
        assert_eq!(sent(&mut throttle, 1_000), []);
        throttle.set_asked(Some(ScanRate::new(20.0, 90)));
        let lengths = sent(&mut throttle, 20_000);
        // 4 Hz of the robot's own limit in 10 s.
        assert!((38..=42).contains(&lengths.len()) && lengths.iter().all(|len| *len == 90), "{lengths:?}");
        throttle.set_asked(Some(ScanRate::new(2.0, 1000)));
        let lengths = sent(&mut throttle, 40_000);
        assert!((19..=22).contains(&lengths.len()) && lengths.iter().all(|len| *len == 90), "{lengths:?}");
        throttle.set_asked(None);
        assert_eq!(sent(&mut throttle, 60_000), []);
    }
}
