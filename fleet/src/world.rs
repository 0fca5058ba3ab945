//! Builds the world of a configuration: the room, and each robot's start pose and tick phase.
//! Live processes and lockstep use the same functions.

use crate::clock::Epoch;
use crate::config::FleetConfig;
use crate::config::room::{self, RoomLoadError};
use crate::run::Run;
use crate::sessions::{self, SessionsError};
use headset::HeadsetRobots;
use msg::{Pose2, RobotId, Stamp};
use sim::{Room, Simulator, StartError};
use std::sync::Once;
use std::time::Duration;

/// Reason why a world cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum WorldError {
    /// The room cannot be loaded.
    #[error(transparent)]
    Room(#[from] RoomLoadError),
    /// The room has no place for all robots.
    #[error("room {path}: {source}")]
    Starts {
        /// Path or name of the room.
        path: String,
        /// What is missing.
        source: StartError,
    },
    /// Two robots would start in one place.
    #[error(
        "{a} and {b} start {apart_m:.2} m apart; expected at least {START_APART_MIN_M} m, or they push each other away"
    )]
    StartsTooNear {
        /// One of the robots.
        a: RobotId,
        /// The other one.
        b: RobotId,
        /// Distance between their start poses, metres.
        apart_m: f64,
    },
    /// A robot cannot start where it should.
    #[error("{robot} cannot start: {source}")]
    Start {
        /// Robot whose start pose is refused.
        robot: RobotId,
        /// What is in the way.
        source: StartError,
    },
    /// The sessions that the fleet begins with cannot be used.
    #[error(transparent)]
    Sessions(#[from] SessionsError),
}

/// Smallest distance between two start poses, metres: bodies do not touch, whatever their headings.
const START_APART_MIN_M: f64 = 2.0 * sim::burger::RADIUS_M;

/// Length from which the open edge of a room's floor is said, metres.
const OPEN_EDGE_MIN_M: f64 = 0.5;
/// An experiment of many sessions says it once.
static WARNED_OF_EDGE: Once = Once::new();

/// Loads the configured room.
pub fn room(config: &FleetConfig) -> Result<Room, WorldError> {
    Ok(room::load(&config.fleet.room)?)
}

/// Returns each robot's start pose: `world` from its `robotK/map`, whose origin is there.
pub fn starts(config: &FleetConfig, room: &Room) -> Result<Vec<Pose2>, WorldError> {
    match config.configured_starts() {
        Some(starts) => check_distances(&starts).map(|()| starts),
        None => room
            .starts(config.fleet.robots)
            .map_err(|source| WorldError::Starts { path: config.fleet.room.clone(), source }),
    }
}

/// Returns the transforms of the robots' maps that merging knows at the start: `map` from `robotK/map`.
///
/// If they are unknown (as configured, or in an external world without a room), the first robot's map is the reference
/// and merging has to find the others. A fleet that begins with sessions uses the transforms that were saved with
/// them.
pub fn known_starts(config: &FleetConfig) -> Result<Vec<Option<Pose2>>, WorldError> {
    let first = |robot: RobotId| (robot.number() == 1).then_some(Pose2::IDENTITY);
    let alone = || RobotId::first(config.fleet.robots).map(first).collect();
    if !config.fleet.starts_known {
        return Ok(alone());
    }
    if config.world.is_external() && config.configured_starts().is_none() {
        return Ok(sessions::known_starts(config, alone())?);
    }
    true_starts(config)
}

/// Returns the same transforms for a process of a run that has begun. Those of robots that have loaded a map of another frame in this
/// run are unknown.
pub fn known_starts_of_run(run: &Run) -> Result<Vec<Option<Pose2>>, WorldError> {
    let mut starts = match sessions::continued_starts(run)? {
        Some(starts) => starts,
        None => known_starts(&run.config)?,
    };
    sessions::forget_other_frames(&sessions::folder(run), &mut starts);
    Ok(starts)
}

/// Returns whether the fleet's `map` is in a frame of its own, whose place in the room is not known: the robots start anywhere, or did
/// when the maps were made with which they begin.
pub fn has_own_frame(config: &FleetConfig) -> bool {
    !config.fleet.starts_known || config.sessions.folder().is_some_and(sessions::have_own_frame)
}

