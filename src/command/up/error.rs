//! Reasons why a fleet does not come up, or ends without all of its results.

use crate::certificate::CertificateError;
use crate::config::ConfigError;
use crate::resources::Shortage;
use crate::run::RunError;
use crate::world::WorldError;
use std::path::PathBuf;

/// Reason why a fleet did not come up.
#[derive(Debug, thiserror::Error)]
pub enum UpError {
    /// The fleet file or an option is out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The world, the robots' starts or their sessions cannot be built.
    #[error(transparent)]
    World(#[from] WorldError),
    /// The run that was created cannot begin: its folder, or the room that a headset offered, cannot be used.
    #[error(transparent)]
    Begin(WorldError),
    /// The run's folder or shared memory cannot be used.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The configured certificate of the operator's page cannot be used.
    #[error("bridge.page.https: {0}")]
    Certificate(#[from] CertificateError),
    /// The TCP port cannot be listened on.
    #[error("cannot listen on {address}:{port}: {why}; choose another with --port, or 0 for any")]
    Port {
        /// Address of the configuration.
        address: String,
        /// Port of the configuration.
        port: u16,
        /// Error of the operating system.
        why: std::io::Error,
    },
    /// A process cannot be started.
    #[error("cannot start the fleet: {0}")]
    Start(#[from] std::io::Error),
    /// The fleet in the background did not start.
    #[error("the fleet did not start; its last words in {log}:\n{words}")]
    Background {
        /// Path of the log.
        log: PathBuf,
        /// End of the log.
        words: String,
        /// Its exit code; `None` if it was killed.
        code: Option<i32>,
    },
    /// The fleet in the background lives, but its first process does not work yet.
    #[error(
        "the fleet (process {pid}) is still starting and has not failed: `mr-slam status --run-dir {dir}` says when it works, \
         {dir}/launcher.log has its messages, and `kill {pid}` ends it"
    )]
    SlowStart {
        /// Process id of the launcher.
        pid: u32,
        /// Folder of the run.
        dir: String,
    },
    /// The machine has too little of a resource.
    #[error(transparent)]
    Shortage(#[from] Shortage),
    /// Processes died again and again until the end. What there is of results is written.
    #[error("not a whole fleet: {} died again and again until the end; the messages above say of what", .0.join(", "))]
    Failing(Vec<String>),
    /// Some results cannot be written. The others are there.
    #[error("not everything was written: {}", .0.join("; "))]
    NotWritten(Vec<String>),
}
