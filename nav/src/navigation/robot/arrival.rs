//! Turns of a robot on the spot: at the goal, and while it waits for another robot.

use super::super::goal::NextPose;
use super::super::input::{NavigatedRobot, RobotPoses};
use super::super::state::NavigationState;
use super::RobotNavigator;
use crate::command::Twist;
use crate::geometry::distance_m;
use msg::{Stamp, pose::wrap_angle};

/// Heading error at which the heading of a goal is reached, radians: six degrees.
const HEADING_TOLERANCE_RAD: f64 = 0.1;
/// Heading error at which a heading between others is passed, radians: the robot turns on without a stop, and sees beyond it.
const PASSED_HEADING_RAD: f64 = 0.3;
/// Distance of the point that is faced to turn to a heading, metres: so far away that its direction is the heading.
const FACED_POINT_M: f64 = 100.0;

impl RobotNavigator {
    /// Turns to where the path goes on after a wait, so that the robot starts without delay.
    pub(super) fn face_the_way_on(&self, poses: RobotPoses) -> Twist {
        let ahead_m = self.followed.as_ref().and_then(|path| path.goes_on_at_m);
        let Some(ahead_m) = ahead_m else { return Twist::STOP };
        let (twist, error_rad) = self.follower.turn_to_face(poses.odom_from_base, ahead_m);
        if error_rad.abs() > self.config.follower.turn_until_rad { twist } else { Twist::STOP }
    }

    /// Turns to the heading of the pose if it counts, and goes on with the next pose or ends.
    pub(super) fn arrive(&mut self, now: Stamp, robot: &NavigatedRobot, poses: RobotPoses) -> Twist {
        let pose = self.goal_pose(robot).ok();
        let Some(active) = self.goal.as_mut() else { return Twist::STOP };
        let next = active.goal.next_pose_after(active.next);
        if next == NextPose::Elsewhere {
            active.take_next_pose(now, true);
            (self.searched, self.followed) = (None, None);
            return Twist::STOP;
        }
        if active.arrived_at.is_none() {
            // Once: a robot that its turns move away and back has no more time for that.
            active.progress.restart(now);
        }
        if !active.is_at_position(poses.odom_from_base) {
            active.arrived_at = Some(poses.odom_from_base);
        }
        let turns_on = next == NextPose::SamePlace;
        if let Some(yaw_rad) = pose.and_then(|pose| pose.yaw_rad) {
            let at = poses.map_from_base;
            let (sin, cos) = wrap_angle(yaw_rad).sin_cos();
            let faced_m = [at.x_m + FACED_POINT_M * cos, at.y_m + FACED_POINT_M * sin];
            let (mut twist, error_rad) = self.follower.turn_to_face(at, faced_m);
            let tolerance_rad = if turns_on { PASSED_HEADING_RAD } else { HEADING_TOLERANCE_RAD };
            if error_rad.abs() > tolerance_rad {
                self.state = NavigationState::Driving;
                if turns_on {
                    twist.angular_rad_s = self.config.follower.turn_rad_s.copysign(error_rad);
                }
                return twist;
            }
            if turns_on {
                active.take_next_pose(now, false);
                return twist;
            }
        }
        self.end(NavigationState::Reached);
        // What was not reached of it, as where an obstacle is too near.
        self.remaining_m = pose.map(|pose| distance_m(pose.position_m, poses.position_m()));
        Twist::STOP
    }
}
