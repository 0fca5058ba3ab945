//! Nav2's actions for ROS 2 nodes: goals that are offered, cancelled and asked for, and what is published of them.

use super::Core;
use super::input::InputError;
use crate::actions::{ActionGoal, ActionKind, ActionServer, ActionService, GoalEnd, RobotPose};
use crate::relay::RosRequestId;
use msg::{Monotonic, NavigationReport, Pose2, PoseEstimate, RobotId, Stamp};
use ros_messages::actions::{
    FollowWaypointsGoal, GoalId, GoalInfo, GoalStatus, MissedWaypoint, NO_GOAL, NavigateToPoseFeedback,
    NavigateToPoseGoal, read_goal_id, write_cancel_response, write_goal_id, write_goal_response,
    write_status_array,
};
use ros_messages::cdr::{DecodeError, Reader, Writer};
use ros_messages::names::MAP;
use ros_messages::{PathMessage, PoseStamped};
use thiserror::Error;

/// Nav2's code of a NavigateToPose without an error.
const NO_ERROR: u16 = 0;
/// Nav2's code of a NavigateToPose that fails for a reason without a code (UNKNOWN).
const NAVIGATE_TO_POSE_ERROR: u16 = 9000;
/// Nav2's code of a FollowWaypoints that fails for a reason without a code (UNKNOWN).
const FOLLOW_WAYPOINTS_ERROR: u16 = 600;

