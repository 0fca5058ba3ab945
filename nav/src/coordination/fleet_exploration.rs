//! Exploration by a fleet that a navigator drives: the coordinator's goals become goals of navigation.
//!
//! The robots of the merged map share one coordinator. A robot whose map is not merged yet explores its own map.

mod conclusion;
mod known_places;

use super::excluded::is_in_zone;
use super::lost_robots::LostRobots;
use super::revisits::Revisits;
use super::sent_goal::SentGoal;
use super::types::{
    CoordinatedRobot, CoordinationInput, CoordinationPhase, ExplorationEnd, FoundLeftover, GoalProgress,
    GoalPurpose, RobotAvailability, RobotGoal, TimeEstimate,
};
use super::{CoordinationConfig, FleetCoordinator};
use crate::navigation::{FleetNavigator, GoalFrame, NavigatedRobot, NavigationInput, NavigationState};
use crate::observation::MapView;
use msg::{Pose2, ROBOTS_MAX, RobotId, Stamp};

/// Robots that share a map, with their coordinator.
#[derive(Clone, Debug)]
struct ExploredMap {
    /// The robot whose own map it is; `None`: the merged map.
    robot: Option<RobotId>,
    coordinator: FleetCoordinator,
    /// When a robot could be given goals last.
    able_at: Stamp,
    known_m2: f64,
    /// Whether persons have all its robots.
    is_manual: bool,
    /// Whether a robot is in it now: robots whose maps were merged may be separated again.
    is_in_use: bool,
}

impl ExploredMap {
    fn new(robot: Option<RobotId>, config: CoordinationConfig, now: Stamp) -> Self {
        let coordinator = FleetCoordinator::new(config);
        Self { robot, coordinator, able_at: now, known_m2: 0.0, is_manual: false, is_in_use: true }
    }
}

/// Exploration of a fleet by a [`FleetNavigator`].
///
/// ```
/// use msg::{Pose2, RobotId, Stamp};
/// use nav::coordination::CoordinationPhase;
/// use nav::{
///     CoordinationConfig, FleetExploration, FleetNavigator, MapView, NavigatedRobot, NavigationInput, NavigatorConfig,
///     RobotObservation,
/// };
///
/// // 4 m by 4 m: the left half is free, the right half is unknown.
/// let cells: Vec<i8> = (0..6400).map(|i| if i % 80 < 40 { 0 } else { -1 }).collect();
/// let pose = Pose2::new(1.0, 2.0, 0.0);
/// let observation = RobotObservation {
///     robot: RobotId::new(1).unwrap(),
///     map: MapView::from_percent(Pose2::IDENTITY, 0.05, (80, 80), &cells),
///     in_merged_map: true,
///     map_from_base: Some(pose),
///     scan: None,
/// };
/// let robots = [NavigatedRobot { observation, odom_from_base: Some(pose), map_from_robot_map: None, uncertainty: None }];
/// let input = NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] };
///
/// let mut exploration = FleetExploration::new(CoordinationConfig::default());
/// let mut navigator = FleetNavigator::new(NavigatorConfig::default());
/// // No robot is silent: all have sent something lately.
/// let phase = exploration.step(&mut navigator, &input, &|_| false);
/// assert_eq!(phase, CoordinationPhase::Exploring);
/// assert_eq!(navigator.robots().count(), 1, "the robot has a goal from where it sees unknown space");
/// ```
#[derive(Clone, Debug)]
pub struct FleetExploration {
    config: CoordinationConfig,
    maps: Vec<ExploredMap>,
    sent: [Option<SentGoal>; ROBOTS_MAX],
    /// Where each robot was first, in its own map.
    homes: [Option<Pose2>; ROBOTS_MAX],
    /// Robots that persons drive, have stopped or sent somewhere.
    manual: [bool; ROBOTS_MAX],
    availability: [Option<RobotAvailability>; ROBOTS_MAX],
    /// Since when a robot is lost or silent.
    absent_since: [Option<Stamp>; ROBOTS_MAX],
    /// When a robot could explore last; `None` before the first step.
    able_at: Option<Stamp>,
    lost: LostRobots,
    revisits: [Revisits; ROBOTS_MAX],
    phase: CoordinationPhase,
    end: Option<ExplorationEnd>,
}

