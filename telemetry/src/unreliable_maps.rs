//! Which maps are unreliable, by what SLAM last said of each robot's.

use msg::{Correction, MapTransforms, ROBOTS_MAX, RobotId, TrackingState};

/// Why a robot's map is unreliable: its corrections do not carry SLAM's evidence.
const REASON: &str = "SLAM found evidence that this map is wrong (state unreliable)";

/// The robots whose maps SLAM calls unreliable.
#[derive(Clone, Copy, Debug)]
pub struct UnreliableMaps {
    /// Whether each robot's map is unreliable, by [`RobotId::index`].
    robots: [bool; ROBOTS_MAX],
}

impl Default for UnreliableMaps {
    fn default() -> Self {
        Self { robots: [false; ROBOTS_MAX] }
    }
}

impl UnreliableMaps {
    /// Records the newest correction of a robot. A state that says nothing about the map, such as lost, changes nothing.
    pub fn record(&mut self, robot: RobotId, correction: &Correction) {
        let is_unreliable = &mut self.robots[robot.index()];
        match correction.state() {
            TrackingState::Unreliable => *is_unreliable = true,
            TrackingState::Tracking | TrackingState::Degenerate => *is_unreliable = false,
            TrackingState::Starting | TrackingState::Lost => {}
        }
    }

    /// Returns why a robot's map is unreliable; nothing if it is not.
    pub fn reasons_of_robot(&self, robot: RobotId) -> Vec<String> {
        let is_unreliable = self.robots[robot.index()];
        is_unreliable.then(|| REASON.to_owned()).into_iter().collect()
    }

    /// Returns why the merged map is unreliable: the reasons of the robots whose maps are in it, each with its robot.
    pub fn reasons_of_merged_map(&self, transforms: Option<&MapTransforms>) -> Vec<String> {
        let is_merged = |robot: &RobotId| {
            transforms.is_some_and(|transforms| transforms.robots[robot.index()].known_pose().is_some())
        };
        let unreliable = RobotId::first(ROBOTS_MAX).filter(|robot| self.robots[robot.index()]);
        unreliable.filter(is_merged).map(|robot| format!("{robot}: {REASON}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::MapTransform;

    fn correction(state: TrackingState) -> Correction {
        Correction { state: state as u32, ..Correction::default() }
    }

    #[test]
    fn a_map_stays_unreliable_while_its_robot_is_lost_and_the_merged_map_is_if_it_holds_it() {
        let [first, second] = [1, 2].map(|number| RobotId::new(number).unwrap());
        let mut maps = UnreliableMaps::default();
        maps.record(second, &correction(TrackingState::Unreliable));
        maps.record(second, &correction(TrackingState::Lost));
        assert!(maps.reasons_of_robot(first).is_empty());
        assert_eq!(maps.reasons_of_robot(second).len(), 1);
        let mut transforms = MapTransforms::default();
        transforms.robots[0] = MapTransform { known: 1, ..MapTransform::default() };
        assert!(maps.reasons_of_merged_map(Some(&transforms)).is_empty(), "robot 2 is not in it");
        transforms.robots[1] = transforms.robots[0];
        let reasons = maps.reasons_of_merged_map(Some(&transforms));
        assert!(reasons.len() == 1 && reasons[0].starts_with("robot2: "), "{reasons:?}");
        maps.record(second, &correction(TrackingState::Tracking));
        assert!(maps.reasons_of_robot(second).is_empty());
    }
}
