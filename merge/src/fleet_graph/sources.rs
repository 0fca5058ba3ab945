//! Sources of submaps: runs of robots' machines, incarnations of their SLAM, and generations of their submaps.

use super::*;

impl FleetPoseGraph {
    /// Number of the frame `robotK/map`; 0, the one in which the robot began, while nothing of the robot is known.
    pub fn map_frame(&self, robot: RobotId) -> u32 {
        self.robots.get(robot.index()).and_then(|robot| robot.map_frame).unwrap_or(0)
    }

    /// Removes a robot whose map has another frame than before: its machine is in another run, or a map of elsewhere was loaded.
    pub(super) fn check_map_frame(&mut self, robot: RobotId, map_frame: u32) -> Result<(), SubmapRejected> {
        let known = self.robots.get_mut(robot.index()).ok_or(SubmapRejected::UnknownRobot(robot))?;
        if known.map_frame.replace(map_frame).is_some_and(|before| before != map_frame) {
            self.remove_robot(robot);
        }
        Ok(())
    }

    /// Returns whether a submap of this source came late, as poses and submaps have a channel each: it is of an older generation than
    /// the poses. Poses of an older generation are those of a SLAM that was started again on another machine, which begins at 0.
    pub(super) fn is_late_submap(&self, robot: RobotId, source: SubmapSource) -> bool {
        let current = self.robots.get(robot.index()).and_then(|known| known.submaps.source());
        current
            .is_some_and(|current| current.0 == source.0 && source.1.wrapping_sub(current.1) > u32::MAX / 2)
    }

    /// Handles submaps or poses of a new source.
    pub(super) fn check_source(
        &mut self,
        robot: RobotId,
        source: SubmapSource,
    ) -> Result<(), SubmapRejected> {
        let index = robot.index();
        let known = self.robots.get_mut(index).ok_or(SubmapRejected::UnknownRobot(robot))?;
        match known.submaps.source() {
            Some(current) if current == source => {}
            None => known.submaps.set_source(source),
            Some(_) => self.restart_source(index, source),
        }
        Ok(())
    }

    /// Begins anew with a robot's submaps. A SLAM that was restarted, or that forgets nodes, continues in the same frame with new submaps:
    /// the robot keeps its transform, and loses submaps and closures.
    pub(super) fn restart_source(&mut self, index: usize, source: SubmapSource) {
        self.robots[index].restart(source);
        for pair in (0..self.pairs.len()).filter(|pair| robots_of_pair(*pair).contains(&index)) {
            let in_graph = self.a_from_b_in_graph(pair);
            self.pairs[pair].restart(in_graph);
        }
        if let Some(reference) = &mut self.reference
            && reference.robot == index
        {
            let transform = self.robots[index].estimate.map_from_robot_map();
            reference.map_from_robot_map = transform.unwrap_or(reference.map_from_robot_map);
        }
    }
}
