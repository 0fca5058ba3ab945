//! Checks of decoded sessions and records: every number finite and in its range, every reference to a node that is there.
//!
//! Serde checks the types; a well-formed value may still be one that no session has.

use super::log::{LogPosition, LogRecord};
use super::{Session, SessionError, SessionIdentity};
use crate::back_end::{BackEndState, ReliabilityMonitor};
use crate::closure::ClosureCandidate;
use crate::front_end::FrontEndState;
use crate::graph::{Edge, EdgeKind, PoseVariances};
use crate::limits::{INTERVAL_S_MAX, POINT_M_MAX, POSITION_M_MAX, SIGMA_MAX, UNMEASURED_S_MAX};
use crate::node::{Node, Rays, SweptPath};
use crate::odometry_agreement::OdometryAgreement;
use crate::reliability::{NodeComparison, ReliabilityEvidence, WallAgreement};
use crate::relocalize::LocalFrameEstimate;
use core::f64::consts::PI;
use msg::{BEAMS_MAX, Pose2};
use nalgebra::Matrix3;

/// Most nodes of a session: more than any configuration allows (`graph.nodes_max`).
const NODES_MAX: usize = 1_000_000;
/// Most edges per node, on average: each has up to 64 links with nodes before (`links.sequential`), as many with others near by
/// (`links.near`), and those of nodes around closures.
const EDGES_PER_NODE_MAX: usize = 1024;
/// Most entries of a queue: nodes to search for, candidates, frame updates, rejected closures.
const WAITING_MAX: usize = 4096;
/// Most newest nodes that a front end refers to.
const RECENT_MAX: usize = 4096;
/// Most odometry messages.
const ODOMETRY_MAX: usize = 65_536;
/// Most scans whose pose is kept.
const SAMPLES_MAX: usize = 10_000_000;
/// Most nodes of one record; a front end makes a few in the time of one.
const RECORD_NODES_MAX: usize = 4096;
/// Largest heading, radians: a turn is 6.28, and headings are kept within half of one.
const YAW_RAD_MAX: f64 = 7.0;
/// Largest component of a unit vector, with rounding.
const UNIT_MAX: f32 = 1.01;
/// Largest element of an information matrix or covariance; a larger one is an error.
const INFORMATION_MAX: f64 = 1e12;
/// Largest variance of an edge, m² and rad².
const VARIANCE_MAX: f64 = 1e9;
/// Longest path of a robot, metres.
const TRAVELLED_M_MAX: f64 = 1e12;
/// Most points of scans that are compared with those of one: no scan has as many, however many others there are.
const COMPARED_POINTS_MAX: u32 = 10_000_000;
/// Largest difference of a map from odometry, standard deviations: any coordinate over any of them.
const RESIDUAL_SIGMAS_MAX: f64 = 1e12;
/// Largest ratio between map and odometry: any coordinate over the shortest motion that counts.
const ODOMETRY_RATIO_MAX: f64 = 1e12;
/// Largest counter: half of what it can hold, so that it can go on counting.
const COUNT_MAX: u64 = u64::MAX / 2;
/// Largest number of a node or of consecutive scans, for the same reason.
const NUMBER_MAX: u32 = u32::MAX / 2;

type Result = core::result::Result<(), SessionError>;

impl Session {
    /// Checks every value of the session.
    ///
    /// # Errors
    /// [`SessionError::Value`] or [`SessionError::TooMany`], which name the first value that is not valid.
    pub fn validate(&self) -> Result {
        let nodes = self.back.nodes.len();
        check_identity(&self.identity)?;
        check_back_end(&self.back)?;
        if let Some(front) = &self.front {
            check_front_end(front, nodes)?;
        }
        check_count(self.samples.len(), SAMPLES_MAX, "scans")?;
        for sample in &self.samples {
            check((sample.node as usize) < nodes, "scan of a node that is not there")?;
            check_pose(sample.node_from_base, "scan's pose")?;
        }
        check_log_position(self.log)
    }
}

