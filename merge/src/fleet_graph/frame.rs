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
        let map_from_robot_map = *known.estimate.at_submaps().first()?;
        Some(ReferenceRobot { robot, map_from_robot_map })
    })
}

/// Gives a transform to every robot that active edges connect to the frame, and removes it from all others.
pub(crate) fn connect_robots(robots: &mut [Robot], pairs: &[RobotPair], reference: Option<ReferenceRobot>) {
    let mut connected: Vec<bool> = robots.iter().map(|robot| robot.estimate.start().is_some()).collect();
    if let Some(reference) = reference {
        connected[reference.robot] = true;
    }
    // As often as there are robots: no path has more edges.
    for _ in 0..robots.len() {
        for (index, pair) in pairs.iter().enumerate().filter(|(_, pair)| pair.edge.is_active()) {
            let ([a, b], a_from_b) = (robots_of_pair(index), pair.edge.a_from_b());
            for (from, to, from_from_to) in [(a, b, a_from_b), (b, a, a_from_b.inverse())] {
                if connected[from] && !connected[to] {
                    connected[to] = true;
                    let Some(map_from_from) = robots[from].estimate.transform() else { continue };
                    if robots[to].estimate.transform().is_none() {
                        robots[to].estimate.set_transform(Some(map_from_from * from_from_to));
                    }
                }
            }
        }
    }
    for (robot, _) in robots.iter_mut().zip(connected).filter(|(_, connected)| !*connected) {
        robot.reset_estimate(None);
    }
}
