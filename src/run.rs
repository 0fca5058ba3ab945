//! A run, one fleet from its start to its end, and the folder that describes it.
//!
//! | file | content |
//! |---|---|
//! | `fleet.toml` | configuration of the run |
//! | `run.json` | process id, shared memory, clocks and port, for the fleet's processes and `mr-slam status` |
//! | `merge.json`, `sessions/` | state that restarted processes continue with |
//! | maps, `report.json` | results, written at the end |

use crate::channel::Opener;
use crate::clock::Epoch;
use crate::config::FleetConfig;
use crate::ports::ChannelError;
use crate::shared_memory::{Domain, Participant};
use crate::supervisor::progress::{ProgressCounter, WatchedThread};
use msg::{Monotonic, RobotId, Role};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Reason why a run could not be created or opened.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The folder or one of its files cannot be read or written.
    #[error("{path}: {why}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system, or of the content.
        why: String,
    },
    /// The configuration in the folder is refused.
    #[error(transparent)]
    Config(#[from] crate::config::ConfigError),
    /// Shared memory of the run cannot be used.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// No fleet runs, or not the one that was named.
    #[error("no fleet is running; start one with `mr-slam up`")]
    NoneRunning,
    /// Several fleets run, and none was named.
    #[error("{} fleets are running; name one with --run-dir: {}", runs.len(), display_all(runs))]
    SeveralRunning {
        /// Folders of the runs, oldest first.
        runs: Vec<PathBuf>,
    },
}

impl RunError {
    fn file(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |why| Self::File { path: path.into(), why: why.to_string() }
    }
}

/// Content of `run.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct RunFile {
    /// Process id of the launcher.
    pid: u32,
    /// Name in shared memory.
    domain: String,
    /// CLOCK_MONOTONIC at stamp 0, nanoseconds.
    epoch_ns: i64,
    /// CLOCK_MONOTONIC at the start, nanoseconds.
    begun_ns: u64,
    /// TCP port for headsets.
    port: u16,
}

impl RunFile {
    fn read(dir: &Path) -> Result<Self, RunError> {
        let path = dir.join("run.json");
        let json = fs::read_to_string(&path).map_err(RunError::file(&path))?;
        serde_json::from_str(&json).map_err(|why| RunError::File { path, why: why.to_string() })
    }
}

fn is_alive(pid: u32) -> bool {
    Path::new(&format!("/proc/{pid}")).exists()
}

fn display_all(runs: &[PathBuf]) -> String {
    runs.iter().map(|dir| dir.display().to_string()).collect::<Vec<_>>().join(", ")
}

/// A fleet's run, as each of its processes knows it.
#[derive(Clone, Debug)]
pub struct Run {
    /// Folder of the run.
    pub dir: PathBuf,
    /// Process id of the launcher.
    pub pid: u32,
    /// Names of the run in shared memory.
    pub domain: Domain,
    /// Origin of its stamps.
    pub epoch: Epoch,
    /// Start of the run.
    pub begun: Monotonic,
    /// TCP port for headsets.
    pub port: u16,
    /// Configuration with the command line's options applied.
    pub config: FleetConfig,
}

impl Run {
    /// Begins a run of this process in `dir`, which is created if it does not exist.
    pub fn create(dir: &Path, config: FleetConfig, port: u16) -> Result<Self, RunError> {
        fs::create_dir_all(dir).map_err(RunError::file(dir))?;
        let dir = fs::canonicalize(dir).map_err(RunError::file(dir))?;
        let pid = std::process::id();
        let epoch = if config.world.is_outside() { Epoch::unix() } else { Epoch::now() };
        let (epoch_ns, begun_ns) = (epoch.monotonic_ns, crate::clock::now().0);
        let file = RunFile { pid, domain: pid.to_string(), epoch_ns, begun_ns, port };
        let run = Self::from_file(dir, file.clone(), config)?;
        let toml_path = run.dir.join("fleet.toml");
        fs::write(&toml_path, run.config.to_toml()).map_err(RunError::file(&toml_path))?;
        let json_path = run.dir.join("run.json");
        let json = serde_json::to_string_pretty(&file).unwrap_or_default();
        fs::write(&json_path, &json).map_err(RunError::file(&json_path))?;
        // `mr-slam status` finds the run by this file without knowing its folder.
        fs::create_dir_all(run.domain.root()).map_err(RunError::file(run.domain.root()))?;
        let pointer = run.domain.root().join("run-dir");
        fs::write(&pointer, run.dir.as_os_str().as_encoded_bytes()).map_err(RunError::file(&pointer))?;
        Ok(run)
    }

