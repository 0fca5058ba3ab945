//! Names of the robots in ROS: of their topics, and of their frames on /tf and in headers.

use msg::{ROBOTS_MAX, RobotFrame, RobotId};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The frame of the fleet's merged map.
pub const MAP: &str = "map";
/// The longest name of a robot, bytes: it leaves space for topics in DDS's 255.
const NAME_BYTES_MAX: usize = 96;

/// How a frame's name carries its robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NameStyle {
    /// `base_link_1`. Unity's connector keeps frames by the last path element: with slashes all robots would share
    /// one `base_link`.
    #[default]
    Flat,
    /// `robot1/base_link`, which ROS tools group by robot.
    Slash,
}

/// Why a name is not accepted for a robot.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RobotNameError {
    /// The name is not a ROS name.
    #[error("'{name}' is no name of a robot; expected letters, digits and _, such as alice or lab/alice")]
    Invalid {
        /// The name as configured.
        name: String,
    },
    /// Two names would give the same topics or frames.
    #[error("'{name}' and '{other}' give the same frames; choose another name")]
    Twice {
        /// The second name.
        name: String,
        /// The first name.
        other: String,
    },
    /// Tools call another robot of the fleet so, by its number.
    #[error(
        "'{name}' is robot {number} here, and tools call another one so: keep the order robot1, robot2, ..., or choose another name"
    )]
    OtherNumber {
        /// The name as configured.
        name: String,
        /// The robot's number in the fleet.
        number: usize,
    },
    /// The empty name is for a robot alone.
    #[error("'' is the name of a fleet's only robot: its topics are /scan and /odom; name all robots")]
    EmptyInFleet,
    /// There are no names, or too many.
    #[error("{count} names; a fleet has 1 to {ROBOTS_MAX} robots")]
    Count {
        /// The number of names.
        count: usize,
    },
}

/// The robots' names in ROS, by [`RobotId::index`]: `robot1` makes `/robot1/scan`, `lab/alice` makes `/lab/alice/scan`.
///
/// The only robot of a fleet may have the empty name. Its topics and frames are then plain: `/scan`, `odom`, and `map`
/// for its map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RobotNames {
    names: Vec<String>,
}

impl From<usize> for RobotNames {
    /// Names the first robots `robot1`, `robot2` and so on; at least one, at most [`ROBOTS_MAX`].
    fn from(count: usize) -> Self {
        let count = count.clamp(1, ROBOTS_MAX);
        Self { names: RobotId::first(count).map(|robot| robot.to_string()).collect() }
    }
}

impl RobotNames {
    /// Checks the names of all robots of a fleet.
    pub fn new(names: Vec<String>) -> Result<Self, RobotNameError> {
        if !(1..=ROBOTS_MAX).contains(&names.len()) {
            return Err(RobotNameError::Count { count: names.len() });
        }
        for (index, name) in names.iter().enumerate() {
            if name.is_empty() && names.len() > 1 {
                return Err(RobotNameError::EmptyInFleet);
            }
            if !name.is_empty() && !is_valid(name) {
                return Err(RobotNameError::Invalid { name: name.clone() });
            }
            if let Some(other) = names[..index].iter().find(|other| suffix(other) == suffix(name)) {
                return Err(RobotNameError::Twice { name: name.clone(), other: other.clone() });
            }
        }
        for (robot, name) in RobotId::first(names.len()).zip(&names) {
            if RobotId::first(names.len()).any(|other| other != robot && other.to_string() == *name) {
                return Err(RobotNameError::OtherNumber { name: name.clone(), number: robot.number() });
            }
        }
        Ok(Self { names })
    }

    /// Returns the number of robots.
    pub fn count(&self) -> usize {
        self.names.len()
    }

    /// Returns the fleet's robots.
    pub fn robots(&self) -> impl Iterator<Item = RobotId> + use<> {
        RobotId::first(self.names.len())
    }

