//! The table of channels. A new channel is one row here, one line in [`CHANNELS`], and one function that names it.

mod battery;
mod moving_objects;
mod navigation;
mod operator;
mod scan_demand;

pub use battery::battery;
pub use moving_objects::moving_objects;
pub use navigation::{
    base_velocity, exclusion_zones, exploration_state, explore, goal, hold, navigation_state,
    navigation_velocity, plan, zone_command,
};
pub use scan_demand::scan_demand;

use super::Endpoint::{External, Of, OfFirst, OfOthers, OtherMachines};
use super::Program::{EdgesTool, Launcher, LinkTool, RecordTool, SlamTool, Worker};
use super::{Channel, ChannelRow, Endpoint, Program, Scope, TypedRow};
use msg::{
    Clock, EdgeCommand, FleetStats, GroundTruth, MapTransforms, MergeEdges, Odometry, OperatorEvent,
    PatchHeader, PoseEstimate, ProcessHealth, ROBOTS_MAX, RobotId, Role, Scan, SlamRequest, SlamResponse,
    Submap, SubmapPoses, SubmapRequest, Transforms, VelocityCommand,
};

const SIM: Program = Worker(Role::Sim);
const SLAM: Program = Worker(Role::Slam);
const MERGE: Program = Worker(Role::Merge);
const TELEMETRY: Program = Worker(Role::Telemetry);
const BRIDGE: Program = Worker(Role::Bridge);
const NAV: Program = Worker(Role::Nav);
const RECORD: Program = Worker(Role::Record);
const OBJECTS: Program = Worker(Role::Objects);

/// Largest batch of messages of a map: with the pause between two batches, 26 MB a second.
pub const MAP_MESSAGES_MAX: usize = 4;
/// Readers of an ordinary channel: the table names at most eight; the bridge's second thread, `status` and tools are the rest.
const READERS_MAX: usize = 12;
/// Readers of submaps, whose messages are large: merge and one tool.
const SUBMAP_READERS_MAX: usize = 2;
/// Writers of requests: the bridge's two endpoints and commands of people.
const REQUEST_WRITERS_MAX: usize = 8;

/// A channel for each robot that wakes its readers and keeps nothing for late ones.
const STREAM: ChannelRow = ChannelRow {
    name: "",
    message: "",
    message_bytes: 0,
    scope: Scope::Robot,
    content: "",
    writers: &[],
    readers: &[],
    depth: 32,
    history: 0,
    readers_max: READERS_MAX,
    writers_max: 1,
    wakes: true,
};
/// A channel of the fleet that gives late readers the newest message.
const STATE: ChannelRow = ChannelRow { scope: Scope::Fleet, depth: 2, history: 1, ..STREAM };
/// A map's channel: readers may fall four batches of messages behind.
const MAP: ChannelRow = ChannelRow { history: 1, depth: 4 * MAP_MESSAGES_MAX, ..STREAM };

const SIM_OR_EXTERNAL: &[Endpoint] = &[Of(SIM), External(BRIDGE)];
/// Writers of what the link writes at the base, where the robots are on other machines.
const SIM_OR_EXTERNAL_OR_LINK: &[Endpoint] = &[Of(SIM), External(BRIDGE), OtherMachines(LinkTool)];
const SLAM_OR_LINK: &[Endpoint] = &[Of(SLAM), OtherMachines(LinkTool)];
const EVERYBODY: &[Endpoint] =
    &[Of(SIM), Of(SLAM), Of(MERGE), Of(TELEMETRY), Of(BRIDGE), Of(RECORD), Of(NAV), Of(OBJECTS)];

/// Who reads a robot's pose in its map, and the map.
const POSE_AND_MAP_READERS: &[Endpoint] = &[
    Of(MERGE),
    Of(TELEMETRY),
    Of(BRIDGE),
    Of(NAV),
    Of(Launcher),
    Of(RECORD),
    Of(RecordTool),
    OtherMachines(LinkTool),
];

