//! Navigator that drives the robots of a fleet to goals that people or programs set.
//!
//! Plans are made on the map, in its frame, about once a second and robot. They are followed in `odom`, so that a
//! correction of the map changes the next plan but never makes a robot jump. The newest scan limits the speed.

mod config;
mod goal;
mod goal_map;
mod input;
mod obstacles;
mod progress;
mod robot;
mod state;
#[cfg(test)]
mod tests;

pub use config::{NavigatorConfig, UnknownSpace};
pub use goal::{ExclusionZone, GOAL_POSES_MAX, GoalError, GoalFrame, GoalPose, NavigationGoal};
pub use input::{NavigatedRobot, NavigationInput};
pub use state::{NavigationFailure, NavigationState};

use crate::command::Twist;
use crate::path::Path;
use input::RobotPoses;
use msg::{ROBOTS_MAX, RobotId, Stamp};
use robot::{OtherRobot, RobotNavigator};

/// What the navigator has decided for one robot.
#[derive(Clone, Copy, Debug)]
pub struct RobotNavigation<'a> {
    /// The robot.
    pub robot: RobotId,
    /// Velocity to drive until the next step; `None` if the navigator does not drive the robot.
    pub twist: Option<Twist>,
    /// What the navigator does with it.
    pub state: NavigationState,
    /// Planned path in the frame of the robot's map; empty without one.
    pub plan: &'a Path,
    /// Number of plans so far, modulo 2^32: it changes with `plan`.
    pub plan_number: u32,
    /// Cost of the rest of the way to the next pose, metres of driving in open space.
    pub remaining_m: Option<f64>,
    /// Index of the pose that is driven to.
    pub next_pose: Option<usize>,
}

/// Navigation of a fleet.
///
/// ```
/// use msg::{Pose2, RobotId, Stamp};
/// use nav::observation::BURGER_BASE_FROM_SCAN;
/// use nav::{
///     FleetNavigator, GoalFrame, MapView, NavigatedRobot, NavigationGoal, NavigationInput, NavigationState,
///     NavigatorConfig, RobotObservation, ScanView,
/// };
///
/// let robot = RobotId::new(1).unwrap();
/// let mut navigator = FleetNavigator::new(NavigatorConfig::default());
/// let goal = NavigationGoal::position(GoalFrame::MergedMap, [1.5, 1.0]).unwrap();
/// navigator.set_goal(Stamp(0), robot, goal);
///
/// let free_space = vec![0; 40 * 40];
/// let pose = Pose2::new(0.5, 1.0, 0.0);
/// let scan = ScanView {
///     received: Stamp(0),
///     base_from_scan: BURGER_BASE_FROM_SCAN,
///     angle_min_rad: 0.0,
///     angle_increment_rad: 0.01,
///     range_min_m: 0.12,
///     range_max_m: 3.5,
///     ranges_m: &[3.5],
/// };
/// let observation = RobotObservation {
///     robot,
///     map: MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &free_space),
///     in_merged_map: true,
///     map_from_base: Some(pose),
///     scan: Some(scan),
/// };
/// let robots = [NavigatedRobot { observation, odom_from_base: Some(pose), map_from_robot_map: None }];
/// navigator.step(&NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] });
///
/// let navigation = navigator.robots().next().unwrap();
/// assert_eq!(navigation.state, NavigationState::Driving);
/// assert!(navigation.twist.unwrap().linear_m_s > 0.1);
/// ```
#[derive(Clone, Debug)]
pub struct FleetNavigator {
    config: NavigatorConfig,
    /// Robots that have or had a goal, in the order of their first one.
    robots: Vec<RobotNavigator>,
    twists: [Option<Twist>; ROBOTS_MAX],
}

impl FleetNavigator {
    /// A navigator of robots without goals.
    pub fn new(config: NavigatorConfig) -> Self {
        Self { config, robots: Vec::new(), twists: [None; ROBOTS_MAX] }
    }

    /// Gives a robot a goal in place of its present one.
    pub fn set_goal(&mut self, now: Stamp, robot: RobotId, goal: NavigationGoal) {
        let known = self.robots.iter_mut().find(|navigator| navigator.robot == robot);
        match known {
            Some(navigator) => navigator.set_goal(now, goal),
            None => {
                let mut navigator = RobotNavigator::new(robot, self.config);
                navigator.set_goal(now, goal);
                self.robots.push(navigator);
            }
        }
    }

    /// Cancels a robot's goal; the next step stops the robot.
    pub fn cancel(&mut self, robot: RobotId) {
        self.of(robot).for_each(|navigator| navigator.end(NavigationState::Cancelled));
    }

    /// Stops driving a robot, because a person drives it or has stopped it; its goal stays.
    pub fn pause(&mut self, robot: RobotId) {
        self.of(robot).for_each(RobotNavigator::pause);
    }

    /// Drives a paused robot on to its goal.
    pub fn resume(&mut self, now: Stamp, robot: RobotId) {
        self.of(robot).for_each(|navigator| navigator.resume(now));
    }

    /// The goal that a robot drives to or that is paused.
    pub fn goal(&self, robot: RobotId) -> Option<&NavigationGoal> {
        self.robots.iter().find(|navigator| navigator.robot == robot)?.goal()
    }

