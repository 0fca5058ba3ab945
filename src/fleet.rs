//! What a configuration makes of the world: the room, and where and when each robot begins. The
//! processes and the lockstep fleet both build their robots from this.

use crate::clock::Epoch;
use crate::config::{FleetConfig, LABORATORY};
use crate::sessions::{self, SessionsError};
use msg::{Pose2, RobotId, Stamp};
use sim::{Room, Simulator};
use std::io::Read;
use std::path::Path;
use std::time::Duration;

/// Why a world cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum FleetError {
    /// The room's file.
    #[error("room {path}: {why}")]
    Room {
        /// The file.
        path: String,
        /// What is wrong with it.
        why: String,
    },
    /// A robot cannot start where it should.
    #[error("{robot} cannot start: {why}")]
    Start {
        /// Which.
        robot: RobotId,
        /// What is in the way.
        why: String,
    },
    /// What the fleet is to begin with.
    #[error(transparent)]
    Sessions(#[from] SessionsError),
}

/// The largest file that is read as a room.
const ROOM_BYTES_MAX: u64 = 256 << 20;

/// Loads the configured room.
pub fn room(config: &FleetConfig) -> Result<Room, FleetError> {
    let path = config.fleet.room.as_str();
    if path == LABORATORY {
        return Ok(Room::laboratory());
    }
    let wrong = |why: String| FleetError::Room { path: path.into(), why };
    let mut file = std::fs::File::open(path).map_err(|why| {
        wrong(format!("{why}; expected `{LABORATORY}` or a .json, .json.gz, .glb, .gltf or .obj file"))
    })?;
    let mut bytes = Vec::new();
    file.by_ref().take(ROOM_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(|why| wrong(why.to_string()))?;
    if bytes.len() as u64 > ROOM_BYTES_MAX {
        return Err(wrong(format!("is larger than {} MB", ROOM_BYTES_MAX >> 20)));
    }
    let name = Path::new(path).file_name().map_or_else(|| path.into(), |name| name.to_string_lossy());
    Room::from_bytes(&name, &bytes).map_err(|why| wrong(why.to_string()))
}

/// Where each robot starts: `world` from its `robotK/map`, which begins there.
pub fn starts(config: &FleetConfig, room: &Room) -> Result<Vec<Pose2>, FleetError> {
    match config.configured_starts() {
        Some(starts) => Ok(starts),
        None => room
            .starts(config.fleet.robots)
            .map_err(|why| FleetError::Room { path: config.fleet.room.clone(), why: why.to_string() }),
    }
}

/// Where each robot's map lies in the fleet's from the start, as far as merging is told. Where it is told nothing (the
/// file says so, or a world outside shows no room to choose places in), the fleet's map is the first robot's, and the
/// others' places are to be found. Where the fleet begins with sessions, their maps' places are those from when they
/// were kept.
pub fn known_starts(config: &FleetConfig) -> Result<Vec<Option<Pose2>>, FleetError> {
    let first = |robot: RobotId| (robot.number() == 1).then_some(Pose2::IDENTITY);
    let alone = || RobotId::first(config.fleet.robots).map(first).collect();
    if !config.fleet.starts_known {
        return Ok(alone());
    }
    if config.world.is_outside() && config.configured_starts().is_none() {
        return Ok(sessions::known_starts(config, alone())?);
    }
    true_starts(config)
}

/// Where each robot's map truly lies, where that is known: in a simulation in `world`, else as configured in `map`.
pub fn true_starts(config: &FleetConfig) -> Result<Vec<Option<Pose2>>, FleetError> {
    let begun = match config.configured_starts() {
        None if config.world.is_outside() => vec![None; config.fleet.robots],
        None => starts(config, &room(config)?)?.into_iter().map(Some).collect(),
        Some(starts) => starts.into_iter().map(Some).collect(),
    };
    Ok(sessions::known_starts(config, begun)?)
}

/// How long after a tick's stamp a robot's simulator takes it: the robots are spread over the tick, so
/// that a fleet does not wake all at once. The same for every tick, so that it is no jitter.
pub fn tick_lag(robot: RobotId, robots: usize) -> Duration {
    Simulator::TICK * robot.index() as u32 / robots.max(1) as u32
}

/// A robot in its room.
pub fn simulator(
    config: &FleetConfig,
    room: &Room,
    robot: RobotId,
    world_from_start: Pose2,
) -> Result<Simulator, FleetError> {
    Simulator::new(room, &config.sim, robot, world_from_start, config.fleet.seed)
        .map_err(|why| FleetError::Start { robot, why: why.to_string() })
}

/// Checks that the whole fleet can be built, before anything is started.
pub fn check(config: &FleetConfig) -> Result<(), FleetError> {
    sessions::check(config)?;
    if config.world.is_outside() {
        return Ok(());
    }
    let room = room(config)?;
    let starts = starts(config, &room)?;
    for (robot, start) in RobotId::first(config.fleet.robots).zip(starts) {
        simulator(config, &room, robot, start)?;
    }
    Ok(())
}

/// Stamps of a run that is on the machine's clock.
pub fn stamp_now(epoch: Epoch) -> Stamp {
    epoch.stamp(crate::clock::now())
}
