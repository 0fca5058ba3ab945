//! What a robot's frames are called on /tf and in headers.

use msg::{Link, ROBOTS_MAX, RobotId};
use serde::{Deserialize, Serialize};

/// The frame of the fleet's merged map.
pub const MAP: &str = "map";

/// How a robot is told apart in a frame's name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NameStyle {
    /// `base_link_1`. Unity's connector keys frames by the last path element: with slashes the robots would
    /// all share one `base_link`.
    #[default]
    Flat,
    /// `robot1/base_link`: what ROS tools group by.
    Slash,
}

impl NameStyle {
    /// The wire's name of one robot's frame.
    pub fn frame(self, robot: RobotId, frame: &str) -> String {
        match self {
            Self::Flat => format!("{frame}_{}", robot.number()),
            Self::Slash => format!("{robot}/{frame}"),
        }
    }
}

/// All frame names of the largest fleet, made once.
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
    /// In one style for all.
    pub fn new(style: NameStyle) -> Self {
        let robot = |robot| RobotNames {
            map: style.frame(robot, MAP),
            links: Link::ALL.map(|link| style.frame(robot, link.name())),
        };
        Self { robots: RobotId::first(ROBOTS_MAX).map(robot).collect() }
    }

    /// The frame of one robot's own map: `map_1`.
    pub fn map(&self, robot: RobotId) -> &str {
        &self.robots[robot.index()].map
    }

    /// A frame of the robot's body: `base_scan_1`.
    pub fn link(&self, robot: RobotId, link: Link) -> &str {
        &self.robots[robot.index()].links[link as usize - 1]
    }

    /// Who owns a frame that is a child on /tf: the frames no client may place.
    pub fn owner(&self, frame: &str) -> Option<RobotId> {
        let frame = frame.strip_prefix('/').unwrap_or(frame);
        RobotId::first(ROBOTS_MAX).find(|robot| {
            self.map(*robot) == frame || self.robots[robot.index()].links.iter().any(|n| n == frame)
        })
    }
}
