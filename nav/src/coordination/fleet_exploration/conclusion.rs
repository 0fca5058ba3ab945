//! What the fleet as a whole does, and when its exploration is over.

use super::ExploredMap;
use super::FleetExploration;
use crate::coordination::types::{CoordinationPhase, ExplorationEnd, RobotAvailability};
use crate::navigation::NavigationInput;
use msg::{ROBOTS_MAX, RobotId, Stamp};

/// Time without a robot that can be given goals after which a map is given up, seconds: a restart of SLAM and a
/// relocalization take less.
const PATIENCE_S: f64 = 60.0;
/// Time without a robot that can explore after which the exploration says that it waits, seconds: the first maps of a fleet that
/// starts take less.
const WAITING_AFTER_S: f64 = 5.0;

impl FleetExploration {
    /// Decides what the fleet as a whole does, and whether the exploration is over.
    pub(super) fn conclude(&mut self, input: &NavigationInput) {
        let now = input.stamp;
        let unable_s = self.unable_s(input);
        let is_able = |map: &&ExploredMap| !map.is_manual && now - map.able_at < PATIENCE_S;
        let phase = self.maps_in_use().filter(is_able).map(|map| map.coordinator.phase()).min();
        match phase {
            Some(phase) => self.phase = phase,
            None if self.maps_in_use().any(|map| map.is_manual) => {}
            None if self.maps.is_empty() && unable_s < PATIENCE_S => {}
            None => self.end = Some(ExplorationEnd::NoRobot),
        }
        if unable_s >= WAITING_AFTER_S {
            self.phase = CoordinationPhase::Waiting;
        }
        if phase == Some(CoordinationPhase::Done) && !self.awaits_robot(now) {
            let is_whole = self.maps_in_use().all(|map| map.coordinator.covers_map());
            let took_too_long = self.maps_in_use().any(|map| map.coordinator.took_too_long());
            self.end = Some(match (is_whole, took_too_long) {
                (false, _) => ExplorationEnd::MapTooLarge,
                (true, true) => ExplorationEnd::TookTooLong,
                (true, false) => ExplorationEnd::Completed,
            });
        }
    }

    /// Returns the time for which no robot could explore, seconds. While persons have all robots it is 0: they may keep them as long as
    /// they like.
    fn unable_s(&mut self, input: &NavigationInput) -> f64 {
        let robots = || input.robots.iter().map(|robot| robot.observation.robot);
        let has_map = self.maps_in_use().next().is_some();
        let is = |robot: RobotId, is: fn(RobotAvailability) -> bool| self.availability(robot).is_some_and(is);
        let is_able = robots().any(|robot| {
            self.lost.is_searching(robot) || (has_map && is(robot, RobotAvailability::explores))
        });
        let is_manual = robots().all(|robot| is(robot, |robot| robot == RobotAvailability::Manual));
        let able_at = match self.able_at {
            Some(able_at) if !is_able && !is_manual => able_at,
            _ => input.stamp,
        };
        self.able_at = Some(able_at);
        input.stamp - able_at
    }

    /// Whether a robot that may go on soon is lost or silent, looks for its place or is on its way to one that it knows: what it alone
    /// reaches is not explored.
    fn awaits_robot(&self, now: Stamp) -> bool {
        RobotId::first(ROBOTS_MAX).any(|robot| {
            let is_absent_for_now =
                self.absent_since[robot.index()].is_some_and(|since| now - since < PATIENCE_S);
            let is_revisiting = self.availability(robot) == Some(RobotAvailability::Revisiting);
            is_absent_for_now || is_revisiting || self.lost.is_searching(robot)
        })
    }
}
