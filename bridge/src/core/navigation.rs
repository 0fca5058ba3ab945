//! Goals of people and programs for the navigator, and the navigator's velocities on their way to the gate.

use super::Core;
use super::input::InputError;
use crate::access::Action;
use crate::drive::velocity_gate::{GateDecision, Velocity};
use crate::input::{InputPurpose, SHARED_GOAL};
use crate::router::{ClientId, Topic, TopicId};
use crate::world::{TransformError, floor_pose};
use msg::{
    ExclusionZone, ExplorationAction, ExplorationCommand, ExplorationReport, GOAL_POSES_MAX, Monotonic,
    NavigationAction, NavigationCommand, NavigationFrame, NavigationPose, NavigationReport, NavigationStatus,
    PauseReason, RobotFrame, RobotId, VelocityCommand, ZoneCommand, ZoneError,
};
use ros_messages::names::{FleetFrame, MAP};
use ros_messages::read::Transform;
use ros_messages::{Bool, Empty, Int32, Message, PathMessage, PolygonStamped, PoseStamped};
use thiserror::Error;

/// Why a goal is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GoalError {
    /// A pose is not one on the floor.
    #[error(transparent)]
    Pose(#[from] TransformError),
    /// The frame is not one of the fleet's.
    #[error("a goal in '{frame}': expected '{MAP}', or a frame of a robot such as {examples}")]
    Frame {
        /// The message's frame.
        frame: String,
        /// Frames of the first robot.
        examples: String,
    },
    /// A path without poses.
    #[error("a path without poses; to cancel, publish on the robot's cancel_navigation")]
    Empty,
    /// A path with too many poses.
    #[error("{count} poses; expected at most {GOAL_POSES_MAX}")]
    TooManyPoses {
        /// Number of poses in the message.
        count: usize,
    },
    /// Poses in more than one frame.
    #[error("poses in '{first}' and in '{other}'; expected one frame")]
    MixedFrames {
        /// The first frame.
        first: String,
        /// A different one.
        other: String,
    },
}

/// Why a message about exclusion zones is refused.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ExclusionError {
    /// The polygon is not one of the merged map.
    #[error("a zone in '{frame}'; expected '{MAP}', the merged map")]
    Frame {
        /// The message's frame.
        frame: String,
    },
    /// The corners make no zone.
    #[error(transparent)]
    Corners(#[from] ZoneError),
    /// No zone can have the number.
    #[error("no zone has the number {number}; expected that of a zone, or 0 for all")]
    Number {
        /// The number in the message.
        number: i32,
    },
    /// Too many commands about zones wait.
    #[error("too many commands about zones wait; send this one again")]
    TooMany,
}

impl Core {
    /// Applies a message to the navigator.
    pub(super) fn apply_navigation_input(
        &mut self,
        input: InputPurpose,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), InputError> {
        let (robot, action) = match input {
            InputPurpose::Goal(robot) => {
                let pose = self.decode(payload)?;
                return self.accept_goal(robot, &pose, now).map(drop);
            }
            InputPurpose::Waypoints(robot) => {
                let path = self.decode(payload)?;
                return self.accept_waypoints(robot, &path, now).map(drop);
            }
            InputPurpose::Explore => {
                let Bool(starts) = self.decode(payload)?;
                return self.command_exploration(starts, now);
            }
            InputPurpose::AddZone => {
                let polygon = self.decode(payload)?;
                return self.add_zone(&polygon, now);
            }
            InputPurpose::RemoveZone => {
                let Int32(number) = self.decode(payload)?;
                return self.remove_zone(number, now);
            }
            InputPurpose::CancelNavigation(robot) => (robot, NavigationAction::Cancel),
            InputPurpose::ResumeNavigation(robot) => (robot, NavigationAction::Resume),
            _ => return Ok(()),
        };
        self.decode::<Empty>(payload)?;
        self.command_navigation_at(robot, action, now)
    }

    /// Sends the selected robot to a pose on `/goal_pose`. Other clients and ROS get the message too: it is Nav2's topic as well.
    pub(super) fn accept_shared_goal(
        &mut self,
        client: ClientId,
        topic: TopicId,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), InputError> {
        let is_goal = |topic: &Topic| topic.name == SHARED_GOAL && topic.message_type == PoseStamped::TYPE;
        if !self.router.topics.get(topic).is_some_and(is_goal) {
            return Ok(());
        }
        match self.check(Action::Drive, client) {
            // A client that may not publish in ROS has been told so.
            Err(_) if self.relay.has_endpoint() => return Ok(()),
            checked => checked?,
        }
        self.apply_navigation_input(InputPurpose::Goal(None), payload, now)
    }

    /// Sends a robot to a pose; without a robot, the selected one. Returns the number of the command.
    pub(super) fn accept_goal(
        &mut self,
        robot: Option<RobotId>,
        pose: &PoseStamped,
        now: Monotonic,
    ) -> Result<u64, InputError> {
        self.accept_poses(robot, &pose.frame_id, core::slice::from_ref(pose), now)
    }