    /// Creates a run without folder or shared memory, for lockstep, whose files and channels are in memory.
    pub fn in_memory(config: FleetConfig) -> Result<Self, RunError> {
        let file = RunFile { pid: 0, domain: "lockstep".into(), epoch_ns: 0, begun_ns: 0, port: 0 };
        Self::from_file("lockstep".into(), file, config)
    }

    /// Opens the run that the folder `dir` describes.
    pub fn open(dir: &Path) -> Result<Self, RunError> {
        let file = RunFile::read(dir)?;
        let config = FleetConfig::from_file(&dir.join("fleet.toml"))?;
        Self::from_file(dir.into(), file, config)
    }

    /// Opens the run in `dir`, whose launcher must be alive.
    pub fn open_running(dir: &Path) -> Result<Self, RunError> {
        let run = Self::open(dir)?;
        if is_alive(run.pid) { Ok(run) } else { Err(RunError::NoneRunning) }
    }

    /// Returns the folders of all runs whose launcher is alive, in the order of their start.
    pub fn all_running() -> Vec<PathBuf> {
        Self::all_running_below(&std::env::temp_dir())
    }

    fn all_running_below(folder: &Path) -> Vec<PathBuf> {
        let mut found = Vec::new();
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Some(pid) = name.strip_prefix("mrslam-").and_then(|pid| pid.parse::<u32>().ok()) else {
                continue;
            };
            let Ok(dir) = fs::read_to_string(entry.path().join("run-dir")) else { continue };
            let dir = PathBuf::from(dir);
            // Process ids do not grow with time, so the start is read from the run's own file.
            if is_alive(pid)
                && let Ok(file) = RunFile::read(&dir)
            {
                found.push((file.begun_ns, dir));
            }
        }
        found.sort();
        found.into_iter().map(|(_, dir)| dir).collect()
    }

    fn from_file(dir: PathBuf, file: RunFile, config: FleetConfig) -> Result<Self, RunError> {
        let RunFile { pid, domain, epoch_ns, begun_ns, port } = file;
        let (epoch, begun) = (Epoch { monotonic_ns: epoch_ns }, Monotonic(begun_ns));
        Ok(Self { dir, pid, domain: Domain::new(&domain)?, epoch, begun, port, config })
    }

    /// Attaches one of the run's processes to shared memory.
    pub fn attach(&self, role: Role, robot: Option<RobotId>) -> Result<Participant, ChannelError> {
        self.attach_thread(role, robot, "")
    }

    /// Attaches a thread of one of the run's processes; `thread` is empty for the main thread.
    pub fn attach_thread(
        &self,
        role: Role,
        robot: Option<RobotId>,
        thread: &str,
    ) -> Result<Participant, ChannelError> {
        let parts = [robot.map(|robot| robot.to_string()), Some(role.name().into()), Some(thread.into())];
        let parts: Vec<String> = parts.into_iter().flatten().filter(|part| !part.is_empty()).collect();
        Participant::open(&self.domain, Opener { program: role.into(), robot }, &parts.join("/"))
    }

    /// Opens the counter with which the calling thread of one of the run's processes says that it works.
    pub fn progress(&self, role: Role, robot: Option<RobotId>, thread: WatchedThread) -> ProgressCounter {
        ProgressCounter::open(&self.domain, &self.config, role, robot, thread)
    }

    /// Returns the robots of the fleet.
    pub fn robots(&self) -> impl Iterator<Item = RobotId> + Clone {
        RobotId::first(self.config.fleet.robots)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn running_fleets_are_listed_in_the_order_of_their_start() {
        let folder = tempfile::tempdir().unwrap();
        // Process 1 always lives; process ids have no order in time.
        for (pid, begun_ns) in [(std::process::id(), 1), (1, 2)] {
            let file = RunFile { pid, domain: pid.to_string(), epoch_ns: 0, begun_ns, port: 0 };
            let dir = folder.path().join(format!("run-{begun_ns}"));
            fs::create_dir_all(&dir).unwrap();
            fs::write(dir.join("run.json"), serde_json::to_string(&file).unwrap()).unwrap();
            let pointer = folder.path().join(format!("mrslam-{pid}"));
            fs::create_dir_all(&pointer).unwrap();
            fs::write(pointer.join("run-dir"), dir.as_os_str().as_encoded_bytes()).unwrap();
        }
        let runs = Run::all_running_below(folder.path());
        assert_eq!(runs, [folder.path().join("run-1"), folder.path().join("run-2")]);
        let several = RunError::SeveralRunning { runs }.to_string();
        assert!(several.contains("--run-dir") && several.contains("run-2"), "{several}");
    }
}
