//! Messages of navigation: goals, their state, and planned paths.

use crate::{CommandSource, Header, RobotId, bounded_text};
use bytemuck::{Pod, Zeroable};

/// Most poses of one goal: a path of waypoints is sent as one.
pub const GOAL_POSES_MAX: usize = 64;
/// Most points of one planned path: 51 m at 0.1 m.
pub const PLAN_POINTS_MAX: usize = 512;

/// What a command of navigation asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum NavigationAction {
    /// Drive to the poses, one after another.
    Goal = 1,
    /// Give the goal up and stop.
    Cancel = 2,
    /// Stop and keep the goal: a person drives the robot or has stopped it.
    Pause = 3,
    /// Drive on to the goal that is kept.
    Resume = 4,
}

/// Why a robot's goal is paused, or a robot on another machine does not follow the base.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u32)]
pub enum PauseReason {
    /// A person drives the robot or has stopped it.
    #[default]
    Person = 0,
    /// On a robot's machine: the base drives the robot.
    Base = 1,
    /// At the base: the emergency stop of the robot's own machine is set.
    StoppedAtRobot = 2,
    /// At the base: a person drives the robot at its own machine.
    DrivenAtRobot = 3,
    /// At the base: the robot was stopped or driven by hand at its own machine, and is not any more.
    InterruptedAtRobot = 4,
    /// At the base: velocities reach the robot too late for it to follow them.
    LateVelocities = 5,
    /// The emergency stop of this machine was set.
    EmergencyStop = 6,
    /// At the base: the robot obeys another base.
    AnotherBase = 7,
}

impl PauseReason {
    /// Decodes a reason; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        use PauseReason::{
            AnotherBase, Base, DrivenAtRobot, EmergencyStop, InterruptedAtRobot, LateVelocities, Person,
            StoppedAtRobot,
        };
        let machine = [Person, Base, EmergencyStop];
        let robot = [StoppedAtRobot, DrivenAtRobot, InterruptedAtRobot, LateVelocities, AnotherBase];
        machine.into_iter().chain(robot).find(|reason| *reason as u32 == code)
    }

    /// Returns the sentence that people read, within 128 bytes.
    pub fn text(self) -> &'static str {
        match self {
            Self::Person => "a person drives or has stopped the robot; resume, or send a new goal",
            Self::EmergencyStop => {
                "the emergency stop was set; when it is released, resume, or send a new goal"
            }
            Self::Base => "the base drives the robot; resume, or send a new goal",
            Self::StoppedAtRobot => {
                "the robot is stopped at its own machine or by another base; `mr-slam release` there, then resume or send a goal"
            }
            Self::AnotherBase => {
                "the robot obeys another base until that one has been silent for 3 s; end the other base, then resume"
            }
            Self::DrivenAtRobot => {
                "a person drives the robot at its own machine; resume afterwards, or send a new goal"
            }
            Self::InterruptedAtRobot => {
                "the robot was stopped or driven by hand at its own machine; resume, or send a new goal"
            }
            Self::LateVelocities => {
                "the link is too slow: velocities reach the robot more than 0.5 s late; resume when it is faster"
            }
        }
    }
}

/// Frame that the poses of a goal are in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum NavigationFrame {
    /// The merged map.
    MergedMap = 0,
    /// A robot's own map.
    RobotMap = 1,
    /// The frame of a robot's odometry.
    Odom = 2,
    /// A robot's `base_footprint` at the time of the command.
    Base = 3,
}

/// Pose of a goal.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct NavigationPose {
    /// Position along x, metres.
    pub x_m: f64,
    /// Position along y, metres.
    pub y_m: f64,
    /// Heading, radians; not a number if any heading will do.
    pub yaw_rad: f64,
}

/// Command to the navigator about one robot.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct NavigationCommand {
    /// Header whose `stamp` is the time of the command.
    pub header: Header,
    /// Number of the command: its time on the machine's clock, nanoseconds. A later command has a larger one.
    pub number: u64,
    /// Number of the goal that is cancelled; 0: whichever the robot has. Other actions have 0.
    pub cancelled: u64,
    /// Code of a [`NavigationAction`].
    pub action: u32,
    /// Code of a [`NavigationFrame`].
    pub frame: u32,
    /// Number of the robot whose frame is meant, from 1; 0 for the merged map.
    pub frame_robot: u32,
    /// Number of `poses` in use. Read them by [`NavigationCommand::poses`].
    pub len: u32,
    /// Code of a [`PauseReason`], if the action is to pause.
    pub pause_reason: u32,
    /// Padding, always zero.
    pub reserved: u32,
    /// Who sent it.
    pub sender: CommandSource,
    /// Storage of the poses. Read it by [`NavigationCommand::poses`].
    pub poses: [NavigationPose; GOAL_POSES_MAX],
}

