//! What the fleet must not forget when its process dies: where robots lie, and what the operator said. Submaps and
//! closures are not in it: robots send the ones again, and the others are found again.

use super::FleetPoseGraph;
use super::pair::REFUSED_MAX;
use crate::align::Alignment;
use crate::merger::is_near;
use msg::{EdgeState, Pose2};
use serde::{Deserialize, Serialize};

/// Plain values that can be kept and read again. Poses are x m, y m, yaw rad.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FleetSnapshot {
    /// `map` from `robotK/map`, by robot; none while it is not known.
    anchors: Vec<Option<[f64; 3]>>,
    /// The robot, from 0, whose map the fleet's frame was taken from, and where that map begins.
    holder: Option<(usize, [f64; 3])>,
    /// Pairs of which anything is known.
    pairs: Vec<PairSnapshot>,
}

/// What is known of two robots.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct PairSnapshot {
    /// The edge's number, from 1.
    edge: usize,
    /// An `EdgeState`'s code.
    state: u32,
    a_from_b: [f64; 3],
    /// What the newest look at two whole maps found, and what chance gives.
    grounds: Option<(Alignment, f64)>,
    /// Places that the operator took back.
    refused: Vec<[f64; 3]>,
}

/// Why a memory is not this fleet's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotRejected {
    /// Another number of robots.
    #[error("is of a fleet of {found} robots; this one has {expected}")]
    Robots {
        /// In the memory.
        found: usize,
        /// In the fleet.
        expected: usize,
    },
    /// A number or a reference that makes no sense.
    #[error("has {0} that makes no sense")]
    Value(&'static str),
}

impl FleetPoseGraph {
    /// All that is to be remembered. It changes when something is found or said, not with each solution.
    pub fn snapshot(&self) -> FleetSnapshot {
        let anchors = self.members.iter().map(|member| member.anchor.map(plain)).collect();
        let holder = self.holder.map(|(robot, pose)| (robot, plain(pose)));
        let known = self.pairs.iter().enumerate().map(|(index, pair)| {
            // A find that waits for its second look waits for the first one again: its maps are gone.
            let state = Some(pair.state()).filter(|state| *state != EdgeState::Candidate);
            let state = state.unwrap_or(EdgeState::None);
            let is_known = state != EdgeState::None;
            PairSnapshot {
                edge: index + 1,
                state: state as u32,
                a_from_b: if is_known { plain(pair.a_from_b) } else { [0.0; 3] },
                // Where it was found is not kept: the pair's place is where it lies now.
                grounds: pair
                    .grounds
                    .filter(|grounds| is_known && is_sound(grounds))
                    .map(|(found, null_f1)| (Alignment { a_from_b: Pose2::IDENTITY, ..found }, null_f1)),
                refused: pair.refused.iter().copied().map(plain).collect(),
            }
        });
        let said = |pair: &PairSnapshot| pair.state != EdgeState::None as u32 || !pair.refused.is_empty();
        FleetSnapshot { anchors, holder, pairs: known.filter(said).collect() }
    }

    /// Goes on with what an earlier process of the same run remembered: robots lie where they lay, before anything
    /// has come of them. To be told first of all; nothing changes if it is refused.
    pub fn restore(&mut self, memory: &FleetSnapshot) -> Result<(), SnapshotRejected> {
        let (found, expected) = (memory.anchors.len(), self.members.len());
        if found != expected {
            return Err(SnapshotRejected::Robots { found, expected });
        }
        let pose = |values: [f64; 3], what| {
            let [x_m, y_m, yaw_rad] = values;
            let pose = Pose2::new(x_m, y_m, yaw_rad);
            Some(pose).filter(|pose| is_near(*pose)).ok_or(SnapshotRejected::Value(what))
        };
        let anchor = |anchor: &Option<[f64; 3]>| anchor.map(|values| pose(values, "a place")).transpose();
        let anchors = memory.anchors.iter().map(anchor).collect::<Result<Vec<_>, _>>()?;
        let holder = match memory.holder {
            Some((robot, values)) if anchors.get(robot).is_some_and(Option::is_some) => {
                Some((robot, pose(values, "a frame")?))
            }
            Some(_) => return Err(SnapshotRejected::Value("a frame of a robot")),
            None => None,
        };
        let mut pairs = vec![super::Pair::default(); self.pairs.len()];
        for kept in &memory.pairs {
            let state = EdgeState::from_code(kept.state).filter(|state| *state != EdgeState::Candidate);
            let state = state.ok_or(SnapshotRejected::Value("an edge's state"))?;
            let pair = kept.edge.checked_sub(1).and_then(|index| pairs.get_mut(index));
            let pair = pair.ok_or(SnapshotRejected::Value("an edge's number"))?;
            if kept.refused.len() > REFUSED_MAX {
                return Err(SnapshotRejected::Value("a number of places taken back"));
            }
            pair.state = Some(state);
            pair.a_from_b = pose(kept.a_from_b, "an edge's place")?;
            for refused in &kept.refused {
                pair.refused.push(pose(*refused, "a place taken back")?);
            }
            if kept.grounds.is_some_and(|grounds| !is_sound(&grounds)) {
                return Err(SnapshotRejected::Value("an edge's evidence"));
            }
            let there = |(found, null_f1)| (Alignment { a_from_b: pair.a_from_b, ..found }, null_f1);
            pair.grounds = kept.grounds.map(there);
        }
        for (member, anchor) in self.members.iter_mut().zip(anchors) {
            member.anchor = anchor.or(member.start);
            member.corrections = member.anchor.into_iter().collect();
        }
        (self.holder, self.pairs) = (holder, pairs);
        // What nothing ties to the frame is in no map, whatever was written.
        self.connect();
        self.unsolved = true;
        Ok(())
    }
}

fn is_sound((found, null_f1): &(Alignment, f64)) -> bool {
    let Alignment {
        occupied_f1,
        agreement,
        overlap_m2,
        overlap_share,
        conflict,
        residual_m,
        margin,
        observability,
        ..
    } = *found;
    let all = [
        occupied_f1,
        agreement,
        overlap_m2,
        overlap_share,
        conflict,
        residual_m,
        margin,
        observability,
        *null_f1,
    ];
    all.iter().all(|value| value.is_finite())
}

fn plain(pose: Pose2) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.yaw_rad]
}