    /// Returns whether the fleet's only robot has plain topics and frames.
    pub fn is_plain(&self) -> bool {
        self.names[0].is_empty()
    }

    /// Returns the name of a robot's topic or service: `/robot1/scan` for `scan`.
    pub fn topic(&self, robot: RobotId, rest: &str) -> String {
        match self.names.get(robot.index()).map_or("", String::as_str) {
            "" => format!("/{rest}"),
            name => format!("/{name}/{rest}"),
        }
    }

    /// Returns the name of a robot's frame.
    fn frame(&self, style: NameStyle, robot: RobotId, frame: &str) -> String {
        let name = &self.names[robot.index()];
        match style {
            _ if name.is_empty() => frame.to_owned(),
            NameStyle::Flat => format!("{frame}_{}", suffix(name)),
            NameStyle::Slash => format!("{name}/{frame}"),
        }
    }

    /// Returns the robot and the frame that a name means, or `None` if it is not a frame of the fleet.
    ///
    /// `odom_2` and `robot2/odom` are accepted, and plain `odom` in a fleet of one. A numbered robot may be beyond the
    /// fleet.
    pub fn parse_frame(&self, name: &str) -> Option<(RobotId, FleetFrame)> {
        let name = name.strip_prefix('/').unwrap_or(name);
        let slash = || {
            let (robot, frame) = name.rsplit_once('/')?;
            Some((self.robot_named(robot)?, frame_called(frame)?))
        };
        let flat = || {
            let of_frame = |frame: FleetFrame| {
                let suffix = name.strip_prefix(frame.name())?.strip_prefix('_')?;
                Some((self.robot_with_suffix(suffix)?, frame))
            };
            FleetFrame::all().find_map(of_frame)
        };
        // Plain `map` is the merged map's frame.
        let alone =
            || Some((RobotId::new(1)?, frame_called(name).filter(|frame| *frame != FleetFrame::Map)?));
        slash().or_else(flat).or_else(|| alone().filter(|_| self.count() == 1))
    }

    /// Returns the frame of one robot that a name means in the robot's own messages, where it may be plain.
    pub fn parse_frame_of(&self, robot: RobotId, name: &str) -> Option<FleetFrame> {
        let plain = || frame_called(name.strip_prefix('/').unwrap_or(name));
        let named = self.parse_frame(name).filter(|(of, _)| *of == robot);
        named.map(|(_, frame)| frame).or_else(plain)
    }

    fn robot_named(&self, name: &str) -> Option<RobotId> {
        let beyond = || number(name.strip_prefix("robot")?).filter(|robot| self.is_beyond(*robot));
        self.find(|of| of == name).or_else(beyond)
    }

    fn robot_with_suffix(&self, text: &str) -> Option<RobotId> {
        let beyond = || number(text).filter(|robot| self.is_beyond(*robot));
        self.find(|of| !of.is_empty() && has_suffix(of, text)).or_else(beyond)
    }

    fn find(&self, is_wanted: impl Fn(&str) -> bool) -> Option<RobotId> {
        RobotId::new(1 + self.names.iter().position(|name| is_wanted(name))?)
    }

    fn is_beyond(&self, robot: RobotId) -> bool {
        robot.number() > self.count()
    }

    /// Returns whether a transform is `map` -> `odom`, which SLAM alone publishes (REP-105), or `map` -> `map_N`, which
    /// merging does, in any naming style.
    pub fn is_correction(&self, parent: &str, child: &str) -> bool {
        let is_plain = |name: &str, plain: &str| name.strip_prefix('/').unwrap_or(name) == plain;
        match self.parse_frame(child) {
            Some((_, frame)) => matches!(frame, FleetFrame::Map | FleetFrame::Robot(RobotFrame::Odom)),
            None => {
                let under_a_map =
                    is_plain(parent, MAP) || matches!(self.parse_frame(parent), Some((_, FleetFrame::Map)));
                is_plain(child, RobotFrame::Odom.name()) && under_a_map
            }
        }
    }
}

