//! States of navigation and the reasons why a robot stands.

use msg::RobotId;
use thiserror::Error;

/// What the navigator does with a robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NavigationState {
    /// It has no goal.
    #[default]
    Idle,
    /// It looks for a path.
    Planning,
    /// It drives along its path.
    Driving,
    /// It lets another robot pass.
    WaitingForRobot(RobotId),
    /// It cannot drive on at the moment, and keeps trying.
    Blocked(NavigationFailure),
    /// It backs up or turns to get free.
    Recovering,
    /// It does not know where it is, and looks for its place: it turns, then drives by its LiDAR alone.
    FindingPlace,
    /// A person drives the robot or has stopped it; the goal waits for [`resume`](super::FleetNavigator::resume).
    Paused,
    /// It has arrived.
    Reached,
    /// The goal was cancelled.
    Cancelled,
    /// It has given up.
    Failed(NavigationFailure),
}

impl NavigationState {
    /// Whether the robot is driven, to a goal or to find its place.
    pub fn is_active(self) -> bool {
        matches!(
            self,
            Self::Planning
                | Self::Driving
                | Self::WaitingForRobot(_)
                | Self::Blocked(_)
                | Self::Recovering
                | Self::FindingPlace
        )
    }
}

/// Why a robot cannot drive to its goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum NavigationFailure {
    /// No map has arrived, or the robot does not know where it is in it.
    #[error(
        "the robot's pose in the map is not known: its SLAM is lost, paused, or has not confirmed the pose"
    )]
    NoPose,
    /// Its newest scan is too old to drive by.
    #[error("no scan has arrived for 0.5 s")]
    NoScan,
    /// The goal is in the merged map, and the robot's map is not part of it yet.
    #[error("the goal is in the merged map, and the robot's map is not merged yet")]
    NotMerged,
    /// The goal lies outside the map.
    #[error("the goal lies outside the map: nothing is known of the floor there")]
    GoalOutsideMap,
    /// Robot and goal do not fit into one window of the planner.
    #[error(
        "the goal is more than 25 m from the robot, which is the farthest that it plans: send it there in steps"
    )]
    GoalTooFar,
    /// An obstacle or an exclusion zone is at the goal.
    #[error("the goal lies on an obstacle, or too close to one or to an exclusion zone")]
    GoalOccupied,
    /// The goal lies in an exclusion zone.
    #[error("the goal lies in exclusion zone {0}")]
    GoalExcluded(u32),
    /// No way that is wide enough leads to the goal.
    #[error(
        "no way leads to the goal: unknown space, obstacles or zones lie between; exploring maps what is unknown"
    )]
    GoalUnreachable,
    /// The robot fits nowhere near its pose.
    #[error("obstacles or exclusion zones surround the robot")]
    StartBlocked,
    /// Something that the scan shows stands in the way.
    #[error("something stands in the way")]
    Obstacle,
    /// A robot stands in the way.
    #[error("{0} stands in the way")]
    Robot(RobotId),
}
