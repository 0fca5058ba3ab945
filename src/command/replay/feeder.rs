//! Feeds a log's scans and odometry to the front end, as a robot would send them.

use super::records::{Log, LogScan};
use super::{PROGRESS, ReplayArgs};
use crate::command::output;
use msg::{Odometry, Pose2, Scan, Stamp};
use slam::{FrontEnd, Node};
use std::time::{Duration, Instant};

/// Longest time between the end of a scan and the odometry after it, seconds: as between a scan and its odometry.
const ODOMETRY_GAP_MAX_S: f64 = 0.5;

/// Converts a log's scans to messages and feeds them to the front end, with the odometry up to the end of each sweep.
pub struct Feeder<'a> {
    scan: Box<Scan>,
    /// Odometry that was not fed yet, in order of time; empty where each scan has its own.
    odometry: &'a [(Stamp, Pose2)],
    /// Each scan has its own odometry, as in a CARMEN log.
    has_own_odometry: bool,
    /// Stamp of the newest odometry that was fed.
    fed_to: Option<Stamp>,
    fov_rad: Option<f64>,
    noted: Instant,
    /// Number of scans.
    pub seq: u64,
    /// Duration of the front end for each scan.
    pub times: Vec<Duration>,
    /// Scans that got no pose in the map.
    pub not_located: u64,
    /// Stamps and poses in the map of the others.
    pub located: Vec<(Stamp, Pose2)>,
}

impl<'a> Feeder<'a> {
    /// Creates a feeder before the first scan.
    pub fn new(args: &ReplayArgs, log: &'a Log) -> Self {
        Self {
            scan: bytemuck::allocation::zeroed_box(),
            odometry: log.odometry(),
            has_own_odometry: log.odometry().is_empty(),
            fed_to: None,
            fov_rad: args.fov_deg.map(f64::to_radians),
            noted: Instant::now(),
            seq: 0,
            times: Vec::new(),
            not_located: 0,
            located: Vec::new(),
        }
    }

    /// Feeds one scan. Returns the node that it became, if it did.
    pub fn scan(&mut self, front: &mut FrontEnd, scan: &LogScan) -> Option<Node> {
        scan.write_to(&mut self.scan, self.seq, self.fov_rad);
        self.seq += 1;
        if self.has_own_odometry {
            add_odometry(front, (scan.line.stamp, scan.line.odom_from_base));
        } else {
            self.feed_odometry(front);
        }
        let start = Instant::now();
        let step = front.process(&self.scan);
        self.times.push(start.elapsed());
        if step.rejected.is_none() {
            if front.is_located() {
                self.located.push((self.scan.header.stamp, step.pose_estimate.map_from_base));
            } else {
                self.not_located += 1;
            }
        }
        if self.noted.elapsed() > PROGRESS {
            self.noted = Instant::now();
            output::note(&format!("{} scans, {} nodes", self.seq, step.pose_estimate.nodes));
        }
        step.node
    }

    /// Feeds the odometry up to the scan's last beam, and the first message after it: a robot's driver sends a scan when it is
    /// complete, and a log can wait for the odometry.
    fn feed_odometry(&mut self, front: &mut FrontEnd) {
        let beams = f64::from(self.scan.len.saturating_sub(1));
        let sweep_s = (f64::from(self.scan.time_increment_s) * beams).clamp(0.0, 1.0);
        let stamp = self.scan.header.stamp;
        while let Some((pose, rest)) = self.odometry.split_first()
            && self.fed_to.is_none_or(|fed_to| fed_to - stamp < sweep_s)
            && pose.0 - stamp <= sweep_s + ODOMETRY_GAP_MAX_S
        {
            add_odometry(front, *pose);
            (self.odometry, self.fed_to) = (rest, Some(pose.0));
        }
    }
}

fn add_odometry(front: &mut FrontEnd, (stamp, odom_from_base): (Stamp, Pose2)) {
    let header = msg::Header { stamp, ..Default::default() };
    front.add_odometry(&Odometry { header, odom_from_base, ..Default::default() });
}

#[cfg(test)]
mod tests {
    use super::super::tests::args;
    use super::*;
    use recording::bag::{Bag, BagScan};
    use slam::{InitialPose, SlamConfig};
    use std::path::Path;

    /// A robot that turns by 1 rad/s: odometry at 20 Hz, and swept scans at 5 Hz in a round room.
    fn turning(time_increment_s: f32) -> Log {
        let at = |seconds: f64| (Stamp::from_seconds(seconds), Pose2::new(0.0, 0.0, seconds));
        let scan = |step: u32| {
            let (stamp, odom_from_base) = at(0.2 * f64::from(step) + 0.01);
            BagScan {
                stamp,
                odom_from_base,
                world_from_base: None,
                angle_min_rad: -3.0,
                angle_increment_rad: 0.06,
                time_increment_s,
                scan_time_s: 0.2,
                range_min_m: 0.3,
                range_max_m: 8.0,
                ranges_m: vec![2.0; 101],
            }
        };
        let scans: Vec<BagScan> = (0..5).map(scan).collect();
        let mut odometry: Vec<_> = (0..40).map(|step| at(0.05 * f64::from(step))).collect();
        odometry.extend(scans.iter().map(|scan| (scan.stamp, scan.odom_from_base)));
        odometry.sort_by_key(|(stamp, _)| *stamp);
        Log::of_bag(Bag { scans, odometry, ..Bag::default() }, Vec::new())
    }

    #[test]
    fn odometry_is_known_to_the_end_of_each_sweep_and_no_scan_goes_without() {
        for (time_increment_s, sweep_s) in [(0.0, 0.0), (0.0019, 0.19)] {
            let log = turning(time_increment_s);
            let args = args(Path::new("turning.mcap"));
            let (mut front, _) =
                slam::create_or_resume(SlamConfig::default(), None, args.mode.into(), InitialPose::Unknown);
            let (mut feeder, mut records) = (Feeder::new(&args, &log), log.records());
            while let Some(scan) = records.next_laser() {
                feeder.scan(&mut front, &scan);
                for share in [0.0, 0.4, 1.0] {
                    let after_s = share * sweep_s;
                    let stamp = Stamp(scan.line.stamp.0 + (after_s * 1e9) as i64);
                    let yaw = front.odom_from_base(stamp).unwrap().yaw_rad;
                    assert!((yaw - stamp.seconds()).abs() < 1e-6, "{yaw} at {stamp:?}, sweep of {sweep_s} s");
                }
            }
            let counts = front.counts();
            assert_eq!((counts.accepted, counts.rejected_odometry, counts.not_deskewed), (5, 0, 0));
        }
    }

    #[test]
    fn a_narrower_field_of_view_begins_later_in_the_sweep() {
        let log = turning(0.002);
        let first = log.records().next_laser().unwrap();
        let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
        first.write_to(&mut scan, 0, None);
        assert_eq!((scan.time_increment_s, scan.range_min_m, scan.len), (0.002, 0.3, 101));
        assert_eq!(scan.header.stamp, first.line.stamp);
        first.write_to(&mut scan, 1, Some(1.2));
        assert_eq!(scan.len, 21);
        assert!((scan.header.stamp - first.line.stamp - 40.0 * 0.002).abs() < 1e-6, "{:?}", scan.header);
    }
}
