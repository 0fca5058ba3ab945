//! Navigator that drives the robots of a fleet to goals that people or programs set.
//!
//! Plans are made on the map, in its frame, about once a second and robot. They are followed in `odom`, so that a
//! correction of the map changes the next plan but never makes a robot jump. The newest scan limits the speed.

mod config;
mod cooperative;
mod goal;
mod goal_map;
mod input;
mod progress;
mod robot;
mod standstill;
mod state;
#[cfg(test)]
mod tests;

pub use config::{NavigatorConfig, UnknownSpace};
pub use goal::{GOAL_POSES_MAX, GoalError, GoalFrame, GoalPose, NavigationGoal};
pub(crate) use goal_map::START_SNAP_MAX_M;
pub use input::{LocalizationUncertainty, NavigatedRobot, NavigationInput};
pub use state::{NavigationFailure, NavigationState};

use crate::command::Twist;
use crate::path::Path;
use cooperative::{CooperativeSearch, Reservation, TimedRoute};
use core::cmp::Reverse;
use input::RobotPoses;
use msg::{ExclusionZone, ROBOTS_MAX, RobotId, Stamp};
use robot::{OtherRobot, RobotNavigator};

/// Time between two plans of all ways, seconds: robots that turn or brake are soon behind their plans.
const COORDINATION_PERIOD_S: f64 = 0.5;
/// Time after which a robot that cannot get out of the others' way gets priority, seconds: a turn and a step aside.
const PROMOTION_PERIOD_S: f64 = 5.0;

/// What the navigator has decided for one robot.
#[derive(Clone, Copy, Debug)]
pub struct RobotNavigation<'a> {
    /// The robot that the decision is about.
    pub robot: RobotId,
    /// Velocity to drive until the next step; `None` if the navigator does not drive the robot.
    pub twist: Option<Twist>,
    /// What the navigator does with it.
    pub state: NavigationState,
    /// Planned path in the frame of the robot's map; empty without one.
    pub plan: &'a Path,
    /// Number of plans so far, modulo 2^32: it changes with `plan`.
    pub plan_number: u32,
    /// Cost of the rest of the way to the next pose, metres of driving in open space; when it is reached, the distance to the goal.
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
/// let robots = [NavigatedRobot { observation, odom_from_base: Some(pose), map_from_robot_map: None, uncertainty: None }];
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
    search: CooperativeSearch,
    coordinated_at: Option<Stamp>,
    trapped_since: Option<Stamp>,
    /// The zones that the robots' routes keep out of.
    zones: Vec<ExclusionZone>,
}

impl FleetNavigator {
    /// A navigator of robots without goals.
    pub fn new(config: NavigatorConfig) -> Self {
        Self {
            config,
            robots: Vec::new(),
            twists: [None; ROBOTS_MAX],
            search: CooperativeSearch::default(),
            coordinated_at: None,
            trapped_since: None,
            zones: Vec::new(),
        }
    }

    /// Gives a robot a goal in place of its present one.
    pub fn set_goal(&mut self, now: Stamp, robot: RobotId, goal: NavigationGoal) {
        self.of_or_new(robot).set_goal(now, goal);
    }

