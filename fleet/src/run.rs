//! A run, one fleet from its start to its end, and the folder that describes it.
//!
//! | file | content |
//! |---|---|
//! | `fleet.toml` | configuration of the run |
//! | `run.json` | process id, shared memory, clocks and port, for the fleet's processes and `mr-slam status` |
//! | `.lock` | held by the launcher, so that a second fleet does not use the folder |
//! | `merge.json`, `merge_robotK.map.gz`, `sessions/`, `bridge.json`, `stopped`, `denied` | state that restarted processes continue with |
//! | `link.json` | figures of the link to other machines, if there are several |
//! | `room.copy/` | copy of the room's files, if it has some: restarted processes read it, whatever becomes of the files |
//! | `recording/` | recording of the run, if there is one |
//! | `results.earlier/`, `sessions/*.earlier` | maps, report and sessions of the run before in this folder |
//! | maps, `report.json`, `report.html`; `launcher.log` | results, written at the end; messages of the processes |

mod folder;
mod running;
#[cfg(test)]
mod tests;

pub use folder::{
    LINK_REPORT, check_output, folder_name_now, keep_earlier_results, lock_folder, remove_link_report,
    restore_folder,
};
pub use running::{LostFleet, RunningFleets, has_remote_robots, runtime_folder_of};

use crate::channel::Opener;
use crate::clock::Epoch;
use crate::config::room::{RoomFiles, RoomLoadError};
use crate::config::{FleetConfig, RobotSource};
use crate::layout;
use crate::other_fleets::OtherFleet;
use crate::ports::ChannelError;
use crate::progress::{ProgressCounter, WatchedThread};
use crate::runtime_folder::{self, FleetPlace, Forbidden, Lock, TrustError};
use crate::shared_memory::{Domain, DomainGuard, Participant};
use msg::{Monotonic, RobotId, Role};
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::{fs, io};

/// Largest size of `run.json` and of a path in a file, bytes.
const FILE_BYTES_MAX: u64 = 64 << 10;
/// Names that are tried for a new folder: more fleets do not start in one second.
const NEW_FOLDERS_MAX: usize = 100;

/// Reason why a run could not be created or opened.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The folder or one of its files cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// `run.json` is not the JSON that was expected.
    #[error("{}: {source}", path.display())]
    Json {
        /// Path of the file.
        path: PathBuf,
        /// Where it differs.
        source: serde_json::Error,
    },
    /// The fleet has no robot of this number.
    #[error("{}: this fleet has robots 1 to {robots}, not {number}", path.display())]
    NoRobot {
        /// Path of the fleet's configuration.
        path: PathBuf,
        /// Number of robots.
        robots: usize,
        /// Number that was asked for.
        number: usize,
    },
    /// The configuration in the folder is refused.
    #[error(transparent)]
    Config(#[from] crate::config::ConfigError),
    /// A folder or file belongs to somebody else, or somebody else may write to it.
    #[error("{0}; choose another folder with --run-dir, or mend it")]
    Trust(#[from] TrustError),
    /// Another fleet, or an experiment, runs in the folder.
    #[error(
        "{}: a fleet {} in this folder; end it, or choose another folder, for a run with --run-dir",
        dir.display(),
        pid.map_or("or an experiment is starting or running".into(), |pid| format!("is running (process {pid})"))
    )]
    FolderInUse {
        /// Folder of the run.
        dir: PathBuf,
        /// Process id of the other launcher; `None` before it has written `run.json`.
        pid: Option<u32>,
    },
    /// Shared memory of the run cannot be used.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The room's files cannot be read.
    #[error(transparent)]
    Room(#[from] Box<RoomLoadError>),
    /// No fleet runs.
    #[error("no fleet is running; start one with `mr-slam up`")]
    NoneRunning,
    /// Fleets run, but none that is found from here.
    #[error("{}", display_all(.0))]
    OthersRunning(Vec<OtherFleet>),
    /// The folder that was named has no run.
    #[error("{}: no fleet has run in this folder (it has no run.json); `mr-slam status` finds the fleets that run", .0.display())]
    NoRun(PathBuf),
    /// The fleet that was named has ended.
    #[error("{}: the fleet of this run has ended; start one with `mr-slam up`", .0.display())]
    Ended(PathBuf),
    /// Fleets run, but none whose folder can be read.
    #[error("{}; `mr-slam stop` stops its robots, and `kill` with the process id ends it", display_all(.0))]
    Lost(Vec<LostFleet>),
    /// Several fleets run, and none was named.
    #[error("{} fleets are running; name one with --run-dir: {}", runs.len(), display_dirs(runs))]
    SeveralRunning {
        /// Folders of the runs, oldest first.
        runs: Vec<PathBuf>,
    },
}

