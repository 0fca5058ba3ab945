//! Which scans reached SLAM, by the corrections it answers them with.

use heapless::Deque;
use msg::{Correction, Stamp};

/// Scans remembered for the rate: at least a second's up to 255 Hz.
const RECENT: usize = 256;
/// A rate is taken over the second up to the newest scan, unless that is this old, seconds: a
/// correction needs its time to arrive.
const FRESH_S: f64 = 0.25;

/// One robot's scans.
#[derive(Clone, Debug, Default)]
pub(crate) struct Scans {
    /// Scans that reached SLAM.
    pub received: u64,
    /// Scans that never did.
    pub lost: u64,
    recent: Deque<Stamp, RECENT>,
    last: Option<Last>,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    run: u64,
    seq: u64,
    scan_seq: u64,
}

impl Scans {
    pub fn add(&mut self, correction: &Correction) {
        let now = Last {
            run: correction.header.incarnation,
            seq: correction.header.seq,
            scan_seq: correction.scan_seq,
        };
        let (received, lost) = self.last.map_or((1, 0), |last| steps(last, now));
        self.received += received;
        self.lost += lost;
        self.last = Some(now);
        let stamp = correction.header.stamp;
        if self.recent.back().is_some_and(|newest| stamp < *newest) {
            self.recent.clear(); // the simulator's clock began anew
        }
        if self.recent.is_full() {
            self.recent.pop_front();
        }
        let _ = self.recent.push_back(stamp);
    }

    /// Scans a second of the run's clock, at `stamp`.
    pub fn rate_hz(&self, stamp: Stamp) -> f64 {
        let Some(newest) = self.recent.back() else { return 0.0 };
        if stamp - *newest > FRESH_S {
            return self.recent.iter().filter(|at| (0.0..1.0).contains(&(stamp - **at))).count() as f64;
        }
        // From the last scan a second or more ago to the newest: whole periods, whatever the phase.
        let within = self.recent.iter().rev().take_while(|at| *newest - **at < 1.0).count();
        match self.recent.iter().rev().nth(within) {
            Some(before) if *newest - *before < 2.0 => within as f64 / (*newest - *before),
            _ => within as f64,
        }
    }
}

/// Scans received and lost from one correction to the next that came here. SLAM answers each scan
/// it receives with one correction: as many as its own `seq` advanced it did receive, even if
/// telemetry missed the answers; what `scan_seq` advanced beyond that never reached SLAM.
fn steps(last: Last, now: Last) -> (u64, u64) {
    let received = if now.run == last.run { now.seq.saturating_sub(last.seq).max(1) } else { 1 };
    // A simulator that restarted counts from 0 again.
    let sent = now.scan_seq.checked_sub(last.scan_seq).unwrap_or(1);
    (received.min(sent.max(1)), sent.saturating_sub(received))
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Header;

    fn correction(run: u64, seq: u64, scan_seq: u64, seconds: f64) -> Correction {
        let header =
            Header { stamp: Stamp::from_seconds(seconds), seq, incarnation: run, ..Default::default() };
        Correction { header, scan_seq, ..Default::default() }
    }

    #[test]
    fn ten_hertz_is_ten_at_any_phase() {
        let mut scans = Scans::default();
        for n in 0..100_u32 {
            let at = f64::from(n) * 0.1;
            scans.add(&correction(1, n.into(), n.into(), at));
            if n > 10 {
                for late in [0.0, 0.03, 0.099, 0.2] {
                    let rate = scans.rate_hz(Stamp::from_seconds(at + late));
                    assert!((rate - 10.0).abs() < 1e-6, "{rate}");
                }
            }
        }
        assert_eq!((scans.received, scans.lost), (100, 0));
        assert_eq!(scans.rate_hz(Stamp::from_seconds(9.9 + 0.55)), 5.0);
        assert_eq!(scans.rate_hz(Stamp::from_seconds(20.0)), 0.0);
    }

    #[test]
    fn what_telemetry_missed_is_not_lost_to_slam() {
        let mut scans = Scans::default();
        scans.add(&correction(1, 0, 5, 0.0));
        scans.add(&correction(1, 1, 6, 0.1));
        scans.add(&correction(1, 2, 9, 0.4)); // SLAM never saw 7 and 8
        assert_eq!((scans.received, scans.lost), (3, 2));
        scans.add(&correction(1, 5, 12, 0.7)); // telemetry missed two answers
        assert_eq!((scans.received, scans.lost), (6, 2));
        scans.add(&correction(2, 0, 16, 1.1)); // SLAM restarted, three scans fell between
        assert_eq!((scans.received, scans.lost), (7, 5));
        scans.add(&correction(2, 1, 0, 0.0)); // the simulator restarted
        assert_eq!((scans.received, scans.lost), (8, 5));
    }
}
