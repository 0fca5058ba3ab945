//! Robots of an exploration that return to a place that they know, so that SLAM closes a loop.

use super::super::excluded::is_in_zone;
use super::super::revisits::RevisitInput;
use super::super::types::{CoordinationPhase, GoalProgress, GoalPurpose, RobotAvailability, RobotGoal};
use super::FleetExploration;
use crate::navigation::{NavigatedRobot, NavigationInput};
use msg::{Pose2, RobotId};

impl FleetExploration {
    /// Has a free robot return to a place that it knows when its own has become uncertain. Returns its availability with that.
    pub(super) fn revisit(
        &mut self,
        input: &NavigationInput,
        robot: &NavigatedRobot,
        robot_map_from_base: Option<Pose2>,
        (availability, progress): (RobotAvailability, GoalProgress),
    ) -> RobotAvailability {
        let index = robot.observation.robot.index();
        let of = (!robot.observation.in_merged_map).then_some(robot.observation.robot);
        let map = self.maps.iter().find(|map| map.robot == of);
        let known_m2 = map.map_or(0.0, |map| map.known_m2);
        let is_explored = map.is_none_or(|map| map.coordinator.phase() == CoordinationPhase::Exploring);
        let may = availability == RobotAvailability::Free && is_explored;
        let revisits = &mut self.revisits[index];
        let Some((robot_map_from_base, uncertainty)) =
            robot_map_from_base.zip(robot.uncertainty).filter(|_| may)
        else {
            revisits.interrupt();
            return availability;
        };
        let sent = self.sent[index].as_ref().filter(|sent| sent.goal.purpose == GoalPurpose::Revisit);
        let progress = sent.map_or(GoalProgress::Idle, |_| progress);
        // Zones are in the merged map.
        let (zones, merged) = (input.exclusion_zones, robot.map_from_robot_map.filter(|_| of.is_none()));
        let is_excluded = |place: &Pose2| merged.is_some_and(|map| is_in_zone(zones, &(map * *place)));
        let place = revisits.step(&RevisitInput {
            stamp: input.stamp,
            robot_map_from_base,
            uncertainty,
            progress,
            known_m2,
            is_excluded: &is_excluded,
        });
        if place.is_some() { RobotAvailability::Revisiting } else { availability }
    }

    /// The goal of a robot that returns to a place that it knows, in its own map: merging does not move it.
    pub(super) fn known_place(&self, robot: RobotId) -> Option<RobotGoal> {
        let place = self.revisits[robot.index()].destination()?;
        Some(RobotGoal {
            purpose: GoalPurpose::Revisit,
            position_m: [place.x_m, place.y_m],
            headings_rad: vec![place.yaw_rad],
            expected_s: 0.0,
            gain_m2: 0.0,
        })
    }
}
