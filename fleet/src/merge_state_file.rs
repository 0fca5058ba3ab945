//! State of the merge process that outlives a restart: transforms of the robots' maps, and the operator's commands.
//! It is a file in the run's folder, which only the restarted merge process of the same run reads.

use crate::run::Run;
use crate::storage::{Storage, keep_unusable};
use merge::{FleetPoseGraph, FleetSnapshot, SnapshotRejected};
use msg::Monotonic;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The file's name in the run's folder.
const FILE: &str = "merge.json";
/// The format this program reads and writes.
const VERSION: u32 = 3;
/// Longest file that is read, bytes: 64 robots whose every edge was undone eight times take 4 MB.
const BYTES_MAX: u64 = 8 << 20;
/// Time after a failed write until the next attempt, nanoseconds.
const AGAIN_NS: u64 = 5_000_000_000;

/// Content of the file, as JSON.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Kept {
    version: u32,
    /// Start of the run, which tells it from others in the same folder.
    run: u64,
    fleet: FleetSnapshot,
}

/// Reason why a file cannot be used.
#[derive(Debug, thiserror::Error)]
enum Unusable {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] std::io::Error),
    /// The content is not valid.
    #[error(transparent)]
    Content(#[from] serde_json::Error),
    /// The content does not say its version.
    #[error("does not say its version; expected {VERSION}")]
    NoVersion,
    /// It has the format of another version of the program.
    #[error("is of format version {0}; this program reads version {VERSION}")]
    Version(u64),
    /// Another run left it in this folder.
    #[error("is of another run")]
    Run,
    /// The merge process cannot continue from its content.
    #[error(transparent)]
    Fleet(#[from] SnapshotRejected),
}

impl Unusable {
    /// Keeps the file, unless another run left it. Returns what came of it.
    fn keep(&self, storage: &impl Storage, path: &Path) -> String {
        match self {
            Self::Run => "it is written anew".into(),
            _ => keep_unusable(storage, path),
        }
    }
}

/// Reason why the state cannot be saved.
#[derive(Debug, thiserror::Error)]
enum SaveError {
    /// The state has no JSON.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The file cannot be written.
    #[error("{}: {why}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the storage.
        why: std::io::Error,
    },
}

/// Writes the state to the file when it has changed.
pub struct MergeStateFile<S> {
    storage: S,
    path: PathBuf,
    run: u64,
    kept: Option<FleetSnapshot>,
    /// Earliest time of the next attempt after a failed write.
    due: Monotonic,
    /// Error of the last warning; it is not reported again.
    last_warning: Option<String>,
}

impl<S: Storage> MergeStateFile<S> {
    /// Restores what an earlier process of this run saved. A file that cannot be used is reported and
    /// ignored.
    pub fn restore(run: &Run, storage: S, fleet: &mut FleetPoseGraph) -> Self {
        let path = run.dir.join(FILE);
        let kept = restore(&storage, &path, run.begun.0, fleet).unwrap_or_else(|why| {
            let kept = why.keep(&storage, &path);
            tracing::warn!("merge: {}: {why}; it begins without it; {kept}", path.display());
            None
        });
        Self { storage, path, run: run.begun.0, kept, due: Monotonic::default(), last_warning: None }
    }

    /// Writes the state, if it has changed; returns whether the file has it. After a failed write it waits, unless `at_once`.
    pub fn save(&mut self, fleet: &FleetPoseGraph, now: Monotonic, at_once: bool) -> bool {
        let snapshot = fleet.snapshot();
        if self.kept.as_ref() == Some(&snapshot) {
            return true;
        }
        if now < self.due && !at_once {
            return false;
        }
        match write(&self.storage, &self.path, self.run, &snapshot) {
            Ok(()) => (self.kept, self.last_warning) = (Some(snapshot), None),
            Err(why) => {
                self.due = Monotonic(now.0 + AGAIN_NS);
                let why = why.to_string();
                if self.last_warning.as_ref() != Some(&why) {
                    tracing::warn!("merge: the state is not saved: {why}; it is tried again later");
                }
                self.last_warning = Some(why);
            }
        }
        self.last_warning.is_none()
    }
}

fn write(storage: &impl Storage, path: &Path, run: u64, fleet: &FleetSnapshot) -> Result<(), SaveError> {
    let kept = Kept { version: VERSION, run, fleet: fleet.clone() };
    let text = serde_json::to_vec(&kept)?;
    storage.write(path, &text).map_err(|why| SaveError::Write { path: path.into(), why })
}