impl LogRecord {
    /// Checks every value of the record. How many nodes the map has is known when the record is applied.
    ///
    /// # Errors
    /// [`SessionError::Value`] or [`SessionError::TooMany`], which name the first value that is not valid.
    pub fn validate(&self) -> Result {
        check_identity(&self.identity)?;
        check_log_position(self.position)?;
        check_count(self.nodes.len(), RECORD_NODES_MAX, "nodes of a record")?;
        for logged in &self.nodes {
            check(logged.node.id <= NUMBER_MAX, "number of a record's node")?;
            check_node(&logged.node)?;
            if let Some(LocalFrameEstimate { map_from_local, sigma_m, sigma_rad }) = logged.begins_at {
                check_pose(map_from_local, "estimate of the first node's pose")?;
                let sound = [sigma_m, sigma_rad].iter().all(|sigma| (0.0..=SIGMA_MAX).contains(sigma));
                check(sound, "uncertainty of the first node's pose")?;
            }
        }
        check_front_end(&self.front, usize::MAX)
    }
}

fn check(sound: bool, what: &'static str) -> Result {
    if sound { Ok(()) } else { Err(SessionError::Value { what }) }
}

fn check_count(found: usize, most: usize, what: &'static str) -> Result {
    if found <= most { Ok(()) } else { Err(SessionError::TooMany { what, found: found as u64, most }) }
}

fn check_pose(pose: Pose2, what: &'static str) -> Result {
    let near = pose.x_m.abs() <= POSITION_M_MAX && pose.y_m.abs() <= POSITION_M_MAX;
    check(near && pose.yaw_rad.abs() <= YAW_RAD_MAX, what)
}

fn check_poses(poses: impl IntoIterator<Item = Pose2>, what: &'static str) -> Result {
    poses.into_iter().try_for_each(|pose| check_pose(pose, what))
}

fn check_matrix(m: &Matrix3<f64>, what: &'static str) -> Result {
    check(m.iter().all(|v| v.abs() <= INFORMATION_MAX) && (0..3).all(|k| m[(k, k)] >= 0.0), what)
}

fn check_points(points: &[[f32; 2]], most_m: f32, what: &'static str) -> Result {
    check(points.iter().flatten().all(|v| v.abs() <= most_m), what)
}

fn check_identity(identity: &SessionIdentity) -> Result {
    let finite = identity.base_from_scan.iter().all(|v| v.is_finite());
    check(finite && identity.range_use_max_m.is_finite(), "identity")
}

fn check_log_position(position: LogPosition) -> Result {
    check(position.number <= COUNT_MAX, "place in the log")
}

fn check_swept_path(path: &SweptPath, most_m: f32) -> Result {
    check_points(path.positions_m(), most_m, "swept path")
}

fn check_node(node: &Node) -> Result {
    let Rays { sensor, hits, misses } = &*node.rays;
    check_count(hits.len().max(misses.len()), BEAMS_MAX, "beams in a node")?;
    let (points, cloud_sensor, centroid_m, _) = node.cloud.parts();
    for point in points {
        check_points(&[point.at], POINT_M_MAX, "point of a node")?;
        check_points(&[point.normal], UNIT_MAX, "surface's direction")?;
    }
    check_points(hits, POINT_M_MAX, "beam of a node")?;
    check_points(misses, POINT_M_MAX, "beam of a node")?;
    check_points(&[cloud_sensor, centroid_m, *sensor], POINT_M_MAX, "sensor of a node")?;
    check_swept_path(&node.swept_path, POINT_M_MAX)?;
    check((0.0..=UNMEASURED_S_MAX).contains(&node.unmeasured_s), "time without a measured motion")?;
    let [slip_x_m, slip_y_m, slip_rad] = node.slip;
    check_pose(Pose2::new(slip_x_m, slip_y_m, slip_rad), "node's slip")?;
    check_pose(node.local_from_base, "node's pose")?;
    check_poses(node.previous_from_this, "node's odometry")
}

fn check_edge(edge: &Edge, nodes: usize) -> Result {
    let there = (edge.a as usize) < nodes && (edge.b as usize) < nodes && edge.a != edge.b;
    check(there, "edge between nodes that are not there")?;
    let PoseVariances { worst_axis_m2, heading_rad2 } = edge.variances;
    let is_variance = |v: f64| (0.0..=VARIANCE_MAX).contains(&v);
    check(is_variance(worst_axis_m2) && is_variance(heading_rad2), "edge's variance")?;
    check((0.0..=1.0).contains(&edge.response), "closure's response")?;
    check_pose(edge.a_from_b, "edge's measurement")?;
    let is_direction = |rad: f64| rad.abs() <= PI && edge.kind == EdgeKind::ScanMatch;
    check(edge.degenerate_direction_rad.is_none_or(is_direction), "edge's degenerate direction")?;
    check_matrix(&edge.information, "edge's information")
}

