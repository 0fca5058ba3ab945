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
    has_own_odometry: bool,
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
        while let Some((pose, rest)) = self.odometry.split_first() {
            if pose.0 - stamp > sweep_s + ODOMETRY_GAP_MAX_S {
                break;
            }
            add_odometry(front, *pose);
            self.odometry = rest;
            if pose.0 - stamp >= sweep_s {
                break;
            }
        }
    }
}

fn add_odometry(front: &mut FrontEnd, (stamp, odom_from_base): (Stamp, Pose2)) {
    let header = msg::Header { stamp, ..Default::default() };
    front.add_odometry(&Odometry { header, odom_from_base, ..Default::default() });
}
