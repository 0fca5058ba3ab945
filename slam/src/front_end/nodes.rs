//! Which scans become nodes, and the local maps of the newest of them.

use super::{FrontEnd, TrackedPose};
use crate::beam_poses::BeamPoses;
use crate::cloud::Cloud;
use crate::config::TrackingConfig;
use crate::likelihood_field::LikelihoodField;
use crate::node::{Node, SweptPath};
use msg::{Pose2, Scan, TrackingState};
use std::sync::Arc;

/// Points this close to a surface agree with it,
const NEAR_M: f32 = 0.15;
/// and a scan that sees this far behind a point contradicts it, metres.
const BEHIND_M: f32 = 0.4;
/// If this share of what can be compared is contradicted, the robot is elsewhere,
const TORN_SHARE: f32 = 0.3;
/// if it is as many points, counted in each of the newest scans that sees through them or is seen through.
const TORN_POINTS_MIN: usize = 40;

/// Surfaces of some newest nodes as a field to search in.
pub(super) struct LocalMap {
    pub field: LikelihoodField,
    pub nodes: usize,
}

impl LocalMap {
    pub fn new(config: &TrackingConfig) -> Self {
        Self { field: LikelihoodField::new(config.cell_m, config.local_map_reach_m, config.blur_m), nodes: 0 }
    }
}

impl FrontEnd {
    pub(super) fn node_due(&mut self, found: &TrackedPose, cloud: &Cloud) -> bool {
        let t = &self.config.tracking;
        self.last_scan_lost = found.state == TrackingState::Lost;
        if self.last_scan_lost {
            self.counts.lost += 1;
            // A scan that sees nothing is no reason to give up the local map.
            let blind = cloud.points().len() < t.points_min;
            self.lost_in_row += u32::from(!blind);
            if blind || self.lost_in_row < t.lost_scans_max {
                return false;
            }
        } else {
            self.lost_in_row = 0;
        }
        let Some(newest) = self.recent.back() else { return true };
        let moved = newest.local_from_base.between(found.local_from_base);
        let far = moved.x_m.hypot(moved.y_m) >= t.node_distance_m || moved.yaw_rad.abs() >= t.node_turn_rad;
        core::mem::take(&mut self.node_wanted) || far
    }

    /// The scan is matched against from now on, and handed over as a node if there is room.
    pub(super) fn make_node(
        &mut self,
        (scan, sweep): (&Scan, &BeamPoses),
        found: &TrackedPose,
        odom: Option<Pose2>,
        cloud: Arc<Cloud>,
    ) -> Option<Node> {
        let fits = found.state != TrackingState::Lost;
        if !fits && self.contradicted(&cloud, found.local_from_base) {
            self.last_break = Some(self.next_node);
            self.located = false;
            self.counts.odometry_breaks += 1;
        }
        let moved = self.node_odom_from_base.zip(odom).map(|(before, now)| before.between(now));
        (self.node_odom_from_base, self.node_covariance) = (odom, found.covariance);
        let node = Node {
            id: self.next_node,
            header: scan.header,
            local_from_base: found.local_from_base,
            previous_from_this: self.published_from_newest.zip(moved).map(|(a, b)| a * b),
            fits,
            odometry_break: self.last_break == Some(self.next_node),
            disconnected: None,
            cloud,
            rays: self.pool.rays(scan, sweep, &self.config),
            swept_path: SweptPath::default(),
        };
        let has_capacity = self.pool.has_capacity(self.recent.len() + 1);
        if !fits {
            self.recent.clear();
            self.lost_in_row = 0;
        }
        self.extend_local_maps(&node, !fits);
        if self.recent.len() == self.config.tracking.references {
            self.recent.pop_front();
        }
        self.recent.push_back(node.clone());
        if !has_capacity {
            self.published_from_newest = node.previous_from_this;
            self.counts.nodes_held_back += 1;
            return None;
        }
        self.next_node += 1;
        self.published = Some((node.id, node.local_from_base));
        self.published_from_newest = Some(Pose2::IDENTITY);
        self.apply_revisions(node.id);
        let swept_path = core::mem::take(&mut self.swept_path);
        // A way that the scans contradict was another one.
        let is_known = self.config.map.robot_radius_m > 0.0 && fits && !node.odometry_break;
        let swept_path =
            if is_known { swept_path.seen_from(node.local_from_base) } else { SweptPath::default() };
        Some(Node { swept_path, ..node })
    }

    /// Whether a scan placed here and the newest nodes see through what the other one saw: the
    /// robot is not there. Where they only look at different things, odometry may well be right.
    pub(super) fn contradicted(&self, cloud: &Cloud, local_from_base: Pose2) -> bool {
        let (mut agree, mut contradict) = (0, 0);
        for node in &self.recent {
            let node_from_base = node.local_from_base.between(local_from_base);
            for (a, c) in [
                node.cloud.judge(cloud, node_from_base, NEAR_M, BEHIND_M),
                cloud.judge(&node.cloud, node_from_base.inverse(), NEAR_M, BEHIND_M),
            ] {
                agree += a;
                contradict += c;
            }
        }
        let enough = contradict >= TORN_POINTS_MIN;
        enough && contradict as f32 > TORN_SHARE * (agree + contradict) as f32
    }

    /// Two local maps overlap: the older one is matched against, the younger one grows to replace it.
    fn extend_local_maps(&mut self, node: &Node, anew: bool) {
        let size = self.config.tracking.local_map_nodes;
        let centre = [node.local_from_base.x_m, node.local_from_base.y_m];
        let [older, younger] = &mut self.local_maps;
        if older.nodes == 0 || anew {
            older.field.clear(centre);
            older.nodes = 0;
            younger.nodes = 0;
        } else if older.nodes >= size {
            core::mem::swap(older, younger);
            younger.nodes = 0;
        }
        older.field.insert(&node.cloud, node.local_from_base);
        older.nodes += 1;
        if older.nodes > size / 2 {
            if younger.nodes == 0 {
                younger.field.clear(centre);
            }
            younger.field.insert(&node.cloud, node.local_from_base);
            younger.nodes += 1;
        }
    }
}
