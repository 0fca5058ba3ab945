//! The front end: one scan in, one pose out, in bounded time.
//!
//! It matches each scan against local maps of the newest nodes, in a frame of its own that never
//! jumps ([`FrontEnd::process`] shows the stages). What the back end finds out about the past
//! only moves that frame in the map.

mod deskew;
mod kidnap_check;
mod local_frame;
mod motion;
mod node_builder;
mod odom_in_map;
mod pose_estimate;
mod scan_check;
mod scan_matcher;
mod state;

pub(crate) use motion::SPEED_SIGMA_SHARE;
pub(crate) use node_builder::UNMEASURED_MAX_S;
pub use scan_check::ScanRejection;
pub use state::FrontEndState;

use crate::clock_reset::ClockResetDetector;
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::node::{MapFrameUpdate, Node, SweptPath};
use crate::relocalize::LocalFrameEstimate;
use crate::scan_buffers::ScanBufferPool;
use crate::stages::{Stage, StageObserver};
use local_frame::LocalFrameInMap;
use motion::MotionModel;
use msg::{Odometry, Pose2, PoseEstimate, Scan, Stamp, TrackingState};
use nalgebra::Matrix3;
use node_builder::NodeBuilder;
use odom_in_map::OdomInMap;
use scan_matcher::{ScanMatcher, TrackedPose};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Counts of scans by what became of them.
// More than 12 fields: one counter for each outcome of a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrontEndCounts {
    /// Scans that got a pose.
    pub accepted: u64,
    /// Scans rejected for [`ScanRejection::StampRepeated`].
    pub rejected_stamp_repeated: u64,
    /// Scans rejected for [`ScanRejection::StampWentBack`].
    pub rejected_stamp_went_back: u64,
    /// Clocks that were set back for good: their new time was taken over.
    pub clock_resets: u64,
    /// Scans rejected for [`ScanRejection::BeamCount`].
    pub rejected_beam_count: u64,
    /// Scans rejected for [`ScanRejection::Geometry`].
    pub rejected_geometry: u64,
    /// Scans that did not fit the map, or saw too little to tell.
    pub lost: u64,
    /// Odometry messages that were no numbers or not newer than the last.
    pub rejected_odometry: u64,
    /// Times that scans contradicted the map so clearly that the robot must be elsewhere: odometry breaks.
    pub odometry_breaks: u64,
    /// Scans that contradicted odometry so clearly that they alone determined the pose.
    pub slips: u64,
    /// Poses not remembered because the trajectory was full.
    pub trajectory_dropped: u64,
    /// Scans that were due to become nodes while too many were in flight: only the front end used them.
    pub nodes_held_back: u64,
    /// Scans that were not deskewed: their time increment is implausible, or the motion is unknown.
    pub not_deskewed: u64,
}

/// The answer to one scan.
#[derive(Clone, Debug)]
pub struct ScanResult {
    /// Pose of the robot with its covariance; after a rejected scan the last one.
    ///
    /// The covariance is that of the pose in the map, as seen from one node of it, the first where all are placed. While the scan does not fit, it
    /// grows with the path since the newest node. While the robot is not located in its map, it is that of an unknown
    /// pose (100 m, pi).
    pub pose_estimate: PoseEstimate,
    /// Covariance over (x, y, yaw) of the pose in the local map of the newest nodes, in the front end's frame: how well
    /// the scan fits, whatever the map has drifted since its first node.
    pub local_covariance: Matrix3<f64>,
    /// Reason why the scan was not used; `None` if it was.
    pub rejected: Option<ScanRejection>,
    /// The node for the back end, if the scan became one. ([`crate::Slam`] keeps it.)
    pub node: Option<Node>,
    /// The id of the node that the scan became.
    pub node_id: Option<u32>,
}

/// Pose of an accepted scan relative to the newest node, with which it moves when the graph is solved.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct TrajectorySample {
    /// Stamp of the scan.
    pub stamp: Stamp,
    /// The front end's number of the node.
    pub node: u32,
    /// Pose of the robot in the frame of the node.
    pub node_from_base: Pose2,
    /// Whether the robot was lost: its scan fitted nothing, so that the pose is a guess.
    pub is_lost: bool,
}

/// The last accepted scan.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct LastScan {
    /// Stamp of the scan.
    pub stamp: Stamp,
    /// Pose of the robot in the front end's frame.
    pub local_from_base: Pose2,
    /// Pose by odometry in its continuous frame, which does not jump when the driver is started again; `None` where
    /// odometry was missing.
    pub continuous_from_base: Option<Pose2>,
    /// Motion over the last interval, and its length in seconds, for logs without odometry.
    pub motion: Option<(Pose2, f64)>,
    /// Covariance of the pose, see [`ScanResult::pose_estimate`].
    #[serde(with = "crate::encoding::matrix")]
    pub covariance: Matrix3<f64>,
}

