//! Goals of exploration as the navigator was given them.

use super::types::{CoordinatedRobot, GoalProgress, RobotGoal};
use crate::geometry::distance_m;
use crate::navigation::{GoalError, GoalFrame, GoalPose, NavigationFailure, NavigationGoal, NavigationState};
use msg::{Stamp, pose::wrap_angle};

/// Distance within which two goals are at one place, metres: a cell of the map.
const SAME_PLACE_M: f64 = 0.06;
/// Distance to its place within which a robot is told of new headings, metres. Farther away they may change again.
const HEADINGS_FROM_M: f64 = 0.5;
/// Change of the first heading that a robot is told of, radians: less than the sensor sees to each side.
const HEADING_CHANGE_RAD: f64 = 0.35;
/// Time after which a goal is left alone at which something stands, seconds: a person who walks by has left.
const OCCUPIED_S: f64 = 3.0;

/// Goal that the navigator was given.
#[derive(Clone, Debug)]
pub(super) struct SentGoal {
    pub(super) frame: GoalFrame,
    pub(super) goal: RobotGoal,
    /// Since when navigation says that something stands there.
    pub(super) occupied_since: Option<Stamp>,
}

impl SentGoal {
    /// What a robot does with it, by the state of its navigation.
    pub(super) fn progress(&mut self, now: Stamp, state: NavigationState) -> GoalProgress {
        use NavigationFailure::{GoalExcluded, GoalOccupied};
        let is_occupied = matches!(state, NavigationState::Blocked(GoalOccupied | GoalExcluded(_)));
        self.occupied_since = is_occupied.then(|| self.occupied_since.unwrap_or(now));
        match state {
            NavigationState::Idle => GoalProgress::Idle,
            NavigationState::Reached => GoalProgress::Reached,
            NavigationState::Failed(_) | NavigationState::Cancelled => GoalProgress::Failed,
            _ if self.occupied_since.is_some_and(|since| now - since >= OCCUPIED_S) => GoalProgress::Occupied,
            _ => GoalProgress::Active,
        }
    }

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coordination::GoalPurpose;

    #[test]
    fn a_goal_counts_as_occupied_after_three_seconds_without_a_break() {
        let goal = RobotGoal {
            purpose: GoalPurpose::Explore,
            position_m: [1.0, 0.0],
            headings_rad: Vec::new(),
            expected_s: 5.0,
            gain_m2: 1.0,
        };
        let mut sent = SentGoal { frame: GoalFrame::MergedMap, goal, occupied_since: None };
        let occupied = NavigationState::Blocked(NavigationFailure::GoalOccupied);
        let mut progress = |at_s, state| sent.progress(Stamp::from_seconds(at_s), state);
        assert_eq!(progress(0.0, occupied), GoalProgress::Active);
        assert_eq!(progress(2.0, NavigationState::Driving), GoalProgress::Active);
        assert_eq!(progress(4.0, occupied), GoalProgress::Active);
        assert_eq!(progress(7.0, occupied), GoalProgress::Occupied);
        let unreachable = NavigationState::Blocked(NavigationFailure::GoalUnreachable);
        assert_eq!(
            progress(60.0, unreachable),
            GoalProgress::Active,
            "the robot turns to see whether a way leads on"
        );
    }
}
