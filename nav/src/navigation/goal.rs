//! Goals of navigation, with the frame that their poses are in.

use crate::geometry::distance_m;
use msg::Pose2;
use msg::pose::COORDINATE_MAX_M;
use thiserror::Error;

pub use msg::GOAL_POSES_MAX;

/// Distance within which two poses are one place, at which the robot turns, metres.
const SAME_PLACE_M: f64 = 0.01;

/// What comes after a pose of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NextPose {
    /// A pose elsewhere: the heading at this one does not count.
    Elsewhere,
    /// Another heading at the same place: the robot turns from this heading to that one.
    SamePlace,
    /// No other pose.
    Absent,
}

/// Frame that the poses of a goal are in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalFrame {
    /// The merged map, which all merged robots share.
    MergedMap,
    /// The robot's own map, before and after it is merged.
    RobotMap,
}

/// Pose to reach.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GoalPose {
    /// Position in the frame of the goal, metres.
    pub position_m: [f64; 2],
    /// Heading to turn to on arrival, radians; any heading will do if `None`. It counts at the last pose, and where the next
    /// pose is at the same place.
    pub yaw_rad: Option<f64>,
}

/// One or more poses that a robot drives to, one after another. Poses at one place are headings to turn through there.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigationGoal {
    frame: GoalFrame,
    poses: Vec<GoalPose>,
}

/// A goal is not usable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum GoalError {
    /// There is no pose in it.
    #[error("the goal has no pose")]
    Empty,
    /// There are more poses than [`GOAL_POSES_MAX`].
    #[error("the goal has {0} poses, expected at most {GOAL_POSES_MAX}")]
    TooManyPoses(usize),
    /// A coordinate is not a usable number.
    #[error("pose {0} of the goal is not a finite pose within 100 km of the origin")]
    NotFinite(usize),
}

impl NavigationGoal {
    /// A goal with these poses.
    pub fn new(frame: GoalFrame, poses: Vec<GoalPose>) -> Result<Self, GoalError> {
        if poses.is_empty() {
            return Err(GoalError::Empty);
        }
        if poses.len() > GOAL_POSES_MAX {
            return Err(GoalError::TooManyPoses(poses.len()));
        }
        let is_valid = |pose: &GoalPose| {
            pose.position_m.iter().all(|v| v.abs() <= COORDINATE_MAX_M)
                && pose.yaw_rad.is_none_or(f64::is_finite)
        };
        match poses.iter().position(|pose| !is_valid(pose)) {
            Some(index) => Err(GoalError::NotFinite(index)),
            None => Ok(Self { frame, poses }),
        }
    }

    /// A goal of one position, with any heading.
    pub fn position(frame: GoalFrame, position_m: [f64; 2]) -> Result<Self, GoalError> {
        Self::new(frame, vec![GoalPose { position_m, yaw_rad: None }])
    }

    /// Frame of the poses.
    pub fn frame(&self) -> GoalFrame {
        self.frame
    }

    /// What comes after the pose with this index.
    pub(super) fn next_pose_after(&self, index: usize) -> NextPose {
        let Some([pose, next]) = self.poses.get(index..).and_then(|poses| poses.first_chunk()) else {
            return NextPose::Absent;
        };
        let is_turn = distance_m(pose.position_m, next.position_m) < SAME_PLACE_M;
        if is_turn && pose.yaw_rad.is_some() { NextPose::SamePlace } else { NextPose::Elsewhere }
    }

    /// The poses, at least one, in their order.
    pub fn poses(&self) -> &[GoalPose] {
        &self.poses
    }
}

impl GoalPose {
    /// The same pose in another frame.
    pub(super) fn transformed(&self, to_from_goal: Pose2) -> Self {
        Self {
            position_m: to_from_goal.apply(self.position_m),
            yaw_rad: self.yaw_rad.map(|yaw_rad| yaw_rad + to_from_goal.yaw_rad),
        }
    }
}