impl RunError {
    /// Returns the conversion of an error of the operating system at a file.
    pub fn file(path: &Path) -> impl FnOnce(io::Error) -> Self + '_ {
        move |source| Self::File { path: path.into(), source }
    }
}

/// Content of `run.json`.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct RunFile {
    /// Process id of the launcher.
    pid: u32,
    /// Name in shared memory.
    domain: String,
    /// Folder of the run's sockets and locks.
    runtime: PathBuf,
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
        if fs::symlink_metadata(&path).is_err_and(|why| why.kind() == io::ErrorKind::NotFound) {
            return Err(RunError::NoRun(dir.into()));
        }
        // What another user put there is not a fleet of this user's.
        runtime_folder::check_file(&path, Forbidden::Writing)?;
        let json = formats::limited::read_text(&path, FILE_BYTES_MAX).map_err(RunError::file(&path))?;
        serde_json::from_str(&json).map_err(|source| RunError::Json { path, source })
    }
}

fn display_dirs(runs: &[PathBuf]) -> String {
    runs.iter().map(|dir| dir.display().to_string()).collect::<Vec<_>>().join(", ")
}

fn display_all(fleets: &[impl ToString]) -> String {
    fleets.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
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
    /// Content of `run.json`.
    file: RunFile,
    /// Files of the room as they were at the start, in the launcher: it writes their copy again if the folder is lost.
    room: Option<Arc<RoomFiles>>,
    /// Locks of the launcher, which say that it lives. They end with its process.
    _locks: Option<Arc<[Lock; 3]>>,
}

/// Creates the folder of a run if it does not exist, and checks that nobody else can put files into it.
pub fn create_folder(dir: &Path) -> Result<PathBuf, RunError> {
    fs::DirBuilder::new().recursive(true).mode(0o755).create(dir).map_err(RunError::file(dir))?;
    let dir = fs::canonicalize(dir).map_err(RunError::file(dir))?;
    runtime_folder::check_folder(&dir, Forbidden::WritingByAll)?;
    Ok(dir)
}

/// Creates the folder `name` below `parent`, or `name-2` and so on while that exists: of two fleets that start at the same
/// time each gets one of its own.
pub fn create_new_folder(parent: &Path, name: &str) -> Result<PathBuf, RunError> {
    create_folder(parent)?;
    let mut dir = parent.join(name);
    for number in 2..=NEW_FOLDERS_MAX {
        match fs::DirBuilder::new().mode(0o755).create(&dir) {
            Err(why) if why.kind() == io::ErrorKind::AlreadyExists => {
                dir = parent.join(format!("{name}-{number}"));
            }
            created => return created.map_err(RunError::file(&dir)).map(|()| dir.clone()),
        }
    }
    Err(RunError::file(&dir)(io::ErrorKind::AlreadyExists.into()))
}

/// Reads the files of a simulated room, and names the copy of them in a run's folder as the room of the configuration. `None`: the room
/// has no files.
fn hold_room(dir: &Path, config: &mut FleetConfig) -> Result<Option<Arc<RoomFiles>>, RunError> {
    if config.world != RobotSource::Simulator {
        return Ok(None);
    }
    let Some(files) = RoomFiles::read(&config.fleet.room).map_err(Box::new)? else { return Ok(None) };
    // A configuration holds no path that is not UTF-8: there the run reads the files themselves.
    let Some(copy) = files.copy_in(dir).to_str().map(str::to_owned) else { return Ok(None) };
    config.fleet.room = copy;
    Ok(Some(Arc::new(files)))
}