    fn of(&mut self, robot: RobotId) -> impl Iterator<Item = &mut RobotNavigator> {
        self.robots.iter_mut().filter(move |navigator| navigator.robot == robot)
    }

    /// Whether some robot has a goal to drive to now. If not, a step does nothing.
    pub fn is_active(&self) -> bool {
        self.robots.iter().any(|navigator| navigator.state().is_active())
    }

    /// What was decided for each robot that has or had a goal.
    pub fn robots(&self) -> impl Iterator<Item = RobotNavigation<'_>> {
        self.robots.iter().map(|navigator| {
            let (plan, plan_number) = navigator.plan();
            RobotNavigation {
                robot: navigator.robot,
                twist: self.twists[navigator.robot.index()],
                state: navigator.state(),
                plan,
                plan_number,
                remaining_m: navigator.remaining_m(),
                next_pose: navigator.next_pose(),
            }
        })
    }

    /// One control step: observes the fleet, plans for one robot at most, and computes all velocities.
    pub fn step(&mut self, input: &NavigationInput) {
        let now = input.stamp;
        let others: Vec<Vec<OtherRobot>> = (0..self.robots.len()).map(|i| self.others(i, input)).collect();
        for (navigator, others) in self.robots.iter_mut().zip(&others) {
            if let Some(robot) = find(input, navigator.robot).filter(|_| navigator.state().is_active()) {
                navigator.observe(now, robot, others);
            }
        }
        self.search_one(input);
        for (navigator, others) in self.robots.iter_mut().zip(&others) {
            let unknown;
            let robot = match find(input, navigator.robot) {
                Some(robot) => robot,
                None => {
                    unknown = NavigatedRobot::unknown(navigator.robot);
                    &unknown
                }
            };
            self.twists[navigator.robot.index()] = navigator.control(now, robot, others);
        }
    }

    /// Searches the routes of the robot whose turn it is: one robot a step bounds the time of a step.
    fn search_one(&mut self, input: &NavigationInput) {
        let now = input.stamp;
        let due = self.robots.iter().enumerate().filter_map(|(i, navigator)| {
            let poses = find(input, navigator.robot)?.poses()?;
            let is_due = navigator.state().is_active() && navigator.is_search_due(now, poses);
            is_due.then_some((navigator.searched_at(), i, poses))
        });
        let Some((_, i, poses)) = due.min_by_key(|(at, i, _)| (*at, *i)) else { return };
        let Some(robot) = find(input, self.robots[i].robot) else { return };
        let standing: Vec<(RobotId, [f64; 2])> = self.standing_robots(robot, input);
        let navigator = &mut self.robots[i];
        navigator.search(now, robot, input.exclusion_zones, &standing);
        if navigator.has_routes() {
            set_whole_path(navigator, poses);
        }
    }

    /// The robots that stand or that a person drives, by their poses in the map of one robot.
    fn standing_robots(&self, robot: &NavigatedRobot, input: &NavigationInput) -> Vec<(RobotId, [f64; 2])> {
        let id = robot.observation.robot;
        let is_active = |other: RobotId| {
            self.robots.iter().any(|navigator| navigator.robot == other && navigator.state().is_active())
        };
        let others = input.robots.iter().filter(|other| shares_map(robot, other));
        let others = others.map(|other| (other.observation.robot, other.poses()));
        others
            .filter(|(other, _)| *other != id && !is_active(*other))
            .filter_map(|(other, poses)| Some((other, poses?.position_m())))
            .collect()
    }

    /// The other robots of known pose, as seen by one.
    fn others(&self, index: usize, input: &NavigationInput) -> Vec<OtherRobot> {
        let robot = self.robots[index].robot;
        let Some((observed, poses)) =
            find(input, robot).and_then(|observed| Some((observed, observed.poses()?)))
        else {
            return Vec::new();
        };
        let base_from_map = poses.map_from_base.inverse();
        let other = |other: &NavigatedRobot| {
            let other_robot = other.observation.robot;
            let at_m = other.poses()?.position_m();
            let navigator = self.robots.iter().find(|navigator| navigator.robot == other_robot);
            let is_active = navigator.is_some_and(|navigator| navigator.state().is_active());
            Some(OtherRobot { robot: other_robot, in_base_m: base_from_map.apply(at_m), is_active })
        };
        let others = input.robots.iter().filter(|other| other.observation.robot != robot);
        others.filter(|other| shares_map(observed, other)).filter_map(other).collect()
    }
}

/// Whether two robots' poses are in the same frame.
fn shares_map(a: &NavigatedRobot, b: &NavigatedRobot) -> bool {
    a.observation.in_merged_map && b.observation.in_merged_map
}

fn find<'a, 'b>(input: &'a NavigationInput<'b>, robot: RobotId) -> Option<&'a NavigatedRobot<'b>> {
    input.robots.iter().find(|observed| observed.observation.robot == robot)
}

/// Follows the cheapest route to the goal.
fn set_whole_path(navigator: &mut RobotNavigator, poses: RobotPoses) {
    let mut path = Path::default();
    let goal_map = navigator.goal_map_mut();
    let Some(start) = goal_map.start_cell(poses.position_m()) else { return };
    goal_map.append_route(start, &mut path);
    let length = path.waypoints.len();
    navigator.set_path(poses, path, length, None);
}
