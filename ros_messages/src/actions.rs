//! Messages of ROS 2's actions (action_msgs), and Nav2's NavigateToPose and FollowWaypoints (nav2_msgs, Jazzy).
//!
//! An action is three services and two topics below `NAME/_action/`: send_goal, cancel_goal and get_result, feedback
//! and status. Each message begins with the goal's identifier, which the client chooses.

use crate::cdr::{DecodeError, Reader, Writer};
use crate::message::Message;
use crate::navigation::{POSE_STAMPED_BYTES_MIN, PoseStamped};
use crate::{read, write};
use msg::Stamp;
use std::time::Duration;

/// unique_identifier_msgs/UUID: identifier of a goal, chosen by its client.
pub type GoalId = [u8; 16];

/// The identifier that means no goal, or any.
pub const NO_GOAL: GoalId = [0; 16];

/// action_msgs/GoalStatus: what has become of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum GoalStatus {
    /// The server does not know the goal, or no longer.
    Unknown = 0,
    /// It is accepted, and not being pursued yet.
    Accepted = 1,
    /// It is being pursued.
    Executing = 2,
    /// A client has cancelled it, and the server has not stopped yet.
    Canceling = 3,
    /// It was reached.
    Succeeded = 4,
    /// It was given up because a client wished so.
    Canceled = 5,
    /// It was given up by the server.
    Aborted = 6,
}

impl GoalStatus {
    /// Returns whether the goal is over.
    pub fn is_final(self) -> bool {
        matches!(self, Self::Succeeded | Self::Canceled | Self::Aborted)
    }
}

/// action_msgs/GoalInfo: a goal and when it was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GoalInfo {
    /// Identifier of the goal.
    pub id: GoalId,
    /// Time at which it was accepted.
    pub stamp: Stamp,
}

/// Answer to action_msgs/CancelGoal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum CancelCode {
    /// What fits the request is being cancelled; that may be nothing.
    Accepted = 0,
    /// No goal has the identifier.
    UnknownGoal = 2,
    /// The goal is over already.
    GoalTerminated = 3,
}

/// Reads the identifier of a goal.
pub fn read_goal_id(from: &mut Reader<'_>) -> Result<GoalId, DecodeError> {
    let mut id = NO_GOAL;
    for byte in &mut id {
        *byte = from.u8("goal_id")?;
    }
    Ok(id)
}

/// Writes the identifier of a goal.
pub fn write_goal_id(to: &mut Writer<'_>, id: &GoalId) {
    id.iter().for_each(|byte| to.u8(*byte));
}

impl GoalInfo {
    /// Reads a goal info, which is the request of CancelGoal too.
    pub fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { id: read_goal_id(from)?, stamp: read::stamp(from, "goal_info.stamp")? })
    }

    /// Writes a goal info.
    pub fn write(&self, to: &mut Writer<'_>) {
        write_goal_id(to, &self.id);
        write::stamp(to, self.stamp);
    }
}

/// Writes action_msgs/GoalStatusArray: the state of each goal.
pub fn write_status_array<'a>(
    to: &mut Writer<'_>,
    goals: impl ExactSizeIterator<Item = (&'a GoalInfo, GoalStatus)>,
) {
    to.count(goals.len());
    for (info, status) in goals {
        info.write(to);
        to.u8(status as u8);
    }
}

/// Writes the response of CancelGoal.
pub fn write_cancel_response(to: &mut Writer<'_>, code: CancelCode, canceling: &[GoalInfo]) {
    to.u8(code as u8);
    to.count(canceling.len());
    canceling.iter().for_each(|info| info.write(to));
}

/// Writes the response of any action's send_goal.
pub fn write_goal_response(to: &mut Writer<'_>, accepted: bool, stamp: Stamp) {
    to.bool(accepted);
    write::stamp(to, stamp);
}

/// The goal of nav2_msgs/NavigateToPose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NavigateToPoseGoal {
    /// The pose to drive to.
    pub pose: PoseStamped,
    /// File of a behaviour tree; empty for the server's own.
    pub behavior_tree: String,
}

impl NavigateToPoseGoal {
    /// Reads the goal.
    pub fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { pose: PoseStamped::read(from)?, behavior_tree: from.string("behavior_tree")?.to_owned() })
    }
}

/// The goal of nav2_msgs/FollowWaypoints.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FollowWaypointsGoal {
    /// How often the waypoints are driven again.
    pub number_of_loops: u32,
    /// Index of the first waypoint that is driven to.
    pub goal_index: u32,
    /// The waypoints in the order of driving.
    pub poses: Vec<PoseStamped>,
}

impl FollowWaypointsGoal {
    /// Reads the goal.
    pub fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (number_of_loops, goal_index) = (from.u32("number_of_loops")?, from.u32("goal_index")?);
        let count = from.count("poses", POSE_STAMPED_BYTES_MIN)?;
        let poses = (0..count).map(|_| PoseStamped::read(from)).collect::<Result<_, _>>()?;
        Ok(Self { number_of_loops, goal_index, poses })
    }
}