impl Default for NavigationCommand {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl NavigationCommand {
    /// A command without poses.
    pub fn new(number: u64, action: NavigationAction) -> Self {
        Self { number, action: action as u32, ..Self::default() }
    }

    /// A cancellation of the goal with a number, and of no goal that has taken its place.
    pub fn cancel(number: u64, goal: u64) -> Self {
        Self { cancelled: goal, ..Self::new(number, NavigationAction::Cancel) }
    }

    /// A pause with its reason.
    pub fn pause(number: u64, reason: PauseReason) -> Self {
        Self { pause_reason: reason as u32, ..Self::new(number, NavigationAction::Pause) }
    }

    /// A goal; poses beyond the [`GOAL_POSES_MAX`]th are left out.
    pub fn goal(
        number: u64,
        (frame, robot): (NavigationFrame, Option<RobotId>),
        poses: &[NavigationPose],
    ) -> Self {
        let mut goal = Self::new(number, NavigationAction::Goal);
        (goal.frame, goal.frame_robot) = (frame as u32, robot.map_or(0, |robot| robot.number() as u32));
        let len = poses.len().min(GOAL_POSES_MAX);
        goal.len = len as u32;
        goal.poses[..len].copy_from_slice(&poses[..len]);
        goal
    }

    /// Decodes the action; `None` for an unknown code.
    pub fn action(&self) -> Option<NavigationAction> {
        use NavigationAction::{Cancel, Goal, Pause, Resume};
        [Goal, Cancel, Pause, Resume].into_iter().find(|action| *action as u32 == self.action)
    }

    /// Decodes the frame; `None` for an unknown code.
    pub fn frame(&self) -> Option<NavigationFrame> {
        use NavigationFrame::{Base, MergedMap, Odom, RobotMap};
        [MergedMap, RobotMap, Odom, Base].into_iter().find(|frame| *frame as u32 == self.frame)
    }

    /// Returns the robot whose frame is meant.
    pub fn frame_robot(&self) -> Option<RobotId> {
        RobotId::new(self.frame_robot as usize)
    }

    /// Returns the poses in use.
    pub fn poses(&self) -> &[NavigationPose] {
        &self.poses[..(self.len as usize).min(GOAL_POSES_MAX)]
    }
}

/// What the navigator does with a robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum NavigationStatus {
    /// The robot has no goal.
    Idle = 0,
    /// It looks for a path.
    Planning = 1,
    /// It drives along its path.
    Driving = 2,
    /// It lets another robot pass.
    Waiting = 3,
    /// It cannot drive on at the moment, and keeps trying.
    Blocked = 4,
    /// It backs up or turns to get free, or looks for its place; the reason says which.
    Recovering = 5,
    /// A person drives the robot or has stopped it; the goal is kept.
    Paused = 6,
    /// It has arrived.
    Reached = 7,
    /// The goal was cancelled.
    Cancelled = 8,
    /// It has given up.
    Failed = 9,
}

impl NavigationStatus {
    /// All states in the order of their codes.
    pub const ALL: [Self; 10] = [
        Self::Idle,
        Self::Planning,
        Self::Driving,
        Self::Waiting,
        Self::Blocked,
        Self::Recovering,
        Self::Paused,
        Self::Reached,
        Self::Cancelled,
        Self::Failed,
    ];

    /// Returns the state's name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Idle => "idle",
            Self::Planning => "planning",
            Self::Driving => "driving",
            Self::Waiting => "waiting",
            Self::Blocked => "blocked",
            Self::Recovering => "recovering",
            Self::Paused => "paused",
            Self::Reached => "reached",
            Self::Cancelled => "cancelled",
            Self::Failed => "failed",
        }
    }

    /// Returns whether the goal is over.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Reached | Self::Cancelled | Self::Failed)
    }
}

