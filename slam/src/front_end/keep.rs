//! What of the scan path is kept in a session.

use super::{FrontEnd, FrontEndCounts, LastScan, REVISIONS_MAX};
use crate::config::SlamConfig;
use crate::node::{Node, Revision, SweptPath};
use crate::odometry::OdometryBuffer;
use msg::{Odometry, Pose2};
use nalgebra::Matrix3;

/// Where the scan path is, to be kept. Its local maps are not in it: they are drawn again from the
/// newest nodes, which the map keeps anyway.
#[derive(Clone, Debug)]
pub struct FrontEndState {
    /// The next node's number.
    pub next_node: u32,
    /// How many of the newest nodes refine poses.
    pub recent: u32,
    /// How many of the newest nodes are in the older and in the younger local map.
    pub local_maps: [u32; 2],
    /// Scans in a row that did not fit.
    pub lost_in_row: u32,
    /// Whether the scan before did not fit.
    pub last_scan_lost: bool,
    /// Closures in force, as last heard.
    pub closures: u32,
    /// Whether `map_from_local` is known.
    pub located: bool,
    /// The loop-closed map from the scan path's frame.
    pub map_from_local: Pose2,
    /// Odometry from the newest node handed over to the newest scan matched against.
    pub published_from_newest: Option<Pose2>,
    /// Odometry at the newest node.
    pub node_odom_from_base: Option<Pose2>,
    /// Of the newest node's pose.
    pub node_covariance: Matrix3<f64>,
    /// The newest node that does not follow from the one before.
    pub last_break: Option<u32>,
    /// The scan before.
    pub last: Option<LastScan>,
    /// How many scans went which way.
    pub counts: FrontEndCounts,
    /// Revisions that wait for their node.
    pub waiting: Vec<Revision>,
    /// The newest odometry.
    pub odometry: Vec<Odometry>,
    /// Its frame, see `odometry`.
    pub continuous_from_odom: Pose2,
    /// Messages refused.
    pub odometry_rejected: u64,
    /// Where the robot has been since the newest node, in the scan path's frame.
    pub swept_path: SweptPath,
}

impl FrontEnd {
    /// Goes on where a scan path was when it gave [`FrontEnd::state`]. `newest` are the map's newest
    /// nodes, in order: as many as the state speaks of.
    pub fn resume(config: SlamConfig, state: FrontEndState, newest: &[Node]) -> Self {
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
            state.odometry_rejected,
        );
        front.waiting.extend(state.waiting.into_iter().take(REVISIONS_MAX));
        (front.next_node, front.lost_in_row) = (state.next_node, state.lost_in_row);
        (front.map_from_local, front.located) = (state.map_from_local, state.located);
        front.published = newest.last().map(|node| (state.next_node.saturating_sub(1), node.local_from_base));
        front.published_from_newest = state.published_from_newest;
        (front.node_odom_from_base, front.last) = (state.node_odom_from_base, state.last);
        (front.last_scan_lost, front.swept_path) = (state.last_scan_lost, state.swept_path);
        (front.node_covariance, front.last_break) = (state.node_covariance, state.last_break);
        (front.counts, front.closures) = (state.counts, state.closures);
        front
    }

    /// Where the scan path is. It costs a copy of the odometry buffer.
    pub fn state(&self) -> FrontEndState {
        let (odometry, continuous_from_odom, odometry_rejected) = self.odometry.parts();
        FrontEndState {
            next_node: self.next_node,
            recent: self.recent.len() as u32,
            local_maps: [0, 1].map(|k: usize| self.local_maps[k].nodes as u32),
            lost_in_row: self.lost_in_row,
            last_scan_lost: self.last_scan_lost,
            closures: self.closures,
            located: self.located,
            map_from_local: self.map_from_local,
            published_from_newest: self.published_from_newest,
            node_odom_from_base: self.node_odom_from_base,
            node_covariance: self.node_covariance,
            last_break: self.last_break,
            last: self.last,
            counts: self.counts,
            waiting: self.waiting.iter().copied().collect(),
            odometry,
            continuous_from_odom,
            odometry_rejected,
            swept_path: self.swept_path,
        }
    }
}
