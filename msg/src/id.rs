//! Identity of a robot in the fleet.

use core::fmt;

/// Number of robots in the largest fleet. Arrays over robots have this length, so a [`RobotId`] always fits.
pub const ROBOTS_MAX: usize = 64;

/// Number of a robot, 1 to [`ROBOTS_MAX`], as topics and people count them (`robot1`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RobotId(u8);

impl RobotId {
    /// Checks a robot's number; `None` unless `1 <= number <= ROBOTS_MAX`.
    pub const fn new(number: usize) -> Option<Self> {
        if number >= 1 && number <= ROBOTS_MAX { Some(Self(number as u8)) } else { None }
    }

    /// Iterates over the first `count` robots, at most [`ROBOTS_MAX`].
    pub fn first(count: usize) -> impl Iterator<Item = Self> + Clone {
        (1..=count.min(ROBOTS_MAX)).map(|n| Self(n as u8))
    }

    /// Returns the robot's number: 1 for `robot1`.
    pub const fn number(self) -> usize {
        self.0 as usize
    }

    /// Returns the robot's index in an array over robots: 0 for `robot1`.
    pub const fn index(self) -> usize {
        self.0 as usize - 1
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "robot{}", self.0)
    }
}
