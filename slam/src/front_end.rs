//! The scan path: one scan in, one pose out, in bounded time. It matches against local maps of
//! the newest nodes in a frame of its own that never jumps; what the back end finds out about the
//! past only moves that frame in the map.

mod deskew;
mod keep;
mod locate;
mod nodes;
mod refuse;

pub use keep::FrontEndState;
pub use refuse::ScanRejection;

use crate::clock_reset::ClockResetDetector;
use crate::config::SlamConfig;
use crate::likelihood_field::SearchBuffers;
use crate::node::{Node, Revision, SweptPath};
use crate::odometry::OdometryBuffer;
use crate::scan_buffers::ScanBufferPool;
use crate::stages::{Stage, StageObserver};
use locate::{PosePrediction, TrackedPose, carried};
use msg::{Correction, Odometry, Pose2, Scan, Stamp, TrackingState};
use nalgebra::{Matrix3, Vector3};
use nodes::LocalMap;
use std::collections::VecDeque;

/// Revisions that wait for their node.
const REVISIONS_MAX: usize = 64;
/// The last motion says nothing after more than this, seconds.
const CARRIED_MAX_S: f64 = 0.5;
/// A robot that is not located may be anywhere: one standard deviation of its place, metres, and of
/// its heading, radians.
const ANYWHERE_M: f64 = 100.0;
const ANYWHERE_RAD: f64 = core::f64::consts::PI;

/// How many scans went which way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrontEndCounts {
    /// Scans that got a pose.
    pub accepted: u64,
    /// See [`ScanRejection::StampRepeated`].
    pub stamp_repeated: u64,
    /// See [`ScanRejection::StampWentBack`].
    pub stamp_went_back: u64,
    /// Clocks that were set back for good: their new time was taken over.
    pub clock_set_back: u64,
    /// See [`ScanRejection::BeamCount`].
    pub beam_count: u64,
    /// See [`ScanRejection::Geometry`].
    pub geometry: u64,
    /// Scans that did not fit the map, or saw too little to tell.
    pub lost: u64,
    /// Odometry messages that were no numbers or not newer than the last.
    pub odometry_rejected: u64,
    /// Times that scans contradicted the map so clearly that the robot must be elsewhere.
    pub odometry_breaks: u64,
    /// Scans that contradicted odometry so clearly that they were believed alone.
    pub slips: u64,
    /// Poses not remembered because the trajectory was full.
    pub trajectory_dropped: u64,
    /// Scans that should have become nodes while too many were under way: they served the scan path alone.
    pub nodes_held_back: u64,
    /// Scans whose beams' times could not be made good: the times cannot be, or the motion is not known.
    pub not_deskewed: u64,
}

/// The answer to one scan.
#[derive(Clone, Debug)]
pub struct ScanResult {
    /// Where the robot is. Of a refused scan: the last pose.
    ///
    /// The covariance is that of the pose in the local map of the newest nodes; how far the map's far
    /// parts have drifted is not in it. While the scan does not fit, it grows with the way since the
    /// newest node; while it is not known where the robot is in its map, it says so (100 m, pi).
    pub correction: Correction,
    /// Set if the scan was not used.
    pub rejected: Option<ScanRejection>,
    /// Set if the scan entered the pose graph: for the back end. ([`crate::Slam`] keeps it.)
    pub node: Option<Node>,
    /// The id of the node that the scan became.
    pub node_id: Option<u32>,
}

/// An accepted scan rides on the newest node.
#[derive(Clone, Copy, Debug)]
pub struct TrajectorySample {
    /// The scan's.
    pub stamp: Stamp,
    /// Which node.
    pub node: u32,
    /// The robot as seen from its node.
    pub node_from_base: Pose2,
}

/// The scan before.
#[derive(Clone, Copy, Debug)]
pub struct LastScan {
    /// Its stamp.
    pub stamp: Stamp,
    /// The robot's pose.
    pub local_from_base: Pose2,
    /// Odometry's, if it was known.
    pub odom_from_base: Option<Pose2>,
    /// Motion over the last interval, and its length in seconds, for logs without odometry.
    pub motion: Option<(Pose2, f64)>,
    /// Of the pose, see [`ScanResult::correction`].
    pub covariance: Matrix3<f64>,
}

