//! Snapshot of the fleet's pose graph that outlives the merge process, with the operator's decisions.
//!
//! Submaps and closures are not in it: robots send submaps again, and closures are found again.

use super::FleetPoseGraph;
use super::edge::{Evidence, MapEdge, REJECTED_MAX};
use super::frame::ReferenceRobot;
use super::pair::RobotPair;
use crate::align::Alignment;
use crate::limits::is_plausible;
use msg::{EdgeState, Pose2};
use serde::{Deserialize, Serialize};

/// Snapshot of a [`FleetPoseGraph`] as plain values, to be kept in a file. Poses are x m, y m, yaw rad.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetSnapshot {
    /// One element for each robot of the fleet.
    robots: Vec<RobotSnapshot>,
    /// Index of the reference robot, and frame `map` from the beginning of its map.
    reference: Option<(usize, [f64; 3])>,
    /// The pairs of robots about which anything is known.
    pairs: Vec<PairSnapshot>,
}

/// Snapshot of a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotSnapshot {
    /// Frame `map` from frame `robotK/map`; none while it is unknown.
    map_from_robot_map: Option<[f64; 3]>,
    /// Number of the frame of its map; none before its poses have said it.
    #[serde(rename = "run")]
    map_frame: Option<u32>,
    /// Whether the robot's start is known: not after its machine began anew.
    is_start_known: bool,
    /// Whether the maps contradicted the start.
    is_start_contradicted: bool,
}

/// Snapshot of a pair of robots.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PairSnapshot {
    /// Number of the edge, from 1.
    edge: usize,
    /// Code of an [`EdgeState`].
    state: u32,
    a_from_b: [f64; 3],
    evidence: Option<Evidence>,
    /// Alignments that the operator rejected.
    rejected: Vec<[f64; 3]>,
}

/// Reason why a snapshot cannot be restored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotRejected {
    /// The snapshot is of another number of robots.
    #[error("is of a fleet of {found} robots; this one has {expected}")]
    Robots {
        /// Robots in the snapshot.
        found: usize,
        /// Robots in the fleet.
        expected: usize,
    },
    /// A number or an index is not valid.
    #[error("has {0} that is invalid")]
    Value(&'static str),
}

impl FleetPoseGraph {
    /// Takes a snapshot. It changes when something is found or decided, not with each solution of the graph.
    pub fn snapshot(&self) -> FleetSnapshot {
        let robots = self.robots.iter().map(|robot| RobotSnapshot {
            map_from_robot_map: robot.estimate.map_from_robot_map().map(to_values),
            map_frame: robot.map_frame,
            is_start_known: robot.estimate.configured_map_from_robot_map().is_some(),
            is_start_contradicted: robot.is_start_contradicted,
        });
        let reference =
            self.reference.map(|reference| (reference.robot, to_values(reference.map_from_robot_map)));
        let pairs = self.pairs.iter().enumerate().map(|(index, pair)| pair_snapshot(index, pair));
        let is_known =
            |pair: &PairSnapshot| pair.state != EdgeState::None as u32 || !pair.rejected.is_empty();
        FleetSnapshot { robots: robots.collect(), reference, pairs: pairs.filter(is_known).collect() }
    }

