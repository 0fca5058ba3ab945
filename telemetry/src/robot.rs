//! Statistics of one robot.

use crate::Histogram;
use crate::jitter::TransformJitter;
use crate::scans::ScanCounter;
use heapless::Deque;
use msg::{GroundTruth, Monotonic, Pose2, PoseEstimate, RobotStats, Stamp, TrackingState};
use std::time::Duration;

/// True poses kept until the pose estimate of that time arrives: more than half a second at 100 Hz.
const TRUTHS_MAX: usize = 64;
/// Largest gap between the stamps of a true pose and a pose estimate that are compared, seconds: 2 cm at 0.2 m/s.
const TRUTH_GAP_MAX_S: f64 = 0.1;
/// A state that SLAM has not repeated for so long is not known any more: its process has ended or hangs, or no scan comes.
const SILENT: Duration = Duration::from_secs(3);

/// Scans for which the latency of their map means something: not those of a map that a restarted process had saved, and
/// not those of a map that was drawn before telemetry began.
#[derive(Default)]
struct MapScans {
    /// Incarnation of the SLAM process that sent the newest pose estimate.
    slam_incarnation: Option<u64>,
    /// When the first scan was sent that this SLAM process answered.
    first_sent: Option<Monotonic>,
    /// When the newest scan was sent that was in a map.
    newest_in_map: Monotonic,
}

impl MapScans {
    fn add_pose_estimate(&mut self, pose_estimate: &PoseEstimate) {
        if self.slam_incarnation != Some(pose_estimate.header.incarnation) {
            self.slam_incarnation = Some(pose_estimate.header.incarnation);
            self.first_sent = Some(pose_estimate.scan_sent);
        }
    }

    fn accept_map(&mut self, scan_sent: Monotonic) -> bool {
        let is_answered = self.first_sent.is_some_and(|first| scan_sent >= first);
        let is_accepted = is_answered && scan_sent >= self.newest_in_map;
        if is_accepted {
            self.newest_in_map = scan_sent;
        }
        is_accepted
    }
}

/// Messages of one robot, counted.
#[derive(Default)]
pub(crate) struct RobotTelemetry {
    /// Scans whose maps have a latency.
    map_scans: MapScans,
    /// Jitter of its transforms.
    pub jitter: TransformJitter,
    scans: ScanCounter,
    scan_to_pose: Histogram,
    scan_to_map: Histogram,
    newest: Option<PoseEstimate>,
    /// When the newest pose estimate came.
    newest_received: Monotonic,
    truths: Deque<(Stamp, Pose2), TRUTHS_MAX>,
}

impl RobotTelemetry {
    /// Adds SLAM's answer to a scan.
    pub fn add_pose_estimate(&mut self, pose_estimate: &PoseEstimate, received: Monotonic) {
        self.map_scans.add_pose_estimate(pose_estimate);
        self.scans.add(pose_estimate, received);
        record_latency(&mut self.scan_to_pose, pose_estimate.scan_sent, received);
        self.newest = Some(*pose_estimate);
        self.newest_received = received;
    }

    /// Records the latency of a map, unless it is older than one before.
    pub fn record_map_arrival(&mut self, scan_sent: Monotonic, received: Monotonic) {
        if self.map_scans.accept_map(scan_sent) {
            record_latency(&mut self.scan_to_map, scan_sent, received);
        }
    }

    /// Adds a true pose.
    pub fn add_truth(&mut self, truth: &GroundTruth) {
        if self.truths.is_full() {
            self.truths.pop_front();
        }
        let _ = self.truths.push_back((truth.header.stamp, truth.world_from_base));
    }

    /// Computes the robot's statistics, with the cell counts of its map. `world_from_robot_map`: where its map lies in truth, if that is
    /// known.
    pub fn stats(
        &self,
        counts: RobotStats,
        world_from_robot_map: Option<Pose2>,
        now: Monotonic,
    ) -> RobotStats {
        let pose_estimate = self.newest.unwrap_or_default();
        let is_silent = self.newest.is_some() && now > self.newest_received + SILENT;
        RobotStats {
            state: if is_silent { TrackingState::UNKNOWN_CODE } else { pose_estimate.state },
            scan_hz: self.scans.rate_hz(now),
            scans: self.scans.received,
            scans_lost: self.scans.lost,
            tf_jitter_ms: self.jitter.deviations().distribution_ms(),
            scan_to_pose_ms: self.scan_to_pose.distribution_ms(),
            scan_to_map_ms: self.scan_to_map.distribution_ms(),
            map_from_base: pose_estimate.map_from_base,
            pose_error_m: self.pose_error_m(world_from_robot_map).unwrap_or(f64::NAN),
            nodes: pose_estimate.nodes,
            closures: pose_estimate.closures,
            ..counts
        }
    }

    /// Returns the distance of SLAM's newest pose from the true one of nearly the same time, metres.
    fn pose_error_m(&self, world_from_robot_map: Option<Pose2>) -> Option<f64> {
        let pose_estimate = self.newest.as_ref()?;
        let gap_s = |stamp: Stamp| (stamp - pose_estimate.header.stamp).abs();
        let nearest = self.truths.iter().min_by(|a, b| gap_s(a.0).total_cmp(&gap_s(b.0)))?;
        let world_from_base = world_from_robot_map? * pose_estimate.map_from_base;
        (gap_s(nearest.0) <= TRUTH_GAP_MAX_S).then(|| world_from_base.distance_m(nearest.1))
    }
}

/// Records a latency, unless the time of sending is missing or lies ahead.
fn record_latency(histogram: &mut Histogram, sent: Monotonic, received: Monotonic) {
    if sent != Monotonic::default() && sent <= received {
        histogram.add(received.since(sent));
    }
}