/// See the module.
pub struct FrontEnd {
    config: SlamConfig,
    odometry: OdometryBuffer,
    last: Option<LastScan>,
    /// Odometry at the newest node, if it has not jumped since.
    node_odom_from_base: Option<Pose2>,
    /// Of the newest node's pose.
    node_covariance: Matrix3<f64>,
    /// Scans refused for their stamps.
    backward: ClockResetDetector,
    /// Newest scans to match against, newest at the back: the newest nodes, and scans held back.
    recent: VecDeque<Node>,
    next_node: u32,
    /// The newest node handed over, and where it is.
    published: Option<(u32, Pose2)>,
    /// Odometry from it to the newest of `recent`.
    published_from_newest: Option<Pose2>,
    pool: ScanBufferPool,
    local_maps: [LocalMap; 2],
    lost_in_row: u32,
    /// The scan before did not fit.
    last_scan_lost: bool,
    node_wanted: bool,
    /// Where the robot has been since the newest node, in the scan path's own frame.
    swept_path: SweptPath,
    scratch: SearchBuffers,
    points: Vec<[f32; 2]>,
    map_from_local: Pose2,
    /// Whether `map_from_local` is known: where the robot is in its map.
    located: bool,
    /// The newest node that does not follow from the one before: what was said before it of where
    /// the robot is holds no more.
    last_break: Option<u32>,
    closures: u32,
    waiting: VecDeque<Revision>,
    samples: Vec<TrajectorySample>,
    counts: FrontEndCounts,
    stages: Box<dyn StageObserver>,
}

impl FrontEnd {
    /// Ready for the first scan.
    pub fn new(config: SlamConfig) -> Self {
        let t = &config.tracking;
        let local_map = || LocalMap::new(t);
        Self {
            odometry: OdometryBuffer::new(config.odometry.clone()),
            last: None,
            node_odom_from_base: None,
            node_covariance: Matrix3::zeros(),
            backward: ClockResetDetector::default(),
            recent: VecDeque::with_capacity(t.references + 1),
            next_node: 0,
            published: None,
            published_from_newest: Some(Pose2::IDENTITY),
            pool: ScanBufferPool::new(&config),
            local_maps: [local_map(), local_map()],
            lost_in_row: 0,
            last_scan_lost: false,
            node_wanted: false,
            swept_path: SweptPath::default(),
            scratch: SearchBuffers::with_capacity(
                t.search_points_max,
                t.window_max_m,
                t.window_max_rad,
                t.cell_m,
            ),
            points: Vec::with_capacity(t.search_points_max),
            map_from_local: Pose2::IDENTITY,
            located: true,
            last_break: None,
            closures: 0,
            waiting: VecDeque::with_capacity(REVISIONS_MAX),
            // The system gives the memory as it is used.
            samples: Vec::with_capacity(config.graph.trajectory_max),
            counts: FrontEndCounts::default(),
            stages: Box::new(()),
            config,
        }
    }

    /// The robot in the scan path's own frame, at the last scan.
    pub fn local_from_base(&self) -> Pose2 {
        self.last.map_or(Pose2::IDENTITY, |last| last.local_from_base)
    }

    /// Whether it is known where the robot is in its map.
    pub fn is_located(&self) -> bool {
        self.located
    }

    /// Says where the scan path's frame lies in the map, or that it is not known; revisions say it later.
    pub fn set_map_from_local(&mut self, map_from_local: Option<Pose2>) {
        self.located = map_from_local.is_some();
        self.last_break = None;
        self.map_from_local = map_from_local.unwrap_or(self.map_from_local);
        self.waiting.clear();
    }

    /// The next scan that fits becomes a node, even if the robot stands: somebody waits for one.
    pub fn request_node(&mut self) {
        self.node_wanted = true;
    }

    /// From now on this watch hears of every stage.
    pub fn observe_stages(&mut self, observer: Box<dyn StageObserver>) {
        self.stages = observer;
    }

    /// Takes one odometry message.
    pub fn add_odometry(&mut self, odometry: &Odometry) {
        self.odometry.push(odometry);
        self.counts.odometry_rejected = self.odometry.rejected();
    }

