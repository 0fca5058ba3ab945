//! The transforms of an external world: the robots' own frames for the fleet's channels, and where their LiDARs are.

use super::checks::check_transform;
use super::{ExternalWorld, MessageContext, RobotTopic, SourceId, TransformError, WorldError, WorldMessage};
use msg::{RobotFrame, RobotFrameTransform, RobotId, Stamp, TRANSFORMS_MAX};
use ros_messages::cdr::Reader;
use ros_messages::names::FleetFrame;
use ros_messages::read::{self, Transform};
use ros_messages::spatial_pose::SpatialPose;

impl ExternalWorld {
    /// Takes transforms; `of`: all are this robot's.
    pub(super) fn receive_transforms(
        &mut self,
        context: &mut MessageContext<'_>,
        of: Option<RobotId>,
        from: &Reader<'_>,
    ) -> Result<(), WorldError> {
        // The whole message must be readable before any part of it is taken.
        read::transforms(&mut from.clone(), |_| {})?;
        self.transforms.iter_mut().for_each(|transforms| transforms.len = 0);
        let mut result = Ok(());
        read::transforms(&mut from.clone(), |transform| {
            self.mounts.trees.record(context.source, of, &transform);
            let taken = self.receive_transform(context, of, &transform);
            if result.is_ok() {
                result = taken;
            }
        })?;
        self.names.robots().for_each(|robot| self.send_transforms(robot));
        result
    }

    /// Takes transforms that never change; `of`: all are this robot's. They say where the LiDARs are mounted.
    pub(super) fn receive_static_transforms(
        &mut self,
        source: SourceId,
        of: Option<RobotId>,
        from: &Reader<'_>,
    ) -> Result<(), WorldError> {
        read::transforms(&mut from.clone(), |_| {})?;
        let trees = &mut self.mounts.trees;
        Ok(read::transforms(&mut from.clone(), |transform| trees.record(source, of, &transform))?)
    }

    /// Returns the robot and the two frames of a transform, `None` if it is not between the fleet's frames.
    fn fleet_frames(
        &self,
        of: Option<RobotId>,
        transform: &Transform<'_>,
    ) -> Result<Option<(RobotId, RobotFrame, RobotFrame)>, TransformError> {
        let robot_count = self.names.count();
        let parse = |name| match of {
            Some(robot) => self.names.parse_frame_of(robot, name).map(|frame| (robot, frame)),
            None => self.names.parse_frame(name),
        };
        let Some((robot, FleetFrame::Robot(child))) = parse(transform.child_frame_id) else {
            return Ok(None);
        };
        if robot.number() > robot_count {
            return Err(TransformError::NoSuchRobot { robot_count });
        }
        match parse(transform.frame_id) {
            Some((of, FleetFrame::Robot(parent))) if of == robot => Ok(Some((robot, parent, child))),
            // A LiDAR on a part that the fleet does not know: its mount is found along the whole chain.
            None if child == RobotFrame::BaseScan => Ok(None),
            _ => Err(TransformError::Parent { robot }),
        }
    }