/// Reads the file, if it exists.
fn restore(
    storage: &impl Storage,
    path: &Path,
    run: u64,
    fleet: &mut FleetPoseGraph,
) -> Result<Option<FleetSnapshot>, Unusable> {
    let bytes = match storage.read(path, BYTES_MAX) {
        Err(why) if why.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        bytes => bytes?,
    };
    let value: serde_json::Value = serde_json::from_slice(&bytes)?;
    // The version is read first: the other fields of another version may differ.
    match value["version"].as_u64() {
        Some(version) if version == u64::from(VERSION) => {}
        Some(other) => return Err(Unusable::Version(other)),
        None => return Err(Unusable::NoVersion),
    }
    let kept: Kept = serde_json::from_value(value)?;
    if kept.run != run {
        return Err(Unusable::Run);
    }
    fleet.restore(&kept.fleet)?;
    Ok(Some(kept.fleet))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;
    use crate::storage::DiskStorage;
    use merge::MergeConfig;
    use msg::{EdgeAction, Pose2, RobotId};

    /// Two robots whose starts are known, and whose edge is pinned.
    fn pinned() -> FleetPoseGraph {
        let mut fleet = fresh(2);
        assert!(fleet.apply_command(1, EdgeAction::Pin));
        fleet
    }

    fn fresh(robots: usize) -> FleetPoseGraph {
        let starts: Vec<_> = (0..robots).map(|k| Some(Pose2::new(0.1 * k as f64, -1.0 / 3.0, 0.7))).collect();
        FleetPoseGraph::new(&MergeConfig::default(), &starts)
    }

    #[test]
    fn what_was_written_comes_back_to_the_last_digit_and_is_not_written_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        assert!(restore(&DiskStorage, &path, 7, &mut fresh(2)).unwrap().is_none());
        let fleet = pinned();
        let mut state_file = MergeStateFile {
            storage: DiskStorage,
            path: path.clone(),
            run: 7,
            kept: None,
            due: Monotonic(0),
            last_warning: None,
        };
        state_file.save(&fleet, Monotonic(1), false);
        let mut again = fresh(2);
        assert_eq!(restore(&DiskStorage, &path, 7, &mut again).unwrap(), Some(fleet.snapshot()));
        assert_eq!(again.snapshot(), fleet.snapshot());
        assert_eq!(
            again.map_from_robot_map(RobotId::new(2).unwrap()),
            fleet.map_from_robot_map(RobotId::new(2).unwrap())
        );
        std::fs::remove_file(&path).unwrap();
        state_file.save(&fleet, Monotonic(2), false);
        assert!(!path.exists());
    }

    #[test]
    fn the_state_of_the_largest_fleet_comes_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let robots = msg::ROBOTS_MAX;
        let mut fleet = fresh(robots);
        for edge in 1..=(robots * (robots - 1) / 2) as u32 {
            assert!(
                fleet.apply_command(edge, EdgeAction::Pin) && fleet.apply_command(edge, EdgeAction::Undo)
            );
        }
        write(&DiskStorage, &path, 7, &fleet.snapshot()).unwrap();
        let mut again = fresh(robots);
        assert!(restore(&DiskStorage, &path, 7, &mut again).unwrap().is_some());
        assert_eq!(again.snapshot(), fleet.snapshot());
        // Every pair holds one undone alignment here, and may hold eight.
        assert!(8 * std::fs::metadata(&path).unwrap().len() < BYTES_MAX);
    }

    #[test]
    fn what_cannot_be_used_is_refused_with_the_reason_and_changes_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        write(&DiskStorage, &path, 7, &pinned().snapshot()).unwrap();
        let whole = std::fs::read_to_string(&path).unwrap();
        let refused = |run, robots, text: &str| {
            std::fs::write(&path, text).unwrap();
            let (mut fleet, untouched) = (fresh(robots), fresh(robots).snapshot());
            let why = restore(&DiskStorage, &path, run, &mut fleet).unwrap_err().to_string();
            assert_eq!(fleet.snapshot(), untouched, "{text}");
            why
        };
        assert!(refused(8, 2, &whole).contains("another run"));
        assert!(refused(7, 3, &whole).contains("fleet of 2 robots"));
        let version = format!("\"version\":{VERSION}");
        assert!(refused(7, 2, &whole.replace(&version, "\"version\":99")).contains("version 99"));
        assert!(refused(7, 2, &whole.replace("-0.3333333333333333", "-1e300")).contains("invalid"));
        assert!(refused(7, 2, &whole.replace("\"edge\":1", "\"edge\":2")).contains("edge's number"));
        assert!(refused(7, 2, &whole.replace("\"state\":3", "\"state\":9")).contains("edge's state"));
        assert!(refused(7, 2, &whole.replace("\"edge\"", "\"hedge\"")).contains("hedge"));
        for length in [0, 1, whole.len() / 2, whole.len() - 1] {
            refused(7, 2, &whole[..length]);
        }
        refused(7, 2, &" ".repeat(BYTES_MAX as usize + 1));
    }

    #[test]
    fn a_file_that_cannot_be_read_is_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Run::in_memory(FleetConfig::default()).unwrap();
        run.dir = folder.path().into();
        // No file can be read from a folder.
        std::fs::create_dir(run.dir.join(FILE)).unwrap();
        std::fs::write(run.dir.join(FILE).join("content"), "whole").unwrap();
        let mut fleet = fresh(2);
        let mut state_file = MergeStateFile::restore(&run, DiskStorage, &mut fleet);
        state_file.save(&pinned(), Monotonic(1), false);
        assert!(run.dir.join(FILE).is_file(), "the new state is saved");
        let kept = run.dir.join(format!("{FILE}.unreadable")).join("content");
        assert_eq!(std::fs::read_to_string(kept).unwrap(), "whole");
    }

    #[test]
    fn a_folder_that_is_gone_costs_the_memory_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        // A file where the folder should be.
        std::fs::write(folder.path().join("run"), "").unwrap();
        let path = folder.path().join("run").join(FILE);
        let mut state_file = MergeStateFile {
            storage: DiskStorage,
            path,
            run: 7,
            kept: None,
            due: Monotonic(0),
            last_warning: None,
        };
        assert!(!state_file.save(&pinned(), Monotonic(1), false));
        assert!(state_file.last_warning.is_some() && state_file.due > Monotonic(1));
        // The folder is there again: what a person asks for is tried at once, and all else after a while.
        std::fs::remove_file(folder.path().join("run")).unwrap();
        assert!(!state_file.save(&pinned(), Monotonic(2), false));
        assert!(state_file.save(&pinned(), Monotonic(2), true));
    }
}
