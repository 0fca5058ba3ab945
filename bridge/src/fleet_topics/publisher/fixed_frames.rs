//! The transforms that never change: the fleet's fixed frames, and those of other publishers.

use super::{FleetPublisher, TopicSink};
use crate::fleet_topics::table::FleetTopic;
use msg::{RobotFrame, RobotId, Transforms};
use ros_messages::cdr::{DecodeError, Reader};
use ros_messages::names::FleetFrame;
use ros_messages::read::{self, Transform};
use ros_messages::spatial_pose::SpatialPose;
use ros_messages::{Message as _, TransformStamped};

impl FleetPublisher {
    /// Publishes the fixed transforms of all robots seen so far, when a robot is seen first: the newest message is the
    /// only one kept.
    pub(super) fn publish_fixed_frames(
        &mut self,
        robot: RobotId,
        transforms: &Transforms,
        sink: &mut impl TopicSink,
    ) {
        if std::mem::replace(&mut self.has_fixed_frames[robot.index()], true) {
            return;
        }
        for transform in transforms.transforms() {
            let (parent, child) =
                (RobotFrame::from_code(transform.parent_frame), RobotFrame::from_code(transform.child_frame));
            let (Some(parent), Some(child)) = (parent, child.filter(|child| child.is_fixed())) else {
                continue;
            };
            self.static_transforms.insert(TransformStamped {
                stamp: transforms.header.stamp,
                frame_id: self.names.robot_frame(robot, parent).into(),
                child_frame_id: self.names.robot_frame(robot, child).into(),
                translation: transform.translation_m,
                rotation: transform.rotation_xyzw,
            });
        }
        self.send_static_transforms(sink);
    }

    /// Adds another publisher's transforms to those that never change, and publishes all of them if any is new.
    ///
    /// # Errors
    /// The payload is no tf2_msgs/TFMessage.
    pub fn receive_static_transforms(
        &mut self,
        payload: &[u8],
        sink: &mut impl TopicSink,
    ) -> Result<(), DecodeError> {
        let transforms = self.read_transforms(payload)?;
        let mut has_changed = false;
        for transform in transforms {
            has_changed |= self.static_transforms.insert(transform);
        }
        if has_changed {
            self.send_static_transforms(sink);
        }
        Ok(())
    }

    fn send_static_transforms(&self, sink: &mut impl TopicSink) {
        let transforms = self.static_transforms.transforms();
        sink.send(FleetTopic::StaticTransforms, None, |to| {
            to.count(transforms.len());
            transforms.iter().for_each(|transform| transform.write(to));
        });
    }

    /// Reads transforms, with the fleet's frames under the names that the fleet publishes. What SLAM and
    /// merging own is left out (REP-105).
    fn read_transforms(&self, payload: &[u8]) -> Result<Vec<TransformStamped>, DecodeError> {
        let mut transforms = Vec::new();
        read::transforms(&mut Reader::new(payload)?, |transform| {
            let (parent, child) = (transform.frame_id, transform.child_frame_id);
            if !self.robots.is_correction(parent, child) {
                let (translation, rotation) = self.published_pose(&transform);
                transforms.push(TransformStamped {
                    stamp: transform.stamp,
                    frame_id: self.published_name(parent),
                    child_frame_id: self.published_name(child),
                    translation,
                    rotation,
                });
            }
        })?;
        Ok(transforms)
    }

    /// Returns the pose that is published: a robot's `base_scan` is upright, as its published scans are.
    fn published_pose(&self, transform: &Transform<'_>) -> ([f64; 3], [f64; 4]) {
        let is_scan = matches!(
            self.robots.parse_frame(transform.child_frame_id),
            Some((_, FleetFrame::Robot(RobotFrame::BaseScan)))
        );
        let pose = SpatialPose::checked(transform.translation, transform.rotation).filter(|_| is_scan);
        pose.map_or((transform.translation, transform.rotation), |pose| pose.upright().parts())
    }

    /// Returns the name under which the fleet publishes a frame; another's name without its leading slash.
    fn published_name(&self, name: &str) -> String {
        let known = self.robots.parse_frame(name).filter(|(robot, _)| self.has(*robot));
        match known {
            Some((robot, FleetFrame::Robot(frame))) => self.names.robot_frame(robot, frame).into(),
            Some((robot, FleetFrame::Map)) => self.names.map(robot).into(),
            None => name.strip_prefix('/').unwrap_or(name).into(),
        }
    }
}