    /// Restores a snapshot that an earlier process of the same run took. Call it before anything else.
    ///
    /// The robots' transforms are valid at once.
    ///
    /// # Errors
    /// [`SnapshotRejected`] says what is not valid; then nothing has changed.
    pub fn restore(&mut self, snapshot: &FleetSnapshot) -> Result<(), SnapshotRejected> {
        let (found, expected) = (snapshot.robots.len(), self.robots.len());
        if found != expected {
            return Err(SnapshotRejected::Robots { found, expected });
        }
        let transforms = snapshot.robots.iter().map(|kept| kept.map_from_robot_map);
        let transforms = transforms.map(|values| values.map(|values| to_pose(values, "a place")).transpose());
        let transforms = transforms.collect::<Result<Vec<_>, _>>()?;
        let reference = match snapshot.reference {
            Some((robot, values)) if transforms.get(robot).is_some_and(Option::is_some) => {
                Some(ReferenceRobot { robot, map_from_robot_map: to_pose(values, "a frame")? })
            }
            Some(_) => return Err(SnapshotRejected::Value("a frame of a robot")),
            None => None,
        };
        let mut pairs = vec![RobotPair::default(); self.pairs.len()];
        for kept in &snapshot.pairs {
            let pair = kept.edge.checked_sub(1).and_then(|index| pairs.get_mut(index));
            let edge = restored_edge(kept)?;
            pair.ok_or(SnapshotRejected::Value("an edge's number"))?.edge = edge;
        }
        for ((robot, kept), transform) in self.robots.iter_mut().zip(&snapshot.robots).zip(transforms) {
            if !kept.is_start_known {
                robot.remove();
            }
            (robot.map_frame, robot.is_start_contradicted) = (kept.map_frame, kept.is_start_contradicted);
            let transform = transform.or(robot.estimate.configured_map_from_robot_map());
            robot.estimate.set_transform(transform);
        }
        (self.reference, self.pairs) = (reference, pairs);
        // A robot that no edge connects to the frame is in no map, whatever the snapshot says.
        self.graph_changed();
        Ok(())
    }
}

fn pair_snapshot(index: usize, pair: &RobotPair) -> PairSnapshot {
    // A candidate waits for its second alignment. It waits for the first one again, because its maps are lost.
    let state = if pair.edge.is_candidate() { EdgeState::None } else { pair.edge.state() };
    let is_known = state != EdgeState::None;
    // The edge keeps the transform; the evidence's own would differ by what the graph has moved since.
    let without_transform = |evidence: Evidence| Evidence {
        alignment: Alignment { a_from_b: Pose2::IDENTITY, ..evidence.alignment },
        ..evidence
    };
    let evidence = pair.edge.evidence().copied().filter(|evidence| is_known && is_finite(evidence));
    PairSnapshot {
        edge: index + 1,
        state: state as u32,
        a_from_b: if is_known { to_values(pair.edge.a_from_b()) } else { [0.0; 3] },
        evidence: evidence.map(without_transform),
        rejected: pair.edge.rejected().iter().copied().map(to_values).collect(),
    }
}

fn restored_edge(kept: &PairSnapshot) -> Result<MapEdge, SnapshotRejected> {
    let state = EdgeState::from_code(kept.state).filter(|state| *state != EdgeState::Candidate);
    let state = state.ok_or(SnapshotRejected::Value("an edge's state"))?;
    if kept.rejected.len() > REJECTED_MAX {
        return Err(SnapshotRejected::Value("a number of rejected alignments"));
    }
    let a_from_b = to_pose(kept.a_from_b, "an edge's place")?;
    let rejected = kept.rejected.iter().map(|values| to_pose(*values, "a rejected alignment"));
    let rejected = rejected.collect::<Result<Vec<_>, _>>()?;
    if kept.evidence.is_some_and(|evidence| !is_finite(&evidence)) {
        return Err(SnapshotRejected::Value("an edge's evidence"));
    }
    Ok(MapEdge::restored(state, a_from_b, kept.evidence, rejected))
}

fn is_finite(evidence: &Evidence) -> bool {
    let found = &evidence.alignment;
    let figures = [
        found.occupied_f1,
        found.agreement,
        found.overlap_m2,
        found.overlap_share,
        found.conflict,
        found.residual_m,
        found.margin,
        found.short_walls_margin,
        found.observability,
        evidence.null_f1_max,
    ];
    figures.iter().all(|value| value.is_finite())
}

fn to_values(pose: Pose2) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.yaw_rad]
}

fn to_pose([x_m, y_m, yaw_rad]: [f64; 3], what: &'static str) -> Result<Pose2, SnapshotRejected> {
    let pose = Pose2::new(x_m, y_m, yaw_rad);
    if is_plausible(pose) { Ok(pose) } else { Err(SnapshotRejected::Value(what)) }
}
