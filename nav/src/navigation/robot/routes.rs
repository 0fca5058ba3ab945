//! Routes of a robot to the next pose of its goal, on the newest map.

use super::super::goal::{GoalFrame, GoalPose};
use super::super::goal_map::GoalMapInput;
use super::super::input::NavigatedRobot;
use super::super::state::{NavigationFailure, NavigationState};
use super::RobotNavigator;
use crate::clearance_map::is_inside;
use msg::{ExclusionZone, RobotId, Stamp};

impl RobotNavigator {
    /// The pose that is driven to, in the frame of the robot's map.
    pub(super) fn goal_pose(&self, robot: &NavigatedRobot) -> Result<GoalPose, NavigationFailure> {
        let active = self.goal.as_ref().ok_or(NavigationFailure::NoPose)?;
        let pose = active.goal.poses()[active.next];
        match (active.goal.frame(), robot.observation.in_merged_map) {
            (GoalFrame::MergedMap, true) | (GoalFrame::RobotMap, false) => Ok(pose),
            (GoalFrame::MergedMap, false) => Err(NavigationFailure::NotMerged),
            (GoalFrame::RobotMap, true) => {
                let map_from_robot_map = robot.map_from_robot_map.ok_or(NavigationFailure::NoPose)?;
                Ok(pose.transformed(map_from_robot_map))
            }
        }
    }

    /// Searches the routes to the goal on the newest map.
    pub(in crate::navigation) fn search(
        &mut self,
        now: Stamp,
        robot: &NavigatedRobot,
        zones: &[ExclusionZone],
        standing: &[(RobotId, [f64; 2])],
    ) {
        let result = self.search_routes(now, robot, zones, standing);
        self.searched = Some((now, result));
        if let Err(failure) = result {
            self.followed = None;
            if !matches!(failure, NavigationFailure::Robot(_)) {
                self.waited_for = None;
            }
            self.state = NavigationState::Blocked(failure);
            return;
        }
        let at_m = robot.poses().map(|poses| poses.position_m());
        self.remaining_m = at_m.and_then(|at_m| self.goal_map.cost_m(at_m));
        if let Some((active, remaining_m)) = self.goal.as_mut().zip(self.remaining_m)
            && active.progress.record(now, &self.config, remaining_m)
        {
            self.waited_for = None;
        }
    }

    fn search_routes(
        &mut self,
        now: Stamp,
        robot: &NavigatedRobot,
        zones: &[ExclusionZone],
        standing: &[(RobotId, [f64; 2])],
    ) -> Result<(), NavigationFailure> {
        let goal_m = self.goal_pose(robot)?.position_m;
        let (map, poses) = robot.observation.map.zip(robot.poses()).ok_or(NavigationFailure::NoPose)?;
        let standing_robots_m: Vec<[f64; 2]> = standing.iter().map(|(_, at_m)| *at_m).collect();
        let input = GoalMapInput {
            stamp: now,
            map,
            poses,
            goal_m,
            obstacles: &self.obstacles,
            zones: if robot.observation.in_merged_map { zones } else { &[] },
            standing_robots_m: &standing_robots_m,
        };
        let result = self.goal_map.search(&self.config, &input);
        let blocking = standing
            .iter()
            .find(|(_, at_m)| crate::geometry::distance_m(*at_m, goal_m) < self.config.separation_m);
        let zone = input.zones.iter().find(|zone| is_inside(goal_m, zone.corners_m()));
        match (result, blocking) {
            (Err(NavigationFailure::GoalOccupied), None) if zone.is_some() => {
                Err(NavigationFailure::GoalExcluded(zone.map_or(0, |zone| zone.number)))
            }
            (Err(NavigationFailure::GoalOccupied), Some((robot, _))) => Err(NavigationFailure::Robot(*robot)),
            (result, _) => result,
        }
    }
}