impl Run {
    /// Begins a run of this process in `dir`, which is created if it does not exist. The run may `outlive_session`, the
    /// user's login. What fleets of dead launchers left is removed.
    pub fn create(
        dir: &Path,
        mut config: FleetConfig,
        port: u16,
        outlives_session: bool,
    ) -> Result<Self, RunError> {
        let dir = create_folder(dir)?;
        let dir_lock = lock_folder(&dir)?;
        let room = hold_room(&dir, &mut config)?;
        remove_link_report(&dir)?;
        let remove = |name: &str, root: &Path| {
            if Domain::new(name, root).is_ok_and(|domain| domain.remove_leftover()) {
                tracing::warn!("removed what a fleet had left that did not end in order ({name})");
            }
        };
        let FleetPlace { name: domain, root: runtime, locks: [file_lock, folder_lock] } =
            runtime_folder::create_place(outlives_session, remove)?;
        crate::shared_memory::remove_leftovers();
        // Without it the run's own folder will do.
        if !outlives_session && let Err(why) = crate::shared_memory::create_ipc_folder(&domain) {
            tracing::debug!("the fleet starts slower, without a folder in shared memory: {why}");
        }
        let pid = std::process::id();
        let epoch = if config.world.is_external() { Epoch::unix() } else { Epoch::now() };
        let (epoch_ns, begun_ns) = (epoch.monotonic_ns, crate::clock::now().0);
        let file = RunFile { pid, domain, runtime, epoch_ns, begun_ns, port };
        let run = Self { room, ..Self::from_file(dir, file, config)? };
        let guard = DomainGuard::new(run.domain.clone());
        layout::write(run.domain.root()).map_err(RunError::file(run.domain.root()))?;
        run.write_description()?;
        // `mr-slam status` finds the run by it without knowing its folder.
        running::write_pointer(&run)?;
        guard.keep();
        Ok(Self { _locks: Some(Arc::new([dir_lock, file_lock, folder_lock])), ..run })
    }

    /// Writes the copy of the room, `fleet.toml` and `run.json`, by which the fleet's processes and other programs know the run.
    fn write_description(&self) -> Result<(), RunError> {
        if let Some(room) = &self.room {
            room.write_copy(&self.dir).map_err(RunError::file(&room.copy_in(&self.dir)))?;
        }
        let toml = self.config.to_toml();
        let path = self.dir.join("fleet.toml");
        formats::atomic::write(&path, |file| file.write_all(toml.as_bytes()))
            .map_err(RunError::file(&path))?;
        let path = self.dir.join("run.json");
        let json = serde_json::to_string_pretty(&self.file)
            .map_err(|source| RunError::Json { path: path.clone(), source })?;
        formats::atomic::write_durably(&path, |file| file.write_all(json.as_bytes()))
            .map_err(RunError::file(&path))
    }

    /// Creates a run without folder or shared memory, for lockstep, whose files and channels are in memory.
    pub fn in_memory(config: FleetConfig) -> Result<Self, RunError> {
        let (domain, runtime) = ("lockstep".into(), "lockstep".into());
        let file = RunFile { pid: 0, domain, runtime, epoch_ns: 0, begun_ns: 0, port: 0 };
        Self::from_file("lockstep".into(), file, config)
    }

    /// Opens the run that the folder `dir` describes.
    pub fn open(dir: &Path) -> Result<Self, RunError> {
        let file = RunFile::read(dir)?;
        // A configuration of another build may have other keys.
        let config = FleetConfig::from_file(&dir.join("fleet.toml"))
            .map_err(|why| layout::check(&file.runtime).map_or_else(RunError::from, |()| why.into()))?;
        Self::from_file(dir.into(), file, config)
    }

    /// Opens the run in `dir`, whose launcher must be alive.
    pub fn open_running(dir: &Path) -> Result<Self, RunError> {
        let run = Self::open(dir)?;
        if runtime_folder::has_launcher(run.domain.root())? { Ok(run) } else { Err(RunError::Ended(run.dir)) }
    }

    fn from_file(dir: PathBuf, file: RunFile, config: FleetConfig) -> Result<Self, RunError> {
        let RunFile { pid, epoch_ns, begun_ns, port, .. } = file;
        let (epoch, begun) = (Epoch { monotonic_ns: epoch_ns }, Monotonic(begun_ns));
        let domain = Domain::new(&file.domain, &file.runtime)?;
        Ok(Self { dir, pid, domain, epoch, begun, port, config, file, room: None, _locks: None })
    }

    /// Returns whether the run's launcher is known to be alive.
    pub fn is_alive(&self) -> bool {
        runtime_folder::is_alive(self.domain.root())
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
        let index = self.config.processes().position(|(row, of)| row.role == role && of == robot);
        ProgressCounter::open(&self.domain, index, thread)
    }

    /// Returns the number of processes that have counters: the fleet's, and the link after them.
    pub fn progress_slots(&self) -> usize {
        self.link_slot() + 1
    }

    /// Returns the index of the counters of the link's process.
    pub fn link_slot(&self) -> usize {
        self.config.processes().count()
    }

    /// Opens the counter with which the link's process says that it works.
    pub fn link_progress(&self) -> ProgressCounter {
        ProgressCounter::open(&self.domain, Some(self.link_slot()), WatchedThread::Main)
    }

    /// Returns the robots of the fleet.
    pub fn robots(&self) -> impl Iterator<Item = RobotId> + Clone {
        RobotId::first(self.config.fleet.robots)
    }
}
