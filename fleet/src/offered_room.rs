//! The room that a headset offers as the simulators' world: its files in the run's folder, and the fleet in it.
//!
//! The bridge saves the offered room. The operator's tool `mr-slam room accept` checks it and writes what it has checked as the accepted
//! room, which tells the launcher to start the fleet again in it. No client can write that file.

use crate::config::FleetConfig;
use crate::run::Run;
use crate::storage::{DiskStorage, Storage as _};
use sim::{Room, RoomError, StartError};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Cells of the floor plan that measures a room, metres.
const PLAN_CELL_M: f64 = 0.05;

/// Reason why an offered room cannot be accepted.
#[derive(Debug, thiserror::Error)]
pub enum OfferedRoomError {
    /// No room is offered.
    #[error("no room is offered: press \"Use my room\" in the headset first")]
    None,
    /// The file cannot be read or renamed.
    #[error("{path}: {source}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The scan is no room.
    #[error(
        "the offered scan is no usable room: {0}; scan the room again in the headset's settings (Space Setup)"
    )]
    Room(#[from] RoomError),
    /// The room is too small for the fleet.
    #[error("{0}; start a fleet with fewer --robots, then offer the room again")]
    Starts(#[from] StartError),
}

/// Returns the path of the room that waits for an answer.
pub fn file(run: &Run) -> PathBuf {
    run.dir.join("offered-room.json")
}

/// Returns the path of the room that was accepted.
fn accepted_file(run: &Run) -> PathBuf {
    run.dir.join("accepted-room.json")
}

/// A room that was read and can be used.
struct CheckedRoom {
    /// The file as it was checked.
    bytes: Vec<u8>,
    /// Size along x and y, metres.
    size_m: [f64; 2],
}

/// Checks the room that waits; returns its size along x and y, metres.
pub fn check(run: &Run) -> Result<[f64; 2], OfferedRoomError> {
    Ok(read(run)?.size_m)
}

fn read(run: &Run) -> Result<CheckedRoom, OfferedRoomError> {
    let path = file(run);
    let bytes = match formats::limited::read(&path, ::bridge::ROOM_BYTES_MAX as u64) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Err(OfferedRoomError::None),
        Err(source) => return Err(OfferedRoomError::File { path, source }),
    };
    let room = Room::from_bytes("the headset's room", &bytes)?;
    room.starts(run.config.fleet.robots)?;
    let plan = room.floor_plan(PLAN_CELL_M).header;
    let size_m = [plan.width, plan.height].map(|cells| f64::from(cells) * plan.resolution_m);
    Ok(CheckedRoom { bytes, size_m })
}

/// Accepts the room that waits: the launcher starts the fleet again in it.
pub fn accept(run: &Run) -> Result<[f64; 2], OfferedRoomError> {
    let room = read(run)?;
    publish(run, &room)?;
    Ok(room.size_m)
}

/// Writes the room as the accepted one. It is what was checked, also if another offer has replaced the file since.
fn publish(run: &Run, room: &CheckedRoom) -> Result<(), OfferedRoomError> {
    let path = accepted_file(run);
    let offer = file(run);
    DiskStorage.write(&path, &room.bytes).map_err(|source| OfferedRoomError::File { path, source })?;
    DiskStorage.remove(&offer).map_err(|source| OfferedRoomError::File { path: offer, source })
}

/// Removes the room that waits.
pub fn refuse(run: &Run) -> Result<(), OfferedRoomError> {
    let path = file(run);
    match fs::remove_file(&path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(OfferedRoomError::None),
        Err(source) => Err(OfferedRoomError::File { path, source }),
        Ok(()) => Ok(()),
    }
}

/// Removes the rooms that an earlier run has left in the folder.
pub fn remove_old(run: &Run) -> io::Result<()> {
    [file(run), accepted_file(run)].iter().try_for_each(|path| DiskStorage.remove(path))
}

/// Returns the room that was accepted in a run.
pub fn accepted(run: &Run) -> Option<PathBuf> {
    Some(accepted_file(run)).filter(|path| path.exists())
}

/// Returns the configuration of the same fleet in another room. `map` is the room's frame, so that a headset shows the
/// map where the room is; the robots' sessions are of the old room.
pub fn fleet_in(config: &FleetConfig, room: &Path) -> FleetConfig {
    let mut config = config.clone();
    config.fleet.room = room.display().to_string();
    config.fleet.starts.clear();
    config.fleet.starts_known = true;
    config.sessions = Default::default();
    config
}

/// Returns the folder of a fleet's run after `count` changes of the room: `DIR`, then `DIR-room2` and so on.
pub fn folder(dir: &Path, count: usize) -> PathBuf {
    match count {
        0 => dir.to_owned(),
        _ => {
            let name = dir.file_name().unwrap_or_default().to_string_lossy();
            dir.with_file_name(format!("{name}-room{}", count + 1))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fleet_in_another_room_begins_anew() {
        let mut config = FleetConfig::default();
        config.fleet.starts = vec![[0.0; 3]; 3];
        config.fleet.starts_known = false;
        let config = fleet_in(&config, Path::new("/runs/a/accepted-room.json"));
        assert_eq!(config.fleet.room, "/runs/a/accepted-room.json");
        assert!(config.fleet.starts.is_empty() && config.fleet.starts_known);
    }

    #[test]
    fn an_offer_that_comes_after_the_check_is_not_accepted() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Run::in_memory(FleetConfig::default()).unwrap();
        run.dir = folder.path().into();
        assert!(matches!(accept(&run), Err(OfferedRoomError::None)));
        let checked = CheckedRoom { bytes: b"checked".to_vec(), size_m: [1.0; 2] };
        fs::write(file(&run), "no room").unwrap();
        assert!(matches!(accept(&run), Err(OfferedRoomError::Room(_))));
        assert!(accepted(&run).is_none() && file(&run).exists(), "it waits for an answer still");
        publish(&run, &checked).unwrap();
        assert_eq!(fs::read(accepted(&run).unwrap()).unwrap(), b"checked");
        assert!(!file(&run).exists());
    }

    #[test]
    fn every_room_has_a_folder() {
        let folders = [0, 1, 2].map(|count| folder(Path::new("runs/2026-11-22T19-40-00"), count));
        assert_eq!(folders[0], Path::new("runs/2026-11-22T19-40-00"));
        assert_eq!(folders[2], Path::new("runs/2026-11-22T19-40-00-room3"));
    }
}
