//! The table of the fleet's processes: it drives the supervisor, telemetry, lockstep and ARCHITECTURE.md.

use msg::{RobotId, Role};
use std::fmt;
use std::time::Duration;

/// What a process that is started again begins from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestartInput {
    /// Nothing: the process finds what it needs in the run's folder.
    Folder,
    /// The robot's last pose in `world`.
    WorldFromBase,
    /// The last pose of `odom` in the robot's map, in case the session file is missing or damaged.
    MapFromOdom,
}

impl fmt::Display for RestartInput {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Folder => "what the run's folder or its runtime folder holds",
            Self::WorldFromBase => "the robot's last true pose (`--at`)",
            Self::MapFromOdom => "its session, else the last pose of `odom` in the map (`--at`)",
        })
    }
}

/// One row of the table.
#[derive(Clone, Copy, Debug)]
pub struct ProcessRow {
    /// The process's role; `mr-slam worker` followed by its name runs it.
    pub role: Role,
    /// Whether there is one for each robot or one for the fleet.
    pub per_robot: bool,
    /// Whether it runs only where the robots are simulated here.
    pub simulated_world_only: bool,
    /// Whether it runs only where the fleet is recorded.
    pub recording_only: bool,
    /// Whether it runs only where people, doors or boxes move in the simulated room.
    pub moving_objects_only: bool,
    /// What it begins from when it is started again.
    pub restart_input: RestartInput,
    /// Longest time without a pass of its main loop; then the supervisor judges whether it hangs.
    pub silence_max: Duration,
    /// Name of its second thread that the supervisor watches.
    pub second_thread: Option<&'static str>,
}

/// Loops wake at least once a second, for their health report.
const SILENCE_MAX: Duration = Duration::from_secs(2);
/// The bridge's loop wakes every 100 ms. Robots need its replacement to be stopped.
const BRIDGE_SILENCE_MAX: Duration = Duration::from_secs(1);

impl ProcessRow {
    /// Returns the process's name for people, such as `slam of robot1`.
    pub fn title(&self, robot: Option<RobotId>) -> String {
        match robot {
            Some(robot) => format!("{} of {robot}", self.role.name()),
            None => self.role.name().into(),
        }
    }
}

const OF_FLEET: ProcessRow = ProcessRow {
    role: Role::Bridge,
    per_robot: false,
    simulated_world_only: false,
    recording_only: false,
    moving_objects_only: false,
    restart_input: RestartInput::Folder,
    silence_max: SILENCE_MAX,
    second_thread: None,
};

/// All processes of a fleet. The supervisor starts the bridge first, then what the first map needs.
pub static PROCESSES: [ProcessRow; 8] = [
    ProcessRow {
        role: Role::Bridge,
        silence_max: BRIDGE_SILENCE_MAX,
        second_thread: Some("ROS 2"),
        ..OF_FLEET
    },
    ProcessRow { role: Role::Telemetry, second_thread: Some("maps"), ..OF_FLEET },
    ProcessRow { role: Role::Merge, second_thread: Some("pose graph"), ..OF_FLEET },
    ProcessRow { role: Role::Nav, ..OF_FLEET },
    ProcessRow {
        role: Role::Slam,
        per_robot: true,
        restart_input: RestartInput::MapFromOdom,
        second_thread: Some("back end"),
        ..OF_FLEET
    },
    ProcessRow {
        role: Role::Sim,
        per_robot: true,
        simulated_world_only: true,
        restart_input: RestartInput::WorldFromBase,
        ..OF_FLEET
    },
    ProcessRow { role: Role::Record, recording_only: true, ..OF_FLEET },
    ProcessRow { role: Role::Objects, simulated_world_only: true, moving_objects_only: true, ..OF_FLEET },
];

/// Every process of a fleet: those of the fleet, then robot by robot.
///
/// `external`: the robots are not simulated here. `recorded`: the fleet has a recorder. `has_moving_objects`: people, doors or boxes move
/// in the simulated room.
pub fn of_fleet(
    robots: usize,
    external: bool,
    recorded: bool,
    has_moving_objects: bool,
) -> impl Iterator<Item = (&'static ProcessRow, Option<RobotId>)> + use<> {
    let runs = move |row: &&ProcessRow| {
        !(row.simulated_world_only && external)
            && (recorded || !row.recording_only)
            && (has_moving_objects || !row.moving_objects_only)
    };
    let of_robot = move |robot| {
        let rows = PROCESSES.iter().filter(|row| row.per_robot).filter(runs);
        rows.map(move |row| (row, Some(robot)))
    };
    let of_fleet = PROCESSES.iter().filter(|row| !row.per_robot).filter(runs).map(|row| (row, None));
    of_fleet.chain(RobotId::first(robots).flat_map(of_robot))
}