/// Why a goal of an action is refused. A response of ROS 2 cannot carry the reason: refusals are counted.
#[derive(Debug, Error)]
enum ActionError {
    /// The payload is not the action's goal.
    #[error(transparent)]
    Payload(#[from] DecodeError),
    /// The goal has no identifier, or that of another one.
    #[error("a goal of this identifier is known, or it is zero; expected a new one")]
    GoalId,
    /// The goal names a behaviour tree.
    #[error("there are no behaviour trees; leave behavior_tree empty")]
    BehaviorTree,
    /// The waypoints are to be driven more than once.
    #[error("waypoints are driven once; expected number_of_loops 0")]
    Loops,
    /// The first waypoint does not exist.
    #[error("goal_index {first} of {count} waypoints")]
    FirstWaypoint {
        /// Index of the first waypoint to drive to.
        first: u32,
        /// Number of waypoints.
        count: usize,
    },
    /// The navigator's commands refuse it.
    #[error(transparent)]
    Input(#[from] InputError),
}

/// Encodes a message for ROS 2.
fn encoded(fill: impl FnOnce(&mut Writer<'_>)) -> Vec<u8> {
    let mut payload = Vec::new();
    fill(&mut Writer::new(&mut payload));
    payload
}

impl Core {
    /// Offers the actions to ROS, but for those that a ROS node offers: real robots may have a Nav2 of their own, and a
    /// goal must not be driven twice.
    ///
    /// Call it when the exchange begins, and when the ROS graph has changed.
    pub(super) fn update_actions(&mut self) {
        if !self.relay.has_endpoint() || !self.config.may_ros_drive() {
            return;
        }
        for index in 0..self.offered.actions.servers().len() {
            let server = &self.offered.actions.servers()[index];
            let service = server.service_name(ActionService::CancelGoal);
            let is_wanted = self.world.is_none() || !self.relay.graph().services.contains_key(&service);
            match (is_wanted, server.is_offered()) {
                (true, false) => self.offer_action(index),
                (false, true) => self.withdraw_action(index),
                _ => {}
            }
        }
        self.publish_action_states();
    }

    fn offer_action(&mut self, index: usize) {
        let server = self.offered.actions.server_mut(index);
        server.set_offered(true);
        for service in ActionService::ALL {
            let name = server.service_name(service);
            self.relay.offer_fleet_service(&name, &server.service_type(service));
        }
        let (name, message_type) = server.feedback_topic();
        self.relay.advertise_fleet_topic(&name, message_type, false);
        let (name, message_type) = server.status_topic();
        self.relay.advertise_fleet_topic(&name, message_type, true);
    }

    fn withdraw_action(&mut self, index: usize) {
        let now = self.commands.newest_time();
        let server = self.offered.actions.server_mut(index);
        let robot = server.robot();
        if let Some(goal) = server.active_mut() {
            goal.end(GoalEnd::Withdrawn, now);
            let number = goal.number();
            server.status_changed();
            self.cancel_navigation(robot, number);
            self.publish_action_states();
        }
        let server = self.offered.actions.server_mut(index);
        server.set_offered(false);
        for service in ActionService::ALL {
            self.relay.withdraw_fleet_service(&server.service_name(service));
        }
        self.relay.unadvertise_fleet_topic(&server.feedback_topic().0);
        self.relay.unadvertise_fleet_topic(&server.status_topic().0);
    }

    /// Handles a ROS 2 node's request to a service of an action.
    pub(super) fn receive_action_request(
        &mut self,
        server: usize,
        service: ActionService,
        request: RosRequestId,
        payload: &[u8],
        now: Monotonic,
    ) {
        let response = match service {
            ActionService::SendGoal => Some(self.offer_goal(server, payload, now)),
            ActionService::CancelGoal => self.cancel_goal(server, payload, now),
            ActionService::GetResult => self.ask_result(server, request, payload),
        };
        if let Some(response) = response {
            self.respond_action(server, service, request, &response);
        }
        self.publish_action_states();
    }

    fn respond_action(
        &mut self,
        server: usize,
        service: ActionService,
        request: RosRequestId,
        response: &[u8],
    ) {
        let name = self.offered.actions.servers()[server].service_name(service);
        self.relay.respond(&name, request, response);
    }

    /// Accepts or refuses a goal; returns the response.
    fn offer_goal(&mut self, server: usize, payload: &[u8], now: Monotonic) -> Vec<u8> {
        let stamp = self.fleet.now();
        let result = self.accept_action_goal(server, stamp, payload, now);
        self.router.counted.refused += u64::from(result.is_err());
        encoded(|to| write_goal_response(to, result.is_ok(), stamp))
    }

    fn accept_action_goal(
        &mut self,
        server: usize,
        stamp: Stamp,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), ActionError> {
        let from = &mut Reader::new(payload)?;
        let id = read_goal_id(from)?;
        let of = self.offered.actions.server_mut(server);
        if id == NO_GOAL || of.find_mut(&id).is_some() {
            return Err(ActionError::GoalId);
        }
        let (robot, kind) = (of.robot(), of.kind());
        let (number, poses, first_index) = match kind {
            ActionKind::NavigateToPose => {
                let goal = NavigateToPoseGoal::read(from)?;
                if !goal.behavior_tree.is_empty() {
                    return Err(ActionError::BehaviorTree);
                }
                (self.accept_goal(Some(robot), &goal.pose, now)?, vec![goal.pose], 0)
            }
            ActionKind::FollowWaypoints => {
                let (poses, first) = remaining_waypoints(FollowWaypointsGoal::read(from)?)?;
                let path = PathMessage { poses, ..PathMessage::default() };
                (self.accept_waypoints(robot, &path, now)?, path.poses, first)
            }
        };
        let goal = ActionGoal::new(GoalInfo { id, stamp }, number, poses, first_index, now);
        self.offered.actions.server_mut(server).add(goal);
        Ok(())
    }

    /// Begins to cancel what a request means; returns the response, or none to a broken request.
    fn cancel_goal(&mut self, server: usize, payload: &[u8], now: Monotonic) -> Option<Vec<u8>> {
        let wanted = Reader::new(payload).and_then(|mut from| GoalInfo::read(&mut from));
        let Ok(wanted) = wanted else {
            self.router.counted.refused += 1;
            return None;
        };
        let server = self.offered.actions.server_mut(server);
        let (code, canceling) = server.begin_cancel(&wanted, now);
        let number = server.active().filter(|_| !canceling.is_empty()).map(ActionGoal::number);
        let robot = server.robot();
        if let Some(number) = number {
            self.commands.record_time(now);
            self.cancel_navigation(robot, number);
        }
        Some(encoded(|to| write_cancel_response(to, code, &canceling)))
    }

    /// Returns the result of a goal that is over or unknown; the request for another one waits for its end.
    fn ask_result(&mut self, server: usize, request: RosRequestId, payload: &[u8]) -> Option<Vec<u8>> {
        let wanted: Result<GoalId, DecodeError> =
            Reader::new(payload).and_then(|mut from| read_goal_id(&mut from));
        let Ok(id) = wanted else {
            self.router.counted.refused += 1;
            return None;
        };
        let server = self.offered.actions.server_mut(server);
        let kind = server.kind();
        match server.find_mut(&id) {
            Some(goal) if goal.status().is_final() => Some(result_response(kind, Some(goal))),
            Some(goal) => {
                goal.wait(request);
                None
            }
            None => Some(result_response(kind, None)),
        }
    }

    /// Applies a report of the navigator to the goal that it is about, and publishes the feedback.
    pub(super) fn apply_goal_report(&mut self, robot: RobotId, report: &NavigationReport) {
        let now = self.commands.newest_time();
        self.offered.actions.apply_report(robot, report, now);
        self.publish_feedback(robot, now);
        self.publish_action_states();
    }

    /// Records where a robot is, for the feedback of its goals.
    pub(super) fn record_goal_pose(&mut self, robot: RobotId, pose_estimate: &PoseEstimate) {
        let pose =
            RobotPose { stamp: pose_estimate.header.stamp, map_from_base: pose_estimate.map_from_base };
        self.offered.actions.record_pose(robot, pose_estimate.is_located().then_some(pose));
    }

    /// Ends goals that the navigator does not answer for, and forgets old results.
    pub(super) fn tick_actions(&mut self, now: Monotonic) {
        for (robot, number) in self.offered.actions.tick(now) {
            self.cancel_navigation(robot, number);
        }
        self.publish_action_states();
    }

    fn publish_feedback(&mut self, robot: RobotId, now: Monotonic) {
        for server in
            self.offered.actions.servers().iter().filter(|of| of.robot() == robot && of.is_offered())
        {
            let Some(goal) = server.active() else { continue };
            let feedback = match server.kind() {
                ActionKind::NavigateToPose => self.pose_feedback(robot, goal, now),
                ActionKind::FollowWaypoints => Some(encoded(|to| {
                    write_goal_id(to, &goal.info.id);
                    to.u32(goal.current_index());
                })),
            };
            if let Some(feedback) = feedback {
                self.relay.publish_fleet_topic(&server.feedback_topic().0, feedback);
            }
        }
    }

    /// Encodes the feedback of a NavigateToPose; `None` while pose or distance are not known.
    fn pose_feedback(&self, robot: RobotId, goal: &ActionGoal, now: Monotonic) -> Option<Vec<u8>> {
        let (distance_m, at) = (goal.remaining_m()?, self.offered.actions.pose(robot)?);
        let transforms = self.fleet.map_transforms();
        let map_from_robot_map = transforms.and_then(|all| all.robots.get(robot.index())?.known_pose());
        let (frame_id, pose): (&str, Pose2) = match map_from_robot_map {
            Some(map_from_robot_map) => (MAP, map_from_robot_map * at.map_from_base),
            None => (self.fleet.frame_names().map(robot), at.map_from_base),
        };
        let feedback = NavigateToPoseFeedback {
            stamp: at.stamp,
            frame_id,
            pose,
            navigation_time: goal.age(now),
            time_remaining: goal.time_remaining(now),
            recoveries: i16::try_from(goal.recoveries()).unwrap_or(i16::MAX),
            distance_remaining_m: distance_m as f32,
        };
        Some(encoded(|to| {
            write_goal_id(to, &goal.info.id);
            feedback.write(to);
        }))
    }

    /// Publishes the status of goals that has changed, and answers the requests for results that are known.
    fn publish_action_states(&mut self) {
        if !self.relay.has_endpoint() {
            return;
        }
        for index in 0..self.offered.actions.servers().len() {
            let server = self.offered.actions.server_mut(index);
            if !server.is_offered() || !server.take_status_due() {
                continue;
            }
            let goals = server.goals().iter().map(|goal| (&goal.info, goal.status()));
            let status = encoded(|to| write_status_array(to, goals));
            let (name, _) = server.status_topic();
            self.relay.publish_fleet_topic(&name, status);
        }
        for (server, place, request) in self.offered.actions.take_answerable() {
            let of: &ActionServer = &self.offered.actions.servers()[server];
            let response = result_response(of.kind(), of.goals().get(place));
            self.respond_action(server, ActionService::GetResult, request, &response);
        }
    }
}

/// Returns the waypoints from the first one that is driven to, and its index.
fn remaining_waypoints(goal: FollowWaypointsGoal) -> Result<(Vec<PoseStamped>, u32), ActionError> {
    let FollowWaypointsGoal { number_of_loops, goal_index: first, mut poses } = goal;
    if number_of_loops > 0 {
        return Err(ActionError::Loops);
    }
    let count = poses.len();
    if first as usize >= count {
        return Err(ActionError::FirstWaypoint { first, count });
    }
    Ok((poses.split_off(first as usize), first))
}

/// Encodes the response of get_result. Without a goal its status is unknown.
fn result_response(kind: ActionKind, goal: Option<&ActionGoal>) -> Vec<u8> {
    let status = goal.map_or(GoalStatus::Unknown, ActionGoal::status);
    let end = goal.and_then(ActionGoal::end_reason);
    let message = end.map_or("", GoalEnd::message);
    let error = match kind {
        _ if status != GoalStatus::Aborted => NO_ERROR,
        ActionKind::NavigateToPose => NAVIGATE_TO_POSE_ERROR,
        ActionKind::FollowWaypoints => FOLLOW_WAYPOINTS_ERROR,
    };
    // As with Nav2's stop_on_failure, the waypoint that could not be reached ends the goal.
    let missed = goal.filter(|_| matches!(end, Some(GoalEnd::Failed(_)))).and_then(|goal| {
        let pose = goal.current_pose()?.clone();
        let (index, error_msg) = (goal.current_index(), message.to_owned());
        Some(MissedWaypoint { index, goal: pose, error_code: error, error_msg })
    });
    encoded(|to| {
        to.u8(status as u8);
        if kind == ActionKind::FollowWaypoints {
            to.count(usize::from(missed.is_some()));
            missed.iter().for_each(|missed| missed.write(to));
        }
        to.u16(error);
        to.string(message);
    })
}