    /// Sends a robot along waypoints. Returns the number of the command.
    pub(super) fn accept_waypoints(
        &mut self,
        robot: RobotId,
        path: &PathMessage,
        now: Monotonic,
    ) -> Result<u64, InputError> {
        let count = path.poses.len();
        let Some(first) = path.poses.first() else { return Err(GoalError::Empty.into()) };
        if count > GOAL_POSES_MAX {
            return Err(GoalError::TooManyPoses { count }.into());
        }
        // A pose without a frame is in the path's.
        let frame_of = |pose: &PoseStamped| match pose.frame_id.as_str() {
            "" => path.frame_id.clone(),
            frame => frame.to_owned(),
        };
        let first = frame_of(first);
        if let Some(other) = path.poses.iter().map(frame_of).find(|frame| *frame != first) {
            return Err(GoalError::MixedFrames { first, other }.into());
        }
        self.accept_poses(Some(robot), &first, &path.poses, now)
    }

    fn accept_poses(
        &mut self,
        robot: Option<RobotId>,
        frame: &str,
        poses: &[PoseStamped],
        now: Monotonic,
    ) -> Result<u64, InputError> {
        if self.gate.drive().is_stopped() {
            return Err(InputError::EmergencyStop);
        }
        self.commands.record_time(now);
        let robot = robot.unwrap_or(self.gate.drive().selected());
        let poses =
            poses.iter().map(navigation_pose).collect::<Result<Vec<_>, _>>().map_err(GoalError::from)?;
        let frame = self.navigation_frame(frame)?;
        let number = self.commands.next_navigation_number();
        self.commands.push_navigation(robot, NavigationCommand::goal(number, frame, &poses));
        self.gate.drive_mut().expect_navigation(robot, number);
        self.offered.actions.replace(robot, number, now);
        Ok(number)
    }

    fn navigation_frame(&self, frame: &str) -> Result<(NavigationFrame, Option<RobotId>), GoalError> {
        if frame.strip_prefix('/').unwrap_or(frame) == MAP {
            return Ok((NavigationFrame::MergedMap, None));
        }
        let robot_count = self.fleet.robot_count();
        let of = self.fleet.robot_names().parse_frame(frame).filter(|(of, _)| of.number() <= robot_count);
        let frame_of = |(robot, part)| match part {
            FleetFrame::Map => Some((NavigationFrame::RobotMap, Some(robot))),
            FleetFrame::Robot(RobotFrame::Odom) => Some((NavigationFrame::Odom, Some(robot))),
            FleetFrame::Robot(RobotFrame::BaseFootprint | RobotFrame::BaseLink) => {
                Some((NavigationFrame::Base, Some(robot)))
            }
            FleetFrame::Robot(_) => None,
        };
        of.and_then(frame_of).ok_or_else(|| {
            let frames = self.fleet.frame_names();
            let of = |robot| {
                let of_robot = |part| frames.robot_frame(robot, part);
                let (odom, base) = (of_robot(RobotFrame::Odom), of_robot(RobotFrame::BaseLink));
                format!("{}, {odom} or {base}", frames.map(robot))
            };
            let examples = self.fleet.robots().next().map_or_else(String::new, of);
            GoalError::Frame { frame: frame.to_owned(), examples }
        })
    }

    /// Tells the navigator to cancel a robot's goal, to pause or to go on.
    pub(super) fn command_navigation(&mut self, robot: RobotId, action: NavigationAction) {
        let number = self.commands.next_navigation_number();
        self.commands.push_navigation(robot, NavigationCommand::new(number, action));
    }

    /// Tells the navigator to cancel the goal with a number; one that has taken its place stays.
    pub(super) fn cancel_navigation(&mut self, robot: RobotId, goal: u64) {
        let number = self.commands.next_navigation_number();
        self.commands.push_navigation(robot, NavigationCommand::cancel(number, goal));
    }

    /// Handles a person's wish to cancel a robot's goal, or to drive on to it.
    fn command_navigation_at(
        &mut self,
        robot: RobotId,
        action: NavigationAction,
        now: Monotonic,
    ) -> Result<(), InputError> {
        if action == NavigationAction::Resume && self.gate.drive().is_stopped() {
            return Err(InputError::EmergencyStop);
        }
        self.commands.record_time(now);
        self.command_navigation(robot, action);
        if action == NavigationAction::Resume {
            // Reports name the goal, not the resumption: it counts as unanswered until a newer goal is.
            let number = self.commands.newest_time().0;
            self.gate.drive_mut().expect_navigation(robot, number);
        }
        Ok(())
    }

    /// Handles a velocity of the navigator: it passes the gate as all others, and gives way to every person.
    pub fn receive_navigation_velocity(&mut self, robot: RobotId, command: &VelocityCommand, now: Monotonic) {
        let velocity = Velocity { linear_m_s: command.linear_m_s, angular_rad_s: command.angular_rad_s };
        let decision = self.gate.request_navigation(robot, velocity, now);
        self.send_velocities();
        // The navigator's last zero after a pause is refused too, and needs no other pause.
        let reason = match decision {
            GateDecision::Stopped => PauseReason::EmergencyStop,
            GateDecision::DrivenBy(_) => PauseReason::Person,
            GateDecision::DrivenByBase => PauseReason::Base,
            _ => return,
        };
        if velocity != Velocity::ZERO {
            self.gate.drive_mut().set_navigated(robot, true);
            self.commands.record_time(now);
            self.pause_navigation_because([robot], reason);
        }
    }

