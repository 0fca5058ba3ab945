//! Goals of exploration as the navigator was given them.

use super::types::{CoordinatedRobot, RobotGoal};
use crate::geometry::distance_m;
use crate::navigation::{GoalError, GoalFrame, GoalPose, NavigationGoal};
use msg::pose::wrap_angle;

/// Distance within which two goals are at one place, metres: a cell of the map.
const SAME_PLACE_M: f64 = 0.06;
/// Distance to its place within which a robot is told of new headings, metres. Farther away they may change again.
const HEADINGS_FROM_M: f64 = 0.5;
/// Change of the first heading that a robot is told of, radians: less than the sensor sees to each side.
const HEADING_CHANGE_RAD: f64 = 0.35;
/// Goal that the navigator was given.
#[derive(Clone, Debug)]
pub(super) struct SentGoal {
    pub(super) frame: GoalFrame,
    pub(super) goal: RobotGoal,
}

impl SentGoal {
    /// The goal as navigation takes it: one pose for each heading.
    pub(super) fn to_navigation(&self) -> Result<NavigationGoal, GoalError> {
        let pose = |yaw_rad| GoalPose { position_m: self.goal.position_m, yaw_rad };
        let poses = match self.goal.headings_rad.as_slice() {
            [] => vec![pose(None)],
            headings => headings.iter().map(|heading| pose(Some(*heading))).collect(),
        };
        NavigationGoal::new(self.frame, poses)
    }

    /// Whether a robot need not be told of a goal, because this one is as good.
    pub(super) fn is_same(&self, frame: GoalFrame, goal: &RobotGoal, robot: &CoordinatedRobot) -> bool {
        if self.frame != frame {
            return false;
        }
        if distance_m(self.goal.position_m, goal.position_m) > SAME_PLACE_M
            || self.goal.purpose != goal.purpose
        {
            return false;
        }
        let is_far = robot
            .map_from_base
            .is_none_or(|pose| distance_m([pose.x_m, pose.y_m], goal.position_m) > HEADINGS_FROM_M);
        let is_near_last = |a: Option<&f64>, b: Option<&f64>| match (a, b) {
            (Some(a), Some(b)) => wrap_angle(a - b).abs() < HEADING_CHANGE_RAD,
            (None, None) => true,
            _ => false,
        };
        is_far || is_near_last(self.goal.headings_rad.last(), goal.headings_rad.last())
    }
}