/// Returns whether a text is a ROS name: tokens of letters, digits and underscores, joined by slashes.
fn is_valid(name: &str) -> bool {
    let is_token = |token: &str| {
        let is_letter = |c: char| c.is_ascii_alphanumeric() || c == '_';
        token.starts_with(|c: char| c.is_ascii_alphabetic()) && token.chars().all(is_letter)
    };
    name.len() <= NAME_BYTES_MAX && !name.contains("__") && name.split('/').all(is_token)
}

/// Returns what follows a frame's name in the flat style: the number of `robot1`, otherwise the name.
fn suffix(name: &str) -> String {
    match name.strip_prefix("robot").and_then(number) {
        Some(robot) => robot.number().to_string(),
        None => name.replace('/', "_"),
    }
}

/// Returns whether a text is a robot's [`suffix`], without allocating.
fn has_suffix(name: &str, text: &str) -> bool {
    match name.strip_prefix("robot").and_then(number) {
        Some(robot) => number(text) == Some(robot),
        None => name.bytes().map(|byte| if byte == b'/' { b'_' } else { byte }).eq(text.bytes()),
    }
}

/// Parses the plain decimal number of a robot.
fn number(digits: &str) -> Option<RobotId> {
    let is_plain = digits.bytes().all(|byte| byte.is_ascii_digit()) && !digits.starts_with('0');
    RobotId::new(digits.parse().ok().filter(|_| is_plain)?)
}

/// The frame names of all robots, built once.
#[derive(Clone, Debug)]
pub struct FrameNames {
    robots: Vec<RobotFrames>,
}

#[derive(Clone, Debug)]
struct RobotFrames {
    map: String,
    frames: [String; RobotFrame::ALL.len()],
}

impl FrameNames {
    /// Builds the names in one style.
    pub fn new(style: NameStyle, names: &RobotNames) -> Self {
        let robot = |robot| RobotFrames {
            map: names.frame(style, robot, MAP),
            frames: RobotFrame::ALL.map(|frame| names.frame(style, robot, frame.name())),
        };
        Self { robots: names.robots().map(robot).collect() }
    }

    /// Returns the frame of one robot's own map: `map_1`. Panics for a robot beyond the fleet.
    pub fn map(&self, robot: RobotId) -> &str {
        &self.robots[robot.index()].map
    }

    /// Returns a frame of the robot's body: `base_scan_1`. Panics for a robot beyond the fleet.
    pub fn robot_frame(&self, robot: RobotId, frame: RobotFrame) -> &str {
        &self.robots[robot.index()].frames[frame as usize - 1]
    }
}

/// A frame of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetFrame {
    /// The robot's own map.
    Map,
    /// A part of the robot's body, or the origin of its odometry.
    Robot(RobotFrame),
}

impl FleetFrame {
    fn all() -> impl Iterator<Item = Self> {
        RobotFrame::ALL.into_iter().map(Self::Robot).chain([Self::Map])
    }

    fn name(self) -> &'static str {
        match self {
            Self::Map => MAP,
            Self::Robot(frame) => frame.name(),
        }
    }
}

