//! Nav2's actions of each robot: their names, and the goals of clients with what has become of them.
//!
//! It follows Nav2's SimpleActionServer: a robot has one goal at most, and a new one ends the one before as aborted.
//! What has become of a goal is told by the navigator's reports alone.

mod goal;
mod server;

pub use goal::{ActionGoal, GoalEnd};
pub use server::{ActionKind, ActionServer, ActionService};

use crate::relay::RosRequestId;
use msg::{Monotonic, NavigationReport, NavigationStatus, Pose2, RobotId, Stamp};
use ros_messages::RobotNames;
use std::collections::BTreeMap;
use std::time::Duration;

/// The navigator gets this time to take up or to cancel a goal: its own loop runs at 20 Hz, and a restart takes 2 s.
const CONFIRMATION_MAX: Duration = Duration::from_secs(5);
/// A goal ends if the navigator, which reports once a second, has been silent for this time: the supervisor has given
/// up restarting it by then.
const SILENCE_MAX: Duration = Duration::from_secs(30);

/// Where a robot is in its own map, by SLAM's newest answer.
#[derive(Clone, Copy, Debug)]
pub struct RobotPose {
    /// Time of the pose.
    pub stamp: Stamp,
    /// Pose of the body in the robot's map.
    pub map_from_base: Pose2,
}

/// The action servers of a fleet.
#[derive(Debug)]
pub struct ActionServers {
    servers: Vec<ActionServer>,
    /// Services by name: index of the server, and which of its services it is.
    by_name: BTreeMap<String, (usize, ActionService)>,
    /// By robot; `None` while the robot does not know where it is.
    poses: Vec<Option<RobotPose>>,
}

impl ActionServers {
    /// Creates the servers of all robots, without goals.
    pub fn new(robots: &RobotNames) -> Self {
        let of_robot = |robot| ActionKind::ALL.map(|kind| ActionServer::new(robots, robot, kind));
        let servers: Vec<ActionServer> = robots.robots().flat_map(of_robot).collect();
        let services = |(index, server): (usize, &ActionServer)| {
            ActionService::ALL.map(|service| (server.service_name(service), (index, service)))
        };
        let by_name = servers.iter().enumerate().flat_map(services).collect();
        Self { servers, by_name, poses: vec![None; robots.count()] }
    }

    /// Returns all servers.
    pub fn servers(&self) -> &[ActionServer] {
        &self.servers
    }

    /// Returns a server by its index.
    pub fn server_mut(&mut self, index: usize) -> &mut ActionServer {
        &mut self.servers[index]
    }

    /// Finds a service by its name with leading slash: the index of its server, and which of its services it is.
    pub fn find(&self, service: &str) -> Option<(usize, ActionService)> {
        self.by_name.get(service).copied()
    }

    /// Returns whether a topic or service is one of an action.
    pub fn owns(&self, name: &str) -> bool {
        let is_of = |server: &ActionServer| name.strip_prefix(server.name()).is_some_and(is_below_action);
        self.servers.iter().any(is_of)
    }

    /// Records where a robot is; `None` if that is not known.
    pub fn record_pose(&mut self, robot: RobotId, pose: Option<RobotPose>) {
        if let Some(known) = self.poses.get_mut(robot.index()) {
            *known = pose;
        }
    }

    /// Returns where a robot is.
    pub fn pose(&self, robot: RobotId) -> Option<RobotPose> {
        self.poses.get(robot.index()).copied().flatten()
    }

    fn of(&mut self, robot: RobotId) -> impl Iterator<Item = &mut ActionServer> {
        self.servers.iter_mut().filter(move |server| server.robot() == robot)
    }

    /// Ends a robot's goal because the command of another one follows.
    pub fn replace(&mut self, robot: RobotId, number: u64, now: Monotonic) {
        self.of(robot).for_each(|server| server.replace(number, now));
    }

    /// Applies a report of the navigator to the robot's goal.
    pub fn apply_report(&mut self, robot: RobotId, report: &NavigationReport, now: Monotonic) {
        for server in self.of(robot) {
            let Some(goal) = server.active_mut() else { continue };
            if report.number > goal.number() {
                goal.end(GoalEnd::Replaced, now);
            } else if report.number == goal.number() {
                goal.apply_report(report, now);
            } else {
                continue;
            }
            server.status_changed();
        }
    }

    /// Ends goals that the navigator does not answer for, and forgets results that nobody asked for in time.
    ///
    /// Returns the goals that the navigator must cancel, by robot and number: nobody may drive on to a goal that counts as given up.
    pub fn tick(&mut self, now: Monotonic) -> Vec<(RobotId, u64)> {
        let mut abandoned = Vec::new();
        for server in &mut self.servers {
            if server.is_idle() {
                continue;
            }
            let robot = server.robot();
            let silent = server.active_mut().and_then(|goal| goal.end_if_silent(now).then(|| goal.number()));
            if let Some(number) = silent {
                server.status_changed();
                abandoned.push((robot, number));
            }
            server.forget_results(now);
        }
        abandoned
    }

    /// Takes the requests for results that can be answered: server, request, and the goal's place in it.
    pub fn take_answerable(&mut self) -> Vec<(usize, usize, RosRequestId)> {
        let mut due = Vec::new();
        for (index, server) in self.servers.iter_mut().enumerate() {
            for (place, goal) in server.goals_mut().iter_mut().enumerate() {
                if goal.status().is_final() {
                    due.extend(goal.take_waiting().map(|request| (index, place, request)));
                }
            }
        }
        due
    }
}

/// Returns whether the rest of a name behind an action's is that of one of its topics or services.
fn is_below_action(rest: &str) -> bool {
    rest.starts_with("/_action/")
}

/// Returns whether the navigator must report now and then in this state.
fn reports_regularly(status: NavigationStatus) -> bool {
    use NavigationStatus::{Blocked, Driving, Paused, Planning, Recovering, Waiting};
    matches!(status, Planning | Driving | Waiting | Blocked | Recovering | Paused)
}

#[cfg(test)]
mod tests;
