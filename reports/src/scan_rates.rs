//! Mean scan rate of each robot over a run, from the counts in successive statistics.

use crate::FleetView;

/// Counts of one robot.
#[derive(Clone, Copy, Debug)]
struct RobotScans {
    first_s: f64,
    newest_s: f64,
    /// Count of the newest statistics.
    newest: u64,
    /// Scans between the first and the newest statistics.
    total: u64,
    /// Lost scans by the newest statistics, and before its counts began anew.
    lost: u64,
    lost_before: u64,
}

/// Scans of all robots since the first statistics. A restart of SLAM or of telemetry begins its count at 0 again.
#[derive(Clone, Debug, Default)]
pub struct ScanRates(Vec<Option<RobotScans>>);

impl ScanRates {
    /// Adds new statistics.
    pub fn add(&mut self, fleet: &FleetView) {
        self.0.resize(fleet.robots.len(), None);
        for (scans, robot) in self.0.iter_mut().zip(&fleet.robots) {
            let scans = scans.get_or_insert(RobotScans {
                first_s: fleet.time_s,
                newest_s: fleet.time_s,
                newest: robot.scans,
                total: 0,
                lost: robot.scans_lost.unwrap_or(0),
                lost_before: 0,
            });
            let lost = robot.scans_lost.unwrap_or(0);
            if lost < scans.lost {
                scans.lost_before += scans.lost;
            }
            scans.lost = lost;
            scans.total += robot.scans.checked_sub(scans.newest).unwrap_or(robot.scans);
            (scans.newest, scans.newest_s) = (robot.scans, fleet.time_s);
        }
    }

    /// Fills in each robot's mean rate, Hz, and all its lost scans. The rate stays unknown until there are two statistics.
    pub fn fill(&self, fleet: &mut FleetView) {
        for (scans, robot) in self.0.iter().zip(&mut fleet.robots) {
            let lost_before = scans.map_or(0, |scans| scans.lost_before);
            robot.scans_lost = robot.scans_lost.map(|lost| lost + lost_before);
            robot.scan_hz = scans.and_then(|scans| {
                let span_s = scans.newest_s - scans.first_s;
                (span_s > 0.0).then(|| scans.total as f64 / span_s)
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{FleetStats, Stamp};

    fn view(seconds: f64, scans: u64) -> FleetView {
        let mut stats: Box<FleetStats> = bytemuck::allocation::zeroed_box();
        stats.header.stamp = Stamp::from_seconds(seconds);
        stats.robot_count = 1;
        stats.robots[0].scans = scans;
        FleetView::new(&stats)
    }

    fn mean(counts: &[(f64, u64)]) -> Option<f64> {
        let mut rates = ScanRates::default();
        counts.iter().for_each(|(seconds, scans)| rates.add(&view(*seconds, *scans)));
        let (seconds, scans) = counts[counts.len() - 1];
        let mut fleet = view(seconds, scans);
        rates.fill(&mut fleet);
        fleet.robots[0].scan_hz
    }

    #[test]
    fn the_mean_is_over_the_whole_run_and_not_of_the_last_second() {
        // Ten seconds at 10 Hz, ten without a scan, one second at 10 Hz.
        assert_eq!(mean(&[(1.0, 10), (11.0, 110), (21.0, 110), (22.0, 120)]), Some(110.0 / 21.0));
        assert_eq!(mean(&[(1.0, 10)]), None);
    }

    #[test]
    fn lost_scans_are_counted_over_restarts_of_telemetry() {
        let mut rates = ScanRates::default();
        let mut fleet = view(0.0, 0);
        for (seconds, lost) in [(1.0, 3), (2.0, 5), (3.0, 0), (4.0, 1)] {
            fleet = view(seconds, 10);
            fleet.robots[0].scans_lost = Some(lost);
            rates.add(&fleet);
        }
        rates.fill(&mut fleet);
        assert_eq!(fleet.robots[0].scans_lost, Some(6));
        fleet.robots[0].scans_lost = None;
        rates.fill(&mut fleet);
        assert_eq!(fleet.robots[0].scans_lost, None, "what is not known is not 0");
    }

    #[test]
    fn a_count_that_begins_anew_goes_on() {
        assert_eq!(mean(&[(0.0, 100), (10.0, 200), (12.0, 10), (20.0, 90)]), Some(190.0 / 20.0));
    }
}
