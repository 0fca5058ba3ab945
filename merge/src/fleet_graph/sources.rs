//! Sources of submaps: runs of robots' machines, incarnations of their SLAM, and generations of their submaps.

use super::*;

impl FleetPoseGraph {
    /// Removes a robot whose machine is in another run than before: the frame of its map is another one.
    pub(super) fn check_run(&mut self, robot: RobotId, run: u32) -> Result<(), SubmapRejected> {
        let known = self.robots.get_mut(robot.index()).ok_or(SubmapRejected::UnknownRobot(robot))?;
        if known.run.replace(run).is_some_and(|before| before != run) {
            self.remove_robot(robot);
        }
        Ok(())
    }

    /// Handles submaps of a new generation. Returns whether a message of this source is to be taken: one of an older generation came
    /// late, as poses and submaps have a channel each.
    pub(super) fn check_source(
        &mut self,
        robot: RobotId,
        source: SubmapSource,
    ) -> Result<bool, SubmapRejected> {
        let index = robot.index();
        let known = self.robots.get_mut(index).ok_or(SubmapRejected::UnknownRobot(robot))?;
        let is_older =
            |current: SubmapSource| current.0 == source.0 && source.1.wrapping_sub(current.1) > u32::MAX / 2;
        match known.submaps.source() {
            Some(current) if current == source => {}
            Some(current) if is_older(current) => return Ok(false),
            None => known.submaps.set_source(source),
            Some(_) => self.restart_source(index, source),
        }
        Ok(true)
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