/// The front end of one robot's SLAM; see the module, and [`BackEnd`](crate::BackEnd) for an example of both.
pub struct FrontEnd {
    config: SlamConfig,
    /// Buffers of clouds and rays, shared with nodes.
    scan_buffers: ScanBufferPool,
    clock_reset: ClockResetDetector,
    motion: MotionModel,
    matcher: ScanMatcher,
    node_builder: NodeBuilder,
    frame: LocalFrameInMap,
    /// Pose of odometry's frame in the map.
    odom_in_map: OdomInMap,
    samples: Vec<TrajectorySample>,
    counts: FrontEndCounts,
    stages: Box<dyn StageObserver>,
}

impl FrontEnd {
    /// A front end ready for the first scan. All memory is allocated here.
    pub fn new(config: SlamConfig) -> Self {
        Self {
            scan_buffers: ScanBufferPool::new(&config),
            clock_reset: ClockResetDetector::default(),
            motion: MotionModel::new(&config.odometry),
            matcher: ScanMatcher::new(&config.tracking),
            node_builder: NodeBuilder::new(),
            frame: LocalFrameInMap::new(),
            odom_in_map: OdomInMap::default(),
            // The operating system provides the memory as it is used.
            samples: Vec::with_capacity(config.graph.trajectory_max),
            counts: FrontEndCounts::default(),
            stages: Box::new(()),
            config,
        }
    }

    /// Processes one scan and returns the robot's pose.
    pub fn process(&mut self, scan: &Scan) -> ScanResult {
        // Reject a scan whose stamp or geometry cannot be used.
        if let Some(rejection) = self.check(scan) {
            return self.reject(scan, rejection);
        }
        // Predict the pose from odometry, or from the last motion.
        let stamp = scan.header.stamp;
        let continuous_from_base = self.motion.odometry.at(stamp);
        let prediction = self.predict(scan, continuous_from_base);
        // Take the robot's motion out of the scan, and match it against the local map.
        let (beam_poses, cloud, pose) = self.deskew_and_match(scan, &prediction, continuous_from_base);
        // A robot that stood and sees something else now was carried elsewhere.
        let (pose, is_kidnapped) = self.check_for_kidnapping(stamp, &cloud, pose, continuous_from_base);
        self.count_unmeasured_time(stamp, &pose, continuous_from_base);
        // Odometry that slipped, or that is back after it was missing, counts from the matched pose.
        self.rebase_odometry(&pose, continuous_from_base);
        // Record where the robot's body was.
        self.stages.stage_started(Stage::Node);
        self.extend_swept_path(&pose);
        // After enough motion the scan becomes a node of the pose graph.
        let is_due = self.is_node_due(&pose, &cloud) || is_kidnapped;
        let node = if is_due {
            self.add_node((scan, &beam_poses), &pose, continuous_from_base, cloud)
        } else {
            None
        };
        // Record the pose for the trajectory and for the next prediction.
        self.record(stamp, &pose, continuous_from_base);
        // Answer in the map's frame.
        let pose_estimate = self.pose_estimate(scan, &pose, continuous_from_base);
        self.stages.stage_started(Stage::Idle);
        ScanResult {
            pose_estimate,
            local_covariance: pose.covariance,
            rejected: None,
            node_id: node.as_ref().map(|n| n.id),
            node,
        }
    }

    /// Adds one odometry message. Returns false if it is rejected: it is not finite, or not newer than the last.
    pub fn add_odometry(&mut self, odometry: &Odometry) -> bool {
        let is_added = self.motion.odometry.push(odometry);
        self.counts.rejected_odometry = self.motion.odometry.rejected();
        is_added
    }

    /// Returns, once, whether the robot has moved in an unknown way: after a session was restored, odometry came from
    /// a driver that was started again since. The robot is not located then, and the back end must relocalize it.
    pub fn take_unknown_motion(&mut self) -> bool {
        let is_unknown = self.motion.odometry.take_unknown_motion();
        if is_unknown {
            self.motion.forget();
            self.odom_in_map = OdomInMap::default();
            self.frame.set(None);
            self.request_node();
        }
        is_unknown
    }

    /// Pose by odometry at a stamp, in the driver's own frame; `None` if odometry is missing there.
    pub fn odom_from_base(&self, stamp: Stamp) -> Option<Pose2> {
        let odometry = &self.motion.odometry;
        Some(odometry.continuous_from_odom().inverse() * odometry.at(stamp)?)
    }

    /// Adds the back end's answer to an earlier node; it takes effect with the node that it names.
    pub fn add_frame_update(&mut self, frame_update: MapFrameUpdate) {
        self.frame.add_frame_update(frame_update);
    }

    /// Takes over how good the map and the robot's place in it are, before the first node of a session that goes on.
    pub(crate) fn restore_quality(&mut self, frame_update: MapFrameUpdate) {
        self.frame.restore_quality(frame_update);
    }

