//! One action of one robot: its names, its goals, and which of them a cancellation means.

use super::goal::{ActionGoal, GoalEnd};
use msg::{Monotonic, RobotId};
use ros_messages::RobotNames;
use ros_messages::actions::{CancelCode, GoalId, GoalInfo, NO_GOAL};
use std::collections::VecDeque;
use std::time::Duration;

/// Goals of one action that are known, the present one among them; of more the oldest is forgotten.
const GOALS_MAX: usize = 16;
/// A result can be asked for this long after the goal's end. rcl_action keeps it for 10 s; clients on a bad link ask late.
const RESULT_KEPT: Duration = Duration::from_secs(60);

/// An action of Nav2.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionKind {
    /// nav2_msgs/action/NavigateToPose: drives to a pose.
    NavigateToPose,
    /// nav2_msgs/action/FollowWaypoints: drives to poses one after another.
    FollowWaypoints,
}

impl ActionKind {
    /// All actions of a robot.
    pub const ALL: [Self; 2] = [Self::NavigateToPose, Self::FollowWaypoints];

    /// Returns the action's name under `/robotN/`.
    fn name(self) -> &'static str {
        match self {
            Self::NavigateToPose => "navigate_to_pose",
            Self::FollowWaypoints => "follow_waypoints",
        }
    }

    /// Returns the action's type as `package/action/Type`.
    fn action_type(self) -> &'static str {
        match self {
            Self::NavigateToPose => "nav2_msgs/action/NavigateToPose",
            Self::FollowWaypoints => "nav2_msgs/action/FollowWaypoints",
        }
    }
}

/// A service of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ActionService {
    /// Offers a goal.
    SendGoal,
    /// Cancels one goal or several.
    CancelGoal,
    /// Waits for a goal's end and returns its result.
    GetResult,
}

impl ActionService {
    /// All services of an action.
    pub const ALL: [Self; 3] = [Self::SendGoal, Self::CancelGoal, Self::GetResult];
}

/// One action of one robot.
#[derive(Debug)]
pub struct ActionServer {
    robot: RobotId,
    kind: ActionKind,
    name: String,
    /// Newest last; all but the last are over.
    goals: VecDeque<ActionGoal>,
    is_status_due: bool,
    is_offered: bool,
}

impl ActionServer {
    /// Creates a server without goals, whose empty status is due.
    pub fn new(robots: &RobotNames, robot: RobotId, kind: ActionKind) -> Self {
        let name = robots.topic(robot, kind.name());
        Self { robot, kind, name, goals: VecDeque::new(), is_status_due: true, is_offered: false }
    }

    /// Returns the robot that drives.
    pub fn robot(&self) -> RobotId {
        self.robot
    }

    /// Returns which action it is.
    pub fn kind(&self) -> ActionKind {
        self.kind
    }

    /// Returns the action's name with leading slash.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the name of one of the action's services.
    pub fn service_name(&self, service: ActionService) -> String {
        let rest = match service {
            ActionService::SendGoal => "send_goal",
            ActionService::CancelGoal => "cancel_goal",
            ActionService::GetResult => "get_result",
        };
        format!("{}/_action/{rest}", self.name)
    }

    /// Returns the type of one of the action's services, as `package/Type` or `package/action/Type`.
    pub fn service_type(&self, service: ActionService) -> String {
        let action_type = self.kind.action_type();
        match service {
            ActionService::SendGoal => format!("{action_type}_SendGoal"),
            ActionService::CancelGoal => "action_msgs/CancelGoal".into(),
            ActionService::GetResult => format!("{action_type}_GetResult"),
        }
    }

    /// Returns name and type of the topic of feedback.
    pub fn feedback_topic(&self) -> (String, String) {
        (format!("{}/_action/feedback", self.name), format!("{}_FeedbackMessage", self.kind.action_type()))
    }

