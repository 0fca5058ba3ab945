//! The submaps of one robot, as its SLAM sent them.

use super::draw_submaps::PlacedSubmap;
use crate::limits::{RESOLUTION_M, is_plausible};
use msg::{Grid, Pose2, SUBMAPS_MAX, Submap, SubmapEdge, SubmapPoses};
use nalgebra::Matrix3;
use posegraph::{Edge, Kernel, PoseSigmas};
use std::sync::Arc;

/// Standard deviations of the relation between two successive submaps that SLAM has not linked.
/// It keeps them in one graph, and is weaker than every other edge.
const UNKNOWN_LINK_SIGMAS: PoseSigmas = PoseSigmas { position_m: 0.5, heading_rad: 0.2 };

/// Incarnation of a robot's SLAM process, and generation of its submaps within that.
pub(crate) type SubmapSource = (u64, u32);

/// The newest version of a submap.
#[derive(Clone, Debug)]
pub(crate) struct StoredSubmap {
    /// Occupancy in the submap's frame.
    pub grid: Arc<Grid>,
    /// Pose-graph nodes in it.
    pub nodes: u32,
    /// Whether it is finished.
    pub finished: bool,
    /// Centre of the grid in the submap's frame, metres.
    pub centre_m: [f64; 2],
    /// Distance from the centre to the corners, metres.
    pub radius_m: f64,
}

/// All submaps of one robot, where they lie in the robot's own map, and how its SLAM links them.
#[derive(Clone, Debug, Default)]
pub(crate) struct SubmapStore {
    source: Option<SubmapSource>,
    submaps: Vec<Option<StoredSubmap>>,
    version: u64,
    poses: Vec<Pose2>,
    distances_m: Vec<f64>,
    links: Vec<(usize, usize, Matrix3<f64>)>,
}

impl SubmapStore {
    /// Empties the store for submaps of another source.
    pub fn restart(&mut self, source: Option<SubmapSource>) {
        *self = Self { source, version: self.version + 1, ..Self::default() };
    }

    /// Sets the source of the first submaps.
    pub fn set_source(&mut self, source: SubmapSource) {
        self.source = Some(source);
    }

    /// Returns the source of these submaps; `None` before the first message.
    pub fn source(&self) -> Option<SubmapSource> {
        self.source
    }

    /// Returns the number of submaps received: two equal versions hold equal submaps.
    pub fn version(&self) -> u64 {
        self.version
    }

    /// Stores a new or grown submap; returns false if it is malformed.
    pub fn add(&mut self, submap: &Submap) -> bool {
        let id = submap.id as usize;
        let Some(view) = submap.view() else { return false };
        let header = view.header;
        if id >= SUBMAPS_MAX || !RESOLUTION_M.contains(&header.resolution_m) || !is_plausible(header.origin) {
            return false;
        }
        let half = [header.width, header.height].map(|cells| f64::from(cells) * header.resolution_m / 2.0);
        let stored = StoredSubmap {
            centre_m: header.origin.apply(half),
            radius_m: half[0].hypot(half[1]),
            grid: Arc::new(view.to_owned()),
            nodes: submap.nodes,
            finished: submap.finished != 0,
        };
        if self.submaps.len() <= id {
            self.submaps.resize(id + 1, None);
        }
        self.submaps[id] = Some(stored);
        self.version += 1;
        true
    }

    /// Replaces poses and links. `None` if they are malformed, else whether anything changed.
    pub fn update_poses(&mut self, message: &SubmapPoses) -> Option<bool> {
        let poses = message.poses();
        let is_valid = |e: &SubmapEdge| {
            e.information.iter().all(|v| v.is_finite()) && e.a < e.b && (e.b as usize) < poses.len()
        };
        if !poses.iter().all(|pose| is_plausible(*pose)) || !message.edges().iter().all(is_valid) {
            return None;
        }
        if poses == self.poses && message.edges().len() == self.links.len() {
            return Some(false);
        }
        self.poses = poses.to_vec();
        self.distances_m = distances_along_m(poses);
        let matrix = |[xx, xy, xt, yy, yt, tt]: [f64; 6]| Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
        let links = message.edges().iter();
        self.links = links.map(|e| (e.a as usize, e.b as usize, matrix(e.information))).collect();
        Some(true)
    }

    /// Returns the number of submaps that have a pose and have not arrived.
    pub fn missing(&self) -> usize {
        self.poses.len().saturating_sub(self.submaps.iter().flatten().count())
    }

    /// Returns whether every submap that has arrived has a pose.
    pub fn all_have_poses(&self) -> bool {
        self.poses.len() >= self.submaps.len()
    }

    /// Returns the number of pose-graph nodes in all submaps.
    pub fn node_count(&self) -> u32 {
        self.submaps.iter().flatten().map(|submap| submap.nodes).sum()
    }

    /// Frame `robotK/map` from the frame of each submap, as the robot's own graph has it.
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// Returns a submap that has arrived, and its pose in the robot's map.
    pub fn get(&self, id: usize) -> Option<(&StoredSubmap, Pose2)> {
        Some((self.submaps.get(id)?.as_ref()?, *self.poses.get(id)?))
    }

    /// Returns the centre of a submap in the robot's map, metres; the origin of its frame if it has not arrived.
    pub fn centre_m(&self, id: usize) -> Option<[f64; 2]> {
        let pose = *self.poses.get(id)?;
        let submap = self.submaps.get(id).and_then(Option::as_ref);
        Some(pose.apply(submap.map_or([0.0; 2], |submap| submap.centre_m)))
    }

    /// Returns the distance that the robot drove between two of its submaps, metres.
    pub fn distance_driven_m(&self, i: usize, k: usize) -> f64 {
        let at = |id: usize| self.distances_m.get(id).or(self.distances_m.last()).copied().unwrap_or(0.0);
        (at(i) - at(k)).abs()
    }

    /// The submaps of a range, placed in the robot's own map.
    pub fn placed(&self, ids: core::ops::Range<usize>) -> Vec<PlacedSubmap> {
        let submaps = ids.filter_map(|id| self.get(id));
        submaps
            .map(|(submap, pose)| PlacedSubmap { grid: submap.grid.clone(), frame_from_submap: pose })
            .collect()
    }

    /// The robot's own links as edges of a graph in which its submaps begin at pose `first`.
    pub fn edges(&self, first: usize) -> Vec<Edge> {
        let between = |a: usize, b: usize, information| Edge {
            a: first + a,
            b: first + b,
            a_from_b: self.poses[a].between(self.poses[b]),
            information,
            kernel: Kernel::Quadratic,
        };
        let known = self.links.iter().filter(|(_, b, _)| *b < self.poses.len());
        let mut edges: Vec<_> = known.map(|(a, b, information)| between(*a, *b, *information)).collect();
        let mut linked = vec![false; self.poses.len()];
        for (_, b, _) in self.links.iter().filter(|(a, b, _)| a + 1 == *b) {
            if let Some(linked) = linked.get_mut(*b) {
                *linked = true;
            }
        }
        let loose = UNKNOWN_LINK_SIGMAS.information();
        edges.extend((1..self.poses.len()).filter(|b| !linked[*b]).map(|b| between(b - 1, b, loose)));
        edges
    }
}

/// Distance along a chain of poses up to each of them, metres.
pub(crate) fn distances_along_m(poses: &[Pose2]) -> Vec<f64> {
    let mut distance_m = 0.0;
    let steps = poses.iter().zip(poses.first().into_iter().chain(poses));
    steps
        .map(|(pose, before)| {
            distance_m += before.distance_m(*pose);
            distance_m
        })
        .collect()
}
