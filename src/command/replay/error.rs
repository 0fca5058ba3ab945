//! Reasons why a replay ends without a result.

use crate::config::ConfigError;
use crate::session_file::SessionFileError;
use formats::bag_folder::BagFilesError;
use formats::map_file::MapFileError;
use std::path::PathBuf;

/// Reason why a replay ended without a result.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// A log cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A result cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// A result would replace a file that is read.
    #[error("{} is read by this replay, and a result would replace it; nothing is done; expected another name for the result", .0.display())]
    Overwrites(PathBuf),
    /// A result is to be written into the folder of a running fleet.
    #[error(transparent)]
    Run(#[from] Box<crate::run::RunError>),
    /// The map cannot be written.
    #[error(transparent)]
    Map(#[from] MapFileError),
    /// A log has no scan.
    #[error(
        "{path} has no usable scan: expected FLASER or ROBOTLASER1 lines ({skipped} other lines, {malformed} malformed)"
    )]
    NoScan {
        /// Path of the file.
        path: PathBuf,
        /// Number of lines of other kinds.
        skipped: u64,
        /// Number of malformed lines.
        malformed: u64,
    },
    /// All scans of a log are skipped.
    #[error("{path} has {scans} scans, and --skip leaves out {skip}; expected less")]
    AllSkipped {
        /// Path of the file.
        path: PathBuf,
        /// Number of scans.
        scans: usize,
        /// Number of scans to skip.
        skip: usize,
    },
    /// A recording has no scan that can be used.
    #[error(
        "{path} has no usable scan: {malformed} are malformed, {without_odometry} have no odometry within 0.5 s; see --odom-topic, \
         --odom-frame and --no-odometry"
    )]
    NoScanOfBag {
        /// Path of the file.
        path: PathBuf,
        /// Number of malformed messages.
        malformed: u64,
        /// Number of scans far from all odometry.
        without_odometry: u64,
    },
    /// A folder or a file is no bag that is read.
    #[error(transparent)]
    BagFiles(#[from] BagFilesError),
    /// Several recordings are not parts of one.
    #[error(
        "the scans of {second} begin {pause_s:.1} s after the last of {first}: expected the parts of one bag, without longer pauses and \
         overlaps (`mcap merge` joins others), or --merge for several robots"
    )]
    NotOneBag {
        /// Path of the part before.
        first: PathBuf,
        /// Path of the part after it.
        second: PathBuf,
        /// Time from the last scan of one to the first of the other, seconds.
        pause_s: f64,
    },
    /// A recording has not what is needed.
    #[error("{path}: {why}")]
    Bag {
        /// Path of the file.
        path: PathBuf,
        /// What is missing.
        why: recording::bag::BagError,
    },
    /// There is no map to localize in.
    #[error("--mode localization needs a session or a map to localize in; expected --session FILE")]
    NothingToLocalizeIn,
    /// Of no scan the place in the map is known.
    #[error("{}: none of {scans} scans has a place in the map: the results are empty", path.display())]
    NothingPlaced {
        /// Path of the log.
        path: PathBuf,
        /// Number of scans that were read.
        scans: u64,
    },
    /// Most scans cannot be used.
    #[error(
        "{}: {used} of {all} scans can be used, the results have no others: expected stamps that increase, and scans of one geometry",
        path.display()
    )]
    FewScans {
        /// Path of the log.
        path: PathBuf,
        /// Number of scans that were used.
        used: u64,
        /// Number of scans.
        all: u64,
    },
    /// The map has no obstacle.
    #[error(
        "{}: the map has no wall: no reading of {scans} scans is an obstacle. Are ranges and range_max in metres, and does the LiDAR see \
         anything?", path.display()
    )]
    NoWall {
        /// Path of the log.
        path: PathBuf,
        /// Number of scans that were read.
        scans: u64,
    },
    /// Only a fleet's own recording is played for clients.
    #[error(
        "--serve plays the recording of a simulated fleet, as `mr-slam record` and `--record` write it, without --merge \
         and names of topics; leave --serve out for other logs"
    )]
    NotServed,
    /// Options that would do nothing.
    #[error("{options}: without effect on {replay}; leave out what is named")]
    WithoutEffect {
        /// Names of the options.
        options: String,
        /// What is replayed.
        replay: &'static str,
    },
    /// A fleet's recording cannot be replayed.
    #[error("cannot replay the fleet: {0}")]
    Replay(String),
    /// A fleet's recording lacks what its replay needs, or the files are of several runs.
    #[error("cannot replay the fleet: {0}")]
    Recording(String),
    /// The session, or the map in its place, cannot be read.
    #[error(transparent)]
    Begin(SessionFileError),
    /// The session cannot be written.
    #[error(transparent)]
    Session(SessionFileError),
    /// A map file has no pose graph that could grow.
    #[error(
        "--session {0} is a map file, which has no pose graph; expected --mode localize, or a session file"
    )]
    MapOnly(PathBuf),
    /// `--fov-deg` is out of range.
    #[error("--fov-deg is {0}; expected 1 to 360 degrees")]
    FieldOfView(f64),
    /// Several logs without `--merge`, or too many.
    #[error("{0} logs: expected one, 2 to {max} with --merge, or the .mcap files of one recording", max = msg::ROBOTS_MAX)]
    Logs(usize),
    /// `--merge` with the scans of one robot, or of too many.
    #[error(
        "the logs have scans of {0} robots: --merge expects 2 to {max}, each in a log of its own, or on a topic of its own in a recording",
        max = msg::ROBOTS_MAX
    )]
    Robots(usize),
    /// A line of the file with the starts is malformed.
    #[error(
        "{path}:{line}: `{found}`: expected `index time x y theta`, the first robot with index 0, and finite numbers"
    )]
    Starts {
        /// Path of the file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// Text of the line.
        found: String,
    },
    /// The fleet file is refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The summary cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

impl ReplayError {
    /// Returns whether the command line, or a file that it names as input, is refused before anything is replayed.
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Read { .. } | Self::Overwrites(_) | Self::NoScan { .. } | Self::AllSkipped { .. } => true,
            Self::NoScanOfBag { .. } | Self::BagFiles(_) | Self::NotOneBag { .. } | Self::Bag { .. } => true,
            Self::NothingToLocalizeIn | Self::NotServed | Self::WithoutEffect { .. } | Self::MapOnly(_) => {
                true
            }
            Self::Recording(_) | Self::Begin(_) | Self::FieldOfView(_) | Self::Logs(_) | Self::Robots(_) => {
                true
            }
            Self::Starts { .. } | Self::Config(_) => true,
            Self::Write { .. } | Self::Run(_) | Self::Map(_) | Self::NothingPlaced { .. } => false,
            Self::FewScans { .. }
            | Self::NoWall { .. }
            | Self::Replay(_)
            | Self::Session(_)
            | Self::Print(_) => false,
        }
    }
}