static COMMAND: TypedRow<VelocityCommand> = TypedRow::new(ChannelRow {
    name: "command",
    content: "commanded velocity, 20 Hz while somebody drives",
    writers: &[Of(BRIDGE)],
    readers: &[Of(SIM), External(BRIDGE), Of(RECORD), Of(RecordTool), Of(Launcher), OtherMachines(LinkTool)],
    ..STREAM
});
static SCAN: TypedRow<Scan> = TypedRow::new(ChannelRow {
    name: "scan",
    content: "one LiDAR scan, 10 Hz",
    writers: SIM_OR_EXTERNAL_OR_LINK,
    readers: &[Of(SLAM), Of(BRIDGE), Of(NAV), Of(RECORD), Of(RecordTool), OtherMachines(LinkTool)],
    // The queue holds 1.6 s of scans while SLAM is restarted or descheduled.
    depth: 16,
    ..STREAM
});
// Several writers: each repeats its demand, so that a lost message costs nothing.
static ODOMETRY: TypedRow<Odometry> = TypedRow::new(ChannelRow {
    name: "odometry",
    content: "wheel odometry, 20 Hz, before the scan of the same stamp",
    writers: SIM_OR_EXTERNAL,
    readers: &[Of(SLAM), Of(BRIDGE), Of(RECORD), Of(RecordTool)],
    depth: 64,
    // The scan of the same stamp wakes the reader.
    wakes: false,
    ..STREAM
});
static TRANSFORMS: TypedRow<Transforms> = TypedRow::new(ChannelRow {
    name: "transforms",
    content: "the robot's own frames, 20 Hz",
    writers: SIM_OR_EXTERNAL_OR_LINK,
    readers: &[Of(TELEMETRY), Of(BRIDGE), Of(NAV), Of(RECORD), Of(RecordTool), OtherMachines(LinkTool)],
    ..STREAM
});
static TRUTH: TypedRow<GroundTruth> = TypedRow::new(ChannelRow {
    name: "truth",
    content: "the simulated pose, 100 Hz",
    writers: &[Of(SIM)],
    readers: &[OfOthers(SIM), Of(OBJECTS), Of(TELEMETRY), Of(Launcher), Of(RECORD), Of(RecordTool)],
    depth: 4,
    readers_max: READERS_MAX + ROBOTS_MAX,
    // Readers poll once in each tick of their own.
    wakes: false,
    ..STREAM
});
static CLOCK: TypedRow<Clock> = TypedRow::new(ChannelRow {
    name: "clock",
    content: "the run's time, 100 Hz",
    scope: Scope::Fleet,
    writers: &[OfFirst(SIM), External(BRIDGE), OtherMachines(LinkTool)],
    readers: &[Of(BRIDGE), Of(RECORD), Of(RecordTool)],
    ..STREAM
});
static POSE_ESTIMATE: TypedRow<PoseEstimate> = TypedRow::new(ChannelRow {
    name: "pose_estimate",
    content: "the pose in the robot's map, one for each scan",
    writers: SLAM_OR_LINK,
    readers: POSE_AND_MAP_READERS,
    ..STREAM
});
// Readers cannot count lost messages of several writers: a client notices a lost request by the missing answer.
static SLAM_REQUEST: TypedRow<SlamRequest> = TypedRow::new(ChannelRow {
    name: "slam_request",
    content: "a request to SLAM, on demand",
    writers: &[Of(BRIDGE), Of(SlamTool)],
    readers: &[Of(SLAM), Of(RECORD), Of(RecordTool)],
    depth: 16,
    writers_max: REQUEST_WRITERS_MAX,
    ..STREAM
});
static SLAM_RESPONSE: TypedRow<SlamResponse> = TypedRow::new(ChannelRow {
    name: "slam_response",
    content: "the answer to each request",
    writers: &[Of(SLAM)],
    readers: &[Of(BRIDGE), Of(SlamTool)],
    depth: 16,
    ..STREAM
});
static ROBOT_MAP: TypedRow<PatchHeader> = TypedRow::new(ChannelRow {
    name: "map",
    content: "changed tiles of the robot's map, at most 10 Hz",
    writers: SLAM_OR_LINK,
    readers: POSE_AND_MAP_READERS,
    ..MAP
});
static SUBMAP: TypedRow<Submap> = TypedRow::new(ChannelRow {
    name: "submap",
    content: "a new or changed submap, at most 10 Hz",
    writers: SLAM_OR_LINK,
    readers: &[Of(MERGE), OtherMachines(LinkTool)],
    // A message has 0.26 MB, so that the queue is short; a reader that lost one requests it.
    depth: 8,
    readers_max: SUBMAP_READERS_MAX,
    ..STREAM
});
static SUBMAP_POSES: TypedRow<SubmapPoses> = TypedRow::new(ChannelRow {
    name: "submap_poses",
    content: "poses of all submaps, with each node",
    scope: Scope::Robot,
    writers: SLAM_OR_LINK,
    readers: &[Of(MERGE), OtherMachines(LinkTool)],
    readers_max: SUBMAP_READERS_MAX,
    ..STATE
});
static SUBMAP_REQUEST: TypedRow<SubmapRequest> = TypedRow::new(ChannelRow {
    name: "submap_request",
    content: "a request for all submaps, when one is missing",
    writers: &[Of(MERGE), OtherMachines(LinkTool)],
    writers_max: 2,
    readers: &[Of(SLAM), OtherMachines(LinkTool)],
    depth: 2,
    wakes: false,
    ..STREAM
});
static MERGED_MAP: TypedRow<PatchHeader> = TypedRow::new(ChannelRow {
    name: "merged_map",
    content: "changed tiles of the fleet's map",
    scope: Scope::Fleet,
    writers: &[Of(MERGE)],
    readers: &[Of(TELEMETRY), Of(BRIDGE), Of(NAV), Of(Launcher), Of(RECORD), Of(RecordTool)],
    ..MAP
});
static MAP_TRANSFORMS: TypedRow<MapTransforms> = TypedRow::new(ChannelRow {
    name: "map_transforms",
    content: "where each robot's map lies in the fleet's, before each merged map",
    writers: &[Of(MERGE)],
    readers: &[Of(TELEMETRY), Of(BRIDGE), Of(NAV), Of(RECORD), Of(RecordTool), Of(Launcher)],
    wakes: false,
    ..STATE
});
static MERGE_EDGES: TypedRow<MergeEdges> = TypedRow::new(ChannelRow {
    name: "merge_edges",
    content: "relative pose and evidence of each pair of robots, on change",
    writers: &[Of(MERGE)],
    readers: &[Of(BRIDGE), Of(Launcher), Of(EdgesTool), Of(RECORD), Of(RecordTool)],
    ..STATE
});
static EDGE_COMMAND: TypedRow<EdgeCommand> = TypedRow::new(ChannelRow {
    name: "edge_command",
    content: "a person's command about an edge, on demand",
    scope: Scope::Fleet,
    writers: &[Of(BRIDGE), Of(EdgesTool)],
    readers: &[Of(MERGE), Of(RECORD), Of(RecordTool)],
    depth: 16,
    writers_max: REQUEST_WRITERS_MAX,
    ..STREAM
});
static STATS: TypedRow<FleetStats> = TypedRow::new(ChannelRow {
    name: "stats",
    content: "the fleet's figures, 1 Hz",
    writers: &[Of(TELEMETRY)],
    readers: &[Of(BRIDGE), Of(Launcher), Of(RECORD), Of(RecordTool)],
    ..STATE
});
static HEALTH: TypedRow<ProcessHealth> = TypedRow::new(ChannelRow {
    name: "health",
    content: "a process's own counters, 1 Hz",
    scope: Scope::Process,
    writers: EVERYBODY,
    readers: &[Of(TELEMETRY)],
    depth: 4,
    wakes: false,
    ..STREAM
});