    /// Takes the back end's answer to an earlier node.
    pub fn add_revision(&mut self, revision: Revision) {
        if self.waiting.len() == REVISIONS_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back(revision);
    }

    /// Every accepted scan, in order.
    pub fn samples(&self) -> &[TrajectorySample] {
        &self.samples
    }

    /// How many scans went which way.
    pub fn counts(&self) -> FrontEndCounts {
        self.counts
    }

    /// One scan in, one pose out.
    pub fn process(&mut self, scan: &Scan) -> ScanResult {
        if let Some(refusal) = self.refuse(scan) {
            return self.refused(scan, refusal);
        }
        self.backward = ClockResetDetector::default();
        let odom_from_base = self.odometry.at(scan.header.stamp);
        let expected = self.expect(scan.header.stamp, odom_from_base);
        let (sweep, cloud, found) = self.look(scan, &expected, odom_from_base);
        self.forget_slip(&found, odom_from_base);
        self.stages.stage_started(Stage::Node);
        if found.state != TrackingState::Lost && self.config.map.robot_radius_m > 0.0 {
            self.swept_path.note([found.local_from_base.x_m as f32, found.local_from_base.y_m as f32]);
        }
        let due = self.node_due(&found, &cloud);
        let node = if due { self.make_node((scan, &sweep), &found, odom_from_base, cloud) } else { None };
        self.remember(scan.header.stamp, &found, odom_from_base);
        let correction = self.correction(scan, &found, odom_from_base);
        self.stages.stage_started(Stage::Idle);
        ScanResult { correction, rejected: None, node_id: node.as_ref().map(|n| n.id), node }
    }

    fn apply_revisions(&mut self, node: u32) {
        // The newest that is due; those before it are out of date.
        let Some(due) = self.waiting.iter().rposition(|r| r.effective_from <= node) else { return };
        for revision in self.waiting.drain(..=due) {
            self.map_from_local = revision.map_from_local;
            self.located = revision.located && self.last_break.is_none_or(|at| revision.cause >= at);
            self.closures = revision.closures;
        }
    }

    fn remember(&mut self, stamp: Stamp, found: &TrackedPose, odom_from_base: Option<Pose2>) {
        self.counts.accepted += 1;
        if let Some((node, local_from_node)) = self.published {
            let node_from_base = local_from_node.between(found.local_from_base);
            if self.samples.len() < self.config.graph.trajectory_max {
                self.samples.push(TrajectorySample { stamp, node, node_from_base });
            } else {
                self.counts.trajectory_dropped += 1;
            }
        }
        let since = |l: LastScan| (l.local_from_base.between(found.local_from_base), stamp - l.stamp);
        let motion = self.last.map(since).filter(|(_, seconds)| *seconds > 0.0);
        self.last = Some(LastScan {
            stamp,
            local_from_base: found.local_from_base,
            odom_from_base,
            motion,
            covariance: found.covariance,
        });
    }

    fn correction(&self, scan: &Scan, found: &TrackedPose, odom_from_base: Option<Pose2>) -> Correction {
        let map_from_base = self.map_from_local * found.local_from_base;
        let (sin, cos) = self.map_from_local.yaw_rad.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let anywhere = Vector3::new(ANYWHERE_M.powi(2), ANYWHERE_M.powi(2), ANYWHERE_RAD.powi(2));
        let c = match self.located {
            true => turn * found.covariance * turn.transpose(),
            false => Matrix3::from_diagonal(&anywhere),
        };
        let base_from_odom =
            odom_from_base.unwrap_or(Pose2::IDENTITY).inverse() * self.odometry.continuous_from_odom();
        Correction {
            header: msg::Header { stamp: scan.header.stamp, ..Default::default() },
            scan_seq: scan.header.seq,
            scan_sent: scan.header.sent,
            map_from_odom: map_from_base * base_from_odom,
            map_from_base,
            covariance: [c[(0, 0)], c[(0, 1)], c[(0, 2)], c[(1, 1)], c[(1, 2)], c[(2, 2)]],
            state: if self.located { found.state } else { TrackingState::Lost } as u32,
            nodes: self.next_node,
            closures: self.closures,
            reserved: 0,
        }
    }
}