    /// Takes one transform, if it is between the fleet's frames.
    fn receive_transform(
        &mut self,
        context: &mut MessageContext<'_>,
        of: Option<RobotId>,
        transform: &Transform<'_>,
    ) -> Result<(), WorldError> {
        let (parent, child) = (transform.frame_id, transform.child_frame_id);
        let own = of.and_then(|robot| self.names.parse_frame_of(robot, child));
        let is_own_odom = matches!(own, Some(FleetFrame::Map | FleetFrame::Robot(RobotFrame::Odom)));
        if is_own_odom || self.names.is_correction(parent, child) {
            return Err(WorldError::Correction { parent: parent.into(), child: child.into() });
        }
        let wrong = |source| WorldError::Transform { parent: parent.into(), child: child.into(), source };
        let Some((robot, parent_frame, child_frame)) = self.fleet_frames(of, transform).map_err(wrong)?
        else {
            if of.is_none() && self.is_unnamed_odometry(transform) {
                self.mounts.report_unnamed(parent, child, &self.names, &mut self.notices);
            }
            return Ok(());
        };
        self.check_source(context, robot)?;
        let mut parent_from_child = check_transform(parent_frame, child_frame, transform).map_err(wrong)?;
        if child_frame == RobotFrame::BaseScan {
            parent_from_child = upright(parent_from_child);
        }
        let stamp = context.clock.convert(transform.stamp, context.received)?;
        let state = &mut self.robots[robot.index()];
        state.source = Some((context.source, context.received));
        if parent_frame == RobotFrame::Odom
            && matches!(child_frame, RobotFrame::BaseFootprint | RobotFrame::BaseLink)
        {
            state.has_footprint |= child_frame == RobotFrame::BaseFootprint;
            if child_frame == RobotFrame::BaseFootprint || !state.has_footprint {
                state.last_transform = Some(context.received);
                if !self.is_of_one_publisher(context, robot, RobotTopic::OdometryTransform)? {
                    return self
                        .note_waiting(context, robot, transform.stamp, &parent_from_child, true)
                        .map_err(wrong);
                }
                self.send_odometry(context, robot, [transform.stamp, stamp], &parent_from_child, true)
                    .map_err(wrong)?;
            }
        }
        self.add_transform(robot, stamp, parent_from_child);
        Ok(())
    }

    /// Adds a transform to the robot's message; those of another stamp are sent first.
    fn add_transform(&mut self, robot: RobotId, stamp: Stamp, transform: RobotFrameTransform) {
        if self.transforms[robot.index()].len > 0 && self.transforms[robot.index()].header.stamp != stamp {
            self.send_transforms(robot);
        }
        let transforms = &mut self.transforms[robot.index()];
        transforms.header.stamp = stamp;
        if let Some(place) = transforms.transforms.get_mut((transforms.len as usize).min(TRANSFORMS_MAX)) {
            *place = transform;
            transforms.len += 1;
        }
    }

    /// Sends the robot's message, with the LiDAR's mount if it has the base but no LiDAR.
    pub(super) fn send_transforms(&mut self, robot: RobotId) {
        let transforms = &mut self.transforms[robot.index()];
        if transforms.len == 0 {
            return;
        }
        let has_scan = |known: &RobotFrameTransform| known.child_frame == RobotFrame::BaseScan as u32;
        let is_base = |known: &&RobotFrameTransform| known.parent_frame == RobotFrame::Odom as u32;
        let base = transforms.transforms().iter().find(is_base).map(|known| known.child_frame);
        if let Some(base) = base.filter(|_| !transforms.transforms().iter().any(has_scan))
            && let Some(scan) = self.mounts.transform(robot, base)
            && let Some(place) = transforms.transforms.get_mut(transforms.len as usize)
        {
            *place = scan;
            transforms.len += 1;
        }
        (self.sink)(WorldMessage::Transforms(robot, transforms));
        transforms.len = 0;
    }

    /// Returns whether a transform is odometry between frames that do not say which robot of several has them.
    fn is_unnamed_odometry(&self, transform: &Transform<'_>) -> bool {
        let any = RobotId::first(self.names.count()).next();
        let plain = |name| match self.names.parse_frame_of(any?, name)? {
            FleetFrame::Robot(frame) => Some(frame).filter(|_| self.names.parse_frame(name).is_none()),
            FleetFrame::Map => None,
        };
        let is_base =
            matches!(plain(transform.child_frame_id), Some(RobotFrame::BaseFootprint | RobotFrame::BaseLink));
        is_base && plain(transform.frame_id) == Some(RobotFrame::Odom)
    }
}

/// Returns the transform to a LiDAR's frame with the frame upright, as the scans in the fleet's channels are.
fn upright(transform: RobotFrameTransform) -> RobotFrameTransform {
    let Some(pose) = SpatialPose::checked(transform.translation_m, transform.rotation_xyzw) else {
        return transform;
    };
    let (translation_m, rotation_xyzw) = pose.upright().parts();
    RobotFrameTransform { translation_m, rotation_xyzw, ..transform }
}
