//! Sends the transforms map -> odom again, with the chain that they are part of.

use super::super::table::FleetTopic;
use super::{FleetPublisher, TopicSink};
use msg::{Monotonic, Pose2, PoseEstimate, RobotFrame, RobotId, Stamp};
use ros_messages::cdr::Writer;
use ros_messages::{names, write};

impl FleetPublisher {
    /// Takes SLAM's answer to a scan at a time, for [`FleetPublisher::repeat_transforms`].
    pub fn receive_pose_estimate(&mut self, robot: RobotId, pose_estimate: &PoseEstimate, now: Monotonic) {
        if let Some(repeated) = &mut self.repeated {
            repeated.repeater.receive(robot, pose_estimate, now);
        }
    }

    /// Publishes the last known transforms map -> odom with the stamp that they have now, dated ahead.
    ///
    /// With them go the transforms of the robots' maps, so that the whole chain is as new.
    pub fn repeat_transforms(&mut self, now: Monotonic, sink: &mut impl TopicSink) {
        let Some(mut repeated) = self.repeated.take() else { return };
        repeated.due.clear();
        for robot in self.robots.robots() {
            let due = repeated.repeater.take_due(robot, now);
            repeated.due.extend(due.map(|pose_estimate| (robot, pose_estimate)));
        }
        let frames = repeated.frames.as_ref();
        // The frame `odom`, and whether the transform belongs on the robot's own topic; `None` while it is not known.
        let odom_of = |robot| match frames {
            Some(frames) => frames.of(robot),
            None => Some((self.names.robot_frame(robot, RobotFrame::Odom), false)),
        };
        let on_tf = |robot| odom_of(robot).is_some_and(|(_, is_own)| !is_own);
        if repeated.due.iter().any(|(robot, _)| on_tf(*robot)) {
            let all = repeated.due.iter().filter(|(robot, _)| on_tf(*robot));
            sink.send(FleetTopic::Transforms, None, |to| self.write_chains(to, all, odom_of));
        }
        for entry in
            repeated.due.iter().filter(|(robot, _)| odom_of(*robot).is_some_and(|(_, is_own)| is_own))
        {
            let one = std::iter::once(entry);
            sink.send(FleetTopic::RobotTransforms, Some(entry.0), |to| self.write_chains(to, one, odom_of));
        }
        self.repeated = Some(repeated);
    }

    /// Writes tf2_msgs/TFMessage with map -> map_N, where known, and map_N -> odom of some robots.
    fn write_chains<'a>(
        &self,
        to: &mut Writer<'_>,
        pose_estimates: impl Iterator<Item = &'a (RobotId, PoseEstimate)> + Clone,
        odom_of: impl Fn(RobotId) -> Option<(&'a str, bool)>,
    ) {
        let map_of = |robot: RobotId| {
            let pose = self.map_transforms.as_ref()?.robots[robot.index()].known_pose();
            pose.filter(|_| !self.robots.is_plain())
        };
        let each = |write: &mut dyn FnMut(Stamp, &str, &str, Pose2)| {
            for (robot, pose_estimate) in pose_estimates.clone() {
                let (Some(published), Some((odom, _))) =
                    (self.in_published_map(pose_estimate), odom_of(*robot))
                else {
                    continue;
                };
                let (stamp, map) = (pose_estimate.header.stamp, self.names.map(*robot));
                if let Some(map_from_robot_map) = map_of(*robot) {
                    write(stamp, names::MAP, map, map_from_robot_map);
                }
                write(stamp, map, odom, published.map_from_odom);
            }
        };
        let mut count = 0;
        each(&mut |_, _, _, _| count += 1);
        to.count(count);
        each(&mut |stamp, parent, child, pose| write::planar_transform(to, stamp, parent, child, pose));
    }
}
