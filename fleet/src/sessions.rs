//! Folder of a fleet's SLAM sessions: one file for each robot, and the poses of the robots' maps in the fleet's map.
//!
//! Each SLAM process saves its session in the run's folder. A restarted process continues with it, and a later fleet
//! may begin with the whole folder.

use crate::config::{FleetConfig, Mode};
use crate::run::Run;
use crate::session_file::{self, SessionFileError};
use crate::session_records;
use crate::storage::{DiskStorage, Storage};
use msg::{Pose2, ROBOTS_MAX, RobotId, SlamMode};
use slam::{Session, SessionIdentity};
use std::collections::BTreeMap;
use std::io;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Name of the folder in a run's folder.
pub const FOLDER: &str = "sessions";
/// File with the poses of the robots' maps.
const STARTS: &str = "starts.json";
/// File that a folder has whose maps are in a frame of their own: where that lies in the room is not known.
const OWN_FRAME: &str = "own_frame";
/// Largest file of poses that is read, bytes.
const STARTS_BYTES_MAX: u64 = 64 << 10;
/// Largest file with the number of a frame, bytes.
const FRAME_BYTES_MAX: u64 = 16;
/// Larger than any session without nodes, bytes.
const WITHOUT_NODES_BYTES_MAX: u64 = 64 << 10;
/// Largest coordinate of a map's pose, metres or radians.
const START_MAX: f64 = 1e6;
/// Standard deviation of a pose that a person gives: metres, radians.
pub const TOLD_SIGMA: [f64; 2] = [0.3, 0.2];