impl FleetExploration {
    /// An exploration that has sent no goal yet.
    pub fn new(config: CoordinationConfig) -> Self {
        Self {
            config,
            maps: Vec::new(),
            sent: [const { None }; ROBOTS_MAX],
            homes: [None; ROBOTS_MAX],
            manual: [false; ROBOTS_MAX],
            availability: [None; ROBOTS_MAX],
            absent_since: [None; ROBOTS_MAX],
            able_at: None,
            lost: LostRobots::default(),
            revisits: core::array::from_fn(|_| Revisits::default()),
            phase: CoordinationPhase::Exploring,
            end: None,
        }
    }

    /// What the fleet does.
    pub fn phase(&self) -> CoordinationPhase {
        self.phase
    }

    /// Why the exploration is over; `None` while it goes on.
    pub fn end(&self) -> Option<ExplorationEnd> {
        self.end
    }

    /// Number of plans made.
    pub fn plans(&self) -> u32 {
        self.maps.iter().map(|map| map.coordinator.plans()).sum()
    }

    /// Expected time until nothing reachable is unknown: that of the map that takes longest.
    pub fn estimate(&self) -> Option<TimeEstimate> {
        let estimates = self.maps.iter().filter_map(|map| map.coordinator.estimate());
        estimates
            .reduce(|a, b| TimeEstimate { least_s: a.least_s.max(b.least_s), most_s: a.most_s.max(b.most_s) })
    }

    /// Area that the maps show, square metres; `None` before the first map. Where unmerged maps overlap it counts more than once.
    pub fn known_m2(&self) -> Option<f64> {
        (!self.maps.is_empty()).then(|| self.maps_in_use().map(|map| map.known_m2).sum())
    }

    /// What is unknown beside known free space, and why no robot goes there.
    pub fn leftovers(&self) -> Vec<FoundLeftover> {
        let of = |map: &ExploredMap| {
            let robot = map.robot;
            map.coordinator.leftovers().into_iter().map(move |leftover| FoundLeftover { robot, leftover })
        };
        self.maps_in_use().flat_map(of).collect()
    }

    fn maps_in_use(&self) -> impl Iterator<Item = &ExploredMap> {
        self.maps.iter().filter(|map| map.is_in_use)
    }

    /// What a robot was at the last step; `None` before the first.
    pub fn availability(&self, robot: RobotId) -> Option<RobotAvailability> {
        self.availability[robot.index()]
    }

    /// Whether the navigator drives a robot for the exploration, to a goal or to find its place.
    pub fn is_driving(&self, robot: RobotId) -> bool {
        self.sent[robot.index()].is_some() || self.lost.is_searching(robot)
    }

    /// Where a robot was first, in its own map.
    pub fn home(&self, robot: RobotId) -> Option<Pose2> {
        self.homes[robot.index()]
    }

    /// Sets where a robot shall return to, in its own map.
    pub fn set_home(&mut self, robot: RobotId, robot_map_from_home: Pose2) {
        self.homes[robot.index()] = Some(robot_map_from_home);
    }

    /// Whether a person drives a robot, has stopped it or gave it a goal.
    pub fn is_manual(&self, robot: RobotId) -> bool {
        self.manual[robot.index()]
    }

    /// Takes a robot out of the exploration, because a person drives it, has stopped it or gives it a goal.
    ///
    /// A goal that the exploration gave it stays with the navigator unless `has_new_goal`.
    pub fn set_manual(&mut self, robot: RobotId, has_new_goal: bool) {
        self.manual[robot.index()] = true;
        if has_new_goal {
            self.sent[robot.index()] = None;
        }
    }

    /// Gives a robot back to the exploration.
    pub fn release_manual(&mut self, robot: RobotId) {
        self.manual[robot.index()] = false;
    }

