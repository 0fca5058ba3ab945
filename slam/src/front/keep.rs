//! What of the scan path is kept in a session.

use super::{Counts, Front, Last, REVISIONS_MAX};
use crate::config::SlamConfig;
use crate::node::{Node, Revision, Way};
use crate::odometry::OdometryBuffer;
use msg::{Odometry, Pose2};
use nalgebra::Matrix3;

/// Where the scan path is, to be kept. Its local maps are not in it: they are drawn again from the
/// newest nodes, which the map keeps anyway.
#[derive(Clone, Debug)]
pub struct FrontState {
    /// The next node's number.
    pub next_node: u32,
    /// How many of the newest nodes refine poses.
    pub recent: u32,
    /// How many of the newest nodes are in the older and in the younger local map.
    pub local_maps: [u32; 2],
    /// Scans in a row that did not fit.
    pub lost_in_row: u32,
    /// Whether the scan before did not fit.
    pub unsure: bool,
    /// Closures in force, as last heard.
    pub closures: u32,
    /// Whether `map_from_local` is known.
    pub located: bool,
    /// The loop-closed map from the scan path's frame.
    pub map_from_local: Pose2,
    /// Odometry from the newest node handed over to the newest scan matched against.
    pub handed_from_recent: Option<Pose2>,
    /// Odometry at the newest node.
    pub node_odom_from_base: Option<Pose2>,
    /// Of the newest node's pose.
    pub node_covariance: Matrix3<f64>,
    /// The newest node that does not follow from the one before.
    pub torn_at: Option<u32>,
    /// The scan before.
    pub last: Option<Last>,
    /// How many scans went which way.
    pub counts: Counts,
    /// Revisions that wait for their node.
    pub waiting: Vec<Revision>,
    /// The newest odometry.
    pub odometry: Vec<Odometry>,
    /// Its frame, see `odometry`.
    pub continuous_from_odom: Pose2,
    /// Messages refused.
    pub odometry_refused: u64,
    /// Where the robot has been since the newest node, in the scan path's frame.
    pub way: Way,
}

impl Front {
    /// Goes on where a scan path was when it gave [`Front::state`]. `newest` are the map's newest
    /// nodes, in order: as many as the state speaks of.
    pub fn resume(config: SlamConfig, state: FrontState, newest: &[Node]) -> Self {
        let mut front = Self::new(config);
        let last_of = |count: u32| &newest[newest.len().saturating_sub(count as usize)..];
        for (map, count) in front.local_maps.iter_mut().zip(state.local_maps) {
            let nodes = last_of(count);
            if let Some(first) = nodes.first() {
                map.field.clear([first.local_from_base.x_m, first.local_from_base.y_m]);
            }
            nodes.iter().for_each(|node| map.field.insert(&node.cloud, node.local_from_base));
            map.nodes = nodes.len();
        }
        let references = front.config.tracking.references as u32;
        front.recent.extend(last_of(state.recent.min(references)).iter().cloned());
        let odometry = front.config.odometry.clone();
        front.odometry = OdometryBuffer::from_parts(
            odometry,
            &state.odometry,
            state.continuous_from_odom,
            state.odometry_refused,
        );
        front.waiting.extend(state.waiting.into_iter().take(REVISIONS_MAX));
        (front.next_node, front.lost_in_row) = (state.next_node, state.lost_in_row);
        (front.map_from_local, front.located) = (state.map_from_local, state.located);
        front.handed = newest.last().map(|node| (state.next_node.saturating_sub(1), node.local_from_base));
        front.handed_from_recent = state.handed_from_recent;
        (front.node_odom_from_base, front.last) = (state.node_odom_from_base, state.last);
        (front.unsure, front.way) = (state.unsure, state.way);
        (front.node_covariance, front.torn_at) = (state.node_covariance, state.torn_at);
        (front.counts, front.closures) = (state.counts, state.closures);
        front
    }

    /// Where the scan path is. It costs a copy of the odometry buffer.
    pub fn state(&self) -> FrontState {
        let (odometry, continuous_from_odom, odometry_refused) = self.odometry.parts();
        FrontState {
            next_node: self.next_node,
            recent: self.recent.len() as u32,
            local_maps: [0, 1].map(|k: usize| self.local_maps[k].nodes as u32),
            lost_in_row: self.lost_in_row,
            unsure: self.unsure,
            closures: self.closures,
            located: self.located,
            map_from_local: self.map_from_local,
            handed_from_recent: self.handed_from_recent,
            node_odom_from_base: self.node_odom_from_base,
            node_covariance: self.node_covariance,
            torn_at: self.torn_at,
            last: self.last,
            counts: self.counts,
            waiting: self.waiting.iter().copied().collect(),
            odometry,
            continuous_from_odom,
            odometry_refused,
            way: self.way,
        }
    }
}
