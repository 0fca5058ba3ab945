//! What a configuration makes of the world: the room, and where and when each robot begins. The
//! processes and the lockstep fleet both build their robots from this.

use crate::clock::Epoch;
use crate::config::{FleetConfig, LABORATORY};
use msg::{Pose2, RobotId, Stamp};
use sim::{Room, Simulator};
use std::io::Read;
use std::path::Path;

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
        None => room.starts(config.fleet.robots).map_err(|why| FleetError::Room {
            path: config.fleet.room.clone(),
            why: why.to_string(),
        }),
    }
}

/// The first tick of a robot's simulator after `now`. The robots' ticks are spread over the tick,
/// as real robots' clocks are, so that a fleet does not wake all at once.
pub fn first_tick(robot: RobotId, robots: usize, now: Stamp) -> Stamp {
    let tick = Simulator::TICK.as_nanos() as i64;
    let phase = tick * robot.index() as i64 / robots.max(1) as i64;
    Stamp((now.0 - phase).div_euclid(tick) * tick + tick + phase)
}

/// A robot in its room, about to take its first tick.
pub fn simulator(
    config: &FleetConfig,
    room: &Room,
    robot: RobotId,
    world_from_start: Pose2,
    first_tick: Stamp,
) -> Result<Simulator, FleetError> {
    Simulator::new(room, &config.sim, robot, world_from_start, first_tick, config.fleet.seed)
        .map_err(|why| FleetError::Start { robot, why: why.to_string() })
}

/// Checks that the whole fleet can be built, before anything is started.
pub fn check(config: &FleetConfig) -> Result<(), FleetError> {
    let room = room(config)?;
    let starts = starts(config, &room)?;
    for (robot, start) in RobotId::first(config.fleet.robots).zip(starts) {
        simulator(config, &room, robot, start, Stamp(0))?;
    }
    Ok(())
}

/// Stamps of a run that is on the machine's clock.
pub fn stamp_now(epoch: Epoch) -> Stamp {
    epoch.stamp(crate::clock::now())
}