    /// Gives a robot a goal whose first poses are behind it: it drives to the one with this index next, or to the last.
    pub fn set_goal_from(&mut self, now: Stamp, robot: RobotId, goal: NavigationGoal, next_pose: usize) {
        self.of_or_new(robot).set_goal(now, goal);
        self.of(robot).for_each(|navigator| navigator.skip_to(next_pose));
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

    /// Has a robot that does not know where it is look for its place, in place of a goal: it turns and drives by its LiDAR alone for
    /// two minutes at most. The search ends when its pose is known; and at once if there are exclusion zones, because it
    /// cannot keep out of them.
    pub fn find_place(&mut self, now: Stamp, robot: RobotId) {
        self.of_or_new(robot).find_place(now);
    }

    /// Ends a search for a robot's place, if there is one.
    pub fn end_place_search(&mut self, robot: RobotId) {
        self.of(robot).for_each(|navigator| navigator.end_place_search(NavigationState::Idle));
    }

    /// The goal that a robot drives to or that is paused.
    pub fn goal(&self, robot: RobotId) -> Option<&NavigationGoal> {
        self.robots.iter().find(|navigator| navigator.robot == robot)?.goal()
    }

    fn of_or_new(&mut self, robot: RobotId) -> &mut RobotNavigator {
        let known = self.robots.iter().position(|navigator| navigator.robot == robot);
        let index = known.unwrap_or_else(|| {
            self.robots.push(RobotNavigator::new(robot, self.config));
            self.robots.len() - 1
        });
        &mut self.robots[index]
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
        if !input.exclusion_zones.is_empty() {
            let failure = NavigationState::Failed(NavigationFailure::NoPose);
            self.robots.iter_mut().for_each(|navigator| navigator.end_place_search(failure));
        }
        let others: Vec<Vec<OtherRobot>> = (0..self.robots.len()).map(|i| self.others(i, input)).collect();
        for (navigator, others) in self.robots.iter_mut().zip(&others) {
            if let Some(robot) = find(input, navigator.robot).filter(|_| navigator.state().is_active()) {
                navigator.observe(now, robot, others);
            }
        }
        self.replace_zones(input.exclusion_zones);
        self.search_one(input);
        let lacks_path = |navigator: &RobotNavigator| {
            navigator.state().is_active() && navigator.has_routes() && !navigator.has_path()
        };
        let is_due = self.coordinated_at.is_none_or(|at| now - at >= COORDINATION_PERIOD_S);
        if self.is_active() && (is_due || self.robots.iter().any(lacks_path)) {
            self.coordinate(input);
        }
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

    /// Takes the zones that hold now. If they have changed, routes may lead through a new one: robots stand until others are found.
    fn replace_zones(&mut self, zones: &[ExclusionZone]) {
        if self.zones != zones {
            self.zones.clear();
            self.zones.extend_from_slice(zones);
            self.robots.iter_mut().for_each(RobotNavigator::forget_routes);
        }
    }

    /// Searches the routes of the robot whose turn it is: one robot a step bounds the time of a step.
    fn search_one(&mut self, input: &NavigationInput) {
        let now = input.stamp;
        let due = self.robots.iter().enumerate().filter_map(|(i, navigator)| {
            let poses = find(input, navigator.robot)?.poses()?;
            let is_due = navigator.state().is_active() && navigator.is_search_due(now, poses);
            is_due.then_some((navigator.searched_at(), i))
        });
        let Some((_, i)) = due.min_by_key(|(at, i)| (*at, *i)) else { return };
        let Some(robot) = find(input, self.robots[i].robot) else { return };
        let standing: Vec<(RobotId, [f64; 2])> = self.standing_robots(robot, input);
        self.robots[i].search(now, robot, input.exclusion_zones, &standing);
    }

    /// Plans the ways of all robots that have routes, one after another in the order of their priority.
    fn coordinate(&mut self, input: &NavigationInput) {
        self.coordinated_at = Some(input.stamp);
        let mut order: Vec<usize> = (0..self.robots.len()).collect();
        order.sort_by_key(|i| (Reverse(self.robots[*i].standstill.promoted), self.robots[*i].robot));
        let mut reservations = Vec::new();
        // Robots that cannot drive stand in everybody's way; so they come first.
        for navigator in self.robots.iter().filter(|navigator| navigator.state().is_active()) {
            let robot = find(input, navigator.robot);
            let can_drive = robot.is_some_and(|robot| robot.can_drive(input.stamp));
            let stands = !can_drive || !navigator.has_routes() || navigator.is_recovering();
            let at_m = robot.and_then(NavigatedRobot::position_m);
            if let Some(at_m) = at_m.filter(|_| stands) {
                reservations.push(Reservation { robot: navigator.robot, positions_m: vec![at_m] });
            }
        }
        let mut trapped = None;
        for i in order {
            let navigator = &mut self.robots[i];
            let Some(robot) = find(input, navigator.robot) else { continue };
            let has_way = navigator.has_routes() && !navigator.is_recovering();
            let drives = navigator.state().is_active() && has_way && robot.can_drive(input.stamp);
            let Some(poses) = robot.poses().filter(|_| drives) else { continue };
            let in_merged_map = robot.observation.in_merged_map;
            let reserved: &[Reservation] = if in_merged_map { &reservations } else { &[] };
            let (at, intended_m) = (poses.map_from_base, navigator.intended_m(poses));
            let (search, separation_m) = (&mut self.search, self.config.separation_m);
            let route = search.search(navigator.goal_map(), at, intended_m, separation_m, reserved);
            let Some(route) = route else { continue };
            if !route.is_clear {
                trapped.get_or_insert(i);
            }
            if in_merged_map {
                reservations.push(reservation(navigator, &route));
            }
            follow_route(navigator, poses, &route);
        }
        self.promote_trapped(input.stamp, trapped);
        self.promote_waiting(input.stamp);
    }

    /// Puts a robot that cannot get out of the others' way for some time before them: they have to get out of its way.
    fn promote_trapped(&mut self, now: Stamp, trapped: Option<usize>) {
        let Some(i) = trapped else {
            self.trapped_since = None;
            return;
        };
        let since = *self.trapped_since.get_or_insert(now);
        if now - since >= PROMOTION_PERIOD_S {
            self.promote(i);
            self.trapped_since = None;
        }
    }

    /// Of two robots that wait for each other, puts the one whose plan waits before the one whose plan leads on: that one has stood for
    /// some time, because they are too near each other, and the plan of the first takes it to be gone soon.
    fn promote_waiting(&mut self, now: Stamp) {
        for i in 0..self.robots.len() {
            let Some(other) = self.robots[i].standstill.stopped_by(now, PROMOTION_PERIOD_S) else { continue };
            let robot = self.robots[i].robot;
            let waiting = self.robots.iter().position(|it| it.robot == other && it.waits_for(robot));
            if let Some(waiting) = waiting {
                self.promote(waiting);
                self.robots[i].standstill.forget_stop();
            }
        }
    }

    fn promote(&mut self, i: usize) {
        let highest = self.robots.iter().map(|navigator| navigator.standstill.promoted).max().unwrap_or(0);
        self.robots[i].standstill.promote(highest.saturating_add(1));
    }

    /// The robots that stand or that a person drives, by their poses in the map of one robot.
    fn standing_robots(&self, robot: &NavigatedRobot, input: &NavigationInput) -> Vec<(RobotId, [f64; 2])> {
        let id = robot.observation.robot;
        let is_active = |other: RobotId| {
            self.robots.iter().any(|navigator| navigator.robot == other && navigator.state().is_active())
        };
        let others = input.robots.iter().filter(|other| shares_map(robot, other));
        let others = others.map(|other| (other.observation.robot, other.position_m()));
        others
            .filter(|(other, _)| *other != id && !is_active(*other))
            .filter_map(|(other, at_m)| Some((other, at_m?)))
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
            let at_m = other.position_m()?;
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

/// The way of a robot through the window of time.
fn reservation(navigator: &RobotNavigator, route: &TimedRoute) -> Reservation {
    let map = navigator.goal_map().map();
    let positions_m = route.cells.iter().map(|cell| map.cell_centre_m(*cell)).collect();
    Reservation { robot: navigator.robot, positions_m }
}

/// Follows a route up to where the robot waits for another one, or to the goal.
fn follow_route(navigator: &mut RobotNavigator, poses: RobotPoses, route: &TimedRoute) {
    let (stretch, waits) = route.first_stretch(navigator.goal_map());
    let mut cells = route.cells.clone();
    cells.dedup();
    let mut path = Path::default();
    path.waypoints.extend(cells.iter().map(|cell| navigator.goal_map().waypoint(*cell)));
    let mut stretch_cells = route.cells[..stretch].to_vec();
    stretch_cells.dedup();
    let last = cells[cells.len() - 1];
    path.waypoints.pop();
    navigator.goal_map_mut().append_route(last, &mut path);
    let followed = if waits { stretch_cells.len() } else { path.waypoints.len() };
    navigator.set_path(poses, path, followed, route.given_way_to.filter(|_| waits));
}
