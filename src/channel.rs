//! The channels: who writes what to whom. One writer each, but for requests; a reader that falls behind loses the
//! oldest. Both ends open a channel through this table, so they cannot disagree.
//!
//! | channel | writer | readers |
//! |---|---|---|
//! | `robotK/command` | bridge | sim(k) |
//! | `robotK/scan` | sim(k) | slam(k), bridge |
//! | `robotK/odometry` | sim(k) | slam(k), bridge |
//! | `robotK/transforms` | sim(k) | bridge, telemetry |
//! | `robotK/truth` | sim(k) | telemetry, the other sims |
//! | `clock` | sim(1) | bridge |
//! | `robotK/correction` | slam(k) | merge, bridge, telemetry, launcher |
//! | `robotK/slam_request` | bridge, `mr-slam slam` | slam(k) |
//! | `robotK/slam_response` | slam(k) | bridge, `mr-slam slam` |
//! | `robotK/map` | slam(k) | merge, bridge, telemetry, launcher |
//! | `robotK/submap`, `robotK/submap_poses` | slam(k) | merge |
//! | `robotK/submap_request` | merge | slam(k) |
//! | `merged_map`, `map_transforms` | merge | bridge, telemetry, launcher |
//! | `merge_edges` | merge | bridge, launcher, `mr-slam edges` |
//! | `edge_command` | bridge, `mr-slam edges` | merge |
//! | `stats` | telemetry | bridge, launcher, `status` |
//! | `NAME/health` | each process | telemetry |
//!
//! Where the world is not simulated here, the bridge writes what the simulators else do, but for the truth.

use crate::shared_memory::MapWriter;
use msg::{
    Clock, Correction, EdgeCommand, FleetStats, GroundTruth, MapTransforms, MergeEdges, Message, Odometry,
    PatchHeader, ProcessHealth, ROBOTS_MAX, RobotId, Role, Scan, SlamRequest, SlamResponse, Submap,
    SubmapPoses, SubmapRequest, Transforms, VelocityCommand,
};
use std::marker::PhantomData;

/// One row of the table.
#[derive(Clone, Debug)]
pub struct Channel<T> {
    /// Unique in a run.
    pub name: String,
    /// Messages a reader may fall behind before it loses the oldest.
    pub depth: usize,
    /// Messages kept for a reader that comes late: 1 for what is state, 0 for what is a stream.
    pub history: usize,
    /// The most readers at a time.
    pub readers: usize,
    /// The most writers at a time.
    pub writers: usize,
    /// Whether a message wakes its readers, or waits until they look.
    pub wakes: bool,
    message: PhantomData<T>,
}

/// Readers of an ordinary channel: the table names at most four; the rest is for `status` and tools.
const READERS: usize = 8;
/// Merge, and somebody who looks.
const SUBMAP_READERS: usize = 2;
/// The bridge, and commands of people.
const ASKERS: usize = 8;

impl<T: Message> Channel<T> {
    fn stream(name: String, depth: usize) -> Self {
        Self { name, depth, history: 0, readers: READERS, writers: 1, wakes: true, message: PhantomData }
    }

    fn state(name: &str) -> Self {
        Self { history: 1, ..Self::stream(name.into(), 2) }
    }

    fn silent(self) -> Self {
        Self { wakes: false, ..self }
    }
}

/// Wished velocities. A second of a headset's 20 Hz fits twice.
pub fn command(robot: RobotId) -> Channel<VelocityCommand> {
    Channel::stream(format!("{robot}/command"), 32)
}

/// 10 Hz: 1.6 s of scans fit while SLAM is restarted or descheduled.
pub fn scan(robot: RobotId) -> Channel<Scan> {
    Channel::stream(format!("{robot}/scan"), 16)
}

/// 20 Hz; written before the scan of the same stamp, which is what wakes the reader.
pub fn odometry(robot: RobotId) -> Channel<Odometry> {
    Channel::stream(format!("{robot}/odometry"), 64).silent()
}

/// 20 Hz.
pub fn transforms(robot: RobotId) -> Channel<Transforms> {
    Channel::stream(format!("{robot}/transforms"), 32)
}

/// 100 Hz; readers look once per tick of their own.
pub fn truth(robot: RobotId) -> Channel<GroundTruth> {
    Channel { readers: READERS + ROBOTS_MAX, ..Channel::stream(format!("{robot}/truth"), 4).silent() }
}

/// 100 Hz.
pub fn clock() -> Channel<Clock> {
    Channel::stream("clock".into(), 32)
}

/// One for each scan.
pub fn correction(robot: RobotId) -> Channel<Correction> {
    Channel::stream(format!("{robot}/correction"), 32)
}

/// Now and then. The reader's numbers of lost messages mean nothing where there are several writers:
/// who asks sees that no answer comes.
pub fn slam_request(robot: RobotId) -> Channel<SlamRequest> {
    Channel { writers: ASKERS, ..Channel::stream(format!("{robot}/slam_request"), 16) }
}

/// One for each request; open it before asking.
pub fn slam_response(robot: RobotId) -> Channel<SlamResponse> {
    Channel::stream(format!("{robot}/slam_response"), 16)
}

/// New or changed, one each 100 ms at most. 0.26 MB each, so that few fit: who misses one asks.
pub fn submap(robot: RobotId) -> Channel<Submap> {
    Channel { readers: SUBMAP_READERS, ..Channel::stream(format!("{robot}/submap"), 8) }
}

/// With every node: the newest say all.
pub fn submap_poses(robot: RobotId) -> Channel<SubmapPoses> {
    Channel { readers: SUBMAP_READERS, ..Channel::state(&format!("{robot}/submap_poses")) }
}

/// When somebody lacks submaps.
pub fn submap_request(robot: RobotId) -> Channel<SubmapRequest> {
    Channel::stream(format!("{robot}/submap_request"), 2).silent()
}

/// What changed, when it did; whoever comes late asks for the whole.
pub fn map(robot: RobotId) -> Channel<PatchHeader> {
    patches(format!("{robot}/map"))
}

/// The same of the fleet's map.
pub fn merged_map() -> Channel<PatchHeader> {
    patches("merged_map".into())
}

/// Messages of a map's channel: four of [`MapWriter::MESSAGES_MAX`] that a reader may fall behind.
fn patches(name: String) -> Channel<PatchHeader> {
    Channel { history: 1, ..Channel::stream(name, 4 * MapWriter::MESSAGES_MAX) }
}

/// 1 Hz.
pub fn map_transforms() -> Channel<MapTransforms> {
    Channel::state("anchors").silent()
}

/// On change, and with each command's end.
pub fn merge_edges() -> Channel<MergeEdges> {
    Channel::state("merge_edges")
}

/// Now and then, from people.
pub fn edge_command() -> Channel<EdgeCommand> {
    Channel { writers: ASKERS, ..Channel::stream("edge_command".into(), 16) }
}

/// 1 Hz.
pub fn stats() -> Channel<FleetStats> {
    Channel::state("stats")
}

/// 1 Hz.
pub fn process_health(role: Role, robot: Option<RobotId>) -> Channel<ProcessHealth> {
    let name = match robot {
        Some(robot) => format!("{robot}/{}/health", role.name()),
        None => format!("{}/health", role.name()),
    };
    Channel::stream(name, 4).silent()
}
