//! The table of what leaves a machine: its direction, its urgency, and whether only the newest counts.

/// Way of a message between a robot's machine and the base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the robot to the base.
    Up,
    /// From the base to the robot.
    Down,
}

impl Direction {
    /// Returns the direction's part of a key expression.
    pub fn name(self) -> &'static str {
        match self {
            Self::Up => "up",
            Self::Down => "down",
        }
    }
}

/// Urgency of a message; the most urgent comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Priority {
    /// Velocities, the emergency stop, and signs of life.
    Command,
    /// Poses and transforms of robots.
    Pose,
    /// Parts of maps and their acknowledgements.
    Map,
    /// Scans, for those who look.
    Scan,
}

impl Priority {
    /// All priorities, the most urgent first.
    pub const ALL: [Self; 4] = [Self::Command, Self::Pose, Self::Map, Self::Scan];

    /// Returns the priority's part of a key expression.
    pub fn name(self) -> &'static str {
        match self {
            Self::Command => "command",
            Self::Pose => "pose",
            Self::Map => "map",
            Self::Scan => "scan",
        }
    }
}

/// What happens to a message that waits when the next one of its kind comes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Waiting {
    /// It is dropped, because only the newest counts.
    NewestWins,
    /// It stays; its sender sends it again if it is not acknowledged.
    Acknowledged,
}

/// Kind of a message between machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Kind {
    /// Sign of life of a robot, and whether it knows what the base holds.
    RobotState = 1,
    /// Pose in the robot's map, from channel `pose_estimate`.
    PoseEstimate = 2,
    /// Frames of the robot, from channel `transforms`.
    Transforms = 3,
    /// Piece of a part of the robot's map.
    Chunk = 4,
    /// Scan with few beams, from channel `scan`, while the base asks for it.
    Scan = 5,
    /// State of the robot's battery, from channel `battery`.
    Battery = 6,
    /// Sign of life of the base, and whether its emergency stop is set.
    BaseState = 16,
    /// Velocity that the base has let pass.
    Velocity = 17,
    /// Page of the list of parts that the base holds.
    Held = 18,
    /// Parts that have arrived.
    Acknowledgement = 19,
}

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Kind of the message.
    pub kind: Kind,
    /// Direction in which it goes.
    pub direction: Direction,
    /// Urgency of the message.
    pub priority: Priority,
    /// Fate of a message that waits when the next one comes.
    pub waiting: Waiting,
    /// Name in tables of bytes.
    pub name: &'static str,
}

/// All that crosses between machines. Ground truth, and whatever else is not here, stays on its machine.
pub static TABLE: [Row; 10] = [
    row(Kind::BaseState, Direction::Down, Priority::Command, Waiting::NewestWins, "base state"),
    row(Kind::Velocity, Direction::Down, Priority::Command, Waiting::NewestWins, "velocity"),
    row(Kind::RobotState, Direction::Up, Priority::Command, Waiting::NewestWins, "robot state"),
    row(Kind::PoseEstimate, Direction::Up, Priority::Pose, Waiting::NewestWins, "pose_estimate"),
    row(Kind::Transforms, Direction::Up, Priority::Pose, Waiting::NewestWins, "transforms"),
    row(Kind::Battery, Direction::Up, Priority::Pose, Waiting::NewestWins, "battery"),
    row(Kind::Chunk, Direction::Up, Priority::Map, Waiting::Acknowledged, "map"),
    row(Kind::Held, Direction::Down, Priority::Map, Waiting::Acknowledged, "held parts"),
    row(Kind::Acknowledgement, Direction::Down, Priority::Map, Waiting::Acknowledged, "acknowledgement"),
    row(Kind::Scan, Direction::Up, Priority::Scan, Waiting::NewestWins, "scan"),
];

const fn row(
    kind: Kind,
    direction: Direction,
    priority: Priority,
    waiting: Waiting,
    name: &'static str,
) -> Row {
    Row { kind, direction, priority, waiting, name }
}

impl Kind {
    /// Decodes a kind; `None` for an unknown code.
    pub fn from_code(code: u8) -> Option<Self> {
        TABLE.iter().map(|row| row.kind).find(|kind| *kind as u8 == code)
    }

    /// Returns the kind's row of the table.
    pub fn row(self) -> &'static Row {
        let index = match self {
            Self::BaseState => 0,
            Self::Velocity => 1,
            Self::RobotState => 2,
            Self::PoseEstimate => 3,
            Self::Transforms => 4,
            Self::Battery => 5,
            Self::Chunk => 6,
            Self::Held => 7,
            Self::Acknowledgement => 8,
            Self::Scan => 9,
        };
        &TABLE[index]
    }
}

/// First element of every key expression.
pub const KEY_PREFIX: &str = "mr-slam";

/// Returns the key expression of a robot's messages of one direction and urgency, such as `mr-slam/robot1/up/map`.
pub fn key(robot: &str, direction: Direction, priority: Priority) -> String {
    format!("{KEY_PREFIX}/{robot}/{}/{}", direction.name(), priority.name())
}

/// Returns the key expression of all of a robot's messages of one direction, for subscriptions and access lists.
pub fn keys(robot: &str, direction: Direction) -> String {
    format!("{KEY_PREFIX}/{robot}/{}/*", direction.name())
}

/// Returns the key expression of the urgent messages of all robots, those included that a base does not have.
pub fn all_robots_key() -> String {
    key("**", Direction::Up, Priority::Command)
}

/// Returns the name of the robot that has sent urgent messages with this key; `None` for other keys.
pub fn robot_of_key(key: &str) -> Option<&str> {
    let end = format!("/{}/{}", Direction::Up.name(), Priority::Command.name());
    key.strip_prefix(KEY_PREFIX)?.strip_prefix('/')?.strip_suffix(end.as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_its_row() {
        for row in &TABLE {
            assert_eq!(row.kind.row().kind, row.kind);
            assert_eq!(Kind::from_code(row.kind as u8), Some(row.kind));
        }
        assert_eq!(Kind::from_code(0), None);
    }

    #[test]
    fn no_robots_key_is_within_another_robots() {
        assert_eq!(key("robot1", Direction::Up, Priority::Map), "mr-slam/robot1/up/map");
        assert_eq!(keys("robot1", Direction::Down), "mr-slam/robot1/down/*");
        for name in ["robot1", "lab/bob"] {
            assert_eq!(robot_of_key(&key(name, Direction::Up, Priority::Command)), Some(name));
            assert_eq!(robot_of_key(&key(name, Direction::Down, Priority::Command)), None);
        }
    }
}
