//! The other robots as obstacles: kinematic bodies that follow the ground truth of their simulators.

use crate::body::{Body, STEP_S};
use crate::burger;
use msg::{GroundTruth, Pose2, ROBOTS_MAX, RobotId, Stamp};
use rapier3d::dynamics::RigidBodyHandle;

/// Time without a message after which a peer is removed, seconds.
pub(crate) const SILENT_MAX_S: f64 = 1.0;
/// Longest extrapolation with a peer's last velocity, seconds. Two of its messages may be lost.
const EXTRAPOLATE_MAX_S: f64 = 0.15;
/// Largest motion of a peer in a physics step that pushes, metres and radians: twice what its wheels can do. A peer that moves farther
/// is placed there. Its messages came late, or it is being pushed: each of two robots that push each other by what the other one was
/// pushed would throw both.
const PUSH_MAX_M: f64 = 2.0 * burger::LINEAR_MAX_M_S * STEP_S as f64;
const PUSH_MAX_RAD: f64 = 2.0 * burger::ANGULAR_MAX_RAD_S * STEP_S as f64;

/// Another robot of the fleet.
#[derive(Clone, Copy)]
struct Peer {
    body: RigidBodyHandle,
    truth: GroundTruth,
    /// Pose of the peer's body in this simulation.
    world_from_base: Pose2,
    present: bool,
}

/// All peers, by [`RobotId::index`].
pub(crate) struct Peers([Option<Peer>; ROBOTS_MAX]);

impl Default for Peers {
    fn default() -> Self {
        Self([None; ROBOTS_MAX])
    }
}

impl Peers {
    /// Records the pose of a peer. The caller has checked that `truth` is finite.
    pub(crate) fn update(&mut self, body: &mut Body, robot: RobotId, truth: &GroundTruth) {
        let peer = self.0[robot.index()].get_or_insert_with(|| Peer {
            body: body.insert_peer(truth.world_from_base),
            truth: *truth,
            world_from_base: truth.world_from_base,
            present: true,
        });
        if peer.present && truth.header.stamp < peer.truth.header.stamp {
            return;
        }
        peer.truth = *truth;
        if !peer.present {
            peer.present = true;
            peer.world_from_base = truth.world_from_base;
            body.place_obstacle(peer.body, truth.world_from_base);
        }
    }

    /// Moves every peer's body to its pose at `now`, the end of the next physics step.
    pub(crate) fn advance(&mut self, body: &mut Body, now: Stamp) {
        for peer in self.0.iter_mut().flatten().filter(|peer| peer.present) {
            let age_s = now - peer.truth.header.stamp;
            if age_s > SILENT_MAX_S {
                peer.present = false;
                body.hide_obstacle(peer.body);
                continue;
            }
            let next = extrapolate(&peer.truth, age_s);
            let moved = peer.world_from_base.between(next);
            if moved.x_m.hypot(moved.y_m) > PUSH_MAX_M || moved.yaw_rad.abs() > PUSH_MAX_RAD {
                body.place_obstacle(peer.body, next);
            } else {
                body.move_obstacle(peer.body, next);
            }
            peer.world_from_base = next;
        }
    }

    /// Iterates over the poses of the present peers.
    pub(crate) fn poses(&self) -> impl Iterator<Item = Pose2> + '_ {
        self.0.iter().flatten().filter(|peer| peer.present).map(|peer| peer.world_from_base)
    }
}

/// Extrapolates a peer's pose along an arc with its last velocity, at most with that of its wheels.
fn extrapolate(truth: &GroundTruth, age_s: f64) -> Pose2 {
    let ahead_s = age_s.clamp(-EXTRAPOLATE_MAX_S, EXTRAPOLATE_MAX_S);
    let limited = |velocity: f64, max: f64| velocity.clamp(-max, max);
    let turn_rad = limited(truth.angular_rad_s, burger::ANGULAR_MAX_RAD_S) * ahead_s;
    let (sin, cos) = (turn_rad / 2.0).sin_cos();
    let way_m = limited(truth.linear_m_s, burger::LINEAR_MAX_M_S) * ahead_s;
    truth.world_from_base * Pose2::new(way_m * cos, way_m * sin, turn_rad)
}
