//! A run: one fleet from its start to its end, and the folder that describes it.
//!
//! The folder holds `fleet.toml` (the configuration in force), `run.json` (what its processes and
//! `mr-slam status` need to find each other), `merge.json` and `sessions/` (what processes that are started again
//! go on with), and at the end the maps and `report.json`.

use crate::channel::Opener;
use crate::clock::Epoch;
use crate::config::FleetConfig;
use crate::ports::ChannelError;
use crate::shared_memory::{Domain, Participant};
use msg::{Monotonic, RobotId, Role};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// What went wrong with a run's folder.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The folder or one of its files.
    #[error("{path}: {why}")]
    File {
        /// Which.
        path: PathBuf,
        /// What the system says, or what is wrong with the content.
        why: String,
    },
    /// The configuration.
    #[error(transparent)]
    Config(#[from] crate::config::ConfigError),
    /// Shared memory.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// No run to be found.
    #[error("no fleet is running; start one with `mr-slam up`")]
    NoneRunning,
}

impl RunError {
    fn file(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |why| Self::File { path: path.into(), why: why.to_string() }
    }
}

/// `run.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct RunFile {
    /// The launcher's process id.
    pid: u32,
    /// The name in shared memory.
    domain: String,
    /// CLOCK_MONOTONIC at stamp 0, nanoseconds.
    epoch_ns: i64,
    /// CLOCK_MONOTONIC at the start, nanoseconds.
    begun_ns: u64,
    /// Where headsets attach.
    port: u16,
}

/// A run, as each of its processes knows it.
#[derive(Clone, Debug)]
pub struct Run {
    /// Its folder.
    pub dir: PathBuf,
    /// The launcher's process id.
    pub pid: u32,
    /// Its names in shared memory.
    pub domain: Domain,
    /// Where its stamps count from.
    pub epoch: Epoch,
    /// When it began.
    pub begun: Monotonic,
    /// Where headsets attach.
    pub port: u16,
    /// The configuration in force.
    pub config: FleetConfig,
}

impl Run {
    /// Begins a run of this process in `dir`, which is made if need be.
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
        // A link that `mr-slam status` finds without being told the folder.
        fs::create_dir_all(run.domain.root()).map_err(RunError::file(run.domain.root()))?;
        let pointer = run.domain.root().join("run-dir");
        fs::write(&pointer, run.dir.as_os_str().as_encoded_bytes()).map_err(RunError::file(&pointer))?;
        Ok(run)
    }

    /// Opens the run that `dir` describes.
    pub fn open(dir: &Path) -> Result<Self, RunError> {
        let json_path = dir.join("run.json");
        let json = fs::read_to_string(&json_path).map_err(RunError::file(&json_path))?;
        let file: RunFile = serde_json::from_str(&json)
            .map_err(|why| RunError::File { path: json_path, why: why.to_string() })?;
        let config = FleetConfig::from_file(&dir.join("fleet.toml"))?;
        Self::from_file(dir.into(), file, config)
    }

    /// The folders of all runs whose launcher lives, newest last.
    pub fn living() -> Vec<PathBuf> {
        let mut found = Vec::new();
        for entry in fs::read_dir(std::env::temp_dir()).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let Some(pid) = name.strip_prefix("mrslam-").and_then(|pid| pid.parse::<u32>().ok()) else {
                continue;
            };
            let Ok(dir) = fs::read_to_string(entry.path().join("run-dir")) else { continue };
            if Path::new(&format!("/proc/{pid}")).exists() {
                found.push((pid, PathBuf::from(dir)));
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

    /// The robots of the fleet.
    pub fn robots(&self) -> impl Iterator<Item = RobotId> + Clone {
        RobotId::first(self.config.fleet.robots)
    }
}
