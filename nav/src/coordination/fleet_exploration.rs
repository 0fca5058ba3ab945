//! Exploration by a fleet that a navigator drives: the coordinator's goals become goals of navigation.

use super::types::{
    CoordinatedRobot, CoordinationInput, CoordinationPhase, GoalProgress, RobotAvailability, RobotGoal,
};
use super::{CoordinationConfig, FleetCoordinator};
use crate::geometry::distance_m;
use crate::navigation::{
    FleetNavigator, GoalFrame, GoalPose, NavigatedRobot, NavigationGoal, NavigationInput, NavigationState,
};
use msg::pose::wrap_angle;
use msg::{ROBOTS_MAX, RobotId};

/// Distance within which two goals are at one place, metres: a cell of the map.
const SAME_PLACE_M: f64 = 0.06;
/// Distance to its place within which a robot is told of new headings, metres. Farther away they may change again.
const HEADINGS_FROM_M: f64 = 0.5;
/// Change of the first heading that a robot is told of, radians: less than the sensor sees to each side.
const HEADING_CHANGE_RAD: f64 = 0.35;

/// Exploration of a fleet by a [`FleetNavigator`].
#[derive(Clone, Debug)]
pub struct FleetExploration {
    coordinator: FleetCoordinator,
    /// Goals that the navigator was given.
    sent: [Option<RobotGoal>; ROBOTS_MAX],
}

impl FleetExploration {
    /// An exploration that has sent no goal yet.
    pub fn new(config: CoordinationConfig) -> Self {
        Self { coordinator: FleetCoordinator::new(config), sent: [const { None }; ROBOTS_MAX] }
    }

    /// The coordinator, with what is left and the expected time.
    pub fn coordinator(&self) -> &FleetCoordinator {
        &self.coordinator
    }

    /// Sets and cancels the navigator's goals. Call it before each step of the navigator.
    ///
    /// `is_dead` tells the robots that do not answer any more. A robot that the navigator has paused is a person's.
    pub fn step(
        &mut self,
        navigator: &mut FleetNavigator,
        input: &NavigationInput,
        is_dead: &dyn Fn(RobotId) -> bool,
    ) -> CoordinationPhase {
        let merged =
            |robot: &&NavigatedRobot| robot.observation.in_merged_map && robot.observation.map.is_some();
        let Some(map) = input.robots.iter().find(merged).and_then(|robot| robot.observation.map) else {
            return self.coordinator.phase();
        };
        let state = |robot: RobotId| navigator.robots().find(|n| n.robot == robot).map(|n| n.state);
        let robots: Vec<CoordinatedRobot> = input
            .robots
            .iter()
            .map(|robot| {
                let id = robot.observation.robot;
                let pose = robot.observation.map_from_base.filter(|_| robot.observation.in_merged_map);
                let availability = match state(id) {
                    _ if is_dead(id) => RobotAvailability::Dead,
                    Some(NavigationState::Paused) => RobotAvailability::Manual,
                    _ if pose.is_none() => RobotAvailability::Lost,
                    _ => RobotAvailability::Free,
                };
                let progress = match state(id).filter(|_| self.sent[id.index()].is_some()) {
                    None | Some(NavigationState::Idle) => GoalProgress::Idle,
                    Some(NavigationState::Reached) => GoalProgress::Reached,
                    Some(NavigationState::Failed(_) | NavigationState::Cancelled) => GoalProgress::Failed,
                    Some(_) => GoalProgress::Active,
                };
                CoordinatedRobot { robot: id, map_from_base: pose, availability, progress }
            })
            .collect();
        let excluded: Vec<Vec<[f64; 2]>> =
            input.exclusion_zones.iter().map(|zone| zone.corners_m.clone()).collect();
        let fleet = CoordinationInput { stamp: input.stamp, map, robots: &robots, excluded: &excluded };
        let phase = self.coordinator.update(&fleet);
        for robot in &robots {
            self.send(navigator, input, robot);
        }
        phase
    }

    /// Cancels all goals that were sent: exploration ends here.
    pub fn stop(&mut self, navigator: &mut FleetNavigator) {
        for (robot, sent) in RobotId::first(ROBOTS_MAX).zip(&mut self.sent) {
            if sent.take().is_some() {
                navigator.cancel(robot);
            }
        }
    }