    /// Handles a velocity of the base on another machine: it passes the gate as all others, gives way to every person here,
    /// and pauses the robot's own navigation.
    pub fn receive_base_velocity(&mut self, robot: RobotId, command: &VelocityCommand, now: Monotonic) {
        let velocity = Velocity { linear_m_s: command.linear_m_s, angular_rad_s: command.angular_rad_s };
        let decision = self.gate.request_base(robot, velocity, now);
        self.send_velocities();
        if matches!(decision, GateDecision::Passed(passed) if passed != Velocity::ZERO) {
            self.commands.record_time(now);
            self.pause_navigation_because([robot], PauseReason::Base);
        }
    }

    /// Records whether the navigator drives a robot. One that has something to do while the emergency stop is set is paused: it
    /// must not set off when the stop is released.
    pub fn record_navigation(&mut self, robot: RobotId, report: &NavigationReport) {
        let status = report.status();
        let is_active =
            !status.is_final() && !matches!(status, NavigationStatus::Idle | NavigationStatus::Paused);
        self.gate.drive_mut().set_navigated(robot, is_active);
        self.gate.drive_mut().confirm_navigation(robot, report.number);
        if self.gate.drive().is_stopped() {
            self.pause_navigation_because([robot], PauseReason::EmergencyStop);
        }
    }

    /// Records which robots explore: a person takes them out by driving them, between two goals too.
    pub fn record_exploration(&mut self, report: &ExplorationReport) {
        self.commands.confirm_exploration(report.number, report.status().is_final());
        let robots: Vec<RobotId> = self.fleet.robots().collect();
        for robot in robots {
            let is_exploring = !report.status().is_final() && report.robot(robot.index()).may_drive();
            self.gate.drive_mut().set_exploring(robot, is_exploring);
            self.gate.drive_mut().confirm_navigation(robot, report.number);
            if self.gate.drive().is_stopped() {
                self.pause_navigation_because([robot], PauseReason::EmergencyStop);
            }
        }
    }

    /// Adds an exclusion zone of the merged map.
    fn add_zone(&mut self, polygon: &PolygonStamped, now: Monotonic) -> Result<(), InputError> {
        let frame = polygon.frame_id.as_str();
        if frame.strip_prefix('/').unwrap_or(frame) != MAP {
            return Err(ExclusionError::Frame { frame: frame.to_owned() }.into());
        }
        let corners_m: Vec<[f64; 2]> =
            polygon.corners.iter().map(|[x, y, _]| [f64::from(*x), f64::from(*y)]).collect();
        let zone = ExclusionZone::new(&corners_m).map_err(ExclusionError::from)?;
        self.command_zones(|number| ZoneCommand::add(number, zone), now)
    }

    /// Removes the exclusion zone with a number; 0 removes all.
    fn remove_zone(&mut self, zone: i32, now: Monotonic) -> Result<(), InputError> {
        let zone = u32::try_from(zone).map_err(|_| ExclusionError::Number { number: zone })?;
        match zone {
            0 => self.command_zones(ZoneCommand::clear, now),
            _ => self.command_zones(|number| ZoneCommand::remove(number, zone), now),
        }
    }

    fn command_zones(
        &mut self,
        command: impl Fn(u64) -> ZoneCommand,
        now: Monotonic,
    ) -> Result<(), InputError> {
        self.commands.record_time(now);
        let number = self.commands.next_navigation_number();
        if self.commands.push_zone(command(number)) { Ok(()) } else { Err(ExclusionError::TooMany.into()) }
    }

    /// Starts the fleet's exploration, or stops it.
    fn command_exploration(&mut self, starts: bool, now: Monotonic) -> Result<(), InputError> {
        if starts && self.gate.drive().is_stopped() {
            return Err(InputError::EmergencyStop);
        }
        self.commands.record_time(now);
        let number = self.commands.next_navigation_number();
        let action = if starts { ExplorationAction::Start } else { ExplorationAction::Stop };
        self.commands.set_exploration(ExplorationCommand::new(number, action));
        if starts {
            let robots: Vec<RobotId> = self.fleet.robots().collect();
            robots.into_iter().for_each(|robot| self.gate.drive_mut().expect_navigation(robot, number));
        }
        Ok(())
    }
}

fn navigation_pose(pose: &PoseStamped) -> Result<NavigationPose, TransformError> {
    let at = floor_pose(&Transform {
        stamp: pose.stamp,
        frame_id: pose.frame_id.as_str(),
        child_frame_id: "",
        translation: pose.position,
        rotation: pose.orientation,
    })?;
    Ok(NavigationPose { x_m: at.x_m, y_m: at.y_m, yaw_rad: at.yaw_rad })
}
