//! Nodes, which the front end sends to the back end, and frame updates, which the back end returns.

use crate::beam_poses::BeamPoses;
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::encoding::plain;
use crate::limits::REACH_M_MAX;
use msg::{Header, Pose2, Scan};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::sync::Arc;

/// A scan that entered the pose graph.
// More than 12 fields: one record of the session file, of which each stage reads a few.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Node {
    /// Nodes count from 0 without gaps: the front end numbers those it makes, the back end those it keeps.
    pub id: u32,
    /// The scan's header.
    pub header: Header,
    /// Pose in the front end's own frame, which never jumps.
    pub local_from_base: Pose2,
    /// Pose in the frame of the node before, by odometry; `None` if unknown, as after that node was removed.
    pub previous_from_this: Option<Pose2>,
    /// Whether the scan fitted the local map, or saw nothing that could fit; if not, or if it saw nothing, only odometry connects it with the others.
    pub is_tracked: bool,
    /// Whether it contradicts the nodes before: the robot is not where odometry has it, and nothing
    /// connects this node with the ones before until it is located.
    pub odometry_break: bool,
    /// First node of the node's component while that is not placed in the map; `None` in the map.
    /// Set by the back end.
    #[serde(skip)]
    pub disconnected_component: Option<u32>,
    /// First node of the node's component while its position in the map is too uncertain to be part of it; `None` otherwise.
    /// Set by the back end.
    #[serde(skip)]
    pub uncertain_component: Option<u32>,
    /// Time since the node before in which neither odometry nor scans measured the motion, seconds.
    pub unmeasured_s: f32,
    /// What odometry measured too much since the node before, where scans contradicted it: (x, y, yaw), metres and radians.
    /// `previous_from_this` is without it.
    pub slip: [f64; 3],
    /// Whether neither scans nor odometry came for some seconds since the node before, and the wheels stood: the robot may have been
    /// carried meanwhile.
    pub possibly_kidnapped: bool,
    /// Surface points, for matching.
    #[serde(with = "crate::encoding::shared")]
    pub cloud: Arc<Cloud>,
    /// Beam end points, for drawing.
    #[serde(with = "crate::encoding::shared")]
    pub rays: Arc<Rays>,
    /// Positions of the robot since the node before.
    pub swept_path: SweptPath,
}

/// The most positions of a swept path; beyond them the oldest is dropped.
pub const SWEPT_PATH_POSITIONS_MAX: usize = 24;
/// Distance between two positions, metres: a body drawn at each of them covers the path.
const SWEPT_PATH_STEP_M: f32 = 0.05;

/// Positions of the robot between two nodes, metres. A node's are in its `base_footprint` and include its own; none if
/// the path or the robot's radius is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SweptPath {
    positions_m: [[f32; 2]; SWEPT_PATH_POSITIONS_MAX],
    len: usize,
}

impl SweptPath {
    /// The path of these positions, up to `SWEPT_PATH_POSITIONS_MAX` of them.
    pub fn of(positions_m: &[[f32; 2]]) -> Self {
        let mut path = Self { len: positions_m.len().min(SWEPT_PATH_POSITIONS_MAX), ..Self::default() };
        path.positions_m[..path.len].copy_from_slice(&positions_m[..path.len]);
        path
    }

    /// The positions, oldest first, metres.
    pub fn positions_m(&self) -> &[[f32; 2]] {
        &self.positions_m[..self.len]
    }

    /// Appends a position, unless one nearby is there already.
    pub(crate) fn push(&mut self, [x, y]: [f32; 2]) {
        if self.positions_m().iter().any(|[u, v]| (x - u).hypot(y - v) < SWEPT_PATH_STEP_M) {
            return;
        }
        if self.len == SWEPT_PATH_POSITIONS_MAX {
            self.positions_m.rotate_left(1);
            self.len -= 1;
        }
        self.positions_m[self.len] = [x, y];
        self.len += 1;
    }

    /// The path in the frame of a pose, with that pose's own position.
    pub(crate) fn seen_from(mut self, pose: Pose2) -> Self {
        let pose_from_frame = pose.inverse();
        for position in &mut self.positions_m[..self.len] {
            *position = pose_from_frame.apply(position.map(f64::from)).map(|v| v as f32);
        }
        // The pose's own position replaces the newest one closer than a step.
        let near = self.positions_m().iter().rposition(|[x, y]| x.hypot(*y) < SWEPT_PATH_STEP_M);
        match near {
            Some(index) => self.positions_m[index] = [0.0; 2],
            None => self.push([0.0; 2]),
        }
        self
    }
}

impl Serialize for SweptPath {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        plain::serialize(self.positions_m(), to)
    }
}

/// Accepts at most `SWEPT_PATH_POSITIONS_MAX` positions.
impl<'de> Deserialize<'de> for SweptPath {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let positions_m: Vec<[f32; 2]> = plain::deserialize(from)?;
        if positions_m.len() > SWEPT_PATH_POSITIONS_MAX {
            return Err(D::Error::invalid_length(positions_m.len(), &"at most a path's positions"));
        }
        Ok(Self::of(&positions_m))
    }
}

/// Covariance of a pose in the map, and where in the map it is: seen from elsewhere, an error in heading moves it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameUncertainty {
    /// Covariance of the pose, as seen from one node of the map, the first one where all are placed: upper triangle over (x, y, yaw), row by row.
    pub covariance: [f64; 6],
    /// Position of the pose in the map, metres.
    pub position_m: [f64; 2],
}