/// Returns where each robot's map truly begins in the room, in a simulation; unknown for maps of an earlier run that are in a frame of
/// their own.
pub fn starts_in_room(run: &Run) -> Result<Vec<Option<Pose2>>, WorldError> {
    let config = &run.config;
    let mut starts = true_starts(config)?;
    if let Some(folder) = config.sessions.folder().filter(|folder| sessions::have_own_frame(folder)) {
        // A map that was reset in this run has kept the frame of the one with which the robot began.
        let is_continued = sessions::is_continued(&sessions::folder(run), Some(folder));
        let has_map = |robot| match is_continued {
            true => sessions::file(folder, robot).exists(),
            false => sessions::begins_with_map(config, folder, robot),
        };
        let robots = run.robots().zip(&mut starts);
        robots.filter(|(robot, _)| has_map(*robot)).for_each(|(_, start)| *start = None);
    }
    Ok(starts)
}

/// Returns the true transform of each robot's map if it is known: in a simulation from `world`, otherwise from `map`
/// as configured.
pub fn true_starts(config: &FleetConfig) -> Result<Vec<Option<Pose2>>, WorldError> {
    let begun = match config.configured_starts() {
        None if config.world.is_external() => vec![None; config.fleet.robots],
        None => starts(config, &room(config)?)?.into_iter().map(Some).collect(),
        Some(starts) => starts.into_iter().map(Some).collect(),
    };
    Ok(sessions::known_starts(config, begun)?)
}

/// Returns the time by which a robot's simulator runs after the tick's stamp. The robots are spread over the tick so
/// that they do not wake all at once. It is constant, so that it adds no jitter.
pub fn tick_offset(robot: RobotId, robots: usize) -> Duration {
    Simulator::TICK * robot.index() as u32 / robots.max(1) as u32
}

/// Creates the simulation of one robot in its room.
pub fn simulator(
    config: &FleetConfig,
    room: &Room,
    robot: RobotId,
    world_from_start: Pose2,
) -> Result<Simulator, WorldError> {
    Simulator::new(room, &config.sim, robot, world_from_start, config.fleet.seed)
        .map_err(|source| WorldError::Start { robot, source })
}

/// Creates the robots of a headset's application, at their starts in the configured room.
pub fn headset_robots(config: &FleetConfig) -> Result<HeadsetRobots, WorldError> {
    let room = room(config)?;
    let starts = starts(config, &room)?;
    let simulators = RobotId::first(config.fleet.robots).zip(starts);
    let simulators = simulators.map(|(robot, start)| Ok((simulator(config, &room, robot, start)?, start)));
    Ok(HeadsetRobots::new(config.robot_names(), simulators.collect::<Result<Vec<_>, WorldError>>()?))
}

/// Checks that the whole fleet can be built, before anything is started.
pub fn check(config: &FleetConfig) -> Result<(), WorldError> {
    sessions::check(config)?;
    if config.world.is_external() {
        return Ok(());
    }
    let room = room(config)?;
    if room.open_edge_m() >= OPEN_EDGE_MIN_M {
        WARNED_OF_EDGE.call_once(|| {
            tracing::warn!(
                "room {}: {:.1} m of the floor's edge is open: unknown cells beside free ones; robots see over the border there",
                config.fleet.room,
                room.open_edge_m()
            );
        });
    }
    let starts = starts(config, &room)?;
    for (robot, start) in RobotId::first(config.fleet.robots).zip(starts) {
        simulator(config, &room, robot, start)?;
    }
    Ok(())
}

/// Checks that no two robots start in one place.
fn check_distances(starts: &[Pose2]) -> Result<(), WorldError> {
    for (a, here) in RobotId::first(starts.len()).zip(starts) {
        for (b, there) in RobotId::first(starts.len()).zip(starts).skip(a.number()) {
            let apart_m = here.distance_m(*there);
            if apart_m < START_APART_MIN_M {
                return Err(WorldError::StartsTooNear { a, b, apart_m });
            }
        }
    }
    Ok(())
}

/// Returns the epoch of a run on the machine's clock.
pub fn stamp_now(epoch: Epoch) -> Stamp {
    epoch.stamp(crate::clock::now())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_that_start_in_one_place_are_refused_by_name() {
        let mut config = FleetConfig::default();
        (config.fleet.robots, config.fleet.starts) = (3, vec![[0.0; 3], [0.5, 0.0, 0.0], [0.0, 0.2, 1.0]]);
        let said = check(&config).unwrap_err().to_string();
        assert!(said.starts_with("robot1 and robot3 start 0.20 m apart"), "{said}");
        config.fleet.starts[2] = [0.0, 0.3, 1.0];
        check(&config).unwrap();
    }
}
