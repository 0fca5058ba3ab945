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
    /// With them go the transforms of the robots' maps, so that the whole chain is as new: on `/tf` those of robots whose
    /// odometry is on a topic of their own, too.
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
        // The merged map's frames are on /tf for readers of that alone.
        let odom_on_tf = |robot| odom_of(robot).filter(|(_, is_own)| !is_own).map(|(odom, _)| odom);
        if self.count_chains(&repeated.due, odom_on_tf) > 0 {
            sink.send(FleetTopic::Transforms, None, |to| self.write_chains(to, &repeated.due, odom_on_tf));
        }
        for entry in &repeated.due {
            let Some((odom, true)) = odom_of(entry.0) else { continue };
            let one = std::slice::from_ref(entry);
            sink.send(FleetTopic::RobotTransforms, Some(entry.0), |to| {
                self.write_chains(to, one, |_| Some(odom))
            });
        }
        self.repeated = Some(repeated);
    }

    /// Returns the transform from a robot's map to the merged map, if it is known and both are published.
    pub(super) fn map_from_robot_map(&self, robot: RobotId) -> Option<Pose2> {
        let pose = self.map_transforms.as_ref()?.robots.get(robot.index())?.known_pose();
        pose.filter(|_| !self.robots.is_plain())
    }

    fn count_chains<'a>(
        &self,
        pose_estimates: &[(RobotId, PoseEstimate)],
        odom_of: impl Fn(RobotId) -> Option<&'a str>,
    ) -> usize {
        let mut count = 0;
        self.for_each_transform(pose_estimates, odom_of, |_, _, _, _| count += 1);
        count
    }

    /// Writes tf2_msgs/TFMessage with map -> map_N, where known, and map_N -> odom of some robots.
    fn write_chains<'a>(
        &self,
        to: &mut Writer<'_>,
        pose_estimates: &[(RobotId, PoseEstimate)],
        odom_of: impl Fn(RobotId) -> Option<&'a str> + Copy,
    ) {
        to.count(self.count_chains(pose_estimates, odom_of));
        self.for_each_transform(pose_estimates, odom_of, |stamp, parent, child, pose| {
            write::planar_transform(to, stamp, parent, child, pose);
        });
    }

    fn for_each_transform<'a>(
        &self,
        pose_estimates: &[(RobotId, PoseEstimate)],
        odom_of: impl Fn(RobotId) -> Option<&'a str>,
        mut each: impl FnMut(Stamp, &str, &str, Pose2),
    ) {
        for (robot, pose_estimate) in pose_estimates {
            let Some(published) = self.in_published_map(pose_estimate) else { continue };
            let (stamp, map) = (pose_estimate.header.stamp, self.names.map(*robot));
            if let Some(map_from_robot_map) = self.map_from_robot_map(*robot) {
                each(stamp, names::MAP, map, map_from_robot_map);
            }
            if let Some(odom) = odom_of(*robot) {
                each(stamp, map, odom, published.map_from_odom);
            }
        }
    }
}