    /// Returns name and type of the topic of status, which is latched.
    pub fn status_topic(&self) -> (String, String) {
        (format!("{}/_action/status", self.name), "action_msgs/GoalStatusArray".into())
    }

    /// Returns whether the action is offered to ROS.
    pub fn is_offered(&self) -> bool {
        self.is_offered
    }

    /// Records whether the action is offered to ROS; its status is then due.
    pub fn set_offered(&mut self, is_offered: bool) {
        (self.is_offered, self.is_status_due) = (is_offered, is_offered);
    }

    /// Returns the goals that are known, newest last.
    pub fn goals(&self) -> &VecDeque<ActionGoal> {
        &self.goals
    }

    pub(super) fn goals_mut(&mut self) -> &mut VecDeque<ActionGoal> {
        &mut self.goals
    }

    /// Returns whether no goal is known.
    pub fn is_idle(&self) -> bool {
        self.goals.is_empty()
    }

    /// Finds a goal.
    pub fn find_mut(&mut self, id: &GoalId) -> Option<&mut ActionGoal> {
        self.goals.iter_mut().find(|goal| goal.info.id == *id)
    }

    /// Returns the goal that is not over.
    pub fn active_mut(&mut self) -> Option<&mut ActionGoal> {
        self.goals.back_mut().filter(|goal| !goal.status().is_final())
    }

    /// Returns the goal that is not over.
    pub fn active(&self) -> Option<&ActionGoal> {
        self.goals.back().filter(|goal| !goal.status().is_final())
    }

    /// Adds a goal that is accepted now. The one before must be over.
    pub fn add(&mut self, goal: ActionGoal) {
        if self.goals.len() >= GOALS_MAX {
            self.goals.pop_front();
        }
        self.goals.push_back(goal);
        self.is_status_due = true;
    }

    /// Ends the goal that is not over, because the command of another one follows.
    pub fn replace(&mut self, number: u64, now: Monotonic) {
        if let Some(goal) = self.active_mut().filter(|goal| goal.number() < number) {
            goal.end(GoalEnd::Replaced, now);
            self.is_status_due = true;
        }
    }

    /// Records that the status of a goal has changed.
    pub fn status_changed(&mut self) {
        self.is_status_due = true;
    }

    /// Returns whether the status must be published, and records that it is.
    pub fn take_status_due(&mut self) -> bool {
        std::mem::take(&mut self.is_status_due)
    }

    /// Forgets goals whose results nobody asked for in time.
    pub fn forget_results(&mut self, now: Monotonic) {
        let before = self.goals.len();
        self.goals.retain(|goal| !goal.has_ended_before(now, RESULT_KEPT));
        self.is_status_due |= self.goals.len() != before;
    }

    /// Begins to cancel what a request means, by action_msgs/CancelGoal: a goal by its identifier, all goals that were
    /// accepted until a time, or without either all.
    pub fn begin_cancel(&mut self, wanted: &GoalInfo, now: Monotonic) -> (CancelCode, Vec<GoalInfo>) {
        let (has_id, has_stamp) = (wanted.id != NO_GOAL, wanted.stamp.0 != 0);
        let known = self.goals.iter().find(|goal| goal.info.id == wanted.id);
        if has_id && !has_stamp {
            match known {
                None => return (CancelCode::UnknownGoal, Vec::new()),
                Some(goal) if goal.status().is_final() => return (CancelCode::GoalTerminated, Vec::new()),
                Some(_) => {}
            }
        }
        let is_meant = |goal: &ActionGoal| {
            let is_old = has_stamp && goal.info.stamp <= wanted.stamp;
            goal.info.id == wanted.id || is_old || (!has_id && !has_stamp)
        };
        let Some(goal) = self.active_mut().filter(|goal| is_meant(goal)) else {
            return (CancelCode::Accepted, Vec::new());
        };
        goal.begin_cancel(now);
        let canceling = vec![goal.info];
        self.is_status_due = true;
        (CancelCode::Accepted, canceling)
    }
}