/// Longest reason in a [`NavigationReport`] or an [`crate::ExplorationReport`], bytes.
pub const REASON_BYTES_MAX: usize = 128;

/// State of a robot's navigation.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct NavigationReport {
    /// Header whose `stamp` is the time of the state.
    pub header: Header,
    /// Number of the goal's command; 0 without a goal.
    pub number: u64,
    /// Cost of the rest of the way to the next pose, metres of driving in open space; of a goal that is reached, the robot's distance
    /// to it; not a number if it is not known.
    pub remaining_m: f64,
    /// Code of a [`NavigationStatus`]. Read it by [`NavigationReport::status`].
    pub status: u32,
    /// Number of the robot that is waited for, from 1; 0 without one.
    pub other_robot: u32,
    /// Index of the pose that is driven to.
    pub next_pose: u32,
    /// Number of bytes of `reason` in use. Read them by [`NavigationReport::reason`].
    pub reason_len: u32,
    /// Why the robot stands or the goal failed, in UTF-8. Read it by [`NavigationReport::reason`].
    pub reason: [u8; REASON_BYTES_MAX],
}

impl Default for NavigationReport {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl NavigationReport {
    /// Decodes the state; an unknown code reads as [`NavigationStatus::Idle`].
    pub fn status(&self) -> NavigationStatus {
        let code = |status: &NavigationStatus| *status as u32 == self.status;
        NavigationStatus::ALL.into_iter().find(code).unwrap_or(NavigationStatus::Idle)
    }

    /// Returns the reason; empty if it is not UTF-8.
    pub fn reason(&self) -> &str {
        bounded_text::read(&self.reason, self.reason_len)
    }

    /// Sets the reason, cut to 128 bytes at the end of a character.
    pub fn set_reason(&mut self, reason: &str) {
        self.reason_len = bounded_text::write(reason, &mut self.reason);
    }
}

/// Whether a robot on another machine follows the base, as its machine says. Only the base has it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct RobotHold {
    /// Header whose `stamp` is not used.
    pub header: Header,
    /// Changes with each stop and each drive by hand at the robot's machine, which end a drive to a goal. 0: not known yet.
    pub interruptions: u64,
    /// Code of a [`PauseReason`]; 0: nothing is known to hold the robot.
    pub reason: u32,
    /// Padding, always zero.
    pub reserved: u32,
}

impl RobotHold {
    /// Returns why the robot does not follow the base; `None` if nothing is known to hold it.
    pub fn reason(&self) -> Option<PauseReason> {
        PauseReason::from_code(self.reason).filter(|reason| *reason != PauseReason::Person)
    }
}

/// Planned path of a robot (nav_msgs/Path).
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct NavigationPlan {
    /// Header whose `stamp` is the time of the plan.
    pub header: Header,
    /// 1 if the points are in the merged map, 0 if in the robot's own.
    pub in_merged_map: u32,
    /// Number of `points_m` in use. Read them by [`NavigationPlan::points_m`].
    pub len: u32,
    /// Storage of the points. Read it by [`NavigationPlan::points_m`].
    pub points_m: [[f32; 2]; PLAN_POINTS_MAX],
}

impl Default for NavigationPlan {
    fn default() -> Self {
        Self::zeroed()
    }
}

impl NavigationPlan {
    /// Returns the points in use, from the robot to the goal.
    pub fn points_m(&self) -> &[[f32; 2]] {
        &self.points_m[..(self.len as usize).min(PLAN_POINTS_MAX)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damaged_messages_are_read_within_their_bounds() {
        let mut command = NavigationCommand { len: u32::MAX, action: 99, frame: 99, ..Default::default() };
        assert_eq!((command.poses().len(), command.action(), command.frame()), (GOAL_POSES_MAX, None, None));
        command.action = 2;
        assert_eq!(command.action(), Some(NavigationAction::Cancel));
        let mut report = NavigationReport { reason_len: u32::MAX, status: 99, ..Default::default() };
        assert_eq!((report.reason().len(), report.status()), (REASON_BYTES_MAX, NavigationStatus::Idle));
        report.set_reason(&"ä".repeat(100));
        assert_eq!(report.reason(), "ä".repeat(64));
        assert_eq!(NavigationPlan { len: u32::MAX, ..Default::default() }.points_m().len(), PLAN_POINTS_MAX);
    }
}
