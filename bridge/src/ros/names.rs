//! Names of the robots' frames on /tf and in headers.

use msg::{Link, ROBOTS_MAX, RobotId};
use serde::{Deserialize, Serialize};

/// The frame of the fleet's merged map.
pub const MAP: &str = "map";

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

impl NameStyle {
    /// Returns the name of one robot's frame.
    pub fn frame(self, robot: RobotId, frame: &str) -> String {
        match self {
            Self::Flat => format!("{frame}_{}", robot.number()),
            Self::Slash => format!("{robot}/{frame}"),
        }
    }
}

/// The frame names of all robots, built once.
#[derive(Clone, Debug)]
pub struct FrameNames {
    robots: Vec<RobotNames>,
}

#[derive(Clone, Debug)]
struct RobotNames {
    map: String,
    links: [String; Link::ALL.len()],
}

impl FrameNames {
    /// Builds the names in one style.
    pub fn new(style: NameStyle) -> Self {
        let robot = |robot| RobotNames {
            map: style.frame(robot, MAP),
            links: Link::ALL.map(|link| style.frame(robot, link.name())),
        };
        Self { robots: RobotId::first(ROBOTS_MAX).map(robot).collect() }
    }

    /// Returns the frame of one robot's own map: `map_1`.
    pub fn map(&self, robot: RobotId) -> &str {
        &self.robots[robot.index()].map
    }

    /// Returns a frame of the robot's body: `base_scan_1`.
    pub fn link(&self, robot: RobotId, link: Link) -> &str {
        &self.robots[robot.index()].links[link as usize - 1]
    }
}

/// A frame of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetFrame {
    /// The robot's own map.
    Map,
    /// A part of the robot's body, or the origin of its odometry.
    Link(Link),
}

/// Returns the robot and the frame that a name means, or `None` if it is not a frame of the fleet.
///
/// `odom_2` and `robot2/odom` are accepted, and plain `odom` in a fleet of one. The robot may be beyond the fleet.
pub fn parse_frame(name: &str, robot_count: usize) -> Option<(RobotId, FleetFrame)> {
    let name = name.strip_prefix('/').unwrap_or(name);
    let number = |digits: &str| {
        let plain = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
        RobotId::new(digits.parse().ok().filter(|_| plain)?)
    };
    let slash = || {
        let (robot, frame) = name.strip_prefix("robot")?.split_once('/')?;
        Some((number(robot)?, frame_called(frame)?))
    };
    let flat = || {
        let (frame, robot) = name.rsplit_once('_')?;
        Some((number(robot)?, frame_called(frame)?))
    };
    // Plain `map` is the merged map's frame.
    let alone = || Some((RobotId::new(1)?, frame_called(name).filter(|frame| *frame != FleetFrame::Map)?));
    slash().or_else(flat).or_else(|| alone().filter(|_| robot_count == 1))
}

fn frame_called(name: &str) -> Option<FleetFrame> {
    if name == MAP {
        return Some(FleetFrame::Map);
    }
    Link::ALL.into_iter().find(|link| link.name() == name).map(FleetFrame::Link)
}

/// Returns whether a transform is `map` -> `odom`, which SLAM alone publishes (REP-105), or `map` -> `map_N`, which
/// merging does, in any naming style.
pub fn is_correction(parent: &str, child: &str, robot_count: usize) -> bool {
    let is_plain = |name: &str, plain: &str| name.strip_prefix('/').unwrap_or(name) == plain;
    match parse_frame(child, robot_count) {
        Some((_, frame)) => matches!(frame, FleetFrame::Map | FleetFrame::Link(Link::Odom)),
        None => {
            let under_a_map = is_plain(parent, MAP)
                || matches!(parse_frame(parent, robot_count), Some((_, FleetFrame::Map)));
            is_plain(child, Link::Odom.name()) && under_a_map
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_is_parsed_in_every_style_and_other_names_are_not() {
        let robot = |number| RobotId::new(number).unwrap();
        for style in [NameStyle::Flat, NameStyle::Slash] {
            for id in RobotId::first(ROBOTS_MAX) {
                for link in Link::ALL {
                    let expected = Some((id, FleetFrame::Link(link)));
                    let name = style.frame(id, link.name());
                    assert_eq!(parse_frame(&name, 3), expected, "{name}");
                    assert_eq!(parse_frame(&format!("/{name}"), 3), expected, "{name}");
                }
                assert_eq!(parse_frame(&style.frame(id, MAP), 3), Some((id, FleetFrame::Map)));
            }
        }
        assert_eq!(parse_frame("odom", 1), Some((robot(1), FleetFrame::Link(Link::Odom))));
        for other in
            ["odom", "map", "base_link", "base_link_0", "base_link_17", "robot1", "robot/odom", "odom_+1"]
        {
            assert_eq!(parse_frame(other, 3), None, "{other}");
        }
        assert_eq!(parse_frame("map", 1), None, "the merged map's");
    }

    #[test]
    fn slams_transform_is_recognized_in_every_style() {
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
            assert!(is_correction(parent, child, 3), "{parent} -> {child}");
        }
        for (parent, child) in
            [("odom_1", "base_link_1"), ("world", "odom"), ("world", "map"), ("map", "table")]
        {
            assert!(!is_correction(parent, child, 3), "{parent} -> {child}");
        }
    }
}