    /// Applies a frame update at once, as after a change of the graph that no node caused.
    pub fn apply_frame_update(&mut self, frame_update: MapFrameUpdate) {
        self.frame.replace_frame_updates(frame_update);
    }

    /// Sets the pose of the front end's frame in the map until the next frame update; `None` marks the robot as not located.
    pub fn set_map_from_local(&mut self, map_from_local: Option<Pose2>) {
        self.frame.set(map_from_local);
    }

    /// Sets the pose of the front end's frame in the map to what a person said, until the next frame update.
    pub fn set_initial_estimate(&mut self, estimate: LocalFrameEstimate) {
        self.frame.set_initial_estimate(estimate, self.local_from_base());
    }

    /// Requests a node: the next scan that fits becomes one, even if the robot stands.
    pub fn request_node(&mut self) {
        self.node_builder.requested = true;
    }

    /// Reports every stage of the work to this observer from now on.
    pub fn observe_stages(&mut self, observer: Box<dyn StageObserver>) {
        self.stages = observer;
    }

    /// Pose of the robot in the front end's own frame, at the last scan.
    pub fn local_from_base(&self) -> Pose2 {
        self.motion.last.map_or(Pose2::IDENTITY, |last| last.local_from_base)
    }

    /// Whether the robot is located in its map.
    pub fn is_located(&self) -> bool {
        self.frame.is_located
    }

    /// Every accepted scan's pose relative to its node, in order.
    pub fn samples(&self) -> &[TrajectorySample] {
        &self.samples
    }

    /// Counts of scans by what became of them.
    pub fn counts(&self) -> FrontEndCounts {
        self.counts
    }

    fn extend_swept_path(&mut self, pose: &TrackedPose) {
        if pose.is_tracked && self.config.map.robot_radius_m > 0.0 {
            let position = [pose.local_from_base.x_m as f32, pose.local_from_base.y_m as f32];
            self.node_builder.swept_path.push(position);
        }
    }

    fn is_node_due(&mut self, pose: &TrackedPose, cloud: &Cloud) -> bool {
        self.counts.lost += u64::from(pose.state == TrackingState::Lost);
        let newest = self.matcher.references.back();
        self.node_builder.is_due(pose, cloud.points().len(), newest, &self.config.tracking)
    }

    /// Makes the scan a reference to match against, and returns it as a node if the back end has capacity.
    fn add_node(
        &mut self,
        (scan, beam_poses): (&Scan, &crate::beam_poses::BeamPoses),
        pose: &TrackedPose,
        continuous_from_base: Option<Pose2>,
        cloud: Arc<Cloud>,
    ) -> Option<Node> {
        let id = self.node_builder.next_node;
        let is_tracked = pose.is_tracked;
        if !is_tracked && self.matcher.contradicts(&cloud, pose.local_from_base) {
            self.add_odometry_break();
        }
        let moved = self.motion.moved_since_reference(continuous_from_base);
        self.motion.continuous_from_reference = continuous_from_base;
        self.motion.reference_covariance = pose.covariance;
        let node = Node {
            id,
            header: scan.header,
            local_from_base: pose.local_from_base,
            previous_from_this: self.node_builder.last_node_from_reference.zip(moved).map(|(a, b)| a * b),
            is_tracked,
            odometry_break: self.frame.last_odometry_break == Some(id),
            disconnected_component: None,
            uncertain_component: None,
            unmeasured_s: 0.0,
            slip: [0.0; 3],
            possibly_kidnapped: false,
            cloud,
            rays: self.scan_buffers.rays(scan, beam_poses, &self.config),
            swept_path: SweptPath::default(),
        };
        let has_capacity = self.scan_buffers.has_capacity(self.matcher.references.len() + 1);
        if !is_tracked {
            self.node_builder.lost_in_row = 0;
        }
        self.matcher.add_reference(node.clone(), !is_tracked, &self.config.tracking);
        if !has_capacity {
            self.node_builder.last_node_from_reference = node.previous_from_this;
            self.counts.nodes_held_back += 1;
            return None;
        }
        self.frame.apply_frame_updates(id);
        // A path that the scans contradict was another one.
        let keep_path = self.config.map.robot_radius_m > 0.0 && is_tracked && !node.odometry_break;
        Some(self.node_builder.publish(node, keep_path))
    }

    fn record(&mut self, stamp: Stamp, pose: &TrackedPose, continuous_from_base: Option<Pose2>) {
        self.counts.accepted += 1;
        if let Some((node, local_from_node)) = self.node_builder.published {
            let node_from_base = local_from_node.between(pose.local_from_base);
            if self.samples.len() < self.config.graph.trajectory_max {
                let is_lost = pose.state == TrackingState::Lost;
                self.samples.push(TrajectorySample { stamp, node, node_from_base, is_lost });
            } else {
                self.counts.trajectory_dropped += 1;
            }
        }
        self.motion.record(stamp, pose.local_from_base, pose.covariance, continuous_from_base);
    }
}