/// All channels of a fleet, in the order of the data flow.
pub static CHANNELS: [&ChannelRow; 33] = [
    &COMMAND.row,
    &SCAN.row,
    &scan_demand::SCAN_DEMAND.row,
    &ODOMETRY.row,
    &battery::BATTERY.row,
    &TRANSFORMS.row,
    &TRUTH.row,
    &moving_objects::MOVING_OBJECTS.row,
    &CLOCK.row,
    &POSE_ESTIMATE.row,
    &SLAM_REQUEST.row,
    &SLAM_RESPONSE.row,
    &ROBOT_MAP.row,
    &SUBMAP.row,
    &SUBMAP_POSES.row,
    &SUBMAP_REQUEST.row,
    &MERGED_MAP.row,
    &MAP_TRANSFORMS.row,
    &MERGE_EDGES.row,
    &EDGE_COMMAND.row,
    &operator::OPERATOR_EVENT.row,
    &navigation::GOAL.row,
    &navigation::NAVIGATION_VELOCITY.row,
    &navigation::BASE_VELOCITY.row,
    &navigation::HOLD.row,
    &navigation::NAVIGATION_STATE.row,
    &navigation::PLAN.row,
    &navigation::EXPLORE.row,
    &navigation::EXPLORATION_STATE.row,
    &navigation::ZONE_COMMAND.row,
    &navigation::EXCLUSION_ZONES.row,
    &STATS.row,
    &HEALTH.row,
];