fn check_candidate(candidate: &ClosureCandidate, nodes: usize) -> Result {
    let ClosureCandidate { newer, older, older_from_newer, information, response } = candidate;
    let there = (*newer as usize) < nodes && (*older as usize) < nodes;
    check(there && newer != older, "closure candidate of a node that is not there")?;
    check((0.0..=1.0).contains(response), "closure candidate's response")?;
    check_pose(*older_from_newer, "closure candidate's measurement")?;
    check_matrix(information, "closure candidate's information")
}

fn check_back_end(back: &BackEndState) -> Result {
    let nodes = back.nodes.len();
    check_count(nodes, NODES_MAX, "nodes")?;
    for (id, node) in back.nodes.iter().enumerate() {
        check(node.id as usize == id, "number of a node")?;
        check_node(node)?;
    }
    check(back.front_ids.len() == nodes, "number of the front end's ids")?;
    check(back.front_ids.iter().all(|id| *id <= NUMBER_MAX), "front end's id of a node")?;
    check(back.poses.len() == nodes, "number of poses")?;
    check_count(back.drawn.len(), nodes, "drawn poses")?;
    check_poses(back.poses.iter().chain(&back.drawn).copied(), "pose of a node")?;
    check_count(back.edges.len(), EDGES_PER_NODE_MAX * nodes, "edges")?;
    back.edges.iter().try_for_each(|edge| check_edge(edge, nodes))?;
    check((0.0..TRAVELLED_M_MAX).contains(&back.travelled_m), "length of the path")?;
    for (ids, what) in [(&back.not_found, "nodes not found"), (&back.to_retry, "nodes to search for again")] {
        check_count(ids.len(), WAITING_MAX, what)?;
        check(ids.iter().all(|id| (*id as usize) < nodes), what)?;
    }
    check(back.unverified_node.is_none_or(|id| (id as usize) < nodes), "unverified node")?;
    let detector = &back.detector;
    check_count(detector.pending.len(), WAITING_MAX, "closure candidates")?;
    detector.pending.iter().try_for_each(|candidate| check_candidate(candidate, nodes))?;
    let last_search_m = detector.last_search_m.unwrap_or_default();
    check((0.0..TRAVELLED_M_MAX).contains(&last_search_m), "place of the last search")?;
    check_count(back.rejected_closures.len(), WAITING_MAX, "rejected closures")?;
    for rejected in &back.rejected_closures {
        let there = (rejected.a as usize) < nodes && (rejected.b as usize) < nodes;
        check(there, "rejected closure of a node that is not there")?;
        check_pose(rejected.a_from_b, "rejected closure")?;
    }
    check_reliability(&back.reliability, nodes)?;
    check(back.linked_since_solve as u64 <= COUNT_MAX, "number of nodes linked since the last solution")?;
    let c = &detector.counts;
    let counts = [c.searches, c.below_min_response, c.ambiguous, c.contradicted, c.unconfirmed, c.accepted];
    let counts = counts.into_iter().chain([back.solutions, back.retracted, back.removed_nodes]);
    check_counters(counts)
}