/// nav2_msgs/MissedWaypoint: a waypoint that was not reached.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedWaypoint {
    /// Index of the waypoint in the goal.
    pub index: u32,
    /// The waypoint as the client gave it.
    pub goal: PoseStamped,
    /// Nav2's code of the reason.
    pub error_code: u16,
    /// The reason, for a person.
    pub error_msg: String,
}

impl MissedWaypoint {
    /// Writes the waypoint.
    pub fn write(&self, to: &mut Writer<'_>) {
        to.u32(self.index);
        self.goal.write(to);
        to.u16(self.error_code);
        to.string(&self.error_msg);
    }
}

/// Feedback of nav2_msgs/NavigateToPose.
#[derive(Clone, Debug, PartialEq)]
pub struct NavigateToPoseFeedback<'a> {
    /// Time of the pose.
    pub stamp: Stamp,
    /// Frame of the pose.
    pub frame_id: &'a str,
    /// Where the robot is.
    pub pose: msg::Pose2,
    /// Time since the goal was accepted.
    pub navigation_time: Duration,
    /// Expected time to the goal; zero while it is not known, as in Nav2.
    pub time_remaining: Duration,
    /// How often the robot has backed up or turned to get free.
    pub recoveries: i16,
    /// Distance to the goal, metres.
    pub distance_remaining_m: f32,
}

impl NavigateToPoseFeedback<'_> {
    /// Writes the feedback.
    pub fn write(&self, to: &mut Writer<'_>) {
        let (position, orientation) = write::spatial(self.pose);
        write::header(to, self.stamp, self.frame_id);
        write::pose(to, position, orientation);
        write_duration(to, self.navigation_time);
        write_duration(to, self.time_remaining);
        to.i16(self.recoveries);
        to.f32(self.distance_remaining_m);
    }
}

/// Writes builtin_interfaces/Duration: seconds and nanoseconds.
fn write_duration(to: &mut Writer<'_>, duration: Duration) {
    to.i32(i32::try_from(duration.as_secs()).unwrap_or(i32::MAX));
    to.u32(duration.subsec_nanos());
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bytes(fill: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
        let mut bytes = Vec::new();
        fill(&mut Writer::new(&mut bytes));
        bytes
    }

    #[test]
    fn goals_are_read_as_clients_write_them() {
        let pose =
            PoseStamped { frame_id: "map".into(), position: [1.0, 2.0, 0.0], ..PoseStamped::default() };
        let sent = bytes(|to| {
            write_goal_id(to, &[7; 16]);
            pose.write(to);
            to.string("");
        });
        let from = &mut Reader::new(&sent).unwrap();
        assert_eq!(read_goal_id(from), Ok([7; 16]));
        let goal = NavigateToPoseGoal { pose: pose.clone(), behavior_tree: String::new() };
        assert_eq!(NavigateToPoseGoal::read(from), Ok(goal));

        let sent = bytes(|to| {
            to.u32(0);
            to.u32(1);
            to.count(2);
            pose.write(to);
            pose.write(to);
        });
        let goal = FollowWaypointsGoal { goal_index: 1, poses: vec![pose.clone(), pose], number_of_loops: 0 };
        assert_eq!(FollowWaypointsGoal::read(&mut Reader::new(&sent).unwrap()), Ok(goal));
        for end in 4..sent.len() {
            assert!(FollowWaypointsGoal::read(&mut Reader::new(&sent[..end]).unwrap()).is_err(), "{end}");
        }
    }

    #[test]
    fn numbers_of_two_bytes_are_aligned_to_two() {
        let sent = bytes(|to| {
            to.u8(1);
            to.u16(0x0302);
            to.u8(4);
            to.i16(-2);
        });
        assert_eq!(sent[4..], [1, 0, 2, 3, 4, 0, 0xfe, 0xff]);
    }

    #[test]
    fn a_status_array_has_one_byte_of_status_after_each_goal() {
        let info = GoalInfo { id: [9; 16], stamp: Stamp(2_000_000_003) };
        let sent = bytes(|to| {
            write_status_array(
                to,
                [(&info, GoalStatus::Executing), (&info, GoalStatus::Aborted)].into_iter(),
            );
        });
        // Count, identifier, seconds, nanoseconds and status; padding before the next goal's seconds.
        assert_eq!(sent[4..8], [2, 0, 0, 0]);
        assert_eq!((sent[24], sent[28], sent[32]), (2, 3, GoalStatus::Executing as u8));
        assert_eq!(GoalInfo::read(&mut Reader::new(&[&sent[..4], &sent[8..32]].concat()).unwrap()), Ok(info));
        assert_eq!(sent.last(), Some(&(GoalStatus::Aborted as u8)));
    }
}
