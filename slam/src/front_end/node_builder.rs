//! Node builder: decides which scans become pose-graph nodes, and relates each node to the one before.

use super::scan_matcher::TrackedPose;
use crate::config::TrackingConfig;
use crate::node::{Node, SweptPath};
use msg::Pose2;

/// Beyond this time in which nothing measured the motion, the place is unknown, seconds.
pub(crate) const UNMEASURED_MAX_S: f32 = 1.5;

/// Numbers nodes and decides when the next one is due.
pub(super) struct NodeBuilder {
    /// Id of the next node.
    pub next_node: u32,
    /// Id of the newest node sent to the back end, and its pose in the front end's frame.
    pub published: Option<(u32, Pose2)>,
    /// Motion by odometry from that node to the newest reference scan.
    pub last_node_from_reference: Option<Pose2>,
    /// Scans in a row that did not fit.
    pub lost_in_row: u32,
    /// Whether the last scan did not fit.
    pub last_scan_lost: bool,
    /// Whether a node was requested: the next scan that fits becomes one.
    pub requested: bool,
    /// Time since the newest node in which neither odometry nor scans measured the motion, seconds.
    pub unmeasured_s: f32,
    /// What odometry measured too much since the newest node, where scans contradicted it: (x, y, yaw), metres and radians.
    pub slip: [f64; 3],
    /// Whether the robot may have been kidnapped since the newest node.
    pub possibly_kidnapped: bool,
    /// Positions since the newest node, in the front end's frame.
    pub swept_path: SweptPath,
}

impl NodeBuilder {
    pub fn new() -> Self {
        Self {
            next_node: 0,
            published: None,
            last_node_from_reference: Some(Pose2::IDENTITY),
            lost_in_row: 0,
            last_scan_lost: false,
            requested: false,
            unmeasured_s: 0.0,
            slip: [0.0; 3],
            possibly_kidnapped: false,
            swept_path: SweptPath::default(),
        }
    }

    /// Whether a scan with `points` surface points becomes a reference and a node: after enough motion since the
    /// `newest` reference, on request, or when several scans in a row have not fitted. Where the robot may have been kidnapped, the first scan
    /// that fits does: scans are given relative to the node before them, and this one says nothing of where they are.
    pub fn is_due(
        &mut self,
        pose: &TrackedPose,
        points: usize,
        newest: Option<&Node>,
        config: &TrackingConfig,
    ) -> bool {
        self.last_scan_lost = !pose.is_tracked;
        if self.last_scan_lost {
            // A scan that sees nothing is no reason to give up the local map.
            let blind = points < config.points_min;
            self.lost_in_row += u32::from(!blind);
            if blind || self.lost_in_row < config.lost_scans_max {
                return false;
            }
        } else {
            self.lost_in_row = 0;
        }
        let Some(newest) = newest else { return true };
        let moved = newest.local_from_base.between(pose.local_from_base);
        let far = moved.x_m.hypot(moved.y_m) >= config.node_distance_m
            || moved.yaw_rad.abs() >= config.node_turn_rad;
        let requested = core::mem::take(&mut self.requested);
        requested || far || self.unmeasured_s > UNMEASURED_MAX_S || self.possibly_kidnapped
    }

    /// Completes a node that goes to the back end. `keep_path`: whether the robot's footprint and path are known.
    pub fn publish(&mut self, node: Node, keep_path: bool) -> Node {
        self.next_node += 1;
        self.published = Some((node.id, node.local_from_base));
        self.last_node_from_reference = Some(Pose2::IDENTITY);
        let unmeasured_s = core::mem::take(&mut self.unmeasured_s);
        let slip = core::mem::take(&mut self.slip);
        let possibly_kidnapped = core::mem::take(&mut self.possibly_kidnapped);
        let path = core::mem::take(&mut self.swept_path);
        let swept_path = if keep_path { path.seen_from(node.local_from_base) } else { SweptPath::default() };
        Node { swept_path, unmeasured_s, slip, possibly_kidnapped, ..node }
    }
}
