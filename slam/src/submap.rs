//! Submaps: groups of consecutive nodes, each drawn as a small grid that a fleet's pose graph moves rigidly.
//!
//! A submap's pose is its first node's. It is drawn again when the robot's pose graph has changed it.

use crate::back_end::BackEnd;
use crate::config::{LinkConfig, MapConfig, SlamConfig};
use crate::graph::{Graph, upper_triangle};
use crate::mapper::{OccupancyMapper, TURN_ARM_M};
use msg::{Pose2, SUBMAP_EDGES_MAX, SUBMAPS_MAX, Submap, SubmapEdge, SubmapPoses, pose::wrap_angle};
use nalgebra::Matrix3;
use posegraph::{limit_information, transport_information};
use std::collections::BTreeMap;

/// Nodes of a finished submap, unless its path reaches [`PATH_MAX_M`] first.
const NODES_MAX: u32 = 20;
/// Longest path within a submap, metres: drift within it stays below what two submaps can be aligned to.
const PATH_MAX_M: f64 = 10.0;
/// Least nodes of a submap before a scan that did not fit begins a new one.
const NODES_MIN: u32 = 4;
/// Nodes by which a growing submap grows between two publications.
const GROWN_NODES: u32 = 5;
/// Share of [`LinkConfig::drift_m_per_m`] and [`LinkConfig::drift_rad_per_m`], which are for the worst case, that a
/// chain of links drifts at least: errors of its links are correlated.
const DRIFT_SHARE: f64 = 0.3;
/// Information added to each coordinate before inversion, 1/m² and 1/rad²: keeps an unobserved direction invertible.
const REGULARISATION: f64 = 1e-4;

/// The submaps of one robot.
pub struct Submaps {
    map: MapConfig,
    links: LinkConfig,
    groups: Vec<Group>,
    /// Number of nodes processed so far.
    nodes: u32,
    /// Length of the newest group's path, metres.
    path_m: f64,
    /// Mapper of the newest group.
    mapper: OccupancyMapper,
    /// Number of nodes without a submap because there are [`SUBMAPS_MAX`].
    nodes_without_submap: u64,
    /// Number of times that all submaps were begun again.
    generation: u32,
    /// Nodes the back end had removed when these groups were begun.
    removed_nodes: u64,
    out: Box<Submap>,
}

/// The consecutive nodes of one submap, and what was published of them.
struct Group {
    first: u32,
    nodes: u32,
    finished: bool,
    /// Poses of the nodes in the first one's frame, as published; empty before.
    published_poses: Vec<Pose2>,
    published_finished: bool,
    published_placed: bool,
}

impl Submaps {
    /// An empty set of submaps.
    pub fn new(config: &SlamConfig) -> Self {
        Self {
            map: config.map.clone(),
            links: config.links.clone(),
            groups: Vec::new(),
            nodes: 0,
            path_m: 0.0,
            mapper: OccupancyMapper::new(config.map.clone()),
            nodes_without_submap: 0,
            generation: 0,
            removed_nodes: 0,
            out: bytemuck::allocation::zeroed_box(),
        }
    }

    /// Removes all submaps and begins a new generation: the nodes are no longer the same.
    pub fn restart(&mut self) {
        self.groups.clear();
        (self.nodes, self.path_m, self.nodes_without_submap) = (0, 0.0, 0);
        self.generation += 1;
    }

    /// Publishes all submaps again, for a subscriber that misses some.
    pub fn resend_all(&mut self) {
        self.groups.iter_mut().for_each(|group| group.published_poses.clear());
    }

    /// Adds the nodes that the back end got since the last call. If it removed nodes (the others then have new numbers)
    /// or began a new map, all submaps begin again.
    pub fn update(&mut self, back: &BackEnd) {
        if back.removed_nodes() != self.removed_nodes || back.nodes().len() < self.nodes as usize {
            self.restart();
            self.removed_nodes = back.removed_nodes();
        }
        let poses = back.graph().poses();
        for node in &back.nodes()[(self.nodes as usize).min(back.nodes().len())..] {
            let step_m = if node.id == 0 {
                0.0
            } else {
                poses[node.id as usize - 1].distance_m(poses[node.id as usize])
            };
            self.path_m += step_m;
            let full = self.groups.last().is_none_or(|group| {
                let full = group.nodes >= NODES_MAX || self.path_m > PATH_MAX_M;
                full || node.odometry_break || (!node.is_tracked && group.nodes >= NODES_MIN)
            });
            if full {
                if let Some(group) = self.groups.last_mut() {
                    group.finished = true;
                }
                if self.groups.len() == SUBMAPS_MAX {
                    self.nodes_without_submap += 1;
                    self.nodes += 1;
                    continue;
                }
                let first = node.id;
                self.groups.push(Group {
                    first,
                    nodes: 0,
                    finished: false,
                    published_poses: Vec::new(),
                    published_finished: false,
                    published_placed: false,
                });
                self.path_m = 0.0;
            }
            if let Some(group) = self.groups.last_mut() {
                group.nodes += 1;
            }
            self.nodes += 1;
        }
    }

