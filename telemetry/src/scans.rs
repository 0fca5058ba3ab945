//! Counting of the scans that reached SLAM, by the pose estimates that answer them.

use heapless::Deque;
use msg::{Monotonic, PoseEstimate, Stamp};

/// Scans kept for the rate: at least those of a second, up to 255 Hz.
const RECENT_MAX: usize = 256;
/// Largest time between the newest scan and now for which the rate ends at that scan, seconds. A pose estimate needs
/// time to arrive.
const NEWEST_AGE_MAX_S: f64 = 0.25;

/// One robot's scans.
#[derive(Clone, Debug, Default)]
pub(crate) struct ScanCounter {
    /// Scans that reached SLAM.
    pub received: u64,
    /// Scans that were sent and did not reach SLAM.
    pub lost: u64,
    recent: Deque<Stamp, RECENT_MAX>,
    /// When the newest pose estimate arrived.
    newest_received: Monotonic,
    last: Option<LastPoseEstimate>,
}

#[derive(Clone, Copy, Debug)]
struct LastPoseEstimate {
    run: u64,
    seq: u64,
    scan_seq: u64,
}

impl ScanCounter {
    /// Adds a pose estimate that arrived at `received`.
    pub fn add(&mut self, pose_estimate: &PoseEstimate, received: Monotonic) {
        let now = LastPoseEstimate {
            run: pose_estimate.header.incarnation,
            seq: pose_estimate.header.seq,
            scan_seq: pose_estimate.scan_seq,
        };
        let (arrived, lost) = self.last.map_or((1, 0), |last| scans_between(last, now));
        self.received += arrived;
        self.lost += lost;
        self.last = Some(now);
        let stamp = pose_estimate.header.stamp;
        if self.recent.back().is_some_and(|newest| stamp < *newest) {
            self.recent.clear(); // the simulator was restarted
        }
        if self.recent.is_full() {
            self.recent.pop_front();
        }
        let _ = self.recent.push_back(stamp);
        self.newest_received = received;
    }

    /// Scans a second by their stamps. Their clock need not be the run's: a simulator's begins at 0.
    pub fn rate_hz(&self, now: Monotonic) -> f64 {
        let Some(newest) = self.recent.back() else { return 0.0 };
        let age_ns = i64::try_from(now.since(self.newest_received)).unwrap_or(i64::MAX);
        let stamp = Stamp(newest.0.saturating_add(age_ns));
        if stamp - *newest > NEWEST_AGE_MAX_S {
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

/// Scans received and lost between two pose estimates that reached telemetry.
///
/// SLAM answers each scan with one pose estimate: it received as many as its own `seq` advanced, even if telemetry missed
/// some answers. What `scan_seq` advanced beyond that did not reach SLAM.
fn scans_between(last: LastPoseEstimate, now: LastPoseEstimate) -> (u64, u64) {
    let received = if now.run == last.run { now.seq.saturating_sub(last.seq).max(1) } else { 1 };
    // A restarted simulator counts from 0 again.
    let sent = now.scan_seq.checked_sub(last.scan_seq).unwrap_or(1);
    (received.min(sent.max(1)), sent.saturating_sub(received))
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Header;

    fn at(seconds: f64) -> Monotonic {
        Monotonic((seconds * 1e9) as u64)
    }

    fn pose_estimate(run: u64, seq: u64, scan_seq: u64, seconds: f64) -> PoseEstimate {
        let header =
            Header { stamp: Stamp::from_seconds(seconds), seq, incarnation: run, ..Default::default() };
        PoseEstimate { header, scan_seq, ..Default::default() }
    }

    #[test]
    fn ten_scans_a_second_are_10_hz_at_any_phase() {
        let mut scans = ScanCounter::default();
        // The scans' clock is a simulator's, which began long after this one.
        const BEGAN_S: f64 = 1000.0;
        for n in 0..100_u32 {
            let time_s = f64::from(n) * 0.1;
            scans.add(&pose_estimate(1, n.into(), n.into(), time_s), at(BEGAN_S + time_s));
            if n > 10 {
                for late in [0.0, 0.03, 0.099, 0.2] {
                    let rate = scans.rate_hz(at(BEGAN_S + time_s + late));
                    assert!((rate - 10.0).abs() < 1e-6, "{rate}");
                }
            }
        }
        assert_eq!((scans.received, scans.lost), (100, 0));
        assert_eq!(scans.rate_hz(at(BEGAN_S + 9.9 + 0.55)), 5.0);
        assert_eq!(scans.rate_hz(at(BEGAN_S + 20.0)), 0.0);
    }

    #[test]
    fn pose_estimates_that_telemetry_missed_are_not_lost_scans() {
        let mut scans = ScanCounter::default();
        scans.add(&pose_estimate(1, 0, 5, 0.0), at(0.0));
        scans.add(&pose_estimate(1, 1, 6, 0.1), at(0.0));
        scans.add(&pose_estimate(1, 2, 9, 0.4), at(0.0)); // SLAM never saw 7 and 8
        assert_eq!((scans.received, scans.lost), (3, 2));
        scans.add(&pose_estimate(1, 5, 12, 0.7), at(0.0)); // telemetry missed two answers
        assert_eq!((scans.received, scans.lost), (6, 2));
        scans.add(&pose_estimate(2, 0, 16, 1.1), at(0.0)); // SLAM restarted, three scans fell between
        assert_eq!((scans.received, scans.lost), (7, 5));
        scans.add(&pose_estimate(2, 1, 0, 0.0), at(0.0)); // the simulator restarted
        assert_eq!((scans.received, scans.lost), (8, 5));
    }
}
