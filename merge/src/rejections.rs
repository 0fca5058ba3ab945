//! Counts of messages that the fleet's pose graph has rejected, and what a person is told of them: each reason once for each robot.

use crate::SubmapRejected;
use msg::RobotId;
use std::fmt;

/// Kind of a message about submaps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SubmapMessage {
    /// Poses of a robot's submaps in its map, with the links between them.
    Poses,
    /// The cells of one submap.
    Submap,
}

impl fmt::Display for SubmapMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Poses => "poses of submaps",
            Self::Submap => "submap",
        })
    }
}

/// Messages of one robot that were rejected for one reason.
#[derive(Clone, Copy, Debug)]
struct RejectionCount {
    robot: RobotId,
    message: SubmapMessage,
    why: SubmapRejected,
    count: u64,
}

/// Counts of rejected messages by robot, kind and reason: as many entries as there are of these.
#[derive(Clone, Debug, Default)]
pub struct Rejections {
    counts: Vec<RejectionCount>,
}

impl Rejections {
    /// Counts a message if it was rejected. Returns a text for a person if it is the first of this robot, kind and reason.
    pub fn record(
        &mut self,
        robot: RobotId,
        message: SubmapMessage,
        result: Result<(), SubmapRejected>,
    ) -> Option<String> {
        let why = result.err()?;
        let is_same = |of: &&mut RejectionCount| (of.robot, of.message, of.why) == (robot, message, why);
        if let Some(known) = self.counts.iter_mut().find(is_same) {
            known.count += 1;
            return None;
        }
        self.counts.push(RejectionCount { robot, message, why, count: 1 });
        let next = match message {
            SubmapMessage::Poses => "its submaps stay where they were until it sends valid poses",
            SubmapMessage::Submap => {
                "it is missing in the graph that joins the maps, and is asked for again if its pose is known"
            }
        };
        Some(format!("a message of {robot} is not used ({message}): {why}; {next}; further ones are counted"))
    }

    /// Returns the number of rejected messages of all robots.
    pub fn total(&self) -> u64 {
        self.counts.iter().map(|of| of.count).sum()
    }

    /// Returns a line about each robot, kind and reason, with its count.
    pub fn summary(&self) -> impl Iterator<Item = String> + '_ {
        self.counts.iter().map(|RejectionCount { robot, message, why, count }| {
            format!("{count} messages of {robot} were not used ({message}): {why}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use SubmapMessage::{Poses, Submap};

    #[test]
    fn each_reason_is_told_once_for_each_robot_and_all_are_counted() {
        let [first, second] = [1, 2].map(|number| RobotId::new(number).unwrap());
        let mut rejections = Rejections::default();
        assert_eq!(rejections.record(first, Poses, Ok(())), None);
        assert_eq!((rejections.total(), rejections.summary().count()), (0, 0));
        for robot in [first, second] {
            for message in [Poses, Submap] {
                let rejected = Err(SubmapRejected::Malformed(robot));
                let text = rejections.record(robot, message, rejected).expect("the first one is told");
                assert!(text.contains(&robot.to_string()) && text.contains("invalid number"), "{text}");
                assert_eq!(rejections.record(robot, message, rejected), None);
            }
        }
        assert!(rejections.record(first, Poses, Err(SubmapRejected::UnknownRobot(first))).is_some());
        assert_eq!((rejections.total(), rejections.summary().count()), (9, 5));
        assert!(rejections.summary().any(|line| line.starts_with("2 messages of robot2")));
    }
}