    /// Finishes the newest submap: no more nodes will come.
    pub fn finish(&mut self) {
        if let Some(group) = self.groups.last_mut() {
            group.finished = true;
        }
    }

    /// Number of nodes that belong to no submap because there are [`SUBMAPS_MAX`].
    pub fn nodes_without_submap(&self) -> u64 {
        self.nodes_without_submap
    }

    /// Number of submaps.
    pub fn len(&self) -> usize {
        self.groups.len()
    }

    /// Whether there is no submap: no node was added yet.
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// Id and first node of the submap that a node belongs to.
    pub fn submap_of(&self, node: u32) -> Option<(u32, u32)> {
        let after = self.groups.partition_point(|group| group.first <= node);
        let group = self.groups.get(after.checked_sub(1)?)?;
        (node < group.first + group.nodes).then_some((after as u32 - 1, group.first))
    }

    /// The next submap that is new, has grown, was finished or changed shape since its last publication; `None` when
    /// all are published. The channel sets `header.incarnation` and `seq`.
    pub fn next_changed(&mut self, back: &BackEnd) -> Option<&Submap> {
        let poses = back.graph().poses();
        let newest = self.groups.len().checked_sub(1)?;
        let id = (0..=newest).find(|id| self.is_due(&self.groups[*id], back))?;
        let group = &mut self.groups[id];
        let fresh = group.published_poses.is_empty();
        let range = group.first as usize..(group.first + group.nodes) as usize;
        group.published_poses = relative(&poses[range.clone()]);
        group.published_finished = group.finished;
        group.published_placed = is_placed(group, back);
        // The mapper keeps the newest submap, which grows; older ones rarely change and are drawn from nothing.
        if fresh || id != newest {
            self.mapper = OccupancyMapper::new(self.map.clone());
        }
        self.out.set_grid(self.mapper.finish(&back.nodes()[range], &group.published_poses));
        let out = &mut self.out;
        (out.id, out.first_node, out.nodes) = (id as u32, group.first, group.nodes);
        (out.finished, out.generation) = (u32::from(group.finished), self.generation);
        if id != newest {
            self.mapper = OccupancyMapper::new(self.map.clone());
        }
        Some(&self.out)
    }

    /// Whether a submap must be published again.
    fn is_due(&self, group: &Group, back: &BackEnd) -> bool {
        let (published, poses) = (group.published_poses.len(), back.graph().poses());
        if is_placed(group, back) != group.published_placed {
            return true;
        }
        if !group.published_placed {
            // Nothing of an unplaced submap is published.
            return false;
        }
        if published == 0
            || group.nodes >= published as u32 + GROWN_NODES
            || group.finished != group.published_finished
        {
            return true;
        }
        let first = poses[group.first as usize];
        let now = poses[group.first as usize..].iter().map(|pose| first.between(*pose));
        group.published_poses.iter().zip(now).any(|(was, is)| {
            let turned = wrap_angle(was.yaw_rad - is.yaw_rad).abs();
            was.distance_m(is) > self.map.redraw_m || turned * TURN_ARM_M > self.map.redraw_m
        })
    }

    /// Writes the submaps' poses and the edges between pairs of them, condensed from the graph's links.
    pub fn poses(&self, back: &BackEnd, out: &mut SubmapPoses) {
        let poses = back.graph().poses();
        for (pose, group) in out.robot_map_from_submap.iter_mut().zip(&self.groups) {
            *pose = poses[group.first as usize];
        }
        (out.len, out.generation) = (self.groups.len() as u32, self.generation);
        if let Some(newest) = back.nodes().last() {
            out.header.stamp = newest.header.stamp;
        }
        let mut edges: Vec<_> = self.condensed(back.graph()).into_iter().collect();
        // Neighbours come first when there are too many, then the edges with the most information.
        if edges.len() > SUBMAP_EDGES_MAX {
            edges.sort_by(|((a, b), x), ((c, d), y)| {
                (b - a).min(2).cmp(&(d - c).min(2)).then(y[(0, 0)].total_cmp(&x[(0, 0)]))
            });
        }
        out.edges_len = edges.len().min(SUBMAP_EDGES_MAX) as u32;
        for (slot, ((a, b), sum)) in out.edges.iter_mut().zip(edges) {
            let a_from_b =
                out.robot_map_from_submap[a as usize].between(out.robot_map_from_submap[b as usize]);
            let information = upper_triangle(self.with_drift(sum, a_from_b));
            *slot = SubmapEdge { a, b, information };
        }
    }

