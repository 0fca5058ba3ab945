//! Which maps are unreliable, by what SLAM last said of each robot's and merging of each pair's.

use msg::{MapTransforms, MergeEdges, PoseEstimate, ROBOTS_MAX, RobotId, TrackingState};

/// Why a robot's map is unreliable: its pose estimates do not carry SLAM's evidence.
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
    /// Records the newest pose estimate of a robot. A state that says nothing about the map, such as lost, changes nothing.
    pub fn record(&mut self, robot: RobotId, pose_estimate: &PoseEstimate) {
        let is_unreliable = &mut self.robots[robot.index()];
        match pose_estimate.state() {
            TrackingState::MapUnreliable => *is_unreliable = true,
            TrackingState::Tracking | TrackingState::Degenerate => *is_unreliable = false,
            TrackingState::Starting
            | TrackingState::Lost
            | TrackingState::Unconfirmed
            | TrackingState::Paused => {}
        }
    }

    /// Returns why a robot's map is unreliable; nothing if it is not.
    pub fn reasons_of_robot(&self, robot: RobotId) -> Vec<String> {
        let is_unreliable = self.robots[robot.index()];
        is_unreliable.then(|| REASON.to_owned()).into_iter().collect()
    }

    /// Returns why the merged map is unreliable: the reasons of the robots whose maps are in it, each with its robot, and the pairs
    /// of robots whose maps contradict each other.
    pub fn reasons_of_merged_map(
        &self,
        transforms: Option<&MapTransforms>,
        edges: &MergeEdges,
    ) -> Vec<String> {
        let is_merged = |robot: &RobotId| {
            transforms.is_some_and(|transforms| transforms.robots[robot.index()].known_pose().is_some())
        };
        let unreliable = RobotId::first(ROBOTS_MAX).filter(|robot| self.robots[robot.index()]);
        let of_robots = unreliable.filter(is_merged).map(|robot| format!("{robot}: {REASON}"));
        of_robots.chain(contradictions(edges)).collect()
    }
}

/// Returns the pairs of robots whose maps contradict each other where merging puts them.
pub fn contradictions(edges: &MergeEdges) -> impl Iterator<Item = String> {
    let contradicted = edges.edges().iter().filter(|edge| edge.is_contradicted());
    contradicted.map(|edge| {
        let (count, of) = (edge.contradicted_submaps, edge.compared_submaps);
        format!(
            "robot{} and robot{}: their maps contradict each other in {count} of {of} places",
            edge.a, edge.b
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{MapTransform, MergeEdge};

    fn pose_estimate(state: TrackingState) -> PoseEstimate {
        PoseEstimate { state: state as u32, ..PoseEstimate::default() }
    }

    #[test]
    fn a_map_stays_unreliable_while_its_robot_is_lost_and_the_merged_map_is_if_it_holds_it() {
        let [first, second] = [1, 2].map(|number| RobotId::new(number).unwrap());
        let mut maps = UnreliableMaps::default();
        maps.record(second, &pose_estimate(TrackingState::MapUnreliable));
        maps.record(second, &pose_estimate(TrackingState::Lost));
        assert!(maps.reasons_of_robot(first).is_empty());
        assert_eq!(maps.reasons_of_robot(second).len(), 1);
        let mut transforms = MapTransforms::default();
        transforms.robots[0] = MapTransform { known: 1, ..MapTransform::default() };
        let mut edges = MergeEdges::default();
        assert!(maps.reasons_of_merged_map(Some(&transforms), &edges).is_empty(), "robot 2 is not in it");
        transforms.robots[1] = transforms.robots[0];
        let reasons = maps.reasons_of_merged_map(Some(&transforms), &edges);
        assert!(reasons.len() == 1 && reasons[0].starts_with("robot2: "), "{reasons:?}");
        maps.record(second, &pose_estimate(TrackingState::Tracking));
        assert!(maps.reasons_of_robot(second).is_empty());
        (edges.len, edges.edges[0]) =
            (1, MergeEdge { a: 1, b: 2, compared_submaps: 20, ..MergeEdge::default() });
        assert!(maps.reasons_of_merged_map(Some(&transforms), &edges).is_empty());
        edges.edges[0].contradicted_submaps = 7;
        let reasons = maps.reasons_of_merged_map(Some(&transforms), &edges);
        assert_eq!(reasons, ["robot1 and robot2: their maps contradict each other in 7 of 20 places"]);
    }
}