    /// Sets or cancels the goal of one robot if it has changed.
    fn send(&mut self, navigator: &mut FleetNavigator, input: &NavigationInput, robot: &CoordinatedRobot) {
        let sent = &mut self.sent[robot.robot.index()];
        if robot.availability == RobotAvailability::Manual {
            // Its goal waits in the navigator; the next plan gives it another one.
            *sent = None;
            return;
        }
        let goal = self.coordinator.goal(robot.robot);
        let Some(goal) = goal else {
            if sent.take().is_some() {
                navigator.cancel(robot.robot);
            }
            return;
        };
        let is_same = sent.as_ref().is_some_and(|sent| is_same_goal(sent, goal, robot));
        if is_same && !robot.progress.has_ended() {
            return;
        }
        let pose = |yaw_rad| GoalPose { position_m: goal.position_m, yaw_rad };
        let poses = match goal.headings_rad.as_slice() {
            [] => vec![pose(None)],
            headings => headings.iter().map(|heading| pose(Some(*heading))).collect(),
        };
        if let Ok(navigation_goal) = NavigationGoal::new(GoalFrame::MergedMap, poses) {
            navigator.set_goal(input.stamp, robot.robot, navigation_goal);
            *sent = Some(goal.clone());
        }
    }
}

/// Whether a robot need not be told of a goal, because the one that it has is as good.
fn is_same_goal(sent: &RobotGoal, goal: &RobotGoal, robot: &CoordinatedRobot) -> bool {
    if distance_m(sent.position_m, goal.position_m) > SAME_PLACE_M || sent.purpose != goal.purpose {
        return false;
    }
    let is_far = robot
        .map_from_base
        .is_none_or(|pose| distance_m([pose.x_m, pose.y_m], goal.position_m) > HEADINGS_FROM_M);
    let is_near_last = |a: Option<&f64>, b: Option<&f64>| match (a, b) {
        (Some(a), Some(b)) => wrap_angle(a - b).abs() < HEADING_CHANGE_RAD,
        (None, None) => true,
        _ => false,
    };
    is_far || is_near_last(sent.headings_rad.last(), goal.headings_rad.last())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::navigation::NavigatorConfig;
    use crate::observation::{BURGER_BASE_FROM_SCAN, MapView, RobotObservation, ScanView};
    use msg::{Pose2, Stamp};

    /// Free space of 4 m by 4 m in the middle of unknown space.
    fn cells() -> Vec<i8> {
        (0..160 * 80).map(|i| if (40..120).contains(&(i % 160)) { 0 } else { -1 }).collect()
    }

    fn robots<'a>(cells: &'a [i8], count: usize) -> Vec<NavigatedRobot<'a>> {
        RobotId::first(count)
            .map(|robot| {
                let pose = Pose2::new(3.0 + 2.0 * robot.index() as f64, 2.0, 0.0);
                let scan = ScanView {
                    received: Stamp(0),
                    base_from_scan: BURGER_BASE_FROM_SCAN,
                    angle_min_rad: 0.0,
                    angle_increment_rad: 0.01,
                    range_min_m: 0.12,
                    range_max_m: 3.5,
                    ranges_m: &[3.5],
                };
                let observation = RobotObservation {
                    robot,
                    map: MapView::from_percent(Pose2::IDENTITY, 0.05, (160, 80), cells),
                    in_merged_map: true,
                    map_from_base: Some(pose),
                    scan: Some(scan),
                };
                NavigatedRobot { observation, odom_from_base: Some(pose), map_from_robot_map: None }
            })
            .collect()
    }

    #[test]
    fn the_navigator_drives_to_the_coordinators_goals_until_exploration_stops() {
        let cells = cells();
        let robots = robots(&cells, 2);
        let mut navigator = FleetNavigator::new(NavigatorConfig::default());
        let mut exploration = FleetExploration::new(CoordinationConfig::default());
        let input = NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] };
        let phase = exploration.step(&mut navigator, &input, &|_| false);
        assert_eq!(phase, CoordinationPhase::Exploring);
        navigator.step(&input);
        assert_eq!(navigator.robots().filter(|robot| robot.state.is_active()).count(), 2);
        exploration.stop(&mut navigator);
        navigator.step(&input);
        assert!(!navigator.is_active());
    }

    #[test]
    fn robots_that_are_dead_or_in_a_persons_hands_get_no_goals() {
        let cells = cells();
        let robots = robots(&cells, 2);
        let second = robots[1].observation.robot;
        let mut navigator = FleetNavigator::new(NavigatorConfig::default());
        let mut exploration = FleetExploration::new(CoordinationConfig::default());
        let input = NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] };
        exploration.step(&mut navigator, &input, &|robot| robot == second);
        assert_eq!(
            navigator.robots().map(|robot| robot.robot).collect::<Vec<_>>(),
            [robots[0].observation.robot]
        );
        navigator.pause(robots[0].observation.robot);
        let later = NavigationInput { stamp: Stamp::from_seconds(5.0), ..input };
        exploration.step(&mut navigator, &later, &|robot| robot == second);
        assert_eq!(navigator.robots().next().map(|robot| robot.state), Some(NavigationState::Paused));
    }
}