fn check_reliability(monitor: &ReliabilityMonitor, nodes: usize) -> Result {
    check_count(monitor.node_comparisons.len(), nodes, "nodes compared with others")?;
    let points = |comparison: &NodeComparison| {
        let WallAgreement { agree, contradict } = comparison.walls;
        [agree, contradict].iter().all(|points| *points <= COMPARED_POINTS_MAX)
    };
    check(monitor.node_comparisons.iter().flatten().all(points), "number of compared points")?;
    let is_break_valid =
        monitor.suspected_break.is_none_or(|at| at.before < at.after && (at.after as usize) < nodes);
    check(is_break_valid, "place where the path is wrong")?;
    check(monitor.cursor <= nodes, "node compared anew")?;
    check(monitor.implausible_relocalizations <= NUMBER_MAX, "number of implausible relocalizations")?;
    check((0.0..=UNMEASURED_S_MAX).contains(&monitor.unmeasured_s), "time without a measured motion")?;
    let ReliabilityEvidence {
        contradicted_share,
        odometry_residual_sigmas,
        unmeasured_motion_s,
        implausible_relocalizations,
        position_sigma_m,
        unplaced_share,
        conflicting_closures,
        odometry_agreement,
    } = monitor.current;
    let OdometryAgreement { turn_ratio, distance_ratio, direction_rad } = odometry_agreement;
    let ratios = [turn_ratio, distance_ratio, direction_rad];
    let is_valid = ratios.iter().flatten().all(|ratio| ratio.abs() <= ODOMETRY_RATIO_MAX);
    check(is_valid, "motion compared with odometry's")?;
    check((0.0..=1.0).contains(&contradicted_share), "share of contradicted points")?;
    check((0.0..=1.0).contains(&unplaced_share), "share of nodes that are not placed")?;
    check((0.0..=RESIDUAL_SIGMAS_MAX).contains(&odometry_residual_sigmas), "difference from odometry")?;
    check((0.0..=UNMEASURED_S_MAX).contains(&unmeasured_motion_s), "time without a measured motion")?;
    check(implausible_relocalizations <= NUMBER_MAX, "number of implausible relocalizations")?;
    check(conflicting_closures as usize <= nodes * nodes, "number of conflicting closures")?;
    check(
        position_sigma_m.is_finite() && position_sigma_m >= 0.0,
        "standard deviation of the position known worst",
    )
}

fn check_counters(counts: impl IntoIterator<Item = u64>) -> Result {
    check(counts.into_iter().all(|count| count <= COUNT_MAX), "counts")
}

/// Checks a front end's state; its map has so many nodes.
fn check_front_end(front: &FrontEndState, nodes: usize) -> Result {
    let referenced = [front.reference_count, front.local_maps[0], front.local_maps[1]];
    let there = referenced.iter().all(|count| *count as usize <= nodes.min(RECENT_MAX));
    check(there, "number of nodes in the local map")?;
    check(front.next_node <= NUMBER_MAX, "number of the next node")?;
    check(front.lost_in_row <= NUMBER_MAX, "number of consecutive scans that did not fit")?;
    check_pose(front.map_from_local, "front end's frame in the map")?;
    check_pose(front.continuous_from_odom, "odometry's frame")?;
    check_poses(front.continuous_from_reference, "newest node's odometry")?;
    check_poses(front.last_node_from_reference, "odometry since the newest node")?;
    check_matrix(&front.reference_covariance, "newest node's covariance")?;
    if let Some(last) = &front.last {
        check_pose(last.local_from_base, "last pose")?;
        check_matrix(&last.covariance, "last pose's covariance")?;
        check_poses(last.continuous_from_base, "last pose's odometry")?;
        check_poses(last.motion.map(|(motion, _)| motion), "last motion")?;
        let seconds = last.motion.map_or(0.0, |(_, seconds)| seconds);
        check((0.0..INTERVAL_S_MAX).contains(&seconds), "duration of the last motion")?;
    }
    check_count(front.frame_updates.len(), WAITING_MAX, "frame updates")?;
    check_poses(front.frame_updates.iter().map(|frame_update| frame_update.map_from_local), "frame update")?;
    check_count(front.odometry.len(), ODOMETRY_MAX, "odometry messages")?;
    check_poses(front.odometry.iter().map(|odometry| odometry.odom_from_base), "odometry")?;
    let sorted = front.odometry.is_sorted_by(|a, b| a.header.stamp < b.header.stamp);
    check(sorted, "order of odometry")?;
    check_swept_path(&front.swept_path, POSITION_M_MAX as f32)?;
    let c = &front.counts;
    let rejected = [
        c.rejected_stamp_repeated,
        c.rejected_stamp_went_back,
        c.rejected_beam_count,
        c.rejected_geometry,
        c.rejected_odometry,
    ];
    let counts = [c.accepted, c.clock_resets, c.lost, c.odometry_breaks, c.slips, c.trajectory_dropped];
    check_counters(rejected.into_iter().chain(counts))?;
    check_counters([c.nodes_held_back, c.not_deskewed, front.rejected_odometry])
}