/// `robotK/command`: the velocity that a person or a program wants the robot to drive.
pub fn command(robot: RobotId) -> Channel<VelocityCommand> {
    COMMAND.of_robot(robot)
}

/// `robotK/scan`: one scan of the robot's LiDAR.
pub fn scan(robot: RobotId) -> Channel<Scan> {
    SCAN.of_robot(robot)
}

/// `robotK/odometry`: wheel odometry, before the scan of the same stamp.
pub fn odometry(robot: RobotId) -> Channel<Odometry> {
    ODOMETRY.of_robot(robot)
}

/// `robotK/transforms`: the robot's own frames.
pub fn transforms(robot: RobotId) -> Channel<Transforms> {
    TRANSFORMS.of_robot(robot)
}

/// `robotK/truth`: the simulated pose, to measure errors with.
pub fn truth(robot: RobotId) -> Channel<GroundTruth> {
    TRUTH.of_robot(robot)
}

/// `clock`: the run's time.
pub fn clock() -> Channel<Clock> {
    CLOCK.of_fleet()
}

/// `robotK/pose_estimate`: SLAM's pose in the robot's map, one for each scan.
pub fn pose_estimate(robot: RobotId) -> Channel<PoseEstimate> {
    POSE_ESTIMATE.of_robot(robot)
}

/// `robotK/slam_request`: requests of people and programs to the robot's SLAM.
pub fn slam_request(robot: RobotId) -> Channel<SlamRequest> {
    SLAM_REQUEST.of_robot(robot)
}

/// `robotK/slam_response`: SLAM's answers; open it before sending a request.
pub fn slam_response(robot: RobotId) -> Channel<SlamResponse> {
    SLAM_RESPONSE.of_robot(robot)
}

/// `robotK/map`: changed tiles of the robot's map; a reader that comes late asks for the whole map.
pub fn map(robot: RobotId) -> Channel<PatchHeader> {
    ROBOT_MAP.of_robot(robot)
}

/// `robotK/submap`: new and changed submaps, for merging.
pub fn submap(robot: RobotId) -> Channel<Submap> {
    SUBMAP.of_robot(robot)
}

/// `robotK/submap_poses`: poses of all submaps in the robot's map.
pub fn submap_poses(robot: RobotId) -> Channel<SubmapPoses> {
    SUBMAP_POSES.of_robot(robot)
}

/// `robotK/submap_request`: merging asks SLAM for all submaps because one is missing.
pub fn submap_request(robot: RobotId) -> Channel<SubmapRequest> {
    SUBMAP_REQUEST.of_robot(robot)
}

/// `merged_map`: changed tiles of the fleet's map; a reader that comes late asks for the whole map.
pub fn merged_map() -> Channel<PatchHeader> {
    MERGED_MAP.of_fleet()
}

/// `map_transforms`: where each robot's map lies in the fleet's map.
pub fn map_transforms() -> Channel<MapTransforms> {
    MAP_TRANSFORMS.of_fleet()
}

/// `merge_edges`: relative pose and evidence of every pair of robots' maps.
pub fn merge_edges() -> Channel<MergeEdges> {
    MERGE_EDGES.of_fleet()
}

/// `edge_command`: a person's command about a merge edge, such as pin or undo.
pub fn edge_command() -> Channel<EdgeCommand> {
    EDGE_COMMAND.of_fleet()
}

/// `operator_event`: what operators did beside velocities, goals and requests, for the record.
pub fn operator_event() -> Channel<OperatorEvent> {
    operator::OPERATOR_EVENT.of_fleet()
}

/// `stats`: the fleet's figures from telemetry.
pub fn stats() -> Channel<FleetStats> {
    STATS.of_fleet()
}

/// `ROLE/health` of a process of the fleet, `robotK/ROLE/health` of a robot's process.
pub fn process_health(role: Role, robot: Option<RobotId>) -> Channel<ProcessHealth> {
    let name = match robot {
        Some(robot) => format!("{robot}/{}/{}", role.name(), HEALTH.row.name),
        None => format!("{}/{}", role.name(), HEALTH.row.name),
    };
    HEALTH.channel(robot, name)
}
