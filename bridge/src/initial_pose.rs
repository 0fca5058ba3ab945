//! Where a robot is, as a person says who sees it: RViz's "2D Pose Estimate" on `/initialpose`, or the same on
//! `/robotN/initialpose`.

use crate::hub::Hub;
use crate::ros::PoseWithCovarianceStamped;
use crate::ros::names::{FleetFrame, MAP, meaning};
use crate::ros::read::Transform;
use crate::world::floor_pose;
use msg::{RobotId, SlamRequest, SlamRequestKind};

/// Places in the covariance: x, y and the rotation about z, each with itself.
const X_X: usize = 0;
const Y_Y: usize = 7;
const YAW_YAW: usize = 35;

impl Hub {
    /// Asks SLAM to take a pose for the robot's. `robot` is whom the topic names; else the frame says it, or it is the
    /// selected one.
    pub(crate) fn initial_pose(
        &mut self,
        robot: Option<RobotId>,
        message: &PoseWithCovarianceStamped,
    ) -> Result<(), String> {
        let frame = message.frame_id.as_str();
        let transform = Transform {
            stamp: message.stamp,
            frame_id: frame,
            child_frame_id: "",
            translation: message.position,
            rotation: message.orientation,
        };
        let frame_from_base = floor_pose(&transform)?;
        let (sigma_m, sigma_rad) = sigmas(&message.covariance)?;
        let (robot, pose) = if frame.strip_prefix('/').unwrap_or(frame) == MAP {
            let robot = robot.unwrap_or(self.drive.selected());
            let map_transform = self
                .map_transforms
                .map(|all| all.robots[robot.index()])
                .filter(|map_transform| map_transform.known == 1);
            let map_transform = map_transform.ok_or_else(|| {
                format!(
                    "where {robot}'s map lies in '{frame}' is not known yet; give the pose in its own map"
                )
            })?;
            (robot, map_transform.map_from_robot_map.inverse() * frame_from_base)
        } else {
            let of = match meaning(frame, self.robot_count) {
                Some((of, FleetFrame::Map)) if of.number() <= self.robot_count => of,
                _ => {
                    return Err(format!(
                        "a pose in '{frame}': expected '{MAP}', or a robot's map such as map_1"
                    ));
                }
            };
            if let Some(robot) = robot.filter(|robot| *robot != of) {
                return Err(format!("a pose in '{frame}' is not {robot}'s"));
            }
            (of, frame_from_base)
        };
        self.ask(
            robot,
            SlamRequest {
                kind: SlamRequestKind::SetPose as u32,
                pose,
                sigma_m,
                sigma_rad,
                ..Default::default()
            },
        );
        Ok(())
    }
}

/// Standard deviations of position (the larger axis) and heading.
fn sigmas(covariance: &[f64; 36]) -> Result<(f64, f64), String> {
    let variance = |place: usize| {
        let value = covariance[place];
        let sound = value.is_finite() && value >= 0.0;
        sound.then_some(value).ok_or_else(|| format!("a variance of {value} (covariance[{place}])"))
    };
    Ok((variance(X_X)?.max(variance(Y_Y)?).sqrt(), variance(YAW_YAW)?.sqrt()))
}