/// Reason why a fleet cannot begin with a folder of sessions.
#[derive(Debug, thiserror::Error)]
pub enum SessionsError {
    /// A robot's session file is refused.
    #[error(transparent)]
    Session(#[from] SessionFileError),
    /// The folder has no session of the fleet's robots.
    #[error("{}: no session of this fleet's robots; expected robot1.slam ..., as a run leaves them in its `{FOLDER}`", folder.display())]
    Nothing {
        /// Path of the folder.
        folder: PathBuf,
    },
    /// The file with the poses of the maps cannot be read or written, or a session cannot be renamed.
    #[error("{}: {source}", file.display())]
    StartsFile {
        /// Path of the file.
        file: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file with the poses of the maps is not the JSON that was expected.
    #[error("{}: {source}", file.display())]
    StartsJson {
        /// Path of the file.
        file: PathBuf,
        /// Where it differs.
        source: serde_json::Error,
    },
    /// A robot's map has an impossible pose.
    #[error("{}: {robot} at {pose:?}; expected [x m, y m, yaw rad], each finite and within 1e6", file.display())]
    StartPose {
        /// Path of the file.
        file: PathBuf,
        /// Name of the robot.
        robot: String,
        /// Pose as read: x in m, y in m, yaw in rad.
        pose: [f64; 3],
    },
}

/// Returns the path of a robot's file in a folder of sessions.
pub fn file(folder: &Path, robot: RobotId) -> PathBuf {
    folder.join(format!("{robot}.slam"))
}

/// Returns the path of the file that says that a robot's SLAM is paused.
pub fn pause_marker(folder: &Path, robot: RobotId) -> PathBuf {
    folder.join(format!("{robot}.paused"))
}

/// Returns the path of the file with the number of the frame of a robot's map; none while it is that in which the robot began.
pub fn frame_file(folder: &Path, robot: RobotId) -> PathBuf {
    folder.join(format!("{robot}.frame"))
}

/// Reads the number of a map's frame. Without a file it is 0: the frame in which the robot began.
///
/// # Errors
/// The file cannot be read, or has no number.
pub fn read_frame(storage: &impl Storage, file: &Path) -> io::Result<u32> {
    let bytes = match storage.read(file, FRAME_BYTES_MAX) {
        Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(0),
        read => read?,
    };
    let number = std::str::from_utf8(&bytes).ok().and_then(|text| text.trim().parse().ok());
    number.ok_or_else(|| io::Error::other("is no number"))
}

/// Removes the starts of robots whose map in a folder is in another frame than that in which they began: a map of elsewhere was loaded.
pub fn forget_other_frames(folder: &Path, starts: &mut [Option<Pose2>]) {
    for (robot, start) in RobotId::first(starts.len()).zip(starts) {
        // A number that cannot be read may be another one.
        let is_first = read_frame(&DiskStorage, &frame_file(folder, robot)).is_ok_and(|number| number == 0);
        *start = start.filter(|_| is_first);
    }
}

/// Returns the folder of a run's own sessions.
pub fn folder(run: &Run) -> PathBuf {
    run.dir.join(FOLDER)
}

/// Reads a robot's session from wherever a run's files are.
pub fn read(
    storage: &impl Storage,
    path: &Path,
    identity: &SessionIdentity,
) -> Result<Session, SessionFileError> {
    let bytes = storage
        .read(path, ::slam::session::BYTES_MAX as u64)
        .map_err(|source| SessionFileError::Io { file: path.to_owned(), source })?;
    Session::decode(&bytes, identity).map_err(|why| SessionFileError::Content { file: path.to_owned(), why })
}

/// Returns the identity of a robot of a run.
pub fn identity(run: &Run, robot: RobotId) -> SessionIdentity {
    SessionIdentity::new(robot.number() as u32, run.begun.0, &run.config.slam)
}

/// Reads the session that a robot begins with, if there is one, with the nodes that its run has logged after it. One without
/// nodes, as of a map that was reset at the end, is none.
pub fn first(config: &FleetConfig, robot: RobotId) -> Result<Option<Session>, SessionFileError> {
    let Some((path, session)) = first_saved(config, robot)? else { return Ok(None) };
    let session = session_records::with_records(&DiskStorage, &path, session, &config.slam);
    Ok(Some(session).filter(|session| !session.back.nodes.is_empty()))
}

/// Returns whether a robot begins with a map. Only a short file is read for that: one without nodes is short.
pub fn begins_with_map(config: &FleetConfig, folder: &Path, robot: RobotId) -> bool {
    match file(folder, robot).metadata() {
        Err(_) => false,
        Ok(about) if about.len() > WITHOUT_NODES_BYTES_MAX => true,
        // One that cannot be read may have a map.
        Ok(_) => has_first(config, robot).unwrap_or(true),
    }
}

/// Returns whether [`first`] has a session of this robot. The nodes that its run has logged are not replayed for that.
fn has_first(config: &FleetConfig, robot: RobotId) -> Result<bool, SessionFileError> {
    let Some((path, session)) = first_saved(config, robot)? else { return Ok(false) };
    let logs = session_records::all_files(&path);
    let logged = || session_records::read(&DiskStorage, &logs, &session.identity, session.log).chain;
    Ok(!session.back.nodes.is_empty() || !logged().is_empty())
}

/// Reads the same session as it was saved, with its path.
fn first_saved(config: &FleetConfig, robot: RobotId) -> Result<Option<(PathBuf, Session)>, SessionFileError> {
    let Some(path) = config.sessions.folder().map(|folder| file(folder, robot)) else { return Ok(None) };
    match session_file::read(&path, &SessionIdentity::new(robot.number() as u32, 0, &config.slam)) {
        Ok(session) => Ok(Some((path, session))),
        Err(why) if why.is_missing() => Ok(None),
        Err(why) => Err(why),
    }
}

/// Returns the mode in which a robot begins. A robot without a map makes one.
pub fn first_mode(config: &FleetConfig, has_map: bool) -> SlamMode {
    match config.sessions.mode {
        Mode::Localization if !has_map => SlamMode::Mapping,
        mode => mode.into(),
    }
}

/// Checks all sessions that a fleet begins with, before anything is started.
pub fn check(config: &FleetConfig) -> Result<(), SessionsError> {
    let Some(folder) = config.sessions.folder() else { return Ok(()) };
    let mut missing = Vec::new();
    for robot in RobotId::first(config.fleet.robots) {
        if !has_first(config, robot)? {
            missing.push(robot);
        }
    }
    if missing.len() == config.fleet.robots {
        return Err(SessionsError::Nothing { folder: folder.into() });
    }
    warn_of_other_robots(folder, &missing, config.fleet.robots);
    known_starts(config, Vec::new()).map(drop)
}

/// Warns of robots that have no session in a folder, and of sessions there of robots that the fleet does not have.
fn warn_of_other_robots(folder: &Path, missing: &[RobotId], robots: usize) {
    let named = |robots: &mut dyn Iterator<Item = RobotId>| {
        robots.map(|robot| robot.to_string()).collect::<Vec<_>>().join(", ")
    };
    let missing = named(&mut missing.iter().copied());
    if !missing.is_empty() {
        tracing::warn!("{}: no session of {missing}: each begins a new map", folder.display());
    }
    let surplus =
        named(&mut RobotId::first(ROBOTS_MAX).skip(robots).filter(|robot| file(folder, *robot).exists()));
    if !surplus.is_empty() {
        tracing::warn!("{}: this fleet has no {surplus}: these sessions are not used", folder.display());
    }
}

/// Returns the pose of each robot's map in the fleet's map. Of robots that begin with a session it is the saved one, if
/// there is one and the map is still in the frame of then; of the others it is that of `otherwise`.
pub fn known_starts(
    config: &FleetConfig,
    mut otherwise: Vec<Option<Pose2>>,
) -> Result<Vec<Option<Pose2>>, SessionsError> {
    let Some(folder) = config.sessions.folder() else { return Ok(otherwise) };
    let kept = read_starts(&folder.join(STARTS))?;
    let mut saved: Vec<_> = RobotId::first(config.fleet.robots).map(|robot| start_of(&kept, robot)).collect();
    forget_other_frames(folder, &mut saved);
    for ((robot, start), saved) in RobotId::first(config.fleet.robots).zip(&mut otherwise).zip(saved) {
        if begins_with_map(config, folder, robot) {
            *start = saved;
        }
    }
    Ok(otherwise)
}

/// Returns the poses of the maps as the launcher has written them, if a run saves in the folder with which it begins. What is there
/// by now says nothing of the start: a map that was reset since has no nodes, and has kept its frame.
pub fn continued_starts(run: &Run) -> Result<Option<Vec<Option<Pose2>>>, SessionsError> {
    let folder = folder(run);
    if !is_continued(&folder, run.config.sessions.folder()) || !has_starts(&folder) {
        return Ok(None);
    }
    let kept = read_starts(&folder.join(STARTS))?;
    Ok(Some(run.robots().map(|robot| start_of(&kept, robot)).collect()))
}

fn start_of(kept: &Starts, robot: RobotId) -> Option<Pose2> {
    kept.get(&robot.to_string()).map(|[x, y, yaw]| Pose2::new(*x, *y, *yaw))
}

type Starts = BTreeMap<String, [f64; 3]>;

/// Reads the poses of the maps. A missing file has none.
fn read_starts(path: &Path) -> Result<Starts, SessionsError> {
    let text = match formats::limited::read_text(path, STARTS_BYTES_MAX) {
        Err(why) if why.kind() == io::ErrorKind::NotFound => return Ok(Starts::new()),
        read => read.map_err(|source| SessionsError::StartsFile { file: path.into(), source })?,
    };
    let starts: Starts = serde_json::from_str(&text)
        .map_err(|source| SessionsError::StartsJson { file: path.into(), source })?;
    match starts.iter().find(|(_, pose)| pose.iter().any(|v| !v.is_finite() || v.abs() > START_MAX)) {
        Some((robot, pose)) => {
            Err(SessionsError::StartPose { file: path.into(), robot: robot.clone(), pose: *pose })
        }
        None => Ok(starts),
    }
}

/// Returns whether a folder's maps are in a frame of their own, whose place in the room is not known: their robots had started anywhere.
pub fn have_own_frame(folder: &Path) -> bool {
    folder.join(OWN_FRAME).exists()
}

/// Creates a run's folder for sessions with the poses of the robots' maps that are known. The maps may be in a frame of their own
/// (`is_own_frame`), see [`have_own_frame`].
///
/// Sessions that an earlier run left there are renamed, and stay until the next run in the folder: this run would overwrite them, or
/// a fleet that begins with the folder would take them for maps of this run. Those of this fleet's robots stay as they are if it
/// begins with (`begin_with`) this very folder. Every map of the new run is in the frame in which its robot begins: that one of another
/// frame was loaded before, `known` has taken into account ([`known_starts`]).
pub fn create_folder(
    folder: &Path,
    known: &[Option<Pose2>],
    begin_with: Option<&Path>,
    is_own_frame: bool,
) -> Result<(), SessionsError> {
    set_aside(folder, if is_continued(folder, begin_with) { known.len() } else { 0 })?;
    write_starts(folder, known, is_own_frame)?;
    // After the starts: if this run ends in between, the start of such a map is still unknown.
    remove_all(RobotId::first(ROBOTS_MAX).map(|robot| frame_file(folder, robot)))
}

/// Returns whether a run begins with (`begin_with`) its own folder for sessions: those of the run before are there until it saves its own.
pub fn is_continued(folder: &Path, begin_with: Option<&Path>) -> bool {
    let real = |path: &Path| path.canonicalize().ok();
    begin_with.and_then(real).is_some_and(|begun| real(folder) == Some(begun))
}

/// Returns whether a run's folder for sessions has the file that says where its maps lie.
pub fn has_starts(folder: &Path) -> bool {
    folder.join(STARTS).exists()
}

/// Writes the poses of the robots' maps that are known into a folder for sessions, which is made if need be. The maps may be in a
/// frame of their own (`is_own_frame`), see [`have_own_frame`].
pub fn write_starts(folder: &Path, known: &[Option<Pose2>], is_own_frame: bool) -> Result<(), SessionsError> {
    let path = folder.join(STARTS);
    let named = RobotId::first(known.len()).zip(known);
    let starts: Starts = named
        .filter_map(|(robot, start)| {
            start.map(|Pose2 { x_m, y_m, yaw_rad }| (robot.to_string(), [x_m, y_m, yaw_rad]))
        })
        .collect();
    std::fs::create_dir_all(folder)
        .and_then(|()| {
            let text = serde_json::to_string_pretty(&starts)? + "\n";
            formats::atomic::write(&path, |file| file.write_all(text.as_bytes()))?;
            let own_frame = folder.join(OWN_FRAME);
            match is_own_frame {
                true => std::fs::write(own_frame, "The place of these maps in the room is not known.\n"),
                false if own_frame.exists() => std::fs::remove_file(own_frame),
                false => Ok(()),
            }
        })
        .map_err(|source| SessionsError::StartsFile { file: path.clone(), source })
}

/// Removes files, if they are there.
fn remove_all(files: impl Iterator<Item = PathBuf>) -> Result<(), SessionsError> {
    for file in files {
        DiskStorage.remove(&file).map_err(|source| SessionsError::StartsFile { file, source })?;
    }
    Ok(())
}

/// Renames what an earlier run left of all robots but the first ones, which are `continued`.
fn set_aside(folder: &Path, continued: usize) -> Result<(), SessionsError> {
    let starts = (continued == 0).then(|| folder.join(STARTS));
    let of_robot = |robot| {
        let session = file(folder, robot);
        let logs = session_records::all_files(&session);
        std::iter::once(session).chain(logs).chain([frame_file(folder, robot)])
    };
    remove_all(RobotId::first(ROBOTS_MAX).map(|robot| pause_marker(folder, robot)))?;
    for robot in RobotId::first(continued) {
        session_records::keep_for_next_run(&file(folder, robot))
            .map_err(|(file, source)| SessionsError::StartsFile { file, source })?;
    }
    let files = RobotId::first(ROBOTS_MAX).skip(continued).flat_map(of_robot).chain(starts);
    let mut has_session = false;
    for path in files.filter(|path| path.exists()) {
        let mut earlier = path.clone().into_os_string();
        earlier.push(".earlier");
        has_session |= path.extension().is_some_and(|kind| kind == "slam");
        std::fs::rename(&path, &earlier)
            .map_err(|source| SessionsError::StartsFile { file: path, source })?;
    }
    if has_session {
        tracing::warn!(
            "{}: sessions of an earlier run are renamed to robotK.slam.earlier, until the next run in this folder",
            folder.display()
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests;
