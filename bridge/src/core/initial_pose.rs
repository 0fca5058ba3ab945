//! Initial poses from a person: RViz's "2D Pose Estimate" on `/initialpose`, or `/robotN/initialpose`.

use super::Core;
use crate::world::{TransformError, floor_pose};
use msg::{Pose2, RobotId, SlamRequest, SlamRequestKind};
use ros_messages::PoseWithCovarianceStamped;
use ros_messages::names::{FleetFrame, MAP};
use ros_messages::read::Transform;
use thiserror::Error;

/// Indices of the variances of x, y and the rotation about z in the row-major 6 x 6 covariance.
const X_X: usize = 0;
const Y_Y: usize = 7;
const YAW_YAW: usize = 35;

/// Why an initial pose is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InitialPoseError {
    /// The pose is not one on the floor.
    #[error(transparent)]
    Pose(#[from] TransformError),
    /// A variance is negative or not finite.
    #[error("covariance[{index}] is {value}; expected a variance of 0 or more")]
    Variance {
        /// Index in the row-major covariance.
        index: usize,
        /// The value in the message.
        value: f64,
    },
    /// The place of the robot's map in the merged map is not known.
    #[error("where {robot}'s map lies in '{frame}' is not known yet; give the pose in its own map")]
    UnknownMapTransform {
        /// Robot that the pose was meant for.
        robot: RobotId,
        /// The message's frame.
        frame: String,
    },
    /// The frame is not a map.
    #[error("a pose in '{frame}': expected '{MAP}', or a robot's map such as {example}")]
    Frame {
        /// The message's frame.
        frame: String,
        /// Frame of the first robot's map.
        example: String,
    },
    /// The frame is another robot's map.
    #[error("a pose in '{frame}' is not {robot}'s")]
    OtherRobot {
        /// The message's frame.
        frame: String,
        /// The robot that the topic names.
        robot: RobotId,
    },
}

impl Core {
    /// Asks SLAM to take a pose as the robot's.
    ///
    /// `robot` is the robot that the topic names. Otherwise the frame names it, or the selected one is meant.
    pub(super) fn request_initial_pose(
        &mut self,
        robot: Option<RobotId>,
        message: &PoseWithCovarianceStamped,
    ) -> Result<(), InitialPoseError> {
        let frame_from_base = floor_pose(&Transform {
            stamp: message.stamp,
            frame_id: message.frame_id.as_str(),
            child_frame_id: "",
            translation: message.position,
            rotation: message.orientation,
        })?;
        let (sigma_m, sigma_rad) = standard_deviations(&message.covariance)?;
        let frame = message.frame_id.as_str();
        let (robot, pose) = if frame.strip_prefix('/').unwrap_or(frame) == MAP {
            let robot = robot.unwrap_or(self.gate.drive().selected());
            (robot, self.map_from_robot_map(robot, frame)?.inverse() * frame_from_base)
        } else {
            (self.robot_of_map(robot, frame)?, frame_from_base)
        };
        let kind = SlamRequestKind::SetPose as u32;
        let request = SlamRequest { kind, pose, sigma_m, sigma_rad, ..Default::default() };
        self.commands.push_slam_request(robot, request);
        Ok(())
    }

    fn map_from_robot_map(&self, robot: RobotId, frame: &str) -> Result<Pose2, InitialPoseError> {
        let known = self.fleet.map_transforms().and_then(|all| all.robots[robot.index()].known_pose());
        known.ok_or_else(|| InitialPoseError::UnknownMapTransform { robot, frame: frame.to_owned() })
    }

    /// Returns the robot whose map a frame is, which must be the robot that the topic names, if it names one.
    fn robot_of_map(&self, named: Option<RobotId>, frame: &str) -> Result<RobotId, InitialPoseError> {
        let robot_count = self.fleet.robot_count();
        let of = match self.fleet.robot_names().parse_frame(frame) {
            Some((of, FleetFrame::Map)) if of.number() <= robot_count => of,
            _ => {
                let first = self.fleet.robots().next();
                let example = first.map_or("map_1", |first| self.fleet.frame_names().map(first)).to_owned();
                return Err(InitialPoseError::Frame { frame: frame.to_owned(), example });
            }
        };
        match named {
            Some(robot) if robot != of => {
                Err(InitialPoseError::OtherRobot { frame: frame.to_owned(), robot })
            }
            _ => Ok(of),
        }
    }
}

/// Returns the standard deviations of the position (the larger axis, m) and of the heading (rad).
fn standard_deviations(covariance: &[f64; 36]) -> Result<(f64, f64), InitialPoseError> {
    let variance = |index: usize| {
        let value = covariance[index];
        let is_valid = value.is_finite() && value >= 0.0;
        is_valid.then_some(value).ok_or(InitialPoseError::Variance { index, value })
    };
    Ok((variance(X_X)?.max(variance(Y_Y)?).sqrt(), variance(YAW_YAW)?.sqrt()))
}
