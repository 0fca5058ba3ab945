//! The frames that external robots call `odom`, as their own messages say, so that map -> odom joins their trees.

use crate::input::InputPurpose;
use msg::{RobotFrame, RobotId};
use ros_messages::RobotNames;
use ros_messages::cdr::Reader;
use ros_messages::names::FleetFrame;
use ros_messages::read::{self, Transform};

/// The longest frame name that is kept, bytes.
const NAME_BYTES_MAX: usize = 256;

/// What one robot's messages say about its frame `odom`.
#[derive(Clone, Debug, PartialEq, Eq)]
struct OdomFrame {
    name: String,
    source: Source,
}

/// The message that names the frame; a later one counts more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Source {
    /// nav_msgs/Odometry: the robot may publish no transforms.
    Odometry,
    /// The topic `/tf` of all robots.
    Transforms,
    /// The robot's own topic `/robotN/tf`.
    OwnTransforms,
}

/// The frames of all robots, once their messages have named them.
#[derive(Debug)]
pub struct OdomFrames {
    robots: Vec<Option<OdomFrame>>,
}

impl OdomFrames {
    /// Creates the frames of a fleet, all unknown.
    pub fn new(robot_count: usize) -> Self {
        Self { robots: vec![None; robot_count] }
    }

    /// Takes the frames' names from a robot's message. What cannot be read names nothing.
    pub fn learn(&mut self, names: &RobotNames, input: InputPurpose, payload: &[u8]) {
        let Ok(mut from) = Reader::new(payload) else { return };
        match input {
            InputPurpose::Odometry(robot) => {
                if let Ok(odometry) = read::odometry(&mut from) {
                    self.set(robot, odometry.frame_id, Source::Odometry);
                }
            }
            InputPurpose::Transforms => {
                let _ = read::transforms(&mut from, |transform| {
                    if let Some(robot) = robot_of_odometry(names, &transform) {
                        self.set(robot, transform.frame_id, Source::Transforms);
                    }
                });
            }
            InputPurpose::RobotTransforms(robot) => {
                let _ = read::transforms(&mut from, |transform| {
                    let frame = |name| names.parse_frame_of(robot, name);
                    if is_odometry(frame(transform.frame_id), frame(transform.child_frame_id)) {
                        self.set(robot, transform.frame_id, Source::OwnTransforms);
                    }
                });
            }
            _ => {}
        }
    }

    fn set(&mut self, robot: RobotId, name: &str, source: Source) {
        let Some(known) = self.robots.get_mut(robot.index()) else { return };
        let is_new = known
            .as_ref()
            .is_none_or(|known| source > known.source || (source == known.source && known.name != name));
        if is_new && !name.is_empty() && name.len() <= NAME_BYTES_MAX {
            *known = Some(OdomFrame { name: name.to_owned(), source });
        }
    }

    /// Returns the robot's frame `odom`, and whether the transform to it belongs on the robot's own `/robotN/tf`.
    ///
    /// It does if the robot publishes there, or if other robots call theirs the same: on `/tf` they would collide.
    pub fn of(&self, robot: RobotId) -> Option<(&str, bool)> {
        let frame = self.robots.get(robot.index())?.as_ref()?;
        let is_shared = self.robots.iter().flatten().filter(|other| other.name == frame.name).count() > 1;
        Some((&frame.name, frame.source == Source::OwnTransforms || is_shared))
    }
}

/// Returns the robot whose odometry a transform on `/tf` is.
fn robot_of_odometry(names: &RobotNames, transform: &Transform<'_>) -> Option<RobotId> {
    let (robot, child) = names.parse_frame(transform.child_frame_id)?;
    let (of_parent, parent) = names.parse_frame(transform.frame_id)?;
    (of_parent == robot && is_odometry(Some(parent), Some(child))).then_some(robot)
}

fn is_odometry(parent: Option<FleetFrame>, child: Option<FleetFrame>) -> bool {
    let bases = [RobotFrame::BaseFootprint, RobotFrame::BaseLink].map(|frame| Some(FleetFrame::Robot(frame)));
    parent == Some(FleetFrame::Robot(RobotFrame::Odom)) && bases.contains(&child)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros_messages::{Odometry, TfMessage, TransformStamped, encode};

    fn robot(number: usize) -> RobotId {
        RobotId::new(number).unwrap()
    }

    fn odometry(frame: &str) -> Vec<u8> {
        let mut out = Vec::new();
        encode(&Odometry { frame_id: frame.into(), ..Odometry::default() }, &mut out);
        out
    }

    fn transform(parent: &str, child: &str) -> Vec<u8> {
        let transform = TransformStamped {
            frame_id: parent.into(),
            child_frame_id: child.into(),
            ..TransformStamped::default()
        };
        let mut out = Vec::new();
        encode(&TfMessage { transforms: vec![transform] }, &mut out);
        out
    }

    #[test]
    fn stock_frames_of_several_robots_belong_on_their_own_topics() {
        let names = RobotNames::from(3);
        let mut frames = OdomFrames::new(3);
        assert_eq!(frames.of(robot(1)), None);
        frames.learn(&names, InputPurpose::Odometry(robot(1)), &odometry("odom"));
        assert_eq!(frames.of(robot(1)), Some(("odom", false)), "no other robot has it");
        frames.learn(&names, InputPurpose::RobotTransforms(robot(2)), &transform("odom", "base_footprint"));
        assert_eq!(frames.of(robot(1)), Some(("odom", true)));
        assert_eq!(frames.of(robot(2)), Some(("odom", true)));
        frames.learn(&names, InputPurpose::Transforms, &transform("robot3/odom", "robot3/base_link"));
        assert_eq!(frames.of(robot(3)), Some(("robot3/odom", false)));
    }

    #[test]
    fn transforms_count_more_than_odometry_and_other_frames_are_ignored() {
        let names = RobotNames::from(1);
        let mut frames = OdomFrames::new(1);
        frames.learn(&names, InputPurpose::Transforms, &transform("odom_1", "base_footprint_1"));
        frames.learn(&names, InputPurpose::Odometry(robot(1)), &odometry("odom"));
        frames.learn(&names, InputPurpose::Transforms, &transform("map", "odom_1"));
        frames.learn(&names, InputPurpose::Transforms, &transform("base_footprint_1", "base_link_1"));
        frames.learn(&names, InputPurpose::Transforms, b"junk");
        assert_eq!(frames.of(robot(1)), Some(("odom_1", false)));
    }
}
