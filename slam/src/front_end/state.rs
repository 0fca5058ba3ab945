//! State of the front end, kept in a session.

use super::motion::MotionModel;
use super::node_builder::NodeBuilder;
use super::{FrontEnd, FrontEndCounts, LastScan};
use crate::config::SlamConfig;
use crate::node::{MapFrameUpdate, Node, SweptPath};
use crate::odometry::OdometryBuffer;
use msg::{Odometry, Pose2};
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

/// State of the front end as plain values. Its local maps are rebuilt from the newest nodes.
// More than 12 fields: one for each value that a session stores.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FrontEndState {
    /// Id of the next node.
    pub next_node: u32,
    /// Number of the newest nodes that serve as references of scan matching.
    pub reference_count: u32,
    /// Number of the newest nodes in the older and in the younger local map.
    pub local_maps: [u32; 2],
    /// Number of consecutive scans that did not fit, up to the last one.
    pub lost_in_row: u32,
    /// Whether the last scan did not fit.
    pub last_scan_lost: bool,
    /// Number of active closures, by the last frame update.
    pub closures: u32,
    /// Whether the robot is located, so that `map_from_local` is valid.
    pub located: bool,
    /// Pose of the front end's frame in the loop-closed map.
    pub map_from_local: Pose2,
    /// Motion by odometry from the newest published node to the newest reference scan; `None` if unknown.
    pub last_node_from_reference: Option<Pose2>,
    /// What odometry measured too much since the newest node, where scans contradicted it: (x, y, yaw), metres and radians.
    pub slip: [f64; 3],
    /// Pose of the newest reference scan in the continuous frame of odometry; `None` if unknown.
    pub continuous_from_reference: Option<Pose2>,
    /// Covariance over (x, y, yaw) of the newest reference scan's pose.
    #[serde(with = "crate::encoding::matrix")]
    pub reference_covariance: Matrix3<f64>,
    /// The newest node with an odometry break before it.
    pub last_odometry_break: Option<u32>,
    /// The last accepted scan.
    pub last: Option<LastScan>,
    /// Counts of scans by what became of them.
    pub counts: FrontEndCounts,
    /// Frame updates that take effect with a later node, oldest first.
    pub frame_updates: Vec<MapFrameUpdate>,
    /// The newest odometry messages; their `odom_from_base` is the pose in the continuous frame.
    pub odometry: Vec<Odometry>,
    /// Pose of the odometry frame in the continuous frame, which does not jump when the writer restarts.
    pub continuous_from_odom: Pose2,
    /// Number of odometry messages rejected.
    pub rejected_odometry: u64,
    /// Positions of the robot since the newest node, in the front end's frame.
    pub swept_path: SweptPath,
}

impl FrontEnd {
    /// A front end that continues where another one was when it gave [`FrontEnd::state`]. `newest` are the
    /// map's newest nodes, in order: as many as the state speaks of.
    pub fn resume(config: SlamConfig, state: FrontEndState, newest: &[Node]) -> Self {
        let mut front = Self::new(config);
        front.matcher.restore(newest, state.reference_count, state.local_maps, &front.config.tracking);
        front.motion = MotionModel {
            odometry: OdometryBuffer::from_parts(
                front.config.odometry.clone(),
                &state.odometry,
                state.continuous_from_odom,
                state.rejected_odometry,
            ),
            last: state.last,
            continuous_from_reference: state.continuous_from_reference,
            reference_covariance: state.reference_covariance,
        };
        front.node_builder = NodeBuilder {
            next_node: state.next_node,
            published: newest.last().map(|node| (state.next_node.saturating_sub(1), node.local_from_base)),
            last_node_from_reference: state.last_node_from_reference,
            lost_in_row: state.lost_in_row,
            last_scan_lost: state.last_scan_lost,
            requested: false,
            unmeasured_s: 0.0,
            slip: state.slip,
            possibly_kidnapped: false,
            swept_path: state.swept_path,
        };
        front.frame.restore_frame_updates(state.frame_updates);
        front.frame.map_from_local = state.map_from_local;
        front.frame.is_located = state.located;
        front.frame.last_odometry_break = state.last_odometry_break;
        front.frame.closures = state.closures;
        front.counts = state.counts;
        if let Some(last) = state.last {
            let map_from_local = state.located.then_some(state.map_from_local);
            front.odom_in_map.update(last.local_from_base, last.continuous_from_base, map_from_local);
        }
        front
    }

    /// The state to be kept in a session. Copies the odometry buffer.
    pub fn state(&self) -> FrontEndState {
        let (odometry, continuous_from_odom, rejected_odometry) = self.motion.odometry.parts();
        FrontEndState {
            next_node: self.node_builder.next_node,
            reference_count: self.matcher.references.len() as u32,
            local_maps: [0, 1].map(|k: usize| self.matcher.local_maps[k].nodes as u32),
            lost_in_row: self.node_builder.lost_in_row,
            last_scan_lost: self.node_builder.last_scan_lost,
            closures: self.frame.closures,
            located: self.frame.is_located,
            map_from_local: self.frame.map_from_local,
            last_node_from_reference: self.node_builder.last_node_from_reference,
            slip: self.node_builder.slip,
            continuous_from_reference: self.motion.continuous_from_reference,
            reference_covariance: self.motion.reference_covariance,
            last_odometry_break: self.frame.last_odometry_break,
            last: self.motion.last,
            counts: self.counts,
            frame_updates: self.frame.frame_updates.iter().copied().collect(),
            odometry,
            continuous_from_odom,
            rejected_odometry,
            swept_path: self.node_builder.swept_path,
        }
    }
}
