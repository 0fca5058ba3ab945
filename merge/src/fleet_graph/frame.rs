//! The fleet's frame `map`, and which robots are connected to it.

use super::pair::{RobotPair, robots_of_pair};
use super::robot::Robot;
use msg::Pose2;

/// The robot whose map fixes the frame `map` where no start is given: the gauge of the joint graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ReferenceRobot {
    /// Index of the robot.
    pub robot: usize,
    /// Frame `map` from the beginning of the robot's map.
    pub map_from_robot_map: Pose2,
}

/// Makes a robot the reference.
pub(crate) fn set_reference(robots: &mut [Robot], robot: usize, map_from_robot_map: Pose2) -> ReferenceRobot {
    robots[robot].estimate.set_transform(Some(map_from_robot_map));
    ReferenceRobot { robot, map_from_robot_map }
}

/// Returns the first robot with a transform, as the successor of a reference that has left: the frame itself stays.
pub(crate) fn successor(robots: &[Robot]) -> Option<ReferenceRobot> {
    robots.iter().enumerate().find_map(|(robot, known)| {
        let map_from_robot_map = *known.estimate.map_from_robot_map_at_submaps().first()?;
        Some(ReferenceRobot { robot, map_from_robot_map })
    })
}

/// Returns the reference that shows most robots: the present one, unless other robots are joined to each other in a larger
/// number. Then it is the first of these. If it was connected to the frame `map`, the frame stays where it is, as goals and zones
/// lie in it; otherwise `map` is the frame of its map from now on.
pub(crate) fn reference_of_largest_component(
    robots: &mut [Robot],
    pairs: &[RobotPair],
    reference: ReferenceRobot,
) -> ReferenceRobot {
    let components = components(robots.len(), pairs);
    let size = |robot: usize| components.iter().filter(|component| **component == components[robot]).count();
    // Of equal ones the first, so that the frame depends on the edges alone.
    let largest = (0..robots.len()).max_by_key(|robot| (size(*robot), core::cmp::Reverse(*robot)));
    let Some(largest) = largest.filter(|largest| size(*largest) > size(reference.robot)) else {
        return reference;
    };
    let kept = robots[largest].estimate.map_from_robot_map_at_submaps().first().copied();
    let kept = kept.or(robots[largest].estimate.map_from_robot_map());
    robots.iter_mut().for_each(|robot| robot.reset_estimate(None));
    set_reference(robots, largest, kept.unwrap_or(Pose2::IDENTITY))
}

/// Returns the component of each robot, which is the least index of the robots that active edges join.
fn components(robots: usize, pairs: &[RobotPair]) -> Vec<usize> {
    let mut components: Vec<usize> = (0..robots).collect();
    for (index, _) in pairs.iter().enumerate().filter(|(_, pair)| pair.edge.is_active()) {
        let [a, b] = robots_of_pair(index).map(|robot| components[robot]);
        let (joined, first) = (a.max(b), a.min(b));
        components
            .iter_mut()
            .filter(|component| **component == joined)
            .for_each(|component| *component = first);
    }
    components
}

/// Gives a transform to every robot that active edges connect to the frame, and removes it from all others.
pub(crate) fn connect_robots(robots: &mut [Robot], pairs: &[RobotPair], reference: Option<ReferenceRobot>) {
    let mut connected: Vec<bool> =
        robots.iter().map(|robot| robot.estimate.configured_map_from_robot_map().is_some()).collect();
    if let Some(reference) = reference {
        connected[reference.robot] = true;
    }
    // As often as there are robots: no path has more edges.
    for _ in 0..robots.len() {
        for (index, pair) in pairs.iter().enumerate().filter(|(_, pair)| pair.edge.is_active()) {
            let ([a, b], a_from_b) = (robots_of_pair(index), pair.edge.a_from_b());
            for (near, far, near_from_far) in [(a, b, a_from_b), (b, a, a_from_b.inverse())] {
                if connected[near] && !connected[far] {
                    connected[far] = true;
                    let Some(map_from_near) = robots[near].estimate.map_from_robot_map() else { continue };
                    if robots[far].estimate.map_from_robot_map().is_none() {
                        robots[far].estimate.set_transform(Some(map_from_near * near_from_far));
                    }
                }
            }
        }
    }
    for (robot, _) in robots.iter_mut().zip(connected).filter(|(_, connected)| !*connected) {
        robot.reset_estimate(None);
    }
}