    /// Sets and cancels the navigator's goals. Call it before each step of the navigator.
    ///
    /// `is_silent` tells the robots whose data do not arrive any more. A robot that the navigator has paused is a
    /// person's.
    pub fn step(
        &mut self,
        navigator: &mut FleetNavigator,
        input: &NavigationInput,
        is_silent: &dyn Fn(RobotId) -> bool,
    ) -> CoordinationPhase {
        let robots: Vec<CoordinatedRobot> =
            input.robots.iter().map(|robot| self.describe(navigator, (input, robot), is_silent)).collect();
        let merged = |robot: &NavigatedRobot| robot.observation.in_merged_map;
        self.maps.retain(|map| {
            let is_of = |robot: &&NavigatedRobot| map.robot == Some(robot.observation.robot);
            input.robots.iter().find(is_of).is_none_or(|robot| !merged(robot))
        });
        let is_any_merged = input.robots.iter().any(merged);
        for map in self.maps.iter_mut().filter(|map| map.robot.is_none()) {
            map.is_in_use = is_any_merged;
        }
        let in_merged: Vec<CoordinatedRobot> = input
            .robots
            .iter()
            .zip(&robots)
            .filter(|(observed, _)| merged(observed))
            .map(|(_, robot)| *robot)
            .collect();
        if let Some(map) = input.robots.iter().filter(|robot| merged(robot)).find_map(|r| r.observation.map) {
            self.explore(navigator, input, None, map, &in_merged);
        }
        for (observed, robot) in input.robots.iter().zip(&robots).filter(|(observed, _)| !merged(observed)) {
            if let Some(map) = observed.observation.map {
                self.explore(navigator, input, Some(robot.robot), map, &[*robot]);
            }
        }
        self.lost.step(navigator, input, &robots);
        self.conclude(input);
        self.phase
    }

    /// Describes a robot to the coordinator.
    fn describe(
        &mut self,
        navigator: &FleetNavigator,
        (input, robot): (&NavigationInput, &NavigatedRobot),
        is_silent: &dyn Fn(RobotId) -> bool,
    ) -> CoordinatedRobot {
        let id = robot.observation.robot;
        let pose = robot.observation.map_from_base.filter(|pose| pose.is_finite());
        let map_from_robot_map =
            if robot.observation.in_merged_map { robot.map_from_robot_map } else { Some(Pose2::IDENTITY) };
        let robot_map_from_base = map_from_robot_map.zip(pose).map(|(map, pose)| map.inverse() * pose);
        let home = &mut self.homes[id.index()];
        *home = home.or(robot_map_from_base);
        let state = navigator.robots().find(|navigation| navigation.robot == id).map(|n| n.state);
        let availability = match state {
            _ if is_silent(id) => RobotAvailability::Silent,
            _ if self.manual[id.index()] => RobotAvailability::Manual,
            Some(NavigationState::Paused) => RobotAvailability::Manual,
            _ if pose.is_none() => RobotAvailability::Lost,
            _ => RobotAvailability::Free,
        };
        let sent = self.sent[id.index()].as_mut().zip(state);
        let progress = sent.map_or(GoalProgress::Idle, |(sent, state)| sent.progress(input.stamp, state));
        let availability = self.revisit(input, robot, robot_map_from_base, (availability, progress));
        self.availability[id.index()] = Some(availability);
        let is_absent = matches!(availability, RobotAvailability::Lost | RobotAvailability::Silent);
        let since = &mut self.absent_since[id.index()];
        *since = is_absent.then(|| since.unwrap_or(input.stamp));
        let home = map_from_robot_map.zip(self.homes[id.index()]).map(|(map, home)| map * home);
        CoordinatedRobot { robot: id, map_from_base: pose, home, availability, progress }
    }