    /// Information of all links between two submaps, in their frames (condensed
    /// measurements: Grisetti, Kümmerle, Ni, "Robust optimization of factor graphs by using
    /// condensed measurements", IROS 2012).
    fn condensed(&self, graph: &Graph) -> BTreeMap<(u32, u32), Matrix3<f64>> {
        let poses = graph.poses();
        let mut sums = BTreeMap::new();
        for edge in graph.edges().iter().filter(|edge| edge.is_active) {
            let (a, b, information) = if edge.a < edge.b {
                (edge.a, edge.b, edge.measured_information())
            } else {
                (edge.b, edge.a, inverted(edge.measured_information(), edge.a_from_b))
            };
            let (Some((i, first_i)), Some((j, first_j))) = (self.submap_of(a), self.submap_of(b)) else {
                continue;
            };
            if i == j {
                continue;
            }
            let i_from_a = poses[first_i as usize].between(poses[a as usize]);
            let b_from_j = poses[b as usize].between(poses[first_j as usize]);
            let a_from_b = poses[a as usize].between(poses[b as usize]);
            let moved = transport_information(information, i_from_a, a_from_b, b_from_j);
            *sums.entry((i, j)).or_insert_with(Matrix3::zeros) += moved;
        }
        sums
    }

    /// Information reduced by the drift of a chain of links between two submaps.
    fn with_drift(&self, information: Matrix3<f64>, a_from_b: Pose2) -> Matrix3<f64> {
        let distance_m = a_from_b.x_m.hypot(a_from_b.y_m);
        let m = self.links.sigma_min_m + DRIFT_SHARE * self.links.drift_m_per_m * distance_m;
        let rad = self.links.sigma_min_rad + DRIFT_SHARE * self.links.drift_rad_per_m * distance_m;
        limit_information(information, [m, rad], REGULARISATION)
    }
}

/// Whether a submap is part of the map, as its first node is: all its nodes are in one component, and a component whose position is
/// uncertain begins within one submap.
fn is_placed(group: &Group, back: &BackEnd) -> bool {
    back.nodes().get(group.first as usize).is_some_and(|node| node.is_placed())
}

/// Poses in the frame of the first one.
fn relative(poses: &[Pose2]) -> Vec<Pose2> {
    poses.iter().map(|pose| poses[0].between(*pose)).collect()
}

/// Information of `b_from_a`, given the information of `a_from_b`.
fn inverted(information: Matrix3<f64>, a_from_b: Pose2) -> Matrix3<f64> {
    let (sin, cos) = a_from_b.yaw_rad.sin_cos();
    let back = Matrix3::new(-cos, sin, a_from_b.y_m, -sin, -cos, -a_from_b.x_m, 0.0, 0.0, -1.0);
    back.transpose() * information * back
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numerically: how the outer pose moves when the inner one does.
    fn jacobian(outer: impl Fn(Pose2) -> Pose2, at: Pose2) -> Matrix3<f64> {
        let step = 1e-6;
        Matrix3::from_fn(|row, column| {
            let mut moved = at;
            match column {
                0 => moved.x_m += step,
                1 => moved.y_m += step,
                _ => moved.yaw_rad += step,
            }
            let (a, b) = (outer(at), outer(moved));
            [b.x_m - a.x_m, b.y_m - a.y_m, wrap_angle(b.yaw_rad - a.yaw_rad)][row] / step
        })
    }

    #[test]
    fn information_moves_with_the_frames_it_is_said_in() {
        let (i_from_a, z, b_from_j) =
            (Pose2::new(1.0, -2.0, 0.7), Pose2::new(3.0, 0.5, -1.1), Pose2::new(-2.0, 1.5, 2.0));
        let information = Matrix3::new(4.0, 1.0, 0.2, 1.0, 3.0, -0.3, 0.2, -0.3, 9.0);
        let j = jacobian(|z| i_from_a * z * b_from_j, z).try_inverse().unwrap();
        let expected = j.transpose() * information * j;
        assert!((transport_information(information, i_from_a, z, b_from_j) - expected).amax() < 1e-4);
        let j = jacobian(|z| z.inverse(), z).try_inverse().unwrap();
        let expected = j.transpose() * information * j;
        assert!((inverted(information, z) - expected).amax() < 1e-4);
    }
}
