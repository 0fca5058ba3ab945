//! Pose of the front end's frame in the map, updated by the back end's frame updates.

use crate::graph::{carry_covariance, turn_covariance};
use crate::limits::FRAME_UPDATES_MAX;
use crate::node::{FrameUncertainty, MapFrameUpdate};
use crate::relocalize::LocalFrameEstimate;
use msg::Pose2;
use nalgebra::Matrix3;
use std::collections::VecDeque;

/// Pose of the front end's frame in the map, and the frame updates that will change it.
pub(super) struct LocalFrameInMap {
    pub map_from_local: Pose2,
    /// How well it is known.
    pub uncertainty: FrameUncertainty,
    /// Whether `map_from_local` is known: whether the robot is located in its map.
    pub is_located: bool,
    /// Whether a person said where the robot is, and scans have not confirmed it yet.
    pub is_unconfirmed: bool,
    /// The newest node with an odometry break before it: frame updates caused by older nodes do not locate the robot.
    pub last_odometry_break: Option<u32>,
    /// Whether there is evidence that the map is wrong, as last reported.
    pub is_unreliable: bool,
    /// Number of active closures, as last reported.
    pub closures: u32,
    /// Frame updates that take effect with a later node, oldest first.
    pub frame_updates: VecDeque<MapFrameUpdate>,
}

impl LocalFrameInMap {
    pub fn new() -> Self {
        Self {
            map_from_local: Pose2::IDENTITY,
            uncertainty: FrameUncertainty::default(),
            is_located: true,
            is_unconfirmed: false,
            last_odometry_break: None,
            is_unreliable: false,
            closures: 0,
            frame_updates: VecDeque::with_capacity(FRAME_UPDATES_MAX),
        }
    }

    /// Sets the pose at once; `None` marks the robot as not located.
    pub fn set(&mut self, map_from_local: Option<Pose2>) {
        self.is_located = map_from_local.is_some();
        self.is_unconfirmed = false;
        self.last_odometry_break = None;
        self.map_from_local = map_from_local.unwrap_or(self.map_from_local);
        self.uncertainty = FrameUncertainty::default();
        self.frame_updates.clear();
    }

    /// Sets the pose at once to what a person said, the robot being at `local_from_base`.
    pub fn set_initial_estimate(&mut self, estimate: LocalFrameEstimate, local_from_base: Pose2) {
        self.set(Some(estimate.map_from_local));
        self.uncertainty = estimate.uncertainty(local_from_base);
        self.is_unconfirmed = true;
    }

    /// Adds an odometry break before a node: from there on the robot is not located in its map.
    pub fn add_odometry_break(&mut self, node: u32) {
        self.last_odometry_break = Some(node);
        self.is_located = false;
    }

    /// Covariance of a pose in the map, `local` being that in the front end's frame.
    pub fn covariance_in_map(&self, local: Matrix3<f64>, map_from_base: Pose2) -> Matrix3<f64> {
        let FrameUncertainty { covariance: [xx, xy, xt, yy, yt, tt], position_m } = self.uncertainty;
        let covariance = Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
        let moved = [map_from_base.x_m - position_m[0], map_from_base.y_m - position_m[1]];
        carry_covariance(covariance, moved) + turn_covariance(local, self.map_from_local.yaw_rad)
    }

    pub fn add_frame_update(&mut self, frame_update: MapFrameUpdate) {
        if self.frame_updates.len() == FRAME_UPDATES_MAX {
            self.frame_updates.pop_front();
        }
        self.frame_updates.push_back(frame_update);
    }

    /// Applies the newest frame update that is due with this node; those before it are out of date.
    pub fn apply_frame_updates(&mut self, node: u32) {
        let Some(due) = self.frame_updates.iter().rposition(|r| r.effective_from_node <= node) else {
            return;
        };
        let due = self.frame_updates.drain(..=due).next_back();
        due.into_iter().for_each(|frame_update| self.apply(frame_update));
    }

    /// Applies a frame update at once, in the place of those that wait.
    pub fn replace_frame_updates(&mut self, frame_update: MapFrameUpdate) {
        self.frame_updates.clear();
        self.apply(frame_update);
    }

    fn apply(&mut self, frame_update: MapFrameUpdate) {
        self.map_from_local = frame_update.map_from_local;
        self.is_located =
            frame_update.located && self.last_odometry_break.is_none_or(|at| frame_update.cause_node >= at);
        self.apply_quality(frame_update);
    }

    /// Takes over how good the map and the pose of a session are, which it does not keep, and not where the robot is; also for the updates that
    /// wait.
    pub fn restore_quality(&mut self, latest: MapFrameUpdate) {
        self.apply_quality(latest);
        let MapFrameUpdate { uncertainty, unconfirmed, unreliable, .. } = latest;
        for waiting in &mut self.frame_updates {
            *waiting = MapFrameUpdate { uncertainty, unconfirmed, unreliable, ..*waiting };
        }
    }

    fn apply_quality(&mut self, frame_update: MapFrameUpdate) {
        self.uncertainty = frame_update.uncertainty;
        self.is_unconfirmed = frame_update.unconfirmed;
        self.is_unreliable = frame_update.unreliable;
        self.closures = frame_update.closures;
    }

    pub fn restore_frame_updates(&mut self, frame_updates: Vec<MapFrameUpdate>) {
        self.frame_updates.extend(frame_updates.into_iter().take(FRAME_UPDATES_MAX));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_update_takes_effect_with_its_node_however_long_it_has_to_wait() {
        for lag_nodes in [1, 4, FRAME_UPDATES_MAX as u32] {
            let mut frame = LocalFrameInMap::new();
            for node in 0..300 {
                frame.apply_frame_updates(node);
                let expected = f64::from(node.saturating_sub(lag_nodes));
                assert_eq!(frame.map_from_local.x_m, expected, "node {node}, {lag_nodes} nodes later");
                frame.add_frame_update(MapFrameUpdate {
                    cause_node: node,
                    effective_from_node: node + lag_nodes,
                    map_from_local: Pose2::new(f64::from(node), 0.0, 0.0),
                    uncertainty: FrameUncertainty::default(),
                    closures: 0,
                    located: true,
                    unconfirmed: false,
                    unreliable: false,
                });
            }
        }
    }
}