/// The back end's result after a node, for the front end.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MapFrameUpdate {
    /// The node that caused it.
    pub cause_node: u32,
    /// It takes effect with the scan that makes this node, or the first one after it.
    pub effective_from_node: u32,
    /// Pose of the front end's frame in the loop-closed map, by the newest node.
    pub map_from_local: Pose2,
    /// How well that is known: the covariance of the newest node's pose in the map.
    ///
    /// A session does not keep it: the back end finds it anew.
    #[serde(skip)]
    pub uncertainty: FrameUncertainty,
    /// Number of active closures.
    pub closures: u32,
    /// Whether the robot is located in its map; if not, `map_from_local` is not valid.
    pub located: bool,
    /// Whether a person said where the robot is, and scans have not confirmed it yet.
    ///
    /// A session does not keep it.
    #[serde(skip)]
    pub unconfirmed: bool,
    /// Whether there is evidence that the map is wrong: see `ReliabilityEvidence`.
    ///
    /// A session does not keep it: the back end finds it anew.
    #[serde(skip)]
    pub unreliable: bool,
}

/// A scan's beams as end points in `base_footprint`, metres.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Rays {
    /// Sensor position, where the beams start.
    pub sensor: [f32; 2],
    /// End points of beams with a return.
    #[serde(with = "crate::encoding::plain")]
    pub hits: Vec<[f32; 2]>,
    /// Points up to which beams without a return are known to be free.
    #[serde(with = "crate::encoding::plain")]
    pub misses: Vec<[f32; 2]>,
}

impl Node {
    /// Whether the node is part of the map: drawn, matched against, given out.
    pub fn in_map(&self) -> bool {
        self.is_tracked && self.is_placed()
    }

    /// Whether the node's place in the map is known.
    pub fn is_placed(&self) -> bool {
        self.unplaced_component().is_none()
    }

    /// First node of the node's component while its place in the map is not known: nothing connects it with the map, or its
    /// position is too uncertain.
    pub fn unplaced_component(&self) -> Option<u32> {
        self.disconnected_component.or(self.uncertain_component)
    }

    /// A copy with memory of its own, for code that keeps nodes; it releases the front end's buffers.
    pub fn into_owned(self) -> Self {
        let (cloud, rays) = (Arc::new(Cloud::clone(&self.cloud)), Arc::new(Rays::clone(&self.rays)));
        Self { cloud, rays, ..self }
    }
}

impl Rays {
    /// Rays without beams, with room for `beams` of each kind.
    pub fn with_capacity(beams: usize) -> Self {
        Self { sensor: [0.0; 2], hits: Vec::with_capacity(beams), misses: Vec::with_capacity(beams) }
    }

    /// The beams worth drawing, see [`Rays::fill`].
    pub fn new(scan: &Scan, sweep: &BeamPoses, config: &SlamConfig) -> Self {
        let mut rays = Self::default();
        rays.fill(scan, sweep, config);
        rays
    }

    /// Replaces the beams by those of a scan that are worth drawing: REP-117's +inf and ranges beyond the
    /// maximum are misses; NaN and ranges below the minimum, with -inf, are dropped.
    pub fn fill(&mut self, scan: &Scan, sweep: &BeamPoses, config: &SlamConfig) {
        let clear_m = config.map.clear_without_return_m.min(scan.range_max_m).min(REACH_M_MAX);
        let first_beam = sweep.base_from_sensor(0);
        self.sensor = sweep.mid_sweep_position();
        self.hits.clear();
        self.misses.clear();
        for (beam, &range) in scan.ranges_m().iter().enumerate() {
            let (drawn, reach) = if range >= scan.range_max_m {
                (&mut self.misses, clear_m)
            } else if range >= scan.range_min_m && range > 0.0 && range <= config.map.range_max_m {
                (&mut self.hits, range)
            } else {
                continue;
            };
            let base_from_sensor = if sweep.has_motion() { sweep.base_from_sensor(beam) } else { first_beam };
            let (sin, cos) = scan.angle_rad(beam).sin_cos();
            drawn.push(base_from_sensor.point([reach * cos, reach * sin]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swept_path_has_each_position_once_and_keeps_the_newest() {
        let mut path = SweptPath::default();
        // Forth, back, and forth again.
        for k in (0..20).chain((0..20).rev()).chain(0..30) {
            path.push([0.02 * k as f32, 1.0]);
        }
        assert_eq!(path.positions_m().len(), 10);
        let seen = path.seen_from(Pose2::new(0.58, 1.0, core::f64::consts::PI));
        assert_eq!(seen.positions_m().len(), 10);
        assert_eq!(*seen.positions_m().last().unwrap(), [0.0; 2]);
        let first = seen.positions_m()[0];
        assert!((first[0] - 0.58).abs() < 1e-5 && first[1].abs() < 1e-5, "{first:?}");
        for k in 0..100 {
            path.push([k as f32, 0.0]);
        }
        assert_eq!(path.positions_m().len(), SWEPT_PATH_POSITIONS_MAX);
        assert_eq!(path.positions_m()[SWEPT_PATH_POSITIONS_MAX - 1], [99.0, 0.0]);
        assert_eq!(
            path.seen_from(Pose2::new(50.0, 3.0, 0.0)).positions_m()[SWEPT_PATH_POSITIONS_MAX - 1],
            [0.0; 2]
        );
    }
}