    /// Explores one map with the robots that share it.
    fn explore(
        &mut self,
        navigator: &mut FleetNavigator,
        input: &NavigationInput,
        of: Option<RobotId>,
        map: MapView,
        robots: &[CoordinatedRobot],
    ) {
        let index = self.maps.iter().position(|map| map.robot == of).unwrap_or_else(|| {
            self.maps.push(ExploredMap::new(of, self.config, input.stamp));
            self.maps.len() - 1
        });
        // Zones are in the merged map; where they lie in another one is not known.
        let zones = if of.is_none() { input.exclusion_zones } else { &[] };
        let excluded: Vec<Vec<[f64; 2]>> = zones.iter().map(|zone| zone.corners_m().to_vec()).collect();
        let explored = &mut self.maps[index];
        let plans = explored.coordinator.plans();
        let is_here = |id: RobotId| robots.iter().any(|robot| robot.robot == id);
        let scans = input.robots.iter().filter(|robot| is_here(robot.observation.robot));
        explored.coordinator.set_sensors(scans.filter_map(|robot| robot.observation.scan));
        explored.coordinator.update(&CoordinationInput {
            stamp: input.stamp,
            map,
            robots,
            excluded: &excluded,
        });
        // What keeps a free robot from getting goals is known after the plan.
        for robot in robots.iter().filter(|robot| robot.availability == RobotAvailability::Free) {
            if explored.coordinator.is_enclosed(robot.robot) {
                let is_excluded = robot.map_from_base.is_some_and(|pose| is_in_zone(zones, &pose));
                self.availability[robot.robot.index()] =
                    Some(if is_excluded { RobotAvailability::Excluded } else { RobotAvailability::Enclosed });
            }
        }
        if explored.coordinator.plans() != plans {
            explored.known_m2 = map.known_m2();
        }
        explored.is_manual = robots.iter().all(|robot| robot.availability == RobotAvailability::Manual);
        let looks_for_place = robots.iter().any(|robot| {
            self.lost.is_searching(robot.robot) || robot.availability == RobotAvailability::Revisiting
        });
        // Persons may keep robots as long as they like.
        if explored.coordinator.has_explorers() || explored.is_manual || looks_for_place {
            explored.able_at = input.stamp;
        }
        let frame = if of.is_none() { GoalFrame::MergedMap } else { GoalFrame::RobotMap };
        for robot in robots {
            let (frame, goal) = match self.known_place(robot.robot) {
                Some(place) => (GoalFrame::RobotMap, Some(place)),
                None => (frame, self.maps[index].coordinator.goal(robot.robot).cloned()),
            };
            self.send(navigator, input.stamp, frame, robot, goal);
        }
    }

    /// Cancels all goals that were sent: exploration ends here.
    pub fn stop(&mut self, navigator: &mut FleetNavigator) {
        self.lost.stop(navigator);
        for (robot, sent) in RobotId::first(ROBOTS_MAX).zip(&mut self.sent) {
            if sent.take().is_some() {
                navigator.cancel(robot);
            }
        }
    }

    /// Sends or cancels the goal of one robot if it has changed.
    fn send(
        &mut self,
        navigator: &mut FleetNavigator,
        now: Stamp,
        frame: GoalFrame,
        robot: &CoordinatedRobot,
        goal: Option<RobotGoal>,
    ) {
        let sent = &mut self.sent[robot.robot.index()];
        if robot.availability == RobotAvailability::Manual {
            // The goal that it has waits in the navigator.
            return;
        }
        let Some(goal) = goal else {
            if sent.take().is_some() {
                navigator.cancel(robot.robot);
            }
            return;
        };
        let is_same = |sent: &SentGoal| sent.is_same(frame, &goal, robot);
        // A robot that has returned waits for SLAM.
        let goes_on = goal.purpose == GoalPurpose::Revisit || !robot.progress.has_ended();
        if sent.as_ref().is_some_and(is_same) && goes_on {
            return;
        }
        let new = SentGoal { frame, goal, occupied_since: None };
        if let Ok(navigation_goal) = new.to_navigation() {
            navigator.set_goal(now, robot.robot, navigation_goal);
            *sent = Some(new);
        }
    }
}

#[cfg(test)]
mod tests;
