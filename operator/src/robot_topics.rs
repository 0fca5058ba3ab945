//! The robots' topics by their names in ROS.

use bridge::RobotNames;
use msg::{ROBOTS_MAX, RobotId};

/// Names of a fleet's robots, and the beginnings of their topics' names.
#[derive(Clone, Debug)]
pub struct RobotTopics {
    names: RobotNames,
    /// `/robot1/` and so on, by [`RobotId::index`].
    prefixes: Vec<String>,
}

impl Default for RobotTopics {
    /// Returns the topics of `robot1`, `robot2` and so on, as many as a fleet may have.
    fn default() -> Self {
        Self::new(ROBOTS_MAX.into())
    }
}

impl RobotTopics {
    /// Returns the topics of robots with these names.
    pub fn new(names: RobotNames) -> Self {
        let prefixes = names.robots().map(|robot| names.topic(robot, "")).collect();
        Self { names, prefixes }
    }

    /// Returns the robots' names.
    pub fn names(&self) -> &RobotNames {
        &self.names
    }

    /// Splits a robot's topic: `/robot2/scan` is `scan` of robot 2.
    pub fn split<'a>(&self, topic: &'a str) -> Option<(RobotId, &'a str)> {
        let mut robots = self.names.robots().zip(&self.prefixes);
        robots.find_map(|(robot, prefix)| {
            // A robot `lab` beside a robot `lab/bob` has no topic `bob/scan`.
            let rest = topic.strip_prefix(prefix.as_str()).filter(|rest| !rest.contains('/'))?;
            Some((robot, rest))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(number: usize) -> RobotId {
        RobotId::new(number).unwrap()
    }

    #[test]
    fn a_topic_names_its_robot() {
        let topics = RobotTopics::default();
        assert_eq!(topics.split("/robot2/scan"), Some((robot(2), "scan")));
        assert_eq!(topics.split("/robot64/map"), Some((robot(64), "map")));
        assert_eq!(topics.split("/robot65/map"), None);
        assert_eq!(topics.split("/robot/map"), None);
        assert_eq!(topics.split("/merged_map"), None);
    }

    #[test]
    fn robots_have_any_names_and_namespaces() {
        let names =
            |names: &[&str]| RobotNames::new(names.iter().map(|name| (*name).into()).collect()).unwrap();
        let topics = RobotTopics::new(names(&["lab", "lab/bob"]));
        assert_eq!(topics.split("/lab/scan"), Some((robot(1), "scan")));
        assert_eq!(topics.split("/lab/bob/scan"), Some((robot(2), "scan")));
        assert_eq!(topics.split("/robot1/scan"), None);
        assert_eq!(RobotTopics::new(names(&[""])).split("/scan"), Some((robot(1), "scan")));
    }
}