fn frame_called(name: &str) -> Option<FleetFrame> {
    FleetFrame::all().find(|frame| frame.name() == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(names: &[&str]) -> Result<RobotNames, RobotNameError> {
        RobotNames::new(names.iter().map(|name| (*name).to_owned()).collect())
    }

    fn robot(number: usize) -> RobotId {
        RobotId::new(number).unwrap()
    }

    #[test]
    fn a_frame_is_parsed_in_every_style_and_other_names_are_not() {
        let fleets = [RobotNames::from(ROBOTS_MAX), named(&["alice", "lab/bob_2", "base"]).unwrap()];
        for names in &fleets {
            for style in [NameStyle::Flat, NameStyle::Slash] {
                for id in names.robots() {
                    for frame in FleetFrame::all() {
                        let name = names.frame(style, id, frame.name());
                        assert_eq!(names.parse_frame(&name), Some((id, frame)), "{name}");
                        assert_eq!(names.parse_frame(&format!("/{name}")), Some((id, frame)), "{name}");
                    }
                }
            }
        }
        let odom = Some((robot(1), FleetFrame::Robot(RobotFrame::Odom)));
        assert_eq!(RobotNames::from(1).parse_frame("odom"), odom);
        let three = RobotNames::from(3);
        assert_eq!(
            three.parse_frame("odom_7"),
            Some((robot(7), FleetFrame::Robot(RobotFrame::Odom))),
            "beyond"
        );
        for other in ["odom", "map", "base_link", "base_link_0", "robot1", "robot/odom", "odom_+1", "odom_"] {
            assert_eq!(three.parse_frame(other), None, "{other}");
        }
        assert_eq!(three.parse_frame(&format!("odom_{}", ROBOTS_MAX + 1)), None);
        assert_eq!(RobotNames::from(1).parse_frame("map"), None, "the merged map's");
    }

    #[test]
    fn a_robot_alone_may_have_plain_names() {
        let plain = named(&[""]).unwrap();
        assert_eq!(plain.topic(robot(1), "scan"), "/scan");
        let frames = FrameNames::new(NameStyle::Flat, &plain);
        let name_of = |frame| frames.robot_frame(robot(1), frame);
        assert_eq!(
            [RobotFrame::Odom, RobotFrame::BaseFootprint, RobotFrame::BaseScan].map(name_of),
            ["odom", "base_footprint", "base_scan"]
        );
        assert_eq!(frames.map(robot(1)), MAP);
        assert_eq!(plain.parse_frame("odom"), Some((robot(1), FleetFrame::Robot(RobotFrame::Odom))));
        assert!(plain.is_correction("map", "odom") && !plain.is_correction("odom", "base_footprint"));
    }

    #[test]
    fn names_that_are_no_ros_names_or_would_collide_are_refused() {
        assert_eq!(named(&["alice", "lab/bob"]).unwrap().topic(robot(2), "odom"), "/lab/bob/odom");
        for invalid in ["1st", "a b", "a//b", "/a", "a/", "ä", "a__b", &"x".repeat(97)] {
            let name = invalid.to_owned();
            assert_eq!(named(&["alice", invalid]), Err(RobotNameError::Invalid { name }));
        }
        assert!(matches!(named(&["a/b", "a_b"]), Err(RobotNameError::Twice { .. })));
        assert!(matches!(named(&["alice", "alice"]), Err(RobotNameError::Twice { .. })));
        // What tools call robot 2 has to be robot 2.
        assert!(matches!(named(&["robot2", "robot3"]), Err(RobotNameError::OtherNumber { number: 1, .. })));
        assert!(
            named(&["robot1", "robot2"]).is_ok()
                && named(&["alice", "robot2"]).is_ok()
                && named(&["robot7"]).is_ok()
        );
        assert_eq!(named(&["", "bob"]), Err(RobotNameError::EmptyInFleet));
        assert_eq!(named(&[]), Err(RobotNameError::Count { count: 0 }));
    }

    #[test]
    fn slams_transform_is_recognized_in_every_style() {
        let three = RobotNames::from(3);
        for (parent, child) in [
            ("map", "odom"),
            ("/map", "/odom"),
            ("map", "odom_2"),
            ("map_2", "odom_2"),
            ("robot2/map", "robot2/odom"),
            ("map_2", "odom"),
            ("anything", "odom_1"),
            ("map", "map_1"),
        ] {
            assert!(three.is_correction(parent, child), "{parent} -> {child}");
        }
        for (parent, child) in
            [("odom_1", "base_link_1"), ("world", "odom"), ("world", "map"), ("map", "table")]
        {
            assert!(!three.is_correction(parent, child), "{parent} -> {child}");
        }
    }
}
